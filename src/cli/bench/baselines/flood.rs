//! Jump flooding on all voxels of a grid (Rong and Tan 2006).
//!
//! Purpose: every voxel takes the nearest of the seeds that it and its 26 neighbours know, at distances N/2, N/4 to 1. A warm
//! start keeps the last labels; its first distance is the least power of two that no seed has moved beyond. That is enough
//! near the surface; far from all seeds cells move farther than seeds do.
//! Centroids are those of the surface in the surface's voxels, cut exactly: flooding says nothing of masses, and equal ones
//! would count a slanted surface up to √3 times. Invariant: the labels depend on the seeds, and those of a warm start on the
//! ones before; on no thread. On a device, single precision may round otherwise. Must not know: what moves seeds.

mod on_device;

use std::collections::BTreeMap;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::session::{Clustering, NONE};
use super::sums::Points;
use super::voxels::Voxels;
use geometry::mesh::closest_point::SurfacePoint;
use geometry::rvd::{CellSums, PassStats, RvdError, Surface, elapsed_ms};
use geometry::token::Token;
pub(super) use on_device::OnDevice;

/// Bytes of a voxel of the grid: two labels.
pub(super) const BYTES: u64 = 8;

/// Labels of all voxels of a grid.
pub(super) trait Labels: Send + Sync {
    /// Floods from (voxel, seed) of each voxel that holds a seed, and from the labels that are there if they are `kept`. The
    /// first distance is `step`; seeds are in units of a voxel.
    fn flood(
        &mut self,
        seeds: &[[f32; 3]],
        planted: &[[u32; 2]],
        kept: bool,
        step: u32,
        token: &Token,
    ) -> Result<(), RvdError>;

    /// The label of voxel `code`, which is the `k`th of the surface's.
    fn label(&self, k: usize, code: u32) -> u32;

    /// Bytes that they take.
    fn bytes(&self) -> u64;
}

pub(super) struct Flood<L> {
    voxels: Voxels,
    points: Points,
    warm: bool,
    /// Units of a voxel, those of the labels.
    seeds: Vec<[f32; 3]>,
    labels: L,
}

impl<L: Labels> Flood<L> {
    pub(super) fn new(voxels: Voxels, surface: &Surface, warm: bool, labels: L) -> Self {
        let points = Points::new(surface.area(), voxels.parts.iter().copied());
        Self { voxels, points, warm, seeds: Vec::new(), labels }
    }

    /// Takes new seeds. Returns each voxel that holds some with the nearest to its centre, whether the labels are kept, and
    /// the first distance of the flood.
    fn plant(&mut self, seeds: &[DVec3]) -> (Vec<[u32; 2]>, bool, u32) {
        let grid = self.voxels.grid;
        let places: Vec<[f32; 3]> = seeds.iter().map(|&p| grid.to_voxels(p).to_array().map(|x| x as f32)).collect();
        let moves = self.seeds.iter().zip(&places).map(|(a, b)| squared(a, b)).fold(0.0, f32::max);
        let kept = self.warm && self.seeds.len() == places.len() && moves.is_finite();
        self.seeds = places;
        let mut planted = BTreeMap::new();
        for (i, &seed) in (0..).zip(seeds) {
            let code = grid.code_of(seed);
            let label = planted.entry(code).or_insert(i);
            *label = nearer(&self.seeds, centre(grid.n, code), *label, i);
        }
        let most = grid.n.div_ceil(2).next_power_of_two();
        let step =
            if kept { (moves.sqrt().ceil().min(most as f32) as u32).next_power_of_two().min(most) } else { most };
        (planted.into_iter().map(|(code, seed)| [code, seed]).collect(), kept, step)
    }

    fn label_of(&self, k: usize) -> u32 {
        self.labels.label(k, self.voxels.codes[k])
    }
}

/// Labels in the host's memory, on the threads of the present pool.
pub(super) struct OnHost {
    n: usize,
    labels: Vec<u32>,
    next: Vec<u32>,
}

impl OnHost {
    pub(super) fn new(n: u32) -> Self {
        let n = n as usize;
        Self { n, labels: vec![NONE; n.pow(3)], next: vec![NONE; n.pow(3)] }
    }

