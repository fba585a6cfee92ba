//! Seeds of curves beside those of others.
//!
//! Purpose: [`Placed::beside`] moves the seeds of a bent curve along it until they are beside those of a curve next to it. Chords of two
//! curves that are nearer to each other than the chords are to the curves do not cross then: rims of a thin wall, turns of a thread.
//! Invariant: depends on the curves, their order and their places alone; straight stretches stay as they are. Must not know: why curves
//! are near each other, surfaces.

use std::collections::HashMap;

use glam::DVec3;

use super::path::Path;

/// A curve is near another whose distance is less than its chords' from it over this, so that curves cross only far beyond.
const ROOM: f64 = 0.3;
/// Curves at a larger distance are not near, share of the spacing.
const REACH: f64 = 0.5;
/// Least and largest distance of a seed that is moved from the one before, share of the spacing.
const SPACING: [f64; 2] = [0.55, 1.45];
/// Parts of the spacing in which a place beside a seed is sought.
const PARTS: f64 = 8.0;
/// Steps of Newton's iteration for the place on a curve that is nearest to a seed.
const STEPS: usize = 3;

/// A seed where its curve was before parts of the surface were moved, with the curve and the arc length there.
#[derive(Clone, Copy)]
struct Seed {
    place: DVec3,
    curve: u32,
    along: f64,
}

/// The seeds of the curves so far.
pub(super) struct Placed {
    /// Side of the cells of a grid.
    cell: f64,
    grid: HashMap<[i64; 3], Vec<Seed>>,
}

impl Placed {
    /// `edge` is the usual spacing.
    pub(super) fn new(edge: f64) -> Self {
        Self { cell: edge, grid: HashMap::new() }
    }

    fn key(&self, p: DVec3) -> [i64; 3] {
        p.to_array().map(|x| (x / self.cell).floor() as i64)
    }

    fn insert(&mut self, seed: Seed) {
        self.grid.entry(self.key(seed.place)).or_default().push(seed);
    }

    /// Arc lengths for the seeds of a curve in place of `places`, beside those of earlier curves and of its own earlier turns where they are
    /// near. The curve was moved by `moved`, and has at least `least` edges.
    pub(super) fn beside(
        &mut self,
        places: Vec<f64>,
        path: &Path,
        (curve, moved, least): (u32, DVec3, usize),
    ) -> Vec<f64> {
        let mut own = Vec::new();
        let found = self.march(&places, path, (curve, moved), &mut own);
        let edges = own.len() + usize::from(!path.is_closed());
        if found && edges >= least {
            return own;
        }
        for &along in &own {
            let key = self.key(path.at(along) - moved);
            self.grid.entry(key).or_default().retain(|seed| seed.curve != curve);
        }
        places.iter().for_each(|&along| self.insert(Seed { place: path.at(along) - moved, curve, along }));
        places
    }

    /// Goes along the curve from seed to seed: to a place beside another seed, else to one of `places`. Whether one was beside another.
    fn march(&mut self, places: &[f64], path: &Path, (curve, moved): (u32, DVec3), own: &mut Vec<f64>) -> bool {
        let length = path.length();
        let mut stops = places.to_vec();
        match path.is_closed() {
            true => stops.extend(places.first().map(|first| first + length)),
            false => {
                stops.insert(0, 0.0);
                stops.push(length);
            }
        }
        if stops.len() < 2 {
            return false;
        }
        let gap_at = |s: f64| {
            let k = stops.partition_point(|&stop| stop <= s).clamp(1, stops.len() - 1);
            stops[k] - stops[k - 1]
        };
        let nearest = |of: &[f64], target: f64| {
            of.iter().copied().min_by(|a, b| (a - target).abs().total_cmp(&(b - target).abs()))
        };
        let (mut at, mut end, mut found) = (stops[0], length, false);
        let mut put = |placed: &mut Self, along: f64| {
            placed.insert(Seed { place: path.at(along) - moved, curve, along });
            own.push(along);
        };
        if path.is_closed() {
            let gap = gap_at(at);
            let near = self.near(path, (curve, moved), (at - 0.5 * gap, at + 0.5 * gap), gap);
            found = !near.is_empty();
            at = nearest(&near, at).unwrap_or(at);
            end = at + length;
            put(self, at);
        }
        loop {
            let gap = gap_at(at);
            let (target, low, high) = (at + gap, at + SPACING[0] * gap, at + SPACING[1] * gap);
            if end - low < SPACING[0] * gap {
                break;
            }
            let last = high.min(end - SPACING[0] * gap);
            let near = self.near(path, (curve, moved), (low, last), gap);
            found |= !near.is_empty();
            let usual: Vec<f64> = stops.iter().copied().filter(|stop| (low..=last).contains(stop)).collect();
            let next = nearest(&near, target).or_else(|| nearest(&usual, target)).unwrap_or(target);
            // A gap between two stops in one place takes it no farther.
            if end - next < SPACING[0] * gap || next <= at {
                break;
            }
            put(self, next);
            at = next;
        }
        found
    }

