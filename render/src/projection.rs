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
    /// Of the picture, in points.
    width: f64,
    height: f64,
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
            width: width.into(),
            height: height.into(),
        })
    }

    /// A place of the model as the eye sees it.
    pub fn place(&self, position: [f32; 3]) -> Place {
        let to_place = DVec3::from_array(position.map(f64::from)) - self.eye;
        Place { x: self.right.dot(to_place), y: self.up.dot(to_place), depth: self.forward.dot(to_place) }
    }

    /// The place of the model that the middle of a point shows, where the surface there has this depth: what [`Projection::place`]
    /// brings to that point. Points are counted from the top left corner.
    pub fn seen_at(&self, column: u32, row: u32, depth: f64) -> DVec3 {
        let x = (2.0 * (f64::from(column) + 0.5) / self.width - 1.0) * depth;
        let y = (1.0 - 2.0 * (f64::from(row) + 0.5) / self.height) * depth;
        let (right, up) = (self.right / self.right.length_squared(), self.up / self.up.length_squared());
        self.eye + right * x + up * y + self.forward * depth
    }

    /// The projection for a picture of a part of this one: of the square about the middle of a point that is so many points wide.
    /// It is for drawing only: [`Projection::seen_at`] knows places by points of the whole.
    pub fn part(&self, column: u32, row: u32, points: f64) -> Self {
        let x = 2.0 * (f64::from(column) + 0.5) / self.width - 1.0;
        let y = 1.0 - 2.0 * (f64::from(row) + 0.5) / self.height;
        Projection {
            right: (self.right - self.forward * x) * (self.width / points),
            up: (self.up - self.forward * y) * (self.height / points),
            ..*self
        }
    }

    /// How high a point of the picture is at this depth, in mesh units.
    pub fn point_height(&self, depth: f64) -> f64 {
        2.0 * depth / (self.up.length() * self.height)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_found_again_from_its_point() {
        let camera: Camera = "1000 2000 3000, 1004 1998 3001, 0 0 1, 50".parse().unwrap();
        let origin = [990.0, 2000.0, 3000.0];
        let projection = Projection::new(&camera, origin, 10.0, 320, 200).unwrap();
        for (column, row, depth) in [(0, 0, 1.0), (319, 199, 7.5), (160, 100, 1e3), (17, 133, 1e-2)] {
            let seen = projection.seen_at(column, row, depth);
            let place = projection.place(seen.as_vec3().to_array());
            let on_picture = [(0.5 + 0.5 * place.x / place.depth) * 320.0, (0.5 - 0.5 * place.y / place.depth) * 200.0];
            // Places are in single precision.
            let rounding = 1e-6 * (10.0 + depth) / projection.point_height(depth);
            assert!((on_picture[0] - f64::from(column) - 0.5).abs() < rounding, "{on_picture:?}");
            assert!((on_picture[1] - f64::from(row) - 0.5).abs() < rounding, "{on_picture:?}");
            assert!((place.depth - depth).abs() < 1e-5 * (1.0 + depth));
            // In the middle of the part about it, at the same depth.
            let part = projection.part(column, row, 5.0).place(seen.as_vec3().to_array());
            let off = [part.x, part.y].map(|across| across / part.depth * 2.5);
            assert!(off.iter().all(|off| off.abs() < rounding), "{off:?}");
            assert_eq!(part.depth, place.depth);
            // The point below is by one height farther down.
            let below = projection.seen_at(column, row + 1, depth);
            assert!((seen.distance(below) / projection.point_height(depth) - 1.0).abs() < 1e-6);
        }
    }
}
