//! Jobs in a PostgreSQL database that several servers share.
//!
//! Purpose: [`PostgresStore`]. Each operation is one short transaction. Invariant: what was answered is committed; only the
//! database's clock decides. Must not know: messages, how jobs are done.

mod index;
mod migrations;
mod pool;

use std::sync::Arc;

pub use pool::PostgresOptions;

use crate::blob::index::BlobIndex;
use crate::store::StoreError;
use index::PostgresIndex;
use pool::Database;

#[derive(Debug)]
pub struct PostgresStore {
    index: Arc<PostgresIndex>,
}

impl PostgresStore {
    /// Connects, and brings the schema of the database up to date. Errors: `Unusable`, `Unavailable`, `UnknownVersion`.
    pub async fn open(options: PostgresOptions) -> Result<Self, StoreError> {
        let database = Database::open(&options).await?;
        let index = Arc::new(PostgresIndex::new(database.clone(), options.same_use));
        Ok(Self { index })
    }

    pub fn index(&self) -> Arc<dyn BlobIndex> {
        self.index.clone()
    }
}
