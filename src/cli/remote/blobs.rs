//! Blobs: uploads and downloads.
//!
//! Invariant: an upload goes on where the server says that it was cut, a download where the bytes that came end; either ends
//! if nothing comes for long. What is written was checked piece by piece, and is whole only if its digest is right.
//! Must not know: jobs, files' names.

use std::collections::HashSet;
use std::io;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Result;
use tonic::{Code, Response};

use super::faults::{self, Fault, wrong};
use super::link::{Door, Link, Sent};
use super::session::{Session, one};
use crate::exit::NoInput;
use crate::progress::Progress;
use crate::source::{Pieces, Source};
use wire::pieces::{Incoming, PIECE_BYTES, piece};
use wire::proto::blob_service_client::BlobServiceClient;
use wire::proto::{
    FindMissingRequest, QueryWriteStatusRequest, QueryWriteStatusResponse, ReadRequest, StatRequest, WriteRequest,
    WriteResponse,
};

/// How many digests are asked for at once.
const DIGESTS: usize = 10_000;

pub(crate) fn blobs(door: Door) -> BlobServiceClient<Door> {
    BlobServiceClient::new(door).max_decoding_message_size(16 << 20)
}

/// Takes bytes as they come.
type Sink<'a> = &'a mut dyn FnMut(&[u8]) -> Result<()>;

/// How the sending of pieces ended early, if it did.
type Broken = Arc<Mutex<Option<io::Error>>>;

impl Session<'_> {
    pub(crate) async fn stat(&mut self, digest: &str) -> Result<u64> {
        let request = StatRequest { digest: digest.to_owned() };
        let answer = self.once(async |link| one(link, blobs(link.channel()).stat(request)).await).await?;
        if answer.digest == digest { Ok(answer.size_bytes) } else { Err(wrong("it is about another blob")) }
    }

    /// Uploads those of `sources` that the server does not have; how many bytes that were.
    pub(crate) async fn upload(&mut self, sources: &[Source], progress: &Progress) -> Result<u64> {
        let mut missing = HashSet::new();
        for some in sources.chunks(DIGESTS) {
            let digests: Vec<String> = some.iter().map(|source| source.digest.clone()).collect();
            let ask = async |link: &Link<'_>| {
                let request = FindMissingRequest { digests: digests.clone() };
                one(link, blobs(link.channel()).find_missing(request)).await
            };
            missing.extend(self.repeat(ask).await?.digests);
        }
        let mut sent = 0;
        for source in sources {
            // The same bytes may have several names.
            if missing.remove(&source.digest) {
                sent += self.upload_one(source, progress).await?;
            }
        }
        Ok(sent)
    }

    async fn upload_one(&mut self, source: &Source, progress: &Progress) -> Result<u64> {
        let (mut kept, mut most) = (0, 0);
        loop {
            let tried = self.once(async |link| go_on(link, source, &mut kept, progress).await).await;
            if kept > most {
                most = kept;
                self.again.came();
            }
            match tried {
                Ok(()) => {
                    self.again.came();
                    return Ok(source.size);
                }
                Err(fault) => self.lost(fault).await?,
            }
        }
    }

    /// Fetches a blob and gives its bytes to `sink` as they come; how many there are.
    pub(crate) async fn download(&mut self, digest: &str, sink: Sink<'_>, progress: &Progress) -> Result<u64> {
        let mut blob = Incoming::new(digest);
        loop {
            let before = blob.bytes();
            let tried = self.once(async |link| read_on(link, digest, &mut blob, sink, progress).await).await;
            if blob.bytes() > before {
                self.again.came();
            }
            match tried {
                Ok(()) => return blob.finish().map_err(wrong),
                Err(fault) => self.lost(fault).await?,
            }
        }
    }
}

