//! The report of a run, as `--report` writes it and the service sends it.
//!
//! Purpose: plain figures with fixed names, and `to_json`, which writes them.
//! Invariant: a name that scripts read does not change.
//! Must not know: how the figures came about.

use std::fmt;

use serde::Serialize;

use super::constants::{ENOUGH_AWAY, ENOUGH_LACKING, FAR_DIVIDED};
use crate::cvt::density::DensityFigures;
pub use crate::cvt::figures::{DeviceFigures, FinalFigures, IterationFigures};
pub use crate::mesh::comparison::{LostPart, LostParts, LostReason};
pub use crate::mesh::crossings::Crossings;
pub use crate::mesh::duplicates::InputKind;
pub use crate::mesh::input::InputFigures;
use crate::mesh::measure::{Quality, Topology};
pub use crate::mesh::metric::MetricFigures;
pub use crate::rvd::RvdFigures;

/// What `--report` writes.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// "serial", "parallel" or "gpu".
    pub backend: String,
    /// The GPU adapter's name.
    pub adapter: Option<String>,
    /// Threads of the CPU pool.
    pub threads: usize,
    /// Random seed, if the seeds were drawn: that of the options, or one up to three above it where the result had defects.
    pub seed: Option<u64>,
    /// Whether a convergence test stopped the iterations.
    pub converged: bool,
    /// The surface that came in.
    pub input: InputFigures,
    /// Creases and boundaries.
    pub features: FeatureFigures,
    /// The last diagram and what it took.
    pub rvd: RvdFigures,
    /// One entry a step.
    pub iterations: Vec<IterationFigures>,
    /// The seeds after the last step.
    #[serde(rename = "final")]
    pub last: FinalFigures,
    /// What was done after them.
    pub refine: RefineFigures,
    /// How many vertices were asked for, and why there are not as many.
    pub vertex_count: CountFigures,
    /// Wall-clock times.
    pub timings_ms: Timings,
    /// Memory.
    pub memory: MemoryFigures,
    /// What a GPU was kept busy with.
    pub device: DeviceFigures,
    /// The surface that came out.
    pub result: ResultFigures,
    /// What is not as in the input, e.g. "euler: 0 becomes 2"; empty if χ, components and boundary loops are kept.
    pub topology_changes: Vec<String>,
    /// Target edge lengths.
    pub density: DensityFigures,
    /// Data that changed or was dropped, and requests that were missed.
    pub warnings: Vec<Warning>,
}

impl Report {
    /// Whether curves were dropped or broken, or facets cross.
    pub(crate) fn lacks_curves(&self) -> bool {
        !self.features.are_whole() || self.features.creases > 0 && self.crossing() > 0
    }

    fn crossing(&self) -> usize {
        self.result.crossings.as_ref().map_or(0, |crossings| crossings.count)
    }

    fn folded(&self) -> usize {
        self.result.folded_edges.unwrap_or(0)
    }

    /// Whether no facets cross, and the topology is that of the input.
    pub(crate) fn is_sound(&self) -> bool {
        self.topology_changes.is_empty() && self.crossing() == 0
    }

    /// Whether patches have no room for their edges: it lacks a part, or is folded and far from the input.
    pub(crate) fn has_no_room(&self) -> bool {
        let away = self.result.edges_away;
        away > 1.0 || away > FAR_DIVIDED && self.folded() > 0
    }

    /// Facets that cross others, but where some of the input do.
    fn new_crossing(&self) -> usize {
        if self.result.input_crosses { 0 } else { self.crossing() }
    }

    /// The defects of its [`Standing`], but for crossing facets that the input has as well.
    pub(crate) fn new_defects(&self, joined: bool) -> usize {
        self.standing(joined).defects - self.crossing() + self.new_crossing()
    }

    /// Whether it is a designed part with defects, far from the input, or without some of the creases.
    pub(crate) fn is_lacking(&self) -> bool {
        let FeatureFigures { is_designed, dropped_share, .. } = self.features;
        let is_far = self.result.edges_away > ENOUGH_AWAY;
        let has_defects = !self.topology_changes.is_empty() || self.new_crossing() + self.folded() > 0;
        is_designed && (has_defects || is_far || dropped_share > ENOUGH_LACKING)
    }

