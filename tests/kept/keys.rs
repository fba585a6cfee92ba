//! Promise: a server that wants keys is of use to those who have one, says the same to all others, shows nobody what is
//! another's, and writes no key anywhere.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tonic::{Code, Status};
use tonic_types::StatusExt;

use super::program::*;

const LIMIT: Duration = Duration::from_secs(300);

/// Runs the program.
fn tessera(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.args(line.split_whitespace()).env("TESSERA_DATA_DIR", folder).env("TESSERA_LOG", "trace").output().unwrap()
}

/// What it prints.
fn done(folder: &Path, line: &str) -> String {
    let output = tessera(folder, line);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{line}: {said}");
    String::from_utf8(output.stdout).unwrap()
}

fn add(folder: &Path, line: &str) -> String {
    done(folder, &format!("keys add {line}")).trim().to_owned()
}

/// What was said, without what names the thing itself.
fn without(name: &str, result: Result<String, Status>) -> String {
    let said = match result {
        Ok(said) => said,
        Err(status) => format!("{:?} {} {:?}", status.code(), status.message(), status.get_error_details()),
    };
    said.replace(name, "NAME")
}

#[test]
fn keys_are_made_listed_and_revoked_beside_the_server() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let key = add(at, "ci --role submit --expires 90d --rate 50 --in-flight 8 --bytes 1e9 --weight 2.5");
    assert!(key.starts_with("tsr_") && key.len() == 79, "{}", key.len());
    let list = done(at, "keys list");
    for word in ["ci", "submit", "ends 20", "rate 50", "in-flight 8", "bytes 1000000000", "weight 2.5", &key[4..14]] {
        assert!(list.contains(word), "{word}: {list}");
    }
    let json: serde_json::Value = serde_json::from_str(&done(at, "keys list --json")).unwrap();
    assert_eq!(
        (json[0]["name"].as_str(), json[0]["role"].as_str(), json[0]["rate"].as_u64()),
        (Some("ci"), Some("submit"), Some(50))
    );
    let kept = std::fs::read_to_string(at.join("keys.json")).unwrap();
    for shown in [&list, &kept, &json.to_string()] {
        assert!(!shown.contains(&key[15..]), "a key is shown once");
    }
    assert_eq!(std::fs::metadata(at.join("keys.json")).unwrap().permissions().mode() & 0o777, 0o600);
    for (line, code) in [
        ("keys add ci --role read", 2),
        ("keys add 7 --role read", 2),
        ("keys add a --role root", 2),
        ("keys add a --role read --expires 0s", 2),
        ("keys add a --role read --expires 0.9s", 2),
        ("keys add a --role read --rate 0", 2),
        ("keys add a --role read --weight 0", 2),
        ("keys add a", 2),
        ("keys revoke nobody", 66),
    ] {
        let output = tessera(at, line);
        assert_eq!(output.status.code(), Some(code), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    }
    let second: serde_json::Value = serde_json::from_str(&done(at, "keys add ci --role read --rotate --json")).unwrap();
    assert!(second["key"].as_str().unwrap().contains(second["id"].as_str().unwrap()));
    done(at, &format!("keys revoke {}", &key[4..14]));
    assert!(!done(at, "keys list").contains(&key[4..14]));
    done(at, "keys revoke ci");
    assert_eq!(done(at, "keys list"), "");
    // A key that nobody has seen is none.
    for options in ["", " --json"] {
        let full = std::fs::File::options().write(true).open("/dev/full").unwrap();
        let (reader, closed) = std::io::pipe().unwrap();
        drop(reader);
        for out in [Stdio::from(full), closed.into()] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
            let line = format!("keys add unseen --role read{options}");
            let made = command.args(line.split(' ')).env("TESSERA_DATA_DIR", at).stdout(out).status().unwrap();
            assert_eq!(made.code(), Some(74), "{line}");
            assert_eq!(done(at, "keys list"), "");
        }
    }
    std::fs::write(at.join("keys.json"), "{").unwrap();
    for line in ["keys list", "keys add a --role read"] {
        assert_eq!(tessera(at, line).status.code(), Some(65), "{line}");
    }
    let served = tessera(at, "serve --listen 127.0.0.1:0 --backend serial --require-keys");
    let said = String::from_utf8_lossy(&served.stderr);
    assert!(served.status.code() == Some(69) && said.contains("keys.json is damaged"), "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn another_s_job_and_blob_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let [alice, bob, eye, root] =
        ["alice --role submit", "bob --role submit", "eye --role read", "root --role admin"].map(|line| add(at, line));
    let program = Program::start(at, &["--require-keys"]);
    let client = program.client().await;
    let (mut alice, mut bob, mut root) = (client.with_key(&alice), client.with_key(&bob), client.with_key(&root));
    let mesh = Shape::Torus.build(500);
    let digest = alice.put_mesh(&mesh).await;
    let id = alice.submit(remesh(&digest, 50, 0)).await;
    let job = alice.end(&id, LIMIT).await;
    assert_eq!(job.state(), JobState::Succeeded, "{job:?}");
    let result = part(&job, "mesh");
    alice.read(&result).await;

    // Names that are, and names that never were, in the mouth of somebody else.
    let strange_job = format!("{}{}", if id.starts_with('0') { '1' } else { '0' }, &id[1..]);
    let strange_blob = hex(&[7; 32]);
    for (there, never) in [(&id, &strange_job)] {
        for step in 0..4 {
            let mut said = Vec::new();
            for name in [there, never] {
                let name = name.clone();
                let answer = match step {
                    0 => bob
                        .jobs
                        .get_job(bob.request(GetJobRequest { id: name.clone() }))
                        .await
                        .map(|_| "got".to_owned()),
                    1 => bob.cancel(&name).await.map(|_| "cancelled".to_owned()),
                    2 => bob.watch(&name, 0).await.map(|_| "watched".to_owned()),
                    _ => bob
                        .jobs
                        .delete_job(bob.request(DeleteJobRequest { id: name.clone() }))
                        .await
                        .map(|_| "gone".to_owned()),
                };
                said.push(without(&name, answer));
            }
            assert_eq!(said[0], said[1]);
            assert!(said[0].starts_with("NotFound"), "{}", said[0]);
        }
    }
    for there in [&digest, &result] {
        for step in 0..5 {
            let mut said = Vec::new();
            for name in [there, &strange_blob] {
                let named = name.clone();
                let answer = match step {
                    0 => bob
                        .blobs
                        .stat(bob.request(StatRequest { digest: named }))
                        .await
                        .map(|a| format!("{:?}", a.into_inner())),
                    1 => bob
                        .blobs
                        .delete(bob.request(DeleteRequest { digest: named }))
                        .await
                        .map(|_| "deleted".to_owned()),
                    2 => bob.create(remesh(&named, 50, 0), "").await.map(|_| "created".to_owned()),
                    3 => {
                        let question =
                            EstimateJobRequest { spec: Some(remesh(&named, 50, 0)), ..EstimateJobRequest::default() };
                        bob.jobs.estimate_job(bob.request(question)).await.map(|a| format!("{:?}", a.into_inner()))
                    }
                    _ => {
                        let missing = FindMissingRequest { digests: vec![named] };
                        bob.blobs.find_missing(bob.request(missing)).await.map(|a| format!("{:?}", a.into_inner()))
                    }
                };
                said.push(without(name, answer));
            }
            assert_eq!(said[0], said[1], "step {step}");
        }
    }
    assert!(bob.all().await.is_empty());
    alice.get(&id).await;
    // Who has the bytes has the blob, and jobs of its own.
    assert_eq!(bob.put_mesh(&mesh).await, digest);
    let own = bob.submit(remesh(&digest, 50, 0)).await;
    assert_eq!(bob.end(&own, LIMIT).await.state(), JobState::Succeeded);
    // Who may only read creates nothing.
    let mut eye = client.with_key(&eye);
    assert_eq!(eye.create(remesh(&digest, 50, 0), "").await.unwrap_err().code(), Code::PermissionDenied);
    assert!(eye.all().await.is_empty());
    // An administrator sees a tenant's jobs if he names it.
    assert!(root.all().await.is_empty());
    let mut of_alice = root.of("alice");
    assert_eq!(of_alice.all().await.len(), 1);
    assert_eq!(of_alice.get(&id).await.id, id);
    assert_eq!(alice.of("bob").create(remesh(&digest, 50, 0), "").await.unwrap_err().code(), Code::PermissionDenied);

    // All of it is so after a restart.
    drop((client, alice, bob, eye, root, of_alice));
    let mut program = program;
    assert_eq!(program.stop(), Some(0));
    let keys: Vec<String> = ["alice", "bob"].map(|name| add(at, &format!("{name} --role submit --rotate"))).into();
    let program = Program::start(at, &["--require-keys"]);
    let client = program.client().await;
    let (mut alice, mut bob) = (client.with_key(&keys[0]), client.with_key(&keys[1]));
    alice.read(&result).await;
    let stat = StatRequest { digest: digest.clone() };
    alice.blobs.stat(alice.request(stat.clone())).await.unwrap();
    bob.blobs.stat(bob.request(stat)).await.unwrap();
    assert_eq!(bob.watch(&id, 0).await.unwrap_err().code(), Code::NotFound);
}

