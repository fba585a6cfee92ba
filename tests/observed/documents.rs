//! Promise: `docs/observability.md` names every metric that the server tells, and none that it does not.

use std::collections::BTreeSet;
use std::path::Path;
use std::time::{Duration, Instant};

use server::readiness::Reason;

use crate::counted::worked;

fn document() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/observability.md")).unwrap()
}

/// The first cells of the tables' rows, which are code.
fn listed(text: &str) -> BTreeSet<String> {
    let rows = text.lines().filter_map(|line| line.strip_prefix("| `")?.split_once('`'));
    rows.map(|(name, _)| name.to_owned()).collect()
}

#[tokio::test]
async fn every_metric_is_in_the_document() {
    // What has labels shows once it was counted.
    let program = worked().await;
    let document = document();
    let metrics = document.split("## ").find(|part| part.starts_with("Metrics")).expect("a section of metrics");
    let wanted = listed(metrics);
    let begin = Instant::now();
    loop {
        let (_, text) = program.get("/metrics", "text/plain").await;
        let told: BTreeSet<String> = text
            .lines()
            .filter_map(|line| line.strip_prefix("# TYPE ")?.split(' ').next().map(str::to_owned))
            .collect();
        // A call is counted when its answer has left.
        if told == wanted || begin.elapsed() > Duration::from_secs(20) {
            assert_eq!(wanted, told);
            break;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    program.stop();
}

#[test]
fn every_reason_is_in_the_document() {
    let document = document();
    let section = document.split("## ").find(|part| part.starts_with("Health")).expect("a section of health");
    let known = Reason::ALL.iter().map(|reason| reason.name().to_owned()).collect();
    assert_eq!(listed(section), known);
}
