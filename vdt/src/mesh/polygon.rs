//! The corners of one face while they are collected, and the triangles of a strip: what several formats share.

use std::path::Path;

use super::MeshError;

/// The most corners that one face may have: 8 MiB of RAM. A face of more is refused with an error.
pub(super) const CORNER_LIMIT: usize = 1 << 20;

/// The corners of the face that is being read.
#[derive(Debug, Default)]
pub(super) struct Corners {
    list: Vec<i64>,
}

impl Corners {
    /// Begins the next face.
    pub fn clear(&mut self) {
        self.list.clear();
    }

    /// The corners so far.
    pub fn as_slice(&self) -> &[i64] {
        &self.list
    }

    /// The next corner. `place` says where it is, for the message that there are too many.
    #[inline]
    pub fn push(&mut self, index: i64, path: &Path, place: impl FnOnce() -> String) -> Result<(), MeshError> {
        if self.list.len() == CORNER_LIMIT {
            return Err(MeshError::Unsupported {
                path: path.to_path_buf(),
                feature: format!("{}: a face of more than {CORNER_LIMIT} corners", place()),
                advice: "cut it into triangles first".to_string(),
            });
        }
        self.list.push(index);
        Ok(())
    }
}

/// Cuts a triangle strip into triangles, each in the orientation of the first.
#[derive(Debug, Default)]
pub(super) struct Strip {
    previous: [i64; 2],
    length: usize,
    odd: bool,
}

impl Strip {
    /// The strip ends; the next corner begins another.
    pub fn restart(&mut self) {
        *self = Strip::default();
    }

    /// The next corner of the strip, and the triangle that it completes. Triangles with two equal corners are part
    /// of how strips are chained, not of the mesh: they are left out.
    #[inline]
    pub fn push(&mut self, corner: i64) -> Option<[i64; 3]> {
        let [first, second] = self.previous;
        self.previous = [second, corner];
        if self.length < 2 {
            self.length += 1;
            return None;
        }
        let triangle = if self.odd { [second, first, corner] } else { [first, second, corner] };
        self.odd = !self.odd;
        (first != second && second != corner && corner != first).then_some(triangle)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangles_of(corners: &[i64]) -> Vec<[i64; 3]> {
        let mut strip = Strip::default();
        corners.iter().filter_map(|&corner| strip.push(corner)).collect()
    }

    #[test]
    fn every_second_triangle_of_a_strip_is_turned() {
        assert_eq!(triangles_of(&[0, 1, 2, 3, 4]), [[0, 1, 2], [2, 1, 3], [2, 3, 4]]);
        assert!(triangles_of(&[0, 1]).is_empty());
    }

    #[test]
    fn a_degenerate_triangle_keeps_the_alternation() {
        assert_eq!(triangles_of(&[0, 1, 2, 2, 3, 4, 5]), [[0, 1, 2], [3, 2, 4], [3, 4, 5]][..].to_vec());
        assert_eq!(triangles_of(&[5, 5, 5, 5]).len(), 0);
    }

    #[test]
    fn a_restarted_strip_begins_anew() {
        let mut strip = Strip::default();
        let mut found = Vec::new();
        for corner in [0, 1, 2, 3] {
            found.extend(strip.push(corner));
        }
        strip.restart();
        for corner in [4, 5, 6] {
            found.extend(strip.push(corner));
        }
        assert_eq!(found, [[0, 1, 2], [2, 1, 3], [4, 5, 6]]);
    }

    #[test]
    fn a_face_of_too_many_corners_is_refused() {
        let mut corners = Corners::default();
        for index in 0..CORNER_LIMIT as i64 {
            corners.push(index, Path::new("file"), String::new).unwrap();
        }
        let error = corners.push(0, Path::new("file"), || "face 7".to_string()).unwrap_err().to_string();
        assert!(error.starts_with("file: face 7: a face of more than 1048576 corners is not supported"), "{error}");
        corners.clear();
        assert!(corners.as_slice().is_empty());
    }
}
