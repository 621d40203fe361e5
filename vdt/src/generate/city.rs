//! City: very many separate parts, and everything that a mesh can be beside a closed surface.
//!
//! Exactly as many triangles as asked for: the grounds take what the buildings leave. The city is a square of lots,
//! about `sqrt(triangles) / 2` of them (one at 10 triangles, 500 at a million), of up to some twenty parts each:
//!
//! | part | what it is |
//! |---|---|
//! | ground | an open sheet, slightly uneven, with a boundary; one on every lot |
//! | tower | two to four closed blocks on each other, and an antenna |
//! | twins | two blocks that share one vertical line of edges: each with four triangles |
//! | walls | three open sheets that meet in one vertical line of edges: each with three triangles |
//! | round tower | a closed prism of many sides |
//! | hourglass | two closed cones that share one vertex |
//! | block | a single closed box |
//!
//! The sides of a block are cut as finely as its share of the triangles allows: from two triangles a side to very
//! many. Kinds take turns, so that from some 1000 triangles on each of them is there; below that only what the
//! triangles suffice for, and always two parts or more. Parts stand in one another (an antenna in its tower), but no
//! two vertices of the file are in one place, and there are no T-junctions. Units are metres; lots are 100 m apart.
//!
//! Memory: the parts of one lot, a few kilobytes.

use crate::mesh::MeshError;

use super::noise::{Noise, sine_and_cosine};
use super::sheet::Sheet;
use super::{Model, TriangleSink, VertexSink};

/// From lot to lot; the streets take up what the grounds leave.
const LOT: f64 = 100.0;
const GROUND: f64 = 90.0;
/// The largest footprint of what stands in a quarter of a lot.
const FOOTPRINT: f64 = 36.0;
/// The fewest triangles of a block: a box with two for each side.
const LEAST_BLOCK: u64 = 12;
/// The fewest triangles of a spindle: two tetrahedra on each other.
const LEAST_SPINDLE: u64 = 6;
/// The fewest triangles of three walls: two for each.
const LEAST_WALLS: u64 = 6;
/// What is built in turn, see [`build`].
const KINDS: u64 = 6;
/// Of the triangles of a lot, at most so many are not in its ground.
const BUILT_SHARE: f64 = 0.7;

pub(super) struct City {
    seed: u64,
    triangles: u64,
    lots: u64,
    /// Sum of the weights of all lots.
    weights: u64,
    vertices: u64,
}

impl City {
    pub(super) fn new(triangles: u64, seed: u64) -> Self {
        let lots = (triangles.isqrt() / 2).max(1);
        let mut city = City { seed, triangles, lots, weights: 0, vertices: 0 };
        city.weights = (0..lots).map(|lot| city.weight(lot)).sum();
        city.vertices = city.parts().map(|part| part.vertices()).sum();
        city
    }

    /// How many triangles the lot gets, relative to others: from one to three.
    fn weight(&self, lot: u64) -> u64 {
        512 + Noise::new(self.seed, lot).hash(0, 0) % 1024
    }

    /// All parts of the city, lot by lot.
    fn parts(&self) -> impl Iterator<Item = Part> {
        let root = self.lots.isqrt();
        let side = root + u64::from(root * root < self.lots);
        let (mut weights, mut given) = (0, 0);
        let mut kind = Noise::new(self.seed, u64::MAX).hash(0, 0) % KINDS;
        (0..self.lots).flat_map(move |lot| {
            // Rounded down in the sum over all lots so far, which comes out even at the last one.
            weights += self.weight(lot);
            let reached = self.triangles * weights / self.weights;
            let corner = [lot % side, lot / side].map(|step| (step as f64 - side as f64 / 2.0) * LOT);
            let parts = self.lot(lot, reached - given, corner, &mut kind);
            given = reached;
            parts
        })
    }

