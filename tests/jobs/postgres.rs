//! Promise: a store in PostgreSQL is one store for all of its clients; what was acknowledged outlives the server's crash.

use jobs::postgres::{PostgresOptions, PostgresStore};
use jobs::store::StoreError;
use needs::needs;

use super::wait;
use crate::postgres_server::{self as server, PASSWORD};

fn options(url: String) -> PostgresOptions {
    PostgresOptions::new(url, "one")
}

fn refusal(options: PostgresOptions) -> StoreError {
    wait(PostgresStore::open(options)).unwrap_err()
}

#[needs(postgres)]
#[test]
fn the_schema_is_made_once_also_by_several_at_once() {
    let database = server::database();
    std::thread::scope(|scope| {
        let open = || wait(PostgresStore::open(options(database.url()))).map(drop).unwrap();
        for thread in [scope.spawn(open), scope.spawn(open)] {
            thread.join().unwrap();
        }
    });
    wait(PostgresStore::open(options(database.url()))).unwrap();
    assert_eq!(database.sql("select count(*) = max(version) from tessera.migrations"), "t");
    // A release that took something away.
    database.sql("update tessera.layout set needs = 999");
    let refused = refusal(options(database.url()));
    assert!(matches!(refused, StoreError::UnknownVersion { found: 999, .. }), "{refused}");
}

#[needs(postgres)]
#[test]
fn a_password_comes_with_the_address_or_from_a_file() {
    let database = server::database();
    let escaped: String = PASSWORD.bytes().map(|byte| format!("%{byte:02X}")).collect();
    wait(PostgresStore::open(options(database.url_by_port(&format!("tessera:{escaped}"))))).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("password");
    std::fs::write(&file, format!("{PASSWORD}\n")).unwrap();
    let by_file = PostgresOptions { password_file: Some(file), ..options(database.url_by_port("tessera")) };
    wait(PostgresStore::open(by_file)).unwrap();
    let refused = refusal(options(database.url_by_port("tessera:wrong")));
    assert!(matches!(refused, StoreError::Unusable { .. }) && !refused.to_string().contains("wrong"), "{refused}");
}

#[needs(postgres)]
#[test]
fn a_database_that_may_lose_jobs_is_refused() {
    let database = server::database();
    for value in ["off", "local"] {
        database.sql(&format!("alter database {} set synchronous_commit = {value}", database.name));
        let refused = refusal(options(database.url()));
        assert!(matches!(&refused, StoreError::Unusable { cause } if cause.contains(value)), "{refused}");
    }
    wait(PostgresStore::open(PostgresOptions { may_lose: true, ..options(database.url()) })).unwrap();
}

#[test]
fn a_server_that_is_not_there_is_unavailable() {
    let refused = refusal(options("postgres://tessera@127.0.0.1:1/tessera".to_owned()));
    assert!(matches!(refused, StoreError::Unavailable { .. }), "{refused}");
}
