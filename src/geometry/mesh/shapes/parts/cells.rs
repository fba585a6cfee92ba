//! Solids made of boxes along the axes.
//!
//! Purpose: a [`Solid`] adds and cuts boxes in turn. A grid goes through all their sides, and the surface consists of the
//! sides of its cells. Invariant: no vertex hangs on an edge. The surface is a manifold if no two parts of the solid, and no
//! two parts of the outside, touch in an edge or a corner alone. Must not know: what is made.

use glam::{DVec3, dvec3};

use super::draft::Draft;
use crate::mesh::TriMesh;

/// Sides nearer to each other than this are one plane.
const ONE_PLANE: f64 = 1e-9;

#[derive(Default)]
pub(super) struct Solid {
    /// Two opposite corners, and whether the box is added or cut.
    boxes: Vec<([DVec3; 2], bool)>,
}

impl Solid {
    /// Adds the box between these corners.
    pub(super) fn add(&mut self, low: [f64; 3], high: [f64; 3]) {
        self.boxes.push(([low.into(), high.into()], true));
    }

    /// Cuts the box between these corners.
    pub(super) fn cut(&mut self, low: [f64; 3], high: [f64; 3]) {
        self.boxes.push(([low.into(), high.into()], false));
    }

    /// The last box around a place decides.
    fn holds(&self, place: DVec3) -> bool {
        let is_around = |[low, high]: &[DVec3; 2]| place.cmpge(*low).all() && place.cmple(*high).all();
        self.boxes.iter().rev().find(|(corners, _)| is_around(corners)).is_some_and(|&(_, is_added)| is_added)
    }

    pub(super) fn surface(&self) -> TriMesh {
        let lines = [0, 1, 2].map(|axis| self.planes(axis));
        let [nx, ny, nz] = [0, 1, 2].map(|axis| lines[axis].len() - 1);
        let middle = |axis: usize, k: usize| 0.5 * (lines[axis][k] + lines[axis][k + 1]);
        let number = |[x, y, z]: [usize; 3]| (x * ny + y) * nz + z;
        let cells = || (0..nx * ny * nz).map(|k| [k / (ny * nz), k / nz % ny, k % nz]);
        let filled: Vec<bool> =
            cells().map(|[x, y, z]| self.holds(dvec3(middle(0, x), middle(1, y), middle(2, z)))).collect();
        let mut draft = Draft::default();
        for cell in cells().filter(|&cell| filled[number(cell)]) {
            for (axis, is_upper) in [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)] {
                let last = if is_upper { [nx, ny, nz][axis] - 1 } else { 0 };
                let mut neighbour = cell;
                if cell[axis] != last {
                    neighbour[axis] = if is_upper { cell[axis] + 1 } else { cell[axis] - 1 };
                    if filled[number(neighbour)] {
                        continue;
                    }
                }
                // The two other axes, so that u × v points outwards.
                let (u, v) = if is_upper { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
                let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| {
                    let mut at = cell;
                    at[axis] += usize::from(is_upper);
                    at[u] += i;
                    at[v] += j;
                    draft.vertex(DVec3::from([0, 1, 2].map(|k| lines[k][at[k]])))
                });
                draft.fan(&corners);
            }
        }
        draft.finish()
    }

    /// Where sides of boxes are along an axis, ascending.
    fn planes(&self, axis: usize) -> Vec<f64> {
        let mut planes: Vec<f64> = self.boxes.iter().flat_map(|(corners, _)| corners.map(|p| p[axis])).collect();
        planes.sort_unstable_by(f64::total_cmp);
        planes.dedup_by(|b, a| *b - *a < ONE_PLANE);
        planes
    }
}
