//! Blobs on a folder, in memory, or on S3.
//!
//! Purpose: [`ObjectBlobs`] opens a store through the crate `object_store` and answers for it; the changes are in
//! [`changes`].
//! Invariant: a change that has begun runs to its end, even if its caller goes away. Must not know: the wire, jobs.

mod changes;
mod marks;

use std::collections::HashSet;
use std::fmt;
use std::fs::{self, File, TryLockError};
use std::ops::Range;
use std::path::{Path as FilePath, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::{StreamExt, TryStreamExt, stream};
use object_store::local::LocalFileSystem;
use object_store::memory::InMemory;
use object_store::multipart::MultipartStore;
use object_store::path::Path;
use object_store::{GetOptions, ObjectStore};
use tokio::task::spawn_blocking;

use super::cache::Cache;
use super::chunk::{Chunk, UploadId, UploadStatus};
use super::digest::{BLOBS, path_of};
use super::error::{found, io, join, object};
use super::index::{BlobIndex, LocalIndex, Stored};
use super::reader::bytes_of;
use super::staging::{Folder, Memory, Multipart, Staging};
use super::store::{BlobInfo, BlobOptions, BlobRead, BlobStore, CacheUse, Usage};
use super::upload::Uploads;
use super::{BlobError, Digest, Owner};
use changes::{Inner, Kind};

const UPLOADS: &str = "uploads";
/// A file that one process holds locked.
const LOCK: &str = "lock";
/// Blobs that are published or removed at the same time, at most; those of one digest never are.
const LOCKS: usize = 64;

/// See the module's head. Clones share one state.
#[derive(Clone)]
pub struct ObjectBlobs(Arc<Inner>);

impl fmt::Debug for ObjectBlobs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ObjectBlobs({})", self.0.objects)
    }
}

impl ObjectBlobs {
    /// Blobs in a folder, which is made if need be, with an index of its own. Uploads outlive the process. Errors: `InUse`,
    /// `StorageFull`, `Unavailable`.
    pub async fn local(folder: impl Into<PathBuf>, options: BlobOptions) -> Result<Self, BlobError> {
        Self::local_with(Arc::new(LocalIndex::default()), folder, options).await
    }

    /// As [`Self::local`], with these index. Owners are written beside the blobs, and entered when the folder is opened.
    pub async fn local_with(
        index: Arc<dyn BlobIndex>,
        folder: impl Into<PathBuf>,
        options: BlobOptions,
    ) -> Result<Self, BlobError> {
        let root = folder.into();
        let opened = spawn_blocking(move || open_folder(&root, &options));
        let (files, staging, lock) = opened.await.map_err(join)??;
        let kind = Kind::Folder { files: Arc::clone(&files), _lock: lock };
        Self::open(files, Box::new(staging), kind, options, index).await
    }

    /// Blobs that are gone with the process, with index of their own.
    pub fn in_memory(options: BlobOptions) -> Self {
        Self::in_memory_with(Arc::new(LocalIndex::default()), options)
    }

    /// As [`Self::in_memory`], with these index.
    pub fn in_memory_with(index: Arc<dyn BlobIndex>, options: BlobOptions) -> Self {
        let objects: Arc<dyn ObjectStore> = Arc::new(InMemory::new());
        let staging = Box::new(Memory(Arc::clone(&objects)));
        Self(Arc::new(Inner::new(objects, staging, Kind::Memory, options, index, Uploads::default())))
    }

    /// Blobs in a store that other processes may use at the same time, with index of this process.
    ///
    /// The quota counts the blobs that this process has seen, and its pins hold against this process alone: give a quota to
    /// one process, and no limit to the others. Errors: `Unavailable`.
    pub async fn shared<S: ObjectStore + MultipartStore>(
        store: Arc<S>,
        options: BlobOptions,
    ) -> Result<Self, BlobError> {
        Self::shared_with(Arc::new(LocalIndex::default()), store, options).await
    }

    /// As [`Self::shared`], with this index. If all processes have the same one, quota and pins hold for all of them.
    pub async fn shared_with<S: ObjectStore + MultipartStore>(
        index: Arc<dyn BlobIndex>,
        store: Arc<S>,
        options: BlobOptions,
    ) -> Result<Self, BlobError> {
        let staging = Multipart::new(&store, UPLOADS, Arc::clone(&index).notes());
        Self::open(store, Box::new(staging), Kind::Shared, options, index).await
    }

    /// Blobs in a bucket: `s3://bucket/prefix`. `settings` are those of `object_store` (`aws_endpoint`, `aws_region`,
    /// `aws_access_key_id`, ...) and count before the variables of the same names, in capitals. The index is as in
    /// [`Self::shared`]. Errors: `Unavailable`.
    #[cfg(feature = "s3")]
    pub async fn s3(
        index: Arc<dyn BlobIndex>,
        url: &str,
        settings: impl IntoIterator<Item = (String, String)>,
        options: BlobOptions,
    ) -> Result<Self, BlobError> {
        Self::shared_with(index, Arc::new(super::s3::open(url, settings)?), options).await
    }

