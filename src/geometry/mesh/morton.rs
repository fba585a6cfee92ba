//! Morton order, a space-filling curve (1966).
//!
//! Purpose: an order that keeps neighbours close in memory.
//! Invariant: the place depends on the point alone.
//! Must not know: the ordered items.

use glam::DVec3;

/// The Morton code of a point with coordinates in [-1, 1], with 2²⁰ cells per axis. Points outside are clamped to the box.
pub(crate) fn code(unit: DVec3) -> u64 {
    let spread = |x: f64| {
        // The cast saturates.
        let mut bits = (((x + 1.0) * (1u64 << 20) as f64) as u64).min((1 << 21) - 1);
        bits = (bits | bits << 32) & 0x001f_0000_0000_ffff;
        bits = (bits | bits << 16) & 0x001f_0000_ff00_00ff;
        bits = (bits | bits << 8) & 0x100f_00f0_0f00_f00f;
        bits = (bits | bits << 4) & 0x10c3_0c30_c30c_30c3;
        (bits | bits << 2) & 0x1249_2492_4924_9249
    };
    spread(unit.x) | spread(unit.y) << 1 | spread(unit.z) << 2
}
