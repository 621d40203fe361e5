//! The criterion of the front (the paper, 3.3.1): whether the error of a node in pixels is above a threshold, as one
//! formula without branches, for one node and for blocks of [`BLOCK`].
//!
//! With `d` the vector from the eye to the node and `r` the radius of its sphere, in the unit of the view, and
//! `reach = |d| + r`, the error is
//!
//! ```text
//! error = scale * switch * share * finer / (max(|d| - r, nearest) * reach)
//! ```
//!
//! `share / reach`, 1/16 to 1, is the part of the error that counts where the node can hardly be seen; `finer`, at least 1,
//! is what silhouettes and highlights count more. To compare the error with a threshold takes no division. None of its
//! parts is smaller for a node than for its descendants, whose spheres and cones lie within the node's:
//!
//! - *Distance.* A sphere inside another is no nearer, and its reach no longer.
//! - *Frustum.* `outside` is the largest distance of the centre beyond one of five planes, less `r`. A sphere inside
//!   another is at least as far outside, so `outside / reach` does not fall towards the leaves; it is the sine of the angle
//!   outside where the sphere is small. From `margin` on, the share falls with it, in proportion:
//!   `share = max(min(reach, reach + slope * (margin * reach - outside)), reach / 16)`.
//! - *Cone.* With `u` the unit axis of the normals and `a` their half-angle, all of them point away from the eye at every
//!   point of the sphere where `u.d > r + sin(a) * reach`; then the share is `reach / 16`. That is a little stricter than
//!   it must be (0.2 % more triangles in a flight), and goes with nestedness exactly. For a sphere inside, `u.d` falls by
//!   no more than `r` does, and the reach does not grow. For a cone inside, of half-angle `b`, the axis turns by no more
//!   than `a - b`, and the angle that it may be from `d`, `acos(q + (1 + q) sin(a))` with `q = r / |d|`, grows by at
//!   least that.
//! - *Silhouette.* Some normal may be at right angles to the direction of view unless `|u.d| > r + sin(a) * reach`: the
//!   test above, for the cone and for the cone turned round.
//! - *Highlight.* From a point `p`, the direction half-way between those to the eye and to the light `l` is that of
//!   `g = |p| l - p`, which moves by no more than `2 r` over the sphere. Some normal may be within the angle `h` of it
//!   where `u` is within `a + h + asin(2 r / |g|)` of `g` of the centre; always, where the cone reaches 90 degrees or
//!   `2 r` most of `|g|`. Balls about `g` nest as the spheres do, so what is in reach for a node is for its ancestors.
//!
//! All of it is sums, products, square roots and selections of single precision, in a fixed order and with no fused
//! operation. So a node's result has the same bits alone and in a block, whatever the width of the machine's vectors, and
//! what exceeds a test of splits exceeds the test of collapses for the same threshold.

use metanode::page::NormalCone;

use crate::view::Sphere;

/// How many nodes a block has: those that are judged in one go.
pub const BLOCK: usize = 64;

/// How many nodes a group has.
pub const GROUP: usize = 8;

/// By how much the error of what cannot be seen is divided.
pub const UNSEEN_DIVISOR: f32 = 16.0;

/// The largest ratio of a threshold to the scale that counts: no error can be so large, and it overflows nowhere.
const MOST_RATIO: f64 = (1_u64 << 60) as f64;

/// More than what rounding makes of a sine or a length: tests say "may" rather.
const ROUNDING: f32 = 1e-5;

/// The square of what part of `|g|` `2 r` may be: all angles together stay below 180 degrees.
const MOST_DRIFT: f32 = 0.8;

/// What the errors of a group of nodes depend on, but for their positions.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C)]
pub struct Criteria {
    /// Radii of the spheres that hold all that is under the nodes, in mesh units.
    pub radius: [f32; GROUP],
    /// Switch values, in mesh units. A negative one never exceeds a threshold, infinity always does.
    pub switch: [f32; GROUP],
    /// Normal cones, by [`NormalCone::to_word`].
    pub cone: [u32; GROUP],
}

impl Criteria {
    /// Criteria of places that hold no node, all with this switch value.
    pub const fn vacant(switch: f32) -> Self {
        Criteria { radius: [0.0; GROUP], switch: [switch; GROUP], cone: [0; GROUP] }
    }

