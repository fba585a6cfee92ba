//! RVD pieces, packed for streaming, and their file.
//!
//! Purpose: the polygons in which cells meet facets, in flat arrays; and a polygon PLY of them, written batch by batch: double
//! positions, and for each polygon its seed, its facet and a colour by seed, in memory for one batch whatever the mesh.
//! Invariant: `offset` has one entry more than `facet` and `seed`; piece i owns the vertices `offset[i]..offset[i + 1]`. A piece
//! has at least three vertices, counter-clockwise as its facet. What is written is a PLY file once it is finished, and not before.
//! Must not know: backends, what pieces are for, what is written to.

use std::io::{self, BufWriter, IntoInnerError, Read, Seek, SeekFrom, Write};
use std::ops::RangeInclusive;

use glam::DVec3;

/// `opposite` value of a polygon edge that lies on edge `e` of the facet (from corner `e` to
/// corner `(e + 1) % 3`): [`FACET_EDGE`]` - e`. Seed indices are always smaller.
pub const FACET_EDGE: u32 = u32::MAX;

/// The facet edge a label stands for, or `None` if it is a seed.
pub fn facet_edge(label: u32) -> Option<usize> {
    (label >= FACET_EDGE - 2).then(|| (FACET_EDGE - label) as usize)
}

/// Pieces of one batch of facets.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PieceBatch {
    /// Facet of each piece, ascending.
    pub facet: Vec<u32>,
    /// Seed of each piece, ascending within a facet.
    pub seed: Vec<u32>,
    /// First vertex of each piece, and the total at the end.
    pub offset: Vec<u32>,
    /// Vertex positions: unit frame from a [`Session`](super::Session), caller's from a [`Diagram`](super::Diagram).
    pub position: Vec<DVec3>,
    /// Density weight at each vertex.
    pub weight: Vec<f64>,
    /// For the edge from each vertex to the next of its piece: the seed across it, or a facet edge ([`facet_edge`]).
    pub opposite: Vec<u32>,
}

impl PieceBatch {
    /// How many pieces there are.
    pub fn len(&self) -> usize {
        self.facet.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.facet.is_empty()
    }

    /// Empties it and keeps the memory.
    pub fn clear(&mut self) {
        self.facet.clear();
        self.seed.clear();
        self.offset.clear();
        self.offset.push(0);
        self.position.clear();
        self.weight.clear();
        self.opposite.clear();
    }

    /// Vertices of piece `i`.
    pub fn vertices(&self, i: usize) -> std::ops::Range<usize> {
        self.offset[i] as usize..self.offset[i + 1] as usize
    }

    /// Gives the pieces of points from number `seeds` on to the seeds that own them.
    pub(super) fn own(&mut self, seeds: u32, owners: &[u32]) {
        if owners.is_empty() {
            return;
        }
        let owner = |seed: &mut u32| {
            if let Some(&owner) = seed.checked_sub(seeds).and_then(|k| owners.get(k as usize)) {
                *seed = owner;
            }
        };
        self.seed.iter_mut().for_each(owner);
        self.opposite.iter_mut().for_each(owner);
        self.sort();
    }

    /// Appends a piece. `vertices` yields (position, weight, opposite).
    pub fn push(&mut self, facet: u32, seed: u32, vertices: impl IntoIterator<Item = (DVec3, f64, u32)>) {
        if self.offset.is_empty() {
            self.offset.push(0);
        }
        self.facet.push(facet);
        self.seed.push(seed);
        for (position, weight, opposite) in vertices {
            self.position.push(position);
            self.weight.push(weight);
            self.opposite.push(opposite);
        }
        self.offset.push(self.position.len() as u32);
    }

