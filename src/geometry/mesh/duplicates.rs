//! Duplicate facets: facets with the same three corners.
//!
//! Purpose: [`remove`] keeps one facet of each group if the surface is connected without the others: a file may have a facet
//! twice, or a second one for its back. [`oddities`] counts the facets that are no surface.
//! Invariant: a two-sided surface without thickness stays: a sheet of two sides, a flap on a solid, a pillow that is flat in
//! its middle. Vertices keep their numbers, and facets their order. Must not know: the use of the surface.

use std::collections::HashSet;

use rayon::prelude::*;
use serde::Serialize;

use super::TriMesh;
use super::adjacency::weld;
use super::edges::{DisjointSets, EdgeGroups, sides};
use crate::token::{Stopped, Token};

/// A facet's corners in ascending order, its number, and whether it runs from the lowest corner to the middle one.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Sorted {
    corners: [u32; 3],
    facet: u32,
    forward: bool,
}

/// Facets by corners, so that duplicates of either orientation are neighbours, in ascending order.
struct Groups {
    all: Vec<Sorted>,
    vertices: usize,
}

impl Groups {
    fn of(mesh: &TriMesh) -> Self {
        let class = weld(mesh);
        let of = |(t, facet): (&[u32; 3], u32)| {
            let [a, b, c] = t.map(|v| class[v as usize]);
            let mut corners = [a, b, c];
            corners.sort_unstable();
            let forward = sides([a, b, c]).contains(&[corners[0], corners[1]]);
            Sorted { corners, facet, forward }
        };
        let mut all: Vec<Sorted> = mesh.facets().iter().zip(0..).map(of).collect();
        // A facet with equal corners has no sides.
        all.retain(|Sorted { corners: [a, b, c], .. }| a != b && b != c);
        all.par_sort_unstable();
        Self { all, vertices: class.len() }
    }

    fn iter(&self) -> impl Iterator<Item = &[Sorted]> {
        self.all.chunk_by(|a, b| a.corners == b.corners)
    }
}

/// Kind of the input as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum InputKind {
    /// No edge has more than two facets.
    Surface,
    /// Some edges have.
    NonManifold,
    /// Most facets lie between others, as in a mesh of tetrahedra: the boundary of the volume is a surface.
    Volume,
}

/// Facets of a list that are no surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Oddities {
    /// Facets that lie on another one that is oriented the other way: two sides without thickness.
    pub back_to_back: usize,
    /// Groups of duplicate facets, or single ones, with more than two groups at each edge, as inside a mesh of tetrahedra.
    pub enclosed: usize,
    /// Number of all groups.
    pub groups: usize,
}

impl Oddities {
    /// Kind of facets with an edge of more than two facets, or, by default, without one.
    pub(crate) fn kind(&self) -> InputKind {
        match self.groups {
            0 => InputKind::Surface,
            groups if 2 * self.enclosed > groups => InputKind::Volume,
            _ => InputKind::NonManifold,
        }
    }
}

/// Linear in the facets except for sorting.
pub(crate) fn oddities(mesh: &TriMesh) -> Oddities {
    let all = Groups::of(mesh);
    let groups: Vec<&[Sorted]> = all.iter().collect();
    let mut crowded_sides = vec![0u8; groups.len()];
    EdgeGroups::new(all.vertices, groups.iter().map(|group| group[0].corners).enumerate()).for_each(|_, halves| {
        if halves.len() > 2 {
            halves.iter().for_each(|half| crowded_sides[half.facet as usize] += 1);
        }
    });
    let is_double = |group: &&&[Sorted]| group.iter().any(|facet| facet.forward != group[0].forward);
    Oddities {
        back_to_back: groups.iter().filter(is_double).map(|group| group.len()).sum(),
        enclosed: crowded_sides.into_iter().filter(|&sides| sides == 3).count(),
        groups: groups.len(),
    }
}

pub(crate) fn any(mesh: &TriMesh) -> bool {
    Groups::of(mesh).iter().any(|group| group.len() > 1)
}

