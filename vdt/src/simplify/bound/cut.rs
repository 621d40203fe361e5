//! Cuts a piece along the spokes of a fan, so that each part goes to a sector of its own.
//!
//! Each corner of the piece is given to a sector. A side whose ends are given to different sectors crosses the spokes
//! between them, each where it comes nearest to the spoke, in their order along the side; the chords between the two
//! crossings of a spoke cut the piece. Whatever the surface looks like, that is a partition of a convex polygon into convex
//! parts: the crossings of the spokes follow each other on every side, so no two chords cross.
//!
//! A part is as far from its sector as the farthest of its corners is: the distance from a triangle is a convex function.
//! A crossing is as far as it is from the spoke, which both sectors have.

use super::distance::pass;
use super::lanes::{LANES, Lanes, Vectors};
use super::pieces::MOST_CORNERS;

/// A part of a piece may have so many corners: two more for each spoke that bounds it, on either side.
const MOST_PART_CORNERS: usize = MOST_CORNERS + 4;

/// A piece, as it is cut.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Shape {
    /// Corners in order, normalised.
    pub corners: [[f32; 3]; MOST_CORNERS],
    pub count: usize,
    /// The sector that each corner is given to.
    pub sectors: [usize; MOST_CORNERS],
    /// The squared distance of each corner from its sector.
    pub squares: [f32; MOST_CORNERS],
}

impl Shape {
    /// Appends a corner that is given to a sector, from which it is so far, squared.
    pub fn push(&mut self, corner: [f32; 3], sector: usize, square: f32) {
        if self.count < MOST_CORNERS {
            (self.corners[self.count], self.sectors[self.count], self.squares[self.count]) = (corner, sector, square);
            self.count += 1;
        }
    }
}

/// A part of a piece.
#[derive(Debug, Clone, Copy)]
pub(super) struct Part {
    /// The sector that it is given to.
    pub sector: usize,
    corners: [[f32; 3]; MOST_PART_CORNERS],
    count: usize,
    /// The squared distance of its farthest corner from its sector.
    pub square: f32,
}

impl Part {
    /// Its corners, if they are no more than can be kept.
    pub fn corners(&self) -> Option<&[[f32; 3]]> {
        (self.count <= MOST_CORNERS).then_some(&self.corners[..self.count])
    }

    fn without_corners(sector: usize) -> Self {
        Part { sector, corners: [[0.0; 3]; MOST_PART_CORNERS], count: 0, square: 0.0 }
    }

    fn push(&mut self, corner: [f32; 3], square: f32) {
        self.square = self.square.max(square);
        // A crossing at the end of a side is no corner of its own.
        let is_new = self.count == 0 || self.corners[self.count - 1] != corner;
        if is_new && self.count < MOST_PART_CORNERS {
            self.corners[self.count] = corner;
            self.count += 1;
        }
    }
}

/// A side of a piece crosses a spoke.
#[derive(Debug, Clone, Copy)]
struct Crossing {
    /// The side, by the corner that it begins at.
    side: usize,
    spoke: usize,
    /// Where on the side.
    place: f32,
    /// Its squared distance from the spoke.
    square: f32,
}

/// Cuts pieces; kept from one to the next for its memory.
#[derive(Debug, Default)]
pub(super) struct Cutter {
    crossings: Vec<Crossing>,
    /// The parts of the last piece.
    pub parts: Vec<Part>,
}

impl Cutter {
    /// Cuts a piece. `origin` is the vertex that stays; `spokes` has, for each, where it ends, relative to that (of the
    /// first, which is none, anything). `false` where the sectors of the corners do not rise and fall once, around the piece.
    pub fn cut(&mut self, shape: &Shape, origin: [f32; 3], spokes: &[[f32; 3]]) -> bool {
        self.crossings.clear();
        self.parts.clear();
        let Shape { corners, count, sectors, squares } = shape;
        let count = *count;
        for side in 0..count {
            let (from, to) = (sectors[side], sectors[(side + 1) % count]);
            let crossing = |spoke| Crossing { side, spoke, place: 0.0, square: 0.0 };
            if from < to {
                self.crossings.extend((from + 1..=to).map(crossing));
            } else {
                self.crossings.extend((to + 1..=from).rev().map(crossing));
            }
        }
        let (lowest, highest) =
            sectors[..count].iter().fold((usize::MAX, 0), |(low, high), sector| (low.min(*sector), high.max(*sector)));
        // Each spoke is crossed an even number of times, and once up and once down at least.
        if self.crossings.len() != 2 * (highest - lowest) {
            return false;
        }
        self.place_crossings(shape, origin, spokes);

        self.parts.extend((lowest..=highest).map(Part::without_corners));
        let mut crossings = self.crossings.iter().peekable();
        for side in 0..count {
            self.parts[sectors[side] - lowest].push(corners[side], squares[side]);
            let (from, to) = (corners[side], corners[(side + 1) % count]);
            while let Some(Crossing { spoke, place, square, .. }) = crossings.next_if(|crossing| crossing.side == side)
            {
                let corner = std::array::from_fn(|axis| from[axis] + (to[axis] - from[axis]) * place);
                self.parts[spoke - 1 - lowest].push(corner, *square);
                self.parts[spoke - lowest].push(corner, *square);
            }
        }
        true
    }

