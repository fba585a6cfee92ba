//! Metrics for Prometheus.
//!
//! Purpose: [`Metrics`] is counted up by the service and, as an [`Observer`], by the engine; [`Metrics::text`] is what a
//! scrape sees. `docs/observability.md` has the list, and a test compares the two.
//! Invariant: names and labels come from fixed lists, so that strangers cannot make new ones. Counting takes well under a
//! microsecond and never waits for a scrape. There is no global registry: code that counts is given the value.
//! Must not know: messages, connections, how anything that is counted is done.

mod format;
#[cfg(test)]
mod tests;

use std::fmt;
use std::hash::Hash;
use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

pub use format::Format;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry, Unit};
use strum::IntoStaticStr;

use crate::readiness::{Condition, Reason};
use geometry::rvd::BackendKind;
use jobs::admission::estimate::Kind;
use jobs::observe::activity::{JobOutcome, Observer, Origin, Phase};
use jobs::store::shared::Overview;
use transport::{Counters, Histograms, Labels};

/// Upper bounds for calls, seconds: those that OpenTelemetry advises, and more for work that takes minutes.
const CALL_SECONDS: [f64; 18] =
    [0.005, 0.01, 0.025, 0.05, 0.075, 0.1, 0.25, 0.5, 0.75, 1.0, 2.5, 5.0, 7.5, 10.0, 30.0, 60.0, 300.0, 1800.0];

/// Upper bounds for what jobs wait and stages take, seconds.
const WORK_SECONDS: [f64; 13] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0];

/// See the module's head. Clones share one state.
#[derive(Clone)]
pub struct Metrics(Arc<Inner>);

