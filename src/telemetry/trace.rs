//! Which trace a piece of work belongs to.
//!
//! Purpose: [`TraceContext`] is a caller's `traceparent` (W3C Trace Context), and goes with a call from task to task and, with its
//! job, to a host thread. [`join`] makes a span a part of that trace.
//! Invariant: what a stranger sends is taken as it should be written, or not at all. Without an exporter a trace is only a
//! number in the log. Must not know: what is done, where traces go.

use std::fmt;
use std::future::Future;

use tracing::Span;
use tracing::instrument::{Instrument, Instrumented};

/// The metadata that carries it.
pub const TRACEPARENT: &str = "traceparent";

/// A trace and the calling span in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TraceContext {
    /// The trace. Not 0.
    pub trace_id: u128,
    /// The calling span; 0 if it is not exported.
    pub span_id: u64,
    /// Whether the caller keeps this trace.
    pub is_sampled: bool,
}

impl TraceContext {
    /// Reads a `traceparent`: version, trace, span and flags in lower-case hexadecimal digits. A version that came after this
    /// may have more at its end.
    pub fn parse(text: &str) -> Option<Self> {
        let mut parts = text.split('-');
        let [version, trace, span, flags] = [parts.next()?, parts.next()?, parts.next()?, parts.next()?];
        let is_hex = |part: &str, digits| {
            part.len() == digits && part.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b))
        };
        let is_whole = parts.next().is_none() || version != "00";
        if !(is_hex(version, 2) && is_hex(trace, 32) && is_hex(span, 16) && is_hex(flags, 2) && is_whole) {
            return None;
        }
        let (trace_id, span_id) = (u128::from_str_radix(trace, 16).ok()?, u64::from_str_radix(span, 16).ok()?);
        let is_sampled = u8::from_str_radix(flags, 16).ok()? & 1 == 1;
        (version != "ff" && trace_id != 0 && span_id != 0).then_some(Self { trace_id, span_id, is_sampled })
    }

    /// A trace of its own, for a call that belongs to none.
    fn new() -> Self {
        let mut bytes = [0; 16];
        // Without random numbers all such calls share a number, which harms the log and nothing else.
        let _ = getrandom::fill(&mut bytes);
        Self { trace_id: u128::from_le_bytes(bytes).max(1), span_id: 0, is_sampled: false }
    }

    /// The trace as it is written.
    pub fn id(&self) -> String {
        format!("{:032x}", self.trace_id)
    }
}

impl fmt::Display for TraceContext {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "00-{:032x}-{:016x}-{:02x}", self.trace_id, self.span_id, u8::from(self.is_sampled))
    }
}

tokio::task_local! {
    static HERE: TraceContext;
}

/// The trace that the current task works for.
pub fn here() -> Option<TraceContext> {
    HERE.try_with(|here| *here).ok()
}

/// Makes a span part of `parent`'s trace, or of a new one, and records the trace in its field `trace_id`. Returns the parent
/// of its children. Called once, before anything is done in the span.
pub fn join(span: &Span, parent: Option<TraceContext>) -> TraceContext {
    #[cfg(feature = "otlp")]
    let parent = exported(span, parent).or(parent);
    let context = parent.unwrap_or_else(TraceContext::new);
    // Displayed: a text would be in quotes in lines of text.
    span.record("trace_id", tracing::field::display(context.id()));
    context
}

/// Has a future work for a trace, within its span.
pub fn within<F: Future>(context: TraceContext, span: Span, work: F) -> impl Future<Output = F::Output> {
    HERE.scope(context, work.instrument(span))
}

/// Has a future that is spawned go on with the current trace and span.
pub fn carry<F: Future>(work: F) -> impl Future<Output = F::Output> {
    let (here, work): (_, Instrumented<F>) = (here(), work.in_current_span());
    async move {
        match here {
            Some(here) => HERE.scope(here, work).await,
            None => work.await,
        }
    }
}

/// As [`join`], for an exporter; nothing if spans are not exported.
#[cfg(feature = "otlp")]
fn exported(span: &Span, parent: Option<TraceContext>) -> Option<TraceContext> {
    use opentelemetry::Context;
    use opentelemetry::trace::{SpanContext, SpanId, TraceContextExt as _, TraceFlags, TraceId, TraceState};
    use tracing_opentelemetry::OpenTelemetrySpanExt as _;

    if let Some(TraceContext { trace_id, span_id, is_sampled }) = parent.filter(|parent| parent.span_id != 0) {
        let flags = if is_sampled { TraceFlags::SAMPLED } else { TraceFlags::default() };
        let (trace, asks) = (TraceId::from(trace_id), SpanId::from(span_id));
        let parent = SpanContext::new(trace, asks, flags, true, TraceState::default());
        // A span that is not exported has no parent.
        let _ = span.set_parent(Context::new().with_remote_span_context(parent));
    }
    let context = span.context();
    let own = context.span();
    let own = own.span_context();
    own.is_valid().then(|| TraceContext {
        trace_id: u128::from_be_bytes(own.trace_id().to_bytes()),
        span_id: u64::from_be_bytes(own.span_id().to_bytes()),
        is_sampled: own.is_sampled(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";

    #[test]
    fn a_traceparent_is_read_and_written() {
        let context = TraceContext::parse(GOOD).unwrap();
        assert_eq!(context.to_string(), GOOD);
        assert_eq!(context.id().to_string(), "4bf92f3577b34da6a3ce929d0e0e4736");
        assert!(!TraceContext::parse(&GOOD.replace("-01", "-00")).unwrap().is_sampled);
        assert!(TraceContext::parse(&format!("{}-more", GOOD.replacen("00", "01", 1))).is_some(), "a later version");
    }

    #[test]
    fn what_is_no_traceparent_is_not_taken() {
        for wrong in [
            "",
            "00",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7",
            "ff-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
            "00-4BF92F3577B34DA6A3CE929D0E0E4736-00f067aa0ba902b7-01",
            "00-00000000000000000000000000000000-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-0000000000000000-01",
            "00-4bf92f3577b34da6a3ce929d0e0e473-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01-more",
            "00-+bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
        ] {
            assert_eq!(TraceContext::parse(wrong), None, "{wrong:?}");
        }
    }

    #[tokio::test]
    async fn a_trace_goes_with_what_is_spawned() {
        let context = TraceContext::parse(GOOD).unwrap();
        let seen = within(context, Span::none(), async {
            let (alone, carried) = (tokio::spawn(async { here() }), tokio::spawn(carry(async { here() })));
            (alone.await.unwrap(), carried.await.unwrap())
        });
        assert_eq!(seen.await, (None, Some(context)));
        assert_eq!(here(), None);
    }

    #[test]
    fn calls_without_a_trace_have_one_of_their_own() {
        let (one, other) = (join(&Span::none(), None), join(&Span::none(), None));
        assert_ne!(one.trace_id, other.trace_id);
        let given = TraceContext::parse(GOOD).unwrap();
        assert_eq!(join(&Span::none(), Some(given)).trace_id, given.trace_id);
    }
}
