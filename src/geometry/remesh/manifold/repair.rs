//! From the dual's triangles to an oriented 2-manifold, with or without boundary.
//!
//! Purpose: [`repair`] removes degenerate and duplicate facets, and pairs of facets back to back. It doubles edges along which
//! two sheets touch. Where facets share a directed edge, it keeps the better shaped one. It splits vertices with several fans,
//! one copy a fan, and removes vertices without a facet.
//! Invariant: whatever the dual is, no edge of the result has more than two facets or two of one direction, and no vertex more
//! than one fan. A dual that is a manifold comes out as it went in. The same bits whatever the number of threads.
//! Must not know: where the triangles came from.

use std::collections::{BTreeMap, HashSet};

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::coincident;
use crate::mesh::edges::{DisjointSets, EdgeGroups, Half};
use crate::remesh::constants::{SIDE_STEP, STEP_BACK};
use crate::remesh::report::RepairFigures;
use crate::remesh::triangle::unit_normal;
use crate::token::{Stopped, Token};

#[derive(Clone, Debug, Default)]
pub(crate) struct Repaired {
    /// For each result vertex, the input vertex it stands for: several for a split one, and one where sheets touched.
    pub source: Vec<u32>,
    /// The position of each result vertex: that of its source, but no two coincide, so that welding joins none. Copies of a
    /// split vertex except that with the largest fan move towards the centroids of their facets ([`STEP_BACK`]). Vertices
    /// that still coincide, on the two sides of a surface without thickness, move along their normals ([`SIDE_STEP`]).
    pub positions: Vec<DVec3>,
    pub facets: Vec<[u32; 3]>,
    pub figures: RepairFigures,
}

pub(crate) fn repair(positions: &[DVec3], triangles: &[[u32; 3]], token: &Token) -> Result<Repaired, Stopped> {
    let mut figures = RepairFigures::default();
    let mut facets = simple_facets(triangles, &mut figures);
    let mut places = positions.to_vec();
    let mut source: Vec<u32> = (0..positions.len() as u32).collect();
    let mut conflicts = conflicting(places.len(), &facets);
    // Every round leaves fewer edges to separate: those at a new vertex have two facets each.
    while !conflicts.is_empty() && separate_sheets(&mut places, &mut source, &mut facets) {
        token.check()?;
        conflicts = conflicting(places.len(), &facets);
    }
    token.check()?;
    let facets = oriented(&places, facets, conflicts, &mut figures);
    token.check()?;
    Ok(split_fans(&places, &source, facets, figures))
}

/// Whether each of these triangles lies back to back with another.
pub(crate) fn all_cancel(triangles: &[[u32; 3]]) -> bool {
    simple_facets(triangles, &mut RepairFigures::default()).is_empty()
}

/// Where an edge has two facets of either direction, two sheets touch along it: on a surface without thickness cells reach
/// through to its other side. Of the sheet whose facets have later numbers the edge gets a new vertex in its middle, so
/// that the sheets have no edge in common. The facets whose normals differ least are one sheet. Returns whether any
/// edge was separated; not those of facets that the separation at another edge has changed.
fn separate_sheets(places: &mut Vec<DVec3>, source: &mut Vec<u32>, facets: &mut Vec<[u32; 3]>) -> bool {
    let mut touching: Vec<[Half; 4]> = Vec::new();
    EdgeGroups::new(places.len(), facets.iter().copied().enumerate()).for_each(|low, halves| {
        let mut four: Vec<Half> = halves.to_vec();
        let forward = |half: &Half| facets[half.facet as usize][half.side] == low;
        four.sort_by_key(|half| !forward(half));
        if let [a, b, c, d] = four[..]
            && forward(&b)
            && !forward(&c)
        {
            touching.push([a, b, c, d]);
        }
    });
    let normal = |half: Half, facets: &[[u32; 3]]| unit_normal(facets[half.facet as usize].map(|v| places[v as usize]));
    let mut changed = HashSet::new();
    let mut separated = Vec::new();
    for [a, b, c, d] in touching {
        let [na, nb, nc, nd] = [a, b, c, d].map(|half| normal(half, facets));
        let sheets =
            if na.dot(nc) + nb.dot(nd) >= na.dot(nd) + nb.dot(nc) { [[a, c], [b, d]] } else { [[a, d], [b, c]] };
        let later = sheets.into_iter().max_by_key(|sheet| sheet.map(|half| half.facet).into_iter().min());
        if let Some(sheet) = later.filter(|sheet| sheet.iter().all(|half| !changed.contains(&half.facet))) {
            changed.extend(sheet.map(|half| half.facet));
            separated.push(sheet);
        }
    }
    for sheet in &separated {
        let Half { facet, side } = sheet[0];
        let ends = [facets[facet as usize][side], facets[facet as usize][(side + 1) % 3]];
        let middle = places.len() as u32;
        places.push(places[ends[0] as usize].midpoint(places[ends[1] as usize]));
        // As if its cell were a part of that of the end with the higher number: ends of curves have low ones.
        source.push(ends.map(|v| source[v as usize]).into_iter().fold(0, u32::max));
        for half in sheet {
            let t = facets[half.facet as usize];
            let (a, b, c) = (t[half.side], t[(half.side + 1) % 3], t[(half.side + 2) % 3]);
            facets[half.facet as usize] = [a, middle, c];
            facets.push([middle, b, c]);
        }
    }
    !separated.is_empty()
}

