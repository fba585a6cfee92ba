//! Promise: every kind of job is done as the streams and the command do it, with the same bits; what cannot be done says why;
//! what is refused leaves nothing behind.

use std::time::Duration;

use tessera::mesh::io::{Format, decode, encode};
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tonic::Code;

use super::program::*;

const LIMIT: Duration = Duration::from_secs(300);

fn bytes_of(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn every_kind_of_job_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let mut program = Program::start(folder.path(), &[]);
    let mut client = program.client().await;
    let mesh = Shape::Torus.build(2_000);
    let digest = client.put_mesh(&mesh).await;

    // As the command does it.
    let path = folder.path().join("torus.ply");
    std::fs::write(&path, encode(Format::Ply, &mesh).unwrap()).unwrap();
    let out = folder.path().join("out.ply");
    let done = std::process::Command::new(env!("CARGO_BIN_EXE_tessera"))
        .arg("remesh")
        .arg(&path)
        .args(["--points", "300", "--seed", "5", "--backend", "parallel", "--quiet", "-o"])
        .arg(&out)
        .status()
        .unwrap();
    assert!(done.success());
    let id = client.submit(remesh(&digest, 300, 5)).await;
    let job = client.end(&id, LIMIT).await;
    let file = client.read(&part(&job, "mesh")).await;
    assert!(file == std::fs::read(&out).unwrap(), "the same bytes as the command's");
    let report: serde_json::Value = serde_json::from_slice(&client.read(&part(&job, "report")).await).unwrap();
    assert_eq!(report["backend"], "parallel");

    // In another format, and as arrays.
    let mut spec = remesh(&digest, 300, 5);
    spec.result = Some(ResultFormat { form: Some(result_format::Form::File(MeshFormat::Obj.into())) });
    let id = client.submit(spec).await;
    let job = client.end(&id, LIMIT).await;
    let obj = decode(Format::Obj, &client.read(&part(&job, "mesh")).await).unwrap();
    let ply = decode(Format::Ply, &file).unwrap();
    assert_eq!(obj.facets().len(), ply.facets().len());
    let mut spec = remesh(&digest, 300, 5);
    spec.result = Some(ResultFormat { form: Some(result_format::Form::Arrays(true)) });
    let id = client.submit(spec).await;
    let job = client.end(&id, LIMIT).await;
    let positions: Vec<f64> = ply.positions().iter().flat_map(|p| p.to_array()).collect();
    assert!(client.read(&part(&job, "positions")).await == bytes_of(&positions));

    // A diagram of given seeds, and a session's commands.
    let seeds: Vec<f64> = mesh.positions().iter().take(50).flat_map(|p| p.to_array()).collect();
    let seeds = client.put(&bytes_of(&seeds)).await;
    let given = ArrayRef { digest: seeds, form: ArrayForm::F64.into(), count: 50 };
    let given = Some(JobArrays { seeds: Some(given), ..JobArrays::default() });
    let outputs = [RvdOutput::Cells, RvdOutput::Centroids, RvdOutput::Sums].map(i32::from).to_vec();
    let mut spec = remesh(&digest, 1, 0);
    spec.arrays = given.clone();
    spec.work = Some(job_spec::Work::Rvd(DiagramOptions { outputs, ..DiagramOptions::default() }));
    let id = client.submit(spec).await;
    let job = client.end(&id, LIMIT).await;
    assert!(client.read(&part(&job, "cells")).await.starts_with(b"ply\n"));
    assert_eq!(client.read(&part(&job, "centroids")).await.len(), 50 * 24);
    let areas = client.read(&part(&job, "areas")).await;
    let area: f64 = areas.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).sum();
    assert!((area / mesh.area() - 1.0).abs() < 1e-9, "{area}");
    let step = CvtStep { iterations: 5, seeds: SeedsWanted::Each.into(), kind: 0 };
    let commands = vec![CvtJobCommand { command: Some(cvt_job_command::Command::Step(step)) }];
    let mut spec = remesh(&digest, 1, 0);
    spec.arrays = given;
    spec.work = Some(job_spec::Work::Cvt(CvtJob { options: None, commands }));
    let id = client.submit(spec).await;
    let job = client.end(&id, LIMIT).await;
    assert_eq!(part(&job, "seeds.0005"), part(&job, "seeds"));
    assert_eq!(job.results.len(), 7, "{job:?}");

    // As many seeds as a share of the vertices.
    let quarter = 24 * mesh.positions().len().div_ceil(4);
    let points_percent = Some(25.0);
    let outputs = vec![RvdOutput::Centroids.into()];
    let diagram = DiagramOptions { outputs, points_percent, ..DiagramOptions::default() };
    let options = Some(CvtOptions { points_percent, ..CvtOptions::default() });
    let step = CvtStep { iterations: 1, ..CvtStep::default() };
    let commands = vec![CvtJobCommand { command: Some(cvt_job_command::Command::Step(step)) }];
    for (work, named) in
        [(job_spec::Work::Rvd(diagram), "centroids"), (job_spec::Work::Cvt(CvtJob { options, commands }), "seeds")]
    {
        let id = client.submit(JobSpec { work: Some(work), ..remesh(&digest, 1, 0) }).await;
        let job = client.end(&id, LIMIT).await;
        assert_eq!(client.read(&part(&job, named)).await.len(), quarter, "{named}");
    }

    // Events from a number on: those that came before, without those up to it.
    let all = client.watch(&id, 0).await.unwrap();
    assert_eq!(client.watch(&id, 5).await.unwrap(), all.iter().filter(|e| e.number > 5).cloned().collect::<Vec<_>>());
    assert!(all.iter().any(|e| matches!(e.what, Some(job_event::What::Iteration(_)))));
    assert_eq!(program.stop(), Some(0));
}

