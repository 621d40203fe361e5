//! The fixed parts of a model file: header, root table, root page table, way table. All little endian.
//!
//! ```text
//! offset  bytes  header (256 bytes)
//!      0      8  magic "VDTMODEL"
//!      8      4  version of the format: 3
//!     12      4  feature flags: 1 the model has attributes; a reader refuses flags that it does not know
//!     16      4  bytes of this header: 256
//!     20      4  leaves (vertices)
//!     24      4  triangles
//!     28      4  splits (inner nodes)
//!     32      4  roots (trees, that is components)
//!     36      4  meta-nodes (pages)
//!     40      4  root pages: meta-nodes without a parent
//!     44      4  bytes of the largest page, decoded: what a place holder must hold
//!     48      4  bytes of the largest page in the file; 0 without pages
//!     52      4  levels of the meta-node tree
//!     56     24  origin: three f64, to be added to every position
//!     80     24  bounding box of the positions: minimum and maximum, three f32 each
//!    104      4  largest switch value, f32
//!    108      4  metric: 0 quadric, 1 length
//!    112      4  strategy: 0 passes (frozen-batch rounds), 1 btree (the paper's priority queue)
//!    116      4  what the switch values are: 0 the metric's error, 1 to 4 the certified bound fast, default, tight,
//!                two-sided
//!    120      4  blocking: 0 forest, 1 levels
//!    124      4  blocking parameter: forest: slot bytes asked for; levels: levels of a meta-node
//!    128      4  blocking parameter: forest: most child pages of a page; levels: 0
//!    132      8  offset of the root table
//!    140      8  offset of the first page
//!    148      8  length of the file
//!    156      4  input error: no point of the input is farther from the fully refined mesh, f32
//!    160      4  exponent, i32: the mesh was simplified in units of 2 to this, at which switch values follow from ids
//!    164      4  positions: 0 lossless, else the bits of the lattice that they were rounded to, 10 to 24
//!    168      4  step of the lattice that all positions are on, f32; 0 without one
//!    172      4  way pages: pages on the way to trees that begin in no root page
//!    176      4  bytes of the coder's tables
//!    180      4  bytes of the appearance; 0 without attributes
//!    184      8  bytes of the images
//!    192     60  zero
//!    252      4  CRC-32 of the 252 bytes before
//!
//!    256   60 r  root table, by ascending first leaf: first leaf, end leaf, x, y, z (f32), id, switch (f32),
//!                radius (f32), cone, record, page number, page offset (low, high), page length,
//!                normal of the first leaf (20 bits; 31: whether the surface is inward; the others are 0)
//!         16 p   root page table: page number, offset (low, high), length
//!         20 w   way table, by ascending number: page number, parent's number, offset (low, high), length
//!          4     CRC-32 of the tables
//!          t     the coder's tables (`codec::tables`)
//!          4     CRC-32 of them
//!          a     the appearance, with its CRC-32 (`appearance`), and the images
//!                the pages, in the order of their numbers, without gaps
//! ```

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use storage::StorageError;
use thiserror::Error;
pub use vdt::tree::{ErrorBound, Metric, Positions, Strategy};
use vdt::tree::{Normal, NormalCone};

use crate::page::{PageError, PageLocation};

/// The first eight bytes of every model file.
pub const MAGIC: [u8; 8] = *b"VDTMODEL";
/// The version of the format that this library writes, and the only one that it reads.
pub const VERSION: u32 = 3;
/// Feature flag: the model has attributes.
const ATTRIBUTES: u32 = 1;
/// Bytes of the header.
pub const HEADER_BYTES: usize = 256;
/// Words of one root.
pub const ROOT_WORDS: usize = 15;
/// The largest page that may be, decoded, in bytes.
pub const LARGEST_SLOT_BYTES: u32 = 1 << 30;
/// What the exponent of a mesh in single precision can be.
const EXPONENTS: RangeInclusive<i32> = -149..=129;
/// Words of one root page.
pub const ROOT_PAGE_WORDS: usize = 4;
/// Words of one way page.
pub const WAY_WORDS: usize = 5;

