//! `--picture`: the result as a PNG.
//!
//! Purpose: options to a view, a remesh or pieces to faces and lines. Invariant: a wrong option is
//! refused before any work. Must not know: how a picture is drawn.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use glam::DVec3;

use super::exit::Usage;
use super::files;
use super::given::{Words, words};
use geometry::mesh::TriMesh;
use geometry::mesh::closest_point::ClosestPoint;
use geometry::mesh::regions::Regions;
use geometry::rvd::PieceBatch;
use geometry::rvd::cells::facet_edge;
use picture::{Canvas, Face, PLAIN, Paint, Pens, Size, View, ViewDirection};
use picture::{distinct, draw_mesh, shading_normals, spacing};

#[derive(Args, Clone, Debug)]
pub(crate) struct PictureArgs {
    /// Draw the result there, as a PNG; needs no display.
    #[arg(long, value_name = "FILE.png")]
    pub(crate) picture: Option<PathBuf>,
    /// Pixels of the picture.
    #[arg(long, value_name = "WIDTHxHEIGHT", default_value = "1600x1200", value_parser = size, requires = "picture")]
    picture_size: Size,
    /// Where the picture is seen from: the direction from the surface to the viewer.
    #[arg(long, value_name = "X,Y,Z", default_value = "0.7,0.5,1", value_parser = direction, requires = "picture",
        allow_hyphen_values = true)]
    view: DVec3,
    /// What is up in the picture.
    #[arg(long, value_name = "X,Y,Z", default_value = "0,1,0", value_parser = direction, requires = "picture",
        allow_hyphen_values = true)]
    up: DVec3,
    /// Meaning of the colours [default: plain for a remesh, cell for a diagram].
    #[arg(long, alias = "color", value_parser = words(COLOURS), requires = "picture")]
    colour: Option<Paint>,
}

const COLOURS: Words<Paint> = &[
    ("plain", "Nothing", Paint::Plain),
    ("quality", "The quality of each triangle, red to blue-grey", Paint::Quality),
    ("cell", "The cell: in a remesh, what lies nearest to each vertex", Paint::Cell),
    ("region", "The region of each triangle; plain without regions", Paint::Region),
];

fn size(text: &str) -> Result<Size, String> {
    let (width, height) = text.split_once(['x', 'X', '×']).ok_or("give it as 1600x1200")?;
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| format!("\"{text}\" is no number of pixels"));
    Size::new(number(width)?, number(height)?).map_err(|e| e.to_string())
}

fn direction(text: &str) -> Result<DVec3, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match numbers.as_deref() {
        Ok(&[x, y, z]) if [x, y, z].iter().all(|c| c.is_finite()) && [x, y, z] != [0.0; 3] => Ok(DVec3::new(x, y, z)),
        _ => Err("give three finite numbers that are not all 0, as 0.7,0.5,1".to_owned()),
    }
}

impl PictureArgs {
    /// Refuses a name that does not end in .png and a folder that is not there.
    pub(crate) fn check(&self) -> Result<()> {
        self.picture.iter().try_for_each(|path| files::check_output(path, &["png"]))
    }

    /// As [`Self::check`], for a diagram, which has no triangles.
    pub(crate) fn check_for_cells(&self) -> Result<()> {
        if matches!(self.colour, Some(Paint::Quality | Paint::Region)) {
            let text = "--colour quality and region are for a remesh; the pieces of a diagram have plain or cell";
            return Err(Usage(text.to_owned()).into());
        }
        self.check()
    }

    /// Whether the picture has regions.
    pub(crate) fn wants_regions(&self) -> bool {
        self.picture.is_some() && self.colour == Some(Paint::Region)
    }

    /// Draws a remesh, with bold lines for edges on curves that it keeps, if that is wanted.
    pub(crate) fn draw(&self, mesh: &TriMesh, regions: Option<&Regions>, curves: &[[u32; 2]]) -> Result<()> {
        let Some(path) = &self.picture else { return Ok(()) };
        let lines: Vec<[DVec3; 2]> = curves.iter().map(|e| e.map(|v| mesh.positions()[v as usize])).collect();
        let surface = (mesh, regions.map(Regions::of_facet));
        Ok(draw_mesh(surface, self.view_of(mesh)?, self.colour.unwrap_or_default(), &lines).write(path)?)
    }

    /// Begins the picture of a diagram of `seeds` seeds, if that is wanted.
    pub(crate) fn begin(&self, mesh: &TriMesh, seeds: usize, dots: bool) -> Result<Option<CellPicture>> {
        let Some(path) = &self.picture else { return Ok(None) };
        let view = self.view_of(mesh)?;
        Ok(Some(CellPicture {
            path: path.clone(),
            pens: Pens::for_spacing(spacing(mesh, &view, seeds)),
            canvas: Canvas::new(view),
            normals: shading_normals(mesh),
            dots: dots.then(|| ClosestPoint::new(mesh)),
            plain: self.colour == Some(Paint::Plain),
            faces: Vec::new(),
        }))
    }

    fn view_of(&self, mesh: &TriMesh) -> Result<View> {
        let look = ViewDirection { toward: self.view, up: self.up };
        let used = mesh.facets().iter().flatten().map(|&v| mesh.positions()[v as usize]);
        View::framing(&look, self.picture_size, used).context("--view, --up")
    }
}

/// The picture of a diagram, drawn batch by batch: memory for the pixels, and for the lines between cells.
pub(crate) struct CellPicture {
    path: PathBuf,
    pens: Pens,
    canvas: Canvas,
    normals: Vec<DVec3>,
    dots: Option<ClosestPoint>,
    plain: bool,
    faces: Vec<Face>,
}

impl CellPicture {
    /// Draws pieces, positions in the caller's coordinates.
    pub(crate) fn append(&mut self, cells: &PieceBatch) {
        self.faces.clear();
        for i in 0..cells.len() {
            let (seed, corners) = (cells.seed[i], &cells.position[cells.vertices(i)]);
            let colour = if self.plain { PLAIN } else { distinct(seed) };
            let normal = self.normals.get(cells.facet[i] as usize).copied();
            self.faces.extend(Face::fan(corners, colour, normal));
            for (k, &across) in cells.opposite[cells.vertices(i)].iter().enumerate() {
                // The piece across has the same edge.
                if facet_edge(across).is_none() && seed < across {
                    self.canvas.line(corners[k], corners[(k + 1) % corners.len()]);
                }
            }
        }
        self.canvas.faces(&self.faces);
    }

    /// Draws the lines, and the dots of `seeds` where they were wanted, and writes the file.
    pub(crate) fn finish(mut self, seeds: &[DVec3]) -> Result<()> {
        if let Some(surface) = &self.dots {
            seeds.iter().for_each(|&seed| self.canvas.dot(surface.project(seed).position));
        }
        Ok(self.canvas.finish(&self.pens).write(&self.path)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_and_directions_are_read() {
        assert_eq!(size("640x480"), Ok(Size { width: 640, height: 480 }));
        assert_eq!(direction("-1, 0,2.5"), Ok(DVec3::new(-1.0, 0.0, 2.5)));
        for bad in ["", "640", "640x", "0x480", "640x480x2", "9000x10", "8192x8192", "-1x5"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        for bad in ["", "1,2", "1,2,3,4", "0,0,0", "nan,0,1", "1,inf,0", "x,y,z"] {
            assert!(direction(bad).is_err(), "{bad}");
        }
    }
}
