//! Parts as multipart uploads of an object store.
//!
//! Purpose: uploads to S3 and to stores like it. A note says how far each upload is, so that any process can continue it. The
//! notes are in the index if processes share one, else beside the blobs. Invariant: the note changes after each part of
//! [`PART_BYTES`] and names only parts that the store has. Of the bytes after the last part, all but the last chunk lie beside
//! the blobs: a crash loses one chunk of an upload. Of two processes that continue an upload, the first to change the note goes
//! on; the other begins again from the note. Must not know: which store it is.
//!
//! Multipart uploads whose note was never written cost room until the store removes them: give the bucket a rule that
//! aborts incomplete multipart uploads after some days.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::SystemTime;

use async_trait::async_trait;
use bytes::{Bytes, BytesMut};
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::multipart::{MultipartStore, PartId};
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use tokio::task::spawn_blocking;

use super::{Part, Staging};
use crate::blob::BlobError;
use crate::blob::chunk::UploadId;
use crate::blob::digest::{Tally, path_of};
use crate::blob::error::{found, join, object};
use crate::blob::index::{Note, UploadNotes};
use crate::blob::reader::is_sound;

/// Bytes of a part. S3 takes 5 MiB to 5 GiB, and 10,000 parts.
const PART_BYTES: usize = 8 << 20;
/// Removals at once.
const AT_ONCE: usize = 16;

#[derive(Clone)]
pub(in crate::blob) struct Multipart {
    objects: Arc<dyn ObjectStore>,
    parts: Arc<dyn MultipartStore>,
    notes: Arc<dyn UploadNotes>,
    prefix: Path,
}

impl Multipart {
    /// `notes` are those of the index; without, notes are objects below `prefix`.
    pub(in crate::blob) fn new<S: ObjectStore + MultipartStore>(
        store: &Arc<S>,
        prefix: &str,
        notes: Option<Arc<dyn UploadNotes>>,
    ) -> Self {
        let objects = Arc::clone(store) as Arc<dyn ObjectStore>;
        let prefix = Path::from(prefix);
        let beside = || Arc::new(Beside { objects: Arc::clone(&objects), prefix: prefix.clone() });
        let notes = notes.unwrap_or_else(|| beside());
        Self { objects, parts: Arc::clone(store) as _, notes, prefix }
    }

    /// The folder of the chunks that came after the last part.
    fn folder(&self, id: UploadId) -> Path {
        self.prefix.clone().join(id.to_string())
    }

    /// Where the chunks that begin at `offset` lie.
    fn chunk_path(&self, id: UploadId, offset: u64) -> Path {
        self.folder(id).join(offset.to_string())
    }

    async fn remove(&self, paths: Vec<Path>) -> Result<(), BlobError> {
        let removals = stream::iter(paths).map(|path| async move {
            found("remove a chunk of an upload", self.objects.delete(&path).await).map(drop)
        });
        removals.buffer_unordered(AT_ONCE).collect::<Vec<_>>().await.into_iter().collect()
    }

    fn part(&self, id: UploadId, note: Note, tally: Tally) -> Parted {
        let saved_bytes = tally.bytes();
        Parted { staging: self.clone(), id, note, tally, tail: BytesMut::new(), saved: Vec::new(), saved_bytes }
    }

    /// Removes what the store has of an upload, but for its note.
    async fn clear(&self, id: UploadId, note: &Note) -> Result<(), BlobError> {
        if !note.multipart.is_empty() {
            let aborted = self.parts.abort_multipart(&path_of(&id.digest), &note.multipart).await;
            known("abort an upload", aborted)?;
        }
        let chunks = self.objects.list(Some(&self.folder(id))).map_ok(|chunk| chunk.location);
        let chunks = chunks.try_collect().await.map_err(object("look for the chunks of an upload"))?;
        self.remove(chunks).await
    }
}

