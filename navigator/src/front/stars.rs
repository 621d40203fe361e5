//! The stars of the front's vertices: for each the corners of triangles that it has, in cache lines.
//!
//! A *line* of 64 bytes holds up to seven corners, each with the leaf that it is in the input, and leads to the next one. All
//! lines of a star but the first are full. So a split or a collapse, which asks for the leaf of every corner at a vertex, finds
//! all of most stars in one cache line (`facts/front.md`, 1: lists that lead from triangle to triangle wait for memory at each).
//!
//! Memory: 64 bytes for each line, of which a vertex has about 1.25.

use storage::prefetch::prefetch;

use super::NONE;

/// Corners in a line.
pub const CORNERS: usize = 7;
/// Bytes of a line, with its place in the list of free ones.
pub const LINE_BYTES: usize = size_of::<Line>() + size_of::<u32>();
/// How many free lines ahead one is fetched before it is used.
const SOON: usize = 4;

/// A corner of a triangle at a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// The corner: `4 * triangle + 0, 1 or 2`.
    pub corner: u32,
    /// The leaf that it is in the input.
    pub leaf: u32,
}

impl Entry {
    /// The triangle.
    pub fn triangle(self) -> u32 {
        self.corner >> 2
    }

    /// Which corner of it.
    pub fn place(self) -> usize {
        (self.corner & 3) as usize
    }
}

#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
struct Line {
    corners: [u32; CORNERS],
    leaves: [u32; CORNERS],
    count: u32,
    /// The next line of the star.
    next: u32,
}

const EMPTY_LINE: Line = Line { corners: [0; CORNERS], leaves: [0; CORNERS], count: 0, next: NONE };

/// The lines of all stars. A star is named by its first line, [`NONE`] where it is empty.
#[derive(Debug)]
pub struct Stars {
    lines: Vec<Line>,
    /// Free lines, the one freed last at the end. A list through the lines themselves would have to wait for them.
    free: Vec<u32>,
    most: usize,
}

impl Stars {
    /// Room for `most` lines.
    pub fn new(most: usize) -> Self {
        Stars { lines: super::list(most), free: super::list(most), most }
    }

    /// Lines that are free.
    pub fn room(&self) -> usize {
        self.most - self.used()
    }

    /// Lines in use.
    pub fn used(&self) -> usize {
        self.lines.len() - self.free.len()
    }

    /// Lines that may be needed more to split a star in two and to add so many triangles, each to both and to one other star.
    pub fn most_for_split(born_triangles: usize) -> usize {
        1 + 2 * born_triangles.div_ceil(CORNERS) + born_triangles
    }

    fn new_line(&mut self, next: u32) -> u32 {
        match self.free.pop() {
            None => {
                self.lines.push(Line { next, ..EMPTY_LINE });
                (self.lines.len() - 1) as u32
            }
            Some(line) => {
                let entry = &mut self.lines[line as usize];
                (entry.count, entry.next) = (0, next);
                if let Some(soon) = self.free.len().checked_sub(SOON) {
                    prefetch(&self.lines, self.free[soon] as usize);
                }
                line
            }
        }
    }

    /// Frees a line and says which one follows it.
    fn free_line(&mut self, line: u32) -> u32 {
        self.free.push(line);
        self.lines[line as usize].next
    }

    /// Adds a corner to a star.
    #[inline]
    pub fn push(&mut self, star: &mut u32, entry: Entry) {
        if *star == NONE || self.lines[*star as usize].count as usize == CORNERS {
            *star = self.new_line(*star);
        }
        let line = &mut self.lines[*star as usize];
        let place = line.count as usize;
        (line.corners[place], line.leaves[place]) = (entry.corner, entry.leaf);
        line.count += 1;
    }

    /// Takes a corner out of a star, whatever its leaf; one that the first line has last takes its place.
    #[inline]
    fn remove_at(&mut self, star: &mut u32, line: u32, place: usize) {
        let first = &mut self.lines[*star as usize];
        first.count -= 1;
        let (count, last) = (first.count, first.count as usize);
        let (corner, leaf) = (first.corners[last], first.leaves[last]);
        let line = &mut self.lines[line as usize];
        (line.corners[place], line.leaves[place]) = (corner, leaf);
        if count == 0 {
            *star = self.free_line(*star);
        }
    }

