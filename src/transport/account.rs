//! Metrics and trace of a call: its status and its span.
//!
//! Purpose: [`Account`] lives as long as the call, whatever ends it, and takes the status from the answer's headers or
//! trailers. Invariant: a call that was reset has the status that its client would have seen. Must not know: messages.

use std::sync::Arc;

use tonic::codegen::http::{HeaderMap, Request, StatusCode};
use tracing::{Span, field, info_span};

use super::counters::{Call, Calls, status_name};
use super::exchange::{Ending, Exchange};
use telemetry::trace::{self, TraceContext};

const STATUS: &str = "grpc-status";

fn code(headers: &HeaderMap) -> Option<&'static str> {
    let number: usize = headers.get(STATUS)?.to_str().ok()?.parse().ok()?;
    Some(status_name(number))
}

pub(super) struct Account {
    call: Call,
    exchange: Arc<Exchange>,
    /// The span of the call's work.
    pub(super) span: Span,
}

impl Account {
    /// Opens the account of a request. Returns the trace of its work.
    pub(super) fn open<B>(calls: &Calls, request: &Request<B>, exchange: &Arc<Exchange>) -> (Self, TraceContext) {
        let call = calls.begin(request.uri().path().trim_start_matches('/'));
        let method = call.method();
        let span = info_span!(
            parent: None,
            "call",
            otel.name = method,
            otel.kind = "server",
            rpc.system.name = "grpc",
            rpc.method = method,
            rpc.response.status_code = field::Empty,
            trace_id = field::Empty,
        );
        let asked = request.headers().get(trace::TRACEPARENT).and_then(|value| value.to_str().ok());
        let context = trace::join(&span, asked.and_then(TraceContext::parse));
        (Self { call, exchange: Arc::clone(exchange), span }, context)
    }

    pub(super) fn begun(&self, status: StatusCode, headers: &HeaderMap) {
        match code(headers) {
            Some(code) => self.call.end(code),
            // The answer has no gRPC status, so the request was no gRPC call.
            None if status != StatusCode::OK => self.call.end("UNKNOWN"),
            None => {}
        }
    }
}

impl Ending for Account {
    fn end(&self, trailers: &HeaderMap) {
        self.call.end(code(trailers).unwrap_or("UNKNOWN"));
    }
}

impl Drop for Account {
    fn drop(&mut self) {
        if self.exchange.stalled.is_set() {
            self.call.end("ABORTED");
        } else if self.exchange.is_cut.is_set() {
            self.call.end("UNAVAILABLE");
        }
        self.span.record("rpc.response.status_code", self.call.status());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::Budget;
    use crate::counters::{Counters, Labels};
    use prometheus_client::encoding::text::encode;
    use prometheus_client::metrics::family::Family;
    use prometheus_client::metrics::histogram::Histogram;
    use prometheus_client::registry::Registry;

    const METHOD: &str = "a.B/C";

    /// The counters after an event of a call.
    fn counted(what: impl FnOnce(&Account, &Exchange)) -> String {
        let calls: fn() -> Histogram = || Histogram::new([1.0]);
        let calls = Family::<Labels<2>, _, _>::new_with_constructor(calls);
        let open = Family::default();
        let mut registry = Registry::default();
        registry.register("calls", "", calls.clone());
        registry.register("open", "", open.clone());
        let text = || {
            let mut text = String::new();
            encode(&mut text, &registry).unwrap();
            text
        };
        let counters = Counters { connections: Default::default(), refused: Default::default(), open, calls };
        let calls = Calls::new(counters, [METHOD.to_owned()]);
        let exchange = Arc::new(Exchange::new(Budget::new(1), false));
        let request = Request::builder().uri(format!("http://host/{METHOD}")).body(()).unwrap();
        let (account, _) = Account::open(&calls, &request, &exchange);
        assert!(text().contains("open{rpc_method=\"a.B/C\"} 1\n"));
        what(&account, &exchange);
        drop(account);
        let text = text();
        assert!(text.contains("open{rpc_method=\"a.B/C\"} 0\n"));
        let line = text.lines().find(|line| line.starts_with("calls_count")).unwrap();
        line.split('"').nth(3).unwrap().to_owned()
    }

    fn trailers(code: &'static str) -> HeaderMap {
        HeaderMap::from_iter([(STATUS.parse().unwrap(), code.parse().unwrap())])
    }

    #[test]
    fn a_call_has_the_status_of_its_answer() {
        assert_eq!(counted(|call, _| call.end(&trailers("0"))), "OK");
        assert_eq!(counted(|call, _| call.begun(StatusCode::OK, &trailers("12"))), "UNIMPLEMENTED");
        assert_eq!(counted(|call, _| call.begun(StatusCode::UNSUPPORTED_MEDIA_TYPE, &HeaderMap::new())), "UNKNOWN");
        assert_eq!(counted(|call, _| call.end(&trailers("99"))), "UNKNOWN");
    }

    #[test]
    fn a_call_that_is_cut_has_one_too() {
        assert_eq!(counted(|_, _| {}), "CANCELLED");
        assert_eq!(counted(|_, exchange| exchange.cut()), "UNAVAILABLE");
        assert_eq!(counted(|_, exchange| assert!(exchange.cut_stalled())), "ABORTED");
        assert_eq!(counted(|_, exchange| exchange.lose()), "CANCELLED");
        let whole = counted(|call, exchange| {
            call.end(&trailers("0"));
            exchange.cut();
        });
        assert_eq!(whole, "OK", "what was said stays");
    }
}
