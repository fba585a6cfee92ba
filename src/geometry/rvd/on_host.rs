//! Seeds that move in the host's memory.
//!
//! Purpose: makes any session [`Resident`]: the vectors of an optimiser as plain arrays (`vectors`), every
//! pass through the session's own `sums`.
//! Invariant: one order of additions, whatever the number of threads, so that all backends whose sums have the same bits
//! walk the same path. The vectors cost a few per cent of a pass. Must not know: how sums are computed, line searches.

mod vectors;

use std::collections::VecDeque;
use std::iter::repeat_n;
use std::ops::Range;
use std::sync::Arc;

use super::resident::HISTORY;
use super::{CellSums, DeviceWork, Evaluation, PassStats, PhasesMs, PieceBatch, Resident, RvdError, Session, refill};
use crate::knn::{Point, Threads};
use crate::token::Token;

/// A session on the CPU and the vectors of its seeds.
pub struct OnHost<S, P> {
    session: S,
    /// Whose threads serve long vectors; the caller's alone if there is none.
    pool: Option<Arc<rayon::ThreadPool>>,
    /// The present point, its gradient and what the pass there found.
    x: Vec<P>,
    g: Vec<P>,
    sums: CellSums<P>,
    /// The last probe.
    trial: Vec<P>,
    trial_g: Vec<P>,
    trial_sums: CellSums<P>,
    d: Vec<P>,
    held: Vec<bool>,
    history: VecDeque<Pair<P>>,
}

/// A step s, the change y of the gradient over it, and 1 / sᵀy.
#[derive(Default)]
struct Pair<P> {
    s: Vec<P>,
    y: Vec<P>,
    rho: f64,
}

/// A pair with less curvature than this, as a cosine, would blow the direction up.
const LEAST_CURVATURE: f64 = 1e-10;
/// Seeds from which on a second thread saves more than it takes to wake it.
const LONG: usize = 4096;

impl<S, P: Point> OnHost<S, P> {
    /// A session that is no [`Resident`] made one.
    pub fn new(session: S, pool: Option<Arc<rayon::ThreadPool>>) -> Self {
        let [x, g, trial, trial_g, d] = Default::default();
        let (sums, trial_sums) = Default::default();
        let (held, history) = (Vec::new(), VecDeque::with_capacity(HISTORY));
        Self { session, pool, x, g, sums, trial, trial_g, trial_sums, d, held, history }
    }

    fn reset(&mut self, n: usize) {
        refill(&mut self.d, repeat_n(P::ZERO, n));
        self.history.clear();
    }
}

fn on<R: Send>(pool: Option<&rayon::ThreadPool>, seeds: usize, work: impl FnOnce(Threads) -> R + Send) -> R {
    match pool {
        Some(pool) if seeds >= LONG => pool.install(|| work(Threads::Pool)),
        _ => work(Threads::One),
    }
}

impl<P: Point, S: Session<P>> Session<P> for OnHost<S, P> {
    fn set_seeds(&mut self, seeds: &[P]) -> Result<(), RvdError> {
        self.session.set_seeds(seeds)?;
        seeds.clone_into(&mut self.x);
        if self.held.len() != seeds.len() {
            refill(&mut self.held, repeat_n(false, seeds.len()));
        }
        self.reset(seeds.len());
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums<P>, token: &Token) -> Result<PassStats, RvdError> {
        self.session.sums(out, token)
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, token: &Token) -> Result<PassStats, RvdError> {
        self.session.pieces(facets, out, token)
    }

    fn device_bytes(&self) -> u64 {
        self.session.device_bytes()
    }

    fn device_work(&self) -> DeviceWork {
        self.session.device_work()
    }

    fn device_phases(&self) -> Option<PhasesMs> {
        self.session.device_phases()
    }

    fn resident(&mut self) -> Option<&mut dyn Resident<P>> {
        Some(self)
    }
}

impl<P: Point, S: Session<P>> Resident<P> for OnHost<S, P> {
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError> {
        if held.len() != self.x.len() {
            return Err(RvdError::Internal(format!("{} marks for {} seeds", held.len(), self.x.len())));
        }
        held.clone_into(&mut self.held);
        self.reset(held.len());
        Ok(())
    }

