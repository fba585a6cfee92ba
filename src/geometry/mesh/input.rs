//! The input surface: its figures, and repair of its defects.
//!
//! Purpose: [`InputFigures`] is the input block of a report. [`stitch_boundaries`] moves boundary vertices that nearly
//! coincide to one position, which connects triangle soups with rounded corners and separately exported parts.
//! [`make_consistent`] flips the facets that are oriented unlike most of the area of their component, which is connected
//! through edges of two facets. [`outliers`] are vertices far from all others: one wrong coordinate makes a surface of which
//! nearly all is a spike; [`draw_in`] shortens it. Invariant: names that scripts read do not change. Vertices and facets
//! keep their numbers. Stitching moves no vertex by more than the reach that is given, `TOLERANCE` of the surface's diagonal by itself, nor by
//! more than a share of its edges, so that no facet vanishes or flips. A component that is not orientable (a Möbius strip)
//! and one that is consistent, inward or outward, stay as they are. Must not know: the use of the surface.

use glam::DVec3;
use serde::Serialize;

use super::adjacency::{Adjacency, EdgeKind};
use super::csr::ascending;
use super::duplicates::{self, InputKind, Oddities};
use super::measure::{Topology, topology_unless};
use super::{TriMesh, coincident, normal};
use crate::token::{Stopped, Token};

/// The input surface.
#[derive(Clone, Debug, Serialize)]
pub struct InputFigures {
    /// Kind of the input.
    pub kind: InputKind,
    /// Facets with more than two facets at every edge.
    pub enclosed_facets: usize,
    /// Facets that lie on others, corner on corner and back to back, and stay: they enclose nothing.
    pub back_to_back_facets: usize,
    /// Vertices as given.
    pub vertices: usize,
    /// Facets, degenerate ones included.
    pub facets: usize,
    /// Facets without area.
    pub degenerate_facets: usize,
    /// Edges of two facets that are oriented unlike each other.
    pub inconsistent_edges: usize,
    /// Facets that were turned over, to be oriented as their neighbours are.
    pub reoriented_facets: usize,
    /// Boundary vertices stitched to nearly coincident ones. Other figures are of after that, less `coincident_facets`.
    pub stitched_vertices: usize,
    /// Boundary edges divided at vertices of other boundaries that lie on them.
    pub divided_edges: usize,
    /// Boundary edges that others run along at a distance, 0.1 % of the diagonal at most and much less than their length.
    pub gap_edges: usize,
    /// The largest such distance of an end, caller's units.
    pub gap_distance: f64,
    /// The distance for `weld` that joins most of these edges, caller's units; 0 if none was found that joins any.
    pub gap_weld: f64,
    /// Those that this distance leaves open.
    pub gap_edges_left: usize,
    /// Parts that are connected through edges. Where sheets touch there are more of them than components.
    pub sheets: usize,
    /// Points that keep sheets apart that touch, where there are fewer; 0 where there are enough.
    pub points_for_sheets: usize,
    /// Duplicate facets that were removed: they lay on others, corner on corner, and the surface is connected without them.
    pub coincident_facets: usize,
    /// Vertices 1000 times as far out as half of all: wrong coordinates, most often. Their spikes take most points.
    pub outlier_vertices: usize,
    /// Caller's units squared.
    pub area: f64,
    /// Euler characteristic χ, components, holes, non-manifold elements.
    #[serde(flatten)]
    pub topology: Topology,
}

impl InputFigures {
    /// Measures the input surface.
    pub fn of(mesh: &TriMesh, token: &Token) -> Result<Self, Stopped> {
        let adjacency = Adjacency::unless(mesh, token)?;
        Self::with(mesh, &adjacency, token)
    }

    /// Measures a surface with known adjacency.
    pub fn with(mesh: &TriMesh, adjacency: &Adjacency, token: &Token) -> Result<Self, Stopped> {
        let outlier_vertices = outliers(mesh).len();
        token.check()?;
        let oddities = if adjacency.non_manifold_edges > 0 { duplicates::oddities(mesh) } else { Oddities::default() };
        token.check()?;
        let topology = topology_unless(mesh, adjacency, token)?;
        Ok(Self {
            kind: oddities.kind(),
            enclosed_facets: oddities.enclosed,
            back_to_back_facets: oddities.back_to_back,
            vertices: mesh.positions().len(),
            facets: mesh.facets().len(),
            degenerate_facets: mesh.degenerate_count(),
            inconsistent_edges: adjacency.inconsistent_edges,
            reoriented_facets: 0,
            stitched_vertices: 0,
            divided_edges: 0,
            gap_edges: 0,
            gap_distance: 0.0,
            gap_weld: 0.0,
            gap_edges_left: 0,
            sheets: topology.components,
            points_for_sheets: 0,
            coincident_facets: 0,
            outlier_vertices,
            area: mesh.area(),
            topology,
        })
    }
}

