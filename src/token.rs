//! One token for a piece of work: whoever works asks it whether to go on.
//!
//! Purpose: [`Token`] carries a cancellation and a limit on time from a caller to every loop that can take long, on any
//! thread, and tells the caller which stage is at work.
//! Invariant: once stopped it stays stopped, and the first reason stays the reason. Asking is an atomic load, and reads
//! the clock only where there is a limit on time.
//! Must not know: meshes, seeds, jobs, or what the work is.
//!
//! How to listen: a function that may take longer than [a few milliseconds](Token#how-often-to-ask) takes a token and
//! returns [`Stopped`]. A loop that runs on many threads may instead return early with whatever it has, if its caller
//! asks [`Token::check`] before it uses the result.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Why work was stopped before its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Stopped {
    /// The caller asked, or has gone.
    #[error("cancelled")]
    Cancelled,
    /// The work took as long as it may.
    #[error("the job reached its limit of {} s; ask for less, or raise the limit", .limit.as_secs_f64())]
    Time {
        /// How long it may take.
        limit: Duration,
    },
    /// The work holds as much memory as it may.
    #[error(
        "the job reached its limit on memory: it holds {} MiB, and {} MiB are allowed; ask for less, or raise the limit",
        .used_bytes >> 20, .limit_bytes >> 20
    )]
    Memory {
        /// What it held when it was stopped.
        used_bytes: u64,
        /// What it may hold.
        limit_bytes: u64,
    },
}

/// See the module's head. Clones share one state.
///
/// ```
/// use tessera::token::{Stopped, Token};
///
/// let token = Token::default();
/// assert_eq!(token.check(), Ok(()));
/// token.cancel();
/// assert_eq!(token.check(), Err(Stopped::Cancelled));
/// ```
///
/// # How often to ask
/// At least every few milliseconds of work: about every [`Token::STRIDE`] facets or vertices of a plain loop, and every
/// item where an item may itself look at many others.
#[derive(Clone, Debug, Default)]
pub struct Token(Arc<State>);

#[derive(Debug, Default)]
struct State {
    reason: OnceLock<Stopped>,
    /// When time is up, and the limit that it follows from.
    end: Option<(Instant, Duration)>,
    stage: Mutex<&'static str>,
}

impl Token {
    /// Items of a plain loop between two questions.
    pub const STRIDE: usize = 4096;

    /// A token that stops by itself after `limit`.
    pub fn with_time_limit(limit: Duration) -> Self {
        let end = Instant::now().checked_add(limit).map(|end| (end, limit));
        Self(Arc::new(State { end, ..State::default() }))
    }

    /// Asks everyone who holds a clone to stop.
    pub fn cancel(&self) {
        self.stop(Stopped::Cancelled);
    }

    /// Asks everyone who holds a clone to stop, for this reason if there is none yet.
    pub fn stop(&self, reason: Stopped) {
        let _ = self.0.reason.set(reason);
    }

    /// Why the work is to stop, if it is.
    pub fn stopped(&self) -> Option<Stopped> {
        if let Some(&reason) = self.0.reason.get() {
            return Some(reason);
        }
        let (end, limit) = self.0.end?;
        if Instant::now() < end {
            return None;
        }
        self.stop(Stopped::Time { limit });
        self.0.reason.get().copied()
    }

    /// Whether the work is to stop.
    pub fn is_stopped(&self) -> bool {
        self.stopped().is_some()
    }

    /// Whether to go on.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn check(&self) -> Result<(), Stopped> {
        self.stopped().map_or(Ok(()), Err)
    }

    /// [`Token::check`] at every [`Token::STRIDE`]-th item of a plain loop.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn check_at(&self, item: usize) -> Result<(), Stopped> {
        if item.is_multiple_of(Self::STRIDE) { self.check() } else { Ok(()) }
    }

    /// Says what is being done now, for whoever watches.
    pub fn enter(&self, stage: &'static str) {
        *self.0.stage.lock().unwrap_or_else(PoisonError::into_inner) = stage;
    }

    /// The stage last entered; empty before the first.
    pub fn stage(&self) -> &'static str {
        *self.0.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_reason_stays() {
        let token = Token::default();
        let other = token.clone();
        assert!(!other.is_stopped());
        token.stop(Stopped::Memory { used_bytes: 3, limit_bytes: 2 });
        other.cancel();
        assert_eq!(other.check(), Err(Stopped::Memory { used_bytes: 3, limit_bytes: 2 }));
    }

    #[test]
    fn time_runs_out() {
        let token = Token::with_time_limit(Duration::from_millis(5));
        std::thread::sleep(Duration::from_millis(6));
        assert_eq!(token.check(), Err(Stopped::Time { limit: Duration::from_millis(5) }));
        assert!(!Token::with_time_limit(Duration::MAX).is_stopped(), "no such time");
    }

    #[test]
    fn stages_are_told() {
        let token = Token::default();
        assert_eq!(token.stage(), "");
        token.clone().enter("dual");
        assert_eq!(token.stage(), "dual");
    }
}
