//! What must hold of a small diagram on the GPU (see `cases`).
#![allow(dead_code)]

use ::gpu::diagram::Gpu;
use glam::DVec3;
use tessera::rvd::Serial;
use tessera::rvd::{Capacities, CellSums, PieceBatch, Surface};

use super::cases::{Case, everything};

/// How far a piece's boundary may be off, in distances to the farthest seed: single precision
/// relative to a seed is good to 6e-8 of that distance, and ten roundings and a crossing at a small angle lose
/// some of it. What a pair loses beyond that is the double path's.
const SLIP: f64 = 1e-5;

/// The diagram covers the surface, every piece lies in the cell of a nearest seed, the energy is that of double
/// precision, and capacities change no bit. Which of two seeds at the same distance has a piece is not asked.
///
/// # Errors
/// What does not hold.
pub fn check(case: &Case, gpu: &Gpu) -> Result<(), String> {
    let surface = case.surface();
    let (want, _, _) = everything(&Serial, &surface, &case.seeds, Capacities::default())?;
    let (got, pieces, _) = everything(gpu, &surface, &case.seeds, Capacities::default())?;
    let slip = SLIP * case.seeds.iter().map(|p| p.length()).fold(1.0, f64::max);
    covers(&surface, &pieces, slip)?;
    nearest(&case.seeds, &pieces, slip)?;
    totals(&surface, &got, &want, slip)?;
    let (tight, _, _) = everything(gpu, &surface, &case.seeds, case.tiny)?;
    if tight != got {
        return Err("the GPU's sums depend on the capacities".to_owned());
    }
    Ok(())
}

fn covers(surface: &Surface, pieces: &PieceBatch, slip: f64) -> Result<(), String> {
    let mut covered = vec![0.0; surface.facets().len()];
    let mut count = vec![0; surface.facets().len()];
    for i in 0..pieces.len() {
        covered[pieces.facet[i] as usize] += pieces.area(i);
        count[pieces.facet[i] as usize] += 1;
    }
    for f in (0..covered.len()).filter(|&f| !surface.skips(f)) {
        let [a, b, c] = surface.facets()[f].map(|v| surface.positions()[v as usize]);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let (area, found) = (surface.facet_area(f as u32), covered[f]);
        // A strip as wide as the slip along the boundaries of all pieces.
        if (found - area).abs() > slip * longest * f64::from(count[f] + 1) {
            return Err(format!("facet {f}: {found:e} of {area:e} is covered"));
        }
    }
    Ok(())
}

fn nearest(seeds: &[DVec3], pieces: &PieceBatch, slip: f64) -> Result<(), String> {
    for i in 0..pieces.len() {
        let own = seeds[pieces.seed[i] as usize];
        for p in &pieces.position[pieces.vertices(i)] {
            let least = seeds.iter().map(|x| x.distance(*p)).fold(f64::INFINITY, f64::min);
            let excess = own.distance(*p) - least;
            if excess > 4.0 * slip {
                let (f, s) = (pieces.facet[i], pieces.seed[i]);
                return Err(format!("facet {f}, seed {s}: {p} is farther by {excess:e} than from another seed"));
            }
        }
    }
    Ok(())
}

fn totals(surface: &Surface, got: &CellSums, want: &CellSums, slip: f64) -> Result<(), String> {
    let (area, energy) = (got.area.iter().sum::<f64>(), got.energy.iter().sum::<f64>());
    let (area_want, energy_want) = (want.area.iter().sum::<f64>(), want.energy.iter().sum::<f64>());
    let rim = surface.facets().len() as f64 * got.area.len() as f64;
    if (area - area_want).abs() > slip * rim {
        return Err(format!("the cells have the area {area:e}, not {area_want:e}"));
    }
    // Around a boundary both seeds are as near, so its place hardly matters to the energy.
    let reach2 = if area_want > 0.0 { 1.0 + energy_want / area_want } else { 1.0 };
    if (energy - energy_want).abs() > slip * rim * reach2 {
        return Err(format!("the cells have the energy {energy:e}, not {energy_want:e}"));
    }
    Ok(())
}
