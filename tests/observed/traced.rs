//! Promise: a trace that a client began goes on through the call, the queue, the stages and the passes of its job; log lines
//! have its number; a collector that is away stops nothing.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{TraceService, TraceServiceServer};
use opentelemetry_proto::tonic::collector::trace::v1::{ExportTraceServiceRequest, ExportTraceServiceResponse};
use opentelemetry_proto::tonic::trace::v1::Span;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tokio::net::TcpListener;
use tokio_stream::wrappers::TcpListenerStream;
use tonic::{Request, Response, Status};

use crate::nobody::Nobody;
use crate::program::*;

const TRACE: &str = "4bf92f3577b34da6a3ce929d0e0e4736";
const PARENT: &str = "00f067aa0ba902b7";

/// Keeps the spans that it is sent.
#[derive(Clone, Default)]
struct Collector(Arc<Mutex<Vec<Span>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        let resources = request.into_inner().resource_spans;
        let spans = resources.into_iter().flat_map(|r| r.scope_spans).flat_map(|s| s.spans);
        self.0.lock().unwrap().extend(spans);
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

/// A collector, and where it listens.
async fn collector() -> (Collector, String) {
    let collector = Collector::default();
    let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let serving = tonic::transport::Server::builder().add_service(TraceServiceServer::new(collector.clone()));
    tokio::spawn(serving.serve_with_incoming(TcpListenerStream::new(listener)));
    (collector, url)
}

/// Batches leave soon.
const SOON: (&str, &str) = ("OTEL_BSP_SCHEDULE_DELAY", "100");

async fn job(program: &Program, sampled: bool) -> String {
    let channel = program.channel().await;
    let digest = put(&channel, &Shape::Torus.build(500)).await;
    let parent = format!("00-{TRACE}-{PARENT}-{:02}", u8::from(sampled));
    let id = create(&channel, remesh(&digest, 40), &[("traceparent", &parent)]).await;
    let job = end(&channel, &id).await;
    assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
    id
}

#[tokio::test]
async fn one_trace_leads_from_the_client_to_a_pass() {
    let (collector, url) = collector().await;
    let program = Program::start(&["--otlp-endpoint", &url], &[SOON]);
    let id = job(&program, true).await;
    let start = Instant::now();
    let spans = loop {
        let spans: Vec<Span> =
            collector.0.lock().unwrap().iter().filter(|s| hex(&s.trace_id) == TRACE).cloned().collect();
        // The job's own span is the last that ends.
        if spans.iter().any(|span| span.name == "job") {
            break spans;
        }
        assert!(start.elapsed() < PATIENCE, "{:?}", spans.iter().map(|s| &s.name).collect::<Vec<_>>());
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    let by_id: HashMap<&[u8], &Span> = spans.iter().map(|span| (&span.span_id[..], span)).collect();
    let pass = spans.iter().find(|span| span.name == "pass").expect("a pass");
    let mut path = vec![pass.name.as_str()];
    let mut at = pass;
    while let Some(parent) = by_id.get(&at.parent_span_id[..]) {
        at = parent;
        path.push(&at.name);
        assert!(path.len() < 10, "{path:?}");
    }
    assert_eq!(hex(&at.parent_span_id), PARENT, "the client's span is above all: {path:?}");
    let (last, rest) = path.split_last().unwrap();
    assert_eq!(*last, "tessera.v1.JobService/CreateJob");
    assert_eq!((rest[0], rest[2]), ("pass", "job"), "{path:?}");
    for name in ["queue", "prepare", "iterations", "dual"] {
        assert!(spans.iter().any(|span| span.name == name), "{name}");
    }
    let attribute = |span: &Span, key: &str| {
        let found = span.attributes.iter().find(|a| a.key == key).unwrap_or_else(|| panic!("{key}: {span:?}"));
        format!("{:?}", found.value)
    };
    assert!(attribute(at, "rpc.response.status_code").contains("OK"));
    let job = spans.iter().find(|span| span.name == "job").unwrap();
    assert!(attribute(job, "job").contains(&id) && attribute(job, "backend").contains("parallel"));

    let log = program.stop();
    let lines: Vec<serde_json::Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let ended = lines.iter().find(|line| line["message"] == "a job ended").expect("a line about the job");
    assert!(belongs(ended, &id), "{ended}");
}

#[tokio::test]
async fn what_nobody_samples_is_not_exported() {
    let (collector, url) = collector().await;
    let program = Program::start(&["--otlp-endpoint", &url, "--otlp-ratio", "0"], &[SOON]);
    let id = job(&program, false).await;
    let log = program.stop();
    assert!(collector.0.lock().unwrap().is_empty());
    let line = log.lines().find(|line| line.contains("a job ended")).unwrap();
    assert!(line.contains(TRACE) && line.contains(&id), "the log has its number all the same: {line}");
}

#[tokio::test]
async fn a_collector_that_is_away_costs_a_line() {
    let nobody = Nobody::new();
    let program = Program::start(&["--otlp-endpoint", &nobody.url()], &[SOON]);
    for _ in 0..3 {
        job(&program, true).await;
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
    let log = program.stop();
    let lines = log.lines().filter(|line| line.contains("traces could not be exported")).count();
    assert_eq!(lines, 1, "{log}");
}

#[tokio::test]
async fn without_a_collector_calls_have_a_trace_in_the_log() {
    let program = Program::start(&[], &[]);
    let id = job(&program, true).await;
    let log = program.stop();
    let lines: Vec<serde_json::Value> = log.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let ended = lines.iter().find(|line| line["message"] == "a job ended").unwrap();
    assert!(belongs(ended, &id), "{ended}");
}

/// Whether a line of the log is about a job and has the trace.
fn belongs(line: &serde_json::Value, id: &str) -> bool {
    let spans = line["spans"].as_array().map(Vec::as_slice).unwrap_or_default();
    let has = |key: &str, value: &str| spans.iter().any(|span| span[key] == value);
    has("job", id) && has("trace_id", TRACE)
}
