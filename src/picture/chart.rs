//! Plots: figures over figures.
//!
//! Purpose: [`Figure`] is panels of named series with axes, [`Figure::draw`] makes a picture of them; plotters lays
//! out and draws on [`Paper`]: its own bitmap backend takes fonts from the system, which a server has none of. The letters here
//! come with the program (Noto Sans Mono).
//! Invariant: no font of the system and no display is needed, and the bytes are the same everywhere. Values that
//! have no place on an axis, and what lies outside the paper, are left out. Must not know: what is plotted.

use std::convert::Infallible;
use std::fmt::Display;
use std::ops::Range;
use std::path::Path;

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, RasterizedChar, get_raster, get_raster_width};
use plotters::chart::ChartContext;
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, VPos};
use plotters_backend::{BackendColor, BackendCoord, BackendTextStyle, DrawingErrorKind};

use super::{Image, PictureError, Rgb, Size};

/// One picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figure {
    /// Above everything.
    pub title: String,
    /// Side by side.
    pub panels: Vec<Panel>,
}

/// One pair of axes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Panel {
    /// Above it; may be empty.
    pub title: String,
    /// From left to right.
    pub x: Axis,
    /// From the bottom to the top.
    pub y: Axis,
    /// Drawn in this order, each in a colour of its own.
    pub series: Vec<Series>,
    /// If there are any: the series are bars, and a point's x is the index of the group that it belongs to.
    pub groups: Vec<String>,
}

/// An axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Axis {
    /// What it measures.
    pub label: String,
    /// Whether its steps are factors. Values that are not above 0 have no place then.
    pub log: bool,
}

impl Axis {
    /// An axis whose steps are sums.
    pub fn linear(label: &str) -> Self {
        Self { label: label.to_owned(), log: false }
    }

    /// An axis whose steps are factors.
    pub fn log(label: &str) -> Self {
        Self { label: label.to_owned(), log: true }
    }
}

/// A line of points, in the order given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Series {
    /// In the legend.
    pub name: String,
    /// (x, y).
    pub points: Vec<(f64, f64)>,
}

/// Colours that most people can tell apart, also in grey (Okabe and Ito's, without yellow).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(90, 90, 90),
];

/// Pixels of the paper per pixel of the picture: edges have four levels.
const SCALE: u32 = 2;
/// Height of letters on the paper, pixels.
const TEXT: u32 = 32;
const HEIGHT: RasterHeight = RasterHeight::Size32;

type Area<'a> = DrawingArea<Paper<'a>, Shift>;

fn failed(error: impl Display) -> PictureError {
    PictureError::Plot(error.to_string())
}

impl Figure {
    /// Draws it into a PNG file.
    pub fn write(&self, size: Size, path: &Path) -> Result<(), PictureError> {
        self.draw(size)?.write(path)
    }

    /// Draws it.
    pub fn draw(&self, size: Size) -> Result<Image, PictureError> {
        let (width, height) = (size.width * SCALE, size.height * SCALE);
        let mut pixels = vec![[255; 3]; width as usize * height as usize];
        {
            let root = Paper { pixels: &mut pixels, size: (width, height) }.into_drawing_area();
            let area = root.titled(&self.title, ("bold", TEXT)).map_err(failed)?;
            for (panel, part) in self.panels.iter().zip(area.split_evenly((1, self.panels.len().max(1)))) {
                panel.draw(&part)?;
            }
            root.present().map_err(failed)?;
        }
        Ok(Image::shrunk(size, &pixels, SCALE as usize))
    }
}

impl Panel {
    fn placed<'a>(&'a self, series: &'a Series) -> impl Iterator<Item = (f64, f64)> + 'a {
        let fits = |axis: &Axis, v: f64| v.is_finite() && (!axis.log || v > 0.0);
        series.points.iter().copied().filter(move |&(x, y)| fits(&self.x, x) && fits(&self.y, y))
    }

