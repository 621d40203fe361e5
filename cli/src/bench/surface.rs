//! The triangles of a mesh in RAM, under a hierarchy of boxes: how far a place is from the nearest of them.
//!
//! Exact up to rounding in double precision: a box is passed over only where it is farther than what was found. Boxes hold up to
//! [`LEAF`] triangles and are cut at the median of the longest axis of their middles.
//!
//! RAM: 36 bytes for each triangle, and about 20 for the boxes. It is for experiments: meshes of any size are compared by
//! [`vdt::compare`].

use vdt::compare::{Triangle, squared_distance};

/// Triangles in a box that is not cut any more, at most.
const LEAF: usize = 4;
/// Boxes on the way down that wait: two for each level, of at most 32.
const WAITING: usize = 64;

/// Corners in single precision, as the streams of a navigator have them.
type Corners = [[f32; 3]; 3];

/// A box, and what is in it.
#[derive(Debug, Clone, Copy)]
struct Node {
    low: [f32; 3],
    high: [f32; 3],
    /// Of a box with triangles the first, else the second box that it was cut into; the first one comes next in the list.
    first: u32,
    /// How many triangles; 0 where it was cut.
    count: u32,
}

impl Node {
    /// Square of the distance of a place from the box.
    fn squared_distance(&self, place: [f64; 3]) -> f64 {
        (0..3)
            .map(|axis| {
                let apart =
                    (f64::from(self.low[axis]) - place[axis]).max(place[axis] - f64::from(self.high[axis])).max(0.0);
                apart * apart
            })
            .sum()
    }
}

/// A surface to which distances are measured.
#[derive(Debug, Default)]
pub struct Surface {
    triangles: Vec<Corners>,
    nodes: Vec<Node>,
}

impl Surface {
    /// That of these triangles.
    pub fn new(triangles: impl Iterator<Item = Corners>) -> Self {
        let mut surface = Surface { triangles: triangles.collect(), nodes: Vec::new() };
        if !surface.triangles.is_empty() {
            let count = surface.triangles.len();
            surface.cut(0, count);
        }
        surface
    }

    /// Makes the box of some triangles, and those below it.
    fn cut(&mut self, first: usize, end: usize) {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        let (mut least, mut most) = (low, high);
        for triangle in &self.triangles[first..end] {
            for axis in 0..3 {
                for corner in triangle {
                    low[axis] = low[axis].min(corner[axis]);
                    high[axis] = high[axis].max(corner[axis]);
                }
                least[axis] = least[axis].min(middle(triangle, axis));
                most[axis] = most[axis].max(middle(triangle, axis));
            }
        }
        let node = self.nodes.len();
        let count = if end - first <= LEAF { end - first } else { 0 };
        self.nodes.push(Node { low, high, first: first as u32, count: count as u32 });
        if count > 0 {
            return;
        }
        let extent = |axis: &usize| most[*axis] - least[*axis];
        let axis = (0..3).max_by(|left, right| extent(left).total_cmp(&extent(right))).unwrap_or(0);
        let half = (end - first) / 2;
        self.triangles[first..end]
            .select_nth_unstable_by(half, |left, right| middle(left, axis).total_cmp(&middle(right, axis)));
        self.cut(first, first + half);
        self.nodes[node].first = self.nodes.len() as u32;
        self.cut(first + half, end);
    }

    /// How far a place is from the surface: infinity where it is farther than `limit`. `guess` is where the nearest triangle of the
    /// last place was, and becomes that of this one: neighbours are found faster.
    pub fn distance(&self, place: [f64; 3], limit: f64, guess: &mut usize) -> f64 {
        let mut least = limit * limit;
        let mut found = f64::INFINITY;
        let last = *guess;
        let mut look_at = |number: usize, least: &mut f64| {
            let squared = squared_distance(place, &exact(&self.triangles[number]));
            if squared <= *least {
                (*least, found) = (squared, squared);
                *guess = number;
            }
        };
        if last < self.triangles.len() {
            look_at(last, &mut least);
        }
        let mut waiting = [(0_u32, 0.0_f64); WAITING];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let (number, squared) = waiting[depth];
            if squared > least {
                continue;
            }
            let node = &self.nodes[number as usize];
            if node.count > 0 {
                (node.first..node.first + node.count).for_each(|triangle| look_at(triangle as usize, &mut least));
                continue;
            }
            let children = [number + 1, node.first].map(|child| (child, self.nodes[child as usize]));
            let mut children = children.map(|(child, node)| (child, node.squared_distance(place)));
            // The nearer one is looked at first.
            if children[0].1 < children[1].1 {
                children.swap(0, 1);
            }
            for child in children {
                if child.1 <= least {
                    waiting[depth] = child;
                    depth += 1;
                }
            }
        }
        found.sqrt()
    }
}

/// Three times the middle of a triangle along an axis.
fn middle(triangle: &Corners, axis: usize) -> f32 {
    triangle[0][axis] + triangle[1][axis] + triangle[2][axis]
}

fn exact(corners: &Corners) -> Triangle {
    corners.map(|corner| corner.map(f64::from))
}

#[cfg(test)]
mod tests {
    use navigator::random::Random;

    use super::*;

    #[test]
    fn the_nearest_of_all_is_found() {
        let mut random = Random(5);
        let mut number = |from: f64, to: f64| random.between([from, to]) as f32;
        for count in [0, 1, 2, 5, 300] {
            let triangles: Vec<Corners> = (0..count)
                .map(|_| {
                    let at = [0; 3].map(|_| number(-5.0, 5.0));
                    [0; 3].map(|_| at.map(|coordinate| coordinate + number(-0.5, 0.5)))
                })
                .collect();
            let surface = Surface::new(triangles.iter().copied());
            let mut guess = 0;
            for _ in 0..300 {
                let place = [0; 3].map(|_| f64::from(number(-8.0, 8.0)));
                let squares = triangles.iter().map(|corners| squared_distance(place, &exact(corners)));
                let expected = squares.fold(f64::INFINITY, f64::min).sqrt();
                assert_eq!(surface.distance(place, f64::INFINITY, &mut guess), expected);
                let limit = f64::from(number(0.0, 2.0));
                let expected = if expected <= limit { expected } else { f64::INFINITY };
                assert_eq!(surface.distance(place, limit, &mut guess), expected);
            }
        }
    }
}