struct Inner {
    registry: Registry,
    calls: Histograms<Labels<2>>,
    requests: Histograms<(Labels<2>, [(&'static str, u32); 1])>,
    open_streams: Family<Labels<1>, Gauge>,
    open_connections: Gauge,
    jobs: Family<Labels<2>, Gauge>,
    jobs_ended: Family<Labels<2>, Counter>,
    jobs_reused: Family<Labels<1>, Counter>,
    queue: Histograms<Labels<1>>,
    stages: Histograms<Labels<2>>,
    passes: Family<Labels<1>, Counter>,
    iterations: Counter,
    facets: Counter,
    seeds: Counter,
    device_bytes: Family<Labels<1>, Gauge>,
    device_busy: Counter<f64, AtomicU64>,
    device_losses: Counter,
    refusals: Family<Labels<1>, Counter>,
    blob_bytes: Family<Labels<1>, Gauge>,
    blob_cache: Family<Labels<1>, Counter>,
    memory: Family<Labels<1>, Gauge>,
    memory_used: OnceLock<Arc<AtomicI64>>,
    not_ready: Family<Labels<1>, Gauge>,
    degraded: Family<Labels<1>, Gauge>,
    probes: Family<Labels<1>, Counter>,
    steps: Family<Labels<1>, Gauge<f64, AtomicU64>>,
    node: Family<[(&'static str, String); 2], Gauge>,
    cluster_nodes: Family<Labels<1>, Gauge>,
    cluster_jobs: Family<Labels<1>, Gauge>,
    // Without labels; as families they are told only in a cluster.
    cluster_oldest: Family<Labels<0>, Gauge<f64, AtomicU64>>,
    cluster_capacity: Family<Labels<0>, Gauge>,
    process: Process,
}

impl fmt::Debug for Metrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Metrics").finish_non_exhaustive()
    }
}

impl Default for Metrics {
    fn default() -> Self {
        Self::new(env!("CARGO_PKG_VERSION"), None)
    }
}

fn call_seconds<L: Clone + Hash + Eq>() -> Histograms<L> {
    Family::new_with_constructor(|| Histogram::new(CALL_SECONDS))
}

fn work_seconds<L: Clone + Hash + Eq>() -> Histograms<L> {
    Family::new_with_constructor(|| Histogram::new(WORK_SECONDS))
}

/// Registers a metric and gives it back.
fn add<M: Metric + Clone>(to: &mut Registry, name: &str, unit: Option<Unit>, help: &str, metric: M) -> M {
    match unit {
        Some(unit) => to.register_with_unit(name, help, unit, metric.clone()),
        None => to.register(name, help, metric.clone()),
    }
    metric
}

/// Registers a metric without a unit.
fn plain<M: Metric + Clone + Default>(to: &mut Registry, name: &str, help: &str) -> M {
    add(to, name, None, help, M::default())
}

impl Metrics {
    pub fn new(version: &str, revision: Option<&str>) -> Self {
        let mut registry = Registry::default();
        let (r, s, b) = (&mut registry, || Some(Unit::Seconds), || Some(Unit::Bytes));
        let process = Process::register(r);
        let build = vec![("version", version.to_owned()), ("revision", revision.unwrap_or("unknown").to_owned())];
        r.register("tessera_build", "The version of this server", Info::new(build));
        let (calls, requests) = (
            "How long calls took, by method and status",
            "How long requests of the HTTP interface took, by route and status",
        );
        let all = Inner {
            calls: add(r, "rpc_server_call_duration", s(), calls, call_seconds()),
            requests: add(r, "http_server_request_duration", s(), requests, call_seconds()),
            open_streams: plain(r, "tessera_open_streams", "Calls that are open"),
            open_connections: plain(r, "tessera_open_connections", "Connections that are open"),
            jobs: plain(r, "tessera_jobs", "Jobs that wait or are at work"),
            jobs_ended: plain(r, "tessera_jobs_ended", "Jobs that left the engine, by how they ended"),
            jobs_reused: plain(
                r,
                "tessera_jobs_reused",
                "Jobs that were answered with an earlier one of the same result",
            ),
            queue: add(r, "tessera_queue", s(), "How long jobs waited for their turn", work_seconds()),
            stages: add(r, "tessera_stage", s(), "How long stages of jobs took", work_seconds()),
            passes: plain(r, "tessera_passes", "Passes of the diagram over a surface"),
            iterations: plain(r, "tessera_iterations", "Steps of seeds that were taken"),
            facets: plain(r, "tessera_facets", "Facets of the surfaces of jobs that are done"),
            seeds: plain(r, "tessera_seeds", "Seeds that were asked for, of jobs that are done"),
            device_bytes: add(r, "tessera_device", b(), "Memory of the device", Family::default()),
            device_busy: add(r, "tessera_device_busy", s(), "How long the device was busy", Counter::default()),
            device_losses: plain(r, "tessera_device_losses", "Times that the device was lost"),
            refusals: plain(r, "tessera_refusals", "Calls and connections that were refused"),
            blob_bytes: add(r, "tessera_blob", b(), "Blobs that are kept, and what may be", Family::default()),
            blob_cache: plain(
                r,
                "tessera_blob_cache",
                "Whole blobs that were read, by whether the local disk had a copy",
            ),
            memory: add(r, "tessera_memory", b(), "Memory for uploads and answers that wait", Family::default()),
            memory_used: OnceLock::new(),
            not_ready: plain(r, "tessera_not_ready", "1 for each reason why the server is not ready"),
            degraded: plain(r, "tessera_degraded", "1 for each reason why the server is slower than it should be"),
            probes: plain(r, "tessera_probes", "Probes of the backend, by how they came out"),
            steps: add(r, "tessera_step", s(), "How long the steps of start and shutdown took", Family::default()),
            node: plain(r, "tessera_node_info", "This server among those that share its store"),
            cluster_nodes: plain(r, "tessera_cluster_nodes", "Servers that share the store and are alive"),
            cluster_jobs: plain(r, "tessera_cluster_jobs", "Jobs of all servers that share the store"),
            cluster_oldest: add(
                r,
                "tessera_cluster_oldest_queued",
                s(),
                "How long the oldest queued job waits",
                Family::default(),
            ),
            cluster_capacity: plain(r, "tessera_cluster_capacity", "Jobs that all servers have at work at once"),
            process,
            registry,
        };
        let metrics = Self(Arc::new(all));
        metrics.begin();
        metrics
    }

    /// Low-cardinality series start at 0, so that `rate()` works.
    fn begin(&self) {
        let inner = &*self.0;
        for kind in [Kind::Remesh, Kind::Rvd, Kind::Cvt].map(Kind::name) {
            for state in [Phase::Waiting, Phase::Running].map(state_name) {
                let _ = inner.jobs.get_or_create(&[("state", state), ("kind", kind)]);
            }
            for outcome in
                [JobOutcome::Succeeded, JobOutcome::Failed, JobOutcome::Cancelled, JobOutcome::Released].map(end_name)
            {
                let _ = inner.jobs_ended.get_or_create(&[("outcome", outcome), ("kind", kind)]);
            }
            let _ = inner.queue.get_or_create(&[("kind", kind)]);
            let _ = inner.jobs_reused.get_or_create(&[("kind", kind)]);
        }
        for kind in ["planned", "used"] {
            let _ = inner.device_bytes.get_or_create(&[("kind", kind)]);
        }
        self.condition(Condition::default());
        self.blobs(0, 0);
        self.blob_cache(0, 0);
        self.probed(true, 0);
        self.probed(false, 0);
        for reason in [Refused::Queue, Refused::Memory, Refused::Streams, Refused::Draining, Refused::Connections] {
            self.refusals(reason, 0);
        }
    }

    /// The counts of connections and calls.
    pub(crate) fn connections(&self) -> Counters {
        let inner = &*self.0;
        Counters {
            connections: inner.open_connections.clone(),
            refused: inner.refusals.get_or_create(&[("reason", Refused::Connections.name())]).clone(),
            open: inner.open_streams.clone(),
            calls: inner.calls.clone(),
        }
    }

    /// A request of the HTTP interface is over. Method and route are of a fixed list.
    pub fn request(&self, method: &'static str, route: &'static str, status: u16, took: Duration) {
        let names = [("http_request_method", method), ("http_route", route)];
        let labels = (names, [("http_response_status_code", status.into())]);
        self.0.requests.get_or_create(&labels).observe(took.as_secs_f64());
    }

    pub fn refused(&self, reason: Refused) {
        self.refusals(reason, 1);
    }

    fn refusals(&self, reason: Refused, times: u64) {
        self.0.refusals.get_or_create(&[("reason", reason.name())]).inc_by(times);
    }

    /// Bytes of blobs now, uploads under way included, and how many may be kept.
    pub fn blobs(&self, kept: u64, limit: u64) {
        for (kind, bytes) in [("kept", kept), ("limit", limit)] {
            self.0.blob_bytes.get_or_create(&[("kind", kind)]).set(signed(bytes));
        }
    }

    /// Whole blobs that were read since the start: with a copy on the local disk, and without.
    pub fn blob_cache(&self, hits: u64, misses: u64) {
        for (result, reads) in [("hit", hits), ("miss", misses)] {
            self.0.blob_cache.get_or_create(&[("result", result)]).inner().store(reads, Ordering::Relaxed);
        }
    }

    /// Memory that streams share: where what is used can be read, and what there is.
    pub fn memory(&self, used: Arc<AtomicI64>, limit: u64) {
        let _ = self.0.memory_used.set(used);
        self.0.memory.get_or_create(&[("kind", "limit")]).set(signed(limit));
    }

    /// What is allocated on the device now, if it is known.
    pub fn device_used(&self, bytes: Option<u64>) {
        self.0.device_bytes.get_or_create(&[("kind", "used")]).set(signed(bytes.unwrap_or(0)));
    }

    /// This server's name among those that share its store, and its role.
    pub fn node(&self, node: &str, role: &str) {
        let labels = [("node", node.to_owned()), ("role", role.to_owned())];
        self.0.node.get_or_create(&labels).set(1);
    }

    /// Nothing is known of the other servers now.
    pub fn no_cluster(&self) {
        self.0.cluster_nodes.clear();
        self.0.cluster_jobs.clear();
        self.0.cluster_oldest.clear();
        self.0.cluster_capacity.clear();
    }

    /// All servers that share the store, and all work.
    pub fn cluster(&self, overview: &Overview) {
        let whole = |count: u64| i64::try_from(count).unwrap_or(i64::MAX);
        let alive = overview.members.iter().filter(|member| member.is_alive);
        let (drained, working): (Vec<_>, Vec<_>) = alive.partition(|member| member.drains);
        for (state, members) in [("alive", working), ("draining", drained)] {
            self.0.cluster_nodes.get_or_create(&[("state", state)]).set(members.len() as i64);
        }
        for (state, jobs) in [("queued", overview.queued()), ("running", overview.running())] {
            self.0.cluster_jobs.get_or_create(&[("state", state)]).set(whole(jobs));
        }
        let none: Labels<0> = [];
        self.0.cluster_oldest.get_or_create(&none).set(overview.oldest_ms() as f64 / 1000.0);
        self.0.cluster_capacity.get_or_create(&none).set(whole(overview.capacity().1));
    }

    /// Why the server is not ready, or not as good as it should be.
    pub fn condition(&self, condition: Condition) {
        for &reason in Reason::ALL {
            let label = [("reason", reason.name())];
            let gauges = if reason.only_degrades() { &self.0.degraded } else { &self.0.not_ready };
            gauges.get_or_create(&label).set(i64::from(condition.has(reason)));
        }
    }

    /// Time that a step of the start or of the shutdown took.
    pub fn step(&self, step: &'static str, took: Duration) {
        self.0.steps.get_or_create(&[("step", step)]).set(took.as_secs_f64());
    }

    pub fn probed(&self, is_good: bool, times: u64) {
        let outcome = if is_good { "passed" } else { "failed" };
        self.0.probes.get_or_create(&[("outcome", outcome)]).inc_by(times);
    }

    /// Everything, as Prometheus reads it.
    pub fn text(&self, format: Format) -> String {
        let inner = &*self.0;
        if let Some(used) = inner.memory_used.get() {
            inner.memory.get_or_create(&[("kind", "used")]).set(used.load(Ordering::Acquire));
        }
        inner.process.look();
        format.write(&inner.registry)
    }
}

/// Why a call or a connection is refused, where a retry or an operator may help.
#[derive(Clone, Copy, Debug, PartialEq, Eq, IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Refused {
    Queue,
    /// There is no memory for it now, on the host or on the device.
    Memory,
    /// Too many streams, sessions or watches are open.
    Streams,
    Draining,
    Connections,
    MessageSize,
    /// It could never be done here.
    TooLarge,
    /// There is no room for a blob, or there are too many uploads.
    Storage,
}

impl Refused {
    pub fn name(self) -> &'static str {
        self.into()
    }
}

fn state_name(phase: Phase) -> &'static str {
    match phase {
        Phase::Waiting => "waiting",
        Phase::Running => "running",
    }
}

