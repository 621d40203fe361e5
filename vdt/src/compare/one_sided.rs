//! How far one surface is from another, seen from the first.
//!
//! 1. *Samples*: their mean and root mean square. The vertices are looked at as well, every one or, where there are more
//!    than samples, every so many-th; and the largest distance of all these is kept.
//! 2. *Sweep*: every triangle is passed over if it cannot hold a larger distance, by the distance at a point near it that
//!    was looked at before. What is left is looked at closer (module `refine`), with a limited number of searches.
//! 3. What is open then is refined together, the worst first.
//!
//! Where colours are compared, that is done at the samples (module `paint`).
//!
//! Jobs are of a fixed size, and their sums are added in order: what comes out does not depend on the threads.
//!
//! Memory: for each thread 150 KB of triangles, 200 KB of open ones, its share of the caches, and 32 KB of looks on disk. I/O: the triangles and
//! the vertices of the first surface once or twice, and what the caches of the second miss.

use storage::StorageError;

use super::looks::{Look, Looks};
use super::paint::{Colour, Paint, difference};
use super::records::Window;
use super::refine::{Farthest, Open, OpenSet, cut};
use super::samples::{Sample, for_each_sample};
use super::surface::{CHUNK, Corners, Surface, exact};
use super::target::{Nearest, Searcher, Target};
use super::triangle::{farthest, nearest_weights};
use crate::vector::Vector;
use crate::workers::for_each;

/// Jobs between two reports of progress.
const JOBS_AT_ONCE: u64 = 64;

/// Searches in the sweep, for each triangle and for each sample: a chunk has those of its triangles, and as many more as
/// its share of the area.
const SEARCHES_FOR_A_TRIANGLE: u64 = 2;
const SEARCHES_FOR_A_SAMPLE: u64 = 2;
/// One triangle may have one part in so many of the searches that its chunk has left.
const PART_FOR_ONE: u64 = 8;

/// How far one surface is from another: distances of its points from the nearest ones of the other, in mesh units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OneSided {
    /// Mean over the area, by samples.
    pub mean: f64,
    /// Root of the mean square over the area, by samples.
    pub rms: f64,
    /// The largest distance that was found: the true maximum is no smaller.
    pub max: f64,
    /// The point where that is, in the coordinates of the file.
    pub max_at: [f64; 3],
    /// The true maximum is no larger than this, up to rounding.
    pub max_at_most: f64,
    /// Whether the search for the maximum came to its end: then `max_at_most` is larger by a thousandth at most, or by
    /// 1e-9 of the surface's diagonal. Else it was ended after as many searches as there may be.
    pub is_max_settled: bool,
    /// How far the colours are apart, where both surfaces have any and that was asked for.
    pub colours: Option<ColourDifference>,
}

/// How far the colours at the samples of a surface are from those at the nearest points of the other. Of several triangles
/// that are as near, the first one in the order of the other surface counts. In shares of the range of a channel, each the
/// mean over the three channels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColourDifference {
    /// Mean over the area.
    pub mean: f64,
    /// Root of the mean square over the area.
    pub rms: f64,
    /// The largest one at a sample.
    pub max: f64,
}

/// How to measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Samples on the surface.
    pub samples: u64,
    /// Threads that may work. The result does not depend on them.
    pub threads: usize,
    /// Bytes for the caches of all threads, which are needed where the other surface is on disk.
    pub cache_bytes: usize,
}

/// What a thread works with.
struct Worker<'a> {
    searcher: Searcher<'a>,
    triangles: Vec<Corners>,
    positions: Vec<[f32; 3]>,
    best: Farthest,
    open: OpenSet,
    painter: Option<Painter<'a>>,
}

/// The looks of both surfaces, and what they are painted with.
#[derive(Debug, Clone, Copy)]
pub(super) struct Painted<'a> {
    pub looks: [&'a Looks; 2],
    pub paint: [&'a Paint<'a>; 2],
}

/// Compares colours, with caches of its own.
struct Painter<'a> {
    paint: [&'a Paint<'a>; 2],
    windows: [Window<'a, Look>; 2],
}

impl<'a> Painter<'a> {
    /// Samples go over the first surface from front to back: there the smallest cache will do.
    fn new(Painted { looks, paint }: Painted<'a>, cache_bytes: usize) -> Self {
        let windows = [Window::new(&looks[0].records, 1, 0), Window::new(&looks[1].records, 1, cache_bytes)];
        Painter { paint, windows }
    }

