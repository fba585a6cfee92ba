//! All stages once.
//!
//! Purpose: [`run`] preprocesses a surface, divides it along its creases where it may and has to, and takes it through the stages.
//! Invariant: [`Outcome::Again`] names another way where this one leads to nothing; no result is made then.
//! Must not know: which way is the best, how a stage does its work.

use std::collections::HashMap;

use glam::DVec3;

use super::carried::{self, Carried};
use super::job::{Job, Laps};
use super::prepare::{Asked, Prepared, prepare, with_source};
use super::preprocess::{Preprocessed, Separated, match_reach, preprocess};
use super::tolerance::{self, Attempt};
use super::ways::{Division, Outcome, Way};
use super::{bends, join, measured, periodic, tips};
use crate::cvt::density::{Count, DensityOptions, DensitySource};
use crate::mesh::adjacency::Adjacency;
use crate::mesh::crossings::crossings;
use crate::mesh::features::{EdgeShares, edge_shares};
use crate::mesh::measure::{Topology, topology_unless};
use crate::mesh::{MeshError, TriMesh};
use crate::remesh::features::Held;
use crate::remesh::{
    Anisotropy, Limits, Observer, Placement, Refine, Remesh, RemeshError, RemeshOptions, Result, Seeds, constants,
};
use crate::rvd::{Backend, RvdError};
use crate::token::{Stopped, Token};

/// A surface that is remeshed: with its sheets apart, perhaps also along its creases.
#[derive(Clone, Copy)]
struct Subject<'a> {
    separated: &'a Separated,
    is_divided: bool,
    asked: Asked<'a>,
}