    /// Whether it is lacking, or its chords leave the creases.
    pub(crate) fn lacks_points(&self) -> bool {
        let FeatureFigures { is_designed, dropped_share, away_share, .. } = self.features;
        self.is_lacking() || is_designed && dropped_share + away_share > ENOUGH_LACKING
    }

    /// Whether a tolerance was asked for, and is not reached.
    pub(crate) fn misses_bound(&self) -> bool {
        self.refine.ended.is_some_and(|ended| ended != RefineEnd::Reached)
    }

    /// What decides between it and other results of the same input. `joined`: whether its sheets are.
    pub(crate) fn standing(&self, joined: bool) -> Standing {
        let missing = if joined { self.features.missing_segments } else { 0 };
        // Near the input, a narrow facet that turns over is no loss.
        let folded = if self.has_no_room() { self.folded() } else { 0 };
        Standing {
            topology_changes: self.topology_changes.len(),
            is_lost: self.result.edges_away > 1.0,
            defects: self.crossing() + folded + missing,
            misses_bound: self.misses_bound(),
            dropped_length: self.features.dropped_length,
            distance: self.result.quality.as_ref().map_or(f64::INFINITY, |of| of.hausdorff_percent),
        }
    }
}

/// Distances below this are rounding, % of the diagonal: those of planes.
const ROUNDED: f64 = 1e-6;

/// How good a result is: the first difference decides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Standing {
    pub(crate) topology_changes: usize,
    /// Whether it lacks a part: a place of the input is farther away than an edge is long.
    pub(crate) is_lost: bool,
    /// Facets that cross, edges that are folded far from the input, and edges of joints that are missing.
    pub(crate) defects: usize,
    misses_bound: bool,
    dropped_length: f64,
    distance: f64,
}

impl Standing {
    /// A result that drops more curves has to be twice as near.
    pub(crate) fn is_better_than(&self, other: &Self) -> bool {
        let first = |of: &Self| (of.topology_changes, of.is_lost, of.defects, of.misses_bound);
        let distance = |of: &Self, beside: &Self| {
            let share = if of.dropped_length > beside.dropped_length { 2.0 } else { 1.0 };
            share * of.distance.max(ROUNDED)
        };
        let order = first(self).cmp(&first(other));
        order.then_with(|| distance(self, other).total_cmp(&distance(other, self))).is_lt()
    }
}

/// Old names of keys, for one release: where, now, before.
const OLD_KEYS: [(&str, &str, &str); 12] = [
    ("/input", "reoriented_facets", "turned_facets"),
    ("/input", "coincident_facets", "spare_facets"),
    ("/input", "outlier_vertices", "stray_vertices"),
    ("/features", "merged_corners", "joined_corners"),
    ("/features", "dropped_curves", "given_up"),
    ("/refine", "out_of_tolerance", "missed"),
    ("/refine", "closed_ball_rounds", "thin_rounds"),
    ("/refine", "closed_ball_failures", "thin_cells"),
    ("/result/repair", "multiple_boundary_arcs", "multiple_rims"),
    ("/result/repair", "inconsistent_vertices", "disputed_vertices"),
    ("/result/repair", "closed_facet_pairs", "closed_pockets"),
    ("/result/repair", "extra_vertices", "further_vertices"),
];

/// A report as JSON, also with the names that its keys had before.
pub fn to_json(report: &impl Serialize) -> serde_json::Result<serde_json::Value> {
    let mut json = serde_json::to_value(report)?;
    for (place, now, before) in OLD_KEYS {
        let Some(serde_json::Value::Object(figures)) = json.pointer_mut(place) else { continue };
        if let Some(value) = figures.get(now).cloned() {
            figures.insert(before.to_owned(), value);
        }
    }
    Ok(json)
}

/// A condition that a caller should know of.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Warning {
    /// The name of the condition, for programs.
    pub code: &'static str,
    /// One sentence: what happened, and what helps.
    pub message: String,
    /// How many elements it is about; absent if it is about none or all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub count: Option<usize>,
    /// Where, caller's coordinates; the first places of many.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f64; 3]>,
}

impl Warning {
    pub(super) fn new(code: &'static str, count: Option<usize>, message: String) -> Self {
        Self { code, message, count, places: Vec::new() }
    }

