//! How far the vertices of the input are from the result.
//!
//! Purpose: [`Offsets`] knows for every vertex of the input the nearest facet around its own result vertex, and
//! keeps up while the result changes in places.
//! Invariant: the same whatever the number of threads. Must not know: how the result is changed.

use glam::DVec3;
use rayon::prelude::*;

use super::around::Around;
use crate::mesh::closest_point::closest_on_facet;

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

/// See the module's head.
pub(super) struct Offsets<'a> {
    pub(super) tips: &'a [Tip],
    list: Vec<Offset>,
}

/// Of the facets around a vertex the nearest one: squared distance, facet, barycentric coordinates.
pub(super) fn nearest(
    positions: &[DVec3],
    facets: &[[u32; 3]],
    around: &Around,
    p: DVec3,
    vertex: u32,
) -> (f64, u32, [f64; 3]) {
    let mut best = (f64::INFINITY, u32::MAX, [0.0; 3]);
    for &f in around.of(vertex) {
        let t = facets[f as usize];
        let (squared, lambda) = closest_on_facet(p, t.map(|v| positions[v as usize]), t);
        if squared < best.0 {
            best = (squared, f, lambda);
        }
    }
    best
}

fn offset(positions: &[DVec3], facets: &[[u32; 3]], around: &Around, tip: &Tip) -> Offset {
    let (squared, facet, _) = nearest(positions, facets, around, tip.position, tip.vertex);
    let Some(&t) = facets.get(facet as usize) else { return NOWHERE };
    let p = t.map(|v| positions[v as usize]);
    let edge = (p[0].distance(p[1]) + p[1].distance(p[2]) + p[2].distance(p[0])) / 3.0;
    let to = p.map(|q| q.distance_squared(tip.position));
    let corner = if to[0] <= to[1] && to[0] <= to[2] {
        t[0]
    } else if to[1] <= to[2] {
        t[1]
    } else {
        t[2]
    };
    let distance = squared.sqrt();
    Offset { distance, share: if edge > 0.0 { distance / edge } else { 0.0 }, facet, corner }
}

impl<'a> Offsets<'a> {
    /// Looks at all of them.
    pub(super) fn new(positions: &[DVec3], facets: &[[u32; 3]], around: &Around, tips: &'a [Tip]) -> Self {
        let list = tips.par_iter().map(|tip| offset(positions, facets, around, tip)).collect();
        Self { tips, list }
    }

    /// Looks again at those whose vertex is in `region`.
    pub(super) fn update(&mut self, positions: &[DVec3], facets: &[[u32; 3]], around: &Around, region: &[bool]) {
        let changed = self.list.par_iter_mut().zip(self.tips).filter(|(_, tip)| region[tip.vertex as usize]);
        changed.for_each(|(old, tip)| *old = offset(positions, facets, around, tip));
    }

    /// Those for which `far` says so, with their numbers, the farthest (as a share of an edge) first.
    pub(super) fn far(&self, far: impl Fn(&Offset) -> bool) -> Vec<(usize, Offset)> {
        let mut found: Vec<(usize, Offset)> = self.list.iter().copied().enumerate().filter(|(_, o)| far(o)).collect();
        found.sort_by(|a, b| b.1.share.total_cmp(&a.1.share).then(a.0.cmp(&b.0)));
        found
    }

    /// The largest distance of a tip of each of so many result vertices.
    pub(super) fn by_vertex(&self, vertices: usize) -> Vec<f64> {
        let mut far = vec![0.0f64; vertices];
        for (tip, o) in self.tips.iter().zip(&self.list) {
            let far = &mut far[tip.vertex as usize];
            *far = far.max(o.distance);
        }
        far
    }

    /// The largest distance.
    pub(super) fn deviation(&self) -> f64 {
        self.list.iter().map(|o| o.distance).fold(0.0, f64::max)
    }
}
