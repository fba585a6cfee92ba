//! All sizes of a session, computed before anything is allocated.
//!
//! Purpose: numbers of facets, seeds and pairs in, bytes of every buffer out. The same [`Plan`] serves admission, allocation
//! and the error message. Invariant: pure. A plan that comes back fits the limits it was made for. Must not know: the device
//! itself, where facets and seeds are.

use std::ops::Range;

use super::layout::{
    DOTS, ENTRY_BYTES, Facet, LIFTED_SUM_WORDS, LIST, LIST_STATE_WORDS, LiftedFacet, LiftedSeed, LiftedSorted,
    OptimizerParams, PAIRS, Params, SUM_WORDS, Seed, Sorted, State, Totals,
};
use crate::GpuError;
use crate::dispatch::{ARGUMENTS_BYTES, Limits, PART, REDUCTION_GROUPS, STAGING_BYTES, fits, part_count};

/// Numbers of things that a session holds room for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// Whether the surface is lifted, so that records are longer.
    pub lifted: bool,
    /// Facets of all windows.
    pub facets: u64,
    /// Facets whose records are on the device at once.
    pub held: u64,
    /// Facets of the largest window.
    pub window: u64,
    pub windows: u64,
    pub seeds: u64,
    /// Entries of the neighbour table, longer rows included.
    pub table: u64,
    /// Slots of the sets of cells of one window's facets.
    pub slots: u64,
    /// Pairs in the list, which is one window's.
    pub pairs: u64,
    /// Pairs whose pieces one emit dispatch writes.
    pub emitted: u64,
    /// Polygon vertices per pair.
    pub polygon: u64,
    /// Entries of the grid of facets near each place.
    pub near: u64,
    /// Entries of the grid of seeds.
    pub cells: u64,
    /// Seeds with a Verlet list: all, or none where lists would be more than a shader can see.
    pub listed: u64,
}

/// Seeds that are moved on the device, at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Moved {
    pub lifted: bool,
    pub seeds: u64,
}

/// What a facet needs of the buffers that the facets of a window share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Need {
    pub slots: u64,
    pub pairs: f64,
}

/// Facets that the device sees at once. A diagram is a sum over its facets, so that windows are done one after another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    pub facets: Range<u32>,
    pub slots: u64,
    /// Pairs that are expected of them, rounded up.
    pub pairs: u64,
}

/// The longest windows of which every buffer can be seen whole: records and first cells of their facets, sets of
/// cells with a word more a facet, and `spare` pairs beside those that are expected; of at most `facets`. One facet at
/// least is in each; if that is too much, [`Plan::new`] says so.
pub(crate) fn windows(
    lifted: bool,
    needs: impl IntoIterator<Item = Need>,
    spare: u64,
    facets: u64,
    limits: Limits,
) -> Vec<Window> {
    let most = limits.seen_bytes();
    let records = (most / facet_bytes(lifted, 1)).min((most / 8).saturating_sub(EXTRA_CANDIDATES)).min(facets);
    let (slots, pairs) = (most / 4, (most / 8).saturating_sub(spare) as f64);
    let mut windows = Vec::new();
    let (mut first, mut end, mut have) = (0, 0, Need { slots: 0, pairs: 0.0 });
    let close = |facets: Range<u32>, have: Need| Window { facets, slots: have.slots, pairs: have.pairs.ceil() as u64 };
    for need in needs {
        let next = Need { slots: have.slots.saturating_add(need.slots), pairs: have.pairs + need.pairs };
        let count = u64::from(end - first) + 1;
        if count > 1 && (count > records || next.slots.saturating_add(count) > slots || next.pairs > pairs) {
            windows.push(close(first..end, have));
            (first, have) = (end, need);
        } else {
            have = next;
        }
        end += 1;
    }
    windows.push(close(first..end, have));
    windows
}

