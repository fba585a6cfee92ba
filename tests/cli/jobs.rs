//! Promise: jobs and blobs of a server can be scripted. What is printed is what was asked for, exit codes say what happened,
//! a lost connection is no end, and a server that lies is found out.

mod fake;
mod lies;
mod lost;

use std::process::{Command, Output, Stdio};

use serde_json::Value;
use tessera::mesh::io;
use tessera::proto::{
    self, ArrayForm, BackendChoice, DensitySource, JobState, Placement, job_mesh, job_spec, result_format,
};

use fake::{Fake, ID, digest, job, result};

/// A folder with a surface, a fake server, and what the program says of both.
struct Stage {
    folder: tempfile::TempDir,
    fake: Fake,
    endpoint: String,
    _runtime: tokio::runtime::Runtime,
}

/// What a command said: its code, standard output and standard error.
type Told = (Option<i32>, String, String);

impl Stage {
    fn new(fake: Fake) -> Self {
        let (runtime, address) = fake.serve();
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("in.off"), "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").unwrap();
        Self { folder, fake, endpoint: format!("http://{address}"), _runtime: runtime }
    }

    fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
        command.args(line.split_whitespace()).current_dir(self.folder.path());
        command.env("TESSERA_ENDPOINT", &self.endpoint).env("TESSERA_RETRY_S", "20").env_remove("TESSERA_TENANT");
        command.stdin(Stdio::null());
        command
    }

    fn tell(&self, line: &str) -> Told {
        let Output { status, stdout, stderr } = self.command(line).output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        let (said, told) = (text(stdout), text(stderr));
        for text in [&said, &told] {
            assert!(!text.contains(['\u{1b}', '\u{7}', '\u{202e}']) && !text.contains("panicked"), "{line}: {text:?}");
        }
        (status.code(), said, told)
    }

    /// What it prints, where nothing goes wrong.
    fn ok(&self, line: &str) -> String {
        let (code, said, told) = self.tell(line);
        assert_eq!(code, Some(0), "{line}: {told}");
        said
    }

    fn refused(&self, line: &str, code: i32, words: &str) {
        let (found, said, told) = self.tell(line);
        assert_eq!(found, Some(code), "{line}: {told}");
        assert!(told.contains(words), "{line}: {words:?} is not in {told}");
        assert!(said.is_empty(), "{line}: {said}");
    }
}

#[test]
fn wrong_options_are_wrong_usage() {
    let stage = Stage::new(Fake::default());
    let digest = digest(b"x");
    for (line, words) in [
        ("jobs submit remesh in.off", "--points"),
        ("jobs submit remesh in.off --points 9 -o out.ply", "unexpected argument '-o'"),
        ("jobs submit remesh in.off --points 9 --threads 2", "unexpected argument '--threads'"),
        ("jobs submit remesh in.off --points 9 --max-deviation 1 --max-points 5", "less than the 9 points at first"),
        ("jobs submit remesh in.off --points 9 --max-deviation 1 --placement surface", "for the placement fitted"),
        ("jobs submit remesh in.off --points 9 --adaptivity 2", "adaptivity"),
        ("jobs submit remesh in.xyz --points 9", "no known mesh format"),
        ("jobs submit remesh in.stl --points 9 --creases c.txt --creases strict", "no numbered vertices"),
        (&format!("jobs submit remesh blob:{digest} --points 9"), "--input-format"),
        ("jobs submit remesh blob:abc --points 9", "64 hexadecimal digits"),
        ("jobs submit remesh in.off --points 9 --label x", "KEY=VALUE"),
        ("jobs submit remesh in.off --points 9 --label a=1 --label a=2", "twice"),
        ("jobs submit remesh in.off --points 9 --priority 101", "-100..=100"),
        ("jobs submit remesh in.off --points 9 --deadline-s 0", "seconds"),
        ("jobs submit rvd in.off --points 9 --format obj", "ply"),
        ("jobs submit rvd in.off", "--seeds"),
        ("jobs submit rvd in.off --points 1e9%", "--points is 1000000000 %"),
        ("jobs submit rvd in.off --points 0%", "--points"),
        ("jobs get 12", "32 hexadecimal digits"),
        ("jobs list --state done", "possible values"),
        ("jobs list --limit 0", "whole number from 1"),
        (&format!("jobs fetch {ID}"), "--output"),
        (&format!("jobs --endpoint http://h:1 --ca in.off get {ID}"), "write https://h:1"),
        (&format!("jobs --tenant= get {ID}"), "a tenant has"),
        ("blobs get abc -o x", "64 hexadecimal digits"),
        (&format!("blobs get {digest}"), "--output"),
    ] {
        stage.refused(line, 2, words);
    }
    for line in [format!("jobs get {ID}"), "blobs put in.off".to_owned()] {
        let out = stage.command(&line).env_remove("TESSERA_ENDPOINT").output().unwrap();
        let told = String::from_utf8_lossy(&out.stderr).into_owned();
        assert!(out.status.code() == Some(2) && told.contains("which server?"), "{line}: {told}");
    }
    stage.refused("jobs submit remesh none.off --points 9", 66, "cannot read none.off");
    stage.refused("blobs put none", 66, "cannot read none");
    stage.refused("jobs submit remesh in.off --sizes none", 66, "cannot read none");
    stage.refused(&format!("jobs fetch {ID} -o none/out.ply"), 73, "there is no folder none");
    stage.refused(&format!("blobs get {digest} -o none/out"), 73, "there is no folder none");
    stage.refused(&format!("blobs get {digest} -o ."), 74, "cannot write .");
}

