//! Facets that lie on one another.
//!
//! Purpose: [`single`] leaves one of the facets that have the same three corners where the surface goes on without the others:
//! a file may have a facet twice, or one of its own for the back of some. [`look`] says what is no surface.
//! Invariant: what has two sides and no thickness stays: a sheet of two layers, a flap of two on a solid, a pillow that is flat in
//! its middle. Vertices keep their numbers, and facets their order. Must not know: why it matters.

use std::collections::HashSet;

use rayon::prelude::*;
use serde::Serialize;

use super::TriMesh;
use super::adjacency::weld;
use super::disjoint::DisjointSets;
use super::edges::EdgeGroups;
use crate::token::{Stopped, Token};

/// A facet's corners, the lowest first and the highest last, its number, and whether it runs from the lowest to the middle one.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Layer {
    corners: [u32; 3],
    facet: u32,
    forward: bool,
}

/// Facets with the same corners, whatever way round, side by side; the first one first.
struct Layers {
    all: Vec<Layer>,
    /// How many vertices there are.
    vertices: usize,
}

impl Layers {
    fn of(mesh: &TriMesh) -> Self {
        let class = weld(mesh);
        let of = |(t, facet): (&[u32; 3], u32)| {
            let [a, b, c] = t.map(|v| class[v as usize]);
            let mut corners = [a, b, c];
            corners.sort_unstable();
            let next = |v: u32| {
                if v == a {
                    b
                } else if v == b {
                    c
                } else {
                    a
                }
            };
            Layer { corners, facet, forward: next(corners[0]) == corners[1] }
        };
        let mut all: Vec<Layer> = mesh.facets().iter().zip(0..).map(of).collect();
        // A facet that names a place twice has no sides.
        all.retain(|Layer { corners: [a, b, c], .. }| a != b && b != c);
        all.par_sort_unstable();
        Self { all, vertices: class.len() }
    }

    fn places(&self) -> impl Iterator<Item = &[Layer]> {
        self.all.chunk_by(|a, b| a.corners == b.corners)
    }
}

/// What the facets that came in are together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum InputKind {
    /// No edge has more than two facets.
    Surface,
    /// Some edges have.
    NonManifold,
    /// Most facets lie between others, as those of a mesh of tetrahedra: the boundary of what they fill is a surface.
    Volume,
}

/// What of a list of facets is no surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Oddities {
    /// Facets that lie on another one that is oriented the other way: two sides without thickness.
    pub(crate) back_to_back: usize,
    /// Places of facets of which each edge has facets in more than two places, as those inside a mesh of tetrahedra,
    pub(crate) enclosed: usize,
    /// of so many places.
    pub(crate) places: usize,
}

impl Oddities {
    /// What facets with an edge of more than two are, or, by default, without one.
    pub(crate) fn kind(&self) -> InputKind {
        match self.places {
            0 => InputKind::Surface,
            places if 2 * self.enclosed > places => InputKind::Volume,
            _ => InputKind::NonManifold,
        }
    }
}

/// Looks for what is no surface. Linear in the facets but for sorting.
pub(crate) fn look(mesh: &TriMesh) -> Oddities {
    let layers = Layers::of(mesh);
    let places: Vec<&[Layer]> = layers.places().collect();
    let mut crowded_sides = vec![0u8; places.len()];
    EdgeGroups::new(layers.vertices, places.iter().map(|place| place[0].corners).enumerate()).for_each(|_, halves| {
        if halves.len() > 2 {
            halves.iter().for_each(|half| crowded_sides[half.facet as usize] += 1);
        }
    });
    let is_double = |place: &&&[Layer]| place.iter().any(|layer| layer.forward != place[0].forward);
    Oddities {
        back_to_back: places.iter().filter(is_double).map(|place| place.len()).sum(),
        enclosed: crowded_sides.into_iter().filter(|&sides| sides == 3).count(),
        places: places.len(),
    }
}

/// Whether any facets have the same corners.
pub(crate) fn any(mesh: &TriMesh) -> bool {
    Layers::of(mesh).places().any(|place| place.len() > 1)
}

