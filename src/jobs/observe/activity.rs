//! Metrics and traces of work while it waits and runs.
//!
//! Purpose: [`Observer`] receives what is counted. [`QueuedActivity`] and [`Activity`] accompany a piece of work: they count it
//! from the moment it is queued to its end, and open its spans (`queue`, `job`, `stage`, `pass`) in the trace of its caller.
//! Invariant: every piece that is counted in is counted out, whatever ends it. What counts never waits and never fails.
//! Must not know: how counts are kept, where spans go, what a job does.

use std::fmt;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant};

use glam::DVec3;
use tracing::{Span, debug_span, field, info_span};

use crate::record::{JobId, Kind};
use crate::{JobError, lock};
use geometry::cvt::Iteration;
use geometry::remesh;
use geometry::rvd::BackendKind;
use geometry::token::StageListener;
use telemetry::trace::{self, TraceContext};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Phase {
    Waiting,
    Running,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JobOutcome {
    Succeeded,
    Failed,
    /// The result is no longer wanted.
    Cancelled,
    /// The server ends first. The job is queued again, for the next start.
    Released,
}

/// Where a job comes from and how large it is, for metrics.
#[derive(Clone, Copy, Debug)]
pub struct Origin {
    pub kind: Kind,
    pub backend: BackendKind,
    pub job: Option<JobId>,
    pub facets: u64,
    pub seeds: u64,
}

/// Metrics of work. Every method is called from the working thread, and returns at once.
pub trait Observer: Send + Sync {
    /// A job came, went on, or left.
    fn moved(&self, _kind: Kind, _from: Option<Phase>, _to: Option<Phase>) {}
    /// A job began after it waited for so long.
    fn began(&self, _kind: Kind, _waited: Duration) {}
    fn ended(&self, _origin: &Origin, _how: JobOutcome) {}
    /// An earlier job was the answer to a new one.
    fn reused(&self, _kind: Kind) {}
    fn stage(&self, _stage: &'static str, _backend: BackendKind, _took: Duration) {}
    fn iterated(&self, _steps: u64) {}
    /// A pass ended, for which a backend was busy so long.
    fn passed(&self, _backend: BackendKind, _took: Duration) {}
    /// Change of the bytes that sessions plan on the device.
    fn planned(&self, _bytes: i64) {}
    fn lost_device(&self) {}
}

impl Observer for () {}

/// Hears of stages and steps of one piece of work, on the thread at work, and returns at once.
pub trait Listener: Send + Sync {
    /// A stage began, or has done this many of its steps; `total` is 0 if it is not known.
    fn stage(&self, name: &'static str, done: u64, total: u64);
    fn iteration(&self, iteration: &Iteration, total: usize);
    /// Whether the seeds are to be shown after the next step.
    fn wants_seeds(&self) -> bool {
        false
    }
    /// Where the seeds are after this many steps.
    fn seeds(&self, _steps: usize, _seeds: &[DVec3]) {}
}

struct Counted {
    observer: Arc<dyn Observer>,
    kind: Kind,
    phase: Phase,
}

impl Counted {
    fn go_on(&mut self, to: Phase) {
        self.observer.moved(self.kind, Some(self.phase), Some(to));
        self.phase = to;
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.observer.moved(self.kind, Some(self.phase), None);
    }
}

/// A piece of work that waits. One without an origin goes on with what another began, and is not counted.
pub struct QueuedActivity {
    observer: Arc<dyn Observer>,
    origin: Option<Origin>,
    counted: Option<Counted>,
    trace: Option<TraceContext>,
    since: Instant,
    _span: Span,
}

impl QueuedActivity {
    /// It is queued, for the trace of the current task.
    pub fn new(observer: &Arc<dyn Observer>, origin: Option<Origin>) -> Self {
        let counted = origin.map(|Origin { kind, .. }| {
            let phase = Phase::Waiting;
            observer.moved(kind, None, Some(phase));
            Counted { observer: Arc::clone(observer), kind, phase }
        });
        let (trace, span) = match (trace::here(), &origin) {
            // A session's next command, or the server's own work.
            (trace, None) => (trace, Span::none()),
            (trace, Some(Origin { job, .. })) => {
                let span = info_span!(parent: None, "queue", job = field::Empty, trace_id = field::Empty);
                job.iter().for_each(|job| _ = span.record("job", field::display(job)));
                // A kept job keeps its trace, which may be its own.
                let context = trace::join(&span, trace);
                (trace.or(Some(context)), span)
            }
        };
        Self { observer: Arc::clone(observer), origin, counted, trace, since: Instant::now(), _span: span }
    }

    pub fn begin(self) -> Arc<Activity> {
        let Self { observer, origin, mut counted, trace, since, _span: queued } = self;
        drop(queued);
        if let Some(Origin { kind, .. }) = origin {
            observer.began(kind, since.elapsed());
        }
        counted.iter_mut().for_each(|counted| counted.go_on(Phase::Running));
        let span = match &origin {
            Some(Origin { kind, backend, job, .. }) => {
                let (kind, backend) = (kind.name(), backend.name());
                let span = info_span!(parent: None, "job", kind, backend, job = field::Empty, trace_id = field::Empty);
                job.iter().for_each(|job| _ = span.record("job", field::display(job)));
                span
            }
            None if trace.is_some() => info_span!(parent: None, "turn", trace_id = field::Empty),
            None => Span::none(),
        };
        if !span.is_none() {
            trace::join(&span, trace);
        }
        let now = Mutex::new(Now { span, stage: None, counted, listener: None });
        Arc::new(Activity { observer, origin, now, outcome: OnceLock::new() })
    }
}

pub struct Activity {
    observer: Arc<dyn Observer>,
    origin: Option<Origin>,
    now: Mutex<Now>,
    /// How it ended, where its work says so and not an error.
    outcome: OnceLock<JobOutcome>,
}

struct Now {
    /// Of the whole piece; none once it has ended.
    span: Span,
    stage: Option<Stage>,
    counted: Option<Counted>,
    listener: Option<Arc<dyn Listener>>,
}

struct Stage {
    name: &'static str,
    since: Instant,
    span: Span,
}

impl fmt::Debug for Activity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Activity").field("origin", &self.origin).finish_non_exhaustive()
    }
}

impl Activity {
    /// The span of the piece, for what is logged meanwhile.
    pub fn span(&self) -> Span {
        lock(&self.now).span.clone()
    }

    pub fn listen(&self, listener: Arc<dyn Listener>) {
        lock(&self.now).listener = Some(listener);
    }

    fn listener(&self) -> Option<Arc<dyn Listener>> {
        lock(&self.now).listener.clone()
    }

    /// A stage has done this many of its steps.
    pub(crate) fn advance(&self, stage: &'static str, done: u64, total: u64) {
        self.listener().iter().for_each(|listener| listener.stage(stage, done, total));
    }

    pub fn iterated(&self, steps: u64) {
        self.observer.iterated(steps);
    }

    /// Change of the bytes that sessions hold on the device.
    pub(crate) fn planned(&self, bytes: i64) {
        self.observer.planned(bytes);
    }

    /// A backend begins a pass, which lasts until what this gives is dropped.
    pub(crate) fn pass(&self, pass: &'static str, backend: BackendKind) -> Pass<'_> {
        let span = {
            let now = lock(&self.now);
            // A session outlives the piece that opened it; then the piece at work is asked.
            let parent = now.stage.as_ref().map(|stage| &stage.span).filter(|span| !span.is_none());
            match parent.unwrap_or(&now.span) {
                none if none.is_none() => debug_span!("pass", pass, backend = backend.name()),
                parent => debug_span!(parent: parent, "pass", pass, backend = backend.name()),
            }
        };
        Pass { activity: self, backend, since: Instant::now(), _span: span }
    }

    /// How the job ended, though its work ends well.
    pub fn set_outcome(&self, outcome: JobOutcome) {
        let _ = self.outcome.set(outcome);
    }

    /// The piece has ended, and is out of the count before anybody hears of its result.
    pub(crate) fn end(&self, error: Option<&JobError>) {
        let mut now = lock(&self.now);
        self.end_stage(&mut now);
        now.span = Span::none();
        now.listener = None;
        let Some(counted) = now.counted.take() else { return };
        drop(now);
        let outcome = match error {
            Some(error) if error.is_cancelled() => JobOutcome::Cancelled,
            Some(_) => JobOutcome::Failed,
            None => self.outcome.get().copied().unwrap_or(JobOutcome::Succeeded),
        };
        drop(counted);
        self.origin.iter().for_each(|origin| self.observer.ended(origin, outcome));
    }

    fn end_stage(&self, now: &mut Now) {
        if let (Some(stage), Some(origin)) = (now.stage.take(), &self.origin) {
            self.observer.stage(stage.name, origin.backend, stage.since.elapsed());
        }
    }
}

impl StageListener for Activity {
    fn entered(&self, name: &'static str) {
        let mut now = lock(&self.now);
        if now.stage.as_ref().is_some_and(|stage| stage.name == name) {
            return;
        }
        self.end_stage(&mut now);
        let span = match now.span.is_none() {
            true => Span::none(),
            false => info_span!(parent: &now.span, "stage", stage = name, otel.name = name),
        };
        now.stage = Some(Stage { name, since: Instant::now(), span });
        drop(now);
        self.advance(name, 0, 0);
    }
}

/// Stages come by the token.
impl remesh::Observer for &Activity {
    fn iteration(&mut self, iteration: &Iteration, total: usize) {
        self.iterated(1);
        self.listener().iter().for_each(|listener| listener.iteration(iteration, total));
    }

    fn wants_seeds(&mut self) -> bool {
        self.listener().is_some_and(|listener| listener.wants_seeds())
    }

    fn seeds(&mut self, steps: usize, seeds: &[DVec3]) {
        self.listener().iter().for_each(|listener| listener.seeds(steps, seeds));
    }
}

pub(crate) struct Pass<'a> {
    activity: &'a Activity,
    backend: BackendKind,
    since: Instant,
    _span: Span,
}

impl Drop for Pass<'_> {
    fn drop(&mut self) {
        self.activity.observer.passed(self.backend, self.since.elapsed());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Writes down what is counted.
    #[derive(Default)]
    struct Notes(Mutex<Vec<String>>);

    impl Notes {
        fn add(&self, text: String) {
            self.0.lock().unwrap().push(text);
        }
    }

    impl Observer for Notes {
        fn moved(&self, kind: Kind, from: Option<Phase>, to: Option<Phase>) {
            self.add(format!("{} {from:?} {to:?}", kind.name()));
        }
        fn ended(&self, origin: &Origin, outcome: JobOutcome) {
            self.add(format!("{outcome:?} {} facets", origin.facets));
        }
        fn stage(&self, stage: &'static str, backend: BackendKind, _: Duration) {
            self.add(format!("{stage} {}", backend.name()));
        }
    }

    fn origin() -> Origin {
        Origin { kind: Kind::Remesh, backend: BackendKind::Serial, job: None, facets: 8, seeds: 6 }
    }

    fn notes_of(work: impl FnOnce(&Arc<dyn Observer>)) -> Vec<String> {
        let notes = Arc::new(Notes::default());
        let observer: Arc<dyn Observer> = notes.clone();
        work(&observer);
        let mut all = notes.0.lock().unwrap();
        std::mem::take(&mut *all)
    }

    #[test]
    fn a_job_is_counted_in_and_out() {
        let notes = notes_of(|observer| {
            let activity = QueuedActivity::new(observer, Some(origin())).begin();
            activity.entered("prepare");
            activity.entered("prepare");
            activity.entered("iterations");
            activity.end(None);
        });
        let expected = [
            "remesh None Some(Waiting)",
            "remesh Some(Waiting) Some(Running)",
            "prepare serial",
            "iterations serial",
            "remesh Some(Running) None",
            "Succeeded 8 facets",
        ];
        assert_eq!(notes, expected);
    }

    #[test]
    fn who_leaves_the_queue_is_counted_out() {
        let notes = notes_of(|observer| drop(QueuedActivity::new(observer, Some(origin()))));
        assert_eq!(notes, ["remesh None Some(Waiting)", "remesh Some(Waiting) None"]);
        let notes = notes_of(|observer| drop(QueuedActivity::new(observer, Some(origin())).begin()));
        assert_eq!(notes.last().unwrap(), "remesh Some(Running) None", "work that panics where nobody catches it");
    }

    #[test]
    fn an_end_is_counted_once_and_as_it_was() {
        use geometry::token::Stopped;
        let notes = notes_of(|observer| {
            let activity = QueuedActivity::new(observer, Some(origin())).begin();
            activity.set_outcome(JobOutcome::Failed);
            activity.end(None);
            activity.end(None);
            QueuedActivity::new(observer, Some(origin())).begin().end(Some(&Stopped::Cancelled.into()));
            QueuedActivity::new(observer, Some(origin())).begin().end(Some(&JobError::Draining));
        });
        let ends: Vec<_> = notes.iter().filter(|line| line.ends_with("facets")).collect();
        assert_eq!(ends, ["Failed 8 facets", "Cancelled 8 facets", "Failed 8 facets"]);
    }

    #[test]
    fn what_goes_on_is_not_counted() {
        let notes = notes_of(|observer| {
            let activity = QueuedActivity::new(observer, None).begin();
            activity.entered("iterations");
            activity.end(None);
        });
        assert!(notes.is_empty(), "{notes:?}");
    }
}
