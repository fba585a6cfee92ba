//! The clients of a load.
//!
//! Purpose: a closed loop of clients that ask again after each answer, an open loop that sends by the plan whatever the
//! server does, slow readers beside either; and what is left of calls is cleared away.
//! Invariant: a call that cannot be sent is counted. The run ends within the time of a call after its last one began, and
//! sooner if it is stopped. Must not know: what is in a call, how figures are shown.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{Semaphore, mpsc, watch};
use tokio::task::JoinSet;
use tokio::time::Instant;

use super::LoadArgs;
use super::amounts::{Arrivals, Item, Items};
use super::calls::{Asked, Caller, Outcome, Rubbish, sweep};
use super::measure::{Measure, When};
use super::report::View;
use crate::remote::Door;
use jobs::lock;

pub(super) struct Doors {
    pub(super) usual: Vec<Door>,
    /// Of slow readers, whose windows are narrow.
    pub(super) slow: Vec<Door>,
}

/// The first pause after a failure, and the longest.
const PAUSES: (Duration, Duration) = (Duration::from_millis(100), Duration::from_secs(2));
const REFUSED: Duration = Duration::from_secs(60);
/// Sender of the open loop; clients come after it.
const OPEN: u64 = 0;
const SLOW: u64 = 1 << 32;
/// How many remove what is left at once, and how long they have at the end.
const CLEANERS: usize = 8;
const CLEANING: Duration = Duration::from_secs(60);

pub(super) struct Run {
    caller: Arc<Caller>,
    doors: Doors,
    args: Arc<LoadArgs>,
    measure: Mutex<Measure>,
    open: AtomicU64,
    start: Instant,
    stop: watch::Receiver<bool>,
    rubbish: Option<mpsc::Sender<(Rubbish, Door, bool)>>,
}

pub(super) struct Ran {
    pub(super) measure: Measure,
    /// Jobs and blobs that could not be removed.
    pub(super) left: u64,
    /// Whether it was stopped before its end.
    pub(super) stopped: bool,
}

/// Makes the calls; with `keep`, leaves their jobs and blobs at the server.
pub(super) async fn run(caller: Arc<Caller>, doors: Doors, args: Arc<LoadArgs>, view: View) -> Ran {
    let stop = caller.stop.clone();
    let (sender, receiver) = mpsc::channel(1024);
    let cleaner = (!args.keep).then(|| tokio::spawn(clean(Arc::clone(&caller), receiver)));
    let rubbish = cleaner.as_ref().map(|_| sender);
    let swept = !args.keep && args.mix.parts().any(|(kind, _)| kind.is_job());
    let sweeps = if swept { doors.usual.clone() } else { Vec::new() };
    let measure = Mutex::new(Measure::new(args.window()));
    let (open, start) = (AtomicU64::new(0), Instant::now());
    let run = Arc::new(Run { caller: Arc::clone(&caller), doors, args, measure, open, start, stop, rubbish });
    let shown = tokio::spawn(show(Arc::clone(&run), view));
    run.calls().await;
    shown.abort();
    let _ = shown.await;
    let stopped = *run.stop.borrow();
    let measure = {
        let mut measure = lock(&run.measure);
        measure.turn(run.start.elapsed());
        measure.clone()
    };
    // Its sender goes with it, and so the cleaner ends.
    drop(run);
    let cleaned = tokio::time::timeout(CLEANING, async {
        let mut left = match cleaner {
            Some(cleaner) => cleaner.await.unwrap_or(1),
            None => 0,
        };
        for door in &sweeps {
            left += sweep(&caller.tally, door, &caller.run).await;
        }
        left
    });
    let left = cleaned.await.unwrap_or(1);
    Ran { measure, left, stopped }
}

/// Removes what calls left; how many blobs could not be. Jobs that could not are found by the sweep.
async fn clean(caller: Arc<Caller>, mut receiver: mpsc::Receiver<(Rubbish, Door, bool)>) -> u64 {
    let (places, left) = (Arc::new(Semaphore::new(CLEANERS)), Arc::new(AtomicU64::new(0)));
    while let Some((rubbish, door, ended)) = receiver.recv().await {
        let Ok(place) = Arc::clone(&places).acquire_owned().await else { break };
        let (caller, left) = (Arc::clone(&caller), Arc::clone(&left));
        tokio::spawn(async move {
            let (_, blobs) = rubbish.remove(&caller.tally, &door, ended).await;
            left.fetch_add(blobs, Ordering::Relaxed);
            drop(place);
        });
    }
    let _ = places.acquire_many(CLEANERS as u32).await;
    left.load(Ordering::Relaxed)
}

async fn show(run: Arc<Run>, view: View) {
    let mut tick = tokio::time::interval(View::EVERY);
    loop {
        tick.tick().await;
        let elapsed = run.start.elapsed();
        let mut measure = lock(&run.measure);
        measure.turn(elapsed);
        view.draw(&measure, elapsed, run.open.load(Ordering::Relaxed));
    }
}

impl Run {
    fn is_stopped(&self) -> bool {
        *self.stop.borrow()
    }

