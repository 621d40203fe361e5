//! Damaged models: whatever byte is changed, `verify` finds it, and whoever else reads the model ends with a result or a
//! message, without a panic, in little memory.
//!
//! The library is called here as the program calls it; that the program says what it is told is tested in `wrong_input`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a panic is how a test fails")]

use std::path::Path;
use std::sync::{Arc, LazyLock};

use metanode::chain::PageChain;
use metanode::header::ModelError;
use metanode::model::Model;
use metanode::page::PageLocation;
use metanode::{UniformCut, details, error_for_triangles, statistics, verify};
use navigator::{Camera, Io, Navigator, NavigatorOptions};
use proptest::prelude::*;
use storage::MemoryDisk;
use vdt_tests::random_mesh::Random;
use vdt_tests::workplace;

/// Models of several parts in several meta-nodes: on a lattice and lossless, blocked in both ways.
static MODELS: LazyLock<Vec<Vec<u8>>> = LazyLock::new(|| {
    let place = workplace!();
    place.json("generate city --triangles 900 --seed 5 -o city.ply");
    let ways = ["--positions 12 --blocking forest:4K,4", "--positions lossless --blocking levels:4"];
    let build = |options: &&str| {
        place.json(&format!("build city.ply -o city.vdt --force {options}"));
        place.read("city.vdt")
    };
    ways.iter().map(build).collect()
});

fn open(bytes: &[u8]) -> Result<Model, ModelError> {
    let disk = MemoryDisk::new();
    disk.insert("model.vdt", bytes);
    Model::open(&disk, Path::new("model.vdt"))
}

/// The message of `verify`, or none where it finds nothing wrong.
fn complaint(bytes: &[u8]) -> Option<String> {
    match open(bytes) {
        Err(error) => Some(error.to_string()),
        Ok(model) => verify(&model, &mut |_| ()).err().map(|error| error.to_string()),
    }
}

/// What `info`, `extract` and `navigate` read is read; how that ends is all the same.
fn read_all(bytes: &[u8]) {
    let Ok(model) = open(bytes) else { return };
    let model = Arc::new(model);
    let _ = statistics(&model);
    let _ = details(&model, &[1.0], &mut |_| ());
    let _ = error_for_triangles(&model, 100);
    if let Ok(cut) = UniformCut::new(&model, model.header().largest_switch / 100.0) {
        let _ = cut.for_each_vertex(|_| Ok::<_, ModelError>(()));
        let _ = cut.for_each_triangle(|_| Ok::<_, ModelError>(()));
        let _ = cut.statement();
    }
    let options = NavigatorOptions { memory: 4 << 20, pixels: 0.1, io: Io::Sync, ..NavigatorOptions::default() };
    let Ok(mut navigator) = Navigator::open(model, options) else { return };
    for eye in [[300.0, 200.0, 100.0], [20.0, 30.0, 10.0]] {
        let camera = Camera::looking_at(eye.into(), [0.0; 3].into(), 60.0);
        if navigator.run_until_settled(&camera, 20).is_err() {
            return;
        }
    }
}

/// Where each checksum is, with the start of what it is of.
fn checksums(bytes: &[u8]) -> Vec<(usize, usize)> {
    let model = open(bytes).unwrap();
    let header = model.header();
    let coder_tables = header.pages_offset as usize - 4 - header.table_bytes as usize;
    let mut found = vec![(0, 252), (256, coder_tables - 4), (coder_tables, header.pages_offset as usize - 4)];
    let mut chain = PageChain::new(&model);
    let mut stack: Vec<(PageLocation, Option<u32>)> = model.root_pages().iter().map(|page| (*page, None)).collect();
    while let Some((location, parent)) = stack.pop() {
        let (start, length) = (location.offset as usize, location.length as usize);
        found.push((start, start + length - 4));
        let page = chain.page(location, parent).unwrap();
        stack.extend(page.children().map(|child| (child, Some(location.number))));
    }
    found
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn a_changed_byte_is_found(model in 0..2_usize, at in any::<prop::sample::Index>(), change in 1..=255_u8) {
        let mut bytes = MODELS[model].clone();
        let at = at.index(bytes.len());
        bytes[at] ^= change;
        let message = complaint(&bytes);
        prop_assert!(message.as_ref().is_some_and(|message| message.starts_with("model.vdt: ")), "byte {at}: {message:?}");
        read_all(&bytes);
    }

    /// Made up, not damaged: under a right checksum something may pass; but not do harm.
    #[test]
    fn changed_bytes_under_right_checksums_do_no_harm(
        model in 0..2_usize, seed in any::<u64>(), count in 1..4_usize
    ) {
        let mut bytes = MODELS[model].clone();
        let checksums = checksums(&bytes);
        let mut random = Random(seed);
        for _ in 0..count {
            let (start, end) = checksums[random.below(checksums.len())];
            let at = start + random.below(end - start);
            bytes[at] = random.bits() as u8;
            let checksum = crc32fast::hash(&bytes[start..end]);
            bytes[end..end + 4].copy_from_slice(&checksum.to_le_bytes());
        }
        read_all(&bytes);
        if complaint(&bytes).is_none() {
            let model = open(&bytes).unwrap();
            let cut = UniformCut::new(&model, 0.0).unwrap();
            prop_assert_eq!(cut.triangle_count(), u64::from(model.header().triangle_count));
        }
    }
}

/// The same for models of one's own: `VDT_MODELS=a.vdt,b.vdt VDT_CASES=10000 cargo test -p vdt-tests --test damage --
/// --ignored --nocapture`. Each thirtieth is read in the other ways, too.
#[test]
#[ignore = "for models of one's own"]
fn changed_bytes_of_given_models() {
    let cases: u64 = std::env::var("VDT_CASES").map_or(1000, |cases| cases.parse().unwrap());
    for path in std::env::var("VDT_MODELS").expect("VDT_MODELS names models").split(',') {
        let mut bytes = std::fs::read(path).unwrap();
        assert_eq!(complaint(&bytes), None);
        let mut random = Random(cases);
        for case in 0..cases {
            let (at, change) = (random.below(bytes.len()), 1 + random.below(255) as u8);
            bytes[at] ^= change;
            let message = complaint(&bytes);
            assert!(message.is_some_and(|message| message.starts_with("model.vdt: ")), "{path}: byte {at} ^ {change}");
            if case % 30 == 0 {
                read_all(&bytes);
            }
            bytes[at] ^= change;
        }
        println!("{path}: {cases} changes found, peak RSS {:?} bytes", storage::usage::peak_resident_bytes());
    }
}