    /// From the least to the most that is placed, with room for the legend above. Linear axes of heights begin at 0.
    fn ranges(&self) -> (Range<f64>, Range<f64>) {
        let all: Vec<(f64, f64)> = self.series.iter().flat_map(|s| self.placed(s)).collect();
        let ends = |of: fn(&(f64, f64)) -> f64| {
            let ends = (f64::INFINITY, f64::NEG_INFINITY);
            let (low, high) = all.iter().map(of).fold(ends, |(low, high), v| (low.min(v), high.max(v)));
            if low <= high { (low, high) } else { (0.1, 1.0) }
        };
        let (low, high) = ends(|p| p.0);
        let x = match (self.groups.len(), self.x.log) {
            (0, true) => factors(low, high),
            (0, false) => {
                let room = 0.04 * (high - low).max(0.1 * high.abs()).max(1e-9);
                low - room..high + room
            }
            (groups, _) => -0.5..groups as f64 - 0.5,
        };
        let (low, high) = ends(|p| p.1);
        // A line of the legend takes about a twenty-fifth of the height.
        let taken = (0.04 * (self.series.len() + 1) as f64).min(0.5);
        let y = if self.y.log {
            let Range { start, end } = factors(low, high);
            start..end * (end / start).powf(taken / (1.0 - taken))
        } else {
            0.0..(high / (1.0 - taken)).max(f64::MIN_POSITIVE)
        };
        (x, y)
    }

    fn draw(&self, area: &Area<'_>) -> Result<(), PictureError> {
        let (x, y) = self.ranges();
        let floor = y.start;
        let mut builder = ChartBuilder::on(area);
        builder.margin(TEXT).x_label_area_size(3 * TEXT).y_label_area_size(4 * TEXT);
        if !self.title.is_empty() {
            builder.caption(&self.title, ("regular", TEXT));
        }
        match (self.x.log, self.y.log) {
            (false, false) => self.fill(&mut builder.build_cartesian_2d(x, y).map_err(failed)?, floor),
            (false, true) => self.fill(&mut builder.build_cartesian_2d(x, y.log_scale()).map_err(failed)?, floor),
            (true, false) => self.fill(&mut builder.build_cartesian_2d(x.log_scale(), y).map_err(failed)?, floor),
            (true, true) => {
                self.fill(&mut builder.build_cartesian_2d(x.log_scale(), y.log_scale()).map_err(failed)?, floor)
            }
        }
    }

    fn fill<'a, 'p: 'a, X, Y>(
        &self,
        chart: &mut ChartContext<'a, Paper<'p>, Cartesian2d<X, Y>>,
        floor: f64,
    ) -> Result<(), PictureError>
    where
        X: Ranged<ValueType = f64> + ValueFormatter<f64>,
        Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let group = |x: &f64| match (self.groups.is_empty(), x.fract() == 0.0 && *x >= 0.0) {
            (true, _) => tick(*x),
            (false, true) => self.groups.get(*x as usize).cloned().unwrap_or_default(),
            (false, false) => String::new(),
        };
        let mut mesh = chart.configure_mesh();
        mesh.label_style(("regular", TEXT)).axis_desc_style(("regular", TEXT));
        mesh.x_desc(&self.x.label).y_desc(&self.y.label).x_label_formatter(&group).y_label_formatter(&|y| tick(*y));
        mesh.light_line_style(RGBColor(244, 244, 244)).bold_line_style(RGBColor(214, 214, 214));
        mesh.axis_style(BLACK.stroke_width(SCALE))
            .x_labels(if self.groups.is_empty() { 8 } else { self.groups.len() + 1 })
            .y_labels(8);
        if !self.groups.is_empty() {
            mesh.disable_x_mesh();
        }
        mesh.draw().map_err(failed)?;
        for (k, series) in self.series.iter().enumerate() {
            let colour = COLOURS[k % COLOURS.len()];
            let points: Vec<(f64, f64)> = self.placed(series).collect();
            let anno = if self.groups.is_empty() {
                let dots = points.iter().map(|&p| Circle::new(p, 3 * SCALE, colour.filled()));
                chart.draw_series(dots).map_err(failed)?;
                chart.draw_series(LineSeries::new(points, colour.stroke_width(2 * SCALE))).map_err(failed)?
            } else {
                let width = 0.8 / self.series.len() as f64;
                let bar = |&(x, y): &(f64, f64)| {
                    let left = x - 0.4 + width * k as f64;
                    Rectangle::new([(left, floor), (left + 0.92 * width, y)], colour.filled())
                };
                chart.draw_series(points.iter().map(bar)).map_err(failed)?
            };
            let sample = move |(x, y): (i32, i32)| {
                let half = SCALE as i32 * 3;
                Rectangle::new([(x, y - half), (x + 4 * half, y + half)], colour.filled())
            };
            anno.label(&series.name).legend(sample);
        }
        let mut legend = chart.configure_series_labels();
        legend.position(SeriesLabelPosition::UpperLeft).margin(TEXT / 2).label_font(("regular", TEXT));
        legend.legend_area_size(TEXT).background_style(WHITE.mix(0.85)).border_style(RGBColor(160, 160, 160));
        legend.draw().map_err(failed)
    }
}

