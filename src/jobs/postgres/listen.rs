//! Hears of changes by other processes.
//!
//! Purpose: [`listen`] wakes the waits of this process when a transaction that changed a job was committed anywhere. Invariant:
//! after a connection was lost all waits are woken, since something may have been missed. A wait does not rely on it: it polls
//! besides. Must not know: jobs, statements of operations.

use std::sync::Arc;
use std::time::Duration;

use sqlx::PgPool;
use sqlx::postgres::PgListener;

use super::jobs::CHANNEL;
use crate::record::JobId;
use crate::store::Waiters;

/// Between attempts to connect.
const PAUSE: Duration = Duration::from_secs(1);

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
