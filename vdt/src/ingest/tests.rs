//! [`super::store`] against [`super::canonical`], on files of every kind and with next to no memory.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use proptest::prelude::*;
use storage::{ByteSize, Disk, FaultyDisk, LocalDisk, MemoryDisk, Scratch, Spool};

use super::files;
use super::frame::Frame;
use super::limits::Limits;
use super::progress::Progress;
use super::stored::in_blocks;
use super::*;
use crate::mesh::MeshError;
use crate::tree::{Positions, lattice_number, on_lattice};
use crate::vector::{cross, dot, length, minus, unit};

/// What one file holds.
#[derive(Debug, Clone)]
pub(super) struct FileContent {
    pub positions: Vec<[f64; 3]>,
    pub triangles: Vec<[usize; 3]>,
}

impl FileContent {
    fn as_obj(&self) -> String {
        let vertices = self.positions.iter().map(|[x, y, z]| format!("v {x:?} {y:?} {z:?}\n"));
        let faces = self.triangles.iter().map(|corners| {
            let [a, b, c] = corners.map(|corner| corner + 1);
            format!("f {a} {b} {c}\n")
        });
        vertices.chain(faces).collect()
    }
}

/// Points of a small lattice: ties, equal positions, flat regions, zeros of both signs.
fn lattice_point() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(prop_oneof![3 => (0..5_i32).prop_map(f64::from), 1 => Just(-0.0), 1 => Just(0.1)])
}

/// Triangles between any points, also equal ones; some of the points are in none.
fn soup() -> impl Strategy<Value = FileContent> {
    let corner = prop::array::uniform3(any::<prop::sample::Index>());
    (prop::collection::vec(lattice_point(), 1..60), prop::collection::vec(corner, 0..60)).prop_map(
        |(positions, corners)| {
            let count = positions.len();
            FileContent { positions, triangles: corners.iter().map(|c| c.map(|corner| corner.index(count))).collect() }
        },
    )
}