/// `mesh` with one facet where there are several, one that goes with those beside it, and how many are left out; `None` if none
/// is. Of what hangs together through
/// sides of such facets, all places have one afterwards or none has: where no side has facets in more than two places, and one
/// side goes on to a facet that was alone before, or all facets in each place run the same way.
///
/// # Errors
/// [`Stopped`].
pub(crate) fn single(mesh: &TriMesh, token: &Token) -> Result<Option<(TriMesh, usize)>, Stopped> {
    let layers = Layers::of(mesh);
    token.check()?;
    let places: Vec<&[Layer]> = layers.places().collect();
    if places.iter().all(|place| place.len() == 1) {
        return Ok(None);
    }
    let mut parts = DisjointSets::new(places.len());
    // Of each side of several facets, in how many places it has facets, and one of those with several.
    let mut sides: Vec<(usize, usize)> = Vec::new();
    let mut ends = HashSet::new();
    // Of each place how many facets beside it go with one that runs forward, less those that do not.
    let mut votes = vec![0i32; places.len()];
    EdgeGroups::new(layers.vertices, places.iter().map(|place| place[0].corners).enumerate()).for_each(|_, halves| {
        let several: Vec<usize> =
            halves.iter().map(|half| half.facet as usize).filter(|&place| places[place].len() > 1).collect();
        several.windows(2).for_each(|pair| parts.join(pair[0], pair[1]));
        if let Some(&place) = several.first() {
            sides.push((halves.len(), place));
            if halves.len() > several.len() {
                ends.insert(place);
            }
            if let (&[a, b], [_]) = (halves, &several[..]) {
                let alone = if a.facet as usize == place { b } else { a };
                let layer = places[alone.facet as usize][0];
                // Two sides go together that run opposite ways; in what runs forward the last one runs from high to low.
                let goes = layer.forward == ((a.side == 2) != (b.side == 2));
                votes[place] += if goes { 1 } else { -1 };
            }
        }
    });
    token.check()?;
    let crowded: HashSet<usize> = sides.iter().filter(|side| side.0 > 2).map(|side| parts.root(side.1)).collect();
    let goes_on: HashSet<usize> = ends.into_iter().map(|place| parts.root(place)).collect();
    let several = || places.iter().enumerate().filter(|(_, place)| place.len() > 1);
    let both_ways = several().filter(|(_, place)| place.iter().any(|layer| layer.forward != place[0].forward));
    let both_ways: HashSet<usize> = both_ways.map(|(k, _)| parts.root(k)).collect();
    let mut left_out = HashSet::new();
    for (k, place) in several() {
        let part = parts.root(k);
        if !crowded.contains(&part) && (goes_on.contains(&part) || !both_ways.contains(&part)) {
            let goes = |layer: &&Layer| votes[k] == 0 || layer.forward == (votes[k] > 0);
            let kept = place.iter().find(goes).unwrap_or(&place[0]).facet;
            left_out.extend(place.iter().map(|layer| layer.facet).filter(|&f| f != kept).map(|f| f as usize));
        }
    }
    if left_out.is_empty() {
        return Ok(None);
    }
    let facets = mesh.facets().iter().enumerate().filter(|(f, _)| !left_out.contains(f)).map(|(_, &t)| t).collect();
    Ok(TriMesh::new(mesh.positions().to_vec(), facets).ok().map(|single| (single, left_out.len())))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::adjacency::Adjacency;
    use crate::mesh::shapes::Shape;

    fn with(mesh: &TriMesh, more: impl Iterator<Item = [u32; 3]>) -> TriMesh {
        let facets = mesh.facets().iter().copied().chain(more).collect();
        TriMesh::new(mesh.positions().to_vec(), facets).unwrap()
    }

    fn back([a, b, c]: [u32; 3]) -> [u32; 3] {
        [a, c, b]
    }

    #[test]
    fn facets_that_are_there_twice() {
        for shape in [Shape::Sphere, Shape::Torus] {
            let mesh = shape.build(500);
            assert!(single(&mesh, &Token::default()).unwrap().is_none() && !any(&mesh));
            let some = || mesh.facets().iter().copied().enumerate().filter(|(f, _)| f % 50 < 7).map(|(_, t)| t);
            for twice in
                [with(&mesh, some()), with(&mesh, some().map(back)), with(&mesh, some().chain(some().map(back)))]
            {
                let (once, left_out) = single(&twice, &Token::default()).unwrap().unwrap();
                assert_eq!((once.facets(), left_out), (mesh.facets(), twice.facets().len() - mesh.facets().len()));
                assert!(any(&twice));
            }
            // All of it, the same way round.
            let whole = with(&mesh, mesh.facets().iter().map(|&[a, b, c]| [b, c, a]));
            assert_eq!(single(&whole, &Token::default()).unwrap().unwrap().0.facets(), mesh.facets());
        }
        // The one is taken that goes with those beside it.
        let mesh = Shape::Sphere.build(500);
        let reversed = mesh.facets().iter().enumerate().map(|(f, &t)| if f % 50 == 0 { back(t) } else { t });
        let more = mesh.facets().iter().copied().step_by(50);
        let twice = TriMesh::new(mesh.positions().to_vec(), reversed.chain(more).collect()).unwrap();
        assert_eq!(Adjacency::new(&single(&twice, &Token::default()).unwrap().unwrap().0).inconsistent_edges(), 0);
        // Also where it has boundaries, and where the second one has vertices of its own.
        let sheet = Shape::Plane.build(200);
        let n = sheet.positions().len() as u32;
        let positions = [sheet.positions(), sheet.positions()].concat();
        let facets = sheet.facets().iter().copied().chain(sheet.facets().iter().map(|t| t.map(|v| v + n))).collect();
        assert_eq!(
            single(&TriMesh::new(positions, facets).unwrap(), &Token::default()).unwrap().unwrap().0.facets(),
            sheet.facets()
        );
    }

    #[test]
    fn what_is_no_surface_is_counted() {
        let mesh = Shape::Sphere.build(200);
        let facets = mesh.facets().len();
        assert_eq!(look(&mesh), Oddities { places: facets, ..Oddities::default() });
        let both = with(&mesh, mesh.facets().iter().copied().map(back));
        assert_eq!(look(&both), Oddities { back_to_back: 2 * facets, enclosed: 0, places: facets });
        // Corners of a cube's tetrahedra around one of its diagonals, the facets between them once.
        let points = (0..8u32).map(|k| glam::DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2)));
        let path = [1, 3, 2, 6, 4, 5, 1];
        let facets = path.windows(2).flat_map(|w| [[0, 7, w[0]], [0, w[0], w[1]], [7, w[1], w[0]]]).collect();
        let solid = TriMesh::new(points.collect(), facets).unwrap();
        let seen = look(&solid);
        assert_eq!((seen.back_to_back, seen.places), (0, 18));
        assert!(seen.enclosed >= 6, "{seen:?}");
    }

    #[test]
    fn what_has_no_thickness_stays() {
        // Two sides of a sheet, of some of it, and of a closed surface.
        for shape in [Shape::Plane, Shape::Sphere] {
            let mesh = shape.build(200);
            assert!(
                single(&with(&mesh, mesh.facets().iter().copied().map(back)), &Token::default()).unwrap().is_none()
            );
        }
        // A flap on a solid, of two layers, and a fin of one.
        let solid = Shape::Sphere.build(200);
        let [a, b, _] = solid.facets()[0];
        let mut positions = solid.positions().to_vec();
        positions.push(2.0 * positions[a as usize]);
        let flap = [a, b, solid.positions().len() as u32];
        for flaps in [vec![flap, back(flap)], vec![flap]] {
            let facets = solid.facets().iter().copied().chain(flaps).collect();
            assert!(single(&TriMesh::new(positions.clone(), facets).unwrap(), &Token::default()).unwrap().is_none());
        }
        // A pillow that is flat in its middle.
        let sheet = Shape::Plane.build(200);
        let n = sheet.positions().len() as u32;
        let (low, high) = sheet.bounds();
        let middle = |p: glam::DVec3| (p - (low + high) / 2.0).abs().max_element() < 0.3 * (high - low).max_element();
        let raised = sheet.positions().iter().map(|&p| if middle(p) { p } else { p + 0.1 * glam::DVec3::Z });
        let positions = sheet.positions().iter().copied().chain(raised).collect();
        let facets =
            sheet.facets().iter().copied().chain(sheet.facets().iter().map(|t| back(t.map(|v| v + n)))).collect();
        let pillow = TriMesh::new(positions, facets).unwrap();
        assert!(any(&pillow) && single(&pillow, &Token::default()).unwrap().is_none());
    }
}
