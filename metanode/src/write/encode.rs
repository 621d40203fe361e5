//! The second way through the page tree: the fields of every page are coded, and wait in the scratch for their place.
//!
//! A page says where its child pages lie and how long they are, so nothing can be put in its place before all are coded.
//!
//! Memory: the caches, one page, buffers. I/O: what is coded is written once, a tenth of the tree; 32 bytes for each page are
//! sorted.

use std::borrow::Cow;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex, PoisonError};

use bytemuck::{Pod, Zeroable};
use storage::{SortRecord, Sorted, Sorter, Spool, SpoolWriter};

use super::WriteError;
use super::count::Counted;
use super::descent::{self, Visitor};
use super::gather::{Ancestor, Bounds, Gathered, Gatherer, Position, Work};
use crate::blocking::{BlockingError, Filled, Filler};
use crate::codec::{Encoder, Tables};
use crate::leaf_order::{Nodes, Subtree};

/// A page whose fields are coded. Ordered as pages lie in the file: breadth-first. 40 bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Pod, Zeroable)]
#[repr(C)]
pub(super) struct CodedPage {
    pub level: u32,
    pub first_leaf: u32,
    /// Where the coded fields are, in the store of a thread.
    pub offset: u64,
    pub length: u32,
    pub thread: u32,
    pub triangles: u32,
    /// How many entries lead into it.
    pub entries: u16,
    pub records: u16,
    pub roots: u16,
    pub children: u16,
    /// Wedges beyond one for each record.
    pub more_wedges: u16,
    zero: u16,
}

impl SortRecord for CodedPage {
    fn prefix(&self) -> u64 {
        u64::from(self.level) << 32 | u64::from(self.first_leaf)
    }
}

/// All pages, coded.
pub(super) struct Coded {
    pub pages: Sorted<CodedPage>,
    /// What each thread has coded.
    pub fields: Vec<Spool<u8>>,
    pub bounds: Bounds,
}

/// Codes the fields of pages.
struct PageEncoder<'a> {
    counted: &'a Counted,
    gatherer: Gatherer<'a>,
    encoder: Encoder<'a>,
    thread: u32,
    fields: SpoolWriter<u8>,
    bytes: Vec<u8>,
    waiting: &'a Mutex<Sorter<CodedPage>>,
    splits: u64,
}

impl<'a> Visitor<'a> for PageEncoder<'a> {
    fn nodes(&mut self) -> &mut Nodes<'a> {
        &mut self.gatherer.nodes
    }

    fn splits(&self) -> u64 {
        self.splits
    }

    fn fill(&mut self, filler: Filler, level: u32, subtrees: Vec<Subtree>) -> Result<Filled, BlockingError> {
        match self.counted.large.get(&(level, subtrees[0].start)) {
            Some(page) => Ok(page.clone()),
            None => filler.fill(&mut self.gatherer.nodes, subtrees),
        }
    }

    fn page(
        &mut self,
        position: &Position,
        page: &Filled,
        children: &[Cow<'_, [Subtree]>],
    ) -> Result<Option<Arc<Ancestor>>, WriteError> {
        let Gathered { triangles, more_wedges, ancestor } =
            self.gatherer.code(position, page, children, &mut self.encoder)?;
        self.bytes.clear();
        self.encoder.finish(&mut self.bytes);
        let coded = CodedPage {
            level: position.level,
            first_leaf: page.records[0].start,
            offset: self.fields.len(),
            length: self.bytes.len() as u32,
            thread: self.thread,
            triangles,
            entries: page.records[..page.root_count].iter().filter(|root| !root.is_tree).count() as u16,
            records: page.records.len() as u16,
            roots: page.root_count as u16,
            children: children.len() as u16,
            more_wedges,
            zero: 0,
        };
        self.fields.extend(&self.bytes)?;
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner).push(coded)?;
        self.splits += page.records.len() as u64;
        Ok(ancestor)
    }
}

/// Codes all pages of a tree. `progress` is told how many splits more are coded.
pub(super) fn encode(
    work: &Work<'_>,
    counted: &Counted,
    tables: &Tables,
    root_groups: Vec<Vec<Subtree>>,
    progress: &(impl Fn(u64) + Sync),
) -> Result<Coded, WriteError> {
    let Work { filler, resources, .. } = *work;
    let next_number = AtomicU32::new(root_groups.len() as u32);
    let waiting = Mutex::new(Sorter::new(&resources.scratch, "coded-pages", resources.share(1), 1));
    let mut encoders: Vec<PageEncoder<'_>> = (0..resources.threads.max(1) as u32)
        .map(|thread| PageEncoder {
            counted,
            gatherer: Gatherer::new(work, &next_number),
            encoder: Encoder::new(tables),
            thread,
            fields: SpoolWriter::new(&resources.scratch, "coded-fields", resources.thread_share(1)),
            bytes: Vec::new(),
            waiting: &waiting,
            splits: 0,
        })
        .collect();
    let jobs = descent::first_levels(&mut encoders[0], filler, root_groups)?;
    descent::do_jobs(&mut encoders, filler, jobs, progress, |_, _| (), |_| ())?;
    let (mut fields, mut bounds) = (Vec::with_capacity(encoders.len()), Bounds::NONE);
    for encoder in encoders {
        bounds.add(&encoder.gatherer.bounds);
        fields.push(encoder.fields.finish()?);
    }
    let pages = waiting.into_inner().unwrap_or_else(PoisonError::into_inner).finish()?;
    Ok(Coded { pages, fields, bounds })
}