/// [`PART`]s that one dispatch of a stage may have, by what an item costs: on a software adapter with two cores 20 to 40 ms.
pub(crate) mod size {
    /// A facet that looks for its first cell without a guess.
    pub(crate) const FIRST_CELL: u64 = 1;
    /// A seed that looks for its neighbours, or for facets; a facet that is divided with room for many cells.
    pub(crate) const SEARCH: u64 = 2;
    /// A facet that is divided, or walks to its first cell.
    pub(crate) const FACET: u64 = 4;
    /// An item that is looked at and put somewhere.
    pub(crate) const ITEM: u64 = 32;
}

/// Pairs that one dispatch clips at most: tens of milliseconds on a software adapter, far below
/// every watchdog, and few enough workgroups for one dimension.
pub(crate) const BATCH: u32 = 1 << 18;
/// The same of pairs whose polygons are in memory instead of registers, ten times slower.
pub(crate) const LARGE_BATCH: usize = 1 << 14;
/// Candidates that the host can add to the facets' first cells at once.
pub(crate) const EXTRA_CANDIDATES: u64 = 4096;

fn bytes<T>(count: u64) -> u64 {
    count.saturating_mul(size_of::<T>() as u64)
}

fn facet_bytes(lifted: bool, count: u64) -> u64 {
    if lifted { bytes::<LiftedFacet>(count) } else { bytes::<Facet>(count) }
}

fn seed_bytes(lifted: bool, count: u64) -> u64 {
    if lifted { bytes::<LiftedSeed>(count) } else { bytes::<Seed>(count) }
}

/// Of a vector with the coordinates of all seeds.
fn vector_bytes(c: Moved) -> u64 {
    bytes::<f32>(c.seeds.saturating_mul(if c.lifted { 6 } else { 3 }))
}

fn sorted_bytes(lifted: bool, count: u64) -> u64 {
    if lifted { bytes::<LiftedSorted>(count) } else { bytes::<Sorted>(count) }
}

fn sum_bytes(lifted: bool, count: u64) -> u64 {
    if lifted { bytes::<[u32; LIFTED_SUM_WORDS]>(count) } else { bytes::<[u32; SUM_WORDS]>(count) }
}

/// The buffers of a session: what each is, its name, which is that of the shaders' bindings, its usage, and its bytes for `c`.
/// Those of windows and the readback are made apart.
macro_rules! session_buffers {
    ($with:ident $($own:ident: $type:ty),*) => {
        $with! {
            Plan {
                facets = facet_bytes(c.lifted, c.held),
                candidates = bytes::<[u32; 2]>(EXTRA_CANDIDATES.saturating_mul(c.windows).saturating_add(c.facets)),
                staging = sum_bytes(c.lifted, c.seeds)
                    .max(bytes::<[f32; 4]>(c.emitted.saturating_mul(c.polygon)))
                    .clamp(1 << 16, STAGING_BYTES),
            }
            Buffers(c: Counts) {
                seeds: STORAGE = seed_bytes(c.lifted, c.seeds),
                table: STORAGE = bytes::<u32>(c.table),
                slots: STORAGE = bytes::<u32>(c.slots),
                list: STORAGE = bytes::<[u32; 2]>(c.pairs),
                sums: STORAGE = sum_bytes(c.lifted, c.seeds),
                failures: STORAGE = bytes::<[u32; 2]>(c.pairs),
                state: STORAGE = bytes::<State>(1),
                arguments: ARGUMENTS = search_bytes(c.seeds).max(2 * ARGUMENTS_BYTES),
                params: UNIFORM = bytes::<Params>(1),
                heads: STORAGE = bytes::<[u32; 4]>(c.emitted),
                vertices: STORAGE = bytes::<[f32; 4]>(c.emitted.saturating_mul(c.polygon)),
                labels: STORAGE = bytes::<u32>(c.emitted.saturating_mul(c.polygon)),
                near: STORAGE = bytes::<u32>(c.near),
                cells: STORAGE = bytes::<u32>(c.cells),
                /// How far the seeds of each of its cells have moved.
                drifts: STORAGE = bytes::<u32>(if c.listed > 0 { c.cells } else { 1 }),
                /// Seeds in its order.
                sorted: STORAGE = sorted_bytes(c.lifted, c.seeds),
                /// Where the parts of a dispatch begin.
                origins: COPIED = bytes::<u32>(part_count(c.window.max(c.seeds))),
                /// Where seeds were when lists were made, and how far these reach.
                list_origins: STORAGE = bytes::<[f32; 4]>(c.listed.max(1)),
                lists: STORAGE = c.listed.max(1).saturating_mul(LIST_BYTES),
                /// State of the lists, and the arguments of the searches.
                list_state: ARGUMENTS = (4 * LIST_STATE_WORDS + 2 * search_bytes(c.seeds))
                    .saturating_add(bytes::<u32>(c.listed)),
            }
            [$($own: $type),*]
        }
    };
}
pub(super) use session_buffers;

