//! The mesh of a uniform cut with its attributes: one vertex for each wedge that a triangle has.
//!
//! The active wedges are those of active leaves. They hang together from the roots of the forest of wedges down, as active nodes do
//! in the tree; so the wedge that a corner has is the active one with the largest number that is not above the corner's.
//!
//! First come the vertices of the cut in their order, each with its first wedge. Behind them, in the same order, come the other
//! wedges, but for those that no active triangle has.
//!
//! A triangle has the material of its first corner's wedge. (Those of its corners only differ where parts of the mesh were collapsed
//! that no legal collapse could reduce.)
//!
//! RAM: 4 bytes for each vertex where there are materials; where there are seams, 1.5 bits for each wedge of the model, and 12 bytes for each active wedge that is not the first one of
//! its leaf. I/O: what the cut reads for its vertices and triangles, once more for either of them.

use vdt::tree::Wedge;

use crate::bits::{Bits, RankedBits};
use crate::cut::UniformCut;
use crate::header::ModelError;
use crate::walk::walk;

/// The vertices of a cut with attributes.
#[derive(Debug)]
pub struct CutWedges<'c, 'm> {
    cut: &'c UniformCut<'m>,
    seams: Option<Seams>,
    /// Of each vertex; empty where there are no materials.
    materials: Vec<u32>,
    has_alpha: bool,
}

#[derive(Debug)]
struct Seams {
    /// The numbers of the active wedges.
    active: RankedBits,
    /// The wedges behind the first ones, by rank, with their vertex numbers.
    others: Vec<(u32, u64)>,
}

impl<'c, 'm> CutWedges<'c, 'm> {
    /// Those of a cut; none where its model has no attributes.
    pub fn of(cut: &'c UniformCut<'m>) -> Result<Option<Self>, ModelError> {
        let (model, _) = cut.model();
        let Some(appearance) = model.appearance() else { return Ok(None) };
        let seams = if appearance.layout.has_seams { Some(Self::seams(cut)?) } else { None };
        let mut wedges = CutWedges { cut, seams, materials: Vec::new(), has_alpha: false };
        let kinds = appearance.layout.kinds;
        if !kinds.materials && !kinds.colours {
            return Ok(Some(wedges));
        }
        let (mut materials, mut has_alpha) = (Vec::new(), false);
        if kinds.materials {
            materials.reserve_exact(usize::try_from(wedges.vertex_count()).unwrap_or_default());
        }
        wedges.for_each_vertex(|_, wedge| -> Result<(), ModelError> {
            has_alpha |= wedge.colour[3] < u8::MAX;
            if kinds.materials {
                materials.push(wedge.material);
            }
            Ok(())
        })?;
        (wedges.materials, wedges.has_alpha) = (materials, has_alpha);
        Ok(Some(wedges))
    }

    fn seams(cut: &UniformCut<'_>) -> Result<Seams, ModelError> {
        let (model, error) = cut.model();
        let count = model.appearance().map_or(0, |appearance| appearance.wedge_count);
        let mut active = Bits::new(count);
        let mut others = Vec::new();
        let outside = |number: u32| {
            let problem = format!("wedge {number} of {count}; `vdt verify` says where");
            ModelError::Damaged { path: model.path().into(), part: "file".into(), problem }
        };
        cut.for_each_leaf(|_, wedges| -> Result<(), ModelError> {
            for (place, placed) in wedges.iter().enumerate() {
                if placed.number >= count {
                    return Err(outside(placed.number));
                }
                active.insert(placed.number);
                if place > 0 {
                    others.push(placed.number);
                }
            }
            Ok(())
        })?;
        let active = active.ranked();
        let mut used = Bits::new(active.len());
        walk(model, error, |page, switches| {
            for (index, _) in (0..).zip(switches).filter(|(_, switch)| **switch > error) {
                for number in page.corner_wedges(index).flatten() {
                    let rank = if number < count { active.rank(number) } else { 0 };
                    used.insert(rank.checked_sub(1).ok_or_else(|| outside(number))?);
                }
            }
            Ok::<_, ModelError>(())
        })?;
        let ranks = others.into_iter().map(|number| active.rank(number) - 1).filter(|rank| used.contains(*rank));
        let mut others: Vec<(u32, u64)> = ranks.zip(cut.vertex_count()..).collect();
        others.sort_unstable();
        others.shrink_to_fit();
        Ok(Seams { active, others })
    }

    /// Whether the alpha of a colour is other than 255 anywhere.
    pub fn has_alpha(&self) -> bool {
        self.has_alpha
    }

    /// Vertices, one for each wedge.
    pub fn vertex_count(&self) -> u64 {
        self.cut.vertex_count() + self.seams.as_ref().map_or(0, |seams| seams.others.len() as u64)
    }

    /// Hands every vertex's position, in mesh units relative to the model's origin, and its wedge to `action`, in the order of the
    /// vertex numbers.
    pub fn for_each_vertex<E: From<ModelError>>(
        &self,
        mut action: impl FnMut([f32; 3], &Wedge) -> Result<(), E>,
    ) -> Result<(), E> {
        self.cut.for_each_leaf(|position, wedges| match wedges.first() {
            Some(first) => action(position, &first.wedge),
            None => action(position, &Wedge::PLAIN),
        })?;
        let Some(seams) = &self.seams else { return Ok(()) };
        self.cut.for_each_leaf(|position, wedges| {
            for placed in wedges.iter().skip(1) {
                if seams.vertex(placed.number).is_some() {
                    action(position, &placed.wedge)?;
                }
            }
            Ok(())
        })
    }

    /// Hands the vertex numbers of every triangle, in the orientation of the input mesh, and its material, counted from 1, to
    /// `action`; 0 where it has none.
    pub fn for_each_triangle<E: From<ModelError>>(
        &self,
        mut action: impl FnMut([u64; 3], u32) -> Result<(), E>,
    ) -> Result<(), E> {
        let material = |corners: &[u64; 3]| self.materials.get(corners[0] as usize).copied().unwrap_or_default();
        let Some(seams) = &self.seams else {
            return self.cut.for_each_triangle(|corners| action(corners, material(&corners)));
        };
        let (model, error) = self.cut.model();
        walk(model, error, |page, switches| {
            for (index, _) in (0..).zip(switches).filter(|(_, switch)| **switch > error) {
                for (leaves, wedges) in page.triangles(index).zip(page.corner_wedges(index)) {
                    let corners = [0, 1, 2].map(|corner: usize| {
                        seams.vertex(wedges[corner]).unwrap_or_else(|| self.cut.vertex_of(leaves[corner]))
                    });
                    action(corners, material(&corners))?;
                }
            }
            Ok(())
        })
    }
}

impl Seams {
    /// The vertex of the active wedge that a wedge turns into, if that is not the first one of its leaf.
    fn vertex(&self, number: u32) -> Option<u64> {
        let rank = self.active.rank(number).checked_sub(1)?;
        let place = self.others.binary_search_by_key(&rank, |(rank, _)| *rank).ok()?;
        Some(self.others[place].1)
    }
}