/// A sheet in the order of a scan, or in none, or as a soup of facets.
fn sheet() -> impl Strategy<Value = FileContent> {
    let heights = prop::collection::vec(-1.0..1.0_f64, 17 * 17);
    (1..16_usize, 1..16_usize, heights, 0..3_u8, any::<u64>()).prop_map(|(columns, rows, heights, kind, seed)| {
        let at = |column: usize, row: usize| row * (columns + 1) + column;
        let mut content = FileContent { positions: Vec::new(), triangles: Vec::new() };
        for row in 0..=rows {
            for column in 0..=columns {
                content.positions.push([column as f64, row as f64, heights[at(column, row)]]);
            }
        }
        for row in 0..rows {
            for column in 0..columns {
                let [a, b] = [at(column, row), at(column + 1, row)];
                let [c, d] = [at(column + 1, row + 1), at(column, row + 1)];
                content.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        match kind {
            0 => content,
            1 => shuffled(&content, seed),
            _ => FileContent {
                positions: content.triangles.iter().flatten().map(|corner| content.positions[*corner]).collect(),
                triangles: (0..content.triangles.len())
                    .map(|facet| [3 * facet, 3 * facet + 1, 3 * facet + 2])
                    .collect(),
            },
        }
    })
}

/// Vertices and triangles in another order, each triangle turned.
fn shuffled(content: &FileContent, seed: u64) -> FileContent {
    let mut state = seed | 1;
    let mut below = |limit: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % limit
    };
    let mut places: Vec<usize> = (0..content.positions.len()).collect();
    for last in (1..places.len()).rev() {
        places.swap(last, below(last + 1));
    }
    let mut positions = content.positions.clone();
    places.iter().zip(&content.positions).for_each(|(place, position)| positions[*place] = *position);
    let mut triangles: Vec<_> = content.triangles.iter().map(|t| t.map(|corner| places[corner])).collect();
    for last in (1..triangles.len()).rev() {
        triangles.swap(last, below(last + 1));
        triangles[last].rotate_left(below(3));
    }
    FileContent { positions, triangles }
}

/// One to three files that are one mesh, near zero or far from it, of any size.
pub(super) fn meshes() -> impl Strategy<Value = Vec<FileContent>> {
    let scale = prop_oneof![4 => Just(1.0), 1 => Just(1e-30), 1 => Just(0.001), 1 => Just(1e36), 1 => Just(3e38)];
    let far = prop_oneof![3 => Just(0.0), 1 => Just(4e6), 1 => Just(-1234.5)];
    let mirrored = any::<bool>();
    (prop::collection::vec(prop_oneof![soup(), sheet()], 1..4), scale, far, mirrored).prop_map(
        |(mut files, scale, far, mirrored)| {
            for file in &mut files {
                file.positions.iter_mut().flatten().for_each(|value| *value = *value * scale + far);
                if mirrored {
                    file.positions.iter_mut().for_each(|position| position[1] = -position[1]);
                }
            }
            files
        },
    )
}

fn on_disk(contents: &[FileContent]) -> (MemoryDisk, Vec<PathBuf>) {
    let disk = MemoryDisk::new();
    let paths: Vec<PathBuf> = (0..contents.len()).map(|number| PathBuf::from(format!("{number}.obj"))).collect();
    for (path, content) in paths.iter().zip(contents) {
        // An OBJ without a line is no mesh file.
        disk.insert(path, format!("# made for a test\n{}", content.as_obj()).into_bytes());
    }
    (disk, paths)
}

/// A scratch that goes to this disk.
pub(super) fn scratch_on(disk: impl Disk + 'static) -> Scratch {
    Scratch::open(Arc::new(disk), Path::new("scratch"), "").unwrap().0
}

/// [`store`], also with limits for which it would be refused.
pub(super) fn store_within(
    disk: &dyn Disk,
    scratch: &Scratch,
    paths: &[PathBuf],
    rule: PositionsRule,
    limits: &Limits,
) -> Result<StoredMesh, MeshError> {
    let mut last = 0.0;
    let mut report = |done: f64| {
        assert!(done >= last && done < 1.0 + 1e-9, "{last} -> {done}");
        last = done;
    };
    let mut progress = Progress::new(&mut report);
    let files = files::read(disk, scratch, paths, true, limits, &mut progress)?;
    in_blocks(files, rule, scratch, limits, &mut progress)
}

pub(super) fn all<T: bytemuck::Pod>(spool: &Spool<T>) -> Vec<T> {
    let mut records = vec![T::zeroed(); spool.len() as usize];
    spool.read_at(0, &mut records).unwrap();
    records
}

/// The stored mesh is the mesh in core, and its blocks are what they should be.
pub(super) fn check(stored: &StoredMesh, core: &CoreMesh, block_triangles: u64) {
    let bits = |positions: &[[f32; 3]]| positions.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
    let (positions, triangles) = (all(&stored.positions), all(&stored.triangles));
    assert_eq!(bits(&positions), bits(&core.positions));
    assert_eq!(triangles, core.triangles);
    assert_eq!((stored.origin, stored.exponent), (core.origin, core.exponent));
    assert_eq!((stored.kept_as, stored.lattice_step.to_bits()), (core.kept_as, core.lattice_step.to_bits()));
    assert_eq!(stored.cleaning, core.cleaning);
    assert_eq!(stored.input_error.to_bits(), core.input_error.to_bits());
    let extreme = |axis: usize, largest: bool| {
        let values = positions.iter().map(|position| position[axis]);
        if largest { values.max_by(f32::total_cmp) } else { values.min_by(f32::total_cmp) }.unwrap_or(0.0)
    };
    assert_eq!(stored.bounds, [false, true].map(|largest| [0, 1, 2].map(|axis| extreme(axis, largest))));

    let firsts: Vec<u32> = stored.blocks.iter().map(|block| block.first_vertex).collect();
    assert!(firsts.is_sorted_by(|left, right| left < right));
    assert_eq!(firsts.first(), (!positions.is_empty()).then_some(&0));
    let block_of = |vertex: u32| firsts.partition_point(|first| *first <= vertex) - 1;
    for (number, block) in stored.blocks.iter().enumerate() {
        assert!((block.first_vertex as usize) < positions.len());
        let first_triangle = triangles.partition_point(|triangle| block_of(triangle[0]) < number);
        assert_eq!(block.first_triangle as usize, first_triangle);
        let end = stored.blocks.get(number + 1).map_or(triangles.len(), |next| next.first_triangle as usize);
        let inside = &triangles[first_triangle..end];
        assert!(
            inside.len() as u64 <= (2 * block_triangles).max(1) || inside.iter().all(|t| t[0] == inside[0][0]),
            "{} triangles in a block of {block_triangles}",
            inside.len()
        );
    }
    let abroad = |corners: &[u32; 3]| {
        let home = block_of(corners[0]);
        corners.map(|corner| (block_of(corner) != home).then_some(corner))
    };
    let seam: BTreeSet<u32> = triangles.iter().flat_map(abroad).flatten().collect();
    assert_eq!(all(&stored.seam_vertices), Vec::from_iter(seam));
}

/// Lossless, a lattice, or what is chosen.
pub(super) fn rule() -> impl Strategy<Value = PositionsRule> {
    prop_oneof![
        2 => Just(PositionsRule::LOSSLESS),
        1 => Just(PositionsRule::Auto),
        3 => Positions::BITS.prop_map(|bits| PositionsRule::Fixed(Positions::Bits(bits))),
    ]
}

/// Every position is on the lattice that the mesh has, with as many steps as were allowed.
fn check_lattice(mesh: &CoreMesh, rule: PositionsRule) {
    let CoreMesh { kept_as, lattice_step, .. } = *mesh;
    if rule == PositionsRule::LOSSLESS {
        assert_eq!(kept_as, Positions::Lossless);
    }
    if lattice_step == 0.0 {
        assert_eq!(kept_as, Positions::Lossless);
        return;
    }
    for coordinate in mesh.positions.iter().flatten() {
        let number = lattice_number(*coordinate, lattice_step).unwrap();
        assert_eq!(on_lattice(number, lattice_step).to_bits(), coordinate.to_bits());
        if let Positions::Bits(bits) = kept_as {
            assert!(number.unsigned_abs() <= 1 << (bits - 1));
        }
    }
}

pub(super) fn in_core(
    disk: &dyn Disk,
    paths: &[PathBuf],
    rule: PositionsRule,
) -> Result<(CoreMesh, FileCounts), MeshError> {
    load(disk, paths, rule, true, ByteSize(u64::MAX), &reading_needs)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn any_files_in_any_memory_give_the_canonical_mesh(
        contents in meshes(),
        rule in rule(),
        memory in prop_oneof![0_usize..4000, Just(1 << 20)],
        block_triangles in prop_oneof![0_u64..40, Just(u64::MAX)],
        vertex_chunk in 1_usize..30,
        triangle_chunk in 1_u64..30,
        threads in 1_usize..3,
        in_memory: bool,
    ) {
        let (disk, paths) = on_disk(&contents);
        let limits = Limits { memory, threads, block_triangles, vertex_chunk, triangle_chunk };
        let temporary = MemoryDisk::new();
        let scratch = if in_memory { Scratch::in_memory() } else { scratch_on(temporary.clone()) };
        match (store_within(&disk, &scratch, &paths, rule, &limits), in_core(&disk, &paths, rule)) {
            (Ok(stored), Ok((core, counts))) => {
                prop_assert_eq!(stored.files, counts);
                check(&stored, &core, block_triangles.min(1 << 32));
                check_lattice(&core, rule);
            }
            (Err(stored), Err(core)) => prop_assert_eq!(stored.to_string(), core.to_string()),
            (stored, core) => prop_assert!(false, "stored: {:?}, in core: {:?}", stored.is_ok(), core.is_ok()),
        }
        drop(scratch);
        prop_assert!(temporary.paths().is_empty());
    }
}

#[test]
fn a_read_that_fails_is_an_error() {
    let content =
        FileContent { positions: vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], triangles: vec![[0, 1, 2]] };
    let (disk, paths) = on_disk(&[content.clone(), content]);
    let disk = FaultyDisk::new(Arc::new(disk));
    let limits = Limits { memory: 100, threads: 1, block_triangles: 9, vertex_chunk: 9, triangle_chunk: 9 };
    let outcome = |reads| {
        disk.fail_reads_after(reads);
        store_within(&disk, &Scratch::in_memory(), &paths, PositionsRule::Auto, &limits)
    };
    let failed: Vec<MeshError> = (0..).map_while(|reads| outcome(reads).err()).collect();
    assert!(failed.len() >= 4, "{}", failed.len());
    assert!(failed.iter().all(|error| error.to_string().ends_with("injected fault")), "{failed:?}");
}

