//! Local feature size: how far the medial axis is.
//!
//! Purpose: the distance of every vertex to the nearest centre of a ball that touches the surface twice, found by
//! shrinking balls (Ma, Bae, Choi, *3D medial axis point approximation using nearest neighbors and the normal
//! field*, The Visual Computer 28, 2012). It stands in for the poles of a Voronoi diagram in space (Amenta, Bern
//! 1999): no such diagram is needed, and a threshold on an angle deals with noise.
//! Invariant: at least 0, finite, at most [`FAR`]; the same bits with any number of threads.
//! Must not know: sizes.

use std::f64::consts::PI;
use std::ops::Range;

use glam::DVec3;

use super::net::Net;
use super::normals;
use crate::knn::{SeedIndex, Threads};
use crate::tasks;
use crate::token::{Stopped, Token};

/// Radius of the first ball, and what a surface without medial axis has: the bounding box's longest side. A ball that
/// touches two points of the box and is larger says nothing of features.
pub(super) const FAR: f64 = 1.0;
/// A ball stops shrinking before its two touching points are seen from its centre under a smaller angle, if they are
/// on one sheet: they are then neighbours, and what the ball would measure is noise or the faceting. A normal that is off by δ makes a
/// radius wrong by about δ over half of this angle. 60 degrees.
const LEAST_ANGLE: f64 = PI / 3.0;
/// Points whose normals are farther apart are of two sheets (cosine; 120 degrees): a large ball that ends at the other one
/// under whatever angle goes on shrinking. Beside the tip of a slender cone the first balls lean over to where it is wider.
const FACING: f64 = -0.5;
/// A ball below half the distance of samples is kept only if its points are about opposite: two sheets. 135 degrees.
const OPPOSITE: f64 = 0.75 * PI;
/// Samples that are put into large facets, at about equal distances.
const SAMPLES: f64 = 10_000.0;
/// The most samples of each kind; of more vertices than this every k-th is one.
const MOST_SAMPLES: usize = 200_000;
/// Balls grow from about this many samples of each kind, on both sides. Beside a ball's centre all samples may be at about the same
/// distance (a sphere), so that a query visits them all: these two bounds keep the whole from becoming quadratic.
/// What is thinner than a hundredth of the surface's width is not resolved.
const SOURCES: usize = 10_000;
/// Normals of corners that are off their facet's by more belong to an edge (cosine; 37 degrees): samples of the facet
/// then have the facet's normal, else the interpolated one, as facets of a round surface ask for.
const SMOOTH: f64 = 0.8;
/// A ball shrinks to a fraction each time; nearly all end after fewer than ten.
const ROUNDS: usize = 40;

/// For each vertex the distance to the nearest medial point, per extent of the mesh.
pub(super) struct FeatureSize {
    pub(super) all: Vec<f64>,
    /// The nearest of those between two sheets, of which the other ones are the folds of one.
    pub(super) between_sheets: Vec<f64>,
}

/// Samples are the vertices, and points inside facets that are larger than the spacing of [`SAMPLES`] points.
pub(super) fn local(net: &Net, token: &Token) -> Result<FeatureSize, Stopped> {
    let Samples { points, normals: sample_normals, spacing, first_inner } = samples(net);
    let index = SeedIndex::with_threads(&points, Threads::One);
    let every = |range: Range<usize>| range.clone().step_by(range.len().div_ceil(SOURCES).max(1));
    let sources: Vec<usize> = every(0..first_inner).chain(every(first_inner..points.len())).collect();
    let of_source = |(): &mut (), k: usize| {
        token.check()?;
        let i = sources[k];
        let resolved = |ball: &Ball| ball.radius >= 0.5 * spacing[i] || ball.angle >= OPPOSITE;
        let ball = |n| ball(&index, &points, &sample_normals, i, n);
        Ok([sample_normals[i], -sample_normals[i]].map(|n| ball(n).filter(resolved)))
    };
    let balls: Vec<[Option<Ball>; 2]> = tasks::try_map(sources.len(), || (), of_source)?;
    let balls: Vec<Ball> = balls.into_iter().flatten().flatten().collect();
    let (sheets, folds): (Vec<Ball>, Vec<Ball>) = balls.into_iter().partition(|ball| ball.angle >= OPPOSITE);
    let between_sheets = distances(net, &thinned(sheets), token)?;
    let within_folds = distances(net, &thinned(folds), token)?;
    let all = between_sheets.iter().zip(within_folds).map(|(&sheet, fold)| sheet.min(fold)).collect();
    Ok(FeatureSize { all, between_sheets })
}

