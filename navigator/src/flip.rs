//! Which drawn triangles may be turned round against the triangles of the input that they stand for (design, 5: `flip`).
//!
//! A drawn triangle is *flipped* where its normal is more than 90 degrees from that of its input triangle. The latter is not in
//! the model file: only what follows from it is there. So there are two questions.
//!
//! *Is it certainly not flipped?* The normal cone of each inner node holds the normals of all input triangles at the leaves
//! under it, so that of this one, too, at each of the three corners. Where a drawn normal and a cone's axis are, with the cone's
//! half-angle, less than 90 degrees apart, the triangle is not flipped: that is proven, whatever the rounding of cones in the
//! file, which only opens them. The cones of closed parts that are oriented inward are turned round in the file; no triangle is
//! then proven by them. Where the three corners are leaves, the triangle is that of the input.
//!
//! *Does it look flipped?* Parts without an inside, as all terrain, have no cones, and at coarse levels cones reach 90 degrees.
//! There a triangle is taken for flipped where it points away from the normal of any of the vertices that it is drawn at, each of
//! which is a mean of input normals near by. That is an estimate, and errs in both directions.
//!
//! A triangle is *suspect* where the answers are no and yes. What it means for what is drawn is measured by `vdt bench
//! dependency`. To call suspect all that is not proven would leave no triangle flipped, but is of no use: a model without cones
//! would have to be drawn with all its triangles, always; and on folded surfaces (a brain) more than 8000 splits would be
//! forced by a first wish.
//!
//! A split may make suspect the triangles that it moves or bears. It does not do so for others: they have the same vertices, and
//! a narrower cone at the child that is kept. A collapse may make suspect all triangles around both children, since the cone of the
//! parent is wider.

use metanode::page::{Normal, NormalCone};

use crate::front::{Entry, Front};

