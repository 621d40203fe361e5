//! What a collapse does to what the triangles answer for: everything that those around the vertex that goes answered for is
//! handed to the new ones, at a distance that is a bound (`facts/error.md`, section 6).
//!
//! What is handed on are *pieces*: the old triangles themselves, with their residuals as bases, where any input is with
//! them, and the pieces that they keep. Each goes to the new triangle from which it is least far; where that is farther
//! than need be, it is cut along the spokes ([`super::cut`]), and its parts go to their sectors. What need be follows from
//! the corners: a piece with a corner that is `d` from all new triangles cannot be with them at less than its base and `d`.
//!
//! A new triangle keeps the pieces that are farthest from it, as many as it may; the others are with itself from then on,
//! the largest of their distances being its residual.
//!
//! Where the old triangles are no fan (non-manifold vertices, and in the end phase), nothing is cut. In the end phase there may
//! be no new triangle: then the triangles around the vertex that stays take over, besides what they answer for already.
//! Where there are none either, a part of the mesh has vanished, and it is for the caller to say how far that is.

use super::cut::{Cutter, Shape};
use super::distance::{ROUNDING, Triangles};
use super::fan::Fan;
use super::lanes::{LANES, Lanes, Vectors};
use super::pieces::{Cover, MOST_CORNERS, MOST_PIECES, Piece};
use super::reverse::Reverse;
use super::{minus, square};
use crate::simplify::live_mesh::LiveMesh;
use crate::tree::ErrorBound;

/// A piece is not cut as long as it is no farther than this times what need be.
const TOLERANCE: f32 = 1.05;
/// Sums of two or three numbers, times this, are above what they are without rounding.
pub(super) const ROUND_UP: f32 = 1.0 + 1.0 / (1 << 21) as f32;
/// A point on a side, worked out in single precision, is off by less than this part of the longest vector and of the
/// coordinates of the vertex that stays.
const PLACE_ROUNDING: f32 = 1.0 / (1 << 21) as f32;

/// What is allowed for rounding in a collapse.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Rounding {
    /// Added to distances.
    pub of_distances: f32,
    /// How far a place on a side, worked out, may be off.
    pub of_places: f32,
}

/// A new triangle, and what is handed to it.
#[derive(Debug, Clone, Copy)]
struct Target {
    /// Its number.
    triangle: u32,
    /// Whether it is one of those around the vertex that goes.
    is_around_gone: bool,
    /// Its second and third corners, relative to the vertex that stays.
    corners: [[f32; 3]; 2],
    /// What is with itself.
    residual: f32,
    /// The farthest pieces, the farthest first: how far each is, and which it is.
    kept: [(f32, Source); MOST_PIECES],
    kept_count: usize,
    /// Whether anything was handed to it.
    is_rewritten: bool,
}

/// Which piece.
#[derive(Debug, Clone, Copy)]
enum Source {
    /// An old triangle, by its index in the ring.
    Triangle(usize),
    /// One of those collected, by its index.
    Collected(usize),
}

/// What a collapse comes to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::simplify) struct Rewritten {
    /// How far, at most, anything that was handed on lies from the new triangle that it was handed to, normalised.
    pub error: f32,
    /// The largest dependency id of the collapses that last rewrote a triangle, other than those around the vertex that
    /// goes, to which anything was handed; 0 where none did.
    pub latest: u32,
}

/// Works out what a collapse comes to, and notes it; kept from one to the next for its memory.
#[derive(Debug)]
pub(in crate::simplify) struct Rewriter {
    /// Pieces that a triangle may keep.
    most_kept: usize,
    fan: Fan,
    cutter: Cutter,
    /// The triangles around the vertex that goes.
    old_triangles: Vec<u32>,
    targets: Vec<Target>,
    /// The targets, eight at a time.
    lanes: Vec<Triangles>,
    /// For each target, the squared distance of the vertex that goes.
    from_gone: Vec<f32>,
    /// The target that the vertex that goes is nearest to.
    nearest: usize,
    /// Where each spoke ends, relative to the vertex that stays.
    spokes: Vec<[f32; 3]>,
    /// Pieces that the old triangles keep, then parts of what was cut.
    collected: Vec<Piece>,
    /// The corners of the pieces of the old triangles, relative to the vertex that stays, two pieces at a time.
    points: Vec<Vectors>,
    /// For each target, and for each two of those pieces, the squared distances of their corners.
    rows: Vec<Lanes>,
    /// Pieces that targets are to keep, by the number of the target, in the order in which they are to be added.
    to_be_kept: Vec<(usize, Piece)>,
    /// The other direction, where that is asked for.
    reverse: Option<Reverse>,
    rounding: Rounding,
    error: f32,
}

