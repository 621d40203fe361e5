//! Both backends against a sorted set in RAM.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use proptest::prelude::*;

use super::*;
use crate::{Disk, FaultyDisk, LocalDisk, MemoryDisk};

const ENOUGH: u64 = 1 << 40;

fn scratch(disk: impl Disk + 'static, folder: &Path) -> Scratch {
    Scratch::open(Arc::new(disk), &folder.join("scratch"), "").unwrap().0
}

fn edge() -> impl Strategy<Value = Edge> {
    (0..6_u32, any::<u32>(), 0..9_u32, prop_oneof![0..9_u32, (0..9_u32).prop_map(|high| high | 1 << 31)])
        .prop_map(|(key, tie, low, high)| Edge { key: key << 29 | tie >> 5, tie: tie & 1, low, high })
}

#[derive(Debug, Clone)]
enum Step {
    /// Edges, and how many that are there are passed over for each that is deleted.
    Change {
        inserted: Vec<Edge>,
        absent: Vec<Edge>,
        every: usize,
    },
    DeleteSmallest {
        most: usize,
    },
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        (prop::collection::vec(edge(), 0..200), prop::collection::vec(edge(), 0..20), 1..100_usize)
            .prop_map(|(inserted, absent, every)| Step::Change { inserted, absent, every }),
        (0..150_usize).prop_map(|most| Step::DeleteSmallest { most }),
    ]
}

proptest! {
    #[test]
    fn bytes_order_as_edges_do(a in edge(), b in edge()) {
        prop_assert_eq!(a.to_bytes().cmp(&b.to_bytes()), a.cmp(&b));
        prop_assert_eq!(Edge::from_bytes(a.to_bytes()), a);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_tree_is_a_sorted_set(
        initial in prop::collection::btree_set(edge(), 0..3000), steps in prop::collection::vec(step(), 0..30),
    ) {
        let folder = tempfile::tempdir().unwrap();
        for kind in EdgeTreeKind::ALL {
            let scratch = scratch(LocalDisk, folder.path());
            let mut tree = kind.create(&scratch, 3000, ENOUGH).unwrap();
            let mut expected: BTreeSet<Edge> = initial.clone();
            let mut sorted = initial.iter().copied();
            tree.bulk_load(&mut || Ok(sorted.next())).unwrap();
            for step in &steps {
                match step {
                    Step::Change { inserted, absent, every } => {
                        let mut inserted: BTreeSet<Edge> = inserted.iter().copied().collect();
                        let deleted: BTreeSet<Edge> = expected.iter().step_by(*every).chain(absent).copied().collect();
                        inserted.retain(|edge| !deleted.contains(edge));
                        let were_there = expected.intersection(&deleted).count() as u64;
                        expected.retain(|edge| !deleted.contains(edge));
                        expected.extend(&inserted);
                        let [deleted, inserted] = [deleted, inserted].map(|edges| edges.into_iter().collect::<Vec<_>>());
                        prop_assert_eq!(tree.change(&deleted, &inserted).unwrap(), were_there);
                    }
                    Step::DeleteSmallest { most } => {
                        let mut seen = Vec::new();
                        tree.delete_smallest(&mut |edge| {
                            seen.push(edge);
                            seen.len() <= *most
                        })
                        .unwrap();
                        let smallest: Vec<Edge> = expected.iter().copied().take(most + 1).collect();
                        prop_assert_eq!(&seen, &smallest);
                        for edge in smallest.iter().take(*most) {
                            expected.remove(edge);
                        }
                    }
                }
                prop_assert_eq!(tree.len(), expected.len() as u64);
            }
            let mut rest = Vec::new();
            tree.delete_smallest(&mut |edge| {
                rest.push(edge);
                true
            })
            .unwrap();
            prop_assert!(rest.iter().eq(&expected));
            prop_assert!(tree.is_empty());
        }
        prop_assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}

fn many(count: u32) -> impl Iterator<Item = Edge> {
    (0..count).map(|n| Edge { key: n.wrapping_mul(0x9e37_79b9), tie: n, low: n, high: n + 1 })
}

#[test]
fn a_disk_that_fails_is_an_error_that_names_the_file_and_leaves_nothing() {
    let memory = MemoryDisk::new();
    for full in [0, 3, 10_000, 1 << 20, 2 << 20] {
        let disk = FaultyDisk::new(Arc::new(memory.clone()));
        disk.full_after(full);
        let edges: Vec<Edge> = many(200_000).collect();
        let error = EdgeTreeKind::Redb
            .create(&scratch(disk.clone(), Path::new("")), 0, 64 << 10)
            .and_then(|mut tree| edges.chunks(5000).try_for_each(|edges| tree.change(&[], edges).map(|_| ())))
            .unwrap_err();
        assert!(error.to_string().contains("edges-redb"), "{error}");
        assert!(matches!(error, EdgeTreeError::Storage(_)), "{error:?}");
        assert_eq!(memory.paths(), [] as [PathBuf; 0]);
    }
    let disk = FaultyDisk::new(Arc::new(memory.clone()));
    let mut tree = EdgeTreeKind::Redb.create(&scratch(disk.clone(), Path::new("")), 0, 64 << 10).unwrap();
    tree.change(&[], &many(100_000).collect::<Vec<_>>()).unwrap();
    disk.fail_reads_after(3);
    let error = tree.delete_smallest(&mut |_| true).unwrap_err();
    assert!(error.to_string().contains("injected"), "{error}");
}

#[test]
fn bytes_are_counted_where_the_cache_is_too_small() {
    let disk = crate::CountingDisk::new(Arc::new(MemoryDisk::new()));
    let mut tree = EdgeTreeKind::Redb.create(&scratch(disk.clone(), Path::new("")), 0, 64 << 10).unwrap();
    tree.change(&[], &many(50_000).collect::<Vec<_>>()).unwrap();
    let Traffic { read, written } = tree.traffic();
    assert_eq!((read, written), (disk.bytes_read(), disk.bytes_written()));
    assert!(read > 1 << 20 && written > 1 << 20, "{read} {written}");
}

#[test]
fn sled_is_refused_where_it_would_break_the_limit_with_the_figures() {
    let folder = tempfile::tempdir().unwrap();
    let edges = 3_000_000;
    let needed = sled_needs(edges).0;
    let scratch = scratch(LocalDisk, folder.path());
    let message = EdgeTreeKind::Sled.create(&scratch, edges, needed - 1).unwrap_err().to_string();
    assert!(message.contains("3000000 edges") && message.contains(&sled_needs(edges).to_string()), "{message}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    EdgeTreeKind::Sled.create(&scratch, edges, needed).unwrap();
}