/// Steps in which the sines of half-angles are stored.
const SINE_STEPS: f64 = 254.0;
/// More than what rounding makes of squares.
const ROUNDING: f64 = 1e-9;

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// The normal of a triangle with corners at these places, twice as long as its area.
fn normal_of(positions: [[f32; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = positions.map(|position| position.map(f64::from));
    let [u, v] = [b, c].map(|to| [to[0] - a[0], to[1] - a[1], to[2] - a[2]]);
    [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
}

/// Whether all directions in a cone are less than 90 degrees from a normal with this square of its length.
fn is_proven_by(cone: NormalCone, normal: [f64; 3], square: f64) -> bool {
    let axis = cone.axis.map(f64::from);
    let (along, sine) = (dot(axis, normal), f64::from(cone.sine) / SINE_STEPS);
    cone.sine != u8::MAX && along > 0.0 && along * along > sine * sine * square * dot(axis, axis) * (1.0 + ROUNDING)
}

/// The normal of a triangle that points away from the normal of any vertex that it is drawn at. Those stand at the positions.
#[inline]
fn normal_if_flipped(corners: [[f32; 4]; 3]) -> Option<[f64; 3]> {
    let normal = normal_of(corners.map(|[x, y, z, _]| [x, y, z]));
    let points_away =
        |[.., word]: [f32; 4]| dot(Normal::from_word(word.to_bits()).steps().map(f64::from), normal) < 0.0;
    corners.into_iter().any(points_away).then_some(normal)
}

/// Whether a triangle with these corners, at vertices or leaves, is suspect, see the module. One without an area never is. The cones of
/// the nodes, none of a leaf, are seldom asked for.
#[inline]
fn is_suspect(corners: [[f32; 4]; 3], cones: impl FnOnce() -> [Option<NormalCone>; 3]) -> bool {
    normal_if_flipped(corners).is_some_and(|normal| {
        let cones = cones();
        cones.iter().any(Option::is_some) && !is_proven(cones, normal)
    })
}

/// Whether any cone proves that a triangle with this normal is not flipped.
fn is_proven(cones: [Option<NormalCone>; 3], normal: [f64; 3]) -> bool {
    let square = dot(normal, normal);
    cones.into_iter().flatten().any(|cone| is_proven_by(cone, normal, square))
}

/// Where a vertex stands, with its normal.
fn corner_at(front: &Front, vertex: u32) -> [f32; 4] {
    front.positions()[vertex as usize]
}

/// The cone of the active node at a vertex; none of a leaf.
fn cone_at(front: &Front, vertex: u32) -> Option<NormalCone> {
    (!front.is_leaf(vertex)).then(|| front.sphere(vertex).cone)
}

/// Whether an active triangle is suspect.
pub fn triangle_is_suspect(front: &Front, triangle: u32) -> bool {
    let vertices = front.corners()[triangle as usize];
    is_suspect(vertices.map(|vertex| corner_at(front, vertex)), || vertices.map(|vertex| cone_at(front, vertex)))
}

/// The vertex that is split for a triangle to be repaired: the one with the largest error. None where all corners are leaves.
pub fn vertex_to_split(front: &Front, triangle: u32) -> Option<u32> {
    let corners = front.corners()[triangle as usize].into_iter().filter(|vertex| !front.is_leaf(*vertex));
    corners.max_by(|a, b| front.sphere(*a).switch.total_cmp(&front.sphere(*b).switch))
}

/// The suspect triangles that have a corner at one of these vertices, each once.
pub fn suspects_at(front: &Front, [first, second]: [u32; 2]) -> impl Iterator<Item = u32> + '_ {
    let at_second = front.star(second).filter(move |entry| !front.others(*entry).contains(&first));
    let around = front.star(first).chain(at_second).map(Entry::triangle);
    around.filter(|triangle| triangle_is_suspect(front, *triangle))
}

/// Whether to undo the split that bore `born` would make a triangle suspect that is not.
pub fn collapse_is_blocked(front: &Front, born: u32) -> bool {
    let kept = front.kept(born);
    let parent = corner_at(front, kept);
    // Triangles with corners at both go.
    let blocks = |entry: Entry, other: u32| {
        let others = front.others(entry);
        let [second, third] = others.map(|vertex| corner_at(front, vertex));
        let cones = || {
            let [second, third] = others.map(|vertex| cone_at(front, vertex));
            [Some(front.sphere_above(born).cone), second, third]
        };
        !others.contains(&other)
            && is_suspect([parent, second, third], cones)
            && !triangle_is_suspect(front, entry.triangle())
    };
    front.star(born).any(|entry| blocks(entry, kept)) || front.star(kept).any(|entry| blocks(entry, born))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Whether an active triangle is proven not to be flipped by the cone at any of its corners.
    pub(crate) fn triangle_is_proven(front: &Front, triangle: u32) -> bool {
        let vertices = front.corners()[triangle as usize];
        let normal = normal_of(vertices.map(|vertex| front.sphere(vertex).position));
        is_proven(vertices.map(|vertex| cone_at(front, vertex)), normal)
    }

    /// Whether the drawn triangle is flipped, where the input triangle has its corners at `original`.
    pub(crate) fn is_flipped(drawn: [[f32; 3]; 3], original: [[f32; 3]; 3]) -> bool {
        dot(normal_of(drawn), normal_of(original)) < 0.0
    }

    const UP: NormalCone = NormalCone { axis: [0, 0, 127], sine: 127 };

    fn corners(height: f32, normals: [Normal; 3]) -> [[f32; 4]; 3] {
        let [a, b, c] = normals.map(|normal| f32::from_bits(normal.to_word()));
        [[0.0, 0.0, 0.0, a], [1.0, 0.0, 0.0, b], [0.0, 1.0, height, c]]
    }

    #[test]
    fn what_faces_the_other_way_is_suspect() {
        let [a, b, c] = corners(0.0, [Normal::UP; 3]);
        for cone in [UP, NormalCone::EVERYTHING] {
            assert!(!is_suspect([a, b, c], || [Some(cone); 3]));
            assert!(is_suspect([a, c, b], || [Some(cone); 3]));
        }
        assert!(!is_suspect([a, c, b], || [None; 3]), "what is drawn as in the input is never suspect");
        assert!(!is_suspect([a, c, c], || [Some(UP); 3]), "without an area");
    }

    /// A cone of 30 degrees proves up to 60, whatever a vertex normal says.
    #[test]
    fn what_a_cone_proves_is_not_suspect() {
        let down = Normal::encode([0.0, 0.0, -1.0]);
        let doubted =
            |height: f32, cone| is_suspect(corners(height, [Normal::UP, down, Normal::UP]), || [Some(cone); 3]);
        let at = |degrees: f32| degrees.to_radians().tan();
        assert!(!doubted(at(0.0), UP) && !doubted(at(59.0), UP) && !doubted(at(-59.0), UP));
        assert!(doubted(at(61.0), UP) && doubted(at(-61.0), UP));
        assert!(doubted(at(0.0), NormalCone::EVERYTHING));
    }
}
