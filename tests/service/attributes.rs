//! Promise: what a surface carries goes through the service and comes back with the remesh; what is wrong with it is
//! refused and named.

use crate::server::*;
use glam::{DVec2, DVec3};
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals, PerCorner, Scalar};
use tessera::mesh::io::{read_with_attributes, write_with_attributes};
use tessera::mesh::numbers::NumberType;
use tessera::mesh::regions::Regions;
use tessera::proto::remesh_response::Message as Answer;
use tessera::proto::*;
use tonic::{Code, Status};
use tonic_types::StatusExt;

fn bytes(numbers: impl IntoIterator<Item = f64>) -> Vec<u8> {
    numbers.into_iter().flat_map(f64::to_le_bytes).collect()
}

fn header(kind: AttributeKind, name: &str, r#type: AttributeType, values: usize) -> AttributeHeader {
    let (kind, r#type, name) = (kind.into(), r#type.into(), name.to_owned());
    AttributeHeader { kind, name, r#type, values: values as u64, by_corner: false, components: 0, regions: Vec::new() }
}

fn scalar(attribute: u32, data: &[u8]) -> Vec<Chunk> {
    chunks(ArrayKind::Scalars, data).into_iter().map(|c| Chunk { attribute, ..c }).collect()
}

/// A whole Remesh request.
fn request(attributes: Vec<AttributeHeader>, arrays: Vec<Chunk>) -> Vec<RemeshRequest> {
    let (points, facets) = sphere(3);
    let seeds = spiral(100);
    let header = RemeshHeader {
        mesh: Some(MeshHeader { attributes, ..mesh_header(&points, &facets) }),
        seeds: seeds.len() as u64,
        options: Some(RemeshOptions {
            lloyd: Some(2),
            newton: Some(0),
            measure: Measure::Topology.into(),
            // Off the surface a linear field is not that of the place.
            placement: Placement::Surface.into(),
            ..RemeshOptions::default()
        }),
        ..RemeshHeader::default()
    };
    remesh_request(header, &points, &facets, &seeds, arrays)
}

async fn ask(client: &mut Client, requests: Vec<RemeshRequest>) -> Result<(Vec<Chunk>, RemeshDone), Status> {
    let mut answers = client.remesh(tokio_stream::iter(requests)).await?.into_inner();
    let mut chunks = Vec::new();
    while let Some(answer) = answers.message().await? {
        match answer.message.expect("no empty answers") {
            Answer::Chunk(chunk) => chunks.push(chunk),
            Answer::Done(done) => return Ok((chunks, done)),
            _ => {}
        }
    }
    panic!("the stream ended without its last message")
}

#[tokio::test(flavor = "multi_thread")]
async fn attributes_come_back_with_the_remesh() {
    let server = Server::start(Setup::default()).await;
    let (points, facets) = sphere(3);
    // Texture: x and y, a seam at z = 0.
    let below = |f: usize| facets[f].iter().map(|&v| points[v as usize].z).sum::<f64>() < 0.0;
    let shift = |f: usize| if below(f) { 10.0 } else { 0.0 };
    let uv: Vec<f64> = (0..facets.len())
        .flat_map(|f| facets[f].map(|v| (points[v as usize].x + shift(f), points[v as usize].y)))
        .flat_map(|(u, v)| [u, v])
        .collect();
    let corners: Vec<[u32; 3]> = (0..facets.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let headers = vec![
        header(AttributeKind::Scalar, "height", AttributeType::F32, points.len()),
        header(AttributeKind::TextureCoordinates, "", AttributeType::F64, 3 * facets.len()),
        header(AttributeKind::Colours, "", AttributeType::U8, points.len()),
        header(AttributeKind::Scalar, "east", AttributeType::F64, points.len()),
        header(AttributeKind::Normals, "", AttributeType::F64, points.len()),
    ];
    let single: Vec<u8> = points.iter().flat_map(|p| (p.z as f32).to_le_bytes()).collect();
    let mut arrays = scalar(3, &bytes(points.iter().map(|p| p.x)));
    arrays.extend(scalar(0, &single));
    arrays.extend(chunks(ArrayKind::TextureCoordinates, &bytes(uv)));
    arrays.extend(chunks(ArrayKind::TextureCorners, &facet_bytes(&corners)));
    let colour: Vec<u8> = points.iter().flat_map(|p| [if p.z > 0.0 { 200 } else { 100 }, 0, 255, 255]).collect();
    arrays.extend(chunks(ArrayKind::Colours, &colour));
    arrays.extend(chunks(ArrayKind::Normals, &point_bytes(&points)));

    let (got, done) = ask(&mut server.client().await, request(headers.clone(), arrays)).await.unwrap();
    let vertices = points_of(&gather(&got, ArrayKind::Positions));
    let kinds = |all: &[AttributeHeader]| all.iter().map(|h| (h.kind, h.name.clone())).collect::<Vec<_>>();
    assert_eq!(kinds(&done.attributes), kinds(&headers));
    assert_eq!(done.attributes[2].r#type(), AttributeType::U8);
    let of = |attribute: u32| got.iter().filter(|c| c.attribute == attribute).cloned().collect::<Vec<_>>();
    let (height, east) = (gather(&of(0), ArrayKind::Scalars), gather(&of(3), ArrayKind::Scalars));
    let colours = gather(&got, ArrayKind::Colours);
    let normals = points_of(&gather(&got, ArrayKind::Normals));
    assert_eq!(
        (f64s(&height).len(), colours.len(), normals.len()),
        (vertices.len(), 4 * vertices.len(), vertices.len())
    );
    for (i, p) in vertices.iter().enumerate() {
        // Single precision went in.
        assert!((f64s(&height)[i] - p.z).abs() < 1e-6 && (f64s(&east)[i] - p.x).abs() < 1e-12);
        assert!((100..=200).contains(&colours[4 * i]) && colours[4 * i + 1..4 * i + 4] == [0, 255, 255]);
        assert!(normals[i].dot(p.normalize()) > 0.99);
    }
    let uv = f64s(&gather(&got, ArrayKind::TextureCoordinates));
    let corners = u32s(&gather(&got, ArrayKind::TextureCorners));
    let new_facets = u32s(&gather(&got, ArrayKind::Facets));
    assert_eq!(uv.len(), 2 * done.attributes[1].values as usize);
    for (corner, vertex) in corners.as_chunks::<3>().0.iter().zip(new_facets.as_chunks::<3>().0) {
        let south = vertex.iter().map(|&v| vertices[v as usize].z).sum::<f64>() < 0.0;
        for (&c, &v) in corner.iter().zip(vertex) {
            let off = uv[2 * c as usize] - vertices[v as usize].x;
            // 1 where it is folded back beyond the equator.
            assert!((off - if south { 10.0 } else { 0.0 }).abs() < 1.0, "u is off by {off}");
        }
    }
    server.stop().await.unwrap();
}

/// Regions come with their names, and go with those that no facet has any more.
#[tokio::test(flavor = "multi_thread")]
async fn regions_come_back_with_their_names() {
    let server = Server::start(Setup::default()).await;
    let (points, facets) = sphere(3);
    let north = |f: usize| facets[f].iter().map(|&v| points[v as usize].z).sum::<f64>() > 0.0;
    let named = |number: i64, name: &str| Region { number, name: name.to_owned() };
    let regions = vec![named(7, "north"), named(9, "nowhere")];
    let header = AttributeHeader { regions, ..header(AttributeKind::Regions, "", AttributeType::I32, facets.len()) };
    let labels: Vec<u8> = (0..facets.len()).flat_map(|f| if north(f) { 7i32 } else { -2 }.to_le_bytes()).collect();
    let arrays = chunks(ArrayKind::Regions, &labels);
    let (got, done) = ask(&mut server.client().await, request(vec![header], arrays)).await.unwrap();
    let all = vec![named(7, "north"), named(9, "nowhere"), named(-2, "")];
    assert_eq!((done.attributes[0].regions.clone(), done.attributes[0].r#type()), (all, AttributeType::I64));
    let vertices = points_of(&gather(&got, ArrayKind::Positions));
    let new_facets = u32s(&gather(&got, ArrayKind::Facets));
    let labels = gather(&got, ArrayKind::Regions);
    let labels: Vec<i64> = labels.as_chunks::<8>().0.iter().map(|bytes| i64::from_le_bytes(*bytes)).collect();
    assert_eq!(3 * labels.len(), new_facets.len());
    let odd = labels.iter().zip(new_facets.as_chunks::<3>().0).filter(|(label, corners)| {
        let z = corners.iter().map(|&v| vertices[v as usize].z).sum::<f64>();
        (**label == 7) != (z > 0.0) && z.abs() > 0.3
    });
    assert_eq!(odd.count(), 0);
    server.stop().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_is_named() {
    let server = Server::start(Setup::default()).await;
    let mut client = server.client().await;
    let (points, facets) = sphere(3);
    let field = |status: Status| {
        assert_eq!(status.code(), Code::InvalidArgument, "{status:?}");
        status.get_details_bad_request().expect("has details").field_violations[0].field.clone()
    };
    let scalars = header(AttributeKind::Scalar, "a", AttributeType::F64, points.len());
    let texture = header(AttributeKind::TextureCoordinates, "", AttributeType::F64, 3);
    let both = vec![scalars.clone(), texture.clone()];
    let whole = scalar(0, &bytes(points.iter().map(|p| p.x)));
    let uv = chunks(ArrayKind::TextureCoordinates, &bytes([0.0; 6]));
    let corners = |last: u32| {
        let mut corners = vec![[0, 1, 2]; facets.len()];
        corners[5][1] = last;
        chunks(ArrayKind::TextureCorners, &facet_bytes(&corners))
    };
    let short = AttributeHeader { values: 7, ..scalars.clone() };
    assert_eq!(
        field(ask(&mut client, request(vec![short], vec![])).await.unwrap_err()),
        "header.mesh.attributes[0].values"
    );
    let twice = vec![texture.clone(), texture];
    assert_eq!(field(ask(&mut client, request(twice, vec![])).await.unwrap_err()), "header.mesh.attributes[1]");
    let missing = request(both.clone(), [uv.clone(), corners(2)].concat());
    assert_eq!(field(ask(&mut client, missing).await.unwrap_err()), "mesh.attributes[0].values");
    let missing = request(both.clone(), [whole.clone(), uv.clone()].concat());
    assert_eq!(field(ask(&mut client, missing).await.unwrap_err()), "mesh.attributes[1].corners");
    let far = request(both.clone(), [whole.clone(), uv.clone(), corners(3)].concat());
    assert_eq!(field(ask(&mut client, far).await.unwrap_err()), "mesh.attributes[1].corners[5][1]");
    let nan = scalar(0, &bytes(points.iter().enumerate().map(|(i, p)| if i == 9 { f64::NAN } else { p.x })));
    let nan = request(both.clone(), [nan, uv.clone(), corners(2)].concat());
    assert!(ask(&mut client, nan).await.is_ok(), "a gap in a scalar is none in the surface");
    let strange = request(both.clone(), scalar(1, &bytes([1.0])));
    assert_eq!(field(ask(&mut client, strange).await.unwrap_err()), "chunk.kind");
    let unannounced = request(vec![], whole.clone());
    assert_eq!(field(ask(&mut client, unannounced).await.unwrap_err()), "chunk.kind");
    ask(&mut client, request(both, [whole, uv, corners(2)].concat())).await.expect("the server goes on");
    server.stop().await.unwrap();
}

/// The program, here and through the service: the same file in the end.
#[tokio::test(flavor = "multi_thread")]
async fn the_program_carries_them_here_and_there() {
    let server = Server::start(Setup::default()).await;
    let (points, facets) = sphere(3);
    let mesh = TriMesh::new(points, facets).unwrap();
    let mut all = Attributes::new(&mesh);
    let values = mesh.facets().iter().flatten().map(|&v| mesh.positions()[v as usize]);
    let values = values.zip(0..).map(|(p, i)| DVec2::new(p.x, p.y + if i < 300 { 0.0 } else { 3.0 })).collect();
    let corners = (0..mesh.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    all.set_texture(PerCorner { values, corners }).unwrap();
    all.set_normals(Normals::PerVertex(mesh.positions().to_vec())).unwrap();
    let values = mesh.positions().iter().map(|p: &DVec3| [f64::from(u8::from(p.x > 0.0)), 0.2, 0.4, 1.0]).collect();
    all.set_colours(Colours { values, depth: ColourDepth::Eight }).unwrap();
    all.add_scalar(Scalar::new("height", mesh.positions().iter().map(|p| p.z).collect())).unwrap();
    let labels = mesh.positions().iter().map(|p| if p.x > 0.0 { 7.0 } else { -40.0 }).collect();
    all.add_scalar(Scalar { number: NumberType::I32, ..Scalar::new("label", labels) }).unwrap();
    let regions: Vec<i64> =
        (0..mesh.facets().len()).map(|f| if mesh.corners(f)[0].y > 0.0 { 3 } else { -11 }).collect();
    all.set_regions(Regions::of_numbers(&regions).unwrap()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    assert!(write_with_attributes(&path("in.ply"), &mesh, &all).unwrap().is_empty());
    let endpoint = format!("http://{}", server.address);
    let run = |output: &str, more: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_tessera"));
        command.arg("remesh").arg(path("in.ply")).arg("-o").arg(path(output));
        command.args(["--points", "200", "--lloyd", "2", "--placement", "surface", "--backend", "serial"]).args(more);
        let out = command.output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        String::from_utf8_lossy(&out.stderr).into_owned()
    };
    let (here, there) = tokio::task::block_in_place(|| {
        let options = ["--source-map", "--keep", "sphere:0,0,1,0.5", "--size-in", "sphere:0,0,-1,0.5=0.2"];
        assert!(!run("here.ply", &options).contains("cannot hold"));
        let there = run("there.ply", &[&["--endpoint", &endpoint], &options[..]].concat());
        assert!(!there.contains("left aside"), "{there}");
        let said = run("here.off", &[]);
        assert!(said.contains("cannot hold") && said.contains("scalar height"), "{said}");
        run("bare.ply", &["--no-attributes"]);
        assert!(read_with_attributes(&path("bare.ply")).unwrap().attributes.is_empty());
        (std::fs::read(path("here.ply")).unwrap(), std::fs::read(path("there.ply")).unwrap())
    });
    let loaded = read_with_attributes(&path("here.ply")).unwrap();
    assert!(loaded.attributes.texture().is_some() && loaded.attributes.normals().is_some());
    assert_eq!(loaded.attributes.colours().unwrap().depth, ColourDepth::Eight);
    for (value, p) in loaded.attributes.scalars()[0].values.iter().zip(loaded.mesh.positions()) {
        assert!((value - p.z).abs() < 1e-12);
    }
    // What stays has the bits that it had.
    let kept = loaded.mesh.positions().iter().take_while(|p| mesh.positions().contains(p)).count();
    assert!(kept > 20, "{kept}");
    let labels = &loaded.attributes.scalars()[1];
    assert!(labels.number == NumberType::I32 && labels.values.iter().all(|x| [7.0, -40.0].contains(x)));
    let regions = loaded.attributes.regions().unwrap();
    assert_eq!(regions.all().iter().map(|region| region.number).collect::<Vec<_>>(), [-11, 3]);
    assert!(loaded.attributes.scalars().iter().any(|scalar| scalar.name == "source_facet"));
    assert!(here == there, "the service gives another file");
    server.stop().await.unwrap();
}
