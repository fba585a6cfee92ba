//! Promise: quasi-Newton steps, creases, boundaries, placement and refinement go over the wire, and what is wrong with
//! them is refused with its field.

use crate::server::*;
use glam::DVec3;
use server::config::Limits;
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tonic::{Code, Status};
use tonic_types::StatusExt;

type Mesh = (Vec<DVec3>, Vec<[u32; 3]>);

/// What came back.
struct Answer {
    done: RemeshDone,
    report: serde_json::Value,
    kinds: Vec<String>,
    positions: Vec<DVec3>,
    facets: Vec<u32>,
    creases: Vec<[u32; 2]>,
}

fn options(points: u32) -> RemeshOptions {
    RemeshOptions {
        points: Some(points),
        seed: Some(1),
        lloyd: Some(2),
        newton: Some(4),
        measure: Measure::Topology.into(),
        ..RemeshOptions::default()
    }
}

fn of((points, facets): &Mesh, options: RemeshOptions) -> RemeshHeader {
    RemeshHeader { mesh: Some(mesh_header(points, facets)), options: Some(options), ..RemeshHeader::default() }
}

fn header(mesh: &Mesh, points: u32) -> RemeshHeader {
    of(mesh, options(points))
}

async fn remesh(
    client: &mut Client,
    mesh: &Mesh,
    header: RemeshHeader,
    creases: &[[u32; 2]],
) -> Result<Answer, Status> {
    let bytes: Vec<u8> = creases.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    let requests = remesh_request(header, &mesh.0, &mesh.1, &[], chunks(ArrayKind::Creases, &bytes));
    let mut answers = client.remesh(tokio_stream::iter(requests)).await?.into_inner();
    let (mut chunks, mut kinds, mut done) = (Vec::new(), Vec::new(), None);
    while let Some(answer) = answers.message().await? {
        match answer.message.unwrap() {
            remesh_response::Message::Chunk(chunk) => chunks.push(chunk),
            remesh_response::Message::Iteration(it) => kinds.push(it.kind),
            remesh_response::Message::Done(d) => done = Some(d),
            _ => {}
        }
    }
    let done = done.expect("done comes last");
    let creases = u32s(&gather(&chunks, ArrayKind::Creases));
    Ok(Answer {
        report: serde_json::from_str(&done.report_json).unwrap(),
        kinds,
        positions: points_of(&gather(&chunks, ArrayKind::Positions)),
        facets: u32s(&gather(&chunks, ArrayKind::Facets)),
        creases: creases.as_chunks::<2>().0.to_vec(),
        done,
    })
}

fn field(status: &Status) -> String {
    assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
    status.get_details_bad_request().expect("has details").field_violations[0].field.clone()
}

/// Lengths of the result's edges on curves.
fn length(answer: &Answer) -> f64 {
    answer.creases.iter().map(|&[a, b]| answer.positions[a as usize].distance(answer.positions[b as usize])).sum()
}

fn has_edge(answer: &Answer, edge: [u32; 2]) -> bool {
    answer.facets.chunks(3).any(|t| edge.iter().all(|v| t.contains(v)))
}

