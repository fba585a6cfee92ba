//! Which facets continue each other at edges of more than two.
//!
//! Purpose: [`Pairing::of`] pairs the facets at such edges: first those that the file joins by its vertices, then those with material
//! between them, then those that continue each other best. The last are paired by curves: edges in a row that the same fans of facets
//! meet along, so that noise does not change the pair from edge to edge.
//! Invariant: depends on the mesh alone. A pair along a curve does not make a sheet meet itself elsewhere without a pair there; where it
//! would, both end. Must not know: why sheets are wanted.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use glam::DVec3;

use super::Link;
use crate::mesh::TriMesh;
use crate::mesh::edges::{DisjointSets, EdgeGroups, Half, undirected};
use crate::token::{Stopped, Token};

/// Facets at an edge that are told apart; those of an edge of more stay together.
const MOST_AT_EDGE: usize = 32;

/// What a pair of facets that face opposite sides counts more than one that folds back.
const OPPOSITE: f64 = 4.0;

/// The pairs at edges of more than two facets, by the ends of the edges, the lower first.
pub(super) struct Pairing(BTreeMap<[u32; 2], Vec<Link>>);

/// A facet at an edge, seen along the edge from its lower end.
struct Side {
    facet: usize,
    /// The two vertices that the file has there.
    ends: [u32; 2],
    /// Whether it runs from the lower end to the higher one.
    forward: bool,
    /// From the lower end to the higher one.
    along: DVec3,
    /// Towards its third corner, square to the edge, of length 1.
    out: DVec3,
}

/// An edge with the facets that neither the file nor material pairs.
struct Edge {
    ends: [u32; 2],
    length: f64,
    sides: Vec<Side>,
}

/// Edges in a row that the same fans meet along. The sides of each edge are in the order of the fans.
struct Curve {
    edges: Vec<Edge>,
    is_paired: Vec<bool>,
}

/// Two fans of a curve, by their places in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Pair {
    curve: usize,
    fans: [usize; 2],
}

impl Pairing {
    /// Unless sheets `go_on`, they end at all edges of more than two facets.
    pub(super) fn of(
        mesh: &TriMesh,
        (class, groups): (&[u32], &EdgeGroups),
        go_on: bool,
        token: &Token,
    ) -> Result<Self, Stopped> {
        let mut all = BTreeMap::new();
        let mut sheets = DisjointSets::new(mesh.facets().len());
        let mut found = Vec::new();
        let outward = signed_volume(mesh) >= 0.0;
        let mut edges = Vec::new();
        groups.for_each(|low, halves| match *halves {
            [_] => {}
            [a, b] => sheets.join(a.facet as usize, b.facet as usize),
            // No sheets meet like that.
            ref fan if fan.len() > MOST_AT_EDGE => {
                let links: Vec<Link> = fan.windows(2).map(|pair| [pair[0].facet, pair[1].facet]).collect();
                found.extend_from_slice(&links);
                all.insert(ends_of((mesh, class), low, halves), links);
            }
            _ if !go_on => {}
            _ => {
                let ends = ends_of((mesh, class), low, halves);
                let mut sides = sides(mesh, class, low, halves);
                let mut links = of_file(&mut sides);
                if 2 * sides.iter().filter(|side| side.forward).count() == sides.len() {
                    links.extend(around_material(&mut sides, outward));
                } else {
                    let [p, q] = ends.map(|v| mesh.positions()[v as usize]);
                    edges.push(Edge { ends, length: p.distance(q), sides });
                }
                found.extend_from_slice(&links);
                all.insert(ends, links);
            }
        });
        token.check()?;
        found.iter().for_each(|[a, b]| sheets.join(*a as usize, *b as usize));
        if !edges.is_empty() {
            let mut curves = curves_of(edges, &mut fans(mesh, class, groups));
            pair((mesh, class), &mut curves, &mut sheets, token)?.into_iter().for_each(|Pair { curve, fans }| {
                for edge in &curves[curve].edges {
                    let link = fans.map(|at| edge.sides[at].facet as u32);
                    all.entry(edge.ends).or_default().push(link);
                }
            });
        }
        Ok(Self(all))
    }

