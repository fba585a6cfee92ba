//! Figures of a whole surface: its topology, and its quality as a remesh.
//!
//! Purpose: [`topology`] and [`quality`], with the definitions of the CVT literature.
//! Invariant: exactly coincident vertices count as one and facets that name a point twice not at all. Both functions give
//! the same figures whatever the number of threads. Must not know: how a surface came about.

use std::collections::HashSet;

use serde::Serialize;

use super::adjacency::{Adjacency, EdgeKind};
use super::closest_point::{ClosestPoint, SurfacePoint};
use super::edges::{DisjointSets, sides, undirected};
use super::sample::sample;
use super::{TriMesh, coincident};
use crate::token::{Stopped, Token};
use glam::DVec3;

/// Topology of a surface.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Eq, Default)]
pub struct Topology {
    /// Euler characteristic V - E + F of the used vertices.
    pub euler: i64,
    /// Connected components (through shared vertices).
    pub components: usize,
    /// Chains of boundary edges. Where two holes touch in a vertex they are two; a chain that
    /// a non-manifold edge interrupts counts as if it went on behind it.
    pub boundary_loops: usize,
    /// Edges with exactly one facet.
    pub boundary_edges: usize,
    /// Edges with more than two facets.
    pub non_manifold_edges: usize,
    /// Vertices whose facets form more than one fan.
    pub non_manifold_vertices: usize,
}

impl Topology {
    /// Figures that a remesh did not keep, one sentence each. Non-manifold elements do not count: a remesh never has any.
    pub fn changes(&self, result: &Self) -> Vec<String> {
        let pairs = [
            ("euler", self.euler, result.euler),
            ("components", self.components as i64, result.components as i64),
            ("boundary_loops", self.boundary_loops as i64, result.boundary_loops as i64),
        ];
        let changed = pairs.into_iter().filter(|(_, before, after)| before != after);
        changed.map(|(name, before, after)| format!("{name}: {before} becomes {after}")).collect()
    }

    /// A bound from below on the vertices of a triangulation: three for a part with a boundary, four for one without, and
    /// Heawood's bound for a connected surface without boundary, as 7 for a torus.
    pub fn fewest_vertices(&self) -> usize {
        let parts = self.components.max(1);
        match (self.boundary_edges, parts) {
            (0, 1) => ((7.0 + (49.0 - 24.0 * self.euler.min(2) as f64).sqrt()) / 2.0).ceil() as usize,
            (0, _) => 4 * parts,
            _ => 3 * parts,
        }
    }
}

/// Geometry of a remesh, as the CVT literature reports it. Angles in degrees.
#[derive(Clone, Copy, Debug, Serialize, PartialEq, Default)]
pub struct Quality {
    /// Smallest Q = (6/√3) S/(p h): area, half-perimeter, longest edge. 1 is equilateral.
    pub q_min: f64,
    /// Mean Q.
    pub q_avg: f64,
    /// Smallest angle.
    pub theta_min_deg: f64,
    /// Mean of each triangle's smallest angle.
    pub theta_avg_deg: f64,
    /// Share of triangles with an angle under 30°.
    pub under_30_percent: f64,
    /// Share of interior vertices with 5 to 7 neighbours; 100 if no vertex is interior. A vertex of
    /// a boundary or non-manifold edge is not interior.
    pub v567_percent: f64,
    /// Hausdorff distance, both ways, % of the input's bounding-box diagonal.
    pub hausdorff_percent: f64,
    /// Larger of both ways' root mean square distance over the area, same unit.
    pub rms_percent: f64,
}

/// Area samples per side for distances; the vertices come on top.
const SAMPLES: usize = 100_000;
/// Fixed, so that a figure can be reproduced.
const SAMPLE_SEED: u64 = 0x7e55e7a;
/// Distances are summed per chunk of this many points and the chunks in order.
const CHUNK: usize = 4096;

/// Topology of `mesh`, exactly coincident vertices counted as one.
pub fn topology(mesh: &TriMesh) -> Topology {
    topology_unless(mesh, &Adjacency::new(mesh), &Token::default()).unwrap_or_default()
}

