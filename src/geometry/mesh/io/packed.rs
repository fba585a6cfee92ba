//! Files as they come: packed with gzip or not, of any format.
//!
//! Purpose: [`unpack`] and [`pack_for`]; packed files are known by their first three bytes. [`Measure`] finds the unpacked length of
//! a stream, and keeps none of it. [`recognize`] finds the format by the [`Signature`] of each. [`Room`] lets lists grow in
//! proportion to the bytes that they are read from: `{},` is a node of a glTF.
//! Invariant: no more is unpacked than a limit, and lists with one room take no more than it had. Words are compared only where no
//! start fits, since the header of a binary STL may begin with any word. Must not know: how a format begins.

use super::{DataError, Format, without_mark};
use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write;
use flate2::write::GzEncoder;
use std::borrow::Cow;
use std::io::{self, Read as _, Write};
use std::path::Path;

/// Largest unpacked length, in lengths of the file, beyond 1 MiB. Meshes pack to 1/3 or 1/20, malicious files to 1/1000.
pub const UNPACKED_RATIO: usize = 64;

/// The default limit on the unpacked length of a file of `bytes`.
pub fn limit(bytes: usize) -> usize {
    bytes.saturating_mul(UNPACKED_RATIO).saturating_add(1 << 20)
}

/// The bytes of a file, unpacked if gzip packed them. Readers' limit is [`UNPACKED_RATIO`]; callers may unpack more first.
///
/// ```
/// use tessera::mesh::io::unpack;
/// assert_eq!(*unpack(b"OFF", 3)?, *b"OFF");
/// # Ok::<(), tessera::mesh::io::DataError>(())
/// ```
pub fn unpack(bytes: &[u8], limit: usize) -> Result<Cow<'_, [u8]>, DataError> {
    if !are_packed(bytes) {
        return Ok(bytes.into());
    }
    let mut out = Vec::new();
    let most = u64::try_from(limit).unwrap_or(u64::MAX).saturating_add(1);
    MultiGzDecoder::new(bytes).take(most).read_to_end(&mut out).map_err(|error| unpacked_wrong(&error, limit))?;
    if out.len() > limit {
        return Err(DataError::TooLong { limit });
    }
    Ok(out.into())
}

/// Whether gzip packed these bytes.
pub fn are_packed(bytes: &[u8]) -> bool {
    bytes.starts_with(&[0x1f, 0x8b, 8])
}

/// The first unpacked bytes, at most `most`; fewer where the file is damaged.
pub(super) fn unpack_head(bytes: &[u8], most: usize) -> Vec<u8> {
    let mut head = Vec::new();
    // Bytes before an error are kept.
    let _ = MultiGzDecoder::new(bytes).take(most as u64).read_to_end(&mut head);
    head
}

/// Writes unpacked bytes to `to`. Its `try_finish` fails if the packed bytes are not whole.
pub fn unpacker<W: Write>(to: W) -> write::MultiGzDecoder<W> {
    write::MultiGzDecoder::new(to)
}

/// The error for one of an [`unpacker`]; [`io::ErrorKind::FileTooLarge`] is that of a limit.
pub fn unpacked_wrong(error: &io::Error, limit: usize) -> DataError {
    match error.kind() {
        io::ErrorKind::UnexpectedEof => DataError::Truncated("gzip has more to come".to_owned()),
        io::ErrorKind::FileTooLarge => DataError::TooLong { limit },
        _ => DataError::Header("gzip cannot unpack it; fetch or pack it again".to_owned()),
    }
}

/// Measures the unpacked length of a stream, up to a limit.
pub struct Measure {
    decoder: write::MultiGzDecoder<Counted>,
    limit: usize,
}

struct Counted {
    bytes: usize,
    limit: usize,
}
impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.bytes = self.bytes.saturating_add(bytes.len());
        if self.bytes > self.limit { Err(io::ErrorKind::FileTooLarge.into()) } else { Ok(bytes.len()) }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
impl Measure {
    /// Fails at more than `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self { decoder: unpacker(Counted { bytes: 0, limit }), limit }
    }

    /// Takes the next packed bytes. Fails as [`unpack`] does.
    pub fn add(&mut self, bytes: &[u8]) -> Result<(), DataError> {
        self.decoder.write_all(bytes).map_err(|error| unpacked_wrong(&error, self.limit))
    }

    /// The unpacked length.
    pub fn finish(mut self) -> Result<usize, DataError> {
        self.decoder.try_finish().map_err(|error| unpacked_wrong(&error, self.limit))?;
        Ok(self.decoder.get_ref().bytes)
    }
}

pub(super) fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz"))
}

/// Packs bytes for a path whose name ends in `.gz`.
pub fn pack_for(path: &Path, bytes: Vec<u8>) -> io::Result<Vec<u8>> {
    if !is_packed(path) {
        return Ok(bytes);
    }
    let mut packer = GzEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::default());
    packer.write_all(&bytes)?;
    packer.finish()
}

/// Bytes of lists a byte of the file. A glTF's node with mesh and matrix takes less than 3; many empty ones are refused.
const LIST_RATIO: usize = 4;

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Room {
    bytes: usize,
    all: usize,
    left: usize,
}

impl Room {
    pub(super) fn of(bytes: usize) -> Self {
        let all = bytes.saturating_mul(LIST_RATIO).saturating_add(1 << 20);
        Self { bytes, all, left: all }
    }

    /// The length of the file.
    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    pub(super) fn taken(&self) -> usize {
        self.all - self.left
    }

