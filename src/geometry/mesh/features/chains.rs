//! Curves between corners, made of the graph of feature edges.
//!
//! Purpose: [`curves`] follows chains of edges through vertices of degree two, and cuts them where they turn sharply. Where a
//! crease meets a boundary close to the end of another crease, or a boundary has two corners in a short step, a vertex at each
//! would make an edge that is far too short, and triangles with small angles. [`merge_corners`] removes one of the two where the curves
//! hardly change: they continue along the boundary between the two, and end at the other one. Creases that are too close to each
//! other can be left out instead, and are where they are short.
//! Invariant: every edge of the graph is part of one curve, and a boundary stays one; a corner is merged only if the chords from
//! the remaining one leave the curves by little. Must not know: why an edge is a feature, seeds, facets.

use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;

use super::graph::Graph;
use super::{Curve, CurveKind, Metric};
use crate::mesh::closest_point::distance_to_segment;
use crate::mesh::edges::undirected;
use crate::token::{Stopped, Token};

/// Number of edges at the end of a curve that [`Curve::ends_deg`] averages.
const END_EDGES: usize = 3;
/// A curve has a corner where it turns by more than this, degrees.
const CORNER_ANGLE: f64 = 60.0;
/// The same between straight lines of a plane's boundary. Creases turn like that where a round side was made of plane faces, whose
/// edges are no creases: corners there bring nothing.
const BEND_ANGLE: f64 = 10.0;
/// Lines between which a bend is a corner are this long, [`super::FeatureOptions::turn_reach`].
const LINE: f64 = 2.0;
/// A chain is straight if its vertices are this near to its chord, shares of its length.
const STRAIGHT: f64 = 1e-5;

/// The curves between corners, the corners, and how many of them have become part of others. Those `given` are corners if a curve has
/// them, and stay.
pub(super) fn curves(
    graph: &Graph,
    metric: Metric<'_>,
    merge: CornerMerge,
    given: &BTreeSet<u32>,
    token: &Token,
) -> Result<(Vec<Curve>, Vec<u32>, usize), Stopped> {
    let kind = |a: u32, b: u32| graph.edges[&undirected([a, b])].kind;
    let mean_angle = |c: &[u32]| {
        c.windows(2).map(|p| graph.edges[&undirected([p[0], p[1]])].angle).sum::<f64>() / (c.len() - 1) as f64
    };
    let is_corner =
        |(v, l): &(&u32, &Vec<u32>)| l.len() != 2 || given.contains(v) || kind(**v, l[0]) != kind(**v, l[1]);
    let mut corners: BTreeSet<u32> = graph.neighbours.iter().filter(is_corner).map(|(&v, _)| v).collect();
    let mut curves = Vec::new();
    let mut done = BTreeSet::new();
    let ends: Vec<u32> = corners.iter().copied().chain(graph.neighbours.keys().copied()).collect();
    for v in ends {
        token.check()?;
        for &next in &graph.neighbours[&v] {
            if done.contains(&undirected([v, next])) {
                continue;
            }
            let chain = graph.chain_to(v, next, &corners);
            done.extend(chain.windows(2).map(|p| undirected([p[0], p[1]])));
            let closed = chain[0] == chain[chain.len() - 1] && !corners.contains(&v);
            split(&chain, closed, (graph, metric, merge.reach), (&mut corners, &mut curves), token)?;
        }
    }
    for (k, curve) in curves.iter_mut().enumerate() {
        token.check_at(k)?;
        let chain: Vec<u32> = curve.round().collect();
        curve.angle_deg = mean_angle(&chain);
        let few = chain.len().min(END_EDGES + 1);
        curve.ends_deg = [mean_angle(&chain[..few]), mean_angle(&chain[chain.len() - few..])];
    }
    token.check()?;
    let joined = merge_corners(&mut curves, (&mut corners, given), metric, merge, token)?;
    token.check()?;
    curves.sort_by(|a: &Curve, b| a.vertices.cmp(&b.vertices));
    Ok((curves, corners.into_iter().collect(), joined))
}

