//! How large the smallest angle of a result can be.
//!
//! Purpose: [`angle_bound_deg`] reads it off the sectors between curves at their corners.
//! Invariant: other facets between the same curve edges have no larger smallest angle, as far as the sectors are flat. Must not
//! know: how corners are found.

use std::collections::{HashMap, HashSet};

use crate::mesh::TriMesh;
use crate::mesh::edges::{DisjointSets, undirected};

/// The largest smallest angle that no sector prevents, degrees, and what rounding takes from it.
const FREE_DEG: f64 = 60.0;
const ROUNDING_DEG: f64 = 1e-6;

/// The facets about a corner that no curve edge separates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sector {
    /// Their angles at the corner together, degrees.
    angle: f64,
    /// Whether they go all around it.
    is_closed: bool,
}

impl Sector {
    /// The largest smallest angle of facets that fill it. Beside a facet's angle at the corner, half of what that leaves counts.
    fn bound(self) -> f64 {
        let divided = |facets: f64| {
            let angle = self.angle / facets;
            angle.min((180.0 - angle) / 2.0)
        };
        let fewest: f64 = if self.is_closed { 3.0 } else { 1.0 };
        let few = (self.angle / FREE_DEG).floor().max(fewest);
        divided(few).max(divided(few + 1.0))
    }
}

/// The sectors about a vertex; `facets` are all of its facets.
fn sectors(mesh: &TriMesh, vertex: u32, facets: &[u32], curves: &HashSet<[u32; 2]>) -> Vec<Sector> {
    let others = |f: u32| mesh.facets()[f as usize].into_iter().filter(move |&v| v != vertex);
    let mut beside: HashMap<u32, Vec<usize>> = HashMap::new();
    for (k, &f) in facets.iter().enumerate() {
        others(f).for_each(|v| beside.entry(v).or_default().push(k));
    }
    let mut sets = DisjointSets::new(facets.len());
    let mut inner = vec![0; facets.len()];
    for (&v, around) in &beside {
        if let &[a, b] = &around[..]
            && !curves.contains(&undirected([vertex, v]))
        {
            sets.join(a, b);
            inner[a] += 1;
            inner[b] += 1;
        }
    }
    let mut found = vec![Sector { angle: 0.0, is_closed: true }; facets.len()];
    for (k, &f) in facets.iter().enumerate() {
        let sector = &mut found[sets.root(k)];
        let at = |v: u32| mesh.positions()[v as usize] - mesh.positions()[vertex as usize];
        let sides: Vec<_> = others(f).map(at).collect();
        if let &[p, q] = &sides[..] {
            sector.angle += p.cross(q).length().atan2(p.dot(q)).to_degrees();
        }
        sector.is_closed &= inner[k] == 2;
    }
    (0..facets.len()).filter(|&k| sets.root(k) == k).map(|k| found[k]).collect()
}

/// The largest that the smallest angle can be with these curve edges, degrees: what the sectors at corners leave. None where they
/// leave 60 degrees.
pub(super) fn angle_bound_deg(mesh: &TriMesh, edges: &[[u32; 2]], is_corner: impl Fn(u32) -> bool) -> Option<f64> {
    let curves: HashSet<[u32; 2]> = edges.iter().map(|&edge| undirected(edge)).collect();
    let mut at_corners: Vec<(u32, u32)> = Vec::new();
    for (f, t) in (0..).zip(mesh.facets()) {
        at_corners.extend(t.iter().filter(|&&v| is_corner(v)).map(|&v| (v, f)));
    }
    at_corners.sort_unstable();
    let bounds = at_corners.chunk_by(|a, b| a.0 == b.0).flat_map(|around| {
        let facets: Vec<u32> = around.iter().map(|&(_, f)| f).collect();
        sectors(mesh, around[0].0, &facets, &curves)
    });
    let bound = bounds.map(Sector::bound).fold(FREE_DEG, f64::min);
    (bound < FREE_DEG - ROUNDING_DEG).then_some(bound)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn a_sector_is_divided_as_well_as_it_can_be() {
        let bound = |angle: f64, is_closed: bool| Sector { angle, is_closed }.bound();
        for (angle, is_closed, expected) in [
            (20.0, false, 20.0),
            (60.0, false, 60.0),
            (80.0, false, 50.0),
            (90.0, false, 45.0),
            (100.0, false, 50.0),
            (180.0, false, 60.0),
            (90.0, true, 30.0),
            (360.0, true, 60.0),
        ] {
            assert!((bound(angle, is_closed) - expected).abs() < 1e-9, "{angle}: {}", bound(angle, is_closed));
        }
    }

    #[test]
    fn curves_divide_what_is_about_a_corner() {
        // A fan about the origin in steps of 30 degrees, closed.
        let rim = (0..12).map(|k| f64::from(k).to_radians() * 30.0).map(|t| DVec3::new(t.cos(), t.sin(), 0.0));
        let positions: Vec<DVec3> = std::iter::once(DVec3::ZERO).chain(rim).collect();
        let facets = (0..12).map(|k| [0, 1 + k, 1 + (k + 1) % 12]).collect();
        let mesh = TriMesh::new(positions, facets).unwrap();
        let bound = |edges: &[[u32; 2]]| angle_bound_deg(&mesh, edges, |v| v == 0);
        assert_eq!(bound(&[]), None);
        // A curve that ends there divides nothing.
        assert_eq!(bound(&[[0, 1]]), None);
        assert!((bound(&[[0, 1], [2, 0]]).unwrap() - 30.0).abs() < 1e-9);
        assert!((bound(&[[0, 1], [0, 4]]).unwrap() - 45.0).abs() < 1e-9);
        assert_eq!(angle_bound_deg(&mesh, &[[0, 1], [0, 2]], |_| false), None);
    }
}
