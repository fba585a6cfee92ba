//! Promise: densities go over the wire, and what is wrong with one is refused with its field.

use crate::server::*;
use server::config::Limits;
use tessera::proto::*;
use tonic::{Code, Status};
use tonic_types::StatusExt;

/// A sphere of 2048 facets.
fn surface() -> (Vec<glam::DVec3>, Vec<[u32; 3]>) {
    sphere(4)
}

fn header(points: impl Into<Option<u32>>, density: Density) -> RemeshHeader {
    let (vertices, facets) = surface();
    let options = RemeshOptions {
        points: points.into(),
        seed: Some(1),
        lloyd: Some(2),
        newton: Some(0),
        measure: Measure::Topology.into(),
        density: Some(density),
        ..RemeshOptions::default()
    };
    let mesh = Some(mesh_header(&vertices, &facets));
    RemeshHeader { mesh, options: Some(options), ..RemeshHeader::default() }
}

/// The same with edge lengths, as many as these.
fn with_lengths(count: u64, header: RemeshHeader) -> RemeshHeader {
    let mesh = header.mesh.map(|mesh| MeshHeader { edge_lengths: count, ..mesh });
    RemeshHeader { mesh, ..header }
}

async fn remesh(client: &mut Client, header: RemeshHeader, lengths: &[f64]) -> Result<RemeshDone, Status> {
    let (vertices, facets) = surface();
    let bytes: Vec<u8> = lengths.iter().flat_map(|h| h.to_le_bytes()).collect();
    let requests = remesh_request(header, &vertices, &facets, &[], chunks(ArrayKind::EdgeLengths, &bytes));
    let mut answers = client.remesh(tokio_stream::iter(requests)).await?.into_inner();
    while let Some(answer) = answers.message().await? {
        if let Some(remesh_response::Message::Done(done)) = answer.message {
            return Ok(done);
        }
    }
    panic!("done comes last");
}

fn field(status: &Status) -> String {
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    status.get_details_bad_request().expect("has details").field_violations[0].field.clone()
}

fn density(source: DensitySource) -> Density {
    Density { source: source.into(), ..Density::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_source_makes_a_remesh() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let vertices = surface().0;

    for (source, name) in
        [(DensitySource::Unspecified, "uniform"), (DensitySource::Curvature, "curvature"), (DensitySource::Lfs, "lfs")]
    {
        let done = remesh(&mut client, header(300, density(source)), &[]).await.unwrap();
        let report: serde_json::Value = serde_json::from_str(&done.report_json).unwrap();
        assert_eq!((done.seeds, &report["density"]["source"]), (300, &name.into()));
    }

    let uniform = Density { edge_length: Some(0.2), ..Density::default() };
    let done = remesh(&mut client, header(None, uniform), &[]).await.unwrap();
    // 4π (2/√3) / 0.2² + 2, of a polyhedron.
    assert!((350..=366).contains(&done.seeds), "{}", done.seeds);

    let lengths: Vec<f64> = vertices.iter().map(|p| 0.15 + 0.05 * p.z).collect();
    let given = |points: Option<u32>| with_lengths(vertices.len() as u64, header(points, Density::default()));
    let done = remesh(&mut client, given(None), &lengths).await.unwrap();
    assert!(done.seeds > 500, "{}", done.seeds);
    let report: serde_json::Value = serde_json::from_str(&done.report_json).unwrap();
    assert_eq!(report["density"]["source"], "sizes");
    // With a number of points only the ratios count.
    let done = remesh(&mut client, given(Some(200)), &lengths).await.unwrap();
    assert_eq!(done.seeds, 200);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn wrong_densities_are_refused_by_field() {
    let limits = Limits { max_seeds: 1000, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = server.client().await;
    let vertices = surface().0.len() as u64;
    let none = Density::default();
    let at = |field: &str| format!("header.options.{field}");
    for (points, given, path) in [
        (Some(10), Density { source: 99, ..none.clone() }, at("density.source")),
        (Some(10), density(DensitySource::EdgeLengths), at("density.source")),
        (Some(10), density(DensitySource::Weights), at("density.source")),
        (Some(10), Density { edge_length: Some(0.1), ..none.clone() }, at("density.edge_length")),
        (None, Density { edge_length: Some(-0.1), ..none.clone() }, at("density.edge_length")),
        (None, Density { edge_length: Some(f64::NAN), ..none.clone() }, at("density.edge_length")),
        (Some(10), Density { adaptivity: Some(2.0), ..none.clone() }, at("density.adaptivity")),
        (Some(10), Density { gradation: Some(0.0), ..none.clone() }, at("density.gradation")),
        (None, none.clone(), at("points")),
        (Some(0), none.clone(), at("points")),
        (None, density(DensitySource::Curvature), at("points")),
        // More than the server takes; known only once the surface is there.
        (None, Density { edge_length: Some(1e-9), ..none.clone() }, at("density")),
    ] {
        let status = remesh(&mut client, header(points, given.clone()), &[]).await.unwrap_err();
        assert_eq!(field(&status), path, "{given:?}: {status:?}");
    }
    let of = |count, given| with_lengths(count, header(10, given));
    for (header, path) in [
        (of(5, none.clone()), "header.mesh.edge_lengths"),
        (of(vertices, density(DensitySource::Curvature)), "header.options.density.source"),
    ] {
        let status = remesh(&mut client, header, &[]).await.unwrap_err();
        assert_eq!(field(&status), path, "{status:?}");
    }
    let given = || with_lengths(vertices, header(None, none.clone()));
    let mut lengths = vec![0.2; vertices as usize];
    lengths[11] = f64::NAN;
    let status = remesh(&mut client, given(), &lengths).await.unwrap_err();
    assert_eq!(field(&status), "mesh.edge_lengths[11]");
    let status = remesh(&mut client, given(), &lengths[..20]).await.unwrap_err();
    assert_eq!(field(&status), "mesh.edge_lengths");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_takes_a_density() {
    use cvt_request::Message as Ask;
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (vertices, facets) = surface();
    let density = Density { edge_length: Some(0.2), ..density(DensitySource::Lfs) };
    let header = CvtHeader {
        mesh: Some(mesh_header(&vertices, &facets)),
        options: Some(CvtOptions { seed: Some(1), density: Some(density), ..CvtOptions::default() }),
        ..CvtHeader::default()
    };
    let mut all = vec![Ask::Header(header)];
    all.extend(all_chunks(&vertices, &facets, &[]).into_iter().map(Ask::Chunk));
    all.extend([
        Ask::Start(CvtStart {}),
        Ask::Step(CvtStep { iterations: 2, ..CvtStep::default() }),
        Ask::Finish(Finish {}),
    ]);
    let requests: Vec<_> = all.into_iter().map(|m| CvtRequest { message: Some(m) }).collect();
    let mut answers = client.cvt(tokio_stream::iter(requests)).await.unwrap().into_inner();
    let mut done = None;
    while let Some(answer) = answers.message().await.unwrap() {
        if let Some(cvt_response::Message::Done(d)) = answer.message {
            done = Some(d);
        }
    }
    let done = done.unwrap();
    assert_eq!(done.iterations, 2);
    assert!((350..=366).contains(&done.seeds), "{}", done.seeds);
    server.stop().await.unwrap();
}