/// Topology of `mesh`, whose edges are known already.
pub fn topology_unless(mesh: &TriMesh, adjacency: &Adjacency, token: &Token) -> Result<Topology, Stopped> {
    let representative = adjacency.representative();
    let live: Vec<usize> = (0..mesh.facets().len()).filter(|&f| !adjacency.is_collapsed(f)).collect();
    let vertex = |half: usize| representative[mesh.facets()[half / 3][half % 3] as usize] as usize;
    let mut used = vec![false; representative.len()];
    let mut surfaces = DisjointSets::new(representative.len());
    for (k, &facet) in live.iter().enumerate() {
        token.check_at(k)?;
        for e in 0..3 {
            used[vertex(3 * facet + e)] = true;
            surfaces.join(vertex(3 * facet + e), vertex(3 * facet + (e + 1) % 3));
        }
    }
    let vertices = used.iter().filter(|&&used| used).count();
    let components = (0..used.len()).filter(|&v| used[v] && surfaces.root(v) == v).count();
    token.check()?;
    let (mut fans, fans_at) = fans(mesh, adjacency);
    token.check()?;
    Ok(Topology {
        euler: vertices as i64 - adjacency.edges as i64 + live.len() as i64,
        components,
        boundary_loops: boundary_loops(adjacency, &mut fans, vertex),
        boundary_edges: adjacency.boundary_edges,
        non_manifold_edges: adjacency.non_manifold_edges,
        non_manifold_vertices: fans_at.into_iter().filter(|&fans| fans > 1).count(),
    })
}

/// Vertices are in one place within this share of the diagonal.
const SAME_PLACE: f64 = 1e-5;

/// Counts vertices in the place of an earlier one with which they share no edge.
pub fn coincident_vertices(result: &TriMesh, token: &Token) -> Result<usize, Stopped> {
    let (low, high) = result.bounds();
    let reach = SAME_PLACE * (high - low).length();
    if !(reach.is_finite() && reach > 0.0) {
        return Ok(0);
    }
    let found = coincident::near(result.positions(), 0..result.positions().len() as u32, (low, reach), token)?;
    if found.is_empty() {
        return Ok(0);
    }
    let edges: HashSet<[u32; 2]> = result.facets().iter().flat_map(|&facet| sides(facet)).map(undirected).collect();
    Ok(found.iter().filter(|&&(later, earlier, _)| !edges.contains(&undirected([later, earlier]))).count())
}

/// Quality of `result` against `original`. Distances are from 100,000 random points and all vertices of each to the other.
pub fn quality(original: &TriMesh, result: &TriMesh) -> Quality {
    quality_and_distances(original, None, result, &Token::default()).map(|(quality, _)| quality).unwrap_or_default()
}

/// [`quality`], and how far each vertex of `original` is from the result, 0 where no facet with area has it. `closest` answers for
/// `original`, or for the same surface with its facets divided; it saves the time to make it.
pub fn quality_and_distances(
    original: &TriMesh,
    closest: Option<ClosestPoint>,
    result: &TriMesh,
    token: &Token,
) -> Result<(Quality, Vec<f64>), Stopped> {
    let shapes = || {
        let adjacency = Adjacency::new(result);
        Quality { v567_percent: v567_percent(result, &adjacency), ..shape_quality(result, &adjacency) }
    };
    let back = || rayon::join(shapes, || distances(result, original, closest, token));
    let (there, (mut quality, back)) = rayon::join(|| distances(original, result, None, token), back);
    let ((there, of_vertices), (back, _)) = (there?, back?);
    let (low, high) = original.bounds();
    // Scaled, so that the squares of a tiny or huge box stay within range.
    let extent = (high - low).max_element();
    let diagonal = ((high - low) / extent).length() * extent;
    quality.hausdorff_percent = 100.0 * there.0.max(back.0) / diagonal;
    quality.rms_percent = 100.0 * there.1.max(back.1) / diagonal;
    Ok((quality, of_vertices))
}

/// Q = (6/√3) S/(p h) of one triangle about one unit in size: 1 is equilateral, 0 has no area.
pub fn facet_quality([a, b, c]: [DVec3; 3]) -> f64 {
    let (u, v, w) = (b - a, c - b, a - c);
    let (lu, lv, lw) = (u.length(), v.length(), w.length());
    let box_of = 0.5 * (lu + lv + lw) * lu.max(lv).max(lw);
    if box_of > 0.0 { 6.0 / 3f64.sqrt() * 0.5 * u.cross(w).length() / box_of } else { 0.0 }
}

