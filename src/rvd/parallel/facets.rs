//! All cells of several facets at once.
//!
//! Purpose: the integrals of the facets' pieces for a fraction of what a walk over their cells costs.
//! Of a list those seeds are left that no other one beats at all corners, the facet's members. Between any two
//! of them lies at most one segment, what the others leave of their bisector; and a piece's integrals are sums over
//! the segments around it, so that no polygon is ever made, and a segment serves the pieces on both of its
//! sides. Facets with as many members take the same steps, one in each lane.
//! Invariant: the cells that meet a facet, exactly: what rounding could get wrong is not decided
//! here, but left to the walk. The bits depend on the facet and the seeds alone: neither on what else a list holds
//! nor on the facets in the other lanes. The pieces of a facet add up to it.
//! Must not know: which facets share their lanes and why, threads, how integrals are added, where a list comes from.

use pulp::Simd;

use super::lanes::{Mask, Number, Row, WIDEST};
use super::moments::{self, Moments, PieceIntegrals, Shape, WEIGHTED};
use crate::rvd::Surface;
use crate::rvd::clip::Integrals;
use glam::DVec3;

/// A segment's end may be off by this share of the farthest corner's distance, in the worst case, and the facet is
/// left to the walk beyond: two bisectors are nearly parallel there, one facet in some thousand.
const MAX_SLIP: f64 = 1e-10;

/// A facet with a piece of less than this share is left to the walk: the piece's integrals, sums of terms as large as
/// the facet's, would keep nine digits at most, and some cell may have nothing else.
const LEAST_SHARE: f64 = 1e-6;

/// Members that a facet may have; one with more is walked.
pub(super) const MEMBERS: usize = 12;
/// Seeds that a list may have; a facet with more is walked.
pub(super) const LISTED: usize = 24;

/// A squared distance is off by at most this share of it: three roundings of a coordinate's square, the first of which
/// counts twice, and two of the sum.
const ERROR: f64 = 2.5 * f64::EPSILON;

/// Scratch memory.
pub(super) struct Facets {
    /// Corners, coordinate by coordinate.
    corner: [[Row; 3]; 3],
    /// Of each seed, coordinate by coordinate.
    seed: [[Row; 3]; LISTED],
    /// Squared distances of each seed from the corners.
    squared: [[Row; 3]; LISTED],
    /// The parts of the edges from the second corner to the third that lie in the members' cells.
    low: [Row; MEMBERS],
    high: [Row; MEMBERS],
    /// 1 where a member's piece is there.
    there: [Row; MEMBERS],
    moments: [Moments; MEMBERS],
}

impl Default for Facets {
    fn default() -> Self {
        let row = Row::default();
        Self {
            corner: [[row; 3]; 3],
            seed: [[row; 3]; LISTED],
            squared: [[row; 3]; LISTED],
            low: [row; MEMBERS],
            high: [row; MEMBERS],
            there: [row; MEMBERS],
            moments: [[row; WEIGHTED]; MEMBERS],
        }
    }
}

/// What rounding may do to the facets' numbers.
#[derive(Clone, Copy)]
struct Bounds<S: Simd> {
    /// A bisector's value at a corner is off by at most this.
    value: Number<S>,
    /// What a cut may be off by, as a share of the edge that it cuts.
    slip: Number<S>,
}

/// Pieces of as many members as there are; one in each lane.
pub(super) struct Found {
    /// Where rounding could decide.
    pub unsure: Row,
    pub pieces: [PieceRows; MEMBERS],
}

/// One member's pieces.
#[derive(Clone, Copy, Default)]
pub(super) struct PieceRows {
    /// 1 where it is there.
    pub there: Row,
    /// Mass, moment, energy, area.
    pub values: [Row; 6],
}

impl PieceRows {
    /// The integrals in one lane, if there is a piece.
    #[inline(always)]
    pub(super) fn get(&self, lane: usize) -> Option<Integrals> {
        let [mass, x, y, z, energy, area] = &self.values;
        (self.there.0[lane] != 0.0).then(|| Integrals {
            mass: mass.0[lane],
            moment: DVec3::new(x.0[lane], y.0[lane], z.0[lane]),
            energy: energy.0[lane],
            area: area.0[lane],
        })
    }
}

