//! Distances against looking at everything, and against what is known of simple shapes.

use std::path::Path;
use std::sync::Arc;

use proptest::prelude::*;
use storage::{FaultyDisk, MemoryDisk};

use super::target::Searcher;
use super::triangle::{Triangle, length, squared_distance};
use super::*;
use crate::ingest::{CoreAttributes, CoreMesh, FileCounts, StoredMesh};
use crate::mesh::ImageSource;
use crate::tree::{Appearance, AttributeKinds, CornerPlaces, Image, Material, Wedge};
use crate::vector::Vector;

/// A mesh as a file would hold it.
#[derive(Debug, Clone, Default)]
struct Mesh {
    positions: Vec<Vector>,
    triangles: Vec<[usize; 3]>,
}

impl Mesh {
    fn off(&self) -> Vec<u8> {
        let mut text = format!("OFF\n{} {} 0\n", self.positions.len(), self.triangles.len());
        self.positions.iter().for_each(|[x, y, z]| text += &format!("{x} {y} {z}\n"));
        self.triangles.iter().for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
        text.into_bytes()
    }

    fn moved(&self, change: impl Fn(Vector) -> Vector) -> Mesh {
        let positions = self.positions.iter().map(|position| change(*position)).collect();
        Mesh { positions, triangles: self.triangles.clone() }
    }

    fn corners(&self) -> impl Iterator<Item = Triangle> + '_ {
        self.triangles.iter().map(|corners| corners.map(|corner| self.positions[corner]))
    }

    /// The distance of a point, by looking at all triangles.
    fn distance(&self, point: Vector) -> f64 {
        self.corners().map(|triangle| squared_distance(point, &triangle)).fold(f64::INFINITY, f64::min).sqrt()
    }

    /// Points on all triangles, in a grid of so many steps.
    fn grid(&self, steps: usize) -> Vec<Vector> {
        let weights = (0..=steps).flat_map(|i| (0..=steps - i).map(move |j| [i, j].map(|s| s as f64 / steps as f64)));
        let weights: Vec<[f64; 2]> = weights.collect();
        let on = |[a, b, c]: Triangle, [u, v]: [f64; 2]| -> Vector {
            std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * u + (c[axis] - a[axis]) * v)
        };
        self.corners().flat_map(|triangle| weights.iter().map(move |weight| on(triangle, *weight))).collect()
    }
}

/// The unit square in the plane z = 0, in 2 n² triangles.
fn square(n: usize) -> Mesh {
    let mut mesh = Mesh::default();
    for (i, j) in (0..=n).flat_map(|i| (0..=n).map(move |j| (i, j))) {
        mesh.positions.push([i as f64 / n as f64, j as f64 / n as f64, 0.0]);
    }
    for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        let [a, b] = [i, i + 1].map(|row| row * (n + 1) + j);
        mesh.triangles.extend([[a, b, b + 1], [a, b + 1, a + 1]]);
    }
    mesh
}

/// The surface of a cube of side 2 around the origin, in 12 n² triangles.
fn cube(n: usize) -> Mesh {
    let mut mesh = Mesh::default();
    for (axis, side) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
        let first = mesh.positions.len();
        let face = square(n).moved(|[x, y, _]| {
            let mut position = [side; 3];
            position[(axis + 1) % 3] = 2.0 * x - 1.0;
            position[(axis + 2) % 3] = 2.0 * y - 1.0;
            position
        });
        mesh.positions.extend(face.positions);
        mesh.triangles.extend(face.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
    }
    mesh
}

/// A sphere of radius 1, in 12 n² triangles with corners on it.
fn sphere(n: usize) -> Mesh {
    cube(n).moved(|position| position.map(|value| value / length(position, [0.0; 3])))
}

fn scratch() -> Scratch {
    Scratch::open(Arc::new(MemoryDisk::new()), Path::new("scratch"), "").unwrap().0
}

fn read(mesh: &Mesh, memory: u64) -> Result<Surface, CompareError> {
    let disk = MemoryDisk::new();
    disk.insert("mesh.off", mesh.off());
    let resources = Resources { scratch: &scratch(), memory: ByteSize(memory), threads: 1 };
    Surface::read(&disk, Path::new("mesh.off"), &resources)
}

