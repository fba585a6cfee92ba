//! The lists of a task's facets.
//!
//! Purpose: lists of all facets, by rows of neighbours or, where seeds are spread evenly, without. For a pass with escaped seeds
//! it takes the Verlet list of each facet that none concerns, and makes a new one for each other facet.
//! Invariant: no seed that counts is missing from a list: neither one within its skin that a seed within its own does
//! not beat at all corners, nor an escaped seed that such a one does not beat. Must not know: what becomes of a list.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use super::escaped::{Bounds, Reach};
use super::gather::{Few, Gatherer, Search, Skin};
use super::neighbourhood::{self, GROUP, Neighbourhood};
use super::{Lists, members::Listed, verlet::Verlet};
use crate::knn::Point;
use crate::rvd::parallel::{divide::facets::LISTED, order::Stretch};
use crate::rvd::{incident::Diagram, refill};

/// Seeds to examine for one seed within its skin.
const LOOKED_AT: usize = 1024;
const WIDENED: usize = 6;

#[derive(Default)]
pub(crate) struct ListBuilder<P: Point> {
    gatherer: Gatherer<P>,
    neighbourhood: Neighbourhood<P>,
    reaches: Vec<Reach<P>>,
    /// How many facets are looked around together.
    parts: Vec<usize>,
    /// Escaped seeds near the facets, and where escaped seeds were.
    near: Vec<P>,
    were: Vec<P>,
    /// Those near a group of facets.
    nearer: Vec<P>,
    /// Facets of a group that need a new list, and the seed from which each is seen.
    renewed: Vec<usize>,
    from: Vec<u32>,
    seeds: Vec<u32>,
}

struct Evenly<'a, P: Point> {
    builder: &'a mut ListBuilder<P>,
    diagram: Diagram<'a, P>,
    skin: Skin<'a>,
    facets: Stretch<'a, P>,
    starts: &'a mut [u32],
    out: &'a mut Lists,
}

struct Renew<'a, P: Point> {
    builder: &'a mut ListBuilder<P>,
    listed: Listed<'a, P>,
    /// The diagram as it was when those were made.
    was: Diagram<'a, P>,
    verlet: Verlet<'a, P>,
    out: &'a mut Lists,
}