    /// Sets the criteria at one place of the group.
    #[inline]
    pub fn set(&mut self, place: usize, radius: f32, switch: f32, cone: NormalCone) {
        (self.radius[place], self.switch[place], self.cone[place]) = (radius, switch, cone.to_word());
    }

    /// Sets them to those at a place of another group.
    pub fn copy(&mut self, place: usize, from: &Self, from_place: usize) {
        (self.radius[place], self.switch[place], self.cone[place]) =
            (from.radius[from_place], from.switch[from_place], from.cone[from_place]);
    }
}

/// What decides about changes at a group of vertices, in three cache lines.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(C, align(64))]
pub struct Group {
    /// Whether the nodes there are to be split.
    pub split: Criteria,
    /// Whether the nodes that can be restored there are to be.
    pub collapse: Criteria,
}

/// The groups of a block.
pub type Groups = [Group; BLOCK / GROUP];

/// What the tests say of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// A bit for each node that is to be split, the lowest for the first.
    pub split: u64,
    /// The same for the nodes that are to be restored.
    pub collapse: u64,
    /// The error in pixels of each node that is to be split; anything for the others.
    pub errors: [f32; BLOCK],
}

/// What can be in the picture of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// The largest switch value, 0 where nothing is seen.
    pub switch: f32,
    /// The largest error in pixels above the threshold; 0 where there is none.
    pub error: f32,
}

/// The test of nodes against a threshold: see [`View::splits`](crate::view::View::splits) and
/// [`View::collapses`](crate::view::View::collapses).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Test {
    criterion: Criterion,
    /// The threshold, divided by the scale.
    ratio: f32,
}

impl Test {
    pub(crate) fn new(criterion: Criterion, threshold: f32) -> Self {
        Test { criterion, ratio: (f64::from(threshold) / f64::from(criterion.scale)).min(MOST_RATIO) as f32 }
    }

    /// Whether the error of the node is above the threshold.
    #[inline]
    pub fn is_exceeded(&self, sphere: &Sphere) -> bool {
        self.criterion.weigh_any(sphere).is_above(self.ratio)
    }

    /// The error of the node in pixels, as this test sees it.
    #[inline]
    pub fn error(&self, sphere: &Sphere) -> f32 {
        self.criterion.error(sphere)
    }

    /// The error in pixels, where it is above the threshold.
    #[inline]
    pub fn exceeded(&self, sphere: &Sphere) -> Option<f32> {
        let weighed = self.criterion.weigh_any(sphere);
        weighed.is_above(self.ratio).then(|| weighed.pixels(self.criterion.scale))
    }

    /// For which nodes of a block the error is above the threshold: one bit for each, the lowest for the first; for each
    /// just what [`Test::is_exceeded`] says. The fourth number of a position is not looked at.
    pub fn exceeding(&self, positions: &[[f32; 4]; BLOCK], groups: &Groups) -> u64 {
        self.run(Exceeding { positions, groups })
    }

    /// What this test says of the nodes of a block, and `collapse`, of the same view, of those that can be restored there.
    pub fn judge(&self, collapse: &Test, positions: &[[f32; 4]; BLOCK], groups: &Groups) -> Judged {
        self.run(Judge { collapse, positions, groups })
    }

    /// What of a block can be in the picture, and its largest error where this test is exceeded.
    pub fn seen(&self, positions: &[[f32; 4]; BLOCK], groups: &Groups) -> Seen {
        self.run(Look { positions, groups })
    }

    /// Runs a loop in the widest vectors that the machine has.
    fn run<L: Loop>(&self, block: L) -> L::Result {
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") {
            // SAFETY: AVX2 is all that the function asks of the machine, and it is there.
            return unsafe { self.run_with_avx2(block) };
        }
        self.run_in_loop(block)
    }

    /// The same loop in vectors of eight: 1.7 times as fast.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn run_with_avx2<L: Loop>(&self, block: L) -> L::Result {
        self.run_in_loop(block)
    }

    #[inline(always)]
    fn run_in_loop<L: Loop>(&self, block: L) -> L::Result {
        if self.criterion.has_highlights() { block.run::<true>(self) } else { block.run::<false>(self) }
    }
}

/// A loop over a block.
trait Loop {
    type Result;

    fn run<const HIGHLIGHTS: bool>(self, test: &Test) -> Self::Result;
}

