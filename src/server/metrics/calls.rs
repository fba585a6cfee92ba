//! Calls from their arrival to their end.
//!
//! Invariant: every call is counted once, with its last status; a call that was dropped without one was cancelled. A method
//! that is not served is `_OTHER`, as OpenTelemetry calls it. Must not know: how calls are answered.

use std::collections::HashSet;
use std::sync::Mutex;
use std::time::Instant;

use super::Metrics;
use jobs::lock;

const METHOD: &str = "rpc_method";

/// The status of a call that was dropped before it had one.
const DROPPED: &str = "CANCELLED";

/// The name of a status of gRPC, by its number.
pub fn status_name(number: usize) -> &'static str {
    const CODES: [&str; 17] = [
        "OK",
        "CANCELLED",
        "UNKNOWN",
        "INVALID_ARGUMENT",
        "DEADLINE_EXCEEDED",
        "NOT_FOUND",
        "ALREADY_EXISTS",
        "PERMISSION_DENIED",
        "RESOURCE_EXHAUSTED",
        "FAILED_PRECONDITION",
        "ABORTED",
        "OUT_OF_RANGE",
        "UNIMPLEMENTED",
        "INTERNAL",
        "UNAVAILABLE",
        "DATA_LOSS",
        "UNAUTHENTICATED",
    ];
    CODES.get(number).copied().unwrap_or("UNKNOWN")
}

pub struct Calls {
    metrics: Metrics,
    methods: HashSet<&'static str>,
}

impl Calls {
    pub(super) fn new(metrics: Metrics, methods: impl IntoIterator<Item = String>) -> Self {
        // Once in a server's life, so that labels need no copies.
        Self { metrics, methods: methods.into_iter().map(|name| &*name.leak()).collect() }
    }

    /// A call of `method`, as "package.Service/Method", has come.
    pub fn begin(&self, method: &str) -> Call {
        let method = self.methods.get(method).copied().unwrap_or("_OTHER");
        self.metrics.0.open_streams.get_or_create(&[(METHOD, method)]).inc();
        Call { metrics: self.metrics.clone(), method, began: Instant::now(), status: Mutex::new(None) }
    }
}

/// A call under way; over when this is dropped.
pub struct Call {
    metrics: Metrics,
    method: &'static str,
    began: Instant,
    status: Mutex<Option<&'static str>>,
}

impl Call {
    /// Its method, of the fixed list.
    pub fn method(&self) -> &'static str {
        self.method
    }

    /// Sets its status, unless it has one.
    pub fn end(&self, status: &'static str) {
        lock(&self.status).get_or_insert(status);
    }

    /// Its status, if it is over now.
    pub fn status(&self) -> &'static str {
        lock(&self.status).unwrap_or(DROPPED)
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let inner = &self.metrics.0;
        inner.open_streams.get_or_create(&[(METHOD, self.method)]).dec();
        let labels = [(METHOD, self.method), ("rpc_response_status_code", self.status())];
        inner.calls.get_or_create(&labels).observe(self.began.elapsed().as_secs_f64());
    }
}
