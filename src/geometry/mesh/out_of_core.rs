//! Surfaces in files that are larger than memory.
//!
//! Purpose: [`MeshFile`] reads binary PLY and STL a window of facets at a time, with the corners of each, in memory that does not
//! grow with the file: its bounds, its vertices at one place ([`Welds`]), its facets in the order of the file. [`Sorter`] puts
//! records in order that are more than memory holds.
//! Files are read by positioned reads into memory of the process, and not mapped: a map needs unsafe code, and a file that somebody cuts
//! short while it is mapped ends the process with a signal. A read of such a file is an error. The system keeps what was
//! read lately in memory that is free, as it does for a map.
//! Invariant: vertices, corners, refusals and vertices at one place are those of the surface that [`super::io::read`] makes of
//! the file. Memory is what the caller allows. Must not know: seeds, orders of facets.

mod file;
mod sorter;
mod vertices;
mod welds;

use std::path::Path;

use glam::DVec3;

use super::io::{DataError, Format, Unfit, ply, stl};
use super::numbers::NumberType;
use super::{CHUNK, MAX_ELEMENTS, MeshError, check_extent};
use crate::token::{Stopped, Token};
pub use file::Scratch;
pub(crate) use file::{ReadAt, WriteAt};
pub(crate) use sorter::Sorter;
use vertices::{Table, each_through_table};
pub use welds::Welds;

/// Facets of a window. Partial sums of areas are of as many.
pub(crate) const WINDOW: usize = CHUNK;

/// Bytes that are read at once, about.
pub(crate) const READ: usize = 1 << 20;

/// Why a file could not be read in windows.
#[derive(Debug, thiserror::Error)]
pub enum MeshFileError {
    /// The file cannot be read, or has become shorter.
    #[error("cannot read it: {0}")]
    Read(#[source] std::io::Error),
    /// Scratch files cannot be written or read.
    #[error("cannot use {} for scratch files: {cause}; name another folder", .folder.display())]
    Scratch {
        /// Where they are.
        folder: std::path::PathBuf,
        /// What the system says.
        cause: std::io::Error,
    },
    /// The file is of a kind that is read as a whole.
    #[error(
        "{0}; only binary little-endian .ply (float or double, triangles as uchar and int) and binary .stl are read in windows"
    )]
    NotInWindows(String),
    /// The file is no surface.
    #[error(transparent)]
    Data(#[from] DataError),
    /// The memory that is allowed does not suffice.
    #[error("{needed_bytes} bytes of memory are needed at least, and {limit_bytes} are allowed; allow more")]
    DoesNotFit {
        /// The least that does.
        needed_bytes: u64,
        /// What is allowed.
        limit_bytes: u64,
    },
    /// The caller asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

impl From<Unfit> for MeshFileError {
    fn from(unfit: Unfit) -> Self {
        match unfit {
            Unfit::Data(error) => Self::Data(error),
            Unfit::Kind(reason) => Self::NotInWindows(reason),
        }
    }
}

impl From<MeshError> for MeshFileError {
    fn from(error: MeshError) -> Self {
        Self::Data(error.into())
    }
}

/// A surface in a file, of which nothing is in memory but where its records are.
#[derive(Debug)]
pub struct MeshFile {
    file: ReadAt,
    places: Places,
    /// Bytes of a coordinate: 4 or 8.
    number: usize,
}

#[derive(Clone, Copy, Debug)]
enum Places {
    /// Vertices, and facets that name them.
    Indexed(ply::Places),
    /// Facets with corners of their own, each a vertex.
    Alone { at: u64, stride: usize, facets: usize },
}

/// Facets in the order of the file.
#[derive(Debug, Default)]
pub struct Window {
    /// The number of the first.
    pub first: usize,
    /// Their corners, caller's coordinates.
    pub corners: Vec<[DVec3; 3]>,
    /// For each corner the lowest vertex at its place, or a number with the same order within the facet.
    pub welded: Vec<[u32; 3]>,
}

/// How much memory a pass over the facets may take for vertices, and where the rest goes.
#[derive(Clone, Copy, Debug)]
pub struct Room<'a> {
    /// Bytes for vertices. If all do not fit, the facets are read several times.
    pub vertex_bytes: usize,
    /// Where scratch files go.
    pub scratch: &'a Scratch,
}