#[async_trait]
impl Staging for Multipart {
    async fn scan(&self) -> Result<Vec<(UploadId, SystemTime)>, BlobError> {
        let notes: Vec<_> =
            self.objects.list(Some(&self.prefix)).try_collect().await.map_err(object("look for uploads"))?;
        let found = notes.iter().filter_map(|note| {
            let id = note.location.filename()?.strip_suffix(NOTE)?.parse().ok()?;
            Some((id, SystemTime::from(note.last_modified)))
        });
        Ok(found.collect())
    }

    async fn create(&self, id: UploadId) -> Result<Box<dyn Part>, BlobError> {
        self.notes.begin(id).await?;
        Ok(Box::new(self.part(id, Note::default(), Tally::default())))
    }

    async fn load(&self, id: UploadId) -> Result<Option<Box<dyn Part>>, BlobError> {
        let Some(note) = self.notes.note(id).await? else { return Ok(None) };
        let tally = match note.bytes {
            0 => Some(Tally::default()),
            bytes => Tally::restore(bytes, &note.hash),
        };
        let damaged = || BlobError::Unavailable(format!("the note of upload {id} is damaged; abandon the upload"));
        let mut part = self.part(id, note, tally.ok_or_else(damaged)?);
        part.load_chunks().await?;
        Ok(Some(Box::new(part)))
    }

    async fn sweep(&self) -> Result<(), BlobError> {
        let mut left: BTreeMap<UploadId, Vec<Path>> = BTreeMap::new();
        let mut objects = self.objects.list(Some(&self.prefix));
        while let Some(object) = objects.try_next().await.map_err(object("look for uploads"))? {
            let name = object.location.prefix_match(&self.prefix).and_then(|mut parts| parts.next());
            let id = name.and_then(|name| name.as_ref().trim_end_matches(NOTE).parse().ok());
            if let Some(id) = id {
                left.entry(id).or_default().push(object.location);
            }
        }
        drop(objects);
        for (id, paths) in left {
            // An upload is noted before it has any.
            if self.notes.note(id).await?.is_none() {
                self.remove(paths).await?;
            }
        }
        Ok(())
    }

    async fn check(&self) -> Result<(), BlobError> {
        found("ask whether it is there", self.objects.head(&self.prefix.clone().join("check")).await).map(drop)
    }

    async fn discard(&self, id: UploadId) -> Result<(), BlobError> {
        let note = self.notes.note(id).await?.unwrap_or_default();
        self.clear(id, &note).await?;
        self.notes.remove(id).await
    }
}

/// As [`found`]; `None` if the store has no such multipart upload.
fn known<T>(what: &'static str, answer: object_store::Result<T>) -> Result<Option<T>, BlobError> {
    match found(what, answer) {
        // The store in memory has no better error.
        Err(BlobError::Unavailable(text)) if text.contains("MultipartUpload not found") => Ok(None),
        answer => answer,
    }
}

/// The ending of a note beside the blobs.
const NOTE: &str = ".json";

/// Notes as objects beside the blobs. Of two processes that change a note, the last one wins.
#[derive(Debug)]
struct Beside {
    objects: Arc<dyn ObjectStore>,
    prefix: Path,
}

impl Beside {
    fn path(&self, id: UploadId) -> Path {
        self.prefix.clone().join(format!("{id}{NOTE}"))
    }
}

#[async_trait]
impl UploadNotes for Beside {
    async fn note(&self, id: UploadId) -> Result<Option<Note>, BlobError> {
        let note = found("find an upload", self.objects.get(&self.path(id)).await)?;
        let Some(note) = note else { return Ok(None) };
        let bytes = note.bytes().await.map_err(object("find an upload"))?;
        let note = serde_json::from_slice(&bytes).map_err(|e| BlobError::storage("read the note of an upload", &e))?;
        Ok(Some(note))
    }

    async fn begin(&self, id: UploadId) -> Result<(), BlobError> {
        self.advance(id, &Note::default(), &Note::default()).await.map(drop)
    }

    async fn advance(&self, id: UploadId, _: &Note, to: &Note) -> Result<bool, BlobError> {
        let text = serde_json::to_vec(to).map_err(|e| BlobError::storage("note an upload", &e))?;
        self.objects.put(&self.path(id), text.into()).await.map_err(object("note an upload"))?;
        Ok(true)
    }

