//! The report of a run, as `--report` writes it and the service sends it.
//!
//! Purpose: plain figures with fixed names, and `to_json`, which writes them.
//! Invariant: a name that scripts read does not change.
//! Must not know: how the figures came about.

use serde::Serialize;

use crate::cvt::Iteration;
use crate::cvt::density::DensityFigures;
use crate::mesh::adjacency::Adjacency;
pub use crate::mesh::duplicates::InputKind;
use crate::mesh::duplicates::{self, Oddities};
pub use crate::mesh::lost::{LostPart, LostParts, LostReason};
use crate::mesh::measure::{Quality, Topology, topology_unless};
use crate::mesh::{TriMesh, outliers};
use crate::rvd::dual::Dual;
use crate::rvd::{DeviceWork, PassStats, Surface};
use crate::token::{Stopped, Token};

/// What `--report` writes.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// "serial", "parallel" or "gpu".
    pub backend: String,
    /// The GPU adapter's name.
    pub adapter: Option<String>,
    /// Threads of the CPU pool.
    pub threads: usize,
    /// Random seed, if the seeds were drawn.
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
    /// What is not as in the input, e.g. "euler: 0 becomes 2"; empty if χ, components and boundary
    /// loops are kept.
    pub topology_changes: Vec<String>,
    /// Target edge lengths.
    pub density: DensityFigures,
}

/// Old names of keys, for one release: where, now, before.
#[cfg(feature = "service")]
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
#[cfg(feature = "service")]
pub(crate) fn to_json(report: &impl Serialize) -> serde_json::Result<serde_json::Value> {
    let mut json = serde_json::to_value(report)?;
    for (place, now, before) in OLD_KEYS {
        let Some(serde_json::Value::Object(figures)) = json.pointer_mut(place) else { continue };
        if let Some(value) = figures.get(now).cloned() {
            figures.insert(before.to_owned(), value);
        }
    }
    Ok(json)
}

/// What of the topology is not kept, one sentence each. Non-manifold elements are not counted as
/// kept or lost: the result never has any.
pub(crate) fn topology_changes(input: &Topology, result: &Topology) -> Vec<String> {
    let pairs = [
        ("euler", input.euler, result.euler),
        ("components", input.components as i64, result.components as i64),
        ("boundary_loops", input.boundary_loops as i64, result.boundary_loops as i64),
    ];
    let changed = pairs.into_iter().filter(|(_, before, after)| before != after);
    changed.map(|(name, before, after)| format!("{name}: {before} becomes {after}")).collect()
}

/// The surface that came in.
#[derive(Clone, Debug, Serialize)]
pub struct InputFigures {
    /// What it is.
    pub kind: InputKind,
    /// Facets whose edges all have more than two facets.
    pub enclosed_facets: usize,
    /// Facets that lie on others, corner on corner and back to back, and stay: they enclose nothing.
    pub back_to_back_facets: usize,
    /// Vertices as given.
    pub vertices: usize,
    /// Facets, degenerate ones included.
    pub facets: usize,
    /// Facets without area.
    pub degenerate_facets: usize,
    /// Edges of two facets that are oriented unlike each other.
    pub inconsistent_edges: usize,
    /// Facets that were turned over, to be oriented as their neighbours are.
    pub reoriented_facets: usize,
    /// Vertices of boundaries that were moved to others which are nearly in the same place; the other figures are of the surface
    /// after that,
    pub stitched_vertices: usize,
    /// and without so many facets that lay on others, corner on corner, where the surface goes on without them.
    pub coincident_facets: usize,
    /// Vertices a thousand times as far from the middle as half of all are: wrong coordinates, most often. The surface has a
    /// spike there, which takes most of the points.
    pub outlier_vertices: usize,
    /// Caller's units squared.
    pub area: f64,
    /// χ, components, holes, non-manifold elements.
    #[serde(flatten)]
    pub topology: Topology,
}

/// What was done after the iterations: curves cleared, seeds moved that had no vertex or added where the result was far from
/// the input.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq)]
pub struct RefineFigures {
    /// Rounds in which seeds were moved or added.
    pub rounds: usize,
    /// Seeds without a vertex that were moved to where edges are long.
    pub moved_seeds: usize,
    /// Seeds added there.
    pub added_seeds: usize,
    /// Passes over the diagram.
    pub evaluations: usize,
    /// Samples of the input and of the result that are farther from the other surface than the tolerance; without one, places
    /// of the input that the result is far from.
    pub out_of_tolerance: usize,
    /// The largest distance of a sample, both ways, % of the input's bounding-box diagonal; absent without a tolerance.
    pub deviation_percent: Option<f64>,
    /// What ended the rounds for a tolerance; absent without one.
    pub ended: Option<RefineEnd>,
    /// Rounds that drew seeds again with shorter edges, where the surface was too thin for its cells.
    pub closed_ball_rounds: usize,
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
    /// Why there are more or fewer vertices than that, by over 1.5 %; absent where there are not, and with a tolerance, which
    /// adds points.
    pub reason: Option<CountReason>,
}