/// The buffers with which seeds are moved where they are, for seeds that are moved. A session has them once it moves seeds.
macro_rules! optimizer_buffers {
    ($with:ident) => {
        $with! {
            OptimizerPlan {}
            OptimizerBuffers(c: Moved) {
                /// The present point.
                points: STORAGE = seed_bytes(c.lifted, c.seeds),
                held: STORAGE = bytes::<u32>(c.seeds),
                gradient: STORAGE = vector_bytes(c),
                /// The gradient at the trial point.
                ahead: STORAGE = vector_bytes(c),
                direction: STORAGE = vector_bytes(c),
                steps: STORAGE = vector_bytes(c).saturating_mul(PAIRS as u64),
                changes: STORAGE = vector_bytes(c).saturating_mul(PAIRS as u64),
                partial_totals: STORAGE = bytes::<Totals>(REDUCTION_GROUPS.into()),
                totals: STORAGE = bytes::<Totals>(1),
                partials: STORAGE = bytes::<[f32; DOTS]>(REDUCTION_GROUPS.into()),
                dots: STORAGE = bytes::<[f32; DOTS]>(1),
                params: UNIFORM = bytes::<OptimizerParams>(1),
                /// State and totals of each pass of a submission.
                journal: COPIED = PASSES as u64 * ENTRY_BYTES,
            }
            []
        }
    };
}
pub(super) use optimizer_buffers;