fn compared(a: &Mesh, b: &Mesh, samples: u64, threads: usize) -> Comparison {
    let disk = MemoryDisk::new();
    disk.insert("a.off", a.off());
    disk.insert("b.off", b.off());
    let options =
        CompareOptions { samples, memory: ByteSize(64 << 20), threads, is_one_sided: false, with_colours: false };
    compare(&disk, [Path::new("a.off"), Path::new("b.off")], &options, &scratch(), &mut |_| ()).unwrap()
}

fn assert_near(value: f64, expected: f64, tolerance: f64) {
    assert!((value - expected).abs() <= tolerance, "{value} is not {expected} by {tolerance}");
}

/// Single precision, so that a file gives exactly what is computed with here.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![(-1.0_f32..1.0).prop_map(f64::from), (-2..=2).prop_map(f64::from)]
}

/// A soup, with triangles without an area, and with two corners at one place.
fn meshes() -> impl Strategy<Value = Mesh> {
    let positions = prop::collection::vec(prop::array::uniform3(coordinate()), 3..24);
    (positions, prop::collection::vec(prop::array::uniform3(0_usize..1000), 1..60), any::<bool>()).prop_map(
        |(positions, triangles, is_flat)| {
            let count = positions.len();
            let mesh =
                Mesh { positions, triangles: triangles.into_iter().map(|t| t.map(|corner| corner % count)).collect() };
            if is_flat { mesh.moved(|[x, y, _]| [x, y, 0.0]) } else { mesh }
        },
    )
}

/// What ingest leaves of a mesh: a triangle with two corners at one place is no part of the surface.
fn cleaned(mesh: &Mesh) -> Mesh {
    let place = |corner: usize| mesh.positions[corner].map(|value| value + 0.0);
    let is_kept = |[a, b, c]: &&[usize; 3]| place(*a) != place(*b) && place(*b) != place(*c) && place(*c) != place(*a);
    Mesh { positions: mesh.positions.clone(), triangles: mesh.triangles.iter().filter(is_kept).copied().collect() }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_nearest_point_is_that_of_all_triangles(
        mesh in meshes(),
        points in prop::collection::vec(prop::array::uniform3(coordinate()), 1..40),
        scale in prop_oneof![Just(1.0), Just(10.0), Just(0.0)],
    ) {
        let expected = cleaned(&mesh);
        prop_assume!(!expected.triangles.is_empty());
        let surface = read(&mesh, 64 << 20).unwrap();
        let frame = |point: Vector| -> Vector { std::array::from_fn(|axis| point[axis] - surface.origin[axis]) };
        let targets = [1 << 20, 300, 0].map(|ram_bytes| Target::new(&surface, ram_bytes).unwrap());
        let mut searchers = targets.each_ref().map(|target| Searcher::new(target, 1 << 16));
        for point in points.iter().map(|point: &Vector| point.map(|value| value * scale)) {
            let found = searchers.each_mut().map(|searcher| searcher.nearest(frame(point)).unwrap());
            let distance = expected.distance(point);
            prop_assert!((found[0].distance() - distance).abs() < 1e-13 * (1.0 + scale), "{} {}", found[0].distance(), distance);
            // The same triangle too, whatever the boxes and what was asked before.
            prop_assert_eq!(found[0], found[1]);
            prop_assert_eq!(found[0], found[2]);
            let alone = Searcher::new(&targets[0], 0).nearest(frame(point)).unwrap();
            prop_assert_eq!(found[0], alone);
        }
    }

    #[test]
    fn the_maximum_is_that_of_dense_samples(a in meshes(), b in meshes()) {
        let [clean_a, clean_b] = [&a, &b].map(cleaned);
        prop_assume!(!clean_a.triangles.is_empty() && !clean_b.triangles.is_empty());
        let found = compared(&a, &b, 1000, 2);
        let b_to_a = found.b_to_a.unwrap();
        for (side, from, to) in [(found.a_to_b, &clean_a, &clean_b), (b_to_a, &clean_b, &clean_a)] {
            let dense = from.grid(24).into_iter().map(|point| to.distance(point)).fold(0.0, f64::max);
            prop_assert!(dense <= side.max_at_most + 1e-12, "{} {:?}", dense, side);
            prop_assert!(side.max <= side.max_at_most, "{:?}", side);
            prop_assert!(side.is_max_settled && side.max_at_most <= side.max * 1.001 + 1e-8, "{:?}", side);
            // It was found where it is told to be.
            prop_assert!((to.distance(side.max_at) - side.max).abs() < 1e-12, "{:?}", side);
            prop_assert!(from.distance(side.max_at) < 1e-12, "{:?}", side);
            prop_assert!(side.mean <= side.rms + 1e-12 && side.rms <= side.max + 1e-12, "{:?}", side);
        }
        prop_assert_eq!(found.hausdorff(), Some(found.a_to_b.max.max(b_to_a.max)));
    }
}

