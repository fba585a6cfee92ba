//! The figures of a result.
//!
//! Purpose: [`measure`] compares a result with the surface, and writes the report.
//! Invariant: the result does not change. Attributes and provenance are left empty. Must not know: how a result is made.

use super::job::Job;
use super::optimize;
use super::schedule::Figures;
use super::tolerance::Attempt;
use crate::mesh::TriMesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::apart::Apart;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::comparison::{LostParts, lost_parts};
use crate::mesh::crossings::{Crossings, crossing_facets, crossings};
use crate::mesh::features::{EdgeShares, edge_shares};
use crate::mesh::measure::{Quality, Topology, coincident_vertices, quality_and_distances, topology_unless};
use crate::remesh::constants::CURVE_AWAY;
use crate::remesh::report::{
    CountFigures, CountReason, FeatureFigures, InputFigures, MemoryFigures, Report, ResultFigures,
};
use crate::remesh::{Remesh, RemeshError, RemeshOptions};
use crate::rvd::{Frame, elapsed_ms};
use crate::token::{Stopped, Token};

/// The quality of a result, and what it lacks of `mesh`, for which `closest` may answer.
pub(super) fn compare(
    mesh: &TriMesh,
    closest: Option<ClosestPoint>,
    result: &TriMesh,
    token: &Token,
) -> Result<(Quality, LostParts), Stopped> {
    let (quality, distances) = quality_and_distances(mesh, closest, result, token)?;
    Ok((quality, lost_parts(mesh, result, &distances, token)?))
}

/// What is known of a result before it is measured.
pub(super) struct Known<'a> {
    pub(super) topology: Option<Topology>,
    pub(super) none_crosses: bool,
    /// Whether the result is compared with the surface, and crossing facets are counted.
    pub(super) measures: bool,
    /// The edges of the input, if it is a designed part.
    pub(super) designed: Option<EdgeShares>,
    /// Where sheets of the surface that was remeshed were moved.
    pub(super) apart: Option<&'a Apart>,
}

/// Measures the result against `clean` and writes the report. Attributes and provenance are left empty.
pub(super) fn measure(
    clean: &TriMesh,
    input: InputFigures,
    options: &RemeshOptions,
    attempt: Attempt<'_>,
    known: Known<'_>,
    Job { backend, token, mut laps, topology: wanted, diagonal, .. }: Job<'_, '_>,
) -> Result<Remesh, RemeshError> {
    let Attempt { plan, curves, closest, built, seeds, figures, device, device_bytes, .. } = attempt;
    let Figures { seed, asked, converged, last, rvd, iterations, refine } = figures;
    token.check()?;
    let result = &built.mesh;
    let quality = || known.measures.then(|| compare(clean, closest, result, token)).transpose();
    let crossings = || {
        let count = || if known.none_crosses { Ok(Crossings::default()) } else { crossings(result, token) };
        known.measures.then(count).transpose()
    };
    // Only parts of one seed's cell, or of the surface, can be in one place.
    let touches = built.repair.extra_vertices > 0 || wanted.components > 1 || known.topology.is_some();
    let topology = || -> Result<_, Stopped> {
        let coincident_vertices = if touches { coincident_vertices(result, token)? } else { 0 };
        let topology = match known.topology {
            Some(topology) => topology,
            None => topology_unless(result, &Adjacency::unless(result, token)?, token)?,
        };
        Ok((topology, coincident_vertices))
    };
    let ((topology, crossings), quality) = rayon::join(|| rayon::join(topology, crossings), quality);
    let crossings = crossings?;
    let ((topology, coincident_vertices), (quality, lost)) = (topology?, quality?.unzip());
    let (vertices, facets) = (result.positions().len(), result.facets().len());
    let (repair, metric) = (built.repair, built.metric);
    let edge = (4.0 / 3f64.sqrt() * built.mesh.area() / facets.max(1) as f64).sqrt();
    let edges_away = quality.as_ref().map_or(f64::INFINITY, |of| of.hausdorff_percent / 100.0 * diagonal / edge);
    let folded_edges = match &known.designed {
        // The edge of a thin wedge is divided in the result.
        Some(input) if input.folded > 0 => Some(0),
        Some(_) => Some(edge_shares(&built.mesh, token)?.folded),
        None => None,
    };
    let crosses = known.designed.is_some() && crossings.as_ref().is_some_and(|found| found.count > 0);
    let input_crosses = crosses && !crossing_facets(clean, token)?.is_empty();
    let regions = Vec::new();
    let result = ResultFigures {
        vertices,
        facets,
        topology,
        coincident_vertices,
        quality,
        metric,
        regions,
        kept: None,
        mirror: None,
        periodic: None,
        lost,
        crossings,
        folded_edges,
        edges_away,
        input_crosses,
        repair,
    };
    laps.end(|t| &mut t.measure);
    laps.timings.total = elapsed_ms(laps.begin);
    let reason = match options.refine {
        // A tolerance decides how many points there are, and not how many vertices share one.
        Some(_) if vertices <= asked => None,
        _ if metric.is_some() && wanted.fewest_vertices() <= asked => {
            (!optimize::is_near(vertices, asked)).then_some(CountReason::Metric)
        }
        _ if !curves.narrow().is_empty() => (!optimize::is_near(vertices, asked)).then_some(CountReason::NarrowPatches),
        _ => optimize::count_reason((vertices, result.topology.components), asked, &options.seeds, &wanted),
    };
    let vertex_count = CountFigures { asked, seeds: seeds.len(), reason };
    let is_designed = known.designed.is_some();
    let lacking_shares = || {
        let (low, high) = plan.mesh.bounds();
        let frame = Frame::of_bounds(low, high);
        let place = |p| known.apart.map_or(frame.to_world(p), |apart| apart.back(frame.to_world(p)));
        curves.lacking_shares(place, (&built.mesh, &built.curve_edges), CURVE_AWAY * edge)
    };
    let [dropped_share, away_share] = if is_designed { lacking_shares() } else { [0.0; 2] };
    let report = Report {
        backend: backend.kind().name().into(),
        adapter: backend.adapter(),
        threads: backend.threads(),
        seed,
        converged,
        topology_changes: wanted.changes(&result.topology),
        input,
        features: FeatureFigures {
            is_designed,
            dropped_share,
            away_share,
            angle_bound_deg: curves.angle_bound_deg(&built.mesh, &built.curve_edges, &built.vertex_seed),
            ..curves.figures(&built.segments)
        },
        rvd,
        device,
        iterations,
        last,
        refine,
        vertex_count,
        timings_ms: laps.timings,
        memory: MemoryFigures { host_peak_bytes: None, device_bytes },
        result,
        density: plan.figures,
        warnings: Vec::new(),
    };
    Ok(Remesh {
        mesh: built.mesh,
        vertex_seed: built.vertex_seed,
        curve_edges: built.curve_edges,
        seeds,
        report,
        attributes: None,
        provenance: Vec::new(),
    })
}
