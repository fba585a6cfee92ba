//! Seeds of a method, judged by the exact diagram.
//!
//! Purpose: energy of the seeds, share of the area that a method gives to a wrong seed, shapes of its dual and of the exact
//! one. Invariant: what judges is the library's diagram in double precision where it can be, the same for all methods.
//! The area is sampled at the same random points for all. Must not know: how a method labels.

use std::sync::Arc;

use anyhow::Result;
use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::session::Clustering;
use super::voxels::Unique;
use geometry::cvt::{Cvt, CvtOptions};
use geometry::knn::SeedIndex;
use geometry::mesh::TriMesh;
use geometry::mesh::closest_point::{ClosestPoint, SurfacePoint};
use geometry::mesh::measure::{Quality, quality, topology};
use geometry::mesh::sample::sample;
use geometry::rvd::{Backend, PieceBatch, SessionOptions, Surface, facet_edge, on_threads_of};
use geometry::token::Token;

/// Random points at which labels are compared with nearest seeds.
pub(super) const SAMPLES: usize = 100_000;
/// Random seed of them.
const SAMPLE_SEED: u64 = 0xba5e;
/// Slack of a squared distance, so that rounding makes no label wrong.
const SLACK: f64 = 1.0 + 1e-6;
/// Facets whose pieces are there at one time.
const BATCH: usize = 1 << 14;

/// One surface, in the unit frame.
pub(super) struct Judge {
    surface: Arc<Surface>,
    pub(super) mesh: TriMesh,
    samples: Vec<SurfacePoint>,
    closest: ClosestPoint,
    by: Arc<dyn Backend>,
}

/// Shape of a dual whose vertices are the seeds, put on the surface.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Dual {
    facets: usize,
    #[serde(flatten)]
    pub(super) quality: Quality,
    pub(super) non_manifold_edges: usize,
    pub(super) non_manifold_vertices: usize,
    pub(super) boundary_edges: usize,
    pub(super) euler: i64,
}

/// What the exact diagram says of a method's seeds.
pub(super) struct Verdict {
    /// Over the hexagonal energy.
    pub(super) energy_ratio: f64,
    pub(super) exact_dual: Option<Dual>,
}

/// What it says of its labels.
pub(super) struct Labels {
    /// Share of random points of the surface whose sample has the label of a seed that is not nearest to them, per cent.
    pub(super) wrong_area: f64,
    /// Area of samples that have not the label of a nearest seed, per cent.
    pub(super) wrong_labels: f64,
    pub(super) dual: Option<Dual>,
}

impl Judge {
    pub(super) fn new(surface: &Arc<Surface>, by: &Arc<dyn Backend>, token: &Token) -> Result<Self> {
        let mesh = TriMesh::new(surface.positions().to_vec(), surface.welded().to_vec())?;
        let samples = sample(&mesh, None, SAMPLES, SAMPLE_SEED);
        let closest = on_threads_of(by.as_ref(), || ClosestPoint::unless(&mesh, token))?;
        Ok(Self { surface: Arc::clone(surface), mesh, samples, closest, by: Arc::clone(by) })
    }

    /// Of seeds in the caller's coordinates.
    pub(super) fn seeds(&self, seeds: &[DVec3], token: &Token) -> Result<Verdict> {
        let mut cvt = Cvt::new(self.by.as_ref(), Arc::clone(&self.surface), seeds, CvtOptions::default())?;
        let energy_ratio = cvt.present(token)?.energy_ratio;
        let unit = self.unit(seeds);
        let triangles = self.exact_triangles(&unit, token)?;
        Ok(Verdict { energy_ratio, exact_dual: self.dual(&unit, triangles, token)? })
    }

    /// Of the labels that a method has now for these seeds, caller's coordinates.
    pub(super) fn labels(&self, of: &dyn Clustering, seeds: &[DVec3], token: &Token) -> Result<Labels> {
        let unit = self.unit(seeds);
        let index = SeedIndex::new(&unit);
        let wrong = |at: DVec3, label: u32| {
            let nearest = unit[index.nearest(at) as usize].distance_squared(at);
            unit.get(label as usize).is_none_or(|seed| seed.distance_squared(at) > nearest * SLACK)
        };
        let labelled: Vec<(DVec3, u32)> = self.samples.iter().map(|at| (at.position, of.label(at))).collect();
        let found = on_threads_of(self.by.as_ref(), || labelled.par_iter().filter(|at| wrong(at.0, at.1)).count());
        token.check()?;
        let (mut area, mut wrong_area) = (0.0, 0.0);
        for (at, share, label) in of.samples() {
            area += share;
            wrong_area += if share > 0.0 && wrong(at, label) { share } else { 0.0 };
        }
        Ok(Labels {
            wrong_area: 100.0 * found as f64 / labelled.len().max(1) as f64,
            wrong_labels: 100.0 * wrong_area / area,
            dual: self.dual(&unit, of.triangles(&unit), token)?,
        })
    }

    fn unit(&self, seeds: &[DVec3]) -> Vec<DVec3> {
        seeds.iter().map(|&p| self.surface.frame().to_unit(p)).collect()
    }

    /// Where three cells meet within a facet, with the orientation of the facet.
    fn exact_triangles(&self, seeds: &[DVec3], token: &Token) -> Result<Vec<[u32; 3]>> {
        let mut session = self.by.exact_session(Arc::clone(&self.surface), SessionOptions::new(seeds.len()))?;
        session.set_seeds(seeds)?;
        let (mut batch, mut found) = (PieceBatch::default(), Unique::default());
        let facets = self.surface.facets().len() as u32;
        for first in (0..facets).step_by(BATCH) {
            session.pieces(first..facets.min(first + BATCH as u32), &mut batch, token)?;
            for piece in 0..batch.len() {
                let (own, across) = (batch.seed[piece], &batch.opposite[batch.vertices(piece)]);
                for (k, &after) in across.iter().enumerate() {
                    let before = across[(k + across.len() - 1) % across.len()];
                    // The other two pieces at this vertex say the same.
                    let first = own < before && own < after;
                    if first && before != after && facet_edge(before).is_none() && facet_edge(after).is_none() {
                        found.add([own, before, after]);
                    }
                }
            }
        }
        Ok(found.triangles)
    }

    fn dual(&self, seeds: &[DVec3], triangles: Vec<[u32; 3]>, token: &Token) -> Result<Option<Dual>> {
        let projected = on_threads_of(self.by.as_ref(), || self.closest.project_all(seeds, token))?;
        let positions = projected.into_iter().map(|place| place.position).collect();
        // Too few seeds may have no triangle with an area.
        let Ok(mesh) = TriMesh::new(positions, triangles) else { return Ok(None) };
        let is = topology(&mesh);
        token.check()?;
        Ok(Some(Dual {
            facets: mesh.facets().len(),
            quality: on_threads_of(self.by.as_ref(), || quality(&self.mesh, &mesh)),
            non_manifold_edges: is.non_manifold_edges,
            non_manifold_vertices: is.non_manifold_vertices,
            boundary_edges: is.boundary_edges,
            euler: is.euler,
        }))
    }
}
