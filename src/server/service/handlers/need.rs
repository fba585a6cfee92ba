//! What the job of a stream will need, from its header.
//!
//! Invariant: a stream whose job never fits is refused before its arrays are sent. Must not know: how needs are computed
//! (`job::estimate`), messages but for headers.

use super::{Shared, bounds};
use crate::service::RequestError;
use geometry::remesh::RemeshOptions;
use geometry::rvd::BackendKind;
use jobs::admission::estimate::{Counts, Kind, need};
use jobs::admission::forecast::must_fit;
use jobs::observe::activity::Origin;
use jobs::record::{DensityKind, PlacementRule};
use jobs::{AdmissionRequest, admission};
use wire::codec;
use wire::counts::{MeshCounts, SeedCounts};
use wire::proto::{self, ComputeRvdHeader, CvtHeader, RemeshHeader};
use wire::upload::Header;

/// A header that says what its job needs.
pub(super) trait Needs: Header {
    /// Whether later pieces continue what the first one makes.
    const HAS_CONTINUATIONS: bool;

    /// The counts, where the mesh and the seeds are of these.
    fn counts(&self, by: BackendKind, mesh: MeshCounts, points: u64) -> Counts;
}

/// The admission request of a stream's job, in the name of its tenant.
///
/// # Errors
/// `JobApi` with `TooLarge` if it could never run here.
pub(super) fn admission_request<H: Needs>(
    shared: &Shared,
    tenant: &str,
    header: &H,
) -> Result<AdmissionRequest, RequestError> {
    let by = shared.engine.backend(codec::backend(header.backend())?)?;
    let (mesh, seeds) = header.check(&bounds(&shared.limits))?;
    let points = match seeds {
        SeedCounts::Uploaded(points) | SeedCounts::Sampled { points, .. } => points,
        // Nothing is known yet: seldom more than half as many as facets.
        SeedCounts::Implied { .. } => (mesh.facets / 2).clamp(1, shared.limits.max_seeds.max(1)),
    };
    let counts = header.counts(by.kind, mesh, points);
    let need = need(&counts, by.threads);
    must_fit(&need, shared.engine.memory())?;
    let request = admission::request(&shared.engine, tenant, &counts, &need);
    // Of the points that are asked for, not of those that may be added.
    let origin = request.origin.map(|origin| Origin { seeds: points, ..origin });
    Ok(AdmissionRequest { has_continuations: H::HAS_CONTINUATIONS, origin, ..request })
}

fn density(options: Option<&proto::DensityOptions>, mesh: MeshCounts) -> DensityKind {
    use proto::DensitySource as Source;
    match options.map_or(Source::Unspecified, proto::DensityOptions::source) {
        Source::Curvature => DensityKind::Curvature,
        Source::FeatureSize => DensityKind::FeatureSize,
        _ if mesh.edge_lengths > 0 => DensityKind::EdgeLengths,
        _ if mesh.weights > 0 => DensityKind::Weights,
        _ => DensityKind::Uniform,
    }
}

impl Needs for RemeshHeader {
    const HAS_CONTINUATIONS: bool = false;

    fn counts(&self, by: BackendKind, mesh: MeshCounts, points: u64) -> Counts {
        let usual = RemeshOptions::usual();
        let steps = |given: Option<u32>, usual: usize| given.map_or(usual as u64, u64::from);
        let most = self.refinement.map(|r| r.max_points.unwrap_or(points.saturating_mul(2)).max(points));
        Counts {
            steps: steps(self.lloyd_steps, usual.lloyd) + steps(self.newton_steps, usual.newton),
            density: density(self.density.as_ref(), mesh),
            placement: match self.placement() {
                proto::Placement::Surface => PlacementRule::Surface,
                proto::Placement::Centroids => PlacementRule::Centroids,
                proto::Placement::Fitted | proto::Placement::Unspecified => PlacementRule::Fitted,
            },
            attributes: self.attributes.iter().fold(0, |sum, array| array.values.saturating_mul(3).saturating_add(sum)),
            refines: self.refinement.is_some(),
            measures: self.measure() != proto::Measure::Topology,
            ..Counts::new(Kind::Remesh, by, mesh.vertices, mesh.facets, most.unwrap_or(points))
        }
    }
}

impl Needs for ComputeRvdHeader {
    const HAS_CONTINUATIONS: bool = true;

    fn counts(&self, by: BackendKind, mesh: MeshCounts, points: u64) -> Counts {
        // Pieces are sent as they come, and not kept.
        Counts {
            steps: 0,
            density: density(None, mesh),
            ..Counts::new(Kind::Rvd, by, mesh.vertices, mesh.facets, points)
        }
    }
}

impl Needs for CvtHeader {
    const HAS_CONTINUATIONS: bool = true;

    fn counts(&self, by: BackendKind, mesh: MeshCounts, points: u64) -> Counts {
        Counts {
            density: density(self.density.as_ref(), mesh),
            ..Counts::new(Kind::Cvt, by, mesh.vertices, mesh.facets, self.max_seeds.max(points))
        }
    }
}
