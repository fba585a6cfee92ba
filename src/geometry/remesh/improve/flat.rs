//! Vertices of flat faces.
//!
//! Purpose: [`flatten`] puts a vertex into the plane of its one-ring where the input is in that plane too. The cell of a seed beside a crease may
//! have a part beyond it, which draws the vertex off its face.
//! Invariant: facets that changed are on the input, and none is turned over or worse than allowed. Must not know: seeds, diagrams, files.

use glam::DVec3;

use super::shapes::Mobility;
use crate::mesh::csr::ascending;
use crate::mesh::facet_set::{FacetSet, sample_points};
use crate::remesh::constants::{IN_PLANE, LEAST_SCORE};
use crate::remesh::distance::Reference;
use crate::remesh::manifold::LocalMesh;
use crate::remesh::triangle::score;
use crate::token::{Stopped, Token};

/// Facets keep this share of the score of the worst one. A vertex may have left its plane for the sake of their shapes.
const SCORE_KEPT: f64 = 0.8;

/// Moves free vertices off the plane of their one-rings into it. Returns how many it moved.
pub(crate) fn flatten(
    mesh: &mut LocalMesh,
    mobility: &[Mobility],
    reference: &Reference<'_>,
    token: &Token,
) -> Result<usize, Stopped> {
    let mut moved = 0;
    for (v, _) in (0..).zip(mobility).filter(|(_, m)| **m == Mobility::Free) {
        token.check()?;
        if let Some(to) = place_in_plane(mesh, v, reference) {
            mesh.positions[v as usize] = to;
            moved += 1;
        }
    }
    Ok(moved)
}

/// Where the vertex is in the plane of its one-ring; `None` if it is there, there is no such plane, or the input is not in it.
fn place_in_plane(mesh: &LocalMesh, v: u32, reference: &Reference<'_>) -> Option<DVec3> {
    if mesh.is_on_boundary(v) {
        return None;
    }
    // The sum is that of the polygon around the vertex, wherever that is.
    let area = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
    let normal = mesh.ring(v).iter().map(|&f| area(mesh.corners(f))).sum::<DVec3>().try_normalize()?;
    let here = mesh.positions[v as usize];
    let ring: Vec<u32> = mesh.neighbours(v).into_iter().filter(|&u| u != v).collect();
    let places = || ring.iter().map(|&u| mesh.positions[u as usize]);
    let origin = places().next()?;
    let off = |p: DVec3| (p - origin).dot(normal);
    let reach = IN_PLANE * places().map(|p| p.distance(here)).fold(0.0, f64::max);
    if off(here).abs() <= reach || places().any(|p| off(p).abs() > reach) {
        return None;
    }
    let to = here - off(here) * normal;
    let now = || mesh.ring(v).iter().map(|&f| mesh.corners_with(f, v, to));
    let worst = mesh.ring(v).iter().map(|&f| score(mesh.corners(f))).fold(LEAST_SCORE, f64::min);
    if now().any(|t| area(t).dot(normal) <= 0.0 || score(t) < SCORE_KEPT * worst) {
        return None;
    }
    let input = ascending(ring.iter().chain([&v]).flat_map(|&u| reference.facets.of(u)).copied());
    // An empty set is at no distance from anything.
    if input.is_empty() {
        return None;
    }
    let input = FacetSet::new(input.into_iter().map(|f| reference.corners(f)));
    let (groups, mut hint) = (input.all_groups(), 0);
    let is_on = |p: DVec3| input.distance(p, &groups, &mut hint, 0.0) <= reach * reach;
    now().flat_map(sample_points).all(is_on).then_some(to)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::collections::HashSet;

    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::csr::Csr;
    use crate::rvd::Surface;

    /// A fan of six around the first vertex, of which the input's is at `given` above the plane and the result's at `found`.
    fn moved(given: f64, found: f64) -> (usize, DVec3) {
        let corner = |k: u32| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos();
            DVec3::new(cos, sin, 0.0)
        };
        let positions = |height: f64| [DVec3::Z * height].into_iter().chain((0..6).map(corner)).collect::<Vec<_>>();
        let facets: Vec<[u32; 3]> = (0..6).map(|k| [0, k + 1, (k + 1) % 6 + 1]).collect();
        let surface = Surface::new(&TriMesh::new(positions(given), facets.clone()).unwrap(), None).unwrap();
        let own = Csr::group(7, &[0; 6], |f| f as u32);
        let none = Csr::group(7, &[], |_| DVec3::ZERO);
        let reference = Reference { surface: &surface, facets: own, vertices: none };
        let unit = positions(found).into_iter().map(|p| surface.frame().to_unit(p)).collect();
        let mut mesh = LocalMesh::new(unit, facets, HashSet::new());
        let mut mobility = vec![Mobility::Fixed; 7];
        mobility[0] = Mobility::Free;
        let moved = flatten(&mut mesh, &mobility, &reference, &Token::default()).unwrap();
        (moved, surface.frame().to_world(mesh.positions[0]))
    }

    #[test]
    fn a_vertex_off_a_flat_face_moves_into_it_and_a_tip_stays() {
        let (count, place) = moved(0.0, 0.3);
        assert_eq!(count, 1);
        assert!(place.length() < 1e-9, "{place}");
        assert_eq!(moved(0.3, 0.3).0, 0);
        assert_eq!(moved(0.0, 0.0).0, 0);
    }
}