#[tokio::test(flavor = "multi_thread")]
async fn quasi_newton_steps_are_taken_and_reported() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let mesh = sphere(3);
    let all = remesh(&mut client, &mesh, header(&mesh, 60), &[]).await.unwrap();
    assert_eq!(all.kinds, ["lloyd", "lloyd", "lbfgs", "lbfgs", "lbfgs", "lbfgs"]);
    assert_eq!(all.report["iterations"].as_array().unwrap().len(), 6);
    assert!(all.creases.is_empty(), "a sphere has no curves");
    let none = of(&mesh, RemeshOptions { newton: Some(0), ..options(60) });
    assert_eq!(remesh(&mut client, &mesh, none, &[]).await.unwrap().kinds, ["lloyd", "lloyd"]);
    let many = of(&mesh, RemeshOptions { newton: Some(400), ..options(20) });
    let many = remesh(&mut client, &mesh, many, &[]).await.unwrap();
    assert!(many.done.converged && many.kinds.len() < 402, "{}", many.kinds.len());
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn creases_come_back_as_edges() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let mesh = Shape::Genus(0).build(800).into_parts();
    let box_edges: f64 = {
        let size = mesh.0.iter().fold(DVec3::ZERO, |m, &p| m.max(p));
        4.0 * (size.x + size.y + size.z)
    };
    let surface = RemeshOptions { placement: Placement::Surface.into(), ..options(200) };
    for angle in [None, Some(30.0), Some(89.0)] {
        let wish = of(&mesh, RemeshOptions { crease_angle: angle, ..surface.clone() });
        let out = remesh(&mut client, &mesh, wish, &[]).await.unwrap();
        assert_eq!(out.report["features"]["creases"], 12, "{angle:?}");
        assert_eq!(out.report["features"]["missing_segments"], 0);
        assert!(out.creases.iter().all(|&e| has_edge(&out, e)));
        // Straight creases, whole.
        assert!((length(&out) - box_edges).abs() < 1e-9, "{angle:?}: {} of {box_edges}", length(&out));
    }
    for angle in [Some(0.0), Some(91.0), Some(180.0)] {
        let wish = of(&mesh, RemeshOptions { crease_angle: angle, ..surface.clone() });
        let out = remesh(&mut client, &mesh, wish, &[]).await.unwrap();
        assert_eq!(out.report["features"]["creases"], 0, "{angle:?}");
        assert!(out.creases.is_empty());
    }
    for angle in [200.0, -1.0, f64::NAN, f64::INFINITY] {
        let wish = of(&mesh, RemeshOptions { crease_angle: Some(angle), ..surface.clone() });
        let status = remesh(&mut client, &mesh, wish, &[]).await.err().unwrap();
        assert_eq!(field(&status), "header.options.crease_angle", "{angle}");
    }
    server.stop().await.unwrap();
}

