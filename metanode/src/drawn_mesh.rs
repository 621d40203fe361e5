//! The mesh of any cut with its attributes, in RAM: that of the splits that a view has applied, one vertex for each wedge that a
//! triangle has.
//!
//! What holds of uniform cuts (`cut_wedges`) holds of all: the wedge of a corner is the active one with the largest number that is
//! not above the corner's, since no split is applied without that of the node above.
//!
//! RAM: 60 bytes for each applied split, 40 for each vertex and 36 for each triangle. I/O: each page with an applied split, once.

use vdt::tree::Wedge;

use crate::header::ModelError;
use crate::model::Model;
use crate::walk::walk_pages;
use crate::wedges::PlacedWedge;

/// Vertices and triangles.
#[derive(Debug, Default)]
pub struct DrawnMesh {
    /// Positions, in mesh units relative to the model's origin, and wedges.
    pub vertices: Vec<([f32; 3], Wedge)>,
    /// Vertices of each triangle, in the orientation of the input mesh, and its material, counted from 1; 0: none.
    pub triangles: Vec<([u32; 3], u32)>,
}

/// A wedge of an active leaf.
#[derive(Debug, Clone, Copy)]
struct ActiveWedge {
    placed: PlacedWedge,
    position: [f32; 3],
    /// Its vertex, once a triangle has it.
    vertex: u32,
}

const NO_VERTEX: u32 = u32::MAX;

impl DrawnMesh {
    /// That of a model in which these splits are applied, named by the leaves that they bear; `pages` are the numbers of their
    /// meta-nodes.
    pub fn of(model: &Model, mut splits: Vec<u32>, mut pages: Vec<u32>) -> Result<Self, ModelError> {
        splits.sort_unstable();
        pages.sort_unstable();
        pages.dedup();
        // Wedges by number; where the model has no attributes one for each leaf.
        let mut active: Vec<ActiveWedge> = Vec::with_capacity(splits.len() + model.roots().len());
        let plain = |leaf: u32| PlacedWedge { wedge: Wedge::PLAIN, number: leaf, end: leaf.saturating_add(1) };
        let mut add = |position: [f32; 3], leaf: u32, wedges: &mut dyn Iterator<Item = PlacedWedge>| {
            let before = active.len();
            active.extend(wedges.map(|placed| ActiveWedge { placed, position, vertex: NO_VERTEX }));
            if active.len() == before {
                active.push(ActiveWedge { placed: plain(leaf), position, vertex: NO_VERTEX });
            }
        };
        for root in model.roots() {
            let wedges = model.appearance().map_or(&[][..], |found| found.root_wedges.of(root.start));
            add(root.position, root.start, &mut wedges.iter().copied());
        }
        // The corners of triangles, as numbers of wedges.
        let mut corners: Vec<[u32; 3]> = Vec::new();
        walk_pages(model, &pages, |page| {
            for index in 0..page.counts().records as u16 {
                let Some(record) = page.record(index).filter(|record| splits.binary_search(&record.born_leaf).is_ok())
                else {
                    continue;
                };
                add(record.position, record.born_leaf, &mut page.wedges(index));
                let before = corners.len();
                corners.extend(page.corner_wedges(index));
                if corners.len() == before {
                    // Without seams the number of a wedge is that of its leaf.
                    corners.extend(page.triangles(index));
                }
            }
            Ok::<_, ModelError>(())
        })?;
        active.sort_unstable_by_key(|wedge| wedge.placed.number);
        let mut mesh = DrawnMesh { vertices: Vec::new(), triangles: Vec::with_capacity(corners.len()) };
        for numbers in corners {
            let mut vertices = [0; 3];
            for (vertex, number) in vertices.iter_mut().zip(numbers) {
                let behind = active.partition_point(|wedge| wedge.placed.number <= number);
                let Some(wedge) = behind.checked_sub(1).map(|at| &mut active[at]) else {
                    let problem = format!("wedge {number} turns into none that is drawn; `vdt verify` says where");
                    return Err(ModelError::Damaged { path: model.path().into(), part: "file".into(), problem });
                };
                if wedge.vertex == NO_VERTEX {
                    wedge.vertex = mesh.vertices.len() as u32;
                    mesh.vertices.push((wedge.position, wedge.placed.wedge));
                }
                *vertex = wedge.vertex;
            }
            let (_, wedge) = mesh.vertices[vertices[0] as usize];
            mesh.triangles.push((vertices, wedge.material));
        }
        Ok(mesh)
    }
}
