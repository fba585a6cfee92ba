//! Tests of what is counted.

use std::collections::BTreeSet;

use super::*;

fn origin() -> Origin {
    Origin { kind: Kind::Remesh, backend: BackendKind::Parallel, job: None, facets: 100, seeds: 7 }
}

/// Whether a sample is in the text.
fn has(metrics: &Metrics, sample: &str) -> bool {
    metrics.text(Format::Text).lines().any(|line| line == sample)
}

#[test]
fn work_is_counted_as_it_is_told() {
    let metrics = Metrics::default();
    metrics.moved(Kind::Remesh, None, Some(Phase::Waiting));
    assert!(has(&metrics, r#"tessera_jobs{state="waiting",kind="remesh"} 1"#));
    metrics.moved(Kind::Remesh, Some(Phase::Waiting), Some(Phase::Running));
    metrics.began(Kind::Remesh, Duration::from_millis(20));
    metrics.stage("dual", BackendKind::Parallel, Duration::from_secs(2));
    metrics.iterated(35);
    metrics.reused(Kind::Remesh);
    metrics.ended(&origin(), JobOutcome::Succeeded);
    metrics.ended(&origin(), JobOutcome::Failed);
    metrics.moved(Kind::Remesh, Some(Phase::Running), None);
    for sample in [
        r#"tessera_jobs{state="waiting",kind="remesh"} 0"#,
        r#"tessera_jobs{state="running",kind="remesh"} 0"#,
        r#"tessera_jobs_ended_total{outcome="done",kind="remesh"} 1"#,
        r#"tessera_jobs_ended_total{outcome="failed",kind="remesh"} 1"#,
        r#"tessera_jobs_reused_total{kind="remesh"} 1"#,
        r#"tessera_jobs_reused_total{kind="rvd"} 0"#,
        r#"tessera_queue_seconds_sum{kind="remesh"} 0.02"#,
        r#"tessera_stage_seconds_sum{stage="dual",backend="parallel"} 2.0"#,
        r#"tessera_stage_seconds_bucket{le="3.0",stage="dual",backend="parallel"} 1"#,
        "tessera_iterations_total 35",
        "tessera_facets_total 100",
        "tessera_seeds_total 7",
    ] {
        assert!(has(&metrics, sample), "{sample}\n{}", metrics.text(Format::Text));
    }
}

#[test]
fn the_device_is_busy_when_it_has_passes() {
    let metrics = Metrics::default();
    metrics.passed(BackendKind::Parallel, Duration::from_secs(5));
    metrics.passed(BackendKind::Gpu, Duration::from_millis(1500));
    metrics.planned(1000);
    metrics.planned(-400);
    metrics.lost_device();
    for sample in [
        "tessera_device_busy_seconds_total 1.5",
        r#"tessera_passes_total{backend="gpu"} 1"#,
        r#"tessera_device_bytes{kind="planned"} 600"#,
        "tessera_device_losses_total 1",
    ] {
        assert!(has(&metrics, sample), "{sample}\n{}", metrics.text(Format::Text));
    }
}

#[test]
fn strangers_make_no_labels() {
    let metrics = Metrics::default();
    let calls = transport::Calls::new(metrics.connections(), ["a.B/C".to_owned()]);
    for path in ["a.B/C", "a.B/D", "", "x\"} 1\n", "a.B/C/"] {
        let call = calls.begin(path);
        call.end("OK");
    }
    let text = metrics.text(Format::Text);
    let methods: BTreeSet<_> = text.lines().filter(|line| line.starts_with("tessera_open_streams{")).collect();
    let expected = ["tessera_open_streams{rpc_method=\"_OTHER\"} 0", "tessera_open_streams{rpc_method=\"a.B/C\"} 0"];
    assert_eq!(methods, BTreeSet::from(expected));
    let count = |method: &str| {
        let labels = format!(r#"{{rpc_method="{method}",rpc_response_status_code="OK"}}"#);
        let name = format!("rpc_server_call_duration_seconds_count{labels} ");
        text.lines().find_map(|line| line.strip_prefix(&name)).unwrap().parse::<u64>().unwrap()
    };
    assert_eq!((count("a.B/C"), count("_OTHER")), (1, 4));
}

#[test]
fn reasons_are_told_one_by_one() {
    let metrics = Metrics::default();
    let readiness = crate::readiness::Readiness::new();
    readiness.set(Reason::DiskFull, true);
    metrics.condition(readiness.condition());
    assert!(has(&metrics, r#"tessera_not_ready{reason="disk_full"} 1"#));
    assert!(has(&metrics, r#"tessera_not_ready{reason="draining"} 0"#));
}

#[test]
fn memory_is_read_where_it_is_kept() {
    let metrics = Metrics::default();
    let used = Arc::new(AtomicI64::new(0));
    metrics.memory(Arc::clone(&used), 4096);
    used.store(77, Ordering::Release);
    assert!(has(&metrics, r#"tessera_memory_bytes{kind="used"} 77"#));
    assert!(has(&metrics, r#"tessera_memory_bytes{kind="limit"} 4096"#));
}

/// Counting is on the path of every pass and every call.
#[test]
fn counting_takes_little() {
    const TIMES: u32 = 100_000;
    let metrics = Metrics::default();
    let start = std::time::Instant::now();
    for _ in 0..TIMES {
        metrics.passed(BackendKind::Parallel, Duration::from_millis(1));
    }
    let each = start.elapsed() / TIMES;
    // Without optimisation and on a busy machine; some 50 ns otherwise.
    assert!(each < Duration::from_micros(20), "{each:?}");
}

#[test]
#[cfg(target_os = "linux")]
fn this_process_is_seen() {
    let process = Process::register(&mut Registry::default());
    process.look();
    assert!(process.resident.get() > 1 << 20 && process.threads.get() > 0);
    assert!(process.descriptors.get() > 2 && process.most_descriptors.get() >= process.descriptors.get());
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
    let age = now - process.start.get();
    assert!((-2.0..7.0 * 24.0 * 3600.0).contains(&age), "{age}");
}
