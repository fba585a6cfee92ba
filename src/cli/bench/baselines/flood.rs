//! Jump flooding over a grid of samples: all voxels of a cube (Rong and Tan 2006), or the texels of an image.
//!
//! Purpose: every sample takes the nearest of the seeds that it and its 26 neighbours (8 in an image) know, at distances N/2, N/4
//! to 1. A warm start keeps the last labels; its first distance is the least power of two that no seed has moved beyond. That is
//! enough near the surface; far from all seeds cells move farther than seeds do.
//! [`Flood`] is the method on voxels. Its centroids are those of the surface in its voxels, cut exactly: flooding says nothing of
//! masses, and equal ones would count a slanted surface up to √3 times. Invariant: the labels depend on the seeds, and those of
//! a warm start on the ones before; on no thread. On a device, single precision may round otherwise. Must not know: what moves
//! seeds.

mod on_device;

use std::collections::BTreeMap;
use std::sync::Arc;
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

/// Bytes of a sample: two labels.
pub(super) const BYTES: u64 = 8;

/// A grid of samples, each at a place. Places are in the unit of the seeds.
#[derive(Clone)]
pub(super) struct Samples {
    /// Samples of a row, rows of a layer, layers.
    size: [u32; 3],
    /// Where they are; each in the middle of its unit cube if not given.
    places: Option<Arc<[[f32; 3]]>>,
}

impl Samples {
    /// The centres of N³ voxels, units of a voxel.
    pub(super) fn cube(n: u32) -> Self {
        Self { size: [n; 3], places: None }
    }

    /// A square of K² samples.
    pub(super) fn square(k: u32, places: Vec<[f32; 3]>) -> Self {
        Self { size: [k, k, 1], places: Some(places.into()) }
    }

    pub(super) fn count(&self) -> u32 {
        self.size.iter().product()
    }

    pub(super) fn place(&self, code: u32) -> [f32; 3] {
        match &self.places {
            Some(places) => places[code as usize],
            None => {
                let [x, y, _] = self.size;
                middle([code % x, code / x % y, code / x / y].map(|at| at as usize))
            }
        }
    }

    /// The first distance of a flood that no labels are kept for.
    pub(super) fn first_step(&self) -> u32 {
        let [x, y, z] = self.size;
        x.max(y).max(z).div_ceil(2).next_power_of_two()
    }

    /// Each sample that holds some seeds, with the nearest to it; `codes` are the samples that hold the seeds, one by one.
    pub(super) fn plant(&self, seeds: &[[f32; 3]], codes: impl Iterator<Item = u32>) -> Vec<[u32; 2]> {
        let mut planted = BTreeMap::new();
        for (i, code) in (0..).zip(codes) {
            let label = planted.entry(code).or_insert(i);
            *label = nearer(seeds, self.place(code), *label, i);
        }
        planted.into_iter().map(|(code, seed)| [code, seed]).collect()
    }
}

fn middle(at: [usize; 3]) -> [f32; 3] {
    at.map(|x| x as f32 + 0.5)
}

/// Labels of all samples of a grid.
pub(super) trait Labels: Send + Sync {
    /// Floods from (sample, seed) of each sample that holds a seed, and from the labels that are there if they are `kept`. The
    /// first distance is `step`; seeds are in the unit of the samples' places.
    fn flood(
        &mut self,
        seeds: &[[f32; 3]],
        planted: &[[u32; 2]],
        kept: bool,
        step: u32,
        token: &Token,
    ) -> Result<(), RvdError>;

    /// The label of sample `code`, which is the `k`th of those that are asked for.
    fn label(&self, k: usize, code: u32) -> u32;

    /// Bytes that they take.
    fn bytes(&self) -> u64;
}

/// Jump flooding on voxels.
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
        let samples = Samples::cube(grid.n);
        let places = grid.places(seeds);
        let moves = self.seeds.iter().zip(&places).map(|(a, b)| squared(a, b)).fold(0.0, f32::max);
        let kept = self.warm && self.seeds.len() == places.len() && moves.is_finite();
        self.seeds = places;
        let planted = samples.plant(&self.seeds, seeds.iter().map(|&seed| grid.code_of(seed)));
        let most = samples.first_step();
        let step =
            if kept { (moves.sqrt().ceil().min(most as f32) as u32).next_power_of_two().min(most) } else { most };
        (planted, kept, step)
    }

    fn label_of(&self, k: usize) -> u32 {
        self.labels.label(k, self.voxels.codes[k])
    }
}