/// What is wrong with a model file.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The disk failed, or the file is too short.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// The file is something else.
    #[error(
        "{}: not a vdt model (it does not begin with \"VDTMODEL\"); build one with: vdt build MESH -o MODEL.vdt",
        path.display()
    )]
    NotAModel {
        /// The file in question.
        path: PathBuf,
    },
    /// The file is of a version that this library does not read.
    #[error(
        "{}: the model is of format version {found}, this program reads version {VERSION}; \
         build the model again from its mesh, or use the vdt that wrote it",
        path.display()
    )]
    Version {
        /// The file in question.
        path: PathBuf,
        /// The version found.
        found: u32,
    },
    /// The file uses features that this library does not know.
    #[error(
        "{}: the model uses features that this program does not know (flags {flags:#x}); use a newer vdt",
        path.display()
    )]
    Features {
        /// The file in question.
        path: PathBuf,
        /// The flags found.
        flags: u32,
    },
    /// The fixed parts of the file are damaged.
    #[error("{}: {part}: {problem}; the file is damaged, build it again", path.display())]
    Damaged {
        /// The file in question.
        path: PathBuf,
        /// Which part: "header", "root table", "root 7".
        part: String,
        /// What is wrong.
        problem: String,
    },
    /// A page is damaged.
    #[error("{}: meta-node {} at byte {}: {source}", path.display(), location.number, location.offset)]
    Page {
        /// The file in question.
        path: PathBuf,
        /// The page.
        location: PageLocation,
        /// What is wrong with it.
        source: PageError,
    },
}

/// How the tree was cut into meta-nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Blocking {
    /// Each page a set of subtrees, filled by largest switch value first.
    Forest {
        /// Decoded bytes of a page at most (unless a single split is larger).
        slot_bytes: u32,
        /// Child pages of a page at most (more only where splits with very many triangles leave no other way).
        fan_out: u32,
    },
    /// The paper's: each page a subtree of so many levels (3.2).
    Levels {
        /// Levels of the binary tree in one page.
        levels: u32,
    },
}

/// What the header says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Header {
    /// Leaves, that is vertices of the mesh.
    pub leaf_count: u32,
    /// Triangles of the mesh.
    pub triangle_count: u32,
    /// Inner nodes.
    pub split_count: u32,
    /// Trees, that is connected components.
    pub root_count: u32,
    /// Meta-nodes.
    pub page_count: u32,
    /// Meta-nodes without a parent.
    pub root_page_count: u32,
    /// Meta-nodes with a parent in which a tree begins, or that lead to one.
    pub way_count: u32,
    /// Bytes of the largest page decoded: the size of a place holder.
    pub slot_bytes: u32,
    /// Bytes of the largest page encoded.
    pub largest_page_bytes: u32,
    /// Levels of the meta-node tree.
    pub page_levels: u32,
    /// To be added to every position, in mesh units.
    pub origin: [f64; 3],
    /// Smallest coordinates of the positions, in mesh units, relative to the origin.
    pub minimum: [f32; 3],
    /// Largest coordinates of the positions.
    pub maximum: [f32; 3],
    /// Largest switch value, in mesh units: from this error on only the roots are left.
    pub largest_switch: f32,
    /// The metric.
    pub metric: Metric,
    /// The order of the collapses.
    pub strategy: Strategy,
    /// What the switch values are.
    pub error_bound: ErrorBound,
    /// No point of a triangle of the input files is farther than this from the fully refined mesh, in mesh units: what
    /// single precision or a lattice, and leaving out triangles without area, may have moved.
    pub input_error: f32,
    /// The mesh was simplified in units of 2 to this: [`vdt::tree::switch_of`] has switch values from ids with it.
    pub exponent: i32,
    /// How the positions were kept.
    pub positions: Positions,
    /// The step of the lattice that all positions are on (`vdt::tree::on_lattice`), in mesh units; 0 where there is none.
    pub lattice_step: f32,
    /// The blocking.
    pub blocking: Blocking,
    /// Bytes of the coder's tables.
    pub table_bytes: u32,
    /// Bytes of the appearance; 0 where the model has no attributes.
    pub appearance_bytes: u32,
    /// Bytes of the images behind it.
    pub image_bytes: u64,
    /// Byte offset of the root table.
    pub roots_offset: u64,
    /// Byte offset of the first page.
    pub pages_offset: u64,
    /// Length of the file in bytes.
    pub file_length: u64,
}

