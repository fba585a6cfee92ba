//! The host threads that do the work, and the handle to them.
//!
//! Purpose: [`Engine::submit`] from any task, work on a bounded number of OS threads, an answer with times. A job stays on
//! one of them; the device is shared by the pass ([`gate`](super::gate)).
//! Invariant: a lost device is replaced once, by whoever finds it lost, before the next piece; a piece that can be begun
//! anew waits for the new device and is tried up to three times. Must not know: what a piece computes.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};

use super::bytes::Bytes;
use super::gate::Gate;
use super::loss::{Absence, LossPolicy};
use super::observer::{Observer, Told, Waiting};
use super::pools::Pools;
use super::queue::{Item, Lane, Place, Popped, Queue, Taken};
use super::schedule::Slots;
use super::watchdog::{Ceilings, Watchdog, Watched, Work};
use super::weights::Weights;
use super::{BackendInfo, Backends, JobError, Wish};
use crate::rvd::DeviceFacts;
use crate::token::{StageListener, Token};

/// How the engine is set up.
#[derive(Clone, Copy, Debug)]
pub struct EngineOptions {
    /// New jobs that may wait, at least 1.
    pub queue_jobs: usize,
    /// How long until a lost device is tried again when nobody asks for it.
    pub revive: Duration,
    /// What a job may take. The ceiling on memory is also what jobs at work together may need.
    pub ceilings: Ceilings,
    /// Device memory that jobs at work together may need, bytes; without, as much as the device gives.
    pub device_memory_bytes: Option<u64>,
    /// What to do if a lost device does not come back
    pub loss: LossPolicy,
    /// in this time. Work that was at the device waits for it as long.
    pub loss_patience: Duration,
    /// Jobs at work at once, at least 1; one more of a tenant that has none at work.
    pub jobs_at_once: usize,
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
        }
    }
}

/// As many jobs at once as there are quarters of the processor's cores, but 2 to 8: a job keeps about four cores busy in all
/// of its stages, and two let the host's stages of one pass while the device works for the other.
pub(crate) fn jobs_at_once() -> usize {
    std::thread::available_parallelism().map_or(2, |cores| (cores.get() / 4).clamp(2, 8))
}

/// Between two looks at the token of work that waits for a device.
const LISTEN: Duration = Duration::from_millis(20);

/// Workers for short pieces.
const SHORT_WORKERS: usize = 2;

/// How the device is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    /// Ready.
    Ready,
    /// Lost; being made anew.
    Lost,
    /// It did not come back, and the CPU does its work.
    Replaced,
    /// It did not come back, and the engine is to end.
    Missing,
    /// The engine has ended.
    Gone,
}

/// Whether a piece may be begun anew after the device was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retry {
    /// Its state is made inside, so it can.
    Anew,
    /// Its state was on the lost device.
    Never,
}

/// What a piece of work sees besides the backends.
#[derive(Clone, Debug)]
pub struct Turn {
    /// Set when the caller has gone or the process must end.
    pub token: Token,
    /// Milliseconds the piece waited.
    pub queue_ms: f64,
    /// Is told of what is done.
    pub(crate) told: Arc<Told>,
}

/// An answer and what it took.
#[derive(Clone, Debug)]
pub struct Timed<R> {
    /// The answer.
    pub value: R,
    /// Milliseconds in the queue.
    pub queue_ms: f64,
    /// Milliseconds of work.
    pub compute_ms: f64,
}

/// Work that was submitted. Dropping it cancels the work.
#[derive(Debug)]
pub struct Pending<R> {
    /// How many were ahead of it.
    pub position: usize,
    reply: oneshot::Receiver<Result<Timed<R>, JobError>>,
    token: Token,
    answered: bool,
}

impl<R> Drop for Pending<R> {
    fn drop(&mut self) {
        // The token may be that of more work to come.
        if !self.answered {
            self.token.cancel();
        }
    }
}

impl<R> Pending<R> {
    /// The answer. Cancellation-safe: can be polled again after it lost a `select!`.
    ///
    /// # Errors
    /// The work's own, `Panicked`, `WorkerGone`.
    pub async fn wait(&mut self) -> Result<Timed<R>, JobError> {
        let answer = (&mut self.reply).await.unwrap_or(Err(JobError::WorkerGone));
        self.answered = true;
        answer
    }

    /// What stops it.
    pub fn token(&self) -> &Token {
        &self.token
    }
}

