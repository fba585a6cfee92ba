//! The records of `shaders/shared/` in Rust.
//!
//! Purpose: what the host writes and reads, byte for byte. Invariant: same fields, names, offsets and sizes as in WGSL;
//! `tests/gpu/shaders.rs` compares each of them with what naga reflects. Must not know: where the numbers come from.

use bytemuck::{Pod, Zeroable};

/// Highest bit of [`Seed::row_length`]: no other neighbour can matter.
pub const COMPLETE: u32 = 1 << 31;
/// Highest bit of a pair's second word: the first cell of its facet.
pub const ROOT: u32 = 1 << 31;
/// Highest bit of [`Facet::slot_mask`]: cells look for this facet themselves.
pub const BY_CELL: u32 = 1 << 31;
/// The other 31 bits.
pub const INDEX: u32 = ROOT - 1;
/// Words of sums per seed in R³: mass, moment x y z, energy, area; two limbs each.
pub const SUM_WORDS: usize = 12;
/// The same where the moment has six coordinates.
pub const LIFTED_SUM_WORDS: usize = 18;

/// Codes in the list of failures, as in WGSL. [`failure`] unpacks them.
pub mod code {
    /// The facet's set of cells is full.
    pub const CELLS: u32 = 0;
    /// The row of neighbours ended.
    pub const NEIGHBOURS: u32 = 1;
    /// The polygon needed more slots.
    pub const POLYGON: u32 = 2;
    /// To be finished in double precision.
    pub const FINISH: u32 = 3;
}

/// How sums reach global memory, as in WGSL.
pub mod accumulate {
    /// Atomics, a piece at a time.
    pub const DIRECT: u32 = 0;
    /// Partial sums of a workgroup first.
    pub const TWO_PHASE: u32 = 1;
    /// Not at all, to measure what it costs.
    pub const NOWHERE: u32 = 2;
}

/// An entry of the list of failures: (facet, seed, code). `None` if the device has put the pair to the end of its list again.
pub fn failure(entry: [u32; 2]) -> Option<(u32, u32, u32)> {
    // The next bit says in the first word that it was, and in the second that the pair is the first of its facet.
    let code = (entry[0] >> 31) | ((entry[1] >> 31) << 1);
    let [facet, seed] = entry.map(|word| word & (INDEX >> 1));
    (entry[0] & (1 << 30) == 0).then_some((facet, seed, code))
}

/// A seed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Seed {
    /// Upper part of the position.
    pub hi: [f32; 3],
    /// First entry of its row in the table.
    pub row_begin: u32,
    /// Position less upper part.
    pub lo: [f32; 3],
    /// Entries of its row, and [`COMPLETE`].
    pub row_length: u32,
}

/// A seed of a lifted surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LiftedSeed {
    /// Upper part of the place.
    pub hi: [f32; 3],
    /// As [`Seed::row_begin`].
    pub row_begin: u32,
    /// Place less upper part.
    pub lo: [f32; 3],
    /// As [`Seed::row_length`].
    pub row_length: u32,
    /// Upper part of the lift.
    pub lift_hi: [f32; 3],
    /// Zero.
    pub after_hi: u32,
    /// Lift less upper part.
    pub lift_lo: [f32; 3],
    /// Zero.
    pub after_lo: u32,
}

/// A facet: first corner, frame, other corners in it, weight, slots.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Facet {
    /// Upper part of the first corner.
    pub hi: [f32; 3],
    /// First slot of its set of cells.
    pub slot_begin: u32,
    /// First corner less upper part.
    pub lo: [f32; 3],
    /// Slots less one; a power of two less one. And [`BY_CELL`].
    pub slot_mask: u32,
    /// Unit vector along the first edge.
    pub e1: [f32; 3],
    /// Second corner less the first, along e1. Its other coordinate is 0.
    pub corner1_u: f32,
    /// Unit vector in the plane, to the left of e1.
    pub e2: [f32; 3],
    /// Third corner less the first, along e1.
    pub corner2_u: f32,
    /// Unit normal.
    pub n: [f32; 3],
    /// Third corner less the first, along e2.
    pub corner2_v: f32,
    /// Weight at the first corner.
    pub weight: f32,
    /// Its slope along e1.
    pub weight_u: f32,
    /// Its slope along e2.
    pub weight_v: f32,
    /// Largest weight of the three corners.
    pub weight_top: f32,
}

