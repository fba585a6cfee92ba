//! The closest point of a surface.
//!
//! Purpose: [`ClosestPoint`] finds the point of a surface nearest to a given one, with its facet and barycentric coordinates.
//! Invariant: an answer is a point of the surface, is the nearest up to rounding, and among facets at the same distance
//! names the lowest; it does not depend on the shape of the hierarchy. Facets without area are ignored. Queries are `Sync`.
//! Must not know: samples, quality.

use glam::DVec3;
use pulp::Arch;
use rayon::prelude::*;

use super::TriMesh;
use super::adjacency::weld_unless;
use super::bvh::{self, Bvh, morton};
use super::csr::Csr;
use crate::tasks;
use crate::token::{Pace, Stopped, Token};

/// A point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position, caller's coordinates.
    pub position: DVec3,
    /// On which facet.
    pub facet: u32,
    /// Barycentric coordinates in it: at least 0, their sum is 1 up to rounding.
    pub barycentric: [f64; 3],
}

/// Answers closest-point queries on one surface.
pub struct ClosestPoint {
    tree: Bvh,
    centre: DVec3,
    scale: f64,
    positions: Vec<DVec3>,
    unit: Vec<DVec3>,
    /// Facets with area, with their numbers in the mesh, neighbours side by side. A slender one is there once for each piece.
    facets: Vec<Facet>,
}

/// Corners of a facet, and its number in the mesh.
type Facet = ([u32; 3], u32);

/// The nearest facet so far: squared distance, place in `ClosestPoint::facets`, barycentrics; and how many were looked at.
#[derive(Clone, Copy)]
struct Nearest {
    squared: f64,
    leaf: u32,
    barycentric: [f64; 3],
    visited: usize,
}

/// Points of one task.
const RUN: usize = 256;
/// Steps of a search beyond one for each facet that it looks at.
const STEPS: usize = 16;

/// Farther away than this many unit boxes, only the direction of a point counts.
const FAR: f64 = 1e100;

impl ClosestPoint {
    /// Sorts the facets and puts boxes around them.
    pub fn new(mesh: &TriMesh) -> Self {
        Self::build(mesh, &Token::default())
    }

    /// As [`Self::new`], unless it is stopped.
    pub fn unless(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let built = Self::build(mesh, token);
        token.check().map(|()| built)
    }

    /// Ends early, with what it has, once the token is stopped.
    fn build(mesh: &TriMesh, token: &Token) -> Self {
        let (low, high) = mesh.bounds();
        let centre = low * 0.5 + high * 0.5;
        let scale = inverse_power_of_two((high - low).max_element());
        let unit: Vec<DVec3> = mesh.positions().iter().map(|&p| (p - centre) * scale).collect();
        let mut facets = distinct_facets(mesh, token).unwrap_or_default();
        let corners = |facet: &Facet| facet.0.map(|v| unit[v as usize]);
        let centroid = |corners: [DVec3; 3]| corners.iter().sum::<DVec3>() / 3.0;
        // Nothing is asked of what was stopped.
        let left = |count: usize| if token.check().is_err() { 1 } else { count };
        let tree = match in_pieces(&facets, corners, token) {
            Some(mut pieces) => {
                bvh::arrange(&mut pieces, &|([low, high], _)| (*low + *high) * 0.5, token);
                pieces.truncate(left(pieces.len()));
                let (boxes, arranged): (Vec<[DVec3; 2]>, _) = pieces.into_iter().unzip();
                facets = arranged;
                Bvh::new(&boxes)
            }
            None => {
                bvh::arrange(&mut facets, &|facet| centroid(corners(facet)), token);
                facets.truncate(left(facets.len()));
                let things: Vec<[DVec3; 3]> = tasks::map(facets.len(), |k| corners(&facets[k]));
                Bvh::new(&things)
            }
        };
        Self { tree, centre, scale, positions: mesh.positions().to_vec(), unit, facets }
    }

    /// Transforms the coordinates of queries and answers: p becomes p / `scale` + `centre`. The scale is a power of two.
    pub fn moved(mut self, centre: DVec3, scale: f64) -> Self {
        self.positions.par_iter_mut().for_each(|p| *p = *p / scale + centre);
        self.centre = self.centre / scale + centre;
        self.scale *= scale;
        self
    }

