//! Parts whose faces are all along the axes.
//!
//! Purpose: plates with ribs or letters, frames, enclosures, blocks with slots. Invariant: features up to the largest of their
//! kinds fit, and no two boxes touch in an edge or a corner alone. Must not know: how boxes become a surface.

use super::Pick;
use super::cells::Solid;
use crate::mesh::TriMesh;

/// Letters in rows from the top, without strokes that meet in a corner: A, C, E, F, H, I, L, O, P, S, T, U.
const LETTERS: [[u8; 7]; 12] = [
    [0b11111, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
    [0b11111, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111],
    [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111],
    [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000],
    [0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
    [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
    [0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111],
    [0b11111, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11111],
    [0b11111, 0b10001, 0b10001, 0b11111, 0b10000, 0b10000, 0b10000],
    [0b11111, 0b10000, 0b10000, 0b11111, 0b00001, 0b00001, 0b11111],
    [0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100],
    [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11111],
];

pub(super) fn ribs(rib: f64, pick: &mut Pick) -> TriMesh {
    let (width, plate) = (pick.between(0.4, 0.8), pick.between(0.03, 0.1));
    let height = plate + pick.between(0.1, 0.4);
    let most = ((1.0 / (2.0 * rib)) as usize).clamp(1, 6);
    let count = pick.count(most.min(2), most);
    // Each in the middle of an equal share of the length.
    let share = 1.0 / count as f64;
    let inset = if pick.flip() { 0.1 * width } else { 0.0 };
    let mut solid = Solid::default();
    solid.add([0.0, 0.0, 0.0], [1.0, width, plate]);
    for k in 0..count {
        let x = share * (k as f64 + 0.5) - 0.5 * rib;
        solid.add([x, inset, plate], [x + rib, width - inset, height]);
    }
    if rib < 0.3 * width && pick.flip() {
        let y = 0.5 * (width - rib);
        solid.add([0.0, y, plate], [1.0, y + rib, plate + 0.6 * (height - plate)]);
    }
    solid.surface()
}

pub(super) fn letters(raised: f64, pick: &mut Pick) -> TriMesh {
    let (count, plate) = (pick.count(2, 4), pick.between(0.05, 0.15));
    let pixel = 1.0 / (6 * count + 1) as f64;
    let mut solid = Solid::default();
    solid.add([0.0, 0.0, 0.0], [1.0, 9.0 * pixel, plate]);
    for at in 0..count {
        let letter = LETTERS[pick.count(0, LETTERS.len() - 1)];
        for (row, bits) in letter.into_iter().enumerate() {
            let y = pixel * (7 - row) as f64;
            for column in (0..5).filter(|column| bits >> (4 - column) & 1 == 1) {
                let [x, next] = [1, 2].map(|edge| pixel * (6 * at + column + edge) as f64);
                solid.add([x, y, plate], [next, y + pixel, plate + raised]);
            }
        }
    }
    solid.surface()
}

pub(super) fn frame(strut: f64, pick: &mut Pick) -> TriMesh {
    let size = [1.0, pick.between(0.65, 1.0), pick.between(0.65, 1.0)];
    let bands = size.map(|length| {
        let most = (((length - strut) / (strut + 0.1)) as usize).clamp(1, 3);
        let openings = pick.count(1, most);
        let band = |k: usize| (length - strut) * k as f64 / openings as f64;
        (0..=openings).map(band).collect::<Vec<f64>>()
    });
    let mut solid = Solid::default();
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for (&y, &z) in bands[u].iter().flat_map(|y| bands[v].iter().map(move |z| (y, z))) {
            let (mut low, mut high) = ([0.0; 3], size);
            (low[u], low[v]) = (y, z);
            (high[u], high[v]) = (y + strut, z + strut);
            solid.add(low, high);
        }
    }
    solid.surface()
}

pub(super) fn enclosure(wall: f64, pick: &mut Pick) -> TriMesh {
    let (width, height) = (pick.between(0.5, 0.8), pick.between(0.3, 0.5));
    // Heights are shares of the depth.
    let mut level = |low: f64, high: f64| wall + (height - wall) * pick.between(low, high);
    let (ribs_end, bosses_end) = (level(0.2, 0.5), level(0.6, 0.9));
    let ribs = pick.count(0, 2);
    let room = (1.0 - wall * (2 + ribs) as f64) / (ribs + 1) as f64;
    let inner = width - 2.0 * wall;
    let mut solid = Solid::default();
    solid.add([0.0, 0.0, 0.0], [1.0, width, height]);
    solid.cut([wall, wall, wall], [1.0 - wall, width - wall, height]);
    for k in 0..=ribs {
        let from = wall + k as f64 * (room + wall);
        if k > 0 {
            solid.add([from - wall, wall, wall], [from, width - wall, ribs_end]);
        }
        let side = (room / 3.0).min(inner / 4.0).min(0.15);
        let (x, y) = (from + 0.5 * (room - side), wall + (inner - side) * pick.between(0.2, 0.8));
        solid.add([x, y, wall], [x + side, y + side, bosses_end]);
        if side > 3.0 * wall {
            let floor = wall + 0.3 * (bosses_end - wall);
            solid.cut([x + wall, y + wall, floor], [x + side - wall, y + side - wall, bosses_end]);
        }
    }
    solid.surface()
}

pub(super) fn slots(slot: f64, pick: &mut Pick) -> TriMesh {
    let (width, height) = (pick.between(0.4, 0.8), pick.between(0.3, 0.6));
    let web = slot.max(0.04) * pick.between(1.0, 1.5);
    let most = (((0.84 + web) / (slot + web)) as usize).clamp(1, 7);
    let count = pick.count(most.min(2), most);
    let end = slot.clamp(0.04, 0.3 * width);
    let mut x = 0.5 * (1.0 - count as f64 * slot - (count - 1) as f64 * web);
    let mut solid = Solid::default();
    solid.add([0.0, 0.0, 0.0], [1.0, width, height]);
    for _ in 0..count {
        let floor = height * pick.between(0.1, 0.7);
        match pick.count(0, 2) {
            // A groove, a pocket, a slit through the block.
            0 => solid.cut([x, 0.0, floor], [x + slot, width, height]),
            1 => solid.cut([x, end, floor], [x + slot, width - end, height]),
            _ => solid.cut([x, end, 0.0], [x + slot, width - end, height]),
        }
        x += slot + web;
    }
    solid.surface()
}
