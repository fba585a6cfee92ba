//! Surface files: OBJ, PLY, STL, OFF, VTK, Gmsh, Medit and glTF, in and out, packed by gzip or not.
//!
//! Purpose: [`read`] and [`write()`] for a path, [`decode`] and [`encode`] for bytes. The format is the file's
//! extension ([`Format`]). The same names with `_with_attributes` take and give what a surface carries too.
//! Invariant: no sequence of bytes makes a reader panic, hang, or allocate more than a small
//! multiple of the bytes that are there, whatever counts they declare; of what is packed, no more than [`UNPACKED_RATIO`]
//! times the bytes. A polygon of n corners becomes n - 2 facets: a fan around its first corner if it is convex, or ears
//! (`polygons`). Positions are double precision; only STL and glTF, whose formats say so, hold single precision.
//! Must not know: what is done with a surface.

mod attributed;
mod gltf;
mod gmsh;
mod held;
pub mod lists;
mod medit;
mod numbers;
mod obj;
mod off;
mod packed;
mod ply;
mod polygons;
mod room;
mod single;
mod stl;
mod vtk;

use std::path::{Path, PathBuf};

use glam::DVec3;

use super::attributes::AttributeError;
use super::{MeshError, TriMesh};
use held::{Held, Holds, Raw};
use polygons::Fan;

pub use packed::limit as unpacked_limit;
pub use packed::pack_for;
pub use packed::{Measure, are_packed, unpack_head, unpacked_wrong, unpacker};
pub use packed::{UNPACKED_RATIO, unpack};

pub use attributed::{
    Loaded, decode_with_attributes, encode_with_attributes, read_with_attributes, write_with_attributes,
};

/// A file format that can be read and written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Wavefront OBJ, text. Groups and objects are one surface; materials are left aside.
    Obj,
    /// Stanford PLY. Reads ascii and both binary orders, writes little-endian binary with doubles.
    Ply,
    /// STL. Reads ascii and binary, writes binary; coordinates are rounded to single precision.
    Stl,
    /// Geomview OFF, text, with the COFF and NOFF variants.
    Off,
    /// Legacy VTK. Reads polygonal data and unstructured grids, text and binary; writes binary with doubles.
    Vtk,
    /// VTK XML for polygonal data. Reads text, base64 and appended data, plain or packed by zlib; writes base64 with doubles.
    Vtp,
    /// Gmsh. Reads versions 2 and 4.1, text and binary; writes version 2.2, binary.
    Gmsh,
    /// Medit, text.
    Medit,
    /// Medit, binary. Reads versions 1 to 4, writes version 2 with doubles.
    MeditBinary,
    /// A binary glTF file. Coordinates are rounded to single precision.
    Glb,
    /// A glTF file as text, with its data inside. Coordinates are rounded to single precision.
    Gltf,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 11] = [
        Self::Obj,
        Self::Ply,
        Self::Stl,
        Self::Off,
        Self::Vtk,
        Self::Vtp,
        Self::Gmsh,
        Self::Medit,
        Self::MeditBinary,
        Self::Glb,
        Self::Gltf,
    ];

    /// What knows the format.
    fn codec(self) -> &'static Codec {
        match self {
            Self::Obj => &obj::CODEC,
            Self::Ply => &ply::CODEC,
            Self::Stl => &stl::CODEC,
            Self::Off => &off::CODEC,
            Self::Vtk => &vtk::legacy::CODEC,
            Self::Vtp => &vtk::xml::CODEC,
            Self::Gmsh => &gmsh::CODEC,
            Self::Medit => &medit::TEXT,
            Self::MeditBinary => &medit::BINARY,
            Self::Glb => &gltf::BINARY,
            Self::Gltf => &gltf::TEXT,
        }
    }

    /// The extension, lower case, without the dot.
    pub fn extension(self) -> &'static str {
        self.codec().extension
    }

    /// The format of an extension, in any case, without the dot.
    pub fn from_extension(extension: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.extension().eq_ignore_ascii_case(extension))
    }

    /// All extensions, for a sentence: ".obj, .ply or .stl".
    pub fn names() -> String {
        let mut names = Self::ALL.map(|format| format!(".{}", format.extension())).to_vec();
        let last = names.pop().unwrap_or_default();
        format!("{} or {last}", names.join(", "))
    }

    /// The format of a file name, which may have `.gz` after its extension.
    ///
    /// # Errors
    /// [`FileError::UnknownFormat`].
    pub fn of_path(path: &Path) -> Result<Self, FileError> {
        let stem = if packed::is_packed(path) { path.file_stem().map(Path::new).unwrap_or(path) } else { path };
        let extension = stem.extension().and_then(|e| e.to_str()).unwrap_or_default();
        Self::from_extension(extension)
            .ok_or_else(|| FileError::UnknownFormat { path: path.to_path_buf(), extension: extension.to_owned() })
    }
}

