//! Random operations, and reopened folders, against a model of a few lines.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use jobs::blob::index::BlobIndex;
use jobs::blob::{BlobError, BlobOptions, BlobStore, Chunk, Digest, ObjectBlobs, Owner, UploadId};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use tokio::runtime::Runtime;

use crate::{PATIENCE, content, everything, local, local_with, read};

/// Blobs that there may be, and their lengths.
const LENGTHS: [usize; 6] = [0, 10, 20, 30, 40, 90];
const QUOTA: u64 = 100;
const UPLOADS: usize = 3;

/// An upload: which blob, whose.
type Key = (usize, u8);

#[derive(Clone, Debug)]
enum What {
    /// The bytes that follow.
    Right,
    /// As many other bytes, with their right sum.
    Foreign,
    /// The bytes that follow, with a wrong sum.
    Damaged,
    /// Bytes from elsewhere: so far behind or ahead.
    Elsewhere(i64),
}

#[derive(Clone, Debug)]
enum Operation {
    Begin(Key),
    Write(Key, u64, What),
    Finish(Key, Option<u8>),
    Status(Key),
    Abandon(Key),
    Read(usize, u64, u64),
    Stat(usize),
    FindMissing(Vec<usize>),
    Delete(usize),
    /// Whether an owner has a blob.
    Has(Key),
    /// Takes a blob from an owner.
    Disown(Key),
    Pin(u8, Vec<usize>),
    Unpin(u8),
    /// Removes all uploads: they are kept for no time.
    Sweep,
    Reopen,
}

fn operations() -> impl Strategy<Value = Vec<Operation>> {
    let blob = 0..LENGTHS.len();
    let key = || (0..LENGTHS.len(), 0_u8..2);
    let some = || prop::collection::vec(0..LENGTHS.len(), 0..4);
    let what = prop_oneof![
        12 => Just(What::Right),
        1 => Just(What::Foreign),
        1 => Just(What::Damaged),
        2 => (-50_i64..50).prop_map(What::Elsewhere),
    ];
    let operation = prop_oneof![
        6 => key().prop_map(Operation::Begin),
        12 => (key(), 0_u64..60, what).prop_map(|(key, length, what)| Operation::Write(key, length, what)),
        6 => (key(), prop::option::weighted(0.2, 0_u8..2)).prop_map(|(key, pin)| Operation::Finish(key, pin)),
        1 => key().prop_map(Operation::Status),
        1 => key().prop_map(Operation::Abandon),
        3 => (blob.clone(), 0_u64..100, 0_u64..100).prop_map(|(k, a, b)| Operation::Read(k, a, b)),
        1 => blob.clone().prop_map(Operation::Stat),
        1 => some().prop_map(Operation::FindMissing),
        1 => blob.prop_map(Operation::Delete),
        2 => (0_u8..2, some()).prop_map(|(name, blobs)| Operation::Pin(name, blobs)),
        1 => (0_u8..2).prop_map(Operation::Unpin),
        2 => key().prop_map(Operation::Has),
        2 => key().prop_map(Operation::Disown),
        1 => Just(Operation::Sweep),
        3 => Just(Operation::Reopen),
    ];
    prop::collection::vec(operation, 1..80)
}

/// What a call said: figures, or the error.
type Said = Result<Vec<u64>, BlobError>;

struct Model {
    contents: Vec<Bytes>,
    /// The least recently used first.
    blobs: Vec<usize>,
    owners: BTreeSet<Key>,
    uploads: BTreeMap<Key, Vec<u8>>,
    pins: BTreeMap<u8, BTreeSet<usize>>,
}

impl Model {
    fn new() -> Self {
        let contents = LENGTHS.iter().enumerate().map(|(k, length)| content(k as u64, *length)).collect();
        Self { contents, blobs: Vec::new(), owners: BTreeSet::new(), uploads: BTreeMap::new(), pins: BTreeMap::new() }
    }

    fn digest(&self, k: usize) -> Digest {
        Digest::of(&self.contents[k])
    }

    fn id(&self, (k, owner): Key) -> UploadId {
        UploadId::new(self.digest(k), LENGTHS[k] as u64).of(&owner.to_string())
    }

