//! The changes of a store: uploads, evictions, removals.
//!
//! Purpose: keeps the index, the uploads under way, the staged bytes and the objects in step. Invariant: a slot of an
//! upload is locked before a digest, never the other way. The bytes of a blob are shown and removed under the
//! lock of its digest, so that a late removal never takes a blob that has come back. A blob is in the index only while its
//! bytes are stored. Must not know: which store it is.

use std::fs::File;
use std::sync::{Arc, Mutex, OnceLock};
use std::time::{Duration, Instant, SystemTime};

use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::local::LocalFileSystem;
use object_store::{ObjectMeta, ObjectStore, ObjectStoreExt};
use tokio::sync::{MutexGuard, OwnedMutexGuard};
use tokio::task::spawn_blocking;

use super::{LOCKS, stored};
use crate::blob::cache::Cache;
use crate::blob::chunk::{Chunk, UploadId, UploadStatus};
use crate::blob::digest::path_of;
use crate::blob::error::found;
use crate::blob::index::{BlobIndex, Room, Terms, Used};
use crate::blob::reader::is_sound;
use crate::blob::staging::{Part, Staging};
use crate::blob::upload::{Slot, Uploads};
use crate::blob::{BlobError, BlobInfo, BlobOptions, ByteStream, Digest, Owner};
use crate::lock;

/// Removals and questions to the store that run at once.
const AT_ONCE: usize = 16;

/// How often an upload is begun again that ended meanwhile; each time this takes a millisecond longer.
const ENDED: u64 = 40;

/// What sets stores apart.
#[derive(Debug)]
pub(super) enum Kind {
    /// The files remember when they were used last. The lock keeps other processes out.
    Folder { files: Arc<LocalFileSystem>, _lock: File },
    /// Seen by this process alone.
    Memory,
    /// Other processes may add and remove blobs and continue uploads.
    Shared,
}

pub(super) struct Inner {
    pub(super) objects: Arc<dyn ObjectStore>,
    pub(super) staging: Box<dyn Staging>,
    pub(super) index: Arc<dyn BlobIndex>,
    pub(super) uploads: Uploads,
    /// Whether all processes have one index: it knows every upload and owner.
    pub(super) has_one_index: bool,
    /// When the store was last looked through for what the index lacks.
    scanned: Mutex<Instant>,
    locks: Vec<tokio::sync::Mutex<()>>,
    pub(super) options: BlobOptions,
    pub(super) kind: Kind,
    /// Copies of blobs that lie elsewhere.
    pub(super) cache: OnceLock<Cache>,
}

/// When an object was written or used last, in nanoseconds since 1970.
pub(super) fn stamp_of(object: &ObjectMeta) -> u64 {
    object.last_modified.timestamp_nanos_opt().and_then(|nanos| u64::try_from(nanos).ok()).unwrap_or(0)
}

impl Inner {
    pub(super) fn new(
        objects: Arc<dyn ObjectStore>,
        staging: Box<dyn Staging>,
        kind: Kind,
        options: BlobOptions,
        index: Arc<dyn BlobIndex>,
        uploads: Uploads,
    ) -> Self {
        let has_one_index = matches!(kind, Kind::Shared) && Arc::clone(&index).notes().is_some();
        let locks = (0..LOCKS).map(|_| tokio::sync::Mutex::new(())).collect();
        Self {
            objects,
            staging,
            index,
            uploads,
            has_one_index,
            scanned: Mutex::new(Instant::now()),
            locks,
            options,
            kind,
            cache: OnceLock::new(),
        }
    }