/// Why a result has not as many vertices as were asked for.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum CountReason {
    /// Seeds were given, so none was left out or added.
    GivenSeeds,
    /// The input has so many parts that they need more: three vertices each, or four if they are closed.
    Parts,
    /// Sheets or parts are nearer to each other than an edge is long: seeds have a vertex on each.
    CloseSheets,
    /// Parts of the input are so small that they got too few seeds for a facet, and were left out.
    SmallParts,
    /// Parts of the input have no thickness: seeds there have no vertex.
    NoThickness,
}

/// What ended the rounds for a tolerance.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Eq)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RefineEnd {
    /// No sample is farther away than asked for.
    Reached,
    /// All points that were allowed are used. More bring the result nearer.
    Budget,
    /// More points, or others, did not bring the result nearer.
    NoProgress,
}

/// Creases and boundaries that got seeds of their own.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
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
    /// Edges bent enough for a crease in stretches too short for one.
    pub short_crease_edges: usize,
}

/// The last diagram and what all of them took.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RvdFigures {
    /// Area covered by the pieces, caller's units squared.
    pub area: f64,
    /// (facet, cell) incidences.
    pub pairs: u64,
    /// Pairs launched more than once, all passes.
    pub relaunched_pairs: u64,
    /// Of these, because neighbours ran out.
    pub relaunched_neighbours: u64,
    /// Because polygon slots ran out.
    pub relaunched_polygon: u64,
    /// Because cell slots ran out.
    pub relaunched_cells: u64,
    /// Pairs that the f64 path finished for the GPU, all passes.
    pub f64_finished_pairs: u64,
    /// Cells without surface in the last diagram.
    pub empty_cells: usize,
    /// Seeds that lay exactly on an earlier one, in the pass that had most of them. Their cells are empty.
    pub duplicate_seeds: usize,
    /// Seeds placed again because their cell was empty, all passes.
    pub reseeded_cells: usize,
}

/// Memory that the run took.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MemoryFigures {
    /// The most that the process ever held, bytes; absent where the system does not say, and in a
    /// server's report, whose process does other jobs too.
    pub host_peak_bytes: Option<u64>,
    /// Device memory of the job's plan, bytes; 0 on a CPU.
    pub device_bytes: u64,
}

/// What a GPU was kept busy with: nothing on a CPU. A device counts for all its users together.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct DeviceFigures {
    /// All of the run, from opening the session on.
    #[serde(flatten)]
    pub total: DeviceWork,
    /// Of this, in the iterations.
    pub iterations: DeviceWork,
    /// Figure by figure, the middle of the iterations but the first, which allocates and uploads what the others use.
    pub later_iteration_median: DeviceWork,
    /// The most of them. Where pairs are done again or on the host, seeds and sums are read back.
    pub later_iteration_most: DeviceWork,
}

impl DeviceFigures {
    /// Of a run with these iterations.
    pub(crate) fn new(total: DeviceWork, iterations: &[IterationFigures]) -> Self {
        let sum = iterations.iter().fold(DeviceWork::default(), |sum, step| sum.with(&step.device, |a, b| a + b));
        let later: Vec<DeviceWork> = iterations.iter().skip(1).map(|step| step.device).collect();
        let at = |place: fn(usize) -> usize| {
            let of = |figure: fn(&DeviceWork) -> u64| {
                let mut all: Vec<u64> = later.iter().map(figure).collect();
                all.sort_unstable();
                all.get(place(all.len())).copied().unwrap_or(0)
            };
            DeviceWork {
                host_searches: of(|w| w.host_searches),
                divided_facets: of(|w| w.divided_facets),
                paired_facets: of(|w| w.paired_facets),
                device_submissions: of(|w| w.device_submissions),
                device_allocations: of(|w| w.device_allocations),
                uploaded_bytes: of(|w| w.uploaded_bytes),
                read_back_bytes: of(|w| w.read_back_bytes),
            }
        };
        let (later_iteration_median, later_iteration_most) = (at(|n| n / 2), at(|n| n.saturating_sub(1)));
        Self { total, iterations: sum, later_iteration_median, later_iteration_most }
    }
}

/// One step.
#[derive(Clone, Debug, Serialize)]
pub struct IterationFigures {
    /// "lloyd" or "lbfgs".
    pub kind: &'static str,
    /// Before the step, caller's units.
    pub energy: f64,
    /// Over the hexagonal tiling's.
    pub energy_ratio: f64,
    /// ‖∇E‖.
    pub gradient_norm: f64,
    /// Area covered by the pieces that this step saw, caller's units squared.
    pub area: f64,
    /// Passes.
    pub evaluations: usize,
    /// Wall-clock.
    pub ms: f64,
    /// Of which neighbour tables.
    pub neighbours_ms: f64,
    /// Nearest seeds of the facets.
    pub start_ms: f64,
    /// Clipping and summing.
    pub clip_ms: f64,
    /// Results, seeds moved.
    pub update_ms: f64,
    /// What a GPU was kept busy with.
    #[serde(flatten)]
    pub device: DeviceWork,
}

