//! Pictures of surfaces, drawn without a window system and without a GPU.
//!
//! Purpose: [`Canvas`] takes coloured faces, in as many batches as the caller likes, lines that lie on them and dots, and becomes
//! an [`Image`]; [`View`] is where it is seen from; [`draw_mesh`] draws a whole mesh with its edges. `chart` plots figures.
//! Invariant: what is hidden does not show, whatever the order of drawing, and the bytes are the same
//! whatever the number of threads. No coordinates make it panic: a face that cannot be placed is left out.
//! Must not know: seeds, cells, jobs, files other than the picture.
//!
//! Faces go through an own depth buffer. Rasterisers that are kept up draw in two dimensions (tiny-skia,
//! vello_cpu); those with depth have had no release in years (euc) or are one person's beginning
//! (retrofire), work in one thread and know no lines on surfaces. What is needed of one is 200 lines.

#![warn(unreachable_pub)]

pub mod chart;
mod image;
mod raster;
mod surface;
mod view;

use std::path::PathBuf;

use glam::DVec3;
use rayon::prelude::*;

pub use image::{Image, PLAIN, Rgb, distinct, of_quality};
pub use surface::{Paint, SOFT, draw_mesh, shading_normals, spacing};
pub use view::{View, ViewDirection};

use raster::{Ink, Stroke, Triangle};

/// Side of the square of samples that makes a pixel: edges have ten levels.
const SUPER: usize = 3;
/// Sample rows that one task fills.
const BAND: usize = 16 * SUPER;
/// Longest side of a picture, pixels.
pub const MAX_SIDE: u32 = 8192;
/// Most pixels of a picture; each takes 72 bytes while it is drawn.
pub const MAX_PIXELS: u32 = 1 << 24;

/// Width and height of a picture in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// Pixels from left to right.
    pub width: u32,
    /// Pixels from top to bottom.
    pub height: u32,
}

impl Size {
    /// Checks a size.
    pub fn new(width: u32, height: u32) -> Result<Self, PictureError> {
        let sides = 1..=MAX_SIDE;
        let fits = sides.contains(&width) && sides.contains(&height) && width * height <= MAX_PIXELS;
        if fits { Ok(Self { width, height }) } else { Err(PictureError::Size(width, height)) }
    }
}

impl Default for Size {
    fn default() -> Self {
        Self { width: 1600, height: 1200 }
    }
}

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// No such picture can be drawn.
    #[error("{0}x{1} pixels: give sides from 1 to {MAX_SIDE}, and no more than {most} million pixels", most = MAX_PIXELS >> 20)]
    Size(u32, u32),
    /// A direction has no length or is not finite.
    #[error("({}, {}, {}) is no direction; give three finite numbers that are not all 0", .0.x, .0.y, .0.z)]
    Direction(DVec3),
    /// A plot could not be laid out.
    #[error("cannot draw the plot: {0}")]
    Plot(String),
    /// The PNG could not be encoded.
    #[error("cannot encode the picture: {0}")]
    Encode(#[from] png::EncodingError),
    /// The operating system refused.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What it said.
        source: std::io::Error,
    },
}

/// A triangle to draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Corners, caller's units, counter-clockwise seen from the front. The back has another tint.
    pub corners: [DVec3; 3],
    /// Its colour in full light.
    pub colour: Rgb,
    /// Normal to shade it by, of any length, on its front side; its own if not given. See [`shading_normals`].
    pub normal: Option<DVec3>,
}

impl Face {
    /// The triangles of a convex polygon; none if it has fewer than three corners.
    pub fn fan(corners: &[DVec3], colour: Rgb, normal: Option<DVec3>) -> impl Iterator<Item = Self> + '_ {
        corners.windows(2).skip(1).map(move |rest| Self { corners: [corners[0], rest[0], rest[1]], colour, normal })
    }
}

/// How wide and how strong the lines are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pens {
    /// Width of the fine lines, pixels.
    pub fine_width: f64,
    /// How much of what lies below the fine lines cover, 0 to 1.
    pub fine_strength: f64,
    /// Width of the bold lines, pixels.
    pub bold_width: f64,
    /// Diameter of the dots, pixels.
    pub dot_width: f64,
}

