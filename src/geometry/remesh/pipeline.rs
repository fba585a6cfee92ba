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
mod carried;
mod connect;
mod crossing;
mod extract;
mod job;
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
mod stages;
mod tips;
mod tolerance;
mod uncross;
mod ways;

use glam::DVec3;

use super::attributes;
use super::features::Held;
use super::{Anisotropy, Observer, Placement, Remesh, RemeshError, RemeshOptions, Result, Seeds, Tolerance, warnings};
use crate::cvt::density::DensitySource;
use crate::mesh::TriMesh;
use crate::mesh::attributes::Attributes;
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::input::{draw_in, outliers};
use crate::rvd::{Backend, RvdError, on_threads_of};
use crate::token::Token;
use ways::Way;

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
        stages::run((mesh, held), (options, way), backend, &mut *observer, token)
    };
    ways::run(held, options, &mut run, token)
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
