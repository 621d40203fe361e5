//! The navigator (the paper, 3.3): adapts the front to the camera, frame by frame, in a fixed amount of memory.
//!
//! A frame
//! 1. computes the error of every active node and of every node that can be collapsed;
//! 2. collapses what is below the threshold, in the order of rising ids, so that every collapse finds done what it
//!    depends on; parents whose children become active follow;
//! 3. splits what is above it, the largest error first, so that a frame that cannot do everything has done the most
//!    important; children follow.
//!
//! Where a page is missing, the level at hand stays drawn and the page is asked for. Where the front or the pool is
//! full, the split is refused, and the threshold is raised a little for the next frame. It falls back while there is
//! room, but as long as the camera stands still not to where it hit a limit, so that the picture comes to rest.

use std::io;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use metanode::header::ModelError;
use metanode::model::Model;
use metanode::statement::{Drawn, is_proven, sum_not_below};
use metanode::vanished::VanishedParts;
use metanode::{DecodedFile, Statement};
use storage::usage::thread_cpu_time;
use thiserror::Error;

use crate::budget::{self, Budget, BudgetError, SPARE_SLOTS, Streams};
use crate::camera::{Camera, CameraError};
use crate::collapse_queue::CollapseQueue;
use crate::dependency::{self, Dependency};
use crate::flip;
use crate::front::{Capacity, DrawnWedge, Front, Misfit, NONE, WedgeKeeping};
use crate::io_process::Io;
use crate::paging::{Paging, PagingOptions, SWEEP_FRAMES};
use crate::pool::{HOLD_FRAMES, Hold, Policy, PoolCounters, reserved_slots};
use crate::prediction::{self, Predictor};
use crate::refine::{Chain, Outcome, PATIENCE, Refiner, want};
use crate::split_queue::SplitQueue;
use crate::statistics::FrameStatistics;
use crate::view::View;
use crate::view_parameters::{ViewParameters, ViewParametersError};
use crate::window::Window;

/// By how much the threshold rises with every frame that hit a limit, and falls where there is much room.
const RAISE: f32 = 1.1;
/// By how much it falls with every frame that has some room.
const LOWER: f32 = 1.02;
/// The most that it is raised.
const MOST_RAISED: f32 = 1e6;
/// There is much room where no limit is used by more than this part.
const MUCH_ROOM: f64 = 0.5;
/// There is some room where no limit is used by more than this part.
const SOME_ROOM: f64 = 0.85;
/// While the camera stands still, the threshold stays by this factor above where it hit a limit.
const KEEP_OFF: f32 = 1.05;
/// What the raised threshold is a multiple of, where less than this was asked for, in pixels.
const LEAST_RAISED_PIXELS: f32 = 0.01;
/// In how many frames a standing camera has what belongs to earlier views given up.
const FRAMES_TO_CLEAR: u32 = 8;
/// How many frames in which pages found no room count as a limit, while the camera stands still.
const STARVED_FRAMES: u32 = 2 * HOLD_FRAMES;
/// Most splits and collapses in a frame, if nothing else is said: they take 5 to 10 ms.
pub const MAX_ADAPTS: u64 = 16_000;
/// Most triangles, and most vertices, that a frame moves to gaps in their lists; while the camera moves, no more than there are
/// changes, so that what is sent to a graphics card for it stays in proportion.
const GAPS_CLOSED: usize = 512;
/// How many frames ahead pages are prefetched.
const FRAMES_AHEAD: f64 = 16.0;
/// What part of the threshold the error of a node must be then.
const LEAST_WISH: f32 = 0.7;
/// What part of the strongest wish that found no place a wish must be for it to be looked at.
const NEARLY: f32 = 0.9;
/// What part of the threshold the error of a node must be for its split to be kept for the sake of a triangle that would be turned
/// round. (Out of the picture a sixteenth of the error counts.) Two splits can each need the other: they would stay for ever.
const RELEASED: f32 = 1.0 / 256.0;
/// The step towards a split in which it is known where its page is.
const FIRST_OF_PAGE: usize = 2;
/// How long a navigator that is to settle waits for the I/O process at a time.
const LONGEST_WAIT: Duration = Duration::from_millis(100);

/// How to navigate.
#[derive(Debug, Clone, PartialEq)]
pub struct NavigatorOptions {
    /// Bytes of RAM for everything that grows with the model, the open model included.
    pub memory: u64,
    /// Error to be drawn at most, in pixels.
    pub pixels: f32,
    /// Width of the picture in pixels.
    pub width: u32,
    /// Height of the picture in pixels.
    pub height: u32,
    /// What counts in that error.
    pub view: ViewParameters,
    /// How changes depend on each other.
    pub dependency: Dependency,
    /// Most triangles to be drawn.
    pub max_triangles: Option<u64>,
    /// Most splits and collapses in a frame: what is left waits for the next, the most visible goes first. So a jump of the
    /// camera takes some frames, but none of them much longer than the others.
    pub max_adapts: Option<u64>,
    /// In how many frames a vertex that a split bears goes from where it was born to its own place, see
    /// [`Navigator::morph_stream`]; 0 for at once.
    pub geomorph: u32,
    /// Whether the front also has what the corners of triangles carry, see [`Navigator::wedge_stream`]: colours, texture coordinates,
    /// materials and given normals. Takes 20 bytes for each vertex, or some 28 and 24 for each triangle where the model has
    /// seams; nothing where the model has no attributes.
    pub attributes: bool,
    /// How the I/O process runs.
    pub io: Io,
    /// How many threads the I/O process has, where it has any; `None` for as many as the machine has cores, two to four. There
    /// are fewer where they would take too much of the memory.
    pub io_threads: Option<usize>,
    /// Whether pages are prefetched that will probably be needed soon.
    pub prefetch: bool,
    /// What becomes of pages that nobody needs at the moment.
    pub policy: Policy,
}