#[test]
fn nobody_there_is_said() {
    let stage = Stage::new(Fake::default());
    for line in [
        &format!("jobs get {ID}"),
        &format!("jobs wait {ID}"),
        &format!("jobs fetch {ID} -o out.ply"),
        "jobs submit remesh in.off --points 9",
        "blobs put in.off",
    ] {
        stage.refused(&format!("{line} --endpoint http://127.0.0.1:1"), 69, "cannot reach http://127.0.0.1:1");
    }
    assert!(!stage.folder.path().join("out.ply").exists());
}

#[test]
fn what_is_not_set_is_not_sent() {
    let stage = Stage::new(Fake::default());
    assert_eq!(stage.ok("jobs submit remesh in.off --points 9"), format!("{ID}\n"));
    let (request, tenant) = stage.fake.created();
    assert_eq!((request.request_id.as_str(), tenant), ("", None));
    let input = digest(&std::fs::read(stage.folder.path().join("in.off")).unwrap());
    let file = proto::MeshFile { digest: input.clone(), format: proto::MeshFormat::Off.into(), attributes: None };
    let options = proto::RemeshOptions { points: Some(9), ..Default::default() };
    let expected = proto::JobSpec {
        mesh: Some(proto::JobMesh { source: Some(job_mesh::Source::File(file)) }),
        work: Some(job_spec::Work::Remesh(options)),
        ..Default::default()
    };
    assert_eq!(request.spec, Some(expected));
    assert!(stage.fake.state().blobs.contains_key(&input));
    // What is stored is not sent again, and can be named.
    let writes = stage.fake.state().writes.len();
    stage.ok("jobs submit remesh in.off --points 9");
    stage.ok(&format!("jobs submit remesh blob:{input} --input-format off --points 9"));
    assert_eq!(stage.fake.state().writes.len(), writes);
}

