//! A step length along a direction of descent.
//!
//! Purpose: the strong Wolfe conditions, found by bracketing and cubic interpolation (Nocedal and
//! Wright, Numerical Optimization, 2nd edition, Algorithms 3.5 and 3.6).
//! Invariant: an accepted step lowers the energy; the last probe is the accepted one.
//! Must not know: where vectors live, what the function is.

use crate::rvd::{Evaluation, PassStats, Resident, RvdError};
use crate::token::Token;

/// Sufficient decrease, as a share of what the slope promises.
const DECREASE: f64 = 1e-4;
/// Remaining slope, as a share of the first.
const CURVATURE: f64 = 0.9;
/// Probes in one search.
const MAX_PROBES: usize = 20;
/// A step grows by at most this factor between two probes.
const GROWTH: f64 = 4.0;
/// An interpolated step stays this share of the bracket away from its ends.
const MARGIN: f64 = 0.1;

pub(super) struct Found {
    /// The last probe; `None` if no step lowered the energy enough.
    pub(super) evaluation: Option<Evaluation>,
    pub(super) probes: usize,
    pub(super) stats: PassStats,
}

#[derive(Clone, Copy)]
struct Point {
    step: f64,
    evaluation: Evaluation,
}

struct Search<'a, P: crate::knn::Point> {
    vectors: &'a mut dyn Resident<P>,
    token: &'a Token,
    /// Energy and slope at step 0.
    energy: f64,
    slope: f64,
    found: Found,
}

/// Searches from a point whose slope is below 0, beginning with the step `first`.
pub(super) fn search<P: crate::knn::Point>(
    vectors: &mut dyn Resident<P>,
    at: Evaluation,
    first: f64,
    token: &Token,
) -> Result<Found, RvdError> {
    let found = Found { evaluation: None, probes: 0, stats: PassStats::default() };
    let mut search = Search { vectors, token, energy: at.energy, slope: at.slope, found };
    let mut before = Point { step: 0.0, evaluation: at };
    let mut step = first;
    while search.found.probes < MAX_PROBES {
        let here = search.probe(step)?;
        if !search.decreases(here) || (before.step > 0.0 && here.evaluation.energy >= before.evaluation.energy) {
            return search.zoom(before, here);
        }
        if search.is_flat(here) {
            return Ok(search.end(Some(here)));
        }
        if here.evaluation.slope >= 0.0 {
            return search.zoom(here, before);
        }
        let target = minimum(before, here);
        step = if target > step { target.min(GROWTH * step).max(1.1 * step) } else { GROWTH * step };
        before = here;
    }
    // The last probe lowered the energy; only its slope was still steep.
    Ok(search.end(Some(before)))
}

impl<P: crate::knn::Point> Search<'_, P> {
    fn probe(&mut self, step: f64) -> Result<Point, RvdError> {
        let evaluation = self.vectors.probe(step, self.token)?;
        self.found.probes += 1;
        self.found.stats.add(&evaluation.stats);
        Ok(Point { step, evaluation })
    }

    fn decreases(&self, here: Point) -> bool {
        here.evaluation.energy <= self.energy + DECREASE * here.step * self.slope
    }

    fn is_flat(&self, here: Point) -> bool {
        here.evaluation.slope.abs() <= -CURVATURE * self.slope
    }

    /// Narrows the bracket between `low`, the best step so far, and `high`.
    fn zoom(mut self, mut low: Point, mut high: Point) -> Result<Found, RvdError> {
        while self.found.probes < MAX_PROBES {
            let (from, to) = (low.step.min(high.step), low.step.max(high.step));
            let margin = MARGIN * (to - from);
            let step = minimum(low, high).clamp(from + margin, to - margin);
            if step <= from || step >= to {
                break;
            }
            let here = self.probe(step)?;
            if !self.decreases(here) || here.evaluation.energy >= low.evaluation.energy {
                high = here;
                continue;
            }
            if self.is_flat(here) {
                return Ok(self.end(Some(here)));
            }
            if here.evaluation.slope * (high.step - low.step) >= 0.0 {
                high = low;
            }
            low = here;
        }
        if low.step == 0.0 {
            return Ok(self.end(None));
        }
        // The best step was not the last probe: it is taken again.
        let low = self.probe(low.step)?;
        Ok(self.end(Some(low)))
    }

    fn end(mut self, at: Option<Point>) -> Found {
        self.found.evaluation = at.map(|p| p.evaluation);
        self.found
    }
}