    /// Orders the pieces by facet, then by seed.
    pub fn sort(&mut self) {
        let mut order: Vec<usize> = (0..self.len()).collect();
        if !self.facet.is_sorted() {
            order.sort_by_key(|&i| self.facet[i]);
        }
        // Those of one facet are few.
        let of_facet = order.chunk_by_mut(|&i, &j| self.facet[i] == self.facet[j]);
        of_facet.for_each(|pieces| pieces.sort_unstable_by_key(|&i| self.seed[i]));
        if order.is_sorted() {
            return;
        }
        let mut sorted = PieceBatch::default();
        for i in order {
            let vertices = self.vertices(i).map(|v| (self.position[v], self.weight[v], self.opposite[v]));
            sorted.push(self.facet[i], self.seed[i], vertices);
        }
        *self = sorted;
    }

    /// Area of piece `i`, in the units of the positions squared.
    pub fn area(&self, i: usize) -> f64 {
        let p = &self.position[self.vertices(i)];
        let twice = (2..p.len()).fold(DVec3::ZERO, |sum, k| sum + (p[k - 1] - p[0]).cross(p[k] - p[0]));
        0.5 * twice.length()
    }

    /// Appends all pieces of `other`.
    pub fn extend(&mut self, other: &PieceBatch) {
        if self.offset.is_empty() {
            self.offset.push(0);
        }
        let base = self.position.len() as u32;
        self.facet.extend_from_slice(&other.facet);
        self.seed.extend_from_slice(&other.seed);
        self.offset.extend(other.offset.iter().skip(1).map(|o| o + base));
        self.position.extend_from_slice(&other.position);
        self.weight.extend_from_slice(&other.weight);
        self.opposite.extend_from_slice(&other.opposite);
    }
}

/// A file being written: vertices behind a header of fixed length, and polygons in a second file that is appended at the end.
pub struct CellWriter<V, P: Write> {
    vertices: V,
    polygons: BufWriter<P>,
    vertex_count: u64,
    polygon_count: u64,
}

/// Long enough for any counts; the rest is a comment.
const HEADER_BYTES: usize = 512;

/// Readers of PLY expect the length of a list in one byte.
const MOST_CORNERS: usize = 255;

impl<V: Write + Seek, P: Read + Write + Seek> CellWriter<V, P> {
    /// Begins a file in `vertices`, at its start. `polygons` is for the meantime.
    pub fn new(mut vertices: V, polygons: P) -> io::Result<Self> {
        vertices.write_all(&[0; HEADER_BYTES])?;
        Ok(Self { vertices, polygons: BufWriter::new(polygons), vertex_count: 0, polygon_count: 0 })
    }

    /// Adds pieces.
    pub fn append(&mut self, cells: &PieceBatch) -> io::Result<()> {
        for p in &cells.position {
            p.to_array().iter().try_for_each(|x| self.vertices.write_all(&x.to_le_bytes()))?;
        }
        for i in 0..cells.len() {
            // A piece is convex, so a fan of parts is the same piece.
            let vertices = cells.vertices(i);
            let (apex, last) = (vertices.start, vertices.end - 1);
            let mut from = apex + 1;
            loop {
                let to = last.min(from + MOST_CORNERS - 2);
                self.polygon(apex, from..=to, cells.facet[i], cells.seed[i])?;
                if to == last {
                    break;
                }
                from = to;
            }
        }
        self.vertex_count += cells.position.len() as u64;
        Ok(())
    }

    fn polygon(&mut self, apex: usize, rest: RangeInclusive<usize>, facet: u32, seed: u32) -> io::Result<()> {
        self.polygons.write_all(&[(rest.end() - rest.start() + 2) as u8])?;
        for v in std::iter::once(apex).chain(rest) {
            let index = i32::try_from(self.vertex_count + v as u64).map_err(|_| {
                io::Error::new(io::ErrorKind::FileTooLarge, "PLY cannot number more than 2^31 vertices")
            })?;
            self.polygons.write_all(&index.to_le_bytes())?;
        }
        self.polygons.write_all(&seed.to_le_bytes())?;
        self.polygons.write_all(&facet.to_le_bytes())?;
        self.polygons.write_all(&colour(seed))?;
        self.polygon_count += 1;
        Ok(())
    }

