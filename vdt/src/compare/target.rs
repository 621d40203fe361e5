//! The nearest point of a surface: runs of consecutive triangles under a hierarchy of boxes.
//!
//! Consecutive triangles are near each other, so a run of them has a small box. The boxes are cut at the median of their
//! longest axis again and again, four children to a node. A search goes down the nearest child first, from the triangle
//! that was nearest to the point before: queries in Morton order begin with a good guess.
//!
//! The result is that of looking at all triangles, bit by bit: the least computed distance, and among equals the first
//! triangle. For that, boxes are passed over only where they are farther than what was found by more than what rounding
//! can do. So neither the runs nor the order of the queries matter.
//!
//! Memory: 40 bytes for each run, 70 while it is built; runs are as short as the limit allows, four triangles at least.
//! I/O: what the windows of the searchers read.

use storage::StorageError;

use super::records::Window;
use super::surface::{CHUNK, Corners, Surface, exact};
use super::triangle::{Triangle, squared_distance};
use crate::vector::Vector;

/// The fewest triangles of a run.
const SHORTEST_RUN: usize = 4;
/// Bytes for each run while the hierarchy is built.
const BYTES_FOR_A_RUN: u64 = 72;
/// Children of a node.
const CHILDREN: usize = 4;
/// Marks the number of a run among those of nodes.
const RUN: u32 = 1 << 31;
/// What rounding may do to a distance, relative to the coordinates.
const ROUNDING: f64 = 1e-14;

/// Boxes of four children, side by side.
#[derive(Debug, Clone, Copy)]
struct Node {
    low: [[f32; CHILDREN]; 3],
    high: [[f32; CHILDREN]; 3],
    children: [u32; CHILDREN],
}

impl Node {
    /// No child: infinitely far from everything.
    const EMPTY: Node =
        Node { low: [[f32::INFINITY; CHILDREN]; 3], high: [[f32::NEG_INFINITY; CHILDREN]; 3], children: [0; CHILDREN] };

    /// Squares of the distances of the children's boxes from a point.
    #[inline]
    fn squared_distances(&self, point: Vector) -> [f64; CHILDREN] {
        let mut squares = [0.0; CHILDREN];
        for axis in 0..3 {
            for child in 0..CHILDREN {
                let below = f64::from(self.low[axis][child]) - point[axis];
                let above = point[axis] - f64::from(self.high[axis][child]);
                let apart = below.max(above).max(0.0);
                squares[child] += apart * apart;
            }
        }
        squares
    }
}

/// The box of a run, while the hierarchy is built.
#[derive(Debug, Clone, Copy)]
struct RunBox {
    low: [f32; 3],
    high: [f32; 3],
    run: u32,
}

impl RunBox {
    const EMPTY: RunBox = RunBox { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3], run: 0 };

    fn include(&mut self, low: [f32; 3], high: [f32; 3]) {
        for axis in 0..3 {
            self.low[axis] = self.low[axis].min(low[axis]);
            self.high[axis] = self.high[axis].max(high[axis]);
        }
    }

    /// The middle of the box, along an axis.
    fn middle(&self, axis: usize) -> f32 {
        self.low[axis] * 0.5 + self.high[axis] * 0.5
    }
}

/// A surface to which distances are measured.
#[derive(Debug)]
pub struct Target<'a> {
    pub(super) surface: &'a Surface,
    /// Triangles in a run.
    run: usize,
    nodes: Vec<Node>,
    /// The largest coordinate.
    scale: f64,
}

impl<'a> Target<'a> {
    /// Builds the hierarchy of boxes over a surface, in at most `ram_bytes` where runs of that length can be.
    ///
    /// # Errors
    ///
    /// Those of the scratch disk.
    pub fn new(surface: &'a Surface, ram_bytes: u64) -> Result<Self, StorageError> {
        let count = surface.triangle_count();
        let mut run = SHORTEST_RUN;
        while run < CHUNK && count.div_ceil(run as u64) * BYTES_FOR_A_RUN > ram_bytes {
            run *= 2;
        }
        let mut boxes = Vec::with_capacity(count.div_ceil(run as u64) as usize);
        let mut triangles = vec![Corners::default(); CHUNK];
        let mut start = 0;
        while start < count {
            let found = surface.triangles.read(start, &mut triangles)?;
            for triangles in triangles[..found].chunks(run) {
                let mut around = RunBox { run: boxes.len() as u32, ..RunBox::EMPTY };
                triangles.as_flattened().iter().for_each(|corner| around.include(*corner, *corner));
                boxes.push(around);
            }
            start += found as u64;
        }
        let mut nodes = Vec::with_capacity(boxes.len() / (CHILDREN - 1) + 1);
        nodes.push(Node::EMPTY);
        fill(&mut nodes, 0, &mut boxes);
        let scale = surface.bounds.iter().flatten().map(|value| f64::from(value.abs())).fold(0.0, f64::max);
        Ok(Target { surface, run, nodes, scale })
    }
}