impl Default for Blocking {
    /// Forest pages of 16 KiB with up to 8 child pages: what a flight reads least of (`vdt bench blocking`).
    fn default() -> Self {
        Blocking::Forest { slot_bytes: 16 * 1024, fan_out: 8 }
    }
}

impl Header {
    /// Length of the diagonal of the bounding box, in mesh units.
    pub fn diagonal(&self) -> f64 {
        let square = |axis: usize| {
            let extent = f64::from(self.maximum[axis]) - f64::from(self.minimum[axis]);
            extent * extent
        };
        (square(0) + square(1) + square(2)).sqrt()
    }

    /// The 256 bytes of the header.
    pub fn to_bytes(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = Vec::with_capacity(HEADER_BYTES);
        let (blocking, first_parameter, second_parameter) = match self.blocking {
            Blocking::Forest { slot_bytes, fan_out } => (0, slot_bytes, fan_out),
            Blocking::Levels { levels } => (1, levels, 0),
        };
        bytes.extend(MAGIC);
        let mut words = |words: &[u32]| words.iter().for_each(|word| bytes.extend(word.to_le_bytes()));
        let flags = if self.appearance_bytes > 0 { ATTRIBUTES } else { 0 };
        words(&[VERSION, flags, HEADER_BYTES as u32, self.leaf_count, self.triangle_count, self.split_count]);
        words(&[self.root_count, self.page_count, self.root_page_count, self.slot_bytes, self.largest_page_bytes]);
        words(&[self.page_levels]);
        self.origin.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        self.minimum.iter().chain(&self.maximum).for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend(self.largest_switch.to_le_bytes());
        let metric = u32::from(self.metric == Metric::Length);
        let strategy = u32::from(self.strategy == Strategy::Btree);
        let error_bound = match self.error_bound {
            ErrorBound::None => 0,
            ErrorBound::Fast => 1,
            ErrorBound::Default => 2,
            ErrorBound::Tight => 3,
            ErrorBound::TwoSided => 4,
        };
        for word in [metric, strategy, error_bound, blocking, first_parameter, second_parameter] {
            bytes.extend(word.to_le_bytes());
        }
        for word in [self.roots_offset, self.pages_offset, self.file_length] {
            bytes.extend(word.to_le_bytes());
        }
        bytes.extend(self.input_error.to_le_bytes());
        let positions = match self.positions {
            Positions::Lossless => 0,
            Positions::Bits(bits) => u32::from(bits),
        };
        bytes.extend(self.exponent.to_le_bytes());
        bytes.extend(positions.to_le_bytes());
        bytes.extend(self.lattice_step.to_le_bytes());
        bytes.extend(self.way_count.to_le_bytes());
        bytes.extend(self.table_bytes.to_le_bytes());
        bytes.extend(self.appearance_bytes.to_le_bytes());
        bytes.extend(self.image_bytes.to_le_bytes());
        let mut whole = [0; HEADER_BYTES];
        whole[..bytes.len()].copy_from_slice(&bytes);
        let checksum = crc32fast::hash(&whole[..HEADER_BYTES - 4]);
        whole[HEADER_BYTES - 4..].copy_from_slice(&checksum.to_le_bytes());
        whole
    }