    /// The parts of one lot: exactly `triangles` in all. `kind` is what is built next.
    fn lot(&self, lot: u64, triangles: u64, corner: [f64; 2], kind: &mut u64) -> Vec<Part> {
        let mut dice = Dice { noise: Noise::new(self.seed, lot), thrown: 0 };
        let quarters = (triangles / 40).clamp(1, 4);
        let shares: Vec<f64> = (0..quarters).map(|_| 0.15 + dice.between(0.0, 1.0) * dice.between(0.0, 1.0)).collect();
        let all: f64 = shares.iter().sum();
        let mut parts = Vec::new();
        for (quarter, share) in (0..).zip(shares) {
            let budget = (triangles as f64 * BUILT_SHARE * share / all) as u64;
            let half = [quarter % 2, quarter / 2].map(|step: u64| GROUND * (0.25 + 0.5 * step as f64));
            let centre = [corner[0] + half[0], corner[1] + half[1]];
            parts.extend(build(*kind, budget, centre, &mut dice));
            *kind = (*kind + 1) % KINDS;
        }
        let built: u64 = parts.iter().map(Part::triangles).sum();
        let sheet = Sheet::with_triangles(triangles - built);
        parts.push(Part::Ground(Ground { corner, sheet, uneven: Noise::new(self.seed, u64::MAX - 1) }));
        parts
    }
}

impl Model for City {
    fn vertex_count(&self) -> u64 {
        self.vertices
    }

    fn triangle_count(&self) -> u64 {
        self.triangles
    }

    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        self.parts().try_for_each(|part| part.emit_vertices(emit))
    }

    fn emit_triangles(&self, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        let mut base = 0;
        self.parts().try_for_each(|part| {
            part.emit_triangles(base, emit)?;
            base += part.vertices();
            Ok(())
        })
    }
}

/// One number after the other.
struct Dice {
    noise: Noise,
    thrown: u64,
}

impl Dice {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        self.thrown += 1;
        low + (high - low) * self.noise.uniform(self.thrown, 1)
    }
}

/// What stands in one quarter of a lot: at most `budget` triangles.
fn build(kind: u64, budget: u64, centre: [f64; 2], dice: &mut Dice) -> Vec<Part> {
    match kind {
        0 if budget >= 2 * LEAST_BLOCK + LEAST_SPINDLE => tower(budget, centre, dice),
        1 if budget >= 2 * LEAST_BLOCK => vec![twins(budget, centre, dice)],
        2 if budget >= LEAST_WALLS => vec![walls(budget, centre, dice)],
        3 if budget >= 2 * LEAST_SPINDLE => vec![hourglass(budget, centre, dice)],
        4 if budget >= LEAST_BLOCK => vec![block(budget, centre, dice)],
        _ if budget >= LEAST_SPINDLE => vec![round_tower(budget, centre, dice)],
        _ => Vec::new(),
    }
}

fn tower(budget: u64, centre: [f64; 2], dice: &mut Dice) -> Vec<Part> {
    let antenna = (budget / 8).max(LEAST_SPINDLE);
    let blocks = ((budget - antenna) / LEAST_BLOCK).min(2 + dice.between(0.0, 3.0) as u64);
    let each = (budget - antenna) / blocks;
    let (mut bottom, mut width, mut depth) = (0.0, dice.between(20.0, FOOTPRINT), dice.between(20.0, FOOTPRINT));
    let mut parts = Vec::new();
    for _ in 0..blocks {
        let size = [width, depth, dice.between(8.0, 25.0)];
        let origin = [centre[0] - width / 2.0, centre[1] - depth / 2.0, bottom];
        parts.push(Part::Block(Block { origin, size, cells: Block::cells(size, each, dice.between(0.5, 2.0)) }));
        // The next one begins inside this one, away from all its vertices.
        bottom += size[2] - 0.5;
        width *= dice.between(0.5, 0.85);
        depth *= dice.between(0.5, 0.85);
    }
    let length = dice.between(5.0, 20.0);
    let (sides, rings) = Spindle::fit(antenna, 8);
    parts.push(Part::Spindle(Spindle {
        axis: centre,
        tips: [bottom - 0.5, bottom + length],
        rings_between: [bottom, bottom + 0.9 * length],
        radii: [0.8, 0.2],
        sides,
        rings,
    }));
    parts
}

