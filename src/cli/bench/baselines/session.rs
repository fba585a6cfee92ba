//! A baseline as a backend.
//!
//! Purpose: a [`Clustering`] gives labels and sums; [`Baseline`] lets the library's own iteration run on them, Lloyd and
//! L-BFGS, with its line search and its places for seeds with empty cells. Invariant: sums are the clustering's, in double
//! precision; vectors are added in one order. Must not know: how labels are found.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::DVec3;

use geometry::mesh::closest_point::SurfacePoint;
use geometry::rvd::resident::HISTORY;
use geometry::rvd::{
    Backend, BackendKind, CellSums, Evaluation, PassStats, PieceBatch, Resident, RvdError, Session, SessionOptions,
    Surface, check_seeds, elapsed_ms, on_threads_of,
};
use geometry::token::Token;

/// The label of a place without a seed.
pub(super) const NONE: u32 = u32::MAX;

/// Samples of a surface, each of which gets the label of a seed. Unit frame.
pub(super) trait Clustering: Send {
    /// Labels all samples. The times of the result are those of the parts; the rest of it is not used.
    fn assign(&mut self, seeds: &[DVec3], token: &Token) -> Result<PassStats, RvdError>;

    /// Sums of the labelled samples.
    fn sums(&self, seeds: &[DVec3], out: &mut CellSums);

    /// The label of the sample that stands for a point of the surface.
    fn label(&self, at: &SurfacePoint) -> u32;

    /// Place, area and label of each sample.
    fn samples(&self) -> Vec<(DVec3, f64, u32)>;

    /// The dual that the labels have: seeds, three a triangle.
    fn triangles(&self, seeds: &[DVec3]) -> Vec<[u32; 3]>;

    /// Bytes that it holds.
    fn bytes(&self) -> u64;
}

/// A clustering on the threads of a backend.
pub(super) struct Baseline {
    clustering: Arc<Mutex<dyn Clustering>>,
    by: Arc<dyn Backend>,
}

impl Baseline {
    pub(super) fn new(clustering: impl Clustering + 'static, by: &Arc<dyn Backend>) -> Self {
        Self { clustering: Arc::new(Mutex::new(clustering)), by: Arc::clone(by) }
    }

    /// The clustering, with the labels of the seeds of the last pass.
    pub(super) fn clustering(&self) -> MutexGuard<'_, dyn Clustering + 'static> {
        self.clustering.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Backend for Baseline {
    fn pool(&self) -> Option<Arc<rayon::ThreadPool>> {
        self.by.pool()
    }

    fn kind(&self) -> BackendKind {
        if self.by.threads() > 1 { BackendKind::Parallel } else { BackendKind::Serial }
    }

    fn threads(&self) -> usize {
        self.by.threads()
    }

    fn session(&self, _: Arc<Surface>, options: SessionOptions) -> Result<Box<dyn Session>, RvdError> {
        Ok(Box::new(Approximate {
            clustering: Arc::clone(&self.clustering),
            by: Arc::clone(&self.by),
            most: options.max_seeds,
            present: Point::default(),
            trial: Point::default(),
            direction: Vec::new(),
            held: Vec::new(),
            history: VecDeque::new(),
        }))
    }
}

/// Seeds, the sums at them, and the gradient.
#[derive(Default)]
struct Point {
    x: Vec<DVec3>,
    sums: CellSums,
    g: Vec<DVec3>,
}

/// A step s, the change y of the gradient over it, and 1 / sᵀy.
struct Pair {
    s: Vec<DVec3>,
    y: Vec<DVec3>,
    rho: f64,
}

/// A pair with less curvature than this, as a cosine, is left out.
const LEAST_CURVATURE: f64 = 1e-10;

struct Approximate {
    clustering: Arc<Mutex<dyn Clustering>>,
    by: Arc<dyn Backend>,
    most: usize,
    present: Point,
    trial: Point,
    direction: Vec<DVec3>,
    held: Vec<bool>,
    history: VecDeque<Pair>,
}

impl Approximate {
    fn pass(&self, seeds: &[DVec3], out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        check_seeds(seeds, self.most)?;
        let mut guard = self.clustering.lock().unwrap_or_else(PoisonError::into_inner);
        // What is locked may go to other threads; the lock may not.
        let clustering: &mut dyn Clustering = &mut *guard;
        on_threads_of(self.by.as_ref(), || {
            let mut stats = clustering.assign(seeds, token)?;
            let begin = std::time::Instant::now();
            clustering.sums(seeds, out);
            stats.update_ms += elapsed_ms(begin);
            Ok(stats)
        })
    }

    /// Passes over the diagram at a point, whose gradient is set.
    fn evaluate_at(&self, at: &mut Point, token: &Token) -> Result<Evaluation, RvdError> {
        let stats = self.pass(&at.x, &mut at.sums, token)?;
        let sums = &at.sums;
        let free = |i: usize| !self.held.get(i).copied().unwrap_or(false);
        at.g.clear();
        at.g.extend(sums.moment.iter().enumerate().map(|(i, &m)| if free(i) { -2.0 * m } else { DVec3::ZERO }));
        Ok(Evaluation {
            energy: sums.energy.iter().sum(),
            gradient_squared: dot(&at.g, &at.g),
            slope: dot(&at.g, &self.direction),
            empty_cells: sums.mass.iter().filter(|&&mass| mass <= 0.0).count(),
            area: sums.area.iter().sum(),
            stats,
        })
    }

    /// The preconditioner of the library's own steps: each seed's part over twice the mass of its cell.
    fn scaled(&self, v: &[DVec3]) -> Vec<DVec3> {
        let mass = &self.present.sums.mass;
        v.iter().zip(mass).map(|(&v, &mass)| if mass > 0.0 { v / (2.0 * mass) } else { DVec3::ZERO }).collect()
    }

    fn forget(&mut self) {
        self.history.clear();
        self.direction.clear();
    }
}

impl Session for Approximate {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        check_seeds(seeds, self.most)?;
        seeds.clone_into(&mut self.present.x);
        self.forget();
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        self.pass(&self.present.x, out, token)
    }

    fn pieces(&mut self, _: Range<u32>, _: &mut PieceBatch, _: &Token) -> Result<PassStats, RvdError> {
        Err(RvdError::Internal("a baseline has no pieces".to_owned()))
    }

    fn resident(&mut self) -> Option<&mut dyn Resident> {
        Some(self)
    }
}

impl Resident for Approximate {
    fn hold(&mut self, held: &[bool]) -> Result<(), RvdError> {
        held.clone_into(&mut self.held);
        self.forget();
        Ok(())
    }

