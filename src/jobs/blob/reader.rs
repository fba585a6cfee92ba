//! Blobs as streams of bytes.
//!
//! Purpose: turns what the object store opened into pieces of at most [`READ_BYTES`]. Invariant: the stream gives exactly
//! the range that was opened, or ends with an error. One of a whole blob ends with an error if its bytes have another
//! digest. It holds two pieces at most. Must not know: its callers.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::{GetResult, GetResultPayload, ObjectStore, ObjectStoreExt};
use tokio::task::{JoinHandle, spawn_blocking};

use super::digest::{Tally, path_of};
use super::error::{found, io, join, object};
use super::{BlobError, ByteStream, Digest, READ_BYTES};

/// The bytes that were opened; if they are to be those of `whole`, that is looked at.
pub(super) fn bytes_of(opened: GetResult, whole: Option<Digest>) -> ByteStream {
    let range = opened.range.clone();
    let check = whole.map(|digest| Check { tally: Tally::default(), digest });
    match opened.payload {
        // Far larger pieces than object_store's own stream of a file has.
        GetResultPayload::File(file, _) => file_pieces(file, range.start, range.end - range.start, check),
        GetResultPayload::Stream(bytes) => {
            let pieces = bytes.map(|piece| piece.map_err(object("read a blob")));
            checked(pieces.flat_map(|piece| stream::iter(cut(piece))).boxed(), check)
        }
    }
}

/// The bytes of a file that were looked at before.
pub(super) fn bytes_of_file(file: File, length: u64) -> ByteStream {
    file_pieces(file, 0, length, None)
}

/// Whether the bytes of a blob are stored, and right. Reads all of them.
pub(super) async fn is_sound(objects: &dyn ObjectStore, digest: Digest) -> Result<bool, BlobError> {
    let Some(opened) = found("open a blob", objects.get(&path_of(&digest)).await)? else { return Ok(false) };
    match bytes_of(opened, Some(digest)).try_for_each(async |_| Ok(())).await {
        Err(BlobError::Damaged { .. }) => Ok(false),
        read => read.map(|()| true),
    }
}

/// Whether all bytes are those of a blob.
struct Check {
    tally: Tally,
    digest: Digest,
}

impl Check {
    fn end(&self) -> Result<(), BlobError> {
        match self.tally.digest() == self.digest {
            true => Ok(()),
            false => Err(BlobError::Damaged { digest: self.digest }),
        }
    }
}

/// The same stream, with an error at its end if it was another blob.
fn checked(pieces: ByteStream, check: Option<Check>) -> ByteStream {
    let Some(check) = check else { return pieces };
    let checked = stream::unfold(Some((pieces, check)), |state| async move {
        let (mut pieces, mut check) = state?;
        match pieces.next().await {
            Some(Ok(piece)) => {
                check.tally.add(&piece);
                Some((Ok(piece), Some((pieces, check))))
            }
            Some(Err(error)) => Some((Err(error), None)),
            None => check.end().err().map(|error| (Err(error), None)),
        }
    });
    checked.boxed()
}

/// Cuts a piece that is too long.
fn cut(piece: Result<Bytes, BlobError>) -> impl Iterator<Item = Result<Bytes, BlobError>> {
    let mut rest = Some(piece);
    std::iter::from_fn(move || match rest.take()? {
        Ok(mut bytes) if bytes.len() > READ_BYTES => {
            let piece = bytes.split_to(READ_BYTES);
            rest = Some(Ok(bytes));
            Some(Ok(piece))
        }
        last => Some(last),
    })
}

/// A file that is read while the reader is busy with the piece before.
struct Ahead {
    next: JoinHandle<std::io::Result<(File, Bytes, Option<Check>)>>,
    rest_bytes: u64,
}

impl Ahead {
    fn new(mut file: File, seek: Option<u64>, rest_bytes: u64, mut check: Option<Check>) -> Self {
        let next = spawn_blocking(move || {
            if let Some(start) = seek {
                file.seek(SeekFrom::Start(start))?;
            }
            let length = rest_bytes.min(READ_BYTES as u64);
            let mut piece = Vec::with_capacity(READ_BYTES.min(usize::try_from(length).unwrap_or(READ_BYTES)));
            (&mut file).take(length).read_to_end(&mut piece)?;
            if let Some(check) = &mut check {
                check.tally.add(&piece);
            }
            Ok((file, piece.into(), check))
        });
        Self { next, rest_bytes }
    }
}

fn file_pieces(file: File, start: u64, length: u64, check: Option<Check>) -> ByteStream {
    if length == 0 {
        return stream::iter(check.and_then(|check| check.end().err()).map(Err)).boxed();
    }
    let first = Ahead::new(file, Some(start), length, check);
    let pieces = stream::unfold(Some(first), |ahead| async move {
        let Ahead { next, rest_bytes } = ahead?;
        let (file, piece, check) = match next.await.map_err(join).and_then(|read| read.map_err(io("read a blob"))) {
            Ok(read) => read,
            Err(error) => return Some((Err(error), None)),
        };
        let rest_bytes = rest_bytes - piece.len() as u64;
        if piece.is_empty() {
            let short = format!("a blob ends {rest_bytes} bytes early; its file was changed by another program");
            return Some((Err(BlobError::Unavailable(short)), None));
        }
        match (rest_bytes, &check) {
            // The last piece of a wrong blob is held back.
            (0, Some(check)) => Some((check.end().map(|()| piece), None)),
            (0, None) => Some((Ok(piece), None)),
            _ => Some((Ok(piece), Some(Ahead::new(file, None, rest_bytes, check)))),
        }
    });
    pieces.boxed()
}