    /// The pairs through which a sheet goes on at the edge with these ends, the lower first, and these facets.
    pub(super) fn at(&self, ends: [u32; 2], halves: &[Half]) -> Vec<Link> {
        match *halves {
            [_] => Vec::new(),
            [a, b] => vec![[a.facet, b.facet]],
            _ => self.0.get(&ends).cloned().unwrap_or_default(),
        }
    }

    /// All pairs at edges of more than two facets.
    pub(super) fn links(&self) -> impl Iterator<Item = &Link> {
        self.0.values().flatten()
    }
}

/// The ends of an edge, the lower first.
pub(super) fn ends_of((mesh, class): (&TriMesh, &[u32]), low: u32, halves: &[Half]) -> [u32; 2] {
    let t = mesh.facets()[halves[0].facet as usize];
    let [a, b] = [t[halves[0].side], t[(halves[0].side + 1) % 3]].map(|v| class[v as usize]);
    [low, if a == low { b } else { a }]
}

/// Six times the volume within a closed surface, from its corner; positive if its facets are seen from outside.
fn signed_volume(mesh: &TriMesh) -> f64 {
    let (origin, _) = mesh.bounds();
    (0..mesh.facets().len())
        .map(|f| {
            let [a, b, c] = mesh.corners(f).map(|p| p - origin);
            a.dot(b.cross(c))
        })
        .sum()
}

fn sides(mesh: &TriMesh, class: &[u32], low: u32, halves: &[Half]) -> Vec<Side> {
    let side = |half: &Half| {
        let facet = half.facet as usize;
        let corners = mesh.facets()[facet];
        let ends = [corners[half.side], corners[(half.side + 1) % 3]];
        let [a, b, c] = [0, 1, 2].map(|k| mesh.corners(facet)[(half.side + k) % 3]);
        let along = (b - a).normalize_or_zero();
        let out = ((c - a) - along * (c - a).dot(along)).normalize_or_zero();
        let forward = class[ends[0] as usize] == low;
        Side { facet, ends, forward, along: if forward { along } else { -along }, out }
    };
    halves.iter().map(side).collect()
}

/// Pairs the facets at an edge that the file joins by its vertices, and takes them out.
fn of_file(sides: &mut Vec<Side>) -> Vec<Link> {
    let mut by_ends: BTreeMap<[u32; 2], Vec<u32>> = BTreeMap::new();
    sides.iter().for_each(|side| by_ends.entry(undirected(side.ends)).or_default().push(side.facet as u32));
    by_ends.retain(|_, facets| facets.len() == 2);
    sides.retain(|side| !by_ends.contains_key(&undirected(side.ends)));
    by_ends.into_values().map(|facets| [facets[0], facets[1]]).collect()
}

/// Pairs the facets of solids that share the edge, so that each solid keeps its own. A facet that runs forward has material on
/// its clockwise side, seen against the edge, if facets are seen from outside.
fn around_material(sides: &mut [Side], outward: bool) -> Vec<Link> {
    let Some(&Side { out: right, along, .. }) = sides.first() else { return Vec::new() };
    let up = along.cross(right);
    // Facets on one another are at one angle in spite of rounding.
    let angle = |side: &Side| (1e9 * side.out.dot(up).atan2(side.out.dot(right))).round();
    // Of two in one place, one ends a solid before the other begins one.
    let begins = |side: &Side| side.forward != outward;
    sides.sort_by(|a, b| angle(a).total_cmp(&angle(b)).then(begins(a).cmp(&begins(b))).then(a.facet.cmp(&b.facet)));
    let mut found = Vec::new();
    let mut open: Vec<usize> = Vec::new();
    let mut closed = vec![false; sides.len()];
    // The second time around ends what began before the first angle.
    for (k, side) in sides.iter().enumerate().chain(sides.iter().enumerate()) {
        if closed[k] || open.contains(&k) {
            continue;
        }
        if begins(side) {
            open.push(k);
        } else if let Some(begun) = open.pop() {
            (closed[k], closed[begun]) = (true, true);
            found.push([sides[begun].facet as u32, side.facet as u32]);
        }
    }
    found
}

