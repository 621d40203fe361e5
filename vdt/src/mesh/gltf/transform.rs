//! Node transforms, composed in f64.
//!
//! Format: glTF 2.0 specification, section 3.5.2 ("Transformations").

use super::document::Node;
use crate::vector::{cross, dot};

/// An affine map, as the upper three rows of a matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Transform {
    rows: [[f64; 4]; 3],
}

impl Transform {
    const IDENTITY: Transform = Transform { rows: [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]] };

    /// The transform of a node to its parent; none where it changes nothing.
    pub fn of(node: &Node) -> Option<Self> {
        let transform = match node.matrix {
            Some(columns) => Transform {
                rows: [0, 1, 2].map(|row| [columns[row], columns[4 + row], columns[8 + row], columns[12 + row]]),
            },
            None => Self::from_parts(
                node.translation.unwrap_or([0.0; 3]),
                node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
                node.scale.unwrap_or([1.0; 3]),
            ),
        };
        (transform != Self::IDENTITY).then_some(transform)
    }

    /// Scales, then rotates, then moves.
    fn from_parts(translation: [f64; 3], [x, y, z, w]: [f64; 4], scale: [f64; 3]) -> Self {
        let rotation = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ];
        let mut rows = [[0.0; 4]; 3];
        for ((row, rotated), moved) in rows.iter_mut().zip(rotation).zip(translation) {
            *row = [rotated[0] * scale[0], rotated[1] * scale[1], rotated[2] * scale[2], moved];
        }
        Transform { rows }
    }

    /// First `inner`, then `self`.
    pub fn after(&self, inner: &Transform) -> Self {
        let [first, second, third] = inner.rows;
        let rows = self.rows.map(|[x, y, z, moved]| {
            let mut row = [0.0; 4];
            for (column, value) in row.iter_mut().enumerate() {
                *value = x * first[column] + y * second[column] + z * third[column];
            }
            row[3] += moved;
            row
        });
        Transform { rows }
    }

    /// Where a point goes.
    pub fn apply(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        self.rows.map(|row| row[0] * x + row[1] * y + row[2] * z + row[3])
    }

    /// Where a normal goes: as the plane does that it stands on. It is of length 1 then, or zero if it has none.
    pub fn apply_to_normal(&self, normal: [f32; 3]) -> [f32; 3] {
        let [a, b, c] = self.rows.map(|row| [row[0], row[1], row[2]]);
        let side = if self.mirrors() { -1.0 } else { 1.0 };
        let normal = normal.map(f64::from);
        // The cofactors are the inverse transpose times the determinant.
        let turned = [cross(b, c), cross(c, a), cross(a, b)].map(|row| side * dot(row, normal));
        let length = dot(turned, turned).sqrt();
        turned.map(|value| if length > 0.0 { (value / length) as f32 } else { 0.0 })
    }

    /// Whether left becomes right, so that triangles must be turned to keep their outside.
    pub fn mirrors(&self) -> bool {
        let [a, b, c] = self.rows;
        let determinant = a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0]);
        determinant < 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quarter turn about z.
    const QUARTER: [f64; 4] = [0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2];

    fn close(found: [f64; 3], expected: [f64; 3]) -> bool {
        found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12)
    }

    #[test]
    fn a_node_without_a_change_has_no_transform() {
        assert_eq!(Transform::of(&Node::default()), None);
        let identity = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(Transform::of(&Node { matrix: Some(identity), ..Node::default() }), None);
        let parts = Node { rotation: Some([0.0, 0.0, 0.0, 1.0]), scale: Some([1.0; 3]), ..Node::default() };
        assert_eq!(Transform::of(&parts), None);
    }

    #[test]
    fn parts_are_applied_from_scale_to_translation() {
        let node = Node {
            translation: Some([10.0, 20.0, 30.0]),
            rotation: Some(QUARTER),
            scale: Some([2.0, 3.0, 4.0]),
            ..Node::default()
        };
        let transform = Transform::of(&node).unwrap();
        assert!(close(transform.apply([1.0, 0.0, 0.0]), [10.0, 22.0, 30.0]));
        assert!(close(transform.apply([0.0, 1.0, 1.0]), [7.0, 20.0, 34.0]));
        assert!(!transform.mirrors());
    }

    #[test]
    fn normals_stay_on_their_planes() {
        let flat = Transform::from_parts([9.0, 9.0, 9.0], [0.0, 0.0, 0.0, 1.0], [1.0, 4.0, 1.0]);
        let normal = flat.apply_to_normal([1.0, 1.0, 0.0]).map(f64::from);
        // The plane x + y = 0 becomes x + y / 4 = 0.
        let expected = [4.0 / 17_f64.sqrt(), 1.0 / 17_f64.sqrt(), 0.0];
        assert!(normal.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6), "{normal:?}");
        let mirror = Transform::from_parts([0.0; 3], QUARTER, [1.0, 1.0, -2.0]);
        let turned = mirror.apply_to_normal([0.0, 0.0, 3.0]);
        assert!((turned[2] + 1.0).abs() < 1e-6, "{turned:?}");
        assert!((mirror.apply_to_normal([2.0, 0.0, 0.0])[1] - 1.0).abs() < 1e-6);
        assert_eq!(mirror.apply_to_normal([0.0; 3]), [0.0; 3]);
    }

    #[test]
    fn a_matrix_is_read_column_by_column() {
        let columns = [0.0, 2.0, 0.0, 0.0, -3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0, 0.0, 10.0, 20.0, 30.0, 1.0];
        let transform = Transform::of(&Node { matrix: Some(columns), ..Node::default() }).unwrap();
        assert_eq!(transform.apply([1.0, 0.0, 0.0]), [10.0, 22.0, 30.0]);
        assert_eq!(transform.apply([0.0, 1.0, 1.0]), [7.0, 20.0, 34.0]);
    }

    #[test]
    fn composition_applies_the_inner_one_first() {
        let outer = Transform::from_parts([1.0, 2.0, 3.0], QUARTER, [1.0, 1.0, -2.0]);
        let inner = Transform::from_parts([5.0, -6.0, 7.0], [0.5, 0.5, 0.5, 0.5], [3.0, 0.5, 1.0]);
        let composed = outer.after(&inner);
        for point in [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [3.0, -4.0, 5.0]] {
            assert!(close(composed.apply(point), outer.apply(inner.apply(point))));
        }
        assert!(outer.mirrors() && !inner.mirrors() && composed.mirrors());
        assert!(!outer.after(&outer).mirrors());
    }
}
