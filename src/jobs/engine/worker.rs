//! The host threads that do the work.
//!
//! Purpose: work on a bounded number of OS threads. A job stays on one of them; the device is shared by the pass
//! ([`gate`](super::gate)). [`Call`] is a piece of work from its submission to its answer. Invariant: a lost device is
//! replaced once, by the first thread that finds it lost, before the next piece. A piece that can be begun anew waits for
//! the new device; this is the one place that counts its attempts. Work that was promised to a device goes to the CPU only
//! by [`LossPolicy`]. A call is answered exactly once or its caller has gone; a panic is an answer; what the work holds
//! goes before the answer. Must not know: what a piece computes.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, OnceLock, PoisonError, RwLock};
use std::thread::Builder;
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};

use crate::beside::Beside;
use crate::engine::gate::{Gate, TOKEN_POLL};
use crate::engine::pools::Pools;
use crate::engine::queue::{Dequeued, Item, Lane, Popped, Queue};
use crate::engine::schedule::{MOST_SUSPENDED, Slots, Weights};
use crate::engine::watchdog::{Ceilings, Watchdog};
use crate::observe::activity::{Activity, Observer, QueuedActivity};
use crate::record::Bytes;
use crate::{Backends, JobError, lock};
use geometry::rvd::{BackendChoice, BackendKind};
use geometry::token::{StageListener, Token};

#[derive(Clone, Copy, Debug)]
pub struct EngineOptions {
    /// New jobs that may wait, at least 1.
    pub queue_jobs: usize,
    /// Time until a lost device is tried again without work for it.
    pub revive: Duration,
    /// What a job may take. The ceiling on memory is also what jobs at work together may need.
    pub ceilings: Ceilings,
    /// Device memory that jobs at work together may need, bytes; without, as much as the device gives.
    pub device_memory_bytes: Option<u64>,
    /// What to do if a lost device does not return within `loss_patience`.
    pub loss: LossPolicy,
    /// How long to wait for a lost device; its work waits too.
    pub loss_patience: Duration,
    /// Jobs at work at once, at least 1; one more of a tenant that has none at work.
    pub jobs_at_once: usize,
    /// How far threads at work give way to others, 0 to 19, where the system knows that: what answers calls then need not wait
    /// for what computes.
    pub nice: u8,
}

impl Default for EngineOptions {
    fn default() -> Self {
        Self {
            queue_jobs: 32,
            revive: Duration::from_secs(5),
            ceilings: Ceilings::default(),
            device_memory_bytes: None,
            loss: LossPolicy::default(),
            loss_patience: Duration::from_secs(30),
            jobs_at_once: jobs_at_once(),
            nice: 0,
        }
    }
}

/// What an engine does whose device does not come back in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LossPolicy {
    /// Tries again, for ever. Work that needs the device is refused after the time.
    #[default]
    Wait,
    /// Ends, so that its process can be started anew.
    End,
    /// Lets the CPU do the work from then on.
    Cpu,
}

impl Backends {
    /// The same without the GPU: [`BackendChoice::Auto`] means the CPU.
    fn without_gpu(&self) -> Self {
        let reason =
            "the device was lost and did not come back; the CPU does its work until the server is started anew";
        let default = match self.default {
            BackendChoice::Only(BackendKind::Gpu) => BackendChoice::Auto,
            other => other,
        };
        Self { gpu: Err(reason.to_owned()), default, ..self.clone() }
    }
}

/// As many jobs at once as there are quarters of the processor's cores, but 2 to 8: a job keeps about four cores busy in all
/// of its stages, and two let the host's stages of one pass while the device works for the other.
pub(crate) fn jobs_at_once() -> usize {
    std::thread::available_parallelism().map_or(2, |cores| (cores.get() / 4).clamp(2, 8))
}

const SHORT_WORKERS: usize = 2;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    Ready,
    /// Lost; being made anew.
    Lost,
    /// It did not come back, and the CPU does its work.
    Replaced,
    /// It did not come back, and the engine is to end.
    Missing,
    Gone,
}

pub(super) struct Shared {
    pub(super) observer: Arc<dyn Observer>,
    pub(super) watchdog: Watchdog,
    pub(super) queue: Queue<Box<dyn Task>>,
    pub(super) pool: Option<Arc<rayon::ThreadPool>>,
    pub(super) slots: Slots,
    pub(super) device: watch::Sender<Device>,
    gate: Arc<Gate>,
    pools: Pools,
    pub(super) weights: Weights,
    /// Rises with every replacement of what it stands beside.
    current: RwLock<(u64, Backends)>,
    factory: Mutex<BackendFactory>,
    revive: Duration,
    loss: LossPolicy,
    loss_patience: Duration,
    pub(super) losses: AtomicU64,
    /// Counts the work of streams, if a store wants to know of it.
    pub(super) beside: OnceLock<Beside>,
}