    fn pass(&mut self, seeds: &[[f32; 3]], step: usize, token: &Token) {
        let Self { n, labels, next } = self;
        let n = *n;
        let beside = |x: usize| [x.checked_sub(step), Some(x), Some(x + step).filter(|&x| x < n)].into_iter().flatten();
        next.par_chunks_mut(n).enumerate().for_each_init(
            || vec![0.0; n],
            |distances, (row, out)| {
                if token.is_stopped() {
                    return;
                }
                let (y, z) = (row % n, row / n);
                let own = &labels[row * n..][..n];
                out.copy_from_slice(own);
                let at = |x: usize| [x as f32 + 0.5, y as f32 + 0.5, z as f32 + 0.5];
                for (x, (distance, &label)) in distances.iter_mut().zip(own).enumerate() {
                    *distance = seeds.get(label as usize).map_or(f32::INFINITY, |seed| squared(seed, &at(x)));
                }
                let mut hear = |first: usize, heard: &[u32]| {
                    let known = out[first..].iter_mut().zip(&mut distances[first..]);
                    for (x, ((best, distance), &label)) in known.zip(heard).enumerate() {
                        // Most voxels hear of one seed alone.
                        if label == *best {
                            continue;
                        }
                        let Some(seed) = seeds.get(label as usize) else { continue };
                        let new = squared(seed, &at(first + x));
                        if new < *distance || (new == *distance && label < *best) {
                            (*best, *distance) = (label, new);
                        }
                    }
                };
                for (y, z) in beside(z).flat_map(|z| beside(y).map(move |y| (y, z))) {
                    let heard = &labels[(y + n * z) * n..][..n];
                    hear(0, heard);
                    if step < n {
                        hear(0, &heard[step..]);
                        hear(step, &heard[..n - step]);
                    }
                }
            },
        );
        std::mem::swap(labels, next);
    }
}

impl Labels for OnHost {
    fn flood(
        &mut self,
        seeds: &[[f32; 3]],
        planted: &[[u32; 2]],
        kept: bool,
        step: u32,
        token: &Token,
    ) -> Result<(), RvdError> {
        if !kept {
            self.labels.par_iter_mut().for_each(|label| *label = NONE);
        }
        for &[code, seed] in planted {
            let label = &mut self.labels[code as usize];
            *label = nearer(seeds, centre(self.n as u32, code), *label, seed);
        }
        let mut step = step as usize;
        while step > 0 {
            self.pass(seeds, step, token);
            token.check()?;
            step /= 2;
        }
        Ok(())
    }

    fn label(&self, _: usize, code: u32) -> u32 {
        self.labels[code as usize]
    }

    fn bytes(&self) -> u64 {
        BYTES * self.labels.len() as u64
    }
}

/// The nearest seed that a place has heard of; of two at one distance the one with the lower number.
pub(super) struct Best<'a> {
    seeds: &'a [[f32; 3]],
    at: [f32; 3],
    pub(super) label: u32,
    squared: f32,
}

impl<'a> Best<'a> {
    pub(super) fn new(seeds: &'a [[f32; 3]], at: [f32; 3], label: u32) -> Self {
        let squared = seeds.get(label as usize).map_or(f32::INFINITY, |seed| squared(seed, &at));
        Self { seeds, at, label, squared }
    }

    #[inline(always)]
    pub(super) fn hear(&mut self, label: u32) {
        // Most places hear of one seed alone.
        if label == self.label {
            return;
        }
        let Some(seed) = self.seeds.get(label as usize) else { return };
        let squared = squared(seed, &self.at);
        if squared < self.squared || (squared == self.squared && label < self.label) {
            (self.label, self.squared) = (label, squared);
        }
    }
}

fn nearer(seeds: &[[f32; 3]], at: [f32; 3], a: u32, b: u32) -> u32 {
    let mut best = Best::new(seeds, at, a);
    best.hear(b);
    best.label
}