    /// Data of a file that the reader leaves aside.
    pub fn left_aside(what: impl fmt::Display) -> Self {
        Self::new("left_aside", None, format!("left aside: {what}"))
    }

    /// Data of the result that the format of the output cannot hold.
    pub fn not_held(what: &[String]) -> Option<Self> {
        let all = what.join(", ");
        (!what.is_empty()).then(|| Self::new("not_held", Some(what.len()), format!("this format cannot hold: {all}")))
    }
}

/// What was done after the iterations: curves cleared, seeds moved that had no vertex or added where the result was far.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq)]
pub struct RefineFigures {
    /// Rounds in which seeds were moved or added.
    pub rounds: usize,
    /// Seeds without a vertex that were moved to where edges are long.
    pub moved_seeds: usize,
    /// Seeds added where the result was far: more than the rounds began with.
    pub added_seeds: usize,
    /// Passes over the diagram.
    pub evaluations: usize,
    /// Samples of either surface that are farther from the other than the tolerance; without one, far places of the input.
    pub out_of_tolerance: usize,
    /// The largest distance of a sample, both ways, % of the input's bounding-box diagonal; absent without a tolerance.
    pub deviation_percent: Option<f64>,
    /// What ended the rounds for a tolerance; absent without one.
    pub ended: Option<RefineEnd>,
    /// Rounds that drew seeds again with shorter edges, where the surface was too thin for its cells.
    pub closed_ball_rounds: usize,
    /// Rounds with less anisotropy where the dual folded.
    pub fold_rounds: usize,
    /// Cells for which it still is.
    pub closed_ball_failures: usize,
    /// Rounds that drew fewer seeds, for the number of vertices that was asked for.
    pub count_rounds: usize,
}

/// The number of vertices.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct CountFigures {
    /// How many vertices were asked for, or implied by edge lengths.
    pub asked: usize,
    /// How many seeds there are: fewer where cells have several components.
    pub seeds: usize,
    /// Why there are more or fewer vertices than that, by over 1.5 %; absent if there are not. With a
    /// tolerance, for more alone.
    pub reason: Option<CountReason>,
}

/// Why a result has not as many vertices as were asked for.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum CountReason {
    /// Seeds were given, so none was left out or added.
    GivenSeeds,
    /// The parts of the input need more vertices: three vertices each, or four if they are closed.
    Parts,
    /// Sheets or parts are nearer to each other than an edge is long: seeds have a vertex on each.
    CloseSheets,
    /// Parts of the input are so small that they got too few seeds for a facet, and were left out.
    SmallParts,
    /// Parts of the input have no thickness: seeds there have no vertex.
    NoThickness,
    /// Patches between creases are narrower than an edge, and take no vertices within.
    NarrowPatches,
    /// A designed part with so few points would be folded, cross itself, have another topology, be far from the input or lack creases.
    FewPoints,
    /// Edges cannot have the lengths that the metric asks for with so many vertices.
    Metric,
}

/// What ended the rounds for a tolerance.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
pub enum RefineEnd {
    /// No sample is farther away than asked for.
    Reached,
    /// All points that were allowed are used. More bring the result nearer.
    Budget,
    /// More points, or others, did not bring the result nearer.
    NoProgress,
}

/// Creases and boundaries that got seeds of their own.
#[derive(Clone, Debug, Default, Serialize, PartialEq)]
pub struct FeatureFigures {
    /// Boundary curves.
    pub boundaries: usize,
    /// Creases.
    pub creases: usize,
    /// Places where curves end, meet or turn sharply.
    pub corners: usize,
    /// Such places that have no seed, since another one is much nearer than an edge and the curves hardly change by it.
    pub merged_corners: usize,
    /// Seeds of corners and curves.
    pub seeds: usize,
    /// Pairs of seeds that follow each other on a curve.
    pub segments: usize,
    /// Of these, such as the result has no edge for.
    pub missing_segments: usize,
    /// Curves with such a pair.
    pub broken_curves: usize,
    /// Curves that there were too few points for.
    pub dropped_curves: usize,
    /// Their length, caller's units.
    pub dropped_length: f64,
    /// The longest of them, at most 8.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<DroppedCurve>,
    /// Edges bent enough for a crease in stretches too short for one.
    pub short_crease_edges: usize,
    /// The largest that the smallest angle of the result can be, degrees: what is left between curves at corners. Absent where that is
    /// 60 degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub angle_bound_deg: Option<f64>,
    /// Whether these are no noise: the surface has flat or ruled faces between sharp edges.
    #[serde(skip)]
    pub(crate) is_designed: bool,
    /// Shares of the length of curves: of what is dropped, and of what is a quarter of an edge from all edges that follow curves.
    /// 0 without `is_designed`.
    #[serde(skip)]
    pub(crate) dropped_share: f64,
    #[serde(skip)]
    pub(crate) away_share: f64,
}

