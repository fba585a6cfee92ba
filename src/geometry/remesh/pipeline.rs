//! The stages of a remesh, in their order.
//!
//! Purpose: [`remesh`] has all stages: preprocess, prepare, optimize, extract, improve, carry attributes, measure.
//!
//! A surface has one name in all of them:
//!
//! | name | surface |
//! | --- | --- |
//! | `given` | the caller's mesh |
//! | `clean` | `given`, preprocessed |
//! | `separated` | `clean` with its sheets apart |
//! | `plan.mesh`, `divided` | `separated` with facets divided for the density |
//! | `surface` | `divided` as the backends take it: unit frame, vertices merged |
//! | `result` | the new surface |
//!
//! Points spread evenly over a surface with a spike that is far longer than the rest is wide all lie on the spike. Such a surface
//! is remeshed with its far vertices drawn in, and [`put_back_spikes`] moves the result to where they were.
//!
//! A designed part whose creases are closer than an edge is divided along them ([`Way`]). Where that fails it is remeshed undivided, and
//! the stages begin again.
//!
//! Invariant: the observer hears of the stages in this order; what could not be kept is in the report.
//! Must not know: how a stage does its work, files, jobs, the network.

mod adapt;
mod bends;
mod connect;
mod crossing;
mod extract;
mod join;
mod kept;
mod measured;
mod mirror;
mod optimize;
mod patches;
mod periodic;
mod prepare;
mod preprocess;
mod schedule;
mod tips;
mod tolerance;
mod uncross;
mod ways;

use std::collections::HashMap;
use std::time::Instant;

use glam::DVec3;

use super::attributes::{self, Provenance};
use super::features::Held;
use super::report::{RefineEnd, RegionFigures, Timings};
use super::{
    Anisotropy, Limits, Observer, Placement, Refine, Remesh, RemeshError, RemeshOptions, Result, Seeds, Tolerance,
    constants, warnings,
};
use crate::cvt::density::{Count, DensityOptions, DensitySource, Plan};
use crate::mesh::TriMesh;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::apart::Apart;
use crate::mesh::attributes::Attributes;
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::crossings::crossings;
use crate::mesh::features::{EdgeShares, edge_shares};
use crate::mesh::input::{draw_in, outliers};
use crate::mesh::measure::{Topology, topology_unless};
use crate::rvd::{Backend, RvdError, elapsed_ms, on_threads_of};
use crate::token::{Stopped, Token};
use prepare::{Asked, Prepared, prepare, with_source};
use preprocess::{Separated, preprocess};
use ways::{Division, Outcome, Way};

