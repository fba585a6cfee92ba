//! Sums over cells in fixed point.
//!
//! Purpose: [`Points`] are weighted points that stand for parts of a surface; summed by label they give what a session answers.
//! Invariant: sums are integers, so that their bits depend neither on threads nor on an order. A cell's energy is that of its
//! points, each with the spread of what it stands for. Must not know: where labels come from.

use glam::DVec3;
use rayon::prelude::*;

use geometry::rvd::CellSums;

/// Parts of the area of a whole surface.
const MASS: f64 = (1u64 << 36) as f64;
/// Parts of a unit of the unit frame. Sums over the surface stay below 2⁶³: coordinates are at most about a half.
const PLACE: f64 = (1u64 << 26) as f64;
/// Parts into which each thread's share of the points is divided.
const SHARES: usize = 4;

/// A part of the surface, unit frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Part {
    pub(super) area: f64,
    pub(super) centroid: DVec3,
    /// Mean squared distance of the part from its centroid.
    pub(super) spread: f64,
}

/// Mass, three moments about the origin, second moment.
type Sums = [i64; 5];

/// Points with the sums that each adds to its cell.
#[derive(Default)]
pub(super) struct Points {
    sums: Vec<Sums>,
    /// Area of a unit of mass.
    unit: f64,
}

impl Points {
    /// Scales the parts to the area of the surface, of which they may be samples.
    pub(super) fn new(area: f64, parts: impl IntoIterator<Item = Part> + Clone) -> Self {
        let total: f64 = parts.clone().into_iter().map(|part| part.area).sum();
        let point = |part: Part| {
            let mass = if total > 0.0 { (part.area / total * MASS).round() as i64 } else { 0 };
            let fixed = |x: f64| (x * PLACE).round() as i64;
            let [x, y, z] = part.centroid.to_array().map(|x| mass * fixed(x));
            [mass, x, y, z, mass * fixed(part.centroid.length_squared() + part.spread)]
        };
        Self { sums: parts.into_iter().map(point).collect(), unit: area / MASS }
    }

    pub(super) fn len(&self) -> usize {
        self.sums.len()
    }

    pub(super) fn bytes(&self) -> u64 {
        (self.sums.capacity() * size_of::<Sums>()) as u64
    }

    /// Area that point `k` stands for.
    pub(super) fn area(&self, k: usize) -> f64 {
        self.sums[k][0] as f64 * self.unit
    }

    /// Sums of each seed's points; a label that is no seed is left out.
    pub(super) fn add_up(&self, label: impl Fn(usize) -> u32 + Sync, seeds: &[DVec3], out: &mut CellSums) {
        let run = self.len().div_ceil(SHARES * rayon::current_num_threads()).max(1);
        let part = |(first, points): (usize, &[Sums])| {
            let mut cells = vec![[0; 5]; seeds.len()];
            for (k, point) in points.iter().enumerate() {
                if let Some(cell) = cells.get_mut(label(first * run + k) as usize) {
                    add(cell, point);
                }
            }
            cells
        };
        let join = |mut a: Vec<Sums>, b: Vec<Sums>| {
            a.iter_mut().zip(&b).for_each(|(a, b)| add(a, b));
            a
        };
        let none = || vec![[0; 5]; seeds.len()];
        let cells = self.sums.par_chunks(run).enumerate().map(part).reduce(none, join);
        out.reset(seeds.len());
        for (i, (&[mass, x, y, z, second], &seed)) in cells.iter().zip(seeds).enumerate() {
            let (mass, second) = (mass as f64, second as f64 / PLACE);
            let moment = DVec3::new(x as f64, y as f64, z as f64) / PLACE;
            out.mass[i] = mass * self.unit;
            out.area[i] = out.mass[i];
            out.moment[i] = (moment - mass * seed) * self.unit;
            out.energy[i] = (second - 2.0 * seed.dot(moment) + mass * seed.length_squared()).max(0.0) * self.unit;
        }
    }
}

fn add(sum: &mut Sums, more: &Sums) {
    sum.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
}
