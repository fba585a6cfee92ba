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

fn header(points: u64, density: DensityOptions) -> RemeshHeader {
    let (vertices, facets) = surface();
    let sampled = SampledSeeds { points, random_seed: 1 };
    RemeshHeader {
        mesh: Some(mesh_header(&vertices, &facets)),
        seeds: Some(SeedSource { source: Some(seed_source::Source::Sampled(sampled)) }),
        lloyd_steps: Some(2),
        newton_steps: Some(0),
        measure: Measure::Topology.into(),
        density: Some(density),
        ..RemeshHeader::default()
    }
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

fn density(source: DensitySource) -> DensityOptions {
    DensityOptions { source: source.into(), ..DensityOptions::default() }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_source_makes_a_remesh() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let vertices = surface().0;

    for (source, name) in [
        (DensitySource::Unspecified, "uniform"),
        (DensitySource::Curvature, "curvature"),
        (DensitySource::FeatureSize, "lfs"),
    ] {
        let done = remesh(&mut client, header(300, density(source)), &[]).await.unwrap();
        let report: serde_json::Value = serde_json::from_str(&done.report_json).unwrap();
        assert_eq!((done.seeds, &report["density"]["source"]), (300, &name.into()));
    }

    let uniform = DensityOptions { edge_length: 0.2, ..DensityOptions::default() };
    let done = remesh(&mut client, header(0, uniform), &[]).await.unwrap();
    // 4π (2/√3) / 0.2² + 2, of a polyhedron.
    assert!((350..=366).contains(&done.seeds), "{}", done.seeds);

    let lengths: Vec<f64> = vertices.iter().map(|p| 0.15 + 0.05 * p.z).collect();
    let given = DensityOptions { edge_lengths: vertices.len() as u64, ..DensityOptions::default() };
    let done = remesh(&mut client, header(0, given), &lengths).await.unwrap();
    assert!(done.seeds > 500, "{}", done.seeds);
    let report: serde_json::Value = serde_json::from_str(&done.report_json).unwrap();
    assert_eq!(report["density"]["source"], "sizes");
    // With a number of points only the ratios count.
    let done = remesh(&mut client, header(200, given), &lengths).await.unwrap();
    assert_eq!(done.seeds, 200);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn wrong_densities_are_refused_by_field() {
    let limits = Limits { max_seeds: 1000, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = server.client().await;
    let vertices = surface().0.len() as u64;
    let none = DensityOptions::default();
    let cases = [
        (10, DensityOptions { source: 99, ..none }, "header.density.source"),
        (10, DensityOptions { edge_lengths: 5, ..none }, "header.density.edge_lengths"),
        (10, density(DensitySource::EdgeLengths), "header.density.edge_lengths"),
        (
            10,
            DensityOptions { edge_lengths: vertices, ..density(DensitySource::Curvature) },
            "header.density.edge_lengths",
        ),
        (10, density(DensitySource::Weights), "header.mesh.weights"),
        (10, DensityOptions { edge_length: 0.1, ..none }, "header.density.edge_length"),
        (0, DensityOptions { edge_length: -0.1, ..none }, "header.density.edge_length"),
        (0, DensityOptions { edge_length: f64::NAN, ..none }, "header.density.edge_length"),
        (10, DensityOptions { adaptivity: Some(2.0), ..none }, "header.density.adaptivity"),
        (10, DensityOptions { gradation: Some(0.0), ..none }, "header.density.gradation"),
        (0, none, "header.seeds.sampled.points"),
        (0, density(DensitySource::Curvature), "header.seeds.sampled.points"),
        // More than the server takes; known only once the surface is there.
        (0, DensityOptions { edge_length: 1e-9, ..none }, "header.density"),
    ];
    for (points, given, path) in cases {
        let status = remesh(&mut client, header(points, given), &[]).await.unwrap_err();
        assert_eq!(field(&status), path, "{given:?}: {status:?}");
    }
    let given = DensityOptions { edge_lengths: vertices, ..none };
    let mut lengths = vec![0.2; vertices as usize];
    lengths[11] = f64::NAN;
    let status = remesh(&mut client, header(0, given), &lengths).await.unwrap_err();
    assert_eq!(field(&status), "mesh.edge_lengths[11]");
    let status = remesh(&mut client, header(0, given), &lengths[..20]).await.unwrap_err();
    assert_eq!(field(&status), "mesh.edge_lengths");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_takes_a_density() {
    use cvt_request::Message as Ask;
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (vertices, facets) = surface();
    let sampled = SampledSeeds { points: 0, random_seed: 1 };
    let header = CvtHeader {
        mesh: Some(mesh_header(&vertices, &facets)),
        seeds: Some(SeedSource { source: Some(seed_source::Source::Sampled(sampled)) }),
        density: Some(DensityOptions { edge_length: 0.2, ..density(DensitySource::FeatureSize) }),
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
