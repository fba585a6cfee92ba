//! Surface files: OBJ, PLY, STL, OFF, VTK, Gmsh, Medit, glTF and 3MF, in and out, packed by gzip or not.
//!
//! Purpose: [`read`] and [`write()`] for a path, [`decode`] and [`encode`] for bytes. The format is the file's
//! extension ([`Format`]). The functions with the suffix `_with_attributes` also read and write [`Attributes`]; an attribute that
//! cannot be used is left aside and named, and never changes the surface.
//! Invariant: no sequence of bytes makes a reader panic, hang, or allocate more than a small multiple of the bytes that are
//! there, whatever counts they declare; of what is packed, no more than [`UNPACKED_RATIO`] times the bytes. A polygon of n
//! corners becomes n - 2 facets: a fan around its first corner if it is convex, or ears (`polygons`). Positions are double
//! precision; only STL and glTF, whose formats say so, hold single precision. Must not know: what is done with a surface.

mod gltf;
mod gmsh;
mod held;
pub mod lists;
mod medit;
pub mod metric;
mod numbers;
mod obj;
mod off;
mod packed;
pub(super) mod ply;
mod polygons;
mod regions;
pub(super) mod stl;
mod threemf;
mod vtk;

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use glam::DVec3;

use super::attributes::{AttributeError, Attributes, Scalar};
use super::{MeshError, TriMesh};
use held::{Held, Holds, Raw};
use packed::Signature;
use polygons::Fan;

pub use regions::RegionChoice;

pub use packed::limit as unpacked_limit;
pub use packed::{Measure, UNPACKED_RATIO, are_packed, pack_for, unpack, unpacked_wrong, unpacker};

/// Why parts of a file cannot be read.
#[derive(Debug)]
pub(super) enum Unfit {
    /// It is no surface.
    Data(DataError),
    /// It is of a kind that is read as a whole.
    Kind(String),
}

impl From<DataError> for Unfit {
    fn from(error: DataError) -> Self {
        Self::Data(error)
    }
}

impl From<MeshError> for Unfit {
    fn from(error: MeshError) -> Self {
        Self::Data(error.into())
    }
}

/// Makes [`Format`] of its table: documentation, name, number in messages, codec.
macro_rules! formats {
    ($($(#[$doc:meta])* $name:ident = $number:literal, $codec:expr;)*) => {
        /// A file format that can be read and written.
        ///
        /// Its number is that of `MeshFormat` in `tessera.v1`.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(i32)]
        pub enum Format {
            $($(#[$doc])* $name = $number,)*
        }

        impl Format {
            /// All formats.
            pub const ALL: [Self; [$($number),*].len()] = [$(Self::$name),*];

            fn codec(self) -> &'static Codec {
                match self {
                    $(Self::$name => &$codec,)*
                }
            }
        }
    };
}

formats! {
    /// Wavefront OBJ, text. Groups and objects are one surface.
    Obj = 2, obj::CODEC;
    /// Stanford PLY. Reads ascii and both binary orders, writes little-endian binary with doubles.
    Ply = 1, ply::CODEC;
    /// STL. Reads ascii and binary, writes binary, or ascii with regions; coordinates are rounded to single precision.
    Stl = 3, stl::CODEC;
    /// Geomview OFF, text, with the COFF and NOFF variants.
    Off = 4, off::CODEC;
    /// Legacy VTK. Reads polygonal data and unstructured grids, text and binary; writes binary with doubles.
    Vtk = 5, vtk::legacy::CODEC;
    /// VTK XML for polygonal data. Reads text, base64 and appended data, plain or packed by zlib; writes base64 with doubles.
    Vtp = 6, vtk::xml::POLYGONS;
    /// Gmsh. Reads versions 2 and 4.1, text and binary; writes version 2.2, binary.
    Gmsh = 7, gmsh::CODEC;
    /// Medit, text.
    Medit = 8, medit::TEXT;
    /// Medit, binary. Reads versions 1 to 4, writes version 2 with doubles.
    MeditBinary = 9, medit::BINARY;
    /// A binary glTF file. Coordinates are rounded to single precision.
    Glb = 10, gltf::BINARY;
    /// A glTF file as text, with its data inside. Coordinates are rounded to single precision.
    Gltf = 11, gltf::TEXT;
    /// VTK XML for unstructured grids. Reads and writes as [`Self::Vtp`].
    Vtu = 12, vtk::xml::GRID;
    /// 3MF. Reads all items of the build; writes one object, in mm.
    ThreeMf = 13, threemf::CODEC;
}

impl Format {
    /// The number in messages of `tessera.v1`.
    pub fn number(self) -> i32 {
        self as i32
    }

    /// The format with this number in messages.
    pub fn of_number(number: i32) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.number() == number)
    }

    /// Its media type, and others that mean it.
    pub fn media_types(self) -> &'static [&'static str] {
        self.codec().media_types
    }

    /// The shortest that a facet is in files that writers make, with half a vertex, in bytes.
    pub fn facet_bytes(self) -> u64 {
        self.codec().facet_bytes
    }

    /// The format of a file, by its bytes, packed by gzip or not.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        packed::recognize(bytes)
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

    /// Whether labels of facets can be chosen by a name.
    fn has_arrays(self) -> bool {
        matches!(self, Self::Obj | Self::Ply | Self::Vtk | Self::Vtp | Self::Vtu)
    }

    /// The format of a file name, which may have `.gz` after its extension.
    pub fn of_path(path: &Path) -> Result<Self, FileError> {
        let stem = if packed::is_packed(path) { path.file_stem().map(Path::new).unwrap_or(path) } else { path };
        let extension = stem.extension().and_then(|e| e.to_str()).unwrap_or_default();
        Self::from_extension(extension)
            .ok_or_else(|| FileError::UnknownFormat { path: path.to_path_buf(), extension: extension.to_owned() })
    }
}