    /// Keeps copies of blobs in a folder of this machine, up to `limit_bytes`; 0 is none. One process at a time may use the folder.
    /// Errors: `StorageFull`, `Unavailable`.
    pub async fn with_cache(self, folder: PathBuf, limit_bytes: u64) -> Result<Self, BlobError> {
        let opened = spawn_blocking(move || Cache::open(folder, limit_bytes)).await.map_err(join)?;
        let cache = opened.map_err(io("open the folder of copies of blobs"))?;
        if limit_bytes > 0 {
            let _ = self.0.cache.set(cache);
        }
        Ok(self)
    }

    async fn open(
        objects: Arc<dyn ObjectStore>,
        staging: Box<dyn Staging>,
        kind: Kind,
        options: BlobOptions,
        index: Arc<dyn BlobIndex>,
    ) -> Result<Self, BlobError> {
        let mut stored = stored(&*objects).await?;
        stored.uploads = staging.scan().await?;
        let uploads = Uploads::default();
        stored.uploads.iter().for_each(|(id, _)| uploads.found(*id));
        let lost = index.enter(stored).await?;
        // Elsewhere another process may have written a mark whose blob this one has not seen.
        if matches!(kind, Kind::Folder { .. }) {
            marks::remove(&*objects, lost).await?;
        }
        Ok(Self(Arc::new(Inner::new(objects, staging, kind, options, index, uploads))))
    }

    /// Runs a change to its end, even if its caller goes away.
    async fn change<T, F>(&self, work: impl FnOnce(Arc<Inner>) -> F) -> Result<T, BlobError>
    where
        T: Send + 'static,
        F: Future<Output = Result<T, BlobError>> + Send + 'static,
    {
        tokio::spawn(work(Arc::clone(&self.0))).await.map_err(join)?
    }
}

/// The blobs of a store and their owners.
async fn stored(objects: &dyn ObjectStore) -> Result<Stored, BlobError> {
    let mut stored = Stored::default();
    let mut blobs = objects.list(Some(&Path::from(BLOBS)));
    while let Some(blob) = blobs.try_next().await.map_err(object("look for blobs"))? {
        match blob.location.filename().and_then(|name| name.parse::<Digest>().ok()) {
            Some(digest) if path_of(&digest) == blob.location => {
                stored.blobs.push((BlobInfo { digest, size_bytes: blob.size }, changes::stamp_of(&blob)));
            }
            _ => tracing::warn!(path = %blob.location, "not a blob; left alone"),
        }
    }
    drop(blobs);
    stored.owners = marks::scan(objects).await?;
    Ok(stored)
}

fn open_folder(root: &FilePath, options: &BlobOptions) -> Result<(Arc<LocalFileSystem>, Folder, File), BlobError> {
    fs::create_dir_all(root.join(BLOBS)).map_err(io("make the folder of blobs"))?;
    let lock = File::options().write(true).create(true).truncate(false).open(root.join(LOCK));
    let lock = lock.map_err(io("make the lock of the blobs"))?;
    match lock.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(BlobError::InUse { folder: root.to_owned() }),
        Err(TryLockError::Error(error)) => return Err(BlobError::storage("lock the folder of blobs", &error)),
    }
    let files = LocalFileSystem::new_with_prefix(root).map_err(object("open the folder of blobs"))?;
    let files = Arc::new(files.with_fsync(options.fsync));
    let staging = Folder::new(Arc::clone(&files), root, UPLOADS, options)?;
    // So that a loss of power does not take the folders themselves. Elsewhere folders cannot be opened.
    #[cfg(unix)]
    if options.fsync {
        let folder = File::open(root).and_then(|folder| folder.sync_all());
        folder.map_err(io("write the folder of blobs to the disk"))?;
    }
    Ok((files, staging, lock))
}

#[async_trait]
impl BlobStore for ObjectBlobs {
    async fn begin_within(&self, upload: UploadId, own_limit_bytes: Option<u64>) -> Result<UploadStatus, BlobError> {
        self.change(|inner| async move { inner.begin(upload, own_limit_bytes).await }).await
    }

    async fn write(&self, upload: UploadId, chunk: Chunk) -> Result<UploadStatus, BlobError> {
        self.change(|inner| async move { inner.write(upload, chunk).await }).await
    }

    async fn upload_status(&self, upload: UploadId) -> Result<UploadStatus, BlobError> {
        self.change(|inner| async move { inner.status(upload).await }).await
    }

    async fn finish(&self, upload: UploadId, pin: Option<&str>) -> Result<BlobInfo, BlobError> {
        let pin = pin.map(str::to_owned);
        self.change(|inner| async move { inner.finish(upload, pin.as_deref()).await }).await
    }