    /// Takes the header of the file `path` apart. `bytes` may be shorter than a header where the file is.
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, ModelError> {
        let damaged = |problem: String| ModelError::Damaged { path: path.into(), part: "header".into(), problem };
        if bytes.get(..8) != Some(&MAGIC) {
            return Err(ModelError::NotAModel { path: path.into() });
        }
        let Some(bytes) = bytes.first_chunk::<HEADER_BYTES>() else {
            return Err(damaged(format!("it has {} of {HEADER_BYTES} bytes", bytes.len())));
        };
        let word = |offset: usize| {
            u32::from_le_bytes([bytes[offset], bytes[offset + 1], bytes[offset + 2], bytes[offset + 3]])
        };
        let long = |offset: usize| u64::from(word(offset)) | u64::from(word(offset + 4)) << 32;
        let float = |offset: usize| f32::from_bits(word(offset));
        if word(8) != VERSION {
            return Err(ModelError::Version { path: path.into(), found: word(8) });
        }
        if crc32fast::hash(&bytes[..HEADER_BYTES - 4]) != word(HEADER_BYTES - 4) {
            return Err(damaged("the checksum does not match".into()));
        }
        let unknown = word(12) & !ATTRIBUTES;
        if unknown != 0 {
            return Err(ModelError::Features { path: path.into(), flags: unknown });
        }
        let header = Header {
            leaf_count: word(20),
            triangle_count: word(24),
            split_count: word(28),
            root_count: word(32),
            page_count: word(36),
            root_page_count: word(40),
            slot_bytes: word(44),
            largest_page_bytes: word(48),
            page_levels: word(52),
            origin: [56, 64, 72].map(|offset| f64::from_bits(long(offset))),
            minimum: [80, 84, 88].map(float),
            maximum: [92, 96, 100].map(float),
            largest_switch: float(104),
            metric: match word(108) {
                0 => Metric::Quadric,
                1 => Metric::Length,
                other => return Err(damaged(format!("metric {other}"))),
            },
            strategy: match word(112) {
                0 => Strategy::Passes,
                1 => Strategy::Btree,
                other => return Err(damaged(format!("strategy {other}"))),
            },
            error_bound: match word(116) {
                0 => ErrorBound::None,
                1 => ErrorBound::Fast,
                2 => ErrorBound::Default,
                3 => ErrorBound::Tight,
                4 => ErrorBound::TwoSided,
                other => return Err(damaged(format!("error bound {other}"))),
            },
            blocking: match word(120) {
                0 => Blocking::Forest { slot_bytes: word(124), fan_out: word(128) },
                1 => Blocking::Levels { levels: word(124) },
                other => return Err(damaged(format!("blocking {other}"))),
            },
            roots_offset: long(132),
            pages_offset: long(140),
            file_length: long(148),
            input_error: float(156),
            exponent: word(160).cast_signed(),
            positions: match (word(164), u8::try_from(word(164)).map(Positions::Bits)) {
                (0, _) => Positions::Lossless,
                (_, Ok(bits)) if bits.is_valid() => bits,
                (other, _) => return Err(damaged(format!("positions of {other} bits"))),
            },
            lattice_step: float(168),
            way_count: word(172),
            table_bytes: word(176),
            appearance_bytes: word(180),
            image_bytes: long(184),
        };
        header.check().map_err(damaged)?;
        // Everything that this version does not use is zero.
        if header.to_bytes() != *bytes {
            return Err(damaged("a field that must be 0 (or, at byte 16, 256) is not, or a flag is wrong".into()));
        }
        Ok(header)
    }

    /// Where the root tables end, with their checksum.
    pub(crate) fn after_root_tables(&self) -> u64 {
        let words = u64::from(self.root_count) * ROOT_WORDS as u64
            + u64::from(self.root_page_count) * ROOT_PAGE_WORDS as u64
            + u64::from(self.way_count) * WAY_WORDS as u64;
        self.roots_offset + 4 * words + 4
    }

    /// Where the tables of the coder end, with their checksum: the offset of the appearance.
    pub(crate) fn after_tables(&self) -> u64 {
        self.after_root_tables() + u64::from(self.table_bytes) + 4
    }

    /// Where the images end: the offset of the first page. Without end where that is beyond all files.
    pub(crate) fn after_images(&self) -> u64 {
        (self.after_tables() + u64::from(self.appearance_bytes)).saturating_add(self.image_bytes)
    }

