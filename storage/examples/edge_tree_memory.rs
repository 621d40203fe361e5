//! Measures what an edge tree takes: `edge_tree_memory redb|sled EDGES CACHE_BYTES` (sled's cache is fixed).
//!
//! Loads so many edges, then deletes the smallest and puts in larger ones the way a simplification does (1.4 put in for
//! each deleted until a fifth of the edges was deleted, then fewer, to the end), and prints what it took. The rule by
//! which sled is refused rests on it.

use std::io;
use std::path::Path;
use std::sync::Arc;

use vdt_storage::{Edge, EdgeTreeKind, LocalDisk, Scratch, usage};

/// A number that looks random.
fn mix(number: u64) -> u64 {
    let bits = number.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (bits ^ (bits >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 16
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [kind, edges, cache] = &arguments[..] else {
        return Err("usage: edge_tree_memory redb|sled EDGES CACHE_BYTES".into());
    };
    let kind = kind.parse::<EdgeTreeKind>()?;
    let (edges, cache): (u64, u64) = (edges.parse()?, cache.parse()?);
    let folder = std::env::temp_dir().join(format!("edge_tree_memory_{}", std::process::id()));
    measure(kind, edges, cache, &folder)
}

fn measure(kind: EdgeTreeKind, edges: u64, cache: u64, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let before = usage::peak_resident_bytes().ok_or_else(|| io::Error::other("no VmHWM"))?;
    let start = usage::cpu_time();
    let (scratch, _) = Scratch::open(Arc::new(LocalDisk), folder, "")?;
    // sled is told of memory without end: what is enough is to be found out.
    let share = if kind == EdgeTreeKind::Sled { u64::MAX } else { cache };
    let mut tree = kind.create(&scratch, 0, share)?;
    let mut next = 0;
    tree.bulk_load(&mut || {
        next += 1;
        let key = ((next << 30) / edges) as u32;
        Ok((next <= edges).then_some(Edge { key, tie: mix(next) as u32, low: next as u32, high: next as u32 + 1 }))
    })?;
    let loaded = usage::cpu_time() - start;
    let (mut deleted, mut inserted) = (0, 0);
    let mut smallest = Vec::new();
    while !tree.is_empty() {
        smallest.clear();
        tree.delete_smallest(&mut |edge| {
            smallest.push(edge);
            smallest.len() <= 1000
        })?;
        smallest.truncate(1000);
        deleted += smallest.len() as u64;
        let share = if deleted < edges / 5 { 1.4 } else { 0.5 };
        let count = (smallest.len() as f64 * share) as usize;
        let mut larger: Vec<Edge> = smallest.iter().cycle().take(count).copied().collect();
        for edge in &mut larger {
            let random = mix(u64::from(edge.tie) << 20 | inserted) as u32;
            edge.key += (random >> 4) % ((1 << 30) - edge.key.min(1 << 29));
            edge.tie = random;
            inserted += 1;
        }
        larger.sort_unstable();
        tree.change(&[], &larger)?;
    }
    let seconds = (usage::cpu_time() - start).as_secs_f64();
    let peak = usage::peak_resident_bytes().unwrap_or_default() - before;
    let traffic = tree.traffic();
    println!(
        "{} edges {edges} cache {cache} peak {peak} bytes = {:.0} per edge; {deleted} deleted, {inserted} put in; \
         {:.2} s CPU to load, {seconds:.2} in all; {} bytes read, {} written",
        kind,
        peak as f64 / edges as f64,
        loaded.as_secs_f64(),
        traffic.read,
        traffic.written,
    );
    Ok(())
}