    fn is_pinned(&self, k: usize) -> bool {
        self.pins.values().any(|held| held.contains(&k))
    }

    fn bytes_of(&self, which: impl Fn(usize) -> bool) -> u64 {
        self.blobs.iter().filter(|k| which(**k)).map(|k| LENGTHS[*k] as u64).sum()
    }

    fn uploading(&self) -> u64 {
        self.uploads.keys().map(|(k, _)| LENGTHS[*k] as u64).sum()
    }

    /// Whether the blob is there; it is used.
    fn touch(&mut self, k: usize) -> bool {
        let place = self.blobs.iter().position(|other| *other == k);
        place.map(|place| self.blobs.remove(place)).is_some_and(|k| {
            self.blobs.push(k);
            true
        })
    }

    /// The blob goes, and nobody has it any more.
    fn remove(&mut self, k: usize) -> bool {
        self.owners.retain(|(other, _)| *other != k);
        let place = self.blobs.iter().position(|other| *other == k);
        place.map(|place| self.blobs.remove(place)).is_some()
    }

    fn absent(&self, k: usize) -> BlobError {
        BlobError::NotFound { digest: self.digest(k) }
    }

    /// What a call says of an upload that is not under way.
    fn ended(&mut self, key: Key) -> Said {
        let k = key.0;
        if self.owners.contains(&key) && self.touch(k) {
            Ok(vec![LENGTHS[k] as u64, 1])
        } else {
            Err(BlobError::UploadNotFound { digest: self.digest(k) })
        }
    }

    fn begin(&mut self, key: Key) -> Said {
        let size = LENGTHS[key.0] as u64;
        if self.owners.contains(&key) && self.touch(key.0) {
            return Ok(vec![size, 1]);
        }
        if let Some(bytes) = self.uploads.get(&key) {
            return Ok(vec![bytes.len() as u64, 0]);
        }
        if self.uploads.len() >= UPLOADS {
            return Err(BlobError::TooManyUploads { limit: UPLOADS });
        }
        let pinned_bytes = self.bytes_of(|k| self.is_pinned(k));
        // All of these are somebody's: they only promise.
        let of = |key: &Key| LENGTHS[key.0] as u64;
        let own: u64 = self.uploads.keys().filter(|other| other.1 == key.1).map(of).sum();
        let crowds = size > 0
            && ((own > 0 && own + size > QUOTA / 4)
                || (self.uploading() > 0 && self.uploading() + size > 3 * (QUOTA / 4)));
        if crowds || pinned_bytes + self.uploading() + size > QUOTA {
            return Err(BlobError::QuotaExceeded {
                needed_bytes: size,
                limit_bytes: QUOTA,
                used_bytes: self.bytes_of(|_| true) + self.uploading(),
                pinned_bytes,
                uploading_bytes: self.uploading(),
            });
        }
        while self.bytes_of(|_| true) + self.uploading() + size > QUOTA {
            let oldest = *self.blobs.iter().find(|k| !self.is_pinned(**k)).unwrap();
            self.remove(oldest);
        }
        self.uploads.insert(key, Vec::new());
        Ok(vec![0, 0])
    }

    fn write(&mut self, key: Key, chunk: &Chunk) -> Said {
        let size_bytes = LENGTHS[key.0] as u64;
        let Some(bytes) = self.uploads.get_mut(&key) else { return self.ended(key) };
        let expected = bytes.len() as u64;
        let end = chunk.offset + chunk.bytes.len() as u64;
        if chunk.offset != expected {
            return Err(BlobError::WrongOffset { expected, got: chunk.offset });
        }
        if end > size_bytes {
            return Err(BlobError::PastEnd { end, size_bytes });
        }
        let actual = crc32c::crc32c(&chunk.bytes);
        if actual != chunk.crc32c {
            return Err(BlobError::ChecksumMismatch { offset: chunk.offset, expected: chunk.crc32c, actual });
        }
        bytes.extend_from_slice(&chunk.bytes);
        Ok(vec![end, 0])
    }

