//! How far a result and the input are apart.
//!
//! Purpose: both ways and about: vertices of the input from the facets around their own result vertex, vertices and
//! middles of facets from the samples around them.
//! Invariant: the same whatever the number of threads. Must not know: what is done about it.

use glam::DVec3;
use rayon::prelude::*;

use super::super::tips::Offsets;
use super::{Sample, Target};
use crate::mesh::csr::Csr;
use crate::token::Token;

/// What is farther from the facets than the second share of an edge was missed, if something is farther than the
/// first.
const MISSED: [f64; 2] = [0.25, 0.17];
/// Vertices or facets that are not worth a task of their own.
const SHARE: usize = 256;

/// How far a result is from the input.
pub(in crate::remesh) struct Far {
    /// Places of the input that were missed; see [`missed`].
    pub(in crate::remesh) missed: Vec<(u32, DVec3)>,
    /// How far the two are apart anywhere.
    pub(in crate::remesh) deviation: f64,
    /// And around each vertex.
    pub(in crate::remesh) by_vertex: Vec<f64>,
}

impl Far {
    /// Looks at all of it; places are missed by `tolerance`.
    pub(in crate::remesh) fn of(
        positions: &[DVec3],
        facets: &[[u32; 3]],
        target: &Target,
        tolerance: Option<f64>,
        token: &Token,
    ) -> Self {
        let around = Csr::one_rings(positions.len(), facets);
        let offsets = Offsets::new(positions, facets, &around, &target.tips, token);
        let missed = places(positions, facets, &around, &offsets, tolerance);
        let strayed = strayed(positions, facets, target, token);
        let deviation = strayed.iter().copied().fold(offsets.deviation(), f64::max);
        let mut by_vertex = offsets.by_vertex(positions.len());
        let widen = |(v, far): (usize, &mut f64)| {
            *far = around.of(v as u32).iter().map(|&f| strayed[f as usize]).fold(*far, f64::max);
        };
        by_vertex.par_iter_mut().enumerate().with_min_len(SHARE).for_each(widen);
        Self { missed, deviation, by_vertex }
    }
}

/// Places of the input that are farther from the result than `tolerance`, or than a share of an edge where that is
/// `None`: (vertex nearest to the place, the place), the farthest first, none beside another.
pub(in crate::remesh) fn missed(
    positions: &[DVec3],
    facets: &[[u32; 3]],
    target: &Target,
    tolerance: Option<f64>,
    token: &Token,
) -> Vec<(u32, DVec3)> {
    let around = Csr::one_rings(positions.len(), facets);
    let offsets = Offsets::new(positions, facets, &around, &target.tips, token);
    places(positions, facets, &around, &offsets, tolerance)
}

fn places(
    positions: &[DVec3],
    facets: &[[u32; 3]],
    around: &Csr<u32>,
    offsets: &Offsets<'_>,
    tolerance: Option<f64>,
) -> Vec<(u32, DVec3)> {
    let mut missed = offsets.far(|o| tolerance.map_or(o.share > MISSED[1], |t| o.distance > t));
    if tolerance.is_none() && missed.first().is_some_and(|(_, o)| o.share <= MISSED[0]) {
        missed.clear();
    }
    let mut taken = vec![false; positions.len()];
    let mut found = Vec::new();
    for (k, o) in missed {
        if !taken[o.corner as usize] {
            around.of(o.corner).iter().flat_map(|&f| facets[f as usize]).for_each(|u| taken[u as usize] = true);
            found.push((o.corner, offsets.place(k)));
        }
    }
    found
}

/// How far a vertex or the middle of each facet is from the input at most: from the plane of the nearest sample around
/// it, or from the sample where that is not below it.
fn strayed(positions: &[DVec3], facets: &[[u32; 3]], target: &Target, token: &Token) -> Vec<f64> {
    let own = |v: u32| match token.check_at(64 * v as usize) {
        Err(_) => 0.0,
        Ok(()) => distance(positions[v as usize], [target.samples.of(v)]),
    };
    let own: Vec<f64> = (0..positions.len() as u32).into_par_iter().with_min_len(SHARE).map(own).collect();
    let of = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        let middle = distance((a + b + c) / 3.0, t.map(|v| target.samples.of(v)));
        t.iter().map(|&v| own[v as usize]).fold(middle, f64::max)
    };
    facets.par_iter().with_min_len(SHARE).map(of).collect()
}

/// Of `p` from the nearest of some samples; 0 if there are none.
fn distance<const N: usize>(p: DVec3, samples: [&[Sample]; N]) -> f64 {
    let (mut least, mut nearest) = (f64::INFINITY, None);
    for s in samples.into_iter().flatten() {
        let squared = s.position.distance_squared(p);
        if squared < least {
            (least, nearest) = (squared, Some(s));
        }
    }
    nearest.map_or(0.0, |s| {
        let (height, reach) = (s.normal.dot(p - s.position).abs(), s.area.sqrt());
        let aside = (least - height * height).max(0.0).sqrt();
        height.max(aside - 2.0 * reach)
    })
}
