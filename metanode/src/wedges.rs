//! Wedges in pages: what the corners of triangles carry besides a position (`vdt::tree::Wedge`), and how it lies there.
//!
//! Which attributes a model has is the same for all of its pages, so its wedges all have the same words, and none for what it does
//! not have. Where no leaf has more than one wedge, a record has that of its born leaf and nothing refers to it. Where some have,
//! the model has *seams*: each record says where its wedges begin, each wedge has its number in the forest of wedges, and each
//! corner of a triangle the number of a wedge.
//!
//! The wedge that a corner has in a mesh that is not fully refined is one of the leaf at which its active node stands: that of them
//! with the largest number which is not above the corner's.

pub use vdt::tree::MOST_WEDGES;
use vdt::tree::{AttributeKinds, Normal, StoredTree, Wedge};

/// How the wedges of a model lie in its pages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WedgeLayout {
    /// Which attributes there are.
    pub kinds: AttributeKinds,
    /// Whether there are leaves with more than one wedge.
    pub has_seams: bool,
}

/// A wedge, and where it is in the forest of wedges.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlacedWedge {
    /// What it is.
    pub wedge: Wedge,
    /// Its number; that of its leaf where there are no seams.
    pub number: u32,
    /// One past the last number of the wedges that turn into it where its leaf is collapsed no further; one past its own where
    /// there are no seams.
    pub end: u32,
}

impl WedgeLayout {
    /// How those of a tree will lie there.
    pub(crate) fn of(tree: &StoredTree) -> Self {
        tree.attributes.as_ref().map_or(WedgeLayout::default(), |attributes| WedgeLayout {
            kinds: attributes.appearance.kinds,
            has_seams: attributes.seams.is_some(),
        })
    }

    /// Whether each wedge has its own normal. Without seams it is that of the record.
    fn has_normals(self) -> bool {
        self.kinds.normals && self.has_seams
    }

    /// Words of a wedge in a page.
    pub fn words(self) -> usize {
        let AttributeKinds { colours, textures, materials, .. } = self.kinds;
        2 * usize::from(self.has_seams)
            + usize::from(self.has_normals())
            + usize::from(colours)
            + 2 * usize::from(textures)
            + usize::from(materials)
    }

    /// Words of the place of a record's first wedge.
    pub fn place_words(self) -> usize {
        usize::from(self.has_seams)
    }

    /// Words of the wedges of a triangle's corners.
    pub fn corner_words(self) -> usize {
        3 * usize::from(self.has_seams)
    }

    /// Appends the words of a wedge.
    pub(crate) fn push(self, placed: &PlacedWedge, words: &mut Vec<u32>) {
        let PlacedWedge { wedge, number, end } = placed;
        let AttributeKinds { colours, textures, materials, .. } = self.kinds;
        if self.has_seams {
            words.extend([*number, *end]);
        }
        if self.has_normals() {
            words.push(wedge.normal.to_word());
        }
        if colours {
            words.push(u32::from_le_bytes(wedge.colour));
        }
        if textures {
            words.extend(wedge.texture.map(i32::cast_unsigned));
        }
        if materials {
            words.push(wedge.material);
        }
    }

    /// The inverse of [`WedgeLayout::push`]. `leaf` and `normal` are those of the record.
    pub(crate) fn wedge(self, words: &[u32], leaf: u32, normal: Normal) -> PlacedWedge {
        let AttributeKinds { normals, colours, textures, materials } = self.kinds;
        let mut words = words.iter().copied();
        let mut next = || words.next().unwrap_or_default();
        let (number, end) = if self.has_seams { (next(), next()) } else { (leaf, leaf.saturating_add(1)) };
        let mut wedge = Wedge::PLAIN;
        if self.has_normals() {
            wedge.normal = Normal::from_word(next());
        } else if normals {
            wedge.normal = normal;
        }
        if colours {
            wedge.colour = next().to_le_bytes();
        }
        if textures {
            wedge.texture = [next(), next()].map(u32::cast_signed);
        }
        if materials {
            wedge.material = next();
        }
        PlacedWedge { wedge, number, end }
    }
}

/// The wedges of the first leaves of all trees, which no split bears.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RootWedges {
    /// The first leaf of each tree, ascending.
    starts: Vec<u32>,
    /// Where the wedges of each begin.
    firsts: Vec<u32>,
    wedges: Vec<PlacedWedge>,
}

impl RootWedges {
    /// Appends those of the next tree.
    pub fn push(&mut self, start: u32, wedges: impl IntoIterator<Item = PlacedWedge>) {
        self.starts.push(start);
        self.firsts.push(self.wedges.len() as u32);
        self.wedges.extend(wedges);
    }

    /// How many trees there are.
    pub fn tree_count(&self) -> usize {
        self.starts.len()
    }

    /// How many wedges they have.
    pub fn wedge_count(&self) -> usize {
        self.wedges.len()
    }

    /// Those of the tree that begins with a leaf; none where no tree does.
    pub fn of(&self, start: u32) -> &[PlacedWedge] {
        self.starts.binary_search(&start).map_or(&[], |tree| self.of_tree(tree))
    }

    /// Those of the tree with this index.
    pub fn of_tree(&self, tree: usize) -> &[PlacedWedge] {
        let Some(first) = self.firsts.get(tree).map(|first| *first as usize) else { return &[] };
        let end = self.firsts.get(tree + 1).map_or(self.wedges.len(), |end| *end as usize);
        self.wedges.get(first..end).unwrap_or_default()
    }

    /// Bytes of RAM that this holds.
    pub fn ram_bytes(&self) -> usize {
        4 * (self.starts.capacity() + self.firsts.capacity()) + self.wedges.capacity() * size_of::<PlacedWedge>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wedge_comes_back_as_it_was() {
        let all = Wedge {
            material: 3,
            texture: [-5, 1 << 22],
            colour: [1, 2, 3, 4],
            normal: Normal::encode([1.0, 2.0, 3.0]),
        };
        for bits in 0..32_u8 {
            let is = |bit: u8| bits >> bit & 1 == 1;
            let kinds = AttributeKinds { normals: is(0), colours: is(1), textures: is(2), materials: is(3) };
            let layout = WedgeLayout { kinds, has_seams: is(4) };
            let wedge = Wedge {
                material: if kinds.materials { all.material } else { 0 },
                texture: if kinds.textures { all.texture } else { [0; 2] },
                colour: if kinds.colours { all.colour } else { [255; 4] },
                normal: if kinds.normals { all.normal } else { Normal::UP },
            };
            let (number, end) = if layout.has_seams { (9, 30) } else { (7, 8) };
            let placed = PlacedWedge { wedge, number, end };
            let mut words = Vec::new();
            layout.push(&placed, &mut words);
            assert_eq!(words.len(), layout.words());
            assert_eq!(layout.wedge(&words, 7, all.normal), placed);
        }
    }

    #[test]
    fn roots_have_their_own() {
        let placed = |number| PlacedWedge { wedge: Wedge::PLAIN, number, end: number + 1 };
        let mut roots = RootWedges::default();
        roots.push(0, [placed(0)]);
        roots.push(5, [placed(5), placed(6)]);
        assert_eq!((roots.of(0), roots.of(5)), (&[placed(0)][..], &[placed(5), placed(6)][..]));
        assert_eq!((roots.of(3), roots.of_tree(2)), (&[][..], &[][..]));
    }
}