struct BackendFactory {
    make: Box<dyn FnMut() -> Result<Backends, JobError> + Send>,
    tried: Instant,
    outage: Option<Instant>,
}

impl BackendFactory {
    fn make(&mut self) -> Result<Backends, JobError> {
        self.tried = Instant::now();
        catch_unwind(AssertUnwindSafe(&mut self.make))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref()))))
    }
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (waiting, running) = self.queue.load();
        f.debug_struct("Engine").field("waiting", &waiting).field("running", &running).finish_non_exhaustive()
    }
}

/// Lowers the priority of this thread and of those that it starts.
fn lower_priority(nice: u8) {
    #[cfg(unix)]
    if nice > 0
        && let Err(error) = rustix::process::nice(nice.into())
    {
        tracing::warn!(%error, nice, "threads at work do not give way to others");
    }
    #[cfg(not(unix))]
    let _ = nice;
}

/// The engine's own thread: starts the others, and waits for their end.
pub(super) fn run(
    factory: Box<dyn FnMut() -> Result<Backends, JobError> + Send>,
    options: EngineOptions,
    observer: Arc<dyn Observer>,
    ready: &SyncSender<Result<Arc<Shared>, JobError>>,
) {
    lower_priority(options.nice);
    let shared = match Shared::new(factory, options, observer) {
        Ok(shared) => Arc::new(shared),
        Err(error) => {
            let _ = ready.send(Err(error));
            return;
        }
    };
    let _end = EndOnDrop(&shared);
    std::thread::scope(|scope| {
        // One for each job that may have begun, and one that looks for the next.
        let jobs = (0..=shared.slots.regular + 1 + MOST_SUSPENDED).map(|i| (Lane::Jobs, format!("job-{i}")));
        let short = (0..SHORT_WORKERS).map(|i| (Lane::Short, format!("short-{i}")));
        for (lane, name) in jobs.chain(short) {
            let shared = &*shared;
            let started = Builder::new().name(name).spawn_scoped(scope, move || shared.work_in(lane));
            if let Err(error) = started {
                // Those that were started end.
                shared.queue.end();
                let _ = ready.send(Err(JobError::Panicked(format!("a host thread could not be started: {error}"))));
                return;
            }
        }
        if ready.send(Ok(Arc::clone(&shared))).is_err() {
            shared.queue.end();
        }
    });
}

impl Shared {
    fn new(
        factory: Box<dyn FnMut() -> Result<Backends, JobError> + Send>,
        options: EngineOptions,
        observer: Arc<dyn Observer>,
    ) -> Result<Self, JobError> {
        let mut factory = BackendFactory { make: factory, tried: Instant::now(), outage: None };
        let backends = factory.make()?;
        let watchdog = Watchdog::start(options.ceilings)
            .map_err(|error| JobError::Panicked(format!("the watchdog could not be started: {error}")))?;
        let memory = Bytes {
            host: options.ceilings.memory_bytes.unwrap_or(u64::MAX),
            device: options.device_memory_bytes.unwrap_or(u64::MAX),
        };
        let slots = Slots { regular: options.jobs_at_once.max(1), memory };
        Ok(Self {
            weights: Weights::default(),
            observer,
            watchdog,
            queue: Queue::new(options.queue_jobs.max(1), slots),
            pool: backends.parallel.pool(),
            slots,
            device: watch::Sender::new(Device::Ready),
            gate: Arc::default(),
            pools: Pools::new(&backends, slots.regular),
            current: RwLock::new((0, backends)),
            factory: Mutex::new(factory),
            revive: options.revive,
            loss: options.loss,
            loss_patience: options.loss_patience,
            losses: AtomicU64::new(0),
            beside: OnceLock::new(),
        })
    }

