//! Promise: several processes may use one index of blobs at once: the quota holds at each moment, no pinned blob goes, no blob is
//! in the index without its bytes, and no call waits for another forever.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::{Barrier, Mutex};
use std::time::Duration;

use jobs::blob::index::{BlobIndex, Stored, Terms};
use jobs::blob::{BlobError, BlobInfo, Digest, Owner, UploadId, Usage};
use jobs::store::JobStore;
use needs::needs;

use super::{postgres::open, postgres_server as server, wait};

const CLIENTS: usize = 4;
const ROUNDS: usize = 250;
const BLOBS: usize = 16;
const TERMS: Terms = Terms { quota_bytes: 300, places: 12, own_quota_bytes: Some(160) };

fn blob(k: usize) -> (Digest, u64) {
    (Digest::of(&[k as u8]), (k * 7 % 40) as u64)
}

/// Where the bytes of all processes lie: the digests that have some.
type Bytes = Mutex<HashSet<Digest>>;

/// A process: what it does, and what it believes.
struct Client<'a> {
    number: usize,
    owner: String,
    index: &'a dyn BlobIndex,
    bytes: &'a Bytes,
    pins: BTreeMap<String, BTreeSet<Digest>>,
    state: u64,
}

impl Client<'_> {
    fn random(&mut self, below: usize) -> usize {
        self.state = self.state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.state >> 33) as usize % below
    }

    /// One of its pins.
    fn name(&mut self) -> String {
        let pin = self.random(3);
        format!("{}-{pin}", self.number)
    }

    async fn pause(&mut self) {
        let micros = self.random(3000) as u64;
        tokio::time::sleep(Duration::from_micros(micros)).await;
    }

    /// Removes bytes as a store of blobs does.
    async fn remove(&mut self, blob: BlobInfo) {
        if self.index.removing(blob).await.unwrap() {
            self.pause().await;
            self.bytes.lock().unwrap().remove(&blob.digest);
            self.index.removed(blob, true).await.unwrap();
        }
    }

    async fn upload(&mut self) {
        let (digest, size_bytes) = blob(self.random(BLOBS));
        let id = UploadId::new(digest, size_bytes).of(&self.owner);
        let room = match self.index.admit(id, TERMS).await {
            Ok(room) => room.expect("uploads of a process are its own"),
            Err(
                BlobError::QuotaExceeded { .. } | BlobError::OwnQuotaExceeded { .. } | BlobError::TooManyUploads { .. },
            ) => return,
            Err(error) => panic!("{error}"),
        };
        self.pause().await;
        for victim in room.victims {
            self.remove(victim).await;
        }
        if self.random(5) == 0 {
            return self.index.end_upload(id).await.unwrap();
        }
        self.index.touch_upload(id).await.unwrap();
        self.index.showing(id).await.unwrap();
        self.bytes.lock().unwrap().insert(digest);
        self.pause().await;
        let name = self.name();
        let pin = (self.random(3) == 0).then_some(name.as_str());
        self.index.publish(id, pin).await.unwrap();
        if pin.is_some() {
            self.pins.entry(name).or_default().insert(digest);
        }
    }

    async fn pin(&mut self) {
        let digests: BTreeSet<Digest> = (0..3).map(|_| blob(self.random(BLOBS)).0).collect();
        let name = self.name();
        let owner = (self.random(2) == 0).then(|| Owner::of(&self.owner));
        // In some order.
        let mut asked: Vec<Digest> = digests.iter().copied().collect();
        let first = self.random(asked.len());
        asked.rotate_left(first);
        match self.index.pin(owner, &name, &asked).await {
            Ok(used) => {
                assert_eq!(used.len(), asked.len());
                self.pins.entry(name).or_default().extend(digests);
            }
            Err(BlobError::NotFound { .. }) => {}
            Err(error) => panic!("{error}"),
        }
    }

    async fn step(&mut self) {
        let digest = blob(self.random(BLOBS)).0;
        let other = Owner::of(&format!("tenant {}", self.random(CLIENTS)));
        match self.random(12) {
            0..=4 => self.upload().await,
            5 | 6 => self.pin().await,
            7 => {
                let name = self.name();
                self.pins.remove(&name);
                self.index.unpin(&name).await.unwrap();
            }
            8 => {
                let all: Vec<Digest> = (0..6).map(|_| blob(self.random(BLOBS)).0).collect();
                self.index.touch(&all).await.unwrap();
            }
            9 => drop(self.index.give(other, digest).await.unwrap()),
            10 => match self.index.disown(other, digest).await {
                Ok(None) | Err(BlobError::NotFound { .. } | BlobError::Pinned { .. }) => {}
                Ok(Some(orphan)) => self.remove(orphan).await,
                Err(error) => panic!("{error}"),
            },
            _ => match self.index.delete(digest).await {
                Err(BlobError::NotFound { .. } | BlobError::Pinned { .. }) => {}
                Ok(blob) => self.remove(blob).await,
                Err(error) => panic!("{error}"),
            },
        }
        let usage = self.index.usage().await.unwrap();
        assert!(usage.blob_bytes + usage.uploading_bytes <= TERMS.quota_bytes, "{usage:?}");
        assert!(usage.pinned_bytes <= usage.blob_bytes, "{usage:?}");
        for digest in self.pins.values().flatten() {
            assert!(self.index.get(*digest).await.unwrap().is_some(), "a pinned blob went");
            assert!(self.bytes.lock().unwrap().contains(digest), "the bytes of a pinned blob went");
        }
    }
}