impl Default for NavigatorOptions {
    /// 16 MiB, one pixel at 1920 × 1080, all as in the paper, at most [`MAX_ADAPTS`] changes in a frame.
    fn default() -> Self {
        NavigatorOptions {
            memory: 16 << 20,
            pixels: 1.0,
            width: 1920,
            height: 1080,
            view: ViewParameters::default(),
            dependency: Dependency::Implicit,
            max_triangles: None,
            max_adapts: Some(MAX_ADAPTS),
            geomorph: 0,
            attributes: false,
            io: Io::Thread,
            io_threads: None,
            prefetch: true,
            policy: Policy::SecondChance,
        }
    }
}

/// What can go wrong in navigation.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum NavigatorError {
    /// The disk failed, or the model file is damaged.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A page is sound in itself, but does not fit to the others.
    #[error("{}: meta-node {page}: {source}; the file is damaged, build it again", path.display())]
    Misfit {
        /// The model file.
        path: PathBuf,
        /// Number of the meta-node.
        page: u32,
        /// What does not fit.
        source: Misfit,
    },
    /// A root is not one.
    #[error("{}: root {root} has the id 0 of a leaf; the file is damaged, build it again", path.display())]
    Root {
        /// The model file.
        path: PathBuf,
        /// Which root, counted from 0.
        root: usize,
    },
    /// The memory allowed is too little.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// The camera cannot be.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The view parameters cannot be.
    #[error(transparent)]
    View(#[from] ViewParametersError),
    /// An option is out of range.
    #[error("{problem}")]
    Options {
        /// What is wrong.
        problem: String,
    },
    /// The system gives no thread.
    #[error("cannot start the I/O thread: {source}")]
    Thread {
        /// What the system said.
        source: io::Error,
    },
}

/// A vertex of the drawn mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActiveNode {
    /// Number of the node in the front: below [`Navigator::node_bound`]. A frame may change it.
    pub node: u32,
    /// The leaf whose position it has: the first under it.
    pub leaf: u32,
    /// One past the last leaf under it.
    pub end_leaf: u32,
    /// Where it stands, in mesh units relative to the model's origin.
    pub position: [f32; 3],
    /// Its dependency id; 0 for a leaf.
    pub id: u32,
    /// Its switch value, in mesh units; 0 for a leaf.
    pub switch: f32,
}

/// A triangle of the drawn mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActiveTriangle {
    /// The active nodes that are its corners, by their numbers in the front.
    pub nodes: [u32; 3],
    /// The leaves whose positions they have.
    pub leaves: [u32; 3],
    /// Those positions, in mesh units relative to the model's origin.
    pub positions: [[f32; 3]; 3],
    /// The triangle of the input mesh that this one stands for: its corners as leaf numbers.
    pub source: [u32; 3],
}

/// A split that is applied: that of a node above active ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AppliedSplit {
    /// The leaf that it bears. No other split of the model bears that one.
    pub born_leaf: u32,
    /// Number of the meta-node that it is in.
    pub page: u32,
}

/// A meta-node that is in use, and where the vertices are that its splits bore.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActiveMetaNode {
    /// Its number.
    pub page: u32,
    /// How many of its splits are applied.
    pub splits: u32,
    /// The box around the vertices that they bore and those that they bore them from, in mesh units relative to the model's
    /// origin: its least corner,
    pub minimum: [f32; 3],
    /// and its largest.
    pub maximum: [f32; 3],
}

/// A model being looked at.
///
/// # What a caller does
///
/// Once for each picture: [`Navigator::frame`] with the camera. Then either all triangles are read ([`Navigator::triangles`]), or
/// copies of [`Navigator::vertex_stream`] and [`Navigator::triangle_stream`] are brought up to date, with what has changed since
/// the last time ([`Navigator::changed_vertices`], [`Navigator::changed_triangles`]), and then [`Navigator::forget_changes`] is
/// called. (With geomorphs there is a third stream, [`Navigator::morph_stream`]; with attributes there are [`Navigator::wedge_stream`]
/// and [`Navigator::corner_stream`].) At first everything has changed. A copy has to
/// follow the length of its stream, which rises and falls; ranges may reach beyond its end. `examples/buffers.rs` is that in 30 lines.
///
/// An error of a frame (a page cannot be read, however often it was tried; the camera cannot be) leaves the front as that of a
/// cut: it may be drawn, and the next frame goes on from there.
///
/// # Threads
///
/// With [`Io::Thread`], as many threads as [`Navigator::io_threads`] tells are started when it is opened; they read and decode pages, and sleep
/// while there is nothing to be read. They end when the navigator is dropped, which waits for the reads that they are at. With
/// [`Io::Sync`] and with mapped pages there are none. All else happens in the caller's thread, within the calls; a navigator may
/// be moved to another thread between them.
///
/// # Memory
///
/// The front, the queues, the place holders and the board are allocated when it is opened, in the size that the budget gives
/// them, and never grow. A frame that reads no page allocates nothing. Who reads pages allocates some short lists with each go, and
/// frees them; his buffers grow to the largest page that he meets. All of that is within [`Navigator::budget_bytes`], however long
/// the flight is (`tests/allocations.rs` counts). Beyond it is, for a time, what [`Navigator::statement`] takes, and
/// [`check`](crate::check), which is for tests.
#[derive(Debug)]
pub struct Navigator {
    model: Arc<Model>,
    options: NavigatorOptions,
    budget: Budget,
    streams: Streams,
    front: Front,
    paging: Paging,
    chain: Chain,
    split_queue: SplitQueue,
    collapse_queue: CollapseQueue,
    frame: u64,
    threshold_factor: f32,
    /// Whether the last frame changed nothing, missed nothing, and kept the threshold.
    is_at_rest: bool,
    /// With how many frames the camera has stood still, and nothing was changed, missed or wished.
    frames_at_rest: usize,
    last_camera: Option<Camera>,
    predictor: Predictor,
    /// With how many frames of this camera pages found no room.
    starved_frames: u32,
    /// Whether a page was missing in the last frame.
    chain_waits: bool,
    /// Counts the frames, but for those in which the camera stands still and a page is missing: what was split for a
    /// node that waits for one is then kept, however many it needs one after the other.
    patience_clock: u16,
    /// The camera of the last frame that hit a limit when it had stood still for a while, and the threshold's factor in it.
    limited_at: Option<(Camera, f32)>,
    /// With how many frames the camera has stood still.
    frames_standing: u32,
    /// The first vertex at which the next frame looks for collapses: where there were too many for the last one.
    collapses_from: u32,
    /// Whether anything has changed since the first vertices had their turn; and whether all have had it since the last change.
    turn_changed: bool,
    turn_was_quiet: bool,
    pool_counters: PoolCounters,
}

