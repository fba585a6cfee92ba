//! Principal curvatures of a triangle surface.
//!
//! Purpose: the largest curvature at each vertex, after Rusinkiewicz, *Estimating Curvatures and Their
//! Derivatives on Triangle Meshes* (3DPVT 2004, section 3): in each facet the tensor that best explains how
//! the corners' normals differ along its edges, carried to the corners and averaged there by area.
//! Invariant: finite, at least 0, or NaN without a usable facet. The same bits on any threads. Must not know: sizes.

use glam::{DMat3, DVec3};

use super::net::Net;
use super::normals::{facet_normal, smoothed_normals};
use crate::tasks;
use crate::token::{Stopped, Token};

/// Facets thinner than this (area over squared longest edges) say nothing of curvature.
const THIN: f64 = 1e-6;

/// [`principal`] at each vertex, per extent of the mesh, from [`smoothed_normals`] after `steps` rounds.
pub(super) fn of(net: &Net, rims: &[[u32; 2]], steps: usize, token: &Token) -> Result<Vec<[f64; 2]>, Stopped> {
    let normals = smoothed_normals(net, rims, steps, token)?;
    let curvatures = principal(&net.points, &normals, &net.facets);
    token.check()?;
    Ok(curvatures)
}

/// The principal curvatures at points with these unit normals, the one of larger absolute value first; NaN without a usable
/// facet. Facets have areas.
pub(crate) fn principal(points: &[DVec3], normals: &[DVec3], facets: &[([u32; 3], f64)]) -> Vec<[f64; 2]> {
    let of_facet = |&(v, _): &([u32; 3], f64)| tensor(v.map(|v| points[v as usize]), v.map(|v| normals[v as usize]));
    let tensors: Vec<Option<(DVec3, DMat3)>> = tasks::map(facets.len(), |f| of_facet(&facets[f]));
    let mut sums = vec![(DMat3::ZERO, 0.0); points.len()];
    for (&(v, area), tensor) in facets.iter().zip(&tensors) {
        let Some((normal, tensor)) = tensor else { continue };
        for v in v.map(|v| v as usize) {
            let turn = rotation(*normal, normals[v]);
            sums[v].0 += turn * *tensor * turn.transpose() * area;
            sums[v].1 += area;
        }
    }
    let of = |(sum, area): (DMat3, f64)| if area > 0.0 { eigenvalues(sum * area.recip()) } else { [f64::NAN; 2] };
    tasks::map(sums.len(), |v| of(sums[v]))
}

