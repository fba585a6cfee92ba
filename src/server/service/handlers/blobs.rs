//! `BlobService`: uploads that can go on after a cut, downloads of ranges, and questions about blobs.
//!
//! Invariant: while one piece of an upload is stored the next may arrive, and no more; of a download only what waits for
//! the client is held. A blob exists only for a tenant that has it: whatever is asked of another's, the
//! answer is that of a blob that is not stored. Bytes are handed on, never copied. An upload that is cut in any way stays as far as it is stored.
//! Must not know: where blobs lie, how statuses look.

use std::sync::Arc;

use futures_util::TryStreamExt as _;
use tonic::{Request, Streaming};

use super::Reply;
use crate::config::Limits;
use crate::service::RequestError;
use crate::service::access::Caller;
use crate::service::convert::digest;
use crate::service::desk::{EmptyUpload, STORE_TIME, check_owned, tenant_of, timely};
use crate::service::stream::{Answers, Gate, Inbox, Kind, Outbox, answer, respond};
use jobs::blob::{BlobError, BlobInfo, BlobStore, Chunk, Digest, Owner, UploadId, UploadStatus};
use transport::{Budget, Phase, Share};
use wire::{WireError, proto};

const MOST_DIGESTS: usize = 10_000;

pub(in crate::service) struct Blobs {
    store: Arc<dyn BlobStore>,
    limits: Limits,
    budget: Budget,
    gate: Gate,
}

impl Blobs {
    pub(in crate::service) fn new(store: Arc<dyn BlobStore>, limits: Limits, budget: Budget, gate: Gate) -> Self {
        Self { store, limits, budget, gate }
    }

    /// A question with one answer, in the name of a tenant.
    async fn ask<M, T, F: Future<Output = Result<T, RequestError>>>(
        &self,
        method: &'static str,
        request: Request<M>,
        work: impl FnOnce(M, Owner, Arc<dyn BlobStore>) -> F,
    ) -> Reply<T> {
        let (metadata, extensions, message) = request.into_parts();
        let tenant = tenant_of(metadata.as_ref(), &extensions)?;
        let work = work(message, Owner::of(&tenant), Arc::clone(&self.store));
        answer((method, Kind::Call, &tenant), &metadata, &extensions, &self.gate, Some(STORE_TIME), work).await
    }

    /// Reads an upload until it finishes, its client ends it, or the blob is there. `most` is what its tenant may have, bytes.
    async fn receive(
        &self,
        mut inbox: Inbox<proto::WriteRequest>,
        tenant: &str,
        most: Option<u64>,
    ) -> Result<proto::WriteResponse, RequestError> {
        let deadline = tokio::time::Instant::now() + self.limits.upload;
        let Some((mut message, mut share)) = self.next(&mut inbox, tenant, deadline).await? else {
            return Err(WireError::Order("the stream ended before its first message, which names the blob").into());
        };
        let upload = UploadId::new(digest("digest", &message.digest)?, message.size_bytes).of(tenant);
        let mut status = timely(self.store.begin_within(upload, most)).await?;
        let _empty = EmptyUpload::new(&self.store, upload);
        while !status.complete {
            let proto::WriteRequest { digest: _, size_bytes: _, offset, data, crc32c, finish } = message;
            let chunk = Chunk { offset, bytes: data, crc32c };
            let storing = store(&*self.store, upload, chunk, status);
            if finish {
                status = storing.await?;
                if !status.complete {
                    let BlobInfo { size_bytes, .. } = timely(self.store.finish(upload, None)).await?;
                    status = UploadStatus { kept_bytes: size_bytes, complete: true };
                }
                break;
            }
            // The next piece comes while this one is stored; a fault of either ends both.
            let next;
            (status, next) = tokio::try_join!(storing, self.next(&mut inbox, tenant, deadline))?;
            drop(share);
            let Some(next) = next else { break };
            check_same(upload, &next.0)?;
            (message, share) = next;
        }
        let UploadStatus { kept_bytes, complete } = status;
        Ok(proto::WriteResponse {
            digest: upload.digest.to_string(),
            size_bytes: upload.size_bytes,
            kept_bytes,
            complete,
        })
    }

    /// The next message with its memory. It must come before the time for the upload is over.
    async fn next(
        &self,
        inbox: &mut Inbox<proto::WriteRequest>,
        tenant: &str,
        deadline: tokio::time::Instant,
    ) -> Result<Option<(proto::WriteRequest, Share)>, RequestError> {
        let message = tokio::select! {
            message = inbox.next(self.limits.upload_idle) => message?,
            () = tokio::time::sleep_until(deadline) => return Err(RequestError::UploadTime(self.limits.upload)),
            // The upload goes on elsewhere, or when the server is back.
            () = self.gate.reached(Phase::Draining) => return Err(RequestError::Draining),
        };
        let Some(message) = message else { return Ok(None) };
        let mut share = self.budget.upload_of(tenant);
        share.grow(message.data.len() as u64)?;
        Ok(Some((message, share)))
    }
}

#[tonic::async_trait]
impl proto::blob_service_server::BlobService for Blobs {
    type ReadStream = Answers<proto::ReadResponse>;

    async fn write(&self, request: Request<Streaming<proto::WriteRequest>>) -> Reply<proto::WriteResponse> {
        let (metadata, extensions, stream) = request.into_parts();
        let tenant = tenant_of(metadata.as_ref(), &extensions)?;
        let most = extensions.get::<Caller>().and_then(|caller| caller.bytes);
        let work = self.receive(Inbox::new(stream), &tenant, most);
        // No limit as a whole besides that of uploads.
        answer(("Write", Kind::Stream, &tenant), &metadata, &extensions, &self.gate, None, work).await
    }

