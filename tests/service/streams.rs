//! Promise: every stream of the service does its work end to end, through a real client.

use crate::server::*;
use server::config::Limits;
use tessera::proto::*;
use tokio_stream::StreamExt;

#[tokio::test(flavor = "multi_thread")]
async fn compute_rvd_covers_the_surface() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (points, facets) = sphere(4);
    let seeds = spiral(300);
    let outputs = [RvdOutput::Cells, RvdOutput::Centroids, RvdOutput::Sums];
    for backend in [BackendChoice::Auto, BackendChoice::Serial] {
        let request = rvd_request(&points, &facets, &seeds, backend, &outputs);
        let answers = ask_rvd(&mut client, request).await.unwrap();
        use compute_rvd_response::Message as M;
        assert!(matches!(&answers[0], M::Accepted(a) if !a.backend.is_empty()));
        let Some(M::Done(done)) = answers.last() else { panic!("done comes last") };
        let (mut pieces, mut facet_met) = (0, vec![false; facets.len()]);
        let mut last = (0, 0);
        for cells in answers.iter().filter_map(|m| if let M::Cells(c) = m { Some(c) } else { None }) {
            let (f, s) = (u32s(&cells.facet), u32s(&cells.seed));
            assert_eq!(f.len(), cells.pieces as usize);
            assert_eq!(u32s(&cells.vertex_count).iter().sum::<u32>(), cells.vertices);
            assert_eq!(points_of(&cells.positions).len(), cells.vertices as usize);
            assert_eq!(u32s(&cells.opposite).len(), cells.vertices as usize);
            for (&f, &s) in f.iter().zip(&s) {
                assert!(pieces == 0 || (f, s) > last, "pieces come by facet and then by seed");
                last = (f, s);
                facet_met[f as usize] = true;
                pieces += 1;
            }
        }
        assert!(facet_met.iter().all(|met| *met));
        let figures = done.figures.unwrap();
        assert_eq!(figures.pairs, pieces);
        let chunks: Vec<Chunk> =
            answers.iter().filter_map(|m| if let M::Chunk(c) = m { Some(c.clone()) } else { None }).collect();
        let areas = f64s(&gather(&chunks, ArrayKind::Areas));
        assert!((areas.iter().sum::<f64>() - figures.area).abs() < 1e-9);
        assert!((figures.area - 12.5).abs() < 0.1, "nearly a sphere: {}", figures.area);
        let centroids = points_of(&gather(&chunks, ArrayKind::Centroids));
        assert!(centroids.iter().zip(&seeds).all(|(c, s)| (*c - *s).length() < 0.1));
        let report: serde_json::Value = serde_json::from_str(&done.report_json).unwrap();
        assert_eq!(report["backend"], done.backend.as_str());
        assert_eq!(report["rvd"]["pairs"], pieces);
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn remesh_gives_a_closed_surface_and_a_report() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (points, facets) = sphere(4);
    let seeds = spiral(200);
    let header = RemeshHeader {
        mesh: Some(mesh_header(&points, &facets)),
        seeds: seeds.len() as u64,
        options: Some(RemeshOptions {
            lloyd: Some(3),
            newton: Some(0),
            measure: Measure::Topology.into(),
            ..RemeshOptions::default()
        }),
        ..RemeshHeader::default()
    };
    let requests = remesh_request(header, &points, &facets, &seeds, Vec::new());
    let mut answers = client.remesh(tokio_stream::iter(requests)).await.unwrap().into_inner();
    let (mut chunks, mut iterations, mut stages, mut done) = (Vec::new(), Vec::new(), Vec::new(), None);
    while let Some(answer) = answers.message().await.unwrap() {
        use remesh_response::Message as M;
        match answer.message.unwrap() {
            M::Accepted(a) => assert_eq!(a.backend, "parallel"),
            M::Progress(p) => stages.push(p.stage),
            M::Iteration(it) => iterations.push(it),
            M::Chunk(chunk) => chunks.push(chunk),
            M::Done(d) => done = Some(d),
        }
    }
    let done = done.unwrap();
    assert_eq!(iterations.len(), 3);
    assert!(iterations.iter().all(|it| it.total == 3 && it.energy > 0.0));
    assert!(["queued", "prepare", "dual", "repair"].iter().all(|s| stages.iter().any(|t| t == s)), "{stages:?}");
    let vertices = points_of(&gather(&chunks, ArrayKind::Positions));
    let triangles = u32s(&gather(&chunks, ArrayKind::Facets));
    let vertex_seed = u32s(&gather(&chunks, ArrayKind::VertexSeeds));
    assert_eq!(vertices.len() as u64, done.vertices);
    assert_eq!(triangles.len() as u64, 3 * done.facets);
    assert_eq!(done.facets, 2 * done.vertices - 4, "closed, genus 0");
    assert_eq!(vertex_seed.len(), vertices.len());
    assert_eq!(points_of(&gather(&chunks, ArrayKind::Seeds)).len(), 200);
    let report: serde_json::Value = serde_json::from_str(&done.report_json).unwrap();
    assert_eq!(report["result"]["euler"], 2);
    assert_eq!(report["iterations"].as_array().unwrap().len(), 3);
    let timing = done.timing.unwrap();
    assert!(timing.compute_ms > 0.0 && timing.queue_ms >= 0.0);
    server.stop().await.unwrap();
}

