//! Figures, as JSON: `cargo test --test jobs figures -- --ignored --nocapture`. `TESSERA_FIGURES_DIR` says on which disk.
//!
//! No bar is held here: a machine that is busy with other things would miss it.

use std::sync::Arc;
use std::time::Instant;

use jobs::record::state::State;
use jobs::record::*;
use jobs::store::*;

use super::{input, knowing, spec, wait};
use crate::process::resident_bytes;

const JOBS: u64 = 10_000;
const THREADS: u64 = 8;

fn create_all(store: &Arc<dyn JobStore>) -> f64 {
    let start = Instant::now();
    std::thread::scope(|scope| {
        for thread in 0..THREADS {
            scope.spawn(move || {
                for number in (thread..JOBS).step_by(THREADS as usize) {
                    let spec = spec(&format!("r{number}"), number);
                    wait(store.create(NewJob {
                        random: number.into(),
                        spec,
                        needs: Bytes::default(),
                        cost: Cost::default(),
                    }))
                    .unwrap();
                }
            });
        }
    });
    JOBS as f64 / start.elapsed().as_secs_f64()
}

fn page_ms(store: &Arc<dyn JobStore>, query: &Query) -> f64 {
    let mut times: Vec<f64> = (0..21)
        .map(|_| {
            let start = Instant::now();
            wait(store.list(query.clone())).unwrap();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[10]
}

fn figures(name: &str, store: &Arc<dyn JobStore>) -> String {
    let before = resident_bytes();
    let creates = create_all(store);
    let memory = (resident_bytes().saturating_sub(before)) as f64 / 1024.0 / JOBS as f64;
    let first = page_ms(store, &Query::default());
    let queued = page_ms(store, &Query { states: vec![State::Queued], ..Query::default() });
    let rare = page_ms(store, &Query { labels: [("body".to_owned(), "1".to_owned())].into(), ..Query::default() });
    format!(
        "\"{name}\": {{ \"creates_per_s\": {creates:.0}, \"memory_kib_per_job\": {memory:.2}, \"list_page_ms\": \
         {{ \"first\": {first:.2}, \"queued\": {queued:.2}, \"one_label_of_all\": {rare:.2} }}"
    )
}

#[test]
#[ignore = "figures, not a test"]
fn figures_of_the_stores() {
    let memory: Arc<dyn JobStore> = Arc::new(knowing(MemoryStore::default(), &[(input(), 1)]));
    let memory = figures("memory", &memory);
    let folder = match std::env::var_os("TESSERA_FIGURES_DIR") {
        Some(folder) => tempfile::tempdir_in(folder).unwrap(),
        None => tempfile::tempdir().unwrap(),
    };
    let live = folder.path().join("live");
    let store = RedbStore::open(&live, RedbOptions::default()).unwrap();
    let store: Arc<dyn JobStore> = Arc::new(knowing(store, &[(input(), 1)]));
    let journal = figures("redb", &store);
    // As `kill -9` leaves it: the file as it is while the store is open.
    let killed = folder.path().join("killed");
    std::fs::create_dir(&killed).unwrap();
    for name in ["journal.redb", "version"] {
        std::fs::copy(live.join(name), killed.join(name)).unwrap();
    }
    let bytes = std::fs::metadata(killed.join("journal.redb")).unwrap().len();
    drop(store);
    let start = Instant::now();
    let again = RedbStore::open(&killed, RedbOptions::default()).unwrap();
    let queued = wait(again.recover(Orphans::All, MAX_CRASHES)).unwrap().queued.len();
    let open = start.elapsed().as_secs_f64() * 1e3;
    assert_eq!(queued as u64, JOBS);
    println!(
        "{{ \"jobs\": {JOBS}, \"threads\": {THREADS}, {memory} }}, {journal}, \"file_bytes_per_job\": {}, \
         \"open_and_recover_after_kill_ms\": {open:.1} }} }}",
        bytes / JOBS
    );
}