#[test]
fn a_scratch_disk_that_fails_is_an_error_and_leaves_nothing() {
    let columns = 40;
    let positions: Vec<[f64; 3]> =
        (0..columns * columns).map(|number| [f64::from(number % columns), f64::from(number / columns), 0.1]).collect();
    let triangles = (0..positions.len() - columns as usize - 1).map(|a| [a, a + 1, a + columns as usize + 1]).collect();
    let (disk, paths) = on_disk(&[FileContent { positions, triangles }]);
    let limits = Limits { memory: 4096, threads: 1, block_triangles: 99, vertex_chunk: 99, triangle_chunk: 99 };
    let rule = PositionsRule::Fixed(Positions::Bits(10));
    let core = in_core(&disk, &paths, rule).unwrap().0;
    for full in [true, false] {
        let (mut faults, mut limit) = (0, 0);
        loop {
            let temporary = MemoryDisk::new();
            let faulty = FaultyDisk::new(Arc::new(temporary.clone()));
            let scratch = scratch_on(faulty.clone());
            if full {
                faulty.full_after(limit)
            } else {
                faulty.fail_reads_after(limit)
            }
            match store_within(&disk, &scratch, &paths, rule, &limits) {
                Ok(stored) => {
                    faulty.heal();
                    check(&stored, &core, 99);
                    break;
                }
                Err(error) => assert!(error.to_string().contains("scratch/0"), "{error}"),
            }
            drop(scratch);
            assert!(temporary.paths().is_empty());
            faults += 1;
            limit += if full { 8192 } else { 1 };
        }
        assert!(faults > 10, "{faults}");
    }
}

