//! Lists beside a surface, as text: points, an edge length or a metric tensor for each vertex, edges that are creases.
//!
//! Purpose: reads one element a line; empty lines and lines that begin with `#` are left out. Numbers of the file's vertices
//! become those of the surface, in parts that options name too.
//! Invariant: vertices keep their numbers, except in OBJ (numbered by first use in a face, unused ones left out), STL (no vertices) and
//! glTF (a vertex several times). A list takes no more memory than the surface has vertices or edges for, however long the text.
//! Must not know: the use of the lists.

use std::str::FromStr;

use glam::DVec3;

use super::{DataError, Format, VertexNumbers, syntax, unpack, unpacked_limit, without_mark};
use crate::mesh::TriMesh;
use crate::mesh::parts::Part;
use crate::mesh::tensor::Tensor;
use crate::token::Token;

/// Lines with an element, numbered from 1. They end early once the token is stopped.
fn lines<'a>(text: &'a str, token: &'a Token) -> impl Iterator<Item = (usize, &'a str)> {
    let all = text.lines().enumerate().take_while(|(i, _)| token.check_at(*i).is_ok());
    all.map(|(i, line)| (i + 1, line.trim())).filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
}

/// The longest number, bytes: reading one does not check the token.
const MOST_NUMBER_BYTES: usize = 4096;

fn parsed<T: FromStr>(word: &str) -> Option<T> {
    if word.len() > MOST_NUMBER_BYTES { None } else { word.parse().ok() }
}

/// The numbers of a line that has exactly `N`.
fn numbers<T: FromStr + Copy + Default, const N: usize>(line: &str) -> Option<[T; N]> {
    let (mut words, mut numbers) = (line.split_whitespace(), [T::default(); N]);
    for value in &mut numbers {
        *value = parsed(words.next()?)?;
    }
    words.next().is_none().then_some(numbers)
}

/// The beginning of a line, for a message.
fn shown(line: &str) -> String {
    const SHOWN: usize = 60;
    let cut = line.char_indices().nth(SHOWN);
    cut.map_or_else(|| format!("{line:?}"), |(end, _)| format!("{:?}...", &line[..end]))
}

/// Points, `x y z` a line; none is an error. Reading ends after one more than `most`, or once the token is stopped.
pub fn points(text: &str, most: usize, token: &Token) -> Result<Vec<DVec3>, DataError> {
    let mut points = Vec::new();
    for (number, line) in lines(text, token).take(most.saturating_add(1)) {
        match numbers::<f64, 3>(line).map(DVec3::from_array) {
            Some(point) if point.is_finite() => points.push(point),
            _ => return Err(syntax(number, format!("not three finite numbers: {}", shown(line)))),
        }
    }
    if points.is_empty() {
        return Err(DataError::List("there are no points".to_owned()));
    }
    Ok(points)
}

/// Metric tensors, six numbers a line: m11, m12, m22, m13, m23, m33. Reading ends after one more than `most`, or once the token is
/// stopped.
pub fn tensors(text: &str, most: usize, token: &Token) -> Result<Vec<Tensor>, DataError> {
    let tensor = |(number, line)| match numbers::<f64, { Tensor::NUMBERS }>(line) {
        Some(tensor) => Ok(Tensor(tensor)),
        None => Err(syntax(number, format!("not six numbers: {}", shown(line)))),
    };
    lines(text, token).take(most.saturating_add(1)).map(tensor).collect()
}

/// How the vertices of a file are numbered in the surface that was read from it.
pub struct FileVertices {
    count: usize,
    /// For each of the surface's vertices its number in the file; `None` if the numbers are the same.
    order: Option<Vec<u32>>,
}

impl FileVertices {
    /// How many vertices the file has.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether the vertices of such a file have numbers.
    pub fn are_numbered(format: Format) -> bool {
        !matches!(format.codec().vertices, VertexNumbers::Absent)
    }

    /// Whether [`Self::of`] reads the bytes of such a file.
    pub fn needs_bytes(format: Format) -> bool {
        matches!(format.codec().vertices, VertexNumbers::Reordered(_))
    }

    /// The vertices of `mesh`, which was read from these bytes. Fails if their numbers are not known.
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

    /// The vertices of a surface that did not come in a file.
    pub fn of_arrays(mesh: &TriMesh) -> Self {
        Self { count: mesh.positions().len(), order: None }
    }

    /// Reads one number above 0 a line for each of the file's vertices; returns one for each of the surface's. Reading ends early
    /// once the token is stopped. Too few or too many are an error.
    pub fn lengths(&self, text: &str, token: &Token) -> Result<Vec<f64>, DataError> {
        let count = self.count;
        let mut lengths = Vec::with_capacity(count.min(text.len()));
        for (number, line) in lines(text, token) {
            if lengths.len() == count {
                return Err(syntax(number, format!("there are more lengths than the {count} vertices of the surface")));
            }
            match parsed::<f64>(line) {
                Some(length) if length.is_finite() && length > 0.0 => lengths.push(length),
                _ => return Err(syntax(number, format!("not a finite number above 0: {}", shown(line)))),
            }
        }
        if lengths.len() != count {
            let text = format!("{} lengths, but the surface has {count} vertices; give one for each", lengths.len());
            return Err(DataError::List(text));
        }
        Ok(match &self.order {
            Some(order) => order.iter().map(|&v| lengths[v as usize]).collect(),
            None => lengths,
        })
    }