/// Fills a node with the boxes of some runs, and makes the nodes below it.
fn fill(nodes: &mut Vec<Node>, node: usize, boxes: &mut [RunBox]) {
    let (left, right) = cut(boxes);
    let ((a, b), (c, d)) = (cut(left), cut(right));
    for (child, boxes) in [a, b, c, d].into_iter().enumerate() {
        let mut around = RunBox::EMPTY;
        boxes.iter().for_each(|other| around.include(other.low, other.high));
        for axis in 0..3 {
            nodes[node].low[axis][child] = around.low[axis];
            nodes[node].high[axis][child] = around.high[axis];
        }
        match boxes {
            [] => (),
            [only] => nodes[node].children[child] = RUN | only.run,
            _ => {
                let below = nodes.len();
                nodes[node].children[child] = below as u32;
                nodes.push(Node::EMPTY);
                fill(nodes, below, boxes);
            }
        }
    }
}

/// Cuts boxes in two, at the median along the axis on which their middles are spread the widest.
fn cut(boxes: &mut [RunBox]) -> (&mut [RunBox], &mut [RunBox]) {
    let half = boxes.len().div_ceil(2);
    if boxes.len() > 2 {
        let mut around = RunBox::EMPTY;
        for run in boxes.iter() {
            let middle = [0, 1, 2].map(|axis| run.middle(axis));
            around.include(middle, middle);
        }
        let extents = [0, 1, 2].map(|axis| around.high[axis] - around.low[axis]);
        let axis = (0..3).max_by(|left, right| extents[*left].total_cmp(&extents[*right])).unwrap_or(0);
        boxes.select_nth_unstable_by(half, |left, right| left.middle(axis).total_cmp(&right.middle(axis)));
    }
    boxes.split_at_mut(half)
}

/// What is nearest to a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Nearest {
    /// Square of the distance.
    pub squared: f64,
    /// Which triangle of the target it is: of several as near, the first.
    pub number: u64,
    /// That triangle, relative to the origin of the target.
    pub triangle: Triangle,
}

impl Nearest {
    /// The distance.
    pub fn distance(&self) -> f64 {
        self.squared.sqrt()
    }
}

/// Asks a target for what is nearest, with a cache and a memory of its own.
#[derive(Debug)]
pub(super) struct Searcher<'a> {
    target: &'a Target<'a>,
    window: Window<'a, Corners>,
    /// Boxes that are still to be looked at, with the squares of their distances.
    stack: Vec<(f64, u32)>,
    last: Option<(u64, Triangle)>,
}

impl<'a> Searcher<'a> {
    /// One with a cache of at most so many bytes, where the triangles are on disk.
    pub fn new(target: &'a Target<'a>, cache_bytes: usize) -> Self {
        let window = Window::new(&target.surface.triangles, target.run, cache_bytes);
        Searcher { target, window, stack: Vec::new(), last: None }
    }

    /// What is nearest to a point, which is given relative to the origin of the target.
    pub fn nearest(&mut self, point: Vector) -> Result<Nearest, StorageError> {
        let Target { nodes, run, scale, .. } = self.target;
        let slack = ROUNDING * point.iter().fold(*scale, |largest, value| largest.max(value.abs()));
        let reach_of = |squared: f64| {
            let reach = squared.sqrt() + slack;
            reach * reach
        };
        let mut best = Nearest { squared: f64::INFINITY, number: u64::MAX, triangle: Triangle::default() };
        if let Some((number, triangle)) = self.last {
            best = Nearest { squared: squared_distance(point, &triangle), number, triangle };
        }
        let mut reach = reach_of(best.squared);
        self.stack.clear();
        self.stack.push((0.0, 0));
        while let Some((squared, code)) = self.stack.pop() {
            if squared > reach {
                continue;
            }
            if code & RUN == 0 {
                let node = &nodes[code as usize];
                let squares = node.squared_distances(point);
                let first = self.stack.len();
                for (squared, child) in squares.into_iter().zip(node.children) {
                    if squared <= reach && squared < f64::INFINITY {
                        // The nearest comes on top.
                        let mut place = self.stack.len();
                        self.stack.push((squared, child));
                        while place > first && self.stack[place - 1].0 < squared {
                            self.stack.swap(place - 1, place);
                            place -= 1;
                        }
                    }
                }
                continue;
            }
            let number = u64::from(code & !RUN);
            let first = number * *run as u64;
            for (number, corners) in (first..).zip(self.window.run(number, *run)?) {
                let triangle = exact(corners);
                let squared = squared_distance(point, &triangle);
                if squared < best.squared || (squared == best.squared && number < best.number) {
                    best = Nearest { squared, number, triangle };
                    reach = reach_of(squared);
                }
            }
        }
        self.last = Some((best.number, best.triangle));
        Ok(best)
    }
}