/// The fans of facets around each vertex between edges of other than two facets: corners, numbered `3 facet + corner`.
struct Fans<'a> {
    mesh: &'a TriMesh,
    class: &'a [u32],
    corners: DisjointSets,
}

fn fans<'a>(mesh: &'a TriMesh, class: &'a [u32], groups: &EdgeGroups) -> Fans<'a> {
    let mut fans = Fans { mesh, class, corners: DisjointSets::new(3 * mesh.facets().len()) };
    groups.for_each(|low, halves| {
        if let [a, b] = *halves {
            for v in ends_of((mesh, class), low, halves) {
                let [a, b] = [a, b].map(|half| fans.corner(half.facet as usize, v));
                fans.corners.join(a, b);
            }
        }
    });
    fans
}

impl Fans<'_> {
    fn corner(&self, facet: usize, v: u32) -> usize {
        let corners = self.mesh.facets()[facet];
        3 * facet + (0..3).find(|&k| self.class[corners[k] as usize] == v).unwrap_or(0)
    }

    /// The fan of a facet at a vertex.
    fn at(&mut self, facet: usize, v: u32) -> usize {
        let corner = self.corner(facet, v);
        self.corners.root(corner)
    }
}

/// The curves that these edges form. Two in a row are of one curve if each side of one is in the fan of a side of the other.
fn curves_of(edges: Vec<Edge>, fans: &mut Fans<'_>) -> Vec<Curve> {
    let mut at: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    edges.iter().enumerate().flat_map(|(k, edge)| edge.ends.map(|v| (v, k))).for_each(|(v, k)| {
        at.entry(v).or_default().push(k);
    });
    let first: Vec<usize> = edges
        .iter()
        .scan(0, |next, edge| {
            *next += edge.sides.len();
            Some(*next - edge.sides.len())
        })
        .collect();
    let mut of_edge = DisjointSets::new(edges.len());
    let mut of_side = DisjointSets::new(edges.iter().map(|edge| edge.sides.len()).sum());
    for (&v, met) in &at {
        let &[a, b] = &met[..] else { continue };
        let mut fans_of = |k: usize| {
            let sides = edges[k].sides.iter().enumerate();
            let mut of: Vec<(usize, usize)> = sides.map(|(i, side)| (fans.at(side.facet, v), first[k] + i)).collect();
            of.sort_unstable();
            of
        };
        let (of_a, of_b) = (fans_of(a), fans_of(b));
        let are_apart = of_a.windows(2).all(|pair| pair[0].0 != pair[1].0);
        if are_apart && of_a.iter().map(|(fan, _)| fan).eq(of_b.iter().map(|(fan, _)| fan)) {
            of_edge.join(a, b);
            of_a.iter().zip(&of_b).for_each(|(a, b)| of_side.join(a.1, b.1));
        }
    }
    let mut curves: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    (0..edges.len()).for_each(|k| curves.entry(of_edge.root(k)).or_default().push(k));
    // A curve along which fans change places has no order of them.
    let mut parted = Vec::new();
    curves.retain(|_, own| {
        let mut is_ordered = |&k: &usize| {
            let of: BTreeSet<usize> = (0..edges[k].sides.len()).map(|i| of_side.root(first[k] + i)).collect();
            of.len() == edges[k].sides.len()
        };
        let is_whole = own.iter().all(&mut is_ordered);
        if !is_whole {
            parted.extend_from_slice(own);
        }
        is_whole
    });
    let mut edges: Vec<Option<Edge>> = edges.into_iter().map(Some).collect();
    let runs = curves.into_values().chain(parted.into_iter().map(|k| vec![k]));
    let mut curve = |own: Vec<usize>| {
        let take = |k: usize| {
            let mut edge = edges[k].take()?;
            let mut sides: Vec<(usize, Side)> =
                edge.sides.into_iter().enumerate().map(|(i, side)| (of_side.root(first[k] + i), side)).collect();
            sides.sort_by_key(|(fan, side)| (*fan, side.facet));
            edge.sides = sides.into_iter().map(|(_, side)| side).collect();
            Some(edge)
        };
        let edges: Vec<Edge> = own.into_iter().filter_map(take).collect();
        Curve { is_paired: vec![false; edges[0].sides.len()], edges }
    };
    runs.map(&mut curve).collect()
}