#[test]
fn parallel_squares_are_their_distance_apart() {
    for (n, m) in [(1, 1), (1, 7), (30, 7)] {
        let found = compared(&square(n), &square(m).moved(|[x, y, _]| [x, y, 0.25]), 5000, 1);
        for side in [found.a_to_b, found.b_to_a.unwrap()] {
            for value in [side.mean, side.rms, side.max] {
                assert_near(value, 0.25, 1e-12);
            }
            assert_near(side.max_at_most, 0.25, 0.25e-3);
        }
        assert_near(found.diagonal, 2.0_f64.sqrt(), 1e-12);
        assert_eq!(found.triangles, [2 * n as u64 * n as u64, 2 * m as u64 * m as u64]);
    }
}

#[test]
fn a_sphere_in_another_of_twice_its_size() {
    let found = compared(&sphere(20), &sphere(20).moved(|position| position.map(|value| 2.0 * value)), 10_000, 2);
    let b_to_a = found.b_to_a.unwrap();
    // Corners of the larger one are 1 from those of the smaller one, and nothing is farther.
    assert_near(b_to_a.max, 1.0, 1e-6);
    assert_near(found.a_to_b.max, 1.0, 1e-2);
    for side in [found.a_to_b, b_to_a] {
        assert_near(side.mean, 1.0, 1e-2);
        assert_near(side.rms, 1.0, 1e-2);
    }
}

#[test]
fn a_cube_is_nowhere_away_from_itself() {
    for n in [1, 9] {
        let found = compared(&cube(n), &cube(1), 10_000, 1);
        for side in [found.a_to_b, found.b_to_a.unwrap()] {
            assert!(side.max < 1e-12 && side.max_at_most < 1e-8 && side.rms < 1e-12, "{side:?}");
        }
    }
}

/// Halving alone comes to no end where surfaces lie on each other and the triangles of one lie across those of the other.
#[test]
fn surfaces_that_lie_on_each_other_are_settled_however_they_are_cut() {
    let soup = Mesh {
        positions: vec![
            [0.0, 0.0, 0.0],
            [2.0, -0.675_820_469_856_262_2, 0.0],
            [2.0, -0.599_329_531_192_779_5, 0.0],
            [-1.0, 2.0, 0.0],
            [0.5, -1.0, 0.0],
        ],
        triangles: vec![[0, 1, 2], [0, 4, 3], [3, 2, 4], [1, 3, 4], [0, 2, 3]],
    };
    let turned = square(13).moved(|[x, y, z]| [0.8 * x - 0.6 * y, 0.6 * x + 0.8 * y, z]);
    let large = square(1).moved(|[x, y, z]| [9.0 * x - 4.5, 9.0 * y - 4.5, z]);
    let within = |[x, y, z]: Vector| [0.2 * x + 0.4, 0.2 * y + 0.4, z];
    for (a, b) in
        [(&soup, &large), (&turned, &large), (&soup.moved(within), &square(7)), (&turned, &turned.moved(|at| at))]
    {
        let side = compared(a, b, 1000, 1).a_to_b;
        assert!(side.max < 1e-12 && side.max_at_most < 1e-8 && side.is_max_settled, "{side:?}");
    }
    // Seven squares across five: all of them are where the others are.
    let found = compared(&square(7), &square(5), 10, 1);
    for side in [found.a_to_b, found.b_to_a.unwrap()] {
        assert!(side.max < 1e-12 && side.max_at_most < 1e-8 && side.is_max_settled, "{side:?}");
    }
}