    /// The backends now, and how often they were replaced before.
    pub(super) fn current(&self) -> (u64, Backends) {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn work_in(&self, lane: Lane) {
        let _end = EndOnPanic(self);
        loop {
            let lost = *self.device.borrow() == Device::Lost;
            match self.queue.pop(lane, lost.then_some(self.revive)) {
                Popped::Item(taken) => self.work(taken),
                Popped::Nothing => self.replace(self.current().0, self.revive),
                Popped::Closed => return,
            }
        }
    }

    fn work(&self, taken: Dequeued<Box<dyn Task>>) {
        // The first local, and so dropped last: after the state that the answer did not take along.
        let _done = DoneOnDrop { queue: &self.queue, number: taken.number, start: Instant::now() };
        let Dequeued { item: mut task, is_alone, .. } = taken;
        let watched = self.watchdog.watch(task.token());
        let threads = if task.has_continuations() { None } else { Some(self.pools.take(is_alone)) };
        // Threads that other jobs share must not wait for this one.
        if threads.as_ref().is_some_and(|threads| threads.is_own()) {
            self.queue.set_preemptible(taken.number);
        }
        let mut attempts = 0;
        loop {
            let (generation, backends) = self.current();
            let backends = backends.for_job(&self.gate, threads.as_deref(), &task.begin());
            if task.run(&backends, attempts) == Outcome::Answered {
                break;
            }
            attempts += 1;
            self.restore(generation, &task);
            // One that was stopped meanwhile begins once more, and says so itself.
            if !task.is_wanted() {
                break;
            }
        }
        drop((task, threads, watched));
    }

    /// Sees to it that there is a device again, and waits for it unless the work is stopped.
    fn restore(&self, generation: u64, task: &dyn Item) {
        let end = Instant::now() + self.loss_patience;
        let mut pause = Duration::ZERO;
        loop {
            self.replace(generation, pause);
            let is_lost = *self.device.borrow() == Device::Lost && self.current().0 == generation;
            if !is_lost || !task.is_wanted() || task.token().is_stopped() || Instant::now() >= end {
                return;
            }
            pause = self.revive;
            std::thread::sleep(TOKEN_POLL);
        }
    }

    /// Makes new backends after a loss, unless another thread did, or tried less than `pause` ago. Until then the old ones
    /// stay and answer with errors: work that was promised to a GPU does not go to a CPU silently.
    fn replace(&self, generation: u64, pause: Duration) {
        let mut factory = lock(&self.factory);
        let (now, old) = self.current();
        if now != generation || (!pause.is_zero() && factory.tried.elapsed() < pause) {
            return;
        }
        let before = *self.device.borrow();
        match before {
            Device::Ready | Device::Replaced => {
                self.losses.fetch_add(1, Ordering::Relaxed);
                self.observer.lost_device();
                self.device.send_replace(Device::Lost);
            }
            Device::Lost => {}
            // Given up.
            Device::Missing | Device::Gone => return,
        }
        tracing::warn!("the device was lost; making it anew");
        let install = |new, state| {
            *self.current.write().unwrap_or_else(PoisonError::into_inner) = (generation + 1, new);
            self.device.send_replace(state);
        };
        match factory.make() {
            Ok(new) if new.gpu.is_err() && old.gpu.is_ok() => {
                tracing::error!(reason = new.gpu.err(), "the GPU did not come back");
            }
            Ok(new) => {
                factory.outage = None;
                install(new, Device::Ready);
                tracing::info!("the device is there again");
                return;
            }
            Err(error) => tracing::error!(%error, "the device could not be made anew"),
        }
        if factory.outage.get_or_insert_with(Instant::now).elapsed() < self.loss_patience {
            return;
        }
        match self.loss {
            LossPolicy::Wait => {}
            LossPolicy::End => drop(self.device.send_replace(Device::Missing)),
            LossPolicy::Cpu => {
                tracing::error!("the device did not come back; the CPU does its work from now on");
                install(old.without_gpu(), Device::Replaced);
            }
        }
    }
}

/// Takes an item out of those at work, also if a destructor of its work panics.
struct DoneOnDrop<'a> {
    queue: &'a Queue<Box<dyn Task>>,
    number: u64,
    start: Instant,
}

impl Drop for DoneOnDrop<'_> {
    fn drop(&mut self) {
        self.queue.done(self.number, self.start.elapsed());
    }
}

/// Answers all callers at the end of the engine, whatever ends it.
struct EndOnDrop<'a>(&'a Shared);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.queue.end();
        self.0.device.send_replace(Device::Gone);
    }
}

/// A host thread that panics, in a destructor, ends the engine, so that callers of its work get an answer.
struct EndOnPanic<'a>(&'a Shared);

impl Drop for EndOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.queue.end();
            self.0.queue.cancel_all();
            self.0.device.send_replace(Device::Gone);
        }
    }
}

/// Attempts after a lost device, the first included.
const ATTEMPTS: usize = 3;

