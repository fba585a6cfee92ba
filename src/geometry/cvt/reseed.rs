//! New places for seeds whose cell is empty.
//!
//! Purpose: a seed that owns no surface is put where it is needed most: beside the seed with the
//! highest energy, on the surface, where it may stay.
//! Invariant: deterministic, and never on top of another seed's new place.
//! Must not know: backends, and why a seed may not be somewhere.

use glam::DVec3;

use super::Cvt;
use super::placement::closest;
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::rvd::{CellSums, RvdError, Surface};
use crate::token::{Stopped, Token};

/// A seed that is farther from a curve than this share of the spacing of the curve's seeds is not pushed off it.
const STAYS: f64 = 0.75;

impl Cvt {
    /// New places for seeds with empty cells, by the sums and the seeds that are at hand.
    pub(super) fn new_places(&mut self, token: &Token) -> Result<Vec<(u32, DVec3)>, RvdError> {
        let empty: Vec<u32> =
            (0..self.seeds.len() as u32).filter(|&i| self.sums.area[i as usize] <= 0.0 && !self.is_held(i)).collect();
        let closest = closest(&mut self.closest, &self.surface)?;
        let clearance = (!self.curves.is_empty()).then(|| self.curves.clearance(STAYS));
        let may = |p| clearance.as_ref().is_none_or(|clearance| clearance.holds(p));
        Ok(place(&empty, &self.sums, &self.seeds, (&self.surface, closest), may, token)?)
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
    token: &Token,
) -> Result<Vec<(u32, DVec3)>, Stopped> {
    let mut hosts: Vec<usize> = (0..seeds.len()).filter(|&i| sums.area[i] > 0.0).collect();
    hosts.sort_by(|&a, &b| sums.energy[b].total_cmp(&sums.energy[a]).then(a.cmp(&b)));
    let mut places = Vec::with_capacity(empty.len());
    if hosts.is_empty() {
        return Ok(places);
    }
    // Where hosts are on the surface, and a tangent there. All at once: where facets lie on one another, one search may
    // look at all of them.
    let footing = |hosts: &[usize]| -> Result<Vec<(usize, DVec3, DVec3)>, Stopped> {
        let at: Vec<DVec3> = hosts.iter().map(|&host| seeds[host]).collect();
        let of = |(&host, centre): (&usize, SurfacePoint)| {
            let [a, b, c] = surface.facets()[centre.facet as usize].map(|v| surface.positions()[v as usize]);
            // The longest edge is a tangent that even a sliver has.
            let tangent = [b - a, c - b, a - c]
                .into_iter()
                .max_by(|x, y| x.length_squared().total_cmp(&y.length_squared()))
                .unwrap_or(DVec3::X)
                .normalize_or(DVec3::X);
            (host, centre.position, tangent)
        };
        Ok(hosts.iter().zip(closest.project_all(&at, token)?).map(of).collect())
    };
    let beside = |&(host, centre, tangent): &(usize, DVec3, DVec3), round: usize| {
        let radius = 0.5 * (sums.area[host] / std::f64::consts::PI).sqrt() / (1 + round / 2) as f64;
        let way = if round.is_multiple_of(2) { radius } else { -radius };
        centre + way * tangent
    };
    let on_surface = |points: Vec<DVec3>| -> Result<Vec<DVec3>, Stopped> {
        Ok(closest.project_all(&points, token)?.into_iter().map(|p| p.position).collect())
    };
    // A place where no seed stays would leave its cell empty again, step after step.
    let mut rest = &hosts[..];
    while places.len() < empty.len() && !rest.is_empty() {
        let (some, after) = rest.split_at(rest.len().min(empty.len() - places.len()));
        let tried = on_surface(footing(some)?.iter().map(|host| beside(host, 0)).collect())?;
        let left = &empty[places.len()..];
        places.extend(left.iter().copied().zip(tried.into_iter().filter(|&p| may(p))));
        rest = after;
    }
    let left = &empty[places.len()..];
    if left.is_empty() {
        return Ok(places);
    }
    let feet = footing(&hosts[..hosts.len().min(left.len())])?;
    let again = (0..left.len()).map(|k| beside(&feet[k % hosts.len()], 1 + k / hosts.len())).collect();
    places.extend(left.iter().copied().zip(on_surface(again)?));
    Ok(places)
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
        let token = Token::default();
        let anywhere = place(&empty, &sums, &seeds, (&surface, closest), |_| true, &token).unwrap();
        // The one with the highest energy has the first.
        assert!(anywhere[0].1.distance(seeds[0]) < 0.1 && apart(&anywhere));
        assert_eq!(anywhere.iter().map(|(seed, _)| *seed).collect::<Vec<_>>(), empty);
        let right = place(&empty, &sums, &seeds, (&surface, closest), |p| p.x > 0.0, &token).unwrap();
        assert!(right.iter().all(|(_, p)| p.x > 0.0) && apart(&right) && right.len() == 10);
        // Where none may stay they are placed all the same.
        let nowhere = place(&empty, &sums, &seeds, (&surface, closest), |_| false, &token).unwrap();
        assert!(apart(&nowhere) && nowhere.len() == 10);
        token.cancel();
        assert!(place(&empty, &sums, &seeds, (&surface, closest), |_| true, &token).is_err());
    }
}
