//! What a job will need, from numbers that are known before it runs.
//!
//! Purpose: [`need`] says how much memory and time a job takes, for admission and for fair queueing. Host bytes are fitted
//! to measured runs (`tests/calibration.rs`; docs/performance.md has the figures). Device bytes are those of the plan that allocates.
//! Invariant: pure, without clock or files. Monotone in every count, but for time in the first steps of a remesh; nothing
//! overflows.
//! Must not know: queues, records of jobs, how counts were found.

use crate::observe::activity::Origin;
pub use crate::record::Kind;
use crate::record::{Bytes, JobId};
use geometry::cvt::density::Expected;
use geometry::remesh::{Anisotropy, Placement, RemeshOptions};
use geometry::rvd::BackendKind;
use gpu::SessionForecast;
use wire::options::{Diagram, Session, source};
pub use wire::proto::DensitySource;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counts {
    pub kind: Kind,
    pub backend: BackendKind,
    pub vertices: u64,
    pub facets: u64,
    /// Seeds, the most that refinement may add included.
    pub points: u64,
    /// Lloyd and quasi-Newton steps together.
    pub steps: u64,
    /// Bytes of the file or the arrays that the surface comes as.
    pub input_bytes: u64,
    pub density: DensitySource,
    pub placement: Placement,
    pub anisotropy: Anisotropy,
    /// Numbers of all attributes that a remesh carries over, three for a normal.
    pub attributes: u64,
    /// Bytes of lists beside the surface (sizes, weights, creases): as they come, and as they are held.
    pub list_bytes: u64,
    /// Whether points are added until a tolerance is met.
    pub refines: bool,
    pub measures: bool,
    pub cells: bool,
    /// Sets of seeds that the result of a session has.
    pub sets: u64,
    /// See [`Expected`]; nothing unusual until the surface was looked at.
    pub extra_pairs: u64,
    pub is_crowded: bool,
}

impl Counts {
    /// With the options that a remesh has if nothing is said: 5 and 30 steps, fitted, measured, even edges.
    pub fn new(kind: Kind, backend: BackendKind, vertices: u64, facets: u64, points: u64) -> Self {
        Self {
            kind,
            backend,
            vertices,
            facets,
            points,
            steps: 35,
            // A binary file in single precision, unless the caller knows better.
            input_bytes: vertices.saturating_mul(12).saturating_add(facets.saturating_mul(13)),
            density: DensitySource::Uniform,
            placement: Placement::Fitted,
            anisotropy: Anisotropy::None,
            attributes: 0,
            list_bytes: 0,
            refines: false,
            measures: true,
            cells: false,
            sets: 0,
            extra_pairs: 0,
            is_crowded: false,
        }
    }

    /// With what the surface made one expect.
    #[must_use]
    pub fn of_surface(self, expected: &Expected) -> Self {
        Self { extra_pairs: expected.extra_pairs, is_crowded: expected.is_crowded, ..self }
    }

    /// With the options of a remesh; `points` are those at first.
    #[must_use]
    pub fn of_remesh(self, options: &RemeshOptions) -> Self {
        let most =
            |most: Option<usize>| most.map_or(self.points.saturating_mul(2), |most| most as u64).max(self.points);
        Self {
            points: options.refine.map_or(self.points, |refine| most(refine.max_points)),
            steps: options.lloyd as u64 + options.newton as u64,
            density: source(&options.density),
            placement: options.placement,
            anisotropy: options.anisotropy,
            refines: options.refine.is_some(),
            measures: options.measure,
            ..self
        }
    }

    #[must_use]
    pub fn of_diagram(self, diagram: &Diagram) -> Self {
        Self { steps: 0, density: source(&diagram.density), ..self }
    }

    /// With the options of a session; `points` are those at first.
    #[must_use]
    pub fn of_session(self, session: &Session) -> Self {
        Self { points: self.points.max(session.options.max_seeds as u64), density: source(&session.density), ..self }
    }

