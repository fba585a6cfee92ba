//! Promise: counters are what the clients counted, call by call and job by job; scrapes are what Prometheus reads.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use tessera::mesh::shapes::Shape;
use tessera::proto::blob_service_client::BlobServiceClient;
use tessera::proto::job_service_client::JobServiceClient;
use tessera::proto::remesh_service_client::RemeshServiceClient;
use tessera::proto::*;
use tonic::Code;
use tonic::transport::Channel;

use crate::process::free_port;
use crate::program::*;

/// What a client counts.
#[derive(Default)]
struct Tally(BTreeMap<(String, String), u64>);

impl Tally {
    fn add(&mut self, method: &str, status: &str) {
        *self.0.entry((method.to_owned(), status.to_owned())).or_default() += 1;
    }
}

async fn read(channel: &Channel, digest: &str) -> Vec<u8> {
    let request = ReadRequest { digest: digest.to_owned(), ..ReadRequest::default() };
    let mut stream = BlobServiceClient::new(channel.clone()).read(request).await.unwrap().into_inner();
    let mut all = Vec::new();
    while let Some(piece) = stream.message().await.unwrap() {
        all.extend_from_slice(&piece.data);
    }
    all
}

#[tokio::test]
async fn counters_are_what_the_client_counted() {
    let program = Program::start(&[], &[]);
    let channel = program.channel().await;
    let mut tally = Tally::default();
    let (mut iterations, mut facets, mut seeds) = (0, 0, 0);

    let mesh = Shape::Torus.build(2000);
    let digest = put(&channel, &mesh).await;
    tally.add("tessera.v1.BlobService/Write", "OK");
    for points in [50, 60, 70] {
        let id = create(&channel, remesh(&digest, points), &[]).await;
        let job = end(&channel, &id).await;
        for method in ["CreateJob", "WatchJob", "GetJob"] {
            tally.add(&format!("tessera.v1.JobService/{method}"), "OK");
        }
        assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
        let report = &job.results.iter().find(|blob| blob.name == "report").unwrap().digest;
        let report: serde_json::Value = serde_json::from_slice(&read(&channel, report).await).unwrap();
        tally.add("tessera.v1.BlobService/Read", "OK");
        iterations += report["iterations"].as_array().unwrap().len();
        facets += report["input"]["facets"].as_u64().unwrap();
        seeds += points;
    }

    // Refusals and faults of the caller.
    let mut jobs = JobServiceClient::new(channel.clone());
    let wrong = jobs.get_job(GetJobRequest { id: "x".to_owned() }).await.unwrap_err();
    assert_eq!(wrong.code(), Code::InvalidArgument);
    tally.add("tessera.v1.JobService/GetJob", "INVALID_ARGUMENT");
    let absent = jobs.get_job(GetJobRequest { id: "0".repeat(32) }).await.unwrap_err();
    assert_eq!(absent.code(), Code::NotFound);
    tally.add("tessera.v1.JobService/GetJob", "NOT_FOUND");
    let huge =
        jobs.create_job(CreateJobRequest { spec: Some(remesh(&digest, u32::MAX)), ..CreateJobRequest::default() });
    assert_eq!(huge.await.unwrap_err().code(), Code::InvalidArgument);
    tally.add("tessera.v1.JobService/CreateJob", "INVALID_ARGUMENT");
    // A method that is not there.
    let mut nobody = tonic::client::Grpc::new(channel.clone());
    nobody.ready().await.unwrap();
    let path = tonic::codegen::http::uri::PathAndQuery::from_static("/tessera.v1.RemeshService/Nothing");
    let codec = tonic_prost::ProstCodec::<GetJobRequest, GetJobResponse>::default();
    let unknown = nobody.unary(tonic::Request::new(GetJobRequest::default()), path, codec).await.unwrap_err();
    assert_eq!(unknown.code(), Code::Unimplemented);
    tally.add("_OTHER", "UNIMPLEMENTED");
    // A stream that its client drops.
    let (sender, receiver) = tokio::sync::mpsc::channel::<RemeshRequest>(1);
    let messages = tokio_stream::wrappers::ReceiverStream::new(receiver);
    let mut streams = RemeshServiceClient::new(channel.clone());
    let open = streams.remesh(messages).await.unwrap();
    assert_eq!(
        program.metrics().await.get("tessera_open_streams{rpc_method=\"tessera.v1.RemeshService/Remesh\"}"),
        1.0
    );
    drop((open, sender));
    tally.add("tessera.v1.RemeshService/Remesh", "CANCELLED");
    // A client whose connection is cut.
    let own = program.channel().await;
    let watch = JobServiceClient::new(own.clone());
    let id = create(&channel, remesh(&digest, 80), &[]).await;
    tally.add("tessera.v1.JobService/CreateJob", "OK");
    end(&channel, &id).await;
    tally.add("tessera.v1.JobService/WatchJob", "OK");
    tally.add("tessera.v1.JobService/GetJob", "OK");
    iterations += 35;
    facets += mesh.facets().len() as u64;
    seeds += 80;
    drop((watch, own));

    let expected = [
        ("tessera_jobs_ended_total{outcome=\"done\",kind=\"remesh\"}", 4),
        ("tessera_jobs_ended_total{outcome=\"failed\",kind=\"remesh\"}", 0),
        ("tessera_queue_seconds_count{kind=\"remesh\"}", 4),
        ("tessera_stage_seconds_count{stage=\"iterations\",backend=\"parallel\"}", 4),
        ("tessera_iterations_total", iterations as u64),
        ("tessera_facets_total", facets),
        ("tessera_seeds_total", u64::from(seeds)),
        ("tessera_jobs{state=\"running\",kind=\"remesh\"}", 0),
        ("tessera_jobs{state=\"waiting\",kind=\"remesh\"}", 0),
        ("tessera_memory_bytes{kind=\"used\"}", 0),
        ("tessera_open_streams{rpc_method=\"tessera.v1.RemeshService/Remesh\"}", 0),
        ("tessera_device_losses_total", 0),
        ("tessera_not_ready{reason=\"draining\"}", 0),
    ];
    // A dropped stream is over once its server has heard of it, and a client hears of a job's end before all of it is put away.
    let start = Instant::now();
    let samples = loop {
        let samples = program.metrics().await;
        let wrong: Vec<_> = expected.iter().filter(|(name, count)| samples.get(name) != *count as f64).collect();
        if samples.calls() == tally.0 && wrong.is_empty() {
            break samples;
        }
        assert!(start.elapsed() < PATIENCE, "{wrong:?}\n{:#?}\n{:#?}", samples.calls(), tally.0);
        tokio::time::sleep(Duration::from_millis(20)).await;
    };
    let passes = samples.get("tessera_passes_total{backend=\"parallel\"}");
    assert!(passes >= iterations as f64, "{passes}");
    assert!(samples.get("tessera_probes_total{outcome=\"passed\"}") >= 1.0);
    assert!(samples.get("tessera_open_connections") >= 1.0);
    assert!(samples.get("process_resident_memory_bytes") > 1e6 && samples.get("process_cpu_seconds_total") > 0.0);
    program.stop();
}

