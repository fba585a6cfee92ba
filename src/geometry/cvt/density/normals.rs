//! Normals at the vertices of a surface, from its facets.
//!
//! Purpose: [`vertex_normals`] are weighted by angle; [`smoothed_normals`] are means over several edges, and along rims.
//! Invariant: unit length, or zero where the facets of a vertex cancel or have no area. Normals that change evenly over the surface, as
//! those of a cylinder do, stay, up to its rims. The same bits with any number of threads.
//! Must not know: curvature, sizes.

use glam::DVec3;

use super::net::Net;
use crate::mesh::csr::Csr;
use crate::tasks;
use crate::token::{Stopped, Token};

/// Cosine of 45°. Rims that turn by more, as those of a scan's holes, say little of the surface beside them.
const SMOOTH_RIM: f64 = 0.7;

/// Normals weighted by the angle of each facet at the vertex (Thürmer, Wüthrich 1998).
pub(super) fn vertex_normals(net: &Net) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; net.vertices()];
    for &(v, _) in &net.facets {
        let p = v.map(|v| net.points[v as usize]);
        let normal = facet_normal(p);
        for e in 0..3 {
            let angle = corner_angle([p[(e + 1) % 3] - p[e], p[(e + 2) % 3] - p[e]]);
            sums[v[e] as usize] += angle * normal;
        }
    }
    tasks::map(sums.len(), |v| sums[v].normalize_or_zero())
}

fn corner_angle([to, from]: [DVec3; 2]) -> f64 {
    to.cross(from).length().atan2(to.dot(from))
}

/// The normal of a facet with these corners, or zero.
pub(super) fn facet_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    // Edges first to unit length, so that the product of two short ones is no underflow.
    (b - a).normalize_or_zero().cross((c - a).normalize_or_zero()).normalize_or_zero()
}

/// [`vertex_normals`] after `steps` rounds of means over each vertex and its neighbours by area. A radius of √steps edges.
/// Vertices of smooth `rims` ([`Net::rims`]) begin with normals from [`extrapolate_to_rims`] and have means along these rims alone:
/// means over the surface on one side would let curvature vanish there.
///
/// Noise of a scan turns normals either way and averages out; on spheres, cylinders and planes the mean is the normal.
pub(super) fn smoothed_normals(
    net: &Net,
    rims: &[[u32; 2]],
    steps: usize,
    token: &Token,
) -> Result<Vec<DVec3>, Stopped> {
    let mut normals = vertex_normals(net);
    let along = smooth_rims(net, rims);
    extrapolate_to_rims(net, &along, &mut normals);
    // Seen from inside, a rim stands for what would be beyond it too.
    let weight = |v: usize| if along.of(v as u32).is_empty() { net.area[v] } else { 2.0 * net.area[v] };
    let weights: Vec<f64> = tasks::map(net.vertices(), weight);
    for _ in 0..steps {
        token.check()?;
        normals = tasks::map(normals.len(), |v| {
            let of = |to: u32| weights[to as usize] * normals[to as usize];
            let sum: DVec3 = match along.of(v as u32) {
                [] => net.neighbours(v).iter().map(|&(to, _)| of(to)).sum(),
                beside => beside.iter().map(|&to| of(to)).sum(),
            };
            (sum + weights[v] * normals[v]).try_normalize().unwrap_or(normals[v])
        });
    }
    Ok(normals)
}

/// The two neighbours along the rim of each vertex at which a rim is smooth.
fn smooth_rims(net: &Net, rims: &[[u32; 2]]) -> Csr<u32> {
    let mut along: Vec<(u32, u32)> = rims.iter().flat_map(|&[a, b]| [(a, b), (b, a)]).collect();
    along.sort_unstable();
    let to = |v: u32, to: u32| (net.points[to as usize] - net.points[v as usize]).normalize_or_zero();
    let is_smooth = |ends: &&[(u32, u32)]| match **ends {
        [(v, a), (_, b)] => to(v, a).dot(to(v, b)) < -SMOOTH_RIM,
        _ => false,
    };
    let smooth: Vec<(u32, u32)> = along.chunk_by(|a, b| a.0 == b.0).filter(is_smooth).flatten().copied().collect();
    Csr::from_pairs(net.vertices(), &smooth)
}

