//! Promise: a store in PostgreSQL is one store for all of its clients; what was acknowledged outlives the server's crash.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Barrier;
use std::time::{Duration, Instant};

use jobs::postgres::{PostgresOptions, PostgresStore};
use jobs::record::event::{Progress, What};
use jobs::record::state::State;
use jobs::record::*;
use jobs::store::*;
use needs::needs;
use sqlx::{Connection, PgConnection};

use super::{KEEP, input, knowing, message, spec, wait};
use crate::certificates::{Age, Authority};
use crate::postgres_server::{self as server, Database, PASSWORD};

const CLIENTS: usize = 4;
const LEASE: Duration = Duration::from_secs(60);
const PLENTY: Bytes = Bytes::MAX;

/// A store in this database, by a process that calls itself as the model's.
pub fn open(database: &Database) -> PostgresStore {
    // The model knows of no outage.
    let options = PostgresOptions { connections: 4, silence: Duration::MAX, ..options(database.url()) };
    wait(PostgresStore::open(options)).unwrap()
}

/// The clock of a database, set by hand.
pub struct Clock(std::cell::RefCell<PgConnection>);

impl Clock {
    /// Takes the place of the clock of a database that has the schema.
    pub fn new(database: &Database) -> Self {
        database.sql(
            "create table public.clock (ms bigint not null); insert into public.clock values (0); \
             create or replace function tessera.now_ms() returns bigint language sql volatile as 'select ms from public.clock'",
        );
        Self(wait(PgConnection::connect(&database.url())).unwrap().into())
    }

    fn run(&self, sql: &'static str) {
        wait(sqlx::raw_sql(sql).execute(&mut *self.0.borrow_mut())).unwrap();
    }

    pub fn set(&self, now: Time) {
        let set = sqlx::query("update public.clock set ms = $1").bind(now.0 as i64);
        wait(set.execute(&mut *self.0.borrow_mut())).unwrap();
    }

    /// Forgets all that is in the store.
    pub fn begin_again(&self) {
        self.run(
            "delete from tessera.jobs; delete from tessera.requests; delete from tessera.leases; delete from tessera.progress; \
             delete from tessera.pins; delete from tessera.uploads; delete from tessera.blobs",
        );
    }
}