/// Which labels become regions, if attributes are wanted.
type Wanted<'a> = Option<&'a RegionChoice>;

struct Codec {
    extension: &'static str,
    /// The preferred media type first.
    media_types: &'static [&'static str],
    facet_bytes: u64,
    signature: Signature,
    /// Reads the surface, and its attributes if they are wanted.
    decode: fn(bytes: &[u8], wanted: Wanted<'_>) -> Result<Soup, DataError>,
    encode: fn(&TriMesh, &Held<'_>) -> Result<Vec<u8>, DataError>,
    counts: fn(&[u8]) -> Option<Counts>,
    holds: Holds,
    vertices: VertexNumbers,
}

/// Sizes of a file that are known before it is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Vertices, at most.
    pub vertices: u64,
    /// Facets, at most.
    pub facets: u64,
    /// Bytes that reading makes of what is packed in the file, or named in it several times.
    pub made_bytes: u64,
}

/// How vertices of a file are numbered in the surface that is read from it.
enum VertexNumbers {
    Kept,
    /// The file has no vertices of its own.
    Absent,
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
        /// The error of the operating system.
        cause: std::io::Error,
    },
    /// The file was read, and what it holds is not a surface; or the surface does not fit the format.
    #[error("{}: {cause}", path.display())]
    Data {
        /// The file.
        path: PathBuf,
        /// The defect and its place.
        cause: DataError,
    },
}

/// A defect of the content of a file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DataError {
    /// The file has no content.
    #[error("the file is empty")]
    Empty,
    /// A line of text cannot be understood.
    #[error("line {line}: {message}")]
    Syntax {
        /// From 1.
        line: usize,
        /// The expected content.
        message: String,
    },
    /// An element of a format without lines cannot be understood.
    #[error("{element} {index}: {message}")]
    Element {
        /// "face", "facet" or "vertex".
        element: &'static str,
        /// From 0.
        index: usize,
        /// The expected content.
        message: String,
    },
    /// The header contradicts itself or is not read.
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
    /// The elements do not form a surface.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The surface does not fit the format.
    #[error(
        "vertex {vertex} ({:e}, {:e}, {:e}) does not fit the single precision of STL and glTF; write .ply, .obj or .off",
        .position.x, .position.y, .position.z
    )]
    SinglePrecision {
        /// From 0.
        vertex: usize,
        /// Its position.
        position: DVec3,
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
    /// The labels that were chosen to be regions are not there.
    #[error("there is no array {name:?} of facets to make regions of; {}", regions::listed(.there))]
    NoRegions {
        /// The name as given, at most 40 characters of it.
        name: String,
        /// Names that are there, the first 32 of them.
        there: Vec<String>,
    },
    /// A list beside the surface does not fit it.
    #[error("{0}")]
    List(String),
}

