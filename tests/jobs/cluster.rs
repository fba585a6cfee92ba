//! Promise: servers that share a database share its work fairly between tenants, whichever of them claims; a large job gets its
//! memory in the end; a job that no server can do says so; operators see all servers, and can drain them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use jobs::ExecutorOptions;
use jobs::blob::{BlobError, UploadId};
use jobs::executor::NodeOptions;
use jobs::executor::api::JobApi;
use jobs::postgres::{Operator, PostgresStore};
use jobs::record::event::Progress;
use jobs::record::state::State;
use jobs::record::{Bytes, JobId, Outcome, Spec};
use jobs::store::shared::{Node, Role, Unschedulable};
use jobs::store::*;
use needs::needs;
use object_store::memory::InMemory;
use tessera::proto::*;

use crate::postgres_server::{self as server, Database};
use crate::{input, knowing, message, shared, wait};

const LEASE: Duration = Duration::from_secs(60);
const WHOLE: Bytes = Bytes { host: 100, device: 0 };

fn open(database: &Database, holder: &str) -> PostgresStore {
    wait(PostgresStore::open(database.options(holder))).unwrap()
}

fn opened(database: &Database, holder: &str) -> PostgresStore {
    knowing(open(database, holder), &[(input(), 1)])
}

fn job(random: u128, tenant: &str, host: u64, (seconds, weight): (f64, f64)) -> NewJob {
    let spec = Spec::new(message(1), tenant.to_owned(), String::new()).unwrap();
    NewJob { random, spec, needs: Bytes { host, device: 0 }, cost: Cost { seconds, weight } }
}

fn offer(holder: &str, room: u64) -> Offer {
    Offer { whole: WHOLE, ..Offer::new(holder, LEASE, Bytes { host: room, device: 0 }) }
}

fn claim(store: &PostgresStore, holder: &str, room: u64) -> Option<jobs::record::Job> {
    wait(store.claim_next(offer(holder, room))).unwrap()
}

fn node(name: &str) -> Node {
    Node { name: name.to_owned(), places: 2, memory: WHOLE, ..Node::default() }
}

/// Tenants whose jobs differ in length and weight have the same virtual time whenever one more job begins.
#[needs(postgres)]
#[test]
fn tenants_share_the_work_whichever_server_claims() {
    let database = server::database();
    let stores = [opened(&database, "a"), open(&database, "b"), open(&database, "c")];
    // Seconds of a job, weight.
    let tenants = [("short", 1.0, 1.0), ("long", 5.0, 1.0), ("twice", 1.0, 2.0)];
    let mut random = 0;
    for (tenant, seconds, weight) in tenants {
        for _ in 0..120 {
            random += 1;
            wait(stores[0].create(job(random, tenant, 1, (seconds, weight)))).unwrap();
        }
    }
    let mut had: BTreeMap<String, f64> = BTreeMap::new();
    let check = |had: &BTreeMap<String, f64>, from: &BTreeMap<String, f64>| {
        let times: Vec<f64> = had.iter().map(|(tenant, time)| time - from.get(tenant).unwrap_or(&0.0)).collect();
        let most = times.iter().fold(0.0f64, |most, time| most.max(*time));
        let least = times.iter().fold(f64::INFINITY, |least, time| least.min(*time));
        // The longest job.
        assert!(most - least <= 5.0, "{had:?}");
    };
    for number in 0..120 {
        let claimed = claim(&stores[number % 3], "x", 100).unwrap();
        let tenant = claimed.spec.tenant.clone();
        let (_, seconds, weight) = tenants.iter().find(|(name, ..)| *name == tenant).unwrap();
        *had.entry(tenant).or_default() += seconds / weight;
        if number % 10 == 9 {
            // Charges that a sweep has summed up count as before.
            wait(stores[number % 3].shared().unwrap().sweeps()).unwrap();
            check(&had, &BTreeMap::new());
        }
    }
    // One that comes late has no debt and no savings.
    for _ in 0..40 {
        random += 1;
        wait(stores[1].create(job(random, "late", 1, (1.0, 1.0)))).unwrap();
    }
    let mut from = had.clone();
    from.insert("late".to_owned(), 0.0);
    had.insert("late".to_owned(), 0.0);
    for number in 0..60 {
        let claimed = claim(&stores[number % 3], "x", 100).unwrap();
        let tenant = claimed.spec.tenant.clone();
        let (seconds, weight) = tenants
            .iter()
            .find(|(name, ..)| *name == tenant)
            .map_or((1.0, 1.0), |(_, seconds, weight)| (*seconds, *weight));
        *had.get_mut(&tenant).unwrap() += seconds / weight;
    }
    check(&had, &from);
}