fn distances(net: &Net, centres: &[DVec3], token: &Token) -> Result<Vec<f64>, Stopped> {
    if centres.is_empty() {
        return Ok(vec![FAR; net.vertices()]);
    }
    let axis = SeedIndex::with_threads(centres, Threads::One);
    let distance = |(): &mut (), v: usize| {
        token.check_at(64 * v)?;
        let p = &net.points[v];
        Ok(centres[axis.nearest(*p) as usize].distance(*p).min(FAR))
    };
    tasks::try_map(net.points.len(), || (), distance)
}

struct Ball {
    centre: DVec3,
    radius: f64,
    /// Under which its two points are seen from the centre.
    angle: f64,
}

/// One centre for each small part of a radius, so that a thousand centres in one place are one.
fn thinned(balls: Vec<Ball>) -> Vec<DVec3> {
    let key = |ball: &Ball| {
        let level = ball.radius.log2().floor();
        let cell = (ball.centre * (128.0 / level.exp2())).floor();
        (level as i64, [cell.x, cell.y, cell.z].map(|x| x as i64))
    };
    let mut all: Vec<_> = balls.into_iter().map(|ball| (key(&ball), ball.centre)).collect();
    // Stable: of one cell the first source's stays.
    all.sort_by_key(|entry| entry.0);
    all.dedup_by_key(|entry| entry.0);
    all.into_iter().map(|entry| entry.1).collect()
}

/// The largest ball at sample `i` on side `n` (plus or minus its normal) without samples of others, if it touches one.
fn ball(index: &SeedIndex, points: &[DVec3], normals: &[DVec3], i: usize, n: DVec3) -> Option<Ball> {
    let p = points[i];
    if n == DVec3::ZERO {
        return None;
    }
    let (mut radius, mut seen) = (FAR, None);
    for _ in 0..ROUNDS {
        let centre = p + n * radius;
        let nearest = index.nearest(centre) as usize;
        let across = points[nearest] - p;
        let inside = points[nearest].distance(centre) < radius * (1.0 - 1e-9);
        // The ball through p, tangent there, and the other point.
        let height = 2.0 * n.dot(across);
        if nearest == i || !inside || height <= 0.0 {
            break;
        }
        let smaller = across.length_squared() / height;
        // Seen from the centre the chord has this half-angle's sine.
        let angle = 2.0 * (0.5 * across.length() / smaller).min(1.0).asin();
        if angle >= LEAST_ANGLE {
            seen = Some((smaller, angle));
        } else if normals[nearest].dot(normals[i]) > FACING {
            break;
        }
        radius = smaller;
    }
    seen.map(|(radius, angle)| Ball { centre: p + n * radius, radius, angle })
}

struct Samples {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    spacing: Vec<f64>,
    /// Vertices come before this one, points inside facets from here.
    first_inner: usize,
}

