//! Clusters of the voxels near a surface, in the manner of Leung, Wang, He (2015).
//!
//! Purpose: each voxel of a shell around the surface takes its nearest seed, and each seed goes to the mean of its voxels'
//! centres. Theirs is found by a distance transform; here it is exact, which is the kindest: by the library's search, or on a GPU.
//! Invariant: the label of a voxel is a nearest seed of its centre, on a device within the rounding of single precision. All
//! voxels count alike. Must not know: what moves seeds.

mod on_device;

use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::session::{Clustering, NONE};
use super::sums::{Part, Points};
use super::voxels::Voxels;
use geometry::knn::SeedIndex;
use geometry::mesh::closest_point::SurfacePoint;
use geometry::rvd::{CellSums, PassStats, RvdError, Surface, elapsed_ms};
use geometry::token::Token;
pub(super) use on_device::OnDevice;

/// Voxels between two looks at the token.
const RUN: usize = 1024;

/// The search for the nearest seeds of all voxels.
pub(super) trait Search: Send + Sync {
    /// Labels each voxel. The times of the result are those of the parts; the rest of it is not used.
    fn nearest(
        &mut self,
        voxels: &Voxels,
        seeds: &[DVec3],
        labels: &mut [u32],
        token: &Token,
    ) -> Result<PassStats, RvdError>;

    /// Bytes that it holds between two searches.
    fn bytes(&self) -> u64;
}

/// The library's search, on the threads of the present pool.
pub(super) struct OnHost;

impl Search for OnHost {
    fn nearest(
        &mut self,
        voxels: &Voxels,
        seeds: &[DVec3],
        labels: &mut [u32],
        token: &Token,
    ) -> Result<PassStats, RvdError> {
        let begin = Instant::now();
        let index = SeedIndex::new(seeds);
        let mut stats = PassStats { neighbours_ms: elapsed_ms(begin), ..PassStats::default() };
        let begin = Instant::now();
        labels.par_chunks_mut(RUN).zip(voxels.codes.par_chunks(RUN)).for_each(|(labels, codes)| {
            if !token.is_stopped() {
                labels
                    .iter_mut()
                    .zip(codes)
                    .for_each(|(label, &code)| *label = index.nearest(voxels.grid.centre(code)));
            }
        });
        token.check()?;
        stats.clip_ms = elapsed_ms(begin);
        Ok(stats)
    }

    fn bytes(&self) -> u64 {
        0
    }
}

pub(super) struct Band<S> {
    voxels: Voxels,
    points: Points,
    labels: Vec<u32>,
    search: S,
}

impl<S: Search> Band<S> {
    /// Of all these voxels.
    pub(super) fn new(voxels: Voxels, surface: &Surface, search: S) -> Self {
        let (grid, codes) = (voxels.grid, &voxels.codes);
        let alike = codes.iter().map(|&code| Part { area: 1.0, centroid: grid.centre(code), spread: 0.0 });
        let points = Points::new(surface.area(), alike);
        let labels = vec![NONE; voxels.codes.len()];
        Self { voxels, points, labels, search }
    }
}

impl<S: Search> Clustering for Band<S> {
    fn assign(&mut self, seeds: &[DVec3], token: &Token) -> Result<PassStats, RvdError> {
        self.search.nearest(&self.voxels, seeds, &mut self.labels, token)
    }

    fn sums(&self, seeds: &[DVec3], out: &mut CellSums) {
        self.points.add_up(|k| self.labels[k], seeds, out);
    }

    fn label(&self, at: &SurfacePoint) -> u32 {
        self.voxels.of_point(at).map_or(NONE, |k| self.labels[k])
    }

    fn samples(&self) -> Vec<(DVec3, f64, u32)> {
        let of = |(k, &code): (usize, &u32)| (self.voxels.grid.centre(code), self.points.area(k), self.labels[k]);
        self.voxels.codes.iter().enumerate().map(of).collect()
    }

    fn triangles(&self, seeds: &[DVec3]) -> Vec<[u32; 3]> {
        self.voxels.triangles(|k| self.labels[k], seeds)
    }

    fn bytes(&self) -> u64 {
        self.voxels.bytes() + self.points.bytes() + 4 * self.labels.len() as u64 + self.search.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::seeds_on;
    use super::super::voxels::Grid;
    use super::*;
    use geometry::mesh::shapes::Shape;

    #[test]
    fn labels_are_those_of_brute_force() {
        for (shape, shell) in [(Shape::Torus, 1), (Shape::Genus(1), 2), (Shape::Hills, 3)] {
            let surface = Surface::new(&shape.build(500), None).unwrap();
            let voxels = Voxels::new(&surface, Grid::new(&surface, 24)).widened(shell - 1);
            let mut band = Band::new(voxels, &surface, OnHost);
            let seeds = seeds_on(&surface, 50);
            band.assign(&seeds, &Token::default()).unwrap();
            for (centre, _, label) in band.samples() {
                let least = seeds.iter().map(|seed| seed.distance(centre)).fold(f64::INFINITY, f64::min);
                assert!(seeds[label as usize].distance(centre) <= least * (1.0 + 1e-12), "{shape}");
            }
            let mut sums = CellSums::default();
            band.sums(&seeds, &mut sums);
            assert!((sums.mass.iter().sum::<f64>() / surface.area() - 1.0).abs() < 1e-6);
        }
    }
}
