//! Curves of a surface that was divided along them, since there is no room between them.
//!
//! Purpose: [`Of::fitted`] finds the edge length with which the curves, and the patches between them, have as many vertices as was asked
//! for. No curve is dropped. Patches that are narrower than an edge get no vertices within.
//! Invariant: depends on the surface, the curves and the number alone. Must not know: how patches get their facets.

use std::collections::HashMap;
use std::sync::Arc;

use glam::DVec3;

use super::seams::{Joint, Seams};
use crate::cvt::curves::CurveSeeds;
use crate::mesh::TriMesh;
use crate::mesh::edges::undirected;
use crate::mesh::features::Features;
use crate::remesh::constants::{
    CROWDED_AWAY, CROWDED_ENOUGH, CROWDED_FULL, CROWDED_SAME, CROWDED_STEPS, MOST_CROWDED, NARROW_PATCH,
};
use crate::rvd::Surface;
use crate::token::{Stopped, Token};

/// Curves, and what decides about their seeds.
pub(super) struct Of<'a> {
    pub(super) surface: &'a Surface,
    pub(super) mesh: &'a TriMesh,
    pub(super) features: &'a Features,
    pub(super) seams: Option<&'a Arc<Seams>>,
    /// By how much each curve was moved when sheets were, unit frame, if seeds are to be beside those of other curves.
    pub(super) moved: Option<&'a [DVec3]>,
    /// Vertices that were asked for.
    pub(super) points: usize,
    /// Seeds of curves, copies included, at most.
    pub(super) most: usize,
    pub(super) token: &'a Token,
}

impl Of<'_> {
    /// Seeds with which a result has as many vertices as was asked for, or fewer; `None` where even the longest edges need more. `edge` is the length without curves.
    pub(super) fn fitted(&self, edge: f64) -> Result<Option<Crowded>, Stopped> {
        let range = [edge / MOST_CROWDED, edge * MOST_CROWDED];
        let found = self.search(range, [None; 2], None)?;
        // Patches may all become wide at one length: then curves alone get more seeds.
        let alone = match &found {
            Some((length, found)) if found.expected < CROWDED_ENOUGH * self.points as f64 => {
                self.search([range[0], *length], [None, Some(found.expected)], Some(*length))?
            }
            _ => None,
        };
        Ok(alone.or(found).map(|found| found.1))
    }

    /// The shortest length with which vertices are not too many, nearly. `counts` are those of vertices at both ends, where they are
    /// known. With `of_patches`, patches are wide or narrow by that length.
    fn search(
        &self,
        [mut low, mut high]: [f64; 2],
        mut counts: [Option<f64>; 2],
        of_patches: Option<f64>,
    ) -> Result<Option<(f64, Crowded)>, Stopped> {
        let points = self.points as f64;
        let mut best: Option<(f64, Crowded)> = None;
        for step in 0..CROWDED_STEPS {
            let target = 0.5 * (CROWDED_FULL + 1.0) * points;
            let length = low * (high / low).powf(share_of(counts, (high / low).ln(), target, step));
            match self.place(length, of_patches.unwrap_or(length))? {
                Some(found) if found.expected <= points => {
                    (high, counts[1]) = (length, Some(found.expected));
                    if best.as_ref().is_none_or(|(_, best)| found.expected >= best.expected) {
                        best = Some((length, found));
                    }
                }
                found => (low, counts[0]) = (length, found.map(|found| found.expected)),
            }
            let is_enough = best.as_ref().is_some_and(|(_, best)| best.expected >= CROWDED_FULL * points);
            if is_enough || high < CROWDED_SAME * low {
                break;
            }
        }
        Ok(best)
    }

    /// Seeds with edges of this length; patches are wide or narrow by another one. `None` if they are too many.
    fn place(&self, edge: f64, of_patches: f64) -> Result<Option<Crowded>, Stopped> {
        let &Self { surface, mesh, features, seams, moved, most, token, .. } = self;
        let placed = match moved {
            Some(moved) => CurveSeeds::place_beside(surface, features, edge, (most, moved), token)?,
            None => CurveSeeds::place(surface, (features, &[]), edge, most, token)?,
        };
        let Some(mut seeds) = placed else { return Ok(None) };
        seeds.split_by_deviation(f64::INFINITY, token)?;
        let patches = Patches::of(features, (mesh, surface), of_patches);
        seeds.split_between_others((|curve| patches.beside_wide[curve as usize], |_| false), token)?;
        let share = |seams: &Arc<Seams>| seams.share(&mut seeds, features, surface.positions());
        let (joints, copies) = seams.map(share).unwrap_or_default();
        let expected = seeds.len().saturating_sub(copies) as f64 + patches.points_within(&seeds, of_patches);
        Ok(Some(Crowded { seeds, joints, copies, narrow: patches.narrow, expected }))
    }
}

