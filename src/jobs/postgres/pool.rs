//! Connections to the database.
//!
//! Purpose: [`Database`] has a pool of connections that are all set alike; what the database says becomes a [`StoreError`].
//! Invariant: every connection has our timeouts, reads what is committed, and keeps what it commits on its own disk and on the
//! synchronous standbys, unless that was given up. A wait for a connection or an answer ends. Secrets are in no text.
//! Must not know: tables, jobs.

use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;

use sqlx::postgres::{PgConnectOptions, PgPoolOptions};
use sqlx::{Connection, PgConnection, PgPool, PgTransaction};

use super::migrations;
use crate::blob::BlobError;
use crate::store::StoreError;

/// The oldest server that is used.
const OLDEST: i32 = 14;
/// [`PostgresOptions::acquire`], if nothing else is given.
const ACQUIRE: Duration = Duration::from_millis(1500);
/// For all that an operation does.
const OPERATION: Duration = Duration::from_secs(8);
/// For a sweep or a list of many jobs.
const LONG_OPERATION: Duration = Duration::from_secs(40);

/// [`PostgresOptions::same_use`], if nothing else is given.
const SAME_USE: Duration = Duration::from_secs(10);

/// How a store gets at its database.
#[derive(Clone)]
pub struct PostgresOptions {
    /// `postgres://USER[:PASSWORD]@HOST[:PORT]/DATABASE`, with `sslmode`, `sslrootcert`, `sslcert` and `sslkey` as parameters.
    /// Without a password the file `PGPASSFILE` is looked at.
    pub url: String,
    /// A file that holds the password alone.
    pub password_file: Option<PathBuf>,
    /// How this process calls itself when it takes jobs.
    pub holder: String,
    /// The most connections of the pool; one more listens.
    pub connections: u32,
    /// For a connection. With a retry by the caller it must fit into a call's patience, and into the time of an operation.
    pub acquire: Duration,
    /// Uses of a blob within this time count as one, which saves writes: those that go for want of room were not used for longer.
    pub same_use: Duration,
    /// Whether `synchronous_commit` may be `off` or `local`: a crash or a failover then loses jobs that were acknowledged.
    pub may_lose: bool,
    /// No sweep of any process for so long means that the database was away. Leases then get their length once more before
    /// [`Orphans::LeaseOver`](crate::store::Orphans) counts. Longer than the time between sweeps, and shorter than a lease.
    pub silence: Duration,
}

impl PostgresOptions {
    pub fn new(url: impl Into<String>, holder: impl Into<String>) -> Self {
        Self {
            url: url.into(),
            password_file: None,
            holder: holder.into(),
            connections: 8,
            acquire: ACQUIRE,
            same_use: SAME_USE,
            may_lose: false,
            silence: Duration::from_secs(10),
        }
    }

    /// Errors: `Unusable`.
    fn connecting(&self) -> Result<PgConnectOptions, StoreError> {
        let unusable = |cause: String| StoreError::Unusable { cause };
        if !["postgres://", "postgresql://"].iter().any(|scheme| self.url.starts_with(scheme)) {
            return Err(unusable("give postgres://USER@HOST/DATABASE".to_owned()));
        }
        // What the parser says may repeat a part of the text, the password for example.
        let wrong = "its address cannot be read; give postgres://USER@HOST/DATABASE, special characters as %XX";
        let mut options = PgConnectOptions::from_str(&self.url).map_err(|_| unusable(wrong.to_owned()))?;
        if let Some(path) = &self.password_file {
            let password = std::fs::read_to_string(path)
                .map_err(|error| unusable(format!("cannot read the password in {}: {error}", path.display())))?;
            options = options.password(password.trim_end_matches(['\r', '\n']));
        }
        if options.get_application_name().is_none() {
            options = options.application_name("tessera");
        }
        Ok(options)
    }
}

#[derive(Clone, Debug)]
pub(super) struct Database {
    pool: PgPool,
}

impl Database {
    /// Connects, and brings the schema up to date. Errors: `Unusable`, `Unavailable`, `UnknownVersion`.
    pub(super) async fn open(options: &PostgresOptions) -> Result<Self, StoreError> {
        first(options, LONG_OPERATION, async |connection| migrations::migrate(connection).await).await?;
        Ok(Self { pool: pool(options, options.connecting()?, options.connections) })
    }

    /// Connects, and leaves the schema as it is. Errors: as [`Self::open`].
    pub(super) async fn connect(options: &PostgresOptions) -> Result<Self, StoreError> {
        first(options, OPERATION, async |connection| migrations::check(connection).await).await?;
        Ok(Self { pool: pool(options, options.connecting()?, options.connections) })
    }

    /// Brings the schema up to date. Gives how many steps there were, and how many there are.
    pub(super) async fn migrate(options: &PostgresOptions) -> Result<(i64, i64), StoreError> {
        first(options, LONG_OPERATION, async |connection| {
            let before = migrations::done(connection).await?;
            migrations::migrate(connection).await?;
            Ok((before, migrations::done(connection).await?))
        })
        .await
    }

    /// A connection of its own, for what must hear while others work.
    pub(super) fn apart(options: &PostgresOptions) -> Result<PgPool, StoreError> {
        Ok(pool(options, options.connecting()?, 1))
    }

    pub(super) fn pool(&self) -> &PgPool {
        &self.pool
    }

