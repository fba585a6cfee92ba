//! New places for seeds whose cell is empty.
//!
//! Purpose: a seed that owns no surface is put where it is needed most: beside the seed with the
//! highest energy, on the surface, where it may stay.
//! Invariant: deterministic, and never on top of another seed's new place.
//! Must not know: backends, and why a seed may not be somewhere.

use glam::DVec3;

use super::{Cvt, closest};
use crate::mesh::closest_point::ClosestPoint;
use crate::rvd::{CellSums, RvdError, Surface};

/// A seed that is farther from a curve than this share of the spacing of the curve's seeds is not pushed off it.
const STAYS: f64 = 0.75;

impl Cvt {
    /// New places for seeds with empty cells, by the sums and the seeds that are at hand.
    pub(super) fn new_places(&mut self) -> Result<Vec<(u32, DVec3)>, RvdError> {
        let empty: Vec<u32> =
            (0..self.seeds.len() as u32).filter(|&i| self.sums.area[i as usize] <= 0.0 && !self.is_held(i)).collect();
        let closest = closest(&mut self.closest, &self.surface)?;
        let clearance = (!self.curves.is_empty()).then(|| self.curves.clearance(STAYS));
        let may = |p| clearance.as_ref().is_none_or(|clearance| clearance.holds(p));
        Ok(place(&empty, &self.sums, &self.seeds, (&self.surface, closest), may))
    }
}

/// New places for the seeds `empty`, each in another cell, in order of falling energy, and where `may` says that a
/// seed stays as long as there are such places; if there are more empty cells than full ones, several share a cell on
/// smaller and smaller circles.
fn place(
    empty: &[u32],
    sums: &CellSums,
    seeds: &[DVec3],
    (surface, closest): (&Surface, &ClosestPoint),
    may: impl Fn(DVec3) -> bool,
) -> Vec<(u32, DVec3)> {
    let mut hosts: Vec<usize> = (0..seeds.len()).filter(|&i| sums.area[i] > 0.0).collect();
    hosts.sort_by(|&a, &b| sums.energy[b].total_cmp(&sums.energy[a]).then(a.cmp(&b)));
    let mut places = Vec::with_capacity(empty.len());
    if hosts.is_empty() {
        return places;
    }
    let beside = |host: usize, round: usize| {
        let centre = closest.project(seeds[host]);
        let [a, b, c] = surface.facets()[centre.facet as usize].map(|v| surface.positions()[v as usize]);
        // The longest edge is a tangent that even a sliver has.
        let tangent = [b - a, c - b, a - c]
            .into_iter()
            .max_by(|x, y| x.length_squared().total_cmp(&y.length_squared()))
            .unwrap_or(DVec3::X)
            .normalize_or(DVec3::X);
        let radius = 0.5 * (sums.area[host] / std::f64::consts::PI).sqrt() / (1 + round / 2) as f64;
        let way = if round.is_multiple_of(2) { radius } else { -radius };
        closest.project(centre.position + way * tangent).position
    };
    // A place where no seed stays would leave its cell empty again, step after step.
    for &host in &hosts {
        let Some(&seed) = empty.get(places.len()) else { return places };
        let place = beside(host, 0);
        if may(place) {
            places.push((seed, place));
        }
    }
    let left = &empty[places.len()..];
    places.extend((hosts.len()..).zip(left).map(|(k, &i)| (i, beside(hosts[k % hosts.len()], k / hosts.len()))));
    places
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn places_are_apart_and_where_seeds_may_stay() {
        let mesh = Shape::Torus.build(2000);
        let surface = Surface::new(&mesh, None).unwrap();
        let mut tree = None;
        let closest = closest(&mut tree, &surface).unwrap();
        let seeds: Vec<DVec3> = (0..40).map(|k| surface.centroid(k * 47)).collect();
        let mut sums = CellSums::default();
        sums.reset(40);
        for i in 0..30 {
            (sums.area[i], sums.energy[i]) = (0.01, 30.0 - i as f64);
        }
        let empty: Vec<u32> = (30..40).collect();
        let apart = |places: &[(u32, DVec3)]| {
            let all = |i: usize| places[..i].iter().all(|(_, p)| p.distance(places[i].1) > 1e-4);
            (0..places.len()).all(all)
        };
        let anywhere = place(&empty, &sums, &seeds, (&surface, closest), |_| true);
        // The one with the highest energy has the first.
        assert!(anywhere[0].1.distance(seeds[0]) < 0.1 && apart(&anywhere));
        assert_eq!(anywhere.iter().map(|(seed, _)| *seed).collect::<Vec<_>>(), empty);
        let right = place(&empty, &sums, &seeds, (&surface, closest), |p| p.x > 0.0);
        assert!(right.iter().all(|(_, p)| p.x > 0.0) && apart(&right) && right.len() == 10);
        // Where none may stay they are placed all the same.
        let nowhere = place(&empty, &sums, &seeds, (&surface, closest), |_| false);
        assert!(apart(&nowhere) && nowhere.len() == 10);
    }
}