/// Facets with three different corners, each set of corners at most once. Two facets with the same corners and opposite
/// orientation cancel, as boundaries do: they are a pocket around a cell component that touches two cells only, or a fold
/// of the surface smaller than its cells, and the surface closes without them. What is left over of three facets is one.
fn simple_facets(triangles: &[[u32; 3]], figures: &mut RepairFigures) -> Vec<[u32; 3]> {
    // Corners in order, facet, whether they are in even order in it.
    let mut sorted: Vec<([u32; 3], u32, bool)> = Vec::with_capacity(triangles.len());
    for (&t, f) in triangles.iter().zip(0..) {
        let mut key = t;
        key.sort_unstable();
        if key[0] == key[1] || key[1] == key[2] {
            figures.degenerate_facets += 1;
            continue;
        }
        sorted.push((key, f, t == key || t == [key[1], key[2], key[0]] || t == [key[2], key[0], key[1]]));
    }
    sorted.par_sort_unstable();
    let mut kept: Vec<u32> = Vec::with_capacity(sorted.len());
    for same in sorted.chunk_by(|a, b| a.0 == b.0) {
        let even = same.iter().filter(|facet| facet.2).count();
        let odd = same.len() - even;
        figures.closed_facet_pairs += even.min(odd);
        if even != odd {
            kept.extend(same.iter().find(|facet| facet.2 == (even > odd)).map(|facet| facet.1));
            figures.duplicate_facets += even.abs_diff(odd) - 1;
        }
    }
    kept.sort_unstable();
    kept.into_iter().map(|f| triangles[f as usize]).collect()
}

/// Facets that have a directed edge in common with another, ascending.
fn conflicting(vertices: usize, facets: &[[u32; 3]]) -> Vec<usize> {
    let mut conflicts = vec![false; facets.len()];
    EdgeGroups::new(vertices, facets.iter().copied().enumerate()).for_each(|low, halves| {
        let forward = |half: &Half| facets[half.facet as usize][half.side] == low;
        for way in [true, false] {
            let same = || halves.iter().filter(|half| forward(half) == way);
            if same().count() > 1 {
                same().for_each(|half| conflicts[half.facet as usize] = true);
            }
        }
    });
    (0..facets.len()).filter(|&f| conflicts[f]).collect()
}

/// Keeps facets so that every directed edge is used once. Of the `conflicting`, by falling quality, those with free edges.
fn oriented(
    positions: &[DVec3],
    facets: Vec<[u32; 3]>,
    mut conflicting: Vec<usize>,
    figures: &mut RepairFigures,
) -> Vec<[u32; 3]> {
    if conflicting.is_empty() {
        return facets;
    }
    let quality = |f: usize| shape(facets[f].map(|v| positions[v as usize]));
    conflicting.sort_by(|&a, &b| quality(b).total_cmp(&quality(a)).then(a.cmp(&b)));
    let mut keep = vec![true; facets.len()];
    let mut used = HashSet::new();
    for f in conflicting {
        let [a, b, c] = facets[f];
        let halves = [(a, b), (b, c), (c, a)];
        if halves.iter().any(|h| used.contains(h)) {
            keep[f] = false;
            figures.non_manifold_facets += 1;
        } else {
            used.extend(halves);
        }
    }
    facets.into_iter().zip(keep).filter_map(|(t, k)| k.then_some(t)).collect()
}