impl<P: Point> WithSimd for Evenly<'_, P> {
    type Output = Option<u64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<u64> {
        let Self { builder, diagram, skin, facets, starts, out } = self;
        let ListBuilder { gatherer, neighbourhood, reaches, parts, .. } = builder;
        let search = Search { diagram, skin, few: Few::TO_WALK };
        let mut unlisted = 0;
        for (facets, starts) in facets.chunks(GROUP).zip(starts.chunks_mut(GROUP)) {
            reaches.clear();
            reaches.extend((0..).zip(&*starts).map(|(k, &start)| Reach::of(diagram, skin, &facets.corners(k), start)));
            parts.clear();
            let mut bounds = neighbourhood::parts(reaches, parts);
            // A facet with too many is listed alone.
            let mut alone = |k: usize, start: &mut u32, out: &mut Lists| {
                let corner = facets.corners(k);
                *start = diagram.index.nearest(facets.centroid(k));
                let mut few = gatherer.gather_from(search, &corner, *start);
                if !few && !skin.is_none() {
                    // Whether there are too many does not depend on what was before.
                    unlisted += 1;
                    few = gatherer.gather_from(Search { skin: Skin::NONE, ..search }, &corner, *start);
                }
                out.push(gatherer.list.iter().copied());
                bounds = bounds.with(Reach::of(diagram, skin, &corner, *start).bounds());
                few
            };
            let (mut done, mut first) = (true, 0);
            for &part in &*parts {
                let reaches = &reaches[first..first + part];
                if neighbourhood.search(diagram, skin, reaches, None) {
                    neighbourhood.each(simd, reaches, |k, seeds| {
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

impl<P: Point> WithSimd for Renew<'_, P> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) -> bool {
        let facets = self.listed.facets.len();
        for (first, bounds) in (0..facets).step_by(GROUP).zip(&self.listed.lists.bounds) {
            let group = first..facets.min(first + GROUP);
            let about = self.verlet.escaped.about(*bounds);
            let ListBuilder { near, were, nearer, .. } = &mut *self.builder;
            nearer.clear();
            nearer.extend(near.iter().filter(|p| bounds.contains(p.place())));
            if nearer.is_empty() && !were.iter().any(|p| about.contains(p.place())) {
                self.out.copy(self.listed.lists, group);
            } else if !self.group(simd, group) {
                return false;
            }
        }
        true
    }
}

impl<P: Point> Renew<'_, P> {
    /// Lists of a group that escaped seeds have to do with. Returns whether it could.
    #[inline(always)]
    fn group<S: Simd>(&mut self, simd: S, group: Range<usize>) -> bool {
        let Self { builder, listed: Listed { facets, starts, lists, .. }, was, verlet, out } = self;
        let Verlet { skin, escaped, even, .. } = *verlet;
        builder.renewed.clear();
        builder.reaches.clear();
        builder.from.clear();
        for at in group.clone() {
            let (list, start) = (lists.get(at), starts[at]);
            if escaped.contains(start) || list.iter().any(|&seed| escaped.contains(seed)) {
                let Some(from) = steady(*was, *verlet, facets.centroid(at), (start, list), &mut builder.seeds) else {
                    return false;
                };
                builder.reaches.push(Reach::of(*was, skin, &facets.corners(at), from));
                builder.from.push(from);
            } else if !builder.nearer.is_empty() {
                let reach = Reach::of(*was, skin, &facets.corners(at), start);
                if !builder.nearer.iter().any(|&p| reach.holds(p)) {
                    continue;
                }
                builder.reaches.push(reach);
                builder.from.push(start);
            } else {
                continue;
            }
            builder.renewed.push(at);
        }
        let ListBuilder { gatherer, neighbourhood, reaches, renewed, from, .. } = &mut **builder;
        let mut next = group.start;
        // Facets that are too far apart go one by one.
        if even && !reaches.is_empty() && neighbourhood.search(*was, skin, reaches, Some(escaped)) {
            neighbourhood.each(simd, reaches, |k, seeds| {
                out.copy(lists, next..renewed[k]);
                seeds.write(out.end(seeds.len()));
                next = renewed[k] + 1;
            });
        } else {
            for ((&at, reach), &from) in renewed.iter().zip(&*reaches).zip(&*from) {
                let search = Search { diagram: *was, skin, few: Few::TO_WALK };
                if !gatherer.gather_from(search, &reach.corner, from) {
                    return false;
                }
                out.copy(lists, next..at);
                let steady = gatherer.list.iter().copied().filter(|&seed| !escaped.contains(seed));
                let new = escaped.within(reach.bounds()).filter(|(p, _)| reach.holds(*p));
                out.push(steady.chain(new.map(|(_, seed)| seed)));
                next = at + 1;
            }
        }
        out.copy(lists, next..group.end);
        true
    }
}

/// A seed within its skin from which to see a facet with this centroid: the one it starts with, the nearest on its list,
/// or one around the one it starts with. `near` is scratch memory.
fn steady<P: Point>(
    was: Diagram<'_, P>,
    verlet: Verlet<'_, P>,
    centroid: P,
    (start, list): (u32, &[u32]),
    near: &mut Vec<u32>,
) -> Option<u32> {
    if !verlet.escaped.contains(start) {
        return Some(start);
    }
    let distance = |seed: u32| centroid.distance_squared(was.seeds[seed as usize]);
    let nearest = |seeds: &[u32]| {
        let steady = seeds.iter().copied().filter(|&seed| !verlet.escaped.contains(seed));
        steady.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
    };
    // All of a list have escaped where a facet lies deep in a cell.
    nearest(list).or_else(|| nearest(was.table.row(start).0)).or_else(|| {
        let mut reach = distance(start).sqrt() + verlet.skin.of(start);
        for _ in 0..WIDENED {
            near.clear();
            if !was.index.in_box(centroid.place() - reach, centroid.place() + reach, LOOKED_AT, near) {
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

impl<P: Point> ListBuilder<P> {
    /// Lists by rows of neighbours, empty where they are too long; `starts` get near seeds. Returns how many are no Verlet list.
    pub(crate) fn list(
        &mut self,
        diagram: Diagram<'_, P>,
        skin: Skin<'_>,
        by_rows: bool,
        (facets, starts): (Stretch<'_, P>, &mut [u32]),
        out: &mut Lists,
    ) -> u64 {
        let search = Search { diagram, skin, few: if by_rows { Few::TO_DIVIDE } else { Few::TO_WALK } };
        let gatherer = &mut self.gatherer;
        let mut unlisted = 0;
        for (at, start) in starts.iter_mut().enumerate() {
            let (corner, centroid) = (facets.corners(at), facets.centroid(at));
            let (nearest, mut few) = gatherer.gather(search, &corner, centroid, *start);
            *start = nearest;
            if !few && !skin.is_none() {
                // Whether there are too many does not depend on what was before.
                unlisted += 1;
                (_, few) = gatherer.gather(Search { skin: Skin::NONE, ..search }, &corner, centroid, *start);
            }
            out.push(gatherer.list.iter().copied().take(if few { usize::MAX } else { 0 }));
        }
        if !skin.is_none() {
            out.bounds.extend(facets.chunks(GROUP).zip(starts.chunks(GROUP)).map(|(facets, starts)| {
                let each = (0..).zip(starts).map(|(k, &start)| Reach::of(diagram, skin, &facets.corners(k), start));
                each.fold(Bounds::NONE, |all, reach| all.with(reach.bounds()))
            }));
        }
        unlisted
    }

    /// The same without rows. `None` if a facet has too many.
    pub(crate) fn list_evenly(
        &mut self,
        diagram: Diagram<'_, P>,
        skin: Skin<'_>,
        (facets, starts): (Stretch<'_, P>, &mut [u32]),
        out: &mut Lists,
    ) -> Option<u64> {
        Arch::new().dispatch(Evenly { builder: self, diagram, skin, facets, starts, out })
    }

    /// Whether escaped seeds concern the facets. If so, [`Self::renew`] makes lists for this pass.
    pub(crate) fn meets_escaped(&mut self, lists: &Lists, verlet: Verlet<'_, P>) -> bool {
        let bounds = lists.bounds.iter().fold(Bounds::NONE, |all, &bounds| all.with(bounds));
        refill(&mut self.near, verlet.escaped.within(bounds).map(|(p, _)| p));
        refill(&mut self.were, verlet.escaped.were_within(bounds));
        !self.near.is_empty() || !self.were.is_empty()
    }

    /// Lists for one pass with escaped seeds, with the diagram as it was when `listed` were made. Returns whether it could.
    pub(crate) fn renew(
        &mut self,
        listed: Listed<'_, P>,
        was: Diagram<'_, P>,
        verlet: Verlet<'_, P>,
        out: &mut Lists,
    ) -> bool {
        out.clear();
        Arch::new().dispatch(Renew { builder: self, listed, was, verlet, out })
    }
}
