//! The lists of a task's facets.
//!
//! Purpose: lists of all facets, by rows of neighbours or, where seeds are spread evenly, without; and for a pass with
//! strays the kept list of each facet that no stray has to do with, and a new one of each other.
//! Invariant: no seed that counts is missing from a list: neither one within its slack that a seed within its own does
//! not beat at all corners, nor a stray that such a one does not beat.
//! Must not know: what becomes of a list.

use glam::DVec3;
use pulp::{Arch, Simd, WithSimd};

use super::around::{Around, GROUP};
use super::facets::LISTED;
use super::gather::{Few, Gatherer, Slack};
use super::groups::Listed;
use super::lists::{Kept, Lists};
use super::strays::Reach;
use crate::rvd::incident::Diagram;

/// One thread's scratch memory.
#[derive(Default)]
pub(super) struct Lister {
    gatherer: Gatherer,
    around: Around,
    reaches: Vec<Reach>,
    near: Vec<DVec3>,
    /// Facets of a group that need a new list.
    strayed: Vec<u32>,
}

/// Lists of facets without rows.
struct Evenly<'a> {
    lister: &'a mut Lister,
    diagram: Diagram<'a>,
    slack: Slack<'a>,
    facets: &'a [u32],
    starts: &'a mut [u32],
    out: &'a mut Lists,
}

/// Lists for one pass with strays.
struct Relist<'a> {
    lister: &'a mut Lister,
    listed: Listed<'a>,
    was: Diagram<'a>,
    kept: Kept<'a>,
    out: &'a mut Lists,
}

impl WithSimd for Evenly<'_> {
    type Output = Option<u64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<u64> {
        let Self { lister: Lister { gatherer, around, reaches, .. }, diagram, slack, facets, starts, out } = self;
        let mut unlisted = 0;
        for (facets, starts) in facets.chunks(GROUP).zip(starts.chunks_mut(GROUP)) {
            reaches.clear();
            reaches.extend(facets.iter().zip(&*starts).map(|(&f, &start)| Reach::of(diagram, slack, f, start)));
            let mut done = 0;
            if around.look(diagram, slack.same, reaches, None) {
                around.each(simd, reaches, |k, seeds| {
                    // One after the other; what comes after one that has too many is left.
                    if done == k && seeds.len() <= LISTED {
                        let centroid = diagram.surface.centroid(facets[k]);
                        let mut least = f64::INFINITY;
                        seeds.each(|seed, p| {
                            out.add(seed);
                            let distance = centroid.distance_squared(p);
                            if distance < least {
                                (starts[k], least) = (seed, distance);
                            }
                        });
                        out.end();
                        done += 1;
                    }
                });
            }
            for k in done..facets.len() {
                let corner = diagram.surface.corners(facets[k]);
                starts[k] = diagram.index.nearest(diagram.surface.centroid(facets[k]));
                let mut few = gatherer.gather_from(diagram, (slack, Few::TO_WALK), &corner, starts[k]);
                if !few && !slack.is_none() {
                    // Whether there are too many does not depend on what was before.
                    unlisted += 1;
                    few = gatherer.gather_from(diagram, (Slack::NONE, Few::TO_WALK), &corner, starts[k]);
                }
                if !few {
                    return None;
                }
                out.push(gatherer.list().iter().copied());
            }
        }
        Some(unlisted)
    }
}