fn end_name(outcome: JobOutcome) -> &'static str {
    match outcome {
        JobOutcome::Succeeded => "done",
        JobOutcome::Failed => "failed",
        JobOutcome::Cancelled => "cancelled",
        JobOutcome::Released => "put_back",
    }
}

fn signed(bytes: u64) -> i64 {
    i64::try_from(bytes).unwrap_or(i64::MAX)
}

impl Observer for Metrics {
    fn moved(&self, kind: Kind, from: Option<Phase>, to: Option<Phase>) {
        let labels = |phase| [("state", state_name(phase)), ("kind", kind.name())];
        for (phase, change) in [(from, -1), (to, 1)] {
            if let Some(phase) = phase {
                self.0.jobs.get_or_create(&labels(phase)).inc_by(change);
            }
        }
    }

    fn began(&self, kind: Kind, waited: Duration) {
        self.0.queue.get_or_create(&[("kind", kind.name())]).observe(waited.as_secs_f64());
    }

    fn ended(&self, origin: &Origin, outcome: JobOutcome) {
        let labels = [("outcome", end_name(outcome)), ("kind", origin.kind.name())];
        self.0.jobs_ended.get_or_create(&labels).inc();
        if outcome == JobOutcome::Succeeded {
            self.0.facets.inc_by(origin.facets);
            self.0.seeds.inc_by(origin.seeds);
        }
    }

