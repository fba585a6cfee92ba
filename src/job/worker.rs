//! The device thread and the handle to it.
//!
//! Purpose: [`Engine::submit`] from any task, work on one OS thread, an answer with times.
//! Invariant: backends are made, used and dropped on the device thread. A lost device is replaced
//! before the next piece; a piece that can be begun anew is tried up to three times.
//! Must not know: what a piece computes.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::AtomicI64;
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};

use super::queue::{Item, Place, Popped, Queue};
use super::watchdog::{Ceilings, Watchdog, Watched, Work};
use super::{BackendInfo, Backends, JobError, Wish};
use crate::token::Token;

/// How the engine is set up.
#[derive(Clone, Copy, Debug)]
pub struct EngineOptions {
    /// New jobs that may wait, at least 1.
    pub queue_jobs: usize,
    /// How long until a lost device is tried again when nobody asks for it.
    pub revive: Duration,
    /// What a job may take.
    pub ceilings: Ceilings,
}

impl Default for EngineOptions {
    fn default() -> Self {
        Self { queue_jobs: 32, revive: Duration::from_secs(5), ceilings: Ceilings::default() }
    }
}

/// How the device is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Device {
    /// Ready.
    Ready,
    /// Lost; being made anew.
    Lost,
    /// The device thread has ended.
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
    watchdog: Watchdog,
    queue: Queue<Box<dyn Task>>,
    infos: Infos,
    device: watch::Sender<Device>,
}

impl std::fmt::Debug for Shared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (waiting, running) = self.queue.load();
        f.debug_struct("Engine").field("waiting", &waiting).field("running", &running).finish_non_exhaustive()
    }
}

/// The handle. Clones share one device thread.
#[derive(Clone, Debug)]
pub struct Engine {
    shared: Arc<Shared>,
}

impl Engine {
    /// Starts the device thread, which calls `factory` for its backends, now and after a loss.
    /// Returns once they are there.
    ///
    /// # Errors
    /// The factory's, or `Panicked`.
    pub fn start(
        factory: impl FnMut() -> Result<Backends, JobError> + Send + 'static,
        options: EngineOptions,
    ) -> Result<(Self, JoinHandle<()>), JobError> {
        let (ready, answer) = std::sync::mpsc::sync_channel(1);
        let thread = Builder::new()
            .name("device".to_owned())
            .spawn(move || Worker { factory }.run(options, &ready))
            .map_err(|e| JobError::Panicked(format!("the device thread could not be started: {e}")))?;
        let shared = answer.recv().unwrap_or(Err(JobError::WorkerGone))?;
        Ok((Self { shared }, thread))
    }

    /// Who will do the work for a wish.
    ///
    /// # Errors
    /// `BackendUnavailable`.
    pub fn backend(&self, wish: Wish) -> Result<BackendInfo, JobError> {
        let Infos { backends, .. } = &self.shared.infos;
        backends.iter().find(|(w, _)| *w == wish).map_or(Err(JobError::WorkerGone), |(_, info)| info.clone())
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
        self.shared.watchdog.token()
    }

    /// Watches work that is done for a job on another thread than the device's, until what it returns is dropped.
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

    /// Does work on the engine's threads, so that their number bounds what is done beside the device thread too.
    pub fn on_threads<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.shared.infos.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Queues `work` with a token of its own. It is called on the device thread once, or again after a lost device if
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
        let call = Call { work: Some(work), reply: Some(sender), token: token.clone(), queued: Instant::now(), retry };
        let position = self.shared.queue.push(place, Box::new(call))?;
        Ok(Pending { position, reply, token, answered: false })
    }

    /// Drops `value` on the device thread, where its buffers live.
    pub fn dispose(&self, value: impl Send + 'static) {
        let mut value = Some(value);
        let (sender, _) = oneshot::channel();
        let work = move |_: &Backends, _: &Turn| {
            drop(value.take());
            Ok(())
        };
        let call = Call {
            work: Some(work),
            reply: Some(sender),
            token: Token::default(),
            queued: Instant::now(),
            retry: Retry::Never,
        };
        // Nobody waits for it; popping drops it on the device thread, and so does its end.
        let _ = self.shared.queue.push(Place::Continuation, Box::new(call));
    }

    /// Waiting pieces, and whether one is at work.
    pub fn load(&self) -> (usize, bool) {
        self.shared.queue.load()
    }

    /// Follows the device's health.
    pub fn watch_device(&self) -> watch::Receiver<Device> {
        self.shared.device.subscribe()
    }

    /// Refuses new jobs; the thread ends once the queue is empty.
    pub fn close(&self) {
        self.shared.queue.close();
    }

    /// Cancels everything that waits or runs.
    pub fn cancel_all(&self) {
        self.shared.queue.cancel_all();
    }
}

struct Infos {
    backends: Vec<(Wish, Result<BackendInfo, JobError>)>,
    /// The threads of the CPU backend.
    pool: Option<Arc<rayon::ThreadPool>>,
}

impl Infos {
    fn of(backends: &Backends) -> Self {
        use crate::rvd::BackendKind::{Gpu, Parallel, Serial};
        let wishes = [Wish::Auto, Wish::Only(Gpu), Wish::Only(Parallel), Wish::Only(Serial)];
        let info = |wish| backends.choose(wish).map(|b| BackendInfo::of(b.as_ref()));
        let pool = backends.parallel.pool();
        Self { backends: wishes.into_iter().map(|wish| (wish, info(wish))).collect(), pool }
    }
}

