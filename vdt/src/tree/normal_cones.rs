//! Nested normal cones, for telling that a whole part of the surface faces away from the eye.
//!
//! Only a closed, consistently oriented component has an inside that hides its back: where a component has a boundary, a
//! non-manifold edge or no volume, its cones hold everything. A component that is oriented inward (its volume is
//! negative) has its cones turned round.
//!
//! A leaf's cone holds the normals of the triangles at it in the input; an inner node's is the smallest cone about its
//! children's two, up to the steps in which cones are stored. Angles are added and halved through their sines and
//! cosines, with +, -, *, / and square roots only, so that every machine gets the same bytes.

use crate::vector::{Vector, cross, dot, minus, unit};

use super::finish::NodePlace;
use super::record::{NormalCone, Root, Split, Tree};

/// Steps in which the sine of a half-angle is stored.
const SINE_STEPS: f64 = 254.0;
/// Steps in which an axis is stored.
const AXIS_STEPS: f64 = 127.0;

/// Fills the cones of all splits. `nodes` in build order; `regular[leaf]`: all edges at the leaf are inner edges of an
/// oriented manifold.
pub(super) fn fill(tree: &mut Tree, nodes: &[NodePlace], regular: &[bool]) {
    let leaf_cones = leaf_cones(tree, regular);
    for NodePlace { first, born } in nodes {
        let Split { kept: kept_split, born: born_split, .. } = tree.splits[*born as usize];
        let cone_of = |split: u32, leaf: u32| {
            tree.splits.get(split as usize).map_or(leaf_cones[leaf as usize], |split| split.cone)
        };
        let cone = smallest_around(cone_of(kept_split, *first), cone_of(born_split, *born));
        tree.splits[*born as usize].cone = cone;
    }
}

/// Which way is out: 1 or -1 times the orientation of the triangles, or nothing where the tree's surface has no inside.
fn outward(tree: &Tree, root: &Root, regular: &[bool]) -> Option<f64> {
    if !regular[root.start as usize..root.end as usize].iter().all(|regular| *regular) {
        return None;
    }
    let reference = tree.positions[root.start as usize].map(f64::from);
    let mut volume = 0.0;
    for corners in triangles_of(tree, root) {
        let [a, b, c] = corners.map(|leaf| minus(tree.positions[leaf as usize].map(f64::from), reference));
        volume += dot(a, cross(b, c));
    }
    (volume != 0.0).then(|| volume.signum())
}

fn triangles_of<'a>(tree: &'a Tree, root: &Root) -> &'a [[u32; 3]] {
    let offsets = &tree.triangles.offsets;
    &tree.triangles.corners[offsets[root.start as usize] as usize..offsets[root.end as usize] as usize]
}

/// The normal of a triangle, twice as long as its area is large.
fn normal_of(tree: &Tree, corners: [u32; 3]) -> Vector {
    let [a, b, c] = corners.map(|leaf| tree.positions[leaf as usize].map(f64::from));
    cross(minus(b, a), minus(c, a))
}

fn leaf_cones(tree: &Tree, regular: &[bool]) -> Vec<NormalCone> {
    let mut cones = vec![NormalCone::EVERYTHING; tree.leaf_count()];
    let mut sums: Vec<Vector> = Vec::new();
    let mut least_cosines: Vec<f64> = Vec::new();
    for root in &tree.roots {
        let Some(sign) = outward(tree, root, regular) else { continue };
        let leaves = (root.end - root.start) as usize;
        let local = |leaf: u32| (leaf - root.start) as usize;
        sums.clear();
        sums.resize(leaves, [0.0; 3]);
        for corners in triangles_of(tree, root) {
            let normal = normal_of(tree, *corners);
            for corner in corners {
                let sum = &mut sums[local(*corner)];
                *sum = [sum[0] + sign * normal[0], sum[1] + sign * normal[1], sum[2] + sign * normal[2]];
            }
        }
        // From here on the axes as they are stored, of unit length.
        for (sum, cone) in sums.iter_mut().zip(&mut cones[root.start as usize..]) {
            cone.axis = stored_axis(*sum);
            *sum = unit(cone.axis.map(f64::from));
        }
        least_cosines.clear();
        least_cosines.resize(leaves, 1.0);
        for corners in triangles_of(tree, root) {
            let normal = unit(normal_of(tree, *corners));
            if normal == [0.0; 3] {
                continue;
            }
            for corner in corners {
                let least = &mut least_cosines[local(*corner)];
                *least = least.min(sign * dot(sums[local(*corner)], normal));
            }
        }
        for (least, cone) in least_cosines.iter().zip(&mut cones[root.start as usize..]) {
            let sine = (1.0 - least * least).max(0.0).sqrt();
            *cone = stored(cone.axis, *least, sine);
        }
    }
    cones
}

