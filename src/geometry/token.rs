//! A token for a piece of work, which checks it to see whether to go on.
//!
//! Purpose: [`Token`] carries a cancellation and a time limit from a caller to every long loop, on any thread, and the current
//! stage back. It records the longest time without a check, so that a stage that does not check can be found.
//! Invariant: once stopped it stays stopped, for the first reason. A check takes some ten nanoseconds; that of suspended work
//! waits until the work goes on or is stopped.
//! Must not know: meshes, seeds, jobs, the kind of work.
//!
//! A function that may take longer than [a few milliseconds](Token#how-often-to-check) takes a token and returns [`Stopped`]. A
//! loop on many threads may instead return early with what it has, if its caller calls [`Token::check`] before it uses the result.

use std::panic::Location;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

/// Why work was stopped before its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Stopped {
    /// The caller cancelled it, or has gone.
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
        /// Memory of the work when it was stopped.
        used_bytes: u64,
        /// The limit.
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
/// # How often to check
/// At least every few milliseconds of work: about every [`Token::STRIDE`] facets or vertices of a plain loop, and every
/// item where an item may itself look at many others.
#[derive(Clone, Debug, Default)]
pub struct Token(Arc<State>);

#[derive(Debug)]
struct State {
    reason: OnceLock<Stopped>,
    limit: OnceLock<Duration>,
    /// Microseconds after `begin` when time is up; [`NEVER`] while the clock stands.
    end: AtomicU64,
    /// Microseconds of the limit that were left when the clock stopped last.
    left: AtomicU64,
    stage: Mutex<&'static str>,
    listener: Mutex<Option<Arc<dyn StageListener>>>,
    begin: Instant,
    /// Microseconds after `begin` of the last check.
    checked: AtomicU64,
    silence: Mutex<Silence>,
    longest: AtomicU64,
    suspended: AtomicBool,
    /// Parts of the work that must not wait.
    uninterrupted: AtomicUsize,
    suspension: Mutex<()>,
    changed: Condvar,
}

const NEVER: u64 = u64::MAX;

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(NEVER)
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Default for State {
    fn default() -> Self {
        Self {
            reason: OnceLock::new(),
            limit: OnceLock::new(),
            end: AtomicU64::new(NEVER),
            left: AtomicU64::new(NEVER),
            stage: Mutex::new(""),
            listener: Mutex::default(),
            begin: Instant::now(),
            checked: AtomicU64::new(0),
            silence: Mutex::default(),
            longest: AtomicU64::new(0),
            suspended: AtomicBool::new(false),
            uninterrupted: AtomicUsize::new(0),
            suspension: Mutex::default(),
            changed: Condvar::new(),
        }
    }
}

/// A time without a check of a token, and where it ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Silence {
    /// Its length.
    pub time: Duration,
    /// See [`Token::enter`].
    pub stage: &'static str,
    /// The place of the next check.
    pub until: Option<&'static Location<'static>>,
}

