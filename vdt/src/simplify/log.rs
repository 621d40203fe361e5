//! What a simplification writes down: [`Simplified`], the collapses and deaths from which the tree is made.
//!
//! The engine carries along, with each vertex that is left, what the node that it stands for amounts to: its leaves, its
//! bounding sphere, its normal cone, its last split. So each collapse is written down once, with all that its node will
//! ever need, and no later step has to walk the tree from the leaves up (time-forward processing, done by the live mesh
//! itself).

use super::SpannedCounters;
use crate::tree::Normal;
use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};
use storage::{KeptScattered, KeptSpool, Scattered, Scratch, Spool, StorageError};

/// A collapse. Vertices are named by canonical ids. 36 bytes.
///
/// Every vertex but the roots is born by exactly one collapse, so `born` names the node. A child's split is given by how
/// many leaves that split's kept child has: in the final numbering the leaf that it bears lies so many behind the child's
/// first leaf (`kept` or `born`), so that numbers flow from the roots down in one pass against the log. No child of a
/// split is without leaves, so 0 is free to say that the child is a leaf.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LoggedCollapse {
    /// The vertex that stays, and gives the new node its position.
    pub kept: u32,
    /// The vertex that goes: born again when the node is split.
    pub born: u32,
    /// Leaves under the kept child. The born leaf's number is the kept leaf's plus this.
    pub kept_leaves: u32,
    /// Leaves under the kept child of the kept child's split; 0 where the kept child is a leaf.
    pub kept_split: u32,
    /// Leaves under the kept child of the born child's split; 0 where the born child is a leaf.
    pub born_split: u32,
    /// Dependency id of the new node, see [`crate::tree::id_after`].
    pub id: u32,
    /// Radius of the node's bounding sphere, in mesh units.
    pub radius: f32,
    /// The node's normal cone, as [`crate::tree::NormalCone::to_word`] has it, for triangles as they are oriented.
    pub cone: u32,
    /// The normal of the input at the vertex that goes.
    pub normal: Normal,
}

/// A wedge of a vertex that went, and what it turned into. 8 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct WedgeImage {
    /// The vertex that went, by its canonical id.
    pub born: u32,
    /// The place of the wedge among those of that vertex.
    pub wedge: u16,
    /// The place of its image among those of the vertex that stayed.
    pub image: u16,
}

/// What is left of a component: one vertex, under which all others are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LoggedRoot {
    /// Its canonical id.
    pub vertex: u32,
    /// Leaves under it.
    pub leaves: u32,
    /// Leaves under the kept child of its split. (Every component has a triangle, so every root splits.)
    pub split: u32,
    /// Which way is out: 1 or -1 times the orientation of the triangles; 0 where the surface has no inside (it is not
    /// closed, not consistently oriented, or without a volume), so that no cone may be used.
    pub outward: i8,
    /// The normal of the input at it.
    pub normal: Normal,
}

/// Everything that happened to a mesh until one root per component was left.
#[derive(Debug)]
pub struct Simplified {
    /// Every collapse once, in an order in which a node's children come before it: not necessarily that in which they were
    /// decided, unless all was in memory.
    pub log: Spool<LoggedCollapse>,
    /// For each canonical triangle the vertex born by the collapse at which it disappeared.
    pub deaths: Scattered<u32>,
    /// The roots, by ascending vertex.
    pub roots: Vec<LoggedRoot>,
    /// The images of all wedges of each vertex that went onto one with several wedges, in no particular order. The image of
    /// any other wedge is the only one there is.
    pub wedge_images: Spool<WedgeImage>,
    /// Rounds that kept all legality tests (1 with the priority queue).
    pub rounds: u32,
    /// Collapses that kept all legality tests.
    pub legal_collapses: u64,
    /// What it took, where it went through spanned sub-meshes.
    pub spanned: Option<SpannedCounters>,
}

/// How to open a [`Simplified`] again that was kept.
#[derive(Debug, Serialize, Deserialize)]
pub struct KeptSimplified {
    log: KeptSpool,
    deaths: KeptScattered,
    roots: KeptSpool,
    wedge_images: KeptSpool,
    rounds: u32,
    legal_collapses: u64,
    /// Holds the file of the roots until the checkpoint has taken it over.
    #[serde(skip)]
    _roots_file: Option<Spool<[u32; 5]>>,
}

impl KeptSimplified {
    /// Its files in the scratch.
    pub fn files(&self) -> impl Iterator<Item = String> + '_ {
        [&self.log.file, &self.roots.file, &self.wedge_images.file]
            .into_iter()
            .flatten()
            .cloned()
            .chain(self.deaths.files())
    }
}

impl Simplified {
    /// Keeps it for a checkpoint: its files stay when it goes. Says how to open it again.
    pub fn keep(&mut self, scratch: &Scratch) -> Result<KeptSimplified, StorageError> {
        let words =
            |root: &LoggedRoot| [root.vertex, root.leaves, root.split, root.outward as u32, root.normal.to_word()];
        let mut roots = Spool::from_vec(self.roots.iter().map(words).collect());
        Ok(KeptSimplified {
            log: self.log.keep(scratch, "log")?,
            deaths: self.deaths.keep(scratch, "deaths")?,
            roots: roots.keep(scratch, "roots")?,
            wedge_images: self.wedge_images.keep(scratch, "wedge-images")?,
            rounds: self.rounds,
            legal_collapses: self.legal_collapses,
            _roots_file: Some(roots),
        })
    }

    /// Opens one that was kept.
    pub fn reopen(scratch: &Scratch, kept: &KeptSimplified) -> Result<Self, StorageError> {
        let spool = Spool::<[u32; 5]>::reopen(scratch, &kept.roots)?;
        let mut reader = spool.reader(0);
        let mut roots = Vec::with_capacity(spool.len() as usize);
        while let Some([vertex, leaves, split, outward, normal]) = reader.next()? {
            let normal = Normal::from_word(normal);
            roots.push(LoggedRoot { vertex, leaves, split, outward: outward as i8, normal });
        }
        Ok(Simplified {
            log: Spool::reopen(scratch, &kept.log)?,
            deaths: Scattered::reopen(scratch, &kept.deaths)?,
            roots,
            wedge_images: Spool::reopen(scratch, &kept.wedge_images)?,
            rounds: kept.rounds,
            legal_collapses: kept.legal_collapses,
            spanned: None,
        })
    }
}
