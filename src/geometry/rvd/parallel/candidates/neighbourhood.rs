//! The seeds around facets that lie beside one another.
//!
//! Purpose: the lists of several facets from one search of the seeds around them all, without rows of neighbours. Every
//! facet has a lane.
//! Invariant: a seed that is left out of a facet's list is farther from all three corners than the seed that the facet is
//! seen from, whatever way either moves within its skin. An escaped seed has no skin. Must not know: what becomes of lists.

use glam::DVec3;
use pulp::Simd;

use super::escaped::{Bounds, Escaped, Reach};
use super::gather::{ROOM, Skin};
use crate::knn::Point;
use crate::rvd::incident::Diagram;
use crate::rvd::parallel::divide::{Mask, Number, Row, WIDEST, distance_squared};

/// Facets that are looked around together.
pub(crate) const GROUP: usize = 16;
/// About the fewest that fill some lanes. More are halved where the halves' boxes are together smaller than one around both.
const APART: usize = 4;
/// Seeds that are looked at for them. They are far more where seeds are dense somewhere near.
const LOOKED_AT: usize = 1024;
/// Seeds in a word: as many as a number has bits.
const WORD: usize = 52;

pub(crate) struct Neighbourhood<P: Point> {
    seeds: Vec<u32>,
    /// Of each seed its place, and how far it may move.
    places: Vec<(P, f64)>,
    corner: [P::Each<Row>; 3],
    /// How far the seed that a facet is seen from may be from each corner.
    most: [Row; 3],
    /// Bit sets of the seeds that count, one lane per facet.
    words: Vec<Row>,
    /// Index of the seed nearest to the centroid.
    nearest: Row,
}

impl<P: Point> Default for Neighbourhood<P> {
    fn default() -> Self {
        let rows = P::each(|_| Row::default());
        let (seeds, places, words) = Default::default();
        Self { seeds, places, corner: [rows; 3], most: Default::default(), words, nearest: Row::default() }
    }
}

/// Cuts facets that lie apart from one another into parts that do not; appends how many each has.
pub(crate) fn parts<P: Point>(reaches: &[Reach<P>], out: &mut Vec<usize>) -> Bounds {
    let begin = out.len();
    if reaches.len() <= APART {
        out.push(reaches.len());
        return reaches.iter().fold(Bounds::NONE, |all, reach| all.with(reach.bounds()));
    }
    let (first, second) = reaches.split_at(reaches.len() / 2);
    let (first, second) = (parts(first, out), parts(second, out));
    let all = first.with(second);
    // About as many seeds lie in a box as the square of its width says: they are on a surface.
    if all.width_squared() <= first.width_squared() + second.width_squared() {
        out.truncate(begin);
        out.push(reaches.len());
    }
    all
}

impl<P: Point> Neighbourhood<P> {
    /// Takes all seeds that could count on facets with these reaches, at most [`GROUP`]: those of the diagram, which move by
    /// their skin, but for escaped seeds, and the escaped seeds. Returns whether it could, and whether there are not too many.
    pub(crate) fn search(
        &mut self,
        diagram: Diagram<'_, P>,
        skin: Skin<'_>,
        reaches: &[Reach<P>],
        escaped: Option<&Escaped<P>>,
    ) -> bool {
        let bounds = reaches.iter().fold(Bounds::NONE, |all, reach| all.with(reach.bounds()));
        self.seeds.clear();
        self.places.clear();
        let others = bounds.wider(skin.most);
        let done = diagram.index.each_in_box(others.low, others.high, LOOKED_AT, |i, p| {
            let own = skin.of(i);
            if bounds.is_within(own, p.place()) && !escaped.is_some_and(|escaped| escaped.contains(i)) {
                self.seeds.push(i);
                self.places.push((p, own));
            }
        });
        if !done {
            return false;
        }
        for (p, i) in escaped.iter().flat_map(|escaped| escaped.within(bounds)) {
            self.seeds.push(i);
            self.places.push((p, 0.0));
        }
        true
    }