/// Area over squared edge lengths: 0 for a sliver, the most for an equilateral triangle.
fn shape([a, b, c]: [DVec3; 3]) -> f64 {
    let squares = (b - a).length_squared() + (c - b).length_squared() + (a - c).length_squared();
    if squares > 0.0 { (b - a).cross(c - a).length() / squares } else { 0.0 }
}

/// Gives every fan of facets a vertex of its own, and drops unused ones. `source` is what each of `positions` stands for.
fn split_fans(positions: &[DVec3], source: &[u32], facets: Vec<[u32; 3]>, mut figures: RepairFigures) -> Repaired {
    let mut fan = DisjointSets::new(facets.len() * 3);
    EdgeGroups::new(positions.len(), facets.iter().copied().enumerate()).for_each(|_, halves| {
        let [near, far] = *halves else { return };
        let corner = |half: Half, end: usize| half.facet as usize * 3 + (half.side + end) % 3;
        let vertex = |corner: usize| facets[corner / 3][corner % 3];
        // Each edge has one facet of either direction at most: the far one runs back.
        for (here, there) in [(corner(near, 0), corner(far, 1)), (corner(near, 1), corner(far, 0))] {
            if vertex(here) == vertex(there) {
                fan.join(here, there);
            }
        }
    });
    // Numbered by what the vertex stands for, by vertex, then by first corner: a manifold keeps its order.
    let corners: Vec<(u32, usize)> = (0..fan.len()).map(|c| (facets[c / 3][c % 3], fan.root(c))).collect();
    let own = corners.iter().enumerate().filter(|&(corner, &(_, first))| corner == first);
    let mut fans: Vec<(u32, u32, usize)> = own.map(|(_, &(v, first))| (source[v as usize], v, first)).collect();
    fans.par_sort_unstable();
    figures.split_vertices = fans.windows(2).filter(|w| w[0].0 == w[1].0).count();
    // By a fan's first corner.
    let mut number = vec![0; corners.len()];
    fans.iter().zip(0u32..).for_each(|(&(_, _, first), i)| number[first] = i);
    let facets: Vec<[u32; 3]> = corners.as_chunks::<3>().0.iter().map(|c| c.map(|(_, first)| number[first])).collect();
    let mut placed: Vec<DVec3> = fans.iter().map(|&(_, v, _)| positions[v as usize]).collect();
    let source: Vec<u32> = fans.into_iter().map(|(source, _, _)| source).collect();
    if figures.split_vertices > 0 {
        step_back(&mut placed, &source, &facets);
    }
    separate_sides(&mut placed, &facets);
    Repaired { source, positions: placed, facets, figures }
}

/// Moves all copies of a split vertex but the one with the most facets.
fn step_back(placed: &mut [DVec3], source: &[u32], facets: &[[u32; 3]]) {
    let mut middle = vec![(DVec3::ZERO, 0u32); placed.len()];
    for t in facets {
        let centre = t.iter().map(|&v| placed[v as usize]).sum::<DVec3>() / 3.0;
        for &v in t {
            middle[v as usize].0 += centre;
            middle[v as usize].1 += 1;
        }
    }
    let mut first = 0;
    for copies in source.chunk_by(|a, b| a == b) {
        let range = first..first + copies.len();
        first = range.end;
        let largest = range.clone().max_by_key(|&v| (middle[v].1, std::cmp::Reverse(v)));
        for v in range.filter(|&v| Some(v) != largest) {
            let (sum, count) = middle[v];
            placed[v] = placed[v].lerp(sum / f64::from(count), STEP_BACK);
        }
    }
}

