//! Weights of tenants.
//!
//! Purpose: [`Weights`] says how large a tenant's share of the work is beside others'. Invariant: a weight is a number from
//! [`LEAST`] to [`MOST`]; a tenant without one has 1. Must not know: keys, the queue.

use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};

/// The smallest share, and the largest.
const LEAST: f64 = 0.01;
const MOST: f64 = 100.0;

/// See the module's head. Clones share one table.
#[derive(Clone, Debug, Default)]
pub struct Weights(Arc<RwLock<HashMap<String, f64>>>);

impl Weights {
    /// The weight of a tenant now.
    pub fn of(&self, tenant: &str) -> f64 {
        self.0.read().unwrap_or_else(PoisonError::into_inner).get(tenant).copied().unwrap_or(1.0)
    }

    /// Sets the weights of these tenants, and 1 for all others. Jobs that wait already keep theirs.
    pub fn set(&self, weights: impl IntoIterator<Item = (String, f64)>) {
        let sound = weights.into_iter().filter(|(_, weight)| weight.is_finite());
        let table = sound.map(|(tenant, weight)| (tenant, weight.clamp(LEAST, MOST))).collect();
        *self.0.write().unwrap_or_else(PoisonError::into_inner) = table;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_has_none_counts_once() {
        let weights = Weights::default();
        weights.clone().set([("a".to_owned(), 4.0), ("b".to_owned(), 0.0), ("c".to_owned(), f64::NAN)]);
        assert_eq!(["a", "b", "c", "d"].map(|tenant| weights.of(tenant)), [4.0, LEAST, 1.0, 1.0]);
        weights.set([]);
        assert_eq!(weights.of("a"), 1.0);
    }
}