/// How many threads read and decode where nobody says how many: as many as there are cores, two to four.
fn usual_io_threads() -> usize {
    std::thread::available_parallelism().map_or(2, usize::from).clamp(2, 4)
}

fn check_pixels(pixels: f32) -> Result<(), NavigatorError> {
    if pixels >= 0.0 && pixels.is_finite() {
        return Ok(());
    }
    Err(NavigatorError::Options { problem: format!("an error of {pixels} pixels cannot be: give 0 or more") })
}

fn check_size(width: u32, height: u32) -> Result<(), NavigatorError> {
    if width > 0 && height > 0 {
        return Ok(());
    }
    Err(NavigatorError::Options { problem: format!("a picture of {width}x{height} pixels cannot be") })
}

impl Navigator {
    /// Allocates all memory, makes all roots active, loads the root pages and prefetches their children.
    pub fn open(model: Arc<Model>, options: NavigatorOptions) -> Result<Self, NavigatorError> {
        Self::open_with(model, options, None)
    }

    /// The same with pages by virtual memory, to compare with: `decoded` has those of the model. The front has room for what
    /// it would have room for with place holders in as much memory, so that both draw the same; the place holders' memory
    /// is left to the system's page cache. The options of the I/O process have no meaning.
    pub fn open_mapped(
        model: Arc<Model>,
        options: NavigatorOptions,
        decoded: DecodedFile,
    ) -> Result<Self, NavigatorError> {
        Self::open_with(model, options, Some(decoded))
    }

    fn open_with(
        model: Arc<Model>,
        options: NavigatorOptions,
        decoded: Option<DecodedFile>,
    ) -> Result<Self, NavigatorError> {
        check_pixels(options.pixels)?;
        check_size(options.width, options.height)?;
        options.view.check()?;
        let leaf_count = model.header().leaf_count;
        if let Some((root, _)) = model.roots().iter().enumerate().find(|(_, root)| root.id == 0) {
            return Err(NavigatorError::Root { path: model.path().into(), root });
        }
        let io_threads = match options.io {
            Io::Sync => 1,
            Io::Thread => options.io_threads.unwrap_or_else(usual_io_threads),
        };
        let appearance = model.appearance().filter(|_| options.attributes);
        let wedges = appearance.map_or(WedgeKeeping::None, |_| WedgeKeeping::of(&model));
        let streams = Streams { morphs: options.geomorph > 0, wedges };
        let budget = budget::plan_with(&model, options.memory, io_threads, streams)?;
        let budget = if decoded.is_some() { budget.with_mapped_pages(&model) } else { budget };
        let front = Front::new(model.roots(), leaf_count, budget.front);
        let front = if options.geomorph > 0 { front.with_morphs(options.geomorph) } else { front };
        let front = match appearance {
            Some(appearance) => front.with_wedges(appearance),
            None => front,
        };
        let vertices = front.capacity().vertices;
        // Of a mapped file, where all pages are there, there is nothing to wish for.
        let options = NavigatorOptions { prefetch: options.prefetch && decoded.is_none(), ..options };
        let NavigatorOptions { io, prefetch, policy, .. } = options;
        let paging_options = PagingOptions { slots: budget.slots, io, io_threads: budget.io_threads, prefetch, policy };
        let paging = match decoded {
            None => Paging::start(model.clone(), paging_options)?,
            Some(decoded) => Paging::mapped(model.clone(), decoded),
        };
        Ok(Navigator {
            model,
            options,
            budget,
            streams,
            front,
            paging,
            chain: Chain::new(),
            split_queue: SplitQueue::new(vertices),
            collapse_queue: CollapseQueue::new(vertices),
            frame: 0,
            threshold_factor: 1.0,
            is_at_rest: false,
            frames_at_rest: 0,
            last_camera: None,
            predictor: Predictor::default(),
            starved_frames: 0,
            chain_waits: false,
            patience_clock: 0,
            limited_at: None,
            frames_standing: 0,
            collapses_from: 0,
            turn_changed: false,
            turn_was_quiet: false,
            pool_counters: PoolCounters::default(),
        })
    }

