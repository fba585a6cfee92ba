//! One diagram in the caller's coordinates.
//!
//! Purpose: [`Diagram`] serves a caller that wants the cells of some seeds and no iterations: it opens a session, sets them, and
//! brings what comes back to the coordinates that the mesh was given in.
//! Invariant: what a session says, scaled by a power of two and moved; nothing else.
//! Must not know: which backend does the work, iterations, jobs.

use std::ops::Range;
use std::sync::Arc;

use glam::DVec3;

use super::{Backend, CellSums, Frame, PieceBatch, RvdError, Session, SessionOptions, Surface};
use crate::mesh::TriMesh;
use crate::token::Token;

/// Sums over each restricted cell in the caller's units, one entry a seed.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Cells {
    /// Centroids; an empty cell's is its seed as given.
    pub centroids: Vec<DVec3>,
    /// ∫ w, weights scaled so that the largest is in (1/2, 1].
    pub masses: Vec<f64>,
    /// ∫ 1.
    pub areas: Vec<f64>,
    /// ∫ w |p - x_i|².
    pub energies: Vec<f64>,
}

impl Cells {
    /// What `unit` is for seeds in the caller's coordinates.
    pub fn new(unit: &CellSums, seeds: &[DVec3], frame: Frame) -> Self {
        let square = frame.scale * frame.scale;
        let centroid = |i: usize| match unit.mass[i] > 0.0 {
            true => frame.to_world(frame.to_unit(seeds[i]) + unit.moment[i] / unit.mass[i]),
            false => seeds[i],
        };
        Self {
            centroids: (0..seeds.len()).map(centroid).collect(),
            masses: unit.mass.iter().map(|m| m / square).collect(),
            areas: unit.area.iter().map(|a| a / square).collect(),
            energies: unit.energy.iter().map(|e| e / square / square).collect(),
        }
    }
}

/// The restricted Voronoi diagram of seeds on a surface, caller's coordinates.
///
/// ```
/// use tessera::mesh::{sample::sample, shapes::Shape};
/// use tessera::{Diagram, Token, auto_backend};
///
/// let mesh = Shape::Sphere.build(1_000);
/// let seeds: Vec<_> = sample(&mesh, None, 50, 1).iter().map(|p| p.position).collect();
/// let (backend, token) = (auto_backend()?, Token::default());
/// let mut diagram = Diagram::new(&mesh, &seeds, backend.as_ref())?;
/// let cells = diagram.cells(&token)?;
/// assert!((cells.areas.iter().sum::<f64>() / mesh.area() - 1.0).abs() < 1e-5);
/// // Where the cells meet the first ten facets.
/// let pieces = diagram.pieces(0..10, &token)?;
/// assert!(pieces.len() >= 10);
/// # Ok::<(), tessera::RvdError>(())
/// ```
pub struct Diagram {
    session: Box<dyn Session>,
    surface: Arc<Surface>,
    seeds: Vec<DVec3>,
}

impl Diagram {
    /// Allocates for `mesh`, uniform density, and sets the seeds.
    pub fn new(mesh: &TriMesh, seeds: &[DVec3], backend: &dyn Backend) -> Result<Self, RvdError> {
        Self::with_weights(mesh, None, seeds, backend)
    }

    /// The same with a weight per vertex: finite, at least 0, not all 0; linear in each facet.
    pub fn with_weights(
        mesh: &TriMesh,
        weights: Option<&[f64]>,
        seeds: &[DVec3],
        backend: &dyn Backend,
    ) -> Result<Self, RvdError> {
        Self::on(Arc::new(Surface::new(mesh, weights)?), seeds, backend)
    }

    /// The same on a surface that others use too.
    pub fn on(surface: Arc<Surface>, seeds: &[DVec3], backend: &dyn Backend) -> Result<Self, RvdError> {
        let mut session = backend.session(Arc::clone(&surface), SessionOptions::new(seeds.len()))?;
        let unit: Vec<DVec3> = seeds.iter().map(|&p| surface.frame().to_unit(p)).collect();
        session.set_seeds(&unit)?;
        Ok(Self { session, surface, seeds: seeds.to_vec() })
    }

    /// Sums over all cells.
    pub fn cells(&mut self, token: &Token) -> Result<Cells, RvdError> {
        let mut unit = CellSums::default();
        self.session.sums(&mut unit, token)?;
        Ok(Cells::new(&unit, &self.seeds, self.surface.frame()))
    }

    /// The polygons in which cells meet `facets`, ordered by facet and then by seed. Facets beyond the last have none.
    pub fn pieces(&mut self, facets: Range<u32>, token: &Token) -> Result<PieceBatch, RvdError> {
        let last = self.surface.facets().len() as u32;
        let mut batch = PieceBatch::default();
        let facets = facets.start.min(last)..facets.end.min(last);
        if !facets.is_empty() {
            self.session.pieces(facets, &mut batch, token)?;
        }
        let frame = self.surface.frame();
        batch.position.iter_mut().for_each(|p| *p = frame.to_world(*p));
        Ok(batch)
    }
}
