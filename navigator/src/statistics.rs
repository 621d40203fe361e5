//! What a frame did, and what a flight did: the figures of the paper's Table 2 and more.

use crate::pool::PoolCounters;

/// What one frame did.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FrameStatistics {
    /// Number of the frame, from 0.
    pub frame: u64,
    /// Active triangles after it.
    pub triangles: u64,
    /// Active nodes after it.
    pub vertices: u64,
    /// Splits applied, the forced ones among them.
    pub splits: u64,
    /// Collapses applied.
    pub collapses: u64,
    /// Nodes that were to be split, but a page for it was missing.
    pub misses: u64,
    /// What the frame wanted done: splits, collapses and misses.
    pub requests: u64,
    /// Nodes that were to be collapsed, or split, but the dependencies did not let them.
    pub blocked: u64,
    /// Splits of nodes that only a neighbour needed.
    pub forced: u64,
    /// Triangles that a split turned round, or might have, until forced splits put them right.
    pub repaired: u64,
    /// Those that were left as they are, because too many splits would have been needed.
    pub unrepaired: u64,
    /// Nodes that were to be split, but a limit was reached: nodes, triangles or place holders.
    pub over_budget: u64,
    /// Nodes that were to be split or collapsed, but the frame had made all the changes that one may make.
    pub postponed: u64,
    /// Vertices on their way to their place, see [`NavigatorOptions::geomorph`](crate::NavigatorOptions::geomorph).
    pub morphs: u64,
    /// By how much the pixel threshold is raised at the moment because of such limits.
    pub threshold_factor: f32,
    /// Largest error in pixels of an active node that can be in the picture, as it is drawn after this frame: the error allowed at
    /// the moment, or more, where nodes wait for pages or for the next frame.
    pub pixels_drawn: f32,
    /// Largest error of an active node that can be in the picture, in mesh units: its switch value and the input error. So
    /// far at most are the points of the input from a triangle that stands for them, whose corners can all be in the
    /// picture.
    pub error_stated: f32,
    /// Whether that is proven; see [`metanode::statement`].
    pub guaranteed: bool,
    /// Parts (trees, that is components) that no triangle is drawn of. The error says nothing of them.
    pub vanished_parts: u64,
    /// Place holders whose page is in use after the frame.
    pub pages_in_use: u64,
    /// Wall time of the frame, in milliseconds.
    pub frame_ms: f64,
    /// CPU time of the frame, in milliseconds, that of the I/O thread not included.
    pub cpu_ms: f64,
    /// What happened in the pool since the last frame.
    pub pool: PoolCounters,
}

/// What the frames of a flight did together.
#[derive(Debug, Clone, Default)]
pub struct FlightSummary {
    triangles: u64,
    adapts: u64,
    misses: u64,
    requests: u64,
    /// Wishes that waited for the next frame because one may not make more changes.
    pub postponed: u64,
    morphs: u64,
    /// Changes that dependencies did not allow.
    pub blocked: u64,
    /// Splits of nodes that only a neighbour needed.
    pub forced: u64,
    /// Triangles that forced splits put right; see [`FrameStatistics::repaired`].
    pub repaired: u64,
    /// Those that were left as they are; see [`FrameStatistics::unrepaired`].
    pub unrepaired: u64,
    cpu_ms: Vec<f64>,
    frame_ms: Vec<f64>,
    pixels: Vec<f64>,
    /// Frames whose stated error is proven.
    guaranteed: u64,
    /// What happened in the pool.
    pub pool: PoolCounters,
    /// Largest error that was in a picture, in mesh units; see [`FrameStatistics::error_stated`].
    pub error_stated: f32,
    /// The most parts that no triangle was drawn of, in one frame.
    pub vanished_parts: u64,
    /// Largest factor by which limits raised the pixel threshold.
    pub threshold_factor: f32,
}

impl FlightSummary {
    /// Adds a frame.
    pub fn add(&mut self, frame: &FrameStatistics) {
        self.triangles += frame.triangles;
        self.adapts += frame.splits + frame.collapses;
        self.misses += frame.misses;
        self.requests += frame.requests;
        self.postponed += frame.postponed;
        self.morphs += frame.morphs;
        self.blocked += frame.blocked;
        self.forced += frame.forced;
        self.repaired += frame.repaired;
        self.unrepaired += frame.unrepaired;
        self.cpu_ms.push(frame.cpu_ms);
        self.frame_ms.push(frame.frame_ms);
        self.pixels.push(frame.pixels_drawn.into());
        self.pool += frame.pool;
        self.error_stated = self.error_stated.max(frame.error_stated);
        self.guaranteed += u64::from(frame.guaranteed);
        self.vanished_parts = self.vanished_parts.max(frame.vanished_parts);
        self.threshold_factor = self.threshold_factor.max(frame.threshold_factor);
    }

