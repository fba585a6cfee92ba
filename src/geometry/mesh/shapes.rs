//! Procedural surfaces, for tests and for `tessera shape`.
//!
//! Purpose: [`Shape::build`] makes a surface of about a given number of facets whose topology is known ([`Shape::euler`]).
//! Invariant: every facet has an area, neighbours run the same way through their edges, and the outside is where the normals
//! point. All are about one unit in size. Must not know: its callers.

use std::collections::HashMap;
use std::fmt;
use std::str::FromStr;

use glam::{DVec3, dvec3};

use super::TriMesh;

mod lattice;
pub mod parts;

pub use lattice::Lattice;

/// A procedural surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Shape {
    /// Geodesic unit sphere. χ = 2.
    Sphere,
    /// Torus of radii 1 and 0.4. χ = 0.
    Torus,
    /// A slab with this many square holes. Closed, sharp creases, χ = 2 - 2 genus.
    Genus(u32),
    /// A block with two notches: closed, sharp convex and concave creases, χ = 2.
    Block,
    /// A hilly height field over the unit square, z up. Open, one boundary, χ = 1.
    Hills,
    /// Two parallel unit squares, a quarter of the edge length apart, facing away from each other. Two components, χ = 2.
    Sheets,
    /// A torus whose rings are spaced 1000 : 1 in turn: closed, half of the facets slivers, χ = 0.
    Slivers,
    /// The unit square as two triangles, whatever number is asked for. χ = 1.
    Square,
    /// The unit square as a regular grid. χ = 1.
    Plane,
}

/// A name that no shape has.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "there is no shape \"{0}\"; there are sphere, torus, genusN (N from 0 to 99), block, hills, sheets, slivers, square, plane"
)]
pub struct UnknownShape(pub String);

/// The most facets that [`Shape::build`] makes; a larger target is taken as this.
pub const MAX_FACETS: usize = 50_000_000;

impl Shape {
    /// One of each kind, genus 3 for the slabs.
    pub const ALL: [Self; 9] = {
        use Shape::{Block, Genus, Hills, Plane, Sheets, Slivers, Sphere, Square, Torus};
        [Sphere, Torus, Genus(3), Block, Hills, Sheets, Slivers, Square, Plane]
    };

    /// Builds it with about `facets` facets: from 500 up within 20 % (for `genusN` from 500 (N + 1) up), below as
    /// near as the shape allows. `Square` always has 2.
    pub fn build(self, facets: usize) -> TriMesh {
        let target = facets.clamp(1, MAX_FACETS);
        match self {
            Self::Sphere => sphere(target),
            Self::Torus => Lattice::torus(target, 1.0).build(),
            Self::Slivers => Lattice::torus(target, 1000.0).build(),
            Self::Genus(holes) => {
                // One row of square holes in a slab three cubes wide.
                let holes = holes.min(MAX_GENUS) as i32;
                surface([2 * holes + 1, 3, 1], target, |[x, y, _]| x % 2 == 0 || y != 1)
            }
            // Two cubes are left out, which do not touch.
            Self::Block => surface([3, 2, 2], target, |cell| cell != [0, 1, 1] && cell != [2, 0, 1]),
            Self::Hills => Lattice::grid(side(target), hill).build(),
            Self::Plane => Lattice::grid(side(target), flat).build(),
            Self::Square => Lattice::grid(1, flat).build(),
            Self::Sheets => sheets(side(target / 2)),
        }
    }

    /// The surface that [`Self::build`] makes, to be written without being held, of any number of facets up to
    /// [`super::MAX_ELEMENTS`]; `None` for shapes that have to be held.
    pub fn lattice(self, facets: usize) -> Option<Lattice> {
        let target = facets.clamp(1, super::MAX_ELEMENTS / 2);
        match self {
            Self::Torus => Some(Lattice::torus(target, 1.0)),
            Self::Slivers => Some(Lattice::torus(target, 1000.0)),
            Self::Hills => Some(Lattice::grid(side(target), hill)),
            Self::Plane => Some(Lattice::grid(side(target), flat)),
            Self::Square => Some(Lattice::grid(1, flat)),
            Self::Sphere | Self::Genus(_) | Self::Block | Self::Sheets => None,
        }
    }

