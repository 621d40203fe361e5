//! The ways to the trees that begin in no root page: a page is decoded with its ancestors at hand, and nothing but this
//! table leads to those of such a tree's page.
//!
//! Pages are numbered breadth-first, so the children of the pages of a level, one page after the other, are the pages of
//! the next level. Level by level from the bottom, one look at the number of children of each page finds the parents.
//!
//! Memory: 24 bytes for each page on such a way. I/O: the sizes of the pages are read twice, where there is such a tree.

use storage::{Spool, StorageError};

use super::encode::CodedPage;
use super::place::Places;
use crate::header::Way;
use crate::page::PageLocation;

/// Bytes of a reader's buffer.
const BUFFER: usize = 8 << 10;

/// The pages, but for root pages, on the way down to the pages in which trees begin, those included, by ascending number.
/// Offsets are counted from the first page.
pub(super) fn ways(places: &Places) -> Result<Vec<Way>, StorageError> {
    let first = places.root_pages.len() as u32;
    let mut wanted: Vec<u32> =
        places.roots.iter().map(|(page, _)| page.number).filter(|number| *number >= first).collect();
    wanted.sort_unstable();
    wanted.dedup();
    let mut ways: Vec<Way> = Vec::new();
    let mut below: Vec<u32> = Vec::new();
    let starts = &places.levels_start;
    for level in (1..starts.len()).rev() {
        let (first, parents) = (starts[level], starts[level - 1]..starts[level]);
        // Of this level: where trees begin, and what leads to the level below.
        below.extend(wanted.drain(wanted.partition_point(|number| *number < first)..));
        below.sort_unstable();
        below.dedup();
        let mut children = std::mem::take(&mut below).into_iter().peekable();
        let mut end = first;
        let mut reader = places.pages.reader_of(parents.start.into(), parents.end.into(), BUFFER);
        for parent in parents {
            if children.peek().is_none() {
                break;
            }
            let Some(page) = reader.next()? else { break };
            end += u32::from(page.children);
            while let Some(number) = children.next_if(|number| *number < end) {
                let page = PageLocation { number, offset: 0, length: 0 };
                ways.push(Way { page, parent });
                if level > 1 && below.last() != Some(&parent) {
                    below.push(parent);
                }
            }
        }
    }
    ways.sort_unstable_by_key(|way| way.page.number);
    locate(&places.pages, &mut ways)?;
    Ok(ways)
}

/// Finds out where the pages lie.
fn locate(pages: &Spool<CodedPage>, ways: &mut [Way]) -> Result<(), StorageError> {
    let end = ways.last().map_or(0, |way| way.page.number + 1);
    let mut reader = pages.reader_of(0, end.into(), BUFFER);
    let (mut number, mut offset) = (0, 0);
    let mut ways = ways.iter_mut().peekable();
    while let Some(page) = reader.next()? {
        let length = page.bytes();
        if let Some(way) = ways.next_if(|way| way.page.number == number) {
            way.page = PageLocation { number, offset, length };
        }
        number += 1;
        offset += u64::from(length);
    }
    Ok(())
}
