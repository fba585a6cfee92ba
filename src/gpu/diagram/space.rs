//! The spaces in which the device has diagrams.
//!
//! Purpose: [`DeviceSpace`] is what differs between R³ and the space of a lifted surface: records, words of sums, and variants
//! of the stages. All else is written once, over it. Invariant: a record holds a point as `layout::split` rounds it; the records
//! of a space are those of its variants of the shaders. Must not know: what is dispatched when.

use std::fmt::Debug;
use std::sync::Arc;

use bytemuck::Pod;
use glam::DVec3;

use super::layout::{Facet, LIFTED_SUM_WORDS, LiftedFacet, LiftedSeed, SUM_WORDS, Seed, split};
use super::pipelines::Pipelines;
use super::{Gpu, Result};
use geometry::rvd::{Lifted, Point, Space, Surface};

/// R³, or the space of a lifted surface.
pub(super) trait DeviceSpace: Space {
    type Seed: SeedRecord;
    type Facet: FacetRecord;

    /// Words of sums per seed.
    const SUM_WORDS: usize;

    /// The stages of this space.
    fn pipelines(gpu: &Gpu) -> Result<Arc<Pipelines>>;

    /// The longest lift of a corner of the surface.
    fn longest_lift(surface: &Surface<Self>) -> f64;

    /// No point is farther from this one that is in the unit frame's box and has a lift no longer than `longest`.
    fn farthest(self, longest: f64) -> f64;

    /// The record of a seed whose row is not known yet.
    fn record(self) -> Self::Seed;

    /// Where a seed is for the device.
    fn of_record(record: &Self::Seed) -> Self;

    /// The record of a facet that is not degenerate, without slots.
    fn facet(surface: &Surface<Self>, f: usize) -> Self::Facet;
}

/// What the device has of a seed.
pub(super) trait SeedRecord: Pod + Copy + Debug + Default + Send + Sync {
    /// Squared distance in which the device orders neighbours.
    fn key(&self, other: &Self) -> f32;

    /// Where its row begins, and the word that says how long it is.
    fn row(&self) -> (u32, u32);

    fn set_row(&mut self, begin: u32, length: u32);
}

/// What the device has of a facet.
pub(super) trait FacetRecord: Pod + Copy + Debug + Default + Send + Sync {
    /// First slot of its set of cells, and the word with its mask.
    fn slots(&self) -> (u32, u32);

    fn set_slots(&mut self, begin: u32, mask: u32);
}

impl DeviceSpace for DVec3 {
    type Seed = Seed;
    type Facet = Facet;

    const SUM_WORDS: usize = SUM_WORDS;

    fn pipelines(gpu: &Gpu) -> Result<Arc<Pipelines>> {
        Ok(Arc::clone(&gpu.pipelines))
    }

    fn longest_lift(_: &Surface) -> f64 {
        0.0
    }

    fn farthest(self, _: f64) -> f64 {
        // The unit frame's box is within [-1/2, 1/2]³ up to rounding.
        (self.abs() + Self::splat(0.5)).length()
    }

    fn record(self) -> Seed {
        let (hi, lo) = split(self.to_array());
        Seed { hi, row_begin: 0, lo, row_length: 0 }
    }

    fn of_record(record: &Seed) -> Self {
        Self::from_array(record.position())
    }

    fn facet(surface: &Surface, f: usize) -> Facet {
        let [a, b, c] = surface.corners(f as u32);
        let e1 = (b - a).normalize();
        let n = (b - a).cross(c - a).normalize();
        let e2 = n.cross(e1).normalize();
        let (hi, lo) = split(a.to_array());
        let of = |v: DVec3| v.as_vec3().to_array();
        Facet { hi, lo, e1: of(e1), e2: of(e2), n: of(n), ..in_frame(surface, f, e1, e2) }
    }
}

impl SeedRecord for Seed {
    fn key(&self, other: &Self) -> f32 {
        Self::key(self, other)
    }

    fn row(&self) -> (u32, u32) {
        (self.row_begin, self.row_length)
    }

    fn set_row(&mut self, begin: u32, length: u32) {
        (self.row_begin, self.row_length) = (begin, length);
    }
}

