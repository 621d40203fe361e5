//! The fixed parts of a model file: header, root table, root page table. All little endian.
//!
//! ```text
//! offset  bytes  header (256 bytes)
//!      0      8  magic "VDTMODEL"
//!      8      4  version of the format: 2
//!     12      4  feature flags: 0; a reader refuses flags that it does not know
//!     16      4  bytes of this header: 256
//!     20      4  leaves (vertices)
//!     24      4  triangles
//!     28      4  splits (inner nodes)
//!     32      4  roots (trees, that is components)
//!     36      4  meta-nodes (pages)
//!     40      4  root pages: meta-nodes without a parent
//!     44      4  bytes of the largest page, decoded: what a place holder must hold
//!     48      4  bytes of the largest page, encoded: in this version 4 more (0 without pages)
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
//!    160     92  zero
//!    252      4  CRC-32 of the 252 bytes before
//!
//!    256   60 r  root table, by ascending first leaf: first leaf, end leaf, x, y, z (f32), id, switch (f32),
//!                radius (f32), cone, record, page number, page offset (low, high), page length, zero
//!         16 p   root page table: page number, offset (low, high), length
//!          4     CRC-32 of both tables
//!                the pages, in the order of their numbers, without gaps
//! ```

use std::path::{Path, PathBuf};

use storage::StorageError;
use thiserror::Error;
use vdt::tree::NormalCone;
pub use vdt::tree::{ErrorBound, Metric, Strategy};

use crate::page::{PageError, PageLocation};

/// The first eight bytes of every model file.
pub const MAGIC: [u8; 8] = *b"VDTMODEL";
/// The version of the format that this library writes, and the only one that it reads.
pub const VERSION: u32 = 2;
/// Bytes of the header.
pub const HEADER_BYTES: usize = 256;
/// Words of one root.
pub const ROOT_WORDS: usize = 15;
/// The largest page that may be, decoded, in bytes.
pub const LARGEST_SLOT_BYTES: u32 = 1 << 30;
/// Words of one root page.
pub const ROOT_PAGE_WORDS: usize = 4;

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
    /// single precision, and leaving out triangles without area, may have moved.
    pub input_error: f32,
    /// The blocking.
    pub blocking: Blocking,
    /// Byte offset of the root table.
    pub roots_offset: u64,
    /// Byte offset of the first page.
    pub pages_offset: u64,
    /// Length of the file in bytes.
    pub file_length: u64,
}

impl Default for Blocking {
    /// Forest pages of 32 KiB with up to 8 child pages.
    fn default() -> Self {
        Blocking::Forest { slot_bytes: 32 * 1024, fan_out: 8 }
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
        words(&[VERSION, 0, HEADER_BYTES as u32, self.leaf_count, self.triangle_count, self.split_count]);
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
        if word(12) != 0 {
            return Err(ModelError::Features { path: path.into(), flags: word(12) });
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
        };
        header.check().map_err(damaged)?;
        // Everything that version 2 does not use is zero.
        if header.to_bytes() != *bytes {
            return Err(damaged("a field that must be 0 (or, at byte 16, 256) is not".into()));
        }
        Ok(header)
    }

    /// What must hold between the fields, whatever the model.
    fn check(&self) -> Result<(), String> {
        let finite = self.origin.iter().all(|value| value.is_finite())
            && self.minimum.iter().chain(&self.maximum).all(|value| value.is_finite())
            && self.largest_switch.is_finite();
        let tables = u64::from(self.root_count) * (ROOT_WORDS * 4) as u64
            + u64::from(self.root_page_count) * (ROOT_PAGE_WORDS * 4) as u64
            + 4;
        if !finite {
            Err("a coordinate is not finite".into())
        } else if !(self.input_error >= 0.0 && self.input_error.is_finite()) {
            Err(format!("the input error is given as {}", self.input_error))
        } else if self.roots_offset != HEADER_BYTES as u64 || self.pages_offset != self.roots_offset + tables {
            Err(format!("sections at bytes {} and {}", self.roots_offset, self.pages_offset))
        } else if self.pages_offset > self.file_length {
            Err(format!("the file length is given as {}", self.file_length))
        } else if u64::from(self.root_count) + u64::from(self.split_count) != u64::from(self.leaf_count) {
            Err(format!(
                "{} leaves, {} splits and {} roots cannot be",
                self.leaf_count, self.split_count, self.root_count
            ))
        } else if self.root_page_count > self.page_count
            || self.page_levels > self.page_count
            || self.page_count > self.split_count
            || [self.root_page_count, self.page_levels, self.page_count].contains(&0) != (self.split_count == 0)
        {
            Err(format!(
                "{} pages, {} of them roots, on {} levels, for {} splits",
                self.page_count, self.root_page_count, self.page_levels, self.split_count
            ))
        } else if u64::from(self.largest_page_bytes) > self.file_length
            || self.slot_bytes > LARGEST_SLOT_BYTES
            || self.largest_page_bytes != if self.page_count == 0 { 0 } else { self.slot_bytes + 4 }
        {
            Err(format!("pages of {} bytes, {} decoded", self.largest_page_bytes, self.slot_bytes))
        } else {
            Ok(())
        }
    }
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
            0,
        ]
    }

    /// The inverse of [`ModelRoot::to_words`]; `None` where a field cannot be.
    pub fn from_words(words: &[u32; ROOT_WORDS]) -> Option<Self> {
        let root = ModelRoot {
            start: words[0],
            end: words[1],
            position: [words[2], words[3], words[4]].map(f32::from_bits),
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
        let sound = words[14] == 0
            && root.end.saturating_sub(root.start) >= 2
            && root.position.iter().all(|value| value.is_finite())
            && root.switch > 0.0
            && root.switch.is_finite()
            && root.radius >= 0.0
            && root.radius.is_finite();
        sound.then_some(root)
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
            blocking: Blocking::Forest { slot_bytes: 4096, fan_out: 4 },
            roots_offset: 256,
            pages_offset: 256 + 2 * 60 + 16 + 4,
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
        assert!(message(&with_word(8, 1)).contains("format version 1, this program reads version 2"));
        assert!(message(&with_word(12, 4)).contains("flags 0x4"));
        for (offset, word) in [(16, 260), (160, 1), (248, 7)] {
            assert!(message(&with_word(offset, word)).contains("must be 0"), "{offset}");
        }
        for (offset, what) in [(108, "metric 9"), (112, "strategy 9"), (116, "error bound 9"), (120, "blocking 9")] {
            assert!(message(&with_word(offset, 9)).contains(what));
        }
    }

    #[test]
    fn fields_that_contradict_each_other_are_refused() {
        let header = some_header();
        assert!(refused(&Header { split_count: 97, ..header }).contains("cannot be"));
        assert!(refused(&Header { page_count: 99, ..header }).contains("99 pages"));
        assert!(refused(&Header { page_levels: 0, ..header }).contains("on 0 levels"));
        assert!(refused(&Header { largest_page_bytes: 4096, ..header }).contains("pages of 4096 bytes"));
        assert!(refused(&Header { file_length: 300, ..header }).contains("file length"));
        assert!(refused(&Header { pages_offset: 400, ..header }).contains("sections"));
        assert!(refused(&Header { maximum: [f32::NAN; 3], ..header }).contains("not finite"));
        assert!(refused(&Header { slot_bytes: u32::MAX, ..header }).contains("decoded"));
        for input_error in [-1.0, f32::NAN, f32::INFINITY] {
            assert!(refused(&Header { input_error, ..header }).contains("input error"));
        }
    }
}
