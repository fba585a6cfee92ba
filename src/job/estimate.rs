//! What a job will need, from numbers that are known before it runs.
//!
//! Purpose: [`need`] says how much memory and time a job takes, for admission and for fair queueing. Host bytes are fitted
//! to measured runs (`calibration`; docs/speed.md has the figures). Device bytes are those of the plan that allocates.
//! Invariant: pure, without clock or files. Monotone in every count, and nothing overflows.
//! Must not know: queues, records of jobs, how counts were found.

use super::record::{DensityKind, PlacementRule};
use crate::rvd::{BackendKind, SessionForecast};

/// The kind of a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// A whole remesh.
    Remesh,
    /// A diagram.
    Rvd,
    /// A session.
    Cvt,
}

/// What is known of a job before it runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Counts {
    /// What is done.
    pub(crate) kind: Kind,
    /// Who does it.
    pub(crate) backend: BackendKind,
    /// Vertices of the surface.
    pub(crate) vertices: u64,
    /// Facets of the surface.
    pub(crate) facets: u64,
    /// Seeds, the most that refinement may add included.
    pub(crate) points: u64,
    /// Lloyd and quasi-Newton steps together.
    pub(crate) steps: u64,
    /// Bytes of the file or the arrays that the surface comes as.
    pub(crate) input_bytes: u64,
    /// Where the density comes from.
    pub(crate) density: DensityKind,
    /// Where a remesh puts its vertices.
    pub(crate) placement: PlacementRule,
    /// Numbers of all attributes that a remesh carries over, three for a normal.
    pub(crate) attributes: u64,
    /// Whether points are added until a tolerance is met.
    pub(crate) refines: bool,
    /// Whether a remesh is measured.
    pub(crate) measures: bool,
    /// Whether a diagram's pieces are written.
    pub(crate) cells: bool,
}

impl Counts {
    /// With the options that a remesh has if nothing is said: 5 and 30 steps, fitted, measured, even edges.
    pub(crate) fn new(kind: Kind, backend: BackendKind, vertices: u64, facets: u64, points: u64) -> Self {
        Self {
            kind,
            backend,
            vertices,
            facets,
            points,
            steps: 35,
            // A binary file in single precision; who knows better says so.
            input_bytes: vertices.saturating_mul(12).saturating_add(facets.saturating_mul(13)),
            density: DensityKind::Uniform,
            placement: PlacementRule::Fitted,
            attributes: 0,
            refines: false,
            measures: true,
            cells: false,
        }
    }
}

/// What a job needs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Need {
    /// Growth of the process's memory over that of an idle one, at most.
    pub(crate) host_bytes: u64,
    /// Buffers on the device; 0 on a CPU.
    pub(crate) device_bytes: u64,
    /// Time that it takes, within a factor of two, on a CPU.
    pub(crate) seconds: f64,
}

/// What a job needs, with so many threads.
pub(crate) fn need(counts: &Counts, threads: usize) -> Need {
    let counts = Counts { facets: divided(counts), ..*counts };
    Need { host_bytes: host_bytes(&counts), device_bytes: device_bytes(&counts), seconds: seconds(&counts, threads) }
}

/// Facets after long ones were divided, so that none is much larger than a cell.
fn divided(counts: &Counts) -> u64 {
    match counts.kind {
        Kind::Rvd => counts.facets,
        Kind::Remesh | Kind::Cvt => counts.facets.max(counts.points / 2),
    }
}

/// Bytes of the plan of the job's session.
fn device_bytes(counts: &Counts) -> u64 {
    if counts.backend != BackendKind::Gpu {
        return 0;
    }
    let graded = counts.density != DensityKind::Uniform;
    let moved = counts.kind != Kind::Rvd && counts.steps > 0;
    SessionForecast { facets: counts.facets, seeds: counts.points, graded, moved }.device_bytes()
}

/// Bytes that everything of one kind takes.
fn each(count: u64, bytes: u64) -> u64 {
    count.saturating_mul(bytes)
}

const MIB: u64 = 1 << 20;

fn host_bytes(counts: &Counts) -> u64 {
    let &Counts { facets, points, .. } = counts;
    let (least, sized) = match counts.kind {
        Kind::Remesh => {
            let fit = if counts.placement == PlacementRule::Fitted { 3500 } else { 2600 };
            (28 * MIB, each(facets, 470).saturating_add(each(points, fit)))
        }
        Kind::Rvd => (4 * MIB, each(facets, 165).saturating_add(each(points, 400))),
        Kind::Cvt => (4 * MIB, each(facets, 300).saturating_add(each(points, 800))),
    };
    let on_device = match counts.backend {
        BackendKind::Gpu => each(facets, 160).saturating_add(each(points, 250)),
        BackendKind::Parallel | BackendKind::Serial => 0,
    };
    let carried = each(counts.attributes, 16);
    // The file is given back once it is read.
    let mesh = each(counts.vertices, 24).saturating_add(each(facets, 12));
    let sized = sized.max(counts.input_bytes.saturating_add(each(mesh, 2)));
    // The allocator keeps some of what was freed, as much again where there is little.
    let kept = sized.min(32 * MIB);
    [least, kept, sized, on_device, carried].into_iter().fold(0, u64::saturating_add)
}

fn seconds(counts: &Counts, threads: usize) -> f64 {
    let (facets, points, steps) = (counts.facets as f64, counts.points as f64, counts.steps as f64);
    let fitted = counts.placement == PlacementRule::Fitted;
    // Microseconds of one thread.
    let step = 0.04 * facets + 0.45 * points;
    let surface = match counts.density {
        DensityKind::Uniform | DensityKind::Weights => 1.0,
        DensityKind::EdgeLengths => 2.0,
        DensityKind::Curvature => 3.0,
        DensityKind::FeatureSize => 7.0,
    } * facets;
    let finish = 1.2 * facets + if fitted { 18.0 } else { 8.0 } * points;
    let measure = if counts.measures { 1e5 + 0.4 * facets + 2.0 * points } else { 0.0 };
    let work = match counts.kind {
        Kind::Remesh => surface + 1.3 * steps * step + finish + measure,
        Kind::Rvd => surface + 2.0 * step,
        Kind::Cvt => surface + 1.3 * steps * step,
    };
    let attempts = if counts.refines { 3.0 } else { 1.0 };
    let share = if counts.backend == BackendKind::Serial { 1.0 } else { 0.2 + 0.8 / threads.max(1) as f64 };
    0.05 + 1e-6 * attempts * share * work
}
