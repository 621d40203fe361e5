//! What the error of a node on the screen depends on, besides where the eye is (the paper, 3.3.1: "eye parameters, such as
//! eye position and look-at direction, light parameters, such as position and direction, and distance metric function").
//!
//! Each can be switched off alone. None of them changes what a cut is or what is proven of it: they say where it is fine.

use glam::DVec3;
use thiserror::Error;

/// Most that silhouettes or highlights can count more.
pub const MOST_FINER: f32 = 1e6;

/// What counts in the error of a node in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewParameters {
    /// Whether the error of what is outside the view frustum counts less: the less the farther, down to a sixteenth at about
    /// 3 degrees outside. A collapse has to be the same for a frustum that is a degree wider.
    pub frustum: bool,
    /// Whether a sixteenth of the error counts where all normals under the node point away from the eye.
    pub cones: bool,
    /// How many times as much the error counts where some normal under the node may be at right angles to the direction of
    /// view: 1 to [`MOST_FINER`]; 1 is off. Where parts of the surface have no inside, and so no cones, it counts all over
    /// them.
    pub silhouettes: f32,
    /// A light, near whose highlights the error counts more.
    pub light: Option<Light>,
}

/// A light far away, as the sun is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// The direction to the light, of any length but zero, in the coordinates of the input file.
    pub direction: DVec3,
    /// How many times as much the error counts where some normal under the node may be within 15 degrees of half-way between
    /// the directions to the eye and to the light: 1 to [`MOST_FINER`]; 1 is off. A highlight of exponent 20 is above half
    /// its brightness there. Where parts of the surface have no inside, it counts all over them.
    pub highlights: f32,
}

/// What is wrong with view parameters.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ViewParametersError {
    /// Silhouettes cannot count so much.
    #[error("silhouettes cannot count {factor} times as much: give 1 to {MOST_FINER}")]
    Silhouettes {
        /// The factor given.
        factor: f32,
    },
    /// Highlights cannot count so much.
    #[error("highlights cannot count {factor} times as much: give 1 to {MOST_FINER}")]
    Highlights {
        /// The factor given.
        factor: f32,
    },
    /// The light is nowhere.
    #[error("the direction to the light is zero or not finite")]
    NoLight,
}

impl Default for ViewParameters {
    /// Frustum and cones, which save triangles that nobody sees; silhouettes and light, which cost some, are off.
    fn default() -> Self {
        ViewParameters { frustum: true, cones: true, silhouettes: 1.0, light: None }
    }
}

impl ViewParameters {
    /// Whether these can be.
    pub fn check(&self) -> Result<(), ViewParametersError> {
        let can_be = |factor: f32| (1.0..=MOST_FINER).contains(&factor);
        if !can_be(self.silhouettes) {
            return Err(ViewParametersError::Silhouettes { factor: self.silhouettes });
        }
        match self.light {
            Some(light) if !can_be(light.highlights) => {
                Err(ViewParametersError::Highlights { factor: light.highlights })
            }
            Some(light) if light.direction.try_normalize().is_none() => Err(ViewParametersError::NoLight),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_is_refused() {
        let usual = ViewParameters::default();
        assert_eq!(usual.check(), Ok(()));
        for factor in [0.99, -1.0, f32::NAN, f32::INFINITY] {
            let said = ViewParameters { silhouettes: factor, ..usual }.check().unwrap_err().to_string();
            assert!(said.starts_with("silhouettes cannot count"), "{said}");
            let light = Light { direction: DVec3::X, highlights: factor };
            let said = ViewParameters { light: Some(light), ..usual }.check().unwrap_err().to_string();
            assert!(said.starts_with("highlights cannot count"), "{said}");
        }
        for direction in [DVec3::ZERO, DVec3::NAN, DVec3::INFINITY] {
            let light = Light { direction, highlights: 2.0 };
            let parameters = ViewParameters { light: Some(light), ..usual };
            assert_eq!(parameters.check(), Err(ViewParametersError::NoLight));
        }
        let light = Light { direction: DVec3::X, highlights: MOST_FINER };
        assert_eq!(ViewParameters { silhouettes: MOST_FINER, light: Some(light), ..usual }.check(), Ok(()));
    }
}
