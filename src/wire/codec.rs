//! Values between messages and the library's types.
//!
//! Purpose: enums, edits, figures. Invariant: an unknown enum value is an error, never a default; `None` is what is not
//! specified. Must not know: defaults (`options`), arrays (`chunks`).

use glam::DVec3;

use super::{WireError, proto};
use geometry::cvt::{Iteration, Projection, SeedEdit, StepKind};
use geometry::remesh::Placement;
use geometry::remesh::report::{RefineEnd, RvdFigures};
use geometry::rvd::{BackendChoice, BackendKind};

/// The backend that a header asks for.
pub fn backend(value: i32) -> Result<BackendChoice, WireError> {
    match proto::BackendChoice::try_from(value) {
        Ok(proto::BackendChoice::Unspecified | proto::BackendChoice::Auto) => Ok(BackendChoice::Auto),
        Ok(proto::BackendChoice::Gpu) => Ok(BackendChoice::Only(BackendKind::Gpu)),
        Ok(proto::BackendChoice::Parallel) => Ok(BackendChoice::Only(BackendKind::Parallel)),
        Ok(proto::BackendChoice::Serial) => Ok(BackendChoice::Only(BackendKind::Serial)),
        Err(_) => Err(WireError::unknown_enum("header.backend", value)),
    }
}

pub fn projection(value: i32) -> Result<Option<Projection>, WireError> {
    match proto::Projection::try_from(value) {
        Ok(proto::Projection::Unspecified) => Ok(None),
        Ok(proto::Projection::Free) => Ok(Some(Projection::Free)),
        Ok(proto::Projection::OnSurface) => Ok(Some(Projection::OnSurface)),
        Err(_) => Err(WireError::unknown_enum("header.projection", value)),
    }
}

/// Whether shape and distance are measured.
pub fn measure(value: i32) -> Result<Option<bool>, WireError> {
    match proto::Measure::try_from(value) {
        Ok(proto::Measure::Unspecified) => Ok(None),
        Ok(proto::Measure::Full) => Ok(Some(true)),
        Ok(proto::Measure::Topology) => Ok(Some(false)),
        Err(_) => Err(WireError::unknown_enum("header.measure", value)),
    }
}

pub fn placement(value: i32) -> Result<Option<Placement>, WireError> {
    match proto::Placement::try_from(value) {
        Ok(proto::Placement::Unspecified) => Ok(None),
        Ok(proto::Placement::Fitted) => Ok(Some(Placement::Fitted)),
        Ok(proto::Placement::Surface) => Ok(Some(Placement::Surface)),
        Ok(proto::Placement::Centroids) => Ok(Some(Placement::Centroids)),
        Err(_) => Err(WireError::unknown_enum("header.placement", value)),
    }
}

/// Whether boundaries are kept.
pub fn boundaries(value: i32) -> Result<Option<bool>, WireError> {
    match proto::BoundaryRule::try_from(value) {
        Ok(proto::BoundaryRule::Unspecified) => Ok(None),
        Ok(proto::BoundaryRule::Keep) => Ok(Some(true)),
        Ok(proto::BoundaryRule::Free) => Ok(Some(false)),
        Err(_) => Err(WireError::unknown_enum("header.boundaries", value)),
    }
}

/// Whether edges become shorter where the surface is thin.
pub fn thin(value: i32) -> Result<Option<bool>, WireError> {
    match proto::ThinRule::try_from(value) {
        Ok(proto::ThinRule::Unspecified) => Ok(None),
        Ok(proto::ThinRule::Finer) => Ok(Some(true)),
        Ok(proto::ThinRule::Even) => Ok(Some(false)),
        Err(_) => Err(WireError::unknown_enum("header.thin", value)),
    }
}

pub fn step_kind(value: i32) -> Result<StepKind, WireError> {
    match proto::StepKind::try_from(value) {
        Ok(proto::StepKind::Unspecified | proto::StepKind::Lloyd) => Ok(StepKind::Lloyd),
        Ok(proto::StepKind::Lbfgs) => Ok(StepKind::Lbfgs),
        Err(_) => Err(WireError::unknown_enum("step.kind", value)),
    }
}

/// What of a diagram is to be sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    pub cells: bool,
    pub centroids: bool,
    pub sums: bool,
}

pub fn outputs(values: &[i32]) -> Result<Outputs, WireError> {
    let mut outputs = Outputs { cells: values.is_empty(), ..Outputs::default() };
    for (i, &value) in values.iter().enumerate() {
        match proto::RvdOutput::try_from(value) {
            Ok(proto::RvdOutput::Cells) => outputs.cells = true,
            Ok(proto::RvdOutput::Centroids) => outputs.centroids = true,
            Ok(proto::RvdOutput::Sums) => outputs.sums = true,
            _ => return Err(WireError::unknown_enum(&format!("header.outputs[{i}]"), value)),
        }
    }
    Ok(outputs)
}

pub fn edits(edits: &[proto::SeedEdit]) -> Result<Vec<SeedEdit>, WireError> {
    let point = |p: &proto::Point| DVec3::new(p.x, p.y, p.z);
    let one = |(i, edit): (usize, &proto::SeedEdit)| {
        let missing = |what: &str| WireError::field(format!("edit.edits[{i}]{what}"), "is missing");
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
        return Err(WireError::field("edit.edits", "is empty; give at least one change"));
    }
    edits.iter().enumerate().map(one).collect()
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