/// All that is to be known of a format, in its own file.
struct Codec {
    extension: &'static str,
    /// The surface, and what it carries if that is wanted.
    decode: fn(bytes: &[u8], wanted: bool) -> Result<Soup, DataError>,
    encode: fn(&TriMesh, &Held<'_>) -> Result<Vec<u8>, DataError>,
    /// See [`counts`].
    counts: fn(&[u8]) -> Option<Counts>,
    holds: Holds,
    vertices: VertexNumbers,
}

/// What is known of a file before it is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Vertices, at most.
    pub vertices: u64,
    /// Facets, at most.
    pub facets: u64,
    /// Bytes that reading makes of what is packed in the file, or named in it several times.
    pub made_bytes: u64,
}

impl From<(u64, u64)> for Counts {
    fn from((vertices, facets): (u64, u64)) -> Self {
        Self { vertices, facets, made_bytes: 0 }
    }
}

/// How vertices of a file are numbered in the surface that is read from it.
enum VertexNumbers {
    /// As in the file.
    Kept,
    /// The file has none.
    Absent,
    /// In another order.
    Reordered(fn(&[u8]) -> Result<VertexOrder, DataError>),
}

/// How many vertices a file has, and which of them each of the surface's is.
type VertexOrder = (usize, Vec<u32>);

/// Why a file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The extension names no format that is known.
    #[error("{}: \"{extension}\" is no known mesh format; name the file {}", path.display(), Format::names())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// Its extension, empty if there is none.
        extension: String,
    },
    /// The operating system refused.
    #[error("cannot {action} {}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// "read" or "write".
        action: &'static str,
        /// What it said.
        cause: std::io::Error,
    },
    /// The file was read, and what it holds is not a surface; or the surface does not fit the format.
    #[error("{}: {cause}", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        cause: DataError,
    },
}

impl FileError {
    /// Whether the file's content is at fault, rather than its name or the file system.
    pub fn is_bad_data(&self) -> bool {
        matches!(self, Self::Data { .. })
    }
}

/// What is wrong with the content of a file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DataError {
    /// Nothing is there.
    #[error("the file is empty")]
    Empty,
    /// A line of text cannot be understood.
    #[error("line {line}: {message}")]
    Syntax {
        /// From 1.
        line: usize,
        /// What was expected.
        message: String,
    },
    /// An element of a format without lines cannot be understood.
    #[error("{element} {index}: {message}")]
    Element {
        /// "face", "facet" or "vertex".
        element: &'static str,
        /// From 0.
        index: usize,
        /// What was expected.
        message: String,
    },
    /// The header says what cannot be.
    #[error("header: {0}")]
    Header(String),
    /// The file ends before what its header declares.
    #[error("the file is cut off: {0}; fetch or export it again")]
    Truncated(String),
    /// More comes out of a packed file than a limit allows.
    #[error("more than {limit} bytes are packed in it; unpack it first (gunzip)")]
    TooLong {
        /// Bytes.
        limit: usize,
    },
    /// All was understood, and it is not a surface.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The surface does not fit the format.
    #[error(
        "vertex {vertex} ({x:e}, {y:e}, {z:e}) does not fit the single precision of STL and glTF; write .ply, .obj or .off"
    )]
    SinglePrecision {
        /// From 0.
        vertex: usize,
        /// Coordinates.
        x: f64,
        /// Second coordinate.
        y: f64,
        /// Third coordinate.
        z: f64,
    },
    /// Facets that are more than a thousandth of the area would have two corners in one place; this is the first.
    #[error(
        "facet {facet} is too small beside its coordinates for the single precision of STL and glTF; write .ply, .obj or .off"
    )]
    Collapsed {
        /// From 0.
        facet: usize,
    },
    /// The attributes are not this surface's.
    #[error(transparent)]
    Attributes(#[from] AttributeError),
    /// A list beside the surface does not fit it.
    #[error("{0}")]
    List(String),
}

/// Reads a surface; the format is the extension's.
///
/// # Errors
/// [`FileError`]: an unknown extension, a file that cannot be opened, or content that is wrong.
pub fn read(path: &Path) -> Result<TriMesh, FileError> {
    let format = Format::of_path(path)?;
    let bytes =
        std::fs::read(path).map_err(|cause| FileError::Io { path: path.to_path_buf(), action: "read", cause })?;
    decode(format, &bytes).map_err(|cause| FileError::Data { path: path.to_path_buf(), cause })
}

/// Writes a surface; the format is the extension's, and a name that ends in `.gz` is packed. An
/// existing file is replaced.
///
/// Vertices and facets keep their numbers (except in STL, which has none), and coordinates
/// their bits (except in STL, which rounds them to single precision).
///
/// # Errors
/// [`FileError`]: an unknown extension, a file that cannot be written, or coordinates that the format cannot hold.
pub fn write(path: &Path, mesh: &TriMesh) -> Result<(), FileError> {
    let format = Format::of_path(path)?;
    let bytes = encode(format, mesh).map_err(|cause| FileError::Data { path: path.to_path_buf(), cause })?;
    pack_for(path, bytes).and_then(|bytes| std::fs::write(path, bytes)).map_err(|cause| FileError::Io {
        path: path.to_path_buf(),
        action: "write",
        cause,
    })
}

