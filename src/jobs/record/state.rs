//! The states of a job, and the one machine that says how they follow each other.
//!
//! | from | claim | release | orphan | succeed | fail | cancel | expire |
//! | --- | --- | --- | --- | --- | --- | --- | --- |
//! | queued | running | | | | failed | cancelled | expired |
//! | running | | queued | queued | succeeded | failed | cancelled | expired |
//! | succeeded | | | | | | | expired |
//! | failed, cancelled, expired | | | | | | | |
//!
//! | transition | made by |
//! | --- | --- |
//! | claim | an executor that takes a lease |
//! | release | the executor that has the lease and stops before the job is done, as at shutdown |
//! | orphan | the process at its start, or any process once the lease ran out: the executor is gone |
//! | succeed | the executor that has the lease |
//! | fail | the executor that has the lease; or the one that finds that a queued job cannot run, or has crashed too often |
//! | cancel | the caller |
//! | expire | the sweep, when a deadline has passed or a result was kept as long as results are |
//!
//! Purpose: [`State`], [`Transition`], [`apply`]. Invariant: `apply` is total, and nothing else decides what may follow.
//! Must not know: stores, clocks, what a job does.

use serde::{Deserialize, Serialize};
use strum::{IntoStaticStr, VariantNames};

pub use super::Transition;

#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, IntoStaticStr, VariantNames,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum State {
    Queued,
    Running,
    Succeeded,
    Failed,
    Cancelled,
    /// A deadline passed, or its result was kept as long as results are.
    Expired,
}

impl State {
    pub const ALL: [Self; 6] =
        [Self::Queued, Self::Running, Self::Succeeded, Self::Failed, Self::Cancelled, Self::Expired];

    pub fn is_ended(self) -> bool {
        !matches!(self, Self::Queued | Self::Running)
    }

    /// Its name, as people and records write it.
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// A transition that the state does not allow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a job that is {} cannot be {}", state.name(), match transition {
    Transition::Claim => "claimed",
    Transition::Release => "released",
    Transition::Orphan => "taken back",
    Transition::Succeed => "completed",
    Transition::Fail => "failed",
    Transition::Cancel => "cancelled",
    Transition::Expire => "expired",
})]
pub struct TransitionError {
    pub state: State,
    pub transition: Transition,
}

/// The state after `transition`. Errors: [`TransitionError`] where the table at the head of the module has no entry.
pub fn apply(state: State, transition: Transition) -> Result<State, TransitionError> {
    use State as S;
    use Transition as T;
    match (state, transition) {
        (S::Queued, T::Claim) => Ok(S::Running),
        (S::Running, T::Release | T::Orphan) => Ok(S::Queued),
        (S::Running, T::Succeed) => Ok(S::Succeeded),
        (S::Queued | S::Running, T::Fail) => Ok(S::Failed),
        (S::Queued | S::Running, T::Cancel) => Ok(S::Cancelled),
        (S::Queued | S::Running | S::Succeeded, T::Expire) => Ok(S::Expired),
        _ => Err(TransitionError { state, transition }),
    }
}
