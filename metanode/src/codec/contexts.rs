//! The contexts in which symbols are coded: for each kind of field, how many there are and where they begin.
//!
//! They are a part of the format: a decoder has to make the same contexts of what it has decoded already, to the bit. So they
//! are made with integers, or with single-precision additions, multiplications, divisions and square roots, which IEEE 754
//! defines exactly; with no function of a mathematical library.

/// A kind of symbol: an alphabet, and the contexts in which it is coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Family {
    /// The number of its first context.
    pub first: usize,
    /// How many contexts it has.
    pub contexts: usize,
    /// How many symbols.
    pub symbols: usize,
}

impl Family {
    const fn after(before: Family, contexts: usize, symbols: usize) -> Family {
        Family { first: before.first + before.contexts, contexts, symbols }
    }

    /// The number of its context `index`.
    #[inline(always)]
    pub fn context(self, index: usize) -> usize {
        debug_assert!(index < self.contexts);
        self.first + index
    }
}

const NOTHING: Family = Family { first: 0, contexts: 0, symbols: 0 };

/// Which of a record's children are leaves, in this page, in another page. Context: the same of its parent, or that it is a
/// root of the page; whether the page has children.
pub(crate) const STRUCTURE: Family = Family::after(NOTHING, 10 * 2, 9);
/// Half-octave class of the size of a subtree in another page.
pub(crate) const SUBTREE_SIZE: Family = Family::after(STRUCTURE, 1, 64);
/// By how much the radius of such a subtree is smaller than that of the root of the page. Context: how much smaller its size
/// is.
pub(crate) const SUBTREE_RADIUS: Family = Family::after(SUBTREE_SIZE, 16, 64);
/// By how many classes of switch values a child is below its parent. Context: its size, kept or born.
pub(crate) const CLASS_STEP: Family = Family::after(SUBTREE_RADIUS, 10 * 2, 64);
/// Place in the chain of dependent nodes of one class. Context: step of the class, place of the parent.
pub(crate) const CHAIN: Family = Family::after(CLASS_STEP, 4 * 6, 64);
/// The first coordinate of the way from the kept to the born vertex, as a class relative to what is expected.
pub(crate) const FIRST_COORDINATE: Family = Family::after(CHAIN, super::scale::CONTEXTS, super::scale::SYMBOLS);
/// The second one. Context also: how large the first one is.
pub(crate) const SECOND_COORDINATE: Family =
    Family::after(FIRST_COORDINATE, super::scale::CONTEXTS * 4, super::scale::SYMBOLS);
/// The third one, less what the tangent plane says.
pub(crate) const THIRD_COORDINATE: Family =
    Family::after(SECOND_COORDINATE, super::scale::CONTEXTS, super::scale::SYMBOLS);
/// Whether the first coordinate is one of the file's frequent numbers, and which. Context: what is expected, in octaves.
pub(crate) const FIRST_FREQUENT: Family =
    Family::after(THIRD_COORDINATE, super::frequent::OCTAVES, super::frequent::SYMBOLS);
/// The second coordinate. Context also: whether the first one is.
pub(crate) const SECOND_FREQUENT: Family =
    Family::after(FIRST_FREQUENT, super::frequent::OCTAVES * 2, super::frequent::SYMBOLS);
/// The third coordinate. Context also: how many of the others are.
pub(crate) const THIRD_FREQUENT: Family =
    Family::after(SECOND_FREQUENT, super::frequent::OCTAVES * 3, super::frequent::SYMBOLS);
/// Whether a coordinate is a fraction of the file's denominator, or how far beside one. Context: which coordinate, and how many
/// before it are none.
pub(crate) const FRACTION: Family =
    Family::after(THIRD_FREQUENT, super::fractions::CONTEXTS, super::fractions::SYMBOLS);
/// How many triangles a split bears in each orientation. Context: whether the page has children.
pub(crate) const TRIANGLE_COUNT: Family = Family::after(FRACTION, 2, 5);
/// First coordinate of a normal, less what is expected. Context: what the expectation is made of.
pub(crate) const FIRST_NORMAL: Family =
    Family::after(TRIANGLE_COUNT, super::normals::CONTEXTS, super::normals::SYMBOLS);
/// Second coordinate. Context also: how far off the first one was.
pub(crate) const SECOND_NORMAL: Family =
    Family::after(FIRST_NORMAL, super::normals::CONTEXTS * 3, super::normals::SYMBOLS);
/// Half-angle of a normal cone. Context: that of the cones below it.
pub(crate) const CONE: Family =
    Family::after(SECOND_NORMAL, super::cones::NO_CONE as usize + 2, super::cones::NO_CONE as usize + 1);
/// How far the number of a leaf elsewhere is from that of one that is known. Context: how far that one is.
pub(crate) const OUTSIDE: Family = Family::after(CONE, 8, 128);