impl MeshFile {
    /// Opens a file and reads its header. Errors: `NotInWindows` for formats and variants that are read as a whole.
    pub fn open(path: &Path, format: Format) -> Result<Self, MeshFileError> {
        let file = ReadAt::open(path).map_err(MeshFileError::Read)?;
        let head = file.head(READ).map_err(MeshFileError::Read)?;
        let places = match format {
            _ if super::io::are_packed(&head) => {
                return Err(MeshFileError::NotInWindows("the file is packed by gzip".to_owned()));
            }
            Format::Ply => Places::Indexed(ply::places(&head, file.bytes())?),
            Format::Stl => {
                let facets = stl::facets_alone(&head, file.bytes())?;
                Places::Alone { at: stl::HEADER as u64, stride: stl::RECORD, facets }
            }
            other => {
                return Err(MeshFileError::NotInWindows(format!("the file is .{}", other.extension())));
            }
        };
        let number = match places {
            Places::Indexed(places) => places.number.bytes(),
            Places::Alone { .. } => NumberType::F32.bytes(),
        };
        let opened = Self { file, places, number };
        for (what, count) in [("vertices", opened.vertices()), ("facets", opened.facets())] {
            if count > MAX_ELEMENTS {
                return Err(MeshError::TooLarge { what, count }.into());
            }
        }
        if opened.facets() == 0 {
            return Err(MeshError::NoFacets.into());
        }
        Ok(opened)
    }

    /// Number of facets.
    pub fn facets(&self) -> usize {
        match self.places {
            Places::Indexed(places) => places.facets.count,
            Places::Alone { facets, .. } => facets,
        }
    }

    /// Number of vertices: three a facet where these stand alone.
    pub fn vertices(&self) -> usize {
        match self.places {
            Places::Indexed(places) => places.vertices.count,
            Places::Alone { facets, .. } => 3 * facets,
        }
    }

    /// Whether facets name vertices of a list.
    pub fn is_indexed(&self) -> bool {
        matches!(self.places, Places::Indexed(_))
    }

    /// Bytes of a coordinate: 4 or 8.
    pub fn number_bytes(&self) -> usize {
        self.number
    }

    /// Length of the file.
    pub fn bytes(&self) -> u64 {
        self.file.bytes()
    }

