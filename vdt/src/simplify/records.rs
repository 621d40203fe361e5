//! A mesh that is being simplified, as it lies on disk between passes: [`VertexRecord`], [`TriangleRecord`], and a
//! [`Piece`] of them.
//!
//! A piece is any part of the mesh: triangles, and all their corners. A vertex whose triangles lie in several pieces has
//! a record in each; the copies agree but for the rounds and dependency ids that grow, of which the largest counts
//! ([`VertexRecord::unite`]).

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use bytemuck::{Pod, Zeroable};
use storage::{Scratch, Spool, SpoolReader, SpoolWriter, StorageError};

use super::bound::Piece as CutPiece;
use super::live_mesh::{LiveMesh, Node, Triangle, Vertex};
use super::live_wedges::{Wait, WedgeReader};
use super::metric::Quadric;
use super::plan::Carried;
use crate::tree::{CornerPlaces, MeshAttributes};

/// A vertex that is left. 96 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct VertexRecord {
    /// The node that it stands for.
    pub node: Node,
    /// Its quadric, about its own position.
    pub quadric: Quadric,
    /// The round in which its star changed last, whether it lies on an edge that is not regular, and whether all of its
    /// star is in the pieces of the same seam.
    pub state: u32,
    /// The first and the last block that has triangles at it, where there is more than one; otherwise at most that one.
    /// By the numbers that blocks had in the pass that wrote it.
    pub span: Span,
}

impl VertexRecord {
    /// Takes over what another copy of the same vertex knows more.
    pub fn unite(&mut self, other: &VertexRecord) {
        // The round is in the low bits, the flags above it are the same in all copies.
        self.state = self.state.max(other.state);
        self.node.star_order = self.node.star_order.max(other.node.star_order);
        self.span = self.span.around(other.span);
    }
}

/// A stretch of blocks, by their numbers in a pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Span {
    /// The first block.
    pub first: u16,
    /// The last block.
    pub last: u16,
}

impl Span {
    /// No block at all.
    pub const NONE: Span = Span { first: u16::MAX, last: 0 };

    /// One block.
    pub fn of(block: u16) -> Self {
        Span { first: block, last: block }
    }

    /// The shortest stretch that holds both.
    pub fn around(self, other: Span) -> Self {
        Span { first: self.first.min(other.first), last: self.last.max(other.last) }
    }

    /// Whether there is more than one block in it.
    pub fn is_shared(self) -> bool {
        self.first < self.last
    }

    /// The same blocks by other numbers, that ascend.
    pub fn renumbered(self, numbers: &[u16]) -> Self {
        if self.first > self.last {
            return Span::NONE;
        }
        Span { first: numbers[usize::from(self.first)], last: numbers[usize::from(self.last)] }
    }

    /// Whether all of it lies in `first..=last`.
    pub fn is_within(self, first: u16, last: u16) -> bool {
        first <= self.first && self.last <= last || self.first > self.last
    }
}

/// A triangle that is left. 24 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TriangleRecord {
    /// Its corners, as places in the list of vertices of its piece.
    pub corners: [u32; 3],
    /// Its canonical id.
    pub id: u32,
    /// Dependency id of the collapse that rewrote it last; 0 where none did.
    pub order: u32,
    /// How far, at most, what it answers for itself lies from it, see `bound`.
    pub residual: f32,
}

/// A part of the mesh on disk.
#[derive(Debug)]
pub(super) struct Piece {
    /// Its vertices, by ascending canonical id.
    pub vertices: Spool<VertexRecord>,
    /// Its triangles, by ascending canonical id.
    pub triangles: Spool<TriangleRecord>,
    /// The pieces of earlier surface that its triangles keep, in their order; of each triangle, the last one first.
    pub cut_pieces: Spool<CutPiece>,
    /// The reverse bounds of its triangles, where such are kept.
    reverses: Option<Spool<f32>>,
    /// The places of its triangles' corners among the wedges of their vertices, where there are vertices with several.
    corners: Option<Spool<CornerPlaces>>,
    /// What waits at its vertices, where attributes count.
    waits: Option<Spool<Wait>>,
    /// Wedges of its vertices.
    pub wedges: u64,
}

/// The stores of a piece being written.
#[derive(Debug)]
pub(super) struct PieceWriter {
    vertices: SpoolWriter<VertexRecord>,
    triangles: SpoolWriter<TriangleRecord>,
    cut_pieces: SpoolWriter<CutPiece>,
    reverses: Option<SpoolWriter<f32>>,
    corners: Option<SpoolWriter<CornerPlaces>>,
    waits: Option<SpoolWriter<Wait>>,
}