fn twins(budget: u64, centre: [f64; 2], dice: &mut Dice) -> Part {
    let [width, depth, other_width, other_depth] = [(); 4].map(|()| dice.between(8.0, FOOTPRINT / 2.0));
    let size = [width, depth, dice.between(10.0, 50.0)];
    let cells = Block::cells(size, budget / 2, dice.between(0.5, 2.0));
    let first = Block { origin: [centre[0] - width, centre[1] - depth, 0.0], size, cells };
    let second = Block { origin: [centre[0], centre[1], 0.0], size: [other_width, other_depth, size[2]], cells };
    Part::Twins(first, second)
}

fn walls(budget: u64, centre: [f64; 2], dice: &mut Dice) -> Part {
    let height = dice.between(3.0, 12.0);
    let start = dice.between(0.0, 1.0);
    let arms = [0.0, 1.0, 2.0].map(|third| {
        let (sine, cosine) = sine_and_cosine(start + (third + dice.between(-0.3, 0.3)) / 3.0);
        let length = dice.between(8.0, FOOTPRINT / 2.0);
        (length, [length * cosine, length * sine])
    });
    let length: f64 = arms.iter().map(|(length, _)| length).sum();
    let mut spacing = (2.0 * height * length / budget as f64).sqrt();
    loop {
        let cells = |length: f64| ((length / spacing) as u64).max(1);
        let walls = Walls {
            foot: centre,
            height,
            storeys: cells(height),
            arms: arms.map(|(length, reach)| Arm { reach, cells: cells(length) }),
        };
        if walls.triangles() <= budget {
            return Part::Walls(walls);
        }
        spacing *= 1.05;
    }
}

fn hourglass(budget: u64, centre: [f64; 2], dice: &mut Dice) -> Part {
    let (sides, rings) = Spindle::fit(budget / 2, 48);
    let (radius, waist) = (dice.between(3.0, 12.0), dice.between(0.5, 2.0));
    let height = dice.between(8.0, 40.0);
    let cone = |share: [f64; 4], radii| Spindle {
        axis: centre,
        tips: [share[0] * height, share[3] * height],
        rings_between: [share[1] * height, share[2] * height],
        radii,
        sides,
        rings,
    };
    let lower = cone([0.0, 0.05, 0.45, 0.5], [radius, waist]);
    let upper = cone([0.5, 0.55, 0.95, 1.0], [waist, radius]);
    Part::Hourglass(lower, upper)
}

fn block(budget: u64, centre: [f64; 2], dice: &mut Dice) -> Part {
    let size = [dice.between(10.0, FOOTPRINT), dice.between(10.0, FOOTPRINT), dice.between(4.0, 60.0)];
    let origin = [centre[0] - size[0] / 2.0, centre[1] - size[1] / 2.0, 0.0];
    // Some are cut much more coarsely than they could be.
    let share = dice.between(0.1, 1.0);
    let budget = ((budget as f64 * share * share) as u64).max(LEAST_BLOCK);
    Part::Block(Block { origin, size, cells: Block::cells(size, budget, dice.between(0.5, 2.0)) })
}

fn round_tower(budget: u64, centre: [f64; 2], dice: &mut Dice) -> Part {
    let (sides, rings) = Spindle::fit(budget, 64);
    let (height, radius) = (dice.between(10.0, 60.0), dice.between(4.0, FOOTPRINT / 2.0));
    Part::Spindle(Spindle {
        axis: centre,
        tips: [0.0, height + dice.between(0.5, 6.0)],
        rings_between: [0.0, height],
        radii: [radius, radius * dice.between(0.7, 1.0)],
        sides,
        rings,
    })
}

/// A part of the city: connected, and apart from all others.
enum Part {
    Ground(Ground),
    Block(Block),
    /// Two blocks of one height and the same cells: the last vertical edge of the first is the first of the second.
    Twins(Block, Block),
    Walls(Walls),
    Spindle(Spindle),
    /// Two spindles: the upper tip of the first is the lower tip of the second.
    Hourglass(Spindle, Spindle),
}