    async fn remove(&self, id: UploadId) -> Result<(), BlobError> {
        found("remove an upload", self.objects.delete(&self.path(id)).await).map(drop)
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
    /// Where the chunks of the tail that are stored begin.
    saved: Vec<u64>,
    /// The bytes up to the end of the last of them.
    saved_bytes: u64,
}

impl Parted {
    /// Reads the chunks that came after the last part.
    async fn load_chunks(&mut self) -> Result<(), BlobError> {
        while self.has_chunk().await? {
            let offset = self.saved_bytes;
            let chunk = self.staging.objects.get(&self.staging.chunk_path(self.id, offset)).await;
            // Another process has made it part of something else.
            let Some(chunk) = found("read a chunk of an upload", chunk)? else { break };
            let bytes = chunk.bytes().await.map_err(object("read a chunk of an upload"))?;
            self.tail.extend_from_slice(&bytes);
            self.hash(bytes).await?;
            self.saved.push(offset);
            self.saved_bytes = self.tally.bytes();
        }
        Ok(())
    }

    /// Whether a chunk is stored that comes next after those that are known.
    async fn has_chunk(&self) -> Result<bool, BlobError> {
        // The server's own are stored again as a whole, and have none.
        if self.id.owner.is_none() {
            return Ok(false);
        }
        let chunk = self.staging.objects.head(&self.staging.chunk_path(self.id, self.saved_bytes)).await;
        let Some(chunk) = found("look for a chunk of an upload", chunk)? else { return Ok(false) };
        let end = self.saved_bytes.saturating_add(chunk.size);
        Ok(chunk.size > 0 && end <= self.id.size_bytes && end < self.note.bytes + PART_BYTES as u64)
    }

    /// Whether the note is still the one that is known here.
    async fn has_note(&self) -> Result<bool, BlobError> {
        Ok(self.staging.notes.note(self.id).await?.is_some_and(|note| note == self.note))
    }

    /// Stores what came after the last part and is not stored yet.
    async fn save_chunk(&mut self) -> Result<(), BlobError> {
        let (start, end) = (self.saved_bytes, self.tally.bytes());
        if self.id.owner.is_none() || start == end {
            return Ok(());
        }
        let from = usize::try_from(start - self.note.bytes).unwrap_or(self.tail.len());
        let bytes = Bytes::copy_from_slice(&self.tail[from..]);
        let path = self.staging.chunk_path(self.id, start);
        self.staging.objects.put(&path, bytes.into()).await.map_err(object("store a chunk"))?;
        self.saved.push(start);
        self.saved_bytes = end;
        Ok(())
    }