    fn reused(&self, kind: Kind) {
        self.0.jobs_reused.get_or_create(&[("kind", kind.name())]).inc();
    }

    fn stage(&self, stage: &'static str, backend: BackendKind, took: Duration) {
        let labels = [("stage", stage), ("backend", backend.name())];
        self.0.stages.get_or_create(&labels).observe(took.as_secs_f64());
    }

    fn iterated(&self, steps: u64) {
        self.0.iterations.inc_by(steps);
    }

    fn passed(&self, backend: BackendKind, took: Duration) {
        self.0.passes.get_or_create(&[("backend", backend.name())]).inc();
        if backend == BackendKind::Gpu {
            self.0.device_busy.inc_by(took.as_secs_f64());
        }
    }

    fn planned(&self, bytes: i64) {
        self.0.device_bytes.get_or_create(&[("kind", "planned")]).inc_by(bytes);
    }

    fn lost_device(&self) {
        self.0.device_losses.inc();
    }
}

/// The usual `process_` metrics of Prometheus, read anew for each answer. A figure that the system does not give is 0.
struct Process {
    resident: Gauge,
    descriptors: Gauge,
    most_descriptors: Gauge,
    threads: Gauge,
    start: Gauge<f64, AtomicU64>,
    cpu: Counter<f64, AtomicU64>,
}

impl Process {
    fn register(r: &mut Registry) -> Self {
        let (seconds, start) = (|| Some(Unit::Seconds), "When the process began, since 1970");
        Self {
            resident: add(r, "process_resident_memory", Some(Unit::Bytes), "Resident memory", Gauge::default()),
            descriptors: plain(r, "process_open_fds", "Open file descriptors"),
            most_descriptors: plain(r, "process_max_fds", "File descriptors that may be open"),
            threads: plain(r, "process_threads", "Threads"),
            start: add(r, "process_start_time", seconds(), start, Gauge::default()),
            cpu: add(r, "process_cpu", seconds(), "Time of all processors", Counter::default()),
        }
    }

    fn look(&self) {
        #[cfg(target_os = "linux")]
        {
            let now = metrics_process::collector::collect();
            let whole = |number: Option<u64>| number.and_then(|n| i64::try_from(n).ok()).unwrap_or(0);
            self.resident.set(whole(now.resident_memory_bytes));
            self.descriptors.set(whole(now.open_fds));
            self.most_descriptors.set(whole(now.max_fds));
            self.threads.set(whole(now.threads));
            self.start.set(now.start_time_seconds.map_or(0.0, |seconds| seconds as f64));
            let cpu = now.cpu_seconds_total.unwrap_or(0.0);
            self.cpu.inner().store(cpu.to_bits(), std::sync::atomic::Ordering::Relaxed);
        }
    }
}
