//! The paper's blocking (3.2): each page holds a subtree of L levels of one tree.
//!
//! Every tree begins a page, and so does every child of the L-th level of a page. On real trees such pages fill badly:
//! with L = 5 two of five hold a single split, and the largest is nearly ten times the mean. It is here to be compared
//! with.
//!
//! Linear time. Memory: 4 bytes for each leaf and 36 for each page; while it runs, 4 more for each leaf.

use vdt::tree::Tree;

use super::{Blocks, outline, root_page};
use crate::blocking::BlockingError;

/// Blocks `tree` into pages of `levels` levels.
pub fn block(tree: &Tree, levels: u32) -> Result<Blocks, BlockingError> {
    let split_count = outline::preorder(tree)?.len();
    let mut blocks = Blocks { order: Vec::with_capacity(split_count), ..Blocks::default() };
    // The roots of the pages, in the order of the pages.
    let mut page_roots: Vec<u32> = tree.roots.iter().map(|root| root.split).collect();
    blocks.pages.resize(page_roots.len(), root_page());
    blocks.root_pages = page_roots.len() as u32;
    let mut number = 0;
    while let Some(&page_root) = page_roots.get(number) {
        blocks.order.push(page_root);
        let next_root = page_roots.len();
        blocks.complete(tree, number, |child, level| {
            let is_inside = level <= levels;
            if !is_inside {
                page_roots.push(child);
            }
            is_inside
        });
        for _ in next_root..page_roots.len() {
            blocks.push_child(number);
        }
        number += 1;
    }
    Ok(blocks)
}