    /// Waits for the lock under which the bytes of a blob are shown and removed.
    pub(super) async fn lock_bytes(&self, digest: &Digest) -> MutexGuard<'_, ()> {
        self.locks[usize::from(digest.as_bytes()[0]) % LOCKS].lock().await
    }

    pub(super) async fn stored(&self, digest: Digest) -> Result<Option<BlobInfo>, BlobError> {
        let known = self.index.get(digest).await?;
        if known.is_some() || !matches!(self.kind, Kind::Shared) {
            return Ok(known);
        }
        // What is being shown or removed here is in the index, or out of it, afterwards.
        let _turn = self.lock_bytes(&digest).await;
        self.stored_in_turn(digest).await
    }

    /// As [`Self::stored`]; the caller holds the lock of its bytes.
    pub(super) async fn stored_in_turn(&self, digest: Digest) -> Result<Option<BlobInfo>, BlobError> {
        let known = self.index.get(digest).await?;
        if known.is_some() || !matches!(self.kind, Kind::Shared) {
            return Ok(known);
        }
        let Some(meta) = found("look for a blob", self.objects.head(&path_of(&digest)).await)? else { return Ok(None) };
        let blob = BlobInfo { digest, size_bytes: meta.size };
        Ok(self.index.found(blob, stamp_of(&meta)).await?.then_some(blob))
    }

    /// A blob that is used now, if it is stored.
    pub(super) async fn used(&self, digest: Digest) -> Result<Option<BlobInfo>, BlobError> {
        if self.stored(digest).await?.is_none() {
            return Ok(None);
        }
        let Some(used) = self.index.touch(&[digest]).await?.pop().flatten() else { return Ok(None) };
        self.stamp(vec![(digest, used.stamp)]).await;
        Ok(Some(used.info))
    }

    /// Has the files remember when they were used last.
    async fn stamp(&self, stamps: Vec<(Digest, u64)>) {
        let Kind::Folder { files, .. } = &self.kind else { return };
        let files = Arc::clone(files);
        let work = spawn_blocking(move || {
            for (digest, stamp) in stamps {
                let Ok(path) = files.path_to_filesystem(&path_of(&digest)) else { continue };
                let time = SystemTime::UNIX_EPOCH + Duration::from_nanos(stamp);
                // A blob may have been evicted since. Without the stamp, only the order of eviction after a restart
                // is worse.
                if let Err(error) = File::open(path).and_then(|file| file.set_modified(time)) {
                    tracing::debug!(%digest, %error, "time of last use not stored");
                }
            }
        });
        drop(work.await);
    }

    /// As [`Self::stamp`].
    async fn stamp_all(&self, used: impl Iterator<Item = Used>) {
        self.stamp(used.map(|used| (used.info.digest, used.stamp)).collect()).await;
    }

    pub(super) async fn find_missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, BlobError> {
        if matches!(self.kind, Kind::Shared) {
            let asked = stream::iter(digests.to_vec()).map(|digest| self.stored(digest)).buffer_unordered(AT_ONCE);
            asked.try_collect::<Vec<_>>().await?;
        }
        let used = self.index.touch(digests).await?;
        let missing = digests.iter().zip(&used).filter(|(_, used)| used.is_none()).map(|(digest, _)| *digest).collect();
        self.stamp_all(used.into_iter().flatten()).await;
        Ok(missing)
    }

    pub(super) async fn pin(&self, owner: Option<Owner>, name: &str, digests: &[Digest]) -> Result<(), BlobError> {
        for digest in digests {
            if self.stored(*digest).await?.is_none() {
                return Err(BlobError::NotFound { digest: *digest });
            }
        }
        let used = self.index.pin(owner, name, digests).await?;
        self.stamp_all(used.into_iter()).await;
        Ok(())
    }

    /// Waits for the turn to change an upload, and reads it if that is still to be done. `None` if there is none.
    async fn turn(&self, id: UploadId) -> Result<Option<OwnedMutexGuard<Slot>>, BlobError> {
        loop {
            let Some(mut slot) = self.uploads.lock(&id).await else {
                if !matches!(self.kind, Kind::Shared) || !self.adopt(id).await? {
                    return Ok(None);
                }
                continue;
            };
            match &*slot {
                Slot::Gone => continue,
                Slot::Open(_) => {}
                Slot::Kept => match self.staging.load(id).await? {
                    Some(part) => *slot = Slot::Open(part),
                    None => {
                        self.drop_upload(id, &mut slot).await?;
                        return Ok(None);
                    }
                },
            }
            return Ok(Some(slot));
        }
    }

    /// Takes over an upload that another process began. Whether there is one.
    async fn adopt(&self, id: UploadId) -> Result<bool, BlobError> {
        // Looked for first: an upload that was never begun must not count against the quota.
        if !self.has_one_index && self.staging.load(id).await?.is_none() {
            return Ok(false);
        }
        match self.index.adopt(id, self.options.uploads).await {
            // Its bytes are what is left of it.
            Err(BlobError::UploadNotFound { .. }) => return Ok(false),
            adopted => adopted?,
        }
        // The next turn reads it again.
        drop(self.uploads.add(id));
        Ok(true)
    }

    /// The upload is no more, and its room is free.
    async fn drop_upload(&self, id: UploadId, slot: &mut Slot) -> Result<(), BlobError> {
        self.index.end_upload(id).await?;
        self.uploads.remove(&id, slot);
        Ok(())
    }

    /// The blob of an upload, if it is stored and the upload's owner has it. Counts as a use.
    async fn own(&self, id: UploadId) -> Result<Option<BlobInfo>, BlobError> {
        match id.owner {
            Some(owner) if !self.is_owned(owner, id.digest).await? => Ok(None),
            _ => self.used(id.digest).await,
        }
    }

    /// The blob of an upload that is not under way any more.
    async fn whole(&self, id: UploadId) -> Result<BlobInfo, BlobError> {
        match self.own(id).await? {
            Some(info) if info.size_bytes == id.size_bytes => Ok(info),
            _ => Err(BlobError::UploadNotFound { digest: id.digest }),
        }
    }

    pub(super) async fn begin(&self, id: UploadId, own_limit: Option<u64>) -> Result<UploadStatus, BlobError> {
        let (digest, size_bytes) = (id.digest, id.size_bytes);
        let mut ended = 0;
        loop {
            if let Some(BlobInfo { size_bytes: actual_bytes, .. }) = self.own(id).await? {
                if actual_bytes == size_bytes {
                    return Ok(UploadStatus { kept_bytes: size_bytes, complete: true });
                }
                if is_sound(&*self.objects, digest).await? {
                    return Err(BlobError::WrongSize { digest, promised_bytes: size_bytes, actual_bytes });
                }
                // Another program changed what is stored: the right bytes take its place.
                self.reject(digest).await?;
            }
            if size_bytes > self.options.blob_bytes {
                return Err(BlobError::TooLarge { size_bytes, limit_bytes: self.options.blob_bytes });
            }
            if let Some(slot) = self.uploads.add(id) {
                match self.begin_new(id, slot, own_limit).await {
                    Ok(Some(status)) => return Ok(status),
                    // Another process began it.
                    Ok(None) => {}
                    Err(full @ (BlobError::TooManyUploads { .. } | BlobError::QuotaExceeded { .. })) => {
                        match self.displace(id).await? {
                            true => continue,
                            false => return Err(full),
                        }
                    }
                    Err(error) => return Err(error),
                }
            }
            match self.status(id).await {
                // It ended just now, or another process is about to end it.
                Err(BlobError::UploadNotFound { .. }) if ended < ENDED => {
                    tokio::time::sleep(Duration::from_millis(ended)).await;
                    ended += 1;
                }
                Err(BlobError::UploadNotFound { .. }) => {
                    return Err(BlobError::Unavailable(format!(
                        "another process is about to end the upload of {digest}"
                    )));
                }
                status => return status,
            }
        }
    }

    /// Begins an upload that has a new slot. `None` if the index has it already. After an error it is no more.
    async fn begin_new(
        &self,
        id: UploadId,
        mut slot: OwnedMutexGuard<Slot>,
        own_quota_bytes: Option<u64>,
    ) -> Result<Option<UploadStatus>, BlobError> {
        let BlobOptions { quota_bytes, uploads: places, .. } = self.options;
        let room = match self.index.admit(id, Terms { quota_bytes, places, own_quota_bytes }).await {
            Ok(Some(room)) => room,
            Ok(None) => return Ok(None),
            Err(error) => {
                self.uploads.remove(&id, &mut slot);
                return Err(error);
            }
        };
        match self.new_part(id, room).await {
            Ok(part) => {
                let kept_bytes = part.tally().bytes();
                *slot = Slot::Open(part);
                Ok(Some(UploadStatus { kept_bytes, complete: false }))
            }
            Err(error) => {
                self.drop_upload(id, &mut slot).await?;
                Err(error)
            }
        }
    }

    /// Removes the upload that was idle for the longest, to make place for another. Returns whether there was one; its client
    /// begins again.
    async fn displace(&self, id: UploadId) -> Result<bool, BlobError> {
        let time = self.options.keep_crowded_uploads;
        if id.owner.is_none() {
            return Ok(false);
        }
        let Some(stalest) = self.index.stalest_upload(id, time).await? else { return Ok(false) };
        match self.abandon(stalest, time).await {
            // It ended just now.
            Err(BlobError::UploadNotFound { .. }) => Ok(true),
            done => done,
        }
    }

    /// Makes room, then a part. Another process may have begun it.
    async fn new_part(&self, id: UploadId, room: Room) -> Result<Box<dyn Part>, BlobError> {
        let Room { victims, given_up } = room;
        if let Some(owner) = id.owner {
            let unmarking = stream::iter(given_up).map(|digest| self.unmark(digest, owner)).buffer_unordered(AT_ONCE);
            unmarking.collect::<Vec<_>>().await.into_iter().collect::<Result<(), _>>()?;
        }
        // All of them, even if one fails: they are out of the index.
        let removals = stream::iter(victims).map(|victim| self.remove(victim)).buffer_unordered(AT_ONCE);
        removals.collect::<Vec<_>>().await.into_iter().collect::<Result<(), _>>()?;
        // An index that has them all has admitted this one as new.
        if !self.has_one_index
            && let Some(part) = self.staging.load(id).await?
        {
            return Ok(part);
        }
        self.staging.create(id).await
    }

    /// Removes the bytes of a blob that is out of the index, in a task of its own.
    pub(super) fn remove_later(inner: &Arc<Self>, blob: BlobInfo) {
        let inner = Arc::clone(inner);
        tokio::spawn(async move {
            if let Err(error) = inner.remove(blob).await {
                tracing::warn!(digest = %blob.digest, %error, "a blob without owners was not removed; it is the next to go");
            }
        });
    }

    /// Removes the bytes of a blob that is out of the index. If that fails it is back in it, as the first to go.
    async fn remove(&self, blob: BlobInfo) -> Result<(), BlobError> {
        let digest = blob.digest;
        let _turn = self.lock_bytes(&digest).await;
        if !self.index.removing(blob).await? {
            // It has come back, with other owners.
            return self.unmark_others(digest).await;
        }
        let removed = found("remove a blob", self.objects.delete(&path_of(&digest)).await);
        self.index.removed(blob, removed.is_ok()).await?;
        removed?;
        self.unmark_others(digest).await
    }

    pub(super) async fn status(&self, id: UploadId) -> Result<UploadStatus, BlobError> {
        // Another stream of the same upload may have ended it: then there is nothing more to send.
        let complete = |info: BlobInfo| UploadStatus { kept_bytes: info.size_bytes, complete: true };
        match self.whole(id).await {
            Err(BlobError::UploadNotFound { .. }) => {}
            known => return known.map(complete),
        }
        while let Some(mut slot) = self.turn(id).await? {
            let Slot::Open(part) = &*slot else { break };
            if part.is_current().await? {
                return Ok(UploadStatus { kept_bytes: part.tally().bytes(), complete: false });
            }
            // It is read again.
            *slot = Slot::Kept;
        }
        // It ended just now.
        self.whole(id).await.map(complete)
    }

    pub(super) async fn write(&self, id: UploadId, chunk: Chunk) -> Result<UploadStatus, BlobError> {
        let Some(mut slot) = self.turn(id).await? else {
            // Another stream of the same upload has ended it in the meantime.
            let info = self.whole(id).await?;
            return Ok(UploadStatus { kept_bytes: info.size_bytes, complete: true });
        };
        let Slot::Open(part) = &mut *slot else { return Err(BlobError::UploadNotFound { digest: id.digest }) };
        chunk.check(part.tally().bytes(), id.size_bytes)?;
        if let Err(error) = part.append(chunk.bytes, chunk.crc32c).await {
            *slot = Slot::Kept;
            return Err(error);
        }
        let kept_bytes = part.tally().bytes();
        self.index.touch_upload(id).await?;
        Ok(UploadStatus { kept_bytes, complete: false })
    }

    pub(super) async fn finish(&self, id: UploadId, pin: Option<&str>) -> Result<BlobInfo, BlobError> {
        let digest = id.digest;
        let gone = BlobError::UploadNotFound { digest };
        let Some(mut slot) = self.turn(id).await? else { return self.finished(id, pin).await };
        let Slot::Open(part) = &mut *slot else { return Err(gone) };
        let missing = (part.tally().bytes() != id.size_bytes)
            .then_some(BlobError::Incomplete { kept_bytes: part.tally().bytes(), size_bytes: id.size_bytes });
        let actual = part.tally().digest();
        if missing.is_none() && actual != digest {
            self.discard(id).await;
            self.drop_upload(id, &mut slot).await?;
            return Err(BlobError::DigestMismatch { expected: digest, actual });
        }
        // An owner of the blob need not send it again.
        let has = match id.owner {
            Some(owner) => self.is_owned(owner, digest).await?,
            None => true,
        };
        match self.index.showing(id).await {
            Err(BlobError::UploadNotFound { .. }) => {
                self.uploads.remove(&id, &mut slot);
                return self.finished(id, pin).await;
            }
            free => free?,
        }
        let shown = self.show(id, &mut slot, (has, missing), pin).await;
        if shown.is_err()
            && let Err(error) = self.index.touch_upload(id).await
        {
            tracing::warn!(%id, %error, "no other process can end the upload for some minutes");
        }
        shown
    }

    /// Shows the bytes of an upload as the blob's, and enters it.
    async fn show(
        &self,
        id: UploadId,
        slot: &mut Slot,
        (has, missing): (bool, Option<BlobError>),
        pin: Option<&str>,
    ) -> Result<BlobInfo, BlobError> {
        let digest = id.digest;
        let Slot::Open(part) = &mut *slot else { return Err(BlobError::UploadNotFound { digest }) };
        let turn = self.lock_bytes(&digest).await;
        if has && self.stored_in_turn(digest).await?.is_some_and(|info| info.size_bytes == id.size_bytes) {
            // Another stream was faster, and the caller may have been told so.
            self.discard(id).await;
        } else if let Some(error) = missing {
            return Err(error);
        } else {
            if let Some(owner) = id.owner {
                self.mark(&digest, owner).await?;
            }
            if self.index.get(digest).await?.is_some_and(|info| info.size_bytes != id.size_bytes) {
                // Another program changed what is stored: the right bytes take its place.
                self.index.forget(digest).await?;
            }
            // Also where others have the blob: it takes as long as where they do not.
            if let Err(error) = part.publish(&path_of(&digest)).await {
                *slot = Slot::Kept;
                return Err(match error {
                    // Another process continues it, or the store has lost parts of it.
                    BlobError::WrongOffset { expected, .. } if expected < id.size_bytes => {
                        BlobError::Incomplete { kept_bytes: expected, size_bytes: id.size_bytes }
                    }
                    BlobError::WrongOffset { .. } => BlobError::Busy { digest },
                    error => error,
                });
            }
        }
        let published = match self.index.publish(id, pin).await {
            Ok(published) => published,
            Err(error) => {
                *slot = Slot::Kept;
                return Err(error);
            }
        };
        if let Some(other) = published.replaced {
            self.unmark(digest, other).await?;
        }
        drop(turn);
        self.uploads.remove(&id, slot);
        self.stamp(vec![(digest, published.stamp)]).await;
        Ok(BlobInfo { digest, size_bytes: id.size_bytes })
    }

    /// As [`Self::finish`], for an upload that has ended.
    async fn finished(&self, id: UploadId, pin: Option<&str>) -> Result<BlobInfo, BlobError> {
        let info = self.whole(id).await?;
        if let Some(name) = pin {
            let pinned = self.index.pin(None, name, &[id.digest]).await;
            pinned.map_err(|_| BlobError::UploadNotFound { digest: id.digest })?;
        }
        Ok(info)
    }

    /// Removes what is staged of an upload that has ended. What stays after a fault is an idle upload to the next
    /// process, and goes with those.
    async fn discard(&self, id: UploadId) {
        if let Err(error) = self.staging.discard(id).await {
            tracing::warn!(%id, %error, "the bytes of an upload were not removed");
        }
    }

    /// Removes an upload, unless somebody continued it less than `idle` ago; says whether.
    pub(super) async fn abandon(&self, id: UploadId, idle: Duration) -> Result<bool, BlobError> {
        let gone = BlobError::UploadNotFound { digest: id.digest };
        let mut slot = loop {
            match self.uploads.lock(&id).await {
                Some(slot) => break slot,
                None if matches!(self.kind, Kind::Shared) && self.adopt(id).await? => {}
                None => return Err(gone),
            }
        };
        if matches!(*slot, Slot::Gone) {
            return Err(gone);
        }
        if self.index.idle_time(id).await?.is_some_and(|time| time < idle) {
            return Ok(false);
        }
        *slot = Slot::Kept;
        self.staging.discard(id).await?;
        self.drop_upload(id, &mut slot).await?;
        Ok(true)
    }

    pub(super) async fn sweep(&self) -> Result<usize, BlobError> {
        let mut swept = 0;
        for id in self.index.idle_uploads(self.options.keep_uploads).await? {
            match self.abandon(id, self.options.keep_uploads).await {
                Ok(gone) => swept += usize::from(gone),
                Err(BlobError::UploadNotFound { .. }) => {}
                // The others go all the same.
                Err(error) => tracing::warn!(%id, %error, "an upload that nobody continues was not removed"),
            }
        }
        if self.has_one_index {
            self.forget_ended().await?;
            self.scan().await?;
        }
        // A process that went down left them, or one that lost its job.
        let mut left = self.index.left(self.options.keep_unneeded).await?;
        left.extend(self.index.orphans(self.options.keep_unneeded).await?);
        for blob in left {
            if let Err(error) = self.remove(blob).await {
                tracing::warn!(digest = %blob.digest, %error, "the bytes of a blob that nobody has were not removed");
            }
        }
        Ok(swept)
    }

    /// Enters objects that the index lacks, now and then: those that no owner has go as orphans. Removes what is left of uploads.
    async fn scan(&self) -> Result<(), BlobError> {
        {
            let mut scanned = lock(&self.scanned);
            if scanned.elapsed() < self.options.scan_period {
                return Ok(());
            }
            *scanned = Instant::now();
        }
        self.staging.sweep().await?;
        self.index.enter(stored(&*self.objects).await?).await.map(drop)
    }

    /// Lets go of what this process holds of uploads that another process has ended.
    async fn forget_ended(&self) -> Result<(), BlobError> {
        for id in self.uploads.all() {
            if self.index.idle_time(id).await?.is_none()
                && let Some(mut slot) = self.uploads.lock(&id).await
                && !matches!(*slot, Slot::Gone)
                && self.index.idle_time(id).await?.is_none()
            {
                self.uploads.remove(&id, &mut slot);
            }
        }
        Ok(())
    }

    /// Removes a blob once its reader finds it damaged.
    pub(super) fn guarded(self: Arc<Self>, bytes: ByteStream) -> ByteStream {
        let guarded = bytes.then(move |piece| {
            let inner = Arc::clone(&self);
            async move {
                if let Err(BlobError::Damaged { digest }) = piece {
                    inner.reject(digest).await?;
                }
                piece
            }
        });
        guarded.boxed()
    }

    /// Another program removed the bytes of a blob, unless they came back meanwhile.
    pub(super) async fn lose(&self, digest: Digest) -> Result<(), BlobError> {
        let _turn = self.lock_bytes(&digest).await;
        if found("look for a blob", self.objects.head(&path_of(&digest)).await)?.is_none() {
            self.index.forget(digest).await?;
        }
        Ok(())
    }

    /// Removes a blob whose bytes are wrong, pinned or not.
    pub(super) async fn reject(&self, digest: Digest) -> Result<(), BlobError> {
        tracing::error!(%digest, "a blob is damaged; it is removed, and can be uploaded again");
        let Some(blob) = self.index.forget(digest).await? else { return Ok(()) };
        self.remove(blob).await
    }

    pub(super) async fn delete(&self, digest: Digest) -> Result<(), BlobError> {
        self.stored(digest).await?;
        let blob = self.index.delete(digest).await?;
        self.remove(blob).await
    }
}