    /// Euler characteristic.
    pub fn euler(self) -> i64 {
        match self {
            Self::Sphere | Self::Block | Self::Sheets => 2,
            Self::Torus | Self::Slivers => 0,
            Self::Hills | Self::Square | Self::Plane => 1,
            Self::Genus(holes) => 2 - 2 * i64::from(holes.min(MAX_GENUS)),
        }
    }

    /// Whether it has no boundary.
    pub fn is_closed(self) -> bool {
        !matches!(self, Self::Hills | Self::Sheets | Self::Square | Self::Plane)
    }
}

const MAX_GENUS: u32 = 99;

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Genus(holes) => write!(f, "genus{holes}"),
            other => f.write_str(&format!("{other:?}").to_lowercase()),
        }
    }
}

impl FromStr for Shape {
    type Err = UnknownShape;

    fn from_str(name: &str) -> Result<Self, UnknownShape> {
        let unknown = || UnknownShape(name.to_owned());
        if let Some(holes) = name.strip_prefix("genus") {
            let holes = holes.parse().ok().filter(|&holes| holes <= MAX_GENUS);
            return holes.map(Self::Genus).ok_or_else(unknown);
        }
        Self::ALL.into_iter().find(|shape| shape.to_string() == name).ok_or_else(unknown)
    }
}

#[derive(Default)]
struct Draft {
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
}

impl Draft {
    /// Two triangles; corners counter-clockwise from outside.
    fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        self.facets.extend([[a, b, c], [a, c, d]]);
    }

    fn finish(self) -> TriMesh {
        TriMesh::assemble(self.positions, self.facets)
    }
}

/// Cells along the side of a square grid of about `facets` facets.
fn side(facets: usize) -> usize {
    ((facets as f64 / 2.0).sqrt().round() as usize).max(1)
}

fn flat(_: f64, _: f64) -> f64 {
    0.0
}

/// Products and squares alone: the same bits everywhere.
fn hill(x: f64, y: f64) -> f64 {
    let bump = |cx: f64, cy: f64, r: f64| {
        let d = ((x - cx) * (x - cx) + (y - cy) * (y - cy)) / (r * r);
        1.0 / (1.0 + d * d)
    };
    0.25 * bump(0.3, 0.35, 0.15) + 0.18 * bump(0.7, 0.6, 0.12) - 0.1 * bump(0.65, 0.2, 0.1)
}

fn sheets(n: usize) -> TriMesh {
    let sheet = |height: f64| Lattice::grid(n, flat).positions().map(move |p| dvec3(p.x, p.y, height));
    let above = Lattice::grid(n, flat);
    let offset = above.vertices() as u32;
    let positions = sheet(0.125 / n as f64).chain(sheet(-0.125 / n as f64)).collect();
    let below = above.facets().map(|[a, b, c]| [a, c, b].map(|v| v + offset));
    TriMesh::assemble(positions, above.facets().chain(below).collect())
}