/// Labels in the host's memory, on the threads of the present pool.
pub(super) struct OnHost {
    samples: Samples,
    labels: Vec<u32>,
    next: Vec<u32>,
}

impl OnHost {
    pub(super) fn new(samples: Samples) -> Self {
        let none = vec![NONE; samples.count() as usize];
        Self { samples, next: none.clone(), labels: none }
    }

    fn pass(&mut self, seeds: &[[f32; 3]], step: usize, token: &Token) {
        match self.samples.places.clone() {
            Some(places) => self.pass_at(|code, _| places[code], seeds, step, token),
            // Computed, since a pass mostly waits for memory.
            None => self.pass_at(|_, at| middle(at), seeds, step, token),
        }
    }

    /// A pass with the place of a sample by its number and its coordinates in the grid.
    fn pass_at(
        &mut self,
        place: impl Fn(usize, [usize; 3]) -> [f32; 3] + Sync,
        seeds: &[[f32; 3]],
        step: usize,
        token: &Token,
    ) {
        let Self { samples, labels, next } = self;
        let [columns, rows, layers] = samples.size.map(|x| x as usize);
        let beside = |x: usize, most: usize| {
            [x.checked_sub(step), Some(x), Some(x + step).filter(|&x| x < most)].into_iter().flatten()
        };
        next.par_chunks_mut(columns).enumerate().for_each_init(
            || vec![0.0; columns],
            |distances, (row, out)| {
                if token.is_stopped() {
                    return;
                }
                let (y, z) = (row % rows, row / rows);
                let own = &labels[row * columns..][..columns];
                out.copy_from_slice(own);
                let at = |x: usize| place(row * columns + x, [x, y, z]);
                for (x, (distance, &label)) in distances.iter_mut().zip(own).enumerate() {
                    *distance = seeds.get(label as usize).map_or(f32::INFINITY, |seed| squared(seed, &at(x)));
                }
                let mut hear = |first: usize, heard: &[u32]| {
                    let known = out[first..].iter_mut().zip(&mut distances[first..]);
                    for (x, ((best, distance), &label)) in known.zip(heard).enumerate() {
                        // Most samples hear of one seed alone.
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
                for (y, z) in beside(z, layers).flat_map(|z| beside(y, rows).map(move |y| (y, z))) {
                    let heard = &labels[(y + rows * z) * columns..][..columns];
                    hear(0, heard);
                    if step < columns {
                        hear(0, &heard[step..]);
                        hear(step, &heard[..columns - step]);
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
            *label = nearer(seeds, self.samples.place(code), *label, seed);
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

/// The nearer of two seeds, or of one and [`NONE`]; of two at one distance the one with the lower number.
fn nearer(seeds: &[[f32; 3]], at: [f32; 3], a: u32, b: u32) -> u32 {
    let key = |label: u32| (seeds.get(label as usize).map_or(f32::INFINITY, |seed| squared(seed, &at)), label);
    let (of_a, of_b) = (key(a), key(b));
    if of_b < of_a { b } else { a }
}

#[inline(always)]
fn squared(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
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
        let samples = Samples::cube(n);
        let at = |seed: &[f32; 3]| seed.map(|x| x as u32);
        let holds = |(i, seed): &(u32, &[f32; 3])| {
            let [x, y, z] = at(seed);
            flood.labels.labels[(x + n * (y + n * z)) as usize] == *i
        };
        let known: Vec<&[f32; 3]> = (0..).zip(&flood.seeds).filter(holds).map(|(_, seed)| seed).collect();
        assert!(known.len() + flood.seeds.len() / 10 > flood.seeds.len(), "{} hold a voxel", known.len());
        let wrong = voxels.iter().filter(|&&code| {
            let at = samples.place(code);
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
            let mut plain = Flood::new(voxels(), &surface, false, OnHost::new(Samples::cube(n)));
            let mut warm = Flood::new(voxels(), &surface, true, OnHost::new(Samples::cube(n)));
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
        let mut flood = Flood::new(Voxels::new(&surface, grid), &surface, true, OnHost::new(Samples::cube(16)));
        let seeds = seeds_on(&surface, 30);
        let token = Token::default();
        token.cancel();
        assert!(flood.assign(&seeds, &token).is_err());
        flood.assign(&seeds, &Token::default()).unwrap();
        assert!(wrong(&flood, &flood.voxels.codes) < 0.005);
    }
}
