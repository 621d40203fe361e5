//! Simplification of meshes with attributes: seams are kept, images are complete, and memory changes nothing.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;
use storage::Scratch;

use super::components::DisjointSets;
use super::live_mesh::Normalisation;
use super::metric::{LengthMetric, QuadricMetric};
use super::plan::{Carried, Plan};
use super::spanned::tests::{any_soup, in_core, tight, with_redb};
use super::tests::{any_bound, any_shape, blocked, check, either_metric, made, outcome};
use super::wedge_images::MOST_SURFACES;
use super::{log, run};
use crate::ingest::{CoreAttributes, CoreMesh, FileCounts, StoredMesh};
use crate::tree::{
    Appearance, AttributeKinds, CornerPlaces, ErrorBound, MOST_WEDGES, Metric, Normal, Strategy as Order, Wedge,
};

const ALL_KINDS: AttributeKinds = AttributeKinds { normals: true, colours: true, textures: true, materials: true };

/// Gives each corner, by its triangle and its vertex, a wedge.
fn dressed(mesh: &CoreMesh, kinds: AttributeKinds, wedge_of: impl Fn(u32, u32) -> Wedge) -> CoreMesh {
    let mut wedges = vec![Vec::new(); mesh.positions.len()];
    let of_corners = (0..).zip(&mesh.triangles).map(|(id, corners)| corners.map(|vertex| wedge_of(id, vertex)));
    let of_corners: Vec<[Wedge; 3]> = of_corners.collect();
    for (corners, of_corner) in mesh.triangles.iter().zip(&of_corners) {
        for (vertex, wedge) in corners.iter().zip(of_corner) {
            wedges[*vertex as usize].push(*wedge);
        }
    }
    for of_vertex in &mut wedges {
        of_vertex.sort_by_key(Wedge::order);
        of_vertex.dedup();
        of_vertex.truncate(MOST_WEDGES);
    }
    let place = |vertex: u32, wedge: &Wedge| {
        wedges[vertex as usize].iter().position(|other| other == wedge).unwrap_or(MOST_WEDGES - 1) as u32
    };
    let corners = mesh.triangles.iter().zip(&of_corners).map(|(corners, of_corner)| {
        CornerPlaces::of([0, 1, 2].map(|corner| place(corners[corner], &of_corner[corner])))
    });
    let corners = corners.collect();
    let appearance = Appearance { kinds, texture_exponent: -16, ..Appearance::default() };
    CoreMesh { attributes: Some(CoreAttributes { appearance, wedges, corners }), ..mesh.clone() }
}

fn hash(a: u32, b: u32) -> u32 {
    super::collapse::hash_pair(a, b)
}

/// A texture cut into charts by the places of triangles, some of which are of the same material; colours by place.
#[derive(Debug, Clone, Copy)]
struct Charts {
    /// Cells of the charts along an axis.
    cells: f32,
    /// How much of the colours is noise, of 256.
    noise: u32,
    seed: u32,
}

impl Charts {
    fn normalised(mesh: &CoreMesh, vertex: u32) -> [f32; 3] {
        Normalisation::new(mesh.exponent).apply(mesh.positions[vertex as usize])
    }

    fn chart(self, mesh: &CoreMesh, triangle: u32) -> u32 {
        let at = mesh.triangles[triangle as usize].map(|vertex| Self::normalised(mesh, vertex));
        let cell = |axis: usize| ((at[0][axis] + at[1][axis] + at[2][axis]) * self.cells / 3.0).floor() as i32 as u32;
        // No vertex has more surfaces than keep their seams.
        hash(hash(cell(0), cell(1)), cell(2) ^ self.seed) % 5
    }

    /// What a chart has at a vertex: a linear map of its own.
    fn surface(mesh: &CoreMesh, chart: u32, vertex: u32) -> (u32, [i32; 2]) {
        let at = Self::normalised(mesh, vertex).map(|value| (value * 30_000.0) as i32);
        let chart = chart as i32;
        let texture = [at[0] * 2 + at[2] + chart * 100_000, at[1] * 2 - at[2] * chart];
        (chart as u32 % 3, texture)
    }

    fn dress(self, mesh: &CoreMesh, kinds: AttributeKinds) -> CoreMesh {
        dressed(mesh, kinds, |triangle, vertex| {
            let (material, texture) = Self::surface(mesh, self.chart(mesh, triangle), vertex);
            let at = Self::normalised(mesh, vertex);
            let noise = hash(vertex, self.seed) % 256 * self.noise / 256;
            let colour = [0, 1, 2, 3].map(|channel| {
                let slope = at[channel % 3].abs() * 100.0 * (channel + 1) as f32;
                (slope as u32 / 2 + noise) as u8
            });
            let normal = Normal::encode([0.1 * f64::from(hash(triangle / 8, vertex) % 3), 0.3, 1.0]);
            Wedge { material, texture, colour, normal }
        })
    }
}

