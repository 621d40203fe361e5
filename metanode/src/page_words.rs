//! The words of a decoded page: in a buffer of its own, which is decoded into; or where they lie in a mapped file, which is
//! only looked at.

use std::ops::{Deref, Range};
use std::sync::Arc;

use storage::MappedFile;

/// The words of a page.
#[derive(Debug, Clone, Default)]
pub struct PageWords {
    own: Vec<u32>,
    mapped: Option<MappedWords>,
}

/// Words in a file, in the machine's own byte order.
#[derive(Debug, Clone)]
struct MappedWords {
    file: Arc<MappedFile>,
    /// Where they lie in it, in bytes.
    bytes: Range<usize>,
}

impl PageWords {
    /// Words in a buffer of its own.
    pub fn own(own: Vec<u32>) -> Self {
        PageWords { own, mapped: None }
    }

    /// These bytes of a file; `None` where it has none there, or they are no words.
    pub fn mapped(file: &Arc<MappedFile>, bytes: Range<usize>) -> Option<Self> {
        bytemuck::try_cast_slice::<u8, u32>(file.bytes().get(bytes.clone())?).ok()?;
        Some(PageWords { own: Vec::new(), mapped: Some(MappedWords { file: file.clone(), bytes }) })
    }

    /// Room for words to be pushed from the first one on, in the buffer of its own.
    pub fn begin(&mut self) -> &mut Vec<u32> {
        self.mapped = None;
        self.own.clear();
        &mut self.own
    }
}

impl Deref for PageWords {
    type Target = [u32];

    #[inline]
    fn deref(&self) -> &[u32] {
        match &self.mapped {
            None => &self.own,
            Some(MappedWords { file, bytes }) => bytemuck::cast_slice(&file.bytes()[bytes.clone()]),
        }
    }
}
