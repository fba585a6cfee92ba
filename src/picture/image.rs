//! The finished picture: samples to pixels, pixels to PNG; its colours and light.
//!
//! Purpose: [`Image`], base colours of faces, and what light makes of them. Invariant: 8-bit sRGB, rows from the top, opaque; a
//! colour is a function of its arguments alone. Must not know: what is in the picture.

use std::path::Path;

use glam::{DVec3, dvec3};
use rayon::prelude::*;

use super::{Pens, PictureError, SUPER, Size};

/// A picture in memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    size: Size,
    pixels: Vec<Rgb>,
}

impl Image {
    /// Pixels in a row.
    pub fn width(&self) -> u32 {
        self.size.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.size.height
    }

    /// The colour of a pixel, counted from the left and the top; `None` outside.
    pub fn pixel(&self, x: u32, y: u32) -> Option<Rgb> {
        let inside = x < self.size.width && y < self.size.height;
        inside.then(|| self.pixels[y as usize * self.size.width as usize + x as usize])
    }

    /// From `by` times as many pixels in each direction, rows from the top: the mean of each square.
    pub(super) fn shrunk(size: Size, pixels: &[Rgb], by: usize) -> Self {
        let (width, height) = (size.width as usize, size.height as usize);
        let pixel = |(x, y): (usize, usize)| {
            let block = (0..by * by).map(|k| pixels[(y * by + k / by) * width * by + x * by + k % by]);
            mean(block, by * by)
        };
        let pixels = (0..width * height).map(|k| pixel((k % width, k / width))).collect();
        Self { size, pixels }
    }

    /// The picture as the bytes of a PNG file.
    pub fn to_png(&self) -> Result<Vec<u8>, PictureError> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.size.width, self.size.height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(self.pixels.as_flattened())?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Writes the picture to a PNG file.
    pub fn write(&self, path: &Path) -> Result<(), PictureError> {
        let bytes = self.to_png()?;
        std::fs::write(path, bytes).map_err(|source| PictureError::Write { path: path.to_owned(), source })
    }
}

fn mean(colours: impl Iterator<Item = Rgb>, count: usize) -> Rgb {
    let sum = colours.fold([0; 3], |sum, c| [0, 1, 2].map(|i| sum[i] + u32::from(c[i])));
    sum.map(|s| ((s + count as u32 / 2) / count as u32) as u8)
}

/// The mean of each pixel's samples, with the inks that lie on them.
pub(super) fn resolve(size: Size, samples: &[[u8; 4]], pens: &Pens) -> Image {
    let width = size.width as usize;
    let strength = [if pens.fine_strength.is_finite() { pens.fine_strength.clamp(0.0, 1.0) } else { 1.0 }, 1.0, 1.0];
    let inked = |&[r, g, b, marks]: &[u8; 4]| {
        let inks = (0..INKS.len()).filter(|ink| marks & (1 << ink) != 0);
        inks.fold([r, g, b], |below, ink| mix(below, INKS[ink], strength[ink]))
    };
    let mut pixels = vec![[0; 3]; width * size.height as usize];
    pixels.par_chunks_mut(width).zip(samples.par_chunks(width * SUPER * SUPER)).for_each(|(row, samples)| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let lines = samples.chunks(width * SUPER);
            let block = lines.flat_map(|line| &line[x * SUPER..(x + 1) * SUPER]);
            *pixel = mean(block.map(inked), SUPER * SUPER);
        }
    });
    Image { size, pixels }
}

/// Red, green and blue, sRGB.
pub type Rgb = [u8; 3];

pub(super) const BACKGROUND: Rgb = [255, 255, 255];
/// Base colour of a surface that has none of its own.
pub const PLAIN: Rgb = [190, 205, 224];
/// Inks: fine lines, bold lines, dots.
const INKS: [Rgb; 3] = [[34, 38, 48], [12, 12, 16], [20, 20, 24]];
/// The tint of back faces, which should not be seen on a closed surface: brick.
const BACK: Rgb = [176, 78, 56];

/// From the worst triangle to the best: red, orange, straw, pale green, blue-grey. Orange and blue differ with any colour vision.
const QUALITY: [(f64, Rgb); 5] = [
    (0.0, [158, 16, 48]),
    (0.5, [232, 104, 48]),
    (0.75, [248, 202, 110]),
    (0.9, [208, 224, 176]),
    (1.0, [126, 176, 212]),
];