impl Rewriter {
    /// For a bound that is certified.
    pub fn new(bound: ErrorBound) -> Self {
        Rewriter {
            most_kept: bound.pieces().saturating_sub(1).min(MOST_PIECES),
            fan: Fan::default(),
            cutter: Cutter::default(),
            old_triangles: Vec::new(),
            targets: Vec::new(),
            lanes: Vec::new(),
            from_gone: Vec::new(),
            nearest: 0,
            spokes: Vec::new(),
            collected: Vec::new(),
            points: Vec::new(),
            rows: Vec::new(),
            to_be_kept: Vec::new(),
            reverse: bound.is_two_sided().then(Reverse::default),
            rounding: Rounding::default(),
            error: 0.0,
        }
    }

    /// Works out what the collapse of `gone`, whose ring is `ring`, onto `stays` comes to; nothing is changed until
    /// [`Self::write`]. `None` where no triangle is left to hand anything to.
    pub fn measure(&mut self, mesh: &LiveMesh, gone: u32, stays: u32, ring: &[[u32; 2]]) -> Option<Rewritten> {
        self.error = 0.0;
        self.targets.clear();
        self.collected.clear();
        self.to_be_kept.clear();
        self.old_triangles.clear();
        self.old_triangles.extend_from_slice(mesh.star(gone));
        let origin = mesh.vertices[stays as usize].position;
        let is_fan = self.fan.arrange(ring, stays) && self.fan.sectors() > 0;
        let mut latest = 0;
        if is_fan {
            for number in 1..=self.fan.sectors() {
                let corners = [number, number + 1].map(|corner| self.fan.corners[corner]);
                self.add_target(mesh, self.old_triangles[self.fan.order[number]], true, origin, corners);
            }
            self.collect_fan(mesh, gone, origin);
            if let Some(reverse) = &mut self.reverse {
                let back = reverse.measure_fan(
                    mesh,
                    [gone, stays],
                    &self.fan,
                    self.nearest,
                    &self.old_triangles,
                    self.rounding,
                );
                self.error = self.error.max(back);
            }
        } else {
            self.add_other_targets(mesh, gone, stays, ring, origin);
            if self.targets.is_empty() {
                return None;
            }
            self.hand_on_whole(mesh, gone, origin, ring);
            if let Some(reverse) = &mut self.reverse {
                let new = self.targets.iter().filter(|target| target.is_around_gone).map(|target| target.corners);
                let back = reverse.measure_whole(mesh, [gone, stays], ring, &self.old_triangles, new, self.rounding);
                self.error = self.error.max(back);
            }
            for target in self.targets.iter().filter(|target| target.is_rewritten && !target.is_around_gone) {
                latest = mesh.triangles[target.triangle as usize].order.max(latest);
            }
        }
        for (number, target) in self.targets.iter().enumerate() {
            for (_, source) in target.kept[..target.kept_count].iter().rev() {
                let piece = match *source {
                    Source::Collected(index) => self.collected[index],
                    Source::Triangle(index) => {
                        let [a, b] = ring[index];
                        let corners = [gone, a, b].map(|vertex| mesh.vertices[vertex as usize].position);
                        let triangle = self.old_triangles[index] as usize;
                        Piece::new(&corners, mesh.covers.of(triangle).residual)
                    }
                };
                self.to_be_kept.push((number, piece));
            }
        }
        Some(Rewritten { error: self.error, latest })
    }