    /// What must hold between the fields, whatever the model.
    fn check(&self) -> Result<(), String> {
        let finite = self.origin.iter().all(|value| value.is_finite())
            && self.minimum.iter().chain(&self.maximum).all(|value| value.is_finite())
            && self.largest_switch.is_finite();
        if !finite {
            Err("a coordinate is not finite".into())
        } else if !(self.input_error >= 0.0 && self.input_error.is_finite()) {
            Err(format!("the input error is given as {}", self.input_error))
        } else if !EXPONENTS.contains(&self.exponent) {
            Err(format!("a mesh 2^{} wide cannot be", self.exponent))
        } else if !has_lattice(self.positions, self.lattice_step) {
            Err(format!("positions {}, in steps of {}", self.positions, self.lattice_step))
        } else if self.roots_offset != HEADER_BYTES as u64 || self.pages_offset != self.after_images() {
            Err(format!("sections at bytes {} and {}", self.roots_offset, self.pages_offset))
        } else if self.image_bytes > 0 && self.appearance_bytes == 0 {
            Err(format!("{} bytes of images, and nothing that refers to them", self.image_bytes))
        } else if self.pages_offset > self.file_length {
            Err(format!("the file length is given as {}", self.file_length))
        } else if u64::from(self.root_count) + u64::from(self.split_count) != u64::from(self.leaf_count) {
            Err(format!(
                "{} leaves, {} splits and {} roots cannot be",
                self.leaf_count, self.split_count, self.root_count
            ))
        } else if u64::from(self.root_page_count) + u64::from(self.way_count) > self.page_count.into()
            || self.page_levels > self.page_count
            || self.page_count > self.split_count
            || [self.root_page_count, self.page_levels, self.page_count].contains(&0) != (self.split_count == 0)
        {
            Err(format!(
                "{} pages, {} of them roots and {} on the way to trees, on {} levels, for {} splits",
                self.page_count, self.root_page_count, self.way_count, self.page_levels, self.split_count
            ))
        } else if u64::from(self.largest_page_bytes) > self.file_length
            || self.slot_bytes > LARGEST_SLOT_BYTES
            || (self.largest_page_bytes == 0) != (self.page_count == 0)
        {
            Err(format!("pages of {} bytes, {} decoded", self.largest_page_bytes, self.slot_bytes))
        } else {
            Ok(())
        }
    }
}

/// Whether positions kept like this can have a lattice with this step, or with 0 none.
pub(crate) fn has_lattice(positions: Positions, step: f32) -> bool {
    positions.is_valid() && (step > 0.0 && step.is_normal() || step == 0.0 && positions == Positions::Lossless)
}

/// A root of the forest, as the file's root table has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModelRoot {
    /// First leaf under the root.
    pub start: u32,
    /// One past the last leaf.
    pub end: u32,
    /// Where the root stands, in mesh units relative to the origin.
    pub position: [f32; 3],
    /// The normal of its first leaf.
    pub normal: Normal,
    /// Whether the tree's surface faces the other way than its triangles' orientation says.
    pub is_inward: bool,
    /// Its dependency id.
    pub id: u32,
    /// Its switch value, in mesh units.
    pub switch: f32,
    /// Radius of its bounding sphere.
    pub radius: f32,
    /// Its normal cone.
    pub cone: NormalCone,
    /// Index of its record in its page.
    pub record: u16,
    /// The page that its split is in.
    pub page: PageLocation,
}

impl ModelRoot {
    /// The words of the root in the root table.
    pub fn to_words(&self) -> [u32; ROOT_WORDS] {
        let [x, y, z] = self.position.map(f32::to_bits);
        let PageLocation { number, offset, length } = self.page;
        [
            self.start,
            self.end,
            x,
            y,
            z,
            self.id,
            self.switch.to_bits(),
            self.radius.to_bits(),
            self.cone.to_word(),
            self.record.into(),
            number,
            offset as u32,
            (offset >> 32) as u32,
            length,
            self.normal.to_word() | u32::from(self.is_inward) << 31,
        ]
    }