/// Receives the stages of the work.
pub trait StageListener: std::fmt::Debug + Send + Sync {
    /// A stage begins, and the one before it is over.
    fn entered(&self, stage: &'static str);
}

/// How often suspended work looks whether a part of it must not wait.
const SUSPENSION_POLL: Duration = Duration::from_millis(20);

/// A part of the work that must not wait, until this is dropped.
#[derive(Debug)]
pub struct Uninterrupted(Token);

impl Drop for Uninterrupted {
    fn drop(&mut self) {
        self.0.0.uninterrupted.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Steps of work since the last check of a token; see [`Token::is_stopped_after`].
#[derive(Clone, Debug, Default)]
pub struct Pace(usize);

impl Token {
    /// Items of a plain loop between two checks.
    pub const STRIDE: usize = 4096;

    /// A token that stops by itself after `limit`.
    pub fn with_time_limit(limit: Duration) -> Self {
        let token = Self::default();
        token.limit_time(limit);
        token.resume();
        token
    }

    /// Limits the time that the clock runs; it stands until [`Token::resume`]. The first limit stays.
    pub fn limit_time(&self, limit: Duration) {
        if self.0.limit.set(limit).is_ok() {
            self.0.left.store(micros(limit), Ordering::Release);
        }
    }

    /// The limit, if there is one.
    pub fn time_limit(&self) -> Option<Duration> {
        self.0.limit.get().copied()
    }

    /// Work begins or goes on: the clock runs.
    pub fn resume(&self) {
        let left = self.0.left.swap(NEVER, Ordering::AcqRel);
        if left != NEVER {
            self.0.end.store(micros(self.0.begin.elapsed()).saturating_add(left), Ordering::Release);
        }
    }

    /// Work pauses: the clock stands.
    pub fn pause(&self) {
        let end = self.0.end.swap(NEVER, Ordering::AcqRel);
        if end != NEVER {
            self.0.left.store(end.saturating_sub(micros(self.0.begin.elapsed())), Ordering::Release);
        }
    }

    /// Stops the work of all clones.
    pub fn cancel(&self) {
        self.stop(Stopped::Cancelled);
    }

    /// [`Self::cancel`], for this reason if there is none yet.
    pub fn stop(&self, reason: Stopped) {
        let _ = self.0.reason.set(reason);
        if self.is_suspended() {
            drop(lock(&self.0.suspension));
            self.0.changed.notify_all();
        }
    }

    /// Suspends the work: its next check waits until [`Self::go_on`] or a stop. The clock stands.
    pub fn suspend(&self) {
        self.0.suspended.store(true, Ordering::Release);
        self.pause();
    }

    /// Ends a suspension: the clock runs. Does nothing without one.
    pub fn go_on(&self) {
        let guard = lock(&self.0.suspension);
        if self.0.suspended.swap(false, Ordering::AcqRel) {
            self.resume();
        }
        drop(guard);
        self.0.changed.notify_all();
    }

    /// Whether both are tokens of the same work.
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }

    /// Whether the work is to wait.
    pub fn is_suspended(&self) -> bool {
        self.0.suspended.load(Ordering::Acquire)
    }

    /// Begins a part of the work that must not wait, because other work waits for it: its checks return at once.
    pub fn uninterrupted(&self) -> Uninterrupted {
        self.0.uninterrupted.fetch_add(1, Ordering::AcqRel);
        Uninterrupted(self.clone())
    }

    /// Waits while the work is suspended.
    #[cold]
    fn wait(&self) {
        let state = &*self.0;
        let mut guard = lock(&state.suspension);
        while self.is_suspended() && !self.is_told_to_stop() && state.uninterrupted.load(Ordering::Acquire) == 0 {
            guard = state.changed.wait_timeout(guard, SUSPENSION_POLL).unwrap_or_else(PoisonError::into_inner).0;
        }
        drop(guard);
        // No silence of the work.
        state.checked.fetch_max(micros(state.begin.elapsed()), Ordering::Relaxed);
    }

    /// Why the work is to stop, if it is.
    #[track_caller]
    pub fn stopped(&self) -> Option<Stopped> {
        self.note();
        if self.0.suspended.load(Ordering::Relaxed) {
            self.wait();
        }
        if let Some(&reason) = self.0.reason.get() {
            return Some(reason);
        }
        let limit = *self.0.limit.get()?;
        if micros(self.0.begin.elapsed()) < self.0.end.load(Ordering::Acquire) {
            return None;
        }
        self.stop(Stopped::Time { limit });
        self.0.reason.get().copied()
    }

    /// Whether the work was stopped. For watchers: it does not count as a check by the work.
    pub fn is_told_to_stop(&self) -> bool {
        self.0.reason.get().is_some()
    }

    /// Whether the work is to stop.
    #[track_caller]
    pub fn is_stopped(&self) -> bool {
        self.stopped().is_some()
    }

    /// Whether to go on.
    #[track_caller]
    pub fn check(&self) -> Result<(), Stopped> {
        self.stopped().map_or(Ok(()), Err)
    }

    /// [`Token::check`] at every [`Token::STRIDE`]-th item of a plain loop.
    #[track_caller]
    pub fn check_at(&self, item: usize) -> Result<(), Stopped> {
        if item.is_multiple_of(Self::STRIDE) { self.check() } else { Ok(()) }
    }

    /// Whether to stop, where items differ in cost: checks every [`Token::STRIDE`] steps; this item took `steps`.
    #[track_caller]
    pub fn is_stopped_after(&self, steps: usize, pace: &mut Pace) -> bool {
        pace.0 = pace.0.saturating_add(steps);
        if pace.0 < Self::STRIDE {
            return false;
        }
        pace.0 = 0;
        self.is_stopped()
    }

    /// [`Token::is_stopped_after`], as a result.
    #[track_caller]
    pub fn check_after(&self, steps: usize, pace: &mut Pace) -> Result<(), Stopped> {
        if self.is_stopped_after(steps, pace) { self.check() } else { Ok(()) }
    }

    #[track_caller]
    fn note(&self) {
        let state = &*self.0;
        let now = state.begin.elapsed().as_micros() as u64;
        let before = state.checked.fetch_max(now, Ordering::Relaxed);
        let silent = now.saturating_sub(before);
        if silent > state.longest.load(Ordering::Relaxed) {
            state.longest.fetch_max(silent, Ordering::Relaxed);
            let mut longest = lock(&state.silence);
            let time = Duration::from_micros(silent);
            if time > longest.time {
                *longest = Silence { time, stage: self.stage(), until: Some(Location::caller()) };
            }
        }
    }

    /// Time since the last check.
    pub fn silent_for(&self) -> Duration {
        let checked = Duration::from_micros(self.0.checked.load(Ordering::Relaxed));
        self.0.begin.elapsed().saturating_sub(checked)
    }

    /// The longest time between two checks so far. A stage that does not check shows here.
    pub fn longest_silence(&self) -> Silence {
        *lock(&self.0.silence)
    }

    /// Begins a stage of the work.
    #[track_caller]
    pub fn enter(&self, stage: &'static str) {
        self.note();
        *lock(&self.0.stage) = stage;
        let listener = lock(&self.0.listener).clone();
        if let Some(listener) = listener {
            listener.entered(stage);
        }
    }

    /// Sends later stages to `listener`, if there is one.
    pub fn tell_stages(&self, listener: Option<Arc<dyn StageListener>>) {
        *lock(&self.0.listener) = listener;
    }

    /// The stage last entered; empty before the first.
    pub fn stage(&self) -> &'static str {
        *lock(&self.0.stage)
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
    fn silence_is_noticed() {
        let token = Token::default();
        token.enter("dual");
        std::thread::sleep(Duration::from_millis(5));
        assert!(token.silent_for() >= Duration::from_millis(5));
        token.enter("repair");
        let silence = token.longest_silence();
        assert!(silence.stage == "dual" && silence.time >= Duration::from_millis(5), "{silence:?}");
    }

    #[test]
    fn suspended_work_waits_and_hears_a_stop() {
        const SHORT: Duration = Duration::from_millis(50);
        for ends_by_stop in [false, true] {
            let token = Token::with_time_limit(Duration::from_secs(1));
            token.suspend();
            // What other work waits for goes on.
            let whole = token.uninterrupted();
            assert_eq!(token.check(), Ok(()));
            drop(whole);
            std::thread::scope(|scope| {
                let work = scope.spawn(|| token.check());
                std::thread::sleep(SHORT);
                assert!(!work.is_finished());
                if ends_by_stop {
                    token.cancel()
                } else {
                    token.go_on()
                }
                assert_eq!(work.join().unwrap().is_err(), ends_by_stop);
            });
            assert!(token.longest_silence().time < SHORT, "waiting is no silence");
        }
        let token = Token::with_time_limit(2 * SHORT);
        token.suspend();
        std::thread::sleep(4 * SHORT);
        token.go_on();
        assert_eq!(token.check(), Ok(()), "the clock stood");
        token.go_on();
    }

    #[test]
    fn stages_are_told() {
        let token = Token::default();
        assert_eq!(token.stage(), "");
        token.clone().enter("dual");
        assert_eq!(token.stage(), "dual");
    }
}
