//! Pictures of small meshes, point by point against rays.

use glam::Vec3;
use proptest::prelude::*;

use super::*;

/// An eye in the origin that looks along x, with z upwards, and sees a right angle from side to side.
fn projection(width: u32, height: u32) -> Projection {
    let fov_degrees = 2.0 * (f64::from(height) / f64::from(width)).atan().to_degrees();
    let camera = navigator::Camera { eye: DVec3::ZERO, target: DVec3::X, up: DVec3::Z, fov_degrees };
    Projection::new(&camera, [0.0; 3], 2.0, width, height).unwrap()
}

fn vertex(position: Vec3) -> [f32; 4] {
    let Vec3 { x, y, z } = position;
    [x, y, z, f32::from_bits(Normal::UP.to_word())]
}

fn drawn(width: u32, height: u32, positions: &[Vec3], triangles: &[[u32; 3]]) -> Picture {
    let vertices: Vec<_> = positions.iter().map(|position| vertex(*position)).collect();
    let mut picture = Picture::new(width, height);
    let buffers = Buffers { vertices: &vertices, morphs: &[], triangles };
    draw(&mut picture, &projection(width, height), buffers, Style::default());
    picture
}

fn points_drawn(picture: &Picture) -> usize {
    picture.distances().filter(|distance| distance.is_finite()).count()
}

/// The distance along x of the first triangle that the ray through the middle of a point meets, and whether it passes clear of all
/// sides.
fn ray(width: u32, height: u32, point: (u32, u32), positions: &[Vec3], triangles: &[[u32; 3]]) -> (f64, bool) {
    let y = 1.0 - 2.0 * (f64::from(point.0) + 0.5) / f64::from(width);
    let z = (1.0 - 2.0 * (f64::from(point.1) + 0.5) / f64::from(height)) * f64::from(height) / f64::from(width);
    let direction = DVec3::new(1.0, y, z);
    let (mut nearest, mut is_clear) = (f64::INFINITY, true);
    for triangle in triangles {
        let [a, b, c] = triangle.map(|corner| positions[corner as usize].as_dvec3());
        // Volumes of the ray with each side: their signs say whether it passes, their sizes how clearly.
        let sides = [(a, b), (b, c), (c, a)].map(|(from, to)| direction.dot(from.cross(to)));
        let whole = a.dot(b.cross(c));
        let scale = direction.length() * (a.cross(b).length() + b.cross(c).length() + c.cross(a).length());
        is_clear &= sides.iter().all(|side| side.abs() > 1e-2 * scale);
        let sum: f64 = sides.iter().sum();
        let inside = sides.iter().all(|side| *side > 0.0) || sides.iter().all(|side| *side < 0.0);
        let distance = whole / sum;
        if inside && distance > 0.0 {
            nearest = nearest.min(distance);
        }
    }
    (nearest, is_clear)
}

fn places() -> impl Strategy<Value = Vec<Vec3>> {
    prop::collection::vec(prop::array::uniform3(-3.0_f32..3.0).prop_map(Vec3::from_array), 3..15)
}