/// A file's surface and its attributes.
#[derive(Clone, Debug, PartialEq)]
pub struct Loaded {
    /// The surface.
    pub mesh: TriMesh,
    /// Its attributes.
    pub attributes: Attributes,
    /// Edges that the file names, as `Ridges` and `RequiredEdges` of Medit, which a remesh should keep; two vertices each.
    pub creases: Vec<[u32; 2]>,
    /// Vertices that the file names, as `RequiredVertices` of Medit, which a remesh should leave where they are; ascending.
    pub vertices: Vec<u32>,
    /// Attributes of the file that cannot be used, with the reason.
    pub left_aside: Vec<AttributeError>,
}

/// Reads a surface; the format is the extension's.
pub fn read(path: &Path) -> Result<TriMesh, FileError> {
    read_as(path, decode)
}

/// [`read`], with attributes.
pub fn read_with_attributes(path: &Path) -> Result<Loaded, FileError> {
    read_as(path, decode_with_attributes)
}

/// [`read_with_attributes`], with a choice of the labels that become regions.
pub fn read_with_regions(path: &Path, choice: &RegionChoice) -> Result<Loaded, FileError> {
    read_as(path, |format, bytes| decode_with_regions(format, bytes, choice))
}

/// The bytes of a surface's file. A `.gltf` takes in the data that it names, from files in its folder or below, so that the
/// bytes are a surface by themselves.
pub fn read_bytes(path: &Path, format: Format) -> Result<Vec<u8>, FileError> {
    let bytes =
        std::fs::read(path).map_err(|cause| FileError::Io { path: path.to_path_buf(), action: "read", cause })?;
    if format != Format::Gltf {
        return Ok(bytes);
    }
    let wrong = |cause| FileError::Data { path: path.to_path_buf(), cause };
    let plain = unpack(&bytes, unpacked_limit(bytes.len())).map_err(wrong)?;
    let whole = gltf::beside::taken_in(without_mark(&plain), path.parent().unwrap_or(Path::new(""))).map_err(wrong)?;
    Ok(match whole {
        // Nothing was taken in.
        Cow::Borrowed(_) => bytes,
        Cow::Owned(whole) => whole,
    })
}

fn read_as<T>(path: &Path, decode: impl FnOnce(Format, &[u8]) -> Result<T, DataError>) -> Result<T, FileError> {
    let format = Format::of_path(path)?;
    let bytes = read_bytes(path, format)?;
    decode(format, &bytes).map_err(|cause| FileError::Data { path: path.to_path_buf(), cause })
}

/// Writes a surface; the format is the extension's, and a name that ends in `.gz` is packed. An existing file is replaced.
///
/// Vertices and facets keep their numbers, except in STL (none); coordinates keep their bits, except in STL and glTF.
pub fn write(path: &Path, mesh: &TriMesh) -> Result<(), FileError> {
    write_with_attributes(path, mesh, &Attributes::new(mesh)).map(|_| ())
}

/// [`write()`], with attributes. Returns the names of the attributes that the format cannot hold.
///
/// Numbers keep their bits; but glTF has single precision, and colours from 8 bits stay so in PLY, OFF, VTK and glTF.
pub fn write_with_attributes(path: &Path, mesh: &TriMesh, attributes: &Attributes) -> Result<Vec<String>, FileError> {
    let format = Format::of_path(path)?;
    let encoded = encode_with_attributes(format, mesh, attributes);
    let (bytes, left_out) = encoded.map_err(|cause| FileError::Data { path: path.to_path_buf(), cause })?;
    let refused = |cause| FileError::Io { path: path.to_path_buf(), action: "write", cause };
    pack_for(path, bytes).and_then(|bytes| std::fs::write(path, bytes)).map_err(refused)?;
    Ok(left_out)
}