    fn finish(&mut self, key: Key, pin: Option<u8>) -> Said {
        let (k, size_bytes) = (key.0, LENGTHS[key.0] as u64);
        if let Some(bytes) = self.uploads.get(&key) {
            let kept_bytes = bytes.len() as u64;
            // Whoever else has the blob: it is sent whole.
            if kept_bytes != size_bytes {
                return Err(BlobError::Incomplete { kept_bytes, size_bytes });
            }
            let actual = Digest::of(bytes);
            self.uploads.remove(&key);
            if actual != self.digest(k) {
                return Err(BlobError::DigestMismatch { expected: self.digest(k), actual });
            }
            if !self.touch(k) {
                self.blobs.push(k);
            }
            self.owners.insert(key);
        } else {
            self.ended(key)?;
        }
        if let Some(name) = pin {
            self.pins.entry(name).or_default().insert(k);
        }
        Ok(vec![size_bytes])
    }

    fn read(&mut self, k: usize, a: u64, b: u64) -> Said {
        let size_bytes = LENGTHS[k] as u64;
        if !self.touch(k) {
            return Err(self.absent(k));
        }
        if a > size_bytes {
            return Err(BlobError::OutOfRange { offset: a, size_bytes });
        }
        let range = usize::try_from(a).unwrap()..usize::try_from(b.min(size_bytes).max(a)).unwrap();
        Ok(self.contents[k][range].iter().map(|byte| u64::from(*byte)).collect())
    }

    fn pin(&mut self, name: u8, blobs: &[usize]) -> Said {
        if let Some(k) = blobs.iter().find(|k| !self.blobs.contains(k)) {
            return Err(self.absent(*k));
        }
        for k in blobs {
            self.pins.entry(name).or_default().insert(*k);
            self.touch(*k);
        }
        Ok(Vec::new())
    }

    fn apply(&mut self, operation: &Operation, chunk: Option<&Chunk>) -> Said {
        match operation {
            Operation::Begin(key) => self.begin(*key),
            Operation::Write(key, ..) => self.write(*key, chunk.unwrap()),
            Operation::Finish(key, pin) => self.finish(*key, *pin),
            Operation::Status(key) => match self.uploads.get(key) {
                Some(bytes) => Ok(vec![bytes.len() as u64, 0]),
                None => self.ended(*key),
            },
            Operation::Abandon(key) => {
                let gone = BlobError::UploadNotFound { digest: self.digest(key.0) };
                self.uploads.remove(key).map(|_| Vec::new()).ok_or(gone)
            }
            Operation::Read(k, a, b) => self.read(*k, *a, *b),
            Operation::Stat(k) if self.blobs.contains(k) => Ok(vec![LENGTHS[*k] as u64]),
            Operation::Stat(k) => Err(self.absent(*k)),
            Operation::FindMissing(blobs) => Ok(blobs.iter().filter(|k| !self.touch(**k)).map(|k| *k as u64).collect()),
            Operation::Delete(k) if self.is_pinned(*k) => Err(BlobError::Pinned { digest: self.digest(*k) }),
            Operation::Delete(k) => match self.remove(*k) {
                true => Ok(Vec::new()),
                false => Err(self.absent(*k)),
            },
            Operation::Has(key) => Ok(vec![u64::from(self.owners.contains(key))]),
            Operation::Disown(key) => {
                if !self.owners.remove(key) {
                    return Err(self.absent(key.0));
                }
                let is_anybodys = self.owners.iter().any(|(k, _)| *k == key.0);
                if !is_anybodys && !self.is_pinned(key.0) {
                    self.remove(key.0);
                }
                Ok(Vec::new())
            }
            Operation::Pin(name, blobs) => self.pin(*name, blobs),
            Operation::Unpin(name) => {
                self.pins.remove(name);
                Ok(Vec::new())
            }
            Operation::Sweep => Ok(vec![std::mem::take(&mut self.uploads).len() as u64]),
            Operation::Reopen => {
                self.pins.clear();
                Ok(Vec::new())
            }
        }
    }