    async fn query_write_status(
        &self,
        request: Request<proto::QueryWriteStatusRequest>,
    ) -> Reply<proto::QueryWriteStatusResponse> {
        let tenant = tenant_of(request.metadata().as_ref(), request.extensions())?;
        self.ask("QueryWriteStatus", request, |message, _, store| async move {
            let proto::QueryWriteStatusRequest { digest: named, size_bytes } = message;
            let upload = UploadId::new(digest("digest", &named)?, size_bytes).of(&tenant);
            let UploadStatus { kept_bytes, complete } = store.upload_status(upload).await?;
            Ok(proto::QueryWriteStatusResponse { kept_bytes, complete })
        })
        .await
    }

    async fn read(&self, request: Request<proto::ReadRequest>) -> Reply<Self::ReadStream> {
        let (metadata, extensions, message) = request.into_parts();
        let tenant = tenant_of(metadata.as_ref(), &extensions)?;
        let (store, owner) = (Arc::clone(&self.store), Owner::of(&tenant));
        Ok(respond(("Read", Kind::Stream, &tenant), &metadata, &extensions, (&self.gate, &self.budget), |out| {
            send(store, owner, message, out)
        })?)
    }

    async fn find_missing(&self, request: Request<proto::FindMissingRequest>) -> Reply<proto::FindMissingResponse> {
        self.ask("FindMissing", request, |message, owner, store| async move {
            let named = message.digests;
            if named.len() > MOST_DIGESTS {
                let text = format!("are {}; ask for at most {MOST_DIGESTS} at once", named.len());
                return Err(WireError::field("digests", text).into());
            }
            let digests = named.iter().enumerate().map(|(i, text)| digest(&format!("digests[{i}]"), text));
            let missing = store.find_missing_of(owner, &digests.collect::<Result<Vec<_>, _>>()?).await?;
            Ok(proto::FindMissingResponse { digests: missing.iter().map(Digest::to_string).collect() })
        })
        .await
    }

    async fn stat(&self, request: Request<proto::StatRequest>) -> Reply<proto::StatResponse> {
        self.ask("Stat", request, |message, owner, store| async move {
            let named = digest("digest", &message.digest)?;
            check_owned(&*store, owner, named).await?;
            let BlobInfo { digest, size_bytes } = store.stat(named).await?;
            Ok(proto::StatResponse { digest: digest.to_string(), size_bytes })
        })
        .await
    }

    async fn delete(&self, request: Request<proto::DeleteRequest>) -> Reply<proto::DeleteResponse> {
        self.ask("Delete", request, |message, owner, store| async move {
            store.disown(owner, digest("digest", &message.digest)?).await?;
            Ok(proto::DeleteResponse {})
        })
        .await
    }
}

/// Stores a piece. One without bytes begins nowhere, and is good if it says so.
async fn store(
    store: &dyn BlobStore,
    upload: UploadId,
    chunk: Chunk,
    status: UploadStatus,
) -> Result<UploadStatus, RequestError> {
    if !chunk.bytes.is_empty() {
        return timely(store.write(upload, chunk)).await;
    }
    match Chunk::new(chunk.offset, chunk.bytes) {
        Chunk { crc32c, .. } if crc32c == chunk.crc32c => Ok(status),
        Chunk { offset, crc32c: actual, .. } => {
            Err(BlobError::ChecksumMismatch { offset, expected: chunk.crc32c, actual }.into())
        }
    }
}

/// Later messages may name the blob again, and no other.
fn check_same(upload: UploadId, message: &proto::WriteRequest) -> Result<(), WireError> {
    if !message.digest.is_empty() && digest("digest", &message.digest)? != upload.digest {
        return Err(WireError::field("digest", "is another than in the first message; a stream is one upload"));
    }
    if message.size_bytes != 0 && message.size_bytes != upload.size_bytes {
        return Err(WireError::field("size_bytes", "is another than in the first message"));
    }
    Ok(())
}

async fn send(
    store: Arc<dyn BlobStore>,
    owner: Owner,
    message: proto::ReadRequest,
    outbox: Outbox<proto::ReadResponse>,
) -> Result<(), RequestError> {
    let proto::ReadRequest { digest: named, offset, limit_bytes } = message;
    let end = if limit_bytes == 0 { u64::MAX } else { offset.saturating_add(limit_bytes) };
    let wanted = digest("digest", &named)?;
    check_owned(&*store, owner, wanted).await?;
    let mut read = timely(store.read(wanted, offset..end)).await?;
    let size_bytes = read.info.size_bytes;
    let mut offset = read.range.start;
    if read.range.is_empty() {
        let nothing = proto::ReadResponse { offset, size_bytes, ..proto::ReadResponse::default() };
        return outbox.send(nothing).await;
    }
    while let Some(bytes) = timely(read.bytes.try_next()).await? {
        let Chunk { offset: begin, bytes: data, crc32c } = Chunk::new(offset, bytes);
        offset += data.len() as u64;
        outbox.send(proto::ReadResponse { offset: begin, data, crc32c, size_bytes }).await?;
    }
    match offset == read.range.end {
        true => Ok(()),
        false => Err(BlobError::Unavailable(format!("blob {named} ended at byte {offset}")).into()),
    }
}
