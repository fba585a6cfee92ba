//! Turned parts.
//!
//! Purpose: stepped shafts, cups, threads. Invariant: features up to the largest of their kinds fit. Must not know: how profiles
//! become surfaces.

use glam::dvec2;

use super::Pick;
use super::draft::Draft;
use super::revolution::{disk, on_circle, revolve, ring, strip};
use crate::mesh::TriMesh;

pub(super) fn steps(step: f64, pick: &mut Pick) -> TriMesh {
    let around = pick.count(20, 48);
    let mut radius = pick.between(0.25, 0.32);
    let sections = pick.count(2, (0.6 / (step + 0.05)) as usize).min(7);
    // What the sections leave between their features, each of which is as long as it is high.
    let length = (1.0 - step * (sections - 1) as f64) / sections as f64;
    let (mut profile, mut least, mut z) = (vec![dvec2(radius, 0.0)], radius, 0.0);
    for section in 1..sections {
        z += length;
        let other = if radius > 0.25 { radius - step } else { radius + step };
        least = least.min(other);
        profile.push(dvec2(radius, z));
        profile.push(dvec2(other, z));
        // Shoulders now and then, otherwise grooves and collars.
        if pick.count(0, 2) == 0 {
            radius = other;
        } else {
            profile.extend([dvec2(other, z + step), dvec2(radius, z + step)]);
        }
        // The section after a shoulder is longer.
        z = section as f64 * (length + step);
    }
    profile.push(dvec2(radius, 1.0));
    let bore = least - step.max(pick.between(0.03, 0.1));
    let is_bored = bore > 0.03 && pick.flip();
    let is_through = is_bored && pick.flip();
    if is_bored {
        let floor = if is_through { 0.0 } else { pick.between(0.2, 0.6) };
        profile.extend([dvec2(bore, 1.0), dvec2(bore, floor)]);
    }
    let mut draft = Draft::default();
    revolve(&mut draft, &profile, around, is_through);
    draft.finish()
}

pub(super) fn cup(wall: f64, pick: &mut Pick) -> TriMesh {
    let (bottom, top, height) = (pick.between(0.3, 0.4), pick.between(0.4, 0.5), pick.between(0.6, 1.0));
    let top = if pick.flip() { bottom } else { top };
    let outer = |z: f64| bottom + (top - bottom) * z / height;
    let mut profile = vec![dvec2(bottom, 0.0)];
    if wall <= 0.1 && pick.flip() {
        // A collar, as high and as wide as the wall.
        let (low, high) = (0.6 * height, 0.6 * height + wall);
        profile.push(dvec2(outer(low), low));
        profile.extend([dvec2(outer(low) + wall, low), dvec2(outer(high) + wall, high), dvec2(outer(high), high)]);
    }
    profile.extend([dvec2(top, height), dvec2(top - wall, height), dvec2(outer(wall) - wall, wall)]);
    let mut draft = Draft::default();
    revolve(&mut draft, &profile, pick.count(24, 64), false);
    draft.finish()
}

/// Rows of vertices in a turn of the thread: the feet and the crest's edges.
const ROWS: usize = 4;

pub(super) fn thread(depth: f64, pick: &mut Pick) -> TriMesh {
    let around = pick.count(20, 40);
    let (root, pitch) = (pick.between(0.12, 0.25), (depth * pick.between(2.3, 3.0)).max(0.03));
    let (flank, crest) = (depth * pick.between(0.3, 0.7), depth * pick.between(0.3, 0.6));
    let turns = ((0.7 / pitch) as usize).saturating_sub(1).clamp(1, 20);
    let has_head = pick.flip();
    let rows = ROWS * turns;
    let mut draft = Draft::default();
    let start = pick.between(0.17, 0.2);
    // A row follows the helix, and goes on after a turn as the row that is higher by the rows of a turn.
    let columns: Vec<Vec<u32>> = (0..around)
        .map(|column| {
            let mut vertex = |row: usize| {
                let (rise, radius) = match row % ROWS {
                    0 => (0.0, root),
                    1 => (flank, root + depth),
                    2 => (flank + crest, root + depth),
                    _ => (2.0 * flank + crest, root),
                };
                let turned = (row / ROWS) as f64 + column as f64 / around as f64;
                draft.vertex(on_circle(radius, start + pitch * turned + rise, column, around))
            };
            (0..=rows).map(&mut vertex).collect()
        })
        .collect();
    for pair in columns.windows(2) {
        let (left, right) = (&pair[0], &pair[1]);
        (0..rows).for_each(|row| draft.fan(&[left[row], right[row], right[row + 1], left[row + 1]]));
    }
    let (first, last) = (&columns[0], &columns[around - 1]);
    for row in 0..rows - ROWS {
        draft.fan(&[last[row], first[row + ROWS], first[row + ROWS + 1], last[row + 1]]);
    }
    // Where a row begins and where it ends the thread shows its profile.
    let top = rows - ROWS;
    draft.fan(&[first[0], first[1], first[2], first[3]]);
    draft.fan(&[last[top + 3], last[top + 2], last[top + 1], last[top]]);
    let below = if has_head {
        let (head, rim) = (root + depth + 0.1, ring(&mut draft, root, 0.12, around));
        let (foot, edge) = (ring(&mut draft, head, 0.0, around), ring(&mut draft, head, 0.12, around));
        disk(&mut draft, &foot, true);
        strip(&mut draft, &foot, &edge);
        strip(&mut draft, &edge, &rim);
        rim
    } else {
        let foot = ring(&mut draft, root, 0.0, around);
        disk(&mut draft, &foot, true);
        foot
    };
    let above = ring(&mut draft, root, 1.0, around);
    disk(&mut draft, &above, false);
    for k in 0..around - 1 {
        draft.fan(&[below[k], below[k + 1], columns[k + 1][0], columns[k][0]]);
        draft.fan(&[columns[k][rows], columns[k + 1][rows], above[k + 1], above[k]]);
    }
    // The last strip of the shaft has the feet of the thread's ends on its sides.
    let end = around - 1;
    draft.fan(&[last[0], below[end], below[0], first[0], first[3], first[ROWS]]);
    draft.fan(&[first[rows], above[0], above[end], last[rows], last[top + 3], last[top]]);
    draft.finish()
}
