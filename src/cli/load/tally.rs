//! Calls as this side counts them, by method and status.
//!
//! Invariant: every call that is begun is counted once: with the status that the server sent, or as unheard if none came,
//! since it was given up or its connection was lost. Must not know: what is asked.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tonic::{Code, Status};

use crate::remote::is_lost;
use jobs::lock;

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Calls {
    /// Calls whose status came, by its name.
    pub(super) heard: BTreeMap<&'static str, u64>,
    pub(super) unheard: u64,
    /// Time of the calls whose status came.
    pub(super) time: Duration,
}

impl Calls {
    pub(super) fn mean_s(&self) -> Option<f64> {
        let heard: u64 = self.heard.values().sum();
        (heard > 0).then(|| self.time.as_secs_f64() / heard as f64)
    }
}

/// Calls by method, as "tessera.v1.JobService/CreateJob".
pub(super) type Methods = BTreeMap<&'static str, Calls>;

/// See the module's head. Clones share one state.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally(Arc<Mutex<Methods>>);

impl Tally {
    pub(super) fn begin(&self, method: &'static str) -> Call {
        Call { tally: self.clone(), method, began: Instant::now(), heard: None }
    }

    pub(super) fn methods(&self) -> Methods {
        lock(&self.0).clone()
    }
}

/// A call under way; over when this is dropped.
#[derive(Debug)]
pub(super) struct Call {
    tally: Tally,
    method: &'static str,
    began: Instant,
    heard: Option<&'static str>,
}

impl Call {
    pub(super) fn over<T>(mut self, answer: &Result<T, Status>) {
        self.heard = match answer {
            Ok(_) => Some(name(Code::Ok)),
            Err(status) => (!is_lost(status)).then(|| name(status.code())),
        };
    }
}

impl Drop for Call {
    fn drop(&mut self) {
        let time = self.began.elapsed();
        let mut all = lock(&self.tally.0);
        let calls = all.entry(self.method).or_default();
        match self.heard {
            Some(status) => {
                *calls.heard.entry(status).or_default() += 1;
                calls.time += time;
            }
            None => calls.unheard += 1,
        }
    }
}

/// A status as gRPC writes it.
pub(super) fn name(code: Code) -> &'static str {
    match code {
        Code::Ok => "OK",
        Code::Cancelled => "CANCELLED",
        Code::Unknown => "UNKNOWN",
        Code::InvalidArgument => "INVALID_ARGUMENT",
        Code::DeadlineExceeded => "DEADLINE_EXCEEDED",
        Code::NotFound => "NOT_FOUND",
        Code::AlreadyExists => "ALREADY_EXISTS",
        Code::PermissionDenied => "PERMISSION_DENIED",
        Code::ResourceExhausted => "RESOURCE_EXHAUSTED",
        Code::FailedPrecondition => "FAILED_PRECONDITION",
        Code::Aborted => "ABORTED",
        Code::OutOfRange => "OUT_OF_RANGE",
        Code::Unimplemented => "UNIMPLEMENTED",
        Code::Internal => "INTERNAL",
        Code::Unavailable => "UNAVAILABLE",
        Code::DataLoss => "DATA_LOSS",
        Code::Unauthenticated => "UNAUTHENTICATED",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_call_is_counted_once() {
        let tally = Tally::default();
        tally.begin("a").over(&Ok(()));
        tally.begin("a").over::<()>(&Err(Status::resource_exhausted("full")));
        tally.begin("a").over::<()>(&Err(Status::from_error(Box::new(std::io::Error::other("broken wire")))));
        drop(tally.begin("a"));
        let all = tally.methods();
        assert_eq!(all["a"].heard, BTreeMap::from([("OK", 1), ("RESOURCE_EXHAUSTED", 1)]));
        assert_eq!(all["a"].unheard, 2);
    }
}
