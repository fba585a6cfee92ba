//! A baseline as a backend.
//!
//! Purpose: a [`Clustering`] gives labels and sums; [`Baseline`] lets the library's own iteration run on them, Lloyd and
//! L-BFGS, with its line search and its places for seeds with empty cells. Invariant: sums are the clustering's. Must not know: how
//! labels are found.

use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use glam::DVec3;

use geometry::mesh::closest_point::SurfacePoint;
use geometry::rvd::{
    Backend, BackendKind, CellSums, OnHost, PassStats, PieceBatch, RvdError, Session, SessionOptions, Surface,
    check_seeds, elapsed_ms, on_threads_of,
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
        let session = Approximate {
            clustering: Arc::clone(&self.clustering),
            by: Arc::clone(&self.by),
            most: options.max_seeds,
            seeds: Vec::new(),
        };
        Ok(Box::new(OnHost::new(session, self.pool())))
    }
}

struct Approximate {
    clustering: Arc<Mutex<dyn Clustering>>,
    by: Arc<dyn Backend>,
    most: usize,
    seeds: Vec<DVec3>,
}

impl Session for Approximate {
    fn set_seeds(&mut self, seeds: &[DVec3]) -> Result<(), RvdError> {
        check_seeds(seeds, self.most)?;
        seeds.clone_into(&mut self.seeds);
        Ok(())
    }

    fn sums(&mut self, out: &mut CellSums, token: &Token) -> Result<PassStats, RvdError> {
        let mut guard = self.clustering.lock().unwrap_or_else(PoisonError::into_inner);
        // What is locked may go to other threads; the lock may not.
        let clustering: &mut dyn Clustering = &mut *guard;
        on_threads_of(self.by.as_ref(), || {
            let mut stats = clustering.assign(&self.seeds, token)?;
            let begin = std::time::Instant::now();
            clustering.sums(&self.seeds, out);
            stats.update_ms += elapsed_ms(begin);
            Ok(stats)
        })
    }

    fn pieces(&mut self, _: Range<u32>, _: &mut PieceBatch, _: &Token) -> Result<PassStats, RvdError> {
        Err(RvdError::Internal("a baseline has no pieces".to_owned()))
    }
}