/// Where too many triangles lie below two to be looked at one by one, the search is ended, and that is told.
#[test]
fn a_search_that_ends_early_is_told() {
    for (n, is_settled) in [(9, true), (120, false)] {
        let found = compared(&square(1).moved(|[x, y, _]| [x, y, 1e-3]), &square(n), 10, 1).a_to_b;
        assert_near(found.max, 1e-3, 1e-9);
        assert_eq!((found.is_max_settled, found.max_at_most <= 1.001e-3), (is_settled, is_settled), "{found:?}");
    }
}

/// The mean over an area needs samples that are spread by area: half of the wedge is its small steep triangles.
#[test]
fn mean_and_rms_of_a_wedge() {
    let mut wedge = square(8);
    wedge.positions.iter_mut().for_each(|[x, _, z]| *z = *x);
    let found = compared(&wedge, &square(1).moved(|[x, y, z]| [3.0 * x - 1.0, 3.0 * y - 1.0, z]), 100_000, 1);
    assert_near(found.a_to_b.mean, 0.5, 1e-3);
    assert_near(found.a_to_b.rms, (1.0_f64 / 3.0).sqrt(), 1e-3);
    assert_near(found.a_to_b.max, 1.0, 1e-12);
}

/// A flap that only one of the meshes has is seen from that one only. Its tip is a vertex; where it is cut off, nothing
/// but halving finds the place that is the farthest.
#[test]
fn the_farthest_point_may_lie_within_a_triangle() {
    // Over the middle of a large triangle, a hole in the other mesh: its middle is the farthest.
    let large = Mesh {
        positions: vec![[-10.0, -10.0, 0.0], [17.0, -10.0, 0.0], [-10.0, 17.0, 0.0]],
        triangles: vec![[0, 1, 2]],
    };
    let mut holed = square(27).moved(|[x, y, z]| [27.0 * x - 10.0, 27.0 * y - 10.0, z]);
    let is_outside = |[x, y, _]: Vector| x.abs() > 1.5 || y.abs() > 1.5;
    let positions = holed.positions.clone();
    holed.triangles.retain(|corners| corners.iter().any(|corner| is_outside(positions[*corner])));
    let found = compared(&large, &holed, 10, 1);
    let dense = large.grid(270).into_iter().map(|point| holed.distance(point)).fold(0.0, f64::max);
    assert!(dense > 0.99 && found.a_to_b.max >= dense * 0.999, "{dense} {found:?}");
    assert!(found.a_to_b.max_at_most >= dense && found.a_to_b.max_at_most <= 1.001 * found.a_to_b.max, "{found:?}");
}

#[test]
fn triangles_without_area_are_measured_along_their_sides() {
    let line = |height: f64| Mesh {
        positions: vec![[0.0, 0.0, height], [1.0, 0.0, height], [4.0, 0.0, height]],
        triangles: vec![[0, 1, 2]],
    };
    let found = compared(&line(0.0), &line(2.0).moved(|[x, y, z]| [0.5 * x, y, z]), 1000, 1);
    assert_near(found.a_to_b.max, 8.0_f64.sqrt(), 1e-12);
    assert_near(found.b_to_a.unwrap().mean, 2.0, 1e-12);
    // Half of it is 2 away, the other half up to √8.
    assert!(found.a_to_b.mean > 2.1 && found.a_to_b.mean < 2.3, "{found:?}");
}

#[test]
fn meshes_with_different_origins_are_in_one_frame() {
    let far = |mesh: &Mesh, height: f64| mesh.moved(|[x, y, z]| [x + 4_200_000.0, y - 7_300_000.0, z + height]);
    let found = compared(&far(&square(3), 0.125), &far(&square(5), 1000.0), 1000, 1);
    assert_near(found.a_to_b.mean, 999.875, 1e-9);
    assert_near(found.a_to_b.max, 999.875, 1e-9);
    let at = found.a_to_b.max_at;
    assert!(at[0] >= 4_200_000.0 && at[1] <= -7_299_999.0 && at[2] == 0.125, "{at:?}");
}

