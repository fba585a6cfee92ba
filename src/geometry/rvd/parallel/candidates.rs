//! The seeds whose cells may meet a facet.
//!
//! Purpose: lists of seeds for every facet, which serve several passes as Verlet lists: `gather` finds them from rows of
//! neighbours or one by one, `neighbourhood` for several facets at once, `list_builder` for a task; `verlet` says how long
//! they hold, but for the seeds that have `escaped`; `members` leaves those that count.
//! Invariant: no seed whose cell meets a facet is missing from its list. Must not know: integrals, tasks.

pub(super) mod escaped;
pub(super) mod gather;
pub(super) mod list_builder;
pub(super) mod lists;
pub(super) mod members;
pub(super) mod neighbourhood;
pub(super) mod verlet;