fn split(
    chain: &[u32],
    closed: bool,
    (graph, metric, reach): (&Graph, Metric<'_>, f64),
    (corners, curves): (&mut BTreeSet<u32>, &mut Vec<Curve>),
    token: &Token,
) -> Result<(), Stopped> {
    let turns = sharp_turns(chain, closed, (graph, metric, reach), token)?;
    let last = chain.len() - 1;
    let kind = graph.edges[&undirected([chain[0], chain[1]])].kind;
    let curve = |vertices, closed| Curve { kind, vertices, closed, angle_deg: 0.0, ends_deg: [0.0; 2], is_rim: false };
    if closed && turns.is_empty() {
        curves.push(curve(chain[..last].to_vec(), true));
        return Ok(());
    }
    corners.extend(turns.iter().map(|&k| chain[k]));
    // A closed chain is cut at its turns alone, the last piece goes on to the first of them.
    let cuts: Vec<usize> = match turns.first() {
        Some(&first) if closed => turns.iter().copied().chain([first + last]).collect(),
        _ => [0].into_iter().chain(turns).chain([last]).collect(),
    };
    let vertex = |k: usize| chain[if k > last { k - last } else { k }];
    curves.extend(cuts.windows(2).map(|cut| curve((cut[0]..=cut[1]).map(vertex).collect(), false)));
    Ok(())
}

/// A chain by arc length. A closed one has its first place again at the end.
struct Arc {
    places: Vec<DVec3>,
    /// Arc length at each place, ascending.
    along: Vec<f64>,
    closed: bool,
}

impl Arc {
    fn new(chain: &[u32], closed: bool, metric: Metric<'_>) -> Self {
        let places = chain.iter().map(|&v| metric.at(v)).collect();
        let mut along = vec![0.0];
        chain.windows(2).for_each(|w| along.push(along[along.len() - 1] + metric.edge(w[0], w[1])));
        Self { places, along, closed }
    }

    fn last(&self) -> usize {
        self.places.len() - 1
    }

    fn total(&self) -> f64 {
        self.along[self.last()]
    }

    /// The point at arc length `s`.
    fn at(&self, s: f64) -> DVec3 {
        let (p, along) = (&self.places, &self.along);
        let s = if self.closed { s.rem_euclid(self.total()) } else { s.clamp(0.0, self.total()) };
        let k = along.partition_point(|&a| a <= s).clamp(1, self.last());
        let width = along[k] - along[k - 1];
        if width > 0.0 { p[k - 1].lerp(p[k], (s - along[k - 1]) / width) } else { p[k] }
    }

    /// Cosine of the turn at place `k`, from `reach` before to `reach` after.
    fn cosine(&self, k: usize, reach: f64) -> f64 {
        let (p, s) = (self.places[k], self.along[k]);
        let (back, ahead) = (p - self.at(s - reach), self.at(s + reach) - p);
        back.normalize_or_zero().dot(ahead.normalize_or_zero())
    }

    /// The place after `k`, and the arc length to it; the place before it without `forward`.
    fn next(&self, k: usize, forward: bool) -> Option<(usize, f64)> {
        let last = self.last();
        // Both ends of a closed chain are one place.
        let k = match k {
            0 if self.closed && !forward => last,
            k if self.closed && forward && k == last => 0,
            k => k,
        };
        let next = if forward { (k < last).then_some(k + 1) } else { k.checked_sub(1) }?;
        Some((next, (self.along[next] - self.along[k]).abs()))
    }

    /// Whether the chain is a straight line from place `k` on, or back without `forward`, over the length `line`.
    fn is_straight(&self, k: usize, forward: bool, line: f64) -> bool {
        let (from, s) = (self.places[k], self.along[k]);
        let along = |length: f64| if forward { s + length } else { s - length };
        let end = along(line);
        if if self.closed { line >= self.total() } else { !(0.0..=self.total()).contains(&end) } {
            return false;
        }
        let chord = self.at(end) - from;
        let is_near = |p: DVec3| (p - from).cross(chord).length() <= STRAIGHT * chord.length_squared();
        // The middle first: a walk from each place of a smooth curve would take the square of their number.
        if !is_near(self.at(along(0.5 * line))) {
            return false;
        }
        let (mut here, mut length) = (k, 0.0);
        while let Some((next, step)) = self.next(here, forward) {
            length += step;
            if length >= line {
                break;
            }
            if !is_near(self.places[next]) {
                return false;
            }
            here = next;
        }
        true
    }
}

/// Places where a chain turns by more than [`CORNER_ANGLE`] from `reach` before to `reach` after, or by more than [`BEND_ANGLE`]
/// between straight lines of a plane's boundary; the sharpest of each `reach`.
fn sharp_turns(
    chain: &[u32],
    closed: bool,
    (graph, metric, reach): (&Graph, Metric<'_>, f64),
    token: &Token,
) -> Result<Vec<usize>, Stopped> {
    let arc = Arc::new(chain, closed, metric);
    let (last, total) = (arc.last(), arc.total());
    let [limit, least_bend] = [CORNER_ANGLE, BEND_ANGLE].map(|angle: f64| angle.to_radians().cos());
    let inner = if closed { 0..last } else { 1..last };
    let line = LINE * reach;
    let reach = reach.min(total / 3.0);
    let is_line = |k: usize, forward: bool| {
        let of_plane = |(next, _)| {
            let edge = graph.edges[&undirected([chain[k], chain[next]])];
            edge.kind == CurveKind::Boundary && edge.beside_planes
        };
        arc.next(k, forward).is_some_and(of_plane) && arc.is_straight(k, forward, line)
    };
    let turn = |k: usize| (arc.cosine(k, reach), k);
    let is_corner =
        |&(cosine, k): &(f64, usize)| cosine < limit || cosine < least_bend && is_line(k, true) && is_line(k, false);
    let mut found: Vec<(f64, usize)> = inner.map(turn).filter(is_corner).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let apart = |j: usize, k: usize| {
        let d = (arc.along[k] - arc.along[j]).abs();
        if closed { d.min(total - d) } else { d }
    };
    // Arc length ascends with the place: only the next taken ones count, and round a closed chain's end the outermost.
    let mut taken = BTreeSet::new();
    for (n, (_, k)) in found.into_iter().enumerate() {
        token.check_at(n)?;
        let beside = [taken.range(..=k).next_back(), taken.range(k..).next(), taken.first(), taken.last()];
        if beside.into_iter().flatten().all(|&j| apart(j, k) > reach) {
            taken.insert(k);
        }
    }
    Ok(taken.into_iter().collect())
}

/// Which corners are merged. Lengths are multiplied by [`super::FeatureOptions::resolution`].
#[derive(Clone, Copy)]
pub(super) struct CornerMerge {
    /// Corners whose curve is shorter than this may be merged.
    pub(super) length: f64,
    /// Length of the chords that decide whether corners are merged.
    pub(super) reach: f64,
    /// Largest deviation of such a chord from a boundary; [`CREASE_FACTOR`] times as much from a crease.
    pub(super) off: f64,
}

/// Factor for creases: a crease may end slightly beside its old end, while a boundary is the only trace of a hole.
const CREASE_FACTOR: f64 = 2.0;
/// Least length of a loop, in chords.
const MIN_LOOP: f64 = 3.0;

struct Merger<'a> {
    curves: &'a mut [Curve],
    /// Corners that stay.
    given: &'a BTreeSet<u32>,
    /// Empty for one that has become part of others.
    at: BTreeMap<u32, Vec<usize>>,
    metric: Metric<'a>,
    merge: CornerMerge,
}

/// Merges corners that are close along a boundary, the shortest distance first. Returns how many were removed.
fn merge_corners(
    curves: &mut Vec<Curve>,
    (corners, given): (&mut BTreeSet<u32>, &BTreeSet<u32>),
    metric: Metric<'_>,
    merge: CornerMerge,
    token: &Token,
) -> Result<usize, Stopped> {
    let open = (0..curves.len()).filter(|&c| !curves[c].closed && curves[c].kind == CurveKind::Boundary);
    let lengths = open.map(|c| (metric.chain(&curves[c].vertices), c));
    let mut short: Vec<(f64, usize)> = lengths.filter(|(length, _)| *length < merge.length).collect();
    if short.is_empty() {
        return Ok(0);
    }
    short.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut at: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (c, curve) in curves.iter().enumerate().filter(|(_, curve)| !curve.closed) {
        curve.ends().into_iter().for_each(|v| at.entry(v).or_default().push(c));
    }
    token.check()?;
    let mut merger = Merger { curves, given, at, metric, merge };
    let mut removed: Vec<u32> = Vec::new();
    for (_, c) in short {
        token.check()?;
        removed.extend(merger.merge(c));
    }
    removed.iter().for_each(|corner| _ = corners.remove(corner));
    curves.retain(|curve| !curve.vertices.is_empty());
    Ok(removed.len())
}

impl Merger<'_> {
    /// Makes one corner of the two ends of a curve, if that can be. Returns the one that is none any more.
    fn merge(&mut self, c: usize) -> Option<u32> {
        let curve = &self.curves[c];
        let [a, b] = curve.ends();
        // It may have become longer since.
        if a == b || self.is_as_long_as(&curve.vertices, self.merge.length) {
            return None;
        }
        let (removed, stays) = match (self.off(c, a, b), self.off(c, b, a)) {
            (Some(first), Some(second)) if second < first => (b, a),
            (Some(_), _) => (a, b),
            (None, Some(_)) => (b, a),
            (None, None) => return None,
        };
        let mut way = std::mem::take(&mut self.curves[c].vertices);
        if way[0] != removed {
            way.reverse();
        }
        for other in self.at.remove(&removed).unwrap_or_default() {
            if other == c {
                continue;
            }
            let vertices = &mut self.curves[other].vertices;
            if vertices[0] == removed {
                vertices.splice(0..1, way.iter().rev().copied());
            } else {
                vertices.extend(&way[1..]);
            }
            self.at.entry(stays).or_default().push(other);
        }
        self.at.entry(stays).or_default().retain(|&other| other != c);
        Some(removed)
    }

    /// How far chords from `stays` leave the curves to `removed` that continue along `c`; `None` if too far, or forbidden.
    fn off(&self, c: usize, removed: u32, stays: u32) -> Option<f64> {
        let others: Vec<&Curve> = self.at[&removed].iter().filter(|&&o| o != c).map(|&o| &self.curves[o]).collect();
        // A boundary does not divide.
        let goes_on = others.iter().filter(|o| o.kind == CurveKind::Boundary).count() == 1;
        let goes_on = goes_on && !self.given.contains(&removed);
        // A curve that returns to its start needs room for a loop.
        let loops =
            |o: &Curve| o.ends().contains(&stays) && self.is_as_long_as(&o.vertices, MIN_LOOP * self.merge.reach);
        let returns = |o: &&Curve| o.ends() == [removed; 2] || o.ends().contains(&stays) && !loops(o);
        if !goes_on || others.iter().any(returns) {
            return None;
        }
        let from = self.metric.at(stays);
        let resolution = self.metric.resolution(removed);
        let passed = |to: DVec3| {
            let way = self.curves[c].vertices.iter().map(|&v| self.metric.at(v));
            way.map(|p| distance_to_segment(p, [from, to])).fold(0.0, f64::max) * resolution
        };
        let mut farthest = 0.0f64;
        for other in others {
            let off = passed(self.ahead(other, removed));
            let most = if other.kind == CurveKind::Crease { CREASE_FACTOR * self.merge.off } else { self.merge.off };
            if off > most {
                return None;
            }
            farthest = farthest.max(off);
        }
        Some(farthest)
    }

    /// The place on a curve where a chord from its end `v` ends.
    fn ahead(&self, curve: &Curve, v: u32) -> DVec3 {
        let chain = &curve.vertices;
        let last = chain.len() - 1;
        let forward = chain[0] == v;
        // The k-th from that end: no copy, since a curve may be long and have many others beside it.
        let vertex = |k: usize| if forward { chain[k] } else { chain[last - k] };
        let mut left = self.merge.reach;
        for k in 0..last {
            let (from, to) = (vertex(k), vertex(k + 1));
            let length = self.metric.edge(from, to);
            if length >= left && length > 0.0 {
                return self.metric.at(from).lerp(self.metric.at(to), left / length);
            }
            left -= length;
        }
        self.metric.at(vertex(last))
    }

    /// Whether a chain has at least the length `least`; stops as soon as it does.
    fn is_as_long_as(&self, chain: &[u32], least: f64) -> bool {
        let mut length = 0.0;
        let mut parts = chain.windows(2).map(|p| self.metric.edge(p[0], p[1]));
        least <= 0.0
            || parts.any(|part| {
                length += part;
                length >= least
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(kind: CurveKind, vertices: &[u32]) -> Curve {
        Curve {
            kind,
            vertices: vertices.to_vec(),
            closed: false,
            angle_deg: 180.0,
            ends_deg: [180.0; 2],
            is_rim: false,
        }
    }

    fn merged(positions: &[DVec3], mut curves: Vec<Curve>) -> (Vec<Curve>, Vec<u32>) {
        let mut corners: BTreeSet<u32> = curves.iter().flat_map(Curve::ends).collect();
        let metric = Metric { positions, resolution: &[] };
        let before = corners.len();
        let merged = merge_corners(
            &mut curves,
            (&mut corners, &BTreeSet::new()),
            metric,
            CornerMerge { length: 0.4, reach: 1.0, off: 0.1 },
            &Token::default(),
        )
        .unwrap();
        assert_eq!(corners.len() + merged, before);
        (curves, corners.into_iter().collect())
    }

    use CurveKind::{Boundary, Crease};

    /// A straight boundary from 0 to 3, that two creases meet in 1 and 2.
    fn two_creases(apart: f64) -> (Vec<DVec3>, Vec<Curve>) {
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let positions = vec![at(-2.0, 0.0), at(0.0, 0.0), at(apart, 0.0), at(2.0, 0.0), at(-1.0, 2.0), at(1.0, 2.0)];
        let rim = [[0, 1], [1, 2], [2, 3]].map(|ends| curve(Boundary, &ends));
        (positions, [&rim[..], &[curve(Crease, &[1, 4]), curve(Crease, &[5, 2])]].concat())
    }

    #[test]
    fn creases_that_meet_a_boundary_side_by_side_meet_it_in_one_corner() {
        let (positions, curves) = two_creases(0.1);
        let (curves, corners) = merged(&positions, curves);
        assert_eq!(corners, [0, 2, 3, 4, 5]);
        let ways: Vec<&[u32]> = curves.iter().map(|c| &c.vertices[..]).collect();
        assert_eq!(ways, [&[0, 1, 2][..], &[2, 3], &[2, 1, 4], &[5, 2]]);
        let (positions, curves) = two_creases(0.5);
        assert_eq!(merged(&positions, curves.clone()), (curves, vec![0, 1, 2, 3, 4, 5]));
    }

    #[test]
    fn corners_that_would_be_cut_off_stay() {
        // A step of a boundary: a chord would leave it by about 0.27.
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let positions = [at(-2.0, 0.0), at(0.0, 0.0), at(0.0, 0.3), at(2.0, 0.3)];
        let curves = [[0, 1], [1, 2], [2, 3]].map(|ends| curve(Boundary, &ends)).to_vec();
        assert_eq!(merged(&positions, curves.clone()).0, curves);
        // A low corner is removed.
        let positions = [at(-2.0, 0.0), at(0.0, 0.0), at(0.0, 0.05), at(2.0, 0.05)];
        let (curves, corners) = merged(&positions, curves);
        assert_eq!((curves.len(), corners.len()), (2, 3));
    }

    #[test]
    fn only_corners_along_a_boundary_that_does_not_divide_are_joined() {
        // Two creases that meet others side by side, and two boundaries that meet in two corners.
        let (positions, mut curves) = two_creases(0.1);
        curves.iter_mut().for_each(|curve| curve.kind = Crease);
        assert_eq!(merged(&positions, curves.clone()), (curves.clone(), vec![0, 1, 2, 3, 4, 5]));
        curves.iter_mut().for_each(|curve| curve.kind = Boundary);
        assert_eq!(merged(&positions, curves.clone()), (curves, vec![0, 1, 2, 3, 4, 5]));
    }

    #[test]
    fn what_closes_on_itself_is_large_enough() {
        // A loop between two corners that are near, too small for one corner, and one that is not.
        let at = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let positions = |size: f64| [at(0.0, 0.0), at(0.1, 0.0), at(0.0, size)];
        let curves = vec![curve(Boundary, &[0, 1]), curve(Boundary, &[1, 2, 0])];
        assert_eq!(merged(&positions(1.4), curves.clone()), (curves.clone(), vec![0, 1]));
        // A small loop where three boundaries meet, as they do where facets are oriented unlike each other.
        let odd = vec![curve(Boundary, &[0, 1, 0]), curve(Boundary, &[0, 2])];
        assert_eq!(merged(&positions(1.6), odd.clone()), (odd, vec![0, 2]));
        assert_eq!(merged(&positions(1.6), curves), (vec![curve(Boundary, &[1, 2, 0, 1])], vec![1]));
    }
}