#[tokio::test]
async fn a_refusal_is_counted_by_its_reason() {
    let program = Program::start(&["--max-streams", "1"], &[]);
    let channel = program.channel().await;
    let (sender, receiver) = tokio::sync::mpsc::channel::<RemeshRequest>(1);
    let mut streams = RemeshServiceClient::new(channel.clone());
    let open = streams.remesh(tokio_stream::wrappers::ReceiverStream::new(receiver)).await.unwrap();
    for _ in 0..3 {
        let refused = streams.remesh(tokio_stream::pending::<RemeshRequest>()).await.unwrap_err();
        assert_eq!(refused.code(), Code::ResourceExhausted);
    }
    let samples = program.metrics().await;
    assert_eq!(samples.get("tessera_refusals_total{reason=\"streams\"}"), 3.0);
    drop((open, sender));
    program.stop();
}

/// Whether a program is there; CI installs it.
fn is_there(name: &str) -> bool {
    Command::new(name).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok()
}

/// A server after some work, and its metrics.
pub async fn worked() -> Program {
    let http = format!("127.0.0.1:{}", free_port());
    let program = Program::start(&["--http-listen", &http], &[]);
    let channel = program.channel().await;
    let digest = put(&channel, &Shape::Torus.build(500)).await;
    let id = create(&channel, remesh(&digest, 40), &[]).await;
    end(&channel, &id).await;
    let (status, _) = get_from(&http, "/v1/jobs", "*/*").await;
    assert_eq!(status, 200);
    program
}

#[tokio::test]
#[ignore = "needs promtool (Debian: prometheus); CI runs it"]
async fn promtool_finds_nothing_wrong() {
    assert!(is_there("promtool"), "install Debian's prometheus");
    let program = worked().await;
    let (_, text) = program.get("/metrics", "text/plain").await;
    let mut tool = Command::new("promtool")
        .args(["check", "metrics"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    tool.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
    let done = tool.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&done.stdout).into_owned() + &String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && said.trim().is_empty(), "{said}");
    program.stop();
}

#[tokio::test]
#[ignore = "needs prometheus (Debian: prometheus); CI runs it"]
async fn a_real_prometheus_reads_it() {
    assert!(is_there("prometheus"), "install Debian's prometheus");
    let program = worked().await;
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("prometheus.yml");
    let config = format!(
        "global: {{ scrape_interval: 200ms, scrape_timeout: 200ms }}\nscrape_configs:\n- job_name: tessera\n  static_configs:\n  - targets: [\"{}\"]\n",
        program.admin
    );
    std::fs::write(&file, config).unwrap();
    let free = format!("127.0.0.1:{}", free_port());
    let mut prometheus = Command::new("prometheus")
        .arg(format!("--config.file={}", file.display()))
        .arg(format!("--storage.tsdb.path={}", folder.path().join("data").display()))
        .arg(format!("--web.listen-address={free}"))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let start = Instant::now();
    let found = loop {
        let asked = Command::new("promtool")
            .args(["query", "instant", &format!("http://{free}"), "tessera_seeds_total"])
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&asked.stdout).into_owned();
        if said.contains("=> 40 ") {
            break Ok(());
        }
        if start.elapsed() > 60 * SECOND {
            break Err(said);
        }
        tokio::time::sleep(Duration::from_millis(200)).await;
    };
    let _ = prometheus.kill();
    let _ = prometheus.wait();
    found.unwrap();
    program.stop();
}
