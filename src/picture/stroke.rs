//! Lines and dots on surfaces.
//!
//! Purpose: marks the samples that lie in a line's width and where the surface does not hide it.
//! Invariant: marks do not depend on the order of drawing, so that crossings are no darker than lines.
//! Must not know: colours.
//!
//! A line lies in the surface, so its depth and that of the surface below it differ by rounding, and
//! by the surface's slope over half a sample. A constant bias that allows for a steep slope would
//! let lines through thin walls. Instead the point of the line's axis next to a sample is compared with the
//! deepest of the nine samples around that point: on a slope one of them lies deeper than the line.

use std::ops::Range;

use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::view::View;
use super::{BAND, Pens, SUPER};

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
const FAR: f64 = 1e6;

impl Stroke {
    /// Where a line is, or `None` if it is too far out.
    pub(super) fn place(from: DVec3, to: DVec3, ink: Ink, view: &View) -> Option<Self> {
        let ends = [from, to].map(|p| view.place(p) * SUPER as f64);
        let near = ends.iter().all(|p| p.is_finite() && p.abs().max_element() <= FAR);
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
            let [t0, t1] = match flat.y.abs() > 1e-3 {
                true => [y - radius, y + radius].map(|edge| ((edge - self.from.y) / flat.y).clamp(0.0, 1.0)),
                false => [0.0, 1.0],
            };
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

/// Marks all `strokes` in the fourth byte of `colour`; `size` in samples.
pub(super) fn draw(strokes: &[Stroke], pens: &Pens, size: (usize, usize), depth: &[f32], colour: &mut [[u8; 4]]) {
    let (width, height) = size;
    let radius = |ink: Ink| {
        let width = [pens.fine_width, pens.bold_width, pens.dot_width][ink as usize];
        // A line of no width, or one wider than the picture, is a mistake.
        let half = 0.5 * SUPER as f64 * width;
        if half.is_finite() { half.clamp(0.0, 300.0) as f32 } else { 0.0 }
    };
    let mut of_band = vec![Vec::new(); height.div_ceil(BAND)];
    for (i, stroke) in strokes.iter().enumerate() {
        let rows = stroke.rows(radius(stroke.ink), height);
        if !rows.is_empty() {
            of_band[rows.start / BAND..=(rows.end - 1) / BAND].iter_mut().for_each(|band| band.push(i));
        }
    }
    let field = Field { depth, width, height };
    colour.par_chunks_mut(BAND * width).zip(of_band).enumerate().for_each(|(band, (colour, here))| {
        for stroke in here.into_iter().map(|i| strokes[i]) {
            stroke.mark(radius(stroke.ink), &field, band * BAND, colour);
        }
    });
}
