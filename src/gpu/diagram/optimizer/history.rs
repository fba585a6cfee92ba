//! The quasi-Newton history as scalars.
//!
//! Purpose: the two-loop recursion works on steps s, changes of the gradient y and the gradient g only by their dot products,
//! and those of y and g divided by the cells' masses, so the host does it on those, in f64, and the device combines the vectors
//! once (\[FWW14\] does L-BFGS on a GPU loop by loop; this way there is one stage instead of thirty). Invariant: a pair is in
//! use only if sᵀy > 1e-10 ‖s‖ ‖y‖; the oldest goes where there are [`HISTORY`]. Must not know: the device.

use crate::diagram::layout::{DOTS, PAIRS, PLAIN_DOTS};
use geometry::rvd::resident::HISTORY;

/// Vectors there are: steps, changes, the gradient.
const VECTORS: usize = 2 * PAIRS + 1;
const GRADIENT: usize = 2 * PAIRS;

/// Which slots hold pairs, and all dot products among them and with the gradient.
#[derive(Default)]
pub(super) struct History {
    /// Slots in use, oldest first.
    order: Vec<usize>,
    products: [[f64; VECTORS]; VECTORS],
    /// Of each change, divided by masses, with every change and the gradient.
    preconditioned: [[f64; PAIRS + 1]; PAIRS],
}

impl History {
    pub(super) fn clear(&mut self) {
        self.order.clear();
    }