#[test]
fn every_option_arrives() {
    let stage = Stage::new(Fake::default());
    let file = |name: &str, text: &str| std::fs::write(stage.folder.path().join(name), text).unwrap();
    file("sizes.txt", "1\n2\n3\n");
    file("creases.txt", "0 1\n");
    file("seeds.xyz", "0 0 0\n");
    file("kept.txt", "0\n");
    let line = "jobs submit remesh in.off --points 9 --sizes sizes.txt --creases creases.txt --gradation 0.3 --adaptivity 1 \
        --max-deviation 0.5 --max-points 20 --crease-angle 30 --boundaries keep --thin even --placement fitted --lloyd 5 \
        --newton 0 --projection surface --seed 0 --keep facets:@kept.txt --mirror -x \
        --periodic translate:1,0,0 --periodic rotate:-60,z --backend serial --no-attributes --format stl --request-id r1 --reuse same-bits --priority -3 \
        --deadline-s 1.5 --queue-deadline-s 60 --label team=a=b --label x= --tenant t1 --json";
    let told: Value = serde_json::from_str(&stage.ok(line)).unwrap();
    assert_eq!((&told["id"], &told["existed"]), (&ID.into(), &false.into()));
    assert_eq!((&told["state"], &told["labels"]["team"]), (&"queued".into(), &"a=b".into()));
    let (request, tenant) = stage.fake.created();
    assert_eq!((request.request_id.as_str(), tenant.as_deref()), ("r1", Some("t1")));
    assert_eq!((request.reuse(), &told["reused"]), (proto::ReusePolicy::SameBits, &false.into()));
    let spec = request.spec.unwrap();
    let Some(job_spec::Work::Remesh(work)) = &spec.work else { panic!("{spec:?}") };
    let density = work.density.as_ref().unwrap();
    let arrays = spec.arrays.clone().unwrap();
    let (edge_lengths, creases) = (arrays.edge_lengths.as_ref().unwrap(), arrays.creases.as_ref().unwrap());
    for (array, bytes) in [(edge_lengths, &b"1\n2\n3\n"[..]), (creases, b"0 1\n")] {
        assert_eq!((array.digest.clone(), array.form(), array.count), (digest(bytes), ArrayForm::Text, 0));
        assert!(stage.fake.state().blobs.contains_key(&array.digest));
    }
    assert_eq!(
        (density.adaptivity, density.gradation, density.source()),
        (Some(1.0), Some(0.3), DensitySource::Unspecified)
    );
    assert_eq!((work.lloyd, work.newton, work.crease_angle), (Some(5), Some(0), Some(30.0)));
    assert_eq!((work.projection(), work.placement()), (proto::Projection::Surface, Placement::Fitted));
    assert_eq!((work.boundaries(), work.thin()), (proto::BoundaryRule::Keep, proto::ThinRule::Even));
    assert_eq!((work.max_deviation, work.max_points), (Some(0.5), Some(20)));
    assert_eq!(work.keep, ["facets:0"]);
    assert_eq!(work.mirror.as_deref(), Some("-x"));
    assert_eq!(work.periodic, ["translate:1,0,0", "rotate:-60,z"]);
    let Some(job_mesh::Source::File(mesh)) = spec.mesh.clone().unwrap().source else { panic!("{spec:?}") };
    assert_eq!((mesh.attributes, spec.backend(), spec.priority), (Some(false), BackendChoice::Serial, Some(-3)));
    let form = Some(result_format::Form::File(proto::MeshFormat::Stl.into()));
    assert_eq!(spec.result, Some(proto::ResultFormat { form }));
    assert_eq!(spec.run_deadline, Some(prost_types::Duration { seconds: 1, nanos: 500_000_000 }));
    assert_eq!(spec.queue_deadline, Some(prost_types::Duration { seconds: 60, nanos: 0 }));
    assert_eq!(spec.labels.len(), 2);

    // Creases of several files are one text.
    file("more.txt", "1 2\n");
    stage.ok("jobs submit remesh in.off --points 9 --creases creases.txt --creases strict --creases more.txt");
    let spec = stage.fake.created().0.spec.unwrap();
    let Some(job_spec::Work::Remesh(work)) = &spec.work else { panic!("{spec:?}") };
    assert!(work.strict_creases);
    let creases = spec.arrays.unwrap().creases.unwrap();
    assert_eq!((creases.digest.clone(), creases.form()), (digest(b"0 1\n\n1 2\n"), ArrayForm::Text));

    file("metric.txt", "# text\n4 0 4 0 0 4\n4 0 4 0 0 0.25\n");
    stage.ok("jobs submit remesh in.off --metric metric.txt");
    let (request, _) = stage.fake.created();
    let metric = request.spec.unwrap().arrays.unwrap().metric.unwrap();
    assert_eq!((metric.form(), metric.count), (ArrayForm::Text, 0));
    assert_eq!(metric.digest, digest(b"4e0 0e0 4e0 0e0 0e0 4e0\n4e0 0e0 4e0 0e0 0e0 2.5e-1\n"));

    stage.ok("jobs submit rvd in.off --seeds seeds.xyz --outputs centroids,sums --format ply");
    let (request, _) = stage.fake.created();
    let spec = request.spec.unwrap();
    let Some(job_spec::Work::Rvd(work)) = &spec.work else { panic!("{spec:?}") };
    let seeds = spec.arrays.clone().unwrap().seeds.unwrap();
    assert_eq!((seeds.digest.clone(), seeds.form()), (digest(b"0 0 0\n"), ArrayForm::Text));
    assert_eq!(work.outputs, [2, 3]);
    for (points, wanted) in [("10k", (Some(10_000), None)), ("12.5%", (None, Some(12.5)))] {
        stage.ok(&format!("jobs submit rvd in.off --points {points} --seed 3"));
        let work = stage.fake.created().0.spec.unwrap().work;
        let Some(job_spec::Work::Rvd(work)) = work else { panic!("{work:?}") };
        assert_eq!(((work.points, work.points_percent), work.seed), (wanted, Some(3)), "{points}");
    }
}

