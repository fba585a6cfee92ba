//! The newest seeds of jobs at work, for watchers.
//!
//! Purpose: a watcher asks `Previews` for a job, and the work shows its seeds there after each step. Invariant: only the newest
//! seeds of a job are held, and only while the job is watched; work without watchers reads nothing back. The work never waits
//! for a watcher. Must not know: jobs' records, watchers, what is drawn.

use std::collections::HashMap;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use glam::DVec3;
use tokio::sync::watch;

use crate::lock;
use crate::record::JobId;

/// How long a job counts as watched after a request: a watcher asks again once it has drawn.
const INTEREST: Duration = Duration::from_secs(10);

/// Larger sets are not shown, so that watching costs no memory worth counting beside the work: 24 MB.
const MOST_SEEDS: usize = 1_000_000;

#[derive(Clone, Debug)]
pub struct Preview {
    pub steps: u64,
    /// Three doubles a seed, little-endian, in the caller's coordinates.
    pub seeds: bytes::Bytes,
}

/// What a watcher waits at. The sender is gone once the job has ended.
pub type PreviewReceiver = watch::Receiver<Option<Preview>>;

#[derive(Debug, Default)]
pub(crate) struct Previews {
    jobs: Mutex<HashMap<JobId, Watched>>,
}

#[derive(Debug)]
struct Watched {
    newest: watch::Sender<Option<Preview>>,
    asked: Instant,
}

impl Watched {
    fn is_watched(&self) -> bool {
        self.newest.receiver_count() > 0 || self.asked.elapsed() < INTEREST
    }
}

impl Previews {
    /// Watches a job, which may not have begun. What is shown of it from now on can be waited for.
    pub(crate) fn watch(&self, id: JobId) -> PreviewReceiver {
        let mut jobs = lock(&self.jobs);
        jobs.retain(|other, job| *other == id || job.is_watched());
        let new = || Watched { newest: watch::Sender::new(None), asked: Instant::now() };
        let job = jobs.entry(id).or_insert_with(new);
        job.asked = Instant::now();
        job.newest.subscribe()
    }

    pub(crate) fn is_watched(&self, id: JobId) -> bool {
        lock(&self.jobs).get(&id).is_some_and(Watched::is_watched)
    }

    pub(crate) fn show(&self, id: JobId, steps: u64, seeds: &[DVec3]) {
        if seeds.len() > MOST_SEEDS || !self.is_watched(id) {
            return;
        }
        let seeds: Vec<u8> = seeds.iter().flat_map(|seed| seed.to_array()).flat_map(f64::to_le_bytes).collect();
        if let Some(job) = lock(&self.jobs).get(&id) {
            job.newest.send_replace(Some(Preview { steps, seeds: seeds.into() }));
        }
    }

    pub(crate) fn end(&self, id: JobId) {
        lock(&self.jobs).remove(&id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Time;

    fn id(number: u128) -> JobId {
        JobId::new(Time(1), number)
    }

    #[tokio::test]
    async fn the_newest_seeds_are_shown_to_who_watches() {
        let previews = Previews::default();
        previews.show(id(1), 1, &[DVec3::X]);
        assert!(!previews.is_watched(id(1)), "nobody asked");
        let mut watcher = previews.watch(id(1));
        assert!(previews.is_watched(id(1)) && !previews.is_watched(id(2)));
        previews.show(id(1), 2, &[DVec3::X]);
        previews.show(id(1), 3, &[DVec3::new(0.1, -2.0, 1e300)]);
        let newest = watcher.wait_for(Option::is_some).await.unwrap().clone().unwrap();
        assert_eq!(newest.steps, 3);
        assert_eq!(newest.seeds[..], [0.1f64, -2.0, 1e300].map(f64::to_le_bytes).concat()[..]);
        previews.end(id(1));
        assert!(watcher.wait_for(|shown| shown.as_ref().is_some_and(|shown| shown.steps > 3)).await.is_err());
    }

    #[tokio::test]
    async fn what_nobody_watches_any_more_is_let_go_of() {
        let previews = Previews::default();
        for number in 0..100 {
            drop(previews.watch(id(number)));
        }
        for job in lock(&previews.jobs).values_mut() {
            job.asked = Instant::now().checked_sub(2 * INTEREST).unwrap();
        }
        let _watcher = previews.watch(id(200));
        assert_eq!(lock(&previews.jobs).len(), 1);
    }

    #[tokio::test]
    async fn large_sets_are_not_shown() {
        let previews = Previews::default();
        let watcher = previews.watch(id(1));
        previews.show(id(1), 1, &vec![DVec3::ZERO; MOST_SEEDS + 1]);
        assert!(watcher.borrow().is_none());
    }
}
