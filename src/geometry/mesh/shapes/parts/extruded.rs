//! Parts that are outlines with a height.
//!
//! Purpose: brackets, blocks with fillets or bores, gears, perforated plates, wedges. Invariant: features up to the largest of
//! their kinds fit. Must not know: how outlines become surfaces.

use std::f64::consts::TAU;

use glam::{DVec2, DVec3, dvec2};

use super::Pick;
use super::draft::Draft;
use super::extrusion::{Face, extrude, fill, hole, rounded};
use crate::mesh::TriMesh;

fn straight(face: Face, height: f64) -> TriMesh {
    extrude(&[(0.0, face.clone()), (height, face)])
}

pub(super) fn bracket(sheet: f64, pick: &mut Pick) -> TriMesh {
    let inner = (sheet * pick.between(0.5, 2.0)).min(0.12);
    let outer = inner + sheet;
    let height = pick.between(0.75, 1.0);
    // A Z of thick sheet has no room for its bends.
    let corners = match pick.count(0, if sheet > 0.2 { 1 } else { 2 }) {
        0 => vec![
            (dvec2(0.0, 0.0), outer),
            (dvec2(1.0, 0.0), 0.0),
            (dvec2(1.0, sheet), 0.0),
            (dvec2(sheet, sheet), inner),
            (dvec2(sheet, height), 0.0),
            (dvec2(0.0, height), 0.0),
        ],
        1 => {
            let other = pick.between(0.6, 0.95);
            vec![
                (dvec2(0.0, 0.0), outer),
                (dvec2(1.0, 0.0), outer),
                (dvec2(1.0, other), 0.0),
                (dvec2(1.0 - sheet, other), 0.0),
                (dvec2(1.0 - sheet, sheet), inner),
                (dvec2(sheet, sheet), inner),
                (dvec2(sheet, height), 0.0),
                (dvec2(0.0, height), 0.0),
            ]
        }
        _ => {
            let web = pick.between(0.45, 0.6);
            vec![
                (dvec2(0.0, 0.0), 0.0),
                (dvec2(web, 0.0), outer),
                (dvec2(web, height - sheet), inner),
                (dvec2(1.0, height - sheet), 0.0),
                (dvec2(1.0, height), 0.0),
                (dvec2(web - sheet, height), outer),
                (dvec2(web - sheet, sheet), inner),
                (dvec2(0.0, sheet), 0.0),
            ]
        }
    };
    let quarter = pick.count(4, 10);
    straight(vec![rounded(&corners, 0.0, quarter)], pick.between(0.25, 0.7))
}

pub(super) fn filleted(radius: f64, pick: &mut Pick) -> TriMesh {
    let (width, height) = (pick.between(0.6, 0.9), pick.between(0.3, 0.6));
    let corner = |x: f64, y: f64| (dvec2(x, y), radius);
    let corners = if radius <= 0.14 && pick.flip() {
        // An L, with a concave fillet.
        let (x, y) = (pick.between(0.35, 0.65), width * 0.5);
        [(0.0, 0.0), (1.0, 0.0), (1.0, y), (x, y), (x, width), (0.0, width)].map(|(x, y)| corner(x, y)).to_vec()
    } else {
        [(0.0, 0.0), (1.0, 0.0), (1.0, width), (0.0, width)].map(|(x, y)| corner(x, y)).to_vec()
    };
    let chamfer = if pick.flip() { radius } else { 0.5 * radius };
    let quarter = pick.count(4, 8);
    let outline = |inset: f64| vec![rounded(&corners, inset, quarter)];
    extrude(&[(0.0, outline(0.0)), (height - chamfer, outline(0.0)), (height, outline(chamfer))])
}