/// Neither the memory nor the threads change a bit: everything in RAM, and both surfaces on disk below long runs.
#[test]
fn memory_and_threads_change_nothing() {
    let (a, b) = (sphere(51), sphere(50).moved(|[x, y, z]| [1.01 * x, y + 0.01 * (9.0 * z).sin(), z]));
    let mut found = Vec::new();
    for (memory, boxes, threads) in [(256 << 20, 64 << 20, 1), (256 << 20, 64 << 20, 3), (4_300_000, 100_000, 2)] {
        let [a, b] = [&a, &b].map(|mesh| read(mesh, memory).unwrap());
        let is_on_disk = [&a, &b].map(|surface| matches!(surface.triangles, records::Records::Disk(_)));
        assert_eq!(is_on_disk, [memory < 64 << 20; 2]);
        let effort = Effort { samples: 5000, threads, cache_bytes: 100_000 };
        let sides = [(&a, &b), (&b, &a)].map(|(from, to)| {
            let target = Target::new(to, boxes).unwrap();
            one_sided(from, &target, effort, &mut |_| ()).unwrap()
        });
        found.push(sides);
    }
    assert_eq!(found[0], found[1]);
    assert_eq!(found[0], found[2]);
}

#[test]
fn what_cannot_be_compared_is_refused() {
    let disk = MemoryDisk::new();
    disk.insert("square.off", square(2).off());
    disk.insert("empty.off", Mesh::default().off());
    let segment = Mesh { positions: vec![[0.0; 3], [1.0; 3]], triangles: vec![[0, 1, 1]] };
    disk.insert("segment.off", segment.off());
    let message = |a: &str, b: &str, memory: u64| {
        let options = CompareOptions {
            samples: 10,
            memory: ByteSize(memory),
            threads: 1,
            is_one_sided: true,
            with_colours: true,
        };
        let outcome = compare(&disk, [Path::new(a), Path::new(b)], &options, &scratch(), &mut |_| ());
        outcome.err().map(|error| error.to_string())
    };
    for name in ["empty.off", "segment.off"] {
        let refused = message("square.off", name, 64 << 20).unwrap();
        assert!(refused.contains(name) && refused.contains("no surface"), "{refused}");
    }
    assert!(message("missing.off", "square.off", 64 << 20).unwrap().contains("missing.off"));
    assert!(message("square.off", "square.off", 1 << 20).unwrap().contains("--memory 16M"));
    assert_eq!(message("square.off", "square.off", 16 << 20), None);
}

/// A disk that fails at any time gives an error, and nothing else.
#[test]
fn a_disk_that_fails_is_told() {
    let memory = MemoryDisk::new();
    memory.insert("sphere.off", sphere(60).off());
    let disk = FaultyDisk::new(Arc::new(memory));
    let mut failures = 0;
    for reads in [0, 1, 3, 10, u64::MAX] {
        disk.fail_reads_after(u64::MAX);
        let (scratch, _) = Scratch::open(Arc::new(disk.clone()), Path::new("scratch"), "").unwrap();
        disk.fail_reads_after(reads);
        let resources = Resources { scratch: &scratch, memory: ByteSize(6 << 20), threads: 1 };
        let outcome = Surface::read(&disk, Path::new("sphere.off"), &resources).and_then(|surface| {
            let target = Target::new(&surface, 100_000)?;
            let effort = Effort { samples: 5000, threads: 2, cache_bytes: 50_000 };
            Ok(one_sided(&surface, &target, effort, &mut |_| ())?)
        });
        failures += usize::from(outcome.is_err());
        assert_eq!(outcome.is_ok(), reads == u64::MAX, "{reads} reads: {outcome:?}");
    }
    assert_eq!(failures, 4);
}

