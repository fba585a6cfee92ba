//! Facets shared out to threads, and their sums.
//!
//! Purpose: a `chunk` is a task's share of the facets; what it finds is `written` down piece by piece and added up in one
//! order.
//! Invariant: no sum depends on how facets are shared out. Must not know: how seeds are listed.

pub(super) mod chunk;
mod written;