/// Largest distance of vertices that coincide, as a share of the surface's diagonal: coordinates that were rounded to single
/// precision twice differ by two of its steps of 1.2e-7, in three directions.
const TOLERANCE: f64 = 5e-7;
/// Largest move of a vertex, share of its shortest edge.
const MAX_EDGE_SHARE: f64 = 0.01;

/// Largest move of a vertex where the distance is given, share of its shortest edge: facets keep their sides.
const MAX_WELDED_SHARE: f64 = 0.4;

/// How far boundaries may be apart that are joined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Reach {
    pub distance: f64,
    /// Largest move of a vertex, share of its shortest edge.
    edge_share: f64,
}

impl Reach {
    /// `weld` is the distance that the caller gives, if any. Never less than what rounding leaves.
    pub(crate) fn of(mesh: &TriMesh, weld: Option<f64>) -> Self {
        let (low, high) = mesh.bounds();
        let rounding = TOLERANCE * (high - low).length();
        match weld {
            Some(distance) if distance > rounding => Self { distance, edge_share: MAX_WELDED_SHARE },
            _ => Self { distance: rounding, edge_share: MAX_EDGE_SHARE },
        }
    }
}

/// Returns `mesh` with boundary vertices within `reach` at one position, and the number of moved ones; `None` if there are none. Linear
/// in the facets.
pub(crate) fn stitch_boundaries(
    mesh: &TriMesh,
    adjacency: &Adjacency,
    reach: Reach,
    token: &Token,
) -> Result<Option<(TriMesh, usize)>, Stopped> {
    if adjacency.boundary_edges == 0 {
        return Ok(None);
    }
    let (origin, _) = mesh.bounds();
    let Reach { distance: tolerance, edge_share } = reach;
    if !(tolerance.is_finite() && tolerance > 0.0) {
        return Ok(None);
    }
    let ends = |half: usize| adjacency.ends(mesh, half);
    let place = |v: u32| mesh.positions()[v as usize];
    let boundary = (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) == EdgeKind::Boundary);
    let vertices = ascending(boundary.flat_map(ends));
    token.check()?;
    let pairs = coincident::near(mesh.positions(), vertices, (origin, tolerance), token)?;
    if pairs.is_empty() {
        return Ok(None);
    }
    let mut shortest = vec![f64::INFINITY; mesh.positions().len()];
    for half in (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) != EdgeKind::Collapsed) {
        token.check_at(half)?;
        let [a, b] = ends(half);
        let length = place(a).distance(place(b));
        for v in [a, b] {
            shortest[v as usize] = shortest[v as usize].min(length);
        }
    }
    let mut target: Vec<u32> = adjacency.representative().to_vec();
    let mut moved = 0;
    for (v, u, distance) in pairs {
        if distance <= edge_share * shortest[u as usize].min(shortest[v as usize]) {
            target[v as usize] = u;
            moved += 1;
        }
    }
    if moved == 0 {
        return Ok(None);
    }
    let all = adjacency.representative().iter().enumerate().map(|(v, &first)| match target[first as usize] {
        to if to != first => place(to),
        _ => mesh.positions()[v],
    });
    Ok(TriMesh::new(all.collect(), mesh.facets().to_vec()).ok().map(|stitched| (stitched, moved)))
}