#[inline(always)]
fn squared(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

/// Units of a voxel.
fn centre(n: u32, code: u32) -> [f32; 3] {
    [code % n, code / n % n, code / n / n].map(|x| x as f32 + 0.5)
}

impl<L: Labels> Clustering for Flood<L> {
    fn assign(&mut self, seeds: &[DVec3], token: &Token) -> Result<PassStats, RvdError> {
        let begin = Instant::now();
        let (planted, kept, step) = self.plant(seeds);
        let mut stats = PassStats { start_ms: elapsed_ms(begin), ..PassStats::default() };
        let begin = Instant::now();
        if let Err(error) = self.labels.flood(&self.seeds, &planted, kept, step, token) {
            // Some labels are of another pass: the next flood must not begin with them.
            self.seeds.clear();
            return Err(error);
        }
        stats.clip_ms = elapsed_ms(begin);
        Ok(stats)
    }

    fn sums(&self, seeds: &[DVec3], out: &mut CellSums) {
        self.points.add_up(|k| self.label_of(k), seeds, out);
    }

    fn label(&self, at: &SurfacePoint) -> u32 {
        self.voxels.of_point(at).map_or(NONE, |k| self.label_of(k))
    }

    fn samples(&self) -> Vec<(DVec3, f64, u32)> {
        let of = |(k, &code): (usize, &u32)| (self.voxels.grid.centre(code), self.points.area(k), self.label_of(k));
        self.voxels.codes.iter().enumerate().map(of).collect()
    }

    fn triangles(&self, seeds: &[DVec3]) -> Vec<[u32; 3]> {
        self.voxels.triangles(|k| self.label_of(k), seeds)
    }

    fn bytes(&self) -> u64 {
        self.voxels.bytes() + self.points.bytes() + self.labels.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::seeds_on;
    use super::*;
    use geometry::mesh::shapes::Shape;

    /// Share of some voxels whose label is not a nearest one of the seeds that have a voxel: of two in one voxel the flood
    /// knows one.
    fn wrong(flood: &Flood<OnHost>, voxels: &[u32]) -> f64 {
        let n = flood.voxels.grid.n;
        let at = |seed: &[f32; 3]| seed.map(|x| x as u32);
        let holds = |(i, seed): &(u32, &[f32; 3])| {
            let [x, y, z] = at(seed);
            flood.labels.labels[(x + n * (y + n * z)) as usize] == *i
        };
        let known: Vec<&[f32; 3]> = (0..).zip(&flood.seeds).filter(holds).map(|(_, seed)| seed).collect();
        assert!(known.len() + flood.seeds.len() / 10 > flood.seeds.len(), "{} hold a voxel", known.len());
        let wrong = voxels.iter().filter(|&&code| {
            let at = centre(n, code);
            let least = known.iter().map(|seed| squared(seed, &at)).fold(f32::INFINITY, f32::min);
            squared(&flood.seeds[flood.labels.labels[code as usize] as usize], &at) > least * (1.0 + 1e-6)
        });
        wrong.count() as f64 / voxels.len() as f64
    }

    #[test]
    fn labels_are_nearly_those_of_brute_force() {
        for n in [24, 40] {
            let surface = Surface::new(&Shape::Torus.build(500), None).unwrap();
            let voxels = || Voxels::new(&surface, super::super::voxels::Grid::new(&surface, n));
            let mut plain = Flood::new(voxels(), &surface, false, OnHost::new(n));
            let mut warm = Flood::new(voxels(), &surface, true, OnHost::new(n));
            let mut seeds = seeds_on(&surface, 60);
            for round in 0..4 {
                for flood in [&mut plain, &mut warm] {
                    flood.assign(&seeds, &Token::default()).unwrap();
                    let all: Vec<u32> = (0..n.pow(3)).collect();
                    let shares = [wrong(flood, &flood.voxels.codes), wrong(flood, &all)];
                    let most = if flood.warm { [0.01, 0.05] } else { [0.005, 0.01] };
                    let few = shares[0] < most[0] && shares[1] < most[1];
                    assert!(few, "{n}, round {round}, warm {}: {shares:?}", flood.warm);
                }
                let mut sums = CellSums::default();
                plain.sums(&seeds, &mut sums);
                seeds = (0..).zip(&seeds).map(|(i, &seed)| sums.centroid(i, seed)).collect();
            }
        }
    }

    #[test]
    fn a_stop_leaves_nothing_behind() {
        let surface = Surface::new(&Shape::Torus.build(500), None).unwrap();
        let grid = super::super::voxels::Grid::new(&surface, 16);
        let mut flood = Flood::new(Voxels::new(&surface, grid), &surface, true, OnHost::new(16));
        let seeds = seeds_on(&surface, 30);
        let token = Token::default();
        token.cancel();
        assert!(flood.assign(&seeds, &token).is_err());
        flood.assign(&seeds, &Token::default()).unwrap();
        assert!(wrong(&flood, &flood.voxels.codes) < 0.005);
    }
}
