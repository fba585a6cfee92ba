//! Lists beside a surface, as text: points, an edge length for each vertex, edges that are creases.
//!
//! Purpose: one element a line; empty lines and lines that begin with `#` are left out. What goes by the file's own vertices
//! is brought to those of the surface that was read.
//! Invariant: vertices keep their numbers, except of OBJ, STL and glTF. OBJ vertices are numbered by first use in a face, and the
//! ones that no face uses are left out; their order comes from the reader of the surface. STL has no vertices to speak of, and glTF
//! has them several times. Must not know: what lists are for.

use glam::DVec3;

use super::{DataError, Format, VertexNumbers, unpack, unpacked_limit, without_mark};
use crate::mesh::TriMesh;

/// The lines that say something, numbered from 1.
fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let all = text.lines().enumerate().map(|(i, line)| (i + 1, line.trim()));
    all.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// The beginning of a line, for who has to find it.
fn shown(line: &str) -> String {
    const SHOWN: usize = 60;
    match line.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{:?}...", &line[..end]),
        None => format!("{line:?}"),
    }
}

/// Points, `x y z` a line.
///
/// # Errors
/// `Syntax` with the line; `List` if there is none.
pub fn points(text: &str) -> Result<Vec<DVec3>, DataError> {
    let mut points = Vec::new();
    for (number, line) in lines(text) {
        let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        match numbers.as_deref() {
            Ok([x, y, z]) if x.is_finite() && y.is_finite() && z.is_finite() => points.push(DVec3::new(*x, *y, *z)),
            _ => return Err(syntax(number, format!("not three finite numbers: {}", shown(line)))),
        }
    }
    if points.is_empty() {
        return Err(DataError::List("there are no points".to_owned()));
    }
    Ok(points)
}

fn syntax(line: usize, message: String) -> DataError {
    DataError::Syntax { line, message }
}

/// How the vertices of a file are numbered in the surface that was read from it.
pub struct FileVertices {
    /// How many the file has.
    count: usize,
    /// For each of the surface's vertices its number in the file; `None` if the numbers are the same.
    order: Option<Vec<u32>>,
}

impl FileVertices {
    /// Whether the vertices of such a file have numbers.
    pub fn are_numbered(format: Format) -> bool {
        !matches!(format.codec().vertices, VertexNumbers::Absent)
    }

    /// Whether [`Self::of`] reads the bytes of such a file.
    pub fn needs_bytes(format: Format) -> bool {
        matches!(format.codec().vertices, VertexNumbers::Reordered(_))
    }

    /// Those of `mesh`, which was read from these bytes.
    ///
    /// # Errors
    /// `List` if they cannot be told.
    pub fn of(format: Format, bytes: &[u8], mesh: &TriMesh) -> Result<Self, DataError> {
        let (count, order) = match format.codec().vertices {
            VertexNumbers::Kept => return Ok(Self::of_arrays(mesh)),
            VertexNumbers::Absent => return Err(DataError::List(NO_NUMBERS.to_owned())),
            VertexNumbers::Reordered(order) => order(without_mark(&unpack(bytes, unpacked_limit(bytes.len()))?))?,
        };
        if order.len() != mesh.positions().len() {
            let text = "cannot tell which vertex of the surface is which of the file; convert it to .ply";
            return Err(DataError::List(text.to_owned()));
        }
        Ok(Self { count, order: Some(order) })
    }

    /// Those of a surface that did not come in a file.
    pub fn of_arrays(mesh: &TriMesh) -> Self {
        Self { count: mesh.positions().len(), order: None }
    }

    /// One number above 0 a line for each of the file's vertices; gives one for each of the surface's.
    ///
    /// # Errors
    /// `Syntax` with the line; `List` if there are too few or too many.
    pub fn lengths(&self, text: &str) -> Result<Vec<f64>, DataError> {
        let mut lengths = Vec::new();
        for (number, line) in lines(text) {
            match line.parse::<f64>() {
                Ok(length) if length.is_finite() && length > 0.0 => lengths.push(length),
                _ => return Err(syntax(number, format!("not a finite number above 0: {}", shown(line)))),
            }
        }
        if lengths.len() != self.count {
            let text =
                format!("{} lengths, but the surface has {} vertices; give one for each", lengths.len(), self.count);
            return Err(DataError::List(text));
        }
        Ok(match &self.order {
            Some(order) => order.iter().map(|&v| lengths[v as usize]).collect(),
            None => lengths,
        })
    }

    /// Two of the file's vertices a line, numbered from 0; gives those of the surface.
    ///
    /// # Errors
    /// `Syntax` with the line.
    pub fn edges(&self, text: &str) -> Result<Vec<[u32; 2]>, DataError> {
        // Where the file's vertices are in the surface.
        let place: Option<Vec<Option<u32>>> = self.order.as_ref().map(|order| {
            let mut place = vec![None; self.count];
            order.iter().zip(0..).for_each(|(&v, k)| place[v as usize] = Some(k));
            place
        });
        let mut edges = Vec::new();
        for (number, line) in lines(text) {
            let at = |text: String| syntax(number, text);
            let numbers: Result<Vec<usize>, _> = line.split_whitespace().map(str::parse).collect();
            let Ok(&[a, b]) = numbers.as_deref() else {
                return Err(at(format!("not two numbers of vertices, which begin at 0: {}", shown(line))));
            };
            let vertex = |v: usize| match &place {
                _ if v >= self.count => {
                    Err(at(format!("there is no vertex {v}; the surface has {}, numbered from 0", self.count)))
                }
                Some(place) => place[v].ok_or_else(|| at(format!("no facet has vertex {v}"))),
                None => Ok(v as u32),
            };
            edges.push([vertex(a)?, vertex(b)?]);
        }
        Ok(edges)
    }
}

/// Why a file of STL or glTF has no lists beside it.
pub const NO_NUMBERS: &str = "STL and glTF have no numbered vertices; convert it to .ply, .obj or .off";
