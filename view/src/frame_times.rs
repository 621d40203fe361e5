//! How long frames took: the last ones, in a fixed amount of memory.

/// How many are kept.
const KEPT: usize = 1 << 16;

/// Times of frames.
#[derive(Debug, Clone, Default)]
pub struct FrameTimes {
    milliseconds: Vec<f32>,
    next: usize,
}

impl FrameTimes {
    /// Adds that of a frame.
    pub fn add(&mut self, milliseconds: f64) {
        let milliseconds = milliseconds as f32;
        match self.milliseconds.get_mut(self.next) {
            Some(place) => *place = milliseconds,
            None => self.milliseconds.push(milliseconds),
        }
        self.next = (self.next + 1) % KEPT;
    }

    /// That which so many percent of the frames do not exceed; 0 where there is none.
    pub fn percentile(&self, percent: f64) -> f64 {
        let mut sorted = self.milliseconds.clone();
        sorted.sort_unstable_by(f32::total_cmp);
        let rank = (percent / 100.0 * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_last_ones() {
        let mut times = FrameTimes::default();
        assert_eq!(times.percentile(50.0), 0.0);
        times.add(3.0);
        assert_eq!((times.percentile(0.0), times.percentile(99.0)), (3.0, 3.0));
        (0..KEPT).for_each(|at| times.add((at % 100 + 1) as f64));
        assert_eq!(times.milliseconds.len(), KEPT);
        assert_eq!((times.percentile(50.0), times.percentile(99.0), times.percentile(100.0)), (50.0, 99.0, 100.0));
    }
}
