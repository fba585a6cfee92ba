//! Parts as files beside the blobs.
//!
//! Purpose: an upload is a file that grows; publishing renames it. `object_store` cannot append, so files are written here,
//! and it does the rename. Invariant: beside `NAME.part` lies `NAME.sums` with the end and the CRC-32C of each chunk,
//! written after the chunk. After a crash or a loss of power, the bytes of a part count up to the first chunk that is
//! missing or wrong. Must not know: quotas.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use async_trait::async_trait;
use bytes::Bytes;
use object_store::ObjectStoreExt;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use tokio::task::{JoinHandle, spawn_blocking};

use super::{Part, Staging};
use crate::blob::chunk::{MAX_CHUNK_BYTES, UploadId};
use crate::blob::digest::Tally;
use crate::blob::error::{io, join, object};
use crate::blob::{BlobError, BlobOptions};

/// Bytes after which the disk is asked to write, so that the end of a large upload need not wait for all of them.
const SYNC_BYTES: u64 = 32 << 20;

/// A line of the sums: the end of a chunk (8 bytes) and its CRC-32C (4 bytes), little-endian.
const SUM_BYTES: usize = 12;

#[derive(Debug)]
pub(in crate::blob) struct Folder {
    objects: Arc<LocalFileSystem>,
    uploads: PathBuf,
    /// The same, as the object store says it.
    prefix: ObjectPath,
    fsync: bool,
    reserve_bytes: u64,
}

impl Folder {
    /// Parts under `prefix` of `root`, which `objects` serves. `reserve_bytes` of the disk stay free.
    pub(in crate::blob) fn new(
        objects: Arc<LocalFileSystem>,
        root: &Path,
        prefix: &str,
        options: &BlobOptions,
    ) -> Result<Self, BlobError> {
        let uploads = root.join(prefix);
        fs::create_dir_all(&uploads).map_err(io("make the folder of uploads"))?;
        let BlobOptions { fsync, reserve_bytes, .. } = *options;
        Ok(Self { objects, uploads, prefix: ObjectPath::from(prefix), fsync, reserve_bytes })
    }

    fn files(&self, id: UploadId) -> Files {
        Files { part: self.uploads.join(format!("{id}.part")), sums: self.uploads.join(format!("{id}.sums")) }
    }

    fn open(&self, id: UploadId, tally: Tally) -> Box<dyn Part> {
        Box::new(Growing {
            objects: Arc::clone(&self.objects),
            path: self.prefix.clone().join(format!("{id}.part")),
            files: self.files(id),
            tally,
            unsynced_bytes: 0,
            sync: None,
            fsync: self.fsync,
            reserve_bytes: self.reserve_bytes,
        })
    }
}

/// Checks that the disk of `folder` has room for `bytes`, with `reserve_bytes` left free.
fn room(folder: &Path, bytes: u64, reserve_bytes: u64) -> Result<(), BlobError> {
    match free_bytes(folder) {
        Some(free) if free < bytes.saturating_add(reserve_bytes) => Err(BlobError::StorageFull),
        _ => Ok(()),
    }
}

/// Whether files can be made there: the folder may be gone, or its disk read-only by now.
fn writable(folder: &Path) -> io::Result<()> {
    #[cfg(unix)]
    {
        use rustix::fs::{Access, access};
        access(folder, Access::WRITE_OK | Access::EXEC_OK)?;
    }
    fs::read_dir(folder).map(drop)
}

/// What the disk has left; nothing where the system does not say.
fn free_bytes(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let disk = rustix::fs::statvfs(folder).ok()?;
        Some(disk.f_bavail.saturating_mul(disk.f_frsize))
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}

#[async_trait]
impl Staging for Folder {
    async fn scan(&self) -> Result<Vec<(UploadId, SystemTime)>, BlobError> {
        let uploads = self.uploads.clone();
        spawn_blocking(move || scan(&uploads)).await.map_err(join)?.map_err(io("look for uploads"))
    }

    async fn check(&self) -> Result<(), BlobError> {
        let (uploads, reserve_bytes) = (self.uploads.clone(), self.reserve_bytes);
        let looked = spawn_blocking(move || {
            writable(&uploads).map_err(io("look at the folder of uploads"))?;
            room(&uploads, 0, reserve_bytes)
        });
        looked.await.map_err(join)?
    }

    async fn create(&self, id: UploadId) -> Result<Box<dyn Part>, BlobError> {
        room(&self.uploads, id.size_bytes, self.reserve_bytes)?;
        let files = self.files(id);
        let made = spawn_blocking(move || {
            // A part without sums counts as empty, sums without a part are removed: any order will do.
            let made = File::create(&files.sums).and_then(|_| File::create(&files.part));
            made.map(drop).inspect_err(|_| drop(files.remove()))
        });
        made.await.map_err(join)?.map_err(io("begin an upload"))?;
        Ok(self.open(id, Tally::default()))
    }

    async fn load(&self, id: UploadId) -> Result<Option<Box<dyn Part>>, BlobError> {
        let files = self.files(id);
        let loaded = spawn_blocking(move || files.load(id.size_bytes));
        let tally = loaded.await.map_err(join)?.map_err(io("go on with an upload"))?;
        Ok(tally.map(|tally| self.open(id, tally)))
    }

    async fn discard(&self, id: UploadId) -> Result<(), BlobError> {
        let files = self.files(id);
        spawn_blocking(move || files.remove()).await.map_err(join)?.map_err(io("remove an upload"))
    }
}

