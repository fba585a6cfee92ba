//! The surfaces of a load, ready to be sent.
//!
//! Invariant: what a call sends is made before it is timed, but for the comment that makes a file one of a kind.
//! Must not know: connections.

use std::path::PathBuf;

use anyhow::Result;
use bytes::Bytes;

use super::amounts::{Points, Sizes};
use crate::exit::BadInput;
use crate::files;
use geometry::mesh::TriMesh;
use geometry::mesh::io::{Format, encode};
use geometry::mesh::shapes::Shape;
use wire::chunks::{facet_chunks, point_chunks};
use wire::counts::mesh_header;
use wire::pieces::Hash;
use wire::proto::{ArrayKind, Chunk, MeshHeader};

/// How many surfaces a distribution of sizes becomes.
const SURFACES: usize = 16;

/// Those of the files, or of a shape if there are none.
pub(super) fn build(paths: &[PathBuf], shape: Shape, sizes: Sizes, points: Points) -> Result<Vec<Surface>> {
    let of = |mesh: &TriMesh| Surface::of(mesh, points.of(mesh.facets().len()));
    if !paths.is_empty() {
        return paths.iter().map(|path| of(&files::read_mesh(path)?)).collect();
    }
    // The middle of each sixteenth: all sizes are there whatever the seed is.
    let at = |k: usize| (k as f64 + 0.5) / SURFACES as f64;
    let count = if sizes.is_one() { 1 } else { SURFACES };
    (0..count).map(|k| of(&shape.build(sizes.at(at(k))))).collect()
}

#[derive(Debug)]
pub(super) struct Surface {
    pub(super) facets: u64,
    pub(super) points: u64,
    pub(super) header: MeshHeader,
    pub(super) chunks: Vec<Chunk>,
    pub(super) file: Bytes,
    pub(super) digest: String,
}

/// The first line of a PLY file; a comment may follow the second.
const FORMAT: &[u8] = b"ply\n";

impl Surface {
    fn of(mesh: &TriMesh, points: u64) -> Result<Self> {
        let positions = point_chunks(ArrayKind::Positions, mesh.positions());
        let chunks = positions.chain(facet_chunks(ArrayKind::Facets, mesh.facets())).collect();
        let file =
            encode(Format::Ply, mesh).map_err(|cause| BadInput(format!("the surface cannot be sent: {cause}")))?;
        let digest = digest(&file);
        let header = mesh_header(mesh);
        Ok(Self { facets: mesh.facets().len() as u64, points, header, chunks, file: file.into(), digest })
    }

    /// How many points are asked for, as messages count.
    pub(super) fn points(&self) -> Option<u32> {
        Some(u32::try_from(self.points).unwrap_or(u32::MAX))
    }

    /// Its file with a comment, and the digest of that: no server has it yet.
    pub(super) fn file_with(&self, comment: &str) -> (Bytes, String) {
        let second = self.file[FORMAT.len()..].iter().position(|byte| *byte == b'\n').unwrap_or_default();
        let (head, rest) = self.file.split_at(FORMAT.len() + second + 1);
        let file = [head, b"comment ", comment.as_bytes(), b"\n", rest].concat();
        let digest = digest(&file);
        (file.into(), digest)
    }

    pub(super) fn chunk_bytes(&self) -> u64 {
        self.chunks.iter().map(|chunk| chunk.data.len() as u64).sum()
    }
}

fn digest(bytes: &[u8]) -> String {
    let mut hash = Hash::default();
    hash.add(bytes);
    hash.digest()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::io::decode;

    #[test]
    fn a_file_with_a_comment_is_the_same_surface() {
        let surfaces = build(&[], Shape::Torus, "500..5000".parse().unwrap(), "10%".parse().unwrap()).unwrap();
        assert_eq!(surfaces.len(), SURFACES);
        let facets: Vec<u64> = surfaces.iter().map(|surface| surface.facets).collect();
        assert!(facets.is_sorted() && facets[0] < 700 && facets[15] > 4000, "{facets:?}");
        let surface = &surfaces[3];
        let (file, digest) = surface.file_with("load 7");
        assert!(digest != surface.digest && file.len() == surface.file.len() + "comment load 7\n".len());
        let (with, without) =
            (decode(Format::Ply, &file).unwrap(), decode(Format::Ply, &surface.file.clone()).unwrap());
        assert!(with.positions() == without.positions() && with.facets() == without.facets());
        let bytes = 24 * with.positions().len() + 12 * with.facets().len();
        assert_eq!(surface.chunk_bytes(), bytes as u64);
    }
}