/// A `.gltf` is sent with what the files beside it hold, packed or not.
#[test]
fn a_gltf_is_sent_with_its_buffers() {
    let stage = Stage::new(Fake::default());
    let numbers: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].iter().flat_map(|x| x.to_le_bytes()).collect();
    let text = r#"{"asset":{"version":"2.0"},"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],
        "scenes":[{"nodes":[0]}],"scene":0,"accessors":[{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}],
        "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"byteLength":36,"uri":"parts/a%20b.bin"}]}"#;
    let name = |name: &str| stage.folder.path().join(name);
    std::fs::create_dir(name("parts")).unwrap();
    std::fs::write(name("parts/a b.bin"), &numbers).unwrap();
    std::fs::write(name("one.gltf"), text).unwrap();
    std::fs::write(name("one.gltf.gz"), io::pack_for(&name("one.gltf.gz"), text.into()).unwrap()).unwrap();
    for file in ["one.gltf", "one.gltf.gz"] {
        stage.ok(&format!("jobs submit remesh {file} --points 9"));
        let spec = stage.fake.created().0.spec.unwrap();
        let Some(job_mesh::Source::File(mesh)) = spec.mesh.unwrap().source else { panic!("no file") };
        assert_eq!(mesh.format(), proto::MeshFormat::Gltf);
        let sent = stage.fake.state().blobs[&mesh.digest].clone();
        assert_eq!(io::decode(io::Format::Gltf, &sent).unwrap().area(), 0.5, "{file}");
    }
    std::fs::remove_file(name("parts/a b.bin")).unwrap();
    for command in ["submit", "estimate"] {
        stage.refused(&format!("jobs {command} remesh one.gltf --points 9"), 65, "parts/a");
    }
}

#[test]
fn an_estimate_uploads_nothing() {
    let stage = Stage::new(Fake::default());
    let told: Value = serde_json::from_str(&stage.ok("jobs estimate remesh in.off --points 9 --json")).unwrap();
    assert_eq!((&told["fits"], &told["host_bytes"]), (&true.into(), &300.into()));
    assert!(stage.ok("jobs estimate remesh in.off --points 9").contains("fits      yes"));
    let state = stage.fake.state();
    assert!(state.writes.is_empty());
    assert_eq!(state.estimated, Some((Some(3), Some(1))));
}

#[test]
fn exit_codes_say_how_a_job_ended() {
    let failure = proto::JobFailure { kind: 1, message: "\u{1b}[31mno\nsurface".to_owned() };
    let failed = proto::Job { failure: Some(failure), ..job(JobState::Failed) };
    let expired = proto::Job { expired_by: "run_deadline".to_owned(), ..job(JobState::Expired) };
    for (ended, code, words) in [
        (job(JobState::Succeeded), 0, ""),
        (failed, 70, "failed (bad input): \u{fffd}[31mno surface"),
        (job(JobState::Cancelled), 70, "was cancelled"),
        (expired, 70, "at work longer than its deadline"),
    ] {
        let state = ended.state();
        // As it is when it is waited for, and before.
        for before in [state, JobState::Queued] {
            let stage = Stage::new(Fake::ending(before, ended.clone()));
            let (found, said, told) = stage.tell(&format!("jobs wait {ID}"));
            assert!(found == Some(code) && told.contains(words) && said.is_empty(), "{state:?}: {found:?} {told}");
            assert_eq!(stage.tell(&format!("jobs watch {ID}")).0, Some(0), "{state:?}");
            let told: Value = serde_json::from_str(&stage.tell(&format!("jobs wait {ID} --json")).1).unwrap();
            assert_eq!(told["state"], state.as_str_name().trim_start_matches("JOB_STATE_").to_lowercase());
        }
    }
    let stage = Stage::new(Fake::default());
    for line in ["get", "wait", "watch", "cancel", "delete", "fetch -o out.ply"] {
        stage.refused(&format!("jobs {line} {ID}"), 66, "the server says: no such job");
    }
}

