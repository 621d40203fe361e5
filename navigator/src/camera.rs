//! A camera: where it stands, what it looks at, and how wide. Its text form is a line of ten numbers.
//!
//! Coordinates are those of the input file; the model's local origin is subtracted, in double precision, where a
//! [`View`](crate::view::View) is made.

use std::fmt;
use std::str::FromStr;

use glam::DVec3;
use thiserror::Error;

/// Where the viewer stands and looks (the paper, 3.3.1: "eye position and look-at direction").
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Position of the eye, in the coordinates of the input file.
    pub eye: DVec3,
    /// A point in the middle of the picture.
    pub target: DVec3,
    /// A direction that points upwards in the picture; of any length, not parallel to the direction of view.
    pub up: DVec3,
    /// Vertical angle of view, in degrees, between 0 and 180.
    pub fov_degrees: f64,
}

/// What is wrong with a camera.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CameraError {
    /// Not ten numbers.
    #[error(
        "a camera is ten numbers (eye x y z, target x y z, up x y z, vertical field of view in degrees), \
         here are {found}"
    )]
    Count {
        /// How many words there are.
        found: usize,
    },
    /// A word is not a number.
    #[error("`{word}` is not a number")]
    Number {
        /// The word.
        word: String,
    },
    /// One of the ten numbers is infinite or not a number.
    #[error("a number of the camera is not finite")]
    NotFinite,
    /// Eye and target are the same point, or too far away for double precision.
    #[error("the eye and the target are the same point: there is no direction of view")]
    NoDirection,
    /// The up direction is zero or parallel to the direction of view.
    #[error("the up direction is zero or parallel to the direction of view")]
    NoUp,
    /// The angle of view cannot be.
    #[error("a vertical field of view of {degrees} degrees cannot be: it must lie between 0 and 180")]
    FieldOfView {
        /// The angle given.
        degrees: f64,
    },
}

/// The directions that a camera spans, of unit length and at right angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Into the picture.
    pub forward: DVec3,
    /// To the right of the picture.
    pub right: DVec3,
    /// To its top.
    pub up: DVec3,
}

impl Camera {
    /// A camera that stands at `eye` and looks at `target`, with z upwards (y where the view is along z).
    pub fn looking_at(eye: DVec3, target: DVec3, fov_degrees: f64) -> Self {
        let direction = (target - eye).normalize_or_zero();
        let up = if direction.cross(DVec3::Z).length() < 1e-3 { DVec3::Y } else { DVec3::Z };
        Camera { eye, target, up, fov_degrees }
    }

    /// The camera's directions; an error where the camera cannot be.
    pub fn frame(&self) -> Result<Frame, CameraError> {
        if !(self.eye.is_finite() && self.target.is_finite() && self.up.is_finite() && self.fov_degrees.is_finite()) {
            return Err(CameraError::NotFinite);
        }
        if !(self.fov_degrees > 0.0 && self.fov_degrees < 180.0) {
            return Err(CameraError::FieldOfView { degrees: self.fov_degrees });
        }
        let forward = (self.target - self.eye).try_normalize().ok_or(CameraError::NoDirection)?;
        let upwards = self.up.try_normalize().ok_or(CameraError::NoUp)?;
        let right = forward.cross(upwards);
        if right.length() < 1e-9 {
            return Err(CameraError::NoUp);
        }
        let right = right.normalize();
        Ok(Frame { forward, right, up: right.cross(forward) })
    }

    /// Tangent of half the vertical angle of view.
    pub fn half_height(&self) -> f64 {
        (self.fov_degrees.to_radians() / 2.0).tan()
    }
}

impl FromStr for Camera {
    type Err = CameraError;

    /// Ten numbers, with spaces or commas between them.
    fn from_str(text: &str) -> Result<Self, CameraError> {
        let mut numbers = [0.0; 10];
        let mut found = 0;
        for word in text.split([' ', '\t', ',', '\r']).filter(|word| !word.is_empty()) {
            if let Some(number) = numbers.get_mut(found) {
                *number = word.parse().map_err(|_| CameraError::Number { word: word.to_owned() })?;
            }
            found += 1;
        }
        if found != numbers.len() {
            return Err(CameraError::Count { found });
        }
        let vector = |first: usize| DVec3::new(numbers[first], numbers[first + 1], numbers[first + 2]);
        let camera = Camera { eye: vector(0), target: vector(3), up: vector(6), fov_degrees: numbers[9] };
        camera.frame().map(|_| camera)
    }
}

impl fmt::Display for Camera {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for vector in [self.eye, self.target, self.up] {
            write!(out, "{} {} {} ", vector.x, vector.y, vector.z)?;
        }
        write!(out, "{}", self.fov_degrees)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_survives_its_text_form() {
        let camera: Camera = "1 2 3, 4.5 5 -6e1, 0 0 1, 60".parse().unwrap();
        assert_eq!(camera.target, DVec3::new(4.5, 5.0, -60.0));
        assert_eq!(camera.to_string().parse::<Camera>(), Ok(camera));
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let parse = |text: &str| text.parse::<Camera>().unwrap_err();
        assert_eq!(parse("1 2 3"), CameraError::Count { found: 3 });
        assert_eq!(parse("1 2 3 4 5 6 0 0 1 60 7"), CameraError::Count { found: 11 });
        assert_eq!(parse("1 2 3 4 5 six 0 0 1 60"), CameraError::Number { word: "six".into() });
        assert_eq!(parse("1 2 3 4 5 NaN 0 0 1 60"), CameraError::NotFinite);
        assert_eq!(parse("1 2 3 1 2 3 0 0 1 60"), CameraError::NoDirection);
        assert_eq!(parse("1 2 3 1 2 4 0 0 1 60"), CameraError::NoUp);
        assert_eq!(parse("1 2 3 1 2 4 0 0 0 60"), CameraError::NoUp);
        assert_eq!(parse("1 2 3 4 5 6 0 0 1 180"), CameraError::FieldOfView { degrees: 180.0 });
        assert_eq!(parse("1 2 3 4 5 6 0 0 1 0"), CameraError::FieldOfView { degrees: 0.0 });
    }

    #[test]
    fn looking_straight_down_has_an_up() {
        for target in [DVec3::Z, -DVec3::Z, DVec3::X] {
            let frame = Camera::looking_at(DVec3::ZERO, target, 60.0).frame().unwrap();
            assert!((frame.right.cross(frame.forward) - frame.up).length() < 1e-12);
        }
    }
}
