//! Normal cones: their half-angles about the normal of the leaf at which their node stands.
//!
//! What a cone must hold at least, by the cones of its children and the angle between their normals, says most about it: so they
//! are coded from below. The half-angle has 16 steps to 90 degrees; from there on there is no cone, as on all surfaces that
//! have no inside.

use vdt::tree::NormalCone;

use super::Fields;
use super::contexts::CONE;
use super::nodes::{BORN, KEPT, LEAF, Nodes, dot};
use super::rans::Coder;

/// The class of no cone.
pub(crate) const NO_CONE: u8 = 16;
/// The sines of half-angles from 0 to 15 of 16 steps, in 254ths, rounded up (the first one more, since axes are rounded).
const SINES: [u8; 16] = [2, 25, 50, 74, 98, 120, 142, 162, 180, 197, 212, 225, 235, 244, 250, 253];
/// The cosines of the same angles.
const COSINES: [f32; 16] = [
    1.0,
    0.995_184_7,
    0.980_785_28,
    0.956_940_34,
    0.923_879_5,
    0.881_921_3,
    0.831_469_6,
    0.773_010_45,
    std::f32::consts::FRAC_1_SQRT_2,
    0.634_393_3,
    0.555_570_23,
    0.471_396_74,
    0.382_683_43,
    0.290_284_67,
    0.195_090_32,
    0.098_017_14,
];

/// Room to work in: for each record of the page the class of its node's cone.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    classes: Vec<u8>,
}

/// Codes the classes of the cones of all children that split.
pub(super) fn code<C: Coder>(coder: &mut C, nodes: &Nodes, fields: &mut Fields, scratch: &mut Scratch) {
    let first = nodes.first;
    let Scratch { classes } = scratch;
    classes.clear();
    // Of each node for now the least that it can be, by what is below.
    classes.resize(nodes.all.len() - first, 0);
    let mut entry = fields.ids.len();
    fields.cones.resize(entry, 0);
    for index in (first..nodes.all.len()).rev() {
        let node = &nodes.all[index];
        let mut least = [0; 2];
        for side in [BORN, KEPT] {
            let child = node.children[side];
            if child == LEAF {
                continue;
            }
            entry -= 1;
            // One context for those in a child page, of which nothing is known.
            let known = (child as usize).checked_sub(first).and_then(|child| classes.get(child));
            let context = CONE.context(known.map_or(usize::from(NO_CONE) + 1, |class| usize::from(*class)));
            let class = coder.symbol(context, fields.cones[entry].into()) as u8;
            fields.cones[entry] = class;
            least[side] = class;
        }
        let cosine = dot(node.normals[KEPT], node.normals[BORN]);
        let turned = COSINES.partition_point(|known| *known > cosine) as u8;
        classes[index - first] = least[KEPT].max(least[BORN].saturating_add(turned)).min(NO_CONE);
    }
}

/// The cone of a class about a normal.
pub(crate) fn cone(class: u8, normal: [f32; 3], is_inward: bool) -> NormalCone {
    match SINES.get(usize::from(class)) {
        Some(sine) => {
            let sign = if is_inward { -127.0 } else { 127.0 };
            NormalCone { axis: normal.map(|value| super::nearest(value * sign) as i8), sine: *sine }
        }
        None => NormalCone::EVERYTHING,
    }
}

/// The class of the narrowest cone about a normal that holds another cone.
pub(crate) fn class_for(inner: NormalCone, normal: [f32; 3], is_inward: bool) -> u8 {
    if inner.sine == u8::MAX {
        return NO_CONE;
    }
    let vector = |cone: NormalCone| cone.axis.map(f64::from);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let sine = f64::from(inner.sine) / 254.0;
    let cosine = (1.0 - sine * sine).max(0.0).sqrt();
    let axis = vector(inner);
    for class in 0..NO_CONE {
        let outer = cone(class, normal, is_inward);
        let about = vector(outer);
        let lengths = (dot(axis, axis) * dot(about, about)).sqrt();
        let between = (dot(axis, about) / lengths).clamp(-1.0, 1.0);
        let across = (1.0 - between * between).sqrt();
        // The cosine of both angles together; they are no more than 90 degrees where it is not negative and they are not 180.
        let together = between * cosine - across * sine;
        let reach = f64::from(outer.sine) / 254.0;
        let least = (1.0 - reach * reach).max(0.0).sqrt();
        if lengths > 0.0 && between > 0.0 && together >= least {
            return class;
        }
    }
    NO_CONE
}