#[test]
fn events_are_a_line_each() {
    let stage = Stage::new(Fake::ending(JobState::Running, job(JobState::Succeeded)));
    let said = stage.ok(&format!("jobs watch {ID}"));
    assert!(said.lines().count() == 5 && said.contains("2026-11-05T08:00:00"), "{said}");
    assert!(said.contains("stage sample 1 of 3") && said.contains("step 1 of 35 lloyd, energy 1.5e0"), "{said}");
    let said = stage.ok(&format!("jobs watch {ID} --after 3 --json"));
    let all: Vec<Value> = said.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(all.iter().map(|event| event["number"].as_u64().unwrap()).collect::<Vec<_>>(), [4, 6]);
    assert_eq!((&all[0]["iteration"]["energy"], &all[1]["state"]), (&1.5.into(), &"succeeded".into()));
    // After the last there is nothing.
    assert_eq!(stage.ok(&format!("jobs watch {ID} --after 99")), "");
}

#[test]
fn a_result_is_fetched_whole() {
    let mesh = vec![7; 3 << 20];
    let (report, extra) = (br#"{"backend": "serial"}"#.to_vec(), b"extra".to_vec());
    let results = vec![result("mesh", &mesh), result("report", &report), result("extra", &extra)];
    let fake = Fake::ending(JobState::Succeeded, proto::Job { results, ..job(JobState::Succeeded) });
    [&mesh, &report, &extra].into_iter().for_each(|bytes| fake.keep(bytes));
    let stage = Stage::new(fake);
    let read = |name: &str| std::fs::read(stage.folder.path().join(name)).unwrap();
    assert_eq!(stage.ok(&format!("jobs fetch {ID} -o out.ply --report r.json")), "");
    assert!(read("out.ply") == mesh && String::from_utf8(read("r.json")).unwrap().contains("serial"));
    let told: Value = serde_json::from_str(&stage.ok(&format!("jobs fetch {ID} -o x --name extra --json"))).unwrap();
    assert_eq!((read("x"), &told["size_bytes"], &told["name"]), (extra.clone(), &5.into(), &"extra".into()));
    stage.refused(&format!("jobs fetch {ID} -o out.obj"), 2, "the result of this job is .ply");
    stage.refused(&format!("jobs fetch {ID} -o y --name other"), 66, "one of: mesh, report, extra");
    assert_eq!(stage.ok(&format!("blobs get {} -o z", digest(&extra))), "");
    assert_eq!(read("z"), extra);
    // Through a pipe.
    #[cfg(unix)]
    assert_eq!(stage.ok(&format!("blobs get {} -o /dev/stdout -q", digest(&extra))), "extra");

    for (state, words) in [(JobState::Running, "is running; wait"), (JobState::Failed, "failed")] {
        let stage = Stage::new(Fake::ending(state, job(state)));
        stage.refused(&format!("jobs fetch {ID} -o out.ply"), 70, words);
        assert!(!stage.folder.path().join("out.ply").exists());
    }
    let gone = Stage::new(Fake::ending(JobState::Succeeded, job(JobState::Succeeded)));
    gone.refused(&format!("jobs fetch {ID} -o out.ply"), 66, "no longer kept");
}

#[test]
fn warnings_of_a_result_are_told_by_wait_and_by_fetch() {
    let report = br#"{"warnings": [{"code": "gaps", "message": "it has\u001b 3 gaps; see `max_points`"}]}"#.to_vec();
    let results = vec![result("mesh", b"mesh"), result("report", &report)];
    let ended = proto::Job { results, ..job(JobState::Succeeded) };
    let wait = format!("jobs wait {ID}");
    for before in [JobState::Succeeded, JobState::Queued] {
        let fake = Fake::ending(before, ended.clone());
        [&b"mesh"[..], &report].into_iter().for_each(|bytes| fake.keep(bytes));
        let stage = Stage::new(fake);
        for line in [&wait, &format!("{wait} --quiet"), &format!("jobs fetch {ID} -q -o out.ply")] {
            let (code, said, told) = stage.tell(line);
            assert!(code == Some(0) && said.is_empty(), "{line}: {told}");
            let warning = format!("tessera: warning: job {ID}: it has\u{fffd} 3 gaps; see --max-points");
            assert_eq!(told.lines().filter(|line| *line == warning).count(), 1, "{line}: {told}");
        }
        let (_, said, told) = stage.tell(&format!("{wait} --json"));
        let said: Value = serde_json::from_str(&said).unwrap();
        assert_eq!((&said["warnings"][0]["code"], &said["state"]), (&"gaps".into(), &"succeeded".into()));
        assert!(told.contains("3 gaps"), "{told}");
    }
    // A report that is gone takes nothing else along.
    let fake = Fake::ending(JobState::Succeeded, ended);
    fake.keep(b"mesh");
    let stage = Stage::new(fake);
    assert_eq!((stage.ok(&wait), stage.ok(&format!("jobs fetch {ID} -o out.ply"))), Default::default());
    assert_eq!(std::fs::read(stage.folder.path().join("out.ply")).unwrap(), b"mesh");
    stage.refused(&format!("jobs fetch {ID} --report r.json"), 66, "no such blob");
}

#[test]
fn blobs_are_named_by_their_digest() {
    let stage = Stage::new(Fake::default());
    let bytes = std::fs::read(stage.folder.path().join("in.off")).unwrap();
    let name = digest(&bytes);
    stage.refused(&format!("blobs stat {name}"), 66, "no such blob");
    assert_eq!(stage.ok("blobs put in.off"), format!("{name}\n"));
    assert_eq!(stage.ok(&format!("blobs stat {name}")), format!("{}\n", bytes.len()));
    let told: Value = serde_json::from_str(&stage.ok(&format!("blobs stat --json {}", name.to_uppercase()))).unwrap();
    assert_eq!(told["size_bytes"], bytes.len());
    std::fs::write(stage.folder.path().join("empty"), "").unwrap();
    assert_eq!(stage.ok("blobs put empty"), format!("{}\n", digest(b"")));
    stage.ok(&format!("blobs get {} -o empty.out", digest(b"")));
    assert_eq!(std::fs::read(stage.folder.path().join("empty.out")).unwrap(), b"");
    let missing = digest(b"not there");
    stage.refused(&format!("blobs get {missing} -o out"), 66, "no such blob");
    assert!(!stage.folder.path().join("out").exists());
}

#[test]
fn jobs_are_listed_page_by_page() {
    let fake = Fake::default();
    let many: Vec<proto::Job> = (0..250u32)
        .map(|i| {
            let labels = [("n".to_owned(), format!("\u{1b}{i}"))].into();
            let spec = proto::JobSpec { labels, ..Default::default() };
            proto::Job { id: format!("{i:032x}"), spec: Some(spec), ..job(JobState::Queued) }
        })
        .collect();
    fake.state().jobs = many;
    let stage = Stage::new(fake);
    let (_, said, told) = stage.tell("jobs list");
    assert!(said.lines().count() == 101 && told.contains("--limit"), "{told}");
    assert!(said.starts_with("ID") && said.lines().last().unwrap().contains("n=\u{fffd}99"), "{said}");
    assert_eq!(stage.ok("jobs list --limit 1e3").lines().count(), 251);
    let told: Value = serde_json::from_str(&stage.ok("jobs list --limit 120 --json")).unwrap();
    assert_eq!((told["jobs"].as_array().unwrap().len(), &told["more"]), (120, &true.into()));
    stage.ok("jobs list --state queued --state running --label n=1");
    let query = stage.fake.state().listed.clone().unwrap();
    assert_eq!((query.states, query.labels.len()), (vec![1, 2], 1));
    // As `tessera jobs list | head -1`, and as events that nobody reads to their end.
    let mut child =
        stage.command("jobs list --limit 250").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success() && !String::from_utf8_lossy(&out.stderr).contains("panicked"));
}

#[test]
fn a_job_is_ended_and_forgotten() {
    let stage = Stage::new(Fake::ending(JobState::Running, job(JobState::Cancelled)));
    stage.refused(&format!("jobs delete {ID}"), 70, &format!("cancel it first: tessera jobs cancel {ID}"));
    assert_eq!(stage.ok(&format!("jobs cancel {ID}")), format!("{ID} cancelled\n"));
    assert!(stage.ok(&format!("jobs get {ID}")).contains("state     was cancelled"));
    assert_eq!(stage.ok(&format!("jobs delete {ID}")), "");
    stage.refused(&format!("jobs get {ID}"), 66, "no such job");
    let done = Stage::new(Fake::ending(JobState::Succeeded, job(JobState::Succeeded)));
    done.refused(&format!("jobs cancel {ID}"), 70, "it has ended");
}
