//! Seeds that move in the host's memory.
//!
//! Purpose: makes any session [`Resident`]: the vectors of an optimiser as plain arrays, every
//! pass through the session's own `sums`.
//! Invariant: one thread and one order of additions, so that all backends whose sums have the same bits
//! walk the same path. The vectors cost a few per cent of a pass.
//! Must not know: how sums are computed, line searches.

use std::collections::VecDeque;
use std::ops::Range;

use glam::DVec3;

use super::resident::HISTORY;
use super::{CancelFlag, CellSums, DeviceWork, Look, PassStats, PhasesMs, PieceBatch, Resident, RvdError, Session};

/// A session and the vectors of its seeds.
pub(super) struct OnHost<S> {
    session: S,
    /// The present point, its gradient and what the pass there found.
    x: Vec<DVec3>,
    g: Vec<DVec3>,
    sums: CellSums,
    /// The last probe.
    trial: Vec<DVec3>,
    trial_g: Vec<DVec3>,
    trial_sums: CellSums,
    d: Vec<DVec3>,
    held: Vec<bool>,
    history: VecDeque<Pair>,
}

/// A step s, the change y of the gradient over it, and 1 / sᵀy.
struct Pair {
    s: Vec<DVec3>,
    y: Vec<DVec3>,
    rho: f64,
}

/// A pair with less curvature than this, as a cosine, would blow the direction up.
const LEAST_CURVATURE: f64 = 1e-10;

impl<S> OnHost<S> {
    pub(super) fn new(session: S) -> Self {
        Self {
            session,
            x: Vec::new(),
            g: Vec::new(),
            sums: CellSums::default(),
            trial: Vec::new(),
            trial_g: Vec::new(),
            trial_sums: CellSums::default(),
            d: Vec::new(),
            held: Vec::new(),
            history: VecDeque::with_capacity(HISTORY),
        }
    }

    fn reset(&mut self, n: usize) {
        self.d.clear();
        self.d.resize(n, DVec3::ZERO);
        self.history.clear();
    }
}

impl<S: Session> Session for OnHost<S> {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        self.session.set_seeds(seeds)?;
        self.x.clear();
        self.x.extend_from_slice(seeds);
        if self.held.len() != seeds.len() {
            self.held.clear();
            self.held.resize(seeds.len(), false);
        }
        self.reset(seeds.len());
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        self.session.sums(out, cancel)
    }

    fn pieces(&mut self, facets: Range<u32>, out: &mut PieceBatch, cancel: &CancelFlag) -> Result<PassStats, RvdError> {
        self.session.pieces(facets, out, cancel)
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

    fn resident(&mut self) -> Option<&mut dyn Resident> {
        Some(self)
    }
}

impl<S: Session> Resident for OnHost<S> {
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError> {
        if held.len() != self.x.len() {
            return Err(RvdError::Internal(format!("{} marks for {} seeds", held.len(), self.x.len())));
        }
        self.held.clear();
        self.held.extend_from_slice(held);
        self.reset(held.len());
        Ok(())
    }

    fn evaluate(&mut self, cancel: &CancelFlag) -> Result<Look, RvdError> {
        self.session.set_seeds(&self.x)?;
        let stats = self.session.sums(&mut self.sums, cancel)?;
        gradient(&self.sums, &self.held, &mut self.g);
        Ok(look(&self.sums, &self.g, stats))
    }

    fn to_centroids(&mut self) -> Result<(), RvdError> {
        for (i, x) in self.x.iter_mut().enumerate().filter(|(i, _)| !self.held[*i]) {
            *x = self.sums.centroid(i, *x);
        }
        self.reset(self.x.len());
        Ok(())
    }