fn each_client(database: &server::Database, run: impl Fn(usize, &dyn BlobIndex) + Sync) {
    let barrier = Barrier::new(CLIENTS);
    std::thread::scope(|scope| {
        for number in 0..CLIENTS {
            let (run, barrier) = (&run, &barrier);
            scope.spawn(move || {
                let store = open(database);
                barrier.wait();
                run(number, &*store.index());
            });
        }
    });
}

/// What the rows say.
fn sums(database: &server::Database) -> Usage {
    let sums = database.sql(
        "select count(*), coalesce(sum(size), 0), coalesce(sum(size) filter (where exists (select from tessera.pins p \
         where p.digest = b.digest)), 0), (select count(*) from tessera.uploads), \
         (select coalesce(sum(size), 0) from tessera.uploads) from tessera.blobs b",
    );
    let sums: Vec<u64> = sums.split('|').map(|sum| sum.parse().unwrap()).collect();
    let [blobs, blob_bytes, pinned_bytes, uploads, uploading_bytes] = sums[..] else { panic!("{sums:?}") };
    let (blobs, uploads) = (blobs as usize, uploads as usize);
    Usage { blobs, blob_bytes, pinned_bytes, uploads, uploading_bytes, limit_bytes: 0 }
}

#[needs(postgres)]
#[test]
fn the_quota_holds_and_pins_keep_with_several_clients() {
    let (database, bytes) = (server::database(), Bytes::default());
    each_client(&database, |number, index| {
        let owner = format!("tenant {number}");
        let mut client =
            Client { number, owner, index, bytes: &bytes, pins: BTreeMap::new(), state: 1 + number as u64 };
        wait(async {
            for _ in 0..ROUNDS {
                client.step().await;
            }
        });
    });
    let store = open(&database);
    let usage = wait(store.index().usage()).unwrap();
    assert_eq!(usage, sums(&database));
    assert!(usage.blobs > 2, "{usage:?}");
    // What the rows of owners repeat, and what an admission has left of the sums.
    assert_eq!(
        database
            .sql("select count(*) from tessera.owners o join tessera.blobs b using (digest) where o.size <> b.size"),
        "0"
    );
    let amounts: usize = database.sql("select count(*) from tessera.amounts").parse().unwrap();
    assert!(amounts < 200, "{amounts}");
    // Nothing is in the index without bytes, and no bytes are forgotten.
    let digests = |table: &str| -> HashSet<String> {
        let rows = database.sql(&format!("select encode(digest, 'hex') from tessera.{table}"));
        rows.lines().map(str::to_owned).collect()
    };
    let (blobs, gone) = (digests("blobs"), digests("gone"));
    let bytes: HashSet<String> = bytes.into_inner().unwrap().iter().map(Digest::to_string).collect();
    assert!(blobs.is_subset(&bytes) && blobs.is_disjoint(&gone), "{blobs:?} {gone:?}");
    assert!(bytes.iter().all(|digest| blobs.contains(digest) || gone.contains(digest)));
}

