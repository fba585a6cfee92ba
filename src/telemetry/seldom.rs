//! Rate limit for log lines that others can cause.
//!
//! Invariant: at most one line in a pause for each [`Seldom`]. Must not know: the content of lines.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Counts events and decides when to log them.
#[derive(Debug)]
pub struct Seldom {
    pause: Duration,
    /// Time of the last line, and events since then.
    state: Mutex<(Option<Instant>, u64)>,
}

/// A line in five seconds: for what remote peers can cause.
impl Default for Seldom {
    fn default() -> Self {
        Self::every(Duration::from_secs(5))
    }
}

impl Seldom {
    /// At most one line in `pause`.
    pub fn every(pause: Duration) -> Self {
        Self { pause, state: Mutex::default() }
    }

    /// Counts an event. If a line is due, returns the number of events since the last line.
    pub fn count(&self) -> Option<u64> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.1 += 1;
        if state.0.is_some_and(|last| last.elapsed() < self.pause) {
            return None;
        }
        state.0 = Some(Instant::now());
        Some(std::mem::take(&mut state.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_is_told_at_once_and_the_next_are_counted() {
        let seldom = Seldom::default();
        assert_eq!(seldom.count(), Some(1));
        assert_eq!(seldom.count(), None);
        seldom.state.lock().unwrap().0 = Instant::now().checked_sub(seldom.pause);
        assert_eq!(seldom.count(), Some(2));
    }
}
