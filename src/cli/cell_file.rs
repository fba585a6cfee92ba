//! RVD pieces as a polygon PLY, written batch by batch.
//!
//! Purpose: double positions, and for each polygon its seed, its facet and a colour by seed, in
//! memory for one batch whatever the mesh.
//! Invariant: the file appears under its name only when it is whole. Must not know: where pieces
//! come from.

use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use anyhow::Result;
use tempfile::NamedTempFile;

use super::exit::NotWritten;
use super::files;
use crate::rvd::PieceBatch;

/// A file being written. Vertices go behind a header of fixed length, polygons to a second
/// file that is appended at the end, when their numbers are known.
pub(crate) struct CellFile {
    path: PathBuf,
    vertices: BufWriter<NamedTempFile>,
    polygons: BufWriter<File>,
    vertex_count: u64,
    polygon_count: u64,
}

/// Long enough for any counts; the rest is a comment.
const HEADER_BYTES: usize = 512;

/// Readers of PLY expect the length of a list in one byte.
const MOST_CORNERS: usize = 255;

impl CellFile {
    /// Begins a file that will be `path`.
    pub(crate) fn create(path: &Path) -> Result<Self> {
        let begin = || {
            let mut vertices = BufWriter::new(files::begin(path)?);
            vertices.write_all(&[0; HEADER_BYTES])?;
            let folder = vertices.get_ref().path().parent().unwrap_or(Path::new("."));
            let polygons = BufWriter::new(tempfile::tempfile_in(folder)?);
            io::Result::Ok((vertices, polygons))
        };
        let (vertices, polygons) = begin().map_err(|e| unwritten(path, &e))?;
        Ok(Self { path: path.to_owned(), vertices, polygons, vertex_count: 0, polygon_count: 0 })
    }

    /// Adds pieces.
    pub(crate) fn append(&mut self, cells: &PieceBatch) -> Result<()> {
        Ok(self.write(cells).map_err(|e| unwritten(&self.path, &e))?)
    }

    fn write(&mut self, cells: &PieceBatch) -> io::Result<()> {
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

    /// Joins the parts and gives the file its name.
    pub(crate) fn finish(self) -> Result<()> {
        let path = self.path.clone();
        Ok(self.join().map_err(|e| unwritten(&path, &e))?)
    }

    fn join(self) -> io::Result<()> {
        let mut polygons = self.polygons.into_inner().map_err(io::IntoInnerError::into_error)?;
        let mut file = self.vertices.into_inner().map_err(io::IntoInnerError::into_error)?;
        polygons.seek(SeekFrom::Start(0))?;
        let mut part = vec![0; 1 << 20];
        loop {
            let n = polygons.read(&mut part)?;
            if n == 0 {
                break;
            }
            file.write_all(&part[..n])?;
        }
        file.seek(SeekFrom::Start(0))?;
        file.write_all(header(self.vertex_count, self.polygon_count).as_bytes())?;
        files::keep(file, &self.path)
    }
}

fn unwritten(path: &Path, error: &io::Error) -> NotWritten {
    NotWritten(format!("cannot write {}: {error}", path.display()))
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
    use super::*;
    use glam::DVec3;

    #[test]
    fn batches_make_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cells.ply");
        let mut file = CellFile::create(&path).unwrap();
        let mut batch = PieceBatch::default();
        batch.push(7, 3, [DVec3::X, DVec3::Y, DVec3::Z].map(|p| (p, 1.0, 0)));
        file.append(&batch).unwrap();
        assert!(!path.exists(), "not before it is whole");
        file.append(&batch).unwrap();
        file.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
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
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("cells.ply");
        let mut file = CellFile::create(&path).unwrap();
        let mut batch = PieceBatch::default();
        batch.push(0, 0, (0..300).map(|_| (DVec3::X, 1.0, 0)));
        file.append(&batch).unwrap();
        assert_eq!(file.polygon_count, 2);
        file.finish().unwrap();
        let lists = &std::fs::read(&path).unwrap()[HEADER_BYTES + 300 * 24..];
        assert_eq!((lists[0], lists[1 + 255 * 4 + 11]), (255, 47));
    }
}
