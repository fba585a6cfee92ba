//! Files that are packed with gzip, of any format: `.obj.gz` and so on.
//!
//! Purpose: [`unpack`] and [`pack`]. Which bytes are packed, their first three say.
//! Invariant: no more is unpacked than a limit. Must not know: formats.

use std::borrow::Cow;
use std::io::{Read as _, Write as _};
use std::path::Path;

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;

use super::DataError;

/// What is packed in a file may be so many times as long as the file, and a MiB longer: meshes pack to a third or a twentieth, and
/// what is made to fill the memory to a thousandth.
pub const UNPACKED_RATIO: usize = 64;

/// How long all may be that is unpacked from so many bytes, by default.
pub(super) fn limit(bytes: usize) -> usize {
    bytes.saturating_mul(UNPACKED_RATIO).saturating_add(1 << 20)
}

/// The bytes of a file, unpacked if gzip packed them. What reads files does so with [`UNPACKED_RATIO`]; who trusts a file that
/// packs better unpacks it first.
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
    if !bytes.starts_with(&[0x1f, 0x8b, 8]) {
        return Ok(bytes.into());
    }
    let mut out = Vec::new();
    let most = u64::try_from(limit).unwrap_or(u64::MAX).saturating_add(1);
    MultiGzDecoder::new(bytes).take(most).read_to_end(&mut out).map_err(|error| match error.kind() {
        std::io::ErrorKind::UnexpectedEof => DataError::Truncated("gzip has more to come".to_owned()),
        _ => DataError::Header("gzip cannot unpack it; fetch or pack it again".to_owned()),
    })?;
    if out.len() > limit {
        return Err(DataError::TooLong { limit });
    }
    Ok(out.into())
}

/// Whether a file's name says that it is packed.
pub(super) fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz"))
}

/// Packs what is to be written to a path, if its name says so.
pub(crate) fn pack_for(path: &Path, bytes: Vec<u8>) -> std::io::Result<Vec<u8>> {
    if !is_packed(path) {
        return Ok(bytes);
    }
    let mut packer = GzEncoder::new(Vec::with_capacity(bytes.len() / 2), Compression::default());
    packer.write_all(&bytes)?;
    packer.finish()
}
