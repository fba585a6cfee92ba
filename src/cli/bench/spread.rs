//! Least, middle and most of some measurements.
//!
//! Purpose: one number is none; [`Spread`] says how far they lie apart. Invariant: the order of the measurements does not matter.
//! Must not know: what was measured.

use serde::Serialize;

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    pub(super) min: f64,
    pub(super) median: f64,
    pub(super) max: f64,
    /// What a step costs, where some make what several use.
    pub(super) mean: f64,
}

impl Spread {
    /// Of these; 0 of none.
    pub(super) fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |k: usize| sorted.get(k).copied().unwrap_or(0.0);
        let mean = sorted.iter().sum::<f64>() / sorted.len().max(1) as f64;
        Self { min: at(0), median: at(sorted.len() / 2), max: at(sorted.len().saturating_sub(1)), mean }
    }

    pub(super) fn row(&self, name: &str) -> String {
        format!("{name:<22}{:>10.3}{:>10.3}{:>10.3}{:>10.3}", self.min, self.median, self.max, self.mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_least_middle_and_most() {
        let of = |values: &[f64]| Spread::of(values.iter().copied());
        assert_eq!(of(&[3.0, 1.0, 2.0]), Spread { min: 1.0, median: 2.0, max: 3.0, mean: 2.0 });
        assert_eq!(of(&[5.0]), Spread { min: 5.0, median: 5.0, max: 5.0, mean: 5.0 });
        assert_eq!(of(&[]), Spread { min: 0.0, median: 0.0, max: 0.0, mean: 0.0 });
    }
}