    /// Calls `visit` with each facet's number among the `reaches` and its seeds.
    #[inline(always)]
    pub(crate) fn each<S: Simd>(&mut self, simd: S, reaches: &[Reach<P>], mut visit: impl FnMut(usize, Seeds<'_, P>)) {
        let lanes = Number::<S>::LANES;
        for (first, facets) in (0..).step_by(lanes).zip(reaches.chunks(lanes)) {
            self.set(lanes, facets);
            self.compare(simd);
            for lane in 0..facets.len() {
                visit(first + lane, Seeds { around: self, lane });
            }
        }
    }

    /// Puts facets into lanes; the last one fills those that are left.
    fn set(&mut self, lanes: usize, facets: &[Reach<P>]) {
        for lane in 0..lanes {
            let Reach { corner, most } = facets[lane.min(facets.len() - 1)];
            for c in 0..3 {
                for (row, &x) in self.corner[c].as_mut().iter_mut().zip(corner[c].coordinates().as_ref()) {
                    row.0[lane % WIDEST] = x;
                }
                self.most[c].0[lane % WIDEST] = most[c];
            }
        }
    }

    #[inline(always)]
    fn compare<S: Simd>(&mut self, simd: S) {
        let (zero, room) = (Number::all(simd, 0.0), Number::all(simd, ROOM));
        let corner = DVec3::each(|c| P::each(|k| Number::load(simd, &self.corner[c].as_ref()[k])));
        let most = DVec3::each(|c| Number::load(simd, &self.most[c]));
        self.words.clear();
        let (mut nearest, mut least) = (zero, Number::all(simd, f64::MAX));
        let mut at = 0.0;
        for places in self.places.chunks(WORD) {
            let (mut bits, mut bit) = (zero, 1.0);
            for &(p, skin) in places {
                let p = p.coordinates();
                let p = P::each(|k| Number::all(simd, p.as_ref()[k]));
                let skin = Number::all(simd, skin);
                let (mut sum, mut counts) = (zero, Mask::none(simd));
                for c in 0..3 {
                    let (squared, most) = (distance_squared::<S, P>(&corner[c], &p), most[c] + skin);
                    counts = counts | squared.at_most(most * most * room);
                    sum = sum + squared;
                }
                bits = bits + counts.choose(Number::all(simd, bit), zero);
                bit *= 2.0;
                // The seed nearest to the centroid has the least sum of squared distances from the corners, and counts.
                let nearer = sum.below(least);
                (least, nearest) = (sum.smaller(least), nearer.choose(Number::all(simd, at), nearest));
                at += 1.0;
            }
            self.words.push(Row::default());
            if let Some(word) = self.words.last_mut() {
                bits.store(word);
            }
        }
        nearest.store(&mut self.nearest);
    }
}

/// The seeds that count on one facet.
#[derive(Clone, Copy)]
pub(crate) struct Seeds<'a, P: Point> {
    around: &'a Neighbourhood<P>,
    lane: usize,
}

impl<P: Point> Seeds<'_, P> {
    fn words(&self) -> impl Iterator<Item = u64> {
        self.around.words.iter().map(|word| word.0[self.lane] as u64)
    }

    pub(crate) fn len(&self) -> usize {
        self.words().map(|word| word.count_ones() as usize).sum()
    }

    /// The one that is nearest to the facet's centroid, unless it does not count.
    pub(crate) fn nearest(&self) -> Option<u32> {
        let at = self.around.nearest.0[self.lane] as usize;
        let word = self.around.words.get(at / WORD)?.0[self.lane] as u64;
        (word >> (at % WORD) & 1 != 0).then(|| self.around.seeds[at])
    }

    /// Puts them into `out`, which has room for as many as there are.
    #[inline(always)]
    pub(crate) fn write(&self, out: &mut [u32]) {
        let mut out = out.iter_mut();
        for (first, mut left) in (0..).step_by(WORD).zip(self.words()) {
            while left != 0 {
                let at = first + left.trailing_zeros() as usize;
                left &= left - 1;
                if let Some(out) = out.next() {
                    *out = self.around.seeds[at];
                }
            }
        }
    }
}
