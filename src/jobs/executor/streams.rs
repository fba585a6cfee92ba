//! Work of a stream, whose caller waits for it.
//!
//! Purpose: [`StreamWork`] queues the pieces of a remesh or a diagram, as [`super::session`] does for a session and
//! [`super::running`] for kept jobs. Invariant: a place that was kept for an upload is free once its work is queued. What
//! is kept between two pieces is with the caller or in one piece. Must not know: messages, clients.

use std::sync::Arc;

use super::diagram::{Diagram, WorldSums};
use super::prepared::Prepared;
use crate::observe::activity::Listener;
use crate::{
    Admission, AdmissionRequest, BackendInfo, Backends, Engine, JobError, Pending, Reservation, Retry, WorkContext,
};
use geometry::mesh::TriMesh;
use geometry::remesh::{Remesh, RemeshOptions, remesh};
use geometry::rvd::{Backend, BackendChoice, PieceBatch};
use geometry::token::Token;

/// A place in the queue, kept for a job while its input is uploaded.
pub struct Place {
    pub reservation: Reservation,
    pub request: AdmissionRequest,
}

/// A diagram, and its next pieces if there are more.
pub type Batch = (Box<Diagram>, Option<PieceBatch>);

/// The pieces of work of one job. They share a token.
pub struct StreamWork {
    engine: Engine,
    choice: BackendChoice,
    by: BackendInfo,
    token: Token,
}

impl StreamWork {
    /// Errors: `BackendUnavailable`.
    pub fn new(engine: &Engine, choice: BackendChoice) -> Result<Self, JobError> {
        Ok(Self { engine: engine.clone(), choice, by: engine.backend(choice)?, token: engine.token() })
    }

    /// The backend that is chosen now.
    pub fn by(&self) -> &BackendInfo {
        &self.by
    }

    pub fn token(&self) -> &Token {
        &self.token
    }

    /// Queues a remesh. `begin` gets the time in the queue, ms, and gives the listener. It is called again if the device is
    /// lost. Errors: `QueueFull`, `Draining`.
    pub fn remesh(
        &self,
        place: Place,
        mesh: TriMesh,
        options: RemeshOptions,
        begin: impl Fn(f64) -> Arc<dyn Listener> + Send + 'static,
    ) -> Result<Pending<Remesh>, JobError> {
        self.first(place, move |backend, context| {
            context.activity.listen(begin(context.queue_ms));
            Ok(remesh(&mesh, &options, backend, &mut &*context.activity, &context.token)?)
        })
    }

    /// Queues the opening of a diagram, and its sums if they are wanted. Errors: `QueueFull`, `Draining`.
    pub fn diagram(
        &self,
        place: Place,
        prepared: Arc<Prepared>,
        wants_sums: bool,
    ) -> Result<Pending<(Box<Diagram>, WorldSums)>, JobError> {
        self.first(place, move |backend, context| {
            let mut diagram = Diagram::open(&prepared, backend)?;
            let sums = match wants_sums {
                true => diagram.sums(backend, &context.token)?,
                false => WorldSums::default(),
            };
            Ok((Box::new(diagram), sums))
        })
    }

    /// Queues the next batch of a diagram. It goes before new jobs, since its own has had its turn. Errors: `Draining`.
    pub fn batch(&self, diagram: Box<Diagram>) -> Result<Pending<Batch>, JobError> {
        let (choice, mut state) = (self.choice, Some(diagram));
        let work = move |backends: &Backends, context: &WorkContext| {
            let mut diagram = state.take().ok_or(JobError::WorkerGone)?;
            let batch = diagram.batch(backends.choose(choice)?.as_ref(), &context.token)?;
            Ok((diagram, batch))
        };
        self.engine.submit_as(self.token.clone(), Admission::Continuation, Retry::Never, work)
    }

    /// Gives up the session of a diagram whose caller reads slowly. The next batch opens another.
    pub fn rest(&self, diagram: &mut Diagram) {
        diagram.rest().into_iter().for_each(|session| self.engine.dispose(session));
    }

    /// Drops a diagram on a host thread.
    pub fn dispose(&self, diagram: Box<Diagram>) {
        self.engine.dispose(diagram);
    }

    /// Queues the first piece, which starts again after a lost device.
    fn first<R: Send + 'static>(
        &self,
        Place { reservation, request }: Place,
        mut work: impl FnMut(&dyn Backend, &WorkContext) -> Result<R, JobError> + Send + 'static,
    ) -> Result<Pending<R>, JobError> {
        let choice = self.choice;
        let work = move |backends: &Backends, context: &WorkContext| {
            context.token.check()?;
            work(backends.choose(choice)?.as_ref(), context)
        };
        let pending = self.engine.submit_as(self.token.clone(), Admission::Reserved(request), Retry::Restart, work);
        drop(reservation);
        pending
    }
}
