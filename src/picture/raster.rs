//! Triangles into a depth buffer, and lines and dots on them.
//!
//! Purpose: which samples a triangle covers, and how deep it is there. Corners are rounded to a grid of [`GRID`] steps per sample and
//! sides decided in integers, so that triangles with a common edge neither overlap nor leave a gap. Strokes mark the samples that
//! lie in a line's width and where the surface does not hide it.
//! Invariant: a sample shows the nearest triangle that covers its middle, the earliest of equally near ones. Marks do not depend on
//! the order of drawing, so that crossings are no darker than lines. Must not know: cameras, light.
//!
//! A line lies in the surface, so its depth and that of the surface below it differ by rounding, and
//! by the surface's slope over half a sample. A constant bias that allows for a steep slope would
//! let lines through thin walls. Instead the point of the line's axis next to a sample is compared with the
//! deepest of the nine samples around that point: on a slope one of them lies deeper than the line.

use std::ops::Range;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::image::lit;
use super::view::View;
use super::{BAND, Face, Pens, SUPER};

/// Steps of the corner grid per sample.
const GRID: i64 = 256;
/// Corners further than this from the picture's corner, in samples, cannot be placed: in grid steps they are
/// 2^29, and twice an area, two products of differences, is below 2^62.
const FAR: f64 = (1 << 21) as f64;

/// A triangle in sample coordinates.
#[derive(Clone, Debug)]
pub(super) struct Triangle {
    /// Corners in grid steps, so ordered that its area is positive.
    x: [i32; 3],
    y: [i32; 3],
    /// Depths, in samples.
    z: [f32; 3],
    colour: [u8; 3],
}

/// The rows of samples that one task fills.
pub(super) struct Band<'a> {
    pub(super) width: usize,
    pub(super) first_row: usize,
    pub(super) depth: &'a mut [f32],
    pub(super) colour: &'a mut [[u8; 4]],
}

impl Triangle {
    /// Where a face is, or `None` if it has no area there or is too far out.
    pub(super) fn place(face: &Face, view: &View) -> Option<Self> {
        let [a, b, c] = face.corners.map(|p| view.place(p) * SUPER as f64);
        if [a, b, c].iter().any(|p| !p.is_finite() || p.abs().max_element() > FAR) {
            return None;
        }
        let grid = |v: f64| (v * GRID as f64).round() as i32;
        let mut placed = Self {
            x: [a, b, c].map(|p| grid(p.x)),
            y: [a, b, c].map(|p| grid(p.y)),
            z: [a, b, c].map(|p| p.z as f32),
            colour: [0; 3],
        };
        // y points down, so a front face has a negative area.
        let area = placed.twice_area();
        if area == 0 {
            return None;
        }
        let back = area > 0;
        if !back {
            placed.x.swap(1, 2);
            placed.y.swap(1, 2);
            placed.z.swap(1, 2);
        }
        let [a, b, c] = face.corners.map(|p| view.turned(p));
        let normal = face.normal.map_or_else(|| (b - a).cross(c - a), |n| view.turned_direction(n));
        // A shading normal may lean away where the face itself does not.
        let toward = if back { -normal } else { normal };
        placed.colour = lit(face.colour, toward, back);
        Some(placed)
    }