    /// How far the colour at a sample is from that at the point that is nearest to it.
    fn difference(&mut self, sample: &Sample, at: Vector, nearest: &Nearest) -> Result<f64, StorageError> {
        let places = [(sample.triangle, sample.weights), (nearest.number, nearest_weights(at, &nearest.triangle))];
        let mut colours = [Colour::default(); 2];
        for (side, (triangle, weights)) in places.into_iter().enumerate() {
            // There is one for each triangle.
            if let Some(look) = self.windows[side].run(triangle, 1)?.first() {
                colours[side] = self.paint[side].colour(look, weights);
            }
        }
        Ok(difference(colours[0], colours[1]))
    }
}

/// What the samples of a job come to.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    distances: f64,
    squares: f64,
    colours: f64,
    colour_squares: f64,
    colour_max: f64,
}

impl Sums {
    fn add(&mut self, other: Sums) {
        self.distances += other.distances;
        self.squares += other.squares;
        self.colours += other.colours;
        self.colour_squares += other.colour_squares;
        self.colour_max = self.colour_max.max(other.colour_max);
    }
}

/// A surface on its way to the target's frame.
#[derive(Clone, Copy)]
struct Source<'a> {
    surface: &'a Surface,
    /// What to add to its positions.
    offset: Vector,
}

impl Source<'_> {
    fn placed(&self, point: Vector) -> Vector {
        std::array::from_fn(|axis| point[axis] + self.offset[axis])
    }
}

/// Measures how far a surface is from a target. `progress` is told the share of the work that is done, from 0 to 1.
///
/// # Errors
///
/// Those of the scratch disk.
pub fn one_sided(
    surface: &Surface,
    target: &Target<'_>,
    effort: Effort,
    progress: &mut dyn FnMut(f64),
) -> Result<OneSided, StorageError> {
    one_sided_painted(surface, target, None, effort, progress)
}

/// The same, and how far the colours are apart, of surfaces that have any.
pub(super) fn one_sided_painted<'a>(
    surface: &'a Surface,
    target: &'a Target<'a>,
    painted: Option<Painted<'a>>,
    effort: Effort,
    progress: &mut dyn FnMut(f64),
) -> Result<OneSided, StorageError> {
    let Effort { samples, threads, cache_bytes } = effort;
    let from = Source { surface, offset: surface.offset_to(target.surface) };
    let threads = threads.max(1);
    // Half of the caches is for the looks, where there are any.
    let cache_each = if painted.is_some() { cache_bytes / 2 } else { cache_bytes } / threads;
    let mut workers: Vec<Worker<'_>> = (0..threads)
        .map(|_| Worker {
            searcher: Searcher::new(target, cache_each),
            triangles: vec![Corners::default(); CHUNK],
            positions: vec![[0.0; 3]; CHUNK],
            best: Farthest::NONE,
            open: OpenSet::new(),
            painter: painted.map(|painted| Painter::new(painted, cache_each)),
        })
        .collect();
    let jobs_of = |count: u64| count.div_ceil(CHUNK as u64);
    let (vertices, triangles) = (surface.positions.len(), surface.triangle_count());
    let stride = vertices.div_ceil(samples.max(1));
    let jobs = [jobs_of(samples), jobs_of(vertices), jobs_of(triangles)];
    let all = jobs.iter().sum::<u64>().max(1) as f64;
    let mut report = |done: u64| progress(done as f64 / all);

    let mut sums = Sums::default();
    for_jobs(&mut workers, jobs[0], &mut report, &|worker, job| worker.sample(&from, job, samples), |of_job: Sums| {
        sums.add(of_job)
    })?;
    workers.iter_mut().for_each(|worker| worker.painter = None);
    let mut report = |done: u64| progress((jobs[0] + done) as f64 / all);
    for_jobs(&mut workers, jobs[1], &mut report, &|worker, job| worker.look_at_vertices(&from, job, stride), |()| ())?;

    let known = best_of(&workers);
    let mut report = |done: u64| progress((jobs[0] + jobs[1] + done) as f64 / all);
    for_jobs(&mut workers, jobs[2], &mut report, &|worker, job| worker.sweep(&from, job, known, samples), |()| ())?;

    let mut best = best_of(&workers);
    let mut open = OpenSet::new();
    workers.into_iter().for_each(|worker| open.append(worker.open));
    let mut searcher = Searcher::new(target, cache_bytes);
    let max_at_most = open.refine(&mut searcher, &mut best, surface.diagonal())?;
    let mean_of = |sum: f64| sum / samples.max(1) as f64;
    Ok(OneSided {
        mean: mean_of(sums.distances),
        rms: mean_of(sums.squares).sqrt(),
        max: best.distance,
        max_at: std::array::from_fn(|axis| best.at[axis] + target.surface.origin[axis]),
        max_at_most,
        is_max_settled: max_at_most <= best.enough(surface.diagonal()),
        colours: painted.map(|_| ColourDifference {
            mean: mean_of(sums.colours),
            rms: mean_of(sums.colour_squares).sqrt(),
            max: sums.colour_max,
        }),
    })
}