/// The numbers of a block one kind after the other, so that the loops over them are ones of vectors to their ends.
struct Coordinates {
    x: [f32; BLOCK],
    y: [f32; BLOCK],
    z: [f32; BLOCK],
}

impl Coordinates {
    #[inline(always)]
    fn of(positions: &[[f32; 4]; BLOCK]) -> Self {
        Coordinates {
            x: std::array::from_fn(|place| positions[place][0]),
            y: std::array::from_fn(|place| positions[place][1]),
            z: std::array::from_fn(|place| positions[place][2]),
        }
    }

    #[inline(always)]
    fn at(&self, place: usize) -> [f32; 3] {
        [self.x[place], self.y[place], self.z[place]]
    }
}

/// The same for what decides.
struct Flat {
    radius: [f32; BLOCK],
    switch: [f32; BLOCK],
    cone: [u32; BLOCK],
}

impl Flat {
    #[inline(always)]
    fn of(groups: &Groups, kind: impl Fn(&Group) -> &Criteria) -> Self {
        let mut flat = Flat { radius: [0.0; BLOCK], switch: [0.0; BLOCK], cone: [0; BLOCK] };
        for (group, first) in groups.iter().zip((0..).step_by(GROUP)) {
            let Criteria { radius, switch, cone } = kind(group);
            flat.radius[first..first + GROUP].copy_from_slice(radius);
            flat.switch[first..first + GROUP].copy_from_slice(switch);
            flat.cone[first..first + GROUP].copy_from_slice(cone);
        }
        flat
    }

    #[inline(always)]
    fn at(&self, place: usize) -> Node {
        Node { radius: self.radius[place], switch: self.switch[place], cone: self.cone[place] }
    }
}

struct Exceeding<'a> {
    positions: &'a [[f32; 4]; BLOCK],
    groups: &'a Groups,
}

impl Loop for Exceeding<'_> {
    type Result = u64;

    #[inline(always)]
    fn run<const HIGHLIGHTS: bool>(self, test: &Test) -> u64 {
        let (coordinates, nodes) = (Coordinates::of(self.positions), Flat::of(self.groups, |group| &group.split));
        let mut is_above = [0_u8; BLOCK];
        for place in 0..BLOCK {
            let from_eye = test.criterion.look_at(coordinates.at(place));
            let weighed = test.criterion.weigh::<HIGHLIGHTS>(&from_eye, nodes.at(place));
            is_above[place] = u8::from(weighed.is_above(test.ratio));
        }
        mask(&is_above)
    }
}

struct Judge<'a> {
    collapse: &'a Test,
    positions: &'a [[f32; 4]; BLOCK],
    groups: &'a Groups,
}

impl Loop for Judge<'_> {
    type Result = Judged;

    /// Most of the work, where a vertex is seen from the eye, is done once for both tests.
    #[inline(always)]
    fn run<const HIGHLIGHTS: bool>(self, test: &Test) -> Judged {
        let coordinates = Coordinates::of(self.positions);
        let (of_split, of_collapse) =
            (Flat::of(self.groups, |group| &group.split), Flat::of(self.groups, |group| &group.collapse));
        let (mut is_split, mut is_kept) = ([0_u8; BLOCK], [0_u8; BLOCK]);
        let mut errors = [0.0; BLOCK];
        for place in 0..BLOCK {
            let from_eye = test.criterion.look_at(coordinates.at(place));
            let split = test.criterion.weigh::<HIGHLIGHTS>(&from_eye, of_split.at(place));
            let collapse = self.collapse.criterion.weigh::<HIGHLIGHTS>(&from_eye, of_collapse.at(place));
            is_split[place] = u8::from(split.is_above(test.ratio));
            is_kept[place] = u8::from(collapse.is_above(self.collapse.ratio));
            errors[place] = split.pixels(test.criterion.scale);
        }
        Judged { split: mask(&is_split), collapse: !mask(&is_kept), errors }
    }
}

struct Look<'a> {
    positions: &'a [[f32; 4]; BLOCK],
    groups: &'a Groups,
}