impl Pens {
    /// Pens for fine lines that are `spacing` pixels apart on average: below about 14 pixels lines
    /// fade, so that a dense mesh keeps its shading and does not turn black.
    pub fn for_spacing(spacing: f64) -> Self {
        let spacing = if spacing.is_finite() { spacing.max(0.0) } else { 0.0 };
        Self {
            fine_width: (0.09 * spacing).clamp(0.6, 1.5),
            fine_strength: ((spacing - 2.0) / 14.0).clamp(0.1, 0.85),
            bold_width: (0.2 * spacing).clamp(2.0, 3.0),
            dot_width: (0.25 * spacing).clamp(2.0, 6.0),
        }
    }
}

/// A picture being drawn.
///
/// ```
/// use glam::dvec3;
/// use tessera::picture::{Canvas, Face, ViewDirection, Pens, Size, View};
/// let corners = [dvec3(0., 0., 0.), dvec3(1., 0., 0.), dvec3(0., 1., 0.)];
/// let view = View::framing(&ViewDirection::default(), Size::new(64, 48)?, corners)?;
/// let mut canvas = Canvas::new(view);
/// canvas.faces(&[Face { corners, colour: [200, 210, 230], normal: None }]);
/// canvas.line(corners[0], corners[1]);
/// let image = canvas.finish(&Pens::for_spacing(20.0));
/// assert_eq!((image.width(), image.height()), (64, 48));
/// # Ok::<(), tessera::picture::PictureError>(())
/// ```
pub struct Canvas {
    view: View,
    /// Distance of what each sample shows from the viewer, in samples; infinite where it shows nothing.
    depth: Vec<f32>,
    /// Its colour, and in the fourth byte which inks lie on it.
    colour: Vec<[u8; 4]>,
    strokes: Vec<Stroke>,
}

impl Canvas {
    /// An empty canvas.
    pub fn new(view: View) -> Self {
        let (width, height) = samples(view.size());
        let [r, g, b] = image::BACKGROUND;
        Self {
            view,
            depth: vec![f32::INFINITY; width * height],
            colour: vec![[r, g, b, 0]; width * height],
            strokes: Vec::new(),
        }
    }

    /// Draws faces. Those that reach half a million pixels out of the picture are left out.
    pub fn faces(&mut self, faces: &[Face]) {
        let (width, height) = samples(self.view.size());
        let view = &self.view;
        let placed: Vec<Triangle> = faces.par_iter().filter_map(|face| Triangle::place(face, view)).collect();
        let of_band = raster::by_band(placed.iter().map(|triangle| triangle.rows(height)), height);
        let bands = self.depth.par_chunks_mut(BAND * width).zip(self.colour.par_chunks_mut(BAND * width));
        bands.zip(of_band).enumerate().for_each(|(band, ((depth, colour), here))| {
            let mut target = raster::Band { width, first_row: band * BAND, depth, colour };
            here.into_iter().for_each(|i| placed[i].fill(&mut target));
        });
    }

    /// Draws a fine line that lies on faces.
    pub fn line(&mut self, from: DVec3, to: DVec3) {
        self.stroke(from, to, Ink::Fine);
    }

    /// Draws a bold line that lies on faces: a feature or a boundary.
    pub fn bold_line(&mut self, from: DVec3, to: DVec3) {
        self.stroke(from, to, Ink::Bold);
    }

    /// Draws a dot that lies on a face.
    pub fn dot(&mut self, at: DVec3) {
        self.stroke(at, at, Ink::Dot);
    }

    fn stroke(&mut self, from: DVec3, to: DVec3, ink: Ink) {
        self.strokes.extend(Stroke::place(from, to, ink, &self.view));
    }

    /// Draws the lines and dots with `pens` and returns the picture.
    pub fn finish(mut self, pens: &Pens) -> Image {
        let size = samples(self.view.size());
        raster::draw_strokes(&self.strokes, pens, size, &self.depth, &mut self.colour);
        image::resolve(self.view.size(), &self.colour, pens)
    }
}

/// Samples in a row, and rows of samples.
fn samples(size: Size) -> (usize, usize) {
    (size.width as usize * SUPER, size.height as usize * SUPER)
}

#[cfg(test)]
mod tests;