    /// Finds where the sides cross the spokes.
    fn place_crossings(&mut self, shape: &Shape, origin: [f32; 3], spokes: &[[f32; 3]]) {
        let Shape { corners, count, .. } = shape;
        let minus = |a: [f32; 3], b: [f32; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        let side_of = |crossing: &Crossing| {
            let (from, to) = (corners[crossing.side], corners[(crossing.side + 1) % count]);
            [minus(from, origin), minus(to, from), spokes[crossing.spoke]]
        };
        for chunk in self.crossings.chunks_mut(LANES) {
            let mut lanes = [Vectors::ZERO; 3];
            for (lane, crossing) in chunk.iter().enumerate() {
                for (lanes, vector) in lanes.iter_mut().zip(side_of(crossing)) {
                    lanes.set(lane, vector);
                }
            }
            let passing = pass(lanes[0], lanes[1], lanes[2], Lanes::ZERO);
            for (lane, crossing) in chunk.iter_mut().enumerate() {
                (crossing.place, crossing.square) = (passing.place.0[lane], passing.square_distance.0[lane]);
            }
        }
        // In their order along the side.
        for index in 1..self.crossings.len() {
            let (before, crossing) = (self.crossings[index - 1], self.crossings[index]);
            if before.side == crossing.side && crossing.place < before.place {
                let [start, step, spoke] = side_of(&crossing).map(Vectors::all);
                let passing = pass(start, step, spoke, Lanes::all(before.place));
                let crossing = &mut self.crossings[index];
                (crossing.place, crossing.square) = (passing.place.0[0], passing.square_distance.0[0]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A convex polygon in a plane: points on a circle, by ascending angle.
    fn polygon() -> impl Strategy<Value = Vec<[f32; 3]>> {
        prop::collection::btree_set(0..360_u32, 3..=MOST_CORNERS).prop_map(|angles| {
            let corner = |angle: u32| {
                let angle = (angle as f32).to_radians();
                [0.4 + angle.cos(), 0.3 + angle.sin(), 0.1 * angle.cos()]
            };
            angles.into_iter().map(corner).collect()
        })
    }

    /// The area above the xy plane.
    fn area(corners: &[[f32; 3]]) -> f32 {
        let origin = corners.first().copied().unwrap_or_default();
        let pairs = corners.windows(2).map(|pair| {
            let [a, b] = [pair[0], pair[1]].map(|p| [p[0] - origin[0], p[1] - origin[1]]);
            a[0] * b[1] - a[1] * b[0]
        });
        pairs.sum::<f32>() / 2.0
    }

    proptest! {
        /// The parts are convex polygons with the orientation of the piece, and cover it: their areas add up.
        #[test]
        fn the_parts_make_up_the_piece(
            corners in polygon(), sectors in prop::collection::vec(0..4_usize, MOST_CORNERS),
            spokes in prop::array::uniform4(prop::array::uniform3(-1.0_f32..1.0)),
        ) {
            let mut shape = Shape::default();
            for (corner, sector) in corners.iter().zip(&sectors) {
                shape.push(*corner, *sector, 0.25);
            }
            let count = corners.len();
            let crossings = |spoke: usize| {
                (0..count).filter(|side| (sectors[*side] < spoke) != (sectors[(*side + 1) % count] < spoke)).count()
            };
            let is_simple = (1..4).all(|spoke| crossings(spoke) <= 2);
            let mut cutter = Cutter::default();
            prop_assert_eq!(cutter.cut(&shape, [0.0; 3], &spokes), is_simple);
            if is_simple {
                let mut sum = 0.0;
                for part in &cutter.parts {
                    let part_area = area(&part.corners[..part.count]);
                    prop_assert!(part_area >= -1e-5, "{}", part_area);
                    sum += part_area;
                }
                prop_assert!((sum - area(&corners)).abs() < 1e-4, "{} {}", sum, area(&corners));
                for (corner, sector) in corners.iter().zip(&sectors) {
                    let part = cutter.parts.iter().find(|part| part.sector == *sector).unwrap();
                    prop_assert!(part.corners[..part.count].contains(corner) && part.square >= 0.25);
                }
            }
        }
    }

    /// By hand: a square over two sectors that meet along the x axis.
    #[test]
    fn a_square_is_cut_in_the_middle() {
        let mut shape = Shape::default();
        for (corner, sector) in
            [([1.0, -1.0, 0.0], 0), ([3.0, -1.0, 0.0], 0), ([3.0, 1.0, 0.0], 1), ([1.0, 1.0, 0.0], 1)]
        {
            shape.push(corner, sector, 0.0);
        }
        let mut cutter = Cutter::default();
        assert!(cutter.cut(&shape, [0.0; 3], &[[0.0; 3], [4.0, 0.0, 1.0]]));
        let [lower, upper] = [0, 1].map(|part: usize| cutter.parts[part]);
        assert_eq!(lower.corners().unwrap(), [[1.0, -1.0, 0.0], [3.0, -1.0, 0.0], [3.0, 0.0, 0.0], [1.0, 0.0, 0.0]]);
        assert_eq!(upper.corners().unwrap().len(), 4);
        // (3, 0, 0) is nearest to (48, 0, 12) / 17, 3 / sqrt 17 away.
        assert!((lower.square - 9.0 / 17.0).abs() < 1e-6 && upper.square == lower.square);
    }
}