fn options(url: String) -> PostgresOptions {
    // Each use counts: the suites look at the order of uses.
    PostgresOptions { same_use: Duration::ZERO, acquire: Duration::from_secs(6), ..PostgresOptions::new(url, "one") }
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
fn the_server_is_who_its_authority_says() {
    let database = server::database();
    let [authority, other] = ["ours", "other"].map(Authority::new);
    let shown = authority.vouch(&["127.0.0.1"], Age::Good);
    database.cluster.offer_tls(&shown.cert, &shown.key);
    let folder = tempfile::tempdir().unwrap();
    let open = |authority: &Authority| {
        let ca = folder.path().join("ca.pem");
        std::fs::write(&ca, authority.pem()).unwrap();
        let url = database.url_by_port("tessera");
        let url = format!("{url}?sslmode=verify-full&sslrootcert={}", ca.display());
        let password_file = Some(folder.path().join("password"));
        wait(PostgresStore::open(PostgresOptions { password_file, ..options(url) }))
    };
    std::fs::write(folder.path().join("password"), PASSWORD).unwrap();
    let store = open(&authority).unwrap();
    assert!(wait(store.list(Query::default())).unwrap().jobs.is_empty());
    let refused = open(&other).unwrap_err();
    assert!(matches!(refused, StoreError::Unusable { .. }), "{refused}");
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

/// Runs this for four clients at once, each with a pool of its own.
fn clients<T: Send>(database: &Database, run: impl Fn(usize, &PostgresStore) -> T + Sync) -> Vec<T> {
    let barrier = Barrier::new(CLIENTS);
    let client = |number| {
        let store = knowing(open(database), &[(input(), 1)]);
        barrier.wait();
        run(number, &store)
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..CLIENTS).map(|number| scope.spawn(move || client(number))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

fn new(random: u128, request: &str) -> NewJob {
    NewJob { random, spec: spec(request, 1), needs: Bytes::default(), cost: Cost::default() }
}

fn stage() -> Progress {
    Progress::Stage { name: "s".to_owned(), done: 0, total: 0 }
}

#[needs(postgres)]
#[test]
fn one_request_at_once_makes_one_job_and_one_job_is_claimed_once() {
    const JOBS: usize = 50;
    let database = server::database();
    let created = clients(&database, |client, store| {
        let create = |number: usize| {
            let random = (client * JOBS + number) as u128;
            let created = wait(store.create(new(random, &format!("r{number}")))).unwrap();
            (created.job.id, created.existed)
        };
        (0..JOBS).map(create).collect::<Vec<_>>()
    });
    for number in 0..JOBS {
        let of_one: BTreeSet<JobId> = created.iter().map(|client| client[number].0).collect();
        let made = created.iter().filter(|client| !client[number].1).count();
        assert_eq!((of_one.len(), made), (1, 1), "request {number}");
    }
    let claimed = clients(&database, |_, store| {
        let next = || wait(store.claim_next(Offer::new("x", LEASE, PLENTY))).unwrap().map(|job| job.id);
        std::iter::from_fn(next).collect::<Vec<_>>()
    });
    let all: Vec<JobId> = claimed.concat();
    assert_eq!((all.len(), all.iter().collect::<BTreeSet<_>>().len()), (JOBS, JOBS));
}

#[needs(postgres)]
#[test]
fn versions_and_events_stay_in_order_with_several_clients() {
    let database = server::database();
    let store = knowing(open(&database), &[(input(), 1)]);
    let ids: Vec<JobId> = (0..6).map(|k| wait(store.create(new(k, ""))).unwrap().job.id).collect();
    // What each client was told: the versions that its changes made, and the numbers of its progress.
    let told = clients(&database, |client, store| {
        let (mut versions, mut numbers, mut state) = (Vec::new(), Vec::new(), client as u64 + 1);
        for _ in 0..120 {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            let (id, what) = (ids[(state >> 33) as usize % ids.len()], (state >> 40) % 8);
            let job = wait(store.get(id)).unwrap();
            let at = job.status.version;
            let changed = match what {
                0..=2 => wait(store.claim_next(Offer::of("x", LEASE, id))).unwrap().map(Ok),
                3 | 4 => Some(wait(store.change(id, at, Change::Release))),
                5 => {
                    wait(store.renew(id, at, LEASE)).ok();
                    None
                }
                _ => {
                    numbers.extend(wait(store.progress(id, at, stage())).ok().map(|number| (id, number)));
                    None
                }
            };
            match changed {
                Some(Ok(job)) => versions.push((id, job.status.version)),
                Some(Err(StoreError::Stale { .. } | StoreError::Transition { .. })) | None => {}
                Some(Err(error)) => panic!("{error}"),
            }
        }
        (versions, numbers)
    });
    let mut versions: Vec<_> = told.iter().flat_map(|told| told.0.clone()).collect();
    let mut numbers: Vec<_> = told.iter().flat_map(|told| told.1.clone()).collect();
    let count = (versions.len(), numbers.len());
    versions.sort();
    versions.dedup();
    numbers.sort();
    numbers.dedup();
    assert_eq!((versions.len(), numbers.len()), count, "none is given twice");
    assert!(count.0 > 50 && count.1 > 20, "{count:?}");
    let last: BTreeMap<JobId, u64> = versions.into_iter().collect();
    for id in ids {
        let events = wait(store.events(id, 0, usize::MAX)).unwrap().events;
        assert!(events.is_sorted_by(|a, b| a.number < b.number), "{events:?}");
        let states: Vec<State> = events
            .iter()
            .filter_map(|event| match event.what {
                What::State { state, .. } => Some(state),
                What::Progress(_) => None,
            })
            .collect();
        // One event a version, and no version was skipped.
        let version = wait(store.get(id)).unwrap().status.version;
        assert_eq!((states.len() as u64, version), (version, last.get(&id).copied().unwrap_or(1)));
        let alternates =
            |pair: &[State]| matches!(pair, [State::Queued, State::Running] | [State::Running, State::Queued]);
        assert!(states.windows(2).all(alternates), "{states:?}");
    }
}

#[needs(postgres)]
#[test]
fn a_wait_hears_of_changes_and_progress_by_another_process() {
    let database = server::database();
    let (one, other) = (knowing(open(&database), &[(input(), 1)]), open(&database));
    let job = wait(one.create(new(1, ""))).unwrap().job;
    wait(async {
        // A change wakes it, long before it polls.
        let wake = async {
            tokio::time::sleep(Duration::from_millis(200)).await;
            let claimed = other.claim_next(Offer::of("x", LEASE, job.id)).await.unwrap().unwrap();
            (claimed.status.version, Instant::now())
        };
        let (waited, (at, _)) = tokio::join!(one.wait(job.id, 1), wake);
        waited.unwrap();
        let wake = async {
            tokio::time::sleep(Duration::from_millis(50)).await;
            other.progress(job.id, at, stage()).await.unwrap()
        };
        let (waited, number) = tokio::join!(one.wait(job.id, 2), wake);
        waited.unwrap();
        assert_eq!(one.events(job.id, 2, 9).await.unwrap().events[0].number, number);
        let gone = async {
            other.change(job.id, at, Change::Cancel).await.unwrap();
            other.delete(job.id).await.unwrap();
        };
        let (waited, ()) = tokio::join!(one.wait(job.id, 99), gone);
        assert_eq!(waited, Err(StoreError::NotFound { id: job.id }));
    });
}

#[needs(postgres)]
#[test]
fn a_start_takes_back_the_jobs_of_its_own_name_alone() {
    let database = server::database();
    let store = knowing(open(&database), &[(input(), 1)]);
    let claim = |random, holder: &str, lease| {
        let id = wait(store.create(new(random, ""))).unwrap().job.id;
        wait(store.claim_next(Offer::of(holder, lease, id))).unwrap().unwrap().id
    };
    let (own, _others, over) = (claim(1, "one", LEASE), claim(2, "two", LEASE), claim(3, "three", Duration::ZERO));
    assert_eq!(wait(store.recover(Orphans::LeaseOver, MAX_CRASHES)).unwrap().requeued, [over]);
    assert_eq!(wait(store.recover(Orphans::All, MAX_CRASHES)).unwrap().requeued, [own]);
}

#[needs(postgres)]
#[test]
fn after_an_outage_holders_have_one_lease_to_come_back() {
    let database = server::database();
    drop(open(&database));
    let clock = Clock::new(&database);
    let silence = Duration::from_secs(10);
    let options = PostgresOptions { silence, ..options(database.url()) };
    clock.set(Time(1_000_000));
    let store = knowing(wait(PostgresStore::open(options)).unwrap(), &[(input(), 1)]);
    let recovered = |second: u64| {
        clock.set(Time(1_000_000 + 1000 * second));
        wait(store.recover(Orphans::LeaseOver, MAX_CRASHES)).unwrap().requeued
    };
    let lease = Duration::from_secs(30);
    let claim = |random| {
        let id = wait(store.create(new(random, ""))).unwrap().job.id;
        wait(store.claim_next(Offer::of("x", lease, id))).unwrap().unwrap()
    };
    assert!(recovered(0).is_empty());
    let (back, gone) = (claim(1), claim(2));
    assert!(recovered(8).is_empty());
    // The database was away, until long after the leases.
    assert!(recovered(100).is_empty());
    wait(store.renew(back.id, back.status.version, lease)).unwrap();
    assert!((101..130).step_by(5).all(|second| recovered(second).is_empty()));
    // Both have had one lease, from the end of the outage and from the renewal.
    assert_eq!(recovered(129), []);
    assert_eq!(recovered(130), [back.id, gone.id]);
}

/// A connection that hears what the stores of a database say.
async fn ear(database: &Database) -> sqlx::postgres::PgListener {
    let mut ear = sqlx::postgres::PgListener::connect(&database.url()).await.unwrap();
    ear.listen("tessera").await.unwrap();
    ear
}

#[needs(postgres)]
#[test]
fn changes_are_said_together_and_progress_never() {
    let database = server::database();
    let store = knowing(open(&database), &[(input(), 1)]);
    let jobs: Vec<Job> = (0..5)
        .map(|random| {
            let id = wait(store.create(new(random, ""))).unwrap().job.id;
            wait(store.claim_next(Offer::of("x", Duration::ZERO, id))).unwrap().unwrap()
        })
        .collect();
    wait(async {
        // What was said of the claims.
        tokio::time::sleep(Duration::from_millis(200)).await;
        let mut ear = ear(&database).await;
        for job in &jobs {
            store.progress(job.id, job.status.version, stage()).await.unwrap();
            store.renew(job.id, job.status.version, Duration::ZERO).await.unwrap();
        }
        let refused = store.change(jobs[0].id, 99, Change::Cancel).await;
        assert!(matches!(refused, Err(StoreError::Stale { .. })), "{refused:?}");
        assert_eq!(store.recover(Orphans::LeaseOver, MAX_CRASHES).await.unwrap().requeued.len(), 5);
        let heard = ear.recv().await.unwrap();
        // They wait again, which is said too.
        let names = heard.payload().strip_prefix('+').unwrap();
        let names: Vec<JobId> = names.split(',').map(|name| name.parse().unwrap()).collect();
        assert_eq!(names, jobs.iter().map(|job| job.id).collect::<Vec<_>>());
        let more = tokio::time::timeout(Duration::from_millis(300), ear.recv()).await;
        assert!(more.is_err(), "{more:?}");
    });
}

#[needs(postgres)]
#[test]
fn renewals_do_not_make_the_tables_grow() {
    // A transaction that is open elsewhere in the cluster keeps old rows.
    let database = server::database_apart();
    let store = knowing(open(&database), &[(input(), 1)]);
    let id = wait(store.create(new(1, ""))).unwrap().job.id;
    let at = wait(store.claim_next(Offer::of("x", LEASE, id))).unwrap().unwrap().status.version;
    let size = || {
        let all = "select pg_total_relation_size('tessera.jobs') + pg_total_relation_size('tessera.leases')";
        database.sql(all).parse::<u64>().unwrap()
    };
    // 300 rows take four pages. A vacuum that is at work beside keeps old rows meanwhile.
    let mut grown = Vec::new();
    let is_steady = (0..20).any(|_| {
        let before = size();
        (0..300).for_each(|_| wait(store.renew(id, at, LEASE)).unwrap());
        grown.push(size() - before);
        grown.last() == Some(&0)
    });
    assert!(is_steady, "bytes in each round: {grown:?}");
}

#[needs(postgres)]
#[test]
fn texts_of_callers_are_data() {
    let database = server::database();
    let store = knowing(open(&database), &[(input(), 1)]);
    let evil = "'; drop table tessera.jobs; --\u{1F600}\u{ffff}\"\\";
    let mut sent = message(1);
    sent.labels.insert("evil".to_owned(), evil.to_owned());
    let spec = Spec::new(sent, "te'nant\"".to_owned(), "r';--".to_owned()).unwrap();
    let created =
        wait(store.create(NewJob { random: 1, spec: spec.clone(), needs: Bytes::default(), cost: Cost::default() }))
            .unwrap();
    assert_eq!(wait(store.requested(spec)).unwrap(), Some(created.job.clone()));
    let listed = |labels: &[(&str, &str)], tenant: &str| {
        let labels = labels.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect();
        wait(store.list(Query { labels, tenant: Some(tenant.to_owned()), ..Query::default() })).unwrap().jobs.len()
    };
    assert_eq!(listed(&[("evil", evil)], "te'nant\""), 1);
    for (label, tenant) in [("\0", "te'nant\""), (evil, "\0"), ("%", "te'nant\""), (evil, "' or true --")] {
        assert_eq!(listed(&[("evil", label)], tenant), 0);
    }
    // A name with what the database cannot keep, and a message.
    let claimed = wait(store.claim_next(Offer::of("ho\0lder", LEASE, created.job.id))).unwrap().unwrap();
    let failure = Failure { kind: FailureKind::Internal, message: format!("\0{evil}") };
    let failed = wait(store.change(claimed.id, claimed.status.version, Change::Fail(failure))).unwrap();
    assert_eq!(wait(store.get(claimed.id)).unwrap(), failed);
}

#[needs(postgres)]
#[test]
fn progress_goes_with_its_day_and_states_stay() {
    const DAY: u64 = 86_400_000;
    let database = server::database();
    drop(open(&database));
    let clock = Clock::new(&database);
    let at_day = |day: u64| {
        clock.set(Time(day * DAY + 5));
        knowing(open(&database), &[(input(), 1)])
    };
    let partitions = || database.sql("select count(*) from pg_inherits where inhparent = 'tessera.progress'::regclass");
    let store = at_day(30_000);
    let id = wait(store.create(new(1, ""))).unwrap().job.id;
    let at = wait(store.claim_next(Offer::of("x", LEASE, id))).unwrap().unwrap().status.version;
    for _ in 0..100 {
        wait(store.progress(id, at, stage())).unwrap();
    }
    let count = |store: &PostgresStore| wait(store.events(id, 0, 999)).unwrap().events.len();
    assert_eq!(count(&store), 2 + jobs::record::event::KEPT_PROGRESS);
    let before: usize = partitions().parse().unwrap();
    let store = at_day(30_009);
    assert_eq!(count(&store), 2, "{before}");
    // Today and tomorrow, and the one for all other days.
    assert_eq!(partitions(), "3");
    let number = wait(store.progress(id, at, stage())).unwrap();
    assert_eq!(number, 103);
    // What is kept is in the job from the next change on.
    wait(store.change(id, at, Change::Release)).unwrap();
    let store = at_day(30_020);
    assert_eq!(count(&store), 4);
    wait(store.cancel(id)).unwrap();
    assert_eq!(wait(store.expire(KEEP, 1000)).unwrap(), Swept::default());
}

/// `cargo test --test jobs figures -- --ignored --nocapture`. The server of the tests does not sync: what a disk adds is not seen.
#[needs(postgres)]
#[test]
#[ignore = "figures, not a test"]
fn figures_of_the_database() {
    const JOBS: u64 = 4000;
    const TASKS: u64 = 16;
    let database = server::database();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async {
        let options = PostgresOptions { connections: TASKS as u32, ..options(database.url()) };
        let store = std::sync::Arc::new(PostgresStore::open(options).await.unwrap());
        let blobs = vec![(jobs::blob::BlobInfo { digest: input(), size_bytes: 1 }, 1)];
        store.index().enter(jobs::blob::index::Stored { blobs, ..Default::default() }).await.unwrap();
        let all = async |what: &str, run: fn(std::sync::Arc<PostgresStore>, u64) -> BoxFuture| {
            let start = Instant::now();
            let tasks: Vec<_> = (0..TASKS).map(|task| tokio::spawn(run(std::sync::Arc::clone(&store), task))).collect();
            for task in tasks {
                task.await.unwrap();
            }
            println!("{what}: {:.0} a second", JOBS as f64 / start.elapsed().as_secs_f64());
        };
        all("creates", |store, task| {
            Box::pin(async move {
                for number in (task..JOBS).step_by(TASKS as usize) {
                    store.create(new(number.into(), &format!("r{number}"))).await.unwrap();
                }
            })
        })
        .await;
        all("claims with a renewal, an event and an end", |store, _| {
            Box::pin(async move {
                while let Some(job) = store.claim_next(Offer::new("x", LEASE, PLENTY)).await.unwrap() {
                    let (id, at) = (job.id, job.status.version);
                    store.renew(id, at, LEASE).await.unwrap();
                    store.progress(id, at, stage()).await.unwrap();
                    store.change(id, at, Change::Cancel).await.unwrap();
                }
            })
        })
        .await;
        let start = Instant::now();
        while store.expire(Retention { results: Duration::ZERO, records: Duration::ZERO }, 1000).await.unwrap().more {}
        println!("deletes: {:.0} a second", JOBS as f64 / start.elapsed().as_secs_f64());
    });
    std::thread::sleep(Duration::from_secs(2));
    let sizes = "select relname, n_tup_ins, n_tup_upd, n_tup_hot_upd, n_dead_tup, pg_table_size(relid), seq_scan, idx_scan \
                 from pg_stat_user_tables where n_tup_ins > 0 order by relname";
    println!("{}", database.sql(sizes));
}

type BoxFuture = std::pin::Pin<Box<dyn Future<Output = ()> + Send>>;