proptest! {
    /// Triangles anywhere about the eye, some of them behind it: what is seen is what rays meet.
    #[test]
    fn what_is_drawn_is_what_rays_meet(positions in places()) {
        let triangles: Vec<[u32; 3]> = (0..positions.len() as u32 / 3).map(|at| [3 * at, 3 * at + 1, 3 * at + 2]).collect();
        let (width, height) = (40, 30);
        let picture = drawn(width, height, &positions, &triangles);
        for (at, distance) in (0..).zip(picture.distances()) {
            let (expected, is_clear) = ray(width, height, (at % width, at / width), &positions, &triangles);
            if is_clear {
                let distance = f64::from(distance);
                let is_met = expected == distance || (expected - distance).abs() < 0.05 * expected;
                prop_assert!(is_met, "point {at}: {distance}, not {expected}");
            }
        }
    }

    /// Around each inner vertex of a plane, and along each side, every point is drawn by one triangle and by no other.
    #[test]
    fn sides_belong_to_one_triangle(
        ring in prop::collection::vec(0.05_f64..1.0, 3..12),
        radius in 0.1_f32..2.0,
        // Corners at middles of points, too, where all is decided by rules.
        is_on_grid in any::<bool>(),
    ) {
        let (width, height) = (64, 64);
        let turn: f64 = ring.iter().sum();
        let mut angle = 0.0;
        let mut positions = vec![Vec3::X];
        for step in &ring {
            angle += step / turn * std::f64::consts::TAU;
            let (sine, cosine) = (angle as f32).sin_cos();
            let place = |along: f32| if is_on_grid { ((radius * along * 32.0).round() + 0.5) / 32.0 } else { radius * along };
            positions.push(Vec3::new(1.0, place(cosine), place(sine)));
        }
        let count = ring.len() as u32;
        let fan: Vec<[u32; 3]> = (1..=count).map(|at| [0, at, at % count + 1]).collect();
        let apart: usize = fan.iter().map(|triangle| points_drawn(&drawn(width, height, &positions, &[*triangle]))).sum();
        let together = points_drawn(&drawn(width, height, &positions, &fan));
        // A fan whose steps are less than half a turn covers nothing twice.
        prop_assume!(ring.iter().all(|step| step / turn < 0.45));
        prop_assume!(!is_on_grid || radius > 0.5);
        prop_assert_eq!(apart, together);
        prop_assert!(together > 0 || radius < 0.3);
    }
}

/// From inside of a box there is nothing but the box, wherever the eye looks through its corners and sides.
#[test]
fn from_inside_there_is_no_hole() {
    let corner =
        |at: usize| Vec3::new(((at & 1) as f32) - 0.3, ((at >> 1 & 1) as f32) - 0.6, ((at >> 2) as f32) - 0.45);
    let positions: Vec<Vec3> = (0..8).map(corner).collect();
    let squares = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> = squares.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    let picture = drawn(97, 61, &positions, &triangles);
    assert_eq!(points_drawn(&picture), 97 * 61);
}

#[test]
fn vertices_on_their_way_are_drawn_there() {
    let vertices = [Vec3::new(2.0, -0.5, -0.5), Vec3::new(2.0, 0.5, -0.5), Vec3::new(4.0, 0.0, 4.0)].map(vertex);
    let morphs = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0], [2.0, 0.0, -0.5, 0.0]];
    let points = |morphs: &[[f32; 4]]| {
        let mut picture = Picture::new(64, 64);
        let buffers = Buffers { vertices: &vertices, morphs, triangles: &[[0, 1, 2]] };
        draw(&mut picture, &projection(64, 64), buffers, Style::default());
        points_drawn(&picture)
    };
    assert!(points(&[]) > 100 && points(&morphs) == 0);
}

#[test]
fn sides_are_seen_where_that_is_asked_for() {
    let vertices = [Vec3::new(2.0, 1.0, -1.0), Vec3::new(2.0, -1.0, -1.0), Vec3::new(2.0, 0.0, 1.0)].map(vertex);
    let colours = |edges: bool| {
        let mut picture = Picture::new(64, 64);
        let buffers = Buffers { vertices: &vertices, morphs: &[], triangles: &[[0, 1, 2]] };
        draw(&mut picture, &projection(64, 64), buffers, Style { edges, ..Style::default() });
        let mut colours = picture.colours().to_vec();
        picture.clear();
        assert!(picture == Picture::new(64, 64));
        colours.sort_unstable();
        colours.dedup();
        colours.len()
    };
    assert_eq!((colours(false), colours(true)), (2, 3));
}

/// A square from one middle of a point to another, of four triangles around a middle: all sides go through middles, and each of
/// these is drawn, but for those below and to the right of the square.
#[test]
fn no_point_on_a_side_is_left_out() {
    for (first, size) in [(10, 20), (7, 2), (0, 62)] {
        let at = |point: i32| 1.0 - 2.0 * (point as f32 + 0.5) / 64.0;
        let (begin, middle, end) = (at(first), at(first + size / 2), at(first + size));
        let corners = [(middle, middle), (begin, begin), (begin, end), (end, end), (end, begin)];
        let positions = corners.map(|(y, z)| Vec3::new(1.0, y, z));
        let picture = drawn(64, 64, &positions, &[[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]]);
        assert_eq!(points_drawn(&picture), (size * size) as usize);
    }
}