impl Loop for Look<'_> {
    type Result = Seen;

    #[inline(always)]
    fn run<const HIGHLIGHTS: bool>(self, test: &Test) -> Seen {
        let (coordinates, nodes) = (Coordinates::of(self.positions), Flat::of(self.groups, |group| &group.split));
        let (mut switches, mut errors) = ([0.0_f32; BLOCK], [0.0_f32; BLOCK]);
        for place in 0..BLOCK {
            let (from_eye, node) = (test.criterion.look_at(coordinates.at(place)), nodes.at(place));
            let weighed = test.criterion.weigh::<HIGHLIGHTS>(&from_eye, node);
            let is_seen = from_eye.beyond - node.radius * test.criterion.unit <= 0.0;
            switches[place] = select(is_seen, node.switch, 0.0);
            errors[place] = select(is_seen & weighed.is_above(test.ratio), weighed.pixels(test.criterion.scale), 0.0);
        }
        let largest = |values: &[f32; BLOCK]| values.iter().copied().fold(0.0, larger);
        Seen { switch: largest(&switches), error: largest(&errors) }
    }
}

/// A node, as far as its error depends on it, but for where it stands.
#[derive(Clone, Copy)]
struct Node {
    radius: f32,
    switch: f32,
    cone: u32,
}

impl From<&Sphere> for Node {
    #[inline(always)]
    fn from(sphere: &Sphere) -> Self {
        let Sphere { radius, switch, cone, .. } = *sphere;
        Node { radius, switch, cone: cone.to_word() }
    }
}

/// An error, divided by the scale, as a fraction.
#[derive(Clone, Copy)]
struct Weighed {
    /// Switch value times share and `finer`.
    weight: f32,
    /// Distance times reach.
    room: f32,
}

impl Weighed {
    #[inline(always)]
    fn is_above(self, ratio: f32) -> bool {
        // What is always to exceed does so even where that is no number any more.
        self.weight > smaller(ratio * self.room, f32::MAX)
    }

    #[inline(always)]
    fn pixels(self, scale: f32) -> f32 {
        self.weight * scale / self.room
    }
}

/// A place as it is seen from the eye, in the unit of the view.
struct FromEye {
    view: [f32; 3],
    length: f32,
    /// How far it is beyond the plane of the frustum that it is farthest beyond; negative inside.
    beyond: f32,
}

/// The numbers that the criterion takes of a view, see the module.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Criterion {
    /// Units of the view in a mesh unit: a power of two.
    pub(crate) unit: f32,
    /// Where the eye is, in mesh units relative to the model's origin.
    pub(crate) eye: [f32; 3],
    /// Pixels that a length takes at a distance of that length.
    pub(crate) scale: f32,
    /// The least distance that counts, in the unit of the view.
    pub(crate) nearest: f32,
    /// The direction of view turned round, of unit length, times the unit.
    pub(crate) backward: [f32; 3],
    /// The same for the direction to the right of the picture.
    pub(crate) right: [f32; 3],
    /// The same for that to its top.
    pub(crate) up: [f32; 3],
    /// Cosine and sine of half the horizontal angle of view.
    pub(crate) side: [f32; 2],
    /// Cosine and sine of half the vertical one.
    pub(crate) top: [f32; 2],
    /// By how much `share / reach` falls where `outside / reach` grows by one; 0 where the frustum does not count.
    pub(crate) slope: f32,
    /// 1 and the slope times the margin.
    pub(crate) widened: f32,
    /// Normals point away where `u.d`, times the axis' length, is above this, too: 0, or infinity where cones do not count.
    pub(crate) facing: f32,
    /// What silhouettes count more, less 1.
    pub(crate) silhouette: f32,
    /// What highlights count more, less 1.
    pub(crate) highlight: f32,
    /// Direction to the light, of unit length.
    pub(crate) light: [f32; 3],
    /// Cosine and sine of the angle `h`.
    pub(crate) shine: [f32; 2],
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// One instruction, other than [`f32::max`], which heeds NaN.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn select(condition: bool, yes: f32, no: f32) -> f32 {
    if condition { yes } else { no }
}

impl Criterion {
    /// Whether the sphere can reach into the picture.
    pub(crate) fn can_see(&self, sphere: &Sphere) -> bool {
        self.look_at(sphere.position).beyond - sphere.radius * self.unit <= 0.0
    }

    /// The error of a node in pixels.
    #[inline]
    pub(crate) fn error(&self, sphere: &Sphere) -> f32 {
        self.weigh_any(sphere).pixels(self.scale)
    }

    fn has_highlights(&self) -> bool {
        self.highlight > 0.0
    }

