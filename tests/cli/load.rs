//! Promise: a load says what the server counts, keeps its plan whatever the server does, finds a stall, and leaves nothing behind.

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::nobody::Nobody;
use crate::process::addresses_of;

/// How long a test waits for what has to come. A loaded machine is far from it; without an end nothing would come at all.
const PATIENCE: Duration = Duration::from_secs(60);

/// A server with an admin port. Killed when dropped.
struct Server {
    child: Child,
    endpoint: String,
    admin: String,
}

impl Server {
    fn start(options: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_tessera"))
            .args(["serve", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0"])
            .args(["--backend", "parallel", "--ephemeral"])
            .args(options)
            .env("TESSERA_LOG", "error")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let (address, admin) = addresses_of(&mut child);
        Self { child, endpoint: format!("http://{address}"), admin }
    }

    fn metrics(&self) -> String {
        format!("http://{}/metrics", self.admin)
    }

    /// Calls by method and status, as the server counts them.
    fn calls(&self) -> BTreeMap<(String, String), u64> {
        let mut stream = TcpStream::connect(&self.admin).unwrap();
        write!(stream, "GET /metrics HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n").unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).unwrap();
        let of = |line: &str| {
            let rest = line.strip_prefix("rpc_server_call_duration_seconds_count{")?;
            let mut labels = rest.split('"').skip(1).step_by(2).map(str::to_owned);
            Some(((labels.next()?, labels.next()?), rest.rsplit(' ').next()?.parse().ok()?))
        };
        text.lines().filter_map(of).collect()
    }

    /// Waits until it has answered calls of this kind.
    fn until_called(&self, method: &str) {
        let begin = Instant::now();
        while !self.calls().iter().any(|((name, _), count)| name.ends_with(method) && *count > 0) {
            assert!(begin.elapsed() < PATIENCE, "nobody calls {method}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// Whether any job is there.
    fn jobs(&self, tenant: &str) -> usize {
        let out = tessera(Path::new("."), &format!("jobs list --json --endpoint {} --tenant {tenant}", self.endpoint));
        let listed: Value = serde_json::from_slice(&out.stdout).unwrap();
        listed["jobs"].as_array().unwrap().len()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        signal(&self.child, "CONT");
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn signal(child: &Child, name: &str) {
    let _ = Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status();
}

fn command(folder: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.current_dir(folder).args(line.split_whitespace()).env_remove("TESSERA_ENDPOINT");
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn tessera(folder: &Path, line: &str) -> Output {
    command(folder, line).output().unwrap()
}

/// What a finished load wrote and printed, and its exit code.
struct Load {
    json: Value,
    said: String,
    told: String,
    code: Option<i32>,
}

impl Load {
    fn of(folder: &Path, out: &Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let (said, told) = (text(&out.stdout), text(&out.stderr));
        let json =
            std::fs::read_to_string(folder.join("out.json")).unwrap_or_else(|_| panic!("no report: {said}{told}"));
        Self { json: serde_json::from_str(&json).unwrap(), said, told, code: out.status.code() }
    }

    fn run(server: &Server, options: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let line = format!("load --json out.json --endpoint {} {options}", server.endpoint);
        Self::of(folder.path(), &tessera(folder.path(), &line))
    }

    fn calls(&self, what: &str) -> u64 {
        self.json["calls"][what].as_u64().unwrap_or_else(|| panic!("no {what}: {}", self.json["calls"]))
    }

    fn latency(&self, what: &str) -> f64 {
        self.json["latency_s"][what].as_f64().unwrap_or_else(|| panic!("no {what}: {}", self.json["latency_s"]))
    }
}

/// Surfaces that take a moment.
const SMALL: &str = "--facets 100..400 --points 10% --lloyd 1 --newton 0 --shape torus";

#[test]
fn counts_are_the_server_s_and_nothing_is_left() {
    let server = Server::start(&[]);
    let before = server.calls();
    let options = format!(
        "--clients 4 --duration-s 5 --warm-up-s 0.3 --ramp-s 0.3 --tenants 2 --tenant crowd --metrics {} {SMALL} \
         --mix remesh-job=3,rvd-job,remesh,rvd,cvt,info --fail-if errors>0,mismatches>0,rate<0.1 --plot out.png",
        server.metrics()
    );
    let load = Load::run(&server, &options);
    assert_eq!(load.code, Some(0), "{}{}", load.said, load.told);
    assert!(load.said.contains("equal to the server's") && load.told.is_empty(), "{}{}", load.said, load.told);
    let comparison = &load.json["comparison"];
    assert_eq!((&comparison["equal"], &comparison["unheard"]), (&true.into(), &0.into()), "{comparison}");
    assert_eq!(load.json["left"], 0);
    assert_eq!((server.jobs("crowd-0"), server.jobs("crowd-1")), (0, 0));
    // Read by somebody else, too.
    let after = server.calls();
    let mut methods = 0;
    for method in comparison["methods"].as_array().unwrap() {
        for count in method["counts"].as_array().unwrap() {
            let name = |value: &Value| value.as_str().unwrap().to_owned();
            let key = (name(&method["method"]), name(&count["status"]));
            // Calls outside of the load: the lists of jobs above, and the question before it what server this is.
            let own = match key.0.rsplit('/').next() {
                Some("ListJobs") => 2,
                Some("GetServerInfo") => 1,
                _ => 0,
            };
            let there = after[&key] - before.get(&key).copied().unwrap_or(0) - own;
            assert_eq!(count["here"].as_u64(), Some(there), "{key:?}");
            methods += 1;
        }
    }
    // Those of a job, at least; a slow machine comes to few others in this time.
    assert!(methods >= 5, "{comparison}");
    let [done, intended] = ["done", "intended"].map(|what| load.calls(what));
    assert!(done == intended && done > 0);
    assert!(load.json["kinds_s"]["remesh-job"]["count"].as_u64() > Some(0), "{}", load.json["kinds_s"]);
    for stage in ["upload", "queue", "compute", "download"] {
        assert!(load.json["stages_s"][stage]["p50"].is_f64(), "{}", load.json["stages_s"]);
    }
    assert_eq!(load.json["server"]["version"], env!("CARGO_PKG_VERSION"));
    let timeline = load.json["timeline"].as_array().unwrap();
    assert!(timeline.len() >= 2 && timeline.iter().any(|second| second["done"].as_u64() > Some(0)));
}

#[test]
fn the_plan_is_kept_and_the_same_seed_gives_the_same() {
    let server = Server::start(&[]);
    let run = |seed: u32| {
        let options = format!("--rate 80 --duration-s 2 --mix info --seed {seed} --metrics {}", server.metrics());
        let load = Load::run(&server, &options);
        assert_eq!(load.code, Some(0), "{}", load.told);
        assert_eq!(load.calls("errors"), 0);
        load
    };
    let loads = [run(1), run(1), run(2)];
    let sent = loads.each_ref().map(|load| load.calls("intended"));
    // 160 are to be expected, with a deviation of 12.6.
    assert!(sent.iter().all(|sent| (110..=210).contains(sent)), "{sent:?}");
    assert!(sent[0] == sent[1] && loads.iter().all(|load| load.calls("done") == load.calls("intended")));
    assert_eq!(loads[0].json["comparison"]["calls"], sent[0]);
}

#[test]
fn what_cannot_be_sent_is_dropped_and_counted() {
    let server = Server::start(&["--jobs-at-once", "1"]);
    let load = Load::run(
        &server,
        &format!(
            "--rate 200 --duration-s 1 --max-in-flight 2 --mix rvd --shape torus --facets 2000 --metrics {}",
            server.metrics()
        ),
    );
    let (dropped, done, intended) = (load.calls("dropped"), load.calls("done"), load.calls("intended"));
    assert!(dropped > 0 && done > 0 && dropped + done == intended, "{}", load.json["calls"]);
    assert_eq!(load.json["comparison"]["calls"], done, "what was dropped was not sent");
    assert!(load.said.contains("dropped"), "{}", load.said);
}

#[test]
fn thresholds_set_the_exit_code() {
    let server = Server::start(&[]);
    let load =
        Load::run(&server, "--clients 1 --duration-s 0.3 --mix info --fail-if p99>0us --fail-if errors>0,rate<0.1");
    assert_eq!(load.code, Some(79), "{}", load.told);
    assert!(load.told.contains("p99>0us: it is") && !load.told.contains("errors"), "{}", load.told);
    assert!(load.said.contains("crossed    p99>0us") && load.json["thresholds_crossed"].as_array().unwrap().len() == 1);
    let load = Load::run(&server, "--clients 1 --duration-s 0.3 --mix info --fail-if p99>1m,errors>0,rate<0.1 --quiet");
    assert!(load.code == Some(0) && load.said.is_empty() && load.told.is_empty(), "{}{}", load.said, load.told);
}

#[test]
fn what_is_cancelled_is_counted() {
    let server = Server::start(&["--jobs-at-once", "1"]);
    // Jobs and streams that would take far longer than a run. What is done first is what a cancellation is timed by.
    let line =
        "--clients 3 --duration-s 2 --cancel 100 --upload once --shape torus --facets 20000 --mix remesh-job,remesh";
    let load = Load::run(&server, &format!("{line} --metrics {}", server.metrics()));
    assert_eq!(load.code, Some(0), "{}", load.told);
    let cancelled = load.calls("cancelled");
    assert!(cancelled > 2 && load.calls("errors") == 0, "{}", load.said);
    assert_eq!(cancelled + load.calls("done"), load.calls("intended"));
    let comparison = &load.json["comparison"];
    assert!(comparison["equal"] == true && comparison["unheard"].as_u64() > Some(0), "{comparison}");
    assert_eq!(load.json["left"], 0, "{}", load.said);
    assert_eq!(server.jobs("load"), 0);
}

#[test]
fn a_refusal_is_no_error() {
    let server = Server::start(&["--max-streams", "1"]);
    let line = "--clients 4 --duration-s 1.5 --mix rvd --shape torus --facets 4000";
    let load = Load::run(&server, &format!("{line} --fail-if refused>1% --metrics {}", server.metrics()));
    let (refused, done) = (load.calls("refused"), load.calls("done"));
    assert!(refused > 0 && done > 0 && load.calls("errors") == 0, "{}", load.said);
    // Who is refused waits as long as the server says, which is a second.
    assert!(refused <= 3 * 3, "{refused}");
    assert_eq!(load.json["comparison"]["server_refusals"]["streams"], refused);
    assert_eq!(load.code, Some(79), "{}", load.told);
}

#[test]
fn a_stall_is_found() {
    let stall = |options: &str, stop: &dyn Fn(&Child) -> bool| {
        let server = Server::start(&[]);
        let folder = tempfile::tempdir().unwrap();
        let line = format!("load --json out.json --duration-s 4 --mix info --endpoint {} {options}", server.endpoint);
        let child = command(folder.path(), &line).spawn().unwrap();
        server.until_called("GetServerInfo");
        std::thread::sleep(Duration::from_millis(1000));
        let stalled = if stop(&child) { &server.child } else { &child };
        signal(stalled, "STOP");
        std::thread::sleep(Duration::from_millis(1000));
        signal(stalled, "CONT");
        Load::of(folder.path(), &child.wait_with_output().unwrap())
    };
    // A quarter of all calls were to begin in the stall, and waited for half of it in the mean.
    let open = stall("--rate 50", &|_| true);
    assert!(open.latency("p90") > 0.4 && open.latency("max") > 0.8, "{}", open.said);
    assert_eq!(open.calls("done"), open.calls("intended"), "{}", open.said);
    // One client saw it once.
    let closed = stall("--clients 1", &|_| true);
    assert!(closed.latency("p90") < 0.3 && closed.latency("max") > 0.8, "{}", closed.said);
    // Where the client itself stands still, its calls are late, and their latencies say so.
    let own = stall("--rate 50", &|_| false);
    assert!(own.calls("late") > 10 && own.latency("p90") > 0.4, "{}", own.said);
}

#[test]
fn slow_readers_take_their_time() {
    let server = Server::start(&[]);
    let line = format!("--clients 1 --duration-s 1 --mix rvd,info {SMALL} --slow-readers 2 --slow-rate 20000");
    let load = Load::run(&server, &line);
    let slow = &load.json["slow_readers"];
    assert!(slow["done"].as_u64() > Some(0) && slow["errors"] == 0, "{slow}");
    assert!(slow["latency_s"]["p50"].as_f64() > Some(0.2), "{slow}");
    assert!(load.calls("done") > slow["done"].as_u64().unwrap(), "{}", load.said);
}

#[test]
fn an_interrupt_ends_it_with_a_report_and_without_jobs() {
    let server = Server::start(&["--jobs-at-once", "1"]);
    let folder = tempfile::tempdir().unwrap();
    let line = "load --json out.json --clients 3 --duration-s 600 --shape torus --facets 30000";
    let child = command(folder.path(), &format!("{line} --endpoint {}", server.endpoint)).spawn().unwrap();
    server.until_called("CreateJob");
    std::thread::sleep(Duration::from_secs(1));
    let begin = Instant::now();
    signal(&child, "INT");
    let load = Load::of(folder.path(), &child.wait_with_output().unwrap());
    // Of the 600 s that it was to take.
    assert!(begin.elapsed() < PATIENCE, "{:?}", begin.elapsed());
    assert_eq!(load.code, Some(130), "{}", load.told);
    assert!(load.said.contains("stopped") && load.calls("stopped") > 0, "{}", load.said);
    assert_eq!((server.jobs("load"), &load.json["left"]), (0, &0.into()), "{}", load.said);
    // Jobs of no tenant are those of this address.
    let out = tessera(folder.path(), &format!("jobs list --json --endpoint {}", server.endpoint));
    assert!(serde_json::from_slice::<Value>(&out.stdout).unwrap()["jobs"].as_array().unwrap().is_empty());
}

#[test]
fn what_is_wrong_is_said_before_any_call() {
    let folder = tempfile::tempdir().unwrap();
    let nobody = Nobody::new();
    let away = format!("--endpoint {}", nobody.url());
    for (line, code, words) in [
        ("--duration-s 1", 2, "--clients"),
        ("--clients 1 --rate 1 --duration-s 1", 2, "cannot be used with"),
        ("--clients 0 --duration-s 1", 2, "whole number"),
        ("--rate 0 --duration-s 1", 2, "calls a second"),
        ("--rate inf --duration-s 1", 2, "calls a second"),
        ("--clients 1", 2, "--duration-s"),
        ("--clients 1 --duration-s nan", 2, "seconds"),
        ("--clients 1 --duration-s 1 --mix bake", 2, "no kind of call"),
        ("--clients 1 --duration-s 1 --facets 9..3", 2, "1000..20000"),
        ("--clients 1 --duration-s 1 --points 0.5", 2, "10%"),
        ("--clients 1 --duration-s 1 --fail-if p99", 2, "p99>2s"),
        ("--clients 1 --duration-s 1 --fail-if mismatches>0", 2, "--metrics"),
        ("--clients 1 --duration-s 1 --metrics 127.0.0.1:9090", 2, "http://"),
        ("--clients 1 --duration-s 1 --mix info --slow-readers 1", 2, "--slow-readers"),
        ("--clients 1 --duration-s 1 --cancel 101", 2, "0 to 100"),
        ("--clients 1 --duration-s 1 --plot x.jpg", 2, ".png"),
        ("--clients 1 --duration-s 1 --json none/x.json", 73, "there is no folder"),
        ("--clients 1 --duration-s 1 --mesh nowhere.ply", 66, "nowhere.ply"),
        ("--clients 1 --duration-s 1 --max-in-flight 5", 2, "cannot be used with"),
        ("--clients 1 --duration-s 1", 69, "cannot reach"),
    ] {
        let out = tessera(folder.path(), &format!("load {line} {away}"));
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(code) && said.contains(words), "{line}: {:?} {said}", out.status.code());
        assert!(out.stdout.is_empty(), "{line}");
    }
    let nobody = tessera(folder.path(), "load --clients 1 --duration-s 1");
    assert_eq!(nobody.status.code(), Some(2));
}

#[test]
fn a_server_that_goes_away_and_a_closed_pipe_end_nothing_badly() {
    let mut server = Server::start(&[]);
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let folder = tempfile::tempdir().unwrap();
    let line = format!("load --clients 2 --duration-s 0.5 --mix info --json out.json --endpoint {}", server.endpoint);
    let out = command(folder.path(), &line).stdout(writer).output().unwrap();
    let told = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success() && told.is_empty() && folder.path().join("out.json").exists(), "{told}");

    let line = format!(
        "load --clients 2 --duration-s 5 --warm-up-s 3 --mix info --json out.json --endpoint {}",
        server.endpoint
    );
    let child = command(folder.path(), &line).spawn().unwrap();
    // In the warm-up.
    server.until_called("GetServerInfo");
    std::thread::sleep(Duration::from_secs(1));
    server.child.kill().unwrap();
    let load = Load::of(folder.path(), &child.wait_with_output().unwrap());
    assert_eq!(load.code, Some(69), "{}{}", load.said, load.told);
    assert!(load.calls("done") == 0 && load.calls("errors") > 0 && load.calls("errors") < 40, "{}", load.said);
    assert!(load.told.contains("went away"), "{}", load.told);
}