/// Takes `given` through all stages in one way. An error leaves nothing behind; the observer has heard of the stages that were entered.
pub(super) fn run(
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
    let held = Held { closes: held.closes || !options.periodic.is_empty(), ..held };
    let asked = Asked { held, ..asked };
    let clean = preprocessed.mesh(given);
    let undivided = preprocessed.separate(given, (options, held), &[], token)?;
    let mut subject = Subject { separated: &undivided, is_divided: false, asked: undivided.asked(asked) };
    token.check()?;
    if preprocessed.changed.is_some() || undivided.is_changed() {
        prepared = prepare(undivided.mesh(clean), undivided.options(options), subject.asked, None, token);
    }
    let seeks_creases = matches!(&prepared, Ok(prepared) if prepared.curves.seeks_creases());
    let designed = if seeks_creases { designed(clean, options, token)? } else { None };
    let may_divide = designed.is_some() && may_divide(options, held);
    let creases = match &prepared {
        // Flat patches then come down to their corners.
        Ok(of)
            if may_divide
                && (way.divides() || way == Way::Free && (of.curves.is_crowded || options.refine.is_some())) =>
        {
            creases(&undivided, clean, of, token)?
        }
        _ => Vec::new(),
    };
    let divided = match creases.is_empty() {
        true => None,
        false => Some(preprocessed.separate(given, (options, held), &creases, token)?)
            .filter(|of| of.joined.is_some() || options.keep_non_manifold && of.apart.is_some()),
    };
    if let Some(divided) = &divided {
        let held = Held { crowded: true, beside: way == Way::Beside, ..held };
        let asked = divided.asked(Asked { held, ..asked });
        let of = prepare_divided(divided, clean, (options, asked), token)?;
        if of.as_ref().is_ok_and(|of| !of.curves.seeds.is_empty()) {
            prepared = of;
            subject = Subject { separated: divided, is_divided: true, asked };
        }
    }
    let Subject { separated, is_divided, asked } = subject;
    if way.divides() && !is_divided {
        return Ok(Outcome::Again(Way::Undivided));
    }
    token.check()?;

    let options = separated.options(options);
    let limits = match &prepared {
        Ok(prepared) => limits(given, options, prepared.plan.points)?,
        Err(_) => None,
    };
    let limited = limits.map(|limits| RemeshOptions { refine: Some(limits.into()), ..options.clone() });
    let options = limited.as_ref().unwrap_or(options);
    let in_metric = matches!(options.density.source, DensitySource::Metric(_));
    // Cells are larger than they look where the lifted surface is, and are no measure of its thickness.
    let improves = in_metric || options.placement == Placement::Fitted;
    // Given edge lengths are not changed.
    let free = !matches!(options.density.source, DensitySource::Sizes(_) | DensitySource::Weights(_));
    let keep_thin = options.keep_thin && free && options.anisotropy == Anisotropy::None && improves;
    // A tolerance decides itself how many points there are, and a metric is scaled for their number.
    let scales_seeds = options.refine.is_none() && !in_metric;
    let divisible = way == Way::Free && may_divide && !is_divided;
    let may_shorten = keep_thin && options.refine.is_none() && !matches!(options.seeds, Seeds::Given(_));
    let (low, high) = clean.bounds();
    let mut job = Job {
        clean,
        apart: separated.apart.as_ref(),
        meet: separated.seams.as_ref().is_some_and(|seams| seams.meet()) && options.periodic.is_empty(),
        separated: separated.mesh(clean),
        asked,
        backend,
        token,
        observer,
        laps,
        // Patches that are divided are not thin, and the number of their vertices is known.
        keep_thin: keep_thin && !is_divided,
        scales_seeds: scales_seeds && !is_divided,
        diagonal: (high - low).length(),
        topology: separated.topology,
        may_divide: divisible && keep_thin && options.refine.is_none(),
        wants_division: false,
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
    let mut attempt = match attempt {
        // Patches may have no room for any cells.
        Err(_) if is_divided && token.check().is_ok() => return Ok(Outcome::Again(Way::Undivided)),
        attempt => attempt.map_err(|error| {
            let counted = matches!(options.seeds.count(), Count::Points(_));
            let edge_length = options.density.edge_length.filter(|_| !counted);
            error.for_surface(&separated.topology, separated.figures.area, edge_length)
        })?,
    };
    token.check()?;
    if is_divided && !attempt.is_whole {
        return Ok(Outcome::Again(Way::Undivided));
    }

    // Not known again once vertices move.
    let mut none_crosses = false;
    if may_shorten {
        let Some((uncrossed, crossing)) = job.uncross(attempt, (divisible, is_divided), options)? else {
            return Ok(Outcome::Again(Way::Divided));
        };
        attempt = uncrossed;
        none_crosses = crossing == 0 && preprocessed.pairs.is_none();
    }
    let (settled, moved) = settle_tips(&mut attempt, subject, options, token)?;
    none_crosses &= !moved;
    let Some((carried, topology)) =
        put_together(&mut job, &mut attempt, (given, &preprocessed, subject), &settled, options)?
    else {
        return Ok(Outcome::Again(Way::Undivided));
    };
    let mesh = &attempt.built.mesh;
    let most_crossing = constants::MOST_CROSSING * mesh.facets().len() as f64;
    if is_divided && !none_crosses && crossings(mesh, token)?.count as f64 > most_crossing {
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
    let known = measured::Known { topology, none_crosses, measures, designed, apart: job.apart };
    let mut measured = measured::measure(clean, separated.figures.clone(), options, attempt, known, job)?;
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

/// Whether a designed part may be divided along its creases. What has to stay as it is, or to meet something else, may not.
fn may_divide(options: &RemeshOptions, held: Held<'_>) -> bool {
    let isotropic =
        options.anisotropy == Anisotropy::None && !matches!(options.density.source, DensitySource::Metric(_));
    let stays = held.closes || !options.periodic.is_empty() || !held.rims.is_empty() || !held.vertices.is_empty();
    options.keep_boundaries && isotropic && !stays
}

/// The edges of all creases, as those of `clean`.
fn creases(
    undivided: &Separated,
    clean: &TriMesh,
    Prepared { curves, plan, surface, .. }: &Prepared<'_>,
    token: &Token,
) -> Result<Vec<[u32; 2]>> {
    let edges = curves.every_edge((&plan.mesh, surface), undivided.mesh(clean).positions().len(), token)?;
    let before = |v| undivided.apart.as_ref().map_or(v, |apart| apart.before(v));
    Ok(edges.into_iter().map(|edge| edge.map(before)).collect())
}

/// A surface that is divided along its creases, with shorter edges where it bends; `Err` inside where it has no room for its curves.
fn prepare_divided<'a>(
    divided: &'a Separated,
    clean: &'a TriMesh,
    (options, asked): (&RemeshOptions, Asked<'_>),
    token: &Token,
) -> Result<Result<Prepared<'a>>> {
    let (mesh, options) = (divided.mesh(clean), divided.options(options));
    let prepared = prepare(mesh, options, asked, None, token);
    let DensityOptions { source, zones, .. } = &options.density;
    if let (Some(apart), Ok(Prepared { plan, .. })) = (&divided.apart, &prepared)
        && matches!(source, DensitySource::Uniform)
        && zones.is_empty()
        && let Some(edge) = plan.figures.edge_median
        && let Some(lengths) = bends::lengths(apart, clean, edge, token)?
    {
        let mut bent = prepare(mesh, &with_source(options, DensitySource::Sizes(lengths)), asked, None, token);
        bent.iter_mut().for_each(|of| of.plan.figures.source = source.name());
        return Ok(bent);
    }
    Ok(prepared)
}

/// How far the result may be, and how many points it may have, where `points` are planned.
fn limits(given: &TriMesh, options: &RemeshOptions, points: usize) -> Result<Option<Limits>> {
    let Some(Refine { tolerance, max_points }) = options.refine else { return Ok(None) };
    let first = if let Count::Points(count) = options.seeds.count() { count } else { points };
    let most = max_points.unwrap_or(first.saturating_mul(2));
    if points > most {
        return Err(RemeshError::RefineLimit { points, most });
    }
    Ok(Some(Limits { tolerance: tolerance.length(given), max_points: most }))
}

/// Gives the result the tips that it lost and the single points that it has to have. Returns the seeds of the points for the vertices that
/// moved to them, and whether any vertex moved.
fn settle_tips(
    attempt: &mut Attempt<'_>,
    subject: Subject<'_>,
    options: &RemeshOptions,
    token: &Token,
) -> Result<(HashMap<u32, u32>, bool)> {
    let Attempt { built, curves, plan, .. } = attempt;
    let mut moved = false;
    if options.keep_thin && options.placement == Placement::Fitted && !matches!(options.seeds, Seeds::Given(_)) {
        let broken = |e| RvdError::Internal(format!("facets in the places of one: {e}"));
        moved = tips::put_back(built, &plan.mesh, token)?.map_err(broken)?;
    }
    let in_metric = matches!(options.density.source, DensitySource::Metric(_));
    let mut settled = HashMap::new();
    if subject.asked.held.seams.is_some() && !in_metric {
        let broken = |e| RvdError::Internal(format!("a vertex moved to a point: {e}"));
        settled = tips::settle_points(built, curves, &plan.mesh, token)?.map_err(broken)?;
    }
    moved |= !settled.is_empty();
    Ok((settled, moved))
}

/// Brings the sheets of a result back to their places, joins them, and gives it the input's attributes. Returns them, and its topology where
/// that is known. `None`: the patches of a divided surface do not meet.
fn put_together(
    job: &mut Job<'_, '_>,
    attempt: &mut Attempt<'_>,
    (given, preprocessed, subject): (&TriMesh, &Preprocessed, Subject<'_>),
    settled: &HashMap<u32, u32>,
    options: &RemeshOptions,
) -> Result<Option<(Carried, Option<Topology>)>> {
    let token = job.token;
    let broken = |e: MeshError| RvdError::Internal(format!("a surface was valid where its parts were apart: {e}"));
    let built = &mut attempt.built;
    let Some(apart) = job.apart else {
        // Attributes are those of the facets as given, and so is the provenance.
        let carried = carried::transfer(job, given, options, (&built.mesh, &built.curve_edges))?;
        return Ok(Some((carried, None)));
    };
    let given_apart = preprocessed.given_apart(given, apart).map_err(broken)?;
    let mut carried = carried::transfer(job, &given_apart, options, (&built.mesh, &built.curve_edges))?;
    // Of the sheets apart: in their places, vertices of several may be in one.
    let of_sheets = topology_unless(&built.mesh, &Adjacency::unless(&built.mesh, token)?, token)?;
    built.mesh = apart.mesh_back(&built.mesh, token)?.map_err(broken)?;
    attempt.seeds.iter_mut().for_each(|p| *p = apart.back(*p));
    attempt.curves.move_dropped(|p| apart.back(p));
    // It answers for the sheets apart, not for the input.
    attempt.closest = None;
    let Subject { separated, is_divided, .. } = subject;
    let wanted = match separated.joined {
        _ if options.keep_non_manifold => separated.figures.topology,
        Some(joined) => joined,
        None => return Ok(Some((carried, Some(of_sheets)))),
    };
    join::join(built, &attempt.curves, settled, &mut carried).map_err(broken)?;
    job.topology = wanted;
    let mesh = &built.mesh;
    let key = |of: &Topology| (of.euler, of.components, of.boundary_loops);
    if options.keep_non_manifold {
        if !is_divided {
            return Ok(Some((carried, None)));
        }
        let found = topology_unless(mesh, &Adjacency::unless(mesh, token)?, token)?;
        return Ok((key(&found) == key(&wanted)).then_some((carried, Some(found))));
    }
    // What has one vertex is joined, and not what touches.
    let own = (0..mesh.positions().len() as u32).collect();
    let found = topology_unless(mesh, &Adjacency::with(mesh, own, token)?, token)?;
    // Patches on both sides of a hole may have the same edge across it.
    let is_broken =
        found.boundary_loops != wanted.boundary_loops || found.non_manifold_edges + found.non_manifold_vertices > 0;
    Ok((!(is_divided && is_broken)).then_some((carried, Some(found))))
}