fn samples(net: &Net) -> Samples {
    let vertex_normals = normals::vertex_normals(net);
    let (mut points, mut directions, mut spacing) = (Vec::new(), Vec::new(), Vec::new());
    for v in (0..net.vertices()).step_by(net.vertices().div_ceil(MOST_SAMPLES)) {
        let around = net.neighbours(v);
        if !around.is_empty() {
            points.push(net.points[v]);
            directions.push(vertex_normals[v]);
            spacing.push(around.iter().map(|end| end.1).sum::<f64>() / around.len() as f64);
        }
    }
    let first_inner = points.len();
    let mut step = (net.outline.area / SAMPLES).sqrt();
    while net.facets.iter().map(|&(v, _)| Grid::of(net, v, step).size()).sum::<usize>() > MOST_SAMPLES {
        step *= 1.5;
    }
    for &(v, _) in &net.facets {
        let grid = Grid::of(net, v, step);
        let corners = grid.normals(&vertex_normals);
        for j in 0..grid.rows {
            let w = (f64::from(j) + 0.5) / f64::from(grid.rows);
            for i in 0..grid.columns {
                let u = (f64::from(i) + 0.5) / f64::from(grid.columns) * (1.0 - w);
                points.push(grid.base + u * grid.along + w * grid.across);
                directions.push((corners[0] * (1.0 - u - w) + corners[1] * u + corners[2] * w).normalize_or_zero());
                spacing.push(step);
            }
        }
    }
    // A vertex of a facet that got samples is not farther from its neighbours than these.
    spacing.iter_mut().for_each(|s| *s = s.min(2.0 * step));
    Samples { points, normals: directions, spacing, first_inner }
}

/// Samples of one facet: rows along its longest edge.
struct Grid {
    corners: [u32; 3],
    base: DVec3,
    along: DVec3,
    across: DVec3,
    rows: u32,
    columns: u32,
}

impl Grid {
    fn of(net: &Net, v: [u32; 3], step: f64) -> Self {
        let p = v.map(|v| net.points[v as usize]);
        let length = |e: usize| (p[(e + 1) % 3] - p[e]).length();
        let mut longest = 0;
        for e in 1..3 {
            if length(e) > length(longest) {
                longest = e;
            }
        }
        let (base, along, across) = (p[longest], p[(longest + 1) % 3] - p[longest], p[(longest + 2) % 3] - p[longest]);
        let count = |length: f64| (length / step).floor().min(1e6) as u32;
        let width = length(longest);
        let columns = if width < 2.0 * step { 0 } else { count(width) };
        let height = along.cross(across).length() / width;
        let corners = [0, 1, 2].map(|e| v[(longest + e) % 3]);
        Self { corners, base, along, across, rows: if columns == 0 { 0 } else { count(height).max(1) }, columns }
    }

    /// What to interpolate: the corners' normals, or the facet's own.
    fn normals(&self, of_vertices: &[DVec3]) -> [DVec3; 3] {
        let own = normals::facet_normal([self.base, self.base + self.along, self.base + self.across]);
        let corners = self.corners.map(|v| of_vertices[v as usize]);
        if corners.iter().all(|n| n.dot(own) > SMOOTH) { corners } else { [own; 3] }
    }