    fn twice_area(&self) -> i64 {
        let [x, y] = [self.x, self.y].map(|v| v.map(i64::from));
        (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    }

    /// Rows of samples whose middles are in its height, of a picture of `height` rows.
    pub(super) fn rows(&self, height: usize) -> Range<usize> {
        span(self.y, height)
    }

    pub(super) fn fill(&self, band: &mut Band<'_>) {
        let last_row = band.first_row + band.depth.len() / band.width;
        let (rows, columns) = (self.rows(last_row), span(self.x, band.width));
        if columns.is_empty() {
            return;
        }
        let edges = [0, 1, 2].map(|i| Edge::new(self, i, (i + 1) % 3));
        let plane = Plane::new(self);
        for row in rows.start.max(band.first_row)..rows.end {
            let (y, x0) = (middle(row), middle(columns.start));
            let mut inside = 0..columns.len() as i64;
            edges.iter().for_each(|edge| edge.narrow(x0, y, &mut inside));
            if inside.is_empty() {
                continue;
            }
            let first = (row - band.first_row) * band.width + columns.start;
            let range = first + inside.start as usize..first + inside.end as usize;
            let (depth, shown) = (&mut band.depth[range.clone()], &mut band.colour[range]);
            let mut z = plane.at(x0 + inside.start * GRID, y);
            for (depth, shown) in depth.iter_mut().zip(shown) {
                let here = (z as f32).clamp(plane.low, plane.high);
                if here < *depth {
                    *depth = here;
                    *shown = [self.colour[0], self.colour[1], self.colour[2], 0];
                }
                z += plane.dx;
            }
        }
    }
}

/// The middle of sample `i`, in grid steps.
fn middle(i: usize) -> i64 {
    i as i64 * GRID + GRID / 2
}

/// The samples below `limit` whose middles lie between the least and the greatest of `v`.
fn span(v: [i32; 3], limit: usize) -> Range<usize> {
    let [low, high] = [v.iter().min(), v.iter().max()].map(|v| v.map_or(0, |&v| i64::from(v)) - GRID / 2);
    let first = -(-low).div_euclid(GRID);
    let end = high.div_euclid(GRID) + 1;
    let limit = limit as i64;
    first.clamp(0, limit) as usize..end.clamp(0, limit) as usize
}

/// One side of a triangle.
struct Edge {
    x: i64,
    y: i64,
    dx: i64,
    dy: i64,
    /// 0 if samples exactly on the edge belong to this triangle, 1 if to the one across.
    open: i64,
}

impl Edge {
    fn new(t: &Triangle, from: usize, to: usize) -> Self {
        let (x, y) = (i64::from(t.x[from]), i64::from(t.y[from]));
        let (dx, dy) = (i64::from(t.x[to]) - x, i64::from(t.y[to]) - y);
        // Of an edge and its reverse exactly one is closed.
        let closed = dy < 0 || (dy == 0 && dx > 0);
        Self { x, y, dx, dy, open: i64::from(!closed) }
    }

    /// Keeps of `inside`, which counts samples from x = `x0` on, those on the inner side at height `y`.
    fn narrow(&self, x0: i64, y: i64, inside: &mut Range<i64>) {
        // At sample i the side is value - i step, and has to be 0 or more.
        let value = self.dx * (y - self.y) - self.dy * (x0 - self.x) - self.open;
        let step = self.dy * GRID;
        if step > 0 {
            inside.end = inside.end.min(value.div_euclid(step) + 1);
        } else if step < 0 {
            inside.start = inside.start.max(-value.div_euclid(-step));
        } else if value < 0 {
            inside.end = inside.start;
        }
    }
}

/// Depth as a function of place.
struct Plane {
    x: f64,
    y: f64,
    z: f64,
    /// Per sample to the right, and per grid step in either direction.
    dx: f64,
    per_x: f64,
    per_y: f64,
    /// Least and greatest depth of the corners: rounding does not lead beyond them on steep faces.
    low: f32,
    high: f32,
}

impl Plane {
    fn new(t: &Triangle) -> Self {
        let [x, y, z] = [t.x.map(f64::from), t.y.map(f64::from), t.z.map(f64::from)];
        let (ux, uy, uz) = (x[1] - x[0], y[1] - y[0], z[1] - z[0]);
        let (vx, vy, vz) = (x[2] - x[0], y[2] - y[0], z[2] - z[0]);
        let area = t.twice_area() as f64;
        let (per_x, per_y) = ((uz * vy - vz * uy) / area, (vz * ux - uz * vx) / area);
        let [low, high] = [f32::min, f32::max].map(|pick: fn(f32, f32) -> f32| pick(pick(t.z[0], t.z[1]), t.z[2]));
        Self { x: x[0], y: y[0], z: z[0], dx: per_x * GRID as f64, per_x, per_y, low, high }
    }

    fn at(&self, x: i64, y: i64) -> f64 {
        self.z + self.per_x * (x as f64 - self.x) + self.per_y * (y as f64 - self.y)
    }
}

/// What a stroke is drawn with. Its bit in a sample's marks is `1 << ink`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ink {
    Fine = 0,
    Bold = 1,
    Dot = 2,
}

/// A line, or with equal ends a dot, in samples.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stroke {
    from: Vec3,
    to: Vec3,
    ink: Ink,
}

/// How much deeper than the surface around it an axis may be, samples: the bottom of a valley.
const BIAS: f32 = 2.0;
/// Slope up to which a line has its full width uphill.
const SLOPE: f32 = 4.0;
/// Ends further than this from the picture's corner, in samples, are too coarse in single precision.
const STROKE_FAR: f64 = 1e6;

