//! Hanging vertices: vertices of a boundary that lie on other boundary edges.
//!
//! Purpose: [`divide`] divides facets at the vertices that lie on their boundary edges (T-junctions), so that both sides have the
//! same vertices and are connected. [`insert`] divides them at places that are no vertices yet. [`gaps`] finds the boundary edges that
//! others run along at some distance.
//! Invariant: vertices stay where they are, and new ones are behind all others. A facet is divided only if its pieces face as it did, and
//! each piece knows the facet that it is of. Must not know: the use of the surface.

use std::collections::HashMap;

use glam::DVec3;
use rstar::RTree;
use rstar::primitives::{GeomWithData, Line};

use super::adjacency::{Adjacency, EdgeKind};
use super::csr::ascending;
use super::edges::undirected;
use super::{TriMesh, normal};
use crate::tasks;
use crate::token::{Stopped, Token};

/// Largest distance of a vertex from the edge that it divides, share of the pieces of this edge.
const MOST_BEND: f64 = 0.05;

/// Edges around a vertex that are looked at, the nearest first. Where more are near, as in a heap of triangles beside one far vertex,
/// nothing is a surface, and all pairs would be too many.
const MOST_NEAR: usize = 64;

/// A surface with divided facets.
pub(crate) struct Divided {
    pub mesh: TriMesh,
    /// The facet that each facet is of.
    pub origin: Vec<u32>,
    pub edges: DividedEdges,
    /// For each new vertex the edge on which it lies, and where, 0 to 1.
    pub inserted: Vec<([u32; 2], f64)>,
}

impl Divided {
    /// This surface, divided once more.
    pub(crate) fn then(mut self, next: Self) -> Self {
        self.origin = next.origin.iter().map(|&f| self.origin[f as usize]).collect();
        self.edges.0.extend(next.edges.0);
        self.inserted.extend(next.inserted);
        Self { mesh: next.mesh, ..self }
    }
}

/// Divided edges, by the lowest vertices at their ends, the lower one first, and the vertices between them in order.
pub(crate) struct DividedEdges(HashMap<[u32; 2], Vec<u32>>);

impl DividedEdges {
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    /// Edges of the surface as it was, divided as its facets are. `class` has the lowest vertex in the place of each.
    pub(crate) fn pieces(&self, edges: &[[u32; 2]], class: &[u32]) -> Vec<[u32; 2]> {
        let mut all = Vec::with_capacity(edges.len());
        let mut left: Vec<[u32; 2]> = edges.iter().rev().copied().collect();
        while let Some([a, b]) = left.pop() {
            let welded = [a, b].map(|v| class.get(v as usize).copied().unwrap_or(v));
            let Some(between) = self.0.get(&undirected(welded)) else {
                all.push([a, b]);
                continue;
            };
            let mut chain = vec![welded[0].min(welded[1])];
            chain.extend(between);
            chain.push(welded[0].max(welded[1]));
            // A piece may be divided once more.
            left.extend(chain.windows(2).rev().map(|pair| [pair[0], pair[1]]));
        }
        all
    }
}

/// A boundary vertex beside a boundary edge that it is no end of.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Beside {
    /// Number of the edge.
    edge: u32,
    /// Where on the edge it is nearest, 0 to 1.
    share: f64,
    vertex: u32,
    distance: f64,
}

/// The boundary edges of a surface.
struct Boundary<'a> {
    /// Of the vertices, and of those that may divide edges.
    positions: &'a [DVec3],
    halves: Vec<usize>,
    /// Their ends, the lowest vertices in their places.
    ends: Vec<[u32; 2]>,
}