/// Pairs fans along curves, and joins their sheets: first those of one sheet, then those with the least bend over the longest curve;
/// pairs that face opposite sides are last.
fn pair(
    (mesh, class): (&TriMesh, &[u32]),
    curves: &mut [Curve],
    sheets: &mut DisjointSets,
    token: &Token,
) -> Result<Vec<Pair>, Stopped> {
    let mut candidates: Vec<(bool, f64, Pair)> = Vec::new();
    for (k, curve) in curves.iter().enumerate() {
        let count = curve.is_paired.len();
        for fans in (0..count).flat_map(|i| (i + 1..count).map(move |j| [i, j])) {
            let bend = |edge: &Edge| {
                let [a, b] = fans.map(|at| &edge.sides[at]);
                edge.length * (a.out.dot(b.out) + if a.forward == b.forward { OPPOSITE } else { 0.0 })
            };
            let [a, b] = fans.map(|at| sheets.root(curve.edges[0].sides[at].facet));
            candidates.push((a != b, curve.edges.iter().map(bend).sum(), Pair { curve: k, fans }));
        }
    }
    candidates.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    let mut places = Places::of((mesh, class), curves, sheets);
    let mut found = Vec::new();
    for (_, _, pair) in candidates {
        token.check()?;
        let Pair { curve, fans } = pair;
        if fans.iter().any(|&at| curves[curve].is_paired[at]) {
            continue;
        }
        let [a, b] = fans.map(|at| sheets.root(curves[curve].edges[0].sides[at].facet));
        let links = if a == b { Some(vec![pair]) } else { places.between([a, b], curves, sheets) };
        for Pair { curve, fans } in links.iter().flatten() {
            fans.iter().for_each(|&at| curves[*curve].is_paired[at] = true);
        }
        if a != b && links.is_some() {
            sheets.join(a, b);
            places.join([a, b]);
        }
        found.extend(links.into_iter().flatten());
    }
    Ok(found)
}

/// Where sheets meet: vertices of curves, those with the same sheets and curves once.
struct Places {
    /// Of each place, the curves there.
    curves: Vec<Vec<usize>>,
    of_sheet: HashMap<usize, BTreeSet<usize>>,
}

impl Places {
    fn of((mesh, class): (&TriMesh, &[u32]), curves: &[Curve], sheets: &mut DisjointSets) -> Self {
        let mut at: BTreeMap<u32, (BTreeSet<usize>, BTreeSet<usize>)> = BTreeMap::new();
        for (k, curve) in curves.iter().enumerate() {
            for v in curve.edges.iter().flat_map(|edge| edge.ends) {
                at.entry(v).or_default().0.insert(k);
            }
        }
        for (f, t) in mesh.facets().iter().enumerate() {
            for v in t.map(|v| class[v as usize]) {
                if let Some((_, of)) = at.get_mut(&v) {
                    of.insert(sheets.root(f));
                }
            }
        }
        let all: BTreeSet<(BTreeSet<usize>, BTreeSet<usize>)> = at.into_values().collect();
        let mut places = Self { curves: Vec::new(), of_sheet: HashMap::new() };
        for (k, (curves, of)) in all.into_iter().enumerate() {
            places.curves.push(curves.into_iter().collect());
            of.into_iter().for_each(|sheet| _ = places.of_sheet.entry(sheet).or_default().insert(k));
        }
        places
    }