    /// The closest point of the surface to `p` (finite); the lowest facet among equals.
    pub fn project(&self, p: DVec3) -> SurfacePoint {
        self.on_surface(self.nearest(p, None))
    }

    /// As [`ClosestPoint::project`], all along a curve that fills space: each search begins with the last one's facet.
    pub fn project_all(&self, points: &[DVec3], token: &Token) -> Result<Vec<SurfacePoint>, Stopped> {
        self.all(points, token, |nearest| self.on_surface(nearest))
    }

    /// As [`ClosestPoint::distance`], all points at once; see [`ClosestPoint::project_all`].
    pub fn distances(&self, points: &[DVec3], token: &Token) -> Result<Vec<f64>, Stopped> {
        self.all(points, token, |nearest| nearest.squared.sqrt() / self.scale)
    }

    fn all<T: Send + Clone>(
        &self,
        points: &[DVec3],
        token: &Token,
        answer: impl Fn(Nearest) -> T + Sync,
    ) -> Result<Vec<T>, Stopped> {
        let mut order = tasks::map(points.len(), |i| (morton(self.to_unit(points[i])), i));
        order.par_sort_unstable();
        let run = |run: &[(u64, usize)]| {
            let mut last = None;
            let mut pace = Pace::default();
            let mut found = Vec::with_capacity(run.len());
            // Boxes are compared as many at once as the processor can.
            Arch::new().dispatch(|| {
                for &(_, i) in run {
                    let nearest = self.nearest(points[i], last);
                    last = Some(nearest.leaf);
                    found.push((i, answer(nearest)));
                    // Where facets lie on one another a search may look at all of them.
                    if token.is_stopped_after(nearest.visited + STEPS, &mut pace) {
                        return;
                    }
                }
            });
            found
        };
        let runs: Vec<Vec<(usize, T)>> =
            tasks::alone(order.len().div_ceil(RUN), |k| run(&order[k * RUN..order.len().min((k + 1) * RUN)]));
        let mut answers: Vec<Option<T>> = vec![None; points.len()];
        runs.into_iter().flatten().for_each(|(i, found)| answers[i] = Some(found));
        token.check()?;
        Ok(answers.into_iter().flatten().collect())
    }

    fn on_surface(&self, nearest: Nearest) -> SurfacePoint {
        let (corners, facet) = self.facets[nearest.leaf as usize];
        let [a, b, c] = corners.map(|v| self.positions[v as usize]);
        let [wa, wb, wc] = nearest.barycentric;
        // Relative to the corner that weighs most, so that a corner is met exactly.
        let position = if wa >= wb && wa >= wc {
            a + (b - a) * wb + (c - a) * wc
        } else if wb >= wc {
            b + (a - b) * wa + (c - b) * wc
        } else {
            c + (a - c) * wa + (b - c) * wb
        };
        SurfacePoint { position, facet, barycentric: nearest.barycentric }
    }

    /// Distance of `p` (finite) from the surface, caller's units.
    pub fn distance(&self, p: DVec3) -> f64 {
        self.nearest(p, None).squared.sqrt() / self.scale
    }

    /// `hint` is a facet that may be near, as its place in `facets`; it does not change the answer.
    fn nearest(&self, p: DVec3, hint: Option<u32>) -> Nearest {
        let p = self.to_unit(p);
        // Boxes and facets round differently: a box is searched although it is farther by this.
        let slack = 4.0 * f64::EPSILON * (1.0 + p.abs().max_element());
        let of_facet = |leaf: u32| {
            let (ids, facet) = self.facets[leaf as usize];
            let (squared, barycentric) = closest_on_facet(p, ids.map(|v| self.unit[v as usize]), ids);
            (Nearest { squared, leaf, barycentric, visited: 0 }, facet)
        };
        let none = (Nearest { squared: f64::INFINITY, leaf: 0, barycentric: [1.0, 0.0, 0.0], visited: 0 }, u32::MAX);
        let mut best = hint.map_or(none, of_facet);
        let mut visited = 0;
        self.tree.nearest(p, slack, best.0.squared, |leaf| {
            visited += 1;
            let here = of_facet(leaf as u32);
            if here.0.squared < best.0.squared || (here.0.squared == best.0.squared && here.1 < best.1) {
                best = here;
            }
            best.0.squared
        });
        Nearest { visited, ..best.0 }
    }