    /// The inverse of [`ModelRoot::to_words`]; `None` where a field cannot be.
    pub fn from_words(words: &[u32; ROOT_WORDS]) -> Option<Self> {
        let root = ModelRoot {
            start: words[0],
            end: words[1],
            position: [words[2], words[3], words[4]].map(f32::from_bits),
            normal: Normal::from_word(words[14] & ((1 << 31) - 1)),
            is_inward: words[14] >> 31 == 1,
            id: words[5],
            switch: f32::from_bits(words[6]),
            radius: f32::from_bits(words[7]),
            cone: NormalCone::from_word(words[8]),
            record: u16::try_from(words[9]).ok()?,
            page: PageLocation {
                number: words[10],
                offset: u64::from(words[11]) | u64::from(words[12]) << 32,
                length: words[13],
            },
        };
        // A root splits, so there are at least two leaves under it.
        let sound = root.normal.is_valid()
            && root.end.saturating_sub(root.start) >= 2
            && root.position.iter().all(|value| value.is_finite())
            && root.switch > 0.0
            && root.switch.is_finite()
            && root.radius >= 0.0
            && root.radius.is_finite();
        sound.then_some(root)
    }
}

/// A page with a parent in which a tree begins, or that is on the way to such a page, as the file's way table has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Way {
    /// The page.
    pub page: PageLocation,
    /// Number of its parent: a root page, or one of the table.
    pub parent: u32,
}

impl Way {
    /// The words of the page in the way table.
    pub fn to_words(&self) -> [u32; WAY_WORDS] {
        let PageLocation { number, offset, length } = self.page;
        [number, self.parent, offset as u32, (offset >> 32) as u32, length]
    }