/// A mesh with wedges, as ingest would make it: one wedge for each vertex, but those of seams.
fn painted(mesh: &Mesh, appearance: &Appearance, wedges: impl Fn(Vector) -> Vec<Wedge>, memory: u64) -> Surface {
    let corners = mesh.triangles.iter().map(|corners| {
        // The wedge of a corner is the one with the material of the triangle.
        let first = |corner: usize| wedges(mesh.positions[corner])[0].material;
        let material = corners.map(first).into_iter().max().unwrap_or(0);
        CornerPlaces::of(corners.map(|corner| {
            let place = wedges(mesh.positions[corner]).iter().position(|wedge| wedge.material == material);
            place.unwrap_or(0) as u32
        }))
    });
    let core = CoreMesh {
        positions: mesh.positions.iter().map(|position| position.map(|value| value as f32)).collect(),
        triangles: mesh.triangles.iter().map(|corners| corners.map(|corner| corner as u32)).collect(),
        attributes: Some(CoreAttributes {
            appearance: appearance.clone(),
            wedges: mesh.positions.iter().map(|position| wedges(*position)).collect(),
            corners: corners.collect(),
        }),
        ..CoreMesh::default()
    };
    let counts = FileCounts { vertices: mesh.positions.len() as u64, triangles: mesh.triangles.len() as u64 };
    Surface::of(StoredMesh::from_core(core, counts), &scratch(), ByteSize(memory)).unwrap()
}

fn coloured() -> Appearance {
    Appearance { kinds: AttributeKinds { colours: true, ..AttributeKinds::default() }, ..Appearance::default() }
}

fn colours_of(a: Surface, b: Surface, threads: usize) -> Comparison {
    let options =
        CompareOptions { samples: 3000, memory: ByteSize(64 << 20), threads, is_one_sided: false, with_colours: true };
    compare_surfaces(&MemoryDisk::new(), [a, b], &options, &mut |_| ()).unwrap()
}

fn grey([red, green, blue]: [u8; 3]) -> impl Fn(Vector) -> Vec<Wedge> {
    move |_| vec![Wedge { colour: [red, green, blue, 255], ..Wedge::PLAIN }]
}

#[test]
fn colours_that_are_the_same_everywhere_are_their_difference_apart() {
    let (a, b) = (square(3), square(4).moved(|[x, y, _]| [x, y, 0.5]));
    let [a, b] = [(a, [100, 100, 100]), (b, [110, 90, 130])]
        .map(|(mesh, colour)| painted(&mesh, &coloured(), grey(colour), 64 << 20));
    let found = colours_of(a, b, 1);
    assert_eq!(found.have_colours, [true; 2]);
    for side in [found.a_to_b, found.b_to_a.unwrap()] {
        let colours = side.colours.unwrap();
        for value in [colours.mean, colours.rms, colours.max] {
            assert_near(value, 50.0 / 3.0 / 255.0, 1e-12);
        }
        assert_near(side.mean, 0.5, 1e-12);
    }
}

/// A colour that grows evenly is the same however the surface is cut; one that is turned is not.
#[test]
fn colours_are_interpolated_over_triangles() {
    let across = |[x, ..]: Vector| vec![Wedge { colour: [(x * 240.0).round() as u8, 0, 0, 255], ..Wedge::PLAIN }];
    let along = |[_, y, _]: Vector| vec![Wedge { colour: [(y * 240.0).round() as u8, 0, 0, 255], ..Wedge::PLAIN }];
    let surface = |n: usize, memory| painted(&square(n), &coloured(), across, memory);
    let found = colours_of(surface(5, 64 << 20), surface(3, 64 << 20), 1);
    for side in [found.a_to_b, found.b_to_a.unwrap()] {
        let colours = side.colours.unwrap();
        // A third is no number of single precision.
        assert!(colours.max < 1e-8, "{colours:?}");
    }
    let found = colours_of(surface(5, 64 << 20), painted(&square(3), &coloured(), along, 64 << 20), 1);
    let colours = found.a_to_b.colours.unwrap();
    // |x - y| has a mean of 1/3 and a mean square of 1/6 over the square.
    assert_near(colours.mean, 240.0 / 255.0 / 9.0, 1e-3);
    assert_near(colours.rms, 240.0 / 255.0 / 3.0 / 6.0_f64.sqrt(), 1e-3);
    assert!(colours.max > 0.27 && colours.max < 240.0 / 255.0 / 3.0, "{colours:?}");
}

