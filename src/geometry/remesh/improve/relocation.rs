//! Relocation of one vertex.
//!
//! Purpose: the one search for a better place. [`places_around`] are the places of one step, [`cheapest`] is the best of some
//! places, [`Steps`] knows how long the next step of each vertex is.
//! Invariant: a vertex stays unless a place costs clearly less. Must not know: what a place costs.

use glam::DVec3;

use crate::remesh::constants::{DIRECTIONS, MAX_HALVINGS, NORMAL_STEP};

/// Places one step away: in the plane of `x` and `y`, then to either side of it.
pub(super) fn places_around(here: DVec3, step: f64, [x, y]: [DVec3; 2]) -> impl Iterator<Item = DVec3> {
    let in_plane = (0..DIRECTIONS).map(move |k| {
        let (sin, cos) = (k as f64 / DIRECTIONS as f64 * std::f64::consts::TAU).sin_cos();
        cos * x + sin * y
    });
    let up = NORMAL_STEP * x.cross(y);
    in_plane.chain([up, -up]).map(move |way| here + step * way)
}

/// The first of the cheapest places, with its cost; that which is given if none costs less by `gain`. `cost` may answer any
/// number that is not less than its second argument if the cost is not less.
pub(super) fn cheapest(
    given: (f64, DVec3),
    gain: f64,
    places: impl Iterator<Item = DVec3>,
    mut cost: impl FnMut(DVec3, f64) -> f64,
) -> (f64, DVec3) {
    places.fold(given, |best, p| {
        let most = best.0 - gain;
        let cost = cost(p, most);
        if cost < most { (cost, p) } else { best }
    })
}

/// How often the step of each vertex was halved.
#[derive(Clone)]
pub(super) struct Steps(Vec<u8>);

impl Steps {
    pub(super) fn new(vertices: usize) -> Self {
        Self(vec![0; vertices])
    }

    /// The share of the first step that a vertex tries next; `None` if it has tried all.
    pub(super) fn next(&self, v: u32) -> Option<f64> {
        let halvings = self.0[v as usize];
        (halvings < MAX_HALVINGS).then(|| 0.5f64.powi(halvings.into()))
    }

    /// None of the places was better.
    pub(super) fn halve(&mut self, v: u32) {
        self.0[v as usize] += 1;
    }

    /// Something around a vertex has changed: it tries its last step again.
    pub(super) fn renew(&mut self, v: u32) {
        self.0[v as usize] = self.0[v as usize].min(MAX_HALVINGS - 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ever_shorter_steps_find_the_least_cost() {
        let goal = DVec3::new(0.3, -0.2, 0.1);
        let cost = |p: DVec3, _: f64| p.distance(goal);
        let (mut steps, mut here) = (Steps::new(1), DVec3::ZERO);
        while let Some(share) = steps.next(0) {
            let places = places_around(here, 0.2 * share, [DVec3::X, DVec3::Y]);
            let (_, best) = cheapest((cost(here, 0.0), here), 1e-4, places, cost);
            if best == here {
                steps.halve(0);
            }
            here = best;
        }
        assert!(here.distance(goal) < 0.03, "{here}");
        steps.renew(0);
        assert_eq!(steps.next(0), Some(0.125));
    }
}
