//! The handle to the host threads.
//!
//! Purpose: [`Engine::submit`] from any task; an answer with times. Invariant: every submitted piece is answered exactly once
//! or its caller has gone. Must not know: what a piece computes, how the threads share the device.

mod gate;
mod pools;
pub mod probe;
pub(crate) mod queue;
mod schedule;
pub(crate) mod watchdog;
pub(crate) mod worker;

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};

use tokio::sync::{oneshot, watch};

use super::{BackendInfo, Backends, JobError};
use crate::beside::{Beside, Mark};
use crate::observe::activity::{Observer, QueuedActivity};
use crate::record::JobId;
use geometry::rvd::{BackendChoice, DeviceFacts};
use geometry::token::Token;
use watchdog::WatchGuard;
use worker::{ActivityState, Call, Reply, Shared, run};

pub use crate::record::Bytes;
pub(crate) use gate::{Gate, Gated, TOKEN_POLL};
pub use queue::Admission;
pub use schedule::{AdmissionRequest, Weights};
pub use watchdog::{Ceilings, Work};
pub use worker::{Device, EngineOptions, LossPolicy, Retry, Timed, WorkContext};

/// Work that was submitted. Dropping it cancels the work.
#[derive(Debug)]
pub struct Pending<R> {
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
    /// The answer. Cancellation-safe: can be polled again after it lost a `select!`. Errors: the work's own, `Panicked`,
    /// `WorkerGone`.
    pub async fn wait(&mut self) -> Result<Timed<R>, JobError> {
        let answer = (&mut self.reply).await.unwrap_or(Err(JobError::WorkerGone));
        self.answered = true;
        answer
    }

    pub fn token(&self) -> &Token {
        &self.token
    }
}

/// A place in the queue, reserved for a job while it is uploaded. Released when dropped, which is after the job was
/// submitted as [`Admission::Reserved`].
#[derive(Debug)]
pub struct Reservation {
    shared: Arc<Shared>,
    number: u64,
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.shared.queue.release(self.number);
    }
}

/// The handle. Clones share the threads.
#[derive(Clone, Debug)]
pub struct Engine {
    shared: Arc<Shared>,
}

impl Engine {
    /// Starts the host threads. `factory` makes their backends, now and after a loss. Returns once they run, with the handle
    /// of a thread that ends after all others.
    pub fn start(
        factory: impl FnMut() -> Result<Backends, JobError> + Send + 'static,
        options: EngineOptions,
    ) -> Result<(Self, JoinHandle<()>), JobError> {
        Self::start_observed(factory, options, Arc::new(()))
    }

    pub fn start_observed(
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

    pub fn backend(&self, choice: BackendChoice) -> Result<BackendInfo, JobError> {
        self.shared.current().1.choose(choice).map(|backend| BackendInfo::of(backend.as_ref()))
    }

    pub(crate) fn observer(&self) -> &dyn Observer {
        self.shared.observer.as_ref()
    }

    pub fn losses(&self) -> u64 {
        self.shared.losses.load(Ordering::Relaxed)
    }

    /// Memory that jobs at work together may need.
    pub fn memory(&self) -> Bytes {
        self.shared.slots.memory
    }

    /// Jobs that are at work at once.
    pub fn places(&self) -> usize {
        self.shared.slots.regular
    }

    /// Memory that the jobs at work are planned to need.
    pub fn planned(&self) -> Bytes {
        self.shared.queue.planned()
    }

    /// The job at work with this token turned out to need more than was predicted.
    pub(crate) fn plan_more(&self, token: &Token, seconds: f64, memory: Bytes) {
        self.shared.queue.plan_more(token, seconds, memory);
    }

    /// Reserves a place for a job of a tenant that is yet to be uploaded, so that it is refused now or not at all. Errors: `QueueFull`,
    /// `Draining`.
    pub fn reserve(&self, tenant: &str) -> Result<Reservation, JobError> {
        let number = self.shared.queue.reserve(tenant)?;
        Ok(Reservation { shared: Arc::clone(&self.shared), number })
    }

    /// A token for a job, whose ceiling on time counts what is done for it here and under [`Self::watch`].
    pub fn token(&self) -> Token {
        self.shared.watchdog.token(None)
    }

    /// The same for a job that is to take no longer than `limit`.
    pub fn token_within(&self, limit: Option<Duration>) -> Token {
        self.shared.watchdog.token(limit)
    }

    /// Work that is no job of a store is counted here from now on. The first count stays.
    pub(crate) fn count_beside(&self, beside: Beside) {
        let _ = self.shared.beside.set(beside);
    }

    /// Marks work that is no job of a store, done on another thread than a worker's.
    pub fn mark(&self) -> Option<Mark> {
        self.shared.beside.get().map(Beside::begin)
    }

    /// Watches work that is done for a job on another thread than a worker's, until what it returns is dropped.
    pub fn watch(&self, token: &Token) -> WatchGuard {
        self.shared.watchdog.watch(token)
    }

    /// Bytes that the process holds outside of jobs, such as uploads: their holders keep this number up to date. A job's
    /// ceiling on memory does not count them.
    pub fn memory_outside_jobs(&self) -> Arc<AtomicI64> {
        self.shared.watchdog.memory_outside_jobs()
    }

    /// State of the work that was asked to stop.
    pub fn watch_work(&self) -> watch::Receiver<Work> {
        self.shared.watchdog.work()
    }

    /// Does work on the engine's threads, so that their number bounds what is done beside the jobs too.
    pub fn on_threads<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        match &self.shared.pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }

    /// Queues `work` with a token of its own. It is called on a host thread once, or again after a lost device if `retry`
    /// allows it. Errors: `QueueFull`, `Draining`.
    pub fn submit<R: Send + 'static>(
        &self,
        admission: Admission,
        retry: Retry,
        work: impl FnMut(&Backends, &WorkContext) -> Result<R, JobError> + Send + 'static,
    ) -> Result<Pending<R>, JobError> {
        self.submit_as(self.token(), admission, retry, work)
    }

    /// The same for a piece of the job that has this token. Errors: `QueueFull`, `Draining`.
    pub fn submit_as<R: Send + 'static>(
        &self,
        token: Token,
        admission: Admission,
        retry: Retry,
        work: impl FnMut(&Backends, &WorkContext) -> Result<R, JobError> + Send + 'static,
    ) -> Result<Pending<R>, JobError> {
        let (sender, reply) = oneshot::channel();
        let position = self.push(token.clone(), admission, retry, work, Some(sender))?;
        Ok(Pending { position, reply, token, answered: false })
    }

    fn push<R: Send + 'static>(
        &self,
        token: Token,
        admission: Admission,
        retry: Retry,
        mut work: impl FnMut(&Backends, &WorkContext) -> Result<R, JobError> + Send + 'static,
        reply: Option<Reply<R>>,
    ) -> Result<usize, JobError> {
        let (has_continuations, origin, is_kept) = match &admission {
            Admission::New(ask) | Admission::Reserved(ask) => (ask.has_continuations, ask.origin, ask.kept.is_some()),
            Admission::Session | Admission::Continuation => (true, None, false),
        };
        let engine = self.clone();
        let work = move |backends: &Backends, context: &WorkContext| {
            let _mark = if is_kept { None } else { engine.mark() };
            work(backends, context)
        };
        let activity = ActivityState::Queued(QueuedActivity::new(&self.shared.observer, origin));
        let queued = Instant::now();
        let call = Call { work: Some(work), has_continuations, reply, token, queued, retry, activity };
        self.shared.queue.push(admission, Box::new(call))
    }

    /// Queues a job that a store keeps. Its work records how it ends. Errors: `Draining`.
    pub(crate) fn submit_kept(
        &self,
        token: Token,
        request: AdmissionRequest,
        work: impl FnMut(&Backends, &WorkContext) -> Result<(), JobError> + Send + 'static,
    ) -> Result<(), JobError> {
        self.push(token, Admission::Reserved(request), Retry::Restart, work, None).map(drop)
    }

    /// Jobs of the store that wait or are at work: a tenant's, or all.
    pub(crate) fn kept(&self, tenant: Option<&str>) -> usize {
        self.shared.queue.kept(tenant)
    }

    /// Whether one more job of a store would begin at once, its memory aside.
    pub(crate) fn has_place(&self) -> bool {
        self.shared.queue.has_place()
    }

    /// Ends once a piece of work is done, also one since the last call. For one caller at a time.
    pub(crate) async fn freed(&self) {
        self.shared.queue.freed().await;
    }

    /// Takes a job of the store out of the line and cancels it.
    pub(crate) fn remove_kept(&self, id: JobId) {
        self.shared.queue.remove_kept(id);
    }

    /// Takes the waiting jobs of the store out of the line.
    pub(crate) fn release_kept(&self) {
        self.shared.queue.release_kept();
    }

    /// Cancels the jobs of the store, whether they wait or are at work.
    pub(crate) fn cancel_kept(&self) {
        self.shared.queue.cancel_kept();
    }

    /// Drops `value` on a host thread: freeing much takes time.
    pub fn dispose(&self, value: impl Send + 'static) {
        let mut value = Some(value);
        let work = move |_: &Backends, _: &WorkContext| {
            drop(value.take());
            Ok(())
        };
        // Without a waiting caller, a host thread drops it when it takes it from the queue, or at its end.
        let (sender, _) = oneshot::channel();
        drop(self.push(Token::default(), Admission::Continuation, Retry::Never, work, Some(sender)));
    }

    /// How much each tenant counts beside others.
    pub fn weights(&self) -> &Weights {
        &self.shared.weights
    }

    /// The GPU backend's device as it is now; `None` if there is none.
    pub fn device_facts(&self) -> Option<DeviceFacts> {
        self.shared.current().1.gpu.ok()?.device_facts()
    }

    /// Waiting pieces, and whether one is at work.
    pub fn load(&self) -> (usize, bool) {
        self.shared.queue.load()
    }

    pub fn watch_device(&self) -> watch::Receiver<Device> {
        self.shared.device.subscribe()
    }

    /// Refuses new jobs; the threads end once the queue is empty.
    pub fn close(&self) {
        self.shared.queue.close();
    }

    pub fn cancel_all(&self) {
        self.shared.queue.cancel_all();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;
    use crate::AdmissionRequest;
    use geometry::rvd::RvdError;
    use geometry::rvd::parallel::Parallel;
    use geometry::rvd::serial::Serial;

    fn backends() -> Result<Backends, JobError> {
        let parallel = Arc::new(Parallel::new(Some(1))?);
        let serial = Arc::new(Serial);
        Ok(Backends { gpu: Err("none".into()), parallel, serial, default: BackendChoice::Auto, pools: None })
    }

    fn new() -> Admission {
        Admission::New(AdmissionRequest::default())
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
        let lose =
            |_: &Backends, _: &WorkContext| -> Result<(), JobError> { Err(RvdError::DeviceLost("x".into()).into()) };
        let error = engine.submit(new(), Retry::Never, lose).unwrap().wait().await.unwrap_err();
        assert!(error.is_device_lost());
        health.wait_for(|d| *d == Device::Lost).await.unwrap();
        tokio::time::timeout(Duration::from_secs(5), health.wait_for(|d| *d == Device::Ready)).await.unwrap().unwrap();
        assert_eq!(made.load(Ordering::SeqCst), 4);
        engine.close();
        thread.join().unwrap();
        assert_eq!(*health.borrow(), Device::Gone);
        let late = engine.submit(Admission::Session, Retry::Never, |_, _| Ok(()));
        assert!(matches!(late, Err(JobError::Draining)), "nobody would answer");
    }

    #[tokio::test]
    async fn a_panic_in_a_destructor_ends_the_engine_with_nothing_at_work() {
        struct Bomb;
        impl Drop for Bomb {
            fn drop(&mut self) {
                panic!("in a destructor");
            }
        }
        let (engine, thread) = Engine::start(backends, EngineOptions::default()).unwrap();
        let bomb = Bomb;
        let work = move |_: &Backends, _: &WorkContext| {
            let _bomb = &bomb;
            Ok(())
        };
        let error = engine.submit(new(), Retry::Never, work).unwrap().wait().await.unwrap_err();
        assert!(matches!(error, JobError::WorkerGone));
        assert!(thread.join().is_err());
        assert_eq!(engine.load(), (0, false));
    }

    /// Jobs that take for ever, of one tenant or of several, and every place taken: a tiny job of another tenant has its turn.
    #[tokio::test]
    async fn a_tiny_job_does_not_wait_for_long_ones_of_other_tenants() {
        let pools = || -> Result<Backends, JobError> {
            let make: crate::PoolFactory = |threads| Ok(Arc::new(Parallel::new(Some(threads))?));
            Ok(Backends { pools: Some(make), ..backends()? })
        };
        let of = |tenant: &str| {
            Admission::New(AdmissionRequest { tenant: tenant.into(), seconds: 0.4, ..AdmissionRequest::default() })
        };
        let endless = |_: &Backends, context: &WorkContext| -> Result<(), JobError> {
            loop {
                context.token.check()?;
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        for tenants in [["a", "a", "a"], ["a", "b", "c"]] {
            let options = EngineOptions { jobs_at_once: 2, ..EngineOptions::default() };
            let (engine, thread) = Engine::start(pools, options).unwrap();
            let long: Vec<_> = tenants.map(|tenant| engine.submit(of(tenant), Retry::Never, endless).unwrap()).into();
            tokio::time::sleep(Duration::from_millis(100)).await;
            for tenant in ["tiny", "another", "tiny"] {
                let begin = Instant::now();
                engine.submit(of(tenant), Retry::Never, |_, _| Ok(())).unwrap().wait().await.unwrap();
                assert!(begin.elapsed() < Duration::from_secs(3), "{tenants:?}: {:?}", begin.elapsed());
            }
            // Those that wait for their turn end as well.
            engine.close();
            drop(long);
            thread.join().unwrap();
        }
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
