//! Promise: whatever a server does, the command ends with a sentence and a code of its own, and never with a panic.

use std::net::SocketAddr;
use std::process::{Command, Output};

use tessera::mesh::io;
use tessera::mesh::shapes::Shape;
use tessera::proto::remesh_service_server::{RemeshService, RemeshServiceServer};
use tessera::proto::{self, ArrayKind, Chunk, compute_rvd_response, remesh_response};
use tokio::net::TcpListener;
use tokio_stream::StreamExt;
use tonic::transport::server::TcpIncoming;
use tonic::{Request, Response, Status, Streaming};

type Answers<T> = Vec<Result<T, Status>>;
type Stream<T> = tokio_stream::Iter<std::vec::IntoIter<Result<T, Status>>>;

/// Answers every call with the same messages.
#[derive(Clone, Default)]
struct Fake {
    remesh: Answers<proto::RemeshResponse>,
    rvd: Answers<proto::ComputeRvdResponse>,
    /// Ends its process's side of the connection instead of the answer.
    dies: bool,
}

async fn read<T>(request: Request<Streaming<T>>) {
    let mut all = request.into_inner();
    while all.next().await.is_some_and(|message| message.is_ok()) {}
}

#[tonic::async_trait]
impl RemeshService for Fake {
    type ComputeRvdStream = Stream<proto::ComputeRvdResponse>;
    type CvtStream = Stream<proto::CvtResponse>;
    type RemeshStream = Stream<proto::RemeshResponse>;

    async fn compute_rvd(
        &self,
        request: Request<Streaming<proto::ComputeRvdRequest>>,
    ) -> Result<Response<Self::ComputeRvdStream>, Status> {
        read(request).await;
        Ok(Response::new(tokio_stream::iter(self.rvd.clone())))
    }

    async fn cvt(&self, _: Request<Streaming<proto::CvtRequest>>) -> Result<Response<Self::CvtStream>, Status> {
        Err(Status::unimplemented("no"))
    }

    async fn remesh(
        &self,
        request: Request<Streaming<proto::RemeshRequest>>,
    ) -> Result<Response<Self::RemeshStream>, Status> {
        read(request).await;
        Ok(Response::new(tokio_stream::iter(self.remesh.clone())))
    }
}

/// A server of its own; it ends with the runtime.
fn serve(fake: Fake) -> (tokio::runtime::Runtime, SocketAddr) {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let listener = runtime.block_on(TcpListener::bind("127.0.0.1:0")).unwrap();
    let address = listener.local_addr().unwrap();
    if fake.dies {
        // Answers what comes first, then is gone in the midst of the call.
        runtime.spawn(async move {
            let (socket, _) = listener.accept().await.unwrap();
            let mut connection = h2::server::handshake(socket).await.unwrap();
            let mut calls = 0;
            while let Some(Ok((_, mut respond))) = connection.accept().await {
                calls += 1;
                if calls == 2 {
                    return;
                }
                let head = http::Response::builder().header("content-type", "application/grpc");
                respond.send_response(head.header("grpc-status", "12").body(()).unwrap(), true).unwrap();
            }
        });
    } else {
        let server = tonic::transport::Server::builder().add_service(RemeshServiceServer::new(fake));
        runtime.spawn(server.serve_with_incoming(TcpIncoming::from(listener)));
    }
    (runtime, address)
}

/// What a command says of a server: its code, and its words on both streams.
fn told(fake: Fake, line: &str) -> (Option<i32>, String, String) {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.ply"), &Shape::Sphere.build(100)).unwrap();
    let (_runtime, address) = serve(fake);
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.args(line.split(' ')).args(["--endpoint", &format!("http://{address}")]).current_dir(folder.path());
    let Output { status, stdout, stderr } = command.output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    let (said, told) = (text(stdout), text(stderr));
    for text in [&said, &told] {
        assert!(!text.contains(['\u{1b}', '\u{7}', '\u{202e}']) && !text.contains("panicked"), "{line}: {text:?}");
        assert!(!text.contains("NaN ") && !text.contains("hyper") && !text.contains("Error {"), "{line}: {text:?}");
    }
    (status.code(), said, told)
}

const REMESH: &str = "remesh in.ply -o out.ply --points 40";

fn chunk(kind: ArrayKind, data: &[u8]) -> Chunk {
    let (crc32c, total_bytes) = (crc32c::crc32c(data), data.len() as u64);
    Chunk { kind: kind.into(), data: data.to_vec().into(), crc32c, total_bytes, ..Chunk::default() }
}

fn numbers(all: &[f64]) -> Vec<u8> {
    all.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn indices(all: &[u32]) -> Vec<u8> {
    all.iter().flat_map(|x| x.to_le_bytes()).collect()
}

fn positions() -> Chunk {
    chunk(ArrayKind::Positions, &numbers(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]))
}

fn facets() -> Chunk {
    chunk(ArrayKind::Facets, &indices(&[0, 2, 1, 0, 1, 3, 1, 2, 3, 0, 3, 2]))
}

fn done(report_json: &str) -> proto::RemeshDone {
    proto::RemeshDone { vertices: 4, facets: 4, report_json: report_json.to_owned(), ..Default::default() }
}