#[needs(postgres)]
#[test]
fn a_removal_and_an_upload_of_the_same_blob_exclude_each_other() {
    let database = server::database();
    let (one, two) = (open(&database), open(&database));
    let (one, two) = (one.index(), two.index());
    let info = BlobInfo { digest: blob(1).0, size_bytes: 7 };
    let [first, again] = ["a", "b"].map(|owner| UploadId::new(info.digest, 7).of(owner));
    wait(async {
        // The removal has begun: the upload waits for its end.
        one.admit(first, TERMS).await.unwrap();
        one.showing(first).await.unwrap();
        one.publish(first, None).await.unwrap();
        assert_eq!(one.delete(info.digest).await.unwrap(), info);
        two.admit(again, TERMS).await.unwrap();
        assert!(one.removing(info).await.unwrap() && !two.removing(info).await.unwrap());
        assert!(!two.found(info, 1).await.unwrap());
        let end = async {
            tokio::time::sleep(Duration::from_millis(200)).await;
            one.removed(info, true).await.unwrap();
        };
        let (shown, ()) = tokio::join!(two.showing(again), end);
        shown.unwrap();
        // The upload has begun to be shown: the removal does not happen.
        assert!(!one.removing(info).await.unwrap());
        two.publish(again, None).await.unwrap();
        assert!(!one.removing(info).await.unwrap());
        assert_eq!(two.delete(info.digest).await.unwrap(), info);
        // One that nothing removes is there for a sweep; bytes that stay are back.
        assert_eq!(one.left(Duration::ZERO).await.unwrap(), [info]);
        assert_eq!(one.left(Duration::from_secs(60)).await.unwrap(), []);
        assert!(one.removing(info).await.unwrap());
        one.removed(info, false).await.unwrap();
        assert_eq!(
            (one.left(Duration::ZERO).await.unwrap(), two.get(info.digest).await.unwrap()),
            (vec![], Some(info))
        );
        // Only one process at a time shows an upload, and ends it then; a mark that was taken back is none.
        one.admit(first, TERMS).await.unwrap();
        one.showing(first).await.unwrap();
        one.showing(first).await.unwrap();
        let taken = two.showing(first).await.unwrap_err();
        assert!(matches!(taken, BlobError::Busy { .. }), "{taken}");
        two.end_upload(first).await.unwrap();
        two.touch_upload(first).await.unwrap();
        one.touch_upload(first).await.unwrap();
        two.showing(first).await.unwrap();
        two.end_upload(first).await.unwrap();
        assert_eq!(one.idle_time(first).await.unwrap(), None);
        // An upload that another process ended is not shown.
        let ended = BlobError::UploadNotFound { digest: info.digest };
        assert_eq!(one.showing(again).await, Err(ended));
    });
}

#[needs(postgres)]
#[test]
fn a_start_takes_nothing_from_processes_at_work() {
    let database = server::database();
    let (store, other) = (open(&database), open(&database));
    let (index, other) = (store.index(), other.index());
    let [known, new] = [1, 2].map(|k| BlobInfo { digest: blob(k).0, size_bytes: 5 });
    let [a, b] = ["a", "b"].map(Owner::of);
    wait(async {
        let id = UploadId::new(known.digest, 5).of("a");
        index.admit(id, TERMS).await.unwrap();
        index.publish(id, Some("job")).await.unwrap();
        index.pin(Some(a), "job", &[known.digest]).await.unwrap();
        let upload = UploadId::new(blob(3).0, 9).of("a");
        index.admit(upload, TERMS).await.unwrap();
        // Another process begins, with an older view of the storage: a mark that was given up, an upload that is old there.
        let owners = vec![(known.digest, b), (known.digest, a), (new.digest, b), (blob(4).0, b)];
        let stored =
            Stored { blobs: vec![(known, 1), (new, 1)], owners, uploads: vec![(upload, std::time::UNIX_EPOCH)] };
        assert_eq!(other.enter(stored).await.unwrap(), [(known.digest, b), (blob(4).0, b)]);
        assert!(index.has(a, known.digest).await.unwrap() && index.has(b, new.digest).await.unwrap());
        assert_eq!(index.disown(a, known.digest).await, Err(BlobError::Pinned { digest: known.digest }));
        assert!(index.idle_time(upload).await.unwrap().unwrap() < Duration::from_secs(600));
        assert_eq!(index.usage().await.unwrap(), sums(&database));
    });
}