/// Whether a piece may be begun anew after the device was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retry {
    /// From its beginning: its state is made inside.
    Restart,
    /// Its state was on the lost device.
    Never,
}

#[derive(Clone, Debug)]
pub struct WorkContext {
    /// Set when the caller has gone or the process must end.
    pub token: Token,
    pub queue_ms: f64,
    /// Whether it is begun anew if the device is lost.
    pub(crate) may_retry: bool,
    pub activity: Arc<Activity>,
}

#[derive(Clone, Debug)]
pub struct Timed<R> {
    pub value: R,
    pub queue_ms: f64,
    pub compute_ms: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Outcome {
    Answered,
    DeviceLost,
}

pub(super) trait Task: Item {
    /// It is being done from now on.
    fn begin(&mut self) -> Arc<Activity>;
    fn run(&mut self, backends: &Backends, attempt: usize) -> Outcome;
    fn has_continuations(&self) -> bool;
}

impl Item for Box<dyn Task> {
    fn is_wanted(&self) -> bool {
        (**self).is_wanted()
    }

    fn token(&self) -> &Token {
        (**self).token()
    }
}

pub(super) type Reply<R> = oneshot::Sender<Result<Timed<R>, JobError>>;

pub(super) struct Call<R, F> {
    pub(super) work: Option<F>,
    /// Whether later pieces continue what it makes, so that it must not hold threads that are another job's then.
    pub has_continuations: bool,
    /// `None` once it is answered, and for a job of a store, which has its answer.
    pub(super) reply: Option<Reply<R>>,
    pub token: Token,
    pub(super) queued: Instant,
    pub(super) retry: Retry,
    pub(super) activity: ActivityState,
}

pub(super) enum ActivityState {
    Queued(QueuedActivity),
    Running(Arc<Activity>),
    /// Between the two.
    Starting,
}

impl<R: Send, F: Send> Item for Call<R, F> {
    fn is_wanted(&self) -> bool {
        let has_begun = matches!(self.activity, ActivityState::Running(_));
        match &self.reply {
            Some(reply) => !reply.is_closed(),
            // Once it has begun, it records itself how it ends.
            None => self.work.is_some() && (has_begun || !self.token.is_told_to_stop()),
        }
    }

    fn token(&self) -> &Token {
        &self.token
    }
}

impl<R: Send, F: FnMut(&Backends, &WorkContext) -> Result<R, JobError> + Send> Task for Call<R, F> {
    fn has_continuations(&self) -> bool {
        self.has_continuations
    }

    fn begin(&mut self) -> Arc<Activity> {
        let activity = match std::mem::replace(&mut self.activity, ActivityState::Starting) {
            ActivityState::Queued(waiting) => waiting.begin(),
            ActivityState::Running(activity) => activity,
            ActivityState::Starting => QueuedActivity::new(&(Arc::new(()) as Arc<dyn Observer>), None).begin(),
        };
        self.activity = ActivityState::Running(Arc::clone(&activity));
        activity
    }

    fn run(&mut self, backends: &Backends, attempt: usize) -> Outcome {
        let activity = self.begin();
        let queue_ms = ms(self.queued.elapsed());
        let start = Instant::now();
        let may_retry = self.retry == Retry::Restart && attempt + 1 < ATTEMPTS;
        let context = WorkContext { token: self.token.clone(), queue_ms, may_retry, activity: Arc::clone(&activity) };
        let Some(work) = self.work.as_mut() else { return Outcome::Answered };
        self.token.tell_stages(Some(Arc::clone(&activity) as Arc<dyn StageListener>));
        let result = catch_unwind(AssertUnwindSafe(|| activity.span().in_scope(|| work(backends, &context))))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref()))));
        self.token.tell_stages(None);
        let lost = result.as_ref().is_err_and(JobError::is_device_lost);
        if lost && may_retry {
            return Outcome::DeviceLost;
        }
        let result = result.map(|value| Timed { value, queue_ms, compute_ms: ms(start.elapsed()) });
        // What the work still holds goes before the answer: the caller may ask for its memory at once.
        self.work = None;
        // The count too: the caller may read it after the answer.
        activity.end(result.as_ref().err());
        if let Some(reply) = self.reply.take() {
            let _ = reply.send(result);
        }
        if lost { Outcome::DeviceLost } else { Outcome::Answered }
    }
}

pub(super) fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

pub(crate) fn text(panic: &(dyn Any + Send)) -> String {
    let message = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    message.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "(no message)".to_owned())
}