/// A place in the queue that is kept for a job while it is uploaded. Given back when dropped, which is after the job
/// was submitted as [`Place::Kept`].
#[derive(Debug)]
pub struct Ticket {
    shared: Arc<Shared>,
    number: u64,
}

impl Drop for Ticket {
    fn drop(&mut self) {
        self.shared.queue.give_back(self.number);
    }
}

struct Shared {
    observer: Arc<dyn Observer>,
    watchdog: Watchdog,
    queue: Queue<Box<dyn Task>>,
    infos: Infos,
    device: watch::Sender<Device>,
    gate: Arc<Gate>,
    pools: Pools,
    weights: Weights,
    /// Rises with every replacement of what it stands beside.
    current: RwLock<(u64, Backends)>,
    maker: Mutex<Maker>,
    revive: Duration,
    loss: LossPolicy,
    loss_patience: Duration,
    /// Devices that were lost so far.
    losses: AtomicU64,
}

/// Makes backends, now and after a loss.
struct Maker {
    factory: Box<dyn FnMut() -> Result<Backends, JobError> + Send>,
    tried: Instant,
    absence: Absence,
}

impl Maker {
    fn make(&mut self) -> Result<Backends, JobError> {
        self.tried = Instant::now();
        catch_unwind(AssertUnwindSafe(&mut self.factory))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref()))))
    }
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (waiting, running) = self.queue.load();
        f.debug_struct("Engine").field("waiting", &waiting).field("running", &running).finish_non_exhaustive()
    }
}

/// The handle. Clones share the threads.
#[derive(Clone, Debug)]
pub struct Engine {
    shared: Arc<Shared>,
}

impl Engine {
    /// Starts the host threads. `factory` makes their backends, now and after a loss. Returns once they are there; what is
    /// returned beside the handle ends when all threads have.
    ///
    /// # Errors
    /// The factory's, or `Panicked`.
    pub fn start(
        factory: impl FnMut() -> Result<Backends, JobError> + Send + 'static,
        options: EngineOptions,
    ) -> Result<(Self, JoinHandle<()>), JobError> {
        Self::start_observed(factory, options, Arc::new(()))
    }

    /// The same, with somebody who counts what is done.
    ///
    /// # Errors
    /// The factory's, or `Panicked`.
    pub(crate) fn start_observed(
        factory: impl FnMut() -> Result<Backends, JobError> + Send + 'static,
        options: EngineOptions,
        observer: Arc<dyn Observer>,
    ) -> Result<(Self, JoinHandle<()>), JobError> {
        let (ready, answer) = std::sync::mpsc::sync_channel(1);
        let thread = Builder::new()
            .name("engine".to_owned())
            .spawn(move || run(Box::new(factory), options, observer, &ready))
            .map_err(|e| JobError::Panicked(format!("the engine's thread could not be started: {e}")))?;
        let shared = answer.recv().unwrap_or(Err(JobError::WorkerGone))?;
        Ok((Self { shared }, thread))
    }

    /// Who will do the work for a wish.
    ///
    /// # Errors
    /// `BackendUnavailable`.
    pub fn backend(&self, wish: Wish) -> Result<BackendInfo, JobError> {
        self.shared.current().1.choose(wish).map(|backend| BackendInfo::of(backend.as_ref()))
    }

    /// Devices that were lost so far.
    pub fn losses(&self) -> u64 {
        self.shared.losses.load(Ordering::Relaxed)
    }

    /// Memory that jobs at work together may need.
    pub fn memory(&self) -> Bytes {
        self.shared.infos.slots.memory
    }

    /// Keeps a place for a job that is yet to be uploaded, so that it is refused now or not at all.
    ///
    /// # Errors
    /// `QueueFull`, `Draining`.
    pub fn reserve(&self) -> Result<Ticket, JobError> {
        let number = self.shared.queue.keep()?;
        Ok(Ticket { shared: Arc::clone(&self.shared), number })
    }

    /// A token for a job, whose ceiling on time counts what is done for it here and under [`Self::watch`].
    pub fn token(&self) -> Token {
        self.shared.watchdog.token(None)
    }

    /// The same for a job that is to take no longer than `limit`.
    pub(crate) fn token_within(&self, limit: Option<Duration>) -> Token {
        self.shared.watchdog.token(limit)
    }

    /// Watches work that is done for a job on another thread than a worker's, until what it returns is dropped.
    pub fn watch(&self, token: &Token) -> Watched {
        self.shared.watchdog.watch(token)
    }