    async fn abandon(&self, upload: UploadId) -> Result<(), BlobError> {
        self.change(|inner| async move { inner.abandon(upload, Duration::ZERO).await.map(drop) }).await
    }

    async fn read(&self, digest: Digest, range: Range<u64>) -> Result<BlobRead, BlobError> {
        let info = self.0.used(digest).await?.ok_or(BlobError::NotFound { digest })?;
        if range.start > info.size_bytes {
            return Err(BlobError::OutOfRange { offset: range.start, size_bytes: info.size_bytes });
        }
        let range = range.start..range.end.min(info.size_bytes).max(range.start);
        if range.is_empty() {
            return Ok(BlobRead { info, range, bytes: stream::empty().boxed() });
        }
        let whole = (range == (0..info.size_bytes)).then_some(digest);
        let cache = self.0.cache.get().filter(|_| whole.is_some());
        if let Some(cache) = cache
            && let Some(bytes) = cache.read(info).await
        {
            return Ok(BlobRead { info, range, bytes });
        }
        // A whole blob is read to the end of what is there, which may be another end by now.
        let part = whole.is_none().then(|| range.clone().into());
        let wanted = GetOptions { range: part, ..GetOptions::default() };
        match found("open a blob", self.0.objects.get_opts(&path_of(&digest), wanted).await)? {
            Some(opened) => {
                let bytes = self.0.clone().guarded(bytes_of(opened, whole));
                let bytes = match cache {
                    Some(cache) => cache.copied(info, bytes),
                    None => bytes,
                };
                Ok(BlobRead { info, range, bytes })
            }
            None => {
                self.0.lose(digest).await?;
                Err(BlobError::NotFound { digest })
            }
        }
    }

    async fn stat(&self, digest: Digest) -> Result<BlobInfo, BlobError> {
        self.0.stored(digest).await?.ok_or(BlobError::NotFound { digest })
    }

    async fn find_missing(&self, digests: &[Digest]) -> Result<Vec<Digest>, BlobError> {
        self.0.find_missing(digests).await
    }

    async fn delete(&self, digest: Digest) -> Result<(), BlobError> {
        self.change(|inner| async move { inner.delete(digest).await }).await
    }

    async fn pin(&self, name: &str, digests: &[Digest]) -> Result<(), BlobError> {
        self.0.pin(None, name, digests).await
    }

    async fn pin_for(&self, owner: Owner, name: &str, digests: &[Digest]) -> Result<(), BlobError> {
        self.0.pin(Some(owner), name, digests).await
    }

    async fn is_owned(&self, owner: Owner, digest: Digest) -> Result<bool, BlobError> {
        self.0.is_owned(owner, digest).await
    }

    async fn find_missing_of(&self, owner: Owner, digests: &[Digest]) -> Result<Vec<Digest>, BlobError> {
        let mut owned = Vec::new();
        for digest in digests {
            if self.0.is_owned(owner, *digest).await? {
                owned.push(*digest);
            }
        }
        let gone: HashSet<Digest> = self.0.find_missing(&owned).await?.into_iter().collect();
        let there: HashSet<Digest> = owned.into_iter().filter(|digest| !gone.contains(digest)).collect();
        Ok(digests.iter().copied().filter(|digest| !there.contains(digest)).collect())
    }

    async fn claim(&self, owner: Owner, digests: &[Digest]) -> Result<(), BlobError> {
        let digests = digests.to_vec();
        self.change(|inner| async move { inner.claim(owner, &digests).await }).await
    }

    async fn disown(&self, owner: Owner, digest: Digest) -> Result<(), BlobError> {
        let orphan = self.change(|inner| async move { inner.disown(owner, digest).await }).await?;
        if let Some(orphan) = orphan {
            Inner::remove_later(&self.0, orphan);
        }
        Ok(())
    }

    async fn owned_bytes(&self, owner: Owner) -> Result<u64, BlobError> {
        self.0.index.owned_bytes(owner).await
    }

    async fn unpin(&self, name: &str) -> Result<(), BlobError> {
        self.0.index.unpin(name).await
    }

    async fn sweep(&self) -> Result<usize, BlobError> {
        self.change(|inner| async move { inner.sweep().await }).await
    }

    async fn remember(&self, digest: Digest, bytes: &Bytes) {
        if let Some(cache) = self.0.cache.get() {
            cache.put(digest, bytes.clone()).await;
        }
    }

    fn cache_use(&self) -> CacheUse {
        self.0.cache.get().map(Cache::used).unwrap_or_default()
    }

    async fn check(&self) -> Result<(), BlobError> {
        self.0.staging.check().await
    }

    fn limit_bytes(&self) -> u64 {
        self.0.options.quota_bytes
    }

    async fn usage(&self) -> Result<Usage, BlobError> {
        Ok(Usage { limit_bytes: self.limit_bytes(), ..self.0.index.usage().await? })
    }
}