    /// Notes what was measured last, once its collapse was made, with this dependency id.
    pub fn write(&mut self, mesh: &mut LiveMesh, order: u32) {
        for triangle in &self.old_triangles {
            mesh.covers.set(*triangle as usize, Cover::NOTHING);
        }
        for target in self.targets.iter().filter(|target| target.is_rewritten) {
            mesh.covers.set(target.triangle as usize, target.residual);
            mesh.triangles[target.triangle as usize].order = order;
        }
        if let Some(reverse) = &self.reverse {
            let new = self.targets.iter().filter(|target| target.is_around_gone);
            for (target, bound) in new.zip(&reverse.bounds) {
                mesh.covers.set_reverse(target.triangle as usize, *bound);
            }
        }
        for (number, piece) in &self.to_be_kept {
            let target = &self.targets[*number];
            if target.is_rewritten {
                mesh.covers.add_piece(target.triangle as usize, piece);
            }
        }
    }

    fn add_target(
        &mut self,
        mesh: &LiveMesh,
        triangle: u32,
        is_around_gone: bool,
        origin: [f32; 3],
        corners: [u32; 2],
    ) {
        self.targets.push(Target {
            triangle,
            is_around_gone,
            corners: corners.map(|corner| minus(mesh.vertices[corner as usize].position, origin)),
            residual: Cover::NOTHING,
            kept: [(0.0, Source::Triangle(0)); MOST_PIECES],
            kept_count: 0,
            is_rewritten: false,
        });
    }

    /// The targets where the old triangles are no fan: those of them that are left; where none is, those around the vertex
    /// that stays. By their canonical ids, so that the order of stars does not matter.
    fn add_other_targets(&mut self, mesh: &LiveMesh, gone: u32, stays: u32, ring: &[[u32; 2]], origin: [f32; 3]) {
        for (index, pair) in ring.iter().enumerate().filter(|(_, pair)| !pair.contains(&stays)) {
            self.add_target(mesh, self.old_triangles[index], true, origin, *pair);
        }
        if self.targets.is_empty() {
            for triangle in mesh.star(stays) {
                let others = mesh.others(*triangle, stays);
                if !others.contains(&gone) {
                    self.add_target(mesh, *triangle, false, origin, others);
                }
            }
        }
        self.targets.sort_unstable_by_key(|target| mesh.triangle_ids[target.triangle as usize]);
    }

    /// Puts the targets into lanes. Returns the longest squared vector.
    fn lay_out(&mut self) -> f32 {
        self.lanes.clear();
        let mut longest = Lanes::ZERO;
        for chunk in self.targets.chunks(LANES) {
            let [a, b] = [0, 1].map(|corner| Vectors::of(chunk.iter().map(|target| target.corners[corner])));
            longest = longest.max(a.dot(a)).max(b.dot(b));
            self.lanes.push(Triangles::new(a, b));
        }
        longest.largest()
    }

    /// Fixes what is allowed for rounding, by the longest squared vector.
    fn allow_for_rounding(&mut self, longest: f32, origin: [f32; 3]) {
        let reach = longest.sqrt() * ROUND_UP;
        let coordinate = origin[0].abs().max(origin[1].abs()).max(origin[2].abs());
        let of_places = PLACE_ROUNDING * (coordinate + reach);
        self.rounding = Rounding { of_distances: ROUNDING * reach, of_places };
    }

    /// Works out the rows of the pieces collected. Returns the longest squared vector.
    fn fill_rows(&mut self, origin: [f32; 3]) -> f32 {
        let Rewriter { collected, points, rows, lanes, targets, .. } = self;
        points.clear();
        rows.clear();
        let mut longest = Lanes::ZERO;
        for pair in collected.chunks(2) {
            let mut both = Vectors::ZERO;
            for (half, piece) in pair.iter().enumerate() {
                for corner in 0..piece.corner_count() {
                    both.set(half * MOST_CORNERS + corner, minus(piece.corners[corner], origin));
                }
            }
            longest = longest.max(both.dot(both));
            points.push(both);
        }
        if !points.is_empty() {
            for number in 0..targets.len() {
                let target = lanes[number / LANES].spread(number % LANES);
                rows.extend(points.iter().map(|points| target.square_distance(*points)));
            }
        }
        longest.largest()
    }

    /// The squared distances of the corners of a piece from a target. Of corners that it does not have, 0.
    #[inline]
    fn row(&self, target: usize, piece: usize) -> &[f32] {
        let row = &self.rows[target * self.points.len() + piece / 2].0;
        &row[piece % 2 * MOST_CORNERS..][..MOST_CORNERS]
    }

