//! The dependency rule of the house (see the map in `src/lib.rs`), held by a test.
//!
//! Rooms are the modules at the top of `src`. Each may use the rooms below it and none above;
//! each outside crate of weight has the rooms it may appear in. Comments and unit tests are
//! not looked at.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::fs;
use std::path::{Path, PathBuf};

/// Room, and the rooms it may use beside itself.
const ROOMS: &[(&str, &[&str])] = &[
    ("setters", &[]),
    ("token", &[]),
    ("memory", &[]),
    ("mesh", &[]),
    ("gpu", &[]),
    ("picture", &["mesh"]),
    ("knn", &["mesh"]),
    ("rvd", &["knn", "mesh"]),
    ("cvt", &["rvd", "mesh"]),
    ("remesh", &["cvt", "rvd", "mesh"]),
    ("config", &[]),
    ("telemetry", &["config"]),
    ("job", &["remesh", "cvt", "rvd", "mesh", "config", "memory"]),
    ("service", &["job", "remesh", "cvt", "rvd", "mesh", "config"]),
    (
        "cli",
        &["service", "job", "remesh", "cvt", "rvd", "knn", "mesh", "gpu", "picture", "config", "telemetry", "memory"],
    ),
    ("internals", &["cli", "config", "cvt", "gpu", "job", "knn", "mesh", "remesh", "rvd", "service"]),
    ("main", &["internals"]),
    ("lib", &[]),
];

/// Parts of rooms that may use more: (path prefix, more rooms).
const DOORS: &[(&str, &[&str])] = &[
    ("rvd/gpu", &["gpu"]),
    // Opens the device for the backend.
    ("rvd/backends", &["gpu"]),
    ("knn/gpu", &["gpu"]),
    ("cvt/gpu", &["gpu"]),
    ("cvt/curves", &["knn"]),
    ("cvt/density", &["knn"]),
    ("job/admission", &["gpu"]),
    ("job/worker", &["gpu"]),
];

/// Crate, and the path prefixes it may appear in.
const CRATES: &[(&str, &[&str])] = &[
    ("wgpu", &["gpu", "rvd/gpu", "knn/gpu", "cvt/gpu"]),
    ("tonic", &["service", "cli"]),
    ("prost", &["service", "cli"]),
    ("hyper", &["service/connections"]),
    ("hyper_util", &["service/connections"]),
    ("http_body", &["service/connections"]),
    ("socket2", &["service/connections"]),
    ("rustix", &["service/connections"]),
    ("redb", &["job/store"]),
    ("tokio", &["job", "service", "cli", "telemetry"]),
    ("clap", &["config", "cli", "main"]),
    ("temp_env", &["cli/surroundings"]),
    ("anyhow", &["cli", "main"]),
    ("kiddo", &["knn"]),
    ("tobj", &["mesh/io"]),
    ("png", &["picture"]),
    ("plotters", &["picture/chart"]),
    ("noto_sans_mono_bitmap", &["picture/chart"]),
];

fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// (path below src without ending, code lines with their numbers) of every source file.
fn code() -> Vec<(String, Vec<(usize, String)>)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    files.sort();
    files
        .into_iter()
        .map(|path| {
            let text = fs::read_to_string(&path).unwrap();
            let name = path.strip_prefix(&root).unwrap().with_extension("").to_string_lossy().replace('\\', "/");
            let lines = text
                .lines()
                .enumerate()
                .take_while(|(_, l)| l.trim() != "#[cfg(test)]")
                .filter(|(_, l)| !l.trim_start().starts_with("//"))
                .map(|(i, l)| (i + 1, l.to_string()))
                .collect();
            (name, lines)
        })
        .collect()
}

fn within(name: &str, prefix: &str) -> bool {
    name == prefix || name.strip_prefix(prefix).is_some_and(|rest| rest.starts_with('/'))
}

/// Whether `line` has `word` followed by `::`, not as the end of a longer name or path.
fn names(line: &str, word: &str) -> bool {
    let path = format!("{word}::");
    line.match_indices(&path).any(|(at, _)| {
        let before = line[..at].chars().next_back();
        !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
    })
}

#[test]
fn rooms_use_only_what_lies_below_them() {
    let mut wrong = Vec::new();
    for (name, lines) in code() {
        let room = name.split('/').next().unwrap();
        let (_, allowed) = ROOMS.iter().find(|(r, _)| *r == room).unwrap_or_else(|| panic!("no rule for room {room}"));
        let doors = DOORS.iter().filter(|(prefix, _)| within(&name, prefix)).flat_map(|(_, more)| *more);
        // Everybody listens to the token.
        let allowed: Vec<&str> = allowed.iter().chain(doors).copied().chain([room, "token"]).collect();
        for (number, line) in lines {
            for (other, _) in ROOMS {
                let used = line.contains(&format!("crate::{other}::"))
                    || line.contains(&format!("crate::{other};"))
                    || line.contains(&format!("tessera::{other}"));
                if used && !allowed.contains(other) {
                    wrong.push(format!("src/{name}.rs:{number}: {room} must not use {other}: {}", line.trim()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn crates_stay_in_their_rooms() {
    let mut wrong = Vec::new();
    for (name, lines) in code() {
        for (number, line) in lines {
            for (word, places) in CRATES {
                if names(&line, word) && !places.iter().any(|p| within(&name, p)) {
                    wrong.push(format!("src/{name}.rs:{number}: {word} does not belong here: {}", line.trim()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn cvt_and_the_dual_cannot_name_a_backend() {
    let mut wrong = Vec::new();
    for (name, lines) in code() {
        if !(within(&name, "cvt") || name == "rvd/dual") {
            continue;
        }
        for (number, line) in lines {
            for word in ["serial", "parallel", "Serial", "Parallel", "Gpu"] {
                if names(&line, word) || line.contains(&format!("rvd::{word}")) {
                    wrong.push(format!("src/{name}.rs:{number}: {}", line.trim()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

/// What prints by itself panics when nobody reads any more.
#[test]
fn one_place_prints() {
    let mut wrong = Vec::new();
    for (name, lines) in code() {
        for (number, line) in lines {
            let words = ["println!", "eprintln!", "print!", "eprint!", "dbg!"];
            if words.iter().any(|word| line.trim_start().starts_with(word) || line.contains(&format!(" {word}"))) {
                wrong.push(format!("src/{name}.rs:{number}: use outln! or errln!: {}", line.trim()));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn every_module_says_what_it_is_for() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    for path in files {
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("//!"), "{} has no head", path.display());
    }
}