fn any_charts() -> impl Strategy<Value = Charts> {
    (1.0_f32..6.0, prop_oneof![Just(0_u32), 0_u32..200], any::<u32>()).prop_map(|(cells, noise, seed)| Charts {
        cells,
        noise,
        seed,
    })
}

fn any_kinds() -> impl Strategy<Value = AttributeKinds> {
    let kinds = |(colours, textures)| AttributeKinds { colours, textures, ..ALL_KINDS };
    (any::<bool>(), any::<bool>()).prop_map(kinds)
}

/// Wedges of some few at each vertex, without any sense.
fn randomly_dressed(mesh: &CoreMesh, kinds: AttributeKinds, most: u32, seed: u32) -> CoreMesh {
    dressed(mesh, kinds, |triangle, vertex| {
        let number = hash(hash(triangle, vertex), seed) % (1 + hash(vertex, seed) % most);
        let bits = hash(number, vertex ^ seed);
        let texture = [number as i32 / 2 * 1000, (bits & 1) as i32];
        Wedge { material: bits >> 1 & 1, texture, colour: bits.to_le_bytes(), normal: Normal::UP }
    })
}

/// One log entry after the other, on triangles that are no more than corners with places.
struct Replay<'a> {
    attributes: &'a CoreAttributes,
    triangles: BTreeMap<u32, [(u32, u32); 3]>,
    images: BTreeMap<u32, Vec<u32>>,
}

impl<'a> Replay<'a> {
    fn new(mesh: &'a CoreMesh, images: &[log::WedgeImage]) -> Self {
        let attributes = mesh.attributes.as_ref().unwrap();
        let corners = mesh.triangles.iter().zip(&attributes.corners).map(|(corners, places)| {
            let places = places.places();
            [0, 1, 2].map(|corner| (corners[corner], places[corner]))
        });
        let mut of_born: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for image in images {
            let of_vertex = of_born.entry(image.born).or_default();
            // Each wedge once, and all of them.
            assert_eq!(usize::from(image.wedge), of_vertex.len());
            of_vertex.push(image.image.into());
        }
        Replay { attributes, triangles: (0..).zip(corners).collect(), images: of_born }
    }

    fn wedge(&self, (vertex, place): (u32, u32)) -> &Wedge {
        &self.attributes.wedges[vertex as usize][place as usize]
    }

    /// The images of all wedges of the vertex that goes: complete where the other one has several, else none.
    fn images_of(&self, born: u32, kept: u32) -> Vec<u32> {
        let count = self.attributes.wedges[born as usize].len();
        let targets = self.attributes.wedges[kept as usize].len();
        match self.images.get(&born) {
            Some(images) => {
                assert!(targets > 1 && images.len() == count);
                assert!(images.iter().all(|image| (*image as usize) < targets));
                images.clone()
            }
            None => {
                assert_eq!(targets, 1);
                vec![0; count]
            }
        }
    }

    fn collapse(&mut self, born: u32, kept: u32, is_legal: bool) {
        let images = self.images_of(born, kept);
        let around: Vec<u32> =
            self.triangles.iter().filter(|(_, c)| c.iter().any(|c| c.0 == born)).map(|(id, _)| *id).collect();
        let corner = |corners: &[(u32, u32); 3], vertex: u32| corners.iter().copied().find(|corner| corner.0 == vertex);
        // What each vanishing triangle says.
        let said: Vec<[(u32, u32); 2]> = around
            .iter()
            .filter_map(|id| Some([corner(&self.triangles[id], born)?, corner(&self.triangles[id], kept)?]))
            .collect();
        let same = |a: (u32, u32), b: (u32, u32)| self.wedge(a).is_same_surface(self.wedge(b));
        for [own, there] in &said {
            // Of several that have the same wedge, the first counts.
            assert!(images[own.1 as usize] <= there.1);
        }
        // Where so many pieces of a texture meet, they need not be kept.
        let surfaces = self.attributes.wedges[born as usize].chunk_by(|a, b| a.is_same_surface(b)).count();
        let is_free = surfaces > MOST_SURFACES && self.attributes.appearance.kinds.textures;
        let mut after = Vec::new();
        for id in &around {
            let corners = self.triangles[id];
            if corner(&corners, kept).is_some() {
                continue;
            }
            let own = corner(&corners, born).unwrap();
            let image = (kept, images[own.1 as usize]);
            if is_legal && !is_free {
                let of_surface: Vec<_> = said.iter().filter(|[other, _]| same(*other, own)).collect();
                assert!(!of_surface.is_empty());
                assert!(of_surface.iter().all(|[_, there]| same(*there, image)));
            }
            after.push((*id, corners.map(|corner| if corner.0 == born { image } else { corner })));
        }
        for id in around {
            self.triangles.remove(&id);
        }
        self.triangles.extend(after);
    }
}