    /// What the process holds that is no job's own work, bytes: whoever holds it keeps this at that. A job's ceiling on memory
    /// does not count it.
    pub(crate) fn held_besides(&self) -> Arc<AtomicI64> {
        self.shared.watchdog.held_besides()
    }

    /// How work is that was told to stop.
    pub fn watch_work(&self) -> watch::Receiver<Work> {
        self.shared.watchdog.work()
    }

    /// Does work on the engine's threads, so that their number bounds what is done beside the jobs too.
    pub fn on_threads<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.shared.infos.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Queues `work` with a token of its own. It is called on a host thread once, or again after a lost device if
    /// `retry` allows it.
    ///
    /// # Errors
    /// `QueueFull`, `Draining`.
    pub fn submit<R: Send + 'static>(
        &self,
        place: Place,
        retry: Retry,
        work: impl FnMut(&Backends, &Turn) -> Result<R, JobError> + Send + 'static,
    ) -> Result<Pending<R>, JobError> {
        self.submit_as(self.token(), place, retry, work)
    }

    /// The same for a piece of the job that has this token.
    ///
    /// # Errors
    /// `QueueFull`, `Draining`.
    pub fn submit_as<R: Send + 'static>(
        &self,
        token: Token,
        place: Place,
        retry: Retry,
        work: impl FnMut(&Backends, &Turn) -> Result<R, JobError> + Send + 'static,
    ) -> Result<Pending<R>, JobError> {
        let (sender, reply) = oneshot::channel();
        let (goes_on, origin) = match &place {
            Place::New(ask) | Place::Kept(ask) => (ask.goes_on, ask.origin),
            Place::Session | Place::Continuation => (true, None),
        };
        let telling = Telling::Waits(Waiting::new(&self.shared.observer, origin));
        let (work, reply_to, queued) = (Some(work), Some(sender), Instant::now());
        let call = Call { work, goes_on, reply: reply_to, token: token.clone(), queued, retry, telling };
        let position = self.shared.queue.push(place, Box::new(call))?;
        Ok(Pending { position, reply, token, answered: false })
    }

    /// Drops `value` on a host thread: freeing much takes time.
    pub fn dispose(&self, value: impl Send + 'static) {
        let mut value = Some(value);
        let (sender, _) = oneshot::channel();
        let work = move |_: &Backends, _: &Turn| {
            drop(value.take());
            Ok(())
        };
        let call = Call {
            work: Some(work),
            goes_on: true,
            reply: Some(sender),
            token: Token::default(),
            queued: Instant::now(),
            retry: Retry::Never,
            telling: Telling::Waits(Waiting::new(&self.shared.observer, None)),
        };
        // Nobody waits for it; popping drops it on a host thread, and so does its end.
        let _ = self.shared.queue.push(Place::Continuation, Box::new(call));
    }

    /// How much each tenant counts beside others.
    pub fn weights(&self) -> &Weights {
        &self.shared.weights
    }

    /// The GPU backend's device as it is now; `None` if there is none.
    pub(crate) fn device_facts(&self) -> Option<DeviceFacts> {
        self.shared.current().1.gpu.ok()?.device_facts()
    }

    /// Waiting pieces, and whether one is at work.
    pub fn load(&self) -> (usize, bool) {
        self.shared.queue.load()
    }

    /// Follows the device's health.
    pub fn watch_device(&self) -> watch::Receiver<Device> {
        self.shared.device.subscribe()
    }

    /// Refuses new jobs; the threads end once the queue is empty.
    pub fn close(&self) {
        self.shared.queue.close();
    }

    /// Cancels everything that waits or runs.
    pub fn cancel_all(&self) {
        self.shared.queue.cancel_all();
    }
}

struct Infos {
    /// The threads of the CPU backend.
    pool: Option<Arc<rayon::ThreadPool>>,
    slots: Slots,
}

impl Infos {
    fn of(backends: &Backends, slots: Slots) -> Self {
        Self { pool: backends.parallel.pool(), slots }
    }
}

