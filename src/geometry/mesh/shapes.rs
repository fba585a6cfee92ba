//! Procedural surfaces, for tests and for `tessera shape`.
//!
//! Purpose: [`Shape::build`] makes a surface of about a given number of facets whose topology is known ([`Shape::euler`]).
//! Invariant: every facet has an area, neighbours run the same way through their edges, and the outside is where the normals
//! point. All are about one unit in size.
//! Must not know: its callers.

mod round;
mod voxels;

use std::fmt;
use std::str::FromStr;

use glam::{DVec3, dvec3};

use super::TriMesh;

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
    /// Two parallel unit squares, a quarter of the edge length apart, facing away from each other.
    /// Two components, χ = 2.
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
    pub const ALL: [Self; 9] = [
        Self::Sphere,
        Self::Torus,
        Self::Genus(3),
        Self::Block,
        Self::Hills,
        Self::Sheets,
        Self::Slivers,
        Self::Square,
        Self::Plane,
    ];

    /// Builds it with about `facets` facets: from 500 up within 20 % (for `genusN` from 500 (N + 1) up), below as
    /// near as the shape allows. `Square` always has 2.
    pub fn build(self, facets: usize) -> TriMesh {
        let target = facets.clamp(1, MAX_FACETS);
        match self {
            Self::Sphere => round::sphere(target),
            Self::Torus => round::torus(target, 1.0),
            Self::Slivers => round::torus(target, 1000.0),
            Self::Genus(holes) => voxels::slab(holes.min(MAX_GENUS), target),
            Self::Block => voxels::block(target),
            Self::Hills => grid(side(target), hill).finish(),
            Self::Plane => grid(side(target), |_, _| 0.0).finish(),
            Self::Square => grid(1, |_, _| 0.0).finish(),
            Self::Sheets => sheets(side(target / 2)),
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

/// Vertices and facets in the making.
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

/// The unit square with `n * n` cells and a height.
fn grid(n: usize, height: impl Fn(f64, f64) -> f64) -> Draft {
    let mut draft = Draft::default();
    for j in 0..=n {
        for i in 0..=n {
            let (x, y) = (i as f64 / n as f64, j as f64 / n as f64);
            draft.positions.push(dvec3(x, y, height(x, y)));
        }
    }
    let vertex = |i: usize, j: usize| (j * (n + 1) + i) as u32;
    for j in 0..n {
        for i in 0..n {
            draft.quad([vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)]);
        }
    }
    draft
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
    let mut draft = grid(n, |_, _| 0.125 / n as f64);
    let below = grid(n, |_, _| -0.125 / n as f64);
    let offset = draft.positions.len() as u32;
    draft.positions.extend(below.positions);
    draft.facets.extend(below.facets.into_iter().map(|[a, b, c]| [a, c, b].map(|v| v + offset)));
    draft.finish()
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
                assert_eq!(adjacency.inconsistent_edges(), 0, "{name}");
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
