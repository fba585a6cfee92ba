//! Promise: the directory of a journal belongs to one process, and what is wrong with it is told, never taken for empty.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use jobs::record::event::{KEPT_PROGRESS, Progress, What};
use jobs::record::state::State;
use jobs::record::*;
use jobs::store::*;

use super::{input, knowing, open_journal, spec, wait};

fn open(path: &Path) -> Result<RedbStore, StoreError> {
    open_journal(path).map(|store| knowing(store, &[(input(), 1)]))
}

fn new(number: u128) -> NewJob {
    NewJob { random: number, spec: spec(&format!("r{number}"), 1), needs: Bytes::default(), cost: Cost::default() }
}

#[test]
fn jobs_are_there_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let store = open(folder.path()).unwrap();
    let job = wait(store.create(new(1))).unwrap().job;
    drop(store);
    assert_eq!(wait(open(folder.path()).unwrap().get(job.id)).unwrap(), job);
}

#[test]
fn a_second_process_is_told_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let first = open(folder.path()).unwrap();
    let error = RedbStore::open(folder.path(), RedbOptions::default()).unwrap_err();
    let StoreError::InUse { ref holder, .. } = error else { panic!("{error}") };
    assert_eq!(holder.as_deref(), Some(&*std::process::id().to_string()));
    assert!(error.to_string().contains("--data-dir"), "{error}");
    drop(first);
    open(folder.path()).unwrap();
}

#[test]
fn damage_is_not_an_empty_journal() {
    let folder = tempfile::tempdir().unwrap();
    let journal = folder.path().join("journal.redb");
    let store = open(folder.path()).unwrap();
    (0..50).for_each(|number| drop(wait(store.create(new(number))).unwrap()));
    drop(store);
    let whole = fs::read(&journal).unwrap();
    let mut damages: Vec<(String, Option<Vec<u8>>)> = vec![
        ("gone".to_owned(), None),
        ("empty".to_owned(), Some(Vec::new())),
        ("cut".to_owned(), Some(whole[..whole.len() / 2].to_vec())),
        ("short".to_owned(), Some(whole[..100].to_vec())),
        ("other".to_owned(), Some(b"something else".repeat(1000))),
        ("zero".to_owned(), Some(vec![0; whole.len()])),
    ];
    // Bytes of the records themselves.
    let body = whole.windows(7).position(|bytes| bytes == b"\"points").unwrap();
    let mut flipped = whole.clone();
    flipped[body] ^= 1;
    damages.push(("flipped".to_owned(), Some(flipped)));
    for (name, bytes) in damages {
        let is_gone = bytes.is_none();
        match bytes {
            Some(bytes) => fs::write(&journal, bytes).unwrap(),
            None => fs::remove_file(&journal).unwrap(),
        }
        let error = open(folder.path()).expect_err(&name);
        match error {
            // Nothing is there that could be mended.
            StoreError::Unreadable { .. } => assert!(is_gone, "{name}"),
            error => assert!(matches!(error, StoreError::Damaged { .. }) && !is_gone, "{name}: {error:?}"),
        }
    }
    fs::write(&journal, &whole).unwrap();
    let page = wait(open(folder.path()).unwrap().list(Query::default())).unwrap();
    assert_eq!(page.jobs.len(), 50);
}

#[test]
fn a_directory_of_a_later_release_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    drop(open(folder.path()).unwrap());
    fs::write(folder.path().join("version"), "2\n").unwrap();
    let error = open(folder.path()).unwrap_err();
    assert!(matches!(error, StoreError::UnknownVersion { found: 2, .. }), "{error:?}");
}

#[test]
fn a_watcher_goes_on_where_it_was() {
    let store: Arc<dyn JobStore> = Arc::new(knowing(MemoryStore::default(), &[(input(), 1)]));
    wait(async {
        let job = store.create(new(1)).await.unwrap().job;
        let id = job.id;
        let later = Arc::clone(&store);
        let watcher = tokio::spawn(async move { later.wait(id, 1).await });
        tokio::task::yield_now().await;
        let offer = Offer::new("x", Duration::from_secs(1), Bytes::MAX);
        let at = store.claim_next(offer).await.unwrap().unwrap().status.version;
        watcher.await.unwrap().unwrap();
        for index in 0..1000 {
            let (kind, energy, gradient_norm, ms) = ("lloyd".to_owned(), 1.0, f64::NAN, 1.0);
            let step =
                Progress::Iteration { index, total: 1000, kind, energy, energy_ratio: energy, gradient_norm, ms };
            store.progress(id, at, step).await.unwrap();
        }
        store.change(id, at, Change::Succeed(ResultSet::default())).await.unwrap();
        let seen = store.events(id, 0, usize::MAX).await.unwrap();
        assert_eq!(seen.events.len(), KEPT_PROGRESS + 3);
        assert_eq!(seen.missing, 1000 - KEPT_PROGRESS as u64);
        assert!(matches!(seen.events.last().unwrap().what, What::State { state: State::Succeeded, attempt: 1 }));
        let from = seen.events[10].number;
        assert_eq!(store.events(id, from, 5).await.unwrap().events, seen.events[11..16]);
        let gone = Arc::clone(&store);
        let watcher = tokio::spawn(async move { gone.wait(id, u64::MAX).await });
        tokio::task::yield_now().await;
        store.delete(id).await.unwrap();
        assert_eq!(watcher.await.unwrap(), Err(StoreError::NotFound { id }));
    });
}

#[test]
fn deadlines_run_out_in_the_queue_and_at_work() {
    let time = Arc::new(AtomicU64::new(1000));
    let read = Arc::clone(&time);
    let store = MemoryStore::with_clock(Clock::new(move || Time(read.load(Ordering::SeqCst))));
    let store = knowing(store, &[(input(), 1)]);
    wait(async {
        let mut job = new(1);
        let (queue_deadline, run_deadline) = (super::millis(10), super::millis(20));
        let message = tessera::proto::JobSpec { queue_deadline, run_deadline, ..super::message(1) };
        job.spec = Spec::new(message, "t".to_owned(), String::new()).unwrap();
        let id = store.create(job).await.unwrap().job.id;
        let later = |ms: u64| time.store(1000 + ms, Ordering::SeqCst);
        later(9);
        assert_eq!(store.expire(super::KEEP, 10).await.unwrap(), Swept::default());
        store.claim_next(Offer::of("x", Duration::from_millis(90), id)).await.unwrap().unwrap();
        later(28);
        assert_eq!(store.expire(super::KEEP, 10).await.unwrap(), Swept::default());
        later(29);
        assert_eq!(store.expire(super::KEEP, 10).await.unwrap().expired, [id]);
        let status = store.get(id).await.unwrap().status;
        assert_eq!(status.outcome, Some(Outcome::Expired(Cause::RunDeadline)));
    });
}
