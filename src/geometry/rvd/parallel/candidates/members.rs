//! Facets with as many seeds, side by side.
//!
//! Purpose: sorts facets by how many seeds they have to do with, puts those with as many into lanes together, and finds
//! their members.
//! Invariant: what is found of a facet does not depend on those beside it. Must not know: what becomes of members.

use std::iter::repeat_n;

use pulp::{Simd, WithSimd};

use super::{Lists, gather::Skin};
use crate::knn::Point;
use crate::rvd::parallel::divide::facets::{Facets, Given, InTurn, LISTED, MEMBERS, beats};
use crate::rvd::parallel::{divide::Number, order::Stretch};
use crate::rvd::{incident::Diagram, refill};

/// The facets of a chunk, all with area, and their lists.
#[derive(Clone, Copy)]
pub(crate) struct Listed<'a, P: Point> {
    pub diagram: Diagram<'a, P>,
    pub facets: Stretch<'a, P>,
    /// A seed near each facet.
    pub starts: &'a [u32],
    pub lists: &'a Lists,
    /// There are rows of neighbours, and facets with many members are walked by them.
    pub by_rows: bool,
}

#[derive(Default)]
pub(crate) struct ByLength {
    first: Vec<u32>,
    order: Vec<u32>,
}

impl ByLength {
    /// Sorts facets by their numbers, from 1 to `most`; others are left out.
    pub(crate) fn sort(&mut self, most: usize, numbers: impl Iterator<Item = usize> + Clone) {
        refill(&mut self.first, repeat_n(0, most + 2));
        for n in numbers.clone().filter(|&n| (1..=most).contains(&n)) {
            self.first[n + 1] += 1;
        }
        for n in 1..self.first.len() {
            self.first[n] += self.first[n - 1];
        }
        refill(&mut self.order, repeat_n(0, self.first[most + 1] as usize));
        let mut next = self.first.clone();
        for (at, n) in numbers.enumerate().filter(|(_, n)| (1..=most).contains(n)) {
            self.order[next[n] as usize] = at as u32;
            next[n] += 1;
        }
    }

    pub(crate) fn of(&self, n: usize) -> &[u32] {
        &self.order[self.first[n] as usize..self.first[n + 1] as usize]
    }
}

#[derive(Default)]
pub(crate) struct Chooser<P: Point> {
    pub facets: Facets,
    pub in_turn: InTurn<P>,
    pub groups: ByLength,
    /// Of each facet the members among its list, as bits; 0 where there are too many for that.
    pub members: Vec<u32>,
    pub long: LongLists,
}

/// Lists that are too long for lanes, without those that others beat.
#[derive(Default)]
pub(crate) struct LongLists {
    lists: Lists,
    /// Which of them each facet has, from 1, or 0.
    of: Vec<u32>,
    among: FacetMembers,
}

impl<P: Point> Chooser<P> {
    /// Finds the members of every facet with a long list.
    pub(crate) fn begin(&mut self, listed: Listed<'_, P>) {
        let Self { members, long: LongLists { lists, of, among }, .. } = self;
        refill(members, repeat_n(0, listed.starts.len()));
        lists.clear();
        refill(of, repeat_n(0, listed.starts.len()));
        for at in 0..listed.starts.len() {
            let list = listed.lists.get(at);
            if list.len() > LISTED {
                among.of_long(listed.diagram.seeds, &listed.facets.corners(at), list);
                lists.push(among.seeds.iter().copied());
                of[at] = lists.len() as u32;
                let n = among.seeds.len();
                members[at] = if n <= MEMBERS { (1 << n) - 1 } else { 0 };
            }
        }
    }
}

impl LongLists {
    /// The list in which the bits of a facet's `members` count.
    #[inline(always)]
    pub(crate) fn list<'a, P: Point>(&'a self, listed: Listed<'a, P>, at: usize) -> &'a [u32] {
        match self.of[at] {
            0 => listed.lists.get(at),
            k => self.lists.get(k as usize - 1),
        }
    }

    /// One facet's members in the order of their numbers; `members` has their bits, if its list is not long.
    pub(crate) fn among<P: Point>(&mut self, listed: Listed<'_, P>, at: usize, members: u32) -> &FacetMembers {
        let mut among = std::mem::take(&mut self.among);
        let all = self.of[at] != 0;
        let chosen = self.list(listed, at).iter().enumerate().filter(|(k, _)| all || members >> k & 1 != 0);
        refill(&mut among.seeds, chosen.map(|(_, &seed)| seed));
        among.seeds.sort_unstable();
        self.among = among;
        &self.among
    }
}

