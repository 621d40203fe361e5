//! What each triangle that is left answers for: a residual, and the pieces of earlier surface that it keeps.
//!
//! Every point of the input lies within `base` of a point of some piece, or within `residual` of a point of the triangle
//! itself. Before the first collapse, a triangle's residual is 0: it is the input. Pieces are kept as they are, and
//! measured anew at every collapse around them, so errors add up only where a piece is let go into the residual.
//!
//! For bounds in both directions, each triangle also has its *reverse* bound: every point of it lies within that of a point
//! of the input.
//!
//! Memory: 8 bytes for each triangle, 4 more for the reverse bounds, 56 for each piece that there is. Pieces lie in chunks, so that their number can grow
//! without a copy; each triangle's form a list.

use bytemuck::{Pod, Zeroable};

use crate::tree::ErrorBound;

/// The most corners that a piece can have. (Nearly all parts of what is cut have three or four: of those kept on a scan of
/// 269 K triangles, with room for six, 84 % three, 15 % four, 0.5 % more.)
pub(super) const MOST_CORNERS: usize = 4;
/// The most pieces that a triangle can keep.
pub(in crate::simplify) const MOST_PIECES: usize = 3;

/// What a triangle answers for. 8 bytes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::simplify) struct Cover {
    /// How far, at most, a point of the input that is not with a piece lies from the triangle, normalised;
    /// [`Cover::NOTHING`] where there is no such point.
    pub residual: f32,
    first: u32,
}

impl Cover {
    /// As a residual: no point of the input is with the triangle itself.
    pub const NOTHING: f32 = -1.0;
    /// A triangle of the input.
    pub const INPUT: Cover = Cover { residual: 0.0, first: END };

    /// One without pieces.
    pub fn without_pieces(residual: f32) -> Self {
        Cover { residual, first: END }
    }
}

/// The end of a list.
const END: u32 = (1 << NEXT_BITS) - 1;
const NEXT_BITS: u32 = 29;

/// A convex polygon of earlier surface. 56 bytes, on disk too.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(in crate::simplify) struct Piece {
    /// Its corners in order, normalised; zero behind the last one.
    pub corners: [[f32; 3]; MOST_CORNERS],
    /// How far, at most, a point of the input that is with it lies from it, normalised.
    pub base: f32,
    /// In the upper three bits how many corners; below, where the next of the list is, or, on disk, which triangle it
    /// belongs to.
    word: u32,
}

impl Piece {
    /// One with these corners, at most [`MOST_CORNERS`].
    pub fn new(corners: &[[f32; 3]], base: f32) -> Self {
        let mut piece = Piece { base, ..Piece::zeroed() };
        let count = corners.len().min(MOST_CORNERS);
        piece.corners[..count].copy_from_slice(&corners[..count]);
        piece.word = (count as u32) << NEXT_BITS | END;
        piece
    }

    pub fn corner_count(&self) -> usize {
        ((self.word >> NEXT_BITS) as usize).min(MOST_CORNERS)
    }

    /// On disk: the place of the triangle that it belongs to.
    pub fn owner(&self) -> u32 {
        self.word & END
    }

    /// The same, for disk: of the triangle at this place.
    pub fn owned_by(self, owner: u32) -> Self {
        Piece { word: self.word & !END | owner, ..self }
    }
}

const CHUNK_SHIFT: u32 = 9;
const CHUNK: usize = 1 << CHUNK_SHIFT;

/// What all triangles of a mesh answer for.
#[derive(Debug)]
pub(in crate::simplify) struct Covers {
    bound: ErrorBound,
    /// Of each triangle; nobody's where no bound is kept.
    of_triangles: Vec<Cover>,
    /// The reverse bounds, where they are kept.
    reverses: Vec<f32>,
    chunks: Vec<Box<[Piece; CHUNK]>>,
    /// How many places for pieces were ever used.
    used: u32,
    /// The list of places that are free again.
    free: u32,
    live: u32,
}