impl FacetRecord for Facet {
    fn slots(&self) -> (u32, u32) {
        (self.slot_begin, self.slot_mask)
    }

    fn set_slots(&mut self, begin: u32, mask: u32) {
        (self.slot_begin, self.slot_mask) = (begin, mask);
    }
}

impl DeviceSpace for Lifted {
    type Seed = LiftedSeed;
    type Facet = LiftedFacet;

    const SUM_WORDS: usize = LIFTED_SUM_WORDS;

    fn pipelines(gpu: &Gpu) -> Result<Arc<Pipelines>> {
        gpu.lifted_pipelines()
    }

    fn longest_lift(surface: &Surface<Self>) -> f64 {
        // Of vertices that facets use; others may lie anywhere.
        let used = surface.facets().iter().flatten().map(|&v| surface.positions()[v as usize]);
        used.map(|p| p.lift.length()).fold(0.0, f64::max)
    }

    fn farthest(self, longest: f64) -> f64 {
        self.place.farthest(0.0).hypot(self.lift.length() + longest)
    }

    fn record(self) -> LiftedSeed {
        let ((hi, lo), (lift_hi, lift_lo)) = (split(self.place.to_array()), split(self.lift.to_array()));
        LiftedSeed { hi, lo, lift_hi, lift_lo, ..LiftedSeed::default() }
    }

    fn of_record(record: &LiftedSeed) -> Self {
        let [place, lift] = record.position().map(DVec3::from_array);
        Self { place, lift }
    }

    fn facet(surface: &Surface<Self>, f: usize) -> LiftedFacet {
        let [a, b, c] = surface.corners(f as u32);
        let unit = |v: Lifted| v / v.length();
        let e1 = unit(b - a);
        let across = |v: Lifted| v - e1 * e1.dot(v);
        // Twice, since what is left of a thin facet's side may be little.
        let e2 = unit(across(unit(across(c - a))));
        let ((hi, lo), (lift_hi, lift_lo)) = (split(a.place.to_array()), split(a.lift.to_array()));
        let of = |v: DVec3| v.as_vec3().to_array();
        let Facet { corner1_u, corner2_u, corner2_v, weight, weight_u, weight_v, weight_top, .. } =
            in_frame(surface, f, e1, e2);
        LiftedFacet {
            hi,
            lo,
            e1: of(e1.place),
            corner1_u,
            e2: of(e2.place),
            corner2_u,
            lift_hi,
            corner2_v,
            weight,
            weight_u,
            weight_v,
            weight_top,
            lift_lo,
            lift_e1: of(e1.lift),
            lift_e2: of(e2.lift),
            ..LiftedFacet::default()
        }
    }
}

impl SeedRecord for LiftedSeed {
    fn key(&self, other: &Self) -> f32 {
        Self::key(self, other)
    }

    fn row(&self) -> (u32, u32) {
        (self.row_begin, self.row_length)
    }

    fn set_row(&mut self, begin: u32, length: u32) {
        (self.row_begin, self.row_length) = (begin, length);
    }
}

impl FacetRecord for LiftedFacet {
    fn slots(&self) -> (u32, u32) {
        (self.slot_begin, self.slot_mask)
    }

    fn set_slots(&mut self, begin: u32, mask: u32) {
        (self.slot_begin, self.slot_mask) = (begin, mask);
    }
}

/// A facet's corners and weights in its frame, whose origin is its first corner; nothing else.
fn in_frame<P: Point>(surface: &Surface<P>, f: usize, e1: P, e2: P) -> Facet {
    let [a, b, c] = surface.corners(f as u32);
    let [wa, wb, wc] = surface.facets()[f].map(|v| surface.weights()[v as usize]);
    let (length, u, v) = ((b - a).dot(e1), (c - a).dot(e1), (c - a).dot(e2));
    let weight_u = (wb - wa) / length;
    let weight_v = ((wc - wa) - weight_u * u) / v;
    Facet {
        corner1_u: length as f32,
        corner2_u: u as f32,
        corner2_v: v as f32,
        weight: wa as f32,
        weight_u: weight_u as f32,
        weight_v: weight_v as f32,
        weight_top: wa.max(wb).max(wc) as f32,
        ..Facet::default()
    }
}
