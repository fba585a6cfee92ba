//! What the operations need of a container: a few ordered tables of bytes.
//!
//! | table | key | value |
//! | --- | --- | --- |
//! | heads | job | tenant, labels, request, status, numbers of events |
//! | specs | job | the specification |
//! | logs | job | state changes, and the progress kept at the last of them |
//! | requests | tenant, 0, request | job |
//! | states | state, job | nothing |
//! | due | time, job | nothing: jobs with a deadline that runs |
//! | ended | time, job | 1 if there is a result: jobs that have ended |
//! | terms | label or tenant, job | nothing: for lists |
//!
//! Purpose: [`Tables`], so that the stores of one process share their operations. Invariant: keys are in the order of their
//! bytes. Must not know: what the bytes mean.

use std::ops::ControlFlow;

use super::StoreError;

/// One of the tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Table {
    Heads,
    Specs,
    Logs,
    Requests,
    States,
    Due,
    Ended,
    Terms,
}

impl Table {
    pub(super) const ALL: [Self; 8] =
        [Self::Heads, Self::Specs, Self::Logs, Self::Requests, Self::States, Self::Due, Self::Ended, Self::Terms];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Heads => "heads",
            Self::Specs => "specs",
            Self::Logs => "logs",
            Self::Requests => "requests",
            Self::States => "states",
            Self::Due => "due",
            Self::Ended => "ended",
            Self::Terms => "terms",
        }
    }
}

/// Which way a range is visited.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    Up,
    Down,
}

pub(super) type Visit<'a> = dyn FnMut(&[u8], &[u8]) -> Result<ControlFlow<()>, StoreError> + 'a;

/// Reading.
pub(super) trait Tables {
    fn get(&self, table: Table, key: &[u8]) -> Result<Option<Vec<u8>>, StoreError>;

    /// Visits keys from `from` to before `to` until told to break.
    fn visit(&self, table: Table, range: (&[u8], &[u8]), order: Order, visit: &mut Visit<'_>)
    -> Result<(), StoreError>;
}

/// Writing.
pub(super) trait TablesMut: Tables {
    fn put(&mut self, table: Table, key: &[u8], value: &[u8]) -> Result<(), StoreError>;
    fn remove(&mut self, table: Table, key: &[u8]) -> Result<(), StoreError>;
}