/// A regular solid, each face divided into n² triangles and blown up: 20 n² facets, or 8 n² or 4 n² if much nearer.
fn sphere(facets: usize) -> TriMesh {
    let phi = (1.0 + 5f64.sqrt()) / 2.0;
    // Coordinates of the corners, and the corners of the faces.
    let solids: [(&[f64], &[u32]); 3] = [
        (
            &[
                -1., phi, 0., 1., phi, 0., -1., -phi, 0., 1., -phi, 0., 0., -1., phi, 0., 1., phi, 0., -1., -phi, 0.,
                1., -phi, phi, 0., -1., phi, 0., 1., -phi, 0., -1., -phi, 0., 1.,
            ],
            &[
                0, 11, 5, 0, 5, 1, 0, 1, 7, 0, 7, 10, 0, 10, 11, 1, 5, 9, 5, 11, 4, 11, 10, 2, 10, 7, 6, 7, 1, 8, 3, 9,
                4, 3, 4, 2, 3, 2, 6, 3, 6, 8, 3, 8, 9, 4, 9, 5, 2, 4, 11, 6, 2, 10, 8, 6, 7, 9, 8, 1,
            ],
        ),
        (
            &[1., 0., 0., 0., 1., 0., -1., 0., 0., 0., -1., 0., 0., 0., 1., 0., 0., -1.],
            &[0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4, 1, 0, 5, 2, 1, 5, 3, 2, 5, 0, 3, 5],
        ),
        (&[1., 1., 1., 1., -1., -1., -1., 1., -1., -1., -1., 1.], &[0, 1, 2, 0, 3, 1, 0, 2, 3, 1, 3, 2]),
    ];
    let solids = solids.map(|(corners, faces)| (corners.as_chunks().0, faces.as_chunks().0));
    let target = facets as f64;
    let mut best = (f64::INFINITY, 0, 1);
    for (solid, (_, faces)) in solids.iter().enumerate() {
        let n = (target / faces.len() as f64).sqrt().round().max(1.0);
        // How far off; the rounder solid wins unless another is nearer by a tenth.
        let off = (faces.len() as f64 * n * n / target).ln().abs();
        if off < best.0 - 0.1 || solid == 0 {
            best = (off, solid, n as u32);
        }
    }
    let (corners, faces) = solids[best.1];
    divide(corners, faces, best.2)
}

/// Divides each face into n² triangles. Points are known by the corners that weigh in them, so that faces share their edges.
fn divide(corners: &[[f64; 3]], faces: &[[u32; 3]], n: u32) -> TriMesh {
    let mut draft = Draft::default();
    let mut numbers: HashMap<[(u32, u32); 3], u32> = HashMap::new();
    for face in faces {
        let mut point = |i: u32, j: u32| {
            let mut key = [(face[0], n - i - j), (face[1], i), (face[2], j)];
            key.iter_mut().filter(|(_, weight)| *weight == 0).for_each(|entry| *entry = (u32::MAX, 0));
            key.sort_unstable();
            *numbers.entry(key).or_insert_with(|| {
                let part = |&(v, w): &(u32, u32)| DVec3::from_array(corners[v as usize]) * f64::from(w);
                let sum: DVec3 = key.iter().filter(|e| e.1 > 0).map(part).sum();
                draft.positions.push(sum.normalize());
                (draft.positions.len() - 1) as u32
            })
        };
        for j in 0..n {
            for i in 0..n - j {
                let (a, b, c) = (point(i, j), point(i + 1, j), point(i, j + 1));
                let far = (i + j + 1 < n).then(|| point(i + 1, j + 1));
                draft.facets.push([a, b, c]);
                draft.facets.extend(far.map(|d| [b, d, c]));
            }
        }
    }
    draft.finish()
}

/// The boundary of the cubes of `solid`, as about `facets` facets. No two cubes may touch only in an edge or a corner.
fn surface(size: [i32; 3], facets: usize, solid: impl Fn([i32; 3]) -> bool) -> TriMesh {
    let inside = |cell: [i32; 3]| (0..3).all(|k| (0..size[k]).contains(&cell[k])) && solid(cell);
    // Squares by axis of the normal.
    let mut squares = Vec::new();
    let [nx, ny, nz] = size;
    for cell in (0..nx * ny * nz).map(|k| [k / (ny * nz), k / nz % ny, k % nz]).filter(|&cell| inside(cell)) {
        for (axis, step) in [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)] {
            let mut neighbour = cell;
            neighbour[axis] += step;
            if !inside(neighbour) {
                squares.push((cell, axis, step));
            }
        }
    }
    let divisions = divisions(facets, [0, 1, 2].map(|axis| squares.iter().filter(|s| s.1 == axis).count()));
    let mut draft = Draft::default();
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    let longest = f64::from(size.into_iter().max().unwrap_or(1));
    for (cell, axis, step) in squares {
        // The two other axes, so that u × v points along the outward normal.
        let (u, v) = if step > 0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
        let mut point = |i: i32, j: i32| {
            let mut at = [0, 1, 2].map(|k| cell[k] * divisions[k]);
            at[axis] += if step > 0 { divisions[axis] } else { 0 };
            at[u] += i;
            at[v] += j;
            *numbers.entry(at).or_insert_with(|| {
                let position = [0, 1, 2].map(|k| f64::from(at[k]) / f64::from(divisions[k]) / longest * 2.0);
                draft.positions.push(DVec3::from_array(position));
                (draft.positions.len() - 1) as u32
            })
        };
        let mut quads = Vec::new();
        for (i, j) in (0..divisions[v]).flat_map(|j| (0..divisions[u]).map(move |i| (i, j))) {
            quads.push([point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)]);
        }
        quads.into_iter().for_each(|quad| draft.quad(quad));
    }
    draft.finish()
}