/// What a file is, a job says; whether it is packed by gzip, its bytes say.
#[tokio::test(flavor = "multi_thread")]
async fn files_of_every_format_are_taken_and_given() {
    let folder = tempfile::tempdir().unwrap();
    let mut program = Program::start(folder.path(), &[]);
    let mut client = program.client().await;
    let mesh = Shape::Torus.build(300);
    let gzip = |bytes: &[u8]| {
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        std::io::Write::write_all(&mut packer, bytes).unwrap();
        packer.finish().unwrap()
    };
    for format in Format::ALL {
        let bytes = encode(format, &mesh).unwrap();
        let mut results = Vec::new();
        for bytes in [gzip(&bytes), bytes] {
            let digest = client.put(&bytes).await;
            let mut spec = remesh(&digest, 40, 1);
            let file = MeshFile { digest, format: format.number(), attributes: None };
            spec.mesh = Some(JobMesh { source: Some(job_mesh::Source::File(file)) });
            spec.result = Some(ResultFormat { form: Some(result_format::Form::File(format.number())) });
            let id = client.submit(spec).await;
            let job = client.end(&id, LIMIT).await;
            results.push(client.read(&part(&job, "mesh")).await);
        }
        assert!(results[0] == results[1], "{format:?}: packed or not, the bits are the same");
        assert!(decode(format, &results[0]).unwrap().facets().len() > 40, "{format:?}");
    }
    let bomb = client.put(&gzip(&vec![b'\n'; 64 << 20])).await;
    let refused = client.create(remesh(&bomb, 100, 0), "").await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument, "{refused:?}");
    assert!(refused.message().contains("are packed in the file"), "{refused:?}");
    assert_eq!(program.stop(), Some(0));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_cannot_be_done_says_why_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--keep-results", "2s", "--keep-jobs", "6s"]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Torus.build(2_000)).await;

    let code = |result: Result<CreateJobResponse, tonic::Status>| result.unwrap_err().code();
    assert_eq!(code(client.create(JobSpec::default(), "").await), Code::InvalidArgument);
    assert_eq!(code(client.create(remesh(&"0".repeat(64), 100, 0), "").await), Code::NotFound);
    assert_eq!(code(client.create(remesh("x", 100, 0), "").await), Code::InvalidArgument);
    assert_eq!(code(client.create(remesh(&digest, 5_000_000, 0), "").await), Code::InvalidArgument, "too many");
    let mut gpu = remesh(&digest, 100, 0);
    gpu.backend = BackendChoice::Gpu.into();
    assert_eq!(code(client.create(gpu, "").await), Code::FailedPrecondition);
    let no_mesh = client.put(b"this is no mesh").await;
    assert_eq!(code(client.create(remesh(&no_mesh, 100, 0), "").await), Code::InvalidArgument);
    let most =
        EstimateJobRequest { spec: Some(remesh(&digest, 100, 0)), vertices: Some(u64::MAX), facets: Some(u64::MAX) };
    assert!(!client.jobs.estimate_job(most).await.unwrap().into_inner().fits);
    assert!(client.all().await.is_empty(), "nothing is left of it");

    // A request that comes again.
    let first = client.create(remesh(&digest, 100, 0), "mine").await.unwrap();
    let again = client.create(remesh(&digest, 100, 0), "mine").await.unwrap();
    assert_eq!((again.existed, &again.job.unwrap().id), (true, &first.job.clone().unwrap().id));
    assert_eq!(code(client.create(remesh(&digest, 101, 0), "mine").await), Code::AlreadyExists);

    // Its end is looked at now: later it is forgotten, however slow this machine is.
    let id = first.job.unwrap().id;
    assert_eq!(client.end(&id, LIMIT).await.state(), JobState::Succeeded);

    // Others see nothing of it.
    let mut other = client.of("somebody-else");
    assert!(other.all().await.is_empty());
    assert_eq!(other.cancel(&id).await.unwrap_err().code(), Code::NotFound);
    assert_eq!(other.watch(&id, 0).await.unwrap_err().code(), Code::NotFound);

    // Deadlines, and a cancel at work.
    let large = client.put_mesh(&Shape::Genus(3).build(20_000)).await;
    let mut late = remesh(&large, 20_000, 0);
    late.run_deadline = Some(prost_types::Duration { seconds: 0, nanos: 300_000_000 });
    let late = client.submit(late).await;
    let job = client.end(&late, LIMIT).await;
    assert_eq!((job.state(), job.expired_by.as_str()), (JobState::Expired, "run_deadline"), "{job:?}");
    let long = client.submit(remesh(&large, 20_000, 1)).await;
    while client.get(&long).await.state() == JobState::Queued {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(client.cancel(&long).await.unwrap().state(), JobState::Cancelled);
    assert_eq!(client.cancel(&long).await.unwrap().state(), JobState::Cancelled, "it stays so");

    // Results go, then the jobs do; and what they needed may go.
    let start = std::time::Instant::now();
    while !client.all().await.is_empty() {
        assert!(start.elapsed() < Duration::from_secs(60), "{:?}", client.all().await);
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    let deleted = client.blobs.delete(DeleteRequest { digest: digest.clone() }).await;
    assert!(deleted.is_ok(), "no pin is left: {deleted:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_with_the_same_result_is_answered_with_the_earlier_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut program = Program::start(folder.path(), &[]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Torus.build(2_000)).await;
    let wanted = || remesh(&digest, 200, 3);
    let first = client.create_or_reuse(wanted()).await;
    let first_id = first.job.unwrap().id;
    assert!(!first.existed && !first.reused);
    let done = client.end(&first_id, LIMIT).await;

    // What changes no bits changes nothing here, and the input is not needed any more.
    client.blobs.delete(DeleteRequest { digest: digest.clone() }).await.unwrap();
    let mut alike = wanted();
    alike.labels = [("night".to_owned(), "7".to_owned())].into();
    (alike.priority, alike.backend) = (Some(9), BackendChoice::Parallel.into());
    for spec in [wanted(), alike] {
        let again = client.create_or_reuse(spec).await;
        assert!(again.existed && again.reused);
        assert_eq!(again.job.unwrap(), done);
    }
    client.put_mesh(&Shape::Torus.build(2_000)).await;

    // Other options, another backend, another tenant, and callers that do not ask for it have jobs of their own.
    let new = |answer: CreateJobResponse| {
        assert!(!answer.existed && !answer.reused, "{answer:?}");
        answer.job.unwrap().id
    };
    let mut fewer = wanted();
    fewer.result = Some(ResultFormat { form: Some(result_format::Form::File(MeshFormat::Stl.into())) });
    let mut serial = wanted();
    serial.backend = BackendChoice::Serial.into();
    for other in [remesh(&digest, 201, 3), remesh(&digest, 200, 4), fewer, serial] {
        new(client.create_or_reuse(other).await);
    }
    let mut other = client.of("somebody-else");
    other.put_mesh(&Shape::Torus.build(2_000)).await;
    new(other.create_or_reuse(wanted()).await);
    let own = new(client.create(wanted(), "").await.unwrap());
    let own_done = client.end(&own, LIMIT).await;
    assert_eq!(part(&own_done, "mesh"), part(&done, "mesh"), "the bits are the same");

    // A request that came before goes first.
    let request = |request_id: &str| CreateJobRequest {
        spec: Some(wanted()),
        request_id: request_id.to_owned(),
        reuse: ReusePolicy::SameBits.into(),
    };
    let named = new(client.create(wanted(), "mine").await.unwrap());
    let again = client.jobs.create_job(client.request(request("mine"))).await.unwrap().into_inner();
    assert_eq!((again.existed, again.reused, again.job.unwrap().id), (true, false, named.clone()));
    client.end(&named, LIMIT).await;

    // After a restart as well; and once the results are deleted, a new job.
    program.kill();
    let mut program = Program::start(folder.path(), &[]);
    let mut client = program.client().await;
    let again = client.create_or_reuse(wanted()).await;
    assert!(again.reused);
    for id in [first_id, own, named] {
        client.jobs.delete_job(client.request(DeleteJobRequest { id })).await.unwrap();
    }
    new(client.create_or_reuse(wanted()).await);
    program.stop();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_and_the_input_of_a_job_are_never_evicted() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--blobs-mib", "1", "--jobs-at-once", "1"]);
    let mut client = program.client().await;
    let mesh = Shape::Torus.build(2_000);
    let digest = client.put_mesh(&mesh).await;
    let id = client.create(remesh(&digest, 200, 0), "one").await.unwrap().job.unwrap().id;
    let job = client.end(&id, LIMIT).await;
    let result = client.read(&part(&job, "mesh")).await;
    // The input is needed no more; five times the quota goes through.
    for i in 0..20u8 {
        client.put(&vec![i; 256 << 10]).await;
    }
    assert!(client.read(&part(&job, "mesh")).await == result);
    let missing = client.blobs.stat(StatRequest { digest: digest.clone() }).await;
    assert_eq!(missing.unwrap_err().code(), Code::NotFound, "the input went");
    let again = client.create(remesh(&digest, 200, 0), "one").await.unwrap();
    assert_eq!((again.existed, again.job.unwrap().id), (true, id.clone()), "a call that is repeated needs no input");
    assert_eq!(
        client.blobs.delete(DeleteRequest { digest: part(&job, "mesh") }).await.unwrap_err().code(),
        Code::FailedPrecondition
    );
    client.jobs.delete_job(DeleteJobRequest { id }).await.unwrap();
    client.blobs.delete(DeleteRequest { digest: part(&job, "mesh") }).await.unwrap();
}

/// Every file below a folder.
fn files(folder: &std::path::Path) -> Vec<std::path::PathBuf> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { all.extend(files(&path)) } else { all.push(path) }
    }
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_blob_is_found_and_can_be_uploaded_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut program = Program::start(folder.path(), &[]);
    let mut client = program.client().await;
    let file = encode(Format::Ply, &Shape::Torus.build(2_000)).unwrap();
    let digest = client.put(&file).await;
    assert_eq!(program.stop(), Some(0));
    let blob = files(folder.path()).into_iter().find(|path| path.ends_with(&digest)).unwrap();
    for damage in [file.len() - 100, 100] {
        // The same length with other bytes, and fewer bytes.
        let mut bytes = file.clone();
        bytes[damage] ^= 1;
        bytes.truncate(if damage == 100 { 500 } else { bytes.len() });
        std::fs::write(&blob, &bytes).unwrap();
        let mut program = Program::start(folder.path(), &[]);
        let mut client = program.client().await;
        match client.create(remesh(&digest, 100, 0), "").await {
            Ok(created) => {
                let job = client.end(&created.job.unwrap().id, LIMIT).await;
                assert_eq!(job.failure.clone().unwrap().kind(), JobFailureKind::MissingInput, "{job:?}");
            }
            // A small file is read before the job is taken.
            Err(status) => assert_eq!(status.code(), Code::DataLoss, "{status:?}"),
        }
        assert_eq!(client.put(&file).await, digest);
        assert!(client.read(&digest).await == file);
        let id = client.submit(remesh(&digest, 100, 0)).await;
        assert_eq!(client.end(&id, LIMIT).await.state(), JobState::Succeeded);
        assert_eq!(program.stop(), Some(0));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn promises_of_one_tenant_keep_nobody_out() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &["--waiting-jobs", "4", "--jobs-at-once", "1"]);
    let client = program.client().await;
    let (mut greedy, mut other) = (client.of("greedy"), client.of("other"));
    // Uploads that are begun and left, with no bytes and with some.
    for i in 0..300u32 {
        let begun = WriteRequest { digest: format!("{i:064x}"), size_bytes: 1 << 30, ..WriteRequest::default() };
        let data = i.to_le_bytes().to_vec();
        let some = WriteRequest { crc32c: crc32c::crc32c(&data), data: data.into(), ..begun.clone() };
        let _ = greedy.begin(if i % 2 == 0 { begun } else { some }).await;
    }
    let mesh = Shape::Genus(3).build(4_000);
    let digest = other.put_mesh(&mesh).await;
    // Jobs that fill the line, and a result that has to be kept.
    let mut filled = 0;
    while greedy.create(remesh(&digest, 3_000, filled), "").await.is_ok() {
        filled += 1;
        assert!(filled < 10);
    }
    let id = other.submit(remesh(&digest, 100, 0)).await;
    assert_eq!(other.end(&id, LIMIT).await.state(), JobState::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failure_is_told_in_few_words() {
    let folder = tempfile::tempdir().unwrap();
    let program = Program::start(folder.path(), &[]);
    let mut client = program.client().await;
    let digest = client.put_mesh(&Shape::Torus.build(2_000)).await;
    let line = client.put("1 ".repeat(3 << 20).as_bytes()).await;
    let given = ArrayRef { digest: line, form: ArrayForm::Text.into(), count: 0 };
    let mut spec = remesh(&digest, 1, 0);
    spec.arrays = Some(JobArrays { seeds: Some(given), ..JobArrays::default() });
    spec.work = Some(job_spec::Work::Rvd(DiagramOptions::default()));
    let id = client.submit(spec).await;
    let job = client.end(&id, LIMIT).await;
    let failure = job.failure.unwrap();
    assert!(failure.kind() == JobFailureKind::BadInput && failure.message.len() < 2_000, "{}", failure.message.len());
    // An array that is longer than it says is not read.
    let mut spec = remesh(&digest, 1, 0);
    let long = client.put(&vec![0u8; 24 << 20]).await;
    let given = ArrayRef { digest: long, form: ArrayForm::F64.into(), count: 1 };
    spec.arrays = Some(JobArrays { seeds: Some(given), ..JobArrays::default() });
    spec.work = Some(job_spec::Work::Rvd(DiagramOptions::default()));
    let id = client.submit(spec).await;
    let words = client.end(&id, LIMIT).await.failure.unwrap().message;
    assert!(words.contains("25165824") && words.contains("24"), "{words}");
}