/// A facet of a lifted surface. Its plane has no normal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LiftedFacet {
    /// Upper part of the first corner's place.
    pub hi: [f32; 3],
    /// As [`Facet::slot_begin`].
    pub slot_begin: u32,
    /// The place less upper part.
    pub lo: [f32; 3],
    /// As [`Facet::slot_mask`].
    pub slot_mask: u32,
    /// Unit vector along the first edge: its place.
    pub e1: [f32; 3],
    /// As [`Facet::corner1_u`].
    pub corner1_u: f32,
    /// Unit vector in the plane, across e1: its place.
    pub e2: [f32; 3],
    /// As [`Facet::corner2_u`].
    pub corner2_u: f32,
    /// Upper part of the first corner's lift.
    pub lift_hi: [f32; 3],
    /// As [`Facet::corner2_v`].
    pub corner2_v: f32,
    /// Weight at the first corner.
    pub weight: f32,
    /// Its slope along e1.
    pub weight_u: f32,
    /// Its slope along e2.
    pub weight_v: f32,
    /// Largest weight of the three corners.
    pub weight_top: f32,
    /// The lift less upper part.
    pub lift_lo: [f32; 3],
    /// Zero.
    pub after_lo: u32,
    /// The lift of e1.
    pub lift_e1: [f32; 3],
    /// Zero.
    pub after_e1: u32,
    /// The lift of e2.
    pub lift_e2: [f32; 3],
    /// Zero.
    pub after_e2: u32,
}

/// Parameters of a dispatch. A uniform.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Params {
    /// Units per unit of mass. All four are powers of two.
    pub mass_scale: f32,
    /// Units per unit of first moment.
    pub moment_scale: f32,
    /// Units per unit of energy.
    pub energy_scale: f32,
    /// Units per unit of area.
    pub area_scale: f32,
    /// 1 if all weights are 1; then mass is area.
    pub uniform_weights: u32,
    /// Entries that the list of pairs holds.
    pub list_capacity: u32,
    /// Pairs per clip dispatch at most.
    pub batch: u32,
    /// First candidate to enter.
    pub enqueue_begin: u32,
    /// How many.
    pub enqueue_count: u32,
    /// [`ROOT`] for first cells of facets, 0 for others.
    pub enqueue_root: u32,
    /// First pair to emit.
    pub emit_begin: u32,
    /// How many; also the pairs that `verify` looks at and the seeds of `reach`.
    pub emit_count: u32,
    /// Vertices that a polygon in registers may have; at most its slots.
    pub polygon: u32,
    /// How sums reach global memory, see [`accumulate`].
    pub accumulate: u32,
    /// Grid cells along each side of the unit box.
    pub grid: u32,
    /// Zero, which the compiler of the shader cannot know.
    pub zero: u32,
    /// Seeds.
    pub seeds: u32,
    /// Entries of a row of the table as the search writes it, at most [`ROW`].
    pub row: u32,
    /// Cells along each side of the grid of seeds.
    pub side: u32,
    /// Facets that have a first cell: entries of the candidates.
    pub roots: u32,
    /// Where among the slots it says which facets `divide` has done; [`NONE`] if it need not.
    pub divided: u32,
    /// The facet whose record comes first in the present window.
    pub facet_first: u32,
    /// The item that the present part of a dispatch begins at.
    pub part_first: u32,
    /// 1 if there is room for Verlet lists.
    pub has_lists: u32,
    /// The longest lift of the surface, or more by a rounding.
    pub longest_lift: f32,
}

/// What the host reads between submissions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct State {
    /// First pair that no dispatch has taken.
    pub head: u32,
    /// First pair of the last dispatch.
    pub begin: u32,
    /// End of the last dispatch.
    pub end: u32,
    /// Pairs in the list.
    pub length: u32,
    /// Entries in the list of failures.
    pub failures: u32,
    /// Non-empty pieces.
    pub pieces: u32,
    /// Pairs that found the list full.
    pub list_overflow: u32,
    /// Pairs that found their facet's set full.
    pub cells_overflow: u32,
    /// Why the search did not go on, see [`halt`]; 0 if it did.
    pub halt: u32,
    /// 1 if a seed is near the surface's box.
    pub near: u32,
    /// Seeds that lie on an earlier one.
    pub duplicates: u32,
    /// Facets whose first cell could not be proved.
    pub unproved: u32,
    /// `u32::MAX` less the first seed that is not finite or beyond the range; 0 if there is none.
    pub bad: u32,
    /// Entries of the sorted seeds that are given out.
    pub cursor: u32,
    /// Facets that `divide` left to the list of pairs.
    pub paired: u32,
    /// Clip dispatches that had pairs.
    pub rounds: u32,
    /// Entries of the rows that the device made longer.
    pub longer: u32,
    /// Failures that it put to the end of the list again.
    pub requeued: u32,
    /// Those of them whose polygons had not fit.
    pub overflowed: u32,
}

