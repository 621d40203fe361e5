//! Whether the mesh of a front is as closed as the full mesh: exactly, whatever is seen of it.
//!
//! A side is open where an odd number of triangles has it. A front is the full mesh with each leaf moved to the active node that
//! it is under, so its open sides are those of the full mesh, moved so: of those that come to lie on each other two and two are
//! closed, and what becomes a point is gone. Any other open side is a crack, or the border of a hole.
//!
//! Memory: 4 bytes for each leaf, 8 for each side of the front and, at first, 24 for each triangle of the full mesh.

use navigator::Navigator;

/// The open sides of a full mesh.
#[derive(Debug)]
pub struct OpenSides {
    leaves: usize,
    sides: Vec<[u32; 2]>,
}

impl OpenSides {
    /// Those of triangles over leaves.
    pub fn new(leaves: usize, triangles: &[[u32; 3]]) -> Self {
        OpenSides { leaves, sides: odd(triangles.iter().flat_map(sides).collect()) }
    }

    /// How many sides of what is drawn are open that should not be, or closed that should be open.
    pub fn wrong(&self, navigator: &Navigator) -> u64 {
        let mut above = vec![0; self.leaves];
        for node in navigator.active_nodes() {
            above[node.leaf as usize..node.end_leaf as usize].fill(node.node);
        }
        self.wrong_among(&above, navigator.triangle_stream())
    }

    /// The same, where it is known which vertex each leaf is under.
    fn wrong_among(&self, above: &[u32], triangles: &[[u32; 3]]) -> u64 {
        let drawn = triangles.iter().filter(|[a, b, c]| a != b && b != c && c != a).flat_map(sides);
        let expected = self.sides.iter().map(|side| side.map(|leaf| above[leaf as usize]));
        // What is there on both sides is there an even number of times.
        let expected = odd(expected.filter(|[a, b]| a != b).collect());
        odd(drawn.chain(expected).collect()).len() as u64
    }
}

fn sides(&[a, b, c]: &[u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// Those that are there an odd number of times, whichever way round.
fn odd(mut sides: Vec<[u32; 2]>) -> Vec<[u32; 2]> {
    sides.iter_mut().for_each(|side| side.sort_unstable());
    sides.sort_unstable();
    sides.chunk_by(|left, right| left == right).filter(|same| same.len() % 2 == 1).map(|same| same[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_open_that_should_not_be() {
        // A fan about leaf 0, open outside.
        let fan = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]];
        let open = OpenSides::new(5, &fan);
        assert_eq!(open.sides, [[1, 2], [1, 4], [2, 3], [3, 4]]);
        let each = [0, 1, 2, 3, 4];
        assert_eq!(open.wrong_among(&each, &fan), 0);
        // Places without a triangle do not count; a triangle that is missing does, with three sides.
        assert_eq!(open.wrong_among(&each, &[[0; 3], fan[0], fan[1], fan[2], fan[3]]), 0);
        assert_eq!(open.wrong_among(&each, &fan[1..]), 3);
        // Leaf 1 under leaf 0: two triangles are left, and their four sides.
        let above = [0, 0, 2, 3, 4];
        assert_eq!(open.wrong_among(&above, &[[0, 2, 3], [0, 3, 4]]), 0);
        assert_eq!(open.wrong_among(&above, &[[0, 2, 3]]), 3);
        // All in one point; and folded into one side.
        assert_eq!(open.wrong_among(&[0; 5], &[]), 0);
        assert_eq!(open.wrong_among(&[0, 0, 3, 3, 0], &[]), 0);
    }
}