/// Reads a surface from the bytes of a file.
///
/// ```
/// use tessera::mesh::io::{DataError, Format, decode};
/// let text = b"OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
/// assert_eq!(decode(Format::Off, text)?.area(), 0.5);
/// assert!(matches!(decode(Format::Off, &text[..20]), Err(DataError::Truncated(_))));
/// # Ok::<(), DataError>(())
/// ```
pub fn decode(format: Format, bytes: &[u8]) -> Result<TriMesh, DataError> {
    let Soup { positions, facets, .. } = decode_soup(format, bytes, None)?;
    Ok(TriMesh::new(positions, facets)?)
}

/// Reads a surface and its attributes from the bytes of a file. Fails exactly where [`decode`] does.
///
/// ```
/// use tessera::mesh::io::{DataError, Format, decode_with_attributes};
/// let text = b"COFF 3 1 0\n0 0 0 255 0 0 255\n1 0 0 0 255 0 255\n0 1 0 0 0 51 255\n3 0 1 2\n";
/// let loaded = decode_with_attributes(Format::Off, text)?;
/// assert_eq!(loaded.attributes.colours().unwrap().values[2], [0.0, 0.0, 0.2, 1.0]);
/// # Ok::<(), DataError>(())
/// ```
pub fn decode_with_attributes(format: Format, bytes: &[u8]) -> Result<Loaded, DataError> {
    decode_with_regions(format, bytes, &RegionChoice::Named)
}

/// [`decode_with_attributes`], with a choice of the labels that become regions. Labels of one kind alone are no regions, and
/// neither are more than [`MAX_REGIONS`](super::regions::MAX_REGIONS), or such that change at most edges: these are left aside.
/// Fails where [`decode`] does, and if an array is chosen that is not there.
///
/// ```
/// use tessera::mesh::io::{DataError, Format, RegionChoice, decode_with_regions};
/// let text = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nusemtl red\nf 1 2 3\nusemtl blue\nf 2 4 3\n";
/// let loaded = decode_with_regions(Format::Obj, text, &RegionChoice::Named)?;
/// assert_eq!(loaded.attributes.regions().unwrap().label(1), "blue");
/// let other = RegionChoice::Array("g".to_owned());
/// assert!(matches!(decode_with_regions(Format::Obj, text, &other), Err(DataError::NoRegions { .. })));
/// # Ok::<(), DataError>(())
/// ```
pub fn decode_with_regions(format: Format, bytes: &[u8], choice: &RegionChoice) -> Result<Loaded, DataError> {
    let Soup { positions, facets, mut raw, .. } = decode_soup(format, bytes, Some(choice))?;
    let mesh = TriMesh::new(positions, facets)?;
    if let Some(name) = choice.array().filter(|_| raw.regions.is_none() || !format.has_arrays()) {
        return Err(regions::missing(name, &raw.arrays));
    }
    let (creases, vertices) = (raw.edges_of(&mesh), raw.vertices_of(&mesh));
    let (attributes, left_aside) = raw.onto(&mesh, choice);
    Ok(Loaded { mesh, attributes, creases, vertices, left_aside })
}

/// Vertices and facets that [`decode`] would find in a file, at most: a polygon of n corners counts as n - 2 facets, a facet
/// of STL as three vertices. `None` if the bytes are no such file, or end before what its header declares; `decode` fails then.
///
/// It keeps no element and reads counts alone: several times as fast as reading, with memory in proportion to the bytes.
pub fn counts(format: Format, bytes: &[u8]) -> Option<(u64, u64)> {
    let bytes = unpack(bytes, unpacked_limit(bytes.len())).ok()?;
    counts_of_plain(format, &bytes).map(|counts| (counts.vertices, counts.facets))
}

/// [`counts`] of bytes that are not packed.
pub fn counts_of_plain(format: Format, bytes: &[u8]) -> Option<Counts> {
    let counts = (format.codec().counts)(without_mark(bytes))?;
    (counts.vertices > 0 && counts.facets > 0).then_some(counts)
}

/// Elements of a file that are no facets.
#[derive(Clone, Copy, Debug, Default)]
struct Others {
    /// Points and lines.
    thin: usize,
    /// What fills space.
    volumes: usize,
}