    fn evaluate(&mut self, token: &Token) -> Result<Evaluation, RvdError> {
        let mut present = std::mem::take(&mut self.present);
        let evaluation = self.evaluate_at(&mut present, token);
        self.present = present;
        Ok(Evaluation { slope: 0.0, ..evaluation? })
    }

    fn to_centroids(&mut self) -> Result<(), RvdError> {
        let Point { x, sums, .. } = &mut self.present;
        for (i, x) in x.iter_mut().enumerate() {
            if !self.held.get(i).copied().unwrap_or(false) {
                *x = sums.centroid(i, *x);
            }
        }
        self.forget();
        Ok(())
    }

    fn search_direction(&mut self) -> Result<f64, RvdError> {
        let mut q = self.present.g.clone();
        let mut alphas = Vec::with_capacity(HISTORY);
        for pair in self.history.iter().rev() {
            let alpha = pair.rho * dot(&pair.s, &q);
            add(&mut q, -alpha, &pair.y);
            alphas.push(alpha);
        }
        let scale = self.history.back().map_or(1.0, |last| 1.0 / (last.rho * dot(&last.y, &self.scaled(&last.y))));
        let mut d: Vec<DVec3> = self.scaled(&q).into_iter().map(|q| q * scale).collect();
        for (pair, alpha) in self.history.iter().zip(alphas.into_iter().rev()) {
            let beta = pair.rho * dot(&pair.y, &d);
            add(&mut d, alpha - beta, &pair.s);
        }
        d.iter_mut().for_each(|d| *d = -*d);
        if !d.iter().all(|d| d.is_finite()) {
            // The changes have to do with cells alone that have lost their mass.
            self.history.clear();
            d = self.scaled(&self.present.g).into_iter().map(|g| -g).collect();
        }
        self.direction = d;
        Ok(dot(&self.present.g, &self.direction))
    }

    fn probe(&mut self, step: f64, token: &Token) -> Result<Evaluation, RvdError> {
        let mut trial = std::mem::take(&mut self.trial);
        trial.x.clear();
        trial.x.extend(self.present.x.iter().zip(&self.direction).map(|(&x, &d)| x + step * d));
        let evaluation = self.evaluate_at(&mut trial, token);
        self.trial = trial;
        evaluation
    }

    fn accept(&mut self) -> Result<(), RvdError> {
        let less = |a: &[DVec3], b: &[DVec3]| -> Vec<DVec3> { a.iter().zip(b).map(|(&a, &b)| a - b).collect() };
        let (s, y) = (less(&self.trial.x, &self.present.x), less(&self.trial.g, &self.present.g));
        let curvature = dot(&s, &y);
        if curvature > LEAST_CURVATURE * (dot(&s, &s) * dot(&y, &y)).sqrt() {
            if self.history.len() == HISTORY {
                self.history.pop_front();
            }
            self.history.push_back(Pair { s, y, rho: 1.0 / curvature });
        }
        std::mem::swap(&mut self.present, &mut self.trial);
        Ok(())
    }

    fn clear_history(&mut self) {
        self.history.clear();
    }

    fn read(&mut self, out: &mut Vec<DVec3>) -> Result<(), RvdError> {
        out.clone_from(&self.present.x);
        Ok(())
    }

    fn read_sums(&mut self, out: &mut CellSums) -> Result<(), RvdError> {
        out.clone_from(&self.present.sums);
        Ok(())
    }
}

/// The sum over the shorter of both: no direction yet gives 0.
fn dot(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}

fn add(to: &mut [DVec3], factor: f64, more: &[DVec3]) {
    to.iter_mut().zip(more).for_each(|(to, &more)| *to += factor * more);
}