/// `mesh` with each component oriented as most of its area, and the number of flipped facets; `None` for 0. Linear time.
pub(crate) fn make_consistent(mesh: &TriMesh, token: &Token) -> Result<Option<(TriMesh, usize)>, Stopped> {
    let adjacency = Adjacency::unless(mesh, token)?;
    if adjacency.inconsistent_edges == 0 {
        return Ok(None);
    }
    let area = |f: usize| normal(mesh.corners(f)).length();
    let mut flipped: Vec<Option<bool>> = vec![None; mesh.facets().len()];
    let mut facets = mesh.facets().to_vec();
    let mut count = 0;
    for start in 0..facets.len() {
        if flipped[start].is_some() {
            continue;
        }
        flipped[start] = Some(false);
        let mut component = vec![start];
        let mut orientable = true;
        let mut next = 0;
        while let Some(&f) = component.get(next) {
            token.check_at(next)?;
            next += 1;
            for half in 3 * f..3 * f + 3 {
                let Some(other) = adjacency.opposite(half) else { continue };
                let inconsistent = adjacency.kind(half) == EdgeKind::Inconsistent;
                let expected = flipped[f].map(|t| t != inconsistent);
                match flipped[other / 3] {
                    None => {
                        flipped[other / 3] = expected;
                        component.push(other / 3);
                    }
                    known => orientable &= known == expected,
                }
            }
        }
        if !orientable {
            continue;
        }
        let of = |side: bool| component.iter().filter(|&&f| flipped[f] == Some(side)).map(|&f| area(f)).sum::<f64>();
        let fewer = of(true) <= of(false);
        for &f in component.iter().filter(|&&f| flipped[f] == Some(fewer)) {
            facets[f].swap(1, 2);
            count += 1;
        }
    }
    let flipped = (count > 0).then(|| TriMesh::new(mesh.positions().to_vec(), facets).ok()).flatten();
    Ok(flipped.map(|flipped| (flipped, count)))
}

/// Distance of an outlier from the middle of the vertices, as a multiple of their median distance.
const FAR: f64 = 1000.0;

/// Distance of an outlier after it is drawn in, in the same measure.
const REACH: f64 = 10.0;

