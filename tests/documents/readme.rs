//! What one page repeats of others is what they say, and README.md stays short.

use super::{pages, read};

#[test]
fn readme_is_short() {
    let lines = read("README.md").lines().count();
    assert!(lines <= 150, "README.md has {lines} lines");
}

/// Figures are measured for one page each. README.md may only repeat rows of these.
#[test]
fn figures_are_those_of_their_pages() {
    let sources = read("docs/quality.md") + &read("docs/performance.md");
    let readme = read("README.md");
    let figures = readme.lines().filter(|line| line.starts_with("| ") && line.chars().any(|c| c.is_ascii_digit()));
    let wrong: Vec<&str> = figures.filter(|line| !sources.lines().any(|other| other == *line)).collect();
    assert!(wrong.is_empty(), "rows of README.md that no page has:\n{}", wrong.join("\n"));
}

#[test]
fn the_index_has_every_page() {
    let index = read("docs/README.md");
    let missing: Vec<String> = pages()
        .into_iter()
        .filter_map(|page| page.strip_prefix("docs/").map(str::to_owned))
        .filter(|page| page != "README.md" && !index.contains(&format!("]({page})")))
        .collect();
    assert!(missing.is_empty(), "docs/README.md has no link to {missing:?}");
}

#[test]
fn operations_explain_every_alert() {
    let rules = read("deploy/prometheus/alerts.yml");
    let page = read("docs/operations.md");
    let alerts: Vec<&str> = rules.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).collect();
    assert!(!alerts.is_empty());
    let listed: Vec<&str> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| `Tessera")?.split_once('`').map(|(name, _)| name))
        .collect();
    let mut missing = alerts.iter().filter(|alert| !listed.iter().any(|name| format!("Tessera{name}") == **alert));
    assert_eq!((missing.next(), listed.len()), (None, alerts.len()), "of {alerts:?} the page has {listed:?}");
}
