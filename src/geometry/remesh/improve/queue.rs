//! A queue of vertices by priority.
//!
//! Purpose: the worst comes first; of equally bad vertices that with the lower number. A vertex may be in it several times:
//! its taker checks whether it is still as bad.
//! Invariant: the order depends on what was put in alone. Must not know: what makes a vertex bad.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// A vertex, and how bad it is. Vertices of a higher kind come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Place<K> {
    pub(super) kind: K,
    /// Numbers from zero on have the order of their bits.
    bits: u64,
    vertex: Reverse<u32>,
}

pub(super) type Queue<K> = BinaryHeap<Place<K>>;

impl<K> Place<K> {
    /// `badness` is not negative.
    pub(super) fn new(kind: K, vertex: u32, badness: f64) -> Self {
        Self { kind, bits: badness.max(0.0).to_bits(), vertex: Reverse(vertex) }
    }

    pub(super) fn vertex(&self) -> u32 {
        self.vertex.0
    }

    pub(super) fn badness(&self) -> f64 {
        f64::from_bits(self.bits)
    }
}
