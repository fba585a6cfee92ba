//! Promise: whatever is wrong with a request is refused with the right code and names the place.

use crate::server::*;
use glam::DVec3;
use server::config::Limits;
use tessera::proto::compute_rvd_request::Message as Ask;
use tessera::proto::*;
use tonic::{Code, Status};
use tonic_types::StatusExt;

const CELLS: &[RvdOutput] = &[RvdOutput::Cells];

/// The field that a BadRequest names.
fn field(status: &Status) -> String {
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    status.get_details_bad_request().expect("has details").field_violations[0].field.clone()
}

async fn refused(client: &mut Client, requests: Vec<ComputeRvdRequest>) -> Status {
    ask_rvd(client, requests).await.expect_err("is refused")
}

fn first_chunk(requests: &mut [ComputeRvdRequest], kind: ArrayKind) -> &mut Chunk {
    requests
        .iter_mut()
        .find_map(|r| match r.message.as_mut() {
            Some(Ask::Chunk(c)) if c.kind == i32::from(kind) => Some(c),
            _ => None,
        })
        .unwrap()
}

fn header(requests: &mut [ComputeRvdRequest]) -> &mut ComputeRvdHeader {
    match requests[0].message.as_mut() {
        Some(Ask::Header(header)) => header,
        _ => panic!("the header is first"),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn chunks_are_checked() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let good = || small_rvd(BackendChoice::Auto);

    let mut bad = good();
    first_chunk(&mut bad, ArrayKind::Facets).crc32c ^= 1;
    assert_eq!(field(&refused(&mut client, bad).await), "chunk.crc32c");

    let mut hole = good();
    first_chunk(&mut hole, ArrayKind::Positions).offset = 24;
    assert_eq!(field(&refused(&mut client, hole).await), "chunk.offset");

    let mut twice = good();
    let again = twice[1].clone();
    twice.insert(2, again);
    assert_eq!(field(&refused(&mut client, twice).await), "chunk.offset");

    let mut short = good();
    short.remove(1);
    assert_eq!(field(&refused(&mut client, short).await), "mesh.positions");

    let mut long = good();
    header(&mut long).mesh.as_mut().unwrap().facets = 7;
    assert_eq!(field(&refused(&mut client, long).await), "chunk.data");

    let mut unfinished = good();
    unfinished.pop();
    assert_eq!(field(&refused(&mut client, unfinished).await), "message");

    let headless = good().split_off(1);
    assert_eq!(field(&refused(&mut client, headless).await), "message");

    let mut unknown = good();
    header(&mut unknown).backend = 99;
    assert_eq!(field(&refused(&mut client, unknown).await), "header.backend");

    ask_rvd(&mut client, good()).await.expect("the server goes on");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn geometry_is_checked_and_the_element_is_named() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (mut points, mut facets) = octahedron();
    let seeds = spiral(5);

    points[3].y = f64::NAN;
    let status = refused(&mut client, rvd_request(&points, &facets, &seeds, BackendChoice::Auto, CELLS)).await;
    assert_eq!(field(&status), "mesh.positions[3]");
    let (points, _) = octahedron();

    facets[6][1] = 6;
    let status = refused(&mut client, rvd_request(&points, &facets, &seeds, BackendChoice::Auto, CELLS)).await;
    assert_eq!(field(&status), "mesh.facets[6][1]");
    let (_, facets) = octahedron();

    let status = refused(&mut client, rvd_request(&points, &[], &seeds, BackendChoice::Auto, CELLS)).await;
    assert_eq!(field(&status), "header.mesh.facets");
    let status = refused(&mut client, rvd_request(&points, &[[0, 0, 1]], &seeds, BackendChoice::Auto, CELLS)).await;
    assert_eq!(field(&status), "mesh.facets");

    let status = refused(&mut client, rvd_request(&points, &facets, &[], BackendChoice::Auto, CELLS)).await;
    assert_eq!(field(&status), "header.options.points");
    let bad = [DVec3::X, DVec3::new(0.0, f64::INFINITY, 0.0)];
    let status = refused(&mut client, rvd_request(&points, &facets, &bad, BackendChoice::Auto, CELLS)).await;
    assert_eq!(field(&status), "seeds[1]");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn counts_beyond_the_limits_are_refused_before_anything_is_sent() {
    let limits = Limits { max_seeds: 10, max_vertices: 100, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = server.client().await;
    let mut request = small_rvd(BackendChoice::Auto);
    request.truncate(1);
    assert_eq!(field(&refused(&mut client, request.clone()).await), "header.seeds");
    header(&mut request).mesh.as_mut().unwrap().vertices = 1 << 40;
    assert_eq!(field(&refused(&mut client, request).await), "header.mesh.vertices");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn memory_that_all_streams_share_runs_out_with_advice() {
    let limits = Limits { memory_bytes: 100, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let status = refused(&mut server.client().await, small_rvd(BackendChoice::Auto)).await;
    assert_eq!(status.code(), Code::ResourceExhausted);
    assert!(status.get_details_retry_info().is_some());
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_message_over_the_cap_is_resource_exhausted() {
    let server = Server::start(Setup::default()).await;
    let mut request = small_rvd(BackendChoice::Auto);
    first_chunk(&mut request, ArrayKind::Positions).data = vec![0; 5 << 20].into();
    let status = refused(&mut server.client().await, request).await;
    assert_eq!(status.code(), Code::ResourceExhausted, "{status:?}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_missing_gpu_is_a_failed_precondition() {
    let server = Server::start(Setup::default()).await;
    let status = refused(&mut server.client().await, small_rvd(BackendChoice::Gpu)).await;
    assert_eq!(status.code(), Code::FailedPrecondition);
    let violations = status.get_details_precondition_failure().unwrap().violations;
    assert_eq!(violations[0].subject, "gpu");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn malformed_protobuf_is_invalid() {
    use tonic::codegen::http::uri::PathAndQuery;
    let server = Server::start(Setup::default()).await;
    let mut grpc = tonic::client::Grpc::new(server.channel().await);
    grpc.ready().await.unwrap();
    // A Chunk where the header's field should be a message: field 1, length 3, an open group in it.
    let codec = tonic_prost::ProstCodec::<Bad, ComputeRvdResponse>::default();
    let path = PathAndQuery::from_static("/tessera.v1.RemeshService/ComputeRvd");
    let request = tonic::Request::new(tokio_stream::iter([Bad { header: vec![0xff, 0xff, 0xff] }]));
    let mut answers = grpc.streaming(request, path, codec).await.unwrap().into_inner();
    assert_eq!(answers.message().await.unwrap_err().code(), Code::InvalidArgument);
    server.stop().await.unwrap();
}

/// Bytes where `ComputeRvdRequest` has a message.
#[derive(Clone, PartialEq, prost::Message)]
struct Bad {
    #[prost(bytes = "vec", tag = "1")]
    header: Vec<u8>,
}

#[tokio::test(flavor = "multi_thread")]
async fn silence_and_deadlines_end_a_stream() {
    let limits = Limits { upload_idle: std::time::Duration::from_millis(100), ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = server.client().await;
    let (_send, stream) = by_hand::<ComputeRvdRequest>();
    let mut answers = client.compute_rvd(stream).await.unwrap().into_inner();
    assert_eq!(answers.message().await.unwrap_err().code(), Code::DeadlineExceeded);
    server.stop().await.unwrap();
}