pub(super) fn gear(thickness: f64, pick: &mut Pick) -> TriMesh {
    let teeth = pick.count(9, 28);
    let (tip, depth) = (0.5, pick.between(0.06, 0.1));
    let phase = pick.between(0.1, 0.2);
    // The half widths of a tooth, as shares of the pitch, and its radii.
    let flank = [(0.3, tip - depth), (0.22, tip - 0.5 * depth), (0.11, tip)];
    let mut outline = Vec::new();
    for tooth in 0..teeth {
        let at =
            |share: f64, radius: f64| radius * DVec2::from_angle(phase + TAU * (tooth as f64 + share) / teeth as f64);
        outline.extend(flank.iter().map(|&(share, radius)| at(-share, radius)));
        outline.extend(flank.iter().rev().map(|&(share, radius)| at(share, radius)));
    }
    let bore = pick.between(0.06, 0.12);
    let mut face = vec![outline, hole(DVec2::ZERO, bore, pick.count(16, 32), pick.between(0.0, 0.1))];
    if pick.flip() {
        let (count, radius) = (pick.count(3, 6), pick.between(0.05, 0.08));
        for k in 0..count {
            let centre = 0.26 * DVec2::from_angle(TAU * k as f64 / count as f64);
            face.push(hole(centre, radius, 16, pick.between(0.0, TAU)));
        }
    }
    straight(face, thickness)
}

fn rectangle(width: f64) -> Vec<DVec2> {
    vec![dvec2(0.0, 0.0), dvec2(1.0, 0.0), dvec2(1.0, width), dvec2(0.0, width)]
}

pub(super) fn perforated(thickness: f64, pick: &mut Pick) -> TriMesh {
    let columns = pick.count(2, 6);
    let pitch = 1.0 / columns as f64;
    let rows = pick.count(1.max(columns / 2), columns);
    let radius = pitch * pick.between(0.2, 0.42);
    let edges = pick.count(10, 24);
    let mut face = vec![rectangle(rows as f64 * pitch)];
    for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
        let centre = pitch * dvec2(column as f64 + 0.5, row as f64 + 0.5);
        // Turned each in its own way, so that no points of several holes are on a line.
        face.push(hole(centre, radius, edges, pick.between(0.0, TAU)));
    }
    straight(face, thickness)
}

pub(super) fn drilled(wall: f64, pick: &mut Pick) -> TriMesh {
    let width = pick.between(0.5, 0.9);
    let wanted = pick.count(2, 7);
    let mut bores: Vec<(DVec2, f64)> = Vec::new();
    for _ in 0..60 {
        let centre = dvec2(pick.between(0.0, 1.0), pick.between(0.0, width));
        let sides = centre.min(dvec2(1.0, width) - centre).min_element();
        let room = bores.iter().map(|&(other, radius)| centre.distance(other) - radius).fold(sides, f64::min) - wall;
        let radius = room.min(pick.between(0.05, 0.2));
        if radius >= 0.03 && bores.len() < wanted {
            bores.push((centre, radius));
        }
    }
    if bores.is_empty() {
        bores.push((dvec2(0.5, 0.5 * width), 0.5 * width - wall));
    }
    let mut face = vec![rectangle(width)];
    for (centre, radius) in bores {
        face.push(hole(centre, radius, pick.count(16, 32), pick.between(0.0, TAU)));
    }
    straight(face, pick.between(0.2, 0.5))
}

pub(super) fn wedge(height: f64, pick: &mut Pick) -> TriMesh {
    let (width, ridge) = (pick.between(0.3, 0.7), pick.between(0.7, 1.0));
    let (radius, length) = (0.25 * height, pick.between(0.3, 0.6));
    let foot = dvec2(pick.between(0.3, 0.7), 0.5 * width);
    let rim = hole(foot, radius, pick.count(10, 20), pick.between(0.0, TAU));
    let mut draft = Draft::default();
    for triangle in fill(&[rectangle(width), rim.clone()]) {
        let [a, b, c] = triangle.map(|p| draft.vertex(p.extend(0.0)));
        draft.facet([a, c, b]);
    }
    let tip = draft.vertex(foot.extend(-length));
    for k in 0..rim.len() {
        let [a, b] = [rim[k], rim[(k + 1) % rim.len()]].map(|p| draft.vertex(p.extend(0.0)));
        draft.facet([a, b, tip]);
    }
    let mut triangle =
        |y: f64| [(0.0, 0.0), (1.0, 0.0), (ridge, height)].map(|(x, z)| draft.vertex(DVec3::new(x, y, z)));
    let ([a, b, c], [d, e, f]) = (triangle(0.0), triangle(width));
    for face in [&[a, b, c][..], &[d, f, e], &[b, e, f, c], &[c, f, d, a]] {
        draft.fan(face);
    }
    draft.finish()
}