impl Part {
    fn vertices(&self) -> u64 {
        match self {
            Part::Ground(ground) => ground.sheet.vertices(),
            Part::Block(block) => block.vertices(),
            Part::Twins(first, second) => first.vertices() + second.vertices() - (first.cells[2] + 1),
            Part::Walls(walls) => (walls.storeys + 1) * walls.row_vertices(),
            Part::Spindle(spindle) => spindle.vertices(),
            Part::Hourglass(lower, upper) => lower.vertices() + upper.vertices() - 1,
        }
    }

    fn triangles(&self) -> u64 {
        match self {
            Part::Ground(ground) => ground.sheet.triangles(),
            Part::Block(block) => Block::triangles(block.cells),
            Part::Twins(first, second) => Block::triangles(first.cells) + Block::triangles(second.cells),
            Part::Walls(walls) => walls.triangles(),
            Part::Spindle(spindle) => spindle.triangles(),
            Part::Hourglass(lower, upper) => lower.triangles() + upper.triangles(),
        }
    }

    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        match self {
            Part::Ground(ground) => ground.emit_vertices(emit),
            Part::Block(block) => block.emit_vertices(0, emit),
            Part::Twins(first, second) => {
                first.emit_vertices(0, emit)?;
                second.emit_vertices(1, emit)
            }
            Part::Walls(walls) => walls.emit_vertices(emit),
            Part::Spindle(spindle) => spindle.emit_vertices(0, emit),
            Part::Hourglass(lower, upper) => {
                lower.emit_vertices(0, emit)?;
                upper.emit_vertices(1, emit)
            }
        }
    }

    /// `base` is the number of the part's first vertex.
    fn emit_triangles(&self, base: u64, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        match self {
            Part::Ground(ground) => ground.sheet.emit_triangles(base, emit),
            Part::Block(block) => block.emit_triangles(&|i, j, k| base + block.number(i, j, k), emit),
            Part::Twins(first, second) => {
                first.emit_triangles(&|i, j, k| base + first.number(i, j, k), emit)?;
                let [columns, rows, _] = first.cells;
                let second_base = base + first.vertices();
                let number = |i, j, k| match (i, j) {
                    (0, 0) => base + first.number(columns, rows, k),
                    // In every layer up to this one, the first vertex is the other block's.
                    _ => second_base + second.number(i, j, k) - (k + 1),
                };
                second.emit_triangles(&number, emit)
            }
            Part::Walls(walls) => walls.emit_triangles(base, emit),
            Part::Spindle(spindle) => spindle.emit_triangles(base, base + 1, emit),
            Part::Hourglass(lower, upper) => {
                lower.emit_triangles(base, base + 1, emit)?;
                let end = base + lower.vertices();
                upper.emit_triangles(end - 1, end, emit)
            }
        }
    }
}

/// An uneven sheet below the height 0, where all else begins.
struct Ground {
    corner: [f64; 2],
    sheet: Sheet,
    uneven: Noise,
}

impl Ground {
    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        let (lines, squares) = self.sheet.lines();
        for row in 0..lines {
            for column in 0..self.sheet.row_vertices(row) {
                let x = self.corner[0] + GROUND * (column as f64 / self.sheet.columns as f64);
                let y = self.corner[1] + GROUND * (row as f64 / squares as f64);
                emit([x, y, -0.35 + 0.1 * self.uneven.flat(x / 13.0, y / 13.0)])?;
            }
        }
        Ok(())
    }
}

/// A closed box whose sides are cut into squares, and those in two.
struct Block {
    origin: [f64; 3],
    size: [f64; 3],
    /// Squares along x, y and z.
    cells: [u64; 3],
}

impl Block {
    fn triangles([columns, rows, layers]: [u64; 3]) -> u64 {
        4 * (columns * rows + rows * layers + layers * columns)
    }

