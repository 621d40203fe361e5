//! What must be known of a mesh in blocks before the first round can begin in any of them: the initial state of the
//! vertices at the seams, and the limit of the first round.
//!
//! Both need stars that lie in more than one block: those of the seam vertices, and those of the corners of the sampled
//! triangles. They are collected in one scan over all triangles, after another one that finds the sample, and sorted by
//! vertex; see `initial` for what is made of a star.
//!
//! Memory: one bit for each vertex of the mesh, about 100 bytes for each triangle of the sample, which is at most 2^14,
//! and the sorter. I/O: the triangles are read twice, 20 bytes are sorted for each corner at a seam.

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, SortRecord, Sorter, Spool, SpoolWriter, StorageError};

use crate::ingest::StoredMesh;
use crate::nearby::Nearby;

use super::initial::{InitialVertex, initial_vertex};
use super::live_mesh::{Node, Normalisation, SPECIAL};
use super::metric::{CollapseMetric, Quadric};
use super::records::{Span, VertexRecord};
use super::rounds::{Histogram, Sample, count_edge};

/// Bytes of a buffer for reading.
const BUFFER: usize = 256 << 10;

/// A triangle at a vertex of which the star is collected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
struct StarTriangle {
    vertex: u32,
    triangle: u32,
    /// The corners after the vertex.
    others: [u32; 2],
    block: u32,
}

impl SortRecord for StarTriangle {
    fn prefix(&self) -> u64 {
        u64::from(self.vertex) << 32 | u64::from(self.triangle)
    }
}

/// A set of vertices, one bit for each vertex there is.
struct VertexSet {
    words: Vec<u64>,
}

impl VertexSet {
    fn new(vertices: u64) -> Self {
        VertexSet { words: vec![0; vertices.div_ceil(64) as usize] }
    }

    fn insert(&mut self, vertex: u32) {
        self.words[vertex as usize / 64] |= 1 << (vertex % 64);
    }

    #[inline]
    fn has(&self, vertex: u32) -> bool {
        self.words[vertex as usize / 64] >> (vertex % 64) & 1 != 0
    }
}

/// What blocks have to know of each other before the first round.
#[derive(Debug)]
pub(super) struct Seams {
    /// For each block the records of those of its corners that have triangles elsewhere or belong to another block, by
    /// ascending vertex.
    pub vertices: Vec<Spool<VertexRecord>>,
    /// The keys of the sample.
    pub histogram: Histogram,
}

/// Finds them.
pub(super) fn find<M: CollapseMetric>(
    mesh: &StoredMesh,
    metric: M,
    scratch: &Scratch,
    memory: usize,
) -> Result<Seams, StorageError> {
    let normalisation = Normalisation::new(mesh.exponent);
    let sample = Sample::of(mesh.triangles.len());
    let mut wanted = VertexSet::new(mesh.positions.len());
    let mut at_seam = VertexSet::new(mesh.positions.len());
    let mut sampled: Vec<[u32; 3]> = Vec::new();
    let mut reader = mesh.triangles.reader(BUFFER);
    let mut id = 0;
    while let Some(corners) = reader.next()? {
        if sample.has(id) {
            sampled.push(corners);
            corners.iter().for_each(|corner| wanted.insert(*corner));
        }
        id += 1;
    }
    let mut reader = mesh.seam_vertices.reader(BUFFER);
    while let Some(vertex) = reader.next()? {
        at_seam.insert(vertex);
        wanted.insert(vertex);
    }

    let mut stars = Sorter::new(scratch, "seam-stars", memory / 2, 1);
    let mut reader = mesh.triangles.reader(BUFFER);
    let (mut id, mut block) = (0, 0);
    while let Some([a, b, c]) = reader.next()? {
        while mesh.blocks.get(block as usize + 1).is_some_and(|next| next.first_triangle <= id) {
            block += 1;
        }
        for (vertex, others) in [(a, [b, c]), (b, [c, a]), (c, [a, b])] {
            if wanted.has(vertex) {
                stars.push(StarTriangle { vertex, triangle: id, others, block })?;
            }
        }
        id += 1;
    }
    drop(wanted);

    let buffer = (memory / 4 / mesh.blocks.len()).clamp(8 << 10, 256 << 10);
    let mut inboxes: Vec<SpoolWriter<VertexRecord>> =
        mesh.blocks.iter().map(|_| SpoolWriter::to_disk(scratch, "seam-vertices", buffer)).collect();
    // As vertices come by ascending number, so do those of the sample.
    let mut sample_corners = sampled.as_flattened().to_vec();
    sample_corners.sort_unstable();
    sample_corners.dedup();
    let mut of_sample: Vec<([f32; 3], Quadric)> = Vec::with_capacity(sample_corners.len());
    let mut positions = Nearby::new(&mesh.positions, 4096, 64);
    let mut stars = stars.finish()?;
    let mut next = stars.next()?;
    let (mut ring, mut spokes, mut blocks) = (Vec::new(), Vec::new(), Vec::new());
    while let Some(StarTriangle { vertex, .. }) = next {
        let position = positions.get(vertex.into())?;
        let centre = normalisation.apply(position);
        ring.clear();
        spokes.clear();
        blocks.clear();
        while let Some(star) = next.filter(|star| star.vertex == vertex) {
            let mut spoke = [[0.0; 3]; 2];
            for (spoke, other) in spoke.iter_mut().zip(star.others) {
                let end = normalisation.apply(positions.get(other.into())?);
                *spoke = std::array::from_fn(|axis| f64::from(end[axis]) - f64::from(centre[axis]));
            }
            ring.push(star.others);
            spokes.push(spoke);
            if blocks.last() != Some(&star.block) {
                blocks.push(star.block);
            }
            next = stars.next()?;
        }
        let InitialVertex { is_special, quadric, cone, normal } =
            initial_vertex(&ring, &spokes, metric.uses_quadrics());
        if at_seam.has(vertex) {
            let (first, last) = (blocks[0] as u16, blocks[blocks.len() - 1] as u16);
            let state = if is_special { SPECIAL } else { 0 };
            let node = Node::leaf(vertex, position, cone, normal);
            let record = VertexRecord { node, quadric, state, span: Span { first, last } };
            for block in &blocks {
                inboxes[*block as usize].push(record)?;
            }
        }
        if sample_corners.get(of_sample.len()) == Some(&vertex) {
            of_sample.push((centre, quadric));
        }
    }

    let mut histogram = Histogram::new();
    for corners in sampled {
        for side in 0..3 {
            let [(from, first), (to, second)] = [corners[side], corners[(side + 1) % 3]]
                .map(|corner| of_sample[sample_corners.partition_point(|vertex| *vertex < corner)]);
            let d = std::array::from_fn(|axis| to[axis] - from[axis]);
            count_edge(None, metric.keys(&first, &second, d).map(f32::to_bits), 0, &mut histogram);
        }
    }
    // None of it stays in RAM: the first pass has other uses for that.
    let vertices = inboxes.into_iter().map(SpoolWriter::finish_on_disk).collect::<Result<_, _>>()?;
    Ok(Seams { vertices, histogram })
}