    fn size(&self) -> usize {
        self.rows as usize * self.columns as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::TriMesh;
    use crate::mesh::shapes::Shape;
    use glam::dvec3;

    /// Relative errors against `want` (caller's units): median and largest.
    fn errors(mesh: &TriMesh, want: impl Fn(DVec3) -> f64) -> [f64; 2] {
        let net = Net::new(mesh, &Token::default()).unwrap();
        let got = local(&net, &Token::default()).unwrap().all;
        let off = mesh.positions().iter().zip(&got).map(|(&p, d)| (d * net.outline.extent / want(p) - 1.0).abs());
        let mut off: Vec<f64> = off.collect();
        off.sort_by(f64::total_cmp);
        [off[off.len() / 2], off[off.len() - 1]]
    }

    #[test]
    fn a_sphere_has_its_radius() {
        // A ball ends at a sample that is up to half an edge (0.025) beside the antipode; centres are found within
        // the square of that.
        let got = errors(&Shape::Sphere.build(5000), |_| 1.0);
        println!("sphere: {got:?}");
        assert!(got[0] < 0.01 && got[1] < 0.03, "{got:?}");
    }

    #[test]
    fn a_torus_has_its_tube_or_its_hole() {
        for tube in [0.4, 0.7] {
            let mesh = Shape::Torus.build(8000);
            let ring = |p: DVec3| dvec3(p.x, p.y, 0.0).normalize();
            let positions = mesh.positions().iter().map(|&p| ring(p) + (p - ring(p)) * (tube / 0.4)).collect();
            let mesh = TriMesh::new(positions, mesh.facets().to_vec()).unwrap();
            // The medial axis is the circle inside the tube, and the axis of rotation.
            let got = errors(&mesh, |p| dvec3(p.x, p.y, 0.0).length().min(tube));
            println!("torus {tube}: {got:?}");
            // Edges of 0.06: balls touch within half of that.
            assert!(got[0] < 0.02 && got[1] < 0.1, "{got:?}");
        }
    }

    #[test]
    fn a_slender_cone_is_thin_up_to_its_tip() {
        // Twenty times as high as wide, in 200 rings of 64; the first balls beside it are as large as it is high.
        let ring = |k: u32| (0..64u32).map(move |i| (k, i));
        let at = |(k, i): (u32, u32)| {
            let (r, turn) = (1.0 - f64::from(k) / 200.0 * 0.995, f64::from(i) / 64.0 * std::f64::consts::TAU);
            dvec3(r * turn.cos(), r * turn.sin(), 20.0 * f64::from(k) / 200.0)
        };
        let vertex = |k: u32, i: u32| 64 * k + i % 64;
        let quad = |(k, i)| {
            let [a, b, c, d] = [vertex(k, i), vertex(k, i + 1), vertex(k + 1, i + 1), vertex(k + 1, i)];
            [[a, b, c], [a, c, d]]
        };
        let facets = (0..200).flat_map(ring).flat_map(quad).collect();
        let mesh = TriMesh::new((0..=200).flat_map(ring).map(at).collect(), facets).unwrap();
        let net = Net::new(&mesh, &Token::default()).unwrap();
        let size = local(&net, &Token::default()).unwrap().all;
        for (p, size) in mesh.positions().iter().zip(&size).filter(|(p, _)| p.z > 0.5) {
            // The axis is as far as the ring is wide. A ball may end at another ring, so a ring and a half to spare; where none
            // was found, lengths were 0.2 off and more.
            let (radius, got) = (p.truncate().length(), size * net.outline.extent);
            assert!(got < radius + 0.15, "{p}: {got} for {radius}");
        }
    }

    #[test]
    fn two_sheets_have_half_their_gap_and_a_plane_has_none() {
        // Two triangles each: the samples inside facets do the work. 0.3 apart, sample distance 0.006.
        let sheet = |z: f64| [dvec3(0., 0., z), dvec3(1., 0., z), dvec3(1., 1., z), dvec3(0., 1., z)];
        let points = sheet(0.0).into_iter().chain(sheet(0.3)).collect();
        let mesh = TriMesh::new(points, vec![[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]).unwrap();
        let got = errors(&mesh, |_| 0.15);
        println!("two sheets: {got:?}");
        assert!(got[1] < 0.03, "{got:?}");
        let fine = Shape::Sheets.build(4000);
        let (low, high) = fine.bounds();
        let got = errors(&fine, |_| 0.5 * (high.z - low.z));
        println!("fine sheets: {got:?}");
        assert!(got[1] < 0.1, "{got:?}");
        for shape in [Shape::Plane, Shape::Square] {
            assert!(
                local(&Net::new(&shape.build(1000), &Token::default()).unwrap(), &Token::default())
                    .unwrap()
                    .all
                    .iter()
                    .all(|&d| d == FAR),
                "{shape}"
            );
        }
    }
}