    /// The chunk that an operation sends.
    fn chunk(&self, operation: &Operation) -> Option<Chunk> {
        let Operation::Write(key, length, what) = operation else { return None };
        let kept = self.uploads.get(key).map_or(0, |bytes| bytes.len() as u64);
        let offset = match what {
            What::Elsewhere(by) => kept.saturating_add_signed(*by),
            _ => kept,
        };
        let content = &self.contents[key.0];
        let start = usize::try_from(offset).unwrap().min(content.len());
        let end = (start + usize::try_from(*length).unwrap()).min(content.len());
        let mut chunk = Chunk::new(offset, content.slice(start..end));
        match what {
            What::Foreign => chunk = Chunk::new(offset, chunk.bytes.iter().map(|byte| byte ^ 1).collect()),
            What::Damaged => chunk.crc32c ^= 1,
            // Sometimes longer than the blob.
            What::Right if *length > 50 => {
                chunk = Chunk::new(offset, content.slice(start..).iter().copied().chain([0]).collect())
            }
            _ => {}
        }
        Some(chunk)
    }
}

async fn ask(store: &ObjectBlobs, model: &Model, operation: &Operation, chunk: Option<Chunk>) -> Said {
    let status = |status: jobs::blob::UploadStatus| vec![status.kept_bytes, u64::from(status.complete)];
    let digests = |blobs: &[usize]| -> Vec<Digest> { blobs.iter().map(|k| model.digest(*k)).collect() };
    match operation {
        Operation::Begin(key) => store.begin(model.id(*key)).await.map(status),
        Operation::Write(key, ..) => store.write(model.id(*key), chunk.unwrap()).await.map(status),
        Operation::Finish(key, pin) => {
            let pin = pin.map(|name| name.to_string());
            store.finish(model.id(*key), pin.as_deref()).await.map(|info| vec![info.size_bytes])
        }
        Operation::Status(key) => store.upload_status(model.id(*key)).await.map(status),
        Operation::Abandon(key) => store.abandon(model.id(*key)).await.map(|()| Vec::new()),
        Operation::Read(k, a, b) => {
            let bytes = read(store, model.digest(*k), *a..*b).await?;
            Ok(bytes.iter().map(|byte| u64::from(*byte)).collect())
        }
        Operation::Stat(k) => store.stat(model.digest(*k)).await.map(|info| vec![info.size_bytes]),
        Operation::FindMissing(blobs) => {
            let missing = store.find_missing(&digests(blobs)).await?;
            let index = |digest: &Digest| (0..LENGTHS.len()).find(|k| model.digest(*k) == *digest).unwrap() as u64;
            Ok(missing.iter().map(index).collect())
        }
        Operation::Delete(k) => store.delete(model.digest(*k)).await.map(|()| Vec::new()),
        Operation::Has((k, owner)) => {
            let owner = Owner::of(&owner.to_string());
            store.is_owned(owner, model.digest(*k)).await.map(|has| vec![u64::from(has)])
        }
        Operation::Disown((k, owner)) => {
            let owner = Owner::of(&owner.to_string());
            store.disown(owner, model.digest(*k)).await.map(|()| Vec::new())
        }
        Operation::Pin(name, blobs) => store.pin(&name.to_string(), &digests(blobs)).await.map(|()| Vec::new()),
        Operation::Unpin(name) => store.unpin(&name.to_string()).await.map(|()| Vec::new()),
        Operation::Sweep => store.sweep().await.map(|swept| vec![swept as u64]),
        Operation::Reopen => unreachable!("the store is replaced"),
    }
}