impl PieceWriter {
    /// Within so many bytes of RAM while it is written; none of it stays there.
    pub fn new(scratch: &Scratch, name: &str, carried: Carried, ram_bytes: usize) -> Self {
        let Carried { bound, heeded, .. } = carried;
        PieceWriter {
            vertices: SpoolWriter::to_disk(scratch, name, ram_bytes / 2),
            triangles: SpoolWriter::to_disk(scratch, name, ram_bytes / 4),
            cut_pieces: SpoolWriter::to_disk(scratch, name, ram_bytes / 4),
            reverses: bound.is_two_sided().then(|| SpoolWriter::to_disk(scratch, name, ram_bytes / 8)),
            corners: heeded.seams.then(|| SpoolWriter::to_disk(scratch, name, ram_bytes / 8)),
            waits: heeded.counts().then(|| SpoolWriter::to_disk(scratch, name, ram_bytes / 8)),
        }
    }

    /// Writes the live triangles of a mesh for which `is_chosen` holds, with their corners. `places` is a buffer.
    /// `is_whole` says of which vertices all of the star goes into this piece and others of the same seam.
    pub fn write(
        mut self,
        mesh: &LiveMesh,
        spans: &[Span],
        is_chosen: impl Fn(usize) -> bool,
        is_whole: impl Fn(usize) -> bool,
        places: &mut Vec<u32>,
    ) -> Result<Piece, StorageError> {
        const UNUSED: u32 = u32::MAX;
        places.clear();
        places.resize(mesh.vertices.len(), UNUSED);
        let chosen = || (0..mesh.triangles.len()).filter(|triangle| mesh.is_live(*triangle) && is_chosen(*triangle));
        for triangle in chosen() {
            for corner in mesh.triangles[triangle].corners {
                places[corner as usize] = 0;
            }
        }
        let (mut next, mut wedges) = (0, 0);
        for (vertex, place) in places.iter_mut().enumerate() {
            if *place != UNUSED {
                *place = next;
                next += 1;
                let Vertex { quadric, .. } = mesh.vertices[vertex];
                let state = mesh.vertices[vertex].lasting_state(is_whole(vertex));
                let (node, span) = (mesh.nodes[vertex], spans[vertex]);
                self.vertices.push(VertexRecord { node, quadric, state, span })?;
                wedges += mesh.wedges.of(vertex as u32).len() as u64;
                if let Some(waits) = &mut self.waits {
                    waits.push(mesh.wedges.wait(vertex as u32))?;
                }
            }
        }
        let mut kept: Vec<CutPiece> = Vec::new();
        for (place, triangle) in (0..).zip(chosen()) {
            let Triangle { corners, order } = mesh.triangles[triangle];
            let corners = corners.map(|corner| places[corner as usize]);
            let cover = mesh.covers.of(triangle);
            let id = mesh.triangle_ids[triangle];
            self.triangles.push(TriangleRecord { corners, id, order, residual: cover.residual })?;
            if let Some(reverses) = &mut self.reverses {
                reverses.push(mesh.covers.reverse(triangle))?;
            }
            if let Some(corners) = &mut self.corners {
                corners.push(mesh.wedges.corners(triangle))?;
            }
            kept.extend(mesh.covers.pieces(cover));
            while let Some(piece) = kept.pop() {
                self.cut_pieces.push(piece.owned_by(place))?;
            }
        }
        Ok(Piece {
            vertices: self.vertices.finish_on_disk()?,
            triangles: self.triangles.finish_on_disk()?,
            cut_pieces: self.cut_pieces.finish_on_disk()?,
            reverses: self.reverses.map(SpoolWriter::finish_on_disk).transpose()?,
            corners: self.corners.map(SpoolWriter::finish_on_disk).transpose()?,
            waits: self.waits.map(SpoolWriter::finish_on_disk).transpose()?,
            wedges,
        })
    }
}

