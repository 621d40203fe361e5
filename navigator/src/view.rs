//! A camera looking at a model (the paper, 3.3.1): how large the error of a node is on the screen.
//!
//! The error of a node in pixels is `switch * height / (2 tan(fov / 2)) / distance`, where the distance is that from
//! the eye to the node's bounding sphere; it counts as no less than a ten-thousandth of the model's diagonal, nearer
//! than any near plane, so that with the eye inside the sphere the error is large but finite. Less of that counts
//! outside the view frustum and where the surface faces away, more at silhouettes and highlights: see
//! [`ViewParameters`] for what, and [`crate::evaluation`] for how and why.
//!
//! Everything is measured in a unit in which the model is about one wide, a power of two of the mesh's: so squares of
//! lengths stay within single precision whatever the unit of the mesh, and nothing else changes.
//!
//! Spheres and cones nest and switch values never fall towards the root, and every view parameter goes with that; so a
//! node's error is never below that of its descendants (up to rounding), and the nodes with too large an error form the
//! tops of the trees. But for roots: their cones are stored as they are, those below in wider steps (`docs/format.md`, 9.8). So a
//! root may count as facing away while a child of it does not; then the child, once it is drawn, is kept.

use glam::DVec3;
use metanode::header::Header;
use metanode::page::NormalCone;

use crate::camera::{Camera, CameraError};
use crate::evaluation::{Criterion, Test, UNSEEN_DIVISOR};
use crate::view_parameters::{MOST_FINER, ViewParameters};

/// How much smaller than the threshold an error has to be for a collapse: 1.05 saves most of the changes back and
/// forth, more saves no more (`facts/front.md`).
pub const HYSTERESIS: f32 = 1.05;

/// The sine of the angle outside the frustum at which the part of the error that counts is down to that of the unseen.
/// Against none, flights have 3 to 5 % more triangles and 3 to 5 % fewer changes; 0.1 takes 3 % more, and saves no more.
const BORDER: f32 = 0.05;
/// The sine of the angle by which the frustum is wider for collapses: what changes back and forth at its border when the
/// camera trembles is not stopped by a smaller threshold.
const MARGIN: f32 = 0.02;
/// The angle of a highlight about the half-way direction, in degrees.
const SHINE: f64 = 15.0;

/// The least distance, in diagonals of the model's bounding box.
const NEAREST: f64 = 1e-4;
/// The least distance, in the unit of the view, of a model without a diagonal.
const LEAST_NEAREST: f64 = 1e-12;
/// An eye that is farther from the model's origin, in the unit of the view, counts as this far.
const FARTHEST: f64 = (1_u64 << 53) as f64;
/// Of pictures with more pixels for a length at its distance, so many count.
const MOST_SCALE: f64 = (1_u64 << 40) as f64;

/// What the error of a node depends on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sphere {
    /// Where the node stands, in mesh units relative to the model's origin.
    pub position: [f32; 3],
    /// Radius of the sphere about it that holds all that is under it.
    pub radius: f32,
    /// The node's switch value, in mesh units.
    pub switch: f32,
    /// Holds all normals under it.
    pub cone: NormalCone,
}

/// A camera looking at a model, on a screen of a certain size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    criterion: Criterion,
}

/// The power of two, within the range of single precision, that brings `length` nearest below one.
fn unit_for(length: f64) -> f64 {
    let exponent = if length > 0.0 { -length.log2().ceil() } else { 0.0 };
    exponent.clamp(-126.0, 126.0).exp2()
}

/// Cosine and sine of the angle with this tangent.
fn cosine_and_sine(tangent: f64) -> [f32; 2] {
    let cosine = 1.0 / tangent.hypot(1.0);
    [cosine as f32, (tangent * cosine) as f32]
}

/// What a factor adds, within its bounds.
fn extra(factor: f32) -> f32 {
    if factor > 1.0 { factor.min(MOST_FINER) - 1.0 } else { 0.0 }
}