/// What a job really took is charged at its end.
#[needs(postgres)]
#[test]
fn a_tenant_is_charged_what_its_jobs_took() {
    let database = server::database();
    let store = opened(&database, "a");
    for (random, tenant, seconds) in [(1, "under", 0.001), (2, "over", 1000.0)] {
        wait(store.create(job(random, tenant, 1, (seconds, 1.0)))).unwrap();
    }
    let claimed = [claim(&store, "x", 100).unwrap(), claim(&store, "x", 100).unwrap()];
    std::thread::sleep(Duration::from_millis(300));
    for job in claimed {
        wait(store.change(job.id, job.status.version, jobs::record::Change::Succeed(Default::default()))).unwrap();
    }
    for tenant in ["under", "over"] {
        let had: f64 = database.sql(&format!("select tessera.share(0::smallint, '{tenant}')")).parse().unwrap();
        assert!((0.25..100.0).contains(&had), "{tenant}: {had}");
    }
}

/// Claims at once by many: each job once, also while charges are summed up.
#[needs(postgres)]
#[test]
fn claims_at_once_take_each_job_once() {
    const JOBS: u128 = 200;
    let database = server::database();
    let store = opened(&database, "first");
    for random in 0..JOBS {
        wait(store.create(job(random, ["a", "b", "c", "d"][random as usize % 4], 1, (1.0, 1.0)))).unwrap();
    }
    let database = &database;
    let claimed: Vec<Vec<JobId>> = std::thread::scope(|scope| {
        let client = |number: usize| {
            let holder = format!("client {number}");
            let store = open(database, &holder);
            let next = || {
                wait(store.shared().unwrap().sweeps()).unwrap();
                claim(&store, &holder, 100).map(|job| job.id)
            };
            std::iter::from_fn(next).collect()
        };
        let threads: Vec<_> = (0..6).map(|number| scope.spawn(move || client(number))).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    let all: BTreeSet<JobId> = claimed.concat().into_iter().collect();
    assert_eq!((all.len(), claimed.concat().len()), (JOBS as usize, JOBS as usize));
    std::thread::sleep(Duration::from_secs(1));
    assert!(wait(store.shared().unwrap().sweeps()).unwrap());
    assert_eq!(database.sql("select count(*) from tessera.charges"), "0", "a sweep sums them up");
}

#[needs(postgres)]
#[test]
fn a_large_job_gets_its_memory_in_the_end() {
    let database = server::database();
    let store = opened(&database, "a");
    let large = wait(store.create(job(1, "large", 80, (1.0, 1.0)))).unwrap().job.id;
    for random in 2..9 {
        wait(store.create(job(random, "small", 10, (1.0, 1.0)))).unwrap();
    }
    // Too large for what is free, and for a server with less memory.
    let tenant = |job: Option<jobs::record::Job>| job.map(|job| job.spec.tenant);
    assert_eq!(tenant(claim(&store, "a", 50)).as_deref(), Some("small"));
    let little = Offer { whole: Bytes { host: 50, device: 0 }, ..offer("little", 50) };
    assert_eq!(tenant(wait(store.claim_next(little.clone())).unwrap()).as_deref(), Some("small"));
    // Time passes.
    database.sql("update tessera.jobs set passed = passed - 10000 where passed is not null");
    assert_eq!(tenant(claim(&store, "a", 50)), None, "nothing else begins there");
    assert_eq!(tenant(claim(&store, "a", 70)), None);
    assert_eq!(tenant(claim(&store, "b", 50)).as_deref(), Some("small"), "others go on");
    assert_eq!(tenant(wait(store.claim_next(little)).unwrap()).as_deref(), Some("small"));
    assert_eq!(claim(&store, "a", 80).map(|job| job.id), Some(large));
    assert_eq!(tenant(claim(&store, "a", 20)).as_deref(), Some("small"));
    // A server that went away keeps nothing.
    let large = wait(store.create(job(20, "large", 80, (1.0, 1.0)))).unwrap().job.id;
    database.sql("update tessera.jobs set kept_for = 'gone', kept_until = tessera.now_ms() + 60000 where state = 0 and host_bytes = 80");
    assert_ne!(claim(&store, "b", 100).map(|job| job.id), Some(large));
    database.sql("update tessera.jobs set kept_until = tessera.now_ms() - 1 where state = 0 and host_bytes = 80");
    let next = [claim(&store, "b", 100), claim(&store, "b", 100)];
    assert!(next.iter().flatten().any(|job| job.id == large));
}

#[needs(postgres)]
#[test]
fn a_job_that_no_server_can_do_says_so() {
    let database = server::database();
    let store = opened(&database, "a");
    let other = open(&database, "b");
    let plain = wait(store.create(job(1, "t", 60, (1.0, 1.0)))).unwrap().job.id;
    let needs_gpu = JobSpec { backend: BackendChoice::Gpu.into(), ..message(1) };
    let spec = Spec::new(needs_gpu, "t".to_owned(), String::new()).unwrap();
    let new = NewJob { spec, ..job(2, "t", 60, (1.0, 1.0)) };
    let gpu = wait(store.create(new)).unwrap().job.id;
    let why = |id| wait(store.shared().unwrap().unschedulable(id)).unwrap();
    assert_eq!((why(plain), why(gpu)), (Some(Unschedulable::NoServer), Some(Unschedulable::NoServer)));
    wait(store.shared().unwrap().beat(Node { role: Role::Gateway, ..node("one") })).unwrap();
    assert_eq!(why(plain), Some(Unschedulable::NoServer));
    wait(other.shared().unwrap().beat(Node { memory: Bytes { host: 50, device: 0 }, ..node("two") })).unwrap();
    let needs = Bytes { host: 60, device: 0 };
    assert_eq!((why(plain), why(gpu)), (Some(Unschedulable::TooLarge { needs }), Some(Unschedulable::NoGpu)));
    wait(other.shared().unwrap().beat(Node { memory: WHOLE, ..node("two") })).unwrap();
    assert_eq!((why(plain), why(gpu)), (None, Some(Unschedulable::NoGpu)));
    // It is claimed by no server without a GPU.
    let without = Offer { has_gpu: false, ..offer("x", 100) };
    assert_eq!(wait(store.claim_next(without.clone())).unwrap().map(|job| job.id), Some(plain));
    assert_eq!(wait(store.claim_next(without)).unwrap().map(|job| job.id), None);
    wait(other.shared().unwrap().beat(Node { has_gpu: true, ..node("two") })).unwrap();
    assert_eq!(why(gpu), None);
    assert_eq!(claim(&store, "x", 100).map(|job| job.id), Some(gpu));
    assert_eq!(why(gpu), None, "it does not wait");
}

#[needs(postgres)]
#[test]
fn operators_see_and_drain_servers() {
    let database = server::database();
    let stores = [opened(&database, "a"), open(&database, "b")];
    for (store, name) in stores.iter().zip(["one", "two"]) {
        assert!(!wait(store.shared().unwrap().beat(node(name))).unwrap());
    }
    for random in 0..3 {
        wait(stores[0].create(job(random, "t", 1, (1.0, 1.0)))).unwrap();
    }
    claim(&stores[0], "a", 100).unwrap();
    let operator = wait(Operator::connect(&database.options("operator"))).unwrap();
    let overview = wait(operator.overview()).unwrap();
    assert_eq!((overview.queued(), overview.running(), overview.capacity()), (2, 1, (2, 4)));
    assert_eq!((overview.lines[0].tenant.as_str(), overview.leases[0].holder.as_str()), ("t", "a"));
    assert!(overview.leases[0].left_ms > 0);
    // A server knows its address once its port is open, which may be after it has said that it is alive.
    let address = || {
        wait(operator.overview())
            .unwrap()
            .members
            .iter()
            .find(|member| member.node.name == "one")
            .unwrap()
            .node
            .address
            .clone()
    };
    assert_eq!(address(), "");
    wait(stores[0].shared().unwrap().beat(Node { address: "http://one:1".to_owned(), ..node("one") })).unwrap();
    assert_eq!(address(), "http://one:1");
    assert_eq!(wait(operator.drain("none", true)).unwrap(), 0);
    assert_eq!(wait(operator.drain("two", true)).unwrap(), 1);
    assert!(wait(stores[1].shared().unwrap().beat(node("two"))).unwrap());
    assert_eq!(wait(operator.overview()).unwrap().capacity(), (1, 2));
    assert_eq!(wait(operator.drain("two", false)).unwrap(), 1);
    assert!(!wait(stores[1].shared().unwrap().beat(node("two"))).unwrap());
    wait(stores[1].shared().unwrap().leave()).unwrap();
    database.sql("update tessera.nodes set seen = seen - 20000 where name = 'one'");
    let overview = wait(operator.overview()).unwrap();
    assert_eq!((overview.members.len(), overview.members[0].is_alive, overview.capacity().0), (1, false, 0));
}

/// Of many servers one sweeps at a time.
#[needs(postgres)]
#[test]
fn one_server_sweeps_at_a_time() {
    let database = server::database();
    let store = opened(&database, "a");
    let begin = Instant::now();
    let mut swept = 0;
    while begin.elapsed() < Duration::from_millis(2000) {
        swept += u32::from(wait(store.shared().unwrap().sweeps()).unwrap());
        std::thread::sleep(Duration::from_millis(5));
    }
    let most = (begin.elapsed().as_millis() / 900 + 1) as u32;
    assert!((1..=most).contains(&swept), "{swept}");
}

#[needs(postgres)]
#[test]
fn a_job_that_brings_servers_down_names_them_and_can_be_tried_again() {
    let database = server::database();
    let store = opened(&database, "a");
    let id = wait(store.create(job(1, "t", 1, (1.0, 1.0)))).unwrap().job.id;
    let over = "update tessera.leases set until = 0, length = 0";
    for (holder, other) in [("first", false), ("second", false), ("third", true)] {
        let claimed = claim(&store, holder, 100).unwrap();
        assert_eq!(claimed.id, id);
        let stage = Progress::Stage { name: format!("stage of {holder}"), done: 0, total: 0 };
        wait(store.progress(id, claimed.status.version, stage)).unwrap();
        if other {
            // At work beside it at another server: no reason to doubt.
            let beside = wait(store.create(job(2, "t", 1, (1.0, 1.0)))).unwrap().job.id;
            assert_eq!(claim(&store, "elsewhere", 100).unwrap().id, beside);
        }
        database.sql(over);
        let max_crashes = 3;
        let recovered = wait(store.recover(Orphans::LeaseOver, max_crashes)).unwrap();
        assert_eq!(recovered.failed.contains(&id), holder == "third", "{holder}");
    }
    let dead = wait(store.get(id)).unwrap();
    let Some(Outcome::Failed(failure)) = &dead.status.outcome else { panic!("{:?}", dead.status) };
    for part in ["3 times", "first, second, third", "stage of third"] {
        assert!(failure.message.contains(part), "{}", failure.message);
    }
    let operator = wait(Operator::connect(&database.options("operator"))).unwrap();
    assert_eq!(wait(operator.dead()).unwrap().iter().map(|job| job.id).collect::<Vec<_>>(), [id]);
    let again = wait(operator.requeue(id)).unwrap();
    assert_eq!((again.status.state, again.status.crashes), (State::Queued, 0));
    assert_eq!(again.spec.message(), dead.spec.message());
    assert!(matches!(wait(operator.requeue(again.id)), Err(StoreError::NotFound { .. })));
    assert_eq!(wait(operator.requeue(id)).unwrap().id, again.id, "once");
    assert_eq!(wait(operator.dead()).unwrap(), []);
    let checked = wait(operator.check()).unwrap();
    assert_eq!((checked.faults, checked.jobs["failed"]), (Vec::<String>::new(), 1));
    database.sql("delete from tessera.leases");
    claim(&store, "x", 100).unwrap();
    database.sql("delete from tessera.leases; delete from tessera.pins");
    assert_eq!(wait(operator.check()).unwrap().faults.len(), 2);
}

#[needs(postgres)]
#[test]
fn a_schema_is_brought_up_to_date_without_a_server() {
    let database = server::database();
    let options = database.options("operator");
    let operator = wait(Operator::connect(&options)).unwrap();
    assert_eq!(wait(operator.check()).unwrap().faults.len(), 1);
    let (before, now) = wait(Operator::migrate(&options)).unwrap();
    assert!(before == 0 && now >= 3);
    assert_eq!(wait(Operator::migrate(&options)).unwrap(), (now, now));
    assert_eq!(wait(operator.check()).unwrap().faults, Vec::<String>::new());
    database.sql("update tessera.layout set needs = 1000");
    assert!(matches!(wait(Operator::connect(&options)), Err(StoreError::UnknownVersion { .. })));
}

/// A gateway takes calls and does nothing; a drained server does nothing until it may again.
#[needs(postgres)]
#[test]
fn gateways_and_drained_servers_do_no_work() {
    let (database, bucket) = (server::database(), Arc::new(InMemory::new()));
    let of = |name: &str, role| {
        let node = NodeOptions { name: name.to_owned(), role, version: "1".to_owned() };
        ExecutorOptions { node, ..shared::options() }
    };
    shared::runtime().block_on(async {
        let gateway = shared::Node::shared("g", &database, &bucket, of("gateway", Role::Gateway)).await;
        let worker = shared::Node::shared("w", &database, &bucket, of("worker", Role::All)).await;
        let [of_gateway, of_worker] = [&gateway, &worker].map(|node| node.executor.cluster().unwrap());
        of_worker.advertise("http://worker:1".to_owned());
        assert_eq!(of_worker.streams_elsewhere().await, None);
        let end = Instant::now() + shared::PATIENCE;
        while of_gateway.streams_elsewhere().await != Some(Some("http://worker:1".to_owned())) {
            assert!(Instant::now() < end);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let id = gateway.create((200, 50)).await;
        assert!(gateway.ended(id).await.status.state == State::Succeeded);
        let operator = Operator::connect(&database.options("operator")).await.unwrap();
        assert_eq!(operator.drain("worker", true).await.unwrap(), 1);
        let mut drained = of_worker.drained();
        drained.wait_for(|drained| *drained).await.unwrap();
        let id = gateway.create((200, 50)).await;
        let why = loop {
            if let Some(why) = of_gateway.unschedulable(&gateway.get(id).await).await.unwrap() {
                break why;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        };
        assert!(why.contains("no server"), "{why}");
        tokio::time::sleep(Duration::from_millis(1500)).await;
        assert_eq!(gateway.get(id).await.status.state, State::Queued);
        assert_eq!(of_worker.streams_elsewhere().await, Some(None));
        operator.drain("worker", false).await.unwrap();
        assert!(gateway.ended(id).await.status.state == State::Succeeded);
        worker.executor.drain().await;
        assert_eq!(operator.overview().await.unwrap().members.len(), 1, "it left");
    });
}

/// A server that went down while it stored a blob keeps others from it no longer than it counts as alive.
#[needs(postgres)]
#[test]
fn a_server_that_is_away_shows_no_bytes() {
    let database = server::database();
    let [a, b] = ["a", "b"].map(|holder| open(&database, holder));
    let upload = UploadId { digest: [9; 32].into(), size_bytes: 1, owner: None };
    database.sql(&format!(
        "insert into tessera.uploads (digest, size, owner, touched) values ('\\x{}', 1, '\\x{}', tessera.now_us())",
        "09".repeat(32),
        "00".repeat(16)
    ));
    for (store, name) in [(&a, "a"), (&b, "b")] {
        wait(store.shared().unwrap().beat(node(name))).unwrap();
    }
    wait(a.index().showing(upload)).unwrap();
    assert!(matches!(wait(b.index().showing(upload)), Err(BlobError::Busy { .. })));
    database.sql("update tessera.nodes set seen = seen - 20000 where holder = 'a'");
    wait(b.index().showing(upload)).unwrap();
    assert!(matches!(wait(a.index().showing(upload)), Err(BlobError::Busy { .. })), "now it is b's");
}

/// Leases of a server that went down end one after the other, and each of its jobs counts as having been at work beside the others.
#[needs(postgres)]
#[test]
fn jobs_of_a_server_that_went_down_are_taken_back_together() {
    let database = server::database();
    let (gone, store) = (opened(&database, "gone"), open(&database, "b"));
    let ids = [1, 2].map(|random| wait(store.create(job(random, "t", 1, (1.0, 1.0)))).unwrap().job.id);
    for (server, name) in [(&gone, "gone"), (&store, "b")] {
        wait(server.shared().unwrap().beat(node(name))).unwrap();
        claim(server, name, 100).unwrap();
    }
    let third = wait(store.create(job(3, "t", 1, (1.0, 1.0)))).unwrap().job.id;
    assert_eq!(claim(&gone, "gone", 100).unwrap().id, third);
    // One of its two leases is over, and it is not alive.
    database.sql(&format!("update tessera.leases set until = 0, length = 0 where job = '\\x{}'", ids[0]));
    database.sql("update tessera.nodes set seen = seen - 20000 where holder = 'gone'");
    let recovered = wait(store.recover(Orphans::LeaseOver, 1)).unwrap();
    assert_eq!((recovered.requeued, recovered.failed), (vec![ids[0], third], vec![]));
    assert_eq!(wait(store.get(ids[1])).unwrap().status.state, State::Running, "the other server has it");
}

#[needs(postgres)]
#[test]
fn open_calls_and_documents_are_seen_by_all_servers() {
    let database = server::database();
    let [a, b] = ["a", "b"].map(|holder| open(&database, holder));
    let open_calls = |calls: &[(&str, u32)]| calls.iter().map(|(key, open)| ((*key).to_owned(), *open)).collect();
    for (store, name) in [(&a, "a"), (&b, "b")] {
        wait(store.shared().unwrap().beat(node(name))).unwrap();
    }
    let share = |store: &PostgresStore, calls| wait(store.shared().unwrap().share_calls(open_calls(calls))).unwrap();
    assert_eq!(share(&a, &[("k", 2), ("l", 1)]), BTreeMap::new());
    assert_eq!(share(&b, &[("k", 3)]), open_calls(&[("k", 2), ("l", 1)]));
    assert_eq!(share(&a, &[]), open_calls(&[("k", 3)]));
    database.sql("update tessera.nodes set seen = seen - 20000 where holder = 'b'");
    assert_eq!(share(&a, &[]), BTreeMap::new(), "what is away has no calls");
    // A text is changed from the version that was seen, or not at all.
    let operator = wait(Operator::connect(&database.options("operator"))).unwrap();
    let read = || wait(a.shared().unwrap().document("keys")).unwrap();
    assert_eq!(read(), None);
    assert!(
        wait(operator.replace("keys", None, "one")).unwrap() && !wait(operator.replace("keys", None, "two")).unwrap()
    );
    let seen = read().unwrap();
    assert!(wait(operator.replace("keys", Some(seen.version), "three")).unwrap());
    assert!(!wait(operator.replace("keys", Some(seen.version), "four")).unwrap());
    assert_eq!(read().unwrap().content, "three");
}
