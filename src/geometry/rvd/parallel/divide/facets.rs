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

use glam::DVec3;
use pulp::Simd;

use super::{Mask, Moments, Number, PieceIntegrals, Row, Shape, WIDEST, Weight, distance_squared, dot, minus};
use crate::knn::Point;
use crate::rvd::{clip::Integrals, parallel::order::Vertex};

/// A segment's end may be off by this share of the farthest corner's distance, in the worst case, and the facet is
/// left to the walk beyond: two bisectors are nearly parallel there, one facet in some thousand.
const MAX_SLIP: f64 = 1e-10;

/// A piece of less than this share of its facet is left to the clip: its integrals, sums of terms as large as
/// the facet's, would keep nine digits at most, and some cell may have nothing else.
const LEAST_SHARE: f64 = 1e-6;

/// Members that a facet may have; one with more is walked.
pub(crate) const MEMBERS: usize = 24;
/// Seeds that a list may have; a facet with more is walked.
pub(crate) const LISTED: usize = 32;

/// What a squared distance is off by, as a share: three roundings of a coordinate's square, the first twice, two of the sum.
const ERROR: f64 = 2.5 * f64::EPSILON;

/// Facets and seeds, one facet in each lane.
pub(crate) struct Given<P: Point> {
    /// Corners, coordinate by coordinate.
    corner: [P::Each<Row>; 3],
    weight: [Row; 3],
    /// Of each seed, coordinate by coordinate.
    seed: [P::Each<Row>; LISTED],
    /// How far each seed may move.
    skin: [Row; LISTED],
}

#[derive(Default)]
pub(crate) struct Facets {
    squared: [[Row; 3]; LISTED],
    /// The least distances that each seed may have to the corners.
    least: [[Row; 3]; LISTED],
    /// The parts of the edges from the second corner to the third that lie in the members' cells.
    low: [Row; MEMBERS],
    high: [Row; MEMBERS],
    /// 1 where a member's piece is there.
    there: [Row; MEMBERS],
    moments: [Moments; MEMBERS],
}

/// Whether a seed at these squared distances from the corners beats one at those, as in [`Facets::choose`].
pub(crate) fn beats(squared: [f64; 3], other: [f64; 3]) -> bool {
    (0..3).all(|c| squared[c] < other[c] * (1.0 - 4.0 * ERROR))
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
pub(crate) struct Found<P: Point> {
    /// Where rounding could decide.
    pub unsure: Row,
    pub pieces: [PieceRows<P>; MEMBERS],
}

/// What stands for a piece that is there, but of less than [`LEAST_SHARE`].
const SMALL: f64 = 2.0;

#[derive(Clone, Copy)]
pub(crate) struct PieceRows<P: Point> {
    /// 1 where it is there, and [`SMALL`].
    there: Row,
    mass: Row,
    moment: P::Each<Row>,
    energy: Row,
    area: Row,
}

impl<P: Point> Default for Given<P> {
    fn default() -> Self {
        let rows = P::each(|_| Row::default());
        Self { corner: [rows; 3], weight: Default::default(), seed: [rows; LISTED], skin: Default::default() }
    }
}

impl<P: Point> Default for Found<P> {
    fn default() -> Self {
        let row = Row::default();
        let none = PieceRows { there: row, mass: row, moment: P::each(|_| row), energy: row, area: row };
        Self { unsure: row, pieces: [none; MEMBERS] }
    }
}

impl<P: Point> PieceRows<P> {
    /// Whether there is a piece in one lane that is too small for [`Self::get`].
    #[inline(always)]
    pub(crate) fn is_small(&self, lane: usize) -> bool {
        self.there.0[lane] == SMALL
    }

    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> Option<Integrals<P>> {
        (self.there.0[lane] != 0.0).then(|| Integrals {
            mass: self.mass.0[lane],
            moment: P::from_coordinates(P::each(|k| self.moment.as_ref()[k].0[lane])),
            energy: self.energy.0[lane],
            area: self.area.0[lane],
        })
    }
}

impl<P: Point> Given<P> {
    #[inline(always)]
    pub(crate) fn set_facet(&mut self, lane: usize, vertices: &[Vertex<P>; 3]) {
        let lane = lane % WIDEST;
        for (corner, Vertex { p, .. }) in self.corner.iter_mut().zip(vertices) {
            put(corner, lane, *p);
        }
    }

    #[inline(always)]
    pub(crate) fn set_weights(&mut self, lane: usize, vertices: &[Vertex<P>; 3]) {
        self.weight.iter_mut().zip(vertices).for_each(|(row, vertex)| row.0[lane % WIDEST] = vertex.weight);
    }

    #[inline(always)]
    pub(crate) fn set_seed(&mut self, lane: usize, k: usize, p: P) {
        put(&mut self.seed[k], lane % WIDEST, p);
    }

    #[inline(always)]
    pub(crate) fn set_skin(&mut self, lane: usize, k: usize, skin: f64) {
        self.skin[k].0[lane % WIDEST] = skin;
    }
}

/// Two groups' lanes. The next one's are set before those of the one at hand are read: what was written number by
/// number could not be read as a whole at once.
pub(crate) struct InTurn<P: Point>([Given<P>; 2]);

impl<P: Point> Default for InTurn<P> {
    fn default() -> Self {
        Self(Default::default())
    }
}

#[inline(always)]
fn put<P: Point>(rows: &mut P::Each<Row>, lane: usize, p: P) {
    rows.as_mut().iter_mut().zip(p.coordinates().as_ref()).for_each(|(row, x)| row.0[lane] = *x);
}

/// A group to set, and one to read that was set before.
pub(crate) struct Turn<'a> {
    pub set: Option<&'a [u32]>,
    pub read: Option<&'a [u32]>,
    into: usize,
}