    #[inline(always)]
    fn look_at(&self, position: [f32; 3]) -> FromEye {
        let to_node = [position[0] - self.eye[0], position[1] - self.eye[1], position[2] - self.eye[2]];
        let view = [to_node[0] * self.unit, to_node[1] * self.unit, to_node[2] * self.unit];
        let behind = dot(self.backward, to_node);
        let beside = self.side[0] * dot(self.right, to_node).abs() + self.side[1] * behind;
        let above = self.top[0] * dot(self.up, to_node).abs() + self.top[1] * behind;
        FromEye { view, length: dot(view, view).sqrt(), beyond: larger(larger(beside, above), behind) }
    }

    #[inline(always)]
    fn weigh_any(&self, sphere: &Sphere) -> Weighed {
        let (from_eye, node) = (self.look_at(sphere.position), sphere.into());
        if self.has_highlights() { self.weigh::<true>(&from_eye, node) } else { self.weigh::<false>(&from_eye, node) }
    }

    /// The criterion. What is off costs next to nothing in it, highlights excepted.
    #[inline(always)]
    fn weigh<const HIGHLIGHTS: bool>(&self, from_eye: &FromEye, node: Node) -> Weighed {
        let FromEye { view, length, beyond } = *from_eye;
        let radius = node.radius * self.unit;
        let reach = larger(length + radius, self.nearest);
        let distance = larger(length - radius, self.nearest);
        let inside = smaller(reach, self.widened * reach - self.slope * (beyond - radius));

        // Three signed bytes, and one without a sign.
        let byte = |shift: u32| ((node.cone << shift) as i32 >> 24) as f32;
        let axis = [byte(24), byte(16), byte(8)];
        let sine = (node.cone >> 24) as i32 as f32 * (1.0 / 254.0) + ROUNDING;
        let axis_square = dot(axis, axis);
        let along = dot(axis, view);
        let bound = radius + sine * reach;
        let is_one_sided = along * along > axis_square * (bound * bound);
        let facing = select(is_one_sided & (along > self.facing), 0.0, inside);
        let share = larger(facing, reach * (1.0 / UNSEEN_DIVISOR));

        let mut finer = 1.0 + select(is_one_sided, 0.0, self.silhouette);
        if HIGHLIGHTS {
            let [x, y, z] = self.light;
            let half_way = [x * length - view[0], y * length - view[1], z * length - view[2]];
            let axis_length = axis_square.sqrt();
            let cosine = larger(1.0 - sine * sine, 0.0).sqrt();
            let (spread_cosine, spread_sine) =
                (self.shine[0] * cosine - self.shine[1] * sine, self.shine[1] * cosine + self.shine[0] * sine);
            let drift = 2.0 * (radius + ROUNDING * reach);
            let (half_way_square, drift_square) = (dot(half_way, half_way), drift * drift);
            let tangent = larger(half_way_square - drift_square, 0.0).sqrt();
            let least = spread_cosine * tangent - spread_sine * drift;
            let is_anywhere = (sine > 1.0) | (drift_square > MOST_DRIFT * half_way_square);
            let is_lit = (dot(axis, half_way) >= least * axis_length) | is_anywhere;
            finer = larger(finer, 1.0 + select(is_lit, self.highlight, 0.0));
        }
        Weighed { weight: node.switch * self.unit * (share * finer), room: distance * reach }
    }
}

