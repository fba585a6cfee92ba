//! Ceilings of jobs, and work that does not end.
//!
//! Purpose: [`Watchdog`] looks at all work several times a second. Work that makes the process grow beyond its ceiling is
//! stopped. Work that goes on long after it was asked to stop is reported with its stage, then given up as lost.
//! Invariant: it never waits for work, and holds nothing of it but the token. Without work it sleeps.
//! Must not know: what the work is, health, how the process ends.

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::{lock, memory};
use geometry::token::{Stopped, Token};

/// What a job may take, and how long it may take to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ceilings {
    /// Time at work, waiting not counted.
    pub time: Option<Duration>,
    /// Bytes by which the process may grow while the job is at work. Of several jobs, the one that has seen the process grow
    /// most is stopped.
    pub memory_bytes: Option<u64>,
    /// Work that runs this long after its cancellation is stuck.
    pub stuck: Duration,
    /// Work that runs this long after it was found stuck is lost.
    pub lost: Duration,
}

impl Default for Ceilings {
    fn default() -> Self {
        Self { time: None, memory_bytes: None, stuck: Duration::from_secs(10), lost: Duration::from_secs(50) }
    }
}

/// State of the work that was asked to stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Work {
    Stops,
    /// Some goes on in this stage.
    Stuck {
        stage: &'static str,
    },
    /// Some went on for so long that it will not stop. Only the end of the process ends it.
    Lost {
        stage: &'static str,
    },
}

/// How often work is looked at.
const CHECK_PERIOD: Duration = Duration::from_millis(50);

/// See the module's head. Clones share one thread, which ends with the last of them.
#[derive(Clone, Debug)]
pub(crate) struct Watchdog {
    shared: Arc<Shared>,
}

#[derive(Debug)]
struct Shared {
    ceilings: Ceilings,
    /// Bytes that the process holds for others: uploads, and answers that wait.
    besides: Arc<AtomicI64>,
    state: Mutex<State>,
    wake: Condvar,
    work: watch::Sender<Work>,
}

#[derive(Debug, Default)]
struct State {
    entries: Vec<Entry>,
    next: u64,
    ended: bool,
}

#[derive(Debug)]
struct Entry {
    number: u64,
    token: Token,
    /// What the process held when it began.
    base_bytes: u64,
    /// When it was first seen to go on after it was asked to stop.
    stopped: Option<Instant>,
    reported: bool,
}

/// Work that is being watched, until this is dropped. The token's clock runs as long.
#[derive(Debug)]
pub struct WatchGuard {
    shared: Arc<Shared>,
    number: u64,
    token: Token,
}

impl Drop for WatchGuard {
    fn drop(&mut self) {
        self.token.pause();
        let mut state = lock(&self.shared.state);
        state.entries.retain(|entry| entry.number != self.number);
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        lock(&self.state).ended = true;
        self.wake.notify_all();
    }
}

impl Watchdog {
    pub(crate) fn start(ceilings: Ceilings) -> std::io::Result<Self> {
        let work = watch::Sender::new(Work::Stops);
        let shared =
            Arc::new(Shared { ceilings, besides: Arc::default(), state: Mutex::default(), wake: Condvar::new(), work });
        let weak = Arc::downgrade(&shared);
        std::thread::Builder::new().name("watchdog".to_owned()).spawn(move || watch_all(&weak))?;
        Ok(Self { shared })
    }

    /// A token for a job, with the ceiling on its time, or `limit` if that is less. Its clock stands until the job is
    /// watched.
    pub(crate) fn token(&self, limit: Option<Duration>) -> Token {
        let token = Token::default();
        if let Some(limit) = [self.shared.ceilings.time, limit].into_iter().flatten().min() {
            token.limit_time(limit);
        }
        token
    }

    pub(crate) fn watch(&self, token: &Token) -> WatchGuard {
        let base_bytes = held_for_work(&self.shared.besides);
        let mut state = lock(&self.shared.state);
        let number = state.next;
        state.next += 1;
        state.entries.push(Entry { number, token: token.clone(), base_bytes, stopped: None, reported: false });
        drop(state);
        self.shared.wake.notify_all();
        token.resume();
        WatchGuard { shared: Arc::clone(&self.shared), number, token: token.clone() }
    }

    pub(crate) fn memory_outside_jobs(&self) -> Arc<AtomicI64> {
        Arc::clone(&self.shared.besides)
    }

    pub(crate) fn work(&self) -> watch::Receiver<Work> {
        self.shared.work.subscribe()
    }
}

/// Bytes that the process holds, less those for others.
fn held_for_work(besides: &AtomicI64) -> u64 {
    let besides = u64::try_from(besides.load(Ordering::Acquire)).unwrap_or(0);
    memory::memory_bytes().unwrap_or(0).saturating_sub(besides)
}

/// Looks again and again until the last handle has gone.
fn watch_all(shared: &Weak<Shared>) {
    while let Some(shared) = shared.upgrade() {
        let state = lock(&shared.state);
        if state.ended {
            return;
        }
        let idle = state.entries.is_empty();
        // Never for ever: this handle keeps the others' end from being seen.
        let patience = if idle { 10 * CHECK_PERIOD } else { CHECK_PERIOD };
        let (mut state, _) = shared.wake.wait_timeout(state, patience).unwrap_or_else(PoisonError::into_inner);
        let work = look(&mut state.entries, &shared.ceilings, &shared.besides);
        drop(state);
        shared.work.send_if_modified(|before| std::mem::replace(before, work) != work);
    }
}

