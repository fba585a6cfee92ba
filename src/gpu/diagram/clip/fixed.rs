//! Fixed-point sums: scales and decoding.
//!
//! Purpose: the host's half of `shaders/shared/fixed.wgsl`. Invariant: no sum over any set of pieces can leave 64 bits. With
//! total mass M and area A of the surface, and every point of it within R of its nearest seed, the sums over all cells
//! together, in absolute value, are at most A, M, M R (each component of the moment) and M R². A scale is the largest power of
//! two that keeps its bound below 2^60, which leaves a factor of 8 for rounding. The unit is then at most 2^-59 of the bound.
//! Must not know: the device.

use crate::diagram::space::DeviceSpace;
use geometry::rvd::clip::Integrals;
use geometry::rvd::{CellSums, Point, Surface};

/// The device's scales hold where a seed is within this of all of the surface's box (`NEAR` in the stage `count`): twice the
/// box's half diagonal and some. Without such a seed the host searches, and takes the radius from the seeds.
const COVERING_RADIUS: f64 = 2.0;

/// The same where lifts are no longer than `longest_lift`, and that of the seed is no longer but by a rounding.
pub(crate) fn covering_radius_of_near(longest_lift: f64) -> f64 {
    COVERING_RADIUS.hypot(2.001 * longest_lift)
}

/// Units per unit, powers of two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Scales {
    /// Of ∫ w.
    pub mass: f64,
    /// Of ∫ w (p - x).
    pub moment: f64,
    /// Of ∫ w |p - x|².
    pub energy: f64,
    /// Of ∫ 1.
    pub area: f64,
}

/// The largest power of two s with s * bound < 2^60, within what a float can hold.
fn scale(bound: f64) -> f64 {
    let exponent = if bound > 0.0 { 59.0 - bound.log2().floor() } else { 0.0 };
    exponent.clamp(-100.0, 120.0).exp2()
}

pub(crate) fn total_mass<P: Point>(surface: &Surface<P>) -> f64 {
    let mut mass = 0.0;
    for (f, corners) in surface.facets().iter().enumerate().filter(|(f, _)| !surface.skips(*f)) {
        let w: f64 = corners.iter().map(|&v| surface.weights()[v as usize]).sum();
        mass += surface.facet_area(f as u32) * w / 3.0;
    }
    mass
}

/// A bound on the distance from any point of the surface's box to its nearest seed: no seed can
/// be nearer to all of the box than the one with the nearest farthest corner.
pub(crate) fn covering_radius<P: DeviceSpace>(seeds: &[P], longest_lift: f64) -> f64 {
    seeds.iter().map(|p| p.farthest(longest_lift)).fold(f64::INFINITY, f64::min)
}

impl Scales {
    /// For a surface of this `mass` and `area`, every point within `radius` of a seed.
    pub(crate) fn new(mass: f64, area: f64, radius: f64) -> Self {
        Self {
            mass: scale(mass),
            moment: scale(mass * radius),
            energy: scale(mass * radius * radius),
            area: scale(area),
        }
    }
}

/// One cell's sums in units, added with wrap-around as on the device.
#[derive(Clone, Copy)]
pub(crate) struct Units<P: Point> {
    mass: i64,
    moment: P::Each<i64>,
    energy: i64,
    area: i64,
}

/// A piece that the host clipped, in units.
pub(crate) fn encode<P: Point>(piece: &Integrals<P>, s: &Scales) -> Units<P> {
    let unit = |v: f64| v.round() as i64;
    let moment = piece.moment.coordinates();
    Units {
        mass: unit(piece.mass * s.mass),
        moment: P::each(|c| unit(moment.as_ref()[c] * s.moment)),
        energy: unit(piece.energy * s.energy),
        area: unit(piece.area * s.area),
    }
}

/// One cell's words as units, in the order of `shaders/shared/accumulate.wgsl`.
pub(crate) fn units<P: Point>(words: &[u32]) -> Units<P> {
    let unit = |k: usize| ((u64::from(words[2 * k + 1]) << 32) | u64::from(words[2 * k])) as i64;
    let last = words.len() / 2 - 1;
    Units { mass: unit(0), moment: P::each(|c| unit(1 + c)), energy: unit(last - 1), area: unit(last) }
}

/// Adds to the words of one cell, in the order of `shaders/shared/accumulate.wgsl`.
pub(crate) fn add<P: Point>(words: &mut [u32], units: &Units<P>) {
    let all = [units.mass].into_iter().chain(units.moment.as_ref().iter().copied()).chain([units.energy, units.area]);
    for (limbs, unit) in words.chunks_exact_mut(2).zip(all) {
        let sum = ((u64::from(limbs[1]) << 32) | u64::from(limbs[0])).wrapping_add(unit as u64);
        limbs[0] = sum as u32;
        limbs[1] = (sum >> 32) as u32;
    }
}

/// The sums of all cells from their words. With uniform weights mass is area.
pub(crate) fn decode<P: DeviceSpace>(words: &[u32], uniform: bool, s: &Scales, out: &mut CellSums<P>) {
    let value = |cell: &[u32], k: usize| (((u64::from(cell[2 * k + 1]) << 32) | u64::from(cell[2 * k])) as i64) as f64;
    let last = P::SUM_WORDS / 2 - 1;
    for (i, cell) in words.chunks_exact(P::SUM_WORDS).enumerate() {
        out.area[i] = value(cell, last) / s.area;
        out.mass[i] = if uniform { out.area[i] } else { value(cell, 0) / s.mass };
        out.moment[i] = P::from_coordinates(P::each(|c| value(cell, 1 + c))) / s.moment;
        out.energy[i] = value(cell, last - 1) / s.energy;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagram::layout::SUM_WORDS;
    use glam::DVec3;

    #[test]
    fn bounds_stay_below_two_to_the_sixty() {
        for (mass, area, radius) in [(1.0, 1.0, 1.0), (3e-7, 2.0, 1e-3), (2.9, 3.0, 1e6), (1e-30, 1e-28, 1.7)] {
            let s = Scales::new(mass, area, radius);
            for units in [s.mass * mass, s.moment * mass * radius, s.energy * mass * radius * radius, s.area * area] {
                assert!(units < 60f64.exp2(), "{units:e}");
            }
        }
        assert_eq!(scale(1.0), 59f64.exp2());
    }

    #[test]
    fn words_hold_negative_sums() {
        let s = Scales::new(1.0, 1.0, 1.0);
        let piece = Integrals { mass: 0.25, moment: DVec3::new(-0.125, 0.5, -0.25), energy: 0.1, area: 0.25 };
        let mut words = vec![0; SUM_WORDS];
        for _ in 0..3 {
            add(&mut words, &encode(&piece, &s));
        }
        let mut out: CellSums = CellSums::default();
        out.reset(1);
        decode(&words, false, &s, &mut out);
        assert_eq!((out.mass[0], out.moment[0].x, out.moment[0].y, out.area[0]), (0.75, -0.375, 1.5, 0.75));
        assert!((out.energy[0] - 0.3).abs() < 1e-15);
    }
}