    fn to_unit(&self, p: DVec3) -> DVec3 {
        // Halves first: the difference of two large numbers may overflow where its half does not.
        let half = p * 0.5 - self.centre * 0.5;
        let p = half * self.scale * 2.0;
        let size = p.abs().max_element();
        if size < FAR {
            return p;
        }
        let direction = half / half.abs().max_element();
        if direction.is_finite() { direction * FAR } else { DVec3::ZERO }
    }
}

/// 2^-k with the largest k for which `extent * 2^-k` is at least 1/2; 1 for 0. Within 2^±1000.
fn inverse_power_of_two(extent: f64) -> f64 {
    let exponent = ((extent.to_bits() >> 52) & 0x7ff) as i64 - 1023;
    let k = if extent > 0.0 { (-exponent - 1).clamp(-1000, 1000) } else { 0 };
    f64::from_bits(((1023 + k) as u64) << 52)
}

/// A facet that is longer than this many times its width fills little of its box: queries near a fan would look at all of it.
const SLENDER: f64 = 32.0;
/// Pieces of slender facets are about as long as this many facets of mean area are wide.
const PIECE: f64 = 4.0;
/// Pieces of a slender facet, at most; each takes 150 bytes while the hierarchy is built.
const MOST_PIECES: usize = 16;

/// Boxes of facets, several along each slender one; `None` if there is none of these.
fn in_pieces(
    facets: &[Facet],
    corners: impl Fn(&Facet) -> [DVec3; 3],
    token: &Token,
) -> Option<Vec<([DVec3; 2], Facet)>> {
    // From the end of the longest edge on.
    let longest_first = |[a, b, c]: [DVec3; 3]| {
        let [ab, bc, ca] = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
        if ab >= bc && ab >= ca {
            (ab, [a, b, c])
        } else if bc >= ca {
            (bc, [b, c, a])
        } else {
            (ca, [c, a, b])
        }
    };
    let twice = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).length();
    let is_slender = |t: [DVec3; 3]| longest_first(t).0 > SLENDER * twice(t);
    if !facets.iter().any(|facet| is_slender(corners(facet))) {
        return None;
    }
    let around = |points: &[DVec3]| {
        points.iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], &p| [low.min(p), high.max(p)])
    };
    let area: f64 = facets.iter().map(|facet| 0.5 * twice(corners(facet))).sum();
    let part = PIECE * (area / facets.len() as f64).sqrt();
    let mut all = Vec::with_capacity(facets.len());
    for (index, facet) in facets.iter().enumerate() {
        if token.check_at(index).is_err() {
            break;
        }
        let whole = corners(facet);
        let (squared, [a, b, c]) = longest_first(whole);
        let count = if is_slender(whole) { (squared.sqrt() / part) as usize } else { 1 }.clamp(1, MOST_PIECES);
        if count == 1 {
            all.push((around(&whole), *facet));
            continue;
        }
        // Where the third corner is along the longest edge, and the two sides that meet in it.
        let top = ((c - a).dot(b - a) / squared).clamp(0.0, 1.0);
        let beside = |s: f64| if s < top { a + (c - a) * (s / top) } else { b + (c - b) * ((1.0 - s) / (1.0 - top)) };
        let share = |k: usize| k as f64 / count as f64;
        for (from, to) in (0..count).map(|k| (share(k), share(k + 1))) {
            let ends = [from, to].map(|s| [a + (b - a) * s, if s == 1.0 { b } else { beside(s) }]);
            let [[p, q], [r, s]] = ends;
            let corner = if (from..=to).contains(&top) { c } else { p };
            all.push((around(&[p, q, r, s, corner]), *facet));
        }
    }
    Some(all)
}