    fn direct(&mut self) -> Result<f64, RvdError> {
        let d = &mut self.d;
        d.clear();
        d.extend(self.g.iter().map(|&g| -g));
        let mut alphas = [0.0; HISTORY];
        for (pair, alpha) in self.history.iter().zip(&mut alphas).rev() {
            *alpha = pair.rho * dot(&pair.s, d);
            add_scaled(d, -*alpha, &pair.y);
        }
        if let Some(last) = self.history.back() {
            let scale = 1.0 / (last.rho * dot(&last.y, &last.y));
            d.iter_mut().for_each(|d| *d *= scale);
        }
        for (pair, alpha) in self.history.iter().zip(alphas) {
            let beta = pair.rho * dot(&pair.y, d);
            add_scaled(d, alpha - beta, &pair.s);
        }
        Ok(dot(&self.g, &self.d))
    }

    fn probe(&mut self, step: f64, cancel: &CancelFlag) -> Result<Look, RvdError> {
        self.trial.clear();
        self.trial.extend(self.x.iter().zip(&self.d).map(|(&x, &d)| x + step * d));
        self.session.set_seeds(&self.trial)?;
        let stats = self.session.sums(&mut self.trial_sums, cancel)?;
        gradient(&self.trial_sums, &self.held, &mut self.trial_g);
        let slope = dot(&self.trial_g, &self.d);
        Ok(Look { slope, ..look(&self.trial_sums, &self.trial_g, stats) })
    }

    fn accept(&mut self) -> Result<(), RvdError> {
        let mut pair = match self.history.len() {
            HISTORY => self.history.pop_front(),
            _ => None,
        }
        .unwrap_or(Pair { s: Vec::new(), y: Vec::new(), rho: 0.0 });
        difference(&self.trial, &self.x, &mut pair.s);
        difference(&self.trial_g, &self.g, &mut pair.y);
        let curvature = dot(&pair.s, &pair.y);
        if curvature > LEAST_CURVATURE * (dot(&pair.s, &pair.s) * dot(&pair.y, &pair.y)).sqrt() {
            pair.rho = 1.0 / curvature;
            self.history.push_back(pair);
        }
        std::mem::swap(&mut self.x, &mut self.trial);
        std::mem::swap(&mut self.g, &mut self.trial_g);
        std::mem::swap(&mut self.sums, &mut self.trial_sums);
        Ok(())
    }

    fn forget(&mut self) {
        self.history.clear();
    }

    fn read(&mut self, out: &mut Vec<DVec3>) -> Result<(), RvdError> {
        out.clear();
        out.extend_from_slice(&self.x);
        Ok(())
    }

    fn read_sums(&mut self, out: &mut CellSums) -> Result<(), RvdError> {
        out.clone_from(&self.sums);
        Ok(())
    }
}

/// ∇E_i = 2 m_i (x_i - c_i) is minus twice the moment about the seed, so nothing cancels.
fn gradient(sums: &CellSums, held: &[bool], out: &mut Vec<DVec3>) {
    out.clear();
    out.extend(sums.moment.iter().zip(held).map(|(&m, &held)| if held { DVec3::ZERO } else { -2.0 * m }));
}

fn look(sums: &CellSums, g: &[DVec3], stats: PassStats) -> Look {
    Look {
        energy: sums.energy.iter().sum(),
        gradient_squared: dot(g, g),
        slope: 0.0,
        empty_cells: sums.area.iter().filter(|&&a| a <= 0.0).count(),
        area: sums.area.iter().sum(),
        stats,
    }
}

/// In four sums side by side: one alone waits for each addition.
fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
    let mut sums = [DVec3::ZERO; 4];
    for (a, b) in a.iter().zip(b) {
        (0..4).for_each(|k| sums[k] += a[k] * b[k]);
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a.dot(*b)).sum();
    ((sums[0] + sums[1]) + (sums[2] + sums[3])).element_sum() + rest
}

fn add_scaled(to: &mut [DVec3], factor: f64, from: &[DVec3]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to += factor * *from);
}

fn difference(a: &[DVec3], b: &[DVec3], out: &mut Vec<DVec3>) {
    out.clear();
    out.extend(a.iter().zip(b).map(|(&a, &b)| a - b));
}