    pub(super) fn take(&mut self, bytes: usize) -> Result<(), DataError> {
        self.left = self.left.checked_sub(bytes).ok_or_else(|| {
            DataError::Header("it lists more elements than a file of this size may; write .ply or .obj".to_owned())
        })?;
        Ok(())
    }

    /// Adds to a list, which grows by half if it is full.
    pub(super) fn push<T>(&mut self, list: &mut Vec<T>, value: T) -> Result<(), DataError> {
        if list.len() == list.capacity() {
            let more = (list.len() / 2).max(4);
            self.take(more.saturating_mul(size_of::<T>()))?;
            list.reserve_exact(more);
        }
        list.push(value);
        Ok(())
    }
}

pub(super) enum Signature {
    Start(fn(&Head<'_>) -> bool),
    /// The first word is one of these, after empty lines and lines that begin with `#`.
    Words(&'static [&'static str]),
}

pub(super) struct Head<'a> {
    pub(super) bytes: &'a [u8],
    length: u64,
    /// The bits of the length that are known: of a packed file the lower 32.
    known: u64,
}

impl<'a> Head<'a> {
    pub(super) fn has_length(&self, expected: u64) -> bool {
        (self.length ^ expected) & self.known == 0
    }

    pub(super) fn text(&self) -> &'a [u8] {
        without_mark(self.bytes)
    }

    /// The first word, after empty lines and lines that begin with `#`.
    pub(super) fn word(&self) -> &'a [u8] {
        let mut lines = self.text().split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
        let first = lines.find(|line| !line.is_empty() && !line.starts_with(b"#")).unwrap_or_default();
        first.split(u8::is_ascii_whitespace).next().unwrap_or_default()
    }

    pub(super) fn is_document(&self, first: u8, name: &[u8]) -> bool {
        let text = self.text().trim_ascii_start();
        text.first() == Some(&first) && text.windows(name.len()).any(|window| window == name)
    }
}

const HEAD_BYTES: usize = 64 << 10;

/// The format of a file; of a packed one, by the file inside.
pub(super) fn recognize(bytes: &[u8]) -> Option<Format> {
    let unpacked;
    let head = match (are_packed(bytes), bytes.last_chunk()) {
        (true, Some(length)) => {
            unpacked = unpack_head(bytes, HEAD_BYTES);
            Head { bytes: &unpacked, length: u32::from_le_bytes(*length).into(), known: u32::MAX.into() }
        }
        _ => Head { bytes: &bytes[..bytes.len().min(HEAD_BYTES)], length: bytes.len() as u64, known: u64::MAX },
    };
    let starts = |format: &Format| matches!(format.codec().signature, Signature::Start(fits) if fits(&head));
    let word = head.word();
    let says = |format: &Format| match format.codec().signature {
        Signature::Words(words) => words.iter().any(|known| known.as_bytes() == word),
        Signature::Start(_) => false,
    };
    Format::ALL.into_iter().find(starts).or_else(|| Format::ALL.into_iter().find(says))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::io::{encode, pack_for};

    #[test]
    fn files_say_what_they_are() {
        let mut stl = vec![0; 84];
        stl[80] = 1;
        stl.resize(134, 7);
        let mut other = stl.clone();
        other[..4].copy_from_slice(b"OFF ");
        for (bytes, format) in [
            (&b"ply\nformat ascii 1.0\n"[..], Some(Format::Ply)),
            (b"# made by hand\n\nv 0 0 0\n", Some(Format::Obj)),
            (b"mtllib a.mtl\r\nv 0 0 0\n", Some(Format::Obj)),
            (b"solid cube\n", Some(Format::Stl)),
            (&stl, Some(Format::Stl)),
            (b"OFF\n3 1 0\n", Some(Format::Off)),
            (b"# vtk DataFile Version 3.0\n", Some(Format::Vtk)),
            // Its title may be a word of another format.
            (b"# vtk DataFile Version 3.0\nsolid part\nASCII\n", Some(Format::Vtk)),
            (b"<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\">", Some(Format::Vtp)),
            (b"<VTKFile byte_order=\"BigEndian\" type='UnstructuredGrid'><PolyData>", Some(Format::Vtu)),
            (b"PK\x03\x04\x14\0", Some(Format::ThreeMf)),
            (b"$MeshFormat\n4.1 0 8\n", Some(Format::Gmsh)),
            (b"\xef\xbb\xbf# made by hand\nMeshVersionFormatted 2\n", Some(Format::Medit)),
            (b"\x01\0\0\0\x02\0\0\0\x03\0\0\0", Some(Format::MeditBinary)),
            (b"glTF\x02\0\0\0", Some(Format::Glb)),
            (b"{ \"asset\": {} }", Some(Format::Gltf)),
            // A header of a binary STL may begin with a word of another format.
            (&other, Some(Format::Stl)),
            (b"<svg>", None),
            (b"{}", None),
            (b"", None),
        ] {
            assert_eq!(recognize(bytes), format);
        }
    }

    /// Files that the library writes are recognized.
    #[test]
    fn our_own_files_say_what_they_are() {
        let mesh = crate::mesh::shapes::Shape::Torus.build(200);
        for format in Format::ALL {
            let bytes = encode(format, &mesh).unwrap();
            assert_eq!(recognize(&bytes), Some(format));
            let packed = pack_for(std::path::Path::new("a.gz"), bytes).unwrap();
            assert_eq!(recognize(&packed), Some(format));
            assert_eq!(recognize(&packed[..20]), None);
        }
    }
}
