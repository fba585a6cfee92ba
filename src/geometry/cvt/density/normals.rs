//! Normals of welded vertices.
//!
//! Purpose: angle-weighted normals, and the same smoothed along the surface.
//! Invariant: unit length, or zero where the facets of a vertex cancel or have no area. The same bits with any
//! number of threads. Must not know: what the normals are for.

use glam::DVec3;
use rayon::prelude::*;

use super::net::Net;
use crate::token::{Stopped, Token};

/// Normals weighted by the angle of each facet at the vertex (Thürmer, Wüthrich 1998).
pub(super) fn of_vertices(net: &Net) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; net.vertices()];
    for &(v, _) in &net.facets {
        let p = v.map(|v| net.points[v as usize]);
        let normal = of_facet(p);
        for e in 0..3 {
            let (to, from) = (p[(e + 1) % 3] - p[e], p[(e + 2) % 3] - p[e]);
            let angle = to.cross(from).length().atan2(to.dot(from));
            sums[v[e] as usize] += angle * normal;
        }
    }
    sums.into_par_iter().map(DVec3::normalize_or_zero).collect()
}

/// The normal of a facet with these corners, or zero.
pub(super) fn of_facet([a, b, c]: [DVec3; 3]) -> DVec3 {
    // Edges first to unit length, so that the product of two short ones is no underflow.
    (b - a).normalize_or_zero().cross((c - a).normalize_or_zero()).normalize_or_zero()
}

/// `normals` after `steps` rounds in which each becomes the mean over its vertex and those across an edge,
/// weighted by their areas. A radius of about √steps mesh edges.
///
/// Noise of a scan turns normals to and fro and averages out; on spheres, cylinders and planes the mean is the
/// normal itself.
pub(super) fn smoothed(net: &Net, mut normals: Vec<DVec3>, steps: usize, token: &Token) -> Result<Vec<DVec3>, Stopped> {
    for _ in 0..steps {
        token.check()?;
        normals = (0..normals.len())
            .into_par_iter()
            .map(|v| {
                let around = net.neighbours(v).iter();
                let sum: DVec3 = around.map(|&(to, _)| net.area[to as usize] * normals[to as usize]).sum();
                (sum + net.area[v] * normals[v]).try_normalize().unwrap_or(normals[v])
            })
            .collect();
    }
    Ok(normals)
}
