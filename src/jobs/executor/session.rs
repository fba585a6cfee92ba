//! An interactive session of CVT iterations on the engine's threads.
//!
//! Purpose: [`CvtSession`] keeps a [`Cvt`] between the commands of its caller. Every command is a piece of work of its own,
//! so that a slow caller blocks no other. Invariant: the state is either here or in one submitted piece; what is dropped is
//! dropped on the engine's threads. A long command gives way after a slice of time. Must not know: messages.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DVec3;

use crate::executor::prepared::Prepared;
use crate::executor::streams::Place;
use crate::{Admission, BackendInfo, Engine, JobError, Pending, Retry, Timed, WorkContext};
use geometry::cvt::{Cvt, CvtOptions, Iteration, SeedEdit, StepKind};
use geometry::rvd::BackendChoice;
use wire::proto::SeedsWanted;

/// How long a step command keeps the device before others get a turn.
const SLICE: Duration = Duration::from_millis(100);

/// Steps in one slice at most: the answers of a slice travel together.
const SLICE_STEPS: usize = 64;

/// Steps that were taken in one turn, each with the seeds after it if they were wanted.
pub type Steps = Vec<(Iteration, Option<Vec<DVec3>>)>;

pub struct CvtSession {
    engine: Engine,
    by: BackendInfo,
    /// `None` while a piece has it, and after an error took it.
    cvt: Option<Cvt>,
}

impl CvtSession {
    /// Queues the opening of a session, for which a place was kept. Errors: `QueueFull`, `Draining`, `BackendUnavailable`.
    pub fn open(
        engine: &Engine,
        prepared: Arc<Prepared>,
        choice: BackendChoice,
        options: CvtOptions,
        place: Place,
    ) -> Result<Pending<(Cvt, BackendInfo)>, JobError> {
        engine.submit(Admission::Reserved(place.request), Retry::Restart, move |backends, context| {
            context.token.check()?;
            let backend = backends.choose(choice)?;
            let cvt = Cvt::new(backend.as_ref(), Arc::clone(&prepared.surface), &prepared.seeds, options)?;
            Ok((cvt, BackendInfo::of(backend.as_ref())))
        })
    }

    pub fn new(engine: Engine, (cvt, by): (Cvt, BackendInfo)) -> Self {
        Self { engine, by, cvt: Some(cvt) }
    }

    pub fn by(&self) -> &BackendInfo {
        &self.by
    }

    pub fn seed_count(&self) -> usize {
        self.cvt.as_ref().map_or(0, Cvt::len)
    }

    /// The seeds now, caller's coordinates. Errors: what the backend says; the session is then over.
    pub async fn seeds(&mut self) -> Result<Timed<Vec<DVec3>>, JobError> {
        self.call(|cvt, _| Ok(cvt.seeds()?)).await
    }

    /// Takes at least one and at most `steps` steps of a kind, as many as fit a slice of time. With `SeedsWanted::Each` one
    /// step is taken: seeds are large, and the caller sends them on first. Errors: what the backend says; the session is
    /// then over.
    pub async fn step(&mut self, steps: usize, kind: StepKind, seeds: SeedsWanted) -> Result<Timed<Steps>, JobError> {
        self.call(move |cvt, context| {
            let token = &context.token;
            let start = Instant::now();
            let mut taken = Steps::new();
            let most = if seeds == SeedsWanted::Each { 1 } else { steps.min(SLICE_STEPS) };
            while taken.len() < most.max(1) {
                let iterations = match kind {
                    StepKind::Lloyd => cvt.relax(most.max(1) - taken.len(), token)?,
                    StepKind::Lbfgs => vec![cvt.lbfgs(token)?],
                };
                context.activity.iterated(iterations.len() as u64);
                taken.extend(iterations.into_iter().map(|iteration| (iteration, None)));
                let last = taken.len() == steps;
                let wanted = seeds == SeedsWanted::Each || (seeds == SeedsWanted::Last && last);
                if let Some(taken) = taken.last_mut().filter(|_| wanted) {
                    taken.1 = Some(cvt.seeds()?);
                }
                if start.elapsed() >= SLICE {
                    break;
                }
            }
            Ok(taken)
        })
        .await
    }

    /// Changes the seeds. Errors: what is wrong with an edit; nothing is then changed.
    pub async fn edit(&mut self, edits: Vec<SeedEdit>) -> Result<Timed<()>, JobError> {
        let mut edited = self.call(move |cvt, _| Ok(cvt.edit(&edits))).await?;
        std::mem::replace(&mut edited.value, Ok(()))?;
        Ok(Timed { value: (), queue_ms: edited.queue_ms, compute_ms: edited.compute_ms })
    }

    async fn call<R: Send + 'static>(
        &mut self,
        mut work: impl FnMut(&mut Cvt, &WorkContext) -> Result<R, JobError> + Send + 'static,
    ) -> Result<Timed<R>, JobError> {
        let mut state = self.cvt.take();
        let mut pending = self.engine.submit(Admission::Session, Retry::Never, move |_, context| {
            let mut cvt = state.take().ok_or(JobError::WorkerGone)?;
            let answer = work(&mut cvt, context)?;
            Ok((cvt, answer))
        })?;
        let Timed { value: (cvt, value), queue_ms, compute_ms } = pending.wait().await?;
        self.cvt = Some(cvt);
        Ok(Timed { value, queue_ms, compute_ms })
    }
}

impl Drop for CvtSession {
    fn drop(&mut self) {
        if let Some(cvt) = self.cvt.take() {
            self.engine.dispose(cvt);
        }
    }
}