/// A seed in the order of the grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Sorted {
    /// Upper part of the position.
    pub hi: [f32; 3],
    /// Which seed.
    pub seed: u32,
    /// Position less upper part.
    pub lo: [f32; 3],
    /// The earliest seed at the same place.
    pub first: u32,
}

/// The same for a lifted surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LiftedSorted {
    /// Upper part of the place.
    pub hi: [f32; 3],
    /// Which seed.
    pub seed: u32,
    /// Place less upper part.
    pub lo: [f32; 3],
    /// The earliest seed at the same point.
    pub first: u32,
    /// Upper part of the lift.
    pub lift_hi: [f32; 3],
    /// Zero.
    pub after_hi: u32,
    /// Lift less upper part.
    pub lift_lo: [f32; 3],
    /// Zero.
    pub after_lo: u32,
}

/// State of the Verlet lists. Behind it are the arguments of the dispatches that depend on it, and the seeds whose lists do
/// not prove their rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ListState {
    /// How far any seed is from where it was noted; the bits of a float.
    pub drift: u32,
    /// Seeds that are far from there, as far as it matters how many.
    pub fast: u32,
    /// Rows that lists did not suffice for.
    pub open: u32,
    /// 0 if nothing is noted, 1 if places are, from 2 on the passes that the lists have served, and two.
    pub made: u32,
    /// Where the last search took rows from, see [`search`].
    pub mode: u32,
    /// Zero.
    pub padding: [u32; 3],
}

/// Values of [`ListState::mode`].
pub mod search {
    /// Rows from the lists, where they suffice.
    pub const FROM_LISTS: u32 = 3;
}

/// Parameters of the stages that move seeds. A uniform.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct OptimizerParams {
    /// Seeds.
    pub seeds: u32,
    /// Workgroups of a reduction: partial sums.
    pub groups: u32,
    /// How far along the direction.
    pub step: f32,
    /// Where in the history the new pair goes.
    pub slot: u32,
    /// 1 if there is a direction.
    pub directed: u32,
    /// 1 if all weights are 1; then mass is area.
    pub uniform_weights: u32,
    /// Mass units times this are moment units.
    pub moment_per_mass: f32,
    /// Units of the gradient: -2 over the moment's scale.
    pub gradient_unit: f32,
    /// Coefficients of the direction: steps, changes of the gradient, the gradient.
    pub coefficients: [[f32; 4]; 5],
    /// Units of area, two limbs, that the pieces come to at least if they cover the surface.
    pub least_area: [u32; 2],
    /// The same at most.
    pub most_area: [u32; 2],
    /// Mean mass of a cell, in its units.
    pub mean_mass: f32,
    /// Slots of the history that hold pairs, as bits.
    pub used: u32,
    /// Unused.
    pub padding: [u32; 2],
}

/// What one reduction over the cells says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Totals {
    /// Σ energy in units, low limb.
    pub energy_low: u32,
    /// Its high limb.
    pub energy_high: u32,
    /// Σ area in units, low limb.
    pub area_low: u32,
    /// Its high limb.
    pub area_high: u32,
    /// Cells without area.
    pub empty: u32,
    /// Σ |gradient|².
    pub gradient_squared: f32,
    /// Σ gradient · direction.
    pub slope: f32,
    /// Zero.
    pub padding: u32,
}

/// Bits of [`State::halt`].
pub mod halt {
    /// A seed is not finite, or farther than any seed may be.
    pub const BAD: u32 = 1;
    /// A seed is farther than single precision reaches.
    pub const FAR: u32 = 2;
    /// A cell of the grid has more seeds than are worth searching.
    pub const GRID_OVERFLOW: u32 = 4;
    /// Not of the search: the pass is not at its end.
    pub const INCOMPLETE: u32 = 8;
}

/// An entry of the journal: state and totals of a pass, as bytes.
pub const ENTRY_BYTES: u64 = (size_of::<State>() + size_of::<Totals>()) as u64;