/// The seeds after the last step, before they are put on the surface.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct FinalFigures {
    /// Caller's units.
    pub energy: f64,
    /// Over the hexagonal tiling's.
    pub energy_ratio: f64,
    /// ‖∇E‖.
    pub gradient_norm: f64,
}

impl FinalFigures {
    /// Of the seeds that `present` was taken at.
    pub(crate) fn of(present: &Iteration) -> Self {
        let Iteration { energy, energy_ratio, gradient_norm, .. } = *present;
        Self { energy, energy_ratio, gradient_norm }
    }
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
    /// χ, components, holes, non-manifold elements.
    #[serde(flatten)]
    pub topology: Topology,
    /// Vertices that share no edge with another one and are in its place, to within 10⁻⁵ of the diagonal: parts that touch.
    /// Who joins vertices by their places joins the parts.
    pub coincident_vertices: usize,
    /// Shape and distance figures; absent if not measured.
    #[serde(flatten)]
    pub quality: Option<Quality>,
    /// What it lacks of the input; absent if not measured.
    pub lost: Option<LostParts>,
    /// What the repair had to do.
    pub repair: RepairFigures,
}

/// What the repair had to do.
#[derive(Clone, Copy, Debug, Default, Serialize, PartialEq, Eq)]
pub struct RepairFigures {
    /// Restricted cells with more than one connected component.
    pub split_cells: usize,
    /// Cell components that are not a disk. Where this and the next two are 0, the dual has
    /// the topology of the surface, if that is a manifold.
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
    /// Seeds that no vertex is of, and vertices beyond the first of their seed: the result has as many vertices as
    /// there are seeds, less the former, plus the latter.
    pub seeds_without_vertex: usize,
    /// See `seeds_without_vertex`.
    pub extra_vertices: usize,
}

impl InputFigures {
    /// Looks at the surface that came in.
    ///
    /// # Errors
    /// [`Stopped`].
    pub(crate) fn of(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::new(mesh);
        token.check()?;
        Self::with(mesh, &adjacency, token)
    }

    /// The same of a surface whose edges are known.
    ///
    /// # Errors
    /// [`Stopped`].
    pub(super) fn with(mesh: &TriMesh, adjacency: &Adjacency, token: &Token) -> Result<Self, Stopped> {
        let outlier_vertices = outliers::find(mesh).len();
        token.check()?;
        let (area, degenerate_facets) = (mesh.area(), mesh.degenerate_count());
        token.check()?;
        let oddities =
            if adjacency.non_manifold_edges() > 0 { duplicates::oddities(mesh) } else { Oddities::default() };
        token.check()?;
        Ok(Self {
            kind: oddities.kind(),
            enclosed_facets: oddities.enclosed,
            back_to_back_facets: oddities.back_to_back,
            vertices: mesh.positions().len(),
            facets: mesh.facets().len(),
            degenerate_facets,
            inconsistent_edges: adjacency.inconsistent_edges(),
            reoriented_facets: 0,
            stitched_vertices: 0,
            coincident_facets: 0,
            outlier_vertices,
            area,
            topology: topology_unless(mesh, adjacency, token)?,
        })
    }
}

impl RvdFigures {
    /// Adds what one pass had to do again.
    pub(crate) fn add_pass(&mut self, stats: &PassStats) {
        self.relaunched_pairs += stats.relaunched();
        self.relaunched_neighbours += stats.relaunched_neighbours;
        self.relaunched_polygon += stats.relaunched_polygon;
        self.relaunched_cells += stats.relaunched_cells;
        self.f64_finished_pairs += stats.f64_finished;
        self.duplicate_seeds = self.duplicate_seeds.max(stats.duplicate_seeds as usize);
    }

    /// Takes the last diagram's figures.
    pub(crate) fn of_dual(&mut self, dual: &Dual, surface: &Surface) {
        let scale = surface.frame().scale;
        self.area = dual.area / scale / scale;
        self.pairs = dual.stats.pairs;
        self.empty_cells = dual.empty_cells;
    }
}

impl IterationFigures {
    /// One step's figures.
    pub(crate) fn of(step: &Iteration) -> Self {
        Self {
            kind: step.kind.name(),
            energy: step.energy,
            energy_ratio: step.energy_ratio,
            gradient_norm: step.gradient_norm,
            area: step.area,
            evaluations: step.evaluations,
            ms: step.ms,
            neighbours_ms: step.stats.neighbours_ms,
            start_ms: step.stats.start_ms,
            clip_ms: step.stats.clip_ms,
            update_ms: step.stats.update_ms,
            device: step.stats.device_work(),
        }
    }
}
