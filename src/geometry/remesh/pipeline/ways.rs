//! Several runs of all stages, of which the best result is taken.
//!
//! Purpose: [`run`] chooses whether a designed part is divided along its creases, which creases are kept, and the random seeds.
//! Invariant: a result is replaced by a nearer one with as few defects, by one with fewer that is not much farther, or by one that is much
//! nearer.
//! Must not know: what a stage does, meshes.

use super::super::features::Held;
use super::super::{Remesh, RemeshError, RemeshOptions, Result, Seeds, constants};
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

pub(super) enum Outcome {
    /// And whether the surface may be divided, and is not.
    Done(Box<Remesh>, bool),
    /// Divided, and so far from the input that it may be nearer undivided.
    Far(Box<Remesh>),
    /// Another way is better.
    Again(Way),
}

/// All stages once.
type Stages<'a> = dyn FnMut(Held<'_>, (&RemeshOptions, Way)) -> Result<Outcome> + 'a;

/// Where few facets of a designed part cross, or a joint of its sheets lacks an edge, other random seeds are tried.
pub(super) fn run(held: Held<'_>, options: &RemeshOptions, stages: &mut Stages<'_>, token: &Token) -> Result<Remesh> {
    let mut best = of_ways(held, options, stages, token)?;
    for k in 1..=constants::OTHER_SEEDS {
        let defects = best.report.defects(options.keep_non_manifold);
        let (&Seeds::Sample { seed, .. } | &Seeds::Implied { seed }) = &options.seeds else { break };
        let share = defects as f64 / best.mesh.facets().len() as f64;
        // Where holes closed, points are too few, and other seeds do not help. A joint that lacks an edge is a hole itself.
        let is_whole = options.keep_non_manifold || best.report.topology_changes.is_empty();
        if defects == 0 || share > constants::FEW_DEFECTS || !is_whole || !best.report.features.is_designed {
            break;
        }
        let mut other = options.clone();
        if let Seeds::Sample { seed: own, .. } | Seeds::Implied { seed: own } = &mut other.seeds {
            *own = seed.wrapping_add(k);
        }
        match of_ways(held, &other, stages, token) {
            Ok(done)
                if done.report.defects(options.keep_non_manifold) < defects
                    && done.report.topology_changes.len() <= best.report.topology_changes.len() =>
            {
                best = done;
            }
            _ => token.check()?,
        }
    }
    Ok(best)
}

/// Undivided, or divided along the creases. Where patches have no room for their edges, or the result is far, the nearest of several ways.
fn of_ways(held: Held<'_>, options: &RemeshOptions, stages: &mut Stages<'_>, token: &Token) -> Result<Remesh> {
    let mut way = Way::Free;
    let (done, divisible) = loop {
        match stages(held, (options, way))? {
            Outcome::Done(done, divisible) => break (*done, divisible),
            Outcome::Far(divided) => return nearest(Some(*divided), (held, options), stages, token),
            Outcome::Again(Way::Undivided) => return nearest(None, (held, options), stages, token),
            Outcome::Again(other) => way = other,
        }
    };
    if !(divisible && done.report.lacks_curves()) {
        return Ok(done);
    }
    let divided = stages(held, (options, Way::Divided));
    token.check()?;
    Ok(match divided {
        Ok(Outcome::Done(divided, _))
            if divided.report.is_nearer_than(&done.report)
                || options.strict_creases && divided.report.features.are_whole() =>
        {
            *divided
        }
        _ => done,
    })
}

/// The nearest of `divided`, if there is one, a result with seeds beside each other, one with the sharper creases alone, and one that is
/// not divided.
fn nearest(
    divided: Option<Remesh>,
    (held, options): (Held<'_>, &RemeshOptions),
    stages: &mut Stages<'_>,
    token: &Token,
) -> Result<Remesh> {
    let mut best = divided;
    if consider(&mut best, stages(held, (options, Way::Beside)), token)? {
        return best.ok_or_else(no_result);
    }
    // The facets of round surfaces have creases between them, which need more vertices than the edges of a part.
    let coarse = Held { least_crease_deg: Some(SHARP_DEG), ..held };
    let has_weaker = options.crease_angle_deg < SHARP_DEG && !options.strict_creases;
    if !(has_weaker && consider(&mut best, stages(coarse, (options, Way::Divided)), token)?) {
        match stages(held, (options, Way::Undivided)) {
            Err(error) if best.is_none() => return Err(error),
            undivided => _ = consider(&mut best, undivided, token)?,
        }
    }
    best.ok_or_else(no_result)
}

fn no_result() -> RemeshError {
    RvdError::Internal("a surface that is not divided was to be".to_owned()).into()
}

/// Takes another result in place of the best if it is nearer, or has no defect, as many curves and at most twice the distance. One that
/// is much nearer may have facets that cross. Returns whether it was taken and has no defect.
fn consider(best: &mut Option<Remesh>, outcome: Result<Outcome>, token: &Token) -> Result<bool> {
    token.check()?;
    let (other, is_near) = match outcome {
        Ok(Outcome::Done(other, _)) => (other, true),
        Ok(Outcome::Far(other)) => (other, false),
        _ => return Ok(false),
    };
    let is_sound = is_near && other.report.is_sound();
    let is_better = |best: &Remesh| {
        let (own, others) = (&other.report, &best.report);
        let keeps = own.features.dropped_length <= others.features.dropped_length;
        let keeps_topology = own.topology_changes.len() <= others.topology_changes.len();
        is_sound && keeps && own.distance() <= 2.0 * others.distance()
            || keeps_topology && constants::MUCH_NEARER * own.distance() < others.distance()
            || own.is_nearer_than(others)
    };
    let is_taken = best.as_ref().is_none_or(is_better);
    if is_taken {
        *best = Some(*other);
    }
    Ok(is_sound && is_taken)
}
