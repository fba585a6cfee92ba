//! The nearest seeds of voxels by a GPU.
//!
//! Purpose: the host sorts the seeds by the cells of a grid, one invocation for each voxel looks through cells about it until no
//! other seed can be as near, and the labels come back, to be summed on the host. The library's search finds the nearest seeds
//! of voxels that are many cells away from all. Invariant: the rule of [`super`], and of two seeds at one distance the lower
//! number; where two are as near, the device may round otherwise than the host. Must not know: what labels are for.

use std::sync::Arc;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::super::stages::{Buffers, Stage};
use super::super::voxels::Voxels;
use super::{NONE, Search};
use geometry::knn::SeedIndex;
use geometry::rvd::{PassStats, RvdError, elapsed_ms};
use geometry::token::Token;
use gpu::buffers::{Staging, write};
use gpu::shader::Sources;
use gpu::wgpu::Buffer;
use gpu::{Device, GpuError};

const SOURCES: Sources = &[("search", include_str!("search.wgsl"))];
/// Seeds for each square of a side of the cells: about one in a cell that the surface is in.
const PER_SQUARE: f64 = 2.0;
/// Cells along a side at most, so that 8 MiB go to the device with the seeds.
const MOST_CELLS: f64 = 128.0;

pub(in super::super) struct OnDevice {
    buffers: Buffers,
    params: Buffer,
    starts: Buffer,
    sorted: Buffer,
    found: Buffer,
    staging: Staging,
    search: Stage,
}

impl OnDevice {
    /// For these voxels, and `count` seeds at most.
    pub(in super::super) fn new(device: &Arc<Device>, voxels: &Voxels, count: usize) -> Result<Self, GpuError> {
        let (of_voxels, of_seeds) = (4 * voxels.codes.len() as u64, 16 * count as u64);
        let of_cells = 4 * (u64::from(side_for(count)).pow(3) + 1);
        let mut buffers = Buffers::new(device, 3 * of_voxels + of_seeds + of_cells);
        let params = buffers.make("parameters", 16)?;
        let codes = buffers.words("voxels", &voxels.codes)?;
        let (starts, sorted) = (buffers.make("cells", of_cells)?, buffers.make("seeds", of_seeds)?);
        let found = buffers.make("labels", of_voxels)?;
        let search = buffers.stage(SOURCES, "search", &[], &[vec![&params, &codes, &starts, &sorted, &found]])?;
        let staging = buffers.staging(of_voxels)?;
        Ok(Self { buffers, params, starts, sorted, found, staging, search })
    }
}

impl Search for OnDevice {
    fn nearest(
        &mut self,
        voxels: &Voxels,
        seeds: &[DVec3],
        labels: &mut [u32],
        token: &Token,
    ) -> Result<PassStats, RvdError> {
        token.check()?;
        let begin = Instant::now();
        let (n, side, items) = (voxels.grid.n, side_for(seeds.len()), labels.len() as u32);
        let (starts, sorted) = sort(&voxels.grid.places(seeds), n, side);
        let mut stats = PassStats { neighbours_ms: elapsed_ms(begin), ..PassStats::default() };
        let begin = Instant::now();
        let device = &self.buffers.device;
        write(device, &self.params, 0, &[n, side, items, 0])?;
        write(device, &self.starts, 0, &starts)?;
        write(device, &self.sorted, 0, &sorted)?;
        let mut encoder = device.encoder();
        let mut pass = self.buffers.pass(&mut encoder);
        self.search.run(&mut pass, 0, items);
        drop(pass);
        let all = 0..labels.len();
        self.staging.read_with(device, encoder, &self.found, all, |found: &[u32]| {
            labels.iter_mut().zip(found).for_each(|(label, &found)| *label = found);
        })?;
        if labels.contains(&NONE) {
            let index = SeedIndex::new(seeds);
            let open = labels.par_iter_mut().zip(&voxels.codes).filter(|(label, _)| **label == NONE);
            open.for_each(|(label, &code)| *label = index.nearest(voxels.grid.centre(code)));
        }
        stats.clip_ms = elapsed_ms(begin);
        Ok(stats)
    }

    fn bytes(&self) -> u64 {
        self.buffers.bytes()
    }
}

/// Cells along each side of the grid of voxels.
fn side_for(seeds: usize) -> u32 {
    (seeds as f64 / PER_SQUARE).sqrt().clamp(1.0, MOST_CELLS) as u32
}

/// A counting sort of seeds in units of a voxel. Returns where each of the `side`³ cells begins, with the end behind them, and
/// the bits of each seed's place with its number.
fn sort(places: &[[f32; 3]], n: u32, side: u32) -> (Vec<u32>, Vec<[u32; 4]>) {
    let (scale, last) = (side as f32 / n as f32, (side - 1) as f32);
    let side = side as usize;
    let cell_of = |place: &[f32; 3]| {
        // The outermost cells go on without end.
        let [x, y, z] = place.map(|x| (x * scale).floor().clamp(0.0, last) as usize);
        x + side * (y + side * z)
    };
    let mut starts = vec![0; side.pow(3) + 1];
    places.iter().for_each(|place| starts[cell_of(place) + 1] += 1);
    let mut total = 0;
    for start in &mut starts {
        total += *start;
        *start = total;
    }
    let (mut next, mut sorted) = (starts.clone(), vec![[0; 4]; places.len()]);
    for (i, place) in (0..).zip(places) {
        let [x, y, z] = place.map(f32::to_bits);
        let at = &mut next[cell_of(place)];
        sorted[*at as usize] = [x, y, z, i];
        *at += 1;
    }
    (starts, sorted)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_seed_is_in_its_cell_once() {
        let random = |k: u32| ((f64::from(k) * 12.9898).sin() * 43758.5453).rem_euclid(1.0) as f32;
        // Some are beyond the grid of 24 voxels.
        let places: Vec<[f32; 3]> = (0..200).map(|k| [0, 1, 2].map(|c| 28.0 * random(3 * k + c) - 2.0)).collect();
        for side in [1, 5, 24] {
            let (starts, sorted) = sort(&places, 24, side);
            let cells = side.pow(3) as usize;
            assert_eq!((starts.len(), starts[0], starts[cells]), (cells + 1, 0, 200));
            let mut seen = vec![false; places.len()];
            for (cell, range) in starts.windows(2).enumerate() {
                for &[x, y, z, seed] in &sorted[range[0] as usize..range[1] as usize] {
                    assert!(!std::mem::replace(&mut seen[seed as usize], true));
                    let place = [x, y, z].map(f32::from_bits);
                    assert_eq!(place, places[seed as usize]);
                    let [x, y, z] = place.map(|x| (x / 24.0 * side as f32).clamp(0.0, side as f32 - 0.5) as usize);
                    assert_eq!(cell, x + side as usize * (y + side as usize * z), "{place:?}");
                }
            }
            assert!(seen.iter().all(|&seen| seen));
        }
        assert_eq!([1, 2, 1000, 1 << 20].map(side_for), [1, 1, 22, 128]);
    }
}
