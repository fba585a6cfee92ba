//! Curves between corners, made of the graph of feature edges.
//!
//! Purpose: [`curves`] follows chains of edges through vertices of degree two, and cuts them where they turn sharply.
//! Invariant: every edge of the graph is part of one curve. Must not know: why an edge is a feature.

use std::collections::BTreeSet;

use glam::DVec3;

use super::close_corners::{self, CornerMerge};
use super::graph::Graph;
use super::{Curve, CurveKind, Metric};
use crate::mesh::edges::undirected;
use crate::token::{Stopped, Token};

/// Number of edges at the end of a curve that [`Curve::ends_deg`] averages.
const END_EDGES: usize = 3;
/// A curve has a corner where it turns by more than this, degrees.
const CORNER_ANGLE: f64 = 60.0;

/// The curves between corners, the corners, and how many of them have become part of others.
pub(super) fn curves(
    graph: &Graph,
    metric: Metric<'_>,
    merge: CornerMerge,
    token: &Token,
) -> Result<(Vec<Curve>, Vec<u32>, usize), Stopped> {
    let kind = |a: u32, b: u32| graph.edges[&undirected([a, b])].kind;
    let mean_angle = |c: &[u32]| {
        c.windows(2).map(|p| graph.edges[&undirected([p[0], p[1]])].angle).sum::<f64>() / (c.len() - 1) as f64
    };
    let mut corners: BTreeSet<u32> = graph
        .neighbours
        .iter()
        .filter(|(v, l)| l.len() != 2 || kind(**v, l[0]) != kind(**v, l[1]))
        .map(|(&v, _)| v)
        .collect();
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
            split(&chain, closed, kind(v, next), (metric, merge.reach), (&mut corners, &mut curves), token)?;
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
    let joined = close_corners::merge(&mut curves, &mut corners, metric, merge, token)?;
    token.check()?;
    curves.sort_by(|a: &Curve, b| a.vertices.cmp(&b.vertices));
    Ok((curves, corners.into_iter().collect(), joined))
}

/// Cuts a chain where it turns sharply.
fn split(
    chain: &[u32],
    closed: bool,
    kind: CurveKind,
    (metric, reach): (Metric<'_>, f64),
    (corners, curves): (&mut BTreeSet<u32>, &mut Vec<Curve>),
    token: &Token,
) -> Result<(), Stopped> {
    let turns = sharp_turns(chain, closed, (metric, reach), token)?;
    let last = chain.len() - 1;
    let curve = |vertices, closed| Curve { kind, vertices, closed, angle_deg: 0.0, ends_deg: [0.0; 2] };
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

/// Places in a chain where it turns by more than [`CORNER_ANGLE`] between the points `reach` behind and
/// ahead: the sharpest within each stretch of that length.
fn sharp_turns(
    chain: &[u32],
    closed: bool,
    (metric, reach): (Metric<'_>, f64),
    token: &Token,
) -> Result<Vec<usize>, Stopped> {
    let p: Vec<DVec3> = chain.iter().map(|&v| metric.at(v)).collect();
    let last = p.len() - 1;
    let mut along = vec![0.0];
    chain.windows(2).for_each(|w| along.push(along[along.len() - 1] + metric.edge(w[0], w[1])));
    let total = along[last];
    // The point at arc length s.
    let at = |s: f64| {
        let s = if closed { s.rem_euclid(total) } else { s.clamp(0.0, total) };
        let k = along.partition_point(|&a| a <= s).clamp(1, last);
        let width = along[k] - along[k - 1];
        if width > 0.0 { p[k - 1].lerp(p[k], (s - along[k - 1]) / width) } else { p[k] }
    };
    let limit = CORNER_ANGLE.to_radians().cos();
    let inner = if closed { 0..last } else { 1..last };
    let reach = reach.min(total / 3.0);
    let cosine = |k: usize| {
        let (back, ahead) = (p[k] - at(along[k] - reach), at(along[k] + reach) - p[k]);
        back.normalize_or_zero().dot(ahead.normalize_or_zero())
    };
    let mut found: Vec<(f64, usize)> = inner.map(|k| (cosine(k), k)).filter(|&(c, _)| c < limit).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let apart = |j: usize, k: usize| {
        let d = (along[k] - along[j]).abs();
        if closed { d.min(total - d) } else { d }
    };
    // Arc length ascends with the place, so that of those taken only the next ones count, and round the end of a closed
    // chain the first and the last.
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
