//! Options of a session.
//!
//! Purpose: [`SessionOptions`]: the most seeds, first capacities, and choices that exist to be measured.
//! Invariant: none of them changes the diagram. Must not know: backends.

/// Capacities with which a pass starts. They grow where a pair needs more, so they tune speed
/// and memory and never the diagram (sums in floating point may add up in another order).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Capacities {
    /// Neighbours per seed in the first table (\[HYWZ17\] uses 20).
    pub neighbours: usize,
    /// Polygon vertices per pair, at least 4.
    pub polygon: usize,
    /// Cells per facet, at least 1.
    pub cells: usize,
    /// Pairs in one pass, as a multiple of the expected number, at least 0.01.
    pub pairs_percent: usize,
}

impl Capacities {
    /// The defaults.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_neighbours(neighbours: usize),
        with_polygon(polygon: usize),
        with_cells(cells: usize),
        with_pairs_percent(pairs_percent: usize),
    }
}

impl Default for Capacities {
    fn default() -> Self {
        Self { neighbours: 24, polygon: 10, cells: 16, pairs_percent: 100 }
    }
}

/// How the GPU backend finds the pairs of a facet (\[HYWZ17\]). The diagram is the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// From the facet's first cell across bisectors. The default: on a software adapter looking by
    /// cell costs more than the rounds it saves, unless a facet meets thousands of cells.
    #[default]
    Facet,
    /// Each cell looks for the facets that it reaches.
    Cell,
    /// The publication's rule: by cell for the facets that are expected to meet more than
    /// [`CELLS_PER_FACET`] cells.
    Auto,
}

/// Where \[HYWZ17\] turns from facets to cells.
pub const CELLS_PER_FACET: f64 = 20.0;

/// How the GPU backend adds pieces to their cells' sums (\[HYWZ17\]). The sums are the same.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Accumulate {
    /// Atomics to global memory.
    Direct,
    /// Partial sums within a workgroup, merged in a second phase.
    TwoPhase,
    /// What measured better: direct. On a software adapter adding takes 5 to 10 % of the clip phase
    /// directly and 20 to 39 % in two phases (the publication: 10 % and 20 %).
    #[default]
    Auto,
}

/// Choices that exist to be measured. They change the time of a pass on a GPU, never a bit of its
/// result; the CPU backends walk facet by facet and add in a fixed order whatever is chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tuning {
    /// How pairs are found.
    pub strategy: Strategy,
    /// How sums are added.
    pub accumulate: Accumulate,
    /// How many Lloyd steps a submission may have.
    pub together: Together,
}

impl Tuning {
    /// The defaults.
    pub fn new() -> Self {
        Self::default()
    }

    setters! {
        with_strategy(strategy: Strategy),
        with_accumulate(accumulate: Accumulate),
        with_together(together: Together),
    }
}

/// How many Lloyd steps [`Resident::relax`](super::Resident::relax) hands to a GPU at once, where nothing has to be done again in between.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Together {
    /// Twice as many each time, as long as they end within a tenth of a second.
    #[default]
    ByTime,
    /// Twice as many each time up to this, however long they take.
    AtMost(usize),
}

/// What a session needs to know before it allocates.
#[derive(Clone, Copy, Debug)]
pub struct SessionOptions {
    /// The most seeds that will ever be set; seeds may be added up to it without a new plan.
    pub max_seeds: usize,
    /// First capacities.
    pub capacities: Capacities,
    /// How the work is done.
    pub tuning: Tuning,
    /// Whether [`Session::pieces`](super::Session::pieces) has pieces of facets without area, which the dual needs to go
    /// across them. f64 sessions only; sums never have them.
    pub flat_pieces: bool,
}

impl SessionOptions {
    /// Default capacities for at most `max_seeds` seeds.
    pub fn new(max_seeds: usize) -> Self {
        Self { max_seeds, capacities: Capacities::default(), tuning: Tuning::default(), flat_pieces: false }
    }

    setters! {
        with_capacities(capacities: Capacities),
        with_tuning(tuning: Tuning),
        with_flat_pieces(flat_pieces: bool),
    }
}