/// Sends what the server does not have of `source`. What it had is then in `kept`.
async fn go_on(link: &Link<'_>, source: &Source, kept: &mut u64, progress: &Progress) -> Result<(), Fault> {
    let (digest, size_bytes) = (source.digest.clone(), source.size);
    let request = QueryWriteStatusRequest { digest: digest.clone(), size_bytes };
    let status = match link.first(blobs(link.channel()).query_write_status(request)).await? {
        Ok(answer) => answer.into_inner(),
        Err(status) if status.code() == Code::NotFound => QueryWriteStatusResponse::default(),
        Err(status) => return Err(faults::of_call(link.url, &status)),
    };
    if status.complete {
        return Ok(());
    }
    if status.kept_bytes > size_bytes {
        return Err(wrong(format!("it has {} bytes of a blob of {size_bytes}", status.kept_bytes)).into());
    }
    *kept = status.kept_bytes;
    let broken = Broken::default();
    let unread = |cause| anyhow::Error::from(NoInput { path: source.path.clone(), cause });
    let left = (size_bytes - status.kept_bytes).div_ceil(PIECE_BYTES as u64);
    let counter = progress.counter("upload", left);
    let pieces = source.pieces(status.kept_bytes).map_err(unread)?;
    let messages = messages(pieces, digest.clone(), size_bytes, Arc::clone(&broken), (link.sent(), counter));
    let answer = link.first(blobs(link.channel()).write(tokio_stream::iter(messages))).await?;
    if let Some(cause) = broken.lock().unwrap_or_else(PoisonError::into_inner).take() {
        return Err(unread(cause).into());
    }
    match answer.map(Response::into_inner) {
        Ok(WriteResponse { complete: true, digest: stored, .. }) if stored == digest => Ok(()),
        Ok(WriteResponse { complete: true, .. }) => Err(wrong("it is about another blob").into()),
        Ok(_) => Err(wrong(format!("all {size_bytes} bytes were sent, but the blob is not complete")).into()),
        // Another upload of the same bytes went on, or the bytes of a cut one are not what they were.
        Err(status) if status.code() == Code::OutOfRange => match faults::of_call(link.url, &status) {
            Fault::Lost(error) | Fault::Final(error) => Err(Fault::Lost(error)),
        },
        Err(status) => Err(faults::of_call(link.url, &status)),
    }
}

/// The messages of an upload: the first names the blob, the last says finish.
fn messages(
    mut pieces: Pieces,
    digest: String,
    size_bytes: u64,
    broken: Broken,
    (sent, mut told): (Sent, impl FnMut() + Send + 'static),
) -> impl Iterator<Item = WriteRequest> + Send + 'static {
    let (mut name, mut ended) = (Some(digest), false);
    std::iter::from_fn(move || {
        if ended {
            return None;
        }
        let mut message = match pieces.next() {
            Some(Ok((at, data))) => piece(at, data),
            None => {
                ended = true;
                WriteRequest { finish: true, ..piece(size_bytes, Vec::new()) }
            }
            // A stream without finish leaves the upload as it is.
            Some(Err(cause)) => {
                ended = true;
                *broken.lock().unwrap_or_else(PoisonError::into_inner) = Some(cause);
                return None;
            }
        };
        if let Some(digest) = name.take() {
            (message.digest, message.size_bytes) = (digest, size_bytes);
        }
        if !ended {
            told();
        }
        sent.fetch_add(1, Ordering::Relaxed);
        Some(message)
    })
}

async fn read_on(
    link: &Link<'_>,
    digest: &str,
    blob: &mut Incoming,
    sink: Sink<'_>,
    progress: &Progress,
) -> Result<(), Fault> {
    let request = ReadRequest { digest: digest.to_owned(), offset: blob.bytes(), limit_bytes: 0 };
    let mut pieces = one(link, blobs(link.channel()).read(request)).await?;
    while !blob.whole() {
        match link.first(pieces.message()).await? {
            Ok(Some(piece)) => {
                blob.take(&piece).map_err(wrong)?;
                sink(&piece.data)?;
                let pieces = |bytes: u64| bytes.div_ceil(PIECE_BYTES as u64);
                progress.stage("download", pieces(blob.bytes()), pieces(piece.size_bytes));
            }
            Ok(None) => {
                let (came, size) = (blob.bytes(), blob.size().unwrap_or_default());
                return Err(wrong(format!("it ended after {came} of {size} bytes of the blob")).into());
            }
            Err(status) => return Err(faults::of_call(link.url, &status)),
        }
    }
    Ok(())
}