/// Moves vertices that are in one place along their normals.
fn separate_sides(placed: &mut [DVec3], facets: &[[u32; 3]]) {
    let together = coincident::find(placed).into_iter().flat_map(|(later, earliest)| [later, earliest]);
    let mut normal: BTreeMap<usize, _> = together.map(|v| (v as usize, (DVec3::ZERO, f64::INFINITY))).collect();
    if normal.is_empty() {
        return;
    }
    for t in facets {
        let [a, b, c] = t.map(|v| placed[v as usize]);
        let shortest = a.distance(b).min(b.distance(c)).min(c.distance(a));
        for v in t {
            if let Some((sum, edge)) = normal.get_mut(&(*v as usize)) {
                *sum += unit_normal([a, b, c]);
                *edge = edge.min(shortest);
            }
        }
    }
    for (v, (sum, edge)) in normal {
        placed[v] += SIDE_STEP * edge * sum.normalize_or_zero();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(n: u32) -> Vec<DVec3> {
        (0..n).map(|i| DVec3::new(f64::from(i).cos(), f64::from(i * i).sin(), f64::from(i % 3))).collect()
    }

    #[test]
    fn a_tetrahedron_is_left_alone() {
        let facets = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]];
        let out = repair(&points(4), &facets, &Token::default()).unwrap();
        assert_eq!((out.facets.as_slice(), out.source), (&facets[..], vec![0, 1, 2, 3]));
        assert_eq!(out.figures, RepairFigures::default());
    }

    #[test]
    fn duplicates_and_degenerates_go() {
        let out = repair(&points(4), &[[0, 1, 2], [1, 2, 0], [3, 3, 1]], &Token::default()).unwrap();
        assert_eq!(out.facets, [[0, 1, 2]]);
        assert_eq!((out.figures.duplicate_facets, out.figures.degenerate_facets), (1, 1));
    }

    #[test]
    fn of_a_fold_one_facet_is_left() {
        let out = repair(&points(4), &[[0, 1, 2], [0, 2, 1], [1, 2, 0]], &Token::default()).unwrap();
        assert_eq!(out.facets, [[0, 1, 2]]);
        assert_eq!((out.figures.closed_facet_pairs, out.figures.duplicate_facets), (1, 0));
    }

    #[test]
    fn a_pocket_closes() {
        // A tetrahedron whose edge 0-1 was opened around vertex 4.
        let facets = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3], [0, 1, 4], [1, 0, 4]];
        let out = repair(&points(5), &facets, &Token::default()).unwrap();
        assert_eq!((out.facets.as_slice(), out.source.len()), (&facets[..4], 4));
        assert_eq!(out.figures, RepairFigures { closed_facet_pairs: 1, ..RepairFigures::default() });
    }

    #[test]
    fn a_third_facet_at_an_edge_goes() {
        let out = repair(&points(5), &[[0, 1, 2], [1, 0, 3], [0, 1, 4]], &Token::default()).unwrap();
        assert_eq!((out.facets.len(), out.figures.non_manifold_facets), (2, 1));
    }

    #[test]
    fn two_sheets_that_touch_along_an_edge_are_parted() {
        // Two closed surfaces, above and below z = 0, with the edge 0-1 in common, and each a vertex of its own.
        let at = DVec3::new;
        let places = [at(-1.0, 0.0, 0.0), at(1.0, 0.0, 0.0), at(0.0, 1.0, 1.0), at(0.0, -1.0, 1.0), at(0.0, 1.0, -1.0)];
        let places = [&places[..], &[at(0.0, -1.0, -1.0)]].concat();
        let above = [[0, 1, 2], [1, 0, 3], [0, 2, 3], [1, 3, 2]];
        let below = [[1, 0, 4], [0, 1, 5], [1, 4, 5], [0, 5, 4]];
        let out = repair(&places, &[above, below].concat(), &Token::default()).unwrap();
        assert_eq!(out.facets.len(), 10);
        assert_eq!(out.figures.non_manifold_facets, 0);
        let mut halves: Vec<(u32, u32)> = out.facets.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
        halves.sort_unstable();
        assert!(halves.windows(2).all(|w| w[0] != w[1]));
        assert!(halves.iter().all(|&(a, b)| halves.binary_search(&(b, a)).is_ok()), "closed");
        // Ascending, as readers rely on.
        assert!(out.source.is_sorted() && out.source.iter().all(|&v| v < 6), "{:?}", out.source);
    }

    #[test]
    fn two_fans_at_a_vertex_get_two_vertices() {
        let out = repair(&points(5), &[[0, 1, 2], [0, 3, 4]], &Token::default()).unwrap();
        assert_eq!((out.source, out.figures.split_vertices), (vec![0, 0, 1, 2, 3, 4], 1));
        assert_ne!(out.facets[0][0], out.facets[1][0]);
        assert_ne!(out.positions[0], out.positions[1]);
    }
}