impl<'a> Boundary<'a> {
    fn new(mesh: &TriMesh, positions: &'a [DVec3], adjacency: &Adjacency) -> Self {
        let halves: Vec<usize> =
            (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) == EdgeKind::Boundary).collect();
        let ends = halves.iter().map(|&h| adjacency.ends(mesh, h)).collect();
        Self { positions, halves, ends }
    }

    /// Their ends, ascending.
    fn vertices(&self) -> Vec<u32> {
        ascending(self.ends.iter().flatten().copied())
    }

    fn place(&self, v: u32) -> DVec3 {
        self.positions[v as usize]
    }

    fn length(&self, edge: u32) -> f64 {
        let [a, b] = self.ends[edge as usize].map(|v| self.place(v));
        a.distance(b)
    }

    /// Those of `vertices` within `reach` of edges, and much nearer than these are long, by edge, then along it.
    fn beside(&self, vertices: &[u32], reach: f64, token: &Token) -> Result<Vec<Beside>, Stopped> {
        let at = |v: u32| self.place(v).to_array();
        let lines = self.ends.iter().zip(0u32..).map(|(&[a, b], k)| GeomWithData::new(Line::new(at(a), at(b)), k));
        let tree = RTree::bulk_load(lines.collect());
        token.check()?;
        let of_vertex = |k: usize| {
            let vertex = vertices[k];
            let p = self.place(vertex);
            let near = tree.nearest_neighbor_iter_with_distance_2(p.to_array());
            let near = near.take_while(move |(_, squared)| *squared <= reach * reach && !token.is_stopped());
            let beside = move |(line, _): (&GeomWithData<Line<[f64; 3]>, u32>, f64)| {
                let ends = self.ends[line.data as usize];
                let [a, b] = ends.map(|v| self.place(v));
                let along = b - a;
                let share = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
                let distance = p.distance(a + along * share);
                let other = !ends.contains(&vertex) && distance <= MOST_BEND * along.length();
                other.then_some(Beside { edge: line.data, share, vertex, distance })
            };
            near.take(MOST_NEAR).filter_map(beside)
        };
        // Where all edges overlap, a query looks at all of them before its first answer.
        let open = |k: usize| (!token.is_stopped()).then(|| of_vertex(k)).into_iter().flatten();
        let mut found: Vec<Beside> = tasks::flat_map(vertices.len(), open);
        token.check()?;
        found.sort_by(|a, b| a.edge.cmp(&b.edge).then(a.share.total_cmp(&b.share)).then(a.vertex.cmp(&b.vertex)));
        Ok(found)
    }

    /// Those of the vertices beside an edge that divide it.
    fn dividing(&self, beside: &[Beside]) -> Vec<u32> {
        let Some(&Beside { edge, .. }) = beside.first() else { return Vec::new() };
        let [mut last, end] = self.ends[edge as usize].map(|v| self.place(v));
        let mut found = Vec::new();
        for &Beside { share, vertex, distance, .. } in beside {
            let place = self.place(vertex);
            let shorter = place.distance(last).min(place.distance(end));
            if share > 0.0 && share < 1.0 && distance <= MOST_BEND * shorter {
                last = place;
                found.push(vertex);
            }
        }
        found
    }
}

/// Divides the facets of `mesh` at vertices within `reach` of their boundary edges; `None` if there are none.
pub(crate) fn divide(
    mesh: &TriMesh,
    adjacency: &Adjacency,
    reach: f64,
    token: &Token,
) -> Result<Option<Divided>, Stopped> {
    let boundary = Boundary::new(mesh, mesh.positions(), adjacency);
    divide_at(mesh, adjacency, &boundary, (&boundary.vertices(), reach), token)
}

/// Divides the facets of `mesh` at those of `places` within `reach` of their boundary edges, which become vertices; `None` if there are
/// none.
pub(crate) fn insert(
    mesh: &TriMesh,
    adjacency: &Adjacency,
    places: &[DVec3],
    reach: f64,
    token: &Token,
) -> Result<Option<Divided>, Stopped> {
    let first = mesh.positions().len() as u32;
    let mut positions = mesh.positions().to_vec();
    positions.extend(places);
    let boundary = Boundary::new(mesh, &positions, adjacency);
    let new: Vec<u32> = (first..positions.len() as u32).collect();
    let Some(mut divided) = divide_at(mesh, adjacency, &boundary, (&new, reach), token)? else { return Ok(None) };
    // Without the places that divide nothing.
    let mut on_edge: HashMap<u32, ([u32; 2], f64)> = HashMap::new();
    for (&ends, between) in &divided.edges.0 {
        let [start, end] = ends.map(|v| positions[v as usize]);
        let share = |v: u32| (positions[v as usize] - start).dot(end - start) / (end - start).length_squared();
        between.iter().for_each(|&v| _ = on_edge.insert(v, (ends, share(v).clamp(0.0, 1.0))));
    }
    let mut used: Vec<u32> = on_edge.keys().copied().collect();
    used.sort_unstable();
    let number = |v: u32| if v < first { v } else { first + used.partition_point(|&known| known < v) as u32 };
    divided.edges.0.values_mut().flatten().for_each(|v| *v = number(*v));
    divided.inserted = used.iter().map(|v| on_edge[v]).collect();
    let facets = divided.mesh.facets().iter().map(|t| t.map(number)).collect();
    let kept = (0..first).chain(used.iter().copied()).map(|v| positions[v as usize]).collect();
    Ok(TriMesh::new(kept, facets).ok().map(|mesh| Divided { mesh, ..divided }))
}