#[test]
fn a_position_beyond_single_precision_is_refused_with_its_file_and_number() {
    let square = |size: f64| FileContent {
        positions: vec![[9e99, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, size, 0.0]],
        triangles: vec![[1, 2, 3]],
    };
    let (disk, paths) = on_disk(&[square(1.0), square(1e50)]);
    let limits = Limits { memory: 100, threads: 1, block_triangles: 9, vertex_chunk: 9, triangle_chunk: 9 };
    let expected = "1.obj: vertex 3: the coordinates are too large for single precision";
    for rule in [PositionsRule::Auto, PositionsRule::Fixed(Positions::Bits(24))] {
        let error = store_within(&disk, &Scratch::in_memory(), &paths, rule, &limits).unwrap_err();
        assert_eq!(error.to_string(), expected);
        assert_eq!(in_core(&disk, &paths, rule).unwrap_err().to_string(), expected);
    }
}

#[test]
fn less_memory_than_the_smallest_is_refused_with_the_figure() {
    let content = FileContent { positions: vec![[0.0; 3]; 3], triangles: vec![[0, 1, 2]] };
    let (disk, paths) = on_disk(&[content]);
    let mut plan = IngestPlan {
        memory: ByteSize(1 << 20),
        threads: 1,
        block_triangles: 1000,
        positions: PositionsRule::Auto,
        attributes: true,
    };
    let error = store(&disk, &Scratch::in_memory(), &paths, &plan, &mut |_| ()).unwrap_err();
    let MeshError::OverMemory { vertices: 3, triangles: 1, needed, .. } = error else { panic!("{error}") };
    plan.memory = needed;
    let stored = store(&disk, &Scratch::in_memory(), &paths, &plan, &mut |_| ()).unwrap();
    assert_eq!(stored.cleaning.degenerate_triangles, 1);
}

#[test]
fn a_missing_file_is_an_error() {
    let plan = IngestPlan {
        memory: ByteSize(64 << 20),
        threads: 1,
        block_triangles: 1000,
        positions: PositionsRule::Auto,
        attributes: true,
    };
    let paths = [Path::new("/nowhere/at/all.ply").to_path_buf()];
    let error = store(&LocalDisk, &Scratch::in_memory(), &paths, &plan, &mut |_| ()).unwrap_err();
    assert!(error.to_string().contains("/nowhere/at/all.ply"), "{error}");
}

