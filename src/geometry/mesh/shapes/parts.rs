//! Mechanical parts with one small feature, for tests.
//!
//! Purpose: [`part`] makes a part of a [`PartKind`] with walls, fillets, steps, gaps or letters of a given size, triangulated
//! as CAD programs do: few long facets on flat faces, narrow strips around round ones. Invariant: the surface is closed,
//! connected, consistently oriented and without crossings, hanging vertices or facets without area. The same arguments give
//! the same part. Must not know: its callers.

use std::fmt;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::mesh::TriMesh;

mod cells;
mod draft;
mod extruded;
mod extrusion;
mod orthogonal;
mod revolution;
#[cfg(test)]
mod tests;
mod turned;

/// A kind of mechanical part. Its feature is the length that [`part`] takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PartKind {
    /// Bent sheet metal of an L, U or Z profile. Feature: the thickness of the sheet.
    Bracket,
    /// A block with rounded vertical edges and a chamfered rim. Feature: the radius; the chamfer is as wide, or half of it.
    Filleted,
    /// A plate with ribs, and perhaps a lower one across. Feature: the width of the ribs.
    Ribs,
    /// A plate with raised letters of square strokes. Feature: the height of the letters.
    Letters,
    /// A shaft with a helical thread that ends abruptly, perhaps with a head. Feature: the depth of the thread.
    Thread,
    /// A gear wheel with a bore, and perhaps holes in its web. Feature: the thickness.
    Gear,
    /// A lattice of square struts. Feature: the width of the struts.
    Frame,
    /// A plate with round holes in rows. Feature: the thickness.
    Perforated,
    /// A block with bores of several radii. Feature: the thinnest wall between bores and to the sides.
    Drilled,
    /// A turned part with shoulders, grooves and collars, perhaps bored. Feature: the height of the steps.
    Steps,
    /// A round cup with a floor, perhaps conical or with a collar. Feature: the thickness of the wall.
    Cup,
    /// A box open at the top, with ribs and hollow bosses on its floor. Feature: the thickness of all walls.
    Enclosure,
    /// A prism with an acute edge and a needle. Feature: the height of the prism, of which the angles follow.
    Wedge,
    /// A block with grooves, pockets and slits. Feature: their width.
    Slots,
}

impl PartKind {
    /// One of each kind.
    pub const ALL: [Self; 14] = [
        Self::Bracket,
        Self::Filleted,
        Self::Ribs,
        Self::Letters,
        Self::Thread,
        Self::Gear,
        Self::Frame,
        Self::Perforated,
        Self::Drilled,
        Self::Steps,
        Self::Cup,
        Self::Enclosure,
        Self::Wedge,
        Self::Slots,
    ];

    /// The largest feature that leaves room for the rest of the part.
    pub fn largest(self) -> f64 {
        match self {
            Self::Thread | Self::Steps => 0.1,
            Self::Drilled | Self::Enclosure => 0.15,
            Self::Filleted | Self::Cup => 0.2,
            Self::Frame => 0.25,
            Self::Bracket | Self::Ribs | Self::Letters | Self::Gear | Self::Perforated | Self::Wedge | Self::Slots => {
                0.3
            }
        }
    }
}

impl fmt::Display for PartKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&format!("{self:?}").to_lowercase())
    }
}

/// The smallest feature.
pub const SMALLEST: f64 = 1e-4;

/// Makes a part whose longest side is about 1, with a feature of this length; `seed` draws the proportions.
///
/// A feature below [`SMALLEST`] or not a number is taken as that, one above [`PartKind::largest`] as the latter.
pub fn part(kind: PartKind, feature: f64, seed: u64) -> TriMesh {
    let feature = if feature >= SMALLEST { feature.min(kind.largest()) } else { SMALLEST };
    let pick = &mut Pick(ChaCha8Rng::seed_from_u64(seed));
    match kind {
        PartKind::Bracket => extruded::bracket(feature, pick),
        PartKind::Filleted => extruded::filleted(feature, pick),
        PartKind::Gear => extruded::gear(feature, pick),
        PartKind::Perforated => extruded::perforated(feature, pick),
        PartKind::Drilled => extruded::drilled(feature, pick),
        PartKind::Wedge => extruded::wedge(feature, pick),
        PartKind::Ribs => orthogonal::ribs(feature, pick),
        PartKind::Letters => orthogonal::letters(feature, pick),
        PartKind::Frame => orthogonal::frame(feature, pick),
        PartKind::Enclosure => orthogonal::enclosure(feature, pick),
        PartKind::Slots => orthogonal::slots(feature, pick),
        PartKind::Thread => turned::thread(feature, pick),
        PartKind::Steps => turned::steps(feature, pick),
        PartKind::Cup => turned::cup(feature, pick),
    }
}

/// Random proportions.
struct Pick(ChaCha8Rng);

impl Pick {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        let unit = (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        low + (high - low) * unit
    }

    /// From `low` to `high`, both included.
    fn count(&mut self, low: usize, high: usize) -> usize {
        low + (self.0.next_u64() % (high - low + 1) as u64) as usize
    }

    fn flip(&mut self) -> bool {
        self.count(0, 1) == 1
    }
}
