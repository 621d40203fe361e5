//! Vectors of three doubles. (glam is for camera and drawing maths; its sums may differ between machines, and what is
//! computed here decides bytes of the model.) And lengths in single precision that are never too small.

pub(crate) type Vector = [f64; 3];

pub(crate) fn minus(left: Vector, right: Vector) -> Vector {
    [left[0] - right[0], left[1] - right[1], left[2] - right[2]]
}

pub(crate) fn cross(left: Vector, right: Vector) -> Vector {
    [
        left[1] * right[2] - left[2] * right[1],
        left[2] * right[0] - left[0] * right[2],
        left[0] * right[1] - left[1] * right[0],
    ]
}

pub(crate) fn dot(left: Vector, right: Vector) -> f64 {
    left[0] * right[0] + left[1] * right[1] + left[2] * right[2]
}

/// The length of a vector. Not zero unless the vector is, however small it is.
pub(crate) fn length(vector: Vector) -> f64 {
    let largest = vector.iter().fold(0.0_f64, |largest, component| largest.max(component.abs()));
    if largest == 0.0 {
        return 0.0;
    }
    let scaled = vector.map(|component| component / largest);
    largest * dot(scaled, scaled).sqrt()
}

/// The smallest f32 that is not below `value`, or the largest there is.
pub fn rounded_up(value: f64) -> f32 {
    let nearest = (value as f32).min(f32::MAX);
    if f64::from(nearest) < value { nearest.next_up().min(f32::MAX) } else { nearest }
}

/// An f32 that is not below a length that was worked out in double precision by up to 16 operations with positive numbers,
/// each of which may have been rounded down; or the largest f32 there is. 0 stays 0.
pub fn length_not_below(value: f64) -> f32 {
    rounded_up(value * (1.0 + 16.0 * f64::EPSILON))
}

/// The vector at length one; a vector without a direction stays zero.
pub(crate) fn unit(vector: Vector) -> Vector {
    let length = dot(vector, vector).sqrt();
    if length > 0.0 { vector.map(|component| component / length) } else { [0.0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_never_too_small() {
        for (value, expected) in [(0.0, 0.0), (0.5, 0.5), (1e-300, f32::from_bits(1)), (1e300, f32::MAX)] {
            assert_eq!(rounded_up(value), expected);
        }
        assert_eq!((length_not_below(0.0), length_not_below(0.5)), (0.0, 0.5_f32.next_up()));
        assert_eq!((length([0.0; 3]), length([0.0, -3.0, 4.0])), (0.0, 5.0));
        assert!((length([1e-300, 0.0, 1e-300]) / 2e-300_f64 - 0.5_f64.sqrt()).abs() < 1e-12);
    }
}
