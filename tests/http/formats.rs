//! Promise: every format goes in and comes out, packed by gzip or not, and says what it is; what would unpack to more than a
//! file of its size may is refused before there is room for it.

use std::io::Write as _;

use serde_json::{Value, json};
use server::http::OPENAPI;
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::io::{Format, decode, encode, encode_with_attributes};
use tessera::mesh::shapes::Shape;

use crate::client::{self, Answer, House, get, post};
use crate::torus;

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packer.write_all(bytes).unwrap();
    packer.finish().unwrap()
}

const REMESH: &str = "/v1/remesh?points=60&lloyd=1&newton=0&placement=centroids&measure=topology&seed=3";

#[tokio::test(flavor = "multi_thread")]
async fn every_format_comes_and_goes() {
    let house = House::open().await;
    let document: Value = serde_json::from_str(&OPENAPI).unwrap();
    let described = &document["paths"]["/v1/remesh"]["post"];
    let mesh = Shape::Torus.build(500);
    for format in Format::ALL {
        let (name, file) = (format.extension(), encode(format, &mesh).unwrap());
        let packed = gzip(&file);
        // What it is, the bytes say.
        let plain = post(&house, REMESH, &[], &file).await;
        assert_eq!(plain.status, 200, "{name}: {plain:?}");
        let media_type = plain.header("content-type").unwrap().to_owned();
        for part in ["/requestBody/content", "/responses/200/content"] {
            assert!(described.pointer(part).unwrap().get(&media_type).is_some(), "{media_type} is not in {part}");
        }
        let result = decode(format, &plain.body).unwrap();
        assert!((40..=100).contains(&result.positions().len()), "{name}: {}", result.positions().len());
        for (way, headers, body) in [
            (format!("{REMESH}&format={name}"), vec!["Content-Type: application/gzip".to_owned()], &packed),
            (
                REMESH.to_owned(),
                vec![format!("Content-Type: {media_type}"), "Content-Encoding: gzip".to_owned()],
                &packed,
            ),
            (REMESH.to_owned(), vec![], &packed),
        ] {
            let headers: Vec<&str> = headers.iter().map(String::as_str).collect();
            let same = post(&house, &way, &headers, body).await;
            assert_eq!((same.status, same.header("content-type")), (200, Some(&*media_type)), "{way}: {same:?}");
            assert!(same.body == plain.body, "{way}, {headers:?}: the bits differ");
        }
    }
    house.stop().await;
}

/// What a language border keeps from the table names the same formats.
#[test]
fn documents_and_fuzz_targets_name_every_format() {
    assert_eq!(OPENAPI.matches("\"meshb\"").count(), 4);
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &str| std::fs::read_to_string(root.join(path)).unwrap();
    let (formats, http, fuzz) = (read("docs/formats.md"), read("docs/http.md"), read("tests/fuzz/Cargo.toml"));
    for format in Format::ALL {
        let (name, media) = (format.extension(), format.media_types()[0]);
        assert!(formats.contains(&format!("`.{name}`")), ".{name} is not in docs/formats.md");
        assert!(
            http.contains(&format!("`{name}`")) && http.contains(&format!("`{media}`")),
            "{name}, {media}: docs/http.md"
        );
        let target = format!("tests/fuzz/targets/{name}.rs");
        assert!(root.join(&target).exists() && fuzz.contains(&format!("\"targets/{name}.rs\"")), "{target}");
    }
}

/// The status and the reason of a refusal.
fn refusal(answer: &Answer) -> (u16, String) {
    assert_eq!(answer.header("content-type"), Some("application/problem+json"), "{answer:?}");
    (answer.status, answer.json()["reason"].as_str().unwrap().to_owned())
}