impl Stroke {
    /// Where a line is, or `None` if it is too far out.
    pub(super) fn place(from: DVec3, to: DVec3, ink: Ink, view: &View) -> Option<Self> {
        let ends = [from, to].map(|p| view.place(p) * SUPER as f64);
        let near = ends.iter().all(|p| p.is_finite() && p.abs().max_element() <= STROKE_FAR);
        near.then(|| Self { from: ends[0].as_vec3(), to: ends[1].as_vec3(), ink })
    }

    /// Rows of samples that a stroke of this radius may mark.
    fn rows(&self, radius: f32, height: usize) -> Range<usize> {
        reach(self.from.y.min(self.to.y) - radius, self.from.y.max(self.to.y) + radius, height)
    }

    /// Marks the samples of one band of rows.
    fn mark(&self, radius: f32, field: &Field<'_>, first_row: usize, colour: &mut [[u8; 4]]) {
        let rows = self.rows(radius, first_row + colour.len() / field.width);
        let along = self.to - self.from;
        let (flat, start) = (along.truncate(), self.from.truncate());
        let square = flat.length_squared();
        for row in rows.start.max(first_row)..rows.end {
            let y = row as f32 + 0.5;
            // The part of the axis that is within reach of this row.
            let at = |edge: f32| ((edge - self.from.y) / flat.y).clamp(0.0, 1.0);
            let [t0, t1] = if flat.y.abs() > 1e-3 { [y - radius, y + radius].map(at) } else { [0.0, 1.0] };
            let [x0, x1] = [t0, t1].map(|t| self.from.x + t * flat.x);
            for column in reach(x0.min(x1) - radius, x0.max(x1) + radius, field.width) {
                let sample = Vec2::new(column as f32 + 0.5, y);
                let t = if square > 0.0 { ((sample - start).dot(flat) / square).clamp(0.0, 1.0) } else { 0.0 };
                let axis = self.from + t * along;
                let here = (sample - axis.truncate()).length_squared() <= radius * radius
                    && axis.z <= field.depth[row * field.width + column] + BIAS + SLOPE * radius
                    && axis.z <= field.deepest_around(axis) + BIAS;
                if here {
                    colour[(row - first_row) * field.width + column][3] |= 1 << self.ink as u8;
                }
            }
        }
    }
}

/// Samples below `limit` whose middles lie between `low` and `high`.
fn reach(low: f32, high: f32, limit: usize) -> Range<usize> {
    // A negative number becomes 0.
    ((low - 0.5).ceil() as usize).min(limit)..((high + 0.5).floor() as usize).min(limit)
}

/// The surface below the lines.
struct Field<'a> {
    depth: &'a [f32],
    width: usize,
    height: usize,
}

impl Field<'_> {
    fn deepest_around(&self, p: Vec3) -> f32 {
        let near = |v: f32, limit: usize| {
            let at = (v as usize).min(limit - 1);
            at.saturating_sub(1)..(at + 2).min(limit)
        };
        let columns = near(p.x, self.width);
        let rows = near(p.y, self.height).flat_map(|row| &self.depth[row * self.width..][columns.clone()]);
        rows.fold(f32::NEG_INFINITY, |deepest, &z| deepest.max(z))
    }
}

/// Which of these lie in each band of rows.
pub(super) fn by_band(rows: impl Iterator<Item = Range<usize>>, height: usize) -> Vec<Vec<usize>> {
    let mut of_band = vec![Vec::new(); height.div_ceil(BAND)];
    for (i, rows) in rows.enumerate().filter(|(_, rows)| !rows.is_empty()) {
        of_band[rows.start / BAND..=(rows.end - 1) / BAND].iter_mut().for_each(|band| band.push(i));
    }
    of_band
}

/// Marks `all` strokes in the fourth byte of `colour`; `size` in samples.
pub(super) fn draw_strokes(all: &[Stroke], pens: &Pens, size: (usize, usize), depth: &[f32], colour: &mut [[u8; 4]]) {
    let (width, height) = size;
    let radius = |ink: Ink| {
        let width = [pens.fine_width, pens.bold_width, pens.dot_width][ink as usize];
        // A line of no width, or one wider than the picture, is a mistake.
        let half = 0.5 * SUPER as f64 * width;
        if half.is_finite() { half.clamp(0.0, 300.0) as f32 } else { 0.0 }
    };
    let of_band = by_band(all.iter().map(|stroke| stroke.rows(radius(stroke.ink), height)), height);
    let field = Field { depth, width, height };
    colour.par_chunks_mut(BAND * width).zip(of_band).enumerate().for_each(|(band, (colour, here))| {
        for stroke in here.into_iter().map(|i| all[i]) {
            stroke.mark(radius(stroke.ink), &field, band * BAND, colour);
        }
    });
}