/// Returns `mesh` with one facet of each group, oriented like its neighbours, and the facets that stay; `None` if all do.
pub(crate) fn remove(mesh: &TriMesh, token: &Token) -> Result<Option<(TriMesh, Vec<u32>)>, Stopped> {
    let found = Groups::of(mesh);
    token.check()?;
    let groups: Vec<&[Sorted]> = found.iter().collect();
    if groups.iter().all(|group| group.len() == 1) {
        return Ok(None);
    }
    let mut patches = DisjointSets::new(groups.len());
    // For each edge of a repeated facet, how many groups have it, and one of the repeated ones.
    let mut sides: Vec<(usize, usize)> = Vec::new();
    let mut open = HashSet::new();
    // Votes per group: neighbours that agree with a forward facet, less those that do not.
    let mut votes = vec![0i32; groups.len()];
    EdgeGroups::new(found.vertices, groups.iter().map(|group| group[0].corners).enumerate()).for_each(|_, halves| {
        let repeated: Vec<usize> =
            halves.iter().map(|half| half.facet as usize).filter(|&group| groups[group].len() > 1).collect();
        repeated.windows(2).for_each(|pair| patches.join(pair[0], pair[1]));
        if let Some(&group) = repeated.first() {
            sides.push((halves.len(), group));
            if halves.len() > repeated.len() {
                open.insert(group);
            }
            if let (&[a, b], [_]) = (halves, &repeated[..]) {
                let alone = if a.facet as usize == group { b } else { a };
                let other = groups[alone.facet as usize][0];
                // Two half-edges agree if they run opposite ways; the last one of a forward facet runs from high to low.
                let agrees = other.forward == ((a.side == 2) != (b.side == 2));
                votes[group] += if agrees { 1 } else { -1 };
            }
        }
    });
    token.check()?;
    let non_manifold: HashSet<usize> = sides.iter().filter(|s| s.0 > 2).map(|s| patches.root(s.1)).collect();
    let continues: HashSet<usize> = open.into_iter().map(|group| patches.root(group)).collect();
    let repeated = || groups.iter().enumerate().filter(|(_, group)| group.len() > 1);
    let two_sided = repeated().filter(|(_, group)| group.iter().any(|other| other.forward != group[0].forward));
    let two_sided: HashSet<usize> = two_sided.map(|(k, _)| patches.root(k)).collect();
    let mut left_out = HashSet::new();
    for (k, group) in repeated() {
        let patch = patches.root(k);
        if !non_manifold.contains(&patch) && (continues.contains(&patch) || !two_sided.contains(&patch)) {
            let agrees = |other: &&Sorted| votes[k] == 0 || other.forward == (votes[k] > 0);
            let kept = group.iter().find(agrees).unwrap_or(&group[0]).facet;
            left_out.extend(group.iter().map(|other| other.facet).filter(|&f| f != kept).map(|f| f as usize));
        }
    }
    if left_out.is_empty() {
        return Ok(None);
    }
    let kept: Vec<u32> = (0..mesh.facets().len()).filter(|f| !left_out.contains(f)).map(|f| f as u32).collect();
    let facets = kept.iter().map(|&f| mesh.facets()[f as usize]).collect();
    Ok(TriMesh::new(mesh.positions().to_vec(), facets).ok().map(|single| (single, kept)))
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
            assert!(remove(&mesh, &Token::default()).unwrap().is_none() && !any(&mesh));
            let some = || mesh.facets().iter().copied().enumerate().filter(|(f, _)| f % 50 < 7).map(|(_, t)| t);
            for twice in
                [with(&mesh, some()), with(&mesh, some().map(back)), with(&mesh, some().chain(some().map(back)))]
            {
                let (once, kept) = remove(&twice, &Token::default()).unwrap().unwrap();
                assert_eq!((once.facets(), kept.len()), (mesh.facets(), mesh.facets().len()));
                assert!(any(&twice));
            }
            // All facets, with the same orientation.
            let whole = with(&mesh, mesh.facets().iter().map(|&[a, b, c]| [b, c, a]));
            assert_eq!(remove(&whole, &Token::default()).unwrap().unwrap().0.facets(), mesh.facets());
        }
        // The facet that agrees with its neighbours is kept.
        let mesh = Shape::Sphere.build(500);
        let reversed = mesh.facets().iter().enumerate().map(|(f, &t)| if f % 50 == 0 { back(t) } else { t });
        let more = mesh.facets().iter().copied().step_by(50);
        let twice = TriMesh::new(mesh.positions().to_vec(), reversed.chain(more).collect()).unwrap();
        assert_eq!(Adjacency::new(&remove(&twice, &Token::default()).unwrap().unwrap().0).inconsistent_edges, 0);
        // Also where it has boundaries, and where the second one has vertices of its own.
        let sheet = Shape::Plane.build(200);
        let n = sheet.positions().len() as u32;
        let positions = [sheet.positions(), sheet.positions()].concat();
        let facets = sheet.facets().iter().copied().chain(sheet.facets().iter().map(|t| t.map(|v| v + n))).collect();
        assert_eq!(
            remove(&TriMesh::new(positions, facets).unwrap(), &Token::default()).unwrap().unwrap().0.facets(),
            sheet.facets()
        );
    }

    #[test]
    fn what_is_no_surface_is_counted() {
        let mesh = Shape::Sphere.build(200);
        let facets = mesh.facets().len();
        assert_eq!(oddities(&mesh), Oddities { groups: facets, ..Oddities::default() });
        let both = with(&mesh, mesh.facets().iter().copied().map(back));
        assert_eq!(oddities(&both), Oddities { back_to_back: 2 * facets, enclosed: 0, groups: facets });
        // Corners of a cube's tetrahedra around one of its diagonals, the facets between them once.
        let points = (0..8u32).map(|k| glam::DVec3::new(f64::from(k & 1), f64::from(k >> 1 & 1), f64::from(k >> 2)));
        let path = [1, 3, 2, 6, 4, 5, 1];
        let facets = path.windows(2).flat_map(|w| [[0, 7, w[0]], [0, w[0], w[1]], [7, w[1], w[0]]]).collect();
        let solid = TriMesh::new(points.collect(), facets).unwrap();
        let seen = oddities(&solid);
        assert_eq!((seen.back_to_back, seen.groups), (0, 18));
        assert!(seen.enclosed >= 6, "{seen:?}");
    }

    #[test]
    fn what_has_no_thickness_stays() {
        // Two sides of a sheet, of some of it, and of a closed surface.
        for shape in [Shape::Plane, Shape::Sphere] {
            let mesh = shape.build(200);
            assert!(
                remove(&with(&mesh, mesh.facets().iter().copied().map(back)), &Token::default()).unwrap().is_none()
            );
        }
        // A flap on a solid, of two facets, and a fin of one.
        let solid = Shape::Sphere.build(200);
        let [a, b, _] = solid.facets()[0];
        let mut positions = solid.positions().to_vec();
        positions.push(2.0 * positions[a as usize]);
        let flap = [a, b, solid.positions().len() as u32];
        for flaps in [vec![flap, back(flap)], vec![flap]] {
            let facets = solid.facets().iter().copied().chain(flaps).collect();
            assert!(remove(&TriMesh::new(positions.clone(), facets).unwrap(), &Token::default()).unwrap().is_none());
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
        assert!(any(&pillow) && remove(&pillow, &Token::default()).unwrap().is_none());
    }
}