fn divide_at(
    mesh: &TriMesh,
    adjacency: &Adjacency,
    boundary: &Boundary<'_>,
    (vertices, reach): (&[u32], f64),
    token: &Token,
) -> Result<Option<Divided>, Stopped> {
    let mut sides: HashMap<usize, [Vec<u32>; 3]> = HashMap::new();
    for beside in boundary.beside(vertices, reach, token)?.chunk_by(|a, b| a.edge == b.edge) {
        let half = boundary.halves[beside[0].edge as usize];
        let found = boundary.dividing(beside);
        if !found.is_empty() {
            sides.entry(half / 3).or_default()[half % 3] = found;
        }
    }
    let (mut origin, mut edges) = (Vec::new(), HashMap::new());
    let mut facets = Vec::with_capacity(mesh.facets().len());
    for (f, &corners) in mesh.facets().iter().enumerate() {
        let before = facets.len();
        if let Some(vertices) = sides.get(&f) {
            fan(corners, vertices.clone(), &mut facets);
            let face = normal(mesh.corners(f));
            let faces = |t: &[u32; 3]| normal(t.map(|v| boundary.place(v))).dot(face) > 0.0;
            if facets[before..].iter().all(faces) {
                for (side, between) in vertices.iter().enumerate().filter(|(_, between)| !between.is_empty()) {
                    let [a, b] = adjacency.ends(mesh, 3 * f + side);
                    let in_order = between.iter().copied();
                    edges.insert(undirected([a, b]), if a < b { in_order.collect() } else { in_order.rev().collect() });
                }
            } else {
                facets.truncate(before);
            }
        }
        if facets.len() == before {
            facets.push(corners);
        }
        origin.resize(facets.len(), f as u32);
    }
    if edges.is_empty() {
        return Ok(None);
    }
    // Pieces have area, so the surface is as valid as it was.
    Ok(TriMesh::new(boundary.positions.to_vec(), facets).ok().map(|mesh| Divided {
        mesh,
        origin,
        edges: DividedEdges(edges),
        inserted: Vec::new(),
    }))
}

/// Divides a facet at the vertices of its sides.
fn fan([a, b, c]: [u32; 3], [mut ab, bc, ca]: [Vec<u32>; 3], out: &mut Vec<[u32; 3]>) {
    if !ab.is_empty() {
        ab.push(b);
        let (mut from, last) = (a, ab.len() - 1);
        for (k, &to) in ab.iter().enumerate() {
            let first = if k == 0 { ca.clone() } else { Vec::new() };
            let second = if k == last { bc.clone() } else { Vec::new() };
            fan([from, to, c], [Vec::new(), second, first], out);
            from = to;
        }
    } else if !bc.is_empty() {
        fan([b, c, a], [bc, ca, ab], out);
    } else if !ca.is_empty() {
        fan([c, a, b], [ca, ab, bc], out);
    } else {
        out.push([a, b, c]);
    }
}

/// Boundary edges that others run along.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Gaps {
    pub edges: usize,
    /// The largest distance of their ends from those others.
    pub distance: f64,
}

