//! The view parameters of a frame (the paper, 3.3.1): how large the error of a node is on the screen.
//!
//! The error of a node in pixels is `switch * height / (2 tan(fov / 2)) / distance`, where the distance is that from
//! the eye to the node's bounding sphere; it counts as no less than a ten-thousandth of the model's diagonal, nearer
//! than any near plane, so that with the eye inside the sphere the error is large but finite. A sixteenth of that
//! counts where the sphere is outside the view frustum, or where every normal in the node's cone points away from the
//! eye from every point in the sphere.
//!
//! Everything is measured in a unit in which the model is about one wide, a power of two of the mesh's: so squares of
//! lengths stay within single precision whatever the unit of the mesh, and nothing else changes.
//!
//! Spheres and cones nest and switch values never fall towards the root, and every test here says of a node what
//! holds for its descendants too; so a node's error is never below that of its descendants (up to rounding), and the
//! nodes with too large an error form the tops of the trees.

use glam::{DVec3, Vec3};
use metanode::header::Header;
use metanode::page::NormalCone;

use crate::camera::{Camera, CameraError};

/// By how much the error of what cannot be seen is divided.
pub const UNSEEN_DIVISOR: f32 = 16.0;

/// The least distance, in diagonals of the model's bounding box.
const NEAREST: f64 = 1e-4;

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
    /// Units of the view in a mesh unit: a power of two.
    unit: f32,
    eye: Vec3,
    /// Inward normals of the five planes through the eye: behind, right, left, top, bottom.
    planes: [Vec3; 5],
    /// Pixels that a length takes at a distance of that length.
    scale: f32,
    /// The least distance that counts.
    nearest: f32,
}

/// A node as a view sees it, in the unit of the view.
#[derive(Debug, Clone, Copy)]
struct Seen {
    to_node: Vec3,
    radius: f32,
    switch: f32,
    cone: NormalCone,
}

/// The power of two, within the range of single precision, that brings `length` nearest below one.
fn unit_for(length: f64) -> f32 {
    let exponent = if length > 0.0 { -length.log2().ceil() } else { 0.0 };
    exponent.clamp(-126.0, 126.0).exp2() as f32
}

impl View {
    /// The view of a `width` × `height` pixel screen, of the model with this header.
    pub fn new(camera: &Camera, header: &Header, width: u32, height: u32) -> Result<Self, CameraError> {
        let frame = camera.frame()?;
        let tall = camera.half_height();
        let wide = tall * f64::from(width) / f64::from(height.max(1));
        let planes = [
            frame.forward,
            frame.forward * wide - frame.right,
            frame.forward * wide + frame.right,
            frame.forward * tall - frame.up,
            frame.forward * tall + frame.up,
        ];
        let unit = unit_for(header.diagonal());
        Ok(View {
            unit,
            eye: ((camera.eye - DVec3::from_array(header.origin)) * f64::from(unit)).as_vec3(),
            planes: planes.map(|normal| normal.normalize().as_vec3()),
            scale: (f64::from(height) / (2.0 * tall)) as f32,
            nearest: ((header.diagonal() * f64::from(unit) * NEAREST) as f32).max(f32::MIN_POSITIVE),
        })
    }

    #[inline]
    fn seen(&self, sphere: &Sphere) -> Seen {
        Seen {
            to_node: Vec3::from_array(sphere.position) * self.unit - self.eye,
            radius: sphere.radius * self.unit,
            switch: sphere.switch * self.unit,
            cone: sphere.cone,
        }
    }

    /// Error of a node in pixels.
    pub fn pixel_error(&self, sphere: &Sphere) -> f32 {
        self.error_of(&self.seen(sphere))
    }

    fn error_of(&self, node: &Seen) -> f32 {
        let distance = (node.to_node.length() - node.radius).max(self.nearest);
        let error = node.switch * self.scale / distance;
        if self.is_unseen(node) { error / UNSEEN_DIVISOR } else { error }
    }

