//! A navigator allocates its memory when it is opened. After that a frame that reads no page allocates nothing, one that reads
//! some frees what it allocates but for buffers that come to their full size, and all that is held is within the budget. In a process of its own, since everything that it allocates counts.

#![allow(clippy::unwrap_used, reason = "a panic is how a test fails")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use metanode::header::{Blocking, ErrorBound, Metric, Strategy};
use metanode::model::Model;
use metanode::{ModelOptions, WriteResources, write_model};
use storage::{ByteSize, EdgeTreeKind, MemoryDisk, Scratch};
use vdt::build::{BuildOptions, build};
use vdt::generate::{GenerateOptions, Shape, generate};
use vdt::ingest::PositionsRule;
use vdt_navigator::{Dependency, Io, Navigator, NavigatorOptions, RandomWalk};

/// The system's allocator, with what is allocated counted.
struct Counting;

static CALLS: AtomicUsize = AtomicUsize::new(0);
static BYTES: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system's allocator as it is; the counters have nothing to do with the memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        CALLS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        BYTES.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(block, layout) }
    }

    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        CALLS.fetch_add(1, Ordering::Relaxed);
        BYTES.fetch_add(size, Ordering::Relaxed);
        BYTES.fetch_sub(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.realloc(block, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Squares on a side of a surface.
const SIDE: usize = 142;
const FILE: &str = "model.vdt";

/// A terrain, built in memory.
fn terrain() -> MemoryDisk {
    let disk = MemoryDisk::new();
    let what = GenerateOptions { shape: Shape::Terrain, triangles: 40_000, seed: 1 };
    generate(Arc::new(disk.clone()), Path::new("terrain.ply"), &what, &mut |_| ()).unwrap();
    built(&disk, "terrain.ply")
}

/// A bumpy surface with as many triangles, in squares so wide of several materials and textures, with seams between them.
fn patches(width: usize) -> MemoryDisk {
    let mut text = String::new();
    for (y, x) in (0..=SIDE).flat_map(|y| (0..=SIDE).map(move |x| (y, x))) {
        let height = (x as f64 * 0.2).sin() * (y as f64 * 0.13).cos() * 3.0 + (x * 7 + y * 3) as f64 % 5.0 * 0.1;
        writeln!(text, "v {x} {y} {height}\nvt {} {}", (x % width) as f64 / 16.0, (y % width) as f64 / 16.0).unwrap();
    }
    for (y, x) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (y, x))) {
        let corner = |x: usize, y: usize| format!("{0}/{0}", y * (SIDE + 1) + x + 1);
        let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
        writeln!(text, "usemtl m{}\nf {a} {b} {c}\nf {a} {c} {d}", (x / width + y / width) % 3).unwrap();
    }
    let disk = MemoryDisk::new();
    disk.insert("patches.obj", text);
    built(&disk, "patches.obj")
}

/// The model of a mesh, alone.
fn built(disk: &MemoryDisk, mesh: &str) -> MemoryDisk {
    let options = BuildOptions {
        memory: ByteSize(256 << 20),
        threads: 1,
        metric: Metric::Quadric,
        strategy: Strategy::Passes,
        error_bound: ErrorBound::default(),
        edge_tree: EdgeTreeKind::default(),
        positions: PositionsRule::default(),
        attributes: true,
    };
    let scratch = Scratch::in_memory();
    let (tree, report) = build(disk, &[mesh.into()], &options, &scratch, None, &mut |_| ()).unwrap();
    let BuildOptions { metric, strategy, error_bound, .. } = options;
    let (input_error, positions) = (report.input_error, report.positions);
    let blocking = Blocking::default();
    let options = ModelOptions { blocking, metric, strategy, error_bound, input_error, positions };
    let resources = WriteResources::in_memory();
    write_model(Arc::new(disk.clone()), Path::new(FILE), &tree, &options, &resources, &mut |_| ()).unwrap();
    // Nothing but the model stays.
    let alone = MemoryDisk::new();
    alone.insert(FILE, disk.bytes(FILE).unwrap());
    alone
}

/// The bytes that are allocated at the moment.
fn bytes() -> usize {
    BYTES.load(Ordering::Relaxed)
}

#[test]
fn nothing_grows_after_the_start() {
    const WARM_UP: u32 = 600;
    const FRAMES: u32 = 2000;
    let (terrain, plain, patches) = (terrain(), patches(SIDE + 1), patches(15));
    // With whether there are seams.
    let (terrain, plain, patches) = ((&terrain, None), (&plain, Some(false)), (&patches, Some(true)));
    for ((disk, has_seams), dependency, geomorph, memory) in [
        (terrain, Dependency::Implicit, 0, 5 << 19),
        (terrain, Dependency::None, 15, 5 << 19),
        (terrain, Dependency::Flip, 0, 5 << 19),
        (terrain, Dependency::Implicit, 15, 64 << 20),
        (plain, Dependency::Implicit, 15, 5 << 19),
        (patches, Dependency::Implicit, 0, 5 << 19),
        (patches, Dependency::None, 15, 64 << 20),
    ] {
        let before = bytes();
        let model = Arc::new(Model::open(disk, Path::new(FILE)).unwrap());
        let (io, attributes) = (Io::Sync, true);
        let options = NavigatorOptions { memory, dependency, geomorph, attributes, io, ..NavigatorOptions::default() };
        let mut navigator = Navigator::open(model.clone(), options).unwrap();
        let opened = bytes();
        let mut walk = RandomWalk::new(&model, 5).unwrap();
        let of_walk = bytes() - opened;
        let (mut reads, mut calls_for_reads, mut other_calls) = (0, 0, 0);
        let (mut least, mut most) = (usize::MAX, 0);
        for number in 0..WARM_UP + FRAMES {
            walk.step();
            let calls = CALLS.load(Ordering::Relaxed);
            let frame = navigator.frame(&walk.camera()).unwrap();
            let calls = CALLS.load(Ordering::Relaxed) - calls;
            let held = bytes() - before - of_walk;
            assert!(held as u64 <= navigator.budget_bytes(), "{held} of {}", navigator.budget_bytes());
            if number < WARM_UP {
                continue;
            }
            (least, most) = (least.min(held), most.max(held));
            if frame.pool.reads == 0 {
                other_calls += calls;
            } else {
                reads += frame.pool.reads;
                calls_for_reads += calls;
            }
        }
        let said = format!(
            "{dependency:?} in {memory}: {} bytes held after the start, {least} to {most} after the warm-up; {other_calls} \
             calls in frames without reads, {calls_for_reads} for {reads} reads",
            opened - before,
        );
        println!("{said}");
        let layout = model.appearance().map(|appearance| appearance.layout);
        assert_eq!(layout.map(|layout| layout.has_seams), has_seams);
        assert_eq!(navigator.wedge_stream().is_empty(), has_seams.is_none());
        assert_eq!(navigator.corner_stream().is_empty(), has_seams != Some(true));
        assert_eq!(other_calls, 0, "{said}");
        let most_calls = if has_seams == Some(true) { 12 } else { 6 };
        assert!(calls_for_reads as u64 <= most_calls * reads, "{said}");
        // The buffers of who reads pages are as large as the largest page so far.
        assert!(most - least < 64 << 10, "{said}");
        // All is read at the start, or again and again.
        assert_eq!(reads > 0, memory < 64 << 20, "{said}");
    }
}