impl<P: Point> InTurn<P> {
    pub(crate) fn turns(facets: &[u32], lanes: usize) -> impl Iterator<Item = Turn<'_>> {
        let groups = facets.chunks(lanes).map(Some);
        let set = groups.clone().chain([None]);
        set.zip([None].into_iter().chain(groups)).enumerate().map(|(k, (set, read))| Turn { set, read, into: k % 2 })
    }

    #[inline(always)]
    pub(crate) fn next(&mut self, turn: &Turn<'_>) -> &mut Given<P> {
        &mut self.0[turn.into]
    }

    #[inline(always)]
    pub(crate) fn present(&self, turn: &Turn<'_>) -> &Given<P> {
        &self.0[1 - turn.into]
    }
}

impl Facets {
    #[inline(always)]
    fn measure<S: Simd, P: Point>(&mut self, simd: S, n: usize, given: &Given<P>) {
        for c in 0..3 {
            let corner = load_point::<S, P>(simd, &given.corner[c]);
            for k in 0..n {
                let seed = load_point::<S, P>(simd, &given.seed[k]);
                distance_squared::<S, P>(&seed, &corner).store(&mut self.squared[k][c]);
            }
        }
    }

    /// Of lists of `n` seeds those that are not farther than another one from all corners, as bits.
    #[inline(always)]
    pub(crate) fn choose<S: Simd, P: Point>(&mut self, simd: S, n: usize, given: &Given<P>) -> [u32; WIDEST] {
        self.measure(simd, n, given);
        // A seed beats another one by more than roundings.
        let room = Number::all(simd, 1.0 - 4.0 * ERROR);
        for k in 0..n {
            for c in 0..3 {
                (Number::load(simd, &self.squared[k][c]) * room).store(&mut self.least[k][c]);
            }
        }
        self.unbeaten(simd, n)
    }

    /// The same, whatever way any two of them move within their skins.
    #[inline(always)]
    pub(crate) fn choose_with_skin<S: Simd, P: Point>(&mut self, simd: S, n: usize, given: &Given<P>) -> [u32; WIDEST] {
        self.measure(simd, n, given);
        let room = Number::all(simd, 1.0 - 4.0 * ERROR);
        for k in 0..n {
            let skin = Number::load(simd, &given.skin[k]);
            for c in 0..3 {
                let distance = Number::load(simd, &self.squared[k][c]).sqrt();
                ((distance - skin) * room).store(&mut self.least[k][c]);
                (distance + skin).store(&mut self.squared[k][c]);
            }
        }
        self.unbeaten(simd, n)
    }