/// The index, and every file.
async fn compare(store: &ObjectBlobs, model: &Model, folder: Option<&Path>) -> Result<(), TestCaseError> {
    let usage = store.usage().await.unwrap();
    prop_assert_eq!(usage.blobs, model.blobs.len());
    prop_assert_eq!(usage.blob_bytes, model.bytes_of(|_| true));
    prop_assert_eq!(usage.pinned_bytes, model.bytes_of(|k| model.is_pinned(k)));
    prop_assert_eq!((usage.uploads, usage.uploading_bytes), (model.uploads.len(), model.uploading()));
    let Some(folder) = folder else { return Ok(()) };
    let blobs = model.blobs.iter().map(|k| {
        let name = model.digest(*k).to_string();
        (format!("blobs/{}/{name}", &name[..2]), LENGTHS[*k] as u64)
    });
    let parts =
        model.uploads.iter().map(|(key, bytes)| (format!("uploads/{}.part", model.id(*key)), bytes.len() as u64));
    let marks = model.owners.iter().map(|(k, owner)| {
        let (name, owner) = (model.digest(*k).to_string(), Owner::of(&owner.to_string()));
        (format!("owners/{}/{name}-{owner}", &name[..2]), 0)
    });
    let mut expected: Vec<_> = blobs.chain(parts).chain(marks).collect();
    expected.sort();
    // The bytes of a blob that its last owner gave away go while nobody waits.
    let end = Instant::now() + PATIENCE;
    loop {
        let mut found = everything(folder);
        found.retain(|(path, _)| !path.ends_with(".sums"));
        if found == expected {
            break;
        }
        if Instant::now() > end {
            prop_assert_eq!(&found, &expected);
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    }
    Ok(())
}

fn options() -> BlobOptions {
    let options = BlobOptions { quota_bytes: QUOTA, uploads: UPLOADS, ..BlobOptions::default() };
    BlobOptions { keep_uploads: Duration::ZERO, fsync: false, ..options }
}

/// What a store is made of.
enum Over {
    /// A folder, reopened where the operations say so.
    Folder,
    /// There, reopening means to go on.
    Memory,
    /// A folder whose index outlives its process.
    Index(Arc<dyn BlobIndex>),
}

async fn run(operations: &[Operation], over: &Over) -> Result<(), TestCaseError> {
    let folder = tempfile::tempdir().unwrap();
    let path = (!matches!(over, Over::Memory)).then_some(folder.path());
    let open = async |path: Option<&Path>| match (path, over) {
        (Some(path), Over::Index(index)) => local_with(|| index.clone(), path, options()).await,
        (Some(path), _) => local(path, options()).await,
        (None, _) => ObjectBlobs::in_memory(options()),
    };
    let mut model = Model::new();
    let mut store = open(path).await;
    for (step, operation) in operations.iter().enumerate() {
        if matches!(operation, Operation::Reopen) {
            if path.is_some() {
                for name in model.pins.keys() {
                    store.unpin(&name.to_string()).await.unwrap();
                }
                drop(store);
                store = open(path).await;
                model.apply(operation, None).unwrap();
            }
        } else {
            let chunk = model.chunk(operation);
            let expected = model.apply(operation, chunk.as_ref());
            let said = ask(&store, &model, operation, chunk).await;
            prop_assert_eq!(said, expected, "step {}: {:?}", step, operation);
        }
        compare(&store, &model, path).await?;
    }
    Ok(())
}

fn number(variable: &str, default: u64) -> u64 {
    std::env::var(variable).map_or(default, |text| text.parse().unwrap_or_else(|e| panic!("{variable}={text}: {e}")))
}

fn drive(cases: u64, mut begin: impl FnMut(&Runtime) -> Over) {
    let cases = u32::try_from(number("TESSERA_BLOB_CASES", cases)).unwrap();
    let mut seed = [0; 32];
    seed[..8].copy_from_slice(&number("TESSERA_BLOB_SEED", 1).to_le_bytes());
    let config = Config { cases, failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &seed));
    let runtime = Runtime::new().unwrap();
    let begin = std::cell::RefCell::new(&mut begin);
    let result = runner.run(&operations(), |operations| {
        let over = (begin.borrow_mut())(&runtime);
        runtime.block_on(run(&operations, &over))
    });
    result.unwrap_or_else(|failure| panic!("{failure}"));
}

#[test]
fn a_folder_does_what_the_model_does() {
    drive(100, |_| Over::Folder);
}

#[test]
fn memory_does_what_the_model_does() {
    drive(100, |_| Over::Memory);
}

#[cfg(all(unix, feature = "postgres"))]
#[needs::needs(postgres)]
#[test]
fn an_index_in_a_database_does_what_the_model_does() {
    use jobs::store::JobStore;
    let database = crate::postgres_server::database();
    let mut store = None;
    drive(30, |runtime| {
        let store = store.get_or_insert_with(|| runtime.block_on(crate::postgres(&database)));
        let tables = ["pins", "uploads", "blobs", "gone"];
        database.sql(&tables.map(|table| format!("delete from tessera.{table}")).join("; "));
        Over::Index(store.index())
    });
}