/// Remeshes `given` on `backend`.
///
/// # Errors
/// [`RemeshError`]; `Rvd(Stopped)` soon after `token` says so.
pub fn remesh(
    given: &TriMesh,
    options: &RemeshOptions,
    backend: &dyn Backend,
    observer: &mut dyn Observer,
    token: &Token,
) -> Result<Remesh, RemeshError> {
    let flat = match options.anisotropy {
        Anisotropy::Share(share) if !Anisotropy::SHARES.contains(&share) => return Err(RemeshError::BadLift { share }),
        anisotropy => anisotropy == Anisotropy::Share(0.0),
    };
    let in_metric = matches!(options.density.source, DensitySource::Metric(_));
    if in_metric {
        let others = [
            ("anisotropy", options.anisotropy != Anisotropy::None && !flat),
            ("a tolerance", options.refine.is_some()),
            ("seeds", matches!(options.seeds, Seeds::Given(_))),
            // Local changes move the vertices of curves in each sheet for itself.
            ("non_manifold keep", options.keep_non_manifold),
            ("kept parts", options.keeps_parts()),
        ];
        if let Some((other, _)) = others.into_iter().find(|other| other.1) {
            return Err(RemeshError::Beside { one: "a metric", other });
        }
    }
    if options.keeps_parts() && matches!(options.seeds, Seeds::Given(_)) {
        return Err(RemeshError::KeptBesideSeeds);
    }
    let pairs = [("a mirror plane", options.mirror.is_some()), ("periodic boundaries", !options.periodic.is_empty())];
    for (one, _) in pairs.into_iter().filter(|pair| pair.1) {
        let others = [
            ("seeds", matches!(options.seeds, Seeds::Given(_))),
            ("a metric", in_metric),
            ("kept parts", options.keeps_parts()),
            ("free boundaries", !options.keep_boundaries),
            ("periodic boundaries", one == "a mirror plane" && !options.periodic.is_empty()),
        ];
        if let Some((other, _)) = others.into_iter().find(|other| other.1) {
            return Err(RemeshError::Beside { one, other });
        }
    }
    // Where the surface is changed or a part of it stays, a facet that it lacks would be passed over.
    options.density.zones.iter().try_for_each(|zone| zone.part.check(given))?;
    let is_share = matches!(options.seeds, Seeds::Share { .. });
    let changes = flat || in_metric || options.source_map || options.refine.is_some() || is_share;
    let measured = changes.then(|| {
        let mut options = options.clone();
        if in_metric {
            // Local changes place the vertices on the surface.
            options.placement = Placement::Surface;
        }
        if flat {
            options.anisotropy = Anisotropy::None;
        }
        if options.source_map {
            options.attributes.get_or_insert_with(|| Attributes::new(given));
        }
        options.seeds.resolve(given);
        options.refine.iter_mut().for_each(|to| to.tolerance = Tolerance::Length(to.tolerance.length(given)));
        options
    });
    let options = measured.as_ref().unwrap_or(options);
    let mut done = remesh_parts(given, options, backend, observer, token)?;
    // Of the result alone: what one of several attempts drops, another may keep.
    let features = &done.report.features;
    if options.strict_creases && !features.are_whole() {
        return Err(match features.dropped.first() {
            Some(longest) => RemeshError::CreasesDropped {
                curves: features.dropped_curves,
                length: features.dropped_length,
                place: longest.place.into(),
            },
            None => RemeshError::CreasesBroken { curves: features.broken_curves, edges: features.missing_segments },
        });
    }
    if !options.measure {
        let result = &mut done.report.result;
        (result.quality, result.lost, result.crossings, result.folded_edges) = (None, None, None, None);
    }
    done.report.warnings = warnings::of(&done.report, options);
    if options.source_map
        && let Some(attributes) = &mut done.attributes
    {
        attributes::add_source_map(attributes, &done.provenance)?;
    }
    Ok(done)
}

/// All of the surface, or what does not stay.
fn remesh_parts(
    given: &TriMesh,
    options: &RemeshOptions,
    backend: &dyn Backend,
    observer: &mut dyn Observer,
    token: &Token,
) -> Result<Remesh, RemeshError> {
    let begun = tolerance::begin(given, options);
    let options = begun.as_ref().unwrap_or(options);
    if options.keeps_parts() {
        return on_threads_of(backend, || {
            let mut run = |part: (&TriMesh, Held<'_>), options: &RemeshOptions| {
                run_stages(part, options, backend, &mut *observer, token)
            };
            kept::remesh(given, options, &mut run, token)
        });
    }
    if let Some(plane) = options.mirror {
        return on_threads_of(backend, || {
            let mut run = |half: &TriMesh, options: &RemeshOptions| {
                run_stages((half, Held { closes: true, ..Held::default() }), options, backend, &mut *observer, token)
            };
            mirror::remesh(given, options, plane, &mut run, token)
        });
    }
    on_threads_of(backend, || match run_stages((given, Held::default()), options, backend, observer, token) {
        // Far vertices take all the points: without their spikes, which are put back afterwards. Given seeds stay.
        Err(
            error @ (RemeshError::TooFewSeeds { .. }
            | RemeshError::EdgeTooLong { .. }
            | RemeshError::Rvd(RvdError::NoArea)),
        ) => {
            let near = draw_in(given).filter(|_| !matches!(options.seeds, Seeds::Given(_)));
            let Some(near) = near else { return Err(error) };
            let mut done = run_stages((&near, Held::default()), options, backend, observer, token)?;
            put_back_spikes(&mut done, given, &near, token)?;
            Ok(done)
        }
        // Creases that end at a boundary may leave no room for its edges.
        Err(RemeshError::PeriodicLost { .. }) if options.crease_angle_deg > 0.0 => {
            let held = Held { least_crease_deg: Some(f64::INFINITY), ..Held::default() };
            run_stages((given, held), options, backend, observer, token)
        }
        done => done,
    })
}