macro_rules! plan {
    (
        $plan:ident { $($(#[$apart_doc:meta])* $apart:ident = $apart_bytes:expr,)* }
        $buffers:ident($c:ident: $counts:ty) { $($(#[$doc:meta])* $name:ident: $usage:ident = $bytes:expr,)* }
        []
    ) => {
        /// Bytes of every buffer.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(crate) struct $plan {
            $($(#[$apart_doc])* pub $apart: u64,)*
            $($(#[$doc])* pub $name: u64,)*
        }

        impl $plan {
            pub(crate) fn of($c: $counts) -> Self {
                Self { $($apart: $apart_bytes,)* $($name: $bytes,)* }
            }

            /// Name and bytes of every buffer; those of all windows together.
            pub(crate) fn buffers(&self) -> Vec<(&'static str, u64)> {
                vec![$((stringify!($name), self.$name),)* $((stringify!($apart), self.$apart),)*]
            }

            /// What admission reserves.
            pub(crate) fn total_bytes(&self) -> u64 {
                self.buffers().iter().fold(0, |sum, (_, bytes)| sum.saturating_add(*bytes))
            }
        }
    };
}
session_buffers!(plan);
optimizer_buffers!(plan);

impl Plan {
    pub(crate) fn new(counts: Counts, limits: Limits) -> Result<Self, GpuError> {
        let plan = Self::of(counts);
        // Of the facets' buffers there is one a window.
        let (records, candidates) = window_bytes(counts.lifted, counts.window);
        fits(&[("facets", records), ("candidates", candidates)], limits)?;
        fits(&Self { facets: 0, candidates: 0, ..plan }.buffers(), limits)?;
        if counts.facets > MOST_FACETS {
            let [needed_bytes, limit_bytes] =
                [counts.facets, MOST_FACETS].map(|facets| facet_bytes(counts.lifted, facets));
            return Err(GpuError::NeverFits { what: "facets".to_owned(), needed_bytes, limit_bytes });
        }
        Ok(plan)
    }
}

impl OptimizerPlan {
    pub(crate) fn new(moved: Moved, limits: Limits) -> Result<Self, GpuError> {
        let plan = Self::of(moved);
        fits(&plan.buffers(), limits)?;
        Ok(plan)
    }
}

/// Facets that an entry of the list of failures can name. Seeds are fewer: their records are one binding.
const MOST_FACETS: u64 = 1 << 30;
pub(crate) const LIST_BYTES: u64 = 4 * LIST as u64;
/// Seeds that one dispatch of a search looks at.
pub const SEARCH_PART: u64 = 2 * PART;

/// Bytes of the arguments of all parts of a search for `seeds` seeds.
fn search_bytes(seeds: u64) -> u64 {
    ARGUMENTS_BYTES * seeds.min(u64::from(u32::MAX)).div_ceil(SEARCH_PART)
}

/// The byte of [`Plan::list_state`]'s buffer where the arguments of a search for `seeds` seeds begin, with lists or without.
pub(crate) fn search_arguments(seeds: u64, lists: bool) -> u64 {
    4 * LIST_STATE_WORDS + u64::from(lists) * search_bytes(seeds)
}

pub(crate) fn listed(seeds: u64, limits: Limits) -> u64 {
    if seeds.saturating_mul(LIST_BYTES) <= limits.seen_bytes() { seeds } else { 0 }
}

/// Bytes of the records and of the candidates of a window of `facets`.
pub(crate) fn window_bytes(lifted: bool, facets: u64) -> (u64, u64) {
    (facet_bytes(lifted, facets), bytes::<[u32; 2]>(facets.saturating_add(EXTRA_CANDIDATES)))
}

/// Passes of one submission at most.
pub(crate) const PASSES: usize = 32;

/// Cells along each side of the grid over the unit box in which `seeds` seeds on a surface of `area` are
/// searched: three spacings wide, not many more than there are seeds, and at most 160 a side.
pub(crate) fn grid_side(area: f64, seeds: u64) -> u32 {
    let n = seeds.max(1) as f64;
    let by_spacing = 1.0 / (CELL_SPACINGS * (area / n).sqrt());
    by_spacing.min(4.0 * n.cbrt()).clamp(1.0, 160.0) as u32
}

/// Width of a cell of that grid, in spacings.
const CELL_SPACINGS: f64 = 3.0;

pub(crate) fn grid_cells(side: u32) -> u64 {
    let side = u64::from(side);
    side * side * (side + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits { buffer_bytes: 256 << 20, binding_bytes: 128 << 20, workgroups: 65_535 };

    fn counts(n: u64) -> Counts {
        Counts {
            lifted: false,
            facets: n,
            held: n,
            window: n,
            windows: 1,
            seeds: n,
            table: 31 * n,
            slots: 16 * n,
            pairs: 5 * n,
            emitted: 65_536,
            polygon: 10,
            near: 9,
            cells: grid_cells(grid_side(2.0, n)),
            listed: listed(n, LIMITS),
        }
    }

    #[test]
    fn a_million_facets_and_seeds_fit_128_mib_bindings() {
        let plan = Plan::new(counts(1_000_000), LIMITS).unwrap();
        assert_eq!(plan.facets, 96_000_000);
        assert_eq!(plan.total_bytes(), plan.buffers().iter().map(|b| b.1).sum::<u64>());
    }

    #[test]
    fn refusal_names_buffer_and_bytes() {
        let error = Plan::new(counts(2_000_000), LIMITS).unwrap_err();
        let GpuError::NeverFits { what, needed_bytes, limit_bytes } = error else { panic!("{error}") };
        assert_eq!((what.as_str(), needed_bytes, limit_bytes), ("facets", 192_000_000, 128 << 20));
    }

    #[test]
    fn facets_that_no_failure_could_name_are_refused() {
        let many = |facets| Counts { facets, window: 1000, ..counts(1000) };
        assert!(Plan::new(many(1 << 30), LIMITS).is_ok());
        assert!(matches!(Plan::new(many((1 << 30) + 1), LIMITS), Err(GpuError::NeverFits { .. })));
    }

    #[test]
    fn windows_are_as_long_as_fits_and_leave_nothing_out() {
        let needs = |n: u64, slots: u64, pairs: f64| (0..n).map(move |_| Need { slots, pairs });
        let one = windows(false, needs(1_000_000, 16, 3.0), 1024, u64::MAX, LIMITS);
        assert_eq!(one, [Window { facets: 0..1_000_000, slots: 16_000_000, pairs: 3_000_000 }]);
        assert_eq!(windows(false, needs(0, 0, 0.0), 1024, u64::MAX, LIMITS).len(), 1);
        // By records, by slots, by pairs.
        for (slots, pairs, most) in [(16, 3.0, 1_398_101), (64, 3.0, 516_222), (16, 100.0, 167_761)] {
            let many = windows(false, needs(5_000_000, slots, pairs), 1024, u64::MAX, LIMITS);
            assert_eq!(many[0].facets, 0..most);
            assert!(many.windows(2).all(|w| w[0].facets.end == w[1].facets.start));
            assert_eq!(many.last().unwrap().facets.end, 5_000_000);
            let (records, candidates) = window_bytes(false, most.into());
            let most = u64::from(most);
            let all = [records, candidates, 4 * (slots + 1) * most, 8 * (pairs as u64 * most + 1024)];
            assert!(all.iter().all(|bytes| *bytes <= 128 << 20), "{all:?}");
        }
        // What fits nowhere is alone, and refused by the plan.
        let huge = windows(
            false,
            [needs(3, 16, 1.0), needs(1, 1 << 30, 1.0), needs(3, 16, 1.0)].into_iter().flatten(),
            0,
            u64::MAX,
            LIMITS,
        );
        assert_eq!(huge.iter().map(|w| w.facets.clone()).collect::<Vec<_>>(), [0..3, 3..4, 4..7]);
    }

    #[test]
    fn absurd_counts_do_not_overflow() {
        assert!(Plan::new(counts(u64::MAX / 32), LIMITS).is_err());
    }

    #[test]
    fn a_million_seeds_can_be_moved_within_128_mib_bindings() {
        let plan = OptimizerPlan::new(Moved { lifted: false, seeds: 1_000_000 }, LIMITS).unwrap();
        assert_eq!(plan.steps, 96_000_000);
        assert!(OptimizerPlan::new(Moved { lifted: true, seeds: u64::MAX / 8 }, LIMITS).is_err());
    }

    #[test]
    fn a_batch_of_pairs_fits_one_dimension() {
        assert!(BATCH.div_ceil(crate::device::WORKGROUP) <= LIMITS.workgroups);
    }

    #[test]
    fn grids_follow_the_spacing_within_bounds() {
        assert_eq!(grid_side(2.0, 10_000), 23);
        assert_eq!(grid_side(2.0, 1), 1);
        assert_eq!(grid_side(1e-9, 8), 8);
        assert_eq!(grid_side(2.0, 100_000_000), 160);
        // More seeds need no smaller grid, so that room for the most is room for all.
        let sides: Vec<u32> = (0..24).map(|k| grid_side(2.0, 1 << k)).collect();
        assert!(sides.is_sorted());
    }
}
