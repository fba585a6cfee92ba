//! Files that are packed with gzip, of any format: `.obj.gz` and so on. Packed files are known by their first three bytes.
//!
//! Purpose: [`unpack`] and [`pack_for`]; [`Measure`] finds the unpacked length of a stream, and keeps none of it.
//! Invariant: no more is unpacked than a limit. Must not know: formats.

use std::borrow::Cow;
use std::io::{self, Read as _, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write;
use flate2::write::GzEncoder;

use super::DataError;

/// Largest unpacked length, as a multiple of the file's, beyond the first MiB. Meshes pack to a third or a twentieth, files that are
/// made to fill the memory to a thousandth.
pub const UNPACKED_RATIO: usize = 64;

/// The default limit on the unpacked length of a file of `bytes`.
pub fn limit(bytes: usize) -> usize {
    bytes.saturating_mul(UNPACKED_RATIO).saturating_add(1 << 20)
}

/// The bytes of a file, unpacked if gzip packed them. Readers limit the length by [`UNPACKED_RATIO`]; a caller that trusts a file
/// that packs better unpacks it first.
///
/// # Errors
/// [`DataError::TooLong`] if more than `limit` bytes come out; [`DataError::Truncated`] and [`DataError::Header`] for what gzip
/// did not make.
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

/// Counts bytes and drops them.
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

    /// Takes the next packed bytes.
    ///
    /// # Errors
    /// [`DataError::TooLong`] and [`DataError::Header`], as [`unpack`].
    pub fn add(&mut self, bytes: &[u8]) -> Result<(), DataError> {
        self.decoder.write_all(bytes).map_err(|error| unpacked_wrong(&error, self.limit))
    }

    /// The unpacked length.
    pub fn finish(mut self) -> Result<usize, DataError> {
        self.decoder.try_finish().map_err(|error| unpacked_wrong(&error, self.limit))?;
        Ok(self.decoder.get_ref().bytes)
    }
}

/// Whether a file's name is that of a packed file.
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
