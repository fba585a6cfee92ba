//! Values between messages and the library's types.
//!
//! Purpose: enums, edits, figures. Invariant: an unknown enum value is an error, never a default; `None` is what is not
//! specified. Must not know: defaults (`options`), arrays (`chunks`).

use glam::DVec3;

use super::WireError;
use super::options::choice;
use super::proto::{self, SeedsWanted};
use geometry::cvt::{Iteration, SeedEdit, StepKind};
use geometry::remesh::Warning;
use geometry::remesh::report::{RefineEnd, RvdFigures};
use geometry::rvd::{BackendChoice, BackendKind};

pub fn backend(value: i32) -> Result<BackendChoice, WireError> {
    Ok(match choice("backend", value)? {
        proto::BackendChoice::Unspecified | proto::BackendChoice::Auto => BackendChoice::Auto,
        proto::BackendChoice::Gpu => BackendChoice::Only(BackendKind::Gpu),
        proto::BackendChoice::Parallel => BackendChoice::Only(BackendKind::Parallel),
        proto::BackendChoice::Serial => BackendChoice::Only(BackendKind::Serial),
    })
}

pub fn step_kind(value: i32) -> Result<StepKind, WireError> {
    Ok(match choice("kind", value)? {
        proto::StepKind::Unspecified | proto::StepKind::Lloyd => StepKind::Lloyd,
        proto::StepKind::Lbfgs => StepKind::Lbfgs,
    })
}

/// When a command wants the seeds.
pub fn seeds_wanted(value: i32) -> Result<SeedsWanted, WireError> {
    Ok(match choice("seeds", value)? {
        SeedsWanted::Unspecified => SeedsWanted::Never,
        wanted => wanted,
    })
}

pub fn edits(edits: &[proto::SeedEdit]) -> Result<Vec<SeedEdit>, WireError> {
    let point = |p: &proto::Point| DVec3::new(p.x, p.y, p.z);
    let one = |(i, edit): (usize, &proto::SeedEdit)| {
        let missing = |what: &str| WireError::field(format!("edits[{i}]{what}"), "is missing");
        match &edit.edit {
            Some(proto::seed_edit::Edit::Move(m)) => {
                let to = m.to.as_ref().ok_or_else(|| missing(".move.to"))?;
                Ok(SeedEdit::Move { index: m.index, to: point(to) })
            }
            Some(proto::seed_edit::Edit::Add(at)) => Ok(SeedEdit::Add { at: point(at) }),
            Some(proto::seed_edit::Edit::Remove(index)) => Ok(SeedEdit::Remove { index: *index }),
            None => Err(missing("")),
        }
    };
    if edits.is_empty() {
        return Err(WireError::field("edits", "is empty; give at least one change"));
    }
    edits.iter().enumerate().map(one).collect()
}

/// A duration in milliseconds, rounded up.
pub fn duration_ms(duration: prost_types::Duration) -> Result<u64, WireError> {
    match u64::try_from(duration.seconds) {
        Ok(seconds) if NANOS.contains(&duration.nanos) => Ok(milliseconds(seconds, duration.nanos)),
        _ => Err(WireError::field("", "is no duration from 0 on, with nanos from 0 to 999999999")),
    }
}

/// Parts of a second that a duration or a time may have, besides whole ones.
pub const NANOS: std::ops::Range<i32> = 0..1_000_000_000;

/// Milliseconds of seconds and nanoseconds that were checked, rounded up.
pub fn milliseconds(seconds: u64, nanos: i32) -> u64 {
    let parts = u64::from(nanos.unsigned_abs()).div_ceil(1_000_000);
    seconds.saturating_mul(1000).saturating_add(parts)
}

pub fn iteration(it: &Iteration, total: usize, queue_ms: f64) -> proto::Iteration {
    let device = it.stats.device;
    proto::Iteration {
        index: it.index as u64,
        kind: it.kind.name().to_owned(),
        energy: it.energy,
        energy_ratio: it.energy_ratio,
        gradient_norm: it.gradient_norm,
        evaluations: u32::try_from(it.evaluations).unwrap_or(u32::MAX),
        empty_cells: u32::try_from(it.empty_cells).unwrap_or(u32::MAX),
        area: it.area,
        pairs: it.stats.pairs,
        ms: it.ms,
        relaunched_pairs: it.stats.relaunched(),
        total: total as u64,
        queue_ms,
        host_searches: device.host_searches,
        divided_facets: device.divided_facets,
        paired_facets: device.paired_facets,
        device_submissions: device.device_submissions,
        device_allocations: device.device_allocations,
        uploaded_bytes: device.uploaded_bytes,
        read_back_bytes: device.read_back_bytes,
    }
}

pub fn refinement_end(ended: RefineEnd) -> proto::RefinementEnd {
    match ended {
        RefineEnd::Reached => proto::RefinementEnd::Reached,
        RefineEnd::Budget => proto::RefinementEnd::Budget,
        RefineEnd::NoProgress => proto::RefinementEnd::NoProgress,
    }
}

pub fn warning(warning: &Warning) -> proto::Warning {
    proto::Warning {
        code: warning.code.to_owned(),
        message: warning.message.clone(),
        count: warning.count.map(|count| count as u64),
        places: warning.places.iter().map(|&[x, y, z]| proto::Point { x, y, z }).collect(),
    }
}

pub fn figures(figures: &RvdFigures) -> proto::RvdFigures {
    proto::RvdFigures {
        area: figures.area,
        pairs: figures.pairs,
        relaunched_pairs: figures.relaunched_pairs,
        f64_finished_pairs: figures.f64_finished_pairs,
        empty_cells: figures.empty_cells as u64,
        duplicate_seeds: figures.duplicate_seeds as u64,
    }
}