impl View {
    /// The view of a `width` × `height` pixel screen, of the model with this header. Parameters out of range, which
    /// [`ViewParameters::check`] refuses, count as the nearest ones within; a light that is nowhere is off.
    pub fn new(
        camera: &Camera,
        header: &Header,
        width: u32,
        height: u32,
        parameters: &ViewParameters,
    ) -> Result<Self, CameraError> {
        let frame = camera.frame()?;
        let tall = camera.half_height();
        let wide = tall * f64::from(width) / f64::from(height.max(1));
        let unit = unit_for(header.diagonal());
        let eye = ((camera.eye - DVec3::from_array(header.origin)) * unit).clamp_length_max(FARTHEST) / unit;
        let direction = |direction: DVec3| (direction * unit).as_vec3().to_array();
        let slope = if parameters.frustum { (1.0 - 1.0 / UNSEEN_DIVISOR) / BORDER } else { 0.0 };
        let light = parameters.light.and_then(|light| Some((light.direction.try_normalize()?, light.highlights)));
        let (to_light, highlights) = light.unwrap_or((DVec3::ZERO, 1.0));
        let (shine_sine, shine_cosine) = SHINE.to_radians().sin_cos();
        Ok(View {
            criterion: Criterion {
                unit: unit as f32,
                eye: eye.as_vec3().to_array(),
                scale: (f64::from(height) / (2.0 * tall)).min(MOST_SCALE) as f32,
                nearest: (header.diagonal() * unit * NEAREST).max(LEAST_NEAREST) as f32,
                backward: direction(-frame.forward),
                right: direction(frame.right),
                up: direction(frame.up),
                side: cosine_and_sine(wide),
                top: cosine_and_sine(tall),
                slope,
                widened: 1.0,
                facing: if parameters.cones { 0.0 } else { f32::INFINITY },
                silhouette: extra(parameters.silhouettes),
                highlight: extra(highlights),
                light: to_light.as_vec3().to_array(),
                shine: [shine_cosine as f32, shine_sine as f32],
            },
        })
    }

    /// Error of a node in pixels.
    pub fn pixel_error(&self, sphere: &Sphere) -> f32 {
        self.criterion.error(sphere)
    }

    /// Whether the sphere can reach into the picture.
    pub fn can_see(&self, sphere: &Sphere) -> bool {
        self.criterion.can_see(sphere)
    }

    /// The test that a node has to exceed to be split: its error against the threshold, in pixels.
    pub fn splits(&self, threshold: f32) -> Test {
        Test::new(self.criterion, threshold)
    }