struct Worker<F> {
    factory: F,
}

impl<F: FnMut() -> Result<Backends, JobError>> Worker<F> {
    fn run(mut self, options: EngineOptions, ready: &std::sync::mpsc::SyncSender<Result<Arc<Shared>, JobError>>) {
        let mut backends = match self.make() {
            Ok(backends) => backends,
            Err(error) => {
                let _ = ready.send(Err(error));
                return;
            }
        };
        let watchdog = match Watchdog::start(options.ceilings) {
            Ok(watchdog) => watchdog,
            Err(error) => {
                let _ = ready.send(Err(JobError::Panicked(format!("the watchdog could not be started: {error}"))));
                return;
            }
        };
        let shared = Arc::new(Shared {
            watchdog,
            queue: Queue::new(options.queue_jobs.max(1)),
            infos: Infos::of(&backends),
            device: watch::Sender::new(Device::Ready),
        });
        if ready.send(Ok(shared.clone())).is_err() {
            return;
        }
        let _end = EndOnDrop(&shared);
        loop {
            let lost = *shared.device.borrow() == Device::Lost;
            match shared.queue.pop(lost.then_some(options.revive)) {
                Popped::Item(task) => self.work(task, &mut backends, &shared),
                Popped::Nothing => self.replace(&mut backends, &shared),
                Popped::Closed => return,
            }
        }
    }

    fn work(&mut self, mut task: Box<dyn Task>, backends: &mut Backends, shared: &Shared) {
        let start = Instant::now();
        let _watched = shared.watchdog.watch(task.token());
        let mut attempts = 0;
        while task.run(backends, attempts) == Outcome::DeviceLost {
            attempts += 1;
            self.replace(backends, shared);
            if !task.is_wanted() || task.token().is_stopped() {
                break;
            }
        }
        // State that the answer did not take along is dropped here, on its own thread.
        drop(task);
        shared.queue.learn(start.elapsed());
    }

    fn make(&mut self) -> Result<Backends, JobError> {
        catch_unwind(AssertUnwindSafe(&mut self.factory))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref()))))
    }

    /// New backends after a loss. While there are none the old ones stay, and answer with errors:
    /// work that was promised to a GPU does not go to a CPU unsaid.
    fn replace(&mut self, backends: &mut Backends, shared: &Shared) {
        shared.device.send_replace(Device::Lost);
        tracing::warn!("the device was lost; making it anew");
        match self.make() {
            Ok(new) if new.gpu.is_err() && backends.gpu.is_ok() => {
                tracing::error!(reason = new.gpu.err(), "the GPU did not come back");
            }
            Ok(new) => {
                *backends = new;
                shared.device.send_replace(Device::Ready);
            }
            Err(error) => tracing::error!(%error, "the device could not be made anew"),
        }
    }
}

/// Whatever ends the device thread, a panic in a destructor too, nobody waits for it in vain.
struct EndOnDrop<'a>(&'a Shared);

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        self.0.queue.end();
        self.0.device.send_replace(Device::Gone);
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Answered,
    DeviceLost,
}

trait Task: Item {
    fn run(&mut self, backends: &Backends, attempt: usize) -> Outcome;
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
    reply: Option<oneshot::Sender<Result<Timed<R>, JobError>>>,
    token: Token,
    queued: Instant,
    retry: Retry,
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
const ATTEMPTS: usize = 3;

impl<R: Send, F: FnMut(&Backends, &Turn) -> Result<R, JobError> + Send> Task for Call<R, F> {
    fn run(&mut self, backends: &Backends, attempt: usize) -> Outcome {
        let queue_ms = ms(self.queued.elapsed());
        let start = Instant::now();
        let turn = Turn { token: self.token.clone(), queue_ms };
        let Some(work) = self.work.as_mut() else { return Outcome::Answered };
        let result = catch_unwind(AssertUnwindSafe(|| work(backends, &turn)))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref()))));
        let lost = result.as_ref().is_err_and(JobError::is_device_lost);
        if lost && self.retry == Retry::Anew && attempt + 1 < ATTEMPTS {
            return Outcome::DeviceLost;
        }
        let result = result.map(|value| Timed { value, queue_ms, compute_ms: ms(start.elapsed()) });
        // What the work still holds goes before the answer: the caller may ask for its memory at once.
        self.work = None;
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
    use crate::rvd::RvdError;
    use crate::rvd::parallel::Parallel;
    use crate::rvd::serial::Serial;

    fn backends() -> Result<Backends, JobError> {
        let parallel = Arc::new(Parallel::new(Some(1))?);
        Ok(Backends { gpu: Err("none".into()), parallel, serial: Arc::new(Serial), default: Wish::Auto })
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
        let error = engine.submit(Place::New, Retry::Never, lose).unwrap().wait().await.unwrap_err();
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
        let mut all: Vec<_> =
            (0..10).map(|i| engine.submit(Place::New, Retry::Never, move |_, _| Ok(i)).unwrap()).collect();
        engine.close();
        for (i, pending) in all.iter_mut().enumerate() {
            assert_eq!(pending.wait().await.unwrap().value, i);
        }
        thread.join().unwrap();
    }
}