    /// The pairs through which two sheets become one; `None` if that one would meet itself where there is none.
    fn between(&self, of: [usize; 2], curves: &[Curve], sheets: &mut DisjointSets) -> Option<Vec<Pair>> {
        let mut found = BTreeSet::new();
        let [a, b] = of.map(|sheet| self.of_sheet.get(&sheet));
        for &place in a?.intersection(b?) {
            let mut is_met = false;
            for &curve in &self.curves[place] {
                let Curve { edges, is_paired } = &curves[curve];
                let mut fans_of = |sheet: usize| -> Vec<usize> {
                    (0..is_paired.len()).filter(|&at| sheets.root(edges[0].sides[at].facet) == sheet).collect()
                };
                match (&fans_of(of[0])[..], &fans_of(of[1])[..]) {
                    ([], _) | (_, []) => {}
                    (&[i], &[k]) if !is_paired[i] && !is_paired[k] => {
                        is_met = true;
                        found.insert(Pair { curve, fans: [i.min(k), i.max(k)] });
                    }
                    _ => return None,
                }
            }
            if !is_met {
                return None;
            }
        }
        Some(found.into_iter().collect())
    }

    fn join(&mut self, [a, b]: [usize; 2]) {
        let mut both = self.of_sheet.remove(&a).unwrap_or_default();
        both.extend(self.of_sheet.remove(&b).unwrap_or_default());
        self.of_sheet.insert(a.min(b), both);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::sheets::Sheets;

    /// Strips along x: each from one place to the next in a cross-section, for each of some steps.
    fn strips(steps: usize, sections: &[Vec<usize>], place: impl Fn(usize, usize) -> [f64; 2]) -> TriMesh {
        let places = sections.iter().flatten().max().unwrap() + 1;
        let at = |(step, k): (usize, usize)| {
            let [y, z] = place(step, k);
            DVec3::new(step as f64, y, z)
        };
        let positions = (0..=steps).flat_map(|step| (0..places).map(move |k| (step, k))).map(at).collect();
        let number = |step: usize, k: usize| (step * places + k) as u32;
        let mut facets = Vec::new();
        for (step, pair) in
            (0..steps).flat_map(|step| sections.iter().flat_map(|s| s.windows(2)).map(move |p| (step, p)))
        {
            let [a, b] = [0, 1].map(|k| number(step, pair[k]));
            let [c, d] = [0, 1].map(|k| number(step + 1, pair[k]));
            facets.extend([[a, b, d], [a, d, c]]);
        }
        TriMesh::new(positions, facets).unwrap()
    }

    fn count(mesh: &TriMesh) -> usize {
        Sheets::of(mesh, 0.0, true, &Token::default()).unwrap().count
    }

    #[test]
    fn noise_does_not_change_a_pair_along_a_curve() {
        // Three half planes at equal angles, each in turn a little nearer to the one before.
        let place = |step: usize, k: usize| match k {
            0 => [0.0, 0.0],
            _ => {
                let turn = if step / 2 % 3 == k - 1 { 0.2 } else { 0.0 };
                let angle = (k as f64) * std::f64::consts::TAU / 3.0 + turn;
                [angle.cos(), angle.sin()]
            }
        };
        let mesh = strips(12, &[vec![0, 1], vec![2, 0], vec![3, 0]], place);
        assert_eq!(count(&mesh), 2);
    }

    #[test]
    fn a_sheet_does_not_meet_itself_at_another_curve() {
        // Three strips between the same two lines. The best pair at one line is not the best one at the other.
        let places = [[0.0, 0.0], [4.0, 0.0], [0.5, 2.0], [3.5, 2.0], [2.0, 0.1], [0.5, -2.0], [3.9, -0.5]];
        let sections = [vec![0, 2, 3, 1], vec![1, 4, 0], vec![1, 6, 5, 0]];
        assert_eq!(count(&strips(3, &sections, |_, k| places[k])), 2);
        // The same, turned around at one line, so that another pair is the best one there.
        let places = [[0.0, 0.0], [4.0, 0.0], [0.5, 2.0], [3.5, 2.0], [4.0, -1.0], [0.5, -2.0], [3.0, 0.1]];
        assert_eq!(count(&strips(3, &sections, |_, k| places[k])), 2);
    }
}