    /// The places of a stretch of a curve that are beside seeds near it.
    fn near(&self, path: &Path, (curve, moved): (u32, DVec3), (from, to): (f64, f64), gap: f64) -> Vec<f64> {
        let step = gap / PARTS;
        let mut found = Vec::new();
        for k in 0..=((to - from) / step).max(0.0) as usize {
            let s = from + k as f64 * step;
            let reach = (path.deviation(s - 0.5 * gap, s + 0.5 * gap) / ROOM).min(REACH * gap);
            // Rounding takes the place of a distance.
            if reach < 1e-6 * gap {
                continue;
            }
            let here = path.at(s) - moved;
            let [low, high] = [-1.0, 1.0].map(|side| self.key(here + DVec3::splat(side * (reach + step))));
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    for z in low[2]..=high[2] {
                        for seed in self.grid.get(&[x, y, z]).into_iter().flatten() {
                            let is_next = seed.curve == curve && path.apart(seed.along, s) < 2.0 * gap;
                            // No place within a step is nearer to it.
                            let is_far = (seed.place - here).length_squared() > (reach + step).powi(2);
                            let place =
                                (!(is_next || is_far)).then(|| beside(path, seed.place + moved, s, step)).flatten();
                            found.extend(place.filter(|&(along, apart)| {
                                apart <= reach && (along - s).abs() <= 0.6 * step && (from..=to).contains(&along)
                            }));
                        }
                    }
                }
            }
        }
        found.into_iter().map(|(along, _)| along).collect()
    }
}

/// The place near `from` on a curve that is nearest to a point, and its distance.
fn beside(path: &Path, point: DVec3, from: f64, step: f64) -> Option<(f64, f64)> {
    let mut s = from;
    for _ in 0..STEPS {
        let way = (path.at(s + 0.5 * step) - path.at(s - 0.5 * step)).try_normalize()?;
        s += (point - path.at(s)).dot(way);
        if (s - from).abs() > 2.0 * step {
            return None;
        }
    }
    Some((s, path.at(s).distance(point)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use std::f64::consts::TAU;

    use glam::DVec3;

    use super::super::CurveSeeds;
    use crate::mesh::TriMesh;
    use crate::mesh::features::{FeatureOptions, Features};
    use crate::rvd::Surface;
    use crate::token::Token;

    /// The two rims of a flat ring, whose vertices are in other directions.
    fn ring(width: f64) -> TriMesh {
        const VERTICES: u32 = 90;
        let rim = |radius: f64, turn: f64| {
            (0..VERTICES).map(move |k| {
                let (sin, cos) = ((f64::from(k) + turn) / f64::from(VERTICES) * TAU).sin_cos();
                radius * DVec3::new(cos, sin, 0.0)
            })
        };
        let positions = rim(1.0, 0.4).chain(rim(1.0 + width, 0.0)).collect();
        let facets = (0..VERTICES).flat_map(|k| {
            let next = (k + 1) % VERTICES;
            [[k, VERTICES + k, VERTICES + next], [k, VERTICES + next, next]]
        });
        TriMesh::new(positions, facets.collect()).unwrap()
    }

    /// How far the seeds of the outer rim are from the directions of those of the inner one, at most, degrees.
    fn off(width: f64) -> f64 {
        let (mesh, token) = (ring(width), Token::default());
        let surface = Surface::new(&mesh, None).unwrap();
        let edge = 0.6 * surface.frame().scale;
        let options = FeatureOptions { turn_reach: 0.5 * edge, ..FeatureOptions::default() };
        let features = Features::find(&mesh, surface.positions(), &options, &token).unwrap();
        assert!(features.corners.is_empty() && features.curves.len() == 2);
        let moved = [DVec3::ZERO; 2];
        let seeds = CurveSeeds::place_beside(&surface, &features, edge, (100, &moved), &token).unwrap().unwrap();
        let middle = surface.frame().to_unit(DVec3::ZERO);
        let directions = |curve: u32| {
            let own = seeds.segments.iter().filter(move |segment| segment.curve == curve);
            own.map(|segment| (seeds.seeds[segment.ends[0] as usize] - middle).normalize())
        };
        assert!(directions(0).count() >= 8 && directions(1).count() >= 8);
        let nearest = |p: DVec3| directions(0).map(|q| p.angle_between(q).to_degrees()).fold(f64::INFINITY, f64::min);
        directions(1).map(nearest).fold(0.0, f64::max)
    }

    #[test]
    fn seeds_of_a_curve_are_beside_those_of_one_that_is_nearer_than_chords() {
        assert!(off(0.02) < 0.01, "{}", off(0.02));
    }

    #[test]
    fn seeds_of_curves_with_room_between_them_stay() {
        assert!(off(0.4) > 1.0, "{}", off(0.4));
    }
}