    fn is_unseen(&self, node: &Seen) -> bool {
        self.outside(node) || turned_away(node.to_node, node.radius, node.cone)
    }

    /// Whether the sphere can reach into the picture.
    pub fn can_see(&self, sphere: &Sphere) -> bool {
        !self.outside(&self.seen(sphere))
    }

    /// The test against one threshold, with what depends on the threshold alone done ahead.
    pub fn against(&self, threshold: f32) -> Threshold<'_> {
        Threshold {
            view: self,
            threshold,
            reach: self.scale / threshold,
            unseen_reach: self.scale / threshold / UNSEEN_DIVISOR,
        }
    }

    fn outside(&self, node: &Seen) -> bool {
        self.planes.iter().any(|normal| normal.dot(node.to_node) < -node.radius)
    }
}

/// Whether all normals in the cone point away from the eye at every point of the sphere: whether the sphere lies in
/// the cone of points, with its tip at the eye, around the axis, with half-angle 90 degrees less the normals' cone's.
/// The distance of a point inside such a cone from its surface is `cos(angle) * along - sin(angle) * across`.
fn turned_away(to_node: Vec3, radius: f32, cone: NormalCone) -> bool {
    if cone.sine == u8::MAX {
        return false;
    }
    let axis = Vec3::from_array(cone.axis.map(f32::from));
    let along = axis.dot(to_node);
    if along <= 0.0 {
        return false;
    }
    let along = along / axis.length();
    if along <= radius {
        return false;
    }
    let sine = f32::from(cone.sine) / 254.0;
    let cosine = (1.0 - sine * sine).max(0.0).sqrt();
    let across = (to_node.length_squared() - along * along).max(0.0).sqrt();
    // The slack keeps rounding on the safe side.
    cosine * along - sine * across >= radius + 1e-5 * along
}

/// See [`View::against`].
#[derive(Debug, Clone, Copy)]
pub struct Threshold<'a> {
    view: &'a View,
    threshold: f32,
    /// How far away, in multiples of its switch value, a node that is seen has just this error.
    reach: f32,
    /// The same for one that is not seen.
    unseen_reach: f32,
}

/// What part of a squared distance rounding may be wrong by, and much more.
const ROUNDING: f32 = 1e-4;