    /// The inverse of [`Way::to_words`].
    pub fn from_words(words: &[u32; WAY_WORDS]) -> Self {
        let offset = u64::from(words[2]) | u64::from(words[3]) << 32;
        Way { page: PageLocation { number: words[0], offset, length: words[4] }, parent: words[1] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some_header() -> Header {
        Header {
            leaf_count: 100,
            triangle_count: 190,
            split_count: 98,
            root_count: 2,
            page_count: 3,
            root_page_count: 1,
            way_count: 2,
            slot_bytes: 4096,
            largest_page_bytes: 4100,
            page_levels: 2,
            origin: [1e6, -2.5, 0.0],
            minimum: [-1.0, -2.0, -3.0],
            maximum: [1.0, 2.0, 3.0],
            largest_switch: 4.0,
            metric: Metric::Length,
            strategy: Strategy::Btree,
            error_bound: ErrorBound::Fast,
            input_error: 0.25,
            exponent: -3,
            positions: Positions::Bits(14),
            lattice_step: 0.125,
            table_bytes: 100,
            appearance_bytes: 60,
            image_bytes: 7,
            blocking: Blocking::Forest { slot_bytes: 4096, fan_out: 4 },
            roots_offset: 256,
            pages_offset: 256 + 2 * 60 + 16 + 2 * 20 + 4 + 100 + 4 + 60 + 7,
            file_length: 10_000,
        }
    }

    fn refused(header: &Header) -> String {
        Header::from_bytes(Path::new("m.vdt"), &header.to_bytes()).unwrap_err().to_string()
    }

    /// The bytes of some header with the word at `offset` replaced, and the checksum put right.
    fn with_word(offset: usize, word: u32) -> [u8; HEADER_BYTES] {
        let mut bytes = some_header().to_bytes();
        bytes[offset..offset + 4].copy_from_slice(&word.to_le_bytes());
        let checksum = crc32fast::hash(&bytes[..252]);
        bytes[252..].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    #[test]
    fn a_header_comes_back_as_it_was() {
        let header = some_header();
        assert_eq!(Header::from_bytes(Path::new("m.vdt"), &header.to_bytes()).unwrap(), header);
        let header = Header { blocking: Blocking::Levels { levels: 6 }, metric: Metric::Quadric, ..header };
        assert_eq!(Header::from_bytes(Path::new("m.vdt"), &header.to_bytes()).unwrap(), header);
        for (positions, lattice_step) in
            [(Positions::Lossless, 0.0), (Positions::Lossless, 30.0), (Positions::Bits(10), 1e-30)]
        {
            let header = Header { positions, lattice_step, ..header };
            assert_eq!(Header::from_bytes(Path::new("m.vdt"), &header.to_bytes()).unwrap(), header);
        }
        for error_bound in ErrorBound::ALL {
            let header = Header { error_bound, ..header };
            assert_eq!(Header::from_bytes(Path::new("m.vdt"), &header.to_bytes()).unwrap(), header);
        }
        assert!((some_header().diagonal() - 56_f64.sqrt()).abs() < 1e-12);
    }

    #[test]
    fn other_files_versions_and_features_are_told_apart() {
        let message = |bytes: &[u8]| Header::from_bytes(Path::new("m.vdt"), bytes).unwrap_err().to_string();
        assert!(message(b"ply\nformat ascii 1.0").contains("not a vdt model"));
        assert!(message(b"VDTMOD").contains("not a vdt model"));
        assert!(message(&some_header().to_bytes()[..100]).contains("100 of 256 bytes"));
        assert!(message(&with_word(8, 2)).contains("format version 2, this program reads version 3"));
        assert!(message(&with_word(12, 4)).contains("flags 0x4"));
        for (offset, word) in [(16, 260), (12, 0), (192, 1), (248, 7)] {
            assert!(message(&with_word(offset, word)).contains("must be 0"), "{offset}");
        }
        let named = [(108, "metric 9"), (112, "strategy 9"), (116, "error bound 9"), (120, "blocking 9")];
        for (offset, what) in named.into_iter().chain([(164, "positions of 9 bits")]) {
            assert!(message(&with_word(offset, 9)).contains(what));
        }
    }

    #[test]
    fn a_root_comes_back_as_it_was() {
        let page = PageLocation { number: 7, offset: 5 << 32, length: 900 };
        let mut root = ModelRoot {
            start: 3,
            end: 9,
            position: [1.0, -2.0, 3.5],
            normal: Normal::encode([1.0, 2.0, -3.0]),
            is_inward: false,
            id: 77 << 16 | 4,
            switch: 0.5,
            radius: 2.0,
            cone: NormalCone { axis: [1, -2, 127], sine: 9 },
            record: 5,
            page,
        };
        for is_inward in [false, true] {
            root.is_inward = is_inward;
            assert_eq!(ModelRoot::from_words(&root.to_words()), Some(root));
        }
        let refused = |word: usize, value: u32| {
            let mut words = root.to_words();
            words[word] = value;
            assert_eq!(ModelRoot::from_words(&words), None, "{word}: {value:#x}");
        };
        (20..31).for_each(|bit| refused(14, root.normal.to_word() | 1 << bit));
        refused(0, 8);
        refused(1, 2);
        refused(9, 1 << 16);
        [2, 3, 4, 6, 7].into_iter().for_each(|word| refused(word, f32::NAN.to_bits()));
        refused(6, 0);
        refused(7, (-1.0_f32).to_bits());
    }

    #[test]
    fn fields_that_contradict_each_other_are_refused() {
        let header = some_header();
        assert!(refused(&Header { split_count: 97, ..header }).contains("cannot be"));
        assert!(refused(&Header { page_count: 99, ..header }).contains("99 pages"));
        assert!(refused(&Header { page_count: 2, ..header }).contains("1 of them roots and 2 on the way"));
        assert!(refused(&Header { way_count: 1, ..header }).contains("sections"));
        assert!(refused(&Header { page_levels: 0, ..header }).contains("on 0 levels"));
        assert!(refused(&Header { table_bytes: 96, ..header }).contains("sections"));
        for largest_page_bytes in [0, 10_001] {
            let message = refused(&Header { largest_page_bytes, ..header });
            assert!(message.contains(&format!("pages of {largest_page_bytes} bytes")), "{message}");
        }
        assert!(refused(&Header { file_length: 506, ..header }).contains("file length"));
        assert!(refused(&Header { pages_offset: 400, ..header }).contains("sections"));
        assert!(refused(&Header { maximum: [f32::NAN; 3], ..header }).contains("not finite"));
        assert!(refused(&Header { slot_bytes: u32::MAX, ..header }).contains("decoded"));
        for exponent in [-150, 130, i32::MIN] {
            assert!(refused(&Header { exponent, ..header }).contains("cannot be"));
        }
        for lattice_step in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-40] {
            assert!(refused(&Header { lattice_step, ..header }).contains("in steps of"));
        }
        for input_error in [-1.0, f32::NAN, f32::INFINITY] {
            assert!(refused(&Header { input_error, ..header }).contains("input error"));
        }
    }
}