    fn evaluate(&mut self, token: &Token) -> Result<Evaluation, RvdError> {
        self.session.set_seeds(&self.x)?;
        let stats = self.session.sums(&mut self.sums, token)?;
        let Self { pool, g, sums, held, d, .. } = self;
        let evaluation = on(pool.as_deref(), held.len(), |threads| vectors::evaluate(threads, sums, held, d, g));
        Ok(Evaluation { slope: 0.0, stats, ..evaluation })
    }

    fn to_centroids(&mut self) -> Result<(), RvdError> {
        for (i, x) in self.x.iter_mut().enumerate().filter(|(i, _)| !self.held[*i]) {
            *x = self.sums.centroid(i, *x);
        }
        self.reset(self.x.len());
        Ok(())
    }

    fn search_direction(&mut self) -> Result<f64, RvdError> {
        let Self { pool, g, d, history, sums, .. } = self;
        Ok(on(pool.as_deref(), g.len(), |threads| {
            let mass = &sums.mass[..];
            let scale = |last: &Pair<P>| 1.0 / (last.rho * vectors::preconditioned(threads, &last.y, mass));
            // Where y has to do with cells alone that have lost their mass, there is no scale.
            let last = history.back().map(|last| (last, scale(last))).filter(|(_, scale)| scale.is_finite());
            let Some((last, scale)) = last else {
                history.clear();
                return vectors::negate(threads, g, Some(mass), d, g);
            };
            let mut value = vectors::negate(threads, g, None, d, &last.s);
            let mut alphas = [0.0; HISTORY];
            for (k, pair) in history.iter().enumerate().rev() {
                alphas[k] = pair.rho * value;
                let (preconditioner, next) = match k.checked_sub(1) {
                    Some(k) => (None, &history[k].s),
                    None => (Some((scale, mass)), &pair.y),
                };
                value = vectors::add(threads, d, (-alphas[k], &pair.y), preconditioner, next);
            }
            for (k, pair) in history.iter().enumerate() {
                let beta = pair.rho * value;
                let next = history.get(k + 1).map_or(&*g, |next| &next.y);
                value = vectors::add(threads, d, (alphas[k] - beta, &pair.s), None, next);
            }
            value
        }))
    }

    fn probe(&mut self, step: f64, token: &Token) -> Result<Evaluation, RvdError> {
        refill(&mut self.trial, self.x.iter().zip(&self.d).map(|(&x, &d)| x + d * step));
        self.session.set_seeds(&self.trial)?;
        let stats = self.session.sums(&mut self.trial_sums, token)?;
        let Self { pool, trial_g: g, trial_sums: sums, held, d, .. } = self;
        let evaluation = on(pool.as_deref(), held.len(), |threads| vectors::evaluate(threads, sums, held, d, g));
        Ok(Evaluation { stats, ..evaluation })
    }

    fn accept(&mut self) -> Result<(), RvdError> {
        let mut pair = match self.history.len() {
            HISTORY => self.history.pop_front(),
            _ => None,
        }
        .unwrap_or_default();
        let Self { pool, x, g, trial, trial_g, .. } = self;
        let [s_squared, y_squared, curvature] = on(pool.as_deref(), x.len(), |threads| {
            vectors::differences(threads, [trial, x], [trial_g, g], [&mut pair.s, &mut pair.y])
        });
        if curvature > LEAST_CURVATURE * (s_squared * y_squared).sqrt() {
            pair.rho = 1.0 / curvature;
            self.history.push_back(pair);
        }
        std::mem::swap(&mut self.x, &mut self.trial);
        std::mem::swap(&mut self.g, &mut self.trial_g);
        std::mem::swap(&mut self.sums, &mut self.trial_sums);
        Ok(())
    }

    fn clear_history(&mut self) {
        self.history.clear();
    }

    fn read(&mut self, out: &mut Vec<P>) -> Result<(), RvdError> {
        out.clone_from(&self.x);
        Ok(())
    }

    fn read_sums(&mut self, out: &mut CellSums<P>) -> Result<(), RvdError> {
        out.clone_from(&self.sums);
        Ok(())
    }
}
