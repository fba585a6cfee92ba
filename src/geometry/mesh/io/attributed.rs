//! Surface files with what they carry beside the surface.
//!
//! Purpose: what [`super::read`] and its kin do, with [`Attributes`].
//! Invariant: the surface is the one that [`super::decode`] gives, and the bytes of a surface without attributes are
//! those of [`super::encode`]. An attribute that cannot be used is left aside and named; it never
//! spoils the surface or another attribute. Must not know: what is done with attributes.

use std::path::Path;

use super::held::Held;
use super::{DataError, FileError, Format, Soup, decode_soup, pack_for};
use crate::mesh::TriMesh;
use crate::mesh::attributes::{AttributeError, Attributes};

/// A file's surface and what it carries.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The surface.
    pub mesh: TriMesh,
    /// What it carries.
    pub attributes: Attributes,
    /// What is in the file and cannot be used, with the reason.
    pub left_aside: Vec<AttributeError>,
}

/// Reads a surface and its attributes; the format is the extension's.
///
/// # Errors
/// [`FileError`], as [`super::read`].
pub fn read_with_attributes(path: &Path) -> Result<Loaded, FileError> {
    let format = Format::of_path(path)?;
    let bytes =
        std::fs::read(path).map_err(|cause| FileError::Io { path: path.to_path_buf(), action: "read", cause })?;
    decode_with_attributes(format, &bytes).map_err(|cause| FileError::Data { path: path.to_path_buf(), cause })
}

/// Writes a surface and its attributes; the format is the extension's. Gives the names of the
/// attributes that the format cannot hold.
///
/// Numbers keep their bits, except colours that came in 8 bits, which PLY, OFF, VTK and glTF store so; glTF has all
/// others in single precision.
///
/// # Errors
/// [`FileError`], as [`super::write()`].
pub fn write_with_attributes(path: &Path, mesh: &TriMesh, attributes: &Attributes) -> Result<Vec<String>, FileError> {
    let format = Format::of_path(path)?;
    let encoded = encode_with_attributes(format, mesh, attributes);
    let (bytes, left_out) = encoded.map_err(|cause| FileError::Data { path: path.to_path_buf(), cause })?;
    pack_for(path, bytes).and_then(|bytes| std::fs::write(path, bytes)).map_err(|cause| FileError::Io {
        path: path.to_path_buf(),
        action: "write",
        cause,
    })?;
    Ok(left_out)
}

/// Reads a surface and its attributes from the bytes of a file.
///
/// # Errors
/// [`DataError`], exactly where [`super::decode`] gives it.
///
/// ```
/// use tessera::mesh::io::{DataError, Format, decode_with_attributes};
/// let text = b"COFF 3 1 0\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n0 1 0 0 0 51 255\n3 0 1 2\n";
/// let loaded = decode_with_attributes(Format::Off, text)?;
/// assert_eq!(loaded.attributes.colours().unwrap().values[2], [0.0, 0.0, 0.2, 1.0]);
/// # Ok::<(), DataError>(())
/// ```
pub fn decode_with_attributes(format: Format, bytes: &[u8]) -> Result<Loaded, DataError> {
    let Soup { positions, facets, raw, .. } = decode_soup(format, bytes, true)?;
    let mesh = TriMesh::new(positions, facets)?;
    let (attributes, left_aside) = raw.onto(&mesh);
    Ok(Loaded { mesh, attributes, left_aside })
}

/// The bytes of a file that holds `mesh` and of `attributes` what the format can hold, and the names of
/// the others.
///
/// | | normals | texture coordinates | colours | scalars |
/// | --- | --- | --- | --- | --- |
/// | OBJ | yes | yes | without opacity | no |
/// | PLY | per vertex | yes; with seams as the face property `texcoord` | yes | yes |
/// | OFF | per vertex | per vertex | yes | no |
/// | VTK, `.vtk` and `.vtp` | per vertex | per vertex | yes | yes |
/// | glTF | yes | yes | yes | no |
/// | Gmsh | no | no | no | yes |
/// | STL, Medit | no | no | no | no |
///
/// # Errors
/// [`DataError::SinglePrecision`] for STL and glTF; [`DataError::Attributes`] if they are another mesh's.
pub fn encode_with_attributes(
    format: Format,
    mesh: &TriMesh,
    attributes: &Attributes,
) -> Result<(Vec<u8>, Vec<String>), DataError> {
    attributes.check_mesh(mesh)?;
    let held = Held::of(&format.codec().holds, mesh, attributes);
    let bytes = (format.codec().encode)(mesh, &held)?;
    Ok((bytes, held.left_out))
}