/// Where the next length to try is between two, as a share of the logarithm of their ratio. Vertices are about as a power of the length,
/// between that of curves (-1) and that of surfaces (-2). Their number leaps where a patch becomes wide: every third step halves.
fn share_of([at_low, at_high]: [Option<f64>; 2], range: f64, target: f64, step: usize) -> f64 {
    let share = match (at_low, at_high) {
        _ if step % 3 == 2 => 0.5,
        (Some(many), Some(few)) => (many / target).ln() / (many / few).ln(),
        (Some(many), None) => (many / target).ln() / range,
        (None, Some(few)) => 1.0 - (target / few).ln() / range,
        (None, None) => 0.5,
    };
    if share.is_finite() { share.clamp(CROWDED_AWAY, 1.0 - CROWDED_AWAY) } else { 0.5 }
}

/// Curves of a surface that was divided along them, with edges of some length.
pub(super) struct Crowded {
    pub(super) seeds: CurveSeeds,
    pub(super) joints: Vec<Option<Joint>>,
    pub(super) copies: usize,
    pub(super) narrow: Vec<bool>,
    /// How many vertices a result has.
    expected: f64,
}

/// The patches between curves.
struct Patches {
    /// For each facet, whether its patch is too narrow for seeds within.
    narrow: Vec<bool>,
    /// The area of the others, by the weights.
    wide_mass: f64,
    /// For each curve, whether a patch that is not narrow has it.
    beside_wide: Vec<bool>,
    wide_count: usize,
}

impl Patches {
    /// `edge` is the target length where the weight is 1.
    fn of(features: &Features, (mesh, surface): (&TriMesh, &Surface), edge: f64) -> Self {
        let patch = features.regions(mesh);
        let weight = |v: u32| surface.weights()[v as usize];
        let mut rim: HashMap<[u32; 2], (f64, usize)> = HashMap::new();
        for (number, curve) in features.curves.iter().enumerate() {
            for pair in curve.round().collect::<Vec<u32>>().windows(2) {
                let [p, q] = [pair[0], pair[1]].map(|v| surface.positions()[v as usize]);
                let scale = (0.5 * (weight(pair[0]) + weight(pair[1]))).powf(0.25);
                rim.insert(undirected([pair[0], pair[1]]), (scale * p.distance(q), number));
            }
        }
        // For each patch its mass and the length of its curves, both in edges where the weight is 1.
        let mut of: HashMap<u32, (f64, f64, Vec<usize>)> = HashMap::new();
        for (f, t) in surface.welded().iter().enumerate() {
            let (mass, length, curves) = of.entry(patch[f]).or_default();
            *mass += surface.facet_area(f as u32) * (t.iter().map(|&v| weight(v)).sum::<f64>() / 3.0).sqrt();
            for side in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
                if let Some((own, curve)) = rim.get(&undirected(side)) {
                    *length += own;
                    curves.push(*curve);
                }
            }
        }
        // The mean width of a strip is twice its area over the length of its rim.
        let is_narrow = |(mass, length, _): &(f64, f64, Vec<usize>)| 2.0 * mass < NARROW_PATCH * edge * length;
        let narrow = patch.iter().map(|patch| of.get(patch).is_some_and(is_narrow)).collect();
        let mut beside_wide = vec![false; features.curves.len()];
        let (mut wide_mass, mut wide_count) = (0.0, 0);
        let mut order: Vec<&u32> = of.keys().collect();
        order.sort_unstable();
        for (mass, _, curves) in order.into_iter().map(|patch| &of[patch]).filter(|of| !is_narrow(of)) {
            wide_mass += mass;
            wide_count += 1;
            curves.iter().for_each(|&curve| beside_wide[curve] = true);
        }
        Self { narrow, wide_mass, beside_wide, wide_count }
    }

    /// How many vertices the wide patches have within, with edges of this length: of n vertices, b of them on the rim, there are
    /// 2n - b - 2 facets of area √3/4 h².
    fn points_within(&self, seeds: &CurveSeeds, edge: f64) -> f64 {
        let rim = seeds.segments.iter().filter(|segment| self.beside_wide[segment.curve as usize]).count();
        let facets = 4.0 / 3f64.sqrt() * self.wide_mass / (edge * edge);
        (0.5 * (facets - rim as f64) + self.wide_count as f64).max(0.0)
    }
}