/// Corners that are connected through edges with two facets, and how many such fans are around each vertex. Corner
/// `3 * facet + c` is the origin of the half-edge of that number.
fn fans(mesh: &TriMesh, adjacency: &Adjacency) -> (DisjointSets, Vec<u32>) {
    let representative = adjacency.representative();
    let vertex = |half: usize| representative[mesh.facets()[half / 3][half % 3] as usize];
    let halves = || (0..3 * mesh.facets().len()).filter(|half| !adjacency.is_collapsed(half / 3));
    let mut fans = DisjointSets::new(3 * mesh.facets().len());
    for half in halves() {
        if let Some(other) = adjacency.opposite(half).filter(|&other| half < other) {
            // Where the facets run the same way through the edge, so do its ends.
            let (near, far) = if vertex(half) == vertex(other) { (other, next(other)) } else { (next(other), other) };
            fans.join(half, near);
            fans.join(next(half), far);
        }
    }
    let mut count = vec![0u32; representative.len()];
    // Each fan is known by one of its corners.
    halves().for_each(|half| count[vertex(half) as usize] += u32::from(fans.root(half) == half));
    (fans, count)
}

/// The next half-edge of the same facet.
fn next(half: usize) -> usize {
    half - half % 3 + (half + 1) % 3
}

/// The vertices around which a surface is no manifold; each is known by the lowest vertex in its place.
pub fn non_manifold_vertices(mesh: &TriMesh) -> Vec<bool> {
    let adjacency = &Adjacency::new(mesh);
    let vertex = |half: usize| adjacency.representative()[mesh.facets()[half / 3][half % 3] as usize] as usize;
    let mut found: Vec<bool> = fans(mesh, adjacency).1.into_iter().map(|fans| fans > 1).collect();
    for half in 0..3 * mesh.facets().len() {
        if matches!(adjacency.kind(half), EdgeKind::NonManifold | EdgeKind::Inconsistent) {
            [half, next(half)].into_iter().for_each(|half| found[vertex(half)] = true);
        }
    }
    found
}

/// Chains of boundary edges: two that end in one fan are one chain.
fn boundary_loops(adjacency: &Adjacency, fans: &mut DisjointSets, vertex: impl Fn(usize) -> usize) -> usize {
    let mut ends = Vec::new();
    let halves: Vec<usize> = (0..fans.len()).filter(|&half| adjacency.kind(half) == EdgeKind::Boundary).collect();
    for (edge, &half) in halves.iter().enumerate() {
        for corner in [half, next(half)] {
            ends.push((vertex(corner), fans.root(corner), edge));
        }
    }
    ends.sort_unstable();
    let mut chains = DisjointSets::new(halves.len());
    for at_vertex in ends.chunk_by(|a, b| a.0 == b.0) {
        let mut loose: Option<usize> = None;
        for fan in at_vertex.chunk_by(|a, b| a.1 == b.1) {
            fan.windows(2).for_each(|pair| chains.join(pair[0].2, pair[1].2));
            // The other side of this fan is a non-manifold edge: go on with whatever else ends here.
            if fan.len() == 1 {
                loose.inspect(|&before| chains.join(before, fan[0].2));
                loose = Some(fan[0].2);
            }
        }
    }
    (0..halves.len()).filter(|&edge| chains.root(edge) == edge).count()
}

/// The smallest and the largest angle of one facet, degrees.
pub fn angles([a, b, c]: [DVec3; 3]) -> [f64; 2] {
    let at = |p: DVec3, q: DVec3, r: DVec3| (q - p).cross(r - p).length().atan2((q - p).dot(r - p)).to_degrees();
    let (at_a, at_b, at_c) = (at(a, b, c), at(b, c, a), at(c, a, b));
    [at_a.min(at_b).min(at_c), at_a.max(at_b).max(at_c)]
}

/// The smallest angle of one facet, degrees.
pub fn least_angle(corners: [DVec3; 3]) -> f64 {
    angles(corners)[0]
}

/// Q and angles over all facets but the collapsed ones.
fn shape_quality(mesh: &TriMesh, adjacency: &Adjacency) -> Quality {
    let (low, high) = mesh.bounds();
    let extent = (high - low).max_element();
    let (mut count, mut slim, mut q_sum, mut theta_sum) = (0usize, 0usize, 0.0, 0.0);
    let (mut q_min, mut theta_min) = (f64::INFINITY, f64::INFINITY);
    for facet in (0..mesh.facets().len()).filter(|&f| !adjacency.is_collapsed(f)) {
        let [a, b, c] = mesh.corners(facet).map(|p| (p - low) / extent);
        let (u, v, w) = (b - a, c - b, a - c);
        let twice = u.cross(w).length();
        let q = facet_quality([a, b, c]);
        // The arc tangent stays exact where the arc cosine does not, near 0.
        let angle = |p: DVec3, q: DVec3| twice.atan2(-p.dot(q)).to_degrees();
        let theta = angle(u, v).min(angle(v, w)).min(angle(w, u));
        count += 1;
        slim += usize::from(theta < 30.0);
        q_sum += q;
        theta_sum += theta;
        q_min = q_min.min(q);
        theta_min = theta_min.min(theta);
    }
    // A valid mesh has a facet with an area, and that one is not collapsed.
    let count = count.max(1) as f64;
    Quality {
        q_min,
        q_avg: q_sum / count,
        theta_min_deg: theta_min,
        theta_avg_deg: theta_sum / count,
        under_30_percent: 100.0 * slim as f64 / count,
        ..Quality::default()
    }
}

