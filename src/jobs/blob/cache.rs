//! Copies of blobs on the local disk.
//!
//! Purpose: [`Cache`] keeps blobs of a bucket that were read or written as a whole, so that the same input is not fetched again. The
//! least recently used go first. Invariant: what is read has the right digest: a damaged copy is removed and counts as missing.
//! All copies together stay below the limit. No fault of the folder is one of a read. Must not know: owners, which blobs are
//! stored.

use std::collections::{BTreeSet, HashMap};
use std::fs::{self, File};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{SystemTime, UNIX_EPOCH};

use bytes::Bytes;
use futures_util::{StreamExt, stream};
use tempfile::NamedTempFile;
use tokio::task::spawn_blocking;

use super::digest::Tally;
use super::reader::bytes_of_file;
use super::{BlobInfo, ByteStream, CacheUse, Digest, READ_BYTES};
use crate::lock;

#[derive(Clone, Debug)]
pub(super) struct Cache(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    folder: PathBuf,
    limit_bytes: u64,
    copies: Mutex<Copies>,
    hits: AtomicU64,
    misses: AtomicU64,
}

#[derive(Debug, Default)]
struct Copies {
    /// Last use and size. Uses are numbered.
    entries: HashMap<Digest, (u64, u64)>,
    /// The least recently used first.
    order: BTreeSet<(u64, Digest)>,
    bytes: u64,
    last: u64,
}

impl Copies {
    fn remove(&mut self, digest: &Digest) {
        if let Some((used, size)) = self.entries.remove(digest) {
            self.order.remove(&(used, *digest));
            self.bytes -= size;
        }
    }

    fn enter(&mut self, digest: Digest, size: u64) {
        self.remove(&digest);
        self.last += 1;
        self.entries.insert(digest, (self.last, size));
        self.order.insert((self.last, digest));
        self.bytes += size;
    }
}

impl Cache {
    /// The copies in a folder, which is made if need be; whatever else is there is removed. Blocks.
    pub(super) fn open(folder: PathBuf, limit_bytes: u64) -> io::Result<Self> {
        fs::create_dir_all(&folder)?;
        let mut found = Vec::new();
        for entry in fs::read_dir(&folder)? {
            let entry = entry?;
            let digest = entry.file_name().to_str().and_then(|name| name.parse::<Digest>().ok());
            match (digest, entry.metadata()) {
                (Some(digest), Ok(meta)) if meta.is_file() => {
                    found.push((meta.modified().unwrap_or(UNIX_EPOCH), digest, meta.len()));
                }
                // A copy that was being written when a process went down.
                _ => drop(fs::remove_file(entry.path())),
            }
        }
        found.sort_unstable();
        let copies = Mutex::default();
        let cache =
            Self(Arc::new(Shared { folder, limit_bytes, copies, hits: AtomicU64::new(0), misses: AtomicU64::new(0) }));
        found.into_iter().for_each(|(_, digest, size)| cache.0.enter(digest, size));
        Ok(cache)
    }

    pub(super) fn used(&self) -> CacheUse {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        CacheUse { hits: count(&self.0.hits), misses: count(&self.0.misses) }
    }

    /// The bytes of a blob, if there is a copy of it.
    pub(super) async fn read(&self, blob: BlobInfo) -> Option<ByteStream> {
        let shared = Arc::clone(&self.0);
        let opened = spawn_blocking(move || shared.open_copy(blob)).await.ok().flatten();
        let counter = if opened.is_some() { &self.0.hits } else { &self.0.misses };
        counter.fetch_add(1, Ordering::Relaxed);
        opened.map(|file| bytes_of_file(file, blob.size_bytes))
    }

    /// The same bytes, of which a copy is made on the way. A stream that ends early leaves none.
    pub(super) fn copied(&self, blob: BlobInfo, bytes: ByteStream) -> ByteStream {
        let copy =
            (blob.size_bytes <= self.0.limit_bytes).then(|| Copy { shared: Arc::clone(&self.0), blob, file: None });
        let copied = stream::unfold((bytes, copy), |(mut bytes, copy)| async move {
            let (piece, copy) = match (bytes.next().await, copy) {
                (Some(Ok(piece)), Some(copy)) => {
                    let added = piece.clone();
                    let copy = spawn_blocking(move || copy.add(&added)).await.ok().flatten();
                    (Ok(piece), copy)
                }
                (Some(piece), copy) => (piece, copy),
                (None, copy) => {
                    let _ = spawn_blocking(move || copy.map(Copy::keep)).await;
                    return None;
                }
            };
            let copy = copy.filter(|_| piece.is_ok());
            Some((piece, (bytes, copy)))
        });
        copied.boxed()
    }

    /// Makes a copy of bytes that are the blob's.
    pub(super) async fn put(&self, digest: Digest, bytes: Bytes) {
        let blob = BlobInfo { digest, size_bytes: bytes.len() as u64 };
        drop(self.copied(blob, stream::iter([Ok(bytes)]).boxed()).collect::<Vec<_>>().await);
    }
}

impl Shared {
    fn path(&self, digest: &Digest) -> PathBuf {
        self.folder.join(digest.to_string())
    }

