//! A piece of work, from its submission to its answer.
//!
//! Purpose: [`Call`] is what the queue holds: work, who waits for it, and its metrics and trace. Invariant: it is answered
//! exactly once or its caller has gone; a panic is an answer; what the work holds goes before the answer. Must not know:
//! threads, backends but that it is handed some.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::observer::{Activity, Observer, QueuedActivity};
use super::queue::Item;
use super::{Backends, JobError};
use geometry::token::{StageListener, Token};

/// Attempts after a lost device, the first included.
pub(super) const ATTEMPTS: usize = 3;

/// Whether a piece may be begun anew after the device was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retry {
    /// From its beginning: its state is made inside.
    Restart,
    /// Its state was on the lost device.
    Never,
}

/// What a piece of work sees besides the backends.
#[derive(Clone, Debug)]
pub struct WorkContext {
    /// Set when the caller has gone or the process must end.
    pub token: Token,
    /// Milliseconds the piece waited.
    pub queue_ms: f64,
    /// Counts and traces what is done.
    pub activity: Arc<Activity>,
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

pub(super) struct Call<R, F> {
    pub(super) work: Option<F>,
    /// Whether later pieces continue what it makes, so that it must not hold threads that are another job's then.
    pub(super) has_continuations: bool,
    pub(super) reply: Option<oneshot::Sender<Result<Timed<R>, JobError>>>,
    pub(super) token: Token,
    pub(super) queued: Instant,
    pub(super) retry: Retry,
    pub(super) activity: ActivityState,
}

/// The metrics and the trace of a call.
pub(super) enum ActivityState {
    Queued(QueuedActivity),
    Running(Arc<Activity>),
    /// Between the two.
    Starting,
}

impl<R: Send, F: Send> Item for Call<R, F> {
    fn is_wanted(&self) -> bool {
        self.reply.as_ref().is_some_and(|reply| !reply.is_closed())
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
        let context = WorkContext { token: self.token.clone(), queue_ms, activity: Arc::clone(&activity) };
        let Some(work) = self.work.as_mut() else { return Outcome::Answered };
        self.token.tell_stages(Some(Arc::clone(&activity) as Arc<dyn StageListener>));
        let result = catch_unwind(AssertUnwindSafe(|| activity.span().in_scope(|| work(backends, &context))))
            .unwrap_or_else(|panic| Err(JobError::Panicked(text(panic.as_ref()))));
        self.token.tell_stages(None);
        let lost = result.as_ref().is_err_and(JobError::is_device_lost);
        if lost && self.retry == Retry::Restart && attempt + 1 < ATTEMPTS {
            return Outcome::DeviceLost;
        }
        let result = result.map(|value| Timed { value, queue_ms, compute_ms: ms(start.elapsed()) });
        // What the work still holds goes before the answer: the caller may ask for its memory at once.
        self.work = None;
        // The count too: who has the answer may ask for it.
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

pub(super) fn text(panic: &(dyn Any + Send)) -> String {
    let message = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    message.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "(no message)".to_owned())
}
