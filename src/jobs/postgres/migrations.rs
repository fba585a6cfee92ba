//! The schema of the database, step by step.
//!
//! Purpose: [`migrate`] brings the schema `tessera` to what this program needs. Invariant: steps go forward only, one transaction each,
//! under an advisory lock, so that servers may start at once. A step that is out is never edited. A step adds first and takes
//! away in a later release, so that two releases work side by side; `layout.needs` keeps out programs that know too little.
//! Must not know: what the tables are for.

use sqlx::migrate::{MigrateError, Migration, MigrationType, Migrator};
use sqlx::{PgConnection, SqlSafeStr};

use crate::store::StoreError;

const STEPS: [(&str, &str); 4] = [
    ("jobs", include_str!("migrations/0001_jobs.sql")),
    ("blobs", include_str!("migrations/0002_blobs.sql")),
    ("cluster", include_str!("migrations/0003_cluster.sql")),
    ("reuse", include_str!("migrations/0004_reuse.sql")),
];

/// Does the steps that the database lacks. The caller closes the connection. Errors: `UnknownVersion` if its schema needs a later program; `Unavailable`; `Unusable`.
pub(super) async fn migrate(connection: &mut PgConnection) -> Result<(), StoreError> {
    if done(connection).await? < known() {
        run(connection).await?;
    }
    check(connection).await
}

/// Steps that this program knows.
pub(super) fn known() -> i64 {
    STEPS.len() as i64
}

/// Whether this program knows enough for the schema, if there is one. Errors: `UnknownVersion`; `Unavailable`; `Unusable`.
pub(super) async fn check(connection: &mut PgConnection) -> Result<(), StoreError> {
    if done(connection).await? == 0 {
        return Ok(());
    }
    let needs: i64 = sqlx::query_scalar("select needs from tessera.layout").fetch_one(connection).await?;
    if needs > known() {
        return Err(StoreError::UnknownVersion {
            what: "the database's schema".to_owned(),
            found: u32::try_from(needs).unwrap_or(u32::MAX),
            known: STEPS.len() as u32,
        });
    }
    Ok(())
}

/// Steps that were done. A program that lacks none may work without the right to make tables.
pub(super) async fn done(connection: &mut PgConnection) -> Result<i64, StoreError> {
    let is_there = sqlx::query_scalar("select to_regclass('tessera.migrations') is not null");
    if !is_there.fetch_one(&mut *connection).await? {
        return Ok(0);
    }
    let steps = sqlx::query_scalar("select coalesce(max(version), 0) from tessera.migrations where success");
    Ok(steps.fetch_one(connection).await?)
}

async fn run(connection: &mut PgConnection) -> Result<(), StoreError> {
    let steps = (1..).zip(STEPS).map(|(number, (name, sql))| {
        Migration::new(number, name.into(), MigrationType::Simple, sql.into_sql_str(), false)
    });
    let mut migrator = Migrator::with_migrations(steps.collect());
    migrator.set_ignore_missing(true);
    migrator.dangerous_set_table_name("tessera.migrations");
    migrator.create_schema("tessera");
    // With an advisory lock. After an error it goes with the connection.
    migrator.run(connection).await.map_err(failed)
}

fn failed(error: MigrateError) -> StoreError {
    match error {
        MigrateError::Execute(error) | MigrateError::ExecuteMigration(error, _) => error.into(),
        error => StoreError::Unusable { cause: format!("its schema cannot be brought up to date: {error}") },
    }
}
