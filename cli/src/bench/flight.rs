//! Flights over a model that count what of its pages is read, and what of them is used.
//!
//! A split, and with it its record, is *used* where it is applied at the end of a frame. A page is in use where one of its
//! records is; those in use at the end of a frame are the *pages of its cut*.
//!
//! RAM, beside the navigator's: a bit for each leaf and 12 bytes for each page.

use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use metanode::chain::PageChain;
use metanode::header::ModelError;
use metanode::model::Model;
use navigator::{Camera, FlightSummary, Io, Navigator, NavigatorError, NavigatorOptions};
use serde_json::{Value, json};
use storage::usage::thread_cpu_time;

/// What a page takes.
#[derive(Debug, Clone, Copy, Default)]
struct PageSize {
    /// Bytes in the file.
    encoded: u32,
    /// Bytes in a place holder.
    decoded: u32,
    /// Splits.
    records: u32,
}

/// What the pages of a model take, and what it took to decode them all, once each.
#[derive(Debug)]
pub struct PageSizes {
    sizes: Vec<PageSize>,
    /// Bytes of all pages in the file.
    encoded: u64,
    records: u64,
    /// CPU seconds of reading and decoding.
    cpu_seconds: f64,
}

impl PageSizes {
    /// Reads every page.
    pub fn of(model: &Model) -> Result<Self, ModelError> {
        let mut found = PageSizes {
            sizes: vec![PageSize::default(); model.header().page_count as usize],
            encoded: 0,
            records: 0,
            cpu_seconds: 0.0,
        };
        let start = thread_cpu_time();
        let mut chain = PageChain::new(model);
        let mut stack: Vec<_> = model.root_pages().iter().rev().map(|page| (*page, None)).collect();
        while let Some((location, parent)) = stack.pop() {
            let page = chain.page(location, parent)?;
            let counts = page.counts();
            let size = PageSize {
                encoded: location.length,
                decoded: counts.decoded_bytes() as u32,
                records: counts.records as u32,
            };
            // A page that was read has a number below the model's count of pages.
            found.sizes[location.number as usize] = size;
            found.encoded += u64::from(size.encoded);
            found.records += u64::from(size.records);
            let first = stack.len();
            stack.extend(page.children().map(|child| (child, Some(location.number))));
            stack[first..].reverse();
        }
        found.cpu_seconds = (thread_cpu_time() - start).as_secs_f64();
        Ok(found)
    }

    /// Bytes of a page in the file, mean over the pages.
    pub fn encoded_mean(&self) -> f64 {
        self.encoded as f64 / self.sizes.len().max(1) as f64
    }

    /// Bytes of a record in the file with all that belongs to it, mean over the model.
    pub fn record_bytes(&self) -> f64 {
        self.encoded as f64 / self.records.max(1) as f64
    }

    /// CPU time of reading and decoding a record, in nanoseconds.
    pub fn decode_nanoseconds(&self) -> f64 {
        self.cpu_seconds * 1e9 / self.records.max(1) as f64
    }
}

/// What a flight read and used.
#[derive(Debug, Clone)]
pub struct Flight {
    /// What its frames did.
    pub summary: FlightSummary,
    /// Place holders that there were.
    pub place_holders: usize,
    /// Pages of a cut, their bytes in the file and in place holders, their records, and those that were used: each added up
    /// over the frames.
    pages: u64,
    encoded: u64,
    decoded: u64,
    records: u64,
    used_records: u64,
    /// Pages in use in any frame, each once; and their bytes in the file.
    pub distinct_pages: u64,
    distinct_bytes: u64,
    /// Records used in any frame, each once.
    pub distinct_records: u64,
    /// Bytes in the file of so many records.
    distinct_record_bytes: f64,
}

/// What was seen of pages and records in the frames before.
struct Seen {
    /// The last frame in which each page was in use, counted from 1; 0 for none.
    page_frames: Vec<u32>,
    /// A bit for each leaf: whether the split that bears it was used.
    records: Vec<u64>,
}

impl Flight {
    /// Flies. Every page that is missing is read at once, so the flight is the same each time; the figures of CPU time have
    /// reading and decoding in them.
    pub fn fly(
        model: &Arc<Model>,
        sizes: &PageSizes,
        cameras: &[Camera],
        options: NavigatorOptions,
    ) -> Result<Self, NavigatorError> {
        let mut navigator = Navigator::open(model.clone(), NavigatorOptions { io: Io::Sync, ..options })?;
        let mut flight = Flight {
            summary: FlightSummary::default(),
            place_holders: navigator.place_holders(),
            pages: 0,
            encoded: 0,
            decoded: 0,
            records: 0,
            used_records: 0,
            distinct_pages: 0,
            distinct_bytes: 0,
            distinct_records: 0,
            distinct_record_bytes: 0.0,
        };
        let words = (model.header().leaf_count as usize).div_ceil(64);
        let mut seen = Seen { page_frames: vec![0; sizes.sizes.len()], records: vec![0; words] };
        for (frame, camera) in (1..).zip(cameras) {
            flight.summary.add(&navigator.frame(camera)?);
            flight.look(&navigator, sizes, &mut seen, frame);
        }
        flight.distinct_record_bytes = flight.distinct_records as f64 * sizes.record_bytes();
        Ok(flight)
    }

