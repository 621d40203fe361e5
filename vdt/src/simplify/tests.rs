//! Whatever the blocks, the memory and the threads: the same collapses with the same values.

use std::path::Path;
use std::sync::Arc;

use proptest::prelude::*;
use storage::{MemoryDisk, Spool};

use super::*;
use crate::generate::{GenerateOptions, Shape, generate};
use crate::ingest::{CoreMesh, FileCounts, MeshBlock, PositionsRule, load as load_mesh};

pub(super) fn made(shape: Shape, triangles: u64, seed: u64) -> CoreMesh {
    let disk = MemoryDisk::new();
    let options = GenerateOptions { shape, triangles, seed };
    generate(Arc::new(disk.clone()), Path::new("mesh.ply"), &options, &mut |_| {}).unwrap();
    load_mesh(&disk, &["mesh.ply".into()], PositionsRule::LOSSLESS, false, ByteSize(1 << 40), &|_| ByteSize(0))
        .unwrap()
        .0
}

/// Triangles that have nothing to do with each other: no legal collapse at all.
pub(super) fn soup(triangles: u32) -> CoreMesh {
    let positions = (0..triangles * 3).map(|vertex| {
        let (triangle, corner) = (f64::from(vertex / 3), f64::from(vertex % 3));
        [triangle % 37.0 * 2.0 + corner % 2.0, (triangle / 37.0).floor() + corner / 3.0, (triangle * 0.1).floor()]
    });
    let corners = (0..triangles).map(|triangle| [0, 1, 2].map(|corner| triangle * 3 + corner));
    crate::ingest::canonical(positions.collect(), corners.collect(), Default::default()).unwrap()
}

/// A mesh in blocks of so many vertices.
pub(super) fn blocked(mesh: &CoreMesh, block_vertices: u32) -> StoredMesh {
    let mut stored = StoredMesh::from_core(mesh.clone(), FileCounts::default());
    let firsts = (0..mesh.positions.len() as u32).step_by(block_vertices as usize);
    stored.blocks = firsts
        .map(|first| MeshBlock {
            first_vertex: first,
            first_triangle: mesh.triangles.partition_point(|corners| corners[0] < first) as u32,
        })
        .collect();
    let is_foreign = |corners: &[u32; 3], corner: u32| corner / block_vertices != corners[0] / block_vertices;
    let corners = mesh.triangles.iter().flat_map(|corners| corners.iter().map(move |corner| (corners, *corner)));
    let mut seams: Vec<u32> =
        corners.filter(|(corners, corner)| is_foreign(corners, *corner)).map(|(_, corner)| corner).collect();
    seams.sort_unstable();
    seams.dedup();
    stored.seam_vertices = Spool::from_vec(seams);
    stored
}

/// What a simplification came to, its collapses by the vertices that went.
#[derive(Debug, PartialEq)]
pub(super) struct Outcome {
    pub(super) log: Vec<log::LoggedCollapse>,
    deaths: Vec<u32>,
    pub(super) roots: Vec<log::LoggedRoot>,
    wedge_images: Vec<log::WedgeImage>,
    rounds: u32,
    legal_collapses: u64,
}

impl Outcome {
    pub(super) fn of(simplified: Simplified) -> Self {
        let mut log = vec![bytemuck::Zeroable::zeroed(); simplified.log.len() as usize];
        simplified.log.read_at(0, &mut log).unwrap();
        log.sort_by_key(|collapse| collapse.born);
        let mut deaths = Vec::new();
        let mut reader = simplified.deaths;
        while let Some(death) = reader.next().unwrap() {
            deaths.push(death);
        }
        let mut wedge_images = vec![bytemuck::Zeroable::zeroed(); simplified.wedge_images.len() as usize];
        simplified.wedge_images.read_at(0, &mut wedge_images).unwrap();
        wedge_images.sort_by_key(|image: &log::WedgeImage| (image.born, image.wedge));
        let Simplified { roots, rounds, legal_collapses, .. } = simplified;
        Outcome { log, deaths, roots, wedge_images, rounds, legal_collapses }
    }

