//! Several runs of all stages, of which the best result is taken.
//!
//! Purpose: [`run`] chooses whether a designed part is divided along its creases, which creases are kept, the random seeds, and
//! whether it needs more points.
//! Invariant: of several results the best is taken, in one order (`Report::standing`). A sound result that is near is the only one.
//! Must not know: what a stage does, meshes.

use super::super::features::Held;
use super::super::report::{CountFigures, CountReason, Standing};
use super::super::{Remesh, RemeshOptions, Result, Seeds, constants};
use super::optimize::is_near;
use crate::cvt::density::DensitySource;
use crate::mesh::features::SHARP_DEG;
use crate::rvd::RvdError;
use crate::token::Token;

/// Whether a surface is divided along its creases: each patch then has cells of its own, and no crease is dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    /// Where creases would be dropped, or the surface is too thin for its cells.
    Free,
    Divided,
    /// Divided, with seeds of bent curves beside those of curves near them.
    Beside,
    Undivided,
}

impl Way {
    pub(super) fn divides(self) -> bool {
        matches!(self, Self::Divided | Self::Beside)
    }
}

/// What a run of all stages comes to.
pub(super) enum Outcome {
    Done(Box<Remesh>, Division),
    /// Another way is better.
    Again(Way),
}

/// Of the surface along its creases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Division {
    Impossible,
    Possible,
    Made,
}

/// All stages once.
type Stages<'a> = dyn FnMut(Held<'_>, (&RemeshOptions, Way)) -> Result<Outcome> + 'a;

/// Where few facets of a designed part are defects, a joint of its sheets lacks an edge, or a part is lost, other random seeds are tried.
pub(super) fn run(held: Held<'_>, options: &RemeshOptions, stages: &mut Stages<'_>, token: &Token) -> Result<Remesh> {
    let mut best = of_ways(held, options, stages, token)?;
    for k in 1..=constants::OTHER_SEEDS {
        let report = &best.report;
        let joined = options.keep_non_manifold;
        let (defects, Standing { is_lost, .. }) = (report.new_defects(joined), report.standing(joined));
        let (&Seeds::Sample { seed, .. } | &Seeds::Implied { seed }) = &options.seeds else { break };
        let share = defects as f64 / best.mesh.facets().len() as f64;
        // Where holes closed, points are too few, and other seeds do not help. A joint that lacks an edge is a hole itself.
        let is_whole = joined || report.topology_changes.is_empty();
        let is_sound = defects == 0 && !is_lost;
        if is_sound || share > constants::FEW_DEFECTS || !is_whole || !report.features.is_designed {
            break;
        }
        let mut other = options.clone();
        if let Seeds::Sample { seed: own, .. } | Seeds::Implied { seed: own } = &mut other.seeds {
            *own = seed.wrapping_add(k);
        }
        match of_ways(held, &other, stages, token) {
            // All vertices are those of curves, and none is drawn.
            Ok(done) if done.mesh == best.mesh => break,
            Ok(done) => take_better(&mut best, done, options),
            Err(_) => token.check()?,
        }
    }
    if best.report.lacks_points() { with_more_points(best, (held, options), stages, token) } else { Ok(best) }
}

