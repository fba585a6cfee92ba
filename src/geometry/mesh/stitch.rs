//! Stitching of boundary vertices that nearly coincide.
//!
//! Purpose: [`boundaries`] moves such vertices to one position. This connects triangle soups with rounded corners, and
//! separately exported parts.
//! Invariant: no vertex moves by more than `TOLERANCE` of the surface's diagonal, nor by more than `MAX_EDGE_SHARE` of its
//! edges, so that no facet vanishes or flips. Vertices and facets keep their numbers.
//! Must not know: the use of the surface.

use super::adjacency::{Adjacency, EdgeKind};
use super::{TriMesh, coincident};
use crate::token::{Stopped, Token};

/// Largest distance of vertices that coincide, as a share of the surface's diagonal: coordinates that were rounded to single
/// precision twice differ by two of its steps of 1.2e-7, in three directions.
const TOLERANCE: f64 = 5e-7;
/// Largest move of a vertex, share of its shortest edge.
const MAX_EDGE_SHARE: f64 = 0.01;

/// Returns `mesh` with such vertices at one position, and the number of moved ones; `None` if there are none. Linear in the
/// facets.
pub(crate) fn boundaries(
    mesh: &TriMesh,
    adjacency: &Adjacency,
    token: &Token,
) -> Result<Option<(TriMesh, usize)>, Stopped> {
    if adjacency.boundary_edges() == 0 {
        return Ok(None);
    }
    let (origin, high) = mesh.bounds();
    let tolerance = TOLERANCE * (high - origin).length();
    if !(tolerance.is_finite() && tolerance > 0.0) {
        return Ok(None);
    }
    let ends = |half: usize| {
        let facet = mesh.facets()[half / 3];
        [facet[half % 3], facet[(half + 1) % 3]].map(|v| adjacency.representative()[v as usize])
    };
    let place = |v: u32| mesh.positions()[v as usize];
    let mut vertices: Vec<u32> =
        (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) == EdgeKind::Boundary).flat_map(ends).collect();
    vertices.sort_unstable();
    vertices.dedup();
    let pairs = coincident::near(mesh.positions(), vertices, (origin, tolerance), token)?;
    if pairs.is_empty() {
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
    for (v, u, distance) in pairs {
        if distance <= MAX_EDGE_SHARE * shortest[u as usize].min(shortest[v as usize]) {
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
                let (stitched, moved) = boundaries(&soup, &Adjacency::new(&soup), &Token::default()).unwrap().unwrap();
                assert_eq!(topology(&stitched), topology(&mesh), "{shape:?} {noise}");
                assert!(moved > 0);
                let farthest = soup.positions().iter().zip(stitched.positions()).map(|(a, b)| a.distance(*b));
                let (low, high) = mesh.bounds();
                assert!(farthest.fold(0.0, f64::max) <= TOLERANCE * (high - low).length());
            }
        }
    }

    #[test]
    fn what_is_apart_or_one_already_stays() {
        let mesh = Shape::Plane.build(2000);
        for mesh in [Shape::Torus.build(2000), mesh.clone(), soup(&mesh, 0.0), soup(&mesh, 1e-3)] {
            assert!(boundaries(&mesh, &Adjacency::new(&mesh), &Token::default()).unwrap().is_none());
        }
        // Facets as small as what is tolerance elsewhere.
        let mut tiny = mesh.positions().iter().map(|p| *p * 1e-8).collect::<Vec<_>>();
        tiny.push(DVec3::ONE);
        let (mut facets, n) = (mesh.facets().to_vec(), tiny.len() as u32);
        tiny.extend([DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.0, 1.0, 1.0)]);
        facets.push([n - 1, n, n + 1]);
        let tiny = TriMesh::new(tiny, facets).unwrap();
        assert!(boundaries(&tiny, &Adjacency::new(&tiny), &Token::default()).unwrap().is_none());
    }
}