/// The lowest bits of 64 bytes, the first one lowest.
#[inline(always)]
fn mask(bytes: &[u8; BLOCK]) -> u64 {
    // Brings the lowest bits of eight bytes together in the highest byte.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let (eights, _) = bytes.as_chunks::<8>();
    eights.iter().rev().fold(0, |mask, eight| mask << 8 | u64::from_le_bytes(*eight).wrapping_mul(GATHER) >> 56)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use metanode::model::Model;
    use proptest::prelude::*;
    use std::sync::{Arc, LazyLock};

    use super::*;
    use crate::testing;
    use crate::view::View;
    use crate::{Camera, Light, ViewParameters};

    static MODEL: LazyLock<Arc<Model>> = LazyLock::new(|| testing::model_of(&testing::grid_tree(30, 40, 1)));

    fn nodes() -> impl Strategy<Value = Sphere> {
        let switches = prop_oneof![8 => 0.0_f32..1.0, 1 => Just(-1.0), 1 => Just(0.0), 1 => Just(f32::INFINITY)];
        let cones = prop_oneof![3 => any::<u32>(), 1 => Just(NormalCone::EVERYTHING.to_word())];
        (prop::array::uniform3(-30.0_f32..60.0), 0.0_f32..4.0, switches, cones).prop_map(
            |(position, radius, switch, cone)| Sphere { position, radius, switch, cone: NormalCone::from_word(cone) },
        )
    }

    #[test]
    fn places_without_a_node_exceed_nothing() {
        let camera: Camera = "-10 0 0 0 0 0 0 0 1 60".parse().unwrap();
        let view = View::new(&camera, MODEL.header(), 1920, 1080, &ViewParameters::default()).unwrap();
        let vacant = Group { split: Criteria::vacant(-1.0), collapse: Criteria::vacant(f32::INFINITY) };
        let judged = view.splits(0.0).judge(&view.collapses(0.0), &[[0.0; 4]; BLOCK], &[vacant; BLOCK / GROUP]);
        assert_eq!((judged.split, judged.collapse), (0, 0));
    }

    proptest! {
        /// To the bit, also where the error is just the threshold.
        #[test]
        fn blocks_say_what_single_nodes_say(
            nodes in prop::collection::vec(nodes(), BLOCK),
            eye in prop::array::uniform3(-30.0_f64..60.0),
            (frustum, cones) in any::<(bool, bool)>(),
            silhouettes in prop_oneof![Just(1.0_f32), 1.0_f32..8.0],
            light in prop::option::of((prop::array::uniform3(0.1_f64..1.0), 1.0_f32..8.0)),
            number in 0..BLOCK,
            fourth in any::<f32>(),
        ) {
            let camera = Camera::looking_at(DVec3::from_array(eye), DVec3::new(15.0, 70.0, 1.0), 60.0);
            let light = light.map(|(direction, highlights)| Light { direction: direction.into(), highlights });
            let parameters = ViewParameters { frustum, cones, silhouettes, light };
            let view = View::new(&camera, MODEL.header(), 1920, 1080, &parameters).unwrap();
            let mut positions = [[fourth; 4]; BLOCK];
            let vacant = Criteria::vacant(-1.0);
            let mut groups = [Group { split: vacant, collapse: vacant }; BLOCK / GROUP];
            // What can be restored at a place is another node that stands there.
            let restored = |place: usize| Sphere { position: nodes[place].position, ..nodes[BLOCK - 1 - place] };
            for (place, node) in nodes.iter().enumerate() {
                positions[place][..3].copy_from_slice(&node.position);
                let (group, above) = (&mut groups[place / GROUP], restored(place));
                group.split.set(place % GROUP, node.radius, node.switch, node.cone);
                group.collapse.set(place % GROUP, above.radius, above.switch, above.cone);
            }
            let at_node = view.pixel_error(&nodes[number]).clamp(0.0, 1e30);
            for threshold in [0.0, 1.0, 100.0, at_node, f32::from_bits(at_node.to_bits().saturating_sub(1))] {
                let (splits, collapses) = (view.splits(threshold), view.collapses(threshold));
                for test in [splits, collapses] {
                    let single = |place: usize| u64::from(test.is_exceeded(&nodes[place])) << place;
                    let expected = (0..BLOCK).map(single).sum::<u64>();
                    prop_assert_eq!(test.exceeding(&positions, &groups), expected);
                    // Without AVX2.
                    prop_assert_eq!(test.run_in_loop(Exceeding { positions: &positions, groups: &groups }), expected);
                }
                let judged = splits.judge(&collapses, &positions, &groups);
                let seen = splits.seen(&positions, &groups);
                let (mut switch, mut error) = (0.0_f32, 0.0_f32);
                for (place, node) in nodes.iter().enumerate() {
                    let exceeded = splits.exceeded(node);
                    prop_assert_eq!(judged.split >> place & 1 == 1, exceeded.is_some());
                    prop_assert!(exceeded.is_none_or(|error| error.to_bits() == judged.errors[place].to_bits()));
                    prop_assert_eq!(judged.collapse >> place & 1 == 0, collapses.is_exceeded(&restored(place)));
                    if view.can_see(node) {
                        (switch, error) = (switch.max(node.switch), error.max(exceeded.unwrap_or(0.0)));
                    }
                }
                prop_assert_eq!((seen.switch, seen.error), (switch, error));
            }
        }
    }
}
