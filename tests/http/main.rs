//! Promise: a mesh sent by HTTP comes back as the library would give it; blobs, jobs, keys and refusals are those of the gRPC
//! service; what the OpenAPI document says is what is served.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/certificates.rs"]
#[allow(dead_code)]
mod certificates;
mod client;
mod formats;
mod hostile;
mod keys;

use std::sync::Arc;
use std::time::Duration;

use client::{Answer, House, ask, get, post};
use serde_json::{Value, json};
use server::http::{OPENAPI, ROUTES};
use server::keys::{KeyLimits, Role};
use tessera::mesh::io::{self, Format};
use tessera::{BackendChoice, BackendKind, RemeshOptions, Seeds, Token, TriMesh};
use transport::Tls;

/// A torus of so many facets, as a file.
fn torus(rings: u32) -> Vec<u8> {
    use std::f64::consts::TAU;
    let sides = rings / 2;
    let angle = |i: u32, of: u32| TAU * f64::from(i) / f64::from(of);
    let mut text = String::new();
    for i in 0..rings {
        for j in 0..sides {
            let (u, v) = (angle(i, rings), angle(j, sides));
            let r = 2.0 + 0.7 * v.cos();
            text += &format!("v {} {} {}\n", r * u.cos(), r * u.sin(), 0.7 * v.sin());
        }
    }
    let vertex = |i: u32, j: u32| 1 + (i % rings) * sides + j % sides;
    for i in 0..rings {
        for j in 0..sides {
            let (a, b, c, d) = (vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1));
            text += &format!("f {a} {b} {c}\nf {a} {c} {d}\n");
        }
    }
    text.into_bytes()
}