    /// Empties it if it has no scale: where the last change has to do with cells alone that have lost their mass.
    pub(super) fn drop_without_scale(&mut self) {
        if self
            .order
            .last()
            .is_some_and(|&last| !(self.products[last][PAIRS + last] / self.preconditioned[last][last]).is_finite())
        {
            self.clear();
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// A slot for the next pair. There is one slot more than pairs.
    pub(super) fn free_slot(&self) -> usize {
        (0..PAIRS).find(|slot| !self.order.contains(slot)).unwrap_or(0)
    }

    /// The slots in use and one more, as bits.
    pub(super) fn used(&self, slot: usize) -> u32 {
        self.order.iter().fold(1 << slot, |bits, &slot| bits | 1 << slot)
    }

    /// Takes what the `partial_dots` stage says of the pair in `slot` and of the gradient, and of all changes divided by masses.
    pub(super) fn learn(&mut self, slot: usize, dots: &[f32; DOTS]) {
        for which in 0..VECTORS {
            for (k, other) in [slot, PAIRS + slot, GRADIENT].into_iter().enumerate() {
                let dot = f64::from(dots[3 * which + k]);
                self.products[which][other] = dot;
                self.products[other][which] = dot;
            }
        }
        let pairs = (0..PAIRS).flat_map(|k| (k..=PAIRS).map(move |j| (k, j)));
        for ((k, j), &dot) in pairs.zip(&dots[PLAIN_DOTS..]) {
            self.preconditioned[k][j] = f64::from(dot);
            if j < PAIRS {
                self.preconditioned[j][k] = f64::from(dot);
            }
        }
    }

    /// Takes the pair in `slot` into use, if it is any good.
    pub(super) fn take(&mut self, slot: usize) {
        let (s, y) = (slot, PAIRS + slot);
        let least = 1e-10 * (self.products[s][s] * self.products[y][y]).sqrt();
        // Written so that NaN fails.
        if self.products[s][y] > least {
            if self.order.len() == HISTORY {
                self.order.remove(0);
            }
            self.order.push(slot);
        }
    }

    /// Coefficients of -H g: of the steps, and of the changes and the gradient, both divided by masses.
    pub(super) fn direction(&self) -> [f64; VECTORS] {
        let mut c = [0.0; VECTORS];
        c[GRADIENT] = -1.0;
        let along =
            |c: &[f64; VECTORS], v: usize| -> f64 { (0..VECTORS).map(|k| c[k] * self.product(v, k, c[k])).sum() };
        let mut alphas = Vec::with_capacity(HISTORY);
        for &slot in self.order.iter().rev() {
            let alpha = along(&c, slot) / self.products[slot][PAIRS + slot];
            c[PAIRS + slot] -= alpha;
            alphas.push(alpha);
        }
        if let Some(&last) = self.order.last() {
            // Steps have no part yet.
            let scale = self.products[last][PAIRS + last] / self.preconditioned[last][last];
            c.iter_mut().for_each(|x| *x *= scale);
        }
        for (&slot, alpha) in self.order.iter().zip(alphas.iter().rev()) {
            let steps: f64 = (0..PAIRS).map(|k| c[k] * self.product(PAIRS + slot, k, c[k])).sum();
            let of = |k: usize| if c[PAIRS + k] == 0.0 { 0.0 } else { c[PAIRS + k] * self.preconditioned[slot][k] };
            let beta = (steps + (0..=PAIRS).map(of).sum::<f64>()) / self.products[slot][PAIRS + slot];
            c[slot] += alpha - beta;
        }
        c
    }

    /// A product, or 0 where the coefficient is: what a slot out of use holds may be no number.
    fn product(&self, v: usize, k: usize, coefficient: f64) -> f64 {
        if coefficient == 0.0 { 0.0 } else { self.products[v][k] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn dot(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(x, y)| x * y).sum()
    }

    fn preconditioned(v: &[f64], preconditioner: &[f64]) -> Vec<f64> {
        v.iter().zip(preconditioner).map(|(v, preconditioner)| v * preconditioner).collect()
    }

    /// The recursion on the vectors themselves.
    fn two_loops(pairs: &[(Vec<f64>, Vec<f64>)], g: &[f64], preconditioner: &[f64]) -> Vec<f64> {
        let mut q: Vec<f64> = g.iter().map(|x| -x).collect();
        let mut alphas = Vec::new();
        for (s, y) in pairs.iter().rev() {
            let alpha = dot(s, &q) / dot(s, y);
            q.iter_mut().zip(y).for_each(|(q, y)| *q -= alpha * y);
            alphas.push(alpha);
        }
        if let Some((s, y)) = pairs.last() {
            let scale = dot(s, y) / dot(y, &preconditioned(y, preconditioner));
            q.iter_mut().zip(preconditioner).for_each(|(q, preconditioner)| *q *= scale * preconditioner);
        }
        for ((s, y), alpha) in pairs.iter().zip(alphas.iter().rev()) {
            let beta = dot(y, &q) / dot(s, y);
            q.iter_mut().zip(s).for_each(|(q, s)| *q += (alpha - beta) * s);
        }
        q
    }

    #[test]
    fn scalars_give_the_direction_of_the_two_loop_recursion() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut vector = || -> Vec<f64> { (0..20).map(|_| rng.random::<f64>() - 0.5).collect() };
        let mut history = History::default();
        let (mut slots, mut pairs) = (vec![(vec![f64::NAN; 20], vec![f64::NAN; 20]); PAIRS], Vec::new());
        for round in 0..12 {
            let (s, noise, g) = (vector(), vector(), vector());
            let preconditioner: Vec<f64> = vector().iter().map(|x| (2.0 * x).exp()).collect();
            // Positive curvature but for every fifth pair.
            let sign = if round % 5 == 4 { -1.0 } else { 1.0 };
            let y: Vec<f64> = s.iter().zip(&noise).map(|(s, n)| sign * (2.0 * s + 0.3 * n)).collect();
            let slot = history.free_slot();
            slots[slot] = (s.clone(), y.clone());
            let all: Vec<&Vec<f64>> =
                slots.iter().map(|p| &p.0).chain(slots.iter().map(|p| &p.1)).chain([&g]).collect();
            let mut dots = [0.0; DOTS];
            for (which, v) in all.iter().enumerate() {
                for (k, other) in [&s, &y, &g].into_iter().enumerate() {
                    dots[3 * which + k] = dot(v, other) as f32;
                }
            }
            let mut rest = dots[PLAIN_DOTS..].iter_mut();
            for (i, change) in slots.iter().enumerate() {
                let others = slots.iter().map(|p| &p.1).skip(i).chain([&g]);
                others
                    .zip(&mut rest)
                    .for_each(|(other, to)| *to = dot(&preconditioned(&change.1, &preconditioner), other) as f32);
            }
            history.learn(slot, &dots);
            history.take(slot);
            if dot(&s, &y) > 0.0 {
                pairs.push((s, y));
                if pairs.len() > HISTORY {
                    pairs.remove(0);
                }
            }
            let want = two_loops(&pairs, &g, &preconditioner);
            let c = history.direction();
            for (e, want) in want.iter().enumerate() {
                let over = |k: usize| if k < PAIRS { 1.0 } else { preconditioner[e] };
                let got: f64 = (0..VECTORS).filter(|&k| c[k] != 0.0).map(|k| c[k] * all[k][e] * over(k)).sum();
                // The products were rounded to single precision.
                assert!((got - want).abs() < 1e-4, "round {round}: {got} for {want}");
            }
        }
    }
}