    /// Cells for at most `budget` triangles ([`LEAST_BLOCK`] or more), `stretch` times as high as wide.
    fn cells(size: [f64; 3], budget: u64, stretch: f64) -> [u64; 3] {
        let [width, depth, height] = [size[0], size[1], size[2] / stretch];
        let mut spacing = (4.0 * (width * depth + depth * height + height * width) / budget as f64).sqrt();
        loop {
            let cells = [width, depth, height].map(|length| ((length / spacing) as u64).max(1));
            if Block::triangles(cells) <= budget {
                return cells;
            }
            spacing *= 1.05;
        }
    }

    fn vertices(&self) -> u64 {
        Block::triangles(self.cells) / 2 + 2
    }

    /// The number of a vertex on the surface. Layers come one after the other: the lowest and the highest one whole,
    /// the others once around, each beginning with (0, 0).
    fn number(&self, i: u64, j: u64, k: u64) -> u64 {
        let [columns, rows, layers] = self.cells;
        let whole = (columns + 1) * (rows + 1);
        let around = 2 * (columns + rows);
        if k == 0 {
            j * (columns + 1) + i
        } else if k == layers {
            whole + (layers - 1) * around + j * (columns + 1) + i
        } else {
            let step = if j == 0 {
                i
            } else if i == columns {
                columns + j
            } else if j == rows {
                columns + rows + (columns - i)
            } else {
                around - j
            };
            whole + (k - 1) * around + step
        }
    }

    /// All vertices in order, without the first `skip` of each layer.
    fn emit_vertices(&self, skip: u64, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        let [columns, rows, layers] = self.cells;
        let mut vertex = |i: u64, j: u64, k: u64| {
            let share = [(i, columns), (j, rows), (k, layers)].map(|(step, steps)| step as f64 / steps as f64);
            emit([0, 1, 2].map(|axis| self.origin[axis] + self.size[axis] * share[axis]))
        };
        for k in 0..=layers {
            if k == 0 || k == layers {
                for number in skip..(columns + 1) * (rows + 1) {
                    vertex(number % (columns + 1), number / (columns + 1), k)?;
                }
            } else {
                (skip..columns).try_for_each(|i| vertex(i, 0, k))?;
                (0..rows).try_for_each(|j| vertex(columns, j, k))?;
                (0..columns).try_for_each(|i| vertex(columns - i, rows, k))?;
                (0..rows).try_for_each(|j| vertex(0, rows - j, k))?;
            }
        }
        Ok(())
    }

    /// All triangles, facing outward. `number` gives the number of a vertex.
    fn emit_triangles(
        &self,
        number: &dyn Fn(u64, u64, u64) -> u64,
        emit: &mut TriangleSink<'_>,
    ) -> Result<(), MeshError> {
        let [columns, rows, layers] = self.cells;
        let mut square = |corners: [(u64, u64, u64); 4]| {
            let [a, b, c, d] = corners.map(|(i, j, k)| number(i, j, k));
            emit([a, b, c])?;
            emit([a, c, d])
        };
        for j in 0..rows {
            for i in 0..columns {
                square([(i, j, 0), (i, j + 1, 0), (i + 1, j + 1, 0), (i + 1, j, 0)])?;
            }
        }
        for k in 0..layers {
            for i in 0..columns {
                square([(i, 0, k), (i + 1, 0, k), (i + 1, 0, k + 1), (i, 0, k + 1)])?;
                square([(i + 1, rows, k), (i, rows, k), (i, rows, k + 1), (i + 1, rows, k + 1)])?;
            }
            for j in 0..rows {
                square([(columns, j, k), (columns, j + 1, k), (columns, j + 1, k + 1), (columns, j, k + 1)])?;
                square([(0, j + 1, k), (0, j, k), (0, j, k + 1), (0, j + 1, k + 1)])?;
            }
        }
        for j in 0..rows {
            for i in 0..columns {
                square([(i, j, layers), (i + 1, j, layers), (i + 1, j + 1, layers), (i, j + 1, layers)])?;
            }
        }
        Ok(())
    }
}

/// Three upright sheets that meet in one line.
struct Walls {
    foot: [f64; 2],
    height: f64,
    /// Squares from bottom to top.
    storeys: u64,
    arms: [Arm; 3],
}