fn v567_percent(mesh: &TriMesh, adjacency: &Adjacency) -> f64 {
    let mut valence = vec![0u32; mesh.positions().len()];
    let mut interior = vec![true; mesh.positions().len()];
    for half in 0..3 * mesh.facets().len() {
        let ends = adjacency.ends(mesh, half).map(|v| v as usize);
        match adjacency.kind(half) {
            EdgeKind::Manifold | EdgeKind::Inconsistent => {
                if adjacency.opposite(half).is_some_and(|other| half < other) {
                    ends.into_iter().for_each(|v| valence[v] += 1);
                }
            }
            EdgeKind::Boundary | EdgeKind::NonManifold => ends.into_iter().for_each(|v| interior[v] = false),
            EdgeKind::Collapsed => {}
        }
    }
    let inner = || valence.iter().zip(&interior).filter(|(n, inside)| **inside && **n > 0);
    let regular = inner().filter(|(n, _)| (5..=7).contains(*n)).count();
    if inner().next().is_none() { 100.0 } else { 100.0 * regular as f64 / inner().count() as f64 }
}

/// Vertices of facets with an area, ascending. Others are no part of the surface for samples, closest points and distances.
fn solid_vertices(mesh: &TriMesh) -> impl Iterator<Item = u32> {
    let mut used = vec![false; mesh.positions().len()];
    let solid = mesh.facets().iter().enumerate().filter(|&(f, _)| !mesh.is_degenerate(f));
    solid.flat_map(|(_, corners)| corners).for_each(|&v| used[v as usize] = true);
    (0..).zip(used).filter(|&(_, used)| used).map(|(v, _)| v)
}

/// A point at which a surface is compared with another one, and the vertices of the surface that are near it.
#[derive(Clone, Copy, Debug)]
pub struct Probe {
    /// Caller's coordinates.
    pub position: DVec3,
    /// One to three vertices, the last one repeated.
    pub vertices: [u32; 3],
}

/// A corner is near a point of its facet if the point's barycentric coordinate is at least this.
const NEAR_CORNER: f64 = 0.1;
/// Points on one edge, at most.
const MOST_ON_EDGE: f64 = 16.0;
/// Points on all edges, at most.
const MOST_ON_EDGES: f64 = 2.0 * SAMPLES as f64;

impl Probe {
    /// A point of the surface `mesh`.
    pub fn of(mesh: &TriMesh, point: &SurfacePoint) -> Self {
        let corners = mesh.facets()[point.facet as usize];
        let near = |c: &usize| point.barycentric[*c] >= NEAR_CORNER;
        let mut vertices = [corners[(0..3).find(near).unwrap_or(0)]; 3];
        (0..3).filter(near).enumerate().for_each(|(k, c)| vertices[k] = corners[c]);
        Self { position: point.position, vertices }
    }
}

/// All points from which [`quality`] takes distances, and points on edges that are longer than the random points are apart.
pub fn probes(mesh: &TriMesh, token: &Token) -> Result<Vec<Probe>, Stopped> {
    let mut probes: Vec<Probe> = sample(mesh, None, SAMPLES, SAMPLE_SEED).iter().map(|p| Probe::of(mesh, p)).collect();
    token.check()?;
    let at = |v: u32| mesh.positions()[v as usize];
    probes.extend(solid_vertices(mesh).map(|v| Probe { position: at(v), vertices: [v; 3] }));
    let apart = (mesh.area() / SAMPLES as f64).sqrt();
    let solid = mesh.facets().iter().enumerate().filter(|&(f, _)| !mesh.is_degenerate(f));
    let edges = solid.flat_map(|(_, &facet)| sides(facet)).map(undirected);
    let length = |&[a, b]: &[u32; 2]| at(a).distance(at(b));
    let mut edges: Vec<[u32; 2]> = edges.filter(|edge| length(edge) > apart).collect();
    token.check()?;
    edges.sort_unstable();
    edges.dedup();
    // Slivers may have any length of edges.
    let apart = apart.max(edges.iter().map(length).sum::<f64>() / MOST_ON_EDGES);
    for [a, b] in edges {
        let parts = (length(&[a, b]) / apart).clamp(1.0, MOST_ON_EDGE).ceil();
        for part in 1..parts as u32 {
            let share = f64::from(part) / parts;
            probes.push(Probe { position: at(a).lerp(at(b), share), vertices: [a, b, b] });
        }
    }
    Ok(probes)
}

