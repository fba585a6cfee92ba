//! How fine the grid is in which seeds are searched.
//!
//! Purpose: with weights, or on a lifted surface, seeds lie densely in places. Cells three mean spacings wide may then have more of them than the device
//! looks at (`CELL_CAPACITY` in the stage `count`), and the host would have to search in every pass. From the seeds that each
//! cell is to expect, cells are made narrower until none is too full. They are not made so narrow that the rows of many
//! seeds that are far apart leave the rings that the device looks at; the host makes those rows longer.
//! Measured on a software adapter: with half as wide cells the search takes up to half as long again where seeds are spread
//! evenly, so cells are no narrower than needed. 50,000 seeds by feature size, up to a hundred times as dense as on
//! average, took 178 to 189 ms a step with the host's search and 150 without.
//! Invariant: by the surface and the number of seeds alone. Must not know: where seeds are.

use glam::DVec3;
use rayon::prelude::*;

use crate::diagram::layout::RINGS;
use crate::diagram::plan::grid_side;
use geometry::rvd::{Point, Surface};

/// Seeds that a cell may expect: fewer than its capacity, as chance puts more into some.
const FULL: f64 = 160.0;
/// Each time cells are so much narrower.
const NARROWER: f64 = 1.25;
/// Cells along a side, at most; 64 MiB of them.
const FINEST: u32 = 256;
/// 24 neighbours, more than a row has, are within 2.8 spacings in relaxed sets; and a third more to spare.
const NEIGHBOURHOOD: f64 = 3.6;
/// No more than this share of the seeds may be farther apart than rows are found.
const FAR_APART: f64 = 0.01;

/// The most that [`grid_side_for`] gives for `seeds` seeds with weights or lifts, whatever the surface.
pub(crate) fn finest_side(seeds: u64) -> u32 {
    // Few seeds fill no cell, so the grid stays as it was.
    let even = grid_side(0.0, seeds);
    if (seeds as f64) <= FULL { even } else { even.saturating_mul(2).min(FINEST) }
}

/// Grid cells along each side of the unit box for `seeds` seeds.
pub(crate) fn grid_side_for<P: Point>(surface: &Surface<P>, seeds: usize) -> u32 {
    let mut side = grid_side(surface.area(), seeds as u64);
    if surface.is_uniform() && P::IS_PLACE {
        return side;
    }
    let expected = expected_seeds(surface, seeds);
    while fullest(&expected, side) > FULL {
        let finer = (f64::from(side) * NARROWER).ceil() as u32;
        if finer > FINEST || far_apart(&expected, finer) > FAR_APART * seeds as f64 {
            break;
        }
        side = finer;
    }
    side
}

/// A facet's seeds.
struct Expected {
    at: DVec3,
    seeds: f64,
    /// A unit of area.
    density: f64,
    /// A unit of its area in R³, which is less where the surface is lifted.
    in_space: f64,
}

/// Seeds that energies are least with: of w as many a unit of area as its root says (Gersho 1979, in two dimensions).
fn expected_seeds<P: Point>(surface: &Surface<P>, seeds: usize) -> Vec<Expected> {
    let each = seeds as f64 / surface.root_mass();
    let of = |f: usize| {
        let roots = surface.facets()[f].map(|v| surface.weights()[v as usize].sqrt());
        let density = each * roots.iter().sum::<f64>() / 3.0;
        let (at, area) = (surface.centroid(f as u32).place(), surface.facet_area(f as u32));
        let in_space = if P::IS_PLACE { density } else { density * area / area_in_space(surface, f as u32) };
        Expected { at, seeds: density * area, density, in_space }
    };
    (0..surface.facets().len()).into_par_iter().filter(|&f| !surface.skips(f)).map(of).collect()
}

fn area_in_space<P: Point>(surface: &Surface<P>, f: u32) -> f64 {
    let [a, b, c] = surface.corners(f).map(P::place);
    0.5 * (b - a).cross(c - a).length()
}

/// Seeds that the fullest cell expects. Of a facet that is larger than a cell no more than a plane has in one.
fn fullest(expected: &[Expected], side: u32) -> f64 {
    let last = f64::from(side) - 1.0;
    let mut cells: Vec<(u64, f64)> = expected
        .par_iter()
        .map(|e| {
            let place = ((e.at + 0.5) * f64::from(side)).floor().clamp(DVec3::ZERO, DVec3::splat(last));
            let [x, y, z] = place.to_array().map(|x| x as u64);
            let most = 3f64.sqrt() * e.in_space / f64::from(side).powi(2);
            ((z * u64::from(side) + y) * u64::from(side) + x, e.seeds.min(most))
        })
        .collect();
    // Facet by facet: the same sums on any number of threads.
    cells.par_sort_by_key(|cell| cell.0);
    cells.chunk_by(|a, b| a.0 == b.0).map(|cell| cell.iter().map(|c| c.1).sum()).fold(0.0, f64::max)
}

/// Seeds that have not all neighbours of a row within the rings of cells that are looked at.
fn far_apart(expected: &[Expected], side: u32) -> f64 {
    let least = (NEIGHBOURHOOD * f64::from(side) / f64::from(RINGS)).powi(2);
    expected.iter().filter(|e| e.density < least).map(|e| e.seeds).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::shapes::Shape;

    /// The torus with edges that are to be `ratio` times as short at one point as away from it.
    fn graded(ratio: f64) -> Surface {
        let mesh = Shape::Torus.build(20_000);
        let (p, size) = (mesh.positions(), mesh.positions()[0].length());
        let length = |q: &DVec3| (2.0 * q.distance(p[0]) / size).clamp(1.0 / ratio, 1.0);
        let weights: Vec<f64> = p.iter().map(|q| length(q).powi(-4)).collect();
        Surface::new(&mesh, Some(&weights)).unwrap()
    }

    #[test]
    fn cells_are_narrower_where_seeds_are_dense_and_no_narrower_than_needed() {
        let seeds = 20_000;
        let (even, graded) = (graded(1.0), graded(20.0));
        let base = |surface: &Surface| grid_side(surface.area(), seeds as u64);
        assert_eq!(grid_side_for(&even, seeds), base(&even));
        let (expected, side) = (expected_seeds(&graded, seeds), grid_side_for(&graded, seeds));
        let full = |side: u32| fullest(&expected, side);
        assert!((expected.iter().map(|e| e.seeds).sum::<f64>() / seeds as f64 - 1.0).abs() < 1e-9);
        assert!(side > base(&graded) && full(side) <= FULL, "{side}, {} full", full(side));
        assert!(full((f64::from(side) / NARROWER) as u32) > FULL);
        assert!(far_apart(&expected, side) < 0.01 * seeds as f64);
        assert!(far_apart(&expected, 10_000) > 0.99 * seeds as f64);
    }
}