/// Reads a surface from the bytes of a file.
///
/// # Errors
/// [`DataError`], naming the line or the element.
///
/// ```
/// use tessera::mesh::io::{DataError, Format, decode};
/// let text = b"OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
/// assert_eq!(decode(Format::Off, text)?.area(), 0.5);
/// assert!(matches!(decode(Format::Off, &text[..20]), Err(DataError::Truncated(_))));
/// # Ok::<(), DataError>(())
/// ```
pub fn decode(format: Format, bytes: &[u8]) -> Result<TriMesh, DataError> {
    let Soup { positions, facets, .. } = decode_soup(format, bytes, false)?;
    Ok(TriMesh::new(positions, facets)?)
}

/// Vertices and facets that [`decode`] would find in a file, at most: a polygon of n corners counts as n - 2 facets, a facet
/// of STL as three vertices. `None` if the bytes are no such file, or end before what its header declares; `decode` fails then.
///
/// No vertex and no facet is kept, and no number is read that is not a count: this is several times as fast as reading. It takes
/// memory in proportion to the bytes.
pub fn counts(format: Format, bytes: &[u8]) -> Option<(u64, u64)> {
    let bytes = unpack(bytes, unpacked_limit(bytes.len())).ok()?;
    counts_of_plain(format, &bytes).map(|counts| (counts.vertices, counts.facets))
}

/// The same of bytes that are not packed.
pub fn counts_of_plain(format: Format, bytes: &[u8]) -> Option<Counts> {
    let counts = (format.codec().counts)(without_mark(bytes))?;
    (counts.vertices > 0 && counts.facets > 0).then_some(counts)
}

/// Says of elements that fill space that they are left aside; an error if there is nothing else.
fn volumes(soup: &mut Soup, elements: usize, advice: &str) -> Result<(), DataError> {
    match (elements, soup.facets.is_empty()) {
        (0, _) => Ok(()),
        (_, true) => Err(DataError::Header(format!(
            "there are {elements} elements that fill space, and no triangle or polygon; {advice}"
        ))),
        (_, false) => {
            soup.raw.unreadable("volume elements", format!("there are {elements}; the surface is read alone"));
            Ok(())
        }
    }
}

/// What the format's reader finds, its polygons cut; what the surface carries only if it is `wanted`.
fn decode_soup(format: Format, bytes: &[u8], wanted: bool) -> Result<Soup, DataError> {
    let bytes = unpack(bytes, unpacked_limit(bytes.len()))?;
    let bytes = without_mark(&bytes);
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(DataError::Empty);
    }
    let mut soup = (format.codec().decode)(bytes, wanted)?;
    let cuts = polygons::recut(&soup.positions, &soup.facets, &soup.fans);
    cuts.iter().for_each(|cut| cut.apply(&mut soup.facets));
    soup.raw.recut(&cuts);
    Ok(soup)
}

/// Without the byte order mark that some editors put before text. It would hide the first word.
fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// The bytes of a file that holds `mesh`.
///
/// # Errors
/// [`DataError::SinglePrecision`] and [`DataError::Collapsed`] for STL and glTF.
pub fn encode(format: Format, mesh: &TriMesh) -> Result<Vec<u8>, DataError> {
    (format.codec().encode)(mesh, &Held::default())
}

/// What a reader collects: triangles, not yet validated.
#[derive(Debug, Default)]
struct Soup {
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    /// Which of them are polygons' with more than three corners, all of them fans.
    fans: Vec<Fan>,
    /// What it carries, not yet checked.
    raw: Raw,
}

impl Soup {
    /// Adds a polygon as a fan around its first corner. The message says what is wrong with it;
    /// the caller knows where it stands.
    fn push_polygon(&mut self, corners: &[i64]) -> Result<(), String> {
        if corners.len() < 3 {
            return Err(format!("a face needs at least 3 corners and has {}", corners.len()));
        }
        let vertices = self.positions.len();
        let index = |corner: i64| match u32::try_from(corner) {
            Ok(index) if (index as usize) < vertices => Ok(index),
            _ => Err(format!("vertex {corner} is named, but there are {vertices} vertices, counted from 0")),
        };
        if corners.len() > 3 {
            // As many facets as numbers can tell apart are refused later.
            let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
            self.fans.push((count(self.facets.len()), count(corners.len() - 2)));
        }
        let first = index(corners[0])?;
        let mut last = index(corners[1])?;
        for &corner in &corners[2..] {
            let next = index(corner)?;
            self.facets.push([first, last, next]);
            last = next;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
