//! Tells of changes, and hears of those by other processes.
//!
//! Purpose: [`Voice`] says which jobs were changed; [`listen`] wakes the waits of this process when any process says so. Invariant:
//! changes are said after their commit, those of a moment together, and never in the transaction: a transaction that
//! notifies holds a lock of the whole server while its commit goes to the disk, so that commits would go one by one. So a change
//! may remain unsaid, and after a connection was lost something may have been missed; a wait polls besides. Progress is not
//! said. Must not know: statements of operations.

use std::sync::Arc;
use std::time::Duration;

use sqlx::PgPool;
use sqlx::postgres::PgListener;
use tokio::sync::mpsc;

use crate::record::JobId;
use crate::store::Waiters;

/// The channel on which all processes hear of changes.
const CHANNEL: &str = "tessera";
/// Names of jobs in one notification, which has less than 8,000 bytes. Of more changes no names are given.
const MOST_NAMES: usize = 200;
/// Transactions that wait to be said; of more nothing is said.
const WAITING: usize = 1024;
/// Between two notifications of this process.
const MOMENT: Duration = Duration::from_millis(20);
/// Between attempts to connect.
const PAUSE: Duration = Duration::from_secs(1);

/// See the module's head. What it has to say ends with it.
#[derive(Debug)]
pub(super) struct Voice {
    waiters: Arc<Waiters>,
    said: mpsc::Sender<Vec<JobId>>,
}

impl Voice {
    /// To be called within a runtime.
    pub(super) fn new(pool: PgPool, waiters: Arc<Waiters>) -> Self {
        let (said, waiting) = mpsc::channel(WAITING);
        tokio::spawn(speak(pool, waiting));
        Self { waiters, said }
    }

    /// A transaction that changed these jobs was committed.
    pub(super) fn say(&self, jobs: Vec<JobId>) {
        if !jobs.is_empty() {
            self.waiters.wake(&jobs);
            drop(self.said.try_send(jobs));
        }
    }
}

async fn speak(pool: PgPool, mut waiting: mpsc::Receiver<Vec<JobId>>) {
    let mut moment = Vec::new();
    while waiting.recv_many(&mut moment, WAITING).await > 0 {
        let mut jobs: Vec<JobId> = moment.drain(..).flatten().collect();
        jobs.sort_unstable();
        jobs.dedup();
        let names: Vec<String> = jobs.iter().map(JobId::to_string).collect();
        let payload = if names.len() > MOST_NAMES { String::new() } else { names.join(",") };
        let notify = sqlx::query("select pg_notify($1, $2)").bind(CHANNEL).bind(payload);
        if let Err(error) = notify.execute(&pool).await {
            tracing::debug!(%error, "changes are not said: waits poll");
        }
        tokio::time::sleep(MOMENT).await;
    }
}

/// Runs until it is aborted.
pub(super) async fn listen(pool: PgPool, waiters: Arc<Waiters>) {
    loop {
        if let Err(error) = hear(&pool, &waiters).await {
            tracing::debug!(%error, "nothing is heard from the database: waits poll");
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Ends when the connection does.
async fn hear(pool: &PgPool, waiters: &Waiters) -> Result<(), sqlx::Error> {
    let mut listener = PgListener::connect_with(pool).await?;
    listener.listen(CHANNEL).await?;
    waiters.wake_all();
    while let Some(notification) = listener.try_recv().await? {
        let names: Result<Vec<JobId>, _> = notification.payload().split(',').map(str::parse).collect();
        match names {
            Ok(names) => waiters.wake(&names),
            // Too many for one notification.
            Err(_) => waiters.wake_all(),
        }
    }
    Ok(())
}
