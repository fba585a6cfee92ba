//! How far the vertices of the input are from the result.
//!
//! Purpose: [`Offsets`] knows for every vertex of the input the nearest facet around its own result vertex, and
//! keeps up while the result changes in places.
//! Invariant: the same whatever the number of threads. Must not know: how the result is changed.

use glam::DVec3;
use rayon::prelude::*;

use super::fan::Fan;
use super::triangle::perimeter;
use crate::mesh::csr::Csr;
use crate::token::Token;

/// A vertex of the input.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tip {
    /// Where it is.
    pub(super) position: DVec3,
    /// A result vertex; the nearest facet is one of those around it.
    pub(super) vertex: u32,
}

/// Where a tip is, seen from the result.
#[derive(Clone, Copy, Debug)]
pub(super) struct Offset {
    /// From the nearest facet.
    pub(super) distance: f64,
    /// That as a share of the facet's mean edge.
    pub(super) share: f64,
    /// The nearest facet, and its corner nearest to the tip.
    pub(super) facet: u32,
    pub(super) corner: u32,
}

/// A result vertex has no facets; nothing is known.
const NOWHERE: Offset = Offset { distance: 0.0, share: 0.0, facet: 0, corner: 0 };

/// A tip sticks out if it is farther from the facets than this share of an edge.
pub(super) const TIP: f64 = 0.08;

/// Vertices that are one task.
const RUN: usize = 256;
/// Tips between two looks at the token.
const ASKED: usize = 64;

/// See the module's head.
pub(super) struct Offsets<'a> {
    pub(super) tips: &'a Csr<Tip>,
    list: Vec<Offset>,
}

fn offset(positions: &[DVec3], facets: &[[u32; 3]], fan: &mut Fan, tip: &Tip) -> Offset {
    let found = fan.nearest(tip.position);
    let Some(&t) = facets.get(found.facet as usize) else { return NOWHERE };
    let p = t.map(|v| positions[v as usize]);
    let edge = perimeter(p) / 3.0;
    let to = p.map(|q| q.distance_squared(tip.position));
    let corner = if to[0] <= to[1] && to[0] <= to[2] {
        t[0]
    } else if to[1] <= to[2] {
        t[1]
    } else {
        t[2]
    };
    let distance = found.squared.sqrt();
    Offset { distance, share: if edge > 0.0 { distance / edge } else { 0.0 }, facet: found.facet, corner }
}

impl<'a> Offsets<'a> {
    /// Looks at all of them.
    pub(super) fn new(
        positions: &[DVec3],
        facets: &[[u32; 3]],
        around: &Csr<u32>,
        tips: &'a Csr<Tip>,
        token: &Token,
    ) -> Self {
        let mut offsets = Self { tips, list: vec![NOWHERE; tips.all().len()] };
        offsets.look(positions, facets, around, |_| true, token);
        offsets
    }

    /// Looks again at those of vertices for which `changed` says so: itself or a neighbour has moved, or its facets are
    /// others.
    pub(super) fn look(
        &mut self,
        positions: &[DVec3],
        facets: &[[u32; 3]],
        around: &Csr<u32>,
        changed: impl Fn(u32) -> bool + Sync,
        token: &Token,
    ) {
        let tips = self.tips;
        // Runs of vertices, each with its part of the list.
        let mut runs = Vec::with_capacity(positions.len() / RUN + 1);
        let mut rest = self.list.as_mut_slice();
        for begin in (0..positions.len()).step_by(RUN) {
            let vertices = begin as u32..(begin + RUN).min(positions.len()) as u32;
            let count = tips.range(vertices.end - 1).end - tips.range(vertices.start).start;
            let (here, after) = rest.split_at_mut(count);
            rest = after;
            runs.push((vertices, here));
        }
        runs.into_par_iter().for_each_init(Fan::default, |fan, (vertices, mut here)| {
            for v in vertices {
                let own = tips.of(v);
                let (list, after) = here.split_at_mut(own.len());
                here = after;
                if !own.is_empty() && changed(v) {
                    fan.turn_to(positions, facets, around, v);
                    for (k, (o, tip)) in list.iter_mut().zip(own).enumerate() {
                        // A vertex may have many facets, and many tips.
                        if k.is_multiple_of(ASKED) && token.is_stopped() {
                            return;
                        }
                        *o = offset(positions, facets, fan, tip);
                    }
                }
            }
        });
    }

    /// Those for which `far` says so, with their numbers, the farthest (as a share of an edge) first.
    pub(super) fn far(&self, far: impl Fn(&Offset) -> bool) -> Vec<(usize, Offset)> {
        let mut found: Vec<(usize, Offset)> = self.list.iter().copied().enumerate().filter(|(_, o)| far(o)).collect();
        found.sort_by(|a, b| b.1.share.total_cmp(&a.1.share).then(a.0.cmp(&b.0)));
        found
    }

    /// Where tip `k` is.
    pub(super) fn place(&self, k: usize) -> DVec3 {
        self.tips.all()[k].position
    }

    /// The largest distance of a tip of each of so many result vertices.
    pub(super) fn by_vertex(&self, vertices: usize) -> Vec<f64> {
        let largest = |v: u32| self.list[self.tips.range(v)].iter().map(|o| o.distance).fold(0.0, f64::max);
        (0..vertices as u32).into_par_iter().map(largest).collect()
    }

    /// The largest distance.
    pub(super) fn deviation(&self) -> f64 {
        self.list.iter().map(|o| o.distance).fold(0.0, f64::max)
    }
}
