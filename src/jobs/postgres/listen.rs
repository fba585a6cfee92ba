//! Tells of changes, and hears of those by other processes.
//!
//! Purpose: [`Voice`] says which jobs were changed; [`listen`] wakes the waits of this process when any process says so. Invariant:
//! changes are said after their commit, those of a moment together, and never in the transaction: a transaction that
//! notifies holds a lock of the whole server while its commit goes to the disk, so that commits would go one by one. So a change
//! may remain unsaid, and after a connection was lost something may have been missed; a wait polls besides. A notification also
//! says whether a job came to wait, so that processes with room look for work. Progress is not said. Must not know: statements of operations.

use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use sqlx::PgPool;
use sqlx::postgres::PgListener;
use tokio::sync::{mpsc, watch};

use crate::record::JobId;
use crate::store::Waiters;

/// The channel on which all processes hear of changes.
const CHANNEL: &str = "tessera";
/// The first letter of a notification if a job came to wait.
const WORK: char = '+';
/// Names of jobs in one notification, which has less than 8,000 bytes. Of more changes no names are given.
const MOST_NAMES: usize = 200;
/// Transactions that wait to be said; of more nothing is said.
const WAITING: usize = 1024;
/// Between two notifications of this process.
const MOMENT: Duration = Duration::from_millis(20);
/// Of many processes, those that look at once for jobs that came to wait, besides one for each job. For one job the chance that none
/// looks is `e^-6`; then one does within a second. A process that has found a job looks again.
const LOOKERS: f64 = 5.0;
/// Other processes from which on only jobs that came to wait are said.
const MANY: u32 = 16;
/// Between attempts to connect.
const PAUSE: Duration = Duration::from_secs(1);

/// See the module's head. What it has to say ends with it.
#[derive(Debug)]
pub(super) struct Voice {
    waiters: Arc<Waiters>,
    work: Arc<watch::Sender<()>>,
    said: mpsc::Sender<Said>,
}

/// Changed jobs, and whether one of them waits now.
type Said = (Vec<JobId>, bool);

impl Voice {
    /// To be called within a runtime.
    pub(super) fn new(pool: PgPool, Ears { waiters, work, others }: Ears) -> Self {
        let (said, waiting) = mpsc::channel(WAITING);
        tokio::spawn(speak(pool, waiting, others));
        Self { waiters, work, said }
    }

    /// A transaction that changed these jobs was committed. `queued`: one of them waits now.
    pub(super) fn say(&self, jobs: Vec<JobId>, queued: bool) {
        if !jobs.is_empty() {
            self.waiters.wake(&jobs);
            if queued {
                self.work.send_replace(());
            }
            drop(self.said.try_send((jobs, queued)));
        }
    }
}

async fn speak(pool: PgPool, mut waiting: mpsc::Receiver<Said>, others: Arc<AtomicU32>) {
    let mut moment = Vec::new();
    while waiting.recv_many(&mut moment, WAITING).await > 0 {
        let has_work = moment.iter().any(|(_, queued)| *queued);
        // All processes hear what any of them says. Of many, waits find it when they poll.
        if !has_work && others.load(Ordering::Relaxed) >= MANY {
            moment.clear();
            continue;
        }
        let mut jobs: Vec<JobId> = moment.drain(..).flat_map(|(jobs, _)| jobs).collect();
        jobs.sort_unstable();
        jobs.dedup();
        let names: Vec<String> = jobs.iter().map(JobId::to_string).collect();
        let names = if names.len() > MOST_NAMES { String::new() } else { names.join(",") };
        let payload = if has_work { format!("{WORK}{names}") } else { names };
        let notify = sqlx::query("select pg_notify($1, $2)").bind(CHANNEL).bind(payload);
        if let Err(error) = notify.execute(&pool).await {
            tracing::debug!(%error, "changes are not said: waits poll");
        }
        tokio::time::sleep(MOMENT).await;
    }
}

/// What hears of changes.
#[derive(Clone)]
pub(super) struct Ears {
    pub waiters: Arc<Waiters>,
    pub work: Arc<watch::Sender<()>>,
    /// Processes that are alive beside this one.
    pub others: Arc<AtomicU32>,
}

/// Runs until it is aborted.
pub(super) async fn listen(pool: PgPool, ears: Ears) {
    loop {
        if let Err(error) = hear(&pool, &ears).await {
            tracing::debug!(%error, "nothing is heard from the database: waits poll");
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Ends when the connection does.
async fn hear(pool: &PgPool, Ears { waiters, work, others }: &Ears) -> Result<(), sqlx::Error> {
    let mut listener = PgListener::connect_with(pool).await?;
    listener.listen(CHANNEL).await?;
    let dice = RandomState::new();
    waiters.wake_all();
    work.send_replace(());
    while let Some(notification) = listener.try_recv().await? {
        let payload = notification.payload();
        let names = payload.strip_prefix(WORK).unwrap_or(payload);
        let has_work = names != payload;
        let names: Result<Vec<JobId>, _> = names.split(',').map(str::parse).collect();
        let jobs = match names {
            Ok(names) => {
                waiters.wake(&names);
                names.len()
            }
            // Too many for one notification.
            Err(_) => {
                waiters.wake_all();
                usize::MAX
            }
        };
        let all = f64::from(others.load(Ordering::Relaxed)) + 1.0;
        // From 0 to 1, another one in each process.
        let draw = dice.hash_one(payload) as f64 / u64::MAX as f64;
        if has_work && draw * all < LOOKERS + jobs as f64 {
            work.send_replace(());
        }
    }
    Ok(())
}