/// The engine's own thread: starts the others, and waits for their end.
fn run(
    factory: Box<dyn FnMut() -> Result<Backends, JobError> + Send>,
    options: EngineOptions,
    observer: Arc<dyn Observer>,
    ready: &SyncSender<Result<Arc<Shared>, JobError>>,
) {
    let shared = match Shared::new(factory, options, observer) {
        Ok(shared) => Arc::new(shared),
        Err(error) => {
            let _ = ready.send(Err(error));
            return;
        }
    };
    let _end = EndOnDrop(&shared);
    std::thread::scope(|scope| {
        let jobs = (0..=shared.infos.slots.regular).map(|i| (Lane::Jobs, format!("job-{i}")));
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
        let mut maker = Maker { factory, tried: Instant::now(), absence: Absence::default() };
        let backends = maker.make()?;
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
            infos: Infos::of(&backends, slots),
            device: watch::Sender::new(Device::Ready),
            gate: Arc::default(),
            pools: Pools::new(&backends, slots.regular),
            current: RwLock::new((0, backends)),
            maker: Mutex::new(maker),
            revive: options.revive,
            loss: options.loss,
            loss_patience: options.loss_patience,
            losses: AtomicU64::new(0),
        })
    }

    /// The backends now, and how often they were replaced before.
    fn current(&self) -> (u64, Backends) {
        self.current.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn work_in(&self, lane: Lane) {
        let end = EndOnPanic(self);
        loop {
            let lost = *self.device.borrow() == Device::Lost;
            match self.queue.pop(lane, lost.then_some(self.revive)) {
                Popped::Item(taken) => self.work(taken),
                Popped::Nothing => self.replace(self.current().0, self.revive),
                Popped::Closed => break,
            }
        }
        drop(end);
    }

    fn work(&self, taken: Taken<Box<dyn Task>>) {
        let Taken { item: mut task, number, is_alone } = taken;
        let start = Instant::now();
        let watched = self.watchdog.watch(task.token());
        let threads = if task.goes_on() { None } else { Some(self.pools.take(is_alone)) };
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
        // State that the answer did not take along is dropped here.
        drop((task, threads, watched));
        self.queue.done(number, start.elapsed());
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
            std::thread::sleep(LISTEN);
        }
    }

    /// New backends after a loss, unless somebody was faster, or tried less than `pause` ago. While there are none the old
    /// ones stay, and answer with errors: work that was promised to a GPU does not go to a CPU unsaid.
    fn replace(&self, generation: u64, pause: Duration) {
        let mut maker = self.maker.lock().unwrap_or_else(PoisonError::into_inner);
        let (now, old) = self.current();
        if now != generation || (!pause.is_zero() && maker.tried.elapsed() < pause) {
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
            // Nobody waits for it any more.
            Device::Missing | Device::Gone => return,
        }
        tracing::warn!("the device was lost; making it anew");
        let install = |new, state| {
            *self.current.write().unwrap_or_else(PoisonError::into_inner) = (generation + 1, new);
            self.device.send_replace(state);
        };
        match maker.make() {
            Ok(new) if new.gpu.is_err() && old.gpu.is_ok() => {
                tracing::error!(reason = new.gpu.err(), "the GPU did not come back");
            }
            Ok(new) => {
                maker.absence.end();
                install(new, Device::Ready);
                tracing::info!("the device is there again");
                return;
            }
            Err(error) => tracing::error!(%error, "the device could not be made anew"),
        }
        maker.absence.begin();
        if !maker.absence.has_lasted(self.loss_patience) {
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

/// Whatever ends the engine, nobody waits for it in vain.
struct EndOnDrop<'a>(&'a Shared);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.queue.end();
        self.0.device.send_replace(Device::Gone);
    }
}

/// A host thread that panics, in a destructor, takes the engine along: whoever waits for its work is told.
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Answered,
    DeviceLost,
}

trait Task: Item {
    /// It is being done from now on.
    fn begin(&mut self) -> Arc<Told>;
    fn run(&mut self, backends: &Backends, attempt: usize) -> Outcome;
    fn goes_on(&self) -> bool;
}

impl Item for Box<dyn Task> {
    fn is_wanted(&self) -> bool {
        (**self).is_wanted()
    }

    fn token(&self) -> &Token {
        (**self).token()
    }
}

struct Call<R, F> {
    work: Option<F>,
    /// Whether what it makes goes on in later pieces, and so must not hold threads that are another job's then.
    goes_on: bool,
    reply: Option<oneshot::Sender<Result<Timed<R>, JobError>>>,
    token: Token,
    queued: Instant,
    retry: Retry,
    telling: Telling,
}

/// What is told of a call.
enum Telling {
    Waits(Waiting),
    Runs(Arc<Told>),
    /// Between the two.
    Begins,
}

impl<R: Send, F: Send> Item for Call<R, F> {
    fn is_wanted(&self) -> bool {
        self.reply.as_ref().is_some_and(|reply| !reply.is_closed())
    }

    fn token(&self) -> &Token {
        &self.token
    }
}

/// Attempts after a lost device, the first included.
pub(super) const ATTEMPTS: usize = 3;