/// On the present threads.
fn run_stages(
    (mesh, held): (&TriMesh, Held<'_>),
    options: &RemeshOptions,
    backend: &dyn Backend,
    observer: &mut dyn Observer,
    token: &Token,
) -> Result<Remesh, RemeshError> {
    let mut run = |held: Held<'_>, (options, way): (&RemeshOptions, Way)| {
        run_once((mesh, held), (options, way), backend, &mut *observer, token)
    };
    ways::run(held, options, &mut run, token)
}

fn run_once(
    (given, held): (&TriMesh, Held<'_>),
    (options, way): (&RemeshOptions, Way),
    backend: &dyn Backend,
    observer: &mut dyn Observer,
    token: &Token,
) -> Result<Outcome, RemeshError> {
    options.attributes.iter().try_for_each(|attributes| attributes.check_mesh(given))?;
    if options.refine.is_some() && options.placement != Placement::Fitted {
        return Err(RemeshError::RefineUnfitted);
    }
    let laps = Laps::start();
    token.enter("prepare");
    observer.stage("prepare");
    // Most inputs need no preprocessing: what is prepared meanwhile is then of use.
    let asked = Asked { held, ..Asked::new(given, options) };
    let weld = options.weld.map(|weld| weld.length(given));
    let (preprocessed, mut prepared) =
        rayon::join(|| preprocess(given, weld, token), || prepare(given, options, asked, None, token));
    let mut preprocessed = preprocessed?;
    if !options.periodic.is_empty() {
        preprocessed.pair(given, &options.periodic, token)?;
    }
    let in_metric = matches!(options.density.source, DensitySource::Metric(_));
    let isotropic = options.anisotropy == Anisotropy::None;
    let closes = held.closes || !options.periodic.is_empty();
    let held = Held { closes, ..held };
    let asked = Asked { held, ..asked };
    let undivided = preprocessed.separate(given, (options, held), &[], token)?;
    let clean = preprocessed.mesh(given);
    let mut separated = &undivided;
    let first = asked;
    let mut asked = undivided.asked(first);
    token.check()?;
    if preprocessed.changed.is_some() || undivided.is_changed() {
        let mesh = undivided.apart.as_ref().map_or(clean, |apart| &apart.mesh);
        prepared = prepare(mesh, undivided.options.as_ref().unwrap_or(options), asked, None, token);
    }
    let seeks_creases = matches!(&prepared, Ok(prepared) if prepared.curves.seeks_creases());
    let designed = if seeks_creases { designed(clean, options, token)? } else { None };
    let may_divide = options.keep_boundaries
        && isotropic
        && !in_metric
        && !held.closes
        && options.periodic.is_empty()
        && held.rims.is_empty()
        && held.vertices.is_empty()
        && designed.is_some();
    let creases = match &prepared {
        // Flat patches then come down to their corners.
        Ok(prepared)
            if may_divide
                && (way.divides() || way == Way::Free && (prepared.curves.is_crowded || options.refine.is_some())) =>
        {
            let Prepared { curves, plan, surface, .. } = prepared;
            let apart = undivided.apart.as_ref();
            let separated = apart.map_or(clean, |apart| &apart.mesh);
            let edges = curves.every_edge((&plan.mesh, surface), separated.positions().len(), token)?;
            let before = |v| apart.map_or(v, |apart| apart.before(v));
            edges.into_iter().map(|edge| edge.map(before)).collect()
        }
        _ => Vec::new(),
    };
    let divided = match creases.is_empty() {
        true => None,
        false => Some(preprocessed.separate(given, (options, held), &creases, token)?)
            .filter(|of| of.joined.is_some() || options.keep_non_manifold && of.apart.is_some()),
    };
    if let Some(divided) = &divided {
        let again = divided.asked(Asked { held: Held { crowded: true, beside: way == Way::Beside, ..held }, ..first });
        let mesh = divided.apart.as_ref().map_or(clean, |apart| &apart.mesh);
        let options = divided.options.as_ref().unwrap_or(options);
        let mut of = prepare(mesh, options, again, None, token);
        if let (Some(apart), Ok(Prepared { plan, .. })) = (&divided.apart, &of)
            && matches!(options.density, DensityOptions { source: DensitySource::Uniform, ref zones, .. } if zones.is_empty())
            && let Some(edge) = plan.figures.edge_median
            && let Some(lengths) = bends::lengths(apart, clean, edge, token)?
        {
            of = prepare(mesh, &with_source(options, DensitySource::Sizes(lengths)), again, None, token);
            of.iter_mut().for_each(|of| of.plan.figures.source = options.density.source.name());
        }
        if of.as_ref().is_ok_and(|of| !of.curves.seeds.is_empty()) {
            (prepared, separated, asked) = (of, divided, again);
        }
    }
    let is_divided = divided.as_ref().is_some_and(|divided| std::ptr::eq(separated, divided));
    if way.divides() && !is_divided {
        return Ok(Outcome::Again(Way::Undivided));
    }
    let Separated { apart, options: adapted, topology, joined, seams, figures, .. } = separated;
    let (topology, joined, meet) =
        (*topology, *joined, seams.as_ref().is_some_and(|seams| seams.meet()) && options.periodic.is_empty());
    token.check()?;
    let options = adapted.as_ref().unwrap_or(options);
    let separated = apart.as_ref().map_or(clean, |apart| &apart.mesh);
    let input = figures.clone();
    let limits = match (options.refine, &prepared) {
        (Some(Refine { tolerance, max_points }), &Ok(Prepared { plan: Plan { points, .. }, .. })) => {
            let first = if let Count::Points(count) = options.seeds.count() { count } else { points };
            let most = max_points.unwrap_or(first.saturating_mul(2));
            if points > most {
                return Err(RemeshError::RefineLimit { points, most });
            }
            Some(Limits { tolerance: tolerance.length(given), max_points: most })
        }
        _ => None,
    };
    let limited = limits.map(|limits| RemeshOptions { refine: Some(limits.into()), ..options.clone() });
    let options = limited.as_ref().unwrap_or(options);
    // Given edge lengths are not changed.
    let source = &options.density.source;
    let free = !matches!(source, DensitySource::Sizes(_) | DensitySource::Weights(_));
    // Cells are larger than they look where the lifted surface is, and are no measure of its thickness.
    let improves = in_metric || options.placement == Placement::Fitted;
    let keep_thin = options.keep_thin && free && isotropic && improves;
    let (low, high) = clean.bounds();
    let diagonal = (high - low).length();
    // A tolerance decides itself how many points there are, and a metric is scaled for their number.
    let scales_seeds = options.refine.is_none() && !in_metric;
    let divisible = way == Way::Free && may_divide && !is_divided;
    let may_divide = divisible && keep_thin && options.refine.is_none();
    // Patches that are divided are not thin, and the number of their vertices is known.
    let may_shorten = keep_thin && options.refine.is_none() && !matches!(options.seeds, Seeds::Given(_));
    let (keep_thin, scales_seeds) = (keep_thin && !is_divided, scales_seeds && !is_divided);
    let wants_division = false;
    let mut job = Job {
        clean,
        apart: apart.as_ref(),
        meet,
        separated,
        asked,
        backend,
        token,
        observer,
        laps,
        keep_thin,
        scales_seeds,
        diagonal,
        topology,
        may_divide,
        wants_division,
    };
    let attempt = match (limits, &options.seeds) {
        (Some(limits), &(Seeds::Sample { seed, .. } | Seeds::Implied { seed })) => {
            prepared.and_then(|prepared| tolerance::refine(&mut job, prepared, options, limits, seed))
        }
        (Some(limits), _) => prepared.and_then(|prepared| job.add(prepared, options, limits)),
        (None, _) => prepared.and_then(|prepared| job.attempt(prepared, options, None)),
    };
    if job.wants_division {
        return Ok(Outcome::Again(Way::Divided));
    }
    let counted = matches!(options.seeds.count(), Count::Points(_));
    let edge_length = options.density.edge_length.filter(|_| !counted);
    let mut attempt = match attempt {
        // Patches may have no room for any cells.
        Err(_) if is_divided && token.check().is_ok() => return Ok(Outcome::Again(Way::Undivided)),
        attempt => attempt.map_err(|error| error.for_surface(&topology, input.area, edge_length))?,
    };

    token.check()?;
    let is_reached = limits.is_none() || attempt.figures.refine.ended == Some(RefineEnd::Reached);
    if is_divided && !(attempt.is_whole && is_reached) {
        return Ok(Outcome::Again(Way::Undivided));
    }
    // Not known again once vertices move.
    let mut none_crosses = false;
    if may_shorten {
        let crossing;
        (attempt, crossing) = match job.uncross(attempt, (divisible, is_divided), options)? {
            Some(found) => found,
            None => return Ok(Outcome::Again(Way::Divided)),
        };
        none_crosses = crossing == 0 && preprocessed.pairs.is_none();
    }
    if options.keep_thin && options.placement == Placement::Fitted && !matches!(options.seeds, Seeds::Given(_)) {
        let broken = |e| RvdError::Internal(format!("facets in the places of one: {e}"));
        none_crosses &= !tips::put_back(&mut attempt.built, &attempt.plan.mesh, token)?.map_err(broken)?;
    }
    let broken = |e| RvdError::Internal(format!("a vertex moved to a point: {e}"));
    let settled = match &asked.held.seams {
        Some(_) if !in_metric => {
            tips::settle_points(&mut attempt.built, &attempt.curves, &attempt.plan.mesh, token)?.map_err(broken)?
        }
        _ => HashMap::new(),
    };
    none_crosses &= settled.is_empty();
    let mut of_result = None;
    let result = &mut attempt.built.mesh;
    let curve_edges = &attempt.built.curve_edges[..];
    let carried = match apart {
        // Attributes are those of the facets as given, and so is the provenance.
        None => transfer(&mut job, given, options, (result, curve_edges))?,
        Some(apart) => {
            let broken = |e| RvdError::Internal(format!("a surface was valid where its parts were apart: {e}"));
            let given_apart = preprocessed.given_apart(given, apart).map_err(broken)?;
            let mut transferred = transfer(&mut job, &given_apart, options, (result, curve_edges))?;
            // Of the sheets apart: in their places, vertices of several may be in one.
            of_result = Some(topology_unless(result, &Adjacency::unless(result, token)?, token)?);
            *result = apart.mesh_back(result, token)?.map_err(broken)?;
            attempt.seeds.iter_mut().for_each(|p| *p = apart.back(*p));
            attempt.curves.move_dropped(|p| apart.back(p));
            // It answers for the sheets apart, not for the input.
            attempt.closest = None;
            if options.keep_non_manifold {
                join::join(&mut attempt.built, &attempt.curves, &settled, &mut transferred).map_err(broken)?;
                job.topology = input.topology;
                of_result = None;
                if is_divided {
                    let result = &attempt.built.mesh;
                    let found = topology_unless(result, &Adjacency::unless(result, token)?, token)?;
                    let key = |of: &Topology| (of.euler, of.components, of.boundary_loops);
                    if key(&found) != key(&job.topology) {
                        return Ok(Outcome::Again(Way::Undivided));
                    }
                    of_result = Some(found);
                }
            } else if let Some(joined) = joined {
                join::join(&mut attempt.built, &attempt.curves, &settled, &mut transferred).map_err(broken)?;
                job.topology = joined;
                // What has one vertex is joined, and not what touches.
                let result = &attempt.built.mesh;
                let own = (0..result.positions().len() as u32).collect();
                let found = topology_unless(result, &Adjacency::with(result, own, token)?, token)?;
                // Patches on both sides of a hole may have the same edge across it.
                let is_broken = found.boundary_loops != joined.boundary_loops
                    || found.non_manifold_edges + found.non_manifold_vertices > 0;
                if is_divided && is_broken {
                    return Ok(Outcome::Again(Way::Undivided));
                }
                of_result = Some(found);
            }
            transferred
        }
    };
    if is_divided
        && !none_crosses
        && crossings(&attempt.built.mesh, token)?.count as f64
            > constants::MOST_CROSSING * attempt.built.mesh.facets().len() as f64
    {
        return Ok(Outcome::Again(Way::Undivided));
    }
    job.laps.end(|t| &mut t.attributes);
    let mut periodic = None;
    if let Some(pairs) = &preprocessed.pairs {
        let of = (&attempt.curves, &attempt.seeds[..]);
        let by = (&options.periodic[..], match_reach(given));
        let first = pairs.all.first().map_or(DVec3::ZERO, |pair| clean.positions()[pair.from[0] as usize]);
        periodic = Some(periodic::settle(&mut attempt.built, of, by, (pairs, first), token)?);
    }

    job.enter("measure");
    // Which of several ways a designed part goes depends on the figures.
    let measures = options.measure || designed.is_some();
    let known = measured::Known { topology: of_result, none_crosses, measures, designed, apart: apart.as_ref() };
    let mut measured = measured::measure(clean, input, options, attempt, known, job)?;
    let Carried { attributes, provenance, regions } = carried;
    (measured.report.result.regions, measured.report.result.periodic) = (regions, periodic);
    let division = match (is_divided, divisible) {
        (true, _) => Division::Made,
        (false, true) => Division::Possible,
        (false, false) => Division::Impossible,
    };
    Ok(Outcome::Done(Box::new(Remesh { attributes, provenance, ..measured }), division))
}

/// The edges of a surface that has flat or ruled faces between sharp edges, or edges that the caller named.
fn designed(mesh: &TriMesh, options: &RemeshOptions, token: &Token) -> Result<Option<EdgeShares>, Stopped> {
    let shares = edge_shares(mesh, token)?;
    let has_creases = shares.sharp >= constants::LEAST_SHARP || !options.creases.is_empty();
    Ok(Some(shares).filter(|shares| shares.flat >= constants::LEAST_FLAT && has_creases))
}

/// How near a vertex is to a mirror plane, or a boundary to the image of another, to be in it; caller's units.
fn match_reach(mesh: &TriMesh) -> f64 {
    let (low, high) = mesh.bounds();
    constants::MATCH_DIAGONAL * (high - low).length()
}

/// What the result has of the input's attributes.
#[derive(Default)]
struct Carried {
    attributes: Option<Attributes>,
    /// Where its vertices lie on the input.
    provenance: Vec<Provenance>,
    regions: Vec<RegionFigures>,
}

/// The input's attributes on the result, if there are any.
fn transfer(
    job: &mut Job<'_, '_>,
    given: &TriMesh,
    options: &RemeshOptions,
    (result, curve_edges): (&TriMesh, &[[u32; 2]]),
) -> Result<Carried, RemeshError> {
    if options.attributes.is_some() {
        job.enter("attributes");
    }
    carry(given, options.attributes.as_ref(), (result, curve_edges), job.token)
}

/// `attributes` of `given` on the result, if there are any.
fn carry(
    given: &TriMesh,
    attributes: Option<&Attributes>,
    (result, curve_edges): (&TriMesh, &[[u32; 2]]),
    token: &Token,
) -> Result<Carried> {
    let Some(attributes) = attributes else { return Ok(Carried::default()) };
    let closest = ClosestPoint::unless(given, token)?;
    let provenance = attributes::provenance(&closest, result.positions(), token)?;
    token.check()?;
    let mut carried = attributes::carry(given, attributes, &closest, result, &provenance)?;
    let mut figures = Vec::new();
    if let Some(regions) = attributes.regions() {
        let of_facet = attributes::regions::carry((given, regions), &closest, (result, curve_edges), token)?;
        figures = attributes::regions::figures(regions, given, (result, &of_facet));
        carried.set_regions(regions.with_facets(of_facet))?;
    }
    Ok(Carried { attributes: Some(carried), provenance, regions: figures })
}

pub(super) struct Job<'a, 'b> {
    /// The input, preprocessed.
    pub(super) clean: &'a TriMesh,
    /// What was moved to have its sheets apart, if there are several, and whether they meet along curves.
    pub(super) apart: Option<&'a Apart>,
    pub(super) meet: bool,
    /// `clean` with its sheets apart.
    pub(super) separated: &'a TriMesh,
    asked: Asked<'a>,
    pub(super) backend: &'b dyn Backend,
    pub(super) token: &'b Token,
    pub(super) observer: &'b mut dyn Observer,
    pub(super) laps: Laps,
    /// Whether edges become shorter where the surface is too thin for its cells.
    pub(super) keep_thin: bool,
    /// Whether seeds become fewer, for the number of vertices that was asked for.
    pub(super) scales_seeds: bool,
    /// Diagonal of the input's bounding box, caller's units.
    pub(super) diagonal: f64,
    /// What the result is to have.
    pub(super) topology: Topology,
    /// Whether the surface may be divided along its creases where it is too thin for its cells, and whether it is to be.
    pub(super) may_divide: bool,
    pub(super) wants_division: bool,
}

impl Job<'_, '_> {
    pub(super) fn enter(&mut self, stage: &'static str) {
        self.token.enter(stage);
        self.observer.stage(stage);
    }
}

/// A stopwatch, and the times of the stages. All in milliseconds.
pub(super) struct Laps {
    begin: Instant,
    last: Instant,
    pub(super) timings: Timings,
}

impl Laps {
    pub(super) fn start() -> Self {
        let now = Instant::now();
        Self { begin: now, last: now, timings: Timings::default() }
    }

    /// Adds the time since the last call to a stage.
    pub(super) fn end(&mut self, stage: impl Fn(&mut Timings) -> &mut f64) {
        *stage(&mut self.timings) += elapsed_ms(self.last);
        self.last = Instant::now();
    }
}

/// Makes the result of `near`, which is `given` with its far vertices drawn in, one of `given`. Only positions change: a vertex
/// beside a spike keeps its barycentric coordinates, the vertex nearest to a far one goes there.
fn put_back_spikes(done: &mut Remesh, given: &TriMesh, near: &TriMesh, token: &Token) -> Result<()> {
    let far = outliers(given);
    let closest = ClosestPoint::unless(near, token)?;
    let back = |p: DVec3, SurfacePoint { position, facet, barycentric }: SurfacePoint| {
        let corners = given.facets()[facet as usize];
        if !corners.iter().any(|v| far.binary_search(v).is_ok()) {
            return p;
        }
        let place: DVec3 = (0..3).map(|k| given.positions()[corners[k] as usize] * barycentric[k]).sum();
        place + (p - position)
    };
    let mut places = done.mesh.positions().to_vec();
    let near_places = closest.project_all(&places, token)?;
    for &v in &far {
        token.check()?;
        let apart = |p: &DVec3| p.distance_squared(near.positions()[v as usize]);
        let nearest = (0..places.len())
            .min_by(|&a, &b| apart(&done.mesh.positions()[a]).total_cmp(&apart(&done.mesh.positions()[b])));
        nearest.into_iter().for_each(|k| places[k] = given.positions()[v as usize]);
    }
    for ((place, &was), point) in places.iter_mut().zip(done.mesh.positions()).zip(near_places) {
        if *place == was {
            *place = back(was, point);
        }
    }
    // Only one thing can be wrong with it: beside very long spikes no facet has an area.
    done.mesh = TriMesh::new(places, done.mesh.facets().to_vec()).map_err(|_| RvdError::NoArea)?;
    let near_seeds = closest.project_all(&done.seeds, token)?;
    done.seeds.iter_mut().zip(near_seeds).for_each(|(seed, point)| *seed = back(*seed, point));
    let report = &mut done.report;
    (report.input.area, report.input.outlier_vertices) = (given.area(), far.len());
    if report.result.quality.is_some() {
        (report.result.quality, report.result.lost) = Some(measured::compare(given, None, &done.mesh, token)?).unzip();
    }
    Ok(())
}