    /// Number of frames.
    pub fn frames(&self) -> u64 {
        self.frame_ms.len() as u64
    }

    /// Active triangles, mean over the frames.
    pub fn triangles_mean(&self) -> f64 {
        self.mean(self.triangles as f64)
    }

    /// Splits and collapses in a frame (the paper's *Adapt* count), mean over the frames.
    pub fn adapts_mean(&self) -> f64 {
        self.mean(self.adapts as f64)
    }

    /// Share of the requests that the external memory could not fulfil (the paper's *Miss*), in percent.
    pub fn miss_percent(&self) -> f64 {
        100.0 * self.misses as f64 / self.requests.max(1) as f64
    }

    /// Vertices on their way to their place, mean over the frames.
    pub fn morphs_mean(&self) -> f64 {
        self.mean(self.morphs as f64)
    }

    /// CPU time of a frame in milliseconds, mean over the frames.
    pub fn cpu_ms_mean(&self) -> f64 {
        self.mean(self.cpu_ms.iter().sum())
    }

    /// Wall time of a frame in milliseconds, mean over the frames.
    pub fn frame_ms_mean(&self) -> f64 {
        self.mean(self.frame_ms.iter().sum())
    }

    /// The wall time in milliseconds that `percent` of the frames did not exceed; 0 without frames.
    pub fn frame_ms_percentile(&self, percent: f64) -> f64 {
        percentile(&self.frame_ms, percent)
    }

    /// The error in pixels that `percent` of the frames did not exceed, see [`FrameStatistics::pixels_drawn`]; 0 without frames.
    pub fn pixels_percentile(&self, percent: f64) -> f64 {
        percentile(&self.pixels, percent)
    }

    /// Share of the frames in which the error in pixels was within this, in percent.
    pub fn within_pixels_percent(&self, most: f64) -> f64 {
        100.0 * self.pixels.iter().filter(|pixels| **pixels <= most).count() as f64 / self.frames().max(1) as f64
    }

    /// The same of the CPU time.
    pub fn cpu_ms_percentile(&self, percent: f64) -> f64 {
        percentile(&self.cpu_ms, percent)
    }

    /// Whether the stated error is a proven bound in every frame.
    pub fn guaranteed(&self) -> bool {
        self.guaranteed == self.frames()
    }

    fn mean(&self, sum: f64) -> f64 {
        sum / self.frames().max(1) as f64
    }
}

/// The value that `percent` of all do not exceed; 0 where there are none.
fn percentile(values: &[f64], percent: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (percent / 100.0 * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).or(sorted.last()).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flight_sums_up_its_frames() {
        let mut summary = FlightSummary::default();
        assert_eq!((summary.miss_percent(), summary.frame_ms_percentile(99.0)), (0.0, 0.0));
        for frame in 0..100 {
            summary.add(&FrameStatistics {
                triangles: frame,
                splits: 2,
                collapses: 1,
                misses: 1,
                requests: 4,
                frame_ms: (100 - frame) as f64,
                error_stated: frame as f32,
                guaranteed: frame > 0,
                vanished_parts: 7 - frame.min(7),
                pixels_drawn: 1.0 + frame as f32,
                ..FrameStatistics::default()
            });
        }
        assert_eq!(summary.frames(), 100);
        assert_eq!(summary.triangles_mean(), 49.5);
        assert_eq!(summary.adapts_mean(), 3.0);
        assert_eq!(summary.miss_percent(), 25.0);
        assert_eq!(summary.frame_ms_percentile(50.0), 50.0);
        assert_eq!(summary.frame_ms_percentile(99.0), 99.0);
        assert_eq!(summary.frame_ms_mean(), 50.5);
        assert_eq!((summary.error_stated, summary.vanished_parts), (99.0, 7));
        assert!(!summary.guaranteed());
        assert_eq!((summary.pixels_percentile(50.0), summary.within_pixels_percent(90.0)), (50.0, 90.0));
    }
}