impl Default for Found {
    fn default() -> Self {
        Self { unsure: Row::default(), pieces: [PieceRows::default(); MEMBERS] }
    }
}

impl Facets {
    /// Sets a lane's facet.
    #[inline(always)]
    pub(super) fn set_corners(&mut self, lane: usize, surface: &Surface, facet: u32) {
        let lane = lane % WIDEST;
        let vertex = surface.facets()[facet as usize];
        for c in 0..3 {
            let p = surface.positions()[vertex[c] as usize];
            (self.corner[c][0].0[lane], self.corner[c][1].0[lane], self.corner[c][2].0[lane]) = (p.x, p.y, p.z);
        }
    }

    /// Sets a lane's k-th seed.
    #[inline(always)]
    pub(super) fn set_seed(&mut self, lane: usize, k: usize, p: DVec3) {
        let seed = &mut self.seed[k];
        let lane = lane % WIDEST;
        (seed[0].0[lane], seed[1].0[lane], seed[2].0[lane]) = (p.x, p.y, p.z);
    }

    /// The squared distances of the first `n` seeds.
    #[inline(always)]
    fn measure<S: Simd>(&mut self, simd: S, n: usize) {
        for c in 0..3 {
            let [x, y, z] = [0, 1, 2].map(|axis| Number::load(simd, &self.corner[c][axis]));
            for k in 0..n {
                let [dx, dy, dz] = [
                    Number::load(simd, &self.seed[k][0]) - x,
                    Number::load(simd, &self.seed[k][1]) - y,
                    Number::load(simd, &self.seed[k][2]) - z,
                ];
                (dx * dx + dy * dy + dz * dz).store(&mut self.squared[k][c]);
            }
        }
    }

    /// Of lists of `n` seeds those that are not farther than another one from all corners, as bits.
    #[inline(always)]
    pub(super) fn choose<S: Simd>(&mut self, simd: S, n: usize) -> [u32; WIDEST] {
        self.measure(simd, n);
        let room = Number::all(simd, 1.0 + 4.0 * ERROR);
        let squared = |k: usize, c: usize| Number::load(simd, &self.squared[k][c]);
        let mut bits = Number::all(simd, 0.0);
        for a in 0..n {
            let [x, y, z] = [squared(a, 0), squared(a, 1), squared(a, 2)];
            let mut beaten = Mask::none(simd);
            for b in 0..n {
                // Nobody beats itself, with room.
                let [by_x, by_y, by_z] = [squared(b, 0) * room, squared(b, 1) * room, squared(b, 2) * room];
                beaten = beaten | (by_x.below(x) & by_y.below(y) & by_z.below(z));
            }
            bits = bits + beaten.choose(Number::all(simd, 0.0), Number::all(simd, f64::from(1 << a)));
        }
        let mut row = Row::default();
        bits.store(&mut row);
        row.0.map(|bits| bits as u32)
    }

    #[inline(always)]
    fn at<S: Simd>(&self, simd: S, member: usize) -> [Number<S>; 3] {
        let [x, y, z] = &self.squared[member];
        [Number::load(simd, x), Number::load(simd, y), Number::load(simd, z)]
    }