/// Facets with area; of coincident ones the lowest: else all of them would be nearest, and every query visit all.
fn distinct_facets(mesh: &TriMesh, token: &Token) -> Result<Vec<Facet>, Stopped> {
    let representative = weld_unless(mesh, token)?;
    let place = |f: usize| {
        let mut place = mesh.facets()[f].map(|v| representative[v as usize]);
        place.sort_unstable();
        place
    };
    let is_solid = |f: &usize| !mesh.is_degenerate(*f);
    let facets = 0..mesh.facets().len();
    // Side by side by their lowest vertex, of each the lowest facet first.
    let lowest: Vec<u32> = facets.clone().map(|f| if is_solid(&f) { place(f)[0] } else { u32::MAX }).collect();
    let mut around = Csr::group(mesh.positions().len(), &lowest, |f| {
        let [_, rest @ ..] = place(f);
        (rest, f as u32)
    });
    let mut again = vec![false; facets.len()];
    for v in 0..mesh.positions().len() as u32 {
        token.check_at(v as usize)?;
        let range = around.range(v);
        let here = &mut around.all_mut()[range];
        here.sort_unstable();
        here.windows(2).filter(|two| two[0].0 == two[1].0).for_each(|two| again[two[1].1 as usize] = true);
    }
    Ok(facets.filter(is_solid).filter(|&f| !again[f]).map(|f| (mesh.facets()[f], f as u32)).collect())
}

/// A barycentric coordinate is off by a few roundings times the product of the lengths that it was computed from, by the facet's
/// area. While that is less than the root of the first it is less than the second, and says on which side of an edge a point is.
const SURE: f64 = 1e16;
const SEEN: f64 = 1e-6;

