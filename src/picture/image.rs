//! The finished picture.
//!
//! Purpose: samples to pixels, pixels to PNG. Invariant: 8-bit sRGB, rows from the top, opaque.
//! Must not know: what is in the picture.

use std::path::Path;

use rayon::prelude::*;

use super::colour::{INKS, Rgb, mix};
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
        let mean = |(x, y): (usize, usize)| {
            let block = (0..by * by).map(|k| pixels[(y * by + k / by) * width * by + x * by + k % by]);
            let sum = block.fold([0; 3], |sum, c| [0, 1, 2].map(|i| sum[i] + u32::from(c[i])));
            let count = (by * by) as u32;
            sum.map(|s| ((s + count / 2) / count) as u8)
        };
        let pixels = (0..width * height).map(|k| mean((k % width, k / width))).collect();
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
            let sum = block.map(inked).fold([0; 3], |sum, c| [0, 1, 2].map(|i| sum[i] + u32::from(c[i])));
            let count = (SUPER * SUPER) as u32;
            *pixel = sum.map(|s| ((s + count / 2) / count) as u8);
        }
    });
    Image { size, pixels }
}
