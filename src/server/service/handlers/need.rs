//! What the job of a stream will need, from its header.
//!
//! Invariant: a stream whose job never fits is refused before its arrays are sent. Must not know: how needs are computed
//! (`job::estimate`), messages but for headers.

use super::Shared;
use crate::service::RequestError;
use geometry::cvt::density::Count;
use geometry::remesh::RemeshOptions;
use jobs::admission::estimate::{Counts, Kind, need};
use jobs::admission::forecast::must_fit;
use jobs::observe::activity::Origin;
use jobs::{AdmissionRequest, admission};
use wire::options::{Diagram, Session, Start};
use wire::proto::{ComputeRvdHeader, CvtHeader, RemeshHeader};
use wire::upload::{Checked, Header};

/// A header that says what its job needs.
pub(super) trait Needs: Header<Options: Start> {
    const KIND: Kind;
    /// Whether later pieces continue what the first one makes.
    const HAS_CONTINUATIONS: bool;

    fn counts(counts: Counts, options: &Self::Options) -> Counts;
}

/// The admission request of a stream's job, in the name of its tenant.
///
/// # Errors
/// `JobApi` with `TooLarge` if it could never run here.
pub(super) fn admission_request<H: Needs>(
    shared: &Shared,
    tenant: &str,
    header: &Checked<H::Options>,
) -> Result<AdmissionRequest, RequestError> {
    let by = shared.engine.backend(header.backend)?;
    let Checked { mesh, options, attributes, .. } = header;
    let points = match options.seeds().count() {
        _ if mesh.seeds > 0 => mesh.seeds,
        Count::Points(points) => points as u64,
        // Nothing is known yet: seldom more than half as many as facets.
        Count::Implied => (mesh.facets / 2).clamp(1, shared.limits.max_seeds.max(1)),
    };
    let counts = H::counts(Counts::new(H::KIND, by.kind, mesh.vertices, mesh.facets, points), options);
    let attributes = attributes.iter().fold(0, |sum, array| array.values.saturating_mul(3).saturating_add(sum));
    let counts = Counts { attributes, ..counts };
    let need = need(&counts, by.threads);
    must_fit(&need, shared.engine.memory())?;
    let request = admission::request(&shared.engine, tenant, &counts, &need);
    // Of the points that are asked for, not of those that may be added.
    let origin = request.origin.map(|origin| Origin { seeds: points, ..origin });
    Ok(AdmissionRequest { has_continuations: H::HAS_CONTINUATIONS, origin, ..request })
}

impl Needs for RemeshHeader {
    const KIND: Kind = Kind::Remesh;
    const HAS_CONTINUATIONS: bool = false;

    fn counts(counts: Counts, options: &RemeshOptions) -> Counts {
        counts.of_remesh(options)
    }
}

impl Needs for ComputeRvdHeader {
    const KIND: Kind = Kind::Rvd;
    const HAS_CONTINUATIONS: bool = true;

    // Pieces are sent as they come, and not kept.
    fn counts(counts: Counts, options: &Diagram) -> Counts {
        counts.of_diagram(options)
    }
}

impl Needs for CvtHeader {
    const KIND: Kind = Kind::Cvt;
    const HAS_CONTINUATIONS: bool = true;

    fn counts(counts: Counts, options: &Session) -> Counts {
        counts.of_session(options)
    }
}