/// Squared distance of `p` from a facet, and barycentric coordinates of the nearest point. All are of the order of 1.
pub fn closest_on_facet(p: DVec3, [a, b, c]: [DVec3; 3], ids: [u32; 3]) -> (f64, [f64; 3]) {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let normal = ab.cross(ac);
    let whole = normal.length_squared();
    let (v, w) = (ap.cross(ac).dot(normal), ab.cross(ap).dot(normal));
    if v >= 0.0 && w >= 0.0 && v + w <= whole && whole > 0.0 {
        let (v, w) = (v / whole, w / whole);
        return ((ap - ab * v - ac * w).length_squared(), [(1.0 - v - w).max(0.0), v, w]);
    }
    // Outside: the nearest of the edges that can be seen from there; of all three where rounding hides which these are.
    let corners = [a, b, c];
    let sure = ap.length_squared() * (ab.length_squared() + ac.length_squared()) <= SURE * whole;
    let seen = |side: f64| !sure || side <= SEEN * whole;
    let mut best = (f64::INFINITY, [1.0, 0.0, 0.0]);
    for (i, j, side) in [(0, 1, w), (1, 2, whole - v - w), (2, 0, v)] {
        if !seen(side) {
            continue;
        }
        // From the lower vertex, so that both facets of an edge compute the same bits.
        let (i, j) = if ids[i] <= ids[j] { (i, j) } else { (j, i) };
        let (from, along) = (corners[i], corners[j] - corners[i]);
        let length = along.length_squared();
        let t = if length > 0.0 { ((p - from).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
        let apart = if t == 1.0 { p - corners[j] } else { p - from - along * t };
        let squared = apart.length_squared();
        if squared < best.0 {
            let mut barycentric = [0.0; 3];
            barycentric[i] = 1.0 - t;
            barycentric[j] = t;
            best = (squared, barycentric);
        }
    }
    best
}

/// Distance of a point from a segment.
pub fn distance_to_segment(p: DVec3, [a, b]: [DVec3; 2]) -> f64 {
    let along = b - a;
    let squared = along.length_squared();
    let t = if squared > 0.0 { ((p - a).dot(along) / squared).clamp(0.0, 1.0) } else { 0.0 };
    p.distance(a + t * along)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn a_moved_surface_answers_as_one_that_was_there() {
        let mesh = Shape::Torus.build(2000);
        let (centre, scale) = (DVec3::new(3.0, -1.0, 0.5), 0.25);
        let there = mesh.positions().iter().map(|&p| p / scale + centre).collect();
        let there = ClosestPoint::new(&TriMesh::new(there, mesh.facets().to_vec()).unwrap());
        let moved = ClosestPoint::new(&mesh).moved(centre, scale);
        for k in 1..500 {
            let p = 4.0 * DVec3::new(f64::from(k).sin(), f64::from(3 * k).cos(), f64::from(k * k).sin()) + centre;
            let (want, got) = (there.project(p), moved.project(p));
            // Coordinates up to 10.
            assert!(want.position.distance(got.position) < 1e-13 && want.facet == got.facet, "{k}: {got:?}, {want:?}");
            assert!((there.distance(p) - moved.distance(p)).abs() < 1e-13);
        }
    }

    /// The answer is that of looking at all facets, for few of them.
    #[test]
    fn fans_of_slender_facets_are_looked_at_in_pieces() {
        const FACETS: u32 = 4000;
        let rim = |k: u32| (f64::from(k % FACETS) / f64::from(FACETS) * std::f64::consts::TAU).sin_cos();
        let place = |k| DVec3::new(rim(k).0, rim(k).1, 0.001 * f64::from(k % 2));
        let positions = [DVec3::Z * 0.3].into_iter().chain((0..FACETS).map(place)).collect();
        let facets = (0..FACETS).map(|k| [0, 1 + k, 1 + (k + 1) % FACETS]).collect();
        let mesh = TriMesh::new(positions, facets).unwrap();
        let closest = ClosestPoint::new(&mesh);
        let pieces = closest.facets.len() / FACETS as usize;
        assert!((4..=MOST_PIECES).contains(&pieces), "{pieces}");
        let mut visited = 0;
        for k in 0..300 {
            // Near the surface, as vertices of a remesh are.
            let (x, y) = f64::from(7 * k).sin_cos();
            let (r, off) = (f64::from(k) / 300.0, 1e-3 * f64::from(k * k).sin());
            let p = DVec3::new(r * x, r * y, 0.3 * (1.0 - r) + off);
            let found = closest.nearest(p, None);
            visited += found.visited;
            let all = (0..FACETS).map(|f| {
                let ids = mesh.facets()[f as usize];
                (closest_on_facet(closest.to_unit(p), ids.map(|v| closest.unit[v as usize]), ids).0, f)
            });
            let least = all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
            assert_eq!((found.squared, closest.facets[found.leaf as usize].1), least);
        }
        assert!(visited < 300 * FACETS as usize / 8, "{visited}");
        assert_eq!(ClosestPoint::new(&Shape::Torus.build(2000)).facets.len(), Shape::Torus.build(2000).facets().len());
    }

    #[test]
    fn edges_that_cannot_be_seen_are_not_the_nearest() {
        let number = |k: u32| f64::from(k.wrapping_mul(2_654_435_761) >> 8) / f64::from(1 << 24) - 0.5;
        let point = |k: u32| DVec3::new(number(3 * k), number(3 * k + 1), number(3 * k + 2));
        let to_segment = |p: DVec3, a: DVec3, b: DVec3| {
            let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
            p.distance(a + t * (b - a))
        };
        for k in 0..20_000 {
            let (a, b) = (point(4 * k), point(4 * k + 1));
            // One in three is a sliver, flatter and flatter.
            let flat = if k % 3 == 0 { 10f64.powi(-(k as i32 % 17)) } else { 1.0 };
            let c = a.lerp(b, number(7 * k) + 0.5) + flat * point(4 * k + 2);
            let p = 2.0 * point(4 * k + 3);
            let (squared, weights) = closest_on_facet(p, [a, b, c], [0, 1, 2]);
            let place = weights[0] * a + weights[1] * b + weights[2] * c;
            assert!((place.distance(p) - squared.sqrt()).abs() < 1e-9, "{k}");
            let to_edges = to_segment(p, a, b).min(to_segment(p, b, c)).min(to_segment(p, c, a));
            // No farther than the edges, and as far where it is not within: coordinates are of the order of 1.
            assert!(squared.sqrt() < to_edges + 1e-12, "{k}: {} of {to_edges}", squared.sqrt());
            if weights.contains(&0.0) {
                assert!((squared.sqrt() - to_edges).abs() < 1e-9, "{k}: {} of {to_edges}", squared.sqrt());
            }
        }
    }
}