/// The facet's normal and its second fundamental form, as a tensor of space that is zero along the normal.
fn tensor(p: [DVec3; 3], n: [DVec3; 3]) -> Option<(DVec3, DMat3)> {
    let normal = facet_normal(p);
    let edges = [p[1] - p[0], p[2] - p[1], p[0] - p[2]];
    let u = edges[0].try_normalize()?;
    let v = normal.cross(u);
    // Least squares for the three entries of a symmetric 2 x 2 matrix: six equations, two for each edge.
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    let (mut xa, mut mixed, mut yb) = (0.0, 0.0, 0.0);
    for e in 0..3 {
        let (x, y) = (edges[e].dot(u), edges[e].dot(v));
        let turn = n[(e + 1) % 3] - n[e];
        let (a, b) = (turn.dot(u), turn.dot(v));
        (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        (xa, mixed, yb) = (xa + x * a, mixed + y * a + x * b, yb + y * b);
    }
    let (trace, spread) = (xx + yy, xx * yy - xy * xy);
    if n.contains(&DVec3::ZERO) || spread.is_nan() || spread <= THIN * trace * trace {
        return None;
    }
    // Cramer's rule; the determinant is trace * spread.
    let det = trace * spread;
    let l = (xa * (trace * yy - xy * xy) - xy * (mixed * yy - xy * yb)) / det;
    let m = (xx * (mixed * yy - xy * yb) - xa * xy * yy) / det;
    let k = (xx * (trace * yb - mixed * xy) - xy * xy * yb + xa * xy * xy) / det;
    let outer = |p: DVec3, q: DVec3| DMat3::from_cols(p * q.x, p * q.y, p * q.z);
    Some((normal, outer(u, u) * l + (outer(u, v) + outer(v, u)) * m + outer(v, v) * k))
}

/// The least rotation that takes one unit vector to another; none between opposites.
fn rotation(from: DVec3, to: DVec3) -> DMat3 {
    let cosine = from.dot(to);
    if cosine < -0.999 {
        return DMat3::IDENTITY;
    }
    let axis = from.cross(to);
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    DMat3::IDENTITY + cross + cross * cross * (1.0 / (1.0 + cosine))
}

/// The eigenvalues of a symmetric tensor whose third eigenvalue is 0, the one of larger absolute value first.
fn eigenvalues(m: DMat3) -> [f64; 2] {
    let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
    let squares = m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared();
    let half = 0.5 * trace;
    let apart = (0.5 * squares - half * half).max(0.0).sqrt();
    let sign = 1f64.copysign(half);
    [half + sign * apart, half - sign * apart]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::shapes::Shape;
    use glam::dvec3;

    /// Relative errors of the larger one against `want` per caller's unit: median and 99th percentile.
    fn errors(mesh: &TriMesh, steps: usize, want: impl Fn(DVec3) -> f64) -> [f64; 2] {
        let net = Net::new(mesh, &Token::default()).unwrap();
        let got = of(&net, &net.rims(|v| mesh.positions()[v]), steps, &Token::default()).unwrap();
        let mut off: Vec<f64> = mesh
            .positions()
            .iter()
            .zip(&got)
            .map(|(&p, k)| (k[0].abs() / net.outline.extent / want(p) - 1.0).abs())
            .collect();
        off.sort_by(f64::total_cmp);
        [off[off.len() / 2], off[off.len() * 99 / 100]]
    }

    /// A torus of radii 1 and `tube`.
    fn torus(tube: f64) -> (TriMesh, impl Fn(DVec3) -> f64) {
        let mesh = Shape::Torus.build(8000);
        let ring = |p: DVec3| dvec3(p.x, p.y, 0.0).normalize();
        let positions = mesh.positions().iter().map(|&p| ring(p) + (p - ring(p)) * (tube / 0.4)).collect();
        let mesh = TriMesh::new(positions, mesh.facets().to_vec()).unwrap();
        // Around the tube 1/tube; around the axis cos t / (1 + tube cos t).
        let want = move |p: DVec3| {
            let radius = dvec3(p.x, p.y, 0.0).length();
            (1.0 / tube).max(((radius - 1.0) / tube / radius).abs())
        };
        (mesh, want)
    }

    #[test]
    fn spheres_cylinders_and_tori_have_their_curvatures() {
        // Second order in edge over radius: a sphere of 5000 facets has edges of 0.05, a torus of 8000
        // edges of 0.06 on a tube of 0.4. Smoothing in 4 rounds mixes normals over 2 edges, and rings
        // that are not even (where a solid's faces meet) tilt the mean.
        for (steps, most) in [(0, [0.01, 0.03]), (4, [0.06, 0.15])] {
            let sphere = Shape::Sphere.build(5000);
            let got = errors(&sphere, steps, |_| 1.0);
            println!("sphere, {steps} steps: {got:?}");
            assert!(got[0] < most[0] && got[1] < most[1], "{got:?}");
            for tube in [0.4, 0.7] {
                let (mesh, want) = torus(tube);
                let got = errors(&mesh, steps, want);
                println!("torus {tube}, {steps} steps: {got:?}");
                assert!(got[0] < 2.0 * most[0] && got[1] < 3.0 * most[1], "{got:?}");
            }
            // A cylinder's open ends see facets on one side only.
            let sheet = Shape::Plane.build(5000);
            let bent = sheet.positions().iter().map(|p| dvec3(p.x.cos(), p.x.sin(), p.y)).collect();
            let cylinder = TriMesh::new(bent, sheet.facets().to_vec()).unwrap();
            let got = errors(&cylinder, steps, |_| 1.0);
            println!("cylinder, {steps} steps: {got:?}");
            assert!(got[0] < most[0] && got[1] < most[1], "{got:?}");
        }
    }

    /// Noise of a twentieth of an edge along the normal makes curvatures of several times the sphere's;
    /// smoothed over six edges the median is the sphere's to 15 %.
    #[test]
    fn noise_averages_out() {
        let sphere = Shape::Sphere.build(20_000);
        let edge = 0.025;
        let noise = |v: usize| ((v as f64 * 12.9898).sin() * 43_758.547).fract() - 0.5;
        let rough = sphere.positions().iter().enumerate().map(|(v, &p)| p * (1.0 + 0.1 * edge * noise(v))).collect();
        let rough = TriMesh::new(rough, sphere.facets().to_vec()).unwrap();
        let [raw, _] = errors(&rough, 0, |_| 1.0);
        let [smooth, most] = errors(&rough, 36, |_| 1.0);
        println!("noisy sphere: {raw} off, smoothed {smooth}, at most {most}");
        assert!(smooth < 0.15 && smooth < 0.3 * raw, "{smooth}, {raw}");
    }

    #[test]
    fn planes_and_rubbish_have_finite_curvatures() {
        for shape in Shape::ALL {
            let mesh = shape.build(500);
            let net = Net::new(&mesh, &Token::default()).unwrap();
            let got = of(&net, &net.rims(|v| mesh.positions()[v]), 3, &Token::default()).unwrap();
            assert!(got.iter().all(|k| k[0].is_nan() || k[0].is_finite() && k[0].abs() >= k[1].abs()), "{shape}");
            if matches!(shape, Shape::Plane | Shape::Square) {
                assert!(got.iter().all(|&k| k == [0.0; 2]), "{shape}");
            }
        }
    }
}