/// A vertex of a rim has the normal of a place inside, where its facets are. It gets that of its own place: normals change at the same rate
/// from there to the facets as on to the neighbours inside. `along`: [`smooth_rims`].
fn extrapolate_to_rims(net: &Net, along: &Csr<u32>, normals: &mut [DVec3]) {
    let rim: Vec<u32> = (0..net.vertices() as u32).filter(|&v| along.of(v).len() == 2).collect();
    let frames: Vec<[DVec3; 2]> = tasks::map(rim.len(), |k| rim_frame(net, along, rim[k]));
    let mut number = vec![u32::MAX; net.vertices()];
    rim.iter().zip(0..).for_each(|(&v, k)| number[v as usize] = k);
    // Where each vertex's facets are in its frame, by angle as their normals are.
    let mut sums = vec![([0.0; 2], 0.0); rim.len()];
    for &(v, _) in &net.facets {
        let p = v.map(|v| net.points[v as usize]);
        for e in 0..3 {
            let Some(sum) = sums.get_mut(number[v[e] as usize] as usize) else { continue };
            let ends = [p[(e + 1) % 3] - p[e], p[(e + 2) % 3] - p[e]];
            let angle = corner_angle(ends);
            // A facet of a cylinder has the normal midway, whichever corner is there.
            let midway = |axis: DVec3| {
                let [a, b] = ends.map(|end| end.dot(axis));
                0.5 * (a.max(b).max(0.0) + a.min(b).min(0.0))
            };
            let place = frames[number[v[e] as usize] as usize].map(midway);
            *sum = ([0, 1].map(|k| sum.0[k] + angle * place[k]), sum.1 + angle);
        }
    }
    let at_rim = |k: usize| {
        let (v, axes, (sum, angles)) = (rim[k], frames[k], sums[k]);
        let own = normals[v as usize];
        let ends = [0, 1].map(|end| along.of(v)[end] as usize);
        let length = (net.points[ends[1]] - net.points[ends[0]]).dot(axes[0]);
        let per_length = (normals[ends[1]] - normals[ends[0]]) / length;
        let (place, normal) = mean_inside(net, along, v, normals);
        let (near, far) = (sum.map(|at| at / angles), axes.map(|axis| place.dot(axis)));
        let (at_near, at_far) = (own - near[0] * per_length, normal - far[0] * per_length);
        let share = near[1] / (far[1] - near[1]);
        let known = length > 0.0 && near[1] > 0.0 && far[1] > near[1];
        if known { (at_near - share.min(1.0) * (at_far - at_near)).try_normalize().unwrap_or(own) } else { own }
    };
    let at: Vec<DVec3> = tasks::map(rim.len(), at_rim);
    rim.iter().zip(at).for_each(|(&v, normal)| normals[v as usize] = normal);
}

/// Unit directions along the rim at a vertex and inwards from it; zero where there are none.
fn rim_frame(net: &Net, along: &Csr<u32>, v: u32) -> [DVec3; 2] {
    let tangent = along.of(v).iter().fold(DVec3::ZERO, |sum, &to| net.points[to as usize] - sum).normalize_or_zero();
    let (place, _) = mean_inside(net, along, v, &[]);
    [tangent, (place - place.dot(tangent) * tangent).normalize_or_zero()]
}

/// The mean place of the neighbours that are on no rim, from `v`, and their normals', by area. Not finite where there are none.
fn mean_inside(net: &Net, along: &Csr<u32>, v: u32, normals: &[DVec3]) -> (DVec3, DVec3) {
    let (mut place, mut normal, mut area) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for &(to, _) in net.neighbours(v as usize).iter().filter(|&&(to, _)| along.of(to).is_empty()) {
        let own = net.area[to as usize];
        place += own * (net.points[to as usize] - net.points[v as usize]);
        normal += own * normals.get(to as usize).copied().unwrap_or_default();
        area += own;
    }
    (place / area, normal / area)
}