impl Covers {
    /// Of no triangles yet. Without a certified bound, nothing is ever noted.
    pub fn new(bound: ErrorBound) -> Self {
        let (of_triangles, reverses, chunks) = Default::default();
        Covers { bound, of_triangles, reverses, chunks, used: 0, free: END, live: 0 }
    }

    /// For which bound they are noted.
    pub fn bound(&self) -> ErrorBound {
        self.bound
    }

    /// Forgets all, but keeps the memory.
    pub fn clear(&mut self) {
        self.of_triangles.clear();
        self.reverses.clear();
        (self.used, self.free, self.live) = (0, END, 0);
    }

    pub fn reserve(&mut self, triangles: usize) {
        if self.bound.is_certified() {
            self.of_triangles.reserve_exact(triangles);
        }
        if self.bound.is_two_sided() {
            self.reverses.reserve_exact(triangles);
        }
    }

    /// Appends a triangle that keeps no pieces yet, with a reverse bound of 0.
    pub fn push(&mut self, residual: f32) {
        if self.bound.is_certified() {
            self.of_triangles.push(Cover::without_pieces(residual));
        }
        if self.bound.is_two_sided() {
            self.reverses.push(0.0);
        }
    }

    /// How far, at most, a point of a triangle lies from the input, normalised; 0 where that is not noted.
    #[inline]
    pub fn reverse(&self, triangle: usize) -> f32 {
        self.reverses.get(triangle).copied().unwrap_or(0.0)
    }

    /// Notes the reverse bound of a triangle, if such are noted.
    #[inline]
    pub fn set_reverse(&mut self, triangle: usize, reverse: f32) {
        if let Some(place) = self.reverses.get_mut(triangle) {
            *place = reverse;
        }
    }

    /// What a triangle answers for. (A triangle of the input, where no bound is kept.)
    #[inline]
    pub fn of(&self, triangle: usize) -> Cover {
        self.of_triangles.get(triangle).copied().unwrap_or(Cover::INPUT)
    }

    /// The pieces of a triangle.
    #[inline]
    pub fn pieces(&self, cover: Cover) -> impl Iterator<Item = &Piece> {
        let mut next = cover.first;
        std::iter::from_fn(move || {
            let piece = self.piece(next)?;
            next = piece.word & END;
            Some(piece)
        })
    }

    #[inline]
    fn piece(&self, place: u32) -> Option<&Piece> {
        self.chunks.get((place >> CHUNK_SHIFT) as usize).map(|chunk| &chunk[place as usize % CHUNK])
    }

    #[inline]
    fn piece_mut(&mut self, place: u32) -> Option<&mut Piece> {
        self.chunks.get_mut((place >> CHUNK_SHIFT) as usize).map(|chunk| &mut chunk[place as usize % CHUNK])
    }

    /// Lets the pieces of a triangle go, and notes what is with itself.
    pub fn set(&mut self, triangle: usize, residual: f32) {
        let Some(cover) = self.of_triangles.get_mut(triangle) else { return };
        let mut next = std::mem::replace(cover, Cover::without_pieces(residual)).first;
        while next != END {
            let free = self.free;
            let Some(piece) = self.piece_mut(next) else { break };
            let after = piece.word & END;
            piece.word = free;
            self.free = next;
            self.live -= 1;
            next = after;
        }
    }

    /// Gives a triangle one more piece, in front of those that it keeps.
    pub fn add_piece(&mut self, triangle: usize, piece: &Piece) {
        let Some(Cover { first, .. }) = self.of_triangles.get(triangle).copied() else { return };
        let mut place = self.free;
        if place == END {
            place = self.used;
            self.used += 1;
            if place as usize == self.chunks.len() * CHUNK {
                self.chunks.push(Box::new([Piece::zeroed(); CHUNK]));
            }
        } else if let Some(free) = self.piece(place) {
            self.free = free.word & END;
        }
        if let Some(slot) = self.piece_mut(place) {
            *slot = Piece { word: piece.word & !END | first, ..*piece };
        }
        self.of_triangles[triangle].first = place;
        self.live += 1;
    }