    /// When no more calls begin.
    fn end(&self) -> Duration {
        self.args.window().end
    }

    async fn calls(self: &Arc<Self>) {
        let mut clients = JoinSet::new();
        if self.args.rate.is_none() {
            let count = self.args.clients.unwrap_or(1);
            for k in 0..u64::from(count) {
                let begin = self.args.ramp_s.mul_f64(k as f64 / f64::from(count));
                clients.spawn(Arc::clone(self).client(1 + k, begin, None));
            }
        }
        for k in 0..u64::from(self.args.slow_readers) {
            clients.spawn(Arc::clone(self).client(SLOW + k, Duration::ZERO, Some(self.args.slow_rate.into())));
        }
        if let Some(rate) = self.args.rate {
            self.arrivals(rate).await;
        }
        while clients.join_next().await.is_some() {}
        if self.is_stopped() {
            lock(&self.measure).cut(self.start.elapsed());
        }
    }

    async fn arrivals(self: &Arc<Self>, rate: f64) {
        let LoadArgs { mix, cancel, ramp_s, seed, max_in_flight, .. } = &*self.args;
        let arrivals = Arrivals::new(rate, *ramp_s, *seed);
        let mut items = Items::new(mix.clone(), self.caller.surfaces.len(), *cancel / 100.0, *seed, OPEN);
        let places = Arc::new(Semaphore::new(*max_in_flight as usize));
        let end = self.end();
        for (intended, number) in arrivals.take_while(|at| *at < end).zip(0..) {
            let item = items.take();
            if !self.wait_until(self.start + intended).await {
                break;
            }
            let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
                lock(&self.measure).dropped(intended);
                continue;
            };
            let Some(door) = door(&self.doors.usual, number) else { return };
            let run = Arc::clone(self);
            tokio::spawn(async move {
                run.one(intended, item, &door, None).await;
                drop(place);
            });
        }
        // All that are open.
        let _ = places.acquire_many(*max_in_flight).await;
    }

    /// A client that asks, waits for the end and asks again.
    async fn client(self: Arc<Self>, number: u64, begin: Duration, slow: Option<u64>) {
        let LoadArgs { mix, cancel, seed, .. } = &*self.args;
        let (doors, mix, cancel) = match slow {
            None => (&self.doors.usual, Some(mix.clone()), *cancel / 100.0),
            // There is nothing to read of what brings no result.
            Some(_) => (&self.doors.slow, mix.only_those(super::amounts::Kind::is_work), 0.0),
        };
        let (Some(mix), Some(door)) = (mix, door(doors, number)) else { return };
        let mut items = Items::new(mix, self.caller.surfaces.len(), cancel, *seed, number);
        let mut pause = PAUSES.0;
        if !self.wait_until(self.start + begin).await {
            return;
        }
        loop {
            let intended = self.start.elapsed();
            if intended >= self.end() || self.is_stopped() {
                return;
            }
            let wait = match self.one(intended, items.take(), &door, slow).await {
                Outcome::Done | Outcome::Cancelled => {
                    pause = PAUSES.0;
                    continue;
                }
                Outcome::Refused { after, .. } => after.min(REFUSED),
                Outcome::Failed { .. } => {
                    let wait = pause;
                    pause = PAUSES.1.min(2 * pause);
                    wait
                }
                Outcome::Stopped => return,
            };
            if !self.wait_until((Instant::now() + wait).min(self.start + self.end())).await {
                return;
            }
        }
    }

    async fn one(&self, intended: Duration, item: Item, door: &Door, pace: Option<u64>) -> Outcome {
        let sent = self.start.elapsed();
        self.open.fetch_add(1, Ordering::Relaxed);
        let asked = self.caller.ask(door, item, pace).await;
        self.open.fetch_sub(1, Ordering::Relaxed);
        let when = When { kind: item.kind, slow: pace.is_some(), intended, sent, ended: self.start.elapsed() };
        lock(&self.measure).over(&when, &asked);
        let Asked { outcome, rubbish, .. } = asked;
        if let Some((sender, rubbish)) = self.rubbish.as_ref().zip(rubbish) {
            let _ = sender.send((rubbish, door.clone(), is_at_end(&outcome))).await;
        }
        outcome
    }

    /// Waits. False if the run is stopped meanwhile.
    async fn wait_until(&self, at: Instant) -> bool {
        let mut stop = self.stop.clone();
        tokio::select! {
            biased;
            Ok(_) = stop.wait_for(|stop| *stop) => false,
            () = tokio::time::sleep_until(at) => true,
        }
    }
}

/// Whether a call ended together with its job.
fn is_at_end(outcome: &Outcome) -> bool {
    match outcome {
        Outcome::Done | Outcome::Cancelled => true,
        Outcome::Failed { code, .. } => code.starts_with("JOB_"),
        Outcome::Refused { .. } | Outcome::Stopped => false,
    }
}

/// The channel for the client or call of this number.
fn door(doors: &[Door], number: u64) -> Option<Door> {
    doors.get((number % doors.len().max(1) as u64) as usize).cloned()
}