    /// How far the farthest corner of a piece is from a target, squared.
    #[inline]
    fn farthest(&self, target: usize, piece: usize) -> f32 {
        self.row(target, piece).iter().fold(0.0, |farthest, square| square.max(farthest))
    }

    /// The target that a piece is least far from whole, and how far its farthest corner is, squared.
    fn least_far(&self, piece: usize) -> (usize, f32) {
        let (mut best, mut square) = (0, f32::INFINITY);
        for target in 0..self.targets.len() {
            let farthest = self.farthest(target, piece);
            if farthest < square {
                (best, square) = (target, farthest);
            }
        }
        (best, square)
    }

    /// Hands on what is with a fan.
    fn collect_fan(&mut self, mesh: &LiveMesh, gone: u32, origin: [f32; 3]) {
        let sectors = self.targets.len();
        let gone_vector = minus(mesh.vertices[gone as usize].position, origin);
        let mut longest = self.lay_out().max(square(gone_vector));
        self.from_gone.clear();
        for lanes in &self.lanes {
            self.from_gone.extend(lanes.square_distance(Vectors::all(gone_vector)).0);
        }
        self.from_gone.truncate(sectors);
        self.spokes.clear();
        self.spokes.extend(self.targets.iter().map(|target| target.corners[0]));
        // The sector that the vertex that goes is nearest to.
        let nearest = (1..sectors).fold(
            0,
            |best, sector| {
                if self.from_gone[sector] < self.from_gone[best] { sector } else { best }
            },
        );
        self.nearest = nearest;
        let need = self.from_gone[nearest].sqrt();
        let mut most = 0.0_f32;
        for index in &self.fan.order {
            let cover = mesh.covers.of(self.old_triangles[*index] as usize);
            if cover.residual >= 0.0 {
                most = most.max(cover.residual + need);
            }
            self.collected.extend(mesh.covers.pieces(cover));
        }
        let pieces = self.collected.len();
        longest = longest.max(self.fill_rows(origin));
        for (index, pair) in self.collected.chunks(2).enumerate() {
            let rows = self.rows[index..].iter().step_by(self.points.len());
            let nearest = rows.fold(Lanes::all(f32::INFINITY), |nearest, row| nearest.min(*row));
            for (half, piece) in pair.iter().enumerate() {
                let corners = &nearest.0[half * MOST_CORNERS..][..MOST_CORNERS];
                let square = corners.iter().fold(0.0_f32, |farthest, square| square.max(farthest));
                most = most.max(piece.base + square.sqrt());
            }
        }
        self.allow_for_rounding(longest, origin);
        let budget = most * TOLERANCE;

        for number in 0..self.fan.order.len() {
            let index = self.fan.order[number];
            let residual = mesh.covers.of(self.old_triangles[index] as usize).residual;
            if residual < 0.0 {
                continue;
            }
            let own = number.saturating_sub(1).min(sectors - 1);
            let whole = self.from_gone[own];
            if own != nearest && residual + whole.sqrt() > budget {
                let [a, b] = [number, number + 1].map(|corner| self.fan.corners[corner]);
                let mut shape = Shape::default();
                let position = |vertex: u32| mesh.vertices[vertex as usize].position;
                shape.push(position(gone), nearest, self.from_gone[nearest]);
                shape.push(position(a), own, 0.0);
                shape.push(position(b), own, 0.0);
                if self.hand_on_parts(&shape, residual, origin, whole) {
                    continue;
                }
            }
            self.hand_on(own, residual, whole, Source::Triangle(index));
        }
        for index in 0..pieces {
            let piece = self.collected[index];
            let (best, square) = self.least_far(index);
            if piece.base + square.sqrt() > budget {
                let mut shape = Shape::default();
                for corner in 0..piece.corner_count() {
                    let at = |sector: usize| self.row(sector, index)[corner];
                    let nearest =
                        (1..sectors).fold(0, |best, sector| if at(sector) < at(best) { sector } else { best });
                    shape.push(piece.corners[corner], nearest, at(nearest));
                }
                if self.hand_on_parts(&shape, piece.base, origin, square) {
                    continue;
                }
            }
            self.hand_on(best, piece.base, square, Source::Collected(index));
        }
    }

