//! The triangles around a vertex in the order in which they lie, beginning at the edge that collapses.
//!
//! Let the corners around the vertex be w_0, w_1, ... with w_0 the vertex that stays. Old triangle j has the corners w_j and
//! w_j+1. The first one dies, and so does the last one where the fan is closed; each other one, j, becomes the new
//! triangle j - 1, a *sector* of the new surface. Sectors s - 1 and s meet at *spoke* s, from the vertex that stays to w_s+1.

/// A fan with more triangles is not looked at as one.
const MOST_TRIANGLES: usize = 60;

/// The order of the triangles around a vertex.
#[derive(Debug, Default)]
pub(super) struct Fan {
    /// The triangles, as indices into the ring.
    pub order: Vec<usize>,
    /// The corners w_0, w_1, ...; one more than triangles. In a closed fan the last is the first.
    pub corners: Vec<u32>,
}

impl Fan {
    /// How many triangles are left of it.
    pub fn sectors(&self) -> usize {
        self.order.len().saturating_sub(if self.is_closed() { 2 } else { 1 })
    }

    /// Whether the last triangle is next to the first one.
    pub fn is_closed(&self) -> bool {
        self.corners.first() == self.corners.last()
    }

    /// Puts a ring in order: it has, for each triangle around a vertex, the corners after it. `false` where the triangles
    /// are not one fan that begins or ends at `stays`: non-manifold, of several parts, or of disagreeing orientation.
    pub fn arrange(&mut self, ring: &[[u32; 2]], stays: u32) -> bool {
        self.order.clear();
        self.corners.clear();
        if ring.len() > MOST_TRIANGLES {
            return false;
        }
        // Which of a triangle's two corners leads on to the next one.
        let (mut at, mut count) = ([0; 2], [0; 2]);
        for (index, pair) in ring.iter().enumerate() {
            for side in 0..2 {
                if pair[side] == stays {
                    (at[side], count[side]) = (index, count[side] + 1);
                }
            }
        }
        // Forward where the first triangle has `stays` right after the vertex; backward where only the last one has it.
        let (start, onward) = match count {
            [1, 0 | 1] => (at[0], 1),
            [0, 1] => (at[1], 0),
            _ => return false,
        };
        self.corners.push(stays);
        let mut index = start;
        loop {
            self.order.push(index);
            let corner = ring[index][onward];
            self.corners.push(corner);
            if corner == stays {
                break;
            }
            let mut following = ring.iter().enumerate().filter(|(_, pair)| pair[1 - onward] == corner);
            match (following.next(), following.next()) {
                (Some((next, _)), None) if self.order.len() < ring.len() => index = next,
                (None, _) => break,
                _ => return false,
            }
        }
        let is_closed = self.corners[self.corners.len() - 1] == stays;
        self.order.len() == ring.len() && is_closed == (count == [1, 1])
    }
}

#[cfg(test)]
mod tests {
    use super::Fan;

    fn arranged(ring: &[[u32; 2]], stays: u32) -> Option<(Vec<usize>, Vec<u32>)> {
        let mut fan = Fan::default();
        fan.arrange(ring, stays).then_some((fan.order, fan.corners))
    }

    #[test]
    fn closed_fans_go_round() {
        let ring = [[3, 4], [1, 2], [4, 1], [2, 3]];
        assert_eq!(arranged(&ring, 1), Some((vec![1, 3, 0, 2], vec![1, 2, 3, 4, 1])));
        assert_eq!(arranged(&ring, 4), Some((vec![2, 1, 3, 0], vec![4, 1, 2, 3, 4])));
    }

    #[test]
    fn open_fans_begin_at_either_end() {
        let ring = [[2, 3], [1, 2], [3, 4]];
        assert_eq!(arranged(&ring, 1), Some((vec![1, 0, 2], vec![1, 2, 3, 4])));
        assert_eq!(arranged(&ring, 4), Some((vec![2, 0, 1], vec![4, 3, 2, 1])));
        // In the middle of an open fan, or not there at all.
        assert_eq!(arranged(&ring, 2), None);
        assert_eq!(arranged(&ring, 9), None);
    }

    #[test]
    fn what_is_no_fan_is_refused() {
        // Two closed fans at one vertex.
        assert_eq!(arranged(&[[1, 2], [2, 3], [3, 1], [4, 5], [5, 6], [6, 4]], 1), None);
        // Three triangles at one edge.
        assert_eq!(arranged(&[[1, 2], [2, 3], [2, 4]], 1), None);
        // Disagreeing orientation.
        assert_eq!(arranged(&[[1, 2], [3, 2], [3, 1]], 1), None);
        // A ring that closes onto itself elsewhere than where it began.
        assert_eq!(arranged(&[[1, 2], [2, 3], [3, 2]], 1), None);
    }
}