impl WithSimd for Relist<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let Self { lister, listed: Listed { facets, starts, lists, .. }, was, kept, out } = self;
        let Lister { gatherer, around, reaches, near, strayed } = lister;
        let Kept { slack, strays, even, .. } = kept;
        for (first, bounds) in (0..facets.len()).step_by(GROUP).zip(&lists.bounds) {
            near.clear();
            near.extend(strays.within(*bounds).map(|(p, _)| p));
            strayed.clear();
            reaches.clear();
            let group = first..facets.len().min(first + GROUP);
            for at in group.clone() {
                let (list, start) = (lists.get(at), starts[at]);
                let mut from = start;
                // Where the start is a stray, the bounds say nothing.
                let mut astray = strays.contains(start) || list.iter().any(|&seed| strays.contains(seed));
                if astray {
                    match steady(was, kept, facets[at], start, list) {
                        Some(seed) => from = seed,
                        None => return false,
                    }
                } else if !near.is_empty() {
                    let reach = Reach::of(was, slack, facets[at], start);
                    astray = near.iter().any(|&p| reach.holds(p));
                }
                if astray {
                    strayed.push(at as u32);
                    reaches.push(Reach::of(was, slack, facets[at], from));
                    if !even && !gatherer.gather_from(was, (slack, Few::TO_WALK), &reaches[0].corner, from) {
                        return false;
                    }
                }
                if !even {
                    if let [reach] = reaches[..] {
                        let all = gatherer.list().iter().copied().filter(|&seed| !strays.contains(seed));
                        let new = strays.within(reach.bounds()).filter(|(p, _)| reach.holds(*p));
                        out.push(all.chain(new.map(|(_, seed)| seed)));
                        reaches.clear();
                    } else {
                        out.push(list.iter().copied());
                    }
                }
            }
            if !even {
                continue;
            }
            if strayed.is_empty() {
                group.for_each(|at| out.push(lists.get(at).iter().copied()));
                continue;
            }
            if !around.look(was, slack.same, reaches, Some(strays)) {
                return false;
            }
            let mut next = first;
            around.each(simd, reaches, |k, seeds| {
                let at = strayed[k] as usize;
                (next..at).for_each(|at| out.push(lists.get(at).iter().copied()));
                seeds.each(|seed, _| out.add(seed));
                out.end();
                next = at + 1;
            });
            (next..group.end).for_each(|at| out.push(lists.get(at).iter().copied()));
        }
        true
    }
}

/// A seed within its slack from which to see a facet: the one it starts with, or the nearest on its list.
fn steady(was: Diagram<'_>, kept: Kept<'_>, facet: u32, start: u32, list: &[u32]) -> Option<u32> {
    if !kept.strays.contains(start) {
        return Some(start);
    }
    let centroid = was.surface.centroid(facet);
    let distance = |seed: u32| centroid.distance_squared(was.seeds[seed as usize]);
    let steady = list.iter().copied().filter(|&seed| !kept.strays.contains(seed));
    steady.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
}

impl Lister {
    /// Lists of all facets by rows of neighbours; `starts` become seeds near them. A facet with too many gets an empty
    /// list. Returns how many get none that can be kept.
    pub(super) fn list(
        &mut self,
        diagram: Diagram<'_>,
        slack: Slack<'_>,
        by_rows: bool,
        (facets, starts): (&[u32], &mut [u32]),
        out: &mut Lists,
    ) -> u64 {
        let most = if by_rows { Few::TO_DIVIDE } else { Few::TO_WALK };
        let gatherer = &mut self.gatherer;
        let mut unlisted = 0;
        for (&facet, start) in facets.iter().zip(starts) {
            let corner = diagram.surface.corners(facet);
            let centroid = diagram.surface.centroid(facet);
            let (nearest, mut few) = gatherer.gather(diagram, (slack, most), &corner, centroid, *start);
            *start = nearest;
            if !few && !slack.is_none() {
                // Whether there are too many does not depend on what was before.
                unlisted += 1;
                (_, few) = gatherer.gather(diagram, (Slack::NONE, most), &corner, centroid, *start);
            }
            out.push(gatherer.list().iter().copied().take(if few { usize::MAX } else { 0 }));
        }
        unlisted
    }

    /// The same without rows. `None` if a facet has too many.
    pub(super) fn list_evenly(
        &mut self,
        diagram: Diagram<'_>,
        slack: Slack<'_>,
        (facets, starts): (&[u32], &mut [u32]),
        out: &mut Lists,
    ) -> Option<u64> {
        Arch::new().dispatch(Evenly { lister: self, diagram, slack, facets, starts, out })
    }

    /// Lists of all facets for one pass with strays, with the diagram as it was when `listed` were made. Returns whether
    /// it could.
    pub(super) fn relist(&mut self, listed: Listed<'_>, was: Diagram<'_>, kept: Kept<'_>, out: &mut Lists) -> bool {
        out.clear();
        Arch::new().dispatch(Relist { lister: self, listed, was, kept, out })
    }
}