impl std::ops::AddAssign for Others {
    fn add_assign(&mut self, other: Self) {
        self.thin = self.thin.saturating_add(other.thin);
        self.volumes = self.volumes.saturating_add(other.volumes);
    }
}

impl Others {
    /// Reports them as left aside; an error if there is nothing but volumes.
    fn leave(self, soup: &mut Soup, advice: &str) -> Result<(), DataError> {
        let Self { thin, volumes } = self;
        if volumes > 0 && soup.facets.is_empty() {
            let text = format!("there are {volumes} elements that fill space, and no triangle or polygon; {advice}");
            return Err(DataError::Header(text));
        }
        soup.raw.elements("volume elements", volumes);
        soup.raw.elements("points and lines", thin);
        Ok(())
    }
}

/// What to say of scalars whose names become others in a file.
fn renamed(scalars: &[Scalar], written: fn(&str) -> String) -> Option<String> {
    let others = scalars.iter().filter(|scalar| written(&scalar.name) != scalar.name);
    let names: Vec<String> = others.map(|s| format!("{:?} (it is {})", s.name, written(&s.name))).collect();
    (!names.is_empty()).then(|| format!("the name {}", names.join(", ")))
}

fn syntax(line: usize, message: impl Into<String>) -> DataError {
    DataError::Syntax { line, message: message.into() }
}

/// Bytes that reading may take beside what it gives, for each of the file's.
const ROOM_RATIO: usize = 8;

/// The surface that the format's reader finds, with its polygons cut. Attributes are read only if they are `wanted`.
fn decode_soup(format: Format, bytes: &[u8], wanted: Wanted<'_>) -> Result<Soup, DataError> {
    let bytes = unpack(bytes, unpacked_limit(bytes.len()))?;
    let bytes = without_mark(&bytes);
    if bytes.iter().all(u8::is_ascii_whitespace) {
        return Err(DataError::Empty);
    }
    let mut soup = (format.codec().decode)(bytes, wanted)?;
    let fans = std::mem::take(&mut soup.fans);
    let room = bytes.len().saturating_mul(ROOM_RATIO).saturating_sub(fans.capacity() * size_of::<Fan>());
    let mut lists = vec![soup.facets.as_mut_slice()];
    lists.extend(soup.raw.corners_mut());
    let left = polygons::recut(&soup.positions, &mut lists, &fans, room);
    if left > 0 {
        let text = format!(
            "{left} are not convex and too long, or beside many that cross themselves; they become fans around their first corner"
        );
        soup.raw.unreadable("polygons", text);
    }
    Ok(soup)
}

/// Removes the byte order mark that some editors put before text. It would hide the first word.
fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// The bytes of a file that holds `mesh`. Only STL and glTF may not fit it.
pub fn encode(format: Format, mesh: &TriMesh) -> Result<Vec<u8>, DataError> {
    (format.codec().encode)(mesh, &Held::default())
}