    /// Opens a copy and looks at all of its bytes.
    fn open_copy(&self, blob: BlobInfo) -> Option<File> {
        let BlobInfo { digest, size_bytes } = blob;
        if !lock(&self.copies).entries.contains_key(&digest) {
            return None;
        }
        let path = self.path(&digest);
        match sound(&path, digest) {
            Ok(file) => {
                // So that the next process has the order.
                drop(file.set_modified(SystemTime::now()));
                self.enter(digest, size_bytes);
                Some(file)
            }
            Err(error) => {
                tracing::warn!(%digest, %error, "a copy of a blob on the local disk is of no use; it is fetched again");
                drop(fs::remove_file(path));
                lock(&self.copies).remove(&digest);
                None
            }
        }
    }

    /// A copy is there and used now. The least recently used go until all are below the limit.
    fn enter(&self, digest: Digest, size: u64) {
        let mut copies = lock(&self.copies);
        copies.enter(digest, size);
        while copies.bytes > self.limit_bytes {
            let Some(&(_, oldest)) = copies.order.first() else { break };
            copies.remove(&oldest);
            // One that is being read stays until it is closed.
            drop(fs::remove_file(self.path(&oldest)));
        }
    }
}

fn sound(path: &Path, digest: Digest) -> io::Result<File> {
    let (mut file, mut tally) = (File::options().read(true).write(true).open(path)?, Tally::default());
    let mut piece = Vec::with_capacity(READ_BYTES);
    loop {
        piece.clear();
        if (&mut file).take(READ_BYTES as u64).read_to_end(&mut piece)? == 0 {
            break;
        }
        tally.add(&piece);
    }
    if tally.digest() != digest {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "its bytes have another digest"));
    }
    file.rewind()?;
    Ok(file)
}

/// A copy that is being written.
struct Copy {
    shared: Arc<Shared>,
    blob: BlobInfo,
    /// It goes with this, unless it is kept.
    file: Option<NamedTempFile>,
}

impl Copy {
    /// `None` after a fault: then there is no copy.
    fn add(mut self, bytes: &[u8]) -> Option<Self> {
        let written = self.file.take().map_or_else(|| NamedTempFile::new_in(&self.shared.folder), Ok);
        match written.and_then(|mut file| file.write_all(bytes).map(|()| file)) {
            Ok(file) => Some(Self { file: Some(file), ..self }),
            Err(error) => {
                tracing::debug!(digest = %self.blob.digest, %error, "no copy of a blob is made");
                None
            }
        }
    }

    fn keep(self) {
        let Some(file) = self.file else { return };
        if file.persist(self.shared.path(&self.blob.digest)).is_ok() {
            self.shared.enter(self.blob.digest, self.blob.size_bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures_util::TryStreamExt;

    fn blob(k: u8, size: usize) -> (BlobInfo, Bytes) {
        let bytes = Bytes::from(vec![k; size]);
        (BlobInfo { digest: Digest::of(&bytes), size_bytes: size as u64 }, bytes)
    }

    async fn read(cache: &Cache, blob: BlobInfo) -> Option<Vec<Bytes>> {
        Some(cache.read(blob).await?.try_collect().await.unwrap())
    }

    #[tokio::test]
    async fn copies_are_right_and_the_least_recently_used_go() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(".tmp123"), "cut").unwrap();
        let cache = Cache::open(folder.path().into(), 100).unwrap();
        let blobs = [1, 2, 3].map(|k| blob(k, 40));
        for (info, bytes) in &blobs[..2] {
            cache.put(info.digest, bytes.clone()).await;
        }
        assert_eq!(read(&cache, blobs[0].0).await, Some(vec![blobs[0].1.clone()]));
        cache.put(blobs[2].0.digest, blobs[2].1.clone()).await;
        assert!(read(&cache, blobs[1].0).await.is_none(), "it was used before the other");
        let (large, bytes) = blob(4, 101);
        cache.put(large.digest, bytes).await;
        assert!(read(&cache, large).await.is_none());
        assert_eq!(cache.used(), CacheUse { hits: 1, misses: 2 });
        // A stream that ends with an error, or early, leaves no copy.
        let (cut, bytes) = blob(5, 20);
        let damaged = crate::blob::BlobError::Damaged { digest: cut.digest };
        let failing = stream::iter([Ok(bytes.slice(..10)), Err(damaged)]).boxed();
        assert!(cache.copied(cut, failing).try_collect::<Vec<_>>().await.is_err());
        drop(cache.copied(cut, stream::iter([Ok(bytes.clone())]).boxed()).next().await);
        assert!(read(&cache, cut).await.is_none());
        // The next process goes on with what is there.
        let cache = Cache::open(folder.path().into(), 100).unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        assert_eq!(read(&cache, blobs[2].0).await, Some(vec![blobs[2].1.clone()]));
        let path = folder.path().join(blobs[2].0.digest.to_string());
        for damage in [&[0_u8; 40][..], b"short", b""] {
            fs::write(&path, damage).unwrap();
            assert!(read(&cache, blobs[2].0).await.is_none() && !path.exists());
            cache.put(blobs[2].0.digest, blobs[2].1.clone()).await;
        }
        fs::remove_file(&path).unwrap();
        assert!(read(&cache, blobs[2].0).await.is_none());
        assert!(read(&Cache::open(folder.path().into(), 0).unwrap(), blobs[0].0).await.is_none());
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        // Without its folder nothing is kept, and nothing fails.
        fs::remove_dir_all(folder.path()).unwrap();
        cache.put(blobs[0].0.digest, blobs[0].1.clone()).await;
        assert!(read(&cache, blobs[0].0).await.is_none());
    }
}