    /// Takes the corner of a triangle out of a star; no effect where there is none.
    #[inline]
    pub fn remove(&mut self, star: &mut u32, triangle: u32) {
        let mut line = *star;
        while line != NONE {
            let entry = &self.lines[line as usize];
            let found = entry.corners[..entry.count as usize].iter().position(|corner| corner >> 2 == triangle);
            if let Some(place) = found {
                return self.remove_at(star, line, place);
            }
            line = entry.next;
        }
    }

    /// Gives a corner in a star another number.
    pub fn rename(&mut self, star: u32, from: u32, to: u32) {
        let mut line = star;
        while line != NONE {
            let entry = &mut self.lines[line as usize];
            for corner in entry.corners[..entry.count as usize].iter_mut().filter(|corner| **corner == from) {
                *corner = to;
            }
            line = entry.next;
        }
    }

    /// The corners of a star.
    #[inline]
    pub fn corners(&self, star: u32) -> impl Iterator<Item = Entry> + '_ {
        let mut line = self.lines.get(star as usize);
        let mut place = 0;
        std::iter::from_fn(move || {
            let mut current = line?;
            if place == current.count as usize {
                line = self.lines.get(current.next as usize);
                (current, place) = (line?, 0);
            }
            let entry = Entry { corner: current.corners[place], leaf: current.leaves[place] };
            place += 1;
            Some(entry)
        })
    }

    /// Takes a star apart, line by line: `sort` puts each corner elsewhere, at best into stars that get the line anew.
    #[inline]
    pub fn take(&mut self, star: u32, mut sort: impl FnMut(&mut Stars, Entry)) {
        let mut line = star;
        while line != NONE {
            let Line { corners, leaves, count, .. } = self.lines[line as usize];
            line = self.free_line(line);
            for (corner, leaf) in corners.into_iter().zip(leaves).take(count as usize) {
                sort(self, Entry { corner, leaf });
            }
        }
    }

    /// Fetches the first line of a star into the cache.
    #[inline]
    pub fn prefetch(&self, star: u32) {
        prefetch(&self.lines, star as usize);
    }

    /// The corners in the first line of a star: those that can be looked at without waiting, once it was prefetched.
    #[inline]
    pub fn first_corners(&self, star: u32) -> &[u32] {
        self.lines.get(star as usize).map_or(&[], |line| &line.corners[..line.count as usize])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Random;

    #[test]
    fn a_line_is_a_cache_line() {
        assert_eq!((size_of::<Line>(), align_of::<Line>()), (64, 64));
    }

    /// Stars against lists, in random changes.
    #[test]
    fn stars_hold_what_was_put_there() {
        let mut stars = Stars::new(200);
        let mut heads = [NONE; 8];
        let mut lists = vec![Vec::new(); 8];
        let mut random = Random(1);
        for step in 0..20_000_u32 {
            let star = random.below(8);
            match random.below(5) {
                0 | 1 if lists[star].len() < 60 => {
                    let entry = Entry { corner: step * 4 + step % 3, leaf: random.below(100) as u32 };
                    stars.push(&mut heads[star], entry);
                    lists[star].push((entry.corner, entry.leaf));
                }
                2 | 3 if !lists[star].is_empty() => {
                    let length = lists[star].len();
                    let (corner, _) = lists[star].swap_remove(random.below(length));
                    stars.remove(&mut heads[star], corner >> 2);
                }
                4 => {
                    let other = (star + 1) % 8;
                    let (mut near, mut far) = (NONE, heads[other]);
                    stars.take(heads[star], |stars, entry| {
                        stars.push(if entry.leaf < 50 { &mut near } else { &mut far }, entry);
                    });
                    (heads[star], heads[other]) = (near, far);
                    let (near, far): (Vec<_>, Vec<_>) =
                        lists[star].iter().partition(|entry: &&(u32, u32)| entry.1 < 50);
                    lists[star] = near;
                    lists[other].extend(far);
                }
                _ => (),
            }
            let mut found: Vec<_> = stars.corners(heads[star]).map(|entry| (entry.corner, entry.leaf)).collect();
            let mut expected = lists[star].clone();
            found.sort_unstable();
            expected.sort_unstable();
            assert_eq!(found, expected);
            let lines: usize = lists.iter().map(|list| list.len().div_ceil(CORNERS)).sum();
            assert_eq!((stars.used(), stars.room()), (lines, 200 - lines));
        }
    }
}