/// The bytes of a file that holds `mesh` and of `attributes` what the format can hold, and the names of the others. STL and
/// glTF have single precision, which is among the others if it moves a vertex by more than 1 % of an edge. In glTF the place
/// of a surface far from the origin is that of its node, so that nothing is lost there.
///
/// | | normals | texture coordinates | colours | scalars | regions |
/// | --- | --- | --- | --- | --- | --- |
/// | OBJ | yes | yes | without opacity | no | names, as `g` and `usemtl` |
/// | PLY | per vertex | yes; with seams as the face property `texcoord` | yes | yes | numbers, as the face property `regions` |
/// | OFF | per vertex | per vertex | yes | no | no |
/// | VTK, `.vtk`, `.vtp` and `.vtu` | per vertex | per vertex | yes | yes | numbers, as the cell array `regions` |
/// | glTF | yes | yes | yes | no | names, as materials |
/// | Gmsh | no | no | no | yes | names and numbers, as physical groups |
/// | STL | no | no | no | no | names, as solids of text; binary without regions |
/// | Medit | no | no | no | no | numbers, as references |
/// | 3MF | no | no | no | no | no |
///
/// Facets keep their order, but in STL and glTF with regions: there those of each region follow one another. A region without a
/// name is called by its number where a format has names alone.
pub fn encode_with_attributes(
    format: Format,
    mesh: &TriMesh,
    attributes: &Attributes,
) -> Result<(Vec<u8>, Vec<String>), DataError> {
    attributes.check_mesh(mesh)?;
    let mut held = Held::of(&format.codec().holds, mesh, attributes);
    let bytes = (format.codec().encode)(mesh, &held)?;
    let centred = || held::centred(mesh).map_or_else(|| held::rounding(mesh), |(moved, _)| held::rounding(&moved));
    held.left_out.extend(match format {
        Format::Stl => held::rounding(mesh),
        Format::Glb | Format::Gltf => centred(),
        Format::Ply => renamed(held.scalars, ply::word),
        Format::Gmsh => renamed(held.scalars, gmsh::quoted),
        _ => None,
    });
    let quotes = |name: &str| format == Format::Gmsh && gmsh::quoted(name) != name;
    let are_quoted = held.regions.is_some_and(|regions| regions.all().iter().any(|region| quotes(&region.name)));
    held.left_out.extend(are_quoted.then(|| "quotes in names of regions (they are ')".to_owned()));
    held.left_out.extend(match format {
        Format::Obj => regions::renamed(held.regions, obj::word),
        Format::Stl => regions::renamed(held.regions, str::to_owned),
        Format::Gmsh => regions::renumbered(held.regions, &gmsh::GROUPS),
        Format::Medit | Format::MeditBinary => regions::renumbered(held.regions, &medit::REFERENCES),
        Format::Ply => regions::renumbered(held.regions, &ply::LABELS),
        _ => None,
    });
    Ok((bytes, held.left_out))
}

/// The triangles that a reader collects, not yet validated.
#[derive(Debug, Default)]
struct Soup {
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    /// Which of them are polygons' with more than three corners, all of them fans.
    fans: Vec<Fan>,
    /// How many facets each cell has, if that is asked for.
    cells: Option<Vec<u32>>,
    raw: Raw,
}

impl Soup {
    /// Adds a polygon as a fan around its first corner. The message says what is wrong with it; the caller knows where it stands.
    fn push_polygon<T: Copy + Into<i64>>(&mut self, corners: &[T]) -> Result<(), String> {
        let mut polygon = self.begin_polygon(self.positions.len(), corners.len());
        corners.iter().try_for_each(|&corner| self.push_corner(&mut polygon, corner.into()))?;
        self.end_polygon(&polygon)
    }

    /// Begins a polygon of this many corners, which name some of this many vertices.
    fn begin_polygon(&mut self, vertices: usize, corners: usize) -> Polygon {
        // The list grows by half, and for a large polygon by no more than that needs.
        let more = corners.saturating_sub(2);
        if self.facets.capacity() - self.facets.len() < more {
            self.facets.reserve_exact(more.max(self.facets.len() / 2));
        }
        Polygon { vertices, first: 0, last: 0, corners: 0 }
    }

    fn push_corner(&mut self, polygon: &mut Polygon, corner: i64) -> Result<(), String> {
        let vertices = polygon.vertices;
        let next = u32::try_from(corner)
            .ok()
            .filter(|&v| (v as usize) < vertices)
            .ok_or_else(|| format!("vertex {corner} is named, but there are {vertices} vertices, counted from 0"))?;
        match polygon.corners {
            0 => polygon.first = next,
            1 => {}
            _ => self.facets.push([polygon.first, polygon.last, next]),
        }
        polygon.last = next;
        polygon.corners += 1;
        Ok(())
    }

    fn end_polygon(&mut self, polygon: &Polygon) -> Result<(), String> {
        let facets = match polygon.corners {
            corners @ ..3 => return Err(format!("a face needs at least 3 corners and has {corners}")),
            corners => corners - 2,
        };
        if facets > 1 {
            // More facets than 32 bits can number are refused later.
            let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
            self.fans.push((count(self.facets.len() - facets), count(facets)));
        }
        Ok(())
    }
}

/// A polygon of which some corners are read.
struct Polygon {
    vertices: usize,
    first: u32,
    last: u32,
    corners: usize,
}

#[cfg(test)]
mod tests;