    /// Divides facets of `n` members among them. `weight` holds the weights at the corners where they are not 1.
    #[inline(always)]
    pub(super) fn divide<S: Simd, const N: usize>(
        &mut self,
        simd: S,
        n: usize,
        weight: &[Row; 3],
        found: &mut Found,
    ) {
        self.measure(simd, n);
        let (zero, one) = (Number::all(simd, 0.0), Number::all(simd, 1.0));
        let corner = |c: usize| [0, 1, 2].map(|axis| Number::load(simd, &self.corner[c][axis]));
        let first = corner(0);
        let side = [corner(1), corner(2)].map(|p| [p[0] - first[0], p[1] - first[1], p[2] - first[2]]);
        let [e, f] = side;
        let cross = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
        let twice_area = (cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]).sqrt();
        let longest2 = (e[0] * e[0] + e[1] * e[1] + e[2] * e[2]).larger(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]);
        let shape = Shape { side, twice_area, weight: [0, 1, 2].map(|c| Number::load(simd, &weight[c])) };
        for k in 0..n {
            zero.store(&mut self.low[k]);
            one.store(&mut self.high[k]);
            zero.store(&mut self.there[k]);
            for m in 0..N {
                zero.store(&mut self.moments[k][m]);
            }
        }
        let bounds = self.bounds(simd, n, longest2);
        let mut unsure = Mask::none(simd);
        for i in 0..n {
            for j in i + 1..n {
                unsure = unsure | self.pair::<S, N>(simd, (i, j, n), bounds);
            }
        }
        let four_slips = Number::all(simd, 4.0) * bounds.slip;
        for k in 0..n {
            // The first corner is the origin, so that of a facet's own edges only the one across counts.
            let (low, high) = (Number::load(simd, &self.low[k]), Number::load(simd, &self.high[k]));
            let some = low.below(high);
            unsure = unsure | (high - low).abs().at_most(four_slips);
            let [low, high] = [low, high].map(|t| some.choose(t, zero));
            let segment = moments::of::<S, N>(simd, [one - low, low], [one - high, high]);
            let moments = &mut self.moments[k];
            moments::add(simd, moments, segment);
            let there = some | zero.below(Number::load(simd, &self.there[k]));
            unsure = unsure | (there & Number::load(simd, &moments[0]).below(Number::all(simd, LEAST_SHARE)));
            let piece = &mut found.pieces[k];
            there.choose(one, zero).store(&mut piece.there);
            let origin = [0, 1, 2].map(|axis| first[axis] - Number::load(simd, &self.seed[k][axis]));
            let PieceIntegrals { mass, moment: [x, y, z], energy, area } =
                moments::integrals::<S, N>(simd, moments, &shape, origin);
            for (value, row) in [mass, x, y, z, energy, area].into_iter().zip(&mut piece.values) {
                value.store(row);
            }
        }
        unsure.choose(one, zero).store(&mut found.unsure);
    }

    #[inline(always)]
    fn bounds<S: Simd>(&self, simd: S, n: usize, longest2: Number<S>) -> Bounds<S> {
        let (mut most, mut nearest) = (Number::all(simd, 0.0), Number::all(simd, f64::MAX));
        for k in 0..n {
            let [x, y, z] = self.at(simd, k);
            let farthest = x.larger(y).larger(z);
            most = most.larger(farthest);
            nearest = nearest.smaller(farthest);
        }
        // A third side is at most the other two together.
        let slip = (Number::all(simd, 0.25) * nearest / longest2).larger(Number::all(simd, 1.0)).sqrt();
        Bounds {
            // A difference of two, and what is computed from it.
            value: Number::all(simd, 2.0 * ERROR + 8.0 * f64::EPSILON) * most,
            slip: Number::all(simd, MAX_SLIP) * slip,
        }
    }

    /// Adds the segment between two members to their pieces. Returns where rounding could decide.
    #[inline(always)]
    fn pair<S: Simd, const N: usize>(
        &mut self,
        simd: S,
        (i, j, n): (usize, usize, usize),
        bounds: Bounds<S>,
    ) -> Mask<S> {
        let (zero, one) = (Number::all(simd, 0.0), Number::all(simd, 1.0));
        let mine = self.at(simd, i);
        let other = self.at(simd, j);
        let d = [other[0] - mine[0], other[1] - mine[1], other[2] - mine[2]];
        let inside = [zero.below(d[0]), zero.below(d[1]), zero.below(d[2])];
        let mut unsure =
            d[0].abs().at_most(bounds.value) | d[1].abs().at_most(bounds.value) | d[2].abs().at_most(bounds.value);
        unsure = unsure | self.along_edge(simd, (i, j), d[1], d[2], bounds);
        // The corner that is alone on its side.
        let alone = [inside[1] ^ inside[2], inside[0] ^ inside[2], inside[0] ^ inside[1]];
        let crossed = alone[0] | alone[1];
        if !crossed.any() {
            return unsure;
        }
        let (at_2, at_1) = (!alone[2], !alone[1]);
        let pick = |values: [Number<S>; 3]| at_2.choose(values[2], at_1.choose(values[1], values[0]));
        let (c, a, b) = (pick(d), pick([d[1], d[2], d[0]]), pick([d[2], d[0], d[1]]));
        let (to_a, to_b) = (one / (c - a), one / (c - b));
        let (xa, xb) = (c * to_a, c * to_b);
        let twice = bounds.value + bounds.value;
        let (slip_a, slip_b) = ((twice * to_a).abs(), (twice * to_b).abs());
        // The barycentric coordinates of both ends, of which the one across is none.
        let (rest_a, rest_b) = (one - xa, one - xb);
        let from = [pick([rest_a, zero, xa]), pick([xa, rest_a, zero]), pick([zero, xa, rest_a])];
        let to = [pick([rest_b, xb, zero]), pick([zero, rest_b, xb]), pick([xb, zero, rest_b])];
        let (mut low, mut high) = (zero, one);
        let (mut close, mut taken) = (slip_a.larger(slip_b), Mask::none(simd));
        let mut near = bounds.slip.below(close);
        for k in (0..n).filter(|&k| k != i && k != j) {
            let third = self.at(simd, k);
            let g = [third[0] - mine[0], third[1] - mine[1], third[2] - mine[2]];
            let ga = from[0] * g[0] + from[1] * g[1] + from[2] * g[2];
            let gb = to[0] * g[0] + to[1] * g[1] + to[2] * g[2];
            // What a slip along an edge changes, at most.
            let range = g[0].abs() + g[1].abs() + g[2].abs();
            let (unsure_a, unsure_b) = (bounds.value + slip_a * range, bounds.value + slip_b * range);
            let (out_a, out_b) = (ga.at_most(zero), gb.at_most(zero));
            taken = taken | (out_a & out_b & unsure_a.below(ga.abs()) & unsure_b.below(gb.abs()));
            let run = ga - gb;
            let cuts = out_a ^ out_b;
            let slips = cuts & (bounds.slip * run.abs()).below(unsure_a + unsure_b);
            near = near | ga.abs().at_most(unsure_a) | gb.abs().at_most(unsure_b) | slips;
            let t = ga / run;
            low = (cuts & out_a & low.below(t)).choose(t, low);
            high = (cuts & out_b & t.below(high)).choose(t, high);
        }
        let left = crossed & !taken;
        close = (high - low).abs();
        near = near | close.at_most(Number::all(simd, 4.0) * bounds.slip);
        let some = left & low.below(high);
        if some.any() {
            let (du, dv) = (to[1] - from[1], to[2] - from[2]);
            let start = [from[1] + low * du, from[2] + low * dv].map(|x| some.choose(x, zero));
            let end = [from[1] + high * du, from[2] + high * dv].map(|x| some.choose(x, zero));
            // Around corner c, and so around its piece, the segment runs from a's side to b's.
            let along = zero.below(c);
            let [p, q] = [[start[0], end[0]], [start[1], end[1]]].map(|[s, e]| [along.choose(s, e), along.choose(e, s)]);
            let segment = moments::of::<S, N>(simd, [p[0], q[0]], [p[1], q[1]]);
            moments::add(simd, &mut self.moments[i], segment);
            moments::take(simd, &mut self.moments[j], segment);
            for k in [i, j] {
                some.choose(one, Number::load(simd, &self.there[k])).store(&mut self.there[k]);
            }
        }
        unsure | (left & near)
    }

    /// What a bisector leaves to either of its pieces of the edge from the second corner to the third, where
    /// its values are `d` and `e`. Returns where rounding could decide.
    #[inline(always)]
    fn along_edge<S: Simd>(
        &mut self,
        simd: S,
        (i, j): (usize, usize),
        d: Number<S>,
        e: Number<S>,
        bounds: Bounds<S>,
    ) -> Mask<S> {
        let (zero, one, nothing) = (Number::all(simd, 0.0), Number::all(simd, 1.0), Number::all(simd, 2.0));
        let (first, last) = (zero.below(d), zero.below(e));
        let run = d - e;
        let t = d / run;
        let mut part = |k: usize, first: Mask<S>, last: Mask<S>| {
            let begin = first.choose(zero, last.choose(t, nothing));
            let end = last.choose(one, first.choose(t, one));
            let (low, high) = (Number::load(simd, &self.low[k]), Number::load(simd, &self.high[k]));
            low.below(begin).choose(begin, low).store(&mut self.low[k]);
            end.below(high).choose(end, high).store(&mut self.high[k]);
        };
        part(i, first, last);
        part(j, !first, !last);
        (first ^ last) & (bounds.slip * run.abs()).below(bounds.value + bounds.value)
    }
}