/// With more points if they take all defects away, but perhaps for chords that leave creases; else `best`. Few are too few for the edges
/// of some designed parts.
fn with_more_points(
    best: Remesh,
    (held, options): (Held<'_>, &RemeshOptions),
    stages: &mut Stages<'_>,
    token: &Token,
) -> Result<Remesh> {
    let &Seeds::Sample { points, seed } = &options.seeds else { return Ok(best) };
    // A tolerance adds points itself, a metric has lengths of its own, and what is strict is refused. A part of a surface is not all of
    // what was asked for.
    let in_metric = matches!(options.density.source, DensitySource::Metric(_));
    let is_part = held.closes || !held.rims.is_empty() || !held.vertices.is_empty();
    let is_fixed = options.refine.is_some() || in_metric || options.strict_creases || is_part;
    if is_fixed || points > constants::FEW_POINTS {
        return Ok(best);
    }
    let with_reason = |mut done: Remesh| {
        let reason = (!is_near(done.report.result.vertices, points)).then_some(CountReason::FewPoints);
        done.report.vertex_count = CountFigures { asked: points, reason, ..done.report.vertex_count };
        done
    };
    let mut second = None;
    for times in constants::MORE_POINTS {
        let more = RemeshOptions { seeds: Seeds::Sample { points: times * points, seed }, ..options.clone() };
        match of_ways(held, &more, stages, token) {
            Ok(done) if !done.report.lacks_points() => return Ok(with_reason(done)),
            Ok(done) => {
                let changes = &done.report.topology_changes;
                // More do not help.
                if !changes.is_empty() && *changes == best.report.topology_changes {
                    break;
                }
                if second.is_none() && best.report.is_lacking() && !done.report.is_lacking() {
                    second = Some(done);
                }
            }
            Err(_) => token.check()?,
        }
    }
    Ok(second.map_or(best, with_reason))
}

/// Undivided, or divided along the creases. Where patches have no room for their edges, or the result is far, the best of several ways.
fn of_ways(held: Held<'_>, options: &RemeshOptions, stages: &mut Stages<'_>, token: &Token) -> Result<Remesh> {
    let mut way = Way::Free;
    let (mut done, division) = loop {
        match stages(held, (options, way))? {
            Outcome::Done(done, division) => break (*done, division),
            Outcome::Again(Way::Undivided) => return of_others(None, (held, options), stages, token),
            Outcome::Again(other) => way = other,
        }
    };
    match division {
        Division::Made if done.report.misses_bound() || !options.strict_creases && done.report.has_no_room() => {
            of_others(Some(done), (held, options), stages, token)
        }
        Division::Possible if done.report.lacks_curves() => {
            match stages(held, (options, Way::Divided)) {
                Ok(Outcome::Done(divided, _)) if options.strict_creases && divided.report.features.are_whole() => {
                    done = *divided;
                }
                Ok(Outcome::Done(divided, _)) => take_better(&mut done, *divided, options),
                _ => token.check()?,
            }
            Ok(done)
        }
        _ => Ok(done),
    }
}

/// The best of `divided`, if there is one, a result with seeds beside each other, one with the sharper creases alone, and one that is not
/// divided. What is sound and has room is taken at once.
fn of_others(
    divided: Option<Remesh>,
    (held, options): (Held<'_>, &RemeshOptions),
    stages: &mut Stages<'_>,
    token: &Token,
) -> Result<Remesh> {
    // The facets of round surfaces have creases between them, which need more vertices than the edges of a part.
    let coarse = Held { least_crease_deg: Some(SHARP_DEG), ..held };
    let has_weaker = options.crease_angle_deg < SHARP_DEG && !options.strict_creases;
    let coarse = has_weaker.then_some((coarse, Way::Divided));
    let mut best = divided;
    for (held, way) in [Some((held, Way::Beside)), coarse, Some((held, Way::Undivided))].into_iter().flatten() {
        match (stages(held, (options, way)), &mut best) {
            (Ok(Outcome::Done(done, _)), Some(best)) => take_better(best, *done, options),
            (Ok(Outcome::Done(done, _)), None) => best = Some(*done),
            (Err(error), None) if way == Way::Undivided => return Err(error),
            _ => token.check()?,
        }
        // Another way may drop creases.
        let has_room = |of: &Remesh| options.strict_creases || !of.report.has_no_room();
        let is_sound = |of: &Remesh| of.report.is_sound() && !of.report.misses_bound() && has_room(of);
        if best.as_ref().is_some_and(is_sound) {
            break;
        }
    }
    best.ok_or_else(|| RvdError::Internal("a surface that is not divided was to be".to_owned()).into())
}

/// Takes another result in place of the best, if it is better.
fn take_better(best: &mut Remesh, other: Remesh, options: &RemeshOptions) {
    let standing = |of: &Remesh| of.report.standing(options.keep_non_manifold);
    if standing(&other).is_better_than(&standing(best)) {
        *best = other;
    }
}