    #[inline(always)]
    fn unbeaten<S: Simd>(&mut self, simd: S, n: usize) -> [u32; WIDEST] {
        let mut bits = Number::all(simd, 0.0);
        for a in 0..n {
            let [x, y, z] = load(simd, &self.least[a]);
            let mut beaten = Mask::none(simd);
            for b in 0..n {
                let [by_x, by_y, by_z] = load(simd, &self.squared[b]);
                beaten = beaten | (by_x.below(x) & by_y.below(y) & by_z.below(z));
            }
            bits = bits + beaten.choose(Number::all(simd, 0.0), Number::all(simd, f64::from(1u32 << a)));
        }
        let mut row = Row::default();
        bits.store(&mut row);
        row.0.map(|bits| bits as u32)
    }

    /// Divides facets of `n` members among them. Weights are read where they are not 1.
    #[inline(always)]
    pub(crate) fn divide<S: Simd, P: Point, const N: usize>(
        &mut self,
        simd: S,
        n: usize,
        given: &Given<P>,
        found: &mut Found<P>,
    ) {
        self.measure(simd, n, given);
        let (zero, one) = (Number::all(simd, 0.0), Number::all(simd, 1.0));
        let [first, second, third] = DVec3::each(|c| load_point::<S, P>(simd, &given.corner[c]));
        let (e, f) = (minus::<S, P>(&second, &first), minus::<S, P>(&third, &first));
        let shape = Shape { side: [e, f], twice_area: parallelogram::<S, P>(&e, &f) };
        let longest2 = dot::<S, P>(&e, &e).larger(dot::<S, P>(&f, &f));
        let weight = Weight::new(load(simd, &given.weight));
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
                unsure = unsure | self.pair::<S, N>(simd, (i, j, n), bounds, weight);
            }
        }
        let four_slips = Number::all(simd, 4.0) * bounds.slip;
        for k in 0..n {
            // The first corner is the origin, so that of a facet's own edges only the one across counts.
            let (low, high) = (Number::load(simd, &self.low[k]), Number::load(simd, &self.high[k]));
            let some = low.below(high);
            unsure = unsure | (high - low).abs().at_most(four_slips);
            let (low, high) = (some.choose(low, zero), some.choose(high, zero));
            let segment = super::segment_moments::<S, N>(simd, weight, [[one - low, low], [one - high, high]]);
            let moments = &mut self.moments[k];
            super::add_moments(simd, moments, segment);
            let there = some | zero.below(Number::load(simd, &self.there[k]));
            let small = Number::load(simd, &moments[0]).below(Number::all(simd, LEAST_SHARE));
            let piece = &mut found.pieces[k];
            there.choose(small.choose(Number::all(simd, SMALL), one), zero).store(&mut piece.there);
            let origin = minus::<S, P>(&first, &load_point::<S, P>(simd, &given.seed[k]));
            let PieceIntegrals { mass, moment, energy, area } =
                super::integrals::<S, P, N>(simd, moments, &shape, &origin);
            mass.store(&mut piece.mass);
            moment.as_ref().iter().zip(piece.moment.as_mut()).for_each(|(number, row)| number.store(row));
            energy.store(&mut piece.energy);
            area.store(&mut piece.area);
        }
        unsure.choose(one, zero).store(&mut found.unsure);
    }

    #[inline(always)]
    fn bounds<S: Simd>(&self, simd: S, n: usize, longest2: Number<S>) -> Bounds<S> {
        let (mut most, mut nearest) = (Number::all(simd, 0.0), Number::all(simd, f64::MAX));
        for k in 0..n {
            let [x, y, z] = load(simd, &self.squared[k]);
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
        weight: Weight<S>,
    ) -> Mask<S> {
        let (zero, one) = (Number::all(simd, 0.0), Number::all(simd, 1.0));
        let mine = load(simd, &self.squared[i]);
        let other = load(simd, &self.squared[j]);
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
        let at = [!alone[1], !alone[2]];
        let (c, a, b) = (pick(at, d), pick(at, [d[1], d[2], d[0]]), pick(at, [d[2], d[0], d[1]]));
        let (to_a, to_b) = (one / (c - a), one / (c - b));
        let (xa, xb) = (c * to_a, c * to_b);
        let twice = bounds.value + bounds.value;
        let (slip_a, slip_b) = ((twice * to_a).abs(), (twice * to_b).abs());
        // The barycentric coordinates of both ends, of which the one across is none.
        let (rest_a, rest_b) = (one - xa, one - xb);
        let from = [pick(at, [rest_a, zero, xa]), pick(at, [xa, rest_a, zero]), pick(at, [zero, xa, rest_a])];
        let to = [pick(at, [rest_b, xb, zero]), pick(at, [zero, rest_b, xb]), pick(at, [xb, zero, rest_b])];
        let (mut low, mut high) = (zero, one);
        let mut taken = Mask::none(simd);
        let mut near = bounds.slip.below(slip_a.larger(slip_b));
        for k in 0..n {
            if k == i || k == j {
                continue;
            }
            let third = load(simd, &self.squared[k]);
            let g = [third[0] - mine[0], third[1] - mine[1], third[2] - mine[2]];
            let ga = from[0] * g[0] + from[1] * g[1] + from[2] * g[2];
            let gb = to[0] * g[0] + to[1] * g[1] + to[2] * g[2];
            // What a slip along an edge changes, at most.
            let range = g[0].abs() + g[1].abs() + g[2].abs();
            let (unsure_a, unsure_b) = (bounds.value + slip_a * range, bounds.value + slip_b * range);
            let (out_a, out_b) = (ga.at_most(zero), gb.at_most(zero));
            taken = taken | (out_a & out_b & unsure_a.below(ga.abs()) & unsure_b.below(gb.abs()));
            if n > 4 && !(crossed & !taken).any() {
                return unsure;
            }
            let run = ga - gb;
            let cuts = out_a ^ out_b;
            let slips = cuts & (bounds.slip * run.abs()).below(unsure_a + unsure_b);
            near = near | ga.abs().at_most(unsure_a) | gb.abs().at_most(unsure_b) | slips;
            let t = ga / run;
            low = (cuts & out_a & low.below(t)).choose(t, low);
            high = (cuts & out_b & t.below(high)).choose(t, high);
        }
        let left = crossed & !taken;
        near = near | (high - low).abs().at_most(Number::all(simd, 4.0) * bounds.slip);
        let some = left & low.below(high);
        if some.any() {
            let (du, dv) = (to[1] - from[1], to[2] - from[2]);
            // Neighbourhood corner c, and so around its piece, the segment runs from a's side to b's.
            let along = zero.below(c);
            let (begin, end) = (along.choose(low, high), along.choose(high, low));
            let begin = [some.choose(from[1] + begin * du, zero), some.choose(from[2] + begin * dv, zero)];
            let end = [some.choose(from[1] + end * du, zero), some.choose(from[2] + end * dv, zero)];
            let segment = super::segment_moments::<S, N>(simd, weight, [begin, end]);
            super::add_moments(simd, &mut self.moments[i], segment);
            super::take_moments(simd, &mut self.moments[j], segment);
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
        for (k, first, last) in [(i, first, last), (j, !first, !last)] {
            let begin = first.choose(zero, last.choose(t, nothing));
            let end = last.choose(one, first.choose(t, one));
            let (low, high) = (Number::load(simd, &self.low[k]), Number::load(simd, &self.high[k]));
            low.below(begin).choose(begin, low).store(&mut self.low[k]);
            end.below(high).choose(end, high).store(&mut self.high[k]);
        }
        (first ^ last) & (bounds.slip * run.abs()).below(bounds.value + bounds.value)
    }
}

#[inline(always)]
fn load<S: Simd>(simd: S, [x, y, z]: &[Row; 3]) -> [Number<S>; 3] {
    [Number::load(simd, x), Number::load(simd, y), Number::load(simd, z)]
}

#[inline(always)]
fn load_point<S: Simd, P: Point>(simd: S, rows: &P::Each<Row>) -> P::Each<Number<S>> {
    P::each(|k| Number::load(simd, &rows.as_ref()[k]))
}

/// As [`Point::parallelogram`].
#[inline(always)]
fn parallelogram<S: Simd, P: Point>(a: &P::Each<Number<S>>, b: &P::Each<Number<S>>) -> Number<S> {
    let (a, b) = (a.as_ref(), b.as_ref());
    let minor = |&(i, j): &(usize, usize)| a[i] * b[j] - a[j] * b[i];
    let first = minor(&P::MINORS[0]);
    P::MINORS[1..].iter().map(minor).fold(first * first, |sum, minor| sum + minor * minor).sqrt()
}

/// The second or the third value where `at` says so, or else the first.
#[inline(always)]
fn pick<S: Simd>(at: [Mask<S>; 2], values: [Number<S>; 3]) -> Number<S> {
    at[1].choose(values[2], at[0].choose(values[1], values[0]))
}