/// The colour of a triangle of quality `q`, 0 (no area) to 1 (equilateral).
pub fn of_quality(q: f64) -> Rgb {
    let q = if q.is_nan() { 0.0 } else { q.clamp(0.0, 1.0) };
    let above = QUALITY.iter().position(|stop| q <= stop.0).unwrap_or(QUALITY.len() - 1).max(1);
    let ((q0, low), (q1, high)) = (QUALITY[above - 1], QUALITY[above]);
    mix(low, high, (q - q0) / (q1 - q0))
}

/// The colour of item `index` where neighbours should differ: hues a golden angle apart, lightness and
/// saturation by a hash; never so dark that lines are lost on it.
pub fn distinct(index: u32) -> Rgb {
    let hash = (index ^ (index >> 15)).wrapping_mul(0x2c1b_3c6d);
    let hash = (hash ^ (hash >> 12)).wrapping_mul(0x297a_2d39);
    let hash = hash ^ (hash >> 15);
    let hue = (f64::from(index) * 0.618_033_988_749_895).fract() * 6.0;
    let (pale, light) = (f64::from(hash & 0xff) / 255.0, f64::from((hash >> 8) & 0xff) / 255.0);
    let (low, high) = (0.42 + 0.3 * pale, 0.88 + 0.12 * light);
    // Each channel is a trapezium around its third of the circle of hues.
    let channel = |at: f64| {
        let distance = (hue - at).abs().min(6.0 - (hue - at).abs());
        let share = (2.0 - distance).clamp(0.0, 1.0);
        (255.0 * high * (low + (1.0 - low) * share)).round() as u8
    };
    [channel(0.0), channel(2.0), channel(4.0)]
}

/// `base` in the light of two lamps beside the viewer. `normal` points right, up and toward the viewer
/// and need not have a length of 1; `back` says that it is the back that is seen.
pub(super) fn lit(base: Rgb, normal: DVec3, back: bool) -> Rgb {
    let base = if back { mix(base, BACK, 0.75) } else { base };
    let normal = (normal / normal.abs().max_element()).try_normalize().unwrap_or(DVec3::Z);
    let lamp = |toward: DVec3| normal.dot(toward.normalize()).max(0.0);
    let light = 0.42 + 0.56 * lamp(dvec3(-0.35, 0.6, 0.8)) + 0.16 * lamp(dvec3(0.9, 0.0, 0.5));
    base.map(|c| (f64::from(c) * light).min(255.0).round() as u8)
}

/// `share` of `b` in `a`.
pub(super) fn mix(a: Rgb, b: Rgb, share: f64) -> Rgb {
    std::array::from_fn(|i| (f64::from(a[i]) + share * (f64::from(b[i]) - f64::from(a[i]))).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quality_goes_from_stop_to_stop() {
        assert_eq!([0.0, 0.5, 1.0].map(of_quality), [QUALITY[0].1, QUALITY[1].1, QUALITY[4].1]);
        assert_eq!([-1.0, f64::NAN, 7.0].map(of_quality), [QUALITY[0].1, QUALITY[0].1, QUALITY[4].1]);
    }

    #[test]
    fn distinct_colours_are_light_and_differ() {
        let colours: Vec<Rgb> = (0..1000).chain([u32::MAX]).map(distinct).collect();
        assert!(colours.iter().all(|c| c.iter().any(|&x| x > 200)));
        let mut sorted = colours.clone();
        sorted.sort_unstable();
        sorted.dedup();
        assert!(sorted.len() > 990, "{}", sorted.len());
    }

    #[test]
    fn light_needs_a_direction_but_no_length() {
        let up = lit(PLAIN, dvec3(0.0, 1.0, 1.0), false);
        assert_eq!(lit(PLAIN, dvec3(0.0, 1e300, 1e300), false), up);
        assert_eq!(lit(PLAIN, DVec3::ZERO, false), lit(PLAIN, DVec3::Z, false));
        assert!(lit(PLAIN, dvec3(0.0, -1.0, 0.1), false) < up, "from below it is darker");
        assert_ne!(lit(PLAIN, DVec3::Z, true), lit(PLAIN, DVec3::Z, false));
    }
}