    /// Moves what a triangle answers for to another number, which is not larger.
    pub fn renumber(&mut self, old: usize, new: usize) {
        if self.bound.is_certified() {
            self.of_triangles[new] = self.of_triangles[old];
        }
        if self.bound.is_two_sided() {
            self.reverses[new] = self.reverses[old];
        }
    }

    /// Forgets the triangles from this number on, which keep no pieces (any more).
    pub fn truncate(&mut self, triangles: usize) {
        self.of_triangles.truncate(triangles);
        self.reverses.truncate(triangles);
    }

    /// Pieces that there are.
    pub fn piece_count(&self) -> usize {
        self.live as usize
    }

    /// Has what a triangle answers for on its way from memory.
    #[inline]
    pub fn prefetch(&self, triangle: usize) {
        crate::simplify::prefetch::read(&self.of_triangles, triangle);
    }

    /// Has the first piece of a triangle, whose cover should be there by now, on its way from memory.
    #[inline]
    pub fn prefetch_piece(&self, triangle: usize) {
        let first = self.of(triangle).first;
        if let Some(chunk) = self.chunks.get((first >> CHUNK_SHIFT) as usize) {
            crate::simplify::prefetch::read(&chunk[..], first as usize % CHUNK);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn piece(number: u32) -> Piece {
        let corner = |index: u32| [number as f32, index as f32, 0.5];
        let corners: Vec<_> = (0..1 + number % MOST_CORNERS as u32).map(corner).collect();
        Piece::new(&corners, number as f32)
    }

    fn bases(covers: &Covers, triangle: usize) -> Vec<f32> {
        covers.pieces(covers.of(triangle)).map(|piece| piece.base).collect()
    }

    #[test]
    fn a_piece_is_56_bytes_and_remembers_its_owner() {
        assert_eq!((size_of::<Piece>(), size_of::<Cover>()), (56, 8));
        for number in 0..8 {
            let owned = piece(number).owned_by(12_345_678);
            assert_eq!((owned.owner(), owned.corner_count()), (12_345_678, 1 + number as usize % MOST_CORNERS));
        }
    }

    proptest! {
        /// Lists of pieces, held against plain vectors; places that are free are used again.
        #[test]
        fn triangles_keep_the_pieces_that_they_were_given(
            steps in prop::collection::vec((0..40_usize, 0..4_u32), 0..3000),
        ) {
            let mut covers = Covers::new(ErrorBound::Tight);
            let mut expected: Vec<Vec<f32>> = vec![Vec::new(); 40];
            (0..40).for_each(|_| covers.push(0.0));
            let mut most = 0;
            for (number, (triangle, action)) in (0..).zip(steps) {
                if action == 0 {
                    covers.set(triangle, number as f32);
                    prop_assert_eq!(covers.of(triangle).residual, number as f32);
                    expected[triangle].clear();
                } else {
                    covers.add_piece(triangle, &piece(number));
                    expected[triangle].insert(0, number as f32);
                }
                let count = expected.iter().map(Vec::len).sum();
                prop_assert_eq!(covers.piece_count(), count);
                most = most.max(count);
            }
            prop_assert_eq!(covers.used as usize, most);
            for (triangle, expected) in expected.iter().enumerate() {
                prop_assert_eq!(&bases(&covers, triangle), expected);
            }
        }
    }

    #[test]
    fn without_a_bound_nothing_is_noted() {
        let mut covers = Covers::new(ErrorBound::None);
        covers.push(0.25);
        covers.add_piece(0, &piece(1));
        covers.set(0, 0.5);
        covers.set_reverse(0, 0.5);
        assert_eq!((covers.of(0), covers.piece_count(), covers.reverse(0)), (Cover::INPUT, 0, 0.0));
    }
}