/// Simplifies in memory, and goes through the log. Calls `look` after each legal collapse.
fn replay(mesh: &CoreMesh, metric: Metric, order: Order, mut look: impl FnMut(&Replay<'_>)) {
    let stored = StoredMesh::from_core(mesh.clone(), FileCounts::default());
    let scratch = Scratch::in_memory();
    let plan = Plan::new(1 << 40, 1, Carried::of(&stored, ErrorBound::Default));
    let simplified = match metric {
        Metric::Quadric => run(&stored, QuadricMetric, order, plan, &scratch, &mut |_| ()).unwrap(),
        Metric::Length => run(&stored, LengthMetric, order, plan, &scratch, &mut |_| ()).unwrap(),
    };
    let mut images = vec![bytemuck::Zeroable::zeroed(); simplified.wedge_images.len() as usize];
    simplified.wedge_images.read_at(0, &mut images).unwrap();
    let mut state = Replay::new(mesh, &images);
    let mut reader = simplified.log.reader(0);
    let mut number = 0;
    while let Some(collapse) = reader.next().unwrap() {
        let is_legal = number < simplified.legal_collapses;
        state.collapse(collapse.born, collapse.kept, is_legal);
        number += 1;
        if is_legal {
            look(&state);
        }
    }
    assert!(state.triangles.is_empty());
    // One root for each component.
    let mut sets = DisjointSets::default();
    sets.clear_to(mesh.positions.len());
    for [a, b, c] in &mesh.triangles {
        sets.unite(*a, *b);
        sets.unite(*a, *c);
    }
    let components: BTreeSet<u32> = (0..mesh.positions.len() as u32).map(|vertex| sets.find(vertex)).collect();
    assert_eq!(simplified.roots.len(), components.len());
    assert_eq!(simplified.log.len() as usize + components.len(), mesh.positions.len());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    /// Every triangle shows its own chart, at the place where its corners lie, for as long as collapses are legal.
    #[test]
    fn legal_collapses_keep_seams(
        shape in any_shape(), triangles in 300_u64..1_200, seed in any::<u64>(), metric in either_metric(),
        charts in any_charts(), kinds in any_kinds(), is_queue in any::<bool>(),
    ) {
        let mesh = charts.dress(&made(shape, triangles, seed), kinds);
        let order = if is_queue { Order::Btree } else { Order::Passes };
        let chart: Vec<u32> = (0..mesh.triangles.len() as u32).map(|id| charts.chart(&mesh, id)).collect();
        replay(&mesh, metric, order, |state| {
            for (id, corners) in &state.triangles {
                for corner in corners {
                    let wedge = state.wedge(*corner);
                    assert_eq!((wedge.material, wedge.texture), Charts::surface(&mesh, chart[*id as usize], corner.0));
                }
            }
        });
    }

    #[test]
    fn blocks_come_to_the_same_with_attributes(
        shape in any_shape(), triangles in 6_000_u64..30_000, seed in any::<u64>(), metric in either_metric(),
        bound in any_bound(), charts in any_charts(), kinds in any_kinds(),
        block_vertices in 300_u32..6_000, threads in 1_usize..4, most_rounds in 1_usize..5, core_part in 2_u64..20,
    ) {
        let mesh = charts.dress(&made(shape, triangles, seed), kinds);
        check(&mesh, (metric, bound), block_vertices, threads, most_rounds, core_part);
    }

    #[test]
    fn spanned_sub_meshes_come_to_the_same_with_attributes(
        shape in any_shape(), triangles in 500_u64..5_000, seed in any::<u64>(), metric in either_metric(),
        bound in any_bound(), charts in any_charts(), kinds in any_kinds(),
        block_vertices in 100_u32..3_000, sub_meshes in 60_000_u64..400_000, core in 25_000_u64..400_000,
    ) {
        let mesh = charts.dress(&made(shape, triangles, seed), kinds);
        let (found, _) = with_redb(&blocked(&mesh, block_vertices), (metric, bound), tight(sub_meshes, core));
        in_core(&mesh, metric, bound).assert_same(&found);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    /// Whatever the surface, and whatever is on it.
    #[test]
    fn anything_comes_down_to_its_roots(
        mesh in any_soup(), metric in either_metric(), is_queue in any::<bool>(),
        most in prop_oneof![1_u32..4, Just(30)], kinds in any_kinds(), seed in any::<u32>(),
    ) {
        let order = if is_queue { Order::Btree } else { Order::Passes };
        replay(&randomly_dressed(&mesh, kinds, most, seed), metric, order, |_| ());
    }

    #[test]
    fn whatever_is_on_it_comes_to_the_same_in_parts(
        mesh in any_soup(), metric in either_metric(), bound in any_bound(), most in prop_oneof![1_u32..4, Just(30)],
        kinds in any_kinds(), seed in any::<u32>(), block_vertices in 3_u32..90,
        sub_meshes in 70_000_u64..120_000, core in prop_oneof![Just(45_000), 45_000_u64..90_000],
    ) {
        let mesh = randomly_dressed(&mesh, kinds, most, seed);
        check(&mesh, (metric, bound), block_vertices, 2, 3, 4);
        let (found, _) = with_redb(&blocked(&mesh, block_vertices), (metric, bound), tight(sub_meshes, core));
        in_core(&mesh, metric, bound).assert_same(&found);
    }
}

/// A flat grid, of which each vertex has one colour.
fn grid(size: u32, colour: impl Fn(u32, u32) -> [u8; 4]) -> CoreMesh {
    let positions = (0..size * size).map(|vertex| [f64::from(vertex % size), f64::from(vertex / size), 0.0]);
    let cells = (0..(size - 1) * (size - 1)).map(|cell| cell / (size - 1) * size + cell % (size - 1));
    let triangles = cells.flat_map(|at| [[at, at + 1, at + size], [at + 1, at + size + 1, at + size]]);
    let mesh = crate::ingest::canonical(positions.collect(), triangles.collect(), Default::default()).unwrap();
    let kinds = AttributeKinds { colours: true, ..AttributeKinds::default() };
    dressed(&mesh, kinds, |_, vertex| {
        let [x, y, _] = mesh.positions[vertex as usize].map(|value| value as u32);
        Wedge { colour: colour(x, y), ..Wedge::PLAIN }
    })
}

/// Vertices of the uniform cut with this error, in mesh units.
fn cut(mesh: &CoreMesh, order: Order, metric: Metric, error: f32) -> Vec<u32> {
    let stored = StoredMesh::from_core(mesh.clone(), FileCounts::default());
    let plan = Plan::new(1 << 40, 1, Carried::of(&stored, ErrorBound::Default));
    let found = outcome(&stored, metric, order, plan);
    let mut left: BTreeSet<u32> = (0..mesh.positions.len() as u32).collect();
    for collapse in &found.log {
        if crate::tree::switch_of(collapse.id, mesh.exponent) <= error {
            left.remove(&collapse.born);
        }
    }
    left.into_iter().collect()
}

#[test]
fn plain_colours_and_gradients_cost_nothing() {
    let plain = grid(40, |_, _| [200, 10, 10, 255]);
    let gradient = grid(40, |x, y| [(x * 6) as u8, (y * 5) as u8, 100, 255]);
    for order in Order::ALL {
        for metric in Metric::ALL {
            let bare = CoreMesh { attributes: None, ..plain.clone() };
            let expected = cut(&bare, order, metric, 0.01);
            assert!(expected.len() < 100, "{}", expected.len());
            assert_eq!(cut(&plain, order, metric, 0.01), expected);
            let found = cut(&gradient, order, metric, 0.01).len();
            assert!(found < 100, "{found} instead of {}", expected.len());
        }
    }
}

/// One half of the grid is one colour, the other half is noise.
#[test]
fn colours_stay_where_they_vary() {
    let mesh = grid(40, |x, y| if x < 20 { [50; 4] } else { hash(x, y).to_le_bytes() });
    for order in Order::ALL {
        for metric in Metric::ALL {
            let left = cut(&mesh, order, metric, 0.3);
            let (plain, noisy): (Vec<u32>, Vec<u32>) =
                left.iter().partition(|vertex| mesh.positions[**vertex as usize][0] < 19.0);
            assert!(plain.len() * 6 < noisy.len() && noisy.len() > 500, "{} {}", plain.len(), noisy.len());
        }
    }
}