    /// Asks for another error at most, in pixels, from the next frame on.
    pub fn set_pixels(&mut self, pixels: f32) -> Result<(), NavigatorError> {
        check_pixels(pixels)?;
        self.options.pixels = pixels;
        self.look_again();
        Ok(())
    }

    /// Allows so many triangles at most, from the next frame on. Where more are drawn, the threshold rises with every frame
    /// until they are gone.
    pub fn set_max_triangles(&mut self, max_triangles: Option<u64>) {
        self.options.max_triangles = max_triangles;
        self.look_again();
    }

    /// Gives the picture another size in pixels, from the next frame on.
    pub fn set_size(&mut self, width: u32, height: u32) -> Result<(), NavigatorError> {
        check_size(width, height)?;
        (self.options.width, self.options.height) = (width, height);
        self.look_again();
        Ok(())
    }

    /// What was found to be finished is not, and limits that were hit may not be limits any more.
    fn look_again(&mut self) {
        self.is_at_rest = false;
        self.frames_at_rest = 0;
        self.limited_at = None;
        self.starved_frames = 0;
        (self.turn_changed, self.turn_was_quiet) = (true, false);
    }

    /// Adapts the front to the camera, as far as pages, limits and dependencies allow.
    ///
    /// After an error the front is still that of a cut, and the next frame goes on from there.
    pub fn frame(&mut self, camera: &Camera) -> Result<FrameStatistics, NavigatorError> {
        self.frame_with(camera, self.options.max_adapts)
    }

    /// A frame with at most so many changes.
    fn frame_with(&mut self, camera: &Camera, max_adapts: Option<u64>) -> Result<FrameStatistics, NavigatorError> {
        let max_adapts = max_adapts.unwrap_or(u64::MAX);
        let (start, cpu_start) = (Instant::now(), thread_cpu_time());
        self.is_at_rest = false;
        let view = self.view(camera)?;
        self.check_failure()?;
        self.paging.begin_frame();
        self.predictor.add(camera);
        let stands_still = self.last_camera == Some(*camera);
        self.last_camera = Some(*camera);
        self.frames_standing = if stands_still { self.frames_standing.saturating_add(1) } else { 0 };
        self.turn_was_quiet &= stands_still;
        if !(stands_still && self.chain_waits) {
            self.patience_clock = self.patience_clock.wrapping_add(1);
        }
        self.chain_waits = false;
        let mut statistics = FrameStatistics {
            frame: self.frame,
            threshold_factor: self.threshold_factor,
            ..FrameStatistics::default()
        };
        self.frame += 1;

        self.front.step_morphs();
        let threshold = self.threshold();
        let waits = self.evaluate(&view, threshold);
        self.collapse(&view, threshold, max_adapts, &mut statistics);
        self.split(&view, threshold, max_adapts, &mut statistics)?;
        self.wish_ahead(&view, threshold)?;
        let has_wishes = self.paging.end_frame();
        self.check_failure()?;
        let changes = (statistics.splits + statistics.collapses) as usize;
        self.front.close_gaps(if stands_still { GAPS_CLOSED } else { GAPS_CLOSED.min(changes) });

        statistics.requests = statistics.splits + statistics.collapses + statistics.misses;
        if statistics.splits + statistics.collapses > 0 {
            (self.turn_changed, self.turn_was_quiet) = (true, false);
        }
        statistics.triangles = self.front.triangle_count() as u64;
        statistics.vertices = self.front.vertex_count() as u64;
        statistics.morphs = self.front.under_way() as u64;
        statistics.pages_in_use = self.paging.in_use() as u64;
        let counters = self.paging.pool().counters();
        statistics.pool = counters - self.pool_counters;
        self.pool_counters = counters;
        if self.starves_for_long(stands_still, statistics.pool.starved > 0) {
            statistics.over_budget += 1;
        }
        if self.front.triangle_count() > self.triangle_limit() {
            // The limit was lowered: what is drawn must go, though nothing more is wanted.
            statistics.over_budget += 1;
        }
        self.adjust_threshold(camera, statistics.over_budget > 0);
        self.is_at_rest = statistics.requests == 0
            && statistics.postponed + statistics.morphs == 0
            && !waits
            && self.threshold_factor == statistics.threshold_factor;
        let rests = self.is_at_rest && stands_still && !has_wishes;
        self.frames_at_rest = if rests { self.frames_at_rest + 1 } else { 0 };
        statistics.frame_ms = start.elapsed().as_secs_f64() * 1e3;
        statistics.cpu_ms = (thread_cpu_time() - cpu_start).as_secs_f64() * 1e3;
        let (largest_switch, pixels_drawn) = self.drawn(&view, threshold);
        statistics.pixels_drawn = pixels_drawn;
        let header = self.model.header();
        statistics.error_stated = sum_not_below(largest_switch, header.input_error);
        statistics.guaranteed = is_proven(header, self.is_a_state(), largest_switch);
        statistics.vanished_parts = self.front.vanished_trees() as u64;
        Ok(statistics)
    }