    /// Cuts a piece and hands on its parts, if that is better than what it is whole: `whole`, squared.
    fn hand_on_parts(&mut self, shape: &Shape, base: f32, origin: [f32; 3], whole: f32) -> bool {
        if !self.cutter.cut(shape, origin, &self.spokes) {
            return false;
        }
        let base = (base + self.rounding.of_places) * ROUND_UP;
        let farthest = self.cutter.parts.iter().map(|part| part.square).fold(0.0, f32::max);
        if base + farthest.sqrt() >= (base - self.rounding.of_places) + whole.sqrt() {
            return false;
        }
        for index in 0..self.cutter.parts.len() {
            let part = self.cutter.parts[index];
            match part.corners() {
                Some(corners) if self.most_kept > 0 => {
                    self.collected.push(Piece::new(corners, base));
                    self.hand_on(part.sector, base, part.square, Source::Collected(self.collected.len() - 1));
                }
                _ => self.let_go(part.sector, base, part.square),
            }
        }
        true
    }

    /// How far a piece of this base is, whose farthest corner is so far, squared.
    fn distance(&self, base: f32, square: f32) -> f32 {
        (base + square.sqrt()) * ROUND_UP + self.rounding.of_distances
    }

    /// Hands a piece to a target.
    fn hand_on(&mut self, target: usize, base: f32, square: f32, source: Source) {
        let distance = self.distance(base, square);
        self.error = self.error.max(distance);
        self.targets[target].is_rewritten = true;
        self.targets[target].take(distance, source, self.most_kept);
    }

    /// Hands a piece to a target that does not keep it.
    fn let_go(&mut self, target: usize, base: f32, square: f32) {
        let distance = self.distance(base, square);
        self.error = self.error.max(distance);
        let target = &mut self.targets[target];
        target.is_rewritten = true;
        target.residual = target.residual.max(distance);
    }

    /// Hands on what is with triangles that are no fan: each piece whole to where it is least far.
    fn hand_on_whole(&mut self, mesh: &LiveMesh, gone: u32, origin: [f32; 3], ring: &[[u32; 2]]) {
        let mut longest = self.lay_out();
        let mut order: Vec<usize> = (0..ring.len()).collect();
        order.sort_unstable_by_key(|index| mesh.triangle_ids[self.old_triangles[*index] as usize]);
        for index in order {
            let cover = mesh.covers.of(self.old_triangles[index] as usize);
            if cover.residual >= 0.0 {
                let [a, b] = ring[index];
                let corners = [gone, a, b].map(|vertex| mesh.vertices[vertex as usize].position);
                self.collected.push(Piece::new(&corners, cover.residual));
            }
            self.collected.extend(mesh.covers.pieces(cover));
        }
        let handed_on = self.collected.len();
        // What the targets answer for already.
        let mut owners = Vec::new();
        for (number, target) in self.targets.iter_mut().enumerate().filter(|(_, target)| !target.is_around_gone) {
            let cover = mesh.covers.of(target.triangle as usize);
            target.residual = cover.residual;
            self.collected.extend(mesh.covers.pieces(cover));
            owners.resize(self.collected.len() - handed_on, number);
        }
        longest = longest.max(self.fill_rows(origin));
        self.allow_for_rounding(longest, origin);
        for (index, owner) in (handed_on..).zip(owners) {
            let distance = self.distance(self.collected[index].base, self.farthest(owner, index));
            self.targets[owner].take(distance, Source::Collected(index), self.most_kept);
        }
        for index in 0..handed_on {
            let (best, square) = self.least_far(index);
            self.hand_on(best, self.collected[index].base, square, Source::Collected(index));
        }
    }
}

impl Target {
    /// Takes a piece that is so far: keeps it if it is one of the farthest.
    fn take(&mut self, distance: f32, source: Source, most_kept: usize) {
        let mut piece = (distance, source);
        for place in 0..most_kept {
            if place == self.kept_count {
                self.kept[place] = piece;
                self.kept_count += 1;
                return;
            }
            if piece.0 > self.kept[place].0 {
                std::mem::swap(&mut self.kept[place], &mut piece);
            }
        }
        self.residual = self.residual.max(piece.0);
    }
}
