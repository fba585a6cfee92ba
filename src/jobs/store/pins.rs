//! Pins of jobs.
//!
//! Purpose: what a job pins in which state; [`Pins`] does it for stores of one process. The input is pinned while the job waits or runs, the
//! result from before the job names it until it is let go. Invariant: a pin is set before the change that needs it is
//! kept, and ends after the change that ends it is kept. So a crash in between leaves a pin too many, never one too few.
//! There, pins are not in the tables: they follow from the jobs, and a start sets them again. Must not know: tables, where blobs
//! lie.

use std::sync::Arc;

use super::StoreError;
use crate::blob::index::LocalIndex;
use crate::blob::{Digest, Owner};
use crate::record::JobId;
use crate::record::state::State;

/// The name under which a job's input is pinned.
pub(crate) fn input_pin(id: JobId) -> String {
    format!("input:{id}")
}

/// The name under which a job's result is pinned. Whoever does the job pins the blobs of the result as they are stored.
pub fn result_pin(id: JobId) -> String {
    format!("result:{id}")
}

/// The names whose pins end when a job comes to a state.
pub(crate) fn over(id: JobId, state: State) -> Vec<String> {
    match state {
        State::Running => Vec::new(),
        // Of an attempt that came to nothing.
        State::Queued => vec![result_pin(id)],
        State::Succeeded => vec![input_pin(id)],
        State::Failed | State::Cancelled | State::Expired => vec![input_pin(id), result_pin(id)],
    }
}

#[derive(Debug, Default)]
pub(super) struct Pins {
    index: Arc<LocalIndex>,
    /// Names whose pins end once the changes so far are kept.
    over: Vec<String>,
}

impl Pins {
    pub(super) fn new(index: Arc<LocalIndex>) -> Self {
        Self { index, over: Vec::new() }
    }

    /// Pins the input of a new job in its tenant's name. Errors: `InputMissing`; nothing is pinned then.
    pub(super) fn create(&mut self, id: JobId, tenant: &str, input: &[Digest]) -> Result<(), StoreError> {
        let name = input_pin(id);
        let missing = self.index.hold(Owner::of(tenant), &name, input).err();
        if let Some(digest) = missing {
            return Err(StoreError::InputMissing { digest });
        }
        self.over.retain(|over| *over != name);
        Ok(())
    }

    /// A job changed to this state.
    pub(super) fn change(&mut self, id: JobId, state: State) {
        self.over.extend(over(id, state));
    }

    pub(super) fn delete(&mut self, id: JobId) {
        self.over.extend([input_pin(id), result_pin(id)]);
    }

    /// Pins again what is stored of the input of a job that waits, or of the result of one that succeeded.
    pub(super) fn recover(&self, id: JobId, state: State, owner: Owner, digests: &[Digest]) {
        let name = if state == State::Succeeded { result_pin(id) } else { input_pin(id) };
        for digest in digests {
            if self.index.hold(owner, &name, &[*digest]).is_err() {
                tracing::warn!(name, %digest, "a blob that a job needs is gone");
            }
        }
    }

    /// The changes so far are kept.
    pub(super) fn settle(&mut self) {
        self.over.drain(..).for_each(|name| self.index.release(&name));
    }
}
