//! Facets that pass through others.
//!
//! Purpose: [`crossings`] finds them by boxes ([`Bvh`]) and exact signs of volumes (Shewchuk 1997, by the crate `robust`).
//! Invariant: facets cross if an edge of one has its ends on different sides of the other's plane and meets the other there.
//! Facets that only touch, in a vertex, along an edge or flat on each other, do not. Must not know: how a surface came about.

use glam::DVec3;
use robust::{Coord3D, orient3d};
use serde::Serialize;

use super::TriMesh;
use super::bvh::{Bvh, arrange};
use crate::tasks;
use crate::token::{Stopped, Token};

/// The most places that are named.
const PLACES: usize = 8;
/// Facets between two looks at the token.
const BETWEEN_CHECKS: usize = 4096;

/// Facets of a surface that cross others of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Crossings {
    /// How many facets.
    pub count: usize,
    /// Centroids of the first of them, at most 8.
    pub places: Vec<[f64; 3]>,
}

/// How many facets of `mesh` cross others, and where. Facets without area count as none.
pub fn crossings(mesh: &TriMesh, token: &Token) -> Result<Crossings, Stopped> {
    let found = crossing_facets(mesh, token)?;
    let place = |&facet: &u32| (mesh.corners(facet as usize).into_iter().sum::<DVec3>() / 3.0).to_array();
    Ok(Crossings { count: found.len(), places: found.iter().take(PLACES).map(place).collect() })
}

/// The facets of `mesh` that cross others, ascending.
pub(crate) fn crossing_facets(mesh: &TriMesh, token: &Token) -> Result<Vec<u32>, Stopped> {
    // By a power of two, which loses nothing: products of three coordinates neither overflow nor vanish.
    let (low, high) = mesh.bounds();
    let extent = low.abs().max(high.abs()).max_element();
    let scale = if extent > 0.0 { 2f64.powi(-(extent.log2().ceil() as i32).clamp(-1000, 1000)) } else { 1.0 };
    let corners = |facet: u32| mesh.corners(facet as usize).map(|p| p * scale);
    let mut order: Vec<u32> = (0..mesh.facets().len() as u32).filter(|&f| !mesh.is_degenerate(f as usize)).collect();
    arrange(&mut order, &|&facet| corners(facet).into_iter().sum::<DVec3>() / 3.0, token);
    let items: Vec<[DVec3; 3]> = tasks::map(order.len(), |k| corners(order[k]));
    let tree = Bvh::new(&items);
    let is_crossed = |(): &mut (), at: usize| -> Result<bool, Stopped> {
        if at.is_multiple_of(BETWEEN_CHECKS) {
            token.check()?;
        }
        let mut crossed = false;
        tree.overlapping(&items[at], |other| {
            crossed = other != at && cross(&items[at], &items[other]);
            crossed
        });
        Ok(crossed)
    };
    let crossed = tasks::try_map(items.len(), || (), is_crossed)?;
    let mut found: Vec<u32> =
        order.iter().zip(crossed).filter(|(_, crossed)| *crossed).map(|(&facet, _)| facet).collect();
    found.sort_unstable();
    Ok(found)
}

/// Whether an edge of one facet passes through the other. Edges that the two share, and those that begin at a corner that they
/// share, do not.
fn cross(one: &[DVec3; 3], other: &[DVec3; 3]) -> bool {
    let shared = one.iter().filter(|p| other.contains(p)).count();
    shared < 2 && (pierces(one, other) || pierces(other, one))
}

fn pierces(edges: &[DVec3; 3], facet: &[DVec3; 3]) -> bool {
    let [a, b, c] = *facet;
    let sides = edges.map(|p| sign(a, b, c, p));
    (0..3).any(|k| {
        let next = (k + 1) % 3;
        // Strictly on different sides, so that none of the ends is a corner of the facet.
        sides[k] * sides[next] < 0 && {
            let (p, q) = (edges[k], edges[next]);
            let around = [sign(p, q, a, b), sign(p, q, b, c), sign(p, q, c, a)];
            // It passes inside, or through the facet's rim.
            around.iter().all(|&s| s >= 0) || around.iter().all(|&s| s <= 0)
        }
    })
}

