//! When iterations may stop.
//!
//! Purpose: the tests of the design, section 3, "Optimiser".
//! Invariant: only accepted steps are judged. Must not know: what a step is.

/// The gradient has shrunk to this share of the first one.
const GRADIENT: f64 = 1e-3;
/// A step that gains less than this share of the energy counts as a standstill.
const GAIN: f64 = 1e-6;
/// Consecutive standstills that end the steps.
const STANDSTILLS: usize = 2;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Convergence {
    /// Norm of the first gradient.
    first: Option<f64>,
    standstills: usize,
}

impl Convergence {
    /// Hears of a point: the first one gives the gradient that later ones are measured by.
    pub(super) fn begin(&mut self, gradient_norm: f64) {
        self.first.get_or_insert(gradient_norm);
    }

    /// Judges a step from energy `before` to energy `after`.
    pub(super) fn judge(&mut self, before: f64, after: f64, gradient_norm: f64) -> bool {
        let gained = before - after > GAIN * before.abs();
        self.standstills = if gained { 0 } else { self.standstills + 1 };
        let first = *self.first.get_or_insert(gradient_norm);
        self.standstills >= STANDSTILLS || gradient_norm <= GRADIENT * first
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_standstills_running_or_a_small_gradient() {
        let mut test = Convergence::default();
        test.begin(1.0);
        assert!(!test.judge(2.0, 1.0, 0.5));
        assert!(!test.judge(1.0, 1.0, 0.5));
        assert!(!test.judge(1.0, 0.9, 0.5));
        assert!(!test.judge(0.9, 0.9, 0.5));
        assert!(test.judge(0.9, 0.9, 0.5));
        let mut test = Convergence::default();
        test.begin(1.0);
        assert!(!test.judge(1.0, 0.9, 0.002));
        assert!(test.judge(0.9, 0.8, 0.001));
    }
}