/// Reads pieces into an empty live mesh, each vertex once; fills in the span of each vertex, and for each triangle the
/// number that its piece comes with. The wedges of the vertices are those of `attributes`. `ram_bytes` are for buffers.
pub(super) fn read_pieces<'a>(
    mesh: &mut LiveMesh,
    attributes: Option<&MeshAttributes>,
    pieces: impl Iterator<Item = (u16, &'a Piece)> + Clone,
    spans: &mut Vec<Span>,
    numbers: &mut Vec<u16>,
    ram_bytes: usize,
) -> Result<(), StorageError> {
    let count = pieces.clone().count();
    let buffer = (ram_bytes / count.max(1)).clamp(4 << 10, 256 << 10);
    let mut readers: Vec<_> = pieces.clone().map(|(_, piece)| VertexReader::new(piece, buffer)).collect();
    let vertices: u64 = pieces.clone().map(|(_, piece)| piece.vertices.len()).sum();
    let triangles: u64 = pieces.clone().map(|(_, piece)| piece.triangles.len()).sum();
    mesh.reserve(vertices as usize, triangles as usize);
    // For each piece, where its vertices have gone.
    let mut places: Vec<Vec<u32>> = Vec::with_capacity(count);
    let mut heads = BinaryHeap::with_capacity(count);
    for (index, (_, piece)) in pieces.clone().enumerate() {
        places.push(Vec::with_capacity(piece.vertices.len() as usize));
        if let Some((record, wait)) = readers[index].next()? {
            heads.push(Head { index, record, wait });
        }
    }
    let mut united: Option<(VertexRecord, Wait)> = None;
    let mut push = |mesh: &mut LiveMesh, (done, wait): (VertexRecord, Wait)| {
        mesh.push_vertex(done.node, done.quadric, done.state);
        mesh.wedges.set_wait(mesh.vertices.len() as u32 - 1, wait);
        spans.push(done.span);
    };
    while let Some(mut head) = heads.pop() {
        // As long as this piece has the smallest vertex, the heap has nothing to do.
        loop {
            let Head { record, wait, .. } = head;
            match &mut united {
                Some((before, wait_before)) if before.node.id == record.node.id => {
                    before.unite(&record);
                    *wait_before = wait_before.united(wait);
                }
                before => {
                    if let Some(done) = before.replace((record, wait)) {
                        push(mesh, done);
                    }
                }
            }
            places[head.index].push(mesh.vertices.len() as u32);
            let Some((record, wait)) = readers[head.index].next()? else { break };
            (head.record, head.wait) = (record, wait);
            if heads.peek().is_some_and(|other| other.record.node.id < record.node.id) {
                heads.push(head);
                break;
            }
        }
    }
    if let Some(done) = united {
        push(mesh, done);
    }
    drop(readers);
    if let Some(attributes) = attributes {
        mesh.load_wedges(&mut WedgeReader::new(attributes, 1))?;
    }
    for ((number, piece), places) in pieces.zip(&places) {
        let mut reader = piece.triangles.reader(256 << 10);
        let first = mesh.triangles.len();
        while let Some(TriangleRecord { corners, id, order, residual }) = reader.next()? {
            let corners = corners.map(|corner| places[corner as usize]);
            mesh.push_triangle(id, Triangle { corners, order }, residual);
            numbers.push(number);
        }
        let mut reader = piece.cut_pieces.reader(256 << 10);
        while let Some(cut_piece) = reader.next()? {
            mesh.covers.add_piece(first + cut_piece.owner() as usize, &cut_piece);
        }
        if let Some(reverses) = &piece.reverses {
            let mut reader = reverses.reader(64 << 10);
            for triangle in first..mesh.triangles.len() {
                if let Some(reverse) = reader.next()? {
                    mesh.covers.set_reverse(triangle, reverse);
                }
            }
        }
        if let Some(corners) = &piece.corners {
            let mut reader = corners.reader(64 << 10);
            for triangle in first..mesh.triangles.len() {
                if let Some(places) = reader.next()? {
                    mesh.wedges.set_corners(triangle, places);
                }
            }
        }
    }
    mesh.build_stars();
    Ok(())
}

/// Reads the vertices of a piece, each with what waits there.
struct VertexReader<'a> {
    vertices: SpoolReader<'a, VertexRecord>,
    waits: Option<SpoolReader<'a, Wait>>,
}

impl<'a> VertexReader<'a> {
    fn new(piece: &'a Piece, ram_bytes: usize) -> Self {
        let waits = piece.waits.as_ref().map(|waits| waits.reader(ram_bytes / 8));
        VertexReader { vertices: piece.vertices.reader(ram_bytes), waits }
    }

    #[inline]
    fn next(&mut self) -> Result<Option<(VertexRecord, Wait)>, StorageError> {
        let Some(record) = self.vertices.next()? else { return Ok(None) };
        let wait = match &mut self.waits {
            Some(waits) => waits.next()?.unwrap_or(Wait::NONE),
            None => Wait::NONE,
        };
        Ok(Some((record, wait)))
    }
}

/// The next vertex of a piece. The smallest is the greatest, for the heap.
struct Head {
    index: usize,
    record: VertexRecord,
    wait: Wait,
}

impl PartialEq for Head {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Head {}

impl PartialOrd for Head {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Head {
    fn cmp(&self, other: &Self) -> Ordering {
        other.record.node.id.cmp(&self.record.node.id)
    }
}
