//! Corners that should be one.
//!
//! Purpose: [`rims`] moves vertices of boundaries that are nearly in one place into one, so that a list of triangles whose
//! corners were rounded one by one, or parts that were exported one by one, hang together.
//! Invariant: nothing moves by more than `NEAR` of the surface's diagonal, nor by more than `SHORT` of the edges
//! around it, so that no facet vanishes or turns over. Vertices and facets keep their numbers.
//! Must not know: why it matters.

use super::adjacency::{Adjacency, EdgeKind};
use super::{TriMesh, coincident};
use crate::token::{Stopped, Token};

/// Vertices as near as this are one, as a share of the surface's diagonal: coordinates that were rounded to single
/// precision twice differ by two of its steps of 1.2e-7, in three directions.
const NEAR: f64 = 5e-7;
/// And as a share of the shortest edge around them.
const SHORT: f64 = 0.01;

/// `mesh` with such vertices in one place, and how many were moved; `None` if there are none. Linear in the facets.
///
/// # Errors
/// [`Stopped`].
pub(crate) fn rims(mesh: &TriMesh, adjacency: &Adjacency, token: &Token) -> Result<Option<(TriMesh, usize)>, Stopped> {
    if adjacency.boundary_edges() == 0 {
        return Ok(None);
    }
    let (origin, high) = mesh.bounds();
    let near = NEAR * (high - origin).length();
    if !(near.is_finite() && near > 0.0) {
        return Ok(None);
    }
    let ends = |half: usize| {
        let facet = mesh.facets()[half / 3];
        [facet[half % 3], facet[(half + 1) % 3]].map(|v| adjacency.representative()[v as usize])
    };
    let place = |v: u32| mesh.positions()[v as usize];
    let mut rim: Vec<u32> =
        (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) == EdgeKind::Boundary).flat_map(ends).collect();
    rim.sort_unstable();
    rim.dedup();
    let near_others = coincident::near(mesh.positions(), rim, (origin, near), token)?;
    if near_others.is_empty() {
        return Ok(None);
    }
    let mut shortest = vec![f64::INFINITY; mesh.positions().len()];
    for half in (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) != EdgeKind::Collapsed) {
        token.check_at(half)?;
        let [a, b] = ends(half);
        let length = place(a).distance(place(b));
        for v in [a, b] {
            shortest[v as usize] = shortest[v as usize].min(length);
        }
    }
    let mut target: Vec<u32> = adjacency.representative().to_vec();
    let mut moved = 0;
    for (v, u, distance) in near_others {
        if distance <= SHORT * shortest[u as usize].min(shortest[v as usize]) {
            target[v as usize] = u;
            moved += 1;
        }
    }
    if moved == 0 {
        return Ok(None);
    }
    let all = adjacency.representative().iter().enumerate().map(|(v, &first)| match target[first as usize] {
        to if to != first => place(to),
        _ => mesh.positions()[v],
    });
    Ok(TriMesh::new(all.collect(), mesh.facets().to_vec()).ok().map(|stitched| (stitched, moved)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use glam::DVec3;

    use super::*;
    use crate::mesh::measure::topology;
    use crate::mesh::shapes::Shape;

    /// Every facet with corners of its own, each off by at most `noise`.
    fn soup(mesh: &TriMesh, noise: f64) -> TriMesh {
        let corners = mesh.facets().iter().flatten().enumerate();
        let off = |k: usize| DVec3::new(k as f64, (k * k) as f64, (3 * k) as f64).map(f64::sin);
        let positions: Vec<DVec3> = corners.map(|(k, &v)| mesh.positions()[v as usize] + noise * off(k)).collect();
        let facets = (0..mesh.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        TriMesh::new(positions, facets).unwrap()
    }

    #[test]
    fn corners_rounded_one_by_one_are_one_again() {
        for shape in [Shape::Torus, Shape::Block, Shape::Plane] {
            let mesh = shape.build(2000);
            for noise in [1e-15, 1e-12, 1e-7] {
                let soup = soup(&mesh, noise);
                let (stitched, moved) = rims(&soup, &Adjacency::new(&soup), &Token::default()).unwrap().unwrap();
                assert_eq!(topology(&stitched), topology(&mesh), "{shape:?} {noise}");
                assert!(moved > 0);
                let farthest = soup.positions().iter().zip(stitched.positions()).map(|(a, b)| a.distance(*b));
                let (low, high) = mesh.bounds();
                assert!(farthest.fold(0.0, f64::max) <= NEAR * (high - low).length());
            }
        }
    }

    #[test]
    fn what_is_apart_or_one_already_stays() {
        let mesh = Shape::Plane.build(2000);
        for mesh in [Shape::Torus.build(2000), mesh.clone(), soup(&mesh, 0.0), soup(&mesh, 1e-3)] {
            assert!(rims(&mesh, &Adjacency::new(&mesh), &Token::default()).unwrap().is_none());
        }
        // Facets as small as what is near elsewhere.
        let mut tiny = mesh.positions().iter().map(|p| *p * 1e-8).collect::<Vec<_>>();
        tiny.push(DVec3::ONE);
        let (mut facets, n) = (mesh.facets().to_vec(), tiny.len() as u32);
        tiny.extend([DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.0, 1.0, 1.0)]);
        facets.push([n - 1, n, n + 1]);
        let tiny = TriMesh::new(tiny, facets).unwrap();
        assert!(rims(&tiny, &Adjacency::new(&tiny), &Token::default()).unwrap().is_none());
    }
}
