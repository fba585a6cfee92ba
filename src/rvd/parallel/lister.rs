//! The lists of a task's facets.
//!
//! Purpose: lists of all facets, by rows of neighbours or, where seeds are spread evenly, without; and for a pass with
//! strays the kept list of each facet that no stray has to do with, and a new one of each other.
//! Invariant: no seed that counts is missing from a list: neither one within its slack that a seed within its own does
//! not beat at all corners, nor a stray that such a one does not beat.
//! Must not know: what becomes of a list.

use std::ops::Range;

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};

use super::around::{self, Around, GROUP};
use super::facets::LISTED;
use super::gather::{Few, Gatherer, Slack};
use super::groups::Listed;
use super::lists::{Kept, Lists};
use super::order::Stretch;
use super::strays::{Bounds, Reach};
use crate::rvd::incident::Diagram;

/// Seeds that are looked at for one within its slack,
const LOOKED_AT: usize = 1024;
/// and how often farther away.
const WIDENED: usize = 6;

/// One thread's scratch memory.
#[derive(Default)]
pub(super) struct Lister {
    gatherer: Gatherer,
    around: Around,
    reaches: Vec<Reach>,
    /// How many facets are looked around together.
    parts: Vec<usize>,
    /// Strays near the facets, and where strays were.
    near: Vec<DVec3>,
    were: Vec<DVec3>,
    /// Those near a group of facets.
    nearer: Vec<DVec3>,
    /// Facets of a group that need a new list, and the seed from which each is seen.
    strayed: Vec<usize>,
    from: Vec<u32>,
    seeds: Vec<u32>,
}

/// Lists of facets without rows.
struct Evenly<'a> {
    lister: &'a mut Lister,
    diagram: Diagram<'a>,
    slack: Slack<'a>,
    facets: Stretch<'a>,
    starts: &'a mut [u32],
    out: &'a mut Lists,
}

/// Lists for one pass with strays.
struct Relist<'a> {
    lister: &'a mut Lister,
    listed: Listed<'a>,
    /// The diagram as it was when those were made.
    was: Diagram<'a>,
    kept: Kept<'a>,
    out: &'a mut Lists,
}

impl WithSimd for Evenly<'_> {
    type Output = Option<u64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<u64> {
        let Self { lister, diagram, slack, facets, starts, out } = self;
        let Lister { gatherer, around, reaches, parts, .. } = lister;
        let mut unlisted = 0;
        for (facets, starts) in facets.chunks(GROUP).zip(starts.chunks_mut(GROUP)) {
            reaches.clear();
            reaches.extend((0..).zip(&*starts).map(|(k, &start)| Reach::of(diagram, slack, &facets.corners(k), start)));
            parts.clear();
            let mut bounds = around::parts(reaches, parts);
            // A facet with too many is listed alone.
            let mut alone = |k: usize, start: &mut u32, out: &mut Lists| {
                let corner = facets.corners(k);
                *start = diagram.index.nearest(facets.centroid(k));
                let mut few = gatherer.gather_from(diagram, (slack, Few::TO_WALK), &corner, *start);
                if !few && !slack.is_none() {
                    // Whether there are too many does not depend on what was before.
                    unlisted += 1;
                    few = gatherer.gather_from(diagram, (Slack::NONE, Few::TO_WALK), &corner, *start);
                }
                out.push(gatherer.list().iter().copied());
                bounds = bounds.with(Reach::of(diagram, slack, &corner, *start).bounds());
                few
            };
            let (mut done, mut first) = (true, 0);
            for &part in &*parts {
                let reaches = &reaches[first..first + part];
                if around.look(diagram, slack, reaches, None) {
                    around.each(simd, reaches, |k, seeds| {
                        if seeds.len() > LISTED {
                            done &= alone(first + k, &mut starts[first + k], out);
                            return;
                        }
                        seeds.write(out.end(seeds.len()));
                        if let Some(nearest) = seeds.nearest() {
                            starts[first + k] = nearest;
                        }
                    });
                } else {
                    (first..first + part).for_each(|k| done &= alone(k, &mut starts[k], out));
                }
                first += part;
            }
            if !done {
                return None;
            }
            out.bounds.push(bounds);
        }
        Some(unlisted)
    }
}

impl WithSimd for Relist<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> bool {
        let facets = self.listed.facets.len();
        for (first, bounds) in (0..facets).step_by(GROUP).zip(&self.listed.lists.bounds) {
            let group = first..facets.min(first + GROUP);
            let about = self.kept.strays.about(*bounds);
            let Lister { near, were, nearer, .. } = &mut *self.lister;
            nearer.clear();
            nearer.extend(near.iter().filter(|&&p| bounds.contains(p)));
            if nearer.is_empty() && !were.iter().any(|&p| about.contains(p)) {
                self.out.copy(self.listed.lists, group);
            } else if !self.group(simd, group) {
                return false;
            }
        }
        true
    }
}