/// Of a diagram and of a session.
#[tokio::test(flavor = "multi_thread")]
async fn points_are_percent_of_the_vertices() {
    let limits = Limits { max_seeds: 600, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = server.client().await;
    let (points, facets) = sphere(4);
    let half = (points.len() / 2) as u64;
    let diagram = |points_percent| {
        use compute_rvd_request::Message as Ask;
        let mut request = rvd_request(&points, &facets, &[], BackendChoice::Serial, &[RvdOutput::Centroids]);
        let Some(Ask::Header(header)) = &mut request[0].message else { panic!("no header") };
        header.options.as_mut().unwrap().points_percent = Some(points_percent);
        request
    };
    let answers = ask_rvd(&mut client, diagram(50.0)).await.unwrap();
    let Some(compute_rvd_response::Message::Done(done)) = answers.last() else { panic!("done comes last") };
    assert_eq!(done.seeds, half);
    let refused = ask_rvd(&mut client, diagram(1000.0)).await.unwrap_err();
    assert!(refused.message().contains("options.points come to"), "{refused:?}");

    use cvt_request::Message as Ask;
    let options = CvtOptions { points_percent: Some(50.0), ..CvtOptions::default() };
    let mesh = Some(mesh_header(&points, &facets));
    let header = Ask::Header(CvtHeader { mesh, options: Some(options), ..CvtHeader::default() });
    let chunks = all_chunks(&points, &facets, &[]).into_iter().map(Ask::Chunk);
    let rest = [Ask::Start(CvtStart {}), Ask::Finish(Finish {})];
    let all: Vec<_> = [header].into_iter().chain(chunks).chain(rest).map(cvt).collect();
    let mut answers = client.cvt(tokio_stream::iter(all)).await.unwrap().into_inner();
    let mut seeds = None;
    while let Some(answer) = answers.message().await.unwrap() {
        if let Some(cvt_response::Message::Done(done)) = answer.message {
            seeds = Some(done.seeds);
        }
    }
    assert_eq!(seeds, Some(half));
    server.stop().await.unwrap();
}

fn cvt(message: cvt_request::Message) -> CvtRequest {
    CvtRequest { message: Some(message) }
}

fn point(x: f64, y: f64, z: f64) -> Point {
    Point { x, y, z }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_steps_and_edits() {
    use cvt_request::Message as Ask;
    use cvt_response::Message as M;
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (points, facets) = sphere(3);
    let seeds = spiral(50);
    let (send, stream) = by_hand();
    let header = CvtHeader {
        mesh: Some(mesh_header(&points, &facets)),
        seeds: 50,
        options: Some(CvtOptions {
            max_seeds: Some(51),
            projection: Projection::Surface.into(),
            ..CvtOptions::default()
        }),
        ..CvtHeader::default()
    };
    send.send(cvt(Ask::Header(header))).await.unwrap();
    for chunk in all_chunks(&points, &facets, &seeds) {
        send.send(cvt(Ask::Chunk(chunk))).await.unwrap();
    }
    send.send(cvt(Ask::Start(CvtStart {}))).await.unwrap();
    let mut answers = client.cvt(stream).await.unwrap().into_inner();
    let mut next = async || answers.next().await.unwrap().unwrap().message.unwrap();
    assert!(matches!(next().await, M::Accepted(_)));

    let step = |iterations, seeds: SeedsWanted| {
        cvt(Ask::Step(CvtStep { iterations, seeds: seeds.into(), ..CvtStep::default() }))
    };
    send.send(step(3, SeedsWanted::Each)).await.unwrap();
    let mut energies = Vec::new();
    for index in 0..3 {
        let M::Iteration(it) = next().await else { panic!("an iteration") };
        assert_eq!((it.index, it.kind.as_str(), it.total), (index, "lloyd", 3));
        energies.push(it.energy);
        let M::Chunk(chunk) = next().await else { panic!("its seeds") };
        assert_eq!(points_of(&chunk.data).len(), 50);
    }
    assert!(energies[2] < energies[0], "{energies:?}");

    let edits = vec![
        SeedEdit { edit: Some(seed_edit::Edit::Add(point(0.0, 0.0, 1.1))) },
        SeedEdit { edit: Some(seed_edit::Edit::Move(MoveSeed { index: 50, to: Some(point(0.0, 0.1, 1.0)) })) },
    ];
    send.send(cvt(Ask::Edit(CvtEdit { edits, seeds: SeedsWanted::Last.into() }))).await.unwrap();
    assert!(matches!(next().await, M::Edited(CvtEdited { seeds: 51 })));
    let M::Chunk(chunk) = next().await else { panic!("the seeds") };
    assert!((points_of(&chunk.data)[50] - glam::dvec3(0.0, 0.1, 1.0)).length() < 1e-12);

    send.send(step(200, SeedsWanted::Never)).await.unwrap();
    for _ in 0..200 {
        assert!(matches!(next().await, M::Iteration(_)));
    }
    send.send(cvt(Ask::Finish(Finish {}))).await.unwrap();
    assert!(matches!(next().await, M::Chunk(_)));
    let M::Done(done) = next().await else { panic!("done") };
    assert_eq!((done.iterations, done.seeds), (203, 51));
    assert!(answers.next().await.is_none());

    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_beyond_its_room_ends_with_a_field_and_closing_ends_it_well() {
    use cvt_request::Message as Ask;
    use cvt_response::Message as M;
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (points, facets) = sphere(1);
    let open = || {
        let header = CvtHeader { mesh: Some(mesh_header(&points, &facets)), seeds: 10, ..CvtHeader::default() };
        let mut all = vec![cvt(Ask::Header(header))];
        all.extend(all_chunks(&points, &facets, &spiral(10)).into_iter().map(|c| cvt(Ask::Chunk(c))));
        all.push(cvt(Ask::Start(CvtStart {})));
        all
    };
    let mut all = open();
    let edits = vec![SeedEdit { edit: Some(seed_edit::Edit::Add(point(0.0, 0.0, 1.0))) }];
    all.push(cvt(Ask::Edit(CvtEdit { edits, seeds: 0 })));
    let mut answers = client.cvt(tokio_stream::iter(all)).await.unwrap().into_inner();
    assert!(matches!(answers.message().await.unwrap().unwrap().message, Some(M::Accepted(_))));
    assert_eq!(answers.message().await.unwrap_err().code(), tonic::Code::InvalidArgument);

    let mut answers = client.cvt(tokio_stream::iter(open())).await.unwrap().into_inner();
    let mut last = None;
    while let Some(answer) = answers.message().await.unwrap() {
        last = answer.message;
    }
    assert!(matches!(last, Some(M::Done(_))), "closing without finish ends the session as finish does");
    server.stop().await.unwrap();
}