fn by_the_library(file: &[u8], points: usize, to: Format) -> Vec<u8> {
    let mesh: TriMesh = io::decode(Format::Obj, file).unwrap();
    let options = RemeshOptions::new(Seeds::Sample { points, seed: 0 });
    let backend = tessera::BackendOptions::new()
        .with_choice(BackendChoice::Only(BackendKind::Parallel))
        .with_threads(1)
        .open()
        .unwrap();
    let done = tessera::remesh(&mesh, &options, backend.as_ref(), &mut (), &Token::default()).unwrap();
    io::encode(to, &done.mesh).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mesh_comes_back_with_the_bits_of_the_library() {
    let house = House::open().await;
    let file = torus(40);
    let answer = post(&house, "/v1/remesh?points=300&to=ply", &[], &file).await;
    assert_eq!(answer.status, 200, "{answer:?}");
    assert_eq!(answer.header("content-type"), Some("application/x-ply"));
    assert!(answer.body == by_the_library(&file, 300, Format::Ply), "the bits differ");
    // Neither the format of the body nor that of the answer needs a word; both can have one of HTTP.
    let same = post(&house, "/v1/remesh?points=300", &["Content-Type: application/octet-stream"], &file).await;
    assert_eq!((same.status, same.header("content-type")), (200, Some("model/obj")));
    assert!(same.body == by_the_library(&file, 300, Format::Obj));
    let asked = post(&house, "/v1/remesh?points=300", &["Content-Type: model/obj", "Accept: model/stl"], &file).await;
    assert_eq!((asked.status, asked.header("content-type")), (200, Some("model/stl")));
    // What stays comes first, in its order.
    let path = "/v1/remesh?points=300&keep=sphere:1.4,0,0,0.4;sphere:-1.4,0,0,0.4&size_in=sphere:0,1,0,0.3=0.1&to=ply";
    let kept = post(&house, path, &[], &file).await;
    assert_eq!(kept.status, 200, "{kept:?}");
    let (given, kept) = (io::decode(Format::Obj, &file).unwrap(), io::decode(Format::Ply, &kept.body).unwrap());
    let mut left = given.positions().iter();
    let first = kept.positions().iter().take_while(|p| left.any(|q| q == *p)).count();
    assert!((4..200).contains(&first), "{first}");
    // Its jobs are gone.
    for _ in 0..200 {
        let jobs = get(&house, "/v1/jobs", &[]).await.json();
        if jobs["jobs"] == json!([]) {
            house.stop().await;
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("the jobs of requests stay");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_wrong_is_told_as_a_problem() {
    let house = House::open().await;
    let problem = |answer: &Answer| {
        assert_eq!(answer.header("content-type"), Some("application/problem+json"), "{answer:?}");
        let body = answer.json();
        assert_eq!(body["status"], answer.status, "{body}");
        for key in ["type", "title", "detail", "reason"] {
            assert!(body[key].is_string(), "{key}: {body}");
        }
        body
    };
    let file = torus(12);
    for (path, status, field) in [
        ("/v1/remesh?points=0", 400, "points"),
        ("/v1/remesh?points=70&gradation=-1", 400, "gradation"),
        ("/v1/remesh?points=70&crease_angle=200", 400, "crease_angle"),
        ("/v1/remesh?points=70&max_deviation=-1", 400, "max_deviation"),
        ("/v1/remesh?points=70&edge_length=1", 400, "edge_length"),
        ("/v1/remesh", 400, "points"),
        ("/v1/remesh?points=x", 400, "points"),
        ("/v1/remesh?point=7", 400, "point"),
        ("/v1/remesh?points=70&to=xyz", 400, "to"),
        ("/v1/remesh?points=70&keep=sphere:0,0,0,1;box:1", 400, "keep[1]"),
        ("/v1/remesh?points=70&size_in=steel", 400, "size_in[0]"),
        ("/v1/remesh?points=70&mirror=w%3D0.5", 400, "mirror"),
        ("/v1/remesh?points=70&periodic=translate:1,0,0;rotate:360,z", 400, "periodic[1]"),
        ("/v1/remesh?points=70&density=blue", 400, "density"),
        ("/v1/blobs?digest=abc", 400, "digest"),
    ] {
        let answer = post(&house, path, &[], &file).await;
        let body = problem(&answer);
        assert_eq!((answer.status, body["reason"].as_str()), (status, Some("invalid_argument")), "{path}: {body}");
        let named = body["field_violations"][0]["field"].as_str().unwrap();
        assert!(named.starts_with(field), "{path}: {body}");
    }
    let nonsense = post(&house, "/v1/remesh?points=70", &[], b"no mesh at all").await;
    assert_eq!(problem(&nonsense)["field_violations"][0]["field"], "format");
    let damaged = post(&house, "/v1/remesh?points=70&format=ply", &[], &file).await;
    assert_eq!((damaged.status, problem(&damaged)["status"].as_u64()), (400, Some(400)));
    let digest = "0".repeat(64);
    let missing = get(&house, &format!("/v1/blobs/{digest}"), &[]).await;
    assert_eq!((missing.status, problem(&missing)["reason"].as_str()), (404, Some("blob")));
    let missing = get(&house, &format!("/v1/jobs/{}", "0".repeat(32)), &[]).await;
    assert_eq!((missing.status, problem(&missing)["reason"].as_str()), (404, Some("job")));
    assert_eq!(problem(&get(&house, "/v1/nothing", &[]).await)["status"], 404);
    assert_eq!(get(&house, "/v1/remesh", &[]).await.status, 405);
    assert_eq!(post(&house, "/v1/jobs", &[], b"{").await.status, 400);
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn blobs_have_ranges_and_tags() {
    let house = House::open().await;
    let bytes: Vec<u8> = (0..3_000_000u32).map(|i| (i % 251) as u8).collect();
    let stored = post(&house, "/v1/blobs", &[], &bytes).await;
    assert_eq!(stored.status, 201, "{stored:?}");
    let digest = stored.json()["digest"].as_str().unwrap().to_owned();
    assert_eq!(stored.json()["size_bytes"], bytes.len());
    let path = stored.header("location").unwrap().to_owned();
    assert_eq!(path, format!("/v1/blobs/{digest}"));
    // Stored as it comes, since its digest is known; and again, since it is there.
    let other = [&bytes[..], b"!"].concat();
    let wrong = post(&house, &format!("/v1/blobs?digest={digest}"), &[], &other).await;
    assert_eq!(wrong.status, 400, "{wrong:?}");
    let other_digest = jobs::blob::Digest::of(&other).to_string();
    for _ in 0..2 {
        let stored = post(&house, &format!("/v1/blobs?digest={other_digest}"), &[], &other).await;
        assert_eq!((stored.status, stored.json()["digest"].as_str()), (201, Some(other_digest.as_str())));
    }
    assert!(get(&house, &format!("/v1/blobs/{other_digest}"), &[]).await.body == other);

    let tag = format!("\"{digest}\"");
    let all = get(&house, &path, &[]).await;
    assert_eq!((all.status, all.header("etag"), all.header("accept-ranges")), (200, Some(&*tag), Some("bytes")));
    assert!(all.body == bytes);
    let head = ask(&house, "HEAD", &path, &[], b"").await;
    assert_eq!((head.status, head.header("content-length"), head.body.len()), (200, Some("3000000"), 0));
    let part = get(&house, &path, &["Range: bytes=1000-1999"]).await;
    assert_eq!((part.status, part.header("content-range")), (206, Some("bytes 1000-1999/3000000")));
    assert_eq!(part.body, &bytes[1000..2000]);
    assert_eq!(get(&house, &path, &["Range: bytes=-10"]).await.body, &bytes[bytes.len() - 10..]);
    let nowhere = get(&house, &path, &["Range: bytes=3000000-"]).await;
    assert_eq!((nowhere.status, nowhere.header("content-range")), (416, Some("bytes */3000000")));
    let known = get(&house, &path, &[&format!("If-None-Match: {tag}")]).await;
    assert_eq!((known.status, known.body.len()), (304, 0));
    let changed = get(&house, &path, &["Range: bytes=0-9", "If-Range: \"other\""]).await;
    assert_eq!((changed.status, changed.body.len()), (200, bytes.len()));
    assert_eq!(ask(&house, "DELETE", &path, &[], b"").await.status, 204);
    assert_eq!(get(&house, &path, &[]).await.status, 404);
    house.stop().await;
}

/// A client that sends a blob again hears the answer, though the server needs no byte of it.
#[tokio::test(flavor = "multi_thread")]
async fn a_blob_that_is_stored_may_be_sent_again() {
    let house = House::open().await;
    let bytes: Vec<u8> = (0..6_000_000u32).map(|k| (k.wrapping_mul(k) >> 3) as u8).collect();
    let digest = post(&house, "/v1/blobs", &[], &bytes).await.json()["digest"].as_str().unwrap().to_owned();
    for _ in 0..3 {
        let again = post(&house, &format!("/v1/blobs?digest={digest}"), &[], &bytes).await;
        assert_eq!((again.status, again.json()["digest"].as_str()), (201, Some(&*digest)), "{again:?}");
    }
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_created_watched_and_read() {
    let house = House::open().await;
    let file = torus(40);
    let mesh = post(&house, "/v1/blobs", &[], &file).await.json()["digest"].clone();
    let spec = json!({ "mesh": mesh, "format": "obj", "to": "off", "points": 300, "labels": { "of": "test" } });
    let created = post(&house, "/v1/jobs", &["Content-Type: application/json"], spec.to_string().as_bytes()).await;
    assert_eq!(created.status, 201, "{created:?}");
    let path = created.header("location").unwrap().to_owned();
    // Until the job has ended.
    let watched = get(&house, &format!("{path}/events"), &[]).await;
    assert_eq!((watched.status, watched.header("content-type")), (200, Some("text/event-stream")));
    let events = watched.events();
    let numbers: Vec<u64> = events.iter().filter_map(|event| event.id).collect();
    assert!(numbers.is_sorted() && numbers.len() > 3, "{numbers:?}");
    let states: Vec<&Value> = events.iter().filter(|event| event.name == "state").map(|e| &e.data["state"]).collect();
    assert_eq!(states.last(), Some(&&json!("succeeded")), "{states:?}");
    assert!(events.iter().any(|event| event.name == "iteration" && event.data["energy"].is_number()));
    assert_eq!(events.last().unwrap().name, "end");
    // A watch goes on where another ended, and is over at the end.
    let last = *numbers.last().unwrap();
    let from = |number: u64| format!("Last-Event-ID: {number}");
    let rest = get(&house, &format!("{path}/events"), &[&from(last - 1)]).await.events();
    assert_eq!(rest[0].id, Some(last));
    assert_eq!(get(&house, &format!("{path}/events"), &[&from(last)]).await.status, 204);

    let job = get(&house, &path, &[]).await.json();
    assert_eq!((&job["state"], &job["spec"]["labels"]["of"]), (&json!("succeeded"), &json!("test")));
    let result = get(&house, &format!("{path}/result"), &[]).await;
    assert_eq!((result.status, result.header("content-type")), (200, Some("application/x-off")));
    assert!(result.body == by_the_library(&file, 300, Format::Off));
    assert_eq!(result.header("etag"), Some(&*format!("\"{}\"", job["results"]["mesh"].as_str().unwrap())));
    let part = get(&house, &format!("{path}/result"), &["Range: bytes=0-2"]).await;
    assert_eq!((part.status, &part.body[..]), (206, &b"OFF"[..]));
    let report = get(&house, &format!("{path}/result?name=report"), &[]).await;
    assert!(report.json()["result"].is_object(), "{:?}", report.json());
    assert_eq!(get(&house, &format!("{path}/result?name=none"), &[]).await.status, 400);
    let listed = get(&house, "/v1/jobs?label=of%3Dtest&states=succeeded", &[]).await.json();
    assert_eq!(listed["jobs"].as_array().unwrap().len(), 1);
    let cancelled = post(&house, &format!("{path}/cancel"), &[], b"").await;
    assert_eq!((cancelled.status, cancelled.json()["reason"].as_str()), (409, Some("JOB_STATE")));

    // The specification of a job, as it is told, makes the same job.
    let again = post(&house, "/v1/jobs", &[], job["spec"].to_string().as_bytes()).await;
    assert_eq!((again.status, &again.json()["spec"]), (201, &job["spec"]), "{again:?}");
    let other = again.header("location").unwrap().to_owned();
    let _ = get(&house, &format!("{other}/events"), &[]).await;
    assert_eq!(get(&house, &other, &[]).await.json()["results"]["mesh"], job["results"]["mesh"]);
    // Both ways of asking give the earlier one on request; the newest counts.
    let with = |mut body: Value, word: &str| {
        body["reuse"] = word.into();
        body.to_string()
    };
    for (body, earlier) in [(spec.clone(), &other), (job["spec"].clone(), &other)] {
        let reused = post(&house, "/v1/jobs", &[], with(body, "same_bits").as_bytes()).await;
        assert_eq!((reused.status, reused.header("location")), (200, Some(&**earlier)), "{reused:?}");
        assert_eq!(reused.json()["state"], "succeeded");
    }
    let counted = house.metrics.text(server::metrics::Format::Text);
    assert!(counted.contains("tessera_jobs_reused_total{kind=\"remesh\"} 2\n"), "{counted}");
    let never = post(&house, "/v1/jobs", &[], with(spec.clone(), "never").as_bytes()).await;
    assert_eq!(never.status, 201);
    for word in ["always", "unspecified", ""] {
        let refused = post(&house, "/v1/jobs", &[], with(spec.clone(), word).as_bytes()).await;
        assert_eq!(
            (refused.status, &refused.json()["field_violations"][0]["field"]),
            (400, &json!("reuse")),
            "{refused:?}"
        );
    }
    assert_eq!(post(&house, "/v1/remesh?points=9&reuse=same_bits", &[], &file).await.status, 400);
    for path in [path, other] {
        assert_eq!(ask(&house, "DELETE", &path, &[], b"").await.status, 204);
        assert_eq!(get(&house, &path, &[]).await.status, 404);
    }
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_seeds_of_a_job_at_work_are_shown() {
    let house = House::open().await;
    let file = torus(60);
    let mesh = post(&house, "/v1/blobs", &[], &file).await.json()["digest"].clone();
    let spec = json!({ "mesh": mesh, "format": "obj", "points": 500, "lloyd": 20, "newton": 20 });
    let created = post(&house, "/v1/jobs", &[], spec.to_string().as_bytes()).await;
    let path = created.header("location").unwrap().to_owned();
    let (mut after, mut shown) = (0, Vec::new());
    loop {
        let answer = get(&house, &format!("{path}/seeds?after={after}"), &[]).await;
        if answer.status == 204 {
            if answer.header("tessera-ended") == Some("true") {
                break;
            }
            continue;
        }
        assert_eq!((answer.status, answer.body.len()), (200, 500 * 24), "{answer:?}");
        let steps: u64 = answer.header("tessera-steps").unwrap().parse().unwrap();
        assert!(steps > after && steps <= 40);
        after = steps;
        shown.push(answer.body);
    }
    assert!(shown.len() > 1, "{}", shown.len());
    shown.dedup();
    assert!(shown.len() > 1, "the seeds move");
    // Who watches changes nothing.
    let watched = get(&house, &format!("{path}/result"), &[]).await;
    let again = post(&house, "/v1/jobs", &[], spec.to_string().as_bytes()).await;
    let other = again.header("location").unwrap().to_owned();
    let _ = get(&house, &format!("{other}/events"), &[]).await;
    assert!(get(&house, &format!("{other}/result"), &[]).await.body == watched.body && watched.status == 200);
    // There is none of what is not there, of others, or of what was not asked rightly.
    assert_eq!(get(&house, &format!("{path}/seeds"), &[]).await.header("tessera-ended"), Some("true"));
    assert_eq!(get(&house, &format!("{path}/seeds?after=x"), &[]).await.status, 400);
    assert_eq!(get(&house, &format!("{path}/seeds"), &["tessera-tenant: other"]).await.status, 404);
    assert_eq!(get(&house, "/v1/jobs/none/seeds", &[]).await.status, 400);
    house.stop().await;
}

#[cfg(feature = "ui")]
#[tokio::test(flavor = "multi_thread")]
async fn the_page_needs_no_key_and_lets_nothing_else_in() {
    let (house, _keys) = House::with_page().await;
    let page = get(&house, "/", &[]).await;
    assert_eq!((page.status, page.header("content-type")), (200, Some("text/html; charset=utf-8")));
    let policy = page.header("content-security-policy").unwrap();
    assert!(
        policy.starts_with("default-src 'none'") && !policy.contains("unsafe") && !policy.contains("http"),
        "{policy}"
    );
    // All that the page names is here, of the right type.
    let text = String::from_utf8(page.body.clone()).unwrap();
    let named: Vec<&str> = text.split('"').filter(|part| part.starts_with("/ui/") || part.starts_with("ui/")).collect();
    for name in named {
        let part = get(&house, &format!("/{}", name.trim_start_matches('/')), &[]).await;
        assert_eq!(part.status, 200, "{name}");
        assert_eq!(part.header("x-content-type-options"), Some("nosniff"));
        assert_ne!(part.header("content-type"), Some("application/octet-stream"), "{name}");
    }
    assert!(!text.contains("http://") && !text.contains("https://"), "{text}");
    let tag = format!("If-None-Match: {}", page.header("etag").unwrap());
    assert_eq!(get(&house, "/", &[&tag]).await.status, 304);
    for path in ["/ui/none.js", "/ui/..%2f..%2fCargo.toml", "/ui/%2e%2e/Cargo.toml", "/ui/../../Cargo.toml"] {
        assert!(matches!(get(&house, path, &[]).await.status, 401 | 404), "{path}");
    }
    assert_eq!(ask(&house, "POST", "/", &[], b"x").await.status, 405);
    assert_eq!(get(&house, "/v1/jobs", &[]).await.status, 401);
    house.stop().await;
}

#[cfg(feature = "ui")]
#[tokio::test(flavor = "multi_thread")]
async fn the_page_of_a_server_without_keys_uses_it() {
    let house = House::with_open_page().await;
    assert_eq!(get(&house, "/", &[]).await.status, 200);
    let (host, origin) = (format!("Host: {}", house.http), format!("Origin: http://{}", house.http));
    assert_eq!(post(&house, "/v1/blobs", &[&host, &origin], b"OFF").await.status, 201);
    assert_eq!(get(&house, "/", &["Host: evil.example"]).await.status, 403);
    let docs = get(&house, "/docs", &[]).await;
    assert_eq!((docs.status, docs.header("content-type")), (200, Some("text/html; charset=utf-8")));
    assert!(docs.header("content-security-policy").is_some_and(|policy| policy.starts_with("default-src 'none'")));
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_goes_away_ends_the_work() {
    let house = House::open().await;
    let file = torus(200);
    let mut stream = client::send(&house, "POST", "/v1/remesh?points=20000&lloyd=2000", &[], &file).await;
    let running = async |wanted: bool| {
        for _ in 0..3000 {
            let jobs = get(&house, "/v1/jobs?states=queued,running", &[]).await.json();
            if jobs["jobs"].as_array().unwrap().is_empty() != wanted {
                return;
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        panic!("{wanted}: not within a minute");
    };
    running(true).await;
    use tokio::io::AsyncWriteExt;
    stream.shutdown().await.unwrap();
    drop(stream);
    running(false).await;
    // Also while its job is created.
    for milliseconds in 0..40 {
        let stream = client::send(&house, "POST", "/v1/remesh?points=20000&lloyd=2000", &[], &file).await;
        tokio::time::sleep(Duration::from_millis(milliseconds)).await;
        drop(stream);
    }
    tokio::time::sleep(Duration::from_millis(500)).await;
    running(false).await;
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_server_says_how_it_is() {
    let (house, keys) = House::with_keys().await;
    for path in ["/healthz", "/readyz"] {
        assert_eq!(get(&house, path, &[]).await.status, 200, "{path} needs no key");
    }
    assert_eq!(get(&house, "/readyz", &[]).await.json()["ready"], true);
    assert_eq!(get(&house, "/v1/info", &[]).await.status, 401);
    let key = keys.add("reader", Role::Read, KeyLimits::default());
    house.reload().await;
    let info = get(&house, "/v1/info", &[&format!("Authorization: Bearer {}", key.reveal())]).await;
    assert_eq!((info.status, &info.json()["version"]), (200, &env!("CARGO_PKG_VERSION").into()));
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn requests_are_counted_and_http_2_is_spoken() {
    let house = House::open().await;
    assert_eq!(get(&house, "/v1/jobs", &[]).await.status, 200);
    assert_eq!(get(&house, "/v1/none", &[]).await.status, 404);
    assert_eq!(client::over_http2(&house, "/v1/openapi.json").await, (200, OPENAPI.as_bytes().to_vec()));
    let text = house.metrics.text(server::metrics::Format::Text);
    let count = |method: &str, route: &str, status: u16| {
        let labels = format!(
            "http_server_request_duration_seconds_count{{http_request_method=\"{method}\",http_route=\"{route}\",\
             http_response_status_code=\"{status}\"}} 1"
        );
        assert!(text.contains(&labels), "{labels} is not in {text}");
    };
    count("GET", "/v1/jobs", 200);
    count("_OTHER", "_OTHER", 404);
    count("GET", "/v1/openapi.json", 200);
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tls_is_that_of_the_service_with_http_1_too() {
    let folder = tempfile::tempdir().unwrap();
    let authority = certificates::Authority::new("us");
    let shown = authority.vouch(&["localhost"], certificates::Age::Good);
    let tls = Tls::load(certificates::files(folder.path(), &shown, None)).unwrap();
    let house = House::with_tls(Arc::new(tls)).await;
    let (agreed, text) = client::over_tls(&house, &authority.pem(), b"http/1.1", "/v1/jobs").await;
    assert_eq!(agreed.as_deref(), Some(&b"http/1.1"[..]));
    assert!(text.starts_with("HTTP/1.1 200 OK"), "{text}");
    let (agreed, _) = client::over_tls(&house, &authority.pem(), b"h2", "/v1/jobs").await;
    assert_eq!(agreed.as_deref(), Some(&b"h2"[..]));
    house.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_drains_says_so() {
    let house = Arc::new(House::open().await);
    let waiting = {
        let house = Arc::clone(&house);
        tokio::spawn(async move { post(&house, "/v1/remesh?points=2000&lloyd=100", &[], &torus(60)).await })
    };
    for _ in 0..500 {
        let jobs = get(&house, "/v1/jobs?states=running", &[]).await.json();
        if !jobs["jobs"].as_array().unwrap().is_empty() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    house.begin_stop();
    // What is at work may end.
    assert_eq!(waiting.await.unwrap().status, 200);
    Arc::into_inner(house).unwrap().stop().await;
}

#[test]
fn the_document_has_every_route_and_no_other() {
    let document: Value = serde_json::from_str(&OPENAPI).unwrap();
    assert_eq!(document["openapi"], "3.1.0");
    let served: Vec<(String, String)> =
        ROUTES.iter().map(|route| (route.path.to_owned(), route.method.to_ascii_lowercase())).collect();
    let mut described = Vec::new();
    let mut names = std::collections::BTreeSet::new();
    for (path, methods) in document["paths"].as_object().unwrap() {
        for (method, operation) in methods.as_object().unwrap() {
            described.push((path.clone(), method.clone()));
            assert!(names.insert(operation["operationId"].as_str().unwrap()), "{path}: an operationId of its own");
            for part in path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}')) {
                let parameters = operation["parameters"].as_array().unwrap();
                assert!(parameters.iter().any(|p| p["name"] == part && p["in"] == "path"), "{path}: {part}");
            }
        }
    }
    let (mut one, mut other) = (served, described);
    one.sort();
    other.sort();
    assert_eq!(one, other);
    references(&document, &document);
}

#[tokio::test(flavor = "multi_thread")]
async fn routes_read_the_parameters_of_the_document_and_no_other() {
    let house = House::open().await;
    let document: Value = serde_json::from_str(&OPENAPI).unwrap();
    for route in ROUTES {
        let operation = &document["paths"][route.path][route.method.to_ascii_lowercase()];
        let parameters = operation["parameters"].as_array().unwrap();
        assert!(parameters.iter().all(|one| one["description"].as_str().is_some_and(|text| text.ends_with('.'))));
        let place = route.path.replace("{id}", &"0".repeat(32)).replace("{digest}", &"0".repeat(64));
        let names = parameters.iter().filter(|one| one["in"] == "query").map(|one| one["name"].as_str().unwrap());
        let names: Vec<&str> = names.collect();
        for name in names.iter().chain(names.first().map(|_| &"other")) {
            let answer = ask(&house, route.method, &format!("{place}?{name}=0"), &[], b"").await;
            let is_refused = String::from_utf8_lossy(&answer.body).contains("is no option");
            assert_eq!(is_refused, *name == "other", "{} {name}: {answer:?}", route.path);
        }
    }
    house.stop().await;
}

/// Whatever is referred to is there.
fn references(document: &Value, part: &Value) {
    match part {
        Value::Object(object) => {
            if let Some(Value::String(to)) = object.get("$ref") {
                assert!(document.pointer(to.trim_start_matches('#')).is_some(), "{to}");
            }
            object.values().for_each(|value| references(document, value));
        }
        Value::Array(all) => all.iter().for_each(|value| references(document, value)),
        _ => {}
    }
}