/// Divisions per axis: equal, or one more, whichever is nearer.
fn divisions(facets: usize, squares: [usize; 3]) -> [i32; 3] {
    let target = facets as f64;
    let total: usize = squares.iter().sum();
    let least = ((target / (2 * total) as f64).sqrt().floor() as i32).max(1);
    let mut best = (f64::INFINITY, [least; 3]);
    for choice in 0..8 {
        let d = [0, 1, 2].map(|k| least + (choice >> k & 1));
        let count: f64 = (0..3).map(|k| squares[k] as f64 * f64::from(d[(k + 1) % 3] * d[(k + 2) % 3]) * 2.0).sum();
        let off = (count / target).ln().abs();
        if off < best.0 {
            best = (off, d);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::adjacency::Adjacency;
    use crate::mesh::measure::topology;

    fn volume(mesh: &TriMesh) -> f64 {
        (0..mesh.facets().len()).map(|f| mesh.corners(f)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
    }

    #[test]
    fn every_shape_is_what_it_says() {
        let slabs = [0, 1, 2, 7, 20].map(Shape::Genus);
        for shape in Shape::ALL.into_iter().chain(slabs) {
            for target in [1, 40, 500, 777, 2_000, 12_345, 60_000] {
                let built = shape.build(target);
                let name = format!("{shape} of {target}");
                let (positions, facets) = built.clone().into_parts();
                assert_eq!(TriMesh::new(positions, facets).as_ref(), Ok(&built), "{name}");
                let (adjacency, topology) = (Adjacency::new(&built), topology(&built));
                assert_eq!(built.degenerate_count(), 0, "{name}");
                assert_eq!(adjacency.inconsistent_edges, 0, "{name}");
                assert_eq!(topology.euler, shape.euler(), "{name}");
                assert_eq!(topology.boundary_edges == 0, shape.is_closed(), "{name}");
                assert_eq!((topology.non_manifold_edges, topology.non_manifold_vertices), (0, 0), "{name}");
                assert_eq!(topology.components, if shape == Shape::Sheets { 2 } else { 1 }, "{name}");
                assert!(!shape.is_closed() || volume(&built) > 0.005, "{name}: {}", volume(&built));
                let least = if let Shape::Genus(holes) = shape { 500 * (holes as usize + 1) } else { 500 };
                if target >= least && shape != Shape::Square {
                    let ratio = built.facets().len() as f64 / target as f64;
                    assert!((0.8..=1.2).contains(&ratio), "{name}: {ratio}");
                }
            }
        }
    }

    #[test]
    fn names_read_back() {
        for shape in Shape::ALL {
            assert_eq!(shape.to_string().parse(), Ok(shape));
        }
        for wrong in ["", "cube", "genus", "genus100", "genus-1"] {
            assert_eq!(wrong.parse::<Shape>(), Err(UnknownShape(wrong.to_owned())));
        }
    }

    #[test]
    fn slivers_are_slivers() {
        let mesh = Shape::Slivers.build(2000);
        let longest = |f: usize| {
            let [a, b, c] = mesh.corners(f);
            [(b - a).length(), (c - b).length(), (a - c).length()]
        };
        let edges: Vec<f64> = (0..mesh.facets().len()).flat_map(longest).collect();
        let (least, most) = edges.iter().fold((f64::MAX, 0.0f64), |(l, m), &e| (l.min(e), m.max(e)));
        assert!(most / least > 1000.0, "{most} : {least}");
    }
}