    /// Removes the chunks that are part of something else by now. What stays goes with a sweep.
    async fn remove_chunks(&mut self) {
        let chunks = self.saved.drain(..).map(|offset| self.staging.chunk_path(self.id, offset)).collect();
        if let Err(error) = self.staging.remove(chunks).await {
            tracing::debug!(id = %self.id, %error, "chunks of an upload were not removed");
        }
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

    /// What to say once another process has continued the upload.
    async fn overtaken(&self) -> BlobError {
        match self.staging.notes.note(self.id).await {
            Ok(Some(note)) => BlobError::WrongOffset { expected: note.bytes, got: self.note.bytes },
            Ok(None) => BlobError::UploadNotFound { digest: self.id.digest },
            Err(error) => error,
        }
    }

    /// Changes the note, if no other process has.
    async fn advance(&mut self, to: Note) -> Result<(), BlobError> {
        match self.staging.notes.advance(self.id, &self.note, &to).await? {
            true => self.note = to,
            false => return Err(self.overtaken().await),
        }
        Ok(())
    }

    /// Stores the tail as the next part, and notes it.
    async fn put_part(&mut self) -> Result<(), BlobError> {
        let (parts, path) = (Arc::clone(&self.staging.parts), path_of(&self.id.digest));
        if self.note.multipart.is_empty() {
            let multipart = parts.create_multipart(&path).await.map_err(object("begin an upload"))?;
            // Before the part, so that a crash leaves none that no note names.
            let to = Note { multipart: multipart.clone(), ..self.note.clone() };
            if let Err(overtaken) = self.advance(to).await {
                // After another error the note may name it.
                if matches!(overtaken, BlobError::WrongOffset { .. } | BlobError::UploadNotFound { .. })
                    && let Err(error) = parts.abort_multipart(&path, &multipart).await
                {
                    tracing::warn!(id = %self.id, %error, "a multipart upload was not aborted");
                }
                return Err(overtaken);
            }
        } else if !self.has_note().await? {
            // A part under the same number would take the place of the other process's.
            return Err(self.overtaken().await);
        }
        let (bytes, mut to) = (self.tail.clone().freeze(), self.note.clone());
        let part = parts.put_part(&path, &to.multipart, to.parts.len(), bytes.into()).await;
        match known("store a part", part)? {
            Some(part) => to.parts.push(part.content_id),
            // A rule of the bucket has aborted it, for example.
            None => return Err(self.begin_anew().await?),
        }
        (to.bytes, to.hash) = (self.tally.bytes(), self.tally.save());
        self.advance(to).await?;
        self.saved_bytes = self.note.bytes;
        self.tail.clear();
        self.remove_chunks().await;
        Ok(())
    }

    /// Forgets all parts: the store does not have them as they were noted. The caller sends the upload again.
    async fn begin_anew(&mut self) -> Result<BlobError, BlobError> {
        tracing::warn!(id = %self.id, "the store has lost parts of an upload; it begins anew");
        let emptied = self.staging.notes.advance(self.id, &self.note, &Note::default()).await?;
        if emptied {
            self.staging.clear(self.id, &self.note).await?;
        }
        Ok(BlobError::WrongOffset { expected: 0, got: self.tally.bytes() })
    }

    /// Makes the parts an object. Afterwards the bytes there are those that were noted.
    async fn complete(&mut self, to: &Path) -> Result<(), BlobError> {
        let parts: Vec<_> = self.note.parts.iter().map(|part| PartId { content_id: part.clone() }).collect();
        // A store that names its parts by their bytes refuses one that another process has replaced.
        let has_names = parts.iter().all(|part| !part.content_id.is_empty());
        let done = self.staging.parts.complete_multipart(to, &self.note.multipart, parts).await;
        let completed = match known("store a blob", done) {
            Ok(completed) => completed.is_some(),
            // Of S3: a part is another than the one that is named.
            Err(BlobError::Unavailable(text)) if text.contains("InvalidPart") => return Err(self.begin_anew().await?),
            Err(error) => return Err(error),
        };
        // Without the upload, a process may have completed it and gone down before it said so.
        if (completed && has_names) || is_sound(&*self.staging.objects, self.id.digest).await? {
            return Ok(());
        }
        if completed {
            found("remove a wrong blob", self.staging.objects.delete(to).await)?;
        }
        Err(self.begin_anew().await?)
    }
}

#[async_trait]
impl Part for Parted {
    fn tally(&self) -> &Tally {
        &self.tally
    }

    async fn is_current(&self) -> Result<bool, BlobError> {
        Ok(self.has_note().await? && !self.has_chunk().await?)
    }

    async fn append(&mut self, mut bytes: Bytes, _: u32) -> Result<(), BlobError> {
        // Otherwise they become a part now.
        if self.tail.len() + bytes.len() < PART_BYTES {
            self.save_chunk().await?;
        }
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
        if self.note.parts.is_empty() {
            // Less than one part: a plain object, which may be of any size.
            let bytes = self.tail.clone().freeze();
            self.staging.objects.put(to, bytes.into()).await.map_err(object("store a blob"))?;
        } else {
            if !self.tail.is_empty() {
                self.put_part().await?;
            }
            self.complete(to).await?;
        }
        self.remove_chunks().await;
        self.staging.notes.remove(self.id).await
    }
}
