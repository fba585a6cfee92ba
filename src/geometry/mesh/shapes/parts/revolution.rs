//! Surfaces around the z axis.
//!
//! Purpose: [`revolve`] turns a profile around the axis. Invariant: radii are positive, so that no vertex is on the axis; ends
//! are flat disks without a vertex in the middle. Must not know: what is made.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3};

use super::draft::Draft;

/// The vertices of a circle around the axis, counter-clockwise from above.
pub(super) fn ring(draft: &mut Draft, radius: f64, z: f64, around: usize) -> Vec<u32> {
    let place = |k: usize| on_circle(radius, z, k, around);
    (0..around).map(|k| draft.vertex(place(k))).collect()
}

/// One of the places that divide a circle around the axis.
pub(super) fn on_circle(radius: f64, z: f64, k: usize, around: usize) -> DVec3 {
    (radius * DVec2::from_angle(TAU * k as f64 / around as f64)).extend(z)
}

/// A strip between two circles. Going from one to the other, the outside is on the right.
pub(super) fn strip(draft: &mut Draft, from: &[u32], to: &[u32]) {
    for k in 0..from.len() {
        let next = (k + 1) % from.len();
        draft.fan(&[from[k], from[next], to[next], to[k]]);
    }
}

/// The disk within a circle, seen from below or from above.
pub(super) fn disk(draft: &mut Draft, ring: &[u32], from_below: bool) {
    let order: Vec<u32> = if from_below { ring.iter().rev().copied().collect() } else { ring.to_vec() };
    draft.fan(&order);
}

/// Turns a profile of radii and heights, with the outside on its right. One that is not closed gets a disk at each of its ends,
/// the first seen from below, the last from above.
pub(super) fn revolve(draft: &mut Draft, profile: &[DVec2], around: usize, is_closed: bool) {
    let rings: Vec<Vec<u32>> = profile.iter().map(|p| ring(draft, p.x, p.y, around)).collect();
    rings.windows(2).for_each(|pair| strip(draft, &pair[0], &pair[1]));
    if let [first, .., last] = &rings[..] {
        if is_closed {
            strip(draft, last, first);
        } else {
            disk(draft, first, true);
            disk(draft, last, false);
        }
    }
}