impl<R: Send, F: FnMut(&Backends, &Turn) -> Result<R, JobError> + Send> Task for Call<R, F> {
    fn goes_on(&self) -> bool {
        self.goes_on
    }

    fn begin(&mut self) -> Arc<Told> {
        let told = match std::mem::replace(&mut self.telling, Telling::Begins) {
            Telling::Waits(waiting) => waiting.begin(),
            Telling::Runs(told) => told,
            Telling::Begins => Waiting::new(&(Arc::new(()) as Arc<dyn Observer>), None).begin(),
        };
        self.telling = Telling::Runs(Arc::clone(&told));
        told
    }

    fn run(&mut self, backends: &Backends, attempt: usize) -> Outcome {
        let told = self.begin();
        let queue_ms = ms(self.queued.elapsed());
        let start = Instant::now();
        let turn = Turn { token: self.token.clone(), queue_ms, told: Arc::clone(&told) };
        let Some(work) = self.work.as_mut() else { return Outcome::Answered };
        self.token.tell_stages(Some(Arc::clone(&told) as Arc<dyn StageListener>));
        let result = catch_unwind(AssertUnwindSafe(|| told.span().in_scope(|| work(backends, &turn))))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref()))));
        self.token.tell_stages(None);
        let lost = result.as_ref().is_err_and(JobError::is_device_lost);
        if lost && self.retry == Retry::Anew && attempt + 1 < ATTEMPTS {
            return Outcome::DeviceLost;
        }
        let result = result.map(|value| Timed { value, queue_ms, compute_ms: ms(start.elapsed()) });
        // What the work still holds goes before the answer: the caller may ask for its memory at once.
        self.work = None;
        // The count too: who has the answer may ask for it.
        told.end(result.as_ref().err());
        if let Some(reply) = self.reply.take() {
            let _ = reply.send(result);
        }
        if lost { Outcome::DeviceLost } else { Outcome::Answered }
    }
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

fn text(panic: &(dyn Any + Send)) -> String {
    let message = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    message.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "(no message)".to_owned())
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::job::Ask;
    use crate::rvd::RvdError;
    use crate::rvd::parallel::Parallel;
    use crate::rvd::serial::Serial;

    fn backends() -> Result<Backends, JobError> {
        let parallel = Arc::new(Parallel::new(Some(1))?);
        let serial = Arc::new(Serial);
        Ok(Backends { gpu: Err("none".into()), parallel, serial, default: Wish::Auto, pools: None })
    }

    fn new() -> Place {
        Place::New(Ask::default())
    }

    #[tokio::test]
    async fn a_lost_device_comes_back_though_nobody_asks() {
        let made = Arc::new(AtomicUsize::new(0));
        let counter = made.clone();
        let factory = move || match counter.fetch_add(1, Ordering::SeqCst) {
            0 => backends(),
            1 | 2 => Err(RvdError::Device("still gone".into()).into()),
            _ => backends(),
        };
        let options = EngineOptions { revive: Duration::from_millis(20), ..EngineOptions::default() };
        let (engine, thread) = Engine::start(factory, options).unwrap();
        let mut health = engine.watch_device();
        let lose = |_: &Backends, _: &Turn| -> Result<(), JobError> { Err(RvdError::DeviceLost("x".into()).into()) };
        let error = engine.submit(new(), Retry::Never, lose).unwrap().wait().await.unwrap_err();
        assert!(error.is_device_lost());
        health.wait_for(|d| *d == Device::Lost).await.unwrap();
        tokio::time::timeout(Duration::from_secs(5), health.wait_for(|d| *d == Device::Ready)).await.unwrap().unwrap();
        assert_eq!(made.load(Ordering::SeqCst), 4);
        engine.close();
        thread.join().unwrap();
        assert_eq!(*health.borrow(), Device::Gone);
        let late = engine.submit(Place::Session, Retry::Never, |_, _| Ok(()));
        assert!(matches!(late, Err(JobError::Draining)), "nobody would answer");
    }

    #[tokio::test]
    async fn what_waits_is_answered_when_the_queue_closes() {
        let (engine, thread) = Engine::start(backends, EngineOptions::default()).unwrap();
        let mut all: Vec<_> = (0..10).map(|i| engine.submit(new(), Retry::Never, move |_, _| Ok(i)).unwrap()).collect();
        engine.close();
        for (i, pending) in all.iter_mut().enumerate() {
            assert_eq!(pending.wait().await.unwrap().value, i);
        }
        thread.join().unwrap();
    }
}