/// One of the sheets.
struct Arm {
    /// From the line where they meet to the other end.
    reach: [f64; 2],
    /// Squares along it.
    cells: u64,
}

impl Walls {
    fn row_vertices(&self) -> u64 {
        1 + self.arms.iter().map(|arm| arm.cells).sum::<u64>()
    }

    fn triangles(&self) -> u64 {
        2 * self.storeys * (self.row_vertices() - 1)
    }

    fn emit_vertices(&self, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        for storey in 0..=self.storeys {
            let height = self.height * (storey as f64 / self.storeys as f64);
            emit([self.foot[0], self.foot[1], height])?;
            for arm in &self.arms {
                for cell in 1..=arm.cells {
                    let share = cell as f64 / arm.cells as f64;
                    emit([self.foot[0] + arm.reach[0] * share, self.foot[1] + arm.reach[1] * share, height])?;
                }
            }
        }
        Ok(())
    }

    fn emit_triangles(&self, base: u64, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        let row = self.row_vertices();
        for storey in 0..self.storeys {
            let middle = base + storey * row;
            let mut arm_start = middle + 1;
            for arm in &self.arms {
                let mut from = middle;
                for to in arm_start..arm_start + arm.cells {
                    emit([from, to, to + row])?;
                    emit([from, to + row, from + row])?;
                    from = to;
                }
                arm_start += arm.cells;
            }
        }
        Ok(())
    }
}

/// A closed surface around an upright axis: rings of one size, and a tip below and above.
struct Spindle {
    axis: [f64; 2],
    /// Heights of the lower and the upper tip.
    tips: [f64; 2],
    /// Heights of the lowest and the highest ring.
    rings_between: [f64; 2],
    /// Radii of the lowest and the highest ring.
    radii: [f64; 2],
    sides: u64,
    rings: u64,
}

impl Spindle {
    /// Sides and rings for at most `budget` triangles ([`LEAST_SPINDLE`] or more).
    fn fit(budget: u64, most_sides: u64) -> (u64, u64) {
        let sides = (budget / 2).isqrt().clamp(3, most_sides);
        (sides, budget / 2 / sides)
    }

    fn vertices(&self) -> u64 {
        self.sides * self.rings + 2
    }

    fn triangles(&self) -> u64 {
        2 * self.sides * self.rings
    }

    /// The lower tip, ring after ring, the upper tip; without the first `skip`.
    fn emit_vertices(&self, skip: u64, emit: &mut VertexSink<'_>) -> Result<(), MeshError> {
        if skip == 0 {
            emit([self.axis[0], self.axis[1], self.tips[0]])?;
        }
        for ring in 0..self.rings {
            let share = ring as f64 / (self.rings - 1).max(1) as f64;
            let [radius, height] = [self.radii, self.rings_between].map(|[first, last]| first + (last - first) * share);
            for side in 0..self.sides {
                let (sine, cosine) = sine_and_cosine(side as f64 / self.sides as f64);
                emit([self.axis[0] + radius * cosine, self.axis[1] + radius * sine, height])?;
            }
        }
        emit([self.axis[0], self.axis[1], self.tips[1]])
    }

    /// `tip` is the number of the lower tip, `first` that of the first vertex of the first ring.
    fn emit_triangles(&self, tip: u64, first: u64, emit: &mut TriangleSink<'_>) -> Result<(), MeshError> {
        let next = |side: u64| (side + 1) % self.sides;
        for side in 0..self.sides {
            emit([tip, first + next(side), first + side])?;
        }
        for ring in 1..self.rings {
            let upper = first + ring * self.sides;
            let lower = upper - self.sides;
            for side in 0..self.sides {
                emit([lower + side, lower + next(side), upper + next(side)])?;
                emit([lower + side, upper + next(side), upper + side])?;
            }
        }
        let end = first + self.rings * self.sides;
        let last = end - self.sides;
        for side in 0..self.sides {
            emit([last + side, last + next(side), end])?;
        }
        Ok(())
    }
}