#[needs(postgres)]
#[test]
fn too_many_owners_replace_each_other_as_elsewhere() {
    let database = server::database();
    let store = open(&database);
    let index = store.index();
    wait(async {
        let [one, two] = [1, 2].map(|k| (BlobInfo { digest: blob(k).0, size_bytes: 5 }, 1));
        index.enter(Stored { blobs: vec![one, two], ..Stored::default() }).await.unwrap();
        let digest = one.0.digest;
        let [early, rich, needed] = ["early", "rich", "needed"].map(Owner::of);
        index.give(early, digest).await.unwrap();
        database.sql(&format!(
            "insert into tessera.owners (digest, owner, size) select '\\x{digest}', substr(sha256(k::text::bytea), 1, 16), 5 \
             from generate_series(1, 253) k"
        ));
        index.give(needed, digest).await.unwrap();
        index.pin(Some(needed), "job", &[digest]).await.unwrap();
        index.give(rich, two.0.digest).await.unwrap();
        assert_eq!(index.give(rich, digest).await.unwrap(), None);
        let mut last = Owner::of("first");
        let replaced = index.give(last, digest).await.unwrap().unwrap();
        assert!(![early, rich, needed].contains(&replaced));
        for k in 0..3 {
            let next = Owner::of(&format!("next {k}"));
            assert_eq!(index.give(next, digest).await.unwrap(), Some(last), "the latest with the fewest");
            last = next;
        }
        assert_eq!(database.sql("select count(*) from tessera.owners where size = 5"), "257");
    });
}

#[needs(postgres)]
#[test]
fn a_use_soon_after_another_writes_nothing() {
    let database = server::database();
    let options = database.options("one");
    let store = wait(jobs::postgres::PostgresStore::open(options)).unwrap();
    let index = store.index();
    wait(async {
        let id = UploadId::new(blob(1).0, 7);
        index.admit(id, TERMS).await.unwrap();
        let stamp = index.publish(id, None).await.unwrap().stamp;
        assert_eq!(index.touch(&[id.digest]).await.unwrap()[0].unwrap().stamp, stamp);
        database.sql("update tessera.blobs set used = used - 11000000000");
        assert!(index.touch(&[id.digest]).await.unwrap()[0].unwrap().stamp > stamp);
    });
}

#[needs(postgres)]
#[test]
fn many_pinned_blobs_are_looked_at_once() {
    let database = server::database();
    let store = open(&database);
    let index = store.index();
    let held = || database.sql("select count(*) from tessera.blobs where held");
    wait(async {
        database.sql(
            "insert into tessera.blobs (digest, size, used) select sha256(k::text::bytea), 1, k from generate_series(1, 9000) k; \
             insert into tessera.pins (name, digest) select 'job ' || used, digest from tessera.blobs where used < 9000",
        );
        let terms = Terms { quota_bytes: 9000, places: 8, own_quota_bytes: None };
        let admit = async |k: u8| index.admit(UploadId::new(Digest::of(&[k]), 1), terms).await;
        assert_eq!(admit(1).await.unwrap().unwrap().victims.len(), 1);
        let full = admit(2).await.unwrap_err();
        assert!(matches!(full, BlobError::QuotaExceeded { pinned_bytes: 8999, used_bytes: 9000, .. }), "{full}");
        assert_eq!(held(), "8999");
        // The last pin lets it go, also where the mark stayed.
        index.pin(None, "other", &[Digest::of(b"77")]).await.unwrap();
        index.unpin("job 77").await.unwrap();
        assert_eq!(held(), "8999");
        index.unpin("other").await.unwrap();
        assert_eq!(held(), "8998");
        assert_eq!(admit(2).await.unwrap().unwrap().victims[0].digest, Digest::of(b"77"));
        database.sql(
            "delete from tessera.pins where name = 'job 78'; update tessera.blobs set held = true where used = 78",
        );
        assert_eq!(admit(3).await.unwrap().unwrap().victims[0].digest, Digest::of(b"78"));
    });
}

#[needs(postgres)]
#[test]
fn an_index_whose_database_is_away_can_be_asked_again() {
    let database = server::database_apart();
    let store = open(&database);
    let index = store.index();
    let id = UploadId::new(blob(1).0, 7);
    database.cluster.stop_immediate();
    let away = wait(index.admit(id, TERMS)).unwrap_err();
    assert!(matches!(away, BlobError::Database(_)) && away.is_temporary(), "{away}");
    database.cluster.start();
    wait(index.admit(id, TERMS)).unwrap().unwrap();
    wait(index.publish(id, None)).unwrap();
    database.cluster.stop_immediate();
    database.cluster.start();
    // What was answered is there after a crash, but for a first use of a connection that went down.
    let blob = (0..20).find_map(|_| wait(index.get(id.digest)).ok()).flatten();
    assert_eq!(blob.unwrap().size_bytes, 7);
}