    /// The test that a node must not exceed to be collapsed: the threshold is smaller by [`HYSTERESIS`], and the frustum
    /// wider. Whatever exceeds the test of splits exceeds this one.
    pub fn collapses(&self, threshold: f32) -> Test {
        let widened = 1.0 + self.criterion.slope * MARGIN;
        Test::new(Criterion { widened, ..self.criterion }, threshold / HYSTERESIS)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use metanode::model::Model;
    use proptest::prelude::*;
    use std::sync::{Arc, LazyLock};
    use vdt::tree::{Tree, enclosing_cone};

    use super::*;
    use crate::testing;
    use crate::view_parameters::Light;

    static MODEL: LazyLock<Arc<Model>> =
        LazyLock::new(|| testing::model_of(&Tree { origin: [100.0, 0.0, 0.0], ..testing::grid_tree(30, 40, 1) }));

    /// The diagonal of the model is about 50; half the picture is 1 unit high and 2 units wide at distance 1.
    fn view(parameters: &ViewParameters) -> View {
        let camera: Camera = "100 0 0  101 0 0  0 0 1  90".parse().unwrap();
        View::new(&camera, MODEL.header(), 200, 100, parameters).unwrap()
    }

    fn off() -> ViewParameters {
        ViewParameters { frustum: false, cones: false, silhouettes: 1.0, light: None }
    }

    fn sphere(position: [f32; 3], radius: f32) -> Sphere {
        Sphere { position, radius, switch: 1.0, cone: NormalCone::EVERYTHING }
    }

    fn with_cone(axis: [i8; 3], sine: u8, radius: f32) -> Sphere {
        Sphere { cone: NormalCone { axis, sine }, ..sphere([10.0, 0.0, 0.0], radius) }
    }

    #[test]
    fn errors_in_pixels() {
        let view = view(&ViewParameters::default());
        // 100 pixels are 2 units at distance 1.
        assert_eq!(view.pixel_error(&sphere([10.0, 0.0, 0.0], 0.0)), 5.0);
        assert_eq!(view.pixel_error(&sphere([10.0, 0.0, 0.0], 5.0)), 10.0);
        // 0.005 at the least.
        assert!((9_000.0..11_000.0).contains(&view.pixel_error(&sphere([1.0, 0.0, 0.0], 1.0))));
        assert!((9_000.0..11_000.0).contains(&view.pixel_error(&sphere([1.0, 0.0, 0.0], 7.0))));
        assert!((9_000.0..11_000.0).contains(&view.pixel_error(&sphere([0.0; 3], 0.0))));
        let behind = view.pixel_error(&sphere([-10.0, 0.0, 0.0], 0.0));
        assert_eq!(behind, 5.0 / 16.0);
        assert!(view.can_see(&sphere([10.0, 19.0, 9.0], 0.0)));
        assert!(!view.can_see(&sphere([10.0, 19.0, 11.0], 0.0)));
        assert!(!view.can_see(&sphere([10.0, 21.0, 0.0], 0.1)));
        assert!(view.can_see(&sphere([10.0, 21.0, 0.0], 1.0)));
        assert!(view.can_see(&sphere([-0.5, 0.0, 0.0], 1.0)));
    }

    #[test]
    fn less_counts_outside_the_frustum() {
        let view = view(&ViewParameters::default());
        // Above the middle of the picture, at distance 10.
        let at = |degrees: f32| {
            let (sine, cosine) = degrees.to_radians().sin_cos();
            sphere([10.0 * cosine, 0.0, 10.0 * sine], 0.0)
        };
        let error = |degrees: f32| view.pixel_error(&at(degrees));
        assert!((error(44.9) - 5.0).abs() < 1e-5);
        assert!((3.3..3.5).contains(&error(46.0)), "{}", error(46.0));
        assert!((1.6..1.8).contains(&error(47.0)), "{}", error(47.0));
        assert!((error(48.0) - 5.0 / 16.0).abs() < 1e-5);
        assert!((error(135.0) - 5.0 / 16.0).abs() < 1e-5);
        // The frustum is wider by a degree for collapses, and all errors are larger.
        assert!((view.collapses(1.0).error(&at(46.0)) - 5.0).abs() < 1e-5);
        assert!(!view.splits(4.9).is_exceeded(&at(46.0)) && view.collapses(4.9).is_exceeded(&at(46.0)));
        assert!((self::view(&off()).pixel_error(&at(180.0)) - 5.0).abs() < 1e-5);
    }

    #[test]
    fn cones_that_point_away_count_less() {
        let error = |axis, sine, radius| view(&ViewParameters::default()).pixel_error(&with_cone(axis, sine, radius));
        assert!(error([127, 0, 0], 100, 0.1) < 1.0);
        assert!(error([-127, 0, 0], 100, 0.1) > 1.0);
        assert!(error([0, 0, 127], 1, 0.1) > 1.0);
        assert!(error([127, 0, 0], 255, 0.1) > 1.0);
        // 45 degrees of axis and 44 of cone leave one degree for the sphere.
        assert!(error([90, 90, 0], 176, 0.01) < 1.0);
        assert!(error([90, 90, 0], 176, 0.5) > 1.0);
        assert!(error([0, 0, 0], 0, 0.1) > 1.0);
        let without = view(&ViewParameters { cones: false, ..ViewParameters::default() });
        assert!(without.pixel_error(&with_cone([127, 0, 0], 100, 0.1)) > 1.0);
    }

    #[test]
    fn silhouettes_count_more() {
        let view = view(&ViewParameters { silhouettes: 4.0, ..off() });
        let factor = |axis, sine| {
            let node = with_cone(axis, sine, 0.1);
            view.pixel_error(&node) / self::view(&off()).pixel_error(&node)
        };
        assert_eq!(factor([0, 0, 127], 1), 4.0);
        assert_eq!(factor([127, 0, 0], 100), 1.0);
        assert_eq!(factor([-127, 0, 0], 100), 1.0);
        // 45 degrees, and cones of 44 and 46.
        assert_eq!(factor([-90, 90, 0], 174), 1.0);
        assert_eq!(factor([-90, 90, 0], 183), 4.0);
        assert_eq!(factor([0, 0, 0], 255), 4.0);
    }

    #[test]
    fn highlights_count_more() {
        // From above: half-way to the eye is 45 degrees up.
        let light = Light { direction: DVec3::Z * 3.0, highlights: 2.0 };
        let view = view(&ViewParameters { light: Some(light), ..off() });
        let factor = |axis, sine| {
            let node = with_cone(axis, sine, 0.01);
            view.pixel_error(&node) / self::view(&off()).pixel_error(&node)
        };
        assert_eq!(factor([-90, 0, 90], 2), 2.0);
        // 45 degrees away, and cones of 29 and 31.
        assert_eq!(factor([0, 0, 127], 123), 1.0);
        assert_eq!(factor([0, 0, 127], 131), 2.0);
        assert_eq!(factor([90, 0, -90], 200), 1.0);
        assert_eq!(factor([0, 0, 0], 255), 2.0);
    }

    #[test]
    fn parameters_out_of_range_do_no_harm() {
        let light = |direction| Some(Light { direction, highlights: 2.0 });
        let nowhere = view(&ViewParameters { light: light(DVec3::ZERO), silhouettes: f32::NAN, ..off() });
        let node = with_cone([0, 0, 127], 1, 0.1);
        assert_eq!(nowhere.pixel_error(&node), view(&off()).pixel_error(&node));
        let most = view(&ViewParameters { silhouettes: f32::INFINITY, ..off() });
        assert!(most.pixel_error(&node).is_finite());
    }

    /// Far away, near by, with a long or a short lens: errors are numbers, thresholds are compared.
    #[test]
    fn extreme_cameras_do_no_harm() {
        for camera in
            ["1e100 0 0 0 0 0 0 0 1 60", "1e30 0 0 0 0 0 0 0 1 1e-300", "115 20 0 100 0 0 0 0 1 179.999999999"]
        {
            for (width, height) in [(1, u32::MAX), (u32::MAX, 1)] {
                let light = Some(Light { direction: DVec3::X, highlights: MOST_FINER });
                let parameters = ViewParameters { silhouettes: MOST_FINER, light, ..ViewParameters::default() };
                let camera = camera.parse().unwrap();
                let view = View::new(&camera, MODEL.header(), width, height, &parameters).unwrap();
                for radius in [0.0, 1.0, 60.0] {
                    let node = sphere([15.0, 20.0, 0.0], radius);
                    let (never, always) = (Sphere { switch: -1.0, ..node }, Sphere { switch: f32::INFINITY, ..node });
                    assert!(view.pixel_error(&node).is_finite());
                    for threshold in [0.0, 1.0, 1e20, f32::MAX] {
                        for test in [view.splits(threshold), view.collapses(threshold)] {
                            assert!(!test.is_exceeded(&never) && test.is_exceeded(&always));
                            assert!(!test.is_exceeded(&Sphere { switch: 0.0, ..node }));
                        }
                    }
                    assert!(view.splits(0.0).is_exceeded(&node));
                }
            }
        }
    }

    fn vectors(bound: f32) -> impl Strategy<Value = Vec3> {
        prop::array::uniform3(-bound..bound).prop_map(Vec3::from_array)
    }

    fn directions() -> impl Strategy<Value = Vec3> {
        vectors(1.0).prop_filter_map("too short", |vector| (vector.length() > 0.1).then(|| vector.normalize()))
    }

    fn cones() -> impl Strategy<Value = NormalCone> {
        (directions(), prop_oneof![0_u8..=255, 0_u8..50])
            .prop_map(|(axis, sine)| NormalCone { axis: (axis * 127.0).round().to_array().map(|x| x as i8), sine })
    }

    fn lights() -> impl Strategy<Value = Light> {
        (directions(), 1.0_f32..8.0)
            .prop_map(|(direction, highlights)| Light { direction: direction.as_dvec3(), highlights })
    }

    /// Each alone, and together.
    fn parameters() -> impl Strategy<Value = ViewParameters> {
        let all = (any::<bool>(), any::<bool>(), 1.0_f32..8.0, prop::option::of(lights()))
            .prop_map(|(frustum, cones, silhouettes, light)| ViewParameters { frustum, cones, silhouettes, light });
        prop_oneof![
            Just(off()),
            Just(ViewParameters { frustum: true, ..off() }),
            Just(ViewParameters { cones: true, ..off() }),
            (1.0_f32..8.0).prop_map(|silhouettes| ViewParameters { silhouettes, ..off() }),
            lights().prop_map(|light| ViewParameters { light: Some(light), ..off() }),
            all,
        ]
    }

    /// A unit vector turned towards another one by an angle.
    fn turned(from: Vec3, towards: Vec3, angle: f32) -> Vec3 {
        from * angle.cos() + (towards - from * from.dot(towards)).normalize_or_zero() * angle.sin()
    }

    /// A node whose sphere holds a point and whose cone holds a normal, both somewhere.
    fn node_about(point: Vec3, normal: Vec3, shift: Vec3, axis: Vec3) -> Sphere {
        let axis = (axis * 127.0).round().to_array().map(|x| x as i8);
        let vector = DVec3::from_array(axis.map(f64::from)).normalize();
        let angle = vector.angle_between(normal.as_dvec3());
        let sine = if angle < 89.0_f64.to_radians() { (angle.sin() * 254.0 + 1e-3).ceil() as u8 } else { 255 };
        let (position, radius) = ((point + shift).to_array(), shift.length() * 1.000_01);
        Sphere { position, radius, switch: 1.0, cone: NormalCone { axis, sine } }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4096))]

        /// A node inside another, with a smaller error, has a smaller error on the screen.
        #[test]
        fn nested_nodes_have_nested_errors(
            parameters in parameters(),
            position in vectors(20.0),
            radius in 0.0_f32..10.0,
            part in prop_oneof![Just(0.0_f32), Just(1.0), 0.0_f32..1.0],
            towards in vectors(1.0),
            cones in [cones(), cones()],
            threshold in 0.0_f32..20.0,
        ) {
            let view = view(&parameters);
            let cone = enclosing_cone(cones[0], cones[1]);
            let parent = Sphere { position: position.to_array(), radius, switch: 1.0, cone };
            let inner = radius * part;
            let step = towards.clamp_length_max(1.0) * (radius - inner);
            let child =
                Sphere { position: (position + step).to_array(), radius: inner, switch: 0.999, cone: cones[0] };
            prop_assert!(view.pixel_error(&child) <= view.pixel_error(&parent));
            for test in [view.splits(threshold), view.collapses(threshold)] {
                prop_assert!(test.error(&child) <= test.error(&parent));
                prop_assert!(!test.is_exceeded(&child) || test.is_exceeded(&parent));
            }
        }

        /// Nothing is split and collapsed in one frame.
        #[test]
        fn what_is_split_is_not_collapsed(
            parameters in parameters(),
            position in vectors(20.0),
            radius in 0.0_f32..2.0,
            cone in cones(),
            threshold in 0.0_f32..20.0,
        ) {
            let view = view(&parameters);
            let node = Sphere { position: position.to_array(), radius, switch: 1.0, cone };
            let error = view.pixel_error(&node);
            for threshold in [threshold, error, error * 1.05, error * 0.95, f32::from_bits(error.to_bits() - 1)] {
                let (splits, collapses) = (view.splits(threshold), view.collapses(threshold));
                prop_assert!(!splits.is_exceeded(&node) || collapses.is_exceeded(&node));
                prop_assert_eq!(splits.exceeded(&node), splits.is_exceeded(&node).then_some(error));
                prop_assert!(collapses.error(&node) >= error);
                if (error - threshold).abs() > error * 1e-5 {
                    prop_assert_eq!(splits.is_exceeded(&node), error > threshold);
                }
            }
        }

        /// A normal at right angles to the direction of view is at a silhouette, one that faces the eye is seen, and one near
        /// the half-way direction shines, wherever in the sphere and the cone it is.
        #[test]
        fn what_may_be_is_taken_for_true(
            point in vectors(20.0),
            [normal, axis, light] in [directions(), directions(), directions()],
            shift in vectors(3.0),
            turn in 0.0_f32..0.26,
        ) {
            let ratio = |parameters: ViewParameters, normal: Vec3| {
                let node = node_about(point, normal, shift, axis);
                view(&parameters).pixel_error(&node) / view(&off()).pixel_error(&node)
            };
            let across = (normal - point * (normal.dot(point) / point.length_squared())).normalize();
            prop_assert_eq!(ratio(ViewParameters { silhouettes: 4.0, ..off() }, across), 4.0);
            let facing = if normal.dot(point) < 0.0 { normal } else { -normal };
            prop_assert_eq!(ratio(ViewParameters { cones: true, ..off() }, facing), 1.0);
            let half_way = (light - point.normalize()).normalize();
            let shining = turned(half_way, normal, turn);
            let light = Light { direction: light.as_dvec3(), highlights: 4.0 };
            prop_assert_eq!(ratio(ViewParameters { light: Some(light), ..off() }, shining), 4.0);
        }
    }
}