/// How many wedges a born leaf has. Context: how many the leaf onto which it is collapsed has.
pub(crate) const WEDGE_COUNT: Family = Family::after(OUTSIDE, super::wedges::COUNT_LEVELS, super::wedges::PLACES);
/// The image of a wedge. Context: its own place; how many there are to choose from.
pub(crate) const WEDGE_IMAGE: Family =
    Family::after(WEDGE_COUNT, super::wedges::COUNT_LEVELS * super::wedges::COUNT_LEVELS, super::wedges::PLACES);
/// Whether a wedge has another material than its image. Context: whether it is the first one of its leaf.
pub(crate) const MATERIAL: Family = Family::after(WEDGE_IMAGE, 2, 2);
/// The material then.
pub(crate) const MATERIAL_NUMBER: Family = Family::after(MATERIAL, 1, 64);
/// The first coordinate of the way in the texture from an image to its wedge, as a class relative to what is expected.
pub(crate) const TEXTURE_FIRST: Family = Family::after(MATERIAL_NUMBER, super::scale::CONTEXTS, super::scale::SYMBOLS);
/// The second one. Context also: how large the first one is.
pub(crate) const TEXTURE_SECOND: Family =
    Family::after(TEXTURE_FIRST, super::scale::CONTEXTS * 4, super::scale::SYMBOLS);
/// A colour channel, less what is expected. Context: which one; the difference of the one before.
pub(crate) const COLOUR: Family = Family::after(TEXTURE_SECOND, 4 * super::wedges::LEVELS, super::wedges::DIFFERENCES);
/// First coordinate of a wedge's normal, less that of the computed one. Context: whether the wedge is the first one of its leaf.
pub(crate) const WEDGE_NORMAL_FIRST: Family =
    Family::after(COLOUR, 2 * super::wedges::LEVELS, super::wedges::DIFFERENCES);
/// Second coordinate. Context also: how far off the first one was.
pub(crate) const WEDGE_NORMAL_SECOND: Family =
    Family::after(WEDGE_NORMAL_FIRST, 2 * super::wedges::LEVELS, super::wedges::DIFFERENCES);
/// How many more wedges turn into one of a subtree in a child page than leaves there are, or than one. Context: whether there are
/// others of the same leaf.
pub(crate) const SUBTREE_WEDGES: Family = Family::after(WEDGE_NORMAL_SECOND, 2, 64);
/// Which wedge of its leaf a corner has. Context: how many there are; which corner; what was chosen last.
pub(crate) const CORNER_WEDGE: Family =
    Family::after(SUBTREE_WEDGES, super::wedges::COUNT_LEVELS * 3 * super::wedges::CHOICES, super::wedges::PLACES);

/// All families.
pub(crate) const FAMILIES: [Family; 28] = [
    STRUCTURE,
    SUBTREE_SIZE,
    SUBTREE_RADIUS,
    CLASS_STEP,
    CHAIN,
    FIRST_COORDINATE,
    SECOND_COORDINATE,
    THIRD_COORDINATE,
    FIRST_FREQUENT,
    SECOND_FREQUENT,
    THIRD_FREQUENT,
    FRACTION,
    TRIANGLE_COUNT,
    FIRST_NORMAL,
    SECOND_NORMAL,
    CONE,
    OUTSIDE,
    WEDGE_COUNT,
    WEDGE_IMAGE,
    MATERIAL,
    MATERIAL_NUMBER,
    TEXTURE_FIRST,
    TEXTURE_SECOND,
    COLOUR,
    WEDGE_NORMAL_FIRST,
    WEDGE_NORMAL_SECOND,
    SUBTREE_WEDGES,
    CORNER_WEDGE,
];

/// How many contexts for symbols there are.
pub(crate) const SYMBOL_CONTEXTS: usize = CORNER_WEDGE.first + CORNER_WEDGE.contexts;

/// The contexts of decisions: on the way down to a corner, on the way up from a node, and in a subtree elsewhere.
pub(crate) const DOWN: usize = 0;
/// How many there are for the way down: see `paths`.
pub(crate) const DOWN_CONTEXTS: usize = 12 * 13 * 4 * 3;
/// On the way up.
pub(crate) const UP: usize = DOWN + DOWN_CONTEXTS;
/// How many there are for the way up.
pub(crate) const UP_CONTEXTS: usize = 14 * 4 * 4 * 3 * 3;
/// Whether a corner is the first leaf of a subtree elsewhere. Context: which corner.
pub(crate) const FIRST_LEAF: usize = UP + UP_CONTEXTS;
/// Whether a third coordinate that is a frequent number is negative. Context: whether the tangent plane says so.
pub(crate) const SIGN: usize = FIRST_LEAF + 3;
/// How many contexts for decisions there are.
pub(crate) const DECISION_CONTEXTS: usize = SIGN + 2;

/// All families of decisions.
pub(crate) const DECISIONS: [Family; 4] = [
    Family { first: DOWN, contexts: DOWN_CONTEXTS, symbols: 2 },
    Family { first: UP, contexts: UP_CONTEXTS, symbols: 2 },
    Family { first: FIRST_LEAF, contexts: SIGN - FIRST_LEAF, symbols: 2 },
    Family { first: SIGN, contexts: DECISION_CONTEXTS - SIGN, symbols: 2 },
];