    /// Runs frames with this camera until nothing changes any more, but no more than `max_frames`; the last frame's
    /// statistics. They make as many changes as they find, and wait for the I/O process in between.
    pub fn run_until_settled(&mut self, camera: &Camera, max_frames: u64) -> Result<FrameStatistics, NavigatorError> {
        let mut statistics = self.frame_with(camera, None)?;
        for _ in 1..max_frames {
            if self.settled() {
                break;
            }
            self.paging.board().wait_until_idle(LONGEST_WAIT);
            statistics = self.frame_with(camera, None)?;
        }
        Ok(statistics)
    }

    /// Whether another frame with the same camera would change nothing: nothing is missing, nothing outstanding, and
    /// the last frame changed nothing; nor do the next ones wish for anything, of whatever part of the front.
    pub fn settled(&self) -> bool {
        let has_looked_everywhere = !self.options.prefetch || self.frames_at_rest >= SWEEP_FRAMES;
        self.is_at_rest && has_looked_everywhere && self.paging.board().is_idle()
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Bytes of the memory allowed that are allocated, the open model included; all that will ever be.
    pub fn budget_bytes(&self) -> u64 {
        self.budget.bytes
    }

    /// Bytes that the vertices and triangles of the front take at the moment.
    pub fn front_bytes(&self) -> u64 {
        budget::front_bytes(&self.front.used(), self.streams)
    }

    /// Number of place holders.
    pub fn place_holders(&self) -> usize {
        self.budget.slots
    }

    /// Number of those who read and decode pages.
    pub fn io_threads(&self) -> usize {
        self.budget.io_threads
    }

    /// Number of triangles drawn.
    pub fn triangle_count(&self) -> usize {
        self.front.triangle_count()
    }

    /// Number of active nodes, that is of vertices.
    pub fn active_count(&self) -> usize {
        self.front.vertex_count()
    }

    /// The numbers of active nodes are below this.
    pub fn node_bound(&self) -> u32 {
        self.front.vertex_bound()
    }

    /// The vertices of the drawn mesh; also roots that no triangle is left of.
    pub fn active_nodes(&self) -> impl Iterator<Item = ActiveNode> + '_ {
        self.front.vertices().map(|node| {
            let sphere = self.front.sphere(node);
            let (leaf, end_leaf) = self.front.interval(node);
            ActiveNode {
                node,
                leaf,
                end_leaf,
                position: sphere.position,
                id: self.front.id(node),
                switch: sphere.switch,
            }
        })
    }