/// Half of the surface is of one material, half of the other; the vertices between them have a wedge of each.
#[test]
fn seams_and_materials_and_textures() {
    let mut bytes = std::io::Cursor::new(Vec::new());
    // Black on the left, white on the right.
    let image = image::RgbImage::from_fn(2, 1, |x, _| image::Rgb([x as u8 * 255; 3]));
    image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    let material = |base_colour, image| Material { name: String::new(), base_colour, image };
    let appearance = Appearance {
        kinds: AttributeKinds { textures: true, materials: true, ..AttributeKinds::default() },
        texture_exponent: -2,
        materials: vec![material(Some([1.0, 0.0, 0.0, 1.0]), None), material(None, Some(0))],
        images: vec![Image { name: "a.png".into(), source: ImageSource::Bytes(bytes.into_inner()) }],
    };
    // The texture of the second half is white where v does not matter and u is 3/4.
    let wedge = |material: u32| Wedge { material, texture: [3, 1], ..Wedge::PLAIN };
    let halves = move |[x, ..]: Vector| {
        let materials = if x < 0.5 {
            vec![1]
        } else if x > 0.5 {
            vec![2]
        } else {
            vec![1, 2]
        };
        materials.into_iter().map(wedge).collect()
    };
    for memory in [64 << 20, 0] {
        let a = painted(&square(8), &appearance, halves, memory);
        assert_eq!(matches!(a.looks.as_ref().unwrap().records, records::Records::Disk(_)), memory == 0);
        let b = painted(&square(3), &coloured(), grey([255, 255, 255]), memory);
        let found = colours_of(a, b, 2);
        assert!(found.colour_notes.is_empty());
        for side in [found.a_to_b, found.b_to_a.unwrap()] {
            let colours = side.colours.unwrap();
            // Red is two thirds of the range away from white.
            assert_near(colours.mean, 1.0 / 3.0, 1e-3);
            assert_near(colours.max, 2.0 / 3.0, 1e-12);
        }
    }
}

#[test]
fn colours_of_one_mesh_alone_are_not_compared() {
    let plain = || read(&square(2), 64 << 20).unwrap();
    let with = || painted(&square(2), &coloured(), grey([1, 2, 3]), 64 << 20);
    let normals = Appearance { kinds: AttributeKinds { normals: true, ..Default::default() }, ..Default::default() };
    let bare = || painted(&square(2), &normals, grey([1, 2, 3]), 64 << 20);
    for (a, b, have) in
        [(plain(), with(), [false, true]), (with(), bare(), [true, false]), (plain(), bare(), [false; 2])]
    {
        let found = colours_of(a, b, 1);
        assert_eq!(found.have_colours, have);
        assert!(found.a_to_b.colours.is_none() && found.b_to_a.unwrap().colours.is_none());
    }
}

/// Looks in RAM or on disk, one thread or several: the same bits.
#[test]
fn memory_and_threads_change_no_colour() {
    let waves = |[x, y, _]: Vector| {
        let channel = |value: f64| (127.5 + 127.0 * value.sin()) as u8;
        vec![Wedge { colour: [channel(9.0 * x), channel(7.0 * y), channel(5.0 * x * y), 255], ..Wedge::PLAIN }]
    };
    let mut all = Vec::new();
    for (memory, threads) in [(64 << 20, 1), (64 << 20, 3), (100_000, 2)] {
        let a = painted(&sphere(20), &coloured(), waves, memory);
        let b = painted(&sphere(17), &coloured(), waves, memory);
        assert_eq!(matches!(a.looks.as_ref().unwrap().records, records::Records::Disk(_)), memory < 1 << 20);
        all.push(colours_of(a, b, threads));
    }
    let colours = all[0].a_to_b.colours.unwrap();
    assert!(colours.mean > 1e-4 && colours.mean < 0.05 && colours.mean < colours.rms, "{colours:?}");
    assert_eq!(all[0], all[1]);
    assert_eq!(all[0], all[2]);
}