    /// Those of the surface's vertices, of one tensor for each of the file's. Too few or too many are an error.
    pub fn tensors(&self, tensors: Vec<Tensor>) -> Result<Vec<Tensor>, DataError> {
        if tensors.len() != self.count {
            let (given, count) = (tensors.len(), self.count);
            let text = format!("{given} metric tensors, but the surface has {count} vertices; give one for each");
            return Err(DataError::List(text));
        }
        Ok(match &self.order {
            Some(order) => order.iter().map(|&v| tensors[v as usize]).collect(),
            None => tensors,
        })
    }

    /// Reads two of the file's vertices a line, numbered from 0; returns those of the surface, which has this number of facets.
    /// Reading ends early once the token is stopped. The first edge beyond [`most_edges`] is an error.
    pub fn edges(&self, text: &str, facets: usize, token: &Token) -> Result<Vec<[u32; 2]>, DataError> {
        let place = self.places();
        let mut edges = Vec::new();
        for (number, line) in lines(text, token) {
            let at = |text: String| syntax(number, text);
            if edges.len() == most_edges(facets) {
                return Err(at(format!("there are more edges than {facets} facets have")));
            }
            let Some([a, b]) = numbers::<usize, 2>(line) else {
                return Err(at(format!("not two numbers of vertices, which begin at 0: {}", shown(line))));
            };
            let vertex = |v: usize| match &place {
                _ if v >= self.count => {
                    Err(at(format!("there is no vertex {v}; the surface has {}, numbered from 0", self.count)))
                }
                Some(place) if place[v] == u32::MAX => Err(at(format!("no facet has vertex {v}"))),
                Some(place) => Ok(place[v]),
                None => Ok(v as u32),
            };
            edges.push([vertex(a)?, vertex(b)?]);
        }
        Ok(edges)
    }

    /// Gives vertices that parts name by the file's numbers those of the surface. A vertex that the file lacks, or that no facet has, is an
    /// error.
    pub fn renumber(&self, parts: &mut [Part]) -> Result<(), DataError> {
        let Some(place) = self.places() else { return Ok(()) };
        for part in parts {
            if let Part::Vertices(vertices) = part {
                let of = |v: u32| match place.get(v as usize) {
                    Some(&place) if place != u32::MAX => Ok(place),
                    Some(_) => Err(DataError::List(format!("vertices: no facet has vertex {v}"))),
                    None => Err(DataError::List(format!(
                        "vertices: there is no vertex {v}; the surface has {}",
                        self.count
                    ))),
                };
                *vertices = vertices.iter().map(of).collect::<Result<_, _>>()?;
            }
        }
        Ok(())
    }

    /// Where the file's vertices are in the surface; `None` if the numbers are the same.
    fn places(&self) -> Option<Vec<u32>> {
        let order = self.order.as_ref()?;
        let mut places = vec![u32::MAX; self.count];
        order.iter().zip(0..).for_each(|(&v, k)| places[v as usize] = k);
        Some(places)
    }
}

/// The most edges of this number of facets, each as often as facets have it.
pub fn most_edges(facets: usize) -> usize {
    facets.saturating_mul(3)
}

/// The error for lists beside STL or glTF.
pub const NO_NUMBERS: &str = "STL and glTF have no numbered vertices; convert it to .ply, .obj or .off";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn lists_end_where_the_surface_does() {
        let mesh = Shape::Square.build(2);
        let vertices = FileVertices::of_arrays(&mesh);
        let token = Token::default();
        let long = |line: &str| line.repeat(1_000_000);
        let lengths = vertices.lengths(&long("1\n"), &token).unwrap_err();
        assert_eq!(lengths, syntax(5, "there are more lengths than the 4 vertices of the surface".to_owned()));
        let edges = vertices.edges(&long("0 1\n"), 2, &token).unwrap_err();
        assert_eq!(edges, syntax(7, "there are more edges than 2 facets have".to_owned()));
        assert_eq!(points(&long("0 0 1\n"), 9, &token).unwrap().len(), 10);
        // A line of many numbers is not kept either.
        let line = long("1 ");
        assert!(matches!(points(&line, 9, &token), Err(DataError::Syntax { line: 1, .. })));
        assert!(matches!(vertices.edges(&line, 2, &token), Err(DataError::Syntax { line: 1, .. })));
        // A number as long as the text is none.
        assert!(matches!(vertices.lengths(&long("1"), &token), Err(DataError::Syntax { line: 1, .. })));
    }

    #[test]
    fn parts_name_vertices_of_the_file() {
        let vertices = FileVertices { count: 5, order: Some(vec![3, 0, 4]) };
        let renumbered = |text: &str| {
            let mut parts = ["facets:0-2".parse().unwrap(), text.parse().unwrap()];
            vertices.renumber(&mut parts).map(|()| parts.map(|part: Part| part.to_string()))
        };
        assert_eq!(renumbered("vertices:0,4").unwrap(), ["facets:0-2", "vertices:1-2"]);
        assert_eq!(renumbered("vertices:3").unwrap(), ["facets:0-2", "vertices:0"]);
        for (text, says) in [("vertices:1", "no facet has vertex 1"), ("vertices:0,7", "there is no vertex 7")] {
            assert!(renumbered(text).unwrap_err().to_string().contains(says));
        }
    }

    #[test]
    fn a_stopped_token_ends_lists() {
        let token = Token::default();
        token.cancel();
        let vertices = FileVertices::of_arrays(&Shape::Square.build(2));
        assert_eq!(vertices.edges("0 x", 2, &token), Ok(Vec::new()));
        assert!(matches!(vertices.lengths("x", &token), Err(DataError::List(_))));
        // Also inside a long one: nothing after the stop is read.
        let comments = "#\n".repeat(10 * Token::STRIDE) + "x";
        assert!(points(&comments, 9, &token).is_err_and(|error| matches!(error, DataError::List(_))));
    }
}