/// Ends of an axis of factors: a little room, and two powers of ten at least, which are what is labelled.
fn factors(low: f64, high: f64) -> Range<f64> {
    let (start, end) = (low / 1.6, high * 1.6);
    let powers = end.log10().floor() - start.log10().ceil() + 1.0;
    if powers >= 2.0 {
        return start..end;
    }
    let (floor, ceil) = (10f64.powf(start.log10().floor()), 10f64.powf(end.log10().ceil()));
    floor / 1.1..ceil * 1.1
}

/// A number as short as it goes.
fn tick(v: f64) -> String {
    let (number, unit) = match v.abs() {
        a if a >= 1e9 => (v / 1e9, "G"),
        a if a >= 1e6 => (v / 1e6, "M"),
        a if a >= 1e4 => (v / 1e3, "k"),
        _ => (v, ""),
    };
    let text = format!("{number:.4}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    match text {
        "0" | "-0" if v != 0.0 => format!("{v:.0e}"),
        "-0" => "0".to_owned(),
        text => format!("{text}{unit}"),
    }
}

/// Pixels, rows from the top: width times height.
struct Paper<'a> {
    pixels: &'a mut [Rgb],
    size: (u32, u32),
}

impl Paper<'_> {
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
        Ok(((text.chars().count() * width) as u32, TEXT))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn colours(image: &Image) -> Vec<[u8; 3]> {
        let mut all: Vec<[u8; 3]> =
            (0..image.height()).flat_map(|y| (0..image.width()).filter_map(move |x| image.pixel(x, y))).collect();
        all.sort_unstable();
        all.dedup();
        all
    }

    fn figure(log: bool, groups: usize) -> Figure {
        let line = |name: &str, by: f64| Series {
            name: name.to_owned(),
            points: (0..3)
                .map(|k| (f64::from(k), by * 10f64.powi(k)))
                .chain([(1.0, f64::NAN), (f64::INFINITY, 1.0)])
                .collect(),
        };
        let axis = |label: &str| Axis { label: label.to_owned(), log };
        let panel = Panel {
            title: "panel".to_owned(),
            x: Axis { log: log && groups == 0, ..axis("points") },
            y: axis("ms"),
            series: vec![line("gpu", 0.2), line("serial", 3.0)],
            groups: (0..groups).map(|k| format!("group {k}")).collect(),
        };
        Figure { title: "figure".to_owned(), panels: vec![panel.clone(), panel] }
    }

    #[test]
    fn lines_and_bars_are_there_in_their_colours() {
        for (log, groups) in [(false, 0), (true, 0), (false, 3), (true, 3)] {
            let image = figure(log, groups).draw(Size::new(800, 400).unwrap()).unwrap();
            let all = colours(&image);
            for RGBColor(r, g, b) in &COLOURS[..2] {
                assert!(all.contains(&[*r, *g, *b]), "log {log}, {groups} groups: no {r} {g} {b}");
            }
            assert!(all.contains(&[255; 3]) && all.contains(&[0; 3]), "log {log}, {groups} groups");
            assert_eq!(image, figure(log, groups).draw(Size::new(800, 400).unwrap()).unwrap());
        }
    }

    #[test]
    fn what_has_no_points_and_what_is_tiny_make_no_panic() {
        let empty = Figure { panels: vec![Panel::default()], ..Figure::default() };
        for size in [(1, 1), (20, 20), (100, 60), (640, 400)] {
            let size = Size::new(size.0, size.1).unwrap();
            let _ = (empty.draw(size), figure(true, 0).draw(size), Figure::default().draw(size));
        }
        let one = Series { name: String::new(), points: vec![(5.0, 0.0)] };
        let panel = Panel { series: vec![one], ..Panel::default() };
        assert!(Figure { panels: vec![panel], ..Figure::default() }.draw(Size::default()).is_ok());
    }

    #[test]
    fn ticks_are_short() {
        let wanted = [(0.0, "0"), (1e6, "1M"), (20_000.0, "20k"), (1500.0, "1500"), (0.1, "0.1"), (1e-7, "1e-7")];
        for (v, text) in wanted {
            assert_eq!(tick(v), text);
        }
    }
}
