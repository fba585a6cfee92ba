//! Surfaces of sets of cubes: sharp creases, any genus.

use std::collections::HashMap;

use glam::DVec3;

use super::Draft;
use crate::mesh::TriMesh;

/// One row of `holes` square holes in a slab three cubes wide.
pub(super) fn slab(holes: u32, facets: usize) -> TriMesh {
    let holes = holes as i32;
    surface([2 * holes + 1, 3, 1], facets, |[x, y, _]| x % 2 == 0 || y != 1)
}

/// Three by two by two cubes without two of them, which do not touch.
pub(super) fn block(facets: usize) -> TriMesh {
    surface([3, 2, 2], facets, |cell| cell != [0, 1, 1] && cell != [2, 0, 1])
}

/// The boundary of the cubes of `solid`, with squares divided into about `facets` facets. No two cubes may touch only in an
/// edge or a corner.
fn surface(size: [i32; 3], facets: usize, solid: impl Fn([i32; 3]) -> bool) -> TriMesh {
    let inside = |cell: [i32; 3]| (0..3).all(|k| (0..size[k]).contains(&cell[k])) && solid(cell);
    // Squares by axis of the normal.
    let mut squares = Vec::new();
    for x in 0..size[0] {
        for y in 0..size[1] {
            for z in 0..size[2] {
                for (axis, step) in [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)] {
                    let mut neighbour = [x, y, z];
                    neighbour[axis] += step;
                    if inside([x, y, z]) && !inside(neighbour) {
                        squares.push(([x, y, z], axis, step));
                    }
                }
            }
        }
    }
    let divisions = divisions(facets, [0, 1, 2].map(|axis| squares.iter().filter(|s| s.1 == axis).count()));
    let mut draft = Draft::default();
    let mut numbers: HashMap<[i32; 3], u32> = HashMap::new();
    let longest = f64::from(size.into_iter().max().unwrap_or(1));
    for (cell, axis, step) in squares {
        // The two other axes, so that u × v points along the outward normal.
        let (u, v) = if step > 0 { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
        let mut point = |i: i32, j: i32| {
            let mut at = [0, 1, 2].map(|k| cell[k] * divisions[k]);
            at[axis] += if step > 0 { divisions[axis] } else { 0 };
            at[u] += i;
            at[v] += j;
            *numbers.entry(at).or_insert_with(|| {
                let position = [0, 1, 2].map(|k| f64::from(at[k]) / f64::from(divisions[k]) / longest * 2.0);
                draft.positions.push(DVec3::from_array(position));
                (draft.positions.len() - 1) as u32
            })
        };
        let mut quads = Vec::new();
        for j in 0..divisions[v] {
            for i in 0..divisions[u] {
                quads.push([point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)]);
            }
        }
        quads.into_iter().for_each(|quad| draft.quad(quad));
    }
    draft.finish()
}

/// Divisions per axis: equal, or one more, whichever is nearer.
fn divisions(facets: usize, squares: [usize; 3]) -> [i32; 3] {
    let target = facets as f64;
    let total: usize = squares.iter().sum();
    let least = ((target / (2 * total) as f64).sqrt().floor() as i32).max(1);
    let mut best = (f64::INFINITY, [least; 3]);
    for choice in 0..8 {
        let d = [0, 1, 2].map(|k| least + (choice >> k & 1));
        let count: f64 = (0..3).map(|k| squares[k] as f64 * f64::from(d[(k + 1) % 3] * d[(k + 2) % 3]) * 2.0).sum();
        let off = (count / target).ln().abs();
        if off < best.0 {
            best = (off, d);
        }
    }
    best.1
}