    /// Counts what is used at the end of a frame.
    fn look(&mut self, navigator: &Navigator, sizes: &PageSizes, seen: &mut Seen, frame: u32) {
        for split in navigator.applied_splits() {
            self.used_records += 1;
            let word = &mut seen.records[split.born_leaf as usize / 64];
            let bit = 1 << (split.born_leaf % 64);
            self.distinct_records += u64::from(*word & bit == 0);
            *word |= bit;
            let page_frame = &mut seen.page_frames[split.page as usize];
            let before = std::mem::replace(page_frame, frame);
            if before == frame {
                continue;
            }
            let size = sizes.sizes[split.page as usize];
            self.pages += 1;
            self.encoded += u64::from(size.encoded);
            self.decoded += u64::from(size.decoded);
            self.records += u64::from(size.records);
            if before == 0 {
                self.distinct_pages += 1;
                self.distinct_bytes += u64::from(size.encoded);
            }
        }
    }

    fn per_frame(&self, sum: u64) -> f64 {
        sum as f64 / self.summary.frames().max(1) as f64
    }

    /// Pages of a cut, mean over the frames.
    pub fn pages_per_cut(&self) -> f64 {
        self.per_frame(self.pages)
    }

    /// Their bytes in the file.
    pub fn encoded_per_cut(&self) -> f64 {
        self.per_frame(self.encoded)
    }

    /// Their bytes in place holders, without what is left empty of these.
    pub fn decoded_per_cut(&self) -> f64 {
        self.per_frame(self.decoded)
    }

    /// The share of the records in the pages of the cuts that is used, of all frames together.
    pub fn used_share(&self) -> f64 {
        self.used_records as f64 / self.records.max(1) as f64
    }

    /// Pages read from disk, mean over the frames.
    pub fn reads_per_frame(&self) -> f64 {
        self.per_frame(self.summary.pool.reads)
    }

    /// Bytes read from disk, mean over the frames.
    pub fn bytes_per_frame(&self) -> f64 {
        self.per_frame(self.summary.pool.bytes_read)
    }

    /// Bytes read over the bytes of the records used; `None` where none was.
    pub fn read_over_used(&self) -> Option<f64> {
        (self.distinct_records > 0).then(|| self.summary.pool.bytes_read as f64 / self.distinct_record_bytes)
    }

    /// Bytes of the pages that were ever in use over the bytes of the records used: what would be read if no page was
    /// prefetched, and none read twice.
    pub fn needed_over_used(&self) -> Option<f64> {
        (self.distinct_records > 0).then(|| self.distinct_bytes as f64 / self.distinct_record_bytes)
    }

    pub fn to_json(&self) -> Value {
        json!({
            "place_holders": self.place_holders,
            "triangles_mean": self.summary.triangles_mean(),
            "threshold_factor_max": self.summary.threshold_factor,
            "pages_per_cut_mean": self.pages_per_cut(),
            "bytes_per_cut_mean": self.encoded_per_cut(),
            "decoded_bytes_per_cut_mean": self.decoded_per_cut(),
            "records_used_share": self.used_share(),
            "reads": self.summary.pool.reads,
            "bytes_read": self.summary.pool.bytes_read,
            "reads_per_frame": self.reads_per_frame(),
            "bytes_read_per_frame": self.bytes_per_frame(),
            "second_chances": self.summary.pool.second_chances,
            "prefetch_given_up": self.summary.pool.prefetch_given_up,
            "pages_used": self.distinct_pages,
            "pages_used_bytes": self.distinct_bytes,
            "records_used": self.distinct_records,
            "bytes_read_over_bytes_used": self.read_over_used(),
            "pages_used_bytes_over_bytes_used": self.needed_over_used(),
            "cpu_ms_mean": self.summary.cpu_ms_mean(),
        })
    }
}

/// Flies with an I/O thread, as a viewer does: frames begin at this rate (0: each as soon as the last one is done), and wait
/// for no page.
pub fn fly_in_time(
    model: &Arc<Model>,
    cameras: &[Camera],
    options: NavigatorOptions,
    frame_rate: f64,
) -> Result<FlightSummary, NavigatorError> {
    let mut navigator = Navigator::open(model.clone(), NavigatorOptions { io: Io::Thread, ..options })?;
    let mut summary = FlightSummary::default();
    let start = Instant::now();
    for (number, camera) in cameras.iter().enumerate() {
        if frame_rate > 0.0 {
            let due = Duration::from_secs_f64(number as f64 / frame_rate);
            std::thread::sleep(due.saturating_sub(start.elapsed()));
        }
        summary.add(&navigator.frame(camera)?);
    }
    Ok(summary)
}