/// The smallest cone, as cones are stored, about two cones.
fn smallest_around(a: NormalCone, b: NormalCone) -> NormalCone {
    if a.sine == u8::MAX || b.sine == u8::MAX {
        return NormalCone::EVERYTHING;
    }
    let axes = [a, b].map(|cone| unit(cone.axis.map(f64::from)));
    let sines = [a, b].map(|cone| f64::from(cone.sine) / SINE_STEPS);
    let cosines = sines.map(|sine| (1.0 - sine * sine).max(0.0).sqrt());
    let axis = axis_between(axes, sines, cosines);
    let axis_unit = unit(axis.map(f64::from));
    // Both cones as seen from the stored axis; the wider one decides.
    let (mut cosine, mut sine) = (1.0_f64, 0.0_f64);
    for index in 0..2 {
        let (between_cosine, between_sine) = angle(axis_unit, axes[index]);
        let sum_cosine = between_cosine * cosines[index] - between_sine * sines[index];
        let sum_sine = between_sine * cosines[index] + between_cosine * sines[index];
        if sum_cosine <= 0.0 || sum_sine < 0.0 {
            return NormalCone::EVERYTHING;
        }
        if sum_cosine < cosine {
            (cosine, sine) = (sum_cosine, sum_sine);
        }
    }
    stored(axis, cosine, sine)
}

/// The axis of the smallest cone about two cones. With d the angle between their axes and h their half-angles, it lies
/// (d + h1 - h0) / 2 from the first axis towards the second, unless one cone holds the other.
fn axis_between(axes: [Vector; 2], sines: [f64; 2], cosines: [f64; 2]) -> [i8; 3] {
    let (between_cosine, between_sine) = angle(axes[0], axes[1]);
    let difference_cosine = cosines[1] * cosines[0] + sines[1] * sines[0];
    let difference_sine = sines[1] * cosines[0] - cosines[1] * sines[0];
    // d + (h1 - h0), and d - (h1 - h0).
    let towards_second = between_sine * difference_cosine + between_cosine * difference_sine;
    let towards_first = between_sine * difference_cosine - between_cosine * difference_sine;
    if between_sine == 0.0 || towards_second <= 0.0 {
        return stored_axis(axes[0]);
    }
    if towards_first <= 0.0 {
        return stored_axis(axes[1]);
    }
    let cosine = between_cosine * difference_cosine - between_sine * difference_sine;
    let half_cosine = ((1.0 + cosine) * 0.5).max(0.0).sqrt();
    let half_sine = ((1.0 - cosine) * 0.5).max(0.0).sqrt();
    let sideways: Vector = std::array::from_fn(|axis| (axes[1][axis] - axes[0][axis] * between_cosine) / between_sine);
    stored_axis(std::array::from_fn(|axis| axes[0][axis] * half_cosine + sideways[axis] * half_sine))
}

/// A cone with this axis and half-angle, rounded up to a step.
fn stored(axis: [i8; 3], cosine: f64, sine: f64) -> NormalCone {
    // A little more, for the rounding of the sine itself.
    let steps = (sine * SINE_STEPS + 1e-6).ceil();
    if cosine <= 0.0 || steps > SINE_STEPS || axis == [0; 3] {
        NormalCone::EVERYTHING
    } else {
        NormalCone { axis, sine: steps as u8 }
    }
}

/// The nearest axis that can be stored; zero for a vector without a direction.
fn stored_axis(direction: Vector) -> [i8; 3] {
    unit(direction).map(|component| (component * AXIS_STEPS).round() as i8)
}

fn angle(a: Vector, b: Vector) -> (f64, f64) {
    let normal = cross(a, b);
    (dot(a, b), dot(normal, normal).sqrt())
}
