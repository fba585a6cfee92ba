//! Solids between two parallel faces.
//!
//! Purpose: [`extrude`] joins outlines at several heights by walls and fills the first and the last; [`rounded`] and [`circle`]
//! make outlines. Invariant: outlines run counter-clockwise, those of holes clockwise, and have as many points at each height.
//! Must not know: what is made.

use std::f64::consts::{FRAC_PI_2, TAU};

use earcut::Earcut;
use glam::DVec2;

use super::draft::Draft;
use crate::mesh::TriMesh;

/// A face: its outline, then its holes.
pub(super) type Face = Vec<Vec<DVec2>>;

/// Attempts to fill a face. Outlines with points in rows take more than one.
const ATTEMPTS: usize = 12;
/// The least altitude of a filled face's facet, as a share of its longest edge. One of less is almost without an area.
const FLATTEST: f64 = 1e-6;

/// The solid with these outlines at these ascending heights.
pub(super) fn extrude(levels: &[(f64, Face)]) -> TriMesh {
    let mut draft = Draft::default();
    for pair in levels.windows(2) {
        let [(low, lower), (high, upper)] = pair else { continue };
        for (below, above) in lower.iter().zip(upper) {
            for k in 0..below.len() {
                let next = (k + 1) % below.len();
                let corners = [
                    below[k].extend(*low),
                    below[next].extend(*low),
                    above[next].extend(*high),
                    above[k].extend(*high),
                ];
                let corners = corners.map(|p| draft.vertex(p));
                draft.fan(&corners);
            }
        }
    }
    if let [(low, bottom), .., (high, top)] = levels {
        for triangle in fill(bottom) {
            let [a, b, c] = triangle.map(|p| draft.vertex(p.extend(*low)));
            draft.facet([a, c, b]);
        }
        for triangle in fill(top) {
            let corners = triangle.map(|p| draft.vertex(p.extend(*high)));
            draft.facet(corners);
        }
    }
    draft.finish()
}

/// Triangles of a face, counter-clockwise. Each of its points is a corner of some.
pub(super) fn fill(face: &[Vec<DVec2>]) -> Vec<[DVec2; 3]> {
    // Points in one place are one.
    let outlines: Vec<Vec<DVec2>> = face
        .iter()
        .map(|outline| {
            let before = |k: usize| outline[(k + outline.len() - 1) % outline.len()];
            (0..outline.len()).filter(|&k| outline[k] != before(k)).map(|k| outline[k]).collect()
        })
        .collect();
    let mut best = (f64::NEG_INFINITY, Vec::new());
    // Ears leave out points that lie on a line, or make flat triangles of them. Another start and a turn lead to others.
    for attempt in 0..ATTEMPTS {
        let (mut points, mut holes) = (Vec::new(), Vec::new());
        for (number, outline) in outlines.iter().enumerate() {
            if number > 0 {
                holes.push(points.len() as u32);
            }
            let start = outline.len() * attempt / ATTEMPTS;
            points.extend_from_slice(&outline[start..]);
            points.extend_from_slice(&outline[..start]);
        }
        let wanted = points.len() + 2 * holes.len() - 2;
        let turn = DVec2::from_angle(0.7 * attempt as f64);
        let turned: Vec<[f64; 2]> = points.iter().map(|&p| turn.rotate(p).to_array()).collect();
        let mut ears: Vec<u32> = Vec::new();
        Earcut::new().earcut_slice(&turned, &holes, &mut ears);
        let triangles = ears.as_chunks::<3>().0.iter().map(|t| t.map(|k| points[k as usize]));
        let sum: f64 = triangles.clone().map(twice_area).sum();
        let triangles: Vec<[DVec2; 3]> =
            triangles.map(|[a, b, c]| if sum < 0.0 { [a, c, b] } else { [a, b, c] }).collect();
        let flattest = triangles.iter().map(|&t| altitude(t)).fold(f64::INFINITY, f64::min);
        if triangles.len() == wanted && flattest > best.0 {
            best = (flattest, triangles);
        }
        if best.0 > FLATTEST {
            break;
        }
    }
    best.1
}

fn twice_area([a, b, c]: [DVec2; 3]) -> f64 {
    (b - a).perp_dot(c - a)
}

/// The least altitude as a share of the longest edge, negative if the triangle is clockwise.
fn altitude([a, b, c]: [DVec2; 3]) -> f64 {
    let longest = a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a));
    twice_area([a, b, c]) / longest
}

/// A polygon with rounded corners, each with its radius, moved inwards by `inset`. An arc has so many edges in a quarter turn.
///
/// An inset that equals the radius of a convex corner leaves several points in one place there.
pub(super) fn rounded(corners: &[(DVec2, f64)], inset: f64, quarter: usize) -> Vec<DVec2> {
    let count = corners.len();
    let inwards = |k: usize| (corners[(k + 1) % count].0 - corners[k].0).normalize().perp();
    let mut outline = Vec::new();
    for (k, &(corner, radius)) in corners.iter().enumerate() {
        let (before, after) = (inwards((k + count - 1) % count), inwards(k));
        let along = (before + after) / (1.0 + before.dot(after));
        if radius == 0.0 {
            outline.push(corner + inset * along);
            continue;
        }
        let turn = before.angle_to(after);
        let centre = corner + radius.copysign(turn) * along;
        let reach = inset - radius.copysign(turn);
        let edges = (turn.abs() / FRAC_PI_2 * quarter as f64).round().max(1.0) as usize;
        let normal = |i: usize| match i {
            0 => before,
            i if i == edges => after,
            i => DVec2::from_angle(turn * i as f64 / edges as f64).rotate(before),
        };
        outline.extend((0..=edges).map(|i| centre + reach * normal(i)));
    }
    outline
}

/// A regular polygon, counter-clockwise, with its first corner at the angle `phase`.
pub(super) fn circle(centre: DVec2, radius: f64, edges: usize, phase: f64) -> Vec<DVec2> {
    let angle = |k: usize| phase + TAU * k as f64 / edges as f64;
    (0..edges).map(|k| centre + radius * DVec2::from_angle(angle(k))).collect()
}

/// The same, clockwise, as the outline of a hole.
pub(super) fn hole(centre: DVec2, radius: f64, edges: usize, phase: f64) -> Vec<DVec2> {
    circle(centre, radius, edges, phase).into_iter().rev().collect()
}
