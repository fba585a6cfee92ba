//! Seeds of curves on a lifted surface.
//!
//! Purpose: where a crease turns the normal, a seed on it is as many points of the lifted surface as it has sides:
//! [`CurveLifts`] finds them. With one point alone, neither side would have its cell at the crease.
//! Invariant: a seed has a point for each side, in the order of the facets. Must not know: how the surface was lifted.

use glam::DVec3;

use super::curves::CurveSeeds;
use crate::knn::{Point, SeedIndex};
use crate::mesh::bvh::{Bvh, arrange};
use crate::mesh::closest_point::closest_on_facet;
use crate::rvd::Surface;
use crate::tasks;
use crate::token::{Stopped, Token};

/// A place within this distance of a facet is on it, unit frame. Places of curves are sums of a few rounded terms.
const ON_FACET: f64 = 1e-9;
/// Further sides of a seed that count, at most: a corner with more is a cone, and any of them stand for it.
pub(super) const MOST_SIDES: usize = 8;
/// Two points nearer than this share of the lift are one side: normals within a degree.
const ONE_SIDE: f64 = 0.02;

/// The facets at the curves of a surface.
pub(crate) struct CurveLifts {
    facets: Vec<u32>,
    tree: Bvh,
}

impl CurveLifts {
    /// Of the facets that have a vertex on a curve.
    pub(crate) fn new<P: Point>(surface: &Surface<P>, at_curve: impl Fn(u32) -> bool, token: &Token) -> Self {
        let mut facets: Vec<u32> = (0..surface.facets().len() as u32).filter(|&f| at_curve(f)).collect();
        let corners = |f: u32| surface.corners(f).map(P::place);
        arrange(&mut facets, &|&f| corners(f).into_iter().sum::<DVec3>() / 3.0, token);
        let corners: Vec<[DVec3; 3]> = facets.iter().map(|&f| corners(f)).collect();
        Self { tree: Bvh::new(&corners), facets }
    }

    /// As [`CurveSeeds::intruders`], by distances on the lifted surface: on either side, what is nearest to a point of a segment
    /// is a point of a curve's seed. `sides` follow the seeds.
    pub(crate) fn intruders<P: Point>(
        &self,
        surface: &Surface<P>,
        curves: &CurveSeeds,
        (seeds, sides): (&[P], &[(u32, P)]),
        token: &Token,
    ) -> Result<Vec<(u32, u32)>, Stopped> {
        let points: Vec<P> = seeds.iter().copied().chain(sides.iter().map(|side| side.1)).collect();
        let index = SeedIndex::new(&points);
        let is_free = |point: &u32| (curves.len()..seeds.len()).contains(&(*point as usize));
        let of = |k: usize| -> Vec<(u32, u32)> {
            if token.is_stopped() {
                return Vec::new();
            }
            let points = curves.segments[k].between.into_iter().flat_map(|place| self.sides(surface, place));
            points.map(|point| index.nearest(point)).filter(is_free).map(|seed| (seed, k as u32)).collect()
        };
        let mut found: Vec<(u32, u32)> = tasks::flat_map(curves.segments.len(), of);
        token.check()?;
        found.sort_unstable();
        found.dedup_by_key(|f| f.0);
        Ok(found)
    }

    /// The distance of two places of a curve on the lifted surface, on the side where it is longest.
    pub(crate) fn chord<P: Point>(&self, surface: &Surface<P>, ends: [DVec3; 2]) -> f64 {
        let [a, b] = ends.map(|place| self.sides(surface, place));
        let nearest = |p: &P| b.iter().map(|q| p.distance(*q)).fold(f64::INFINITY, f64::min);
        let most = a.iter().map(nearest).filter(|d| d.is_finite()).fold(0.0, f64::max);
        most.max(ends[0].distance(ends[1]))
    }

    /// The points of the lifted surface at a place of a curve.
    pub(crate) fn sides<P: Point>(&self, surface: &Surface<P>, place: DVec3) -> Vec<P> {
        let mut touched = Vec::new();
        let reach = DVec3::splat(ON_FACET);
        self.tree.overlapping(&[place - reach, place + reach], |leaf| {
            touched.push(self.facets[leaf]);
            false
        });
        touched.sort_unstable();
        let mut sides: Vec<P> = Vec::new();
        for facet in touched.into_iter().filter(|&f| !surface.skips(f as usize)) {
            let corners = surface.corners(facet);
            let (squared, [u, v, w]) = closest_on_facet(place, corners.map(P::place), surface.facets()[facet as usize]);
            let point = (corners[0] * u + corners[1] * v + corners[2] * w).at(place);
            let apart = point.at(DVec3::ZERO).length();
            let is_new = |side: &P| (point - *side).at(DVec3::ZERO).length() > ONE_SIDE * apart;
            if squared <= ON_FACET * ON_FACET && sides.iter().all(is_new) {
                sides.push(point);
            }
            if sides.len() > MOST_SIDES {
                break;
            }
        }
        sides
    }
}