    /// The box around all vertices that a facet uses. Refuses what [`super::TriMesh::new`] refuses, but for surfaces
    /// without area. Takes a bit a vertex.
    pub fn bounds(&self, token: &Token) -> Result<(DVec3, DVec3), MeshFileError> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut used = Bits::default();
        if let Places::Indexed(places) = &self.places {
            used = Bits::new(places.vertices.count);
            self.each_indices(places, token, |_, facets| -> Result<(), MeshFileError> {
                facets.iter().flatten().for_each(|&v| used.set(v as usize));
                Ok(())
            })?;
        }
        let all = !self.is_indexed();
        self.each_positions(0..self.vertices(), token, |vertex, position| {
            if !position.is_finite() {
                return Err(MeshError::NonFinitePosition { vertex, position }.into());
            }
            if all || used.get(vertex) {
                (low, high) = (low.min(position), high.max(position));
            }
            Ok(())
        })?;
        check_extent((high - low).max_element())?;
        Ok((low, high))
    }

    /// Visits all facets in the order of the file, [`WINDOW`] at a time.
    pub(crate) fn each_window<E: From<MeshFileError>>(
        &self,
        room: Room<'_>,
        welds: Option<&Welds>,
        token: &Token,
        mut visit: impl FnMut(&Window) -> Result<(), E>,
    ) -> Result<(), E> {
        match &self.places {
            Places::Indexed(places) => each_through_table(self, places, room, welds, token, visit),
            Places::Alone { at, stride, facets } => {
                let (mut window, mut bytes) = (Window::default(), Vec::new());
                for first in (0..*facets).step_by(WINDOW) {
                    token.check().map_err(MeshFileError::from)?;
                    let count = WINDOW.min(facets - first);
                    bytes.resize(count * stride, 0);
                    let from = at + (first * stride) as u64;
                    self.file.read(from, &mut bytes).map_err(MeshFileError::Read)?;
                    window.first = first;
                    window.corners.clear();
                    let corner = |record: &[u8], c: usize| position(&record[12 + 12 * c..][..12], 4);
                    let corners = bytes.chunks_exact(*stride).map(|r| [0, 1, 2].map(|c| corner(r, c)));
                    window.corners.extend(corners);
                    window.welded.clear();
                    match welds {
                        None => window.welded.extend((first..first + count).map(|f| corners_of(f as u32))),
                        Some(welds) => welds.read(3 * first, 3 * count, |welded| {
                            window.welded.extend(welded.chunks_exact(3).map(|w| [w[0], w[1], w[2]]));
                        })?,
                    }
                    visit(&window)?;
                }
                Ok(())
            }
        }
    }

    /// Visits the facets of a file with vertices, each with the vertices that it names, which are checked.
    fn each_indices<E: From<MeshFileError>>(
        &self,
        places: &ply::Places,
        token: &Token,
        mut visit: impl FnMut(usize, &[[u32; 3]]) -> Result<(), E>,
    ) -> Result<(), E> {
        let ply::Places { facets: records, list, vertices, .. } = places;
        let (mut bytes, mut facets) = (Vec::new(), Vec::with_capacity(WINDOW));
        for first in (0..records.count).step_by(WINDOW) {
            token.check().map_err(MeshFileError::from)?;
            let count = WINDOW.min(records.count - first);
            bytes.resize(count * records.stride, 0);
            self.file.read(records.at + (first * records.stride) as u64, &mut bytes).map_err(MeshFileError::Read)?;
            facets.clear();
            for (k, record) in bytes.chunks_exact(records.stride).enumerate() {
                facets.push(ply::triangle(record, *list, vertices.count, first + k).map_err(MeshFileError::from)?);
            }
            visit(first, &facets)?;
        }
        Ok(())
    }

    /// Visits a range of vertices with their positions.
    fn each_positions(
        &self,
        range: std::ops::Range<usize>,
        token: &Token,
        mut visit: impl FnMut(usize, DVec3) -> Result<(), MeshFileError>,
    ) -> Result<(), MeshFileError> {
        let (at, stride, each, offsets) = match self.places {
            Places::Indexed(p) => (p.vertices.at, p.vertices.stride, 1, p.axes),
            // A record has three, one behind the other.
            Places::Alone { at, stride, .. } => (at, stride, 3, [12, 16, 20]),
        };
        let records = range.start / each..range.end.div_ceil(each);
        let step = (READ / stride).max(1);
        let mut bytes = Vec::new();
        for first in records.clone().step_by(step) {
            token.check()?;
            let count = step.min(records.end - first);
            bytes.resize(count * stride, 0);
            self.file.read(at + (first * stride) as u64, &mut bytes).map_err(MeshFileError::Read)?;
            for (k, record) in bytes.chunks_exact(stride).enumerate() {
                for c in 0..each {
                    let vertex = (first + k) * each + c;
                    if range.contains(&vertex) {
                        let axis = |axis: usize| number(&record[offsets[axis] + 3 * self.number * c..], self.number);
                        visit(vertex, DVec3::new(axis(0), axis(1), axis(2)))?;
                    }
                }
            }
        }
        Ok(())
    }

    /// An empty table of positions, as it is kept in memory.
    fn table(&self, welds: bool) -> Table {
        Table::new(self.number, welds)
    }
}

/// The vertices of a facet that stands alone.
fn corners_of(facet: u32) -> [u32; 3] {
    [3 * facet, 3 * facet + 1, 3 * facet + 2]
}

/// The coordinate that begins these bytes, of 4 or 8 of them, the lowest first.
pub(crate) fn number(bytes: &[u8], length: usize) -> f64 {
    match length {
        4 => bytes.first_chunk().map_or(f64::NAN, |&b| f64::from(f32::from_le_bytes(b))),
        _ => bytes.first_chunk().map_or(f64::NAN, |&b| f64::from_le_bytes(b)),
    }
}

/// The position that begins these bytes.
pub(crate) fn position(bytes: &[u8], length: usize) -> DVec3 {
    DVec3::new(number(bytes, length), number(&bytes[length..], length), number(&bytes[2 * length..], length))
}

/// Writes a position that was read with numbers of this length.
pub(crate) fn put_position(out: &mut [u8], length: usize, p: DVec3) {
    for (out, x) in out.chunks_exact_mut(length).zip(p.to_array()) {
        match length {
            4 => out.copy_from_slice(&(x as f32).to_le_bytes()),
            _ => out.copy_from_slice(&x.to_le_bytes()),
        }
    }
}

#[derive(Default)]
struct Bits(Vec<u64>);

impl Bits {
    fn new(count: usize) -> Self {
        Self(vec![0; count.div_ceil(64)])
    }

    fn set(&mut self, at: usize) {
        self.0[at / 64] |= 1 << (at % 64);
    }

    fn get(&self, at: usize) -> bool {
        self.0[at / 64] >> (at % 64) & 1 != 0
    }
}