    /// The triangles of the drawn mesh.
    pub fn triangles(&self) -> impl Iterator<Item = ActiveTriangle> + '_ {
        self.front.triangles().map(|(triangle, nodes)| ActiveTriangle {
            nodes,
            leaves: nodes.map(|node| self.front.interval(node).0),
            positions: nodes.map(|node| self.front.sphere(node).position),
            source: nodes.map(|node| self.front.leaf_at(node, triangle)),
        })
    }

    /// Where the vertices stand, by their numbers: x, y, z in mesh units relative to the model's origin, and the bits of the
    /// word of the normal ([`metanode::page::Normal`]). What stands at a number that no vertex has is to be ignored. A renderer
    /// keeps a copy: after a frame, what is different is told by [`Navigator::changed_vertices`].
    pub fn vertex_stream(&self) -> &[[f32; 4]] {
        self.front.positions()
    }

    /// The corners of the triangles as numbers of vertices. In places where there is no triangle they are the same three times,
    /// so that nothing is drawn there. What is different after a frame is told by [`Navigator::changed_triangles`].
    pub fn triangle_stream(&self) -> &[[u32; 3]] {
        self.front.corners()
    }

    /// The numbers of the vertices that are new since [`Navigator::forget_changes`], as ranges in rising order; two that have at
    /// most `gap` others between them as one.
    pub fn changed_vertices(&self, gap: u32) -> impl Iterator<Item = Range<u32>> + '_ {
        self.front.changes().0.ranges(gap)
    }

    /// The same for the places of the triangles that changed. Those behind the end of the stream are gone.
    pub fn changed_triangles(&self, gap: u32) -> impl Iterator<Item = Range<u32>> + '_ {
        self.front.changes().1.ranges(gap)
    }

    /// Where vertices come from that splits bore in the last frames, by their numbers: x, y, z, and a weight, 0 when they were
    /// just born and 1 when they have arrived. With [`NavigatorOptions::geomorph`], who draws puts a vertex not at its position
    /// but at `origin + weight * (position - origin)`; then no split is seen to jump, but what is drawn comes so many frames
    /// later to the error that the statistics tell. Empty without.
    pub fn morph_stream(&self) -> &[[f32; 4]] {
        self.front.morphs().map_or(&[], |morphs| morphs.stream())
    }

    /// The numbers of the vertices whose origins or weights are different since [`Navigator::forget_changes`], as ranges like
    /// those of [`Navigator::changed_vertices`].
    pub fn changed_morphs(&self, gap: u32) -> impl Iterator<Item = Range<u32>> + '_ {
        self.front.morphs().into_iter().flat_map(move |morphs| morphs.changes().ranges(gap))
    }

    /// What corners of triangles carry besides positions, with [`NavigatorOptions::attributes`]: of a model without seams, where all
    /// corners at a vertex have the same, by the numbers of the vertices; of one with seams by numbers that
    /// [`Navigator::corner_stream`] has. What stands at a number that no vertex or corner has is to be ignored. Empty without
    /// that option, and where the model has no attributes.
    pub fn wedge_stream(&self) -> &[DrawnWedge] {
        self.front.wedges().map_or(&[], |wedges| wedges.stream())
    }

    /// The numbers of the wedges that are new since [`Navigator::forget_changes`], as ranges like those of
    /// [`Navigator::changed_vertices`].
    pub fn changed_wedges(&self, gap: u32) -> impl Iterator<Item = Range<u32>> + '_ {
        self.front.changed_wedges().into_iter().flat_map(move |changes| changes.ranges(gap))
    }

    /// For each place in [`Navigator::triangle_stream`] the wedges of its corners, by their numbers in [`Navigator::wedge_stream`];
    /// zeros where there is no triangle. What is different after a frame is told by [`Navigator::changed_triangles`]: a corner
    /// has another wedge only where its triangle is new, or it is at another vertex. Empty where the wedge stream is
    /// empty, or the model has no seams.
    pub fn corner_stream(&self) -> &[[u32; 3]] {
        self.front.wedges().and_then(|wedges| wedges.seams()).map_or(&[], |seams| seams.corners())
    }

    /// The streams were copied: from now on, changes are new ones.
    pub fn forget_changes(&mut self) {
        self.front.clear_changes();
    }

    /// The splits that are applied, in no particular order: one for each active node that is no root. Their meta-nodes
    /// are those in use.
    pub fn applied_splits(&self) -> impl Iterator<Item = AppliedSplit> + '_ {
        self.front.born().map(|born| AppliedSplit {
            born_leaf: self.front.interval(born).0,
            page: self.paging.page_number(self.front.slot(born)),
        })
    }

    /// The meta-nodes in use, by their numbers. Takes RAM for them beyond the budget; for pictures of how a front is paged.
    pub fn active_meta_nodes(&self) -> Vec<ActiveMetaNode> {
        let mut found: Vec<ActiveMetaNode> = Vec::new();
        // Place holders by their numbers: where each one's meta-node is in that list, counted from 1.
        let mut places = vec![0_usize; self.budget.slots];
        for born in self.front.born() {
            let slot = self.front.slot(born);
            let place = &mut places[slot as usize];
            if *place == 0 {
                let nothing = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
                let page = self.paging.page_number(slot);
                found.push(ActiveMetaNode { page, splits: 0, minimum: nothing.0, maximum: nothing.1 });
                *place = found.len();
            }
            let node = &mut found[*place - 1];
            node.splits += 1;
            for vertex in [born, self.front.kept(born)] {
                let position = self.front.sphere(vertex).position;
                for axis in 0..3 {
                    node.minimum[axis] = node.minimum[axis].min(position[axis]);
                    node.maximum[axis] = node.maximum[axis].max(position[axis]);
                }
            }
        }
        found.sort_unstable_by_key(|node| node.page);
        found
    }

    /// What can be said of the drawn surface's distance from the input, in the picture or not. Takes 31 bytes of RAM for
    /// each part that is not drawn, beyond the budget.
    pub fn statement(&self) -> Statement {
        let is_drawn = |tree: usize| self.front.tree_triangles(tree) > 0;
        let roots = self.model.roots().iter().enumerate();
        let mut vanished = VanishedParts::new(roots.filter(|(tree, _)| !is_drawn(*tree)).map(|(_, root)| root));
        let mut largest_switch = 0.0_f32;
        for vertex in self.front.vertices() {
            let sphere = self.front.sphere(vertex);
            if !self.front.is_bare(vertex) {
                vanished.pass(sphere.position);
            }
            if sphere.switch > largest_switch && is_drawn(self.front.tree_of(self.front.interval(vertex).0)) {
                largest_switch = sphere.switch;
            }
        }
        let drawn = Drawn { largest_switch, is_a_state: self.is_a_state(), vanished: &vanished };
        Statement::new(self.model.header(), drawn)
    }

    /// Whether every front is a state of the construction.
    fn is_a_state(&self) -> bool {
        self.options.dependency == Dependency::Implicit
    }

    pub(crate) fn front(&self) -> &Front {
        &self.front
    }

    pub(crate) fn paging(&self) -> &Paging {
        &self.paging
    }

    pub(crate) fn dependency(&self) -> Dependency {
        self.options.dependency
    }

    /// What this camera sees of the model.
    pub(crate) fn view(&self, camera: &Camera) -> Result<View, CameraError> {
        let NavigatorOptions { width, height, view, .. } = &self.options;
        View::new(camera, self.model.header(), *width, *height, view)
    }

    fn check_failure(&self) -> Result<(), NavigatorError> {
        self.paging.board().take_failure().map_or(Ok(()), |failure| Err(failure.into()))
    }

    /// The error allowed at the moment, in pixels: what was asked for, or more because of limits.
    pub fn threshold(&self) -> f32 {
        if self.threshold_factor > 1.0 {
            self.options.pixels.max(LEAST_RAISED_PIXELS) * self.threshold_factor
        } else {
            self.options.pixels
        }
    }

    /// Collects what is to be split and what to be collapsed; true if a collapse has to wait for a later frame.
    fn evaluate(&mut self, view: &View, threshold: f32) -> bool {
        let (for_split, for_collapse) = (view.splits(threshold), view.collapses(threshold));
        let (split_queue, collapse_queue) = (&mut self.split_queue, &mut self.collapse_queue);
        split_queue.clear();
        collapse_queue.clear();
        let front = &self.front;
        let mut full_at = None;
        let from = std::mem::take(&mut self.collapses_from);
        for (first, positions, groups) in front.blocks() {
            let judged = for_split.judge(&for_collapse, positions, groups);
            for place in bits(judged.split) {
                split_queue.push(first + place, judged.errors[place as usize] / threshold);
            }
            if first >= from && full_at.is_none() && !collapse_queue.find(first, judged.collapse) {
                full_at = Some(first);
            }
        }
        let (clock, mut waits) = (self.patience_clock, false);
        collapse_queue.order(
            |vertex, step| front.prefetch_last_born(vertex, step),
            |vertex| {
                let born = front.last_born(vertex);
                let is_deferred = front.collapse_is_deferred(born, clock, PATIENCE);
                waits |= is_deferred;
                (!is_deferred).then(|| (front.id_above(born), born))
            },
        );
        // Where there are too many, as many as are kept from it by their neighbours: the next frame goes on from there. When
        // they have all had their turn and nothing has changed, nothing will.
        self.collapses_from = full_at.unwrap_or(0);
        let is_in_turns = full_at.is_some() || from > 0;
        if full_at.is_none() {
            self.turn_was_quiet |= is_in_turns && !self.turn_changed;
            self.turn_changed = false;
        }
        waits || (is_in_turns && !self.turn_was_quiet)
    }

    /// Names the pages that will probably be needed by and by: those of the active nodes whose error will be near the
    /// threshold where the camera will probably be, see [`prediction`](crate::prediction). A part of the front in each frame.
    fn wish_ahead(&mut self, now: &View, threshold: f32) -> Result<(), NavigatorError> {
        let listens = self.options.prefetch && !self.paging.has_all_pages();
        let Some(camera) = self.predictor.ahead(FRAMES_AHEAD).filter(|_| listens) else { return Ok(()) };
        let then = self.view(&camera)?;
        // What is much weaker than what found no place last would find none again.
        let least = (self.paging.weakest_wish() * NEARLY).clamp(LEAST_WISH, 1.0);
        // The test for collapses has a wider frustum: a node beside the picture may be forced by one in it.
        let (for_wish, then, now) = (then.collapses(threshold * least), then.splits(threshold), now.splits(threshold));
        let part = self.frame as usize % SWEEP_FRAMES;
        let (front, paging) = (&self.front, &mut self.paging);
        let blocks = front.blocks().zip(front.leads_out()).skip(part).step_by(SWEEP_FRAMES);
        let found = blocks.map(|((first, positions, groups), leads_out)| {
            let found = for_wish.exceeding(positions, groups) & leads_out;
            bits(found).for_each(|place| front.prefetch_last_born(first + place, 0));
            (first, found)
        });
        // While one block is looked at, the vertices of the next are fetched.
        let mut before = (0, 0);
        for block in found.chain([(0, 0)]) {
            let (first, found) = std::mem::replace(&mut before, block);
            for vertex in bits(found).map(|place| first + place) {
                if paging.will_stay(front.place(vertex).0) {
                    continue;
                }
                let sphere = front.sphere(vertex);
                let priority = prediction::priority(now.error(&sphere), then.error(&sphere), threshold);
                paging.wish(&want(front, vertex, priority));
            }
        }
        Ok(())
    }

    /// Says of a split that can be undone, by the vertex that it bore, whether a dependency keeps it.
    pub(crate) fn keeps_splits(&self, view: &View, threshold: f32) -> impl Fn(&Front, u32) -> bool + use<> {
        let for_release = view.collapses(threshold * RELEASED);
        let dependency = self.options.dependency;
        move |front: &Front, born: u32| match dependency {
            Dependency::Implicit => dependency::collapse_is_blocked(front, born),
            Dependency::Flip => {
                flip::collapse_is_blocked(front, born) && for_release.is_exceeded(&front.sphere_above(born))
            }
            Dependency::None => false,
        }
    }

    fn collapse(&mut self, view: &View, threshold: f32, max_adapts: u64, statistics: &mut FrameStatistics) {
        let for_collapse = view.collapses(threshold);
        let is_kept = self.keeps_splits(view, threshold);
        // Splits may have half of what a frame can do, or all that collapses leave.
        let splits = self.split_queue.len() as u64;
        let most = max_adapts - splits.min(max_adapts / 2);
        let front = &mut self.front;
        while statistics.collapses < most
            && let Some(born) = self.collapse_queue.next(|born, step| front.prefetch_for_collapse(born, step))
        {
            if is_kept(front, born) {
                statistics.blocked += 1;
                continue;
            }
            let (slot, kept) = (front.slot(born), front.kept(born));
            front.collapse(born, self.paging.page_number(slot));
            self.paging.end_use(slot, Hold::End);
            statistics.collapses += 1;
            let above = front.split_above(kept);
            if above != NONE && front.is_collapsible(above) && !for_collapse.is_exceeded(&front.sphere_above(above)) {
                self.collapse_queue.follow(front.id_above(above), above);
            }
        }
        statistics.postponed += self.collapse_queue.len() as u64;
    }

    fn split(
        &mut self,
        view: &View,
        threshold: f32,
        max_adapts: u64,
        statistics: &mut FrameStatistics,
    ) -> Result<(), NavigatorError> {
        let for_split = view.splits(threshold);
        let triangle_limit = self.triangle_limit();
        let most = max_adapts.saturating_sub(statistics.collapses);
        let queue = &mut self.split_queue;
        let mut window = Window::default();
        let mut refiner = Refiner {
            front: &mut self.front,
            paging: &mut self.paging,
            chain: &mut self.chain,
            dependency: self.options.dependency,
            triangle_limit,
            now: self.patience_clock,
        };
        while statistics.splits < most
            && let Some(vertex) = window.next(
                || queue.pop(),
                |vertex, step| {
                    refiner.front.prefetch_for_split(vertex, step);
                    if let Some(step) = step.checked_sub(FIRST_OF_PAGE) {
                        let front = &refiner.front;
                        refiner.paging.prefetch(front.slot_above(vertex), front.place(vertex), step);
                    }
                },
            )
        {
            let is_node = refiner.front.is_vertex(vertex) && !refiner.front.is_leaf(vertex);
            // Else it was forced before, or undone since.
            let Some(error) = is_node.then(|| for_split.exceeded(&refiner.front.sphere(vertex))).flatten() else {
                continue;
            };
            let refinement = refiner.split(vertex, error / threshold.max(f32::MIN_POSITIVE))?;
            for born in refiner.born() {
                let front = &refiner.front;
                for child in [front.kept(born), born].into_iter().filter(|child| !front.is_leaf(*child)) {
                    if let Some(error) = for_split.exceeded(&front.sphere(child)) {
                        queue.push(child, error / threshold);
                    }
                }
            }
            statistics.splits += refinement.splits;
            statistics.forced += refinement.forced;
            statistics.repaired += refinement.repaired;
            statistics.unrepaired += refinement.unrepaired;
            match refinement.outcome {
                Outcome::Split => (),
                Outcome::Missing => {
                    statistics.misses += 1;
                    self.chain_waits = true;
                }
                Outcome::Blocked => statistics.blocked += 1,
                Outcome::PoolFull => statistics.over_budget += 1,
                Outcome::FrontFull => {
                    // It is full for the others too.
                    statistics.over_budget += 1 + (window.len() + queue.len()) as u64;
                    return Ok(());
                }
            }
        }
        statistics.postponed += (window.len() + queue.len()) as u64;
        Ok(())
    }

    /// Most triangles to be drawn, by the options and by the room there is.
    fn triangle_limit(&self) -> usize {
        let asked = self.options.max_triangles.map(|limit| usize::try_from(limit).unwrap_or(usize::MAX));
        asked.unwrap_or(usize::MAX).min(self.front.capacity().triangles)
    }

    /// Whether the camera has stood still while, in frame after frame, pages found no room: each of the nodes that want
    /// some may hold what another one needs. As long as the camera moves, that solves itself.
    fn starves_for_long(&mut self, stands_still: bool, starved: bool) -> bool {
        if !stands_still {
            self.starved_frames = 0;
        }
        self.starved_frames += u32::from(starved);
        let for_long = self.starved_frames >= STARVED_FRAMES;
        if for_long {
            self.starved_frames = 0;
        }
        for_long
    }

    /// Raises the threshold after a frame that hit a limit, and lowers it again while there is room.
    fn adjust_threshold(&mut self, camera: &Camera, hit_limit: bool) {
        let factor = self.threshold_factor;
        if hit_limit {
            self.threshold_factor = (factor * RAISE).min(MOST_RAISED);
            // In the first frames after a move there is not yet the room that the last view gives up.
            if self.frames_standing >= FRAMES_TO_CLEAR {
                self.limited_at = Some((*camera, factor));
            }
            return;
        }
        let use_of_limits = self.use_of_limits();
        let lowered = if use_of_limits < MUCH_ROOM {
            factor / RAISE
        } else if use_of_limits < SOME_ROOM {
            factor / LOWER
        } else {
            factor
        };
        let least = match self.limited_at {
            Some((at, too_low)) if at == *camera => too_low * KEEP_OFF,
            _ => 1.0,
        };
        self.threshold_factor = lowered.max(least).max(1.0).min(factor);
    }

    /// How much of the limit that is nearest is used, 0 to 1. One that the whole model does not reach is none.
    fn use_of_limits(&self) -> f64 {
        let header = self.model.header();
        let part = |used: usize, limit: usize, whole: usize| {
            if limit >= whole { 0.0 } else { used as f64 / limit.max(1) as f64 }
        };
        // One place holder is never needed, nor are those that are reserved.
        let pages = header.page_count as usize;
        let (slots, pages) =
            (self.budget.slots + 1 - reserved_slots(self.budget.slots, header), pages + SPARE_SLOTS - 1);
        let capacity = self.front.capacity();
        part(self.front.vertex_count(), capacity.vertices, header.leaf_count as usize)
            .max(part(
                self.front.line_count(),
                capacity.lines,
                Capacity::most_lines(header.leaf_count as usize, header.triangle_count as usize),
            ))
            .max(part(self.front.triangle_count(), self.triangle_limit(), header.triangle_count as usize))
            .max(part(self.front.used().wedges, capacity.wedges, self.wedge_count()))
            .max(part(self.paging.pool().needed(), slots, pages))
    }

    /// Wedges of the whole model.
    fn wedge_count(&self) -> usize {
        self.model.appearance().map_or(0, |appearance| appearance.wedge_count as usize)
    }

    /// Of the active nodes that can be in the picture: the largest switch value; and the largest error in pixels where that is
    /// above the threshold, else the threshold.
    fn drawn(&self, view: &View, threshold: f32) -> (f32, f32) {
        let test = view.splits(threshold);
        let seen = self.front.blocks().map(|(_, positions, groups)| test.seen(positions, groups));
        seen.fold((0.0, threshold), |(switch, pixels): (f32, f32), seen| {
            (switch.max(seen.switch), pixels.max(seen.error))
        })
    }
}

/// The places of the bits that are set.
fn bits(mut mask: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let place = (mask != 0).then(|| mask.trailing_zeros())?;
        mask &= mask - 1;
        Some(place)
    })
}