    pub(super) async fn begin(&self) -> Result<PgTransaction<'static>, StoreError> {
        Ok(self.pool.begin().await?)
    }

    /// Ends what takes too long: it is unknown then what became of it.
    pub(super) async fn run<T>(&self, work: impl Future<Output = Result<T, StoreError>>) -> Result<T, StoreError> {
        within(OPERATION, work).await
    }

    /// As [`Self::run`], for what looks at many jobs.
    pub(super) async fn run_long<T>(&self, work: impl Future<Output = Result<T, StoreError>>) -> Result<T, StoreError> {
        within(LONG_OPERATION, work).await
    }
}

/// Does what comes first, on a connection of its own: of a pool's it would only be said that it took too long.
async fn first<T>(
    options: &PostgresOptions,
    time: Duration,
    work: impl AsyncFnOnce(&mut PgConnection) -> Result<T, StoreError>,
) -> Result<T, StoreError> {
    let connecting = options.connecting()?;
    within(time, async {
        let mut connection = PgConnection::connect_with(&connecting).await?;
        check(&mut connection, options.may_lose).await?;
        let done = work(&mut connection).await;
        connection.close().await?;
        done
    })
    .await
}

async fn within<T>(time: Duration, work: impl Future<Output = Result<T, StoreError>>) -> Result<T, StoreError> {
    match tokio::time::timeout(time, work).await {
        Ok(done) => done,
        Err(_) => Err(StoreError::Unavailable { cause: format!("no answer within {} s", time.as_secs()) }),
    }
}

fn pool(options: &PostgresOptions, connecting: PgConnectOptions, connections: u32) -> PgPool {
    let may_lose = options.may_lose;
    PgPoolOptions::new()
        .max_connections(connections)
        .acquire_timeout(options.acquire)
        .after_connect(move |connection, _| {
            Box::pin(async move {
                check(connection, may_lose)
                    .await
                    .map_err(|error| sqlx::Error::Configuration(error.to_string().into()))?;
                set(connection).await
            })
        })
        .connect_lazy_with(connecting)
}

/// Whether the server is one that jobs can be trusted to. After a failover it is another one. Errors: `Unusable`, `Unavailable`.
async fn check(connection: &mut PgConnection, may_lose: bool) -> Result<(), StoreError> {
    let (version, encoding, commit, is_standby): (i32, String, String, bool) = sqlx::query_as(
        "select current_setting('server_version_num')::int4, current_setting('server_encoding'), \
         current_setting('synchronous_commit'), pg_is_in_recovery()",
    )
    .fetch_one(connection)
    .await?;
    let cause = match () {
        () if is_standby => return Err(StoreError::Unavailable { cause: "it is a standby".to_owned() }),
        () if version / 10000 < OLDEST => {
            format!("its server has version {}; take {OLDEST} or newer", version / 10000)
        }
        () if encoding != "UTF8" => format!("its encoding is {encoding}; make a database with the encoding UTF8"),
        () if !may_lose && ["off", "local"].contains(&commit.as_str()) => format!(
            "synchronous_commit is {commit}, so that a crash or a failover loses jobs that were acknowledged; set it to on for \
             the server, the role or the database"
        ),
        () => return Ok(()),
    };
    Err(StoreError::Unusable { cause })
}

/// An operation is a few short statements. What hangs lets go of its locks.
async fn set(connection: &mut PgConnection) -> Result<(), sqlx::Error> {
    let settings = "set statement_timeout = '5s'; set lock_timeout = '3s'; \
                    set idle_in_transaction_session_timeout = '10s'; \
                    set default_transaction_isolation = 'read committed'";
    sqlx::raw_sql(settings).execute(connection).await.map(drop)
}

/// Whether the same statement may succeed later, by its SQLSTATE.
fn is_passing(code: &str) -> bool {
    // Connections, conflicts, resources, the operator, the system; a lock that was not free; a server that became a standby.
    ["08", "40", "53", "57", "58"].iter().any(|class| code.starts_with(class))
        || ["55P03", "25006", "25P03"].contains(&code)
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        use sqlx::Error as E;
        let cause = error.to_string();
        match error {
            E::Database(error) if !error.code().is_some_and(|code| is_passing(&code)) => Self::Unusable { cause },
            // A certificate that was refused, for example.
            E::Io(error) if error.get_ref().is_some_and(|error| error.is::<rustls::Error>()) => {
                Self::Unusable { cause }
            }
            E::Database(_) | E::Io(_) | E::Protocol(_) | E::PoolTimedOut | E::WorkerCrashed | E::BeginFailed => {
                Self::Unavailable { cause }
            }
            E::PoolClosed => Self::Closed,
            _ => Self::Unusable { cause },
        }
    }
}

impl From<sqlx::Error> for BlobError {
    fn from(error: sqlx::Error) -> Self {
        Self::Database(error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(url: &str) -> String {
        PostgresOptions::new(url, "a").connecting().unwrap_err().to_string()
    }

    #[test]
    fn an_address_that_cannot_be_read_is_refused_without_its_password() {
        for url in
            ["", "mysql://a@b/c", "/var/run", "postgres://a:secret@b:port/c", "postgres://a:secret@b/c?sslmode=secret"]
        {
            let text = refusal(url);
            assert!(text.contains("postgres://USER@HOST/DATABASE") && !text.contains("secret"), "{text}");
        }
        let options =
            PostgresOptions { password_file: Some("/no/file".into()), ..PostgresOptions::new("postgres://a@b/c", "a") };
        assert!(options.connecting().unwrap_err().to_string().contains("/no/file"));
    }

    #[test]
    fn what_passes_is_told_from_what_stays() {
        for (code, passes) in
            [("57P01", true), ("53100", true), ("40P01", true), ("25006", true), ("42501", false), ("22021", false)]
        {
            assert_eq!(is_passing(code), passes, "{code}");
        }
    }
}