    /// Fails where another outcome differs. (It does not show the whole of both, which nobody could read.)
    pub(super) fn assert_same(&self, found: &Outcome) {
        let differs = self.log.iter().zip(&found.log).find(|(expected, found)| expected != found);
        assert_eq!(differs, None);
        let differs = self.wedge_images.iter().zip(&found.wedge_images).find(|(expected, found)| expected != found);
        assert_eq!(differs, None);
        assert!(self == found);
    }
}

pub(super) fn outcome(mesh: &StoredMesh, metric: Metric, order: crate::tree::Strategy, plan: Plan) -> Outcome {
    let scratch = Scratch::in_memory();
    Outcome::of(match metric {
        Metric::Quadric => run(mesh, QuadricMetric, order, plan, &scratch, &mut |_| ()).unwrap(),
        Metric::Length => run(mesh, LengthMetric, order, plan, &scratch, &mut |_| ()).unwrap(),
    })
}

/// Compares an outcome in blocks with the one in core; `core_part` says when what is left is small enough to go on in core.
pub(super) fn check(
    mesh: &CoreMesh,
    (metric, bound): (Metric, ErrorBound),
    block_vertices: u32,
    threads: usize,
    most_rounds: usize,
    core_part: u64,
) {
    let stored = StoredMesh::from_core(mesh.clone(), FileCounts::default());
    let in_core = Plan::new(1 << 40, 1, Carried::of(&stored, bound));
    let order = crate::tree::Strategy::Passes;
    let expected = outcome(&stored, metric, order, in_core);
    assert_eq!(expected.log.len() + expected.roots.len(), mesh.positions.len());
    let core_triangles = mesh.triangles.len() as u64 / core_part;
    let plan = Plan { threads, block_triangles: u64::from(block_vertices) * 2, core_triangles, most_rounds, ..in_core };
    expected.assert_same(&outcome(&blocked(mesh, block_vertices), metric, order, plan));
}

pub(super) fn any_shape() -> impl proptest::strategy::Strategy<Value = Shape> {
    prop::sample::select(Shape::ALL.to_vec())
}

pub(super) fn any_bound() -> impl proptest::strategy::Strategy<Value = ErrorBound> {
    prop::sample::select(ErrorBound::ALL.to_vec())
}

pub(super) fn either_metric() -> impl proptest::strategy::Strategy<Value = Metric> {
    prop::sample::select(Metric::ALL.to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn blocks_come_to_the_same_as_the_whole(
        shape in any_shape(), triangles in 12_000_u64..40_000, seed in any::<u64>(), metric in either_metric(),
        bound in any_bound(), block_vertices in 500_u32..6_000, threads in 1_usize..4, most_rounds in 1_usize..5,
    ) {
        check(&made(shape, triangles, seed), (metric, bound), block_vertices, threads, most_rounds, 2);
    }
}

/// What no legal collapse can reduce may be more than fits in memory: then the end phase goes through the blocks, too.
#[test]
fn the_end_phase_comes_to_the_same_in_blocks() {
    for metric in Metric::ALL {
        for bound in [ErrorBound::None, ErrorBound::Tight] {
            check(&soup(3000), (metric, bound), 500, 2, 4, 10);
            check(&soup(3000), (metric, bound), 77, 1, 1, 10);
            check(&made(Shape::City, 12_000, 3), (metric, bound), 500, 2, 2, 8);
        }
    }
}

/// One block that is larger than what fits in core.
#[test]
fn a_single_block_comes_to_the_same() {
    for metric in Metric::ALL {
        check(&made(Shape::Terrain, 20_000, 1), (metric, ErrorBound::Default), 1 << 20, 2, 3, 10);
    }
}
