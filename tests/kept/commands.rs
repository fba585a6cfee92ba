//! Promise: what the documents say of `tessera jobs` and `tessera blobs` holds against a real server.

use std::path::Path;
use std::process::{Command, Output};

use tessera::mesh::io::{Format, encode};
use tessera::mesh::shapes::Shape;

use super::program::*;

/// Runs the command with a server.
fn run(program: &Program, folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tessera"))
        .args(arguments)
        .env("TESSERA_ENDPOINT", format!("http://{}", program.address))
        .current_dir(folder)
        .output()
        .unwrap()
}

fn told(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap().trim().to_owned()
}

/// What the command prints where it succeeds.
fn good(program: &Program, folder: &Path, line: &str) -> String {
    let output = run(program, folder, &line.split(' ').collect::<Vec<_>>());
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    told(&output)
}

/// Its exit code, and what it says of it.
fn bad(program: &Program, folder: &Path, line: &str) -> (Option<i32>, String) {
    let output = run(program, folder, &line.split(' ').collect::<Vec<_>>());
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn jobs_from_a_shell() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let program = Program::start(&folder.join("data"), &["--jobs-at-once", "1"]);
    let mesh = Shape::Genus(3).build(3_000);
    std::fs::write(folder.join("genus3.obj"), encode(Format::Obj, &mesh).unwrap()).unwrap();
    let here = |line: &str| good(&program, folder, line);

    let estimate = here("jobs estimate remesh genus3.obj --points 300 --json");
    let estimate: serde_json::Value = serde_json::from_str(&estimate).unwrap();
    assert_eq!(estimate["fits"], true, "{estimate}");
    let job = here("jobs submit remesh genus3.obj --points 300 --seed 4 --label project=bridge --priority 3");
    assert!(job.len() == 32 && job.bytes().all(|b| b.is_ascii_hexdigit()), "{job}");
    here(&format!("jobs wait {job}"));
    here(&format!("jobs fetch {job} -o job.ply --report report.json"));
    here("remesh genus3.obj --points 300 --seed 4 --backend parallel --quiet -o here.ply");
    let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
    assert!(read("job.ply") == read("here.ply"), "the bytes of a run here");
    assert!(serde_json::from_slice::<serde_json::Value>(&read("report.json")).unwrap()["result"]["q_min"].is_number());
    let list = here("jobs list --label project=bridge");
    assert!(list.contains(&job) && list.contains("succeeded"), "{list}");
    assert!(!here("jobs list --state failed").contains(&job));
    assert!(here(&format!("jobs get {job}")).contains("succeeded"));
    let events = here(&format!("jobs watch {job} --after 5 --json"));
    let numbers: Vec<u64> = events
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["number"].as_u64().unwrap())
        .collect();
    assert!(numbers[0] == 6 && numbers.is_sorted(), "{numbers:?}");

    let again = "jobs submit remesh genus3.obj --points 200 --request-id nightly-7";
    assert_eq!(here(again), here(again), "the same id");
    let (code, words) = bad(&program, folder, "jobs submit remesh genus3.obj --points 201 --request-id nightly-7");
    assert_eq!(code, Some(65), "{words}");

    let digest = here("blobs put genus3.obj");
    here(&format!("blobs get {digest} -o copy.obj"));
    assert!(read("copy.obj") == read("genus3.obj"));
    assert!(here(&format!("blobs stat {digest}")).contains(&read("genus3.obj").len().to_string()));
    let cells = here(&format!("jobs submit rvd blob:{digest} --input-format obj --points 50"));
    here(&format!("jobs wait {cells}"));
    here(&format!("jobs fetch {cells} -o cells.ply"));
    assert!(read("cells.ply").starts_with(b"ply"));

    let slow = here("jobs submit remesh genus3.obj --points 50000");
    let (code, words) = bad(&program, folder, &format!("jobs delete {slow}"));
    assert_eq!(code, Some(70), "{words}");
    here(&format!("jobs cancel {slow}"));
    let (code, words) = bad(&program, folder, &format!("jobs wait {slow}"));
    assert!(code == Some(70) && words.contains("cancelled"), "{code:?} {words}");
    here(&format!("jobs delete {slow}"));
    let (code, _) = bad(&program, folder, &format!("jobs get {slow}"));
    assert_eq!(code, Some(66));
    let (code, words) = bad(&program, folder, &format!("jobs get {job} --tenant somebody"));
    assert_eq!(code, Some(66), "{words}");
    let (code, words) = bad(&program, folder, "jobs submit remesh genus3.obj --points 5000000");
    assert_eq!(code, Some(65), "{words}");
    // A list of sizes goes by the file's own vertices.
    let sizes: String = mesh.positions().iter().map(|p| format!("{}\n", if p.x > 0.0 { 0.05 } else { 0.1 })).collect();
    std::fs::write(folder.join("sizes.txt"), sizes).unwrap();
    let sized = here("jobs submit remesh genus3.obj --sizes sizes.txt");
    here(&format!("jobs wait {sized}"));
    here(&format!("jobs fetch {sized} -o sized.ply"));
    here("remesh genus3.obj --sizes sizes.txt --backend parallel --quiet -o sized-here.ply");
    assert!(read("sized.ply") == read("sized-here.ply"));
}