fn sign(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> i32 {
    let [a, b, c, d] = [a, b, c, d].map(|p| Coord3D { x: p.x, y: p.y, z: p.z });
    let volume = orient3d(a, b, c, d);
    i32::from(volume > 0.0) - i32::from(volume < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;
    use glam::{DQuat, dvec3};

    fn count(mesh: &TriMesh) -> usize {
        crossings(mesh, &Token::default()).unwrap().count
    }

    fn joined(parts: &[TriMesh]) -> TriMesh {
        let (mut positions, mut facets) = (Vec::new(), Vec::new());
        for part in parts {
            let first = positions.len() as u32;
            positions.extend_from_slice(part.positions());
            facets.extend(part.facets().iter().map(|facet| facet.map(|v| v + first)));
        }
        TriMesh::new(positions, facets).unwrap()
    }

    fn moved(mesh: &TriMesh, to: impl Fn(DVec3) -> DVec3) -> TriMesh {
        TriMesh::new(mesh.positions().iter().map(|&p| to(p)).collect(), mesh.facets().to_vec()).unwrap()
    }

    #[test]
    fn surfaces_that_touch_do_not_cross() {
        for shape in [Shape::Torus, Shape::Sphere, Shape::Hills, Shape::Block, Shape::Plane] {
            assert_eq!(count(&shape.build(2000)), 0, "{shape}");
        }
        let block = Shape::Block.build(500);
        let (low, high) = block.bounds();
        // Beside it face on face, edge on edge, corner on corner; the same again, and turned inside out.
        for shift in [dvec3(1.0, 0.0, 0.0), dvec3(1.0, 1.0, 0.0), DVec3::ONE, DVec3::ZERO] {
            let other = moved(&block, |p| p + shift * (high - low));
            assert_eq!(count(&joined(&[block.clone(), other])), 0, "{shift}");
        }
    }

    #[test]
    fn facets_that_pass_through_others_are_found() {
        let one = Shape::Sphere.build(800);
        for (k, turn) in [0.1, 0.7, 1.3].into_iter().enumerate() {
            let rotation = DQuat::from_axis_angle(dvec3(1.0, 2.0, 3.0).normalize(), turn);
            let both = joined(&[one.clone(), moved(&one, |p| rotation * p + dvec3(0.4, 0.3, 0.1))]);
            let all: Vec<[DVec3; 3]> = (0..both.facets().len()).map(|f| both.corners(f)).collect();
            let crossed = |(i, a): (usize, &[DVec3; 3])| all.iter().enumerate().any(|(j, b)| i != j && cross(a, b));
            let wanted = all.iter().enumerate().filter(|&facet| crossed(facet)).count();
            assert!(wanted > 40, "{wanted}");
            assert_eq!(count(&both), wanted, "{k}");
            // Whatever the units.
            for scale in [1e-100, 1e-3, 1e100] {
                assert_eq!(count(&moved(&both, |p| p * scale)), wanted, "{scale}");
            }
        }
        // Two facets with one corner in common.
        let points = vec![DVec3::ZERO, DVec3::X, DVec3::Y, dvec3(0.4, 0.2, -1.0), dvec3(0.4, 0.2, 1.0)];
        let fan = |facets: &[[u32; 3]]| TriMesh::new(points.clone(), facets.to_vec()).unwrap();
        assert_eq!(crossings(&fan(&[[0, 1, 2], [0, 3, 4]]), &Token::default()).unwrap().count, 2);
        assert_eq!(count(&fan(&[[0, 1, 2], [0, 2, 3]])), 0);
    }
}