/// Largest and root mean square distance of `from`'s points to `to`, and of each vertex, 0 without a facet; caller's units.
fn distances(
    from: &TriMesh,
    to: &TriMesh,
    closest: Option<ClosestPoint>,
    token: &Token,
) -> Result<((f64, f64), Vec<f64>), Stopped> {
    let random = sample(from, None, SAMPLES, SAMPLE_SEED);
    let drawn = random.len();
    let mut points: Vec<DVec3> = random.iter().map(|s| s.position).collect();
    let solid: Vec<u32> = solid_vertices(from).collect();
    points.extend(solid.iter().map(|&v| from.positions()[v as usize]));
    token.check()?;
    let target = closest.map_or_else(|| ClosestPoint::unless(to, token), Ok)?;
    let (low, high) = to.bounds();
    let unit = (high - low).max_element();
    let distances = target.distances(&points, token)?;
    let of_chunk = |(c, chunk): (usize, &[f64])| {
        let random = drawn.saturating_sub(c * CHUNK);
        let squares = chunk.iter().take(random).map(|d| (d / unit) * (d / unit));
        (chunk.iter().fold(0.0, |max, d| f64::max(d / unit, max)), squares.fold(0.0, |sum, d| sum + d))
    };
    let chunks = distances.chunks(CHUNK).enumerate().map(of_chunk);
    let (max, sum) = chunks.fold((0.0f64, 0.0), |(max, sum), (m, s)| (m.max(max), sum + s));
    let mut of_vertices = vec![0.0; from.positions().len()];
    solid.iter().zip(&distances[drawn..]).for_each(|(&v, &distance)| of_vertices[v as usize] = distance);
    Ok(((max * unit, (sum / drawn as f64).sqrt() * unit), of_vertices))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::dvec3;

    fn mesh(points: &[[f64; 3]], facets: &[[u32; 3]]) -> TriMesh {
        TriMesh::new(points.iter().map(|&p| p.into()).collect(), facets.to_vec()).unwrap()
    }

    #[test]
    fn two_fans_in_a_vertex() {
        let points = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [-1., 0., 0.], [-1., -1., 0.]];
        let t = topology(&mesh(&points, &[[0, 1, 2], [0, 3, 4]]));
        let expected = Topology {
            euler: 1,
            components: 1,
            boundary_loops: 2,
            boundary_edges: 6,
            non_manifold_edges: 0,
            non_manifold_vertices: 1,
        };
        assert_eq!(t, expected);
    }

    #[test]
    fn three_pages_of_a_book() {
        let points = [[0., 0., 0.], [0., 0., 1.], [1., 0., 0.], [-1., 1., 0.], [-1., -1., 0.]];
        let t = topology(&mesh(&points, &[[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 0, 4]]));
        assert_eq!((t.euler, t.components, t.non_manifold_edges, t.non_manifold_vertices), (1, 1, 1, 2));
        assert_eq!((t.boundary_edges, t.boundary_loops), (6, 1));
    }

    #[test]
    fn a_moved_plane_is_as_far_as_it_was_moved() {
        let square = |z: f64| {
            let points = [dvec3(0., 0., z), dvec3(3., 0., z), dvec3(3., 4., z), dvec3(0., 4., z)];
            TriMesh::new(points.to_vec(), vec![[0, 1, 2], [0, 2, 3]]).unwrap()
        };
        let q = quality(&square(0.0), &square(0.5));
        assert!((q.hausdorff_percent - 10.0).abs() < 1e-9 && (q.rms_percent - 10.0).abs() < 1e-9, "{q:?}");
        assert!((q.theta_min_deg - (3.0f64 / 4.0).atan().to_degrees()).abs() < 1e-12);
        assert_eq!((q.under_30_percent, q.v567_percent), (0.0, 100.0));
        assert!((q.q_min - 6.0 / 3f64.sqrt() * 6.0 / (6.0 * 5.0)).abs() < 1e-12);
    }
}