/// The line y = 1/2 of a flat square.
#[tokio::test(flavor = "multi_thread")]
async fn uploaded_creases_are_kept() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let mesh = Shape::Plane.build(800).into_parts();
    let on: Vec<u32> = (0..mesh.0.len() as u32).filter(|&v| mesh.0[v as usize].y == 0.5).collect();
    assert_eq!(on.len(), 21);
    let creases: Vec<[u32; 2]> = on.windows(2).map(|w| [w[0], w[1]]).collect();
    let (placement, boundaries) = (Placement::Surface.into(), BoundaryRule::Free.into());
    let plain = of(&mesh, RemeshOptions { placement, boundaries, ..options(150) });
    let with = |creases: u64| {
        let mesh = plain.mesh.clone().map(|mesh| MeshHeader { creases, ..mesh });
        RemeshHeader { mesh, ..plain.clone() }
    };
    let wish = with(creases.len() as u64);
    let out = remesh(&mut client, &mesh, wish.clone(), &creases).await.unwrap();
    assert_eq!(out.report["features"]["creases"], 1);
    assert!(out.creases.iter().flatten().all(|&v| (out.positions[v as usize].y - 0.5).abs() < 1e-12));
    assert!(out.creases.iter().all(|&e| has_edge(&out, e)));
    assert!((length(&out) - 1.0).abs() < 1e-9, "{}", length(&out));

    for (at, pair) in [(0, [0, 400]), (7, [3, 3]), (19, [0, u32::MAX])] {
        let mut wrong = creases.clone();
        wrong[at] = pair;
        let status = remesh(&mut client, &mesh, wish.clone(), &wrong).await.err().unwrap();
        assert_eq!(field(&status), format!("mesh.creases[{at}]"), "{status:?}");
    }
    let status = remesh(&mut client, &mesh, wish.clone(), &creases[..5]).await.err().unwrap();
    assert_eq!(field(&status), "mesh.creases");
    let status = remesh(&mut client, &mesh, plain.clone(), &creases).await.err().unwrap();
    assert_eq!(field(&status), "chunk.data", "{status:?}");
    let status = remesh(&mut client, &mesh, with(u64::MAX), &creases).await.err().unwrap();
    assert_eq!(field(&status), "header.mesh.creases");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn thin_parts_stay_or_are_even() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    // A ring whose tube is thinner than edges on one side.
    let (positions, facets) = Shape::Torus.build(3000).into_parts();
    let thinner = |p: DVec3| {
        let on = DVec3::new(p.x, p.y, 0.0).normalize();
        on + (0.1 + 0.9 * (0.5 + 0.5 * on.x).powi(2)) * (p - on)
    };
    let mesh = (positions.into_iter().map(thinner).collect(), facets);
    for (rule, rounds) in [(ThinRule::Unspecified, true), (ThinRule::Finer, true), (ThinRule::Even, false)] {
        let wish = of(&mesh, RemeshOptions { thin: rule.into(), ..options(600) });
        let out = remesh(&mut client, &mesh, wish, &[]).await.unwrap();
        assert_eq!(out.report["refine"]["closed_ball_rounds"].as_u64().unwrap() > 0, rounds, "{rule:?}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn boundaries_stay_or_are_free() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let mesh = Shape::Plane.build(800).into_parts();
    let area = |out: &Answer| -> f64 {
        let at = |v: u32| out.positions[v as usize];
        out.facets.chunks(3).map(|t| 0.5 * (at(t[1]) - at(t[0])).cross(at(t[2]) - at(t[0])).z).sum()
    };
    for (rule, least, most) in [
        (BoundaryRule::Unspecified, 1.0 - 1e-9, 1.0 + 1e-9),
        (BoundaryRule::Keep, 1.0 - 1e-9, 1.0 + 1e-9),
        (BoundaryRule::Free, 0.8, 0.97),
    ] {
        let placement = Placement::Surface.into();
        let wish = of(&mesh, RemeshOptions { boundaries: rule.into(), placement, ..options(150) });
        let out = remesh(&mut client, &mesh, wish, &[]).await.unwrap();
        assert!(area(&out) > least && area(&out) < most, "{rule:?}: {}", area(&out));
        assert_eq!(out.creases.is_empty(), rule == BoundaryRule::Free);
        assert_eq!(out.done.topology_changes, Vec::<String>::new());
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn placements_are_what_they_say() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let mesh = sphere(4);
    let mut radius = Vec::new();
    for placement in [Placement::Unspecified, Placement::Fitted, Placement::Surface, Placement::Centroids] {
        let wish = of(&mesh, RemeshOptions { placement: placement.into(), ..options(80) });
        let out = remesh(&mut client, &mesh, wish, &[]).await.unwrap();
        radius.push(out.positions.iter().map(|p| p.length()).sum::<f64>() / out.positions.len() as f64);
    }
    // Fitted vertices are outside of a sphere, centroids inside.
    assert_eq!(radius[0].to_bits(), radius[1].to_bits());
    assert!(radius[1] > radius[2] && radius[2] > radius[3], "{radius:?}");
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn refinement_adds_seeds() {
    let limits = Limits { max_seeds: 1000, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = server.client().await;
    let mesh = sphere(4);
    let wish = |tolerance, max_points| {
        let (max_deviation_length, max_points) = (Some(tolerance), Some(max_points));
        of(&mesh, RemeshOptions { max_deviation_length, max_points, ..options(50) })
    };
    let out = remesh(&mut client, &mesh, wish(0.02, 800), &[]).await.unwrap();
    let figures = &out.report["refine"];
    assert_eq!((&figures["ended"], &figures["out_of_tolerance"]), (&"reached".into(), &0.into()), "{figures}");
    assert_eq!(out.done.refinement_end(), RefinementEnd::Reached);
    assert!(out.done.seeds > 50 && out.done.seeds < 800, "{}", out.done.seeds);
    let full = remesh(&mut client, &mesh, wish(1e-4, 60), &[]).await.unwrap();
    assert_ne!(full.report["refine"]["ended"], "reached");
    assert!(full.done.seeds <= 60 && full.done.refinement_end() != RefinementEnd::Reached);
    let loose = remesh(&mut client, &mesh, wish(0.5, 60), &[]).await.unwrap();
    assert!(loose.done.seeds < 50 && loose.done.refinement_end() == RefinementEnd::Reached, "{}", loose.done.seeds);
    let plain = remesh(&mut client, &mesh, header(&mesh, 50), &[]).await.unwrap();
    assert_eq!(plain.done.refinement_end(), RefinementEnd::Unspecified);
    for tolerance in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let status = remesh(&mut client, &mesh, wish(tolerance, 60), &[]).await.err().unwrap();
        assert_eq!(field(&status), "header.options.max_deviation_length", "{tolerance}");
    }
    // 50 are asked for.
    for max_points in [0, 49, 1001, u32::MAX] {
        let status = remesh(&mut client, &mesh, wish(0.1, max_points), &[]).await.err().unwrap();
        assert_eq!(field(&status), "header.options.max_points", "{max_points}");
    }
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_choices_and_too_many_steps_are_refused_by_field() {
    let limits = Limits { max_iterations: 10, ..Limits::default() };
    let server = Server::start(Setup { limits, ..Setup::default() }).await;
    let mut client = server.client().await;
    let mesh = octahedron();
    let good = options(12);
    let (placement, max_deviation_length) = (Placement::Surface.into(), Some(0.1));
    for (wish, field_of) in [
        (RemeshOptions { placement: 99, ..good.clone() }, "placement"),
        (RemeshOptions { placement: -1, ..good.clone() }, "placement"),
        (RemeshOptions { boundaries: 99, ..good.clone() }, "boundaries"),
        (RemeshOptions { thin: 99, ..good.clone() }, "thin"),
        (RemeshOptions { measure: 99, ..good.clone() }, "measure"),
        (RemeshOptions { placement, max_deviation_length, ..good.clone() }, "max_deviation_length"),
        (RemeshOptions { newton: Some(11), ..good.clone() }, "newton"),
        (RemeshOptions { newton: Some(u32::MAX), ..good.clone() }, "newton"),
    ] {
        let (wish, path) = (of(&mesh, wish), format!("header.options.{field_of}"));
        let status = remesh(&mut client, &mesh, wish, &[]).await.err().unwrap();
        assert_eq!(field(&status), path, "{status:?}");
    }
    remesh(&mut client, &mesh, of(&mesh, good), &[]).await.expect("the server goes on");
    server.stop().await.unwrap();
}

/// Steps of a session; what was said of each, and how it ended.
async fn session(client: &mut Client, mesh: &Mesh, steps: &[CvtStep]) -> (Vec<Iteration>, Result<CvtDone, Status>) {
    use cvt_request::Message as Ask;
    let header = CvtHeader {
        mesh: Some(mesh_header(&mesh.0, &mesh.1)),
        options: Some(CvtOptions { points: Some(50), seed: Some(1), ..CvtOptions::default() }),
        ..CvtHeader::default()
    };
    let mut all = vec![Ask::Header(header)];
    all.extend(all_chunks(&mesh.0, &mesh.1, &[]).into_iter().map(Ask::Chunk));
    all.push(Ask::Start(CvtStart {}));
    all.extend(steps.iter().map(|&step| Ask::Step(step)));
    all.push(Ask::Finish(Finish {}));
    let requests: Vec<_> = all.into_iter().map(|m| CvtRequest { message: Some(m) }).collect();
    let mut answers = client.cvt(tokio_stream::iter(requests)).await.unwrap().into_inner();
    let mut iterations = Vec::new();
    loop {
        match answers.message().await {
            Ok(Some(answer)) => match answer.message.unwrap() {
                cvt_response::Message::Iteration(it) => iterations.push(it),
                cvt_response::Message::Done(done) => return (iterations, Ok(done)),
                _ => {}
            },
            Ok(None) => panic!("done comes last"),
            Err(status) => return (iterations, Err(status)),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_takes_quasi_newton_steps() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let mesh = sphere(3);
    let step = |kind: i32, iterations| CvtStep { iterations, kind, ..CvtStep::default() };
    let (lloyd, lbfgs) = (StepKind::Lloyd.into(), StepKind::Lbfgs.into());
    let (all, done) = session(&mut client, &mesh, &[step(0, 1), step(lbfgs, 6), step(lloyd, 1), step(lbfgs, 2)]).await;
    assert_eq!(done.unwrap().iterations, 10);
    let kinds: Vec<&str> = all.iter().map(|it| it.kind.as_str()).collect();
    let mut wanted = vec!["lbfgs"; 10];
    (wanted[0], wanted[7]) = ("lloyd", "lloyd");
    assert_eq!(kinds, wanted);
    for (k, pair) in all.windows(2).enumerate() {
        // Converged, a step of Lloyd's leaves the energy where it is to within rounding.
        assert!(
            pair[1].energy <= pair[0].energy * (1.0 + 1e-12),
            "step {k}: {} then {}",
            pair[0].energy,
            pair[1].energy
        );
        assert_eq!(pair[1].index, k as u64 + 1);
    }
    let (before, refused) = session(&mut client, &mesh, &[step(lbfgs, 2), step(99, 1)]).await;
    assert_eq!((before.len(), field(&refused.unwrap_err())), (2, "step.kind".to_owned()));
    server.stop().await.unwrap();
}
