//! Blobs as streams of bytes.
//!
//! Purpose: turns what the object store opened into pieces of at most [`READ_BYTES`].
//! Invariant: the stream gives exactly the range that was opened, or ends with an error. It holds two pieces at most.
//! Must not know: which blob it is, or who reads.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

use bytes::Bytes;
use futures_util::{StreamExt, stream};
use object_store::{GetResult, GetResultPayload};
use tokio::task::{JoinHandle, spawn_blocking};

use super::error::{io, join, object};
use super::{BlobError, ByteStream, READ_BYTES};

/// The bytes that were opened.
pub(super) fn bytes_of(opened: GetResult) -> ByteStream {
    let range = opened.range.clone();
    match opened.payload {
        // Far larger pieces than object_store's own stream of a file has.
        GetResultPayload::File(file, _) => file_pieces(file, range.start, range.end - range.start),
        GetResultPayload::Stream(bytes) => {
            let pieces = bytes.map(|piece| piece.map_err(object("read a blob")));
            pieces.flat_map(|piece| stream::iter(cut(piece))).boxed()
        }
    }
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
    next: JoinHandle<std::io::Result<(File, Bytes)>>,
    rest_bytes: u64,
}

impl Ahead {
    fn new(mut file: File, seek: Option<u64>, rest_bytes: u64) -> Self {
        let next = spawn_blocking(move || {
            if let Some(start) = seek {
                file.seek(SeekFrom::Start(start))?;
            }
            let length = rest_bytes.min(READ_BYTES as u64);
            let mut piece = Vec::with_capacity(READ_BYTES.min(usize::try_from(length).unwrap_or(READ_BYTES)));
            (&mut file).take(length).read_to_end(&mut piece)?;
            Ok((file, piece.into()))
        });
        Self { next, rest_bytes }
    }
}

fn file_pieces(file: File, start: u64, length: u64) -> ByteStream {
    if length == 0 {
        return stream::empty().boxed();
    }
    let first = Ahead::new(file, Some(start), length);
    let pieces = stream::unfold(Some(first), |ahead| async move {
        let Ahead { next, rest_bytes } = ahead?;
        let (file, piece) = match next.await.map_err(join).and_then(|read| read.map_err(io("read a blob"))) {
            Ok(read) => read,
            Err(error) => return Some((Err(error), None)),
        };
        let rest_bytes = rest_bytes - piece.len() as u64;
        if piece.is_empty() {
            let short = format!("a blob ends {rest_bytes} bytes early; its file was changed by another program");
            return Some((Err(BlobError::Unavailable(short)), None));
        }
        let ahead = (rest_bytes > 0).then(|| Ahead::new(file, None, rest_bytes));
        Some((Ok(piece), ahead))
    });
    pieces.boxed()
}
