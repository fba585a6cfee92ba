//! Promise: one server takes everything that the other files of this folder send, one after the other, stays alive and
//! serving, and ends as it was: the same bits, and no more memory, descriptors and threads.
//!
//! Prints what it held before and after as JSON (`--nocapture`). `TESSERA_TRIAL_ROUNDS` sends everything so often.

#![cfg(target_os = "linux")]

use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::DensitySource;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tessera::remesh::Seeds;
use tonic::{Code, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use crate::adversary;
use crate::process::{address_of, resources_of};
use crate::raw::{CHECK, COMPUTE_RVD, Raw, silent};
use crate::server::*;

const SECOND: Duration = Duration::from_secs(1);

/// What the server may hold of uploads and of answers that wait.
const MEMORY_MIB: u64 = 128;

/// The program itself, on one address.
struct Program {
    child: Child,
    address: SocketAddr,
}

/// What a process holds.
#[derive(Clone, Copy, Debug)]
struct Held {
    mebibytes: u64,
    descriptors: usize,
    threads: usize,
}

impl Program {
    fn start() -> Self {
        let serve =
            "serve --ephemeral --listen 127.0.0.1:0 --backend parallel --threads 2 --stall-s 1 --idle-connection-s 2";
        let command = format!("ulimit -n 1024; exec \"$0\" {serve} --memory-mib {MEMORY_MIB}");
        let mut child = Command::new("sh")
            .args(["-c", &command, env!("CARGO_BIN_EXE_tessera")])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let address = address_of(&mut child).parse().unwrap();
        Self { child, address }
    }

    fn held(&self) -> Held {
        let (bytes, descriptors, threads) = resources_of(&self.child);
        Held { mebibytes: bytes >> 20, descriptors, threads }
    }

    async fn channel(&self) -> tonic::transport::Channel {
        let endpoint = tonic::transport::Endpoint::from_shared(format!("http://{}", self.address)).unwrap();
        endpoint.connect_timeout(PATIENCE).connect().await.unwrap()
    }

    async fn client(&self) -> Client {
        Client::new(self.channel().await).max_decoding_message_size(8 << 20)
    }

    /// It serves, says so, and gives the bits that it gave at first. On a busy machine work may have been silent for so long that
    /// health told of it: that ends with the work.
    async fn is_well(&self, after: &str, bits: &[u8]) {
        let begin = Instant::now();
        let mut client = HealthClient::new(self.channel().await);
        loop {
            let answer = client.check(HealthCheckRequest::default()).await;
            match answer.unwrap().into_inner().status() {
                ServingStatus::Serving => break,
                other => assert!(begin.elapsed() < PATIENCE, "{other:?} after {after}"),
            }
            tokio::time::sleep(SECOND / 10).await;
        }
        assert!(self.plain().await == bits, "other bits after {after}");
    }

    /// The positions of a plain remesh.
    async fn plain(&self) -> Vec<u8> {
        let (positions, facets) = Shape::Torus.build(2_000).into_parts();
        let wish = header(&positions, &facets, 200);
        let done = ask(&mut self.client().await, &positions, &facets, &[], wish, 120 * SECOND).await.unwrap();
        done.positions
    }

    /// Tells it to stop; gives how long that took.
    fn stop(mut self) -> Duration {
        let begin = Instant::now();
        let told = Command::new("kill").args(["-TERM", &self.child.id().to_string()]).status().unwrap();
        assert!(told.success());
        assert!(self.child.wait().unwrap().success());
        begin.elapsed()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

struct Done {
    positions: Vec<u8>,
    report: serde_json::Value,
}

fn header(positions: &[DVec3], facets: &[[u32; 3]], points: u32) -> RemeshHeader {
    let options = RemeshOptions { points: Some(points), seed: Some(1), ..RemeshOptions::default() };
    let mesh = Some(mesh_header(positions, facets));
    RemeshHeader { mesh, options: Some(options), ..RemeshHeader::default() }
}

/// A remesh with a deadline.
async fn ask(
    client: &mut Client,
    positions: &[DVec3],
    facets: &[[u32; 3]],
    seeds: &[DVec3],
    header: RemeshHeader,
    deadline: Duration,
) -> Result<Done, Status> {
    send(client, remesh_request(header, positions, facets, seeds, Vec::new()), deadline).await
}

async fn send(client: &mut Client, messages: Vec<RemeshRequest>, deadline: Duration) -> Result<Done, Status> {
    let mut request = tonic::Request::new(tokio_stream::iter(messages));
    request.set_timeout(deadline);
    let mut answers = client.remesh(request).await?.into_inner();
    let (mut chunks, mut done) = (Vec::new(), None);
    while let Some(answer) = answers.message().await? {
        match answer.message.unwrap() {
            remesh_response::Message::Chunk(chunk) => chunks.push(chunk),
            remesh_response::Message::Done(last) => done = Some(last),
            _ => {}
        }
    }
    let done = done.expect("done comes last");
    let report = if done.report_json.is_empty() {
        serde_json::from_slice(&gather(&chunks, ArrayKind::Report)).unwrap()
    } else {
        serde_json::from_str(&done.report_json).unwrap()
    };
    Ok(Done { positions: gather(&chunks, ArrayKind::Positions), report })
}

/// A sphere with one vertex far away gives a remesh, and the report says so.
async fn outlier_vertices(program: &Program) {
    for distance in [1e7, 1e9, 1e12] {
        let (mut positions, facets) = Shape::Sphere.build(320).into_parts();
        positions[40].y = distance;
        let wish = header(&positions, &facets, 500);
        let done = ask(&mut program.client().await, &positions, &facets, &[], wish, 180 * SECOND).await.unwrap();
        assert_eq!(done.report["input"]["outlier_vertices"], 1, "{distance:e}");
    }
}

/// An adversary's job as a client sends it.
fn hostile(number: u64) -> (String, Vec<RemeshRequest>) {
    let adversary::Job { name, mesh, options } = adversary::job(number, 40_000);
    let (positions, facets) = mesh.into_parts();
    let numbers = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let mut mesh = mesh_header(&positions, &facets);
    let (wish, extra) = (
        wire::options::of_remesh(&options),
        match &options.density.source {
            DensitySource::Sizes(sizes) => {
                mesh.edge_lengths = sizes.len() as u64;
                chunks(ArrayKind::EdgeLengths, &numbers(sizes))
            }
            DensitySource::Weights(weights) => {
                mesh.weights = weights.len() as u64;
                chunks(ArrayKind::Weights, &numbers(weights))
            }
            _ => Vec::new(),
        },
    );
    let seeds = if let Seeds::Given(seeds) = options.seeds { seeds } else { Vec::new() };
    let wish = RemeshHeader { mesh: Some(mesh), seeds: seeds.len() as u64, backend: 0, options: Some(wish) };
    let messages = remesh_request(wish, &positions, &facets, &seeds, extra);
    (name, messages)
}

/// Jobs of every kind, each with a deadline that most of them do not keep. Nothing but a typed answer comes.
async fn hostile_jobs(program: &Program, first: u64) {
    for number in first..first + adversary::SURFACES.len() as u64 {
        let (name, messages) = hostile(number);
        let mut rng = ChaCha8Rng::seed_from_u64(number);
        let deadline = Duration::from_secs_f64(0.2 + 0.8 * rng.random::<f64>());
        let begin = Instant::now();
        let answer = send(&mut program.client().await, messages, deadline).await;
        let code = answer.map_or_else(|status| status.code(), |_| Code::Ok);
        let typed = [
            Code::Ok,
            Code::DeadlineExceeded,
            Code::Cancelled,
            Code::InvalidArgument,
            Code::FailedPrecondition,
            Code::ResourceExhausted,
        ];
        assert!(typed.contains(&code), "{name}: {code:?}");
        assert!(begin.elapsed() < deadline + 20 * SECOND, "{name}: {:?}", begin.elapsed());
    }
}

/// Sessions on a soup whose clients go away while they are prepared.
async fn sessions_that_nobody_waits_for(program: &Program) {
    use cvt_request::Message as Ask;
    let soup = adversary::soup(30_000, &mut ChaCha8Rng::seed_from_u64(1));
    let (positions, facets) = soup.into_parts();
    let wish = CvtHeader {
        mesh: Some(mesh_header(&positions, &facets)),
        options: Some(CvtOptions {
            points: Some(5_000),
            seed: Some(1),
            density: Some(Density { source: tessera::proto::DensitySource::Lfs.into(), ..Density::default() }),
            ..CvtOptions::default()
        }),
        ..CvtHeader::default()
    };
    let mut all = vec![Ask::Header(wish)];
    all.extend(all_chunks(&positions, &facets, &[]).into_iter().map(Ask::Chunk));
    all.push(Ask::Start(CvtStart {}));
    let all: Vec<_> = all.into_iter().map(|message| CvtRequest { message: Some(message) }).collect();
    for _ in 0..40 {
        let mut client = program.client().await;
        let messages = all.clone();
        let session = async move {
            // Open until this goes: hyper keeps a connection whose request's body has no end.
            let (ask, questions) = by_hand();
            let send = async {
                for message in messages {
                    let _ = ask.send(message).await;
                }
                std::future::pending::<()>().await;
            };
            let answers = async {
                let mut answers = client.cvt(questions).await?.into_inner();
                while answers.message().await?.is_some() {}
                Ok::<_, Status>(())
            };
            tokio::select! {
                () = send => {}
                _ = answers => {}
            }
        };
        // Its client goes.
        let _ = tokio::time::timeout(Duration::from_millis(150), session).await;
    }
}

/// More sockets than the server may have open, all of them silent.
async fn silent_sockets(program: &Program) {
    let mut sockets = Vec::new();
    for _ in 0..1200 {
        sockets.push(silent(program.address, b"").await);
    }
    for _ in 0..5 {
        let begin = Instant::now();
        HealthClient::new(program.channel().await).check(HealthCheckRequest::default()).await.unwrap();
        assert!(begin.elapsed() < 20 * SECOND);
    }
}

/// Answers that nobody takes.
async fn shut_windows(program: &Program) {
    let (vertices, facets) = octahedron();
    let request = rvd_request(&vertices, &facets, &spiral(4000), BackendChoice::Parallel, &[RvdOutput::Cells]);
    let mut held = Vec::new();
    let mut connections = Vec::new();
    for _ in 0..12 {
        let mut raw = Raw::connect(program.address, 0).await;
        for _ in 0..10 {
            let asked = tokio::time::timeout(PATIENCE, raw.ask(COMPUTE_RVD, &request)).await;
            // Refused for a full queue, or cut before its head came: both end it.
            held.extend(asked.expect("is answered"));
        }
        connections.push(raw);
    }
    for body in &mut held {
        let end = async { while body.data().await.is_some_and(|data| data.is_ok()) {} };
        tokio::time::timeout(PATIENCE, end).await.expect("is cut");
    }
    connections.into_iter().for_each(|raw| raw.connection.abort());
}

/// Messages of 4 MiB of which the last bytes never come, on every service.
async fn messages_that_never_end(program: &Program) {
    let held = program.held().mebibytes;
    let mut most = held;
    for path in [CHECK, COMPUTE_RVD] {
        let mut connections = Vec::new();
        for _ in 0..2 {
            let mut raw = Raw::connect(program.address, 1 << 16).await;
            let mut bodies = Vec::new();
            for _ in 0..100 {
                // A connection that is at fault so often may be closed.
                let Ok((response, mut body)) = raw.try_begin(path, &[]).await else { break };
                let mut message = vec![0];
                message.extend((4u32 << 20).to_be_bytes());
                message.resize(4 << 20, 0);
                // What the connection's window does not take yet waits here; what was refused says so.
                let _ = body.send_data(message.into(), false);
                bodies.push((response, body));
            }
            connections.push((raw, bodies));
        }
        let begin = Instant::now();
        while begin.elapsed() < 3 * SECOND {
            most = most.max(program.held().mebibytes);
            tokio::time::sleep(SECOND / 20).await;
        }
        connections.into_iter().for_each(|(raw, _)| raw.connection.abort());
    }
    // The server's memory for uploads, and as much for what is on its way or not yet given back; 800 MiB were sent.
    assert!(most < held + 2 * MEMORY_MIB + 64, "{held} MiB became {most}");
}

/// Uploads that stop in the middle, and clients that go away at once.
async fn half_uploads(program: &Program) {
    for cut in 1..30 {
        let mut request = small_rvd(BackendChoice::Parallel);
        request.truncate(cut % request.len());
        let mut client = program.client().await;
        let asked = ask_rvd(&mut client, request);
        assert!(asked.await.is_err(), "there is no finish");
    }
}

/// A report of thousands of steps.
async fn long_report(program: &Program) {
    let (positions, facets) = octahedron();
    let mut wish = header(&positions, &facets, 20);
    let options = wish.options.as_mut().unwrap();
    (options.lloyd, options.newton, options.measure) = (Some(3_000), Some(0), Measure::Topology.into());
    let done = ask(&mut program.client().await, &positions, &facets, &[], wish, 120 * SECOND).await.unwrap();
    assert!(!done.report["iterations"].as_array().unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn one_server_takes_all_of_it_and_is_as_it_was() {
    let program = Program::start();
    let bits = program.plain().await;
    // Pools and the allocator's own stock grow with the first jobs and stay.
    outlier_vertices(&program).await;
    hostile_jobs(&program, 0).await;
    tokio::time::sleep(SECOND).await;
    let before = program.held();
    let rounds = std::env::var("TESSERA_TRIAL_ROUNDS").map_or(1, |text| text.parse().unwrap());
    for round in 1..=rounds {
        outlier_vertices(&program).await;
        program.is_well("stray vertices", &bits).await;
        hostile_jobs(&program, round * adversary::SURFACES.len() as u64).await;
        program.is_well("hostile jobs", &bits).await;
        sessions_that_nobody_waits_for(&program).await;
        program.is_well("sessions that nobody waits for", &bits).await;
        silent_sockets(&program).await;
        program.is_well("silent sockets", &bits).await;
        shut_windows(&program).await;
        program.is_well("shut windows", &bits).await;
        messages_that_never_end(&program).await;
        program.is_well("messages that never end", &bits).await;
        half_uploads(&program).await;
        long_report(&program).await;
        program.is_well("half uploads and a long report", &bits).await;
        println!("{{\"round\": {round}, \"held\": \"{:?}\"}}", program.held());
    }
    let is_as_it_was = |now: Held| {
        now.descriptors <= before.descriptors + 1
            && now.threads <= before.threads + 1
            && now.mebibytes <= before.mebibytes + 100
    };
    let begin = Instant::now();
    while !is_as_it_was(program.held()) && begin.elapsed() < PATIENCE {
        tokio::time::sleep(SECOND / 4).await;
    }
    let after = program.held();
    // A watch is told, and keeps nothing up.
    let mut watch =
        HealthClient::new(program.channel().await).watch(HealthCheckRequest::default()).await.unwrap().into_inner();
    assert_eq!(watch.message().await.unwrap().unwrap().status(), ServingStatus::Serving);
    let stopping = tokio::task::spawn_blocking(|| program.stop());
    assert_eq!(watch.message().await.unwrap().unwrap().status(), ServingStatus::NotServing);
    let stop = stopping.await.unwrap();
    println!("{{\"before\": \"{before:?}\", \"after\": \"{after:?}\", \"stop_s\": {:.2}}}", stop.as_secs_f64());
    assert!(is_as_it_was(after), "{before:?} became {after:?}");
    assert!(stop < 20 * SECOND, "{stop:?}");
}
