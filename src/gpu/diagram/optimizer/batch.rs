//! How many passes one submission may have.
//!
//! Purpose: twice as many each time, as long as passes need nothing of the host and do not take too long.
//! Invariant: one after a pass that needed the host. Must not know: what a pass does.

use crate::diagram::plan::PASSES;
use geometry::rvd::Together;

/// A submission of several passes is not to take longer, by what the last ones took.
const SUBMISSION_MS: f64 = 100.0;

/// Learns how many passes a submission may have.
pub(crate) struct Batch {
    /// Passes of the next submission.
    pub count: usize,
    by: Together,
}

impl Batch {
    pub(crate) fn new(by: Together) -> Self {
        Self { count: 1, by }
    }

    /// `taken` passes out of `tried` were clean, in `ms` altogether: twice as many next time, or one.
    pub(crate) fn learn(&mut self, tried: usize, taken: usize, ms: f64) {
        let most = match self.by {
            Together::ByTime => (SUBMISSION_MS * taken as f64 / ms.max(1e-3)) as usize,
            Together::AtMost(most) => most,
        };
        self.count = if taken < tried { 1 } else { (2 * tried).max(self.count).min(most).clamp(1, PASSES) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clean_passes_double_within_the_time_and_others_begin_anew() {
        let mut together = Batch::new(Together::ByTime);
        let mut seen = Vec::new();
        for _ in 0..7 {
            seen.push(together.count);
            together.learn(together.count, together.count, 1.0);
        }
        assert_eq!(seen, [1, 2, 4, 8, 16, 32, 32]);
        together.learn(32, 3, 10.0);
        assert_eq!(together.count, 1);
        together.learn(1, 1, 20.0);
        together.learn(2, 2, 40.0);
        together.learn(4, 4, 80.0);
        assert_eq!(together.count, 5);
        // Fewer than might have been.
        together.learn(3, 3, 6.0);
        assert_eq!(together.count, 6);
        together.learn(1, 1, 500.0);
        assert_eq!(together.count, 1);
        let mut together = Batch::new(Together::AtMost(4));
        for count in [1, 2, 4, 4] {
            assert_eq!(together.count, count);
            together.learn(count, count, 1e6);
        }
        together.learn(4, 3, 1.0);
        assert_eq!(together.count, 1);
    }
}