/// The middle of the vertices that a facet uses, the distance that half of them have from it at most, and how far each
/// vertex is; all halved, since coordinates may be as far apart as numbers go.
fn spread(mesh: &TriMesh) -> (DVec3, f64, Vec<Option<f64>>) {
    let mut used = vec![false; mesh.positions().len()];
    mesh.facets().iter().flatten().for_each(|&v| used[v as usize] = true);
    let half: Vec<DVec3> = mesh.positions().iter().zip(&used).filter(|p| *p.1).map(|p| *p.0 * 0.5).collect();
    let median = |mut values: Vec<f64>| {
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let centre = DVec3::from_array([0, 1, 2].map(|axis| median(half.iter().map(|p| p[axis]).collect())));
    let distance = |p: DVec3| (p - centre).abs().max_element();
    let near = median(half.iter().map(|&p| distance(p)).collect());
    let all = mesh.positions().iter().zip(&used).map(|(&p, used)| used.then(|| distance(p * 0.5))).collect();
    (centre, near, all)
}

/// The vertices that are farther from the median of all than 1000 times the median distance from it, ascending.
pub(crate) fn outliers(mesh: &TriMesh) -> Vec<u32> {
    let (_, near, all) = spread(mesh);
    let is_far = |distance: &Option<f64>| near > 0.0 && distance.is_some_and(|d| d / near > FAR);
    (0..).zip(&all).filter(|(_, distance)| is_far(distance)).map(|(v, _)| v).collect()
}

/// Returns `mesh` with outliers drawn in towards the middle of the others, each on its line. `None` without outliers.
pub(crate) fn draw_in(mesh: &TriMesh) -> Option<TriMesh> {
    let far = outliers(mesh);
    if far.is_empty() {
        return None;
    }
    let (centre, near, all) = spread(mesh);
    let mut positions = mesh.positions().to_vec();
    for v in far {
        let from = positions[v as usize] * 0.5 - centre;
        positions[v as usize] = 2.0 * (centre + from * (REACH * near / all[v as usize]?));
    }
    TriMesh::new(positions, mesh.facets().to_vec()).ok()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::mesh::measure::topology;
    use crate::mesh::shapes::Shape;

    /// Every facet with corners of its own, each off by at most `noise`.
    fn soup(mesh: &TriMesh, noise: f64) -> TriMesh {
        let corners = mesh.facets().iter().flatten().enumerate();
        let off = |k: usize| DVec3::new(k as f64, (k * k) as f64, (3 * k) as f64).map(f64::sin);
        let positions: Vec<DVec3> = corners.map(|(k, &v)| mesh.positions()[v as usize] + noise * off(k)).collect();
        let facets = (0..mesh.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        TriMesh::new(positions, facets).unwrap()
    }

    #[test]
    fn corners_rounded_one_by_one_are_one_again() {
        for shape in [Shape::Torus, Shape::Block, Shape::Plane] {
            let mesh = shape.build(2000);
            for noise in [1e-15, 1e-12, 1e-7] {
                let soup = soup(&mesh, noise);
                let (stitched, moved) =
                    stitch_boundaries(&soup, &Adjacency::new(&soup), Reach::of(&soup, None), &Token::default())
                        .unwrap()
                        .unwrap();
                assert_eq!(topology(&stitched), topology(&mesh), "{shape:?} {noise}");
                assert!(moved > 0);
                let farthest = soup.positions().iter().zip(stitched.positions()).map(|(a, b)| a.distance(*b));
                let (low, high) = mesh.bounds();
                assert!(farthest.fold(0.0, f64::max) <= TOLERANCE * (high - low).length());
            }
        }
    }

    #[test]
    fn what_is_apart_or_one_already_stays() {
        let mesh = Shape::Plane.build(2000);
        for mesh in [Shape::Torus.build(2000), mesh.clone(), soup(&mesh, 0.0), soup(&mesh, 1e-3)] {
            assert!(
                stitch_boundaries(&mesh, &Adjacency::new(&mesh), Reach::of(&mesh, None), &Token::default())
                    .unwrap()
                    .is_none()
            );
        }
        // Facets as small as what is tolerance elsewhere.
        let mut tiny = mesh.positions().iter().map(|p| *p * 1e-8).collect::<Vec<_>>();
        tiny.push(DVec3::ONE);
        let (mut facets, n) = (mesh.facets().to_vec(), tiny.len() as u32);
        tiny.extend([DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.0, 1.0, 1.0)]);
        facets.push([n - 1, n, n + 1]);
        let tiny = TriMesh::new(tiny, facets).unwrap();
        assert!(
            stitch_boundaries(&tiny, &Adjacency::new(&tiny), Reach::of(&tiny, None), &Token::default())
                .unwrap()
                .is_none()
        );
    }

    fn flip(mesh: &TriMesh, which: impl Fn(usize) -> bool) -> TriMesh {
        let mut facets = mesh.facets().to_vec();
        facets.iter_mut().enumerate().filter(|(f, _)| which(*f)).for_each(|(_, t)| t.swap(1, 2));
        TriMesh::new(mesh.positions().to_vec(), facets).unwrap()
    }

    #[test]
    fn the_lesser_part_is_turned() {
        for shape in [Shape::Sphere, Shape::Plane, Shape::Torus, Shape::Sheets] {
            let mesh = shape.build(2000);
            assert!(
                make_consistent(&mesh, &Token::default()).unwrap().is_none()
                    && make_consistent(&flip(&mesh, |_| true), &Token::default()).unwrap().is_none(),
                "{shape}"
            );
            for every in [3, 7, 1000] {
                let (back, count) =
                    make_consistent(&flip(&mesh, |f| f % every == 0), &Token::default()).unwrap().unwrap();
                assert_eq!((back.facets(), count), (mesh.facets(), mesh.facets().len().div_ceil(every)), "{shape}");
            }
        }
    }

    #[test]
    fn what_has_no_orientation_stays() {
        // A strip of quadrilaterals whose ends meet with half a turn.
        let n = 12u32;
        let point = |k: u32| {
            let (t, side) =
                (f64::from(k / 2) / f64::from(n) * std::f64::consts::TAU, if k.is_multiple_of(2) { 0.3 } else { -0.3 });
            let r = 1.0 + side * (0.5 * t).cos();
            glam::dvec3(r * t.cos(), r * t.sin(), side * (0.5 * t).sin())
        };
        let at = |k: u32| if k >= 2 * n { (k - 2 * n) ^ 1 } else { k };
        let quad = |k: u32| [[at(2 * k), at(2 * k + 1), at(2 * k + 2)], [at(2 * k + 1), at(2 * k + 3), at(2 * k + 2)]];
        let mesh = TriMesh::new((0..2 * n).map(point).collect(), (0..n).flat_map(quad).collect()).unwrap();
        assert!(Adjacency::new(&mesh).inconsistent_edges > 0);
        assert!(make_consistent(&mesh, &Token::default()).unwrap().is_none());
    }

    #[test]
    fn a_wrong_coordinate_is_one_and_a_graded_surface_has_none() {
        for shape in Shape::ALL {
            let mesh = shape.build(300);
            assert!(outliers(&mesh).is_empty() && draw_in(&mesh).is_none(), "{shape}");
            let mut positions = mesh.positions().to_vec();
            let v = mesh.facets()[0][0] as usize;
            for far in [1e5, 1e8, 1e11] {
                positions[v].x = -far;
                let stray = TriMesh::new(positions.clone(), mesh.facets().to_vec()).unwrap();
                assert_eq!(outliers(&stray), [v as u32], "{shape}, {far:e}");
                let near = draw_in(&stray).unwrap();
                assert!(outliers(&near).is_empty() && near.facets() == mesh.facets(), "{shape}, {far:e}");
            }
        }
    }
}