    /// How a job with these counts is counted.
    pub fn origin(&self, job: Option<JobId>) -> Origin {
        let &Self { kind, backend, facets, points, .. } = self;
        Origin { kind, backend, job, facets, seeds: points }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Need {
    /// Growth of the process's memory over that of an idle one, at most, and buffers on the device.
    pub memory: Bytes,
    /// Time that it takes on a CPU, most often within a factor of two. A job on a GPU is taken to be as long.
    pub seconds: f64,
}

pub fn need(counts: &Counts, threads: usize) -> Need {
    let counts = Counts { facets: divided(counts), ..*counts };
    Need {
        memory: Bytes { host: host_bytes(&counts, threads), device: device_bytes(&counts) },
        seconds: seconds(&counts, threads),
    }
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
    let graded = counts.density != DensitySource::Uniform;
    let lifted = counts.kind == Kind::Remesh && counts.anisotropy != Anisotropy::None;
    let moved = counts.kind != Kind::Rvd && counts.steps > 0;
    SessionForecast { facets: counts.facets, seeds: counts.points, graded, moved, lifted }.device_bytes()
}

const MIB: u64 = 1 << 20;

/// Bytes of facets and points, from the bytes of one of each.
fn each(counts: &Counts, facet: u64, point: u64) -> u64 {
    counts.facets.saturating_mul(facet).saturating_add(counts.points.saturating_mul(point))
}

/// The sum of nine: what every job of its kind takes; what grows with its counts, at the stage that takes most; what the
/// allocator keeps of memory that was freed, as much again where there is little; attributes; lengths and lists; pairs of needles, fans and
/// soups; results beside the surface; and readback from a device.
fn host_bytes(counts: &Counts, threads: usize) -> u64 {
    let (least, work) = match counts.kind {
        Kind::Remesh => {
            let fitted = counts.placement == Placement::Fitted;
            let (facet, point) = (530, if fitted { 4000 } else { 3100 });
            // The lifted surface and its session.
            let lifted = counts.anisotropy != Anisotropy::None;
            let (facet, point) = if lifted { (facet + 320, point * 8 / 5) } else { (facet, point) };
            // The best result is kept beside the next one.
            let (facet, point) = if counts.refines { (facet * 3 / 2, point * 7 / 4) } else { (facet, point) };
            (28 * MIB, each(counts, facet, point))
        }
        // The surface while it is prepared, or the diagram.
        Kind::Rvd => {
            let batches = if counts.cells { 24 * MIB } else { 0 };
            (3 * MIB + batches, each(counts, 165, 0).max(each(counts, 60, 500)))
        }
        Kind::Cvt => (6 * MIB, each(counts, CVT_BYTES.0, CVT_BYTES.1)),
    };
    let mesh = counts.vertices.saturating_mul(24).saturating_add(counts.facets.saturating_mul(12));
    let read = counts.input_bytes.saturating_add(mesh.saturating_mul(2));
    let grows = work.max(read);
    let kept = grows.min((threads as u64).saturating_mul(7 * MIB).saturating_add(18 * MIB));
    let carried = counts.attributes.saturating_mul(16);
    // Lengths of vertices, as they are found and bounded.
    let lengths = match counts.density {
        DensitySource::Curvature | DensitySource::Lfs | DensitySource::Error | DensitySource::ErrorMax => {
            counts.vertices.saturating_mul(32)
        }
        // Logarithms of tensors, and their surface with its tree.
        DensitySource::Metric => counts.vertices.saturating_mul(100).saturating_add(counts.facets.saturating_mul(100)),
        _ => 0,
    };
    let (pair, cells) = match counts.kind {
        Kind::Remesh => (PAIR_BYTES, 0),
        Kind::Rvd if counts.cells => (CELL_BYTES, usual_pairs(counts).saturating_mul(CELL_BYTES)),
        Kind::Rvd | Kind::Cvt => (0, 0),
    };
    let pairs = counts.extra_pairs.saturating_mul(pair);
    let sets = counts.sets.saturating_mul(counts.points).saturating_mul(24);
    let results = [cells, sets, counts.steps.saturating_mul(STEP_BYTES)].into_iter().fold(0, u64::saturating_add);
    let readback = if counts.backend == BackendKind::Gpu { 32 * MIB } else { 0 };
    let all = [least, grows, kept, carried, lengths, counts.list_bytes, pairs, results, readback];
    all.into_iter().fold(0, u64::saturating_add)
}

/// Bytes of a pair while the dual is read. Of 1.8 million pairs of needles.
const PAIR_BYTES: u64 = 650;
/// Bytes of a cell's polygon in a facet, while its file is put together.
const CELL_BYTES: u64 = 300;
/// Bytes of a step in the report, its text included.
const STEP_BYTES: u64 = 4096;

/// Pairs of a facet and a cell that meet, on a surface of well-shaped facets.
fn usual_pairs(counts: &Counts) -> u64 {
    let (facets, points) = (counts.facets as f64, counts.points as f64);
    (facets + 3.25 * (facets * points).sqrt() + 2.4 * points) as u64
}

/// Bytes of a session for each facet and each seed.
const CVT_BYTES: (u64, u64) = (180, 650);

/// Steps after which points are as even as they become. Of 0 to 100 steps with 3000 and 10,000 points.
const EVEN_STEPS: f64 = 35.0;

/// How much of their unevenness points keep after so many steps, from 1 to 0.
fn uneven(steps: f64) -> f64 {
    let left = |steps: f64| (-steps / 6.5).exp();
    (left(steps) - left(EVEN_STEPS)).max(0.0)
}

/// By two threads of the machine in docs/performance.md, each microsecond; more threads take less.
fn seconds(counts: &Counts, threads: usize) -> f64 {
    let (facets, points, steps) = (counts.facets as f64, counts.points as f64, counts.steps as f64);
    let threads = if counts.backend == BackendKind::Serial { 1.0 } else { threads.max(1) as f64 };
    let density = match counts.density {
        DensitySource::Unspecified | DensitySource::Uniform | DensitySource::Weights => 0.0,
        DensitySource::EdgeLengths => 0.5,
        // Rounds of local changes take about as long as the fit, for each point.
        DensitySource::Metric => 2.0,
        DensitySource::Curvature | DensitySource::Error | DensitySource::ErrorMax => 1.4,
        DensitySource::Lfs => 5.4,
    } * facets;
    // Where sheets are near one another, a cell has several times the neighbours, and lists for them are long.
    let pair = if counts.is_crowded { 20.0 } else { 0.5 };
    let pairs = counts.extra_pairs as f64 * pair;
    let step = (0.025 * facets + 0.24 * points + pairs) * lifted_share(counts.anisotropy);
    let fit = if counts.placement == Placement::Fitted { 2.7 * facets + 4.5 * points } else { 0.0 };
    let measure = if counts.measures { 0.07e6 + 0.2 * facets + 1.5 * points } else { 0.0 };
    let cells = if counts.cells { 1.5 * (facets + points) } else { 0.0 };
    // Points that few steps have moved leave slender facets to the repair, which looks at the input around each.
    let repair = uneven(steps) * (160.0 * points + 110.0 * (facets * points).sqrt());
    // Each set of seeds becomes a blob of its own.
    let sets = 1e3 * counts.sets as f64;
    // Rounds where cells fail prepare and read the dual again.
    let rounds = if counts.anisotropy == Anisotropy::None { 1.0 } else { 2.0 };
    let (steps, other) = match counts.kind {
        // The dual and what comes after it look at a pair about ten times.
        Kind::Remesh => {
            (steps * step, rounds * (density + 1.2 * facets + 7.5 * points) + fit + measure + 10.0 * pairs + repair)
        }
        Kind::Rvd => (4.0 * step, density + 0.4 * facets + 0.5 * points + cells),
        Kind::Cvt => (steps * step, density + 0.7 * facets + points + sets),
    };
    let attempts = if counts.refines { 6.0 } else { 1.0 };
    // Steps are shared by all threads, the rest by some.
    0.02 + 1e-6 * attempts * (steps * 2.0 / threads + other * (0.6 + 0.8 / threads))
}

/// How much longer steps take on a lifted surface: the longer the lift, the more cells are near one another in space. With the
/// curvature's own lift a few rounds follow where cells fail.
fn lifted_share(anisotropy: Anisotropy) -> f64 {
    match anisotropy {
        Anisotropy::None => 1.0,
        Anisotropy::Auto => 2.5,
        Anisotropy::Share(share) => 2.0 + 9.0 * share.min(1.0),
    }
}

#[cfg(test)]
mod tests;