impl Threshold<'_> {
    /// Whether the error is above the threshold: just as [`View::pixel_error`] says, but for nearly all nodes without a
    /// root or a division, and for most without a look at frustum and cone.
    #[inline]
    pub fn is_exceeded(&self, sphere: &Sphere) -> bool {
        let node = self.view.seen(sphere);
        let square = node.to_node.length_squared();
        let (reach, unseen_reach) = (node.switch * self.reach, node.switch * self.unseen_reach);
        let (seen, unseen) = (reach + node.radius, unseen_reach + node.radius);
        let (seen, unseen) = (seen * seen, unseen * unseen);
        if square > seen * (1.0 + ROUNDING) {
            return false;
        }
        if unseen_reach > self.view.nearest && square < unseen * (1.0 - ROUNDING) {
            return true;
        }
        let only_seen =
            reach > self.view.nearest && square < seen * (1.0 - ROUNDING) && square > unseen * (1.0 + ROUNDING);
        if only_seen { !self.view.is_unseen(&node) } else { self.view.error_of(&node) > self.threshold }
    }

    /// The error in pixels, where it is above the threshold.
    #[inline]
    pub fn exceeded(&self, sphere: &Sphere) -> Option<f32> {
        self.is_exceeded(sphere).then(|| self.view.pixel_error(sphere))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use proptest::prelude::*;
    use vdt::tree::Tree;

    use super::*;
    use crate::testing;

    static VIEW: LazyLock<View> = LazyLock::new(view);

    fn view() -> View {
        let camera: Camera = "100 0 0  101 0 0  0 0 1  90".parse().unwrap();
        let model = testing::model_of(&Tree { origin: [100.0, 0.0, 0.0], ..testing::grid_tree(30, 40, 1) });
        View::new(&camera, model.header(), 200, 100).unwrap()
    }

    fn sphere(position: [f32; 3], radius: f32) -> Sphere {
        Sphere { position, radius, switch: 1.0, cone: NormalCone::EVERYTHING }
    }

    #[test]
    fn errors_in_pixels() {
        let view = view();
        // 100 pixels are 2 units at distance 1.
        assert_eq!(view.pixel_error(&sphere([10.0, 0.0, 0.0], 0.0)), 5.0);
        assert_eq!(view.pixel_error(&sphere([10.0, 0.0, 0.0], 5.0)), 10.0);
        // The diagonal is about 50 units: 0.005 at the least.
        assert!((9_000.0..11_000.0).contains(&view.pixel_error(&sphere([1.0, 0.0, 0.0], 1.0))));
        assert!((9_000.0..11_000.0).contains(&view.pixel_error(&sphere([1.0, 0.0, 0.0], 7.0))));
        let behind = view.pixel_error(&sphere([-10.0, 0.0, 0.0], 0.0));
        assert_eq!(behind, 5.0 / 16.0);
        // Half the picture is 1 unit high and 2 units wide at distance 1.
        assert!(view.can_see(&sphere([10.0, 19.0, 9.0], 0.0)));
        assert!(!view.can_see(&sphere([10.0, 19.0, 11.0], 0.0)));
        assert!(!view.can_see(&sphere([10.0, 21.0, 0.0], 0.1)));
        assert!(view.can_see(&sphere([10.0, 21.0, 0.0], 1.0)));
        assert!(view.can_see(&sphere([-0.5, 0.0, 0.0], 1.0)));
    }

    #[test]
    fn cones_that_point_away_count_less() {
        let view = view();
        let error = |axis: [i8; 3], sine: u8, radius: f32| {
            let cone = NormalCone { axis, sine };
            view.pixel_error(&Sphere { cone, ..sphere([10.0, 0.0, 0.0], radius) })
        };
        assert!(error([127, 0, 0], 100, 0.1) < 1.0);
        assert!(error([-127, 0, 0], 100, 0.1) > 1.0);
        assert!(error([0, 0, 127], 1, 0.1) > 1.0);
        assert!(error([127, 0, 0], 255, 0.1) > 1.0);
        // 45 degrees of axis and 44 of cone leave one degree for the sphere.
        assert!(error([90, 90, 0], 176, 0.01) < 1.0);
        assert!(error([90, 90, 0], 176, 0.5) > 1.0);
        assert!(error([0, 0, 0], 0, 0.1) > 1.0);
    }

    proptest! {
        /// A node inside another, with a smaller error, has a smaller error on the screen.
        #[test]
        fn nested_nodes_have_nested_errors(
            position in prop::array::uniform3(-20.0_f32..20.0),
            radius in 0.0_f32..10.0,
            part in 0.0_f32..1.0,
            towards in prop::array::uniform3(-1.0_f32..1.0),
            axis in prop::array::uniform3(-127_i8..=127),
            sine in 0_u8..=255,
        ) {
            let view = *VIEW;
            let cone = NormalCone { axis, sine };
            let parent = Sphere { position, radius, switch: 1.0, cone };
            let inner = radius * part;
            let step = Vec3::from_array(towards).clamp_length_max(1.0) * (radius - inner);
            let child = Sphere {
                position: (Vec3::from_array(position) + step).to_array(),
                radius: inner,
                switch: 0.9,
                cone: NormalCone { axis, sine: sine / 2 },
            };
            prop_assert!(view.pixel_error(&child) <= view.pixel_error(&parent));
            for threshold in [0.0, 0.1, 1.0, 10.0] {
                let error = view.pixel_error(&parent);
                prop_assert_eq!(view.against(threshold).exceeded(&parent), (error > threshold).then_some(error));
                let scaled = Sphere { switch: threshold.max(0.01) * part * 10.0, ..parent };
                let error = view.pixel_error(&scaled);
                prop_assert_eq!(view.against(threshold).is_exceeded(&scaled), error > threshold);
            }
        }
    }
}