/// The job is gone with the answer, and its report too.
#[tokio::test(flavor = "multi_thread")]
async fn warnings_come_with_the_answer() {
    let house = House::open().await;
    let mesh = Shape::Torus.build(500);
    let mut attributes = Attributes::new(&mesh);
    attributes.add_scalar(Scalar::new("height", vec![1.0; mesh.positions().len()])).unwrap();
    let (file, _) = encode_with_attributes(Format::Ply, &mesh, &attributes).unwrap();
    let kept = post(&house, REMESH, &[], &file).await;
    assert_eq!((kept.status, kept.header("tessera-warning")), (200, None));
    let lost = post(&house, &format!("{REMESH}&to=stl"), &[], &file).await;
    assert_eq!(lost.all("tessera-warning"), ["not_held: this format cannot hold: scalar height"], "{lost:?}");
    house.stop().await;
}

/// With as many headers as clients take, and a surface whose report is gone.
#[tokio::test(flavor = "multi_thread")]
async fn warnings_come_with_the_result_of_a_job() {
    let house = House::open().await;
    let plain = String::from_utf8(encode(Format::Vtp, &Shape::Torus.build(500)).unwrap()).unwrap();
    let file = |odd: usize| {
        let array =
            |k: usize| format!("<DataArray type=\"Float16\" Name=\"odd\u{e4}{k}\" format=\"ascii\">1</DataArray>");
        plain.replace("</PointData>", &((0..odd).map(array).collect::<String>() + "</PointData>"))
    };
    for odd in [1, 16, 17, 300] {
        let direct = post(&house, "/v1/remesh?points=60&format=vtp", &[], file(odd).as_bytes()).await;
        let mesh = post(&house, "/v1/blobs", &[], file(odd).as_bytes()).await.json()["digest"].clone();
        let spec = json!({ "mesh": mesh, "format": "vtp", "points": 60 });
        let path =
            post(&house, "/v1/jobs", &[], spec.to_string().as_bytes()).await.header("location").unwrap().to_owned();
        let _ = get(&house, &format!("{path}/events"), &[]).await;
        let result = format!("{path}/result");
        let fetched = get(&house, &result, &[]).await;
        for answer in [&direct, &fetched] {
            let all = answer.all("tessera-warning");
            assert_eq!((answer.status, all.len()), (200, odd.min(16)), "{answer:?}");
            assert!(all[0].starts_with("left_aside: left aside: ") && all[0].contains("odd\u{e4}0"), "{}", all[0]);
            let more = format!(" has {} more", odd - all.len() + 1);
            assert_eq!(all.last().unwrap().starts_with("more: the report of job "), odd > 16, "{all:?}");
            assert!(odd <= 16 || all.last().unwrap().ends_with(&more), "{all:?}");
        }
        assert_eq!(get(&house, &format!("{result}?name=report"), &[]).await.all("tessera-warning"), [""; 0]);

        let report = get(&house, &path, &[]).await.json()["results"]["report"].as_str().unwrap().parse().unwrap();
        let id = path.rsplit('/').next().unwrap();
        house.blobs.unpin(&format!("result:{id}")).await.unwrap();
        house.blobs.delete(report).await.unwrap();
        let without = get(&house, &result, &[]).await;
        assert_eq!((without.status, without.all("tessera-warning").len()), (200, 0), "{without:?}");
        assert!(without.body == fetched.body);
        assert_eq!(get(&house, &format!("{result}?name=report"), &[]).await.status, 404);
    }
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_unpacks_to_too_much_is_refused() {
    let house = House::open().await;
    let too_large = (413, "too_large".to_owned());
    let wrong = (400, "invalid_argument".to_owned());
    let bomb = gzip(&vec![b'\n'; 64 << 20]);
    let asked = format!("{REMESH}&format=obj");
    assert_eq!(refusal(&post(&house, &asked, &[], &bomb).await), too_large);
    assert_eq!(refusal(&post(&house, &asked, &["Content-Encoding: gzip"], &bomb).await), too_large);
    assert_eq!(refusal(&post(&house, "/v1/blobs", &["Content-Encoding: gzip"], &bomb).await), too_large);
    assert_eq!(client::post_chunked(&house, "/v1/blobs", &["Content-Encoding: gzip"], &bomb).await, 413);
    // As a blob it is bytes as any; no job is made of it.
    let stored = post(&house, "/v1/blobs", &[], &bomb).await.json();
    for format in Format::ALL.map(Format::extension) {
        let spec = format!("{{\"mesh\": {}, \"format\": \"{format}\", \"points\": 10}}", stored["digest"]);
        assert_eq!(refusal(&post(&house, "/v1/jobs", &[], spec.as_bytes()).await), too_large, "{format}");
    }
    let torus = encode(Format::Obj, &Shape::Torus.build(500)).unwrap();
    let packed = gzip(&torus);
    let cut = &packed[..packed.len() - 9];
    assert_eq!(refusal(&post(&house, &asked, &[], cut).await), wrong);
    assert_eq!(refusal(&post(&house, &asked, &["Content-Encoding: gzip"], cut).await), wrong);
    assert_eq!(refusal(&post(&house, &asked, &["Content-Encoding: gzip"], &torus).await), wrong);
    assert_eq!(refusal(&post(&house, &asked, &["Content-Encoding: br"], &torus).await), wrong);
    assert_eq!(refusal(&post(&house, "/v1/blobs", &["Content-Encoding: br"], &torus).await), wrong);
    assert_eq!(client::post_chunked(&house, "/v1/blobs", &["Content-Encoding: gzip"], &packed).await, 201);
    // A blob is what its encoding says, with that digest.
    let digest = jobs::blob::Digest::of(&torus).to_string();
    for path in ["/v1/blobs".to_owned(), format!("/v1/blobs?digest={digest}")] {
        let stored = post(&house, &path, &["Content-Encoding: gzip"], &packed).await;
        assert_eq!((stored.status, stored.json()["digest"].as_str()), (201, Some(&*digest)), "{stored:?}");
    }
    assert!(get(&house, &format!("/v1/blobs/{digest}"), &[]).await.body == torus);
    house.stop().await;
}

/// A form with these parts: name, further headers, content.
fn form(parts: &[(&str, &str, &[u8])]) -> Vec<u8> {
    let mut all = Vec::new();
    for (name, headers, content) in parts {
        all.extend_from_slice(format!("--edge\r\nContent-Disposition: form-data; {name}\r\n{headers}\r\n").as_bytes());
        all.extend_from_slice(content);
        all.extend_from_slice(b"\r\n");
    }
    all.extend_from_slice(b"--edge--\r\n");
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn a_form_is_its_one_file() {
    let house = House::open().await;
    let file = torus(40);
    let packed = gzip(&file);
    let media = "Content-Type: multipart/form-data; boundary=edge";
    let plain = post(&house, "/v1/remesh?points=200", &[], &file).await;
    assert_eq!(plain.status, 200, "{plain:?}");
    let named = "name=\"file\"; filename=\"a.obj\"";
    for (headers, content) in
        [("", &file), ("Content-Type: model/obj\r\n", &file), ("Content-Type: application/gzip\r\n", &packed)]
    {
        let answer = post(&house, "/v1/remesh?points=200", &[media], &form(&[(named, headers, content)])).await;
        assert_eq!(answer.status, 200, "{headers}: {answer:?}");
        assert!(answer.body == plain.body, "{headers}: another result");
    }
    let stored = post(&house, "/v1/blobs", &[media], &form(&[(named, "", &file)])).await;
    let raw = post(&house, "/v1/blobs", &[], &file).await;
    assert_eq!((stored.status, stored.json()["digest"].clone()), (201, raw.json()["digest"].clone()));
    let whole = form(&[(named, "", &file)]);
    let nothing = form(&[]);
    let two = form(&[(named, "", &file), ("name=\"other\"", "", b"1")]);
    let cut = &whole[..whole.len() / 2];
    for (what, media, body) in [
        ("no file", media, &nothing[..]),
        ("two parts", media, &two),
        ("cut", media, cut),
        ("no boundary", "Content-Type: multipart/form-data", &whole),
        ("another boundary", "Content-Type: multipart/form-data; boundary=other", &whole),
        ("another kind", "Content-Type: multipart/mixed; boundary=edge", &whole),
        ("no form", media, &file),
    ] {
        for path in ["/v1/remesh?points=200", "/v1/blobs"] {
            let answer = post(&house, path, &[media], body).await;
            assert_eq!(answer.status, 400, "{what} to {path}: {answer:?}");
        }
    }
    house.stop().await;
}