/// The boundary edges both of whose ends are within `reach` of other boundary edges, and much nearer than either is long.
pub(crate) fn gaps(mesh: &TriMesh, adjacency: &Adjacency, reach: f64, token: &Token) -> Result<Gaps, Stopped> {
    let boundary = Boundary::new(mesh, mesh.positions(), adjacency);
    let mut nearest: HashMap<u32, f64> = HashMap::new();
    for Beside { vertex, distance, .. } in boundary.beside(&boundary.vertices(), reach, token)? {
        let least = nearest.entry(vertex).or_insert(distance);
        *least = least.min(distance);
    }
    let mut found = Gaps::default();
    for (&[a, b], edge) in boundary.ends.iter().zip(0..) {
        let near = |v| nearest.get(&v).copied().filter(|distance| *distance <= MOST_BEND * boundary.length(edge));
        if let (Some(a), Some(b)) = (near(a), near(b)) {
            found.edges += 1;
            found.distance = found.distance.max(a).max(b);
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::measure::topology;
    use crate::mesh::shapes::Shape;

    /// A cube whose sides are divided differently: `counts` cells along each edge of each side, of vertices of its own.
    fn cube(counts: [u32; 6], off: f64) -> TriMesh {
        let (mut positions, mut facets) = (Vec::new(), Vec::new());
        for (side, &n) in counts.iter().enumerate() {
            let first = positions.len() as u32;
            let (axis, high) = (side / 2, (side % 2) as f64);
            for k in 0..(n + 1) * (n + 1) {
                let [u, v] = [k % (n + 1), k / (n + 1)].map(|x| f64::from(x) / f64::from(n));
                let mut p = [0.0; 3];
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (high * (1.0 + off), u, v);
                positions.push(DVec3::from_array(p));
            }
            let at = |x: u32, y: u32| first + y * (n + 1) + x;
            for (x, y) in (0..n).flat_map(|x| (0..n).map(move |y| (x, y))) {
                let quad = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
                let [a, b, c, d] = if high > 0.0 { quad } else { [quad[0], quad[3], quad[2], quad[1]] };
                facets.extend([[a, b, c], [a, c, d]]);
            }
        }
        TriMesh::new(positions, facets).unwrap()
    }

    #[test]
    fn sides_of_other_vertices_are_joined() {
        for counts in [[1, 2, 3, 4, 5, 6], [7, 7, 2, 2, 1, 1], [3, 5, 7, 11, 13, 2]] {
            let mesh = cube(counts, 0.0);
            let adjacency = Adjacency::new(&mesh);
            assert!(adjacency.boundary_edges > 0);
            let divided = divide(&mesh, &adjacency, 1e-9, &Token::default()).unwrap().unwrap();
            let after = topology(&divided.mesh);
            assert_eq!((after.boundary_edges, after.euler, after.components), (0, 2, 1), "{counts:?}");
            assert!((divided.mesh.area() - 6.0).abs() < 1e-12);
            assert_eq!(divided.origin.len(), divided.mesh.facets().len());
            // Every piece lies in the facet that it is of.
            let area = |mesh: &TriMesh, f: usize| 0.5 * normal(mesh.corners(f)).length();
            let mut sums = vec![0.0; mesh.facets().len()];
            for (f, &of) in divided.origin.iter().enumerate() {
                sums[of as usize] += area(&divided.mesh, f);
            }
            assert!(sums.iter().enumerate().all(|(f, sum)| (sum - area(&mesh, f)).abs() < 1e-12));
            // Edges that are named come in pieces.
            let class = adjacency.representative();
            for (&edge, between) in &divided.edges.0 {
                assert_eq!(divided.edges.pieces(&[edge], class).len(), between.len() + 1);
            }
        }
    }

    /// A heap of triangles within the reach that one far vertex makes: time and memory stay linear.
    #[test]
    fn a_heap_beside_a_far_vertex_is_looked_through() {
        let n = 20_000u32;
        let at = |k: u32| DVec3::new(f64::from(k), f64::from(k * k % 1009), f64::from(k * 7 % 997)).map(f64::sin);
        let mut positions: Vec<DVec3> = (0..3 * n).map(at).collect();
        positions.push(DVec3::splat(1e9));
        let mut facets: Vec<[u32; 3]> = (0..n).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        facets.push([0, 1, 3 * n]);
        let mesh = TriMesh::new(positions, facets).unwrap();
        let boundary = Boundary::new(&mesh, mesh.positions(), &Adjacency::new(&mesh));
        let found = boundary.beside(&boundary.vertices(), 1e6, &Token::default()).unwrap();
        assert!(found.len() <= MOST_NEAR * 3 * n as usize, "{}", found.len());
    }

    #[test]
    fn a_gap_is_measured_and_what_is_no_gap_is_none() {
        let mesh = cube([2, 3, 4, 4, 4, 4], 1e-4);
        let found = gaps(&mesh, &Adjacency::new(&mesh), 1e-3, &Token::default()).unwrap();
        assert!(found.edges >= 12 && (1e-4..1.5e-4).contains(&found.distance), "{found:?}");
        for shape in Shape::ALL {
            let mesh = shape.build(500);
            let adjacency = Adjacency::new(&mesh);
            let (low, high) = mesh.bounds();
            let reach = 1e-3 * (high - low).length();
            assert_eq!(gaps(&mesh, &adjacency, reach, &Token::default()).unwrap(), Gaps::default(), "{shape}");
            assert!(divide(&mesh, &adjacency, 1e-4 * reach, &Token::default()).unwrap().is_none(), "{shape}");
        }
    }
}
