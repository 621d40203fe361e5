//! Where on the picture a place of the model is.
//!
//! Places come relative to the model's origin, in single precision; the eye is brought there in double precision. So a mesh far
//! from the origin of its coordinates looks like one at it.

use glam::DVec3;
use navigator::Camera;
use navigator::camera::CameraError;

/// What is nearer to the eye than this is not drawn, in diagonals of the model.
const NEAREST: f64 = 1e-6;

/// A camera, made ready for the places of one model and one size of picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Relative to the model's origin.
    eye: DVec3,
    /// Directions to the right, up and into the picture: the first two as long as one over the tangent of half the angle of view.
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    nearest: f64,
}

/// A place as the eye sees it: in the picture where neither `x` nor `y` is larger than `depth`, whatever their signs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// To the right.
    pub x: f64,
    /// Upwards.
    pub y: f64,
    /// Along the direction of view, in mesh units.
    pub depth: f64,
}

impl Projection {
    /// The projection of a camera into a picture of `width` × `height` points, for a model with this origin and diagonal.
    pub fn new(camera: &Camera, origin: [f64; 3], diagonal: f64, width: u32, height: u32) -> Result<Self, CameraError> {
        let frame = camera.frame()?;
        let tall = camera.half_height();
        let wide = tall * f64::from(width) / f64::from(height.max(1));
        Ok(Projection {
            eye: camera.eye - DVec3::from_array(origin),
            right: frame.right / wide,
            up: frame.up / tall,
            forward: frame.forward,
            nearest: (diagonal * NEAREST).max(f64::MIN_POSITIVE),
        })
    }

    /// A place of the model as the eye sees it.
    pub fn place(&self, position: [f32; 3]) -> Place {
        let to_place = DVec3::from_array(position.map(f64::from)) - self.eye;
        Place { x: self.right.dot(to_place), y: self.up.dot(to_place), depth: self.forward.dot(to_place) }
    }

    /// The least depth that is drawn, in mesh units.
    pub fn nearest(&self) -> f64 {
        self.nearest
    }

    /// The eye, relative to the model's origin.
    pub(crate) fn eye(&self) -> DVec3 {
        self.eye
    }

    /// Directions to the right, up, and into the picture; the first two as long as one over the tangent of half the angle of view.
    pub(crate) fn directions(&self) -> [DVec3; 3] {
        [self.right, self.up, self.forward]
    }

    /// A direction to a light that goes with the eye: over the left shoulder. Of length one.
    pub fn headlight(&self) -> DVec3 {
        (-1.2 * self.forward + self.up.normalize() - self.right.normalize()).normalize()
    }
}
