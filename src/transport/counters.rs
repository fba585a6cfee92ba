//! Counts of connections and calls.
//!
//! Purpose: [`Counters`] are metrics that the service names and registers; [`Calls`] counts each call from its arrival to its
//! end. Invariant: every call is counted once, with its last status; labels come from a fixed list, so that a peer cannot make
//! new ones. Must not know: names of metrics, how they are shown.

use std::collections::HashSet;
use std::sync::Mutex;
use std::time::Instant;

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;

use super::lock;

/// Names and values of labels, of fixed lists.
pub type Labels<const N: usize> = [(&'static str, &'static str); N];
pub type Histograms<L> = Family<L, Histogram, fn() -> Histogram>;

/// Metrics of connections. Clones share their counts.
#[derive(Clone, Debug)]
pub struct Counters {
    /// Connections that are open.
    pub connections: Gauge,
    /// Connections that were refused for their number.
    pub refused: Counter,
    /// Calls that are open, by method.
    pub open: Family<Labels<1>, Gauge>,
    /// Seconds of calls, by method and status.
    pub calls: Histograms<Labels<2>>,
}

const METHOD: &str = "rpc_method";

/// The method of calls that are not served, as OpenTelemetry names it.
const OTHER: &str = "_OTHER";

/// The status of a call that was dropped before it had one.
const DROPPED: &str = "CANCELLED";

/// The name of a status of gRPC, by its number.
pub fn status_name(number: usize) -> &'static str {
    const BY_NUMBER: &str = "OK CANCELLED UNKNOWN INVALID_ARGUMENT DEADLINE_EXCEEDED NOT_FOUND ALREADY_EXISTS \
        PERMISSION_DENIED RESOURCE_EXHAUSTED FAILED_PRECONDITION ABORTED OUT_OF_RANGE UNIMPLEMENTED INTERNAL UNAVAILABLE \
        DATA_LOSS UNAUTHENTICATED";
    BY_NUMBER.split(' ').nth(number).unwrap_or("UNKNOWN")
}

/// Calls of fixed methods, by their names, and of all others as one.
pub struct Calls {
    counters: Counters,
    methods: HashSet<&'static str>,
}

impl Calls {
    /// Methods are named as "package.Service/Method".
    pub fn new(counters: Counters, methods: impl IntoIterator<Item = String>) -> Self {
        // Once in a server's life, so that labels need no copies.
        Self { counters, methods: methods.into_iter().map(|name| &*name.leak()).collect() }
    }

    /// A call of `method` has come.
    pub fn begin(&self, method: &str) -> Call {
        let method = self.methods.get(method).copied().unwrap_or(OTHER);
        self.counters.open.get_or_create(&[(METHOD, method)]).inc();
        Call { counters: self.counters.clone(), method, began: Instant::now(), status: Mutex::new(None) }
    }
}

/// A call under way; over when this is dropped.
pub struct Call {
    counters: Counters,
    method: &'static str,
    began: Instant,
    status: Mutex<Option<&'static str>>,
}

impl Call {
    /// Its method, of the fixed list.
    pub(crate) fn method(&self) -> &'static str {
        self.method
    }

    /// Sets its status, unless it has one.
    pub fn end(&self, status: &'static str) {
        lock(&self.status).get_or_insert(status);
    }

    /// Its status, if it is over now.
    pub(crate) fn status(&self) -> &'static str {
        lock(&self.status).unwrap_or(DROPPED)
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        self.counters.open.get_or_create(&[(METHOD, self.method)]).dec();
        let labels = [(METHOD, self.method), ("rpc_response_status_code", self.status())];
        self.counters.calls.get_or_create(&labels).observe(self.began.elapsed().as_secs_f64());
    }
}

/// An open connection; closed when this is dropped.
pub(crate) struct Open(Gauge);

impl Counters {
    pub(crate) fn connection(&self) -> Open {
        self.connections.inc();
        Open(self.connections.clone())
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.0.dec();
    }
}