/// Finds the members of every other facet with a list.
#[inline(always)]
pub(crate) fn choose_members<S: Simd, P: Point>(simd: S, chooser: &mut Chooser<P>, listed: Listed<'_, P>) {
    let Chooser { facets, in_turn, groups, members, .. } = chooser;
    groups.sort(LISTED, (0..listed.starts.len()).map(|at| listed.lists.get(at).len()));
    for &at in groups.of(1) {
        members[at as usize] = 1;
    }
    for n in 2..=LISTED {
        for turn in InTurn::<P>::turns(groups.of(n), Number::<S>::LANES) {
            if let Some(group) = turn.set {
                set_lists::<S, P>(in_turn.next(&turn), group, listed, n);
            }
            if let Some(group) = turn.read {
                let chosen = facets.choose(simd, n, in_turn.present(&turn));
                for (&at, chosen) in group.iter().zip(chosen) {
                    members[at as usize] = chosen;
                }
            }
        }
    }
}

/// Puts a group of facets with lists of `n` seeds into lanes; the last one fills those that are left.
#[inline(always)]
fn set_lists<S: Simd, P: Point>(given: &mut Given<P>, group: &[u32], listed: Listed<'_, P>, n: usize) {
    let Listed { diagram, facets, lists, .. } = listed;
    for lane in 0..Number::<S>::LANES {
        let at = group[lane.min(group.len() - 1)];
        given.set_facet(lane, &facets.vertices(at as usize));
        for (k, &seed) in lists.get(at as usize).iter().enumerate().take(n) {
            given.set_seed(lane, k, diagram.seeds[seed as usize]);
        }
    }
}

/// Lists without those that others beat whatever way they move.
pub(crate) struct Prune<'a, P: Point> {
    pub chooser: &'a mut Chooser<P>,
    pub listed: Listed<'a, P>,
    pub skin: Skin<'a>,
    pub out: &'a mut Lists,
}

impl<P: Point> WithSimd for Prune<'_, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { chooser: Chooser { facets, in_turn, groups, members, .. }, listed, skin, out } = self;
        let Listed { starts, lists, .. } = listed;
        refill(members, repeat_n(!0, starts.len()));
        groups.sort(LISTED, (0..starts.len()).map(|at| lists.get(at).len()));
        for n in 2..=LISTED {
            for turn in InTurn::<P>::turns(groups.of(n), Number::<S>::LANES) {
                if let Some(group) = turn.set {
                    let given = in_turn.next(&turn);
                    set_lists::<S, P>(given, group, listed, n);
                    for lane in 0..Number::<S>::LANES {
                        let at = group[lane.min(group.len() - 1)];
                        for (k, &seed) in lists.get(at as usize).iter().enumerate().take(n) {
                            given.set_skin(lane, k, skin.of(seed));
                        }
                    }
                }
                if let Some(group) = turn.read {
                    let chosen = facets.choose_with_skin(simd, n, in_turn.present(&turn));
                    for (&at, chosen) in group.iter().zip(chosen) {
                        members[at as usize] = chosen;
                    }
                }
            }
        }
        out.clear();
        for (at, &members) in members.iter().enumerate() {
            let list = lists.get(at);
            let kept = |k: usize| list.len() > LISTED || members >> k & 1 != 0;
            out.push(list.iter().enumerate().filter(|(k, _)| kept(*k)).map(|(_, &seed)| seed));
        }
    }
}

/// The members of one facet.
#[derive(Default)]
pub(crate) struct FacetMembers {
    /// In the order of their numbers.
    pub seeds: Vec<u32>,
    squared: Vec<[f64; 3]>,
}

impl FacetMembers {
    fn of_long<P: Point>(&mut self, seeds: &[P], corner: &[P; 3], list: &[u32]) {
        refill(&mut self.squared, list.iter().map(|&j| corner.map(|q| seeds[j as usize].distance_squared(q))));
        // One after the other would not be sooner: few are beaten.
        let beaten = |mine: [f64; 3]| self.squared.iter().fold(false, |beaten, by| beaten | beats(*by, mine));
        let left = list.iter().zip(&self.squared).filter(|(_, squared)| !beaten(**squared));
        refill(&mut self.seeds, left.map(|(&seed, _)| seed));
        self.seeds.sort_unstable();
    }

    /// The one that is nearest to a point, the lowest of several.
    pub(crate) fn nearest<P: Point>(&self, diagram: Diagram<'_, P>, p: P) -> u32 {
        let key = |i: u32| p.distance_squared(diagram.seeds[i as usize]);
        self.seeds.iter().copied().min_by(|&a, &b| key(a).total_cmp(&key(b))).unwrap_or_default()
    }
}
