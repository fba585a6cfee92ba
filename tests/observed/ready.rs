//! Promise: the admin port, `tessera health` and `tessera info` say how a server is, also while it drains.

use std::process::{Command, Output};
use std::time::{Duration, Instant};

use tessera::mesh::shapes::Shape;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;

use crate::nobody::Nobody;
use crate::program::*;

fn tessera(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tessera")).args(arguments).output().unwrap()
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[tokio::test]
async fn a_server_that_is_well_says_so_everywhere() {
    let program = Program::start(&[], &[]);
    let url = format!("http://{}", program.address);
    // It begins to serve once the first probe has passed.
    let _served = program.channel().await;
    let start = Instant::now();
    while program.get("/readyz", "*/*").await.0 != 200 {
        assert!(start.elapsed() < PATIENCE, "it is not ready");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert_eq!(
        program.get("/readyz", "*/*").await,
        (200, "{\"ready\":true,\"reasons\":[],\"degraded\":[]}\n".to_owned())
    );
    assert_eq!(program.get("/healthz", "*/*").await, (200, "ok\n".to_owned()));
    assert!(program.get("/version", "*/*").await.1.contains(env!("CARGO_PKG_VERSION")));

    let health = tessera(&["health", "--endpoint", &url]);
    assert!(health.status.success() && said(&health) == "SERVING\n", "{health:?}");
    let health = tessera(&["health", "--endpoint", &url, "--service", "tessera.v1.JobService", "--json"]);
    let value: serde_json::Value = serde_json::from_slice(&health.stdout).unwrap();
    assert_eq!((value["service"].as_str(), value["status"].as_str()), (Some("tessera.v1.JobService"), Some("SERVING")));
    let unknown = tessera(&["health", "--endpoint", &url, "--service", "none"]);
    assert_eq!((unknown.status.code(), said(&unknown)), (Some(69), "SERVICE_UNKNOWN\n".to_owned()));

    let info = tessera(&["info", "--endpoint", &url, "--json"]);
    let value: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(value["version"].as_str(), Some(env!("CARGO_PKG_VERSION")));
    assert_eq!(value["readiness"]["ready"].as_bool(), Some(true));
    assert_eq!(value["limits"]["max_seeds"].as_u64(), Some(4_000_000));
    let info = said(&tessera(&["info", "--endpoint", &url]));
    assert!(info.contains("ready       yes") && info.contains("parallel"), "{info}");
    program.stop();
}

#[test]
fn a_server_that_is_not_there_is_said_to_be_away() {
    let nobody = Nobody::new();
    let url = nobody.url();
    for command in ["health", "info"] {
        let away = tessera(&[command, "--endpoint", &url, "--timeout-s", "2"]);
        assert_eq!(away.status.code(), Some(69), "{away:?}");
    }
    // One that takes connections and says nothing.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}", silent.local_addr().unwrap());
    let away = tessera(&["health", "--endpoint", &url, "--timeout-s", "0.5"]);
    assert_eq!(away.status.code(), Some(69), "{away:?}");
    assert!(String::from_utf8_lossy(&away.stderr).contains("0.5 s"), "{away:?}");
}

#[tokio::test]
async fn a_server_that_drains_says_so_until_it_ends() {
    let mut program = Program::start(&["--grace-s", "10"], &[]);
    let channel = program.channel().await;
    let mut health = HealthClient::new(channel.clone());
    let mut states = health.watch(HealthCheckRequest::default()).await.unwrap().into_inner();
    assert_eq!(states.message().await.unwrap().unwrap().status, 1);
    // Work that outlasts the grace.
    let digest = put(&channel, &Shape::Torus.build(30_000)).await;
    create(&channel, remesh(&digest, 60_000), &[]).await;
    let start = Instant::now();
    while program.metrics().await.get("tessera_jobs{state=\"running\",kind=\"remesh\"}") == 0.0 {
        assert!(start.elapsed() < PATIENCE, "the job does not begin");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    program.term();
    let told = tokio::time::timeout(PATIENCE, states.message()).await.unwrap().unwrap().unwrap();
    assert_eq!(told.status, 2);
    let (status, body) = program.get("/readyz", "*/*").await;
    assert_eq!((status, body.as_str()), (503, "{\"ready\":false,\"reasons\":[\"draining\"],\"degraded\":[]}\n"));
    assert_eq!(program.get("/healthz", "*/*").await.0, 200);
    assert_eq!(program.metrics().await.get("tessera_not_ready{reason=\"draining\"}"), 1.0);
    let start = Instant::now();
    while program.child.try_wait().unwrap().is_none() {
        assert!(start.elapsed() < PATIENCE, "it does not end");
        tokio::time::sleep(Duration::from_millis(10)).await;
    }
    assert!(tokio::net::TcpStream::connect(&program.admin).await.is_err(), "the admin port ends with the server");
}

#[tokio::test]
async fn clients_that_say_nothing_keep_no_operator_out() {
    let program = Program::start(&[], &[]);
    let mut silent = Vec::new();
    for _ in 0..28 {
        silent.push(tokio::net::TcpStream::connect(&program.admin).await.unwrap());
    }
    let start = Instant::now();
    assert_eq!(program.get("/healthz", "*/*").await.0, 200);
    assert!(start.elapsed() < 5 * SECOND);
    // More than there are places: the silent ones go after their time.
    for _ in 0..10 {
        silent.push(tokio::net::TcpStream::connect(&program.admin).await.unwrap());
    }
    let answer = tokio::time::timeout(PATIENCE, program.get("/healthz", "*/*"));
    assert_eq!(answer.await.expect("silent ones go").0, 200);
    drop(silent);
    program.stop();
}

#[test]
fn an_admin_port_that_others_reach_needs_a_word() {
    let refused = tessera(&["serve", "--listen", "127.0.0.1:0", "--ephemeral", "--admin-listen", "0.0.0.0:0"]);
    let error = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{error}");
    assert!(error.contains("--admin-listen") && error.contains("--admin-public"), "{error}");
}

#[tokio::test]
async fn readiness_is_asked_at_the_admin_port_too() {
    let program = Program::start(&[], &[]);
    let start = Instant::now();
    while !tessera(&["health", "--admin", &program.admin]).status.success() {
        assert!(start.elapsed() < PATIENCE, "it is not ready");
    }
    let told = tessera(&["health", "--admin", &program.admin]);
    assert_eq!((told.status.code(), &*told.stdout), (Some(0), &b"ready\n"[..]), "{told:?}");
    let json = tessera(&["health", "--admin", &program.admin, "--json"]);
    assert_eq!(String::from_utf8_lossy(&json.stdout), "{\"ready\":true,\"reasons\":[],\"degraded\":[]}\n");
    // The port of calls is no admin port; nor is one where nobody listens.
    let (address, admin) = (program.address.clone(), program.admin.clone());
    let wrong = tessera(&["health", "--admin", &address, "--timeout-s", "2"]);
    assert_eq!(wrong.status.code(), Some(69), "{wrong:?}");
    program.stop();
    let nobody = tessera(&["health", "--admin", &admin]);
    assert_eq!(nobody.status.code(), Some(69), "{nobody:?}");
    assert!(String::from_utf8_lossy(&nobody.stderr).contains("--admin-listen"), "{nobody:?}");
}
