//! Calls, from when they come to when they are over.
//!
//! Invariant: every call is counted once, with the status that it ended with; one that nobody said a status for was
//! cancelled. A method that is not served is `_OTHER`, as OpenTelemetry calls it. Must not know: how calls are answered.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use super::{CallLabels, MethodLabel, Metrics};

/// The status of a call that was dropped before it had one.
const DROPPED: &str = "CANCELLED";

/// See the module's head.
pub struct Calls {
    metrics: Metrics,
    methods: HashMap<String, Arc<String>>,
    other: Arc<String>,
}

impl Calls {
    pub(super) fn new(metrics: Metrics, methods: impl IntoIterator<Item = String>) -> Self {
        let methods = methods.into_iter().map(|name| (name.clone(), Arc::new(name))).collect();
        Self { metrics, methods, other: Arc::new("_OTHER".to_owned()) }
    }

    /// A call of `method`, as "package.Service/Method", has come.
    pub fn begin(&self, method: &str) -> Call {
        let method = Arc::clone(self.methods.get(method).unwrap_or(&self.other));
        self.metrics.0.open_streams.get_or_create(&MethodLabel { rpc_method: Arc::clone(&method) }).inc();
        Call { metrics: self.metrics.clone(), method, began: Instant::now(), status: Mutex::new(None) }
    }
}

/// A call under way; over when this is dropped.
pub struct Call {
    metrics: Metrics,
    method: Arc<String>,
    began: Instant,
    status: Mutex<Option<&'static str>>,
}

impl Call {
    /// Its method, of the fixed list.
    pub fn method(&self) -> &str {
        &self.method
    }

    /// How it ends. What is said first stays.
    pub fn end(&self, status: &'static str) {
        self.status.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(status);
    }

    /// How it ends, if it is over now.
    pub fn status(&self) -> &'static str {
        self.status.lock().unwrap_or_else(PoisonError::into_inner).unwrap_or(DROPPED)
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let rpc_method = Arc::clone(&self.method);
        let inner = &self.metrics.0;
        inner.open_streams.get_or_create(&MethodLabel { rpc_method: Arc::clone(&rpc_method) }).dec();
        let labels = CallLabels { rpc_method, rpc_response_status_code: self.status() };
        inner.calls.get_or_create(&labels).observe(self.began.elapsed().as_secs_f64());
    }
}
