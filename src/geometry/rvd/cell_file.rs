//! RVD pieces as a polygon PLY, written batch by batch.
//!
//! Purpose: double positions, and for each polygon its seed, its facet and a colour by seed, in
//! memory for one batch whatever the mesh.
//! Invariant: what is written is a PLY file once it is finished, and not before. Must not know: where pieces
//! come from, what is written to.

use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::RangeInclusive;

use super::PieceBatch;

/// A file being written. Vertices go behind a header of fixed length, polygons to a second
/// file that is appended at the end, when their numbers are known.
pub struct CellWriter<V, P> {
    vertices: V,
    polygons: P,
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
        Ok(Self { vertices, polygons, vertex_count: 0, polygon_count: 0 })
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
        self.polygons.flush()?;
        self.polygons.seek(SeekFrom::Start(0))?;
        io::copy(&mut self.polygons, &mut self.vertices)?;
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

    use super::*;
    use glam::DVec3;

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