    /// Joins the parts. Gives back what was written to; it is to be flushed.
    pub fn finish(mut self) -> io::Result<V> {
        let mut polygons = self.polygons.into_inner().map_err(IntoInnerError::into_error)?;
        polygons.seek(SeekFrom::Start(0))?;
        io::copy(&mut polygons, &mut self.vertices)?;
        self.vertices.seek(SeekFrom::Start(0))?;
        self.vertices.write_all(header(self.vertex_count, self.polygon_count).as_bytes())?;
        Ok(self.vertices)
    }
}

fn header(vertices: u64, polygons: u64) -> String {
    let top = "ply\nformat binary_little_endian 1.0\ncomment pieces of a restricted Voronoi diagram";
    let rest = format!(
        "\nelement vertex {vertices}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {polygons}\nproperty list uchar int vertex_indices\nproperty int seed\n\
         property int facet\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    );
    // Lines of comment, none so long that a reader's line buffer overflows.
    let room = HEADER_BYTES.saturating_sub(top.len() + rest.len());
    let pad: String = "\ncomment ".chars().chain(std::iter::repeat_n('.', 31)).cycle().take(room).collect();
    let cut = pad.rfind('\n').filter(|at| room - at < 10).unwrap_or(room);
    format!("{top}{}{}{rest}", &pad[..cut], ".".repeat(room - cut))
}

/// A colour that neighbours in number do not share: the index, well mixed, never dark.
fn colour(seed: u32) -> [u8; 3] {
    let mut h = seed.wrapping_mul(0x9e37_79b1) ^ 0x85eb_ca6b;
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^= h >> 15;
    [h as u8, (h >> 8) as u8, (h >> 16) as u8].map(|c| 64 + (c >> 1) + (c >> 2))
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use glam::DVec3;

    use super::*;

    fn writer() -> CellWriter<Cursor<Vec<u8>>, Cursor<Vec<u8>>> {
        CellWriter::new(Cursor::default(), Cursor::default()).unwrap()
    }

    #[test]
    fn batches_make_one_file() {
        let mut file = writer();
        let mut batch = PieceBatch::default();
        batch.push(7, 3, [DVec3::X, DVec3::Y, DVec3::Z].map(|p| (p, 1.0, 0)));
        file.append(&batch).unwrap();
        file.append(&batch).unwrap();
        let bytes = file.finish().unwrap().into_inner();
        assert_eq!(bytes.len(), HEADER_BYTES + 6 * 24 + 2 * (1 + 12 + 8 + 3));
        assert!(bytes[..HEADER_BYTES].ends_with(b"end_header\n"));
        let second = &bytes[HEADER_BYTES + 6 * 24 + 24..];
        assert_eq!(second[..13], [3, 3, 0, 0, 0, 4, 0, 0, 0, 5, 0, 0, 0]);
        for digits in 0..19 {
            let text = header(10u64.pow(digits), 1);
            assert_eq!(text.len(), HEADER_BYTES);
            assert!(text.lines().skip(2).all(|l| l.len() < 80 && l.split(' ').next().unwrap().len() > 2), "{text}");
        }
    }

    #[test]
    fn a_piece_of_many_corners_is_a_fan_of_parts() {
        let mut file = writer();
        let mut batch = PieceBatch::default();
        batch.push(0, 0, (0..300).map(|_| (DVec3::X, 1.0, 0)));
        file.append(&batch).unwrap();
        assert_eq!(file.polygon_count, 2);
        let bytes = file.finish().unwrap().into_inner();
        let lists = &bytes[HEADER_BYTES + 300 * 24..];
        assert_eq!((lists[0], lists[1 + 255 * 4 + 11]), (255, 47));
    }
}