/// The minimum of the cubic through two points' values and slopes, or their middle.
fn minimum(a: Point, b: Point) -> f64 {
    let width = b.step - a.step;
    let d1 = a.evaluation.slope + b.evaluation.slope - 3.0 * (b.evaluation.energy - a.evaluation.energy) / width;
    let root = d1 * d1 - a.evaluation.slope * b.evaluation.slope;
    let d2 = root.max(0.0).sqrt().copysign(width);
    let step = b.step - width * (b.evaluation.slope + d2 - d1) / (b.evaluation.slope - a.evaluation.slope + 2.0 * d2);
    if step.is_finite() { step } else { 0.5 * (a.step + b.step) }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::rvd::CellSums;

    /// A function of the step alone.
    struct Line<F>(F, Vec<f64>);

    impl<F: Fn(f64) -> (f64, f64)> Resident for Line<F> {
        fn hold(&mut self, _: &[bool]) -> Result<(), RvdError> {
            Ok(())
        }
        fn evaluate(&mut self, _: &Token) -> Result<Evaluation, RvdError> {
            Ok(Evaluation::default())
        }
        fn to_centroids(&mut self) -> Result<(), RvdError> {
            Ok(())
        }
        fn search_direction(&mut self) -> Result<f64, RvdError> {
            Ok(self.0(0.0).1)
        }
        fn probe(&mut self, step: f64, _: &Token) -> Result<Evaluation, RvdError> {
            self.1.push(step);
            let (energy, slope) = self.0(step);
            Ok(Evaluation { energy, slope, ..Evaluation::default() })
        }
        fn accept(&mut self) -> Result<(), RvdError> {
            Ok(())
        }
        fn clear_history(&mut self) {}
        fn read(&mut self, _: &mut Vec<DVec3>) -> Result<(), RvdError> {
            Ok(())
        }
        fn read_sums(&mut self, _: &mut CellSums) -> Result<(), RvdError> {
            Ok(())
        }
    }

    fn find(f: impl Fn(f64) -> (f64, f64), first: f64) -> (Found, f64) {
        let mut line = Line(&f, Vec::new());
        let (energy, slope) = f(0.0);
        let present = Evaluation { energy, slope, ..Evaluation::default() };
        let found = search(&mut line, present, first, &Token::default()).unwrap();
        let last = *line.1.last().unwrap();
        (found, last)
    }

    #[test]
    fn a_parabola_from_steps_too_short_and_too_long() {
        let parabola = |t: f64| ((t - 3.0) * (t - 3.0), 2.0 * (t - 3.0));
        for first in [1e-4, 0.1, 1.0, 3.0, 40.0, 1e5] {
            let (found, step) = find(parabola, first);
            let evaluation = found.evaluation.unwrap();
            assert!(evaluation.energy < 9.0 && evaluation.slope.abs() <= 0.9 * 6.0, "{first}: {step}");
            assert_eq!(evaluation.energy, parabola(step).0, "the accepted step is the last probe");
        }
        assert_eq!(find(parabola, 2.9).0.probes, 1);
    }

    #[test]
    fn a_wavy_valley_and_a_rise() {
        let wavy = |t: f64| (-t + 0.3 * (8.0 * t).sin() + 0.05 * t * t, -1.0 + 2.4 * (8.0 * t).cos() + 0.1 * t);
        let descent = |t: f64| wavy(t + 0.3);
        let (found, _) = find(descent, 2.0);
        assert!(found.evaluation.unwrap().energy < descent(0.0).0);
        // Says that it falls and rises: no step is acceptable.
        let (found, _) = find(|t: f64| (t, if t == 0.0 { -1.0 } else { 1.0 }), 1.0);
        assert!(found.evaluation.is_none() && found.probes <= MAX_PROBES + 1);
    }

    #[test]
    fn a_slope_without_end_stops() {
        let (found, _) = find(|t: f64| (-t, -1.0), 1.0);
        assert!(found.evaluation.is_some() && found.probes == MAX_PROBES);
    }
}