/// Does jobs number 0 to `count`, some at a time, and hands on what they came to, in order.
fn for_jobs<'a, R: Send>(
    workers: &mut [Worker<'a>],
    count: u64,
    report: &mut dyn FnMut(u64),
    work: &(dyn Fn(&mut Worker<'a>, u64) -> Result<R, StorageError> + Sync),
    mut take: impl FnMut(R),
) -> Result<(), StorageError> {
    let mut done = 0;
    while done < count {
        let now = (count - done).min(JOBS_AT_ONCE);
        for_each(workers, now as usize, |worker, job| work(worker, done + job as u64))?.into_iter().for_each(&mut take);
        done += now;
        report(done);
    }
    Ok(())
}

fn best_of(workers: &[Worker<'_>]) -> Farthest {
    let mut best = Farthest::NONE;
    workers.iter().for_each(|worker| best.include(worker.best));
    best
}

impl Worker<'_> {
    /// The sums over a job's samples.
    fn sample(&mut self, from: &Source<'_>, job: u64, samples: u64) -> Result<Sums, StorageError> {
        let Worker { searcher, triangles, best, painter, .. } = self;
        let mut sums = Sums::default();
        let first = job * CHUNK as u64;
        let numbers = first..(first + CHUNK as u64).min(samples);
        for_each_sample(from.surface, numbers, samples, triangles, |sample| {
            let at = from.placed(sample.point);
            let nearest = searcher.nearest(at)?;
            let distance = nearest.distance();
            let colour = match painter {
                Some(painter) => painter.difference(&sample, at, &nearest)?,
                None => 0.0,
            };
            sums.add(Sums {
                distances: distance,
                squares: nearest.squared,
                colours: colour,
                colour_squares: colour * colour,
                colour_max: colour,
            });
            best.include(Farthest { distance, at });
            Ok(())
        })?;
        Ok(sums)
    }

    /// Looks at each vertex whose number is a multiple of `stride`.
    fn look_at_vertices(&mut self, from: &Source<'_>, job: u64, stride: u64) -> Result<(), StorageError> {
        let first = job * CHUNK as u64;
        let found = from.surface.positions.read(first, &mut self.positions)?;
        for (number, position) in (first..).zip(&self.positions[..found]) {
            if number % stride == 0 {
                let at = from.placed(position.map(f64::from));
                let distance = self.searcher.nearest(at)?.distance();
                self.best.include(Farthest { distance, at });
            }
        }
        Ok(())
    }

    /// Looks closer at the triangles that may hold a larger distance than is known.
    fn sweep(&mut self, from: &Source<'_>, job: u64, known: Farthest, samples: u64) -> Result<(), StorageError> {
        let Worker { searcher, triangles, open, .. } = self;
        let diagonal = from.surface.diagonal();
        let first = job * CHUNK as u64;
        let found = from.surface.triangles.read(first, triangles)?;
        let mut searches = SEARCHES_FOR_A_TRIANGLE * found as u64;
        searches += (from.surface.share(job) * (SEARCHES_FOR_A_SAMPLE * samples) as f64) as u64;
        // What this job knows: not what others have found, or it would depend on the threads.
        let mut best = known;
        let mut last: Option<Farthest> = None;
        for (number, corners) in (first..).zip(&triangles[..found]) {
            let triangle = exact(corners).map(|corner| from.placed(corner));
            let mut bound = f64::INFINITY;
            if let Some(Farthest { distance, at }) = last {
                bound = distance + farthest(at, &triangle);
                if bound <= best.enough(diagonal) {
                    open.settle(bound);
                    continue;
                }
            }
            let (whole, middle) = Open::look(searcher, number, triangle, bound)?;
            best.include(middle);
            last = Some(middle);
            let allowed = searches / PART_FOR_ONE;
            let outcome = cut(vec![whole], allowed, searcher, &mut best, diagonal, |piece| open.add(piece))?;
            open.settle(outcome.settled);
            searches -= outcome.searches.min(searches);
        }
        self.best.include(best);
        Ok(())
    }
}