#[tokio::test(flavor = "multi_thread")]
async fn no_key_is_written_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let data = at.join("data");
    let key = add(&data, "ci --role submit");
    let other = add(&data, "gone --role admin");
    done(&data, "keys revoke gone");
    let log = at.join("log");
    let program =
        Program::start_logging(&data, &["--require-keys"], "trace", Stdio::from(std::fs::File::create(&log).unwrap()));
    let client = program.client().await;
    let mesh = Shape::Torus.build(500);
    let mut ci = client.with_key(&key);
    let digest = ci.put_mesh(&mesh).await;
    let id = ci.submit(remesh(&digest, 50, 0)).await;
    ci.end(&id, LIMIT).await;
    let (begin, last) = key.split_at(key.len() - 1);
    let another = format!("{begin}{}", if last == "0" { "1" } else { "0" });
    for wrong in [other.as_str(), begin, &another, &key.replace("tsr", "xyz")] {
        let status = client.with_key(wrong).create(remesh(&digest, 50, 0), "").await.unwrap_err();
        assert_eq!(status.code(), Code::Unauthenticated);
        assert!(!status.message().contains(&wrong[20..40]));
    }
    // The command, with a file that others can read.
    let file = at.join("key");
    std::fs::write(&file, format!("{key}\n")).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o644)).unwrap();
    let list = format!("jobs list --endpoint http://{} --key-file {}", program.address, file.display());
    let output = tessera(&data, &list);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success() && String::from_utf8_lossy(&output.stdout).contains(&id), "{said}");
    assert!(said.contains("others can read the key"), "{said}");
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    let quiet = tessera(&data, &list);
    assert!(!String::from_utf8_lossy(&quiet.stderr).contains("others can read"));
    let without = tessera(&data, &format!("jobs list --endpoint http://{}", program.address));
    assert_eq!(without.status.code(), Some(69), "{}", String::from_utf8_lossy(&without.stderr));
    // A job with a key file, as remesh makes it.
    let input = at.join("torus.ply");
    std::fs::write(&input, tessera::mesh::io::encode(tessera::mesh::io::Format::Ply, &mesh).unwrap()).unwrap();
    let line = format!(
        "remesh {} -o {} --points 50 --endpoint http://{} --key-file {}",
        input.display(),
        at.join("out.ply").display(),
        program.address,
        file.display()
    );
    let remeshed = tessera(&data, &line);
    assert!(remeshed.status.success(), "{}", String::from_utf8_lossy(&remeshed.stderr));

    // Revoked while it is watched: the watch ends, and the words are those of every other refusal.
    let start = Instant::now();
    done(&data, "keys revoke ci");
    let status = loop {
        match ci.jobs.list_jobs(ci.request(ListJobsRequest::default())).await {
            Err(status) => break status,
            Ok(_) => assert!(start.elapsed() < Duration::from_secs(60), "a revoked key is seen"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    };
    assert_eq!(status.code(), Code::Unauthenticated);
    drop((client, ci));
    let mut program = program;
    assert_eq!(program.stop(), Some(0));
    let log = std::fs::read(&log).unwrap();
    let all: Vec<u8> = [&log[..], said.as_bytes(), &quiet.stderr, &without.stderr, &remeshed.stderr].concat();
    let text = String::from_utf8_lossy(&all);
    assert!(text.contains("TRACE"), "it was logged");
    for secret in [&key[15..], &other[15..], &key[15..40]] {
        assert!(!text.contains(secret), "a key is in a log");
    }
    for entry in std::fs::read_dir(&data).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            let bytes = std::fs::read(&path).unwrap();
            assert!(!bytes.windows(25).any(|part| part == &key.as_bytes()[15..40]), "a key is in {}", path.display());
        }
    }
}
