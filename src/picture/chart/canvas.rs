//! The paper that plots are drawn on.
//!
//! Purpose: pixels and letters for plotters. Its own bitmap backend takes fonts from the system, which a server has
//! none of; the letters here come with the program (Noto Sans Mono).
//! Invariant: what lies outside the paper is left out. Must not know: axes, series.

use std::convert::Infallible;

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, RasterizedChar, get_raster, get_raster_width};
use plotters::style::text_anchor::{HPos, VPos};
use plotters_backend::{BackendColor, BackendCoord, BackendTextStyle, DrawingBackend, DrawingErrorKind};

use crate::Rgb;

/// Height of a line of text, pixels.
pub(super) const LETTER: u32 = 32;
const HEIGHT: RasterHeight = RasterHeight::Size32;

/// Pixels, rows from the top.
pub(super) struct Paper<'a> {
    pixels: &'a mut [Rgb],
    size: (u32, u32),
}

impl<'a> Paper<'a> {
    /// `pixels` are width times height.
    pub(super) fn new(pixels: &'a mut [Rgb], size: (u32, u32)) -> Self {
        Self { pixels, size }
    }

    fn blend(&mut self, (x, y): BackendCoord, [r, g, b]: Rgb, alpha: f64) {
        let (width, height) = (i64::from(self.size.0), i64::from(self.size.1));
        let (x, y) = (i64::from(x), i64::from(y));
        if (0..width).contains(&x)
            && (0..height).contains(&y)
            && let Some(pixel) = self.pixels.get_mut((y * width + x) as usize)
        {
            let mix = |below: u8, above: u8| (f64::from(below) + alpha * (f64::from(above) - f64::from(below))).round();
            *pixel = [mix(pixel[0], r) as u8, mix(pixel[1], g) as u8, mix(pixel[2], b) as u8];
        }
    }
}

fn glyph(c: char, weight: FontWeight) -> Option<RasterizedChar> {
    get_raster(c, weight, HEIGHT).or_else(|| get_raster('?', weight, HEIGHT))
}

type Drawn = Result<(), DrawingErrorKind<Infallible>>;

impl DrawingBackend for Paper<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        self.size
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        Ok(())
    }

    fn draw_pixel(&mut self, point: BackendCoord, color: BackendColor) -> Drawn {
        let (r, g, b) = color.rgb;
        self.blend(point, [r, g, b], color.alpha.clamp(0.0, 1.0));
        Ok(())
    }

    fn estimate_text_size<S: BackendTextStyle>(
        &self,
        text: &str,
        _: &S,
    ) -> Result<(u32, u32), DrawingErrorKind<Infallible>> {
        let width = get_raster_width(FontWeight::Regular, HEIGHT);
        Ok(((text.chars().count() * width) as u32, LETTER))
    }

    fn draw_text<S: BackendTextStyle>(&mut self, text: &str, style: &S, pos: BackendCoord) -> Drawn {
        let (width, height) = self.estimate_text_size(text, style)?;
        let dx = match style.anchor().h_pos {
            HPos::Left => 0,
            HPos::Right => -(width as i32),
            HPos::Center => -(width as i32) / 2,
        };
        let dy = match style.anchor().v_pos {
            VPos::Top => 0,
            VPos::Bottom => -(height as i32),
            VPos::Center => -(height as i32) / 2,
        };
        let weight = if style.family().as_str() == "bold" { FontWeight::Bold } else { FontWeight::Regular };
        let (BackendColor { alpha, rgb: (r, g, b) }, turn) = (style.color(), style.transform());
        let mut left = dx;
        for letter in text.chars().filter_map(|c| glyph(c, weight)) {
            for (y, row) in letter.rows().enumerate() {
                for (x, &ink) in row.iter().enumerate().filter(|(_, ink)| **ink > 0) {
                    let (x, y) = turn.transform(left + x as i32, dy + y as i32);
                    self.blend((pos.0 + x, pos.1 + y), [r, g, b], alpha * f64::from(ink) / 255.0);
                }
            }
            left += letter.width() as i32;
        }
        Ok(())
    }
}