impl Relist<'_> {
    /// Lists of a group that strays have to do with. Returns whether it could.
    #[inline(always)]
    fn group<S: Simd>(&mut self, simd: S, group: Range<usize>) -> bool {
        let Self { lister, listed: Listed { facets, starts, lists, .. }, was, kept, out } = self;
        let Kept { slack, strays, even, .. } = *kept;
        lister.strayed.clear();
        lister.reaches.clear();
        lister.from.clear();
        for at in group.clone() {
            let (list, start) = (lists.get(at), starts[at]);
            if strays.contains(start) || list.iter().any(|&seed| strays.contains(seed)) {
                let Some(from) = steady(*was, *kept, facets.centroid(at), (start, list), &mut lister.seeds) else {
                    return false;
                };
                lister.reaches.push(Reach::of(*was, slack, &facets.corners(at), from));
                lister.from.push(from);
            } else if !lister.nearer.is_empty() {
                let reach = Reach::of(*was, slack, &facets.corners(at), start);
                if !lister.nearer.iter().any(|&p| reach.holds(p)) {
                    continue;
                }
                lister.reaches.push(reach);
                lister.from.push(start);
            } else {
                continue;
            }
            lister.strayed.push(at);
        }
        let Lister { gatherer, around, reaches, strayed, from, .. } = &mut **lister;
        let mut next = group.start;
        // Facets that are too far apart go one by one.
        if even && !reaches.is_empty() && around.look(*was, slack, reaches, Some(strays)) {
            around.each(simd, reaches, |k, seeds| {
                out.copy(lists, next..strayed[k]);
                seeds.write(out.end(seeds.len()));
                next = strayed[k] + 1;
            });
        } else {
            for ((&at, reach), &from) in strayed.iter().zip(&*reaches).zip(&*from) {
                if !gatherer.gather_from(*was, (slack, Few::TO_WALK), &reach.corner, from) {
                    return false;
                }
                out.copy(lists, next..at);
                let steady = gatherer.list().iter().copied().filter(|&seed| !strays.contains(seed));
                let new = strays.within(reach.bounds()).filter(|(p, _)| reach.holds(*p));
                out.push(steady.chain(new.map(|(_, seed)| seed)));
                next = at + 1;
            }
        }
        out.copy(lists, next..group.end);
        true
    }
}

/// A seed within its slack from which to see a facet with this centroid: the one it starts with, the nearest on its list,
/// or one around the one it starts with. `near` is scratch memory.
fn steady(
    was: Diagram<'_>,
    kept: Kept<'_>,
    centroid: DVec3,
    (start, list): (u32, &[u32]),
    near: &mut Vec<u32>,
) -> Option<u32> {
    if !kept.strays.contains(start) {
        return Some(start);
    }
    let distance = |seed: u32| centroid.distance_squared(was.seeds[seed as usize]);
    let nearest = |seeds: &[u32]| {
        let steady = seeds.iter().copied().filter(|&seed| !kept.strays.contains(seed));
        steady.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
    };
    // All of a list are strays where a facet lies deep in a cell.
    nearest(list).or_else(|| nearest(was.table.row(start).0)).or_else(|| {
        let mut reach = distance(start).sqrt() + kept.slack.of(start);
        for _ in 0..WIDENED {
            near.clear();
            if !was.index.in_box(centroid - reach, centroid + reach, LOOKED_AT, near) {
                return None;
            }
            if let Some(seed) = nearest(near) {
                return Some(seed);
            }
            reach *= 2.0;
        }
        None
    })
}

impl Lister {
    /// Lists of all facets by rows of neighbours; `starts` become seeds near them. A facet with too many gets an empty
    /// list. Returns how many get none that can be kept.
    pub(super) fn list(
        &mut self,
        diagram: Diagram<'_>,
        slack: Slack<'_>,
        by_rows: bool,
        (facets, starts): (Stretch<'_>, &mut [u32]),
        out: &mut Lists,
    ) -> u64 {
        let most = if by_rows { Few::TO_DIVIDE } else { Few::TO_WALK };
        let gatherer = &mut self.gatherer;
        let mut unlisted = 0;
        for (at, start) in starts.iter_mut().enumerate() {
            let (corner, centroid) = (facets.corners(at), facets.centroid(at));
            let (nearest, mut few) = gatherer.gather(diagram, (slack, most), &corner, centroid, *start);
            *start = nearest;
            if !few && !slack.is_none() {
                // Whether there are too many does not depend on what was before.
                unlisted += 1;
                (_, few) = gatherer.gather(diagram, (Slack::NONE, most), &corner, centroid, *start);
            }
            out.push(gatherer.list().iter().copied().take(if few { usize::MAX } else { 0 }));
        }
        if !slack.is_none() {
            out.bounds.extend(facets.chunks(GROUP).zip(starts.chunks(GROUP)).map(|(facets, starts)| {
                let each = (0..).zip(starts).map(|(k, &start)| Reach::of(diagram, slack, &facets.corners(k), start));
                each.fold(Bounds::NONE, |all, reach| all.with(reach.bounds()))
            }));
        }
        unlisted
    }

    /// The same without rows. `None` if a facet has too many.
    pub(super) fn list_evenly(
        &mut self,
        diagram: Diagram<'_>,
        slack: Slack<'_>,
        (facets, starts): (Stretch<'_>, &mut [u32]),
        out: &mut Lists,
    ) -> Option<u64> {
        Arch::new().dispatch(Evenly { lister: self, diagram, slack, facets, starts, out })
    }

    /// Whether strays have to do with the facets. If so, they are to be [relisted](Self::relist).
    pub(super) fn strayed(&mut self, lists: &Lists, kept: Kept<'_>) -> bool {
        let bounds = lists.bounds.iter().fold(Bounds::NONE, |all, &bounds| all.with(bounds));
        self.near.clear();
        self.near.extend(kept.strays.within(bounds).map(|(p, _)| p));
        self.were.clear();
        self.were.extend(kept.strays.were_within(bounds));
        !self.near.is_empty() || !self.were.is_empty()
    }

    /// Lists of all facets for one pass with strays, with the diagram as it was when `listed` were made. Returns whether
    /// it could.
    pub(super) fn relist(&mut self, listed: Listed<'_>, was: Diagram<'_>, kept: Kept<'_>, out: &mut Lists) -> bool {
        out.clear();
        Arch::new().dispatch(Relist { lister: self, listed, was, kept, out })
    }
}
