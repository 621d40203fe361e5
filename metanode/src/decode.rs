//! All pages of a model, decoded one after the other, by several threads: what decoding costs.
//!
//! A page needs its ancestors, so the page tree is gone through depth-first. The subtrees below the root pages are shared out;
//! each thread decodes the root pages above those that it gets once more for itself.
//!
//! RAM: for each thread a page for each level, and what a reader takes. I/O: each page once, root pages for each thread.

use std::time::Duration;

use storage::usage::thread_cpu_time;
use vdt::workers;

use crate::chain::PageChain;
use crate::header::ModelError;
use crate::model::Model;
use crate::page::{Page, PageLocation};

/// What decoding all pages came to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Decoded {
    /// Pages that were decoded, root pages perhaps several times.
    pub pages: u64,
    /// Their records, that is splits.
    pub records: u64,
    /// Their bytes in the file.
    pub bytes: u64,
    /// CPU time of all threads, with reading.
    pub cpu: Duration,
}

impl Decoded {
    fn add(&mut self, page: &Page, location: PageLocation) {
        self.pages += 1;
        self.records += page.counts().records as u64;
        self.bytes += u64::from(location.length);
    }
}

/// Decodes all pages of a model with so many threads.
///
/// # Errors
///
/// The first page that cannot be read or decoded.
pub fn decode_all(model: &Model, threads: usize) -> Result<Decoded, ModelError> {
    let mut jobs = Vec::new();
    let mut chain = PageChain::new(model);
    for root in model.root_pages() {
        let page = chain.page(*root, None)?;
        jobs.push((*root, None));
        jobs.extend(page.children().map(|child| (*root, Some(child))));
    }
    drop(chain);
    let mut chains: Vec<PageChain<'_>> = (0..threads.max(1)).map(|_| PageChain::new(model)).collect();
    let parts = workers::for_each(&mut chains, jobs.len(), |chain, job| {
        let before = thread_cpu_time();
        let mut decoded = Decoded::default();
        let (root, child) = jobs[job];
        let page = chain.page(root, None)?;
        match child {
            None => decoded.add(page, root),
            Some(child) => {
                let mut waiting = vec![(child, root.number)];
                while let Some((location, parent)) = waiting.pop() {
                    let page = chain.page(location, Some(parent))?;
                    decoded.add(page, location);
                    let first = waiting.len();
                    waiting.extend(page.children().map(|child| (child, location.number)));
                    waiting[first..].reverse();
                }
            }
        }
        decoded.cpu = thread_cpu_time().saturating_sub(before);
        Ok::<_, ModelError>(decoded)
    })?;
    Ok(parts.iter().fold(Decoded::default(), |all, part| Decoded {
        pages: all.pages + part.pages,
        records: all.records + part.records,
        bytes: all.bytes + part.bytes,
        cpu: all.cpu + part.cpu,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::header::Blocking;
    use crate::testing::{Shape, TreePlan, model, random_tree};

    #[test]
    fn every_page_is_decoded_once() {
        let plan = TreePlan {
            seed: 3,
            leaves: 4000,
            components: 50,
            triangles: 6000,
            shape: Shape::Random,
            hub: 0,
            reach: 60,
        };
        let tree = random_tree(&plan);
        for blocking in [Blocking::Forest { slot_bytes: 4096, fan_out: 3 }, Blocking::Levels { levels: 3 }] {
            let model = model(&tree, blocking);
            for threads in [1, 3] {
                let decoded = decode_all(&model, threads).unwrap();
                let header = model.header();
                assert_eq!(decoded.pages, u64::from(header.page_count));
                assert_eq!(decoded.records, u64::from(header.split_count));
                assert_eq!(decoded.bytes, header.file_length - header.pages_offset);
            }
        }
    }
}
