//! New places for seeds whose cell is empty.
//!
//! Purpose: a seed that owns no surface is put where it is needed most: beside the seed with the
//! highest energy, on the surface.
//! Invariant: deterministic, and never on top of another seed's new place.
//! Must not know: backends.

use glam::DVec3;

use crate::mesh::closest_point::ClosestPoint;
use crate::rvd::{CellSums, Surface};

/// Places the seeds `empty` anew in `next`, each in another cell, in order of falling energy; if
/// there are more empty cells than full ones, several share a cell on smaller and smaller circles.
pub(super) fn place(empty: &[u32], sums: &CellSums, next: &mut [DVec3], surface: &Surface, closest: &ClosestPoint) {
    let mut hosts: Vec<usize> = (0..next.len()).filter(|&i| sums.area[i] > 0.0).collect();
    hosts.sort_by(|&a, &b| sums.energy[b].total_cmp(&sums.energy[a]).then(a.cmp(&b)));
    if hosts.is_empty() {
        return;
    }
    for (k, &i) in empty.iter().enumerate() {
        let (host, round) = (hosts[k % hosts.len()], k / hosts.len());
        let centre = closest.project(next[host]);
        let [a, b, c] = surface.facets()[centre.facet as usize].map(|v| surface.positions()[v as usize]);
        // The longest edge is a tangent that even a sliver has.
        let tangent = [b - a, c - b, a - c]
            .into_iter()
            .max_by(|x, y| x.length_squared().total_cmp(&y.length_squared()))
            .unwrap_or(DVec3::X)
            .normalize_or(DVec3::X);
        let radius = 0.5 * (sums.area[host] / std::f64::consts::PI).sqrt() / (1 + round / 2) as f64;
        let way = if round % 2 == 0 { radius } else { -radius };
        next[i as usize] = closest.project(centre.position + way * tangent).position;
    }
}
