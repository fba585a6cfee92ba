//! Promise: what scripts rely on does not change unnoticed: commands, their options, and the keys of reports.
//!
//! `TESSERA_SNAPSHOTS=write` writes the lists of `tests/cli/snapshots` anew. What is gone from one of them breaks a promise of
//! docs/compatibility.md; what is new belongs in the changelog.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::Value;

use super::manual::commands;
use super::outputs::{said, tessera};

/// Compares with the list of this name.
fn compare(name: &str, now: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cli/snapshots").join(name);
    if std::env::var("TESSERA_SNAPSHOTS").is_ok_and(|what| what == "write") {
        std::fs::write(&path, now).unwrap();
    }
    let before = std::fs::read_to_string(&path).unwrap();
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<BTreeSet<_>>();
    let (gone, new) = (&lines(&before) - &lines(now), &lines(now) - &lines(&before));
    assert!(gone.is_empty() && new.is_empty(), "{name}: gone {gone:#?}, new {new:#?}");
}

/// The help of a command, and of those below it: a line for each option.
fn options(command: &str, list: &mut Vec<String>) {
    let help = tessera(Path::new("."), &format!("{command} --help"));
    assert!(help.status.success(), "{command}: {}", said(&help));
    let help = String::from_utf8(help.stdout).unwrap();
    let mut is_of_commands = false;
    for line in help.lines() {
        if !line.starts_with(' ') {
            is_of_commands = line == "Commands:";
        }
        let words = line.trim_start();
        if is_of_commands && line.starts_with("  ") && !line.starts_with("   ") {
            let below = words.split_whitespace().next().unwrap();
            if below != "help" {
                options(&format!("{command} {below}"), list);
            }
        } else if words.starts_with('-') || words.starts_with('<') || words.starts_with('[') {
            // Without what the help says of it.
            let option = words.split("  ").next().unwrap();
            list.push(format!("{} {option}", command.trim()));
        }
    }
}

#[test]
fn no_option_comes_or_goes_unnoticed() {
    let mut list = Vec::new();
    options("", &mut list);
    list.sort();
    assert!(list.len() > 100 && list.iter().any(|line| line.starts_with("remesh --points")), "{list:#?}");
    // Every command's help is in it, found in another way.
    let missing: Vec<String> = commands()
        .iter()
        .map(|words| words.join(" "))
        .filter(|command| !list.contains(&format!("{command} -h, --help")))
        .collect();
    assert!(missing.is_empty(), "no help of {missing:?}");
    compare("options.txt", &(list.join("\n") + "\n"));
}

/// The keys of a report; those of entries of a list once.
fn keys(place: &str, value: &Value, list: &mut BTreeSet<String>) {
    match value {
        Value::Object(entries) => entries.iter().for_each(|(key, value)| keys(&format!("{place}/{key}"), value, list)),
        Value::Array(entries) => entries.iter().for_each(|value| keys(&format!("{place}/[]"), value, list)),
        _ => drop(list.insert(place.to_owned())),
    }
}

#[test]
fn no_key_of_a_report_comes_or_goes_unnoticed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut list = BTreeSet::new();
    for (name, line) in [
        ("", "shape block --facets 600 -o in.ply"),
        ("remesh", "remesh in.ply -o out.ply --points 300 --backend serial --report remesh"),
        ("rvd", "rvd in.ply --points 300 --backend serial --report rvd"),
    ] {
        let out = tessera(at, line);
        assert!(out.status.success(), "{line}: {}", said(&out));
        if !name.is_empty() {
            let report: Value = serde_json::from_slice(&std::fs::read(at.join(name)).unwrap()).unwrap();
            keys(name, &report, &mut list);
            let old = |place: &str, now: &str, before: &str| {
                let figures = report.pointer(place).unwrap();
                assert_eq!(figures.get(now), figures.get(before), "{place}");
            };
            old("/input", "outlier_vertices", "stray_vertices");
        }
    }
    compare("report_keys.txt", &(list.into_iter().collect::<Vec<_>>().join("\n") + "\n"));
}
