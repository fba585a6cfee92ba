//! Parts as multipart uploads of an object store.
//!
//! Purpose: uploads to S3 and to stores like it. A note beside the blobs says how far each upload is, so that any process
//! can go on with it. Invariant: the note is written after each part of [`PART_BYTES`] and names only parts that the store
//! has. What came after the last part lies in memory: a crash loses less than [`PART_BYTES`] of an upload. Must not know:
//! which store it is.
//!
//! Multipart uploads whose note was never written cost room until the store removes them: give the bucket a rule that
//! aborts incomplete multipart uploads after some days.

use std::sync::Arc;
use std::time::SystemTime;

use async_trait::async_trait;
use bytes::{Bytes, BytesMut};
use futures_util::TryStreamExt;
use object_store::multipart::{MultipartStore, PartId};
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use serde::{Deserialize, Serialize};
use tokio::task::spawn_blocking;

use super::{Part, Staging};
use crate::blob::BlobError;
use crate::blob::chunk::UploadId;
use crate::blob::digest::{Tally, path_of};
use crate::blob::error::{found, join, object};

/// Bytes of a part. S3 takes 5 MiB to 5 GiB, and 10,000 parts.
const PART_BYTES: usize = 8 << 20;

#[derive(Clone)]
pub(in crate::blob) struct Multipart {
    objects: Arc<dyn ObjectStore>,
    parts: Arc<dyn MultipartStore>,
    prefix: Path,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Note {
    multipart: String,
    parts: Vec<String>,
    bytes: u64,
    /// The hash of these bytes; see [`Tally::save`].
    hash: String,
}

impl Multipart {
    pub(in crate::blob) fn new<S: ObjectStore + MultipartStore>(store: &Arc<S>, prefix: &str) -> Self {
        Self { objects: Arc::clone(store) as _, parts: Arc::clone(store) as _, prefix: prefix.into() }
    }

    fn note_path(&self, id: UploadId) -> Path {
        self.prefix.clone().join(format!("{id}.json"))
    }

    async fn note(&self, id: UploadId) -> Result<Option<Note>, BlobError> {
        let note = found("find an upload", self.objects.get(&self.note_path(id)).await)?;
        let Some(note) = note else { return Ok(None) };
        let bytes = note.bytes().await.map_err(object("find an upload"))?;
        let note = serde_json::from_slice(&bytes).map_err(|e| BlobError::storage("read the note of an upload", &e))?;
        Ok(Some(note))
    }

    fn part(&self, id: UploadId, note: Note, tally: Tally) -> Parted {
        Parted { staging: self.clone(), id, note, tally, tail: BytesMut::new() }
    }
}

#[async_trait]
impl Staging for Multipart {
    async fn scan(&self) -> Result<Vec<(UploadId, SystemTime)>, BlobError> {
        let notes: Vec<_> =
            self.objects.list(Some(&self.prefix)).try_collect().await.map_err(object("look for uploads"))?;
        let found = notes.iter().filter_map(|note| {
            let id = note.location.filename()?.strip_suffix(".json")?.parse().ok()?;
            Some((id, SystemTime::from(note.last_modified)))
        });
        Ok(found.collect())
    }

    async fn create(&self, id: UploadId) -> Result<Box<dyn Part>, BlobError> {
        let multipart = self.parts.create_multipart(&path_of(&id.digest)).await.map_err(object("begin an upload"))?;
        let tally = Tally::default();
        let note = Note { multipart, parts: Vec::new(), bytes: 0, hash: tally.save() };
        let part = self.part(id, note, tally);
        part.write_note().await?;
        Ok(Box::new(part))
    }

    async fn load(&self, id: UploadId) -> Result<Option<Box<dyn Part>>, BlobError> {
        let Some(note) = self.note(id).await? else { return Ok(None) };
        let tally = Tally::restore(note.bytes, &note.hash)
            .ok_or_else(|| BlobError::Unavailable(format!("the note of upload {id} is damaged; delete it")))?;
        Ok(Some(Box::new(self.part(id, note, tally))))
    }

    async fn check(&self) -> Result<(), BlobError> {
        found("ask whether it is there", self.objects.head(&self.prefix.clone().join("check")).await).map(drop)
    }

    async fn discard(&self, id: UploadId) -> Result<(), BlobError> {
        if let Some(note) = self.note(id).await? {
            // Whether the store still has it or not: it is of no use.
            let aborted = self.parts.abort_multipart(&path_of(&id.digest), &note.multipart).await;
            if let Err(error) = aborted {
                tracing::debug!(%id, %error, "multipart upload not aborted");
            }
        }
        found("remove an upload", self.objects.delete(&self.note_path(id)).await).map(drop)
    }
}

/// An upload that is ready for its next chunk.
struct Parted {
    staging: Multipart,
    id: UploadId,
    note: Note,
    tally: Tally,
    /// What came after the last part.
    tail: BytesMut,
}

impl Parted {
    async fn write_note(&self) -> Result<(), BlobError> {
        let text = serde_json::to_vec(&self.note).map_err(|e| BlobError::storage("note an upload", &e))?;
        let path = self.staging.note_path(self.id);
        self.staging.objects.put(&path, text.into()).await.map_err(object("note an upload"))?;
        Ok(())
    }

    async fn hash(&mut self, bytes: Bytes) -> Result<(), BlobError> {
        let mut tally = std::mem::take(&mut self.tally);
        let hashed = spawn_blocking(move || {
            tally.add(&bytes);
            tally
        });
        self.tally = hashed.await.map_err(join)?;
        Ok(())
    }

    /// Stores the tail as the next part, and notes it.
    async fn put_part(&mut self) -> Result<(), BlobError> {
        let bytes = std::mem::take(&mut self.tail).freeze();
        let (store, path) = (&self.staging.parts, path_of(&self.id.digest));
        let index = self.note.parts.len();
        let part = store.put_part(&path, &self.note.multipart, index, bytes.into()).await;
        self.note.parts.push(part.map_err(object("store a part"))?.content_id);
        (self.note.bytes, self.note.hash) = (self.tally.bytes(), self.tally.save());
        self.write_note().await
    }
}

#[async_trait]
impl Part for Parted {
    fn tally(&self) -> &Tally {
        &self.tally
    }

    async fn append(&mut self, mut bytes: Bytes, _: u32) -> Result<(), BlobError> {
        while !bytes.is_empty() {
            let piece = bytes.split_to(bytes.len().min(PART_BYTES - self.tail.len()));
            self.tail.extend_from_slice(&piece);
            self.hash(piece).await?;
            if self.tail.len() == PART_BYTES {
                self.put_part().await?;
            }
        }
        Ok(())
    }

    async fn publish(&mut self, to: &Path) -> Result<(), BlobError> {
        let Parted { staging, id, note, .. } = &*self;
        if note.parts.is_empty() {
            // Less than one part: a plain object, which may be of any size.
            let bytes = self.tail.clone().freeze();
            staging.objects.put(to, bytes.into()).await.map_err(object("store a blob"))?;
            return staging.discard(*id).await;
        }
        if !self.tail.is_empty() {
            self.put_part().await?;
        }
        let Parted { staging, id, note, .. } = &*self;
        let parts = note.parts.iter().map(|part| PartId { content_id: part.clone() }).collect();
        let done = staging.parts.complete_multipart(to, &note.multipart, parts).await;
        done.map_err(object("store a blob"))?;
        staging.discard(*id).await
    }
}