/// A server of remeshes.
fn remesher(chunks: Vec<Chunk>, done: proto::RemeshDone) -> Fake {
    let chunks = chunks.into_iter().map(remesh_response::Message::Chunk);
    let all = chunks.chain([remesh_response::Message::Done(done)]);
    let remesh = all.map(|m| Ok(proto::RemeshResponse { message: Some(m) })).collect();
    Fake { remesh, ..Fake::default() }
}

#[test]
fn wrong_arrays_are_the_server_s_fault() {
    let creases = chunk(ArrayKind::Creases, &indices(&[0, 4_000_000_000, 3, 3]));
    let mut endless = positions();
    endless.total_bytes = 24;
    for (chunks, done, words) in [
        (vec![positions(), facets(), creases.clone()], done("{}"), "no edge from vertex 0 to 4000000000"),
        (vec![positions()], done("{}"), "no ARRAY_KIND_FACETS"),
        (vec![positions(), chunk(ArrayKind::Facets, &indices(&[0, 1, 99]))], done("{}"), "99"),
        (vec![chunk(ArrayKind::Positions, &numbers(&[f64::NAN; 12])), facets()], done("{}"), "not finite"),
        (vec![chunk(ArrayKind::Positions, &[0; 25])], done("{}"), "no whole elements"),
        (vec![endless], done("{}"), "more were sent"),
        (vec![Chunk { total_bytes: 1 << 40, ..positions() }], done("{}"), "at most"),
        (vec![Chunk { crc32c: 1, ..positions() }], done("{}"), "damaged"),
        (vec![positions(), facets()], proto::RemeshDone { vertices: 5, ..done("{}") }, "it says 5 and 4"),
        (vec![positions(), facets()], done("[1]"), "no report"),
        (vec![positions(), facets()], done(&"[".repeat(100_000)), "report"),
    ] {
        for more in ["", " --picture p.png --picture-size 64x48"] {
            let (code, _, told) = told(remesher(chunks.clone(), done.clone()), &format!("{REMESH}{more}"));
            assert!(code == Some(69) && told.contains("the server's answer is wrong: "), "{words}: {told}");
            assert!(told.contains(words) && told.lines().count() == 1, "{words}: {told}");
        }
    }
}

#[test]
fn a_report_says_what_it_likes_and_is_shown_plain() {
    let report = r#"{"backend": 7, "adapter": "\u001b[31mGPU\u202e", "threads": "x", "timings_ms": [], "input": null,
        "result": {"euler": "many", "q_min": 1, "q_avg": "NaN"}, "iterations": [{"energy_ratio": null}]}"#;
    let good = || remesher(vec![positions(), facets()], done(report));
    let (code, said, _) = told(good(), REMESH);
    assert!(code == Some(0) && said.contains("\u{fffd}[31mGPU\u{fffd}") && !said.contains("quality"), "{said}");
    for more in [" --json", " --picture p.png --picture-size 64x48"] {
        assert_eq!(told(good(), &format!("{REMESH}{more}")).0, Some(0));
    }
}

#[test]
fn statuses_and_lost_connections_are_told_once_and_plainly() {
    for (status, exit, words) in [
        (Status::invalid_argument("\u{1b}[31mbad\nmesh"), 65, "the server says: \u{fffd}[31mbad mesh"),
        (Status::internal("a fault"), 69, "the server says: a fault"),
        (Status::unknown("\u{202e}x"), 69, "the server says: \u{fffd}x"),
        (Status::cancelled("I stop"), 69, "the server cancelled the job: I stop"),
    ] {
        let fake = Fake { remesh: vec![Err(status)], ..Fake::default() };
        let (code, _, told) = told(fake, REMESH);
        assert!(code == Some(exit) && told.matches(words).count() == 1 && told.lines().count() == 1, "{told:?}");
    }
    for line in [REMESH, "rvd in.ply --points 40"] {
        let (code, _, text) = told(Fake { dies: true, ..Fake::default() }, line);
        assert!(code == Some(69) && text.contains("was lost: ") && text.contains("try again"), "{text}");
        let (code, _, text) = told(Fake::default(), line);
        assert!(code == Some(69) && text.contains("ended before the job was done"), "{text}");
    }
}

#[test]
fn wrong_pieces_are_refused() {
    let cells = |seed: u32, count: u32| {
        let message = proto::CellsChunk {
            pieces: 1,
            vertices: count,
            facet: indices(&[0]).into(),
            seed: indices(&[seed]).into(),
            vertex_count: indices(&[count]).into(),
            positions: numbers(&vec![0.0; 3 * count as usize]).into(),
            weights: numbers(&vec![1.0; count as usize]).into(),
            opposite: indices(&vec![u32::MAX; count as usize]).into(),
        };
        let message = Some(compute_rvd_response::Message::Cells(message));
        Ok(proto::ComputeRvdResponse { message })
    };
    for (messages, words) in [
        (vec![cells(0, 0)], "no polygon"),
        (vec![cells(99, 3)], "no piece of seed 99"),
        (vec![cells(0, 3), cells(0, 3)], "twice"),
    ] {
        let fake = Fake { rvd: messages, ..Fake::default() };
        let (code, _, told) = told(fake, "rvd in.ply --points 40 -o cells.ply --picture p.png --picture-size 64x48");
        assert!(code == Some(69) && told.contains(words), "{words}: {told}");
    }
}