/// The distance from a point to a triangle: to its plane where the foot is inside, else to the nearest edge.
fn distance(point: [f64; 3], triangle: [[f64; 3]; 3]) -> f64 {
    let along = |from: [f64; 3], to: [f64; 3]| {
        let (edge, way) = (minus(to, from), minus(point, from));
        let share = (dot(way, edge) / dot(edge, edge).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
        length(minus(way, edge.map(|component| component * share)))
    };
    let edges = [0, 1, 2].map(|corner| (triangle[corner], triangle[(corner + 1) % 3]));
    let nearest = edges.iter().map(|(from, to)| along(*from, *to)).fold(f64::INFINITY, f64::min);
    let normal = unit(cross(minus(triangle[1], triangle[0]), minus(triangle[2], triangle[0])));
    let is_inside = edges.iter().all(|(from, to)| dot(cross(minus(*to, *from), minus(point, *from)), normal) >= 0.0);
    if is_inside && normal != [0.0; 3] { dot(minus(point, triangle[0]), normal).abs().min(nearest) } else { nearest }
}

/// The frame of a mesh.
fn frame_of(mesh: &CoreMesh) -> Frame {
    let (origin, step) = (mesh.origin, if mesh.kept_as == Positions::Lossless { 0.0 } else { mesh.lattice_step });
    Frame { origin, step }
}

/// Points that single precision does not hold, some of them a hair apart.
fn double_points() -> impl Strategy<Value = Vec<[f64; 3]>> {
    let value = prop_oneof![(0..4_i32).prop_map(f64::from), -3.0..3.0_f64];
    let hair = prop_oneof![Just(0.0), -1e-9..1e-9_f64, -1e-3..1e-3_f64];
    let point = (prop::array::uniform3(value), hair).prop_map(|([x, y, z], hair)| [x + hair, y, z]);
    prop::collection::vec(point, 3..12)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_point_of_the_files_is_farther_from_the_mesh_than_the_input_error(
        points in double_points(),
        corners in prop::collection::vec(prop::array::uniform3(any::<prop::sample::Index>()), 1..14),
        far in prop_oneof![Just(0.0), Just(123_456.7), Just(-4e6)],
        rule in rule(),
    ) {
        let points: Vec<[f64; 3]> = points.iter().map(|point| point.map(|value| value + far)).collect();
        let triangles: Vec<[usize; 3]> = corners.iter().map(|c| c.map(|corner| corner.index(points.len()))).collect();
        let in_core = triangles.iter().map(|corners| corners.map(|corner| corner as u32)).collect();
        let mesh = canonical_as(rule, points.clone(), in_core, CleaningCounts::default()).unwrap();
        let is_rounded = mesh.kept_as != Positions::Lossless;
        let frame = frame_of(&mesh);
        // Lengths near the origin: there the distances are exact enough.
        let kept = |corner: u32| mesh.positions[corner as usize].map(f64::from);
        let mesh_triangles: Vec<_> = mesh.triangles.iter().map(|corners| corners.map(kept)).collect();
        let is_corner = |point: [f64; 3]| mesh.positions.contains(&frame.local(point));
        let mut largest = 0.0_f64;
        for corners in &triangles {
            let corners = corners.map(|corner| points[corner]);
            if mesh.triangles.is_empty() || !is_rounded && !corners.iter().any(|corner| is_corner(*corner)) {
                // A line or a point apart from the surface.
                continue;
            }
            for weights in [[1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0], [0.2, 0.3, 0.5]] {
                let point = [0, 1, 2].map(|axis| {
                    (0..3).map(|corner| weights[corner] * (corners[corner][axis] - mesh.origin[axis])).sum::<f64>()
                });
                let nearest = mesh_triangles.iter().map(|triangle| distance(point, *triangle));
                largest = largest.max(nearest.fold(f64::INFINITY, f64::min));
            }
        }
        prop_assert!(largest <= f64::from(mesh.input_error) + 1e-12, "{} > {}", largest, mesh.input_error);

        // Where nothing was left out, it is the largest step of a vertex and nothing else.
        if mesh.cleaning.degenerate_triangles == 0 {
            let named: BTreeSet<usize> = triangles.iter().flatten().copied().collect();
            let steps = named.iter().map(|vertex| {
                let local = frame.local(points[*vertex]);
                let squares = (0..3).map(|axis| (points[*vertex][axis] - mesh.origin[axis] - f64::from(local[axis])).powi(2));
                squares.sum::<f64>().sqrt()
            });
            let largest = steps.fold(0.0, f64::max);
            prop_assert!(mesh.input_error >= largest as f32 && f64::from(mesh.input_error) <= largest * 1.000_001);
        }
    }
}

#[test]
fn single_precision_has_no_input_error_and_a_segment_has_half_its_length() {
    let square = [[0.0; 3], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0]];
    let error = |triangles: &[[u32; 3]], far: f64| {
        let positions = square.iter().map(|position| position.map(|value| value + far)).collect();
        canonical(positions, triangles.to_vec(), CleaningCounts::default()).unwrap().input_error
    };
    let whole = [[0, 1, 2], [0, 2, 3]];
    assert_eq!((error(&whole, 0.0), error(&whole, 16_777_216.0)), (0.0, 0.0));
    assert_eq!(error(&[[0, 1, 2], [0, 2, 3], [0, 0, 1], [2, 0, 2]], 0.0), 0.0);
    // Between the two corners that have no edge in common.
    let half = error(&[[0, 1, 2], [0, 2, 3], [1, 1, 3]], 0.0);
    assert!(half >= 8.0_f32.sqrt() && half < 2.8285, "{half}");
    // Corner 3 is in no triangle.
    assert_eq!(error(&[[0, 1, 2], [0, 0, 3]], 0.0), 4.0_f32.next_up());
}