fn scan(uploads: &Path) -> io::Result<Vec<(UploadId, SystemTime)>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(uploads)? {
        let path = entry?.path();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let (stem, ending) = name.rsplit_once('.').unwrap_or((name, ""));
        let Ok(id) = stem.parse::<UploadId>() else { continue };
        match ending {
            "part" => found.push((id, fs::metadata(&path)?.modified()?)),
            // Its part was published or removed just before the end.
            "sums" if !path.with_extension("part").try_exists()? => fs::remove_file(&path)?,
            _ => {}
        }
    }
    Ok(found)
}

#[derive(Clone, Debug)]
struct Files {
    part: PathBuf,
    sums: PathBuf,
}

impl Files {
    /// Adds a chunk behind `kept` bytes.
    fn append(&self, kept: u64, bytes: &[u8], crc32c: u32) -> io::Result<File> {
        let mut part = OpenOptions::new().write(true).open(&self.part)?;
        part.seek(SeekFrom::Start(kept))?;
        part.write_all(bytes)?;
        let mut line = [0; SUM_BYTES];
        line[..8].copy_from_slice(&(kept + bytes.len() as u64).to_le_bytes());
        line[8..].copy_from_slice(&crc32c.to_le_bytes());
        OpenOptions::new().append(true).open(&self.sums)?.write_all(&line)?;
        Ok(part)
    }

    /// Reads what is kept, and cuts off what does not count. `None` if there is no part.
    fn load(&self, size_bytes: u64) -> io::Result<Option<Tally>> {
        let mut part = match OpenOptions::new().read(true).write(true).open(&self.part) {
            Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
            file => file?,
        };
        let mut sums = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&self.sums)?;
        let mut lines = Vec::new();
        sums.read_to_end(&mut lines)?;
        let mut tally = Tally::default();
        let mut good_lines = 0_u64;
        let mut chunk = Vec::new();
        for line in lines.as_chunks::<SUM_BYTES>().0 {
            let [a, b, c, d, e, f, g, h, crc @ ..] = *line;
            let end = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
            let Some(length) = end.checked_sub(tally.bytes()) else { break };
            if length > MAX_CHUNK_BYTES as u64 || end > size_bytes {
                break;
            }
            chunk.clear();
            (&mut part).take(length).read_to_end(&mut chunk)?;
            if chunk.len() as u64 != length || crc32c::crc32c(&chunk) != u32::from_le_bytes(crc) {
                break;
            }
            tally.add(&chunk);
            good_lines += 1;
        }
        part.set_len(tally.bytes())?;
        sums.set_len(good_lines * SUM_BYTES as u64)?;
        Ok(Some(tally))
    }

    /// Removes both, part first: sums alone are of no use and are removed at the next start.
    fn remove(&self) -> io::Result<()> {
        for file in [&self.part, &self.sums] {
            match fs::remove_file(file) {
                Err(e) if e.kind() != ErrorKind::NotFound => return Err(e),
                _ => {}
            }
        }
        Ok(())
    }
}

/// An upload that is ready for its next chunk.
struct Growing {
    objects: Arc<LocalFileSystem>,
    path: ObjectPath,
    files: Files,
    tally: Tally,
    unsynced_bytes: u64,
    /// The disk is writing. Its result must be heard: the system tells a fault once only.
    sync: Option<JoinHandle<io::Result<()>>>,
    fsync: bool,
    reserve_bytes: u64,
}

impl Growing {
    /// Hears what the disk said to the last request.
    async fn synced(&mut self) -> Result<(), BlobError> {
        match self.sync.take() {
            Some(task) => task.await.map_err(join)?.map_err(io("write an upload to the disk")),
            None => Ok(()),
        }
    }
}

#[async_trait]
impl Part for Growing {
    fn tally(&self) -> &Tally {
        &self.tally
    }

    async fn append(&mut self, bytes: Bytes, crc32c: u32) -> Result<(), BlobError> {
        let (files, mut tally) = (self.files.clone(), self.tally.clone());
        let length = bytes.len() as u64;
        // Another upload, or another program, may have taken what was free at the beginning.
        room(&files.part, length, self.reserve_bytes)?;
        let work = spawn_blocking(move || {
            let part = files.append(tally.bytes(), &bytes, crc32c)?;
            tally.add(&bytes);
            Ok((part, tally))
        });
        let (part, tally) = work.await.map_err(join)?.map_err(io("store a chunk"))?;
        self.tally = tally;
        self.unsynced_bytes += length;
        if self.fsync && self.unsynced_bytes >= SYNC_BYTES {
            // At most one request at a time: a slow disk slows the upload instead of filling memory.
            self.synced().await?;
            self.unsynced_bytes = 0;
            self.sync = Some(spawn_blocking(move || part.sync_data()));
        }
        Ok(())
    }

    async fn publish(&mut self, to: &ObjectPath) -> Result<(), BlobError> {
        self.synced().await?;
        let (part, fsync) = (self.files.part.clone(), self.fsync);
        let work = spawn_blocking(move || if fsync { File::open(part)?.sync_all() } else { Ok(()) });
        work.await.map_err(join)?.map_err(io("write a blob to the disk"))?;
        self.objects.rename(&self.path, to).await.map_err(object("store a blob"))?;
        // A crash before this leaves sums without a part.
        let sums = self.files.sums.clone();
        drop(spawn_blocking(move || fs::remove_file(sums)).await);
        self.tally = Tally::default();
        Ok(())
    }
}
