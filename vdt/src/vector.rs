//! Vectors of three doubles. (glam is for camera and drawing maths; its sums may differ between machines, and what is
//! computed here decides bytes of the model.)

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

/// The vector at length one; a vector without a direction stays zero.
pub(crate) fn unit(vector: Vector) -> Vector {
    let length = dot(vector, vector).sqrt();
    if length > 0.0 { vector.map(|component| component / length) } else { [0.0; 3] }
}
