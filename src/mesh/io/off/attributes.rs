//! What an OFF file carries: normals (N), colours (C) and texture coordinates (ST) of its vertices, in this order
//! after the position, as the keyword announces them.

use std::fmt::Write as _;

use glam::{DVec2, DVec3};

use super::super::held::{Held, Raw, eight_bit};
use super::{Lines, header};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{ColourDepth, Colours, Normals, PerCorner};

/// `bytes` are those that `mesh` was read from.
pub(in super::super) fn attributes(bytes: &[u8], mesh: &TriMesh) -> Raw {
    let mut raw = Raw::default();
    let first = Lines { rest: bytes, line: 0 }.next();
    let Ok(Some((_, first))) = first else { return raw };
    let Some(kinds) = first.split_ascii_whitespace().next().and_then(|word| word.strip_suffix("OFF")) else {
        return raw;
    };
    let has_normals = kinds.contains('N');
    let has_texture = kinds.starts_with("ST");
    let has_colours = kinds.contains('C');
    if kinds.is_empty() {
        return raw;
    }
    let mut lines = Lines { rest: bytes, line: 0 };
    let Ok((vertices, _)) = header(&mut lines) else { return raw };
    let (mut normals, mut texture, mut colours) = (Vec::new(), Vec::new(), Vec::new());
    // Eight bits: whole numbers up to 255 throughout, one of them above 1.
    let (mut whole, mut above_one) = (true, false);
    for _ in 0..vertices {
        let Ok(Some((_, line))) = lines.next() else { return raw };
        let mut words: Vec<&str> = line.split_ascii_whitespace().skip(3).take(9).collect();
        // What is missing or no number is NaN, and refused with the others that are not finite.
        let number = |word: Option<&&str>| word.and_then(|w| w.parse::<f64>().ok()).unwrap_or(f64::NAN);
        if has_normals {
            normals.push(DVec3::new(number(words.first()), number(words.get(1)), number(words.get(2))));
            words.drain(..words.len().min(3));
        }
        if has_texture {
            let uv = words.split_off(words.len().saturating_sub(2));
            texture.push(DVec2::new(number(uv.first()), number(uv.get(1))));
        }
        if has_colours {
            let rgb = [words.first(), words.get(1), words.get(2)].map(number);
            let alpha = words.get(3);
            whole &= words.iter().take(4).all(|w| w.bytes().all(|b| b.is_ascii_digit()));
            whole &= rgb.iter().all(|x| *x <= 255.0) && alpha.is_none_or(|_| number(alpha) <= 255.0);
            above_one |= rgb.iter().any(|x| *x > 1.0);
            let opaque = if alpha.is_some() { number(alpha) } else { f64::INFINITY };
            colours.push([rgb[0], rgb[1], rgb[2], opaque]);
            above_one |= opaque > 1.0 && alpha.is_some();
        }
    }
    raw.normals = has_normals.then_some(Normals::PerVertex(normals));
    raw.texture = has_texture.then(|| PerCorner { values: texture, corners: mesh.facets().to_vec() });
    raw.colours = has_colours.then(|| {
        let eight = whole && above_one;
        let scale = if eight { 255.0 } else { 1.0 };
        let component = |x: f64| if x == f64::INFINITY { 1.0 } else { x / scale };
        let values = colours.into_iter().map(|c: [f64; 4]| c.map(component)).collect();
        Colours { values, depth: if eight { ColourDepth::Eight } else { ColourDepth::Float } }
    });
    raw
}

pub(in super::super) fn encode_with(mesh: &TriMesh, held: &Held<'_>) -> Vec<u8> {
    let (vertices, facets) = (mesh.positions().len(), mesh.facets().len());
    let mut text = String::with_capacity(96 * vertices + 24 * facets);
    let mark = |there: bool, letters| if there { letters } else { "" };
    let kinds = [mark(held.uv.is_some(), "ST"), mark(held.colours.is_some(), "C"), mark(held.normals.is_some(), "N")];
    let _ = writeln!(text, "{}OFF\n{vertices} {facets} 0", kinds.concat());
    // Whole numbers none of which is above 1 would be read as floating point.
    let eight = held
        .colours
        .is_some_and(|c| c.depth == ColourDepth::Eight && c.values.iter().flatten().any(|&x| eight_bit(x) > 1));
    // Debug formatting is the shortest text that reads back as the same bits.
    for (vertex, p) in mesh.positions().iter().enumerate() {
        let _ = write!(text, "{:?} {:?} {:?}", p.x, p.y, p.z);
        if let Some(n) = held.normals.as_ref().map(|n| n[vertex]) {
            let _ = write!(text, " {:?} {:?} {:?}", n.x, n.y, n.z);
        }
        if let Some(colours) = held.colours {
            let colour = colours.values[vertex];
            let _ = if eight {
                let [r, g, b, a] = colour.map(eight_bit);
                write!(text, " {r} {g} {b} {a}")
            } else {
                let [r, g, b, a] = colour;
                write!(text, " {r:?} {g:?} {b:?} {a:?}")
            };
        }
        if let Some(uv) = held.uv.as_ref().map(|uv| uv[vertex]) {
            let _ = write!(text, " {:?} {:?}", uv.x, uv.y);
        }
        text.push('\n');
    }
    for [a, b, c] in mesh.facets() {
        let _ = writeln!(text, "3 {a} {b} {c}");
    }
    text.into_bytes()
}