/// Neighbours that the search finds at most. Cells of relaxed seeds need a dozen, facets that meet many cells some more. The
/// more of them, the sooner lists of [`LIST`] do not prove them any more: with 20 instead of 24, steps of the bunny with
/// 10,000 points take a tenth less, and 3 to 5 % more facets go to the list of pairs.
pub const ROW: u32 = 20;
/// Entries of a row at most that the device makes longer.
pub const LONGER: u32 = 128;
/// Pairs at most that the device puts to the end of its list again.
pub const MOST_REQUEUED: u32 = 256;
/// Rings of cells around its own that a seed's search looks at, at most.
pub const RINGS: u32 = 10;
/// Seeds of a Verlet list.
pub const LIST: u32 = 32;
/// Words that say what becomes of the lists, see [`ListState`].
pub const LIST_STATE_WORDS: u64 = (size_of::<ListState>() / 4) as u64;
/// Words of a row as the search writes it: its length, then the neighbours.
pub const STRIDE: u32 = ROW + 1;
/// Cells that the variants of `divide` can do at once.
pub const MEMBERS: [u32; 4] = [4, 6, 8, 12];
/// Workgroups that make rows longer.
pub const LENGTHENERS: u32 = 16;
/// A candidate that is not known.
pub const NONE: u32 = u32::MAX;
/// Pairs of the history, and one that is not accepted yet.
pub const PAIRS: usize = 8;
/// Dot products of each step, each change and the gradient with three vectors.
pub const PLAIN_DOTS: usize = 3 * (2 * PAIRS + 1);
/// All dot products: [`PLAIN_DOTS`], and those of each change, divided by masses, with itself, every later change and the
/// gradient.
pub const DOTS: usize = PLAIN_DOTS + PAIRS * (PAIRS + 3) / 2;

/// Splits a double into upper and lower floats. Below 2048 the upper part is a multiple of
/// 2⁻¹², so that differences of upper parts are exact, and the lower part adds 24 bits to it. It is a
/// multiple of 2⁻⁵², so that no square of a difference is below what a float holds in full.
pub fn split(p: [f64; 3]) -> ([f32; 3], [f32; 3]) {
    const LEAST: f64 = (1u64 << 52) as f64;
    let hi = p.map(|x| if x.abs() < 2048.0 { ((x * 4096.0).round() / 4096.0) as f32 } else { x as f32 });
    let lo = [0, 1, 2].map(|k| (((p[k] - f64::from(hi[k])) * LEAST).round() / LEAST) as f32);
    (hi, lo)
}

impl Seed {
    /// Where it is for the device.
    pub fn position(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| f64::from(self.hi[k]) + f64::from(self.lo[k]))
    }

    /// Squared distance to `other`, with the bits of `squared` in `shaders/shared/distance.wgsl`: each operation rounded once.
    pub fn key(&self, other: &Self) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|k| (other.hi[k] - self.hi[k]) + (other.lo[k] - self.lo[k])).map(|b| b * b);
        (x + y) + z
    }
}

impl LiftedSeed {
    /// Place and lift as they are for the device.
    pub fn position(&self) -> [[f64; 3]; 2] {
        let of = |hi: [f32; 3], lo: [f32; 3]| [0, 1, 2].map(|k| f64::from(hi[k]) + f64::from(lo[k]));
        [of(self.hi, self.lo), of(self.lift_hi, self.lift_lo)]
    }

    /// As [`Seed::key`], in R⁶.
    pub fn key(&self, other: &Self) -> f32 {
        let part = |hi: [f32; 3], lo: [f32; 3], other_hi: [f32; 3], other_lo: [f32; 3]| {
            let [x, y, z] = [0, 1, 2].map(|k| (other_hi[k] - hi[k]) + (other_lo[k] - lo[k])).map(|b| b * b);
            (x + y) + z
        };
        part(self.hi, self.lo, other.hi, other.lo) + part(self.lift_hi, self.lift_lo, other.lift_hi, other.lift_lo)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_keeps_detail() {
        for x in [0.0, 0.3, -0.499_999_999, 1.0 / 3.0, 7.123_456_789, -5000.3, 9e5 + 0.1] {
            let (hi, lo) = split([x; 3]);
            let error = (f64::from(hi[0]) + f64::from(lo[0]) - x).abs();
            assert!(error <= x.abs().max(0.25) * 2e-11, "{x}: {error:e}");
        }
    }

    #[test]
    fn failures_unpack() {
        assert_eq!(failure([5 | 1 << 31, 7]), Some((5, 7, code::NEIGHBOURS)));
        assert_eq!(failure([5, 7 | 1 << 31]), Some((5, 7, code::POLYGON)));
        assert_eq!(failure([5 | 1 << 31, 7 | 3 << 30]), Some((5, 7, code::FINISH)));
        assert_eq!(failure([3 << 30 | 4, 7 | 1 << 30]), None);
    }
}