fn look(entries: &mut [Entry], ceilings: &Ceilings, besides: &AtomicI64) -> Work {
    if let Some(limit_bytes) = ceilings.memory_bytes.filter(|_| !entries.is_empty()) {
        let held = held_for_work(besides);
        let grown = |entry: &Entry| held.saturating_sub(entry.base_bytes);
        let running = entries.iter().filter(|entry| !entry.token.is_told_to_stop());
        let most = running.max_by_key(|entry| (grown(entry), entry.number));
        if let Some(entry) = most.filter(|entry| grown(entry) > limit_bytes) {
            let used_bytes = grown(entry);
            tracing::warn!(stage = entry.token.stage(), used_bytes, limit_bytes, "a job reached its ceiling on memory");
            entry.token.stop(Stopped::Memory { used_bytes, limit_bytes });
        }
    }
    let mut work = Work::Stops;
    for entry in entries.iter_mut().filter(|entry| entry.token.is_told_to_stop()) {
        let (stage, since) = (entry.token.stage(), entry.stopped.get_or_insert_with(Instant::now).elapsed());
        if since < ceilings.stuck {
            continue;
        }
        if !std::mem::replace(&mut entry.reported, true) {
            let (seconds, silent_s) = (since.as_secs_f64(), entry.token.silent_for().as_secs_f64());
            tracing::error!(stage, seconds, silent_s, "work goes on although it was asked to stop");
        }
        let is_lost = since >= ceilings.stuck + ceilings.lost;
        work = match work {
            Work::Lost { .. } => work,
            _ if is_lost => Work::Lost { stage },
            _ => Work::Stuck { stage },
        };
    }
    work
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ceilings(ms: u64) -> Ceilings {
        Ceilings { stuck: Duration::from_millis(ms), lost: Duration::from_millis(ms), ..Ceilings::default() }
    }

    #[tokio::test]
    async fn work_that_does_not_stop_is_told_and_what_recovers_is_fine_again() {
        let watchdog = Watchdog::start(ceilings(100)).unwrap();
        let mut work = watchdog.work();
        let token = watchdog.token(None);
        token.enter("a stage");
        let watched = watchdog.watch(&token);
        tokio::time::sleep(Duration::from_millis(300)).await;
        assert_eq!(*work.borrow_and_update(), Work::Stops, "nobody told it to stop");
        token.cancel();
        let limit = Duration::from_secs(20);
        let is = |wanted: Work| move |work: &Work| *work == wanted;
        // A busy machine may look when the work counts as lost already.
        tokio::time::timeout(limit, work.wait_for(is(Work::Lost { stage: "a stage" }))).await.unwrap().unwrap();
        drop(watched);
        tokio::time::timeout(limit, work.wait_for(is(Work::Stops))).await.unwrap().unwrap();
    }

    #[test]
    fn work_is_stuck_before_it_is_lost() {
        let token = Token::default();
        token.enter("a stage");
        token.cancel();
        let seconds = Duration::from_secs;
        let limits = Ceilings { stuck: seconds(100), lost: seconds(200), ..Ceilings::default() };
        let mut entries = [Entry { number: 0, token, base_bytes: 0, stopped: None, reported: false }];
        let stage = "a stage";
        for (since, wanted) in [(50, Work::Stops), (200, Work::Stuck { stage }), (400, Work::Lost { stage })] {
            entries[0].stopped = Instant::now().checked_sub(seconds(since));
            assert_eq!(look(&mut entries, &limits, &AtomicI64::new(0)), wanted, "{since}");
        }
    }

    #[test]
    fn memory_is_bounded() {
        let Some(held) = memory::memory_bytes() else { return };
        let limits = Ceilings { memory_bytes: Some(1000), ..Ceilings::default() };
        let entry =
            |number, base_bytes| Entry { number, token: Token::default(), base_bytes, stopped: None, reported: false };
        let mut entries = vec![entry(0, held + (1 << 40)), entry(1, 0), entry(2, 1)];
        // Memory that is held for others is no growth of a job.
        let others = AtomicI64::new(held as i64 + (1 << 40));
        look(&mut entries, &limits, &others);
        assert!(entries.iter().all(|entry| !entry.token.is_stopped()));
        let besides = AtomicI64::new(0);
        look(&mut entries, &limits, &besides);
        assert!(
            matches!(entries[1].token.check(), Err(Stopped::Memory { limit_bytes: 1000, .. })),
            "it has grown most"
        );
        assert_eq!(entries[2].token.check(), Ok(()), "one at a time");
        look(&mut entries, &limits, &besides);
        assert!(entries[2].token.is_stopped() && !entries[0].token.is_stopped());
    }

    #[test]
    fn clocks_stand_while_nobody_works() {
        let limits = Ceilings { time: Some(Duration::from_millis(200)), ..Ceilings::default() };
        let watchdog = Watchdog::start(limits).unwrap();
        let token = watchdog.token(None);
        std::thread::sleep(Duration::from_millis(300));
        drop(watchdog.watch(&token));
        assert!(!token.is_stopped(), "it waited");
        let _watched = watchdog.watch(&token);
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(token.check(), Err(Stopped::Time { limit: Duration::from_millis(200) }));
    }
}