impl FeatureFigures {
    /// Whether the result has all edges of all curves.
    pub(crate) fn are_whole(&self) -> bool {
        self.dropped_curves + self.missing_segments == 0
    }
}

/// A crease or a boundary that the result does not follow.
#[derive(Clone, Copy, Debug, Serialize, PartialEq)]
pub struct DroppedCurve {
    /// Caller's units.
    pub length: f64,
    /// A vertex in its middle, caller's coordinates.
    pub place: [f64; 3],
}

/// Memory that the run took.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MemoryFigures {
    /// The most that the process ever held, bytes; absent if unknown, and in a server's report: it does other jobs too.
    pub host_peak_bytes: Option<u64>,
    /// Device memory of the job's plan, bytes; 0 on a CPU.
    pub device_bytes: u64,
}

/// Wall-clock milliseconds per stage.
#[derive(Clone, Debug, Default, Serialize)]
#[allow(missing_docs)]
pub struct Timings {
    pub read: f64,
    pub prepare: f64,
    pub sample: f64,
    pub iterations: f64,
    pub refine: f64,
    pub dual: f64,
    pub repair: f64,
    pub measure: f64,
    pub write: f64,
    pub total: f64,
    pub attributes: f64,
}

/// The surface that came out.
#[derive(Clone, Debug, Serialize)]
pub struct ResultFigures {
    /// Vertices.
    pub vertices: usize,
    /// Facets.
    pub facets: usize,
    /// Euler characteristic χ, components, holes, non-manifold elements.
    #[serde(flatten)]
    pub topology: Topology,
    /// Vertices in the place of another, within 10⁻⁵ of the diagonal, without a common edge: a merge joins their parts.
    pub coincident_vertices: usize,
    /// Shape and distance figures; absent if not measured.
    #[serde(flatten)]
    pub quality: Option<Quality>,
    /// Edges and facets in the metric; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metric: Option<AdaptedFigures>,
    /// The regions of the input, by their numbers; absent without any.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub regions: Vec<RegionFigures>,
    /// What stayed as it was; absent if nothing was to stay.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kept: Option<KeptFigures>,
    /// How both halves meet; absent without a mirror plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mirror: Option<MirrorFigures>,
    /// How boundaries go on in others; absent without periodic ones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub periodic: Option<PeriodicFigures>,
    /// What it lacks of the input; absent if not measured.
    pub lost: Option<LostParts>,
    /// Facets that cross others; absent if not measured.
    pub crossings: Option<Crossings>,
    /// Edges whose facets turn by more than 150° where the input has none; absent if not measured, and for all but designed parts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub folded_edges: Option<usize>,
    /// Hausdorff distance over the length of an edge; infinite if not measured.
    #[serde(skip)]
    pub(crate) edges_away: f64,
    /// Whether facets of the input cross; known where some of the result do and the input is a designed part.
    #[serde(skip)]
    pub(crate) input_crosses: bool,
    /// What the repair had to do.
    pub repair: RepairFigures,
}

/// A region of the input in the result.
#[derive(Clone, Debug, Serialize, PartialEq)]
pub struct RegionFigures {
    /// Its number.
    pub number: i64,
    /// Its name; absent if it has none.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// Its area in the input, caller's units.
    pub input_area: f64,
    /// Its facets in the result; 0 if it is lost.
    pub facets: usize,
    /// Their area.
    pub area: f64,
}

/// What stayed as it was.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct KeptFigures {
    /// Facets, which are the first of the result.
    pub facets: usize,
    /// Vertices, which are the first of the result.
    pub vertices: usize,
    /// Edges that the rest meets.
    pub rim_edges: usize,
    /// Vertices that stay without facets, beside those of facets and edges that stay.
    pub single_vertices: usize,
    /// Facets that stayed though they need not, for the sake of these edges and vertices.
    pub further_facets: usize,
}

/// How a mirrored surface is.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq)]
pub struct MirrorFigures {
    /// Edges in the plane that both halves have.
    pub seam_edges: usize,
    /// How far the input's other half is from the mirror image of the one that was remeshed, at most, % of the diagonal.
    pub asymmetry_percent: f64,
}

/// How a periodic surface is.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct PeriodicFigures {
    /// Pairs of boundary edges of the result, one of which a motion takes to the other.
    pub edges: usize,
    /// Boundary edges of the input that a motion takes to within reach of others, of which none is the same.
    pub unpaired_edges: usize,
}

/// How well a result fits its metric.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq)]
pub struct AdaptedFigures {
    /// Lengths and shapes in the metric, scaled.
    #[serde(flatten)]
    pub figures: MetricFigures,
    /// What lengths in the metric were multiplied by for the number of vertices that was asked for: below 1, edges are longer. 1 if none
    /// was.
    pub scale: f64,
    /// Rounds of local changes.
    pub rounds: usize,
    /// Facets that face away from the input: its bends are shorter than the metric's edges.
    pub facing_away: usize,
}

/// What the repair had to do.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct RepairFigures {
    /// Restricted cells with more than one connected component.
    pub split_cells: usize,
    /// Cell components that are not a disk. If this and the next two are 0, the dual has the topology of a manifold input.
    pub not_disks: usize,
    /// Pairs of cell components that meet in more than one curve.
    pub multiple_edges: usize,
    /// Cell components that meet the boundary in more than one stretch.
    pub multiple_boundary_arcs: usize,
    /// RVD vertices whose three cells do not agree (see `rvd::dual`).
    pub inconsistent_vertices: usize,
    /// Facets dropped because two of their corners are one vertex.
    pub degenerate_facets: usize,
    /// Pairs of facets back to back that were taken out: cell components that touch two cells only.
    pub closed_facet_pairs: usize,
    /// Facets dropped because another has the same corners and orientation.
    pub duplicate_facets: usize,
    /// Facets dropped at edges with more than two facets or with two of one direction.
    pub non_manifold_facets: usize,
    /// Vertices split because their facets form more than one fan, and vertices put into edges along which two sheets touch.
    pub split_vertices: usize,
    /// Seeds without a vertex, and vertices beyond the first of theirs: vertices are seeds less the former plus the latter.
    pub seeds_without_vertex: usize,
    /// See `seeds_without_vertex`.
    pub extra_vertices: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOUND: Standing = Standing {
        topology_changes: 0,
        is_lost: false,
        defects: 0,
        misses_bound: false,
        dropped_length: 0.0,
        distance: 1.0,
    };

    #[test]
    fn defects_decide_before_distances_and_distances_before_dropped_curves() {
        let worse = [
            Standing { topology_changes: 1, distance: 0.1, ..SOUND },
            Standing { is_lost: true, distance: 0.1, ..SOUND },
            Standing { defects: 1, distance: 0.1, ..SOUND },
            Standing { misses_bound: true, distance: 0.1, ..SOUND },
            Standing { distance: 1.1, ..SOUND },
            // As near, and less than twice as near.
            Standing { dropped_length: 1.0, ..SOUND },
            Standing { dropped_length: 1.0, distance: 0.6, ..SOUND },
        ];
        for other in worse {
            assert!(SOUND.is_better_than(&other) && !other.is_better_than(&SOUND), "{other:?}");
        }
        let nearer = Standing { dropped_length: 1.0, distance: 0.4, ..SOUND };
        assert!(nearer.is_better_than(&SOUND) && !SOUND.is_better_than(&nearer));
        // Distances of planes are rounding.
        let flat = |distance: f64, dropped_length: f64| Standing { distance, dropped_length, ..SOUND };
        assert!(flat(1e-9, 0.0).is_better_than(&flat(1e-12, 1.0)));
    }
}
