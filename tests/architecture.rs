//! Promise: the house keeps the order that `src/lib.rs` draws, and this order is about what there is.
//!
//! Rooms are the modules at the top of `src`. Each may use the rooms below it and none above; each outside crate of
//! weight has the modules it may appear in; the parts of a room do not go in circles. What is compiled for tests alone is
//! not looked at. A rule that names what is not there, or an exception that nobody needs, fails as well.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/source.rs"]
mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use source::{Target, Tree};

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
    ("blob", &[]),
    ("keys", &[]),
    ("readiness", &[]),
    ("lifecycle", &["metrics"]),
    ("trace", &[]),
    ("telemetry", &["config"]),
    ("job", &["blob", "remesh", "cvt", "rvd", "mesh", "config", "memory", "trace"]),
    ("metrics", &["job", "readiness", "rvd", "memory"]),
    // Knows nothing of gRPC, nor who finds faults.
    ("admin", &["metrics", "readiness"]),
    ("wire", &["remesh", "cvt", "rvd", "mesh"]),
    (
        "service",
        &[
            "wire",
            "job",
            "blob",
            "keys",
            "lifecycle",
            "remesh",
            "cvt",
            "rvd",
            "mesh",
            "config",
            "memory",
            "metrics",
            "readiness",
            "trace",
        ],
    ),
    // Sees what `service` has for every door, and nothing of gRPC.
    ("http", &["service", "job", "mesh", "blob", "keys", "metrics", "remesh", "trace", "wire"]),
    // Its client speaks to a server through the wire, and imports nothing of it.
    (
        "cli",
        &["wire", "job", "keys", "remesh", "cvt", "rvd", "knn", "mesh", "picture", "config", "telemetry", "memory"],
    ),
    (
        "internals",
        &[
            "blob",
            "cli",
            "config",
            "cvt",
            "gpu",
            "http",
            "job",
            "keys",
            "knn",
            "mesh",
            "metrics",
            "readiness",
            "remesh",
            "rvd",
            "service",
        ],
    ),
    ("main", &["internals"]),
    ("lib", &[]),
];

/// Parts of rooms that may use more: (module, more rooms).
const DOORS: &[(&str, &[&str])] = &[
    ("rvd/gpu", &["gpu"]),
    // Opens the device for the backend.
    ("rvd/backends", &["gpu"]),
    ("cvt/curves", &["knn"]),
    ("cvt/density", &["knn"]),
    // Lists the adapters.
    ("cli/doctor", &["gpu"]),
    ("cli/serve", &["admin", "http", "lifecycle", "metrics", "readiness", "service"]),
];

/// Crate, and the modules it may appear in.
const CRATES: &[(&str, &[&str])] = &[
    ("wgpu", &["gpu", "rvd/gpu"]),
    // Of the wire the generated code alone: how messages travel is no matter of theirs.
    ("tonic", &["service", "wire/proto", "cli"]),
    ("prost", &["service", "wire"]),
    ("crc32c", &["blob", "wire"]),
    ("hyper", &["admin", "cli/health", "service/connections"]),
    ("hyper_util", &["admin", "cli/health", "service/connections"]),
    ("axum", &["admin", "http", "service"]),
    ("prometheus_client", &["metrics"]),
    ("opentelemetry", &["telemetry/traces", "trace"]),
    ("opentelemetry_otlp", &["telemetry/traces"]),
    ("opentelemetry_sdk", &["telemetry/traces"]),
    ("tracing_opentelemetry", &["telemetry/traces", "trace"]),
    ("tracing_appender", &["telemetry"]),
    ("tracing_subscriber", &["telemetry"]),
    ("http_body", &["http/guard", "service/connections", "service/access"]),
    ("form_urlencoded", &["http/options"]),
    ("governor", &["service/access"]),
    ("subtle", &["keys"]),
    ("socket2", &["service/connections"]),
    ("flate2", &["mesh/io/packed", "mesh/io/vtk", "service/connections/unpacking"]),
    ("quick_xml", &["mesh/io/vtk"]),
    ("base64", &["mesh/io/gltf", "mesh/io/vtk"]),
    ("zstd", &["service/connections/unpacking"]),
    ("rustix", &["blob/staging", "job/worker", "service/connections"]),
    ("object_store", &["blob"]),
    ("reqwest", &["blob/s3"]),
    ("rustls", &["blob/s3", "service/connections"]),
    ("tokio_rustls", &["service/connections"]),
    ("toml", &["config"]),
    ("sha2", &["blob", "keys", "wire/pieces"]),
    ("tokio", &["admin", "blob", "http", "job", "lifecycle", "readiness", "service", "cli", "telemetry", "trace"]),
    ("redb", &["job/store"]),
    ("clap", &["config", "cli", "main"]),
    ("clap_complete", &["cli/completions"]),
    ("clap_mangen", &["cli/completions"]),
    ("temp_env", &["cli/surroundings"]),
    ("anyhow", &["cli", "main"]),
    ("hdrhistogram", &["cli/load"]),
    ("kiddo", &["knn"]),
    ("tobj", &["mesh/io"]),
    ("tikv_jemallocator", &["main"]),
    ("png", &["picture"]),
    ("plotters", &["picture/chart"]),
    ("noto_sans_mono_bitmap", &["picture/chart"]),
];

/// Circles that stay for now: the one uses the other, which goes back to it; and why.
const CIRCLES: &[(&str, &str, &str)] = &[];

/// The rules, apart from the tables, so that the checks can be tried on a house of straw.
struct Rules<'a> {
    rooms: &'a [(&'a str, &'a [&'a str])],
    doors: &'a [(&'a str, &'a [&'a str])],
    crates: &'a [(&'a str, &'a [&'a str])],
    circles: &'a [(&'a str, &'a str, &'a str)],
}

const RULES: Rules<'static> = Rules { rooms: ROOMS, doors: DOORS, crates: CRATES, circles: CIRCLES };

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

fn tree() -> &'static Tree {
    static TREE: LazyLock<Tree> =
        LazyLock::new(|| Tree::read(&|file| fs::read_to_string(root().join(file).with_extension("rs")).ok()));
    &TREE
}

/// Source files below `folder`.
fn files(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            files(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// How a module is called in rules.
fn name(path: &[String]) -> String {
    if path.is_empty() { "lib".to_owned() } else { path.join("/") }
}

fn within(name: &str, prefix: &str) -> bool {
    name == prefix || name.strip_prefix(prefix).is_some_and(|rest| rest.starts_with('/'))
}

/// The room that a path from the root leads into. What the root passes on is of the room where it is defined.
fn room_of(tree: &Tree, path: &[String]) -> Option<String> {
    let first = path.first()?;
    if tree.module(std::slice::from_ref(first)).is_some() {
        return Some(first.clone());
    }
    tree.home(path).and_then(|home| tree.modules[home].path.first().cloned())
}

fn upward_uses(tree: &Tree, rules: &Rules<'_>) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut opened = BTreeSet::new();
    for (at, module) in tree.modules.iter().enumerate() {
        let name = name(&module.path);
        let room = name.split('/').next().unwrap();
        let Some((_, allowed)) = rules.rooms.iter().find(|(r, _)| *r == room) else {
            wrong.push(format!("no rule for the room {room}"));
            continue;
        };
        for used in &module.uses {
            let Target::Here(path) = tree.resolve(at, &used.path) else { continue };
            let Some(other) = room_of(tree, &path) else { continue };
            // The root passes on what the interface is made of. Everybody listens to the token.
            if room == "lib" || other == room || other == "token" || allowed.contains(&other.as_str()) {
                continue;
            }
            let door = rules.doors.iter().find(|(place, more)| within(&name, place) && more.contains(&other.as_str()));
            match door {
                Some((place, _)) => {
                    opened.insert((*place, other));
                }
                None => {
                    let (file, line, path) = (&module.file, used.line, used.path.join("::"));
                    wrong.push(format!("src/{file}.rs:{line}: {room} must not use {other}: {path}"));
                }
            }
        }
    }
    for (place, rooms) in rules.doors {
        for room in *rooms {
            if !opened.contains(&(*place, (*room).to_owned())) {
                wrong.push(format!("DOORS: nothing in {place} uses {room}; take the entry out"));
            }
        }
    }
    wrong
}

/// Modules and crates of the rules that do not exist, and modules without a rule.
fn rules_about_nothing(tree: &Tree, rules: &Rules<'_>, manifest: &str) -> Vec<String> {
    let names: BTreeSet<String> = tree.modules.iter().map(|m| name(&m.path)).collect();
    let mut wrong = Vec::new();
    let mut module = |table: &str, place: &str| {
        if !names.contains(place) {
            wrong.push(format!("{table}: there is no module {place}"));
        }
    };
    for (room, allowed) in rules.rooms {
        [room].into_iter().chain(*allowed).for_each(|place| module("ROOMS", place));
    }
    for (place, rooms) in rules.doors {
        [place].into_iter().chain(*rooms).for_each(|place| module("DOORS", place));
    }
    for (_, places) in rules.crates {
        places.iter().for_each(|place| module("CRATES", place));
    }
    for (one, other, _) in rules.circles {
        [one, other].into_iter().for_each(|place| module("CIRCLES", place));
    }
    for (word, _) in rules.crates {
        let is = |line: &str| line.split_once(" = ").is_some_and(|(name, _)| name.replace('-', "_") == *word);
        if !manifest.lines().any(is) {
            wrong.push(format!("CRATES: the manifest has no {word}"));
        }
    }
    wrong
}

fn crates_elsewhere(tree: &Tree, rules: &Rules<'_>) -> Vec<String> {
    let mut wrong = Vec::new();
    for (at, module) in tree.modules.iter().enumerate() {
        let name = name(&module.path);
        for used in &module.uses {
            let Target::Crate(found) = tree.resolve(at, &used.path) else { continue };
            let Some((_, places)) = rules.crates.iter().find(|(word, _)| *word == found) else { continue };
            if !places.iter().any(|place| within(&name, place)) {
                let (file, line, path) = (&module.file, used.line, used.path.join("::"));
                wrong.push(format!("src/{file}.rs:{line}: {found} does not belong here: {path}"));
            }
        }
    }
    wrong
}

/// Which parts of a module use which of its other parts, with one place of each.
type Uses = BTreeMap<(String, String), String>;

/// For every module, what its parts use of each other. A part and what it is a part of are one: neither uses the other.
fn uses_between_parts(tree: &Tree) -> BTreeMap<String, Uses> {
    let mut all: BTreeMap<String, Uses> = BTreeMap::new();
    for (at, module) in tree.modules.iter().enumerate() {
        for used in &module.uses {
            let Target::Here(path) = tree.resolve(at, &used.path) else { continue };
            let Some(home) = tree.home(&path) else { continue };
            let (from, to) = (&module.path, &tree.modules[home].path);
            let shared = from.iter().zip(to).take_while(|(a, b)| a == b).count();
            if shared == 0 || shared == from.len() || shared == to.len() {
                continue;
            }
            let place = format!("src/{}.rs:{}: {}", module.file, used.line, used.path.join("::"));
            let parts = (name(&from[..=shared]), name(&to[..=shared]));
            all.entry(name(&from[..shared])).or_default().entry(parts).or_insert(place);
        }
    }
    all
}

/// Whether uses lead from one part to another.
fn leads(uses: &Uses, from: &str, to: &str, without: &dyn Fn(&(String, String)) -> bool) -> bool {
    let (mut seen, mut open) = (BTreeSet::new(), vec![from]);
    while let Some(part) = open.pop() {
        for edge in uses.keys().filter(|edge| edge.0 == part && !without(edge)) {
            if edge.1 == to {
                return true;
            }
            if seen.insert(edge.1.as_str()) {
                open.push(&edge.1);
            }
        }
    }
    false
}

fn circles(tree: &Tree, rules: &Rules<'_>) -> Vec<String> {
    let mut wrong = Vec::new();
    let all = uses_between_parts(tree);
    let listed = |edge: &(String, String)| rules.circles.iter().any(|(a, b, _)| *a == edge.0 && *b == edge.1);
    for uses in all.values() {
        for (edge, place) in uses.iter().filter(|(edge, _)| !listed(edge)) {
            if leads(uses, &edge.1, &edge.0, &listed) {
                wrong.push(format!("{place}: {} uses {}, which goes back to it", edge.0, edge.1));
            }
        }
    }
    for (one, other, _) in rules.circles {
        let edge = ((*one).to_owned(), (*other).to_owned());
        if !all.values().any(|uses| uses.contains_key(&edge) && leads(uses, other, one, &|_| false)) {
            wrong.push(format!("CIRCLES: {one} and {other} are in no circle by that use; take the entry out"));
        }
    }
    wrong
}

fn expect_none(wrong: &[String]) {
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn rooms_use_only_what_lies_below_them() {
    expect_none(&upward_uses(tree(), &RULES));
}

#[test]
fn rules_are_about_what_there_is() {
    let manifest = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")).unwrap();
    expect_none(&rules_about_nothing(tree(), &RULES, &manifest));
}

#[test]
fn crates_stay_in_their_rooms() {
    expect_none(&crates_elsewhere(tree(), &RULES));
}

#[test]
fn the_parts_of_a_room_do_not_go_in_circles() {
    expect_none(&circles(tree(), &RULES));
}

#[test]
fn every_file_is_part_of_the_house() {
    let tree = tree();
    let mut all = Vec::new();
    files(&root(), &mut all);
    let mut wrong = Vec::new();
    for path in all {
        let file = path.strip_prefix(root()).unwrap().with_extension("").to_string_lossy().replace('\\', "/");
        let declared = tree.modules.iter().any(|m| m.file == file) || tree.test_files.iter().any(|t| within(&file, t));
        if !declared {
            wrong.push(format!("src/{file}.rs is declared by no module"));
        }
    }
    expect_none(&wrong);
}

#[test]
fn cvt_and_the_dual_cannot_name_a_backend() {
    let tree = tree();
    let mut wrong = Vec::new();
    for (at, module) in tree.modules.iter().enumerate() {
        let from = name(&module.path);
        if !(within(&from, "cvt") || within(&from, "rvd/dual")) {
            continue;
        }
        for used in &module.uses {
            let Target::Here(path) = tree.resolve(at, &used.path) else { continue };
            let home = tree.home(&path).map(|home| name(&tree.modules[home].path)).unwrap_or_default();
            if ["rvd/serial", "rvd/parallel", "rvd/gpu", "rvd/backends"].iter().any(|backend| within(&home, backend)) {
                wrong.push(format!("src/{}.rs:{}: {}", module.file, used.line, used.path.join("::")));
            }
        }
    }
    expect_none(&wrong);
}

/// What the device computes is the diagram's matter: layouts and plans that speak of it are in `rvd/gpu`.
#[test]
fn the_device_knows_no_seed_and_no_facet() {
    let mut wrong = Vec::new();
    for module in tree().modules.iter().filter(|module| within(&name(&module.path), "gpu")) {
        let text = fs::read_to_string(root().join(&module.file).with_extension("rs")).unwrap();
        let code = text.lines().enumerate().filter(|(_, line)| !line.starts_with("//!"));
        for (k, line) in code {
            let words = line.split(|c: char| !c.is_alphanumeric()).map(str::to_lowercase);
            let of_diagrams = ["seed", "seeds", "facet", "facets", "cell", "cells", "corner", "mesh"];
            for word in words.filter(|word| of_diagrams.contains(&word.as_str())) {
                wrong.push(format!("src/{}.rs:{}: {word}", module.file, k + 1));
            }
        }
    }
    expect_none(&wrong);
}

/// The generated code has a half for the client and one for the server, in modules of their own.
#[test]
fn the_client_and_the_wire_know_no_server() {
    let mut wrong = Vec::new();
    for module in &tree().modules {
        let from = name(&module.path);
        if !(within(&from, "cli") || within(&from, "wire")) || from == "cli/serve" {
            continue;
        }
        for used in module.uses.iter().filter(|used| used.path.iter().any(|part| part.ends_with("_server"))) {
            wrong.push(format!("src/{}.rs:{}: {}", module.file, used.line, used.path.join("::")));
        }
    }
    expect_none(&wrong);
}

/// What prints by itself panics when nobody reads any more.
#[test]
fn one_place_prints() {
    let mut wrong = Vec::new();
    for module in &tree().modules {
        for (called, line) in &module.macros {
            if ["println", "eprintln", "print", "eprint", "dbg"].contains(&called.as_str()) {
                wrong.push(format!("src/{}.rs:{line}: use outln! or errln!, not {called}!", module.file));
            }
        }
    }
    expect_none(&wrong);
}

#[test]
fn every_module_says_what_it_is_for() {
    let mut all = Vec::new();
    files(&root(), &mut all);
    for path in all {
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("//!"), "{} has no head", path.display());
    }
}

/// A house of straw.
fn straw(files: &[(&str, &str)]) -> Tree {
    Tree::read(&|file| files.iter().find(|(name, _)| *name == file).map(|(_, text)| (*text).to_owned()))
}

const STRAW_ROOMS: &[(&str, &[&str])] = &[("lib", &[]), ("low", &[]), ("high", &["low"])];
const STRAW: Rules<'static> = Rules { rooms: STRAW_ROOMS, doors: &[], crates: &[("tonic", &["high"])], circles: &[] };
const STRAW_LIB: (&str, &str) = ("lib", "mod low; mod high;");
const STRAW_HIGH: (&str, &str) = ("high", "pub struct Tower; pub fn climb() {}");

/// Lines of `low` that are wrong.
fn wrong_lines(low: &str) -> Vec<usize> {
    let tree = straw(&[STRAW_LIB, STRAW_HIGH, ("low", low)]);
    let wrong = [upward_uses(&tree, &STRAW), crates_elsewhere(&tree, &STRAW)].concat();
    wrong.iter().map(|text| text.split(':').nth(1).unwrap().parse().unwrap()).collect()
}

#[test]
fn items_after_a_test_are_looked_at() {
    assert_eq!(wrong_lines("#[cfg(test)]\nmod tests { use crate::high::Tower; }\nuse crate::high::Tower;"), [3]);
    assert_eq!(wrong_lines("struct A;\nimpl A {\n#[cfg(test)]\nfn a() { crate::high::climb() }\n}"), [0; 0]);
    assert_eq!(wrong_lines("#[cfg(all(test, unix))]\nuse crate::high::Tower;"), [0; 0]);
    assert_eq!(wrong_lines("#[cfg(any(test, unix))]\nuse crate::high::Tower;"), [2]);
    assert_eq!(wrong_lines("#[cfg(not(test))]\nuse crate::high::Tower;"), [2]);
    assert_eq!(
        wrong_lines("// crate::high::climb()\n/* crate::high::climb() */\nconst A: &str = \"crate::high::B\";"),
        [0; 0]
    );
}

#[test]
fn paths_are_found_however_they_are_written() {
    for (low, lines) in [
        ("use crate::{\nhigh::{self as h},\n};", &[2][..]),
        ("use super::high;\nfn a() { high::climb() }", &[1, 2]),
        ("fn a() {\nlet t: Vec<super::high::Tower> = Vec::new();\n}", &[2]),
        ("mod inner {\nuse super::super::high::*;\n}", &[2]),
        ("use crate as house;\nuse house::high::Tower;", &[2]),
        ("fn a() {\nprintln!(\"{}\", [crate::high::climb()]);\n}", &[2]),
        ("#[derive(crate::high::Tower)]\nstruct A;", &[1]),
        ("pub(in crate::high) struct A;", &[1]),
        ("macro_rules! a {\n() => { $crate::high::climb() };\n}", &[2]),
        ("use tonic::Status;", &[1]),
        ("fn a() {\n::tonic::a();\nmy::tonic::b();\n}", &[2]),
        ("use self::own::tonic as t;\nmod own { pub mod tonic {} }\nfn a() { t::b() }", &[]),
        ("fn a() {\nm!(::tonic::a, b::tonic::c);\n}", &[2]),
    ] {
        assert_eq!(wrong_lines(low), lines, "{low}");
    }
}

#[test]
fn the_client_must_not_import_the_service() {
    let house = |client: &str| {
        straw(&[
            ("lib", "mod cli; mod service; mod wire;"),
            ("cli", "mod remote; mod serve;"),
            ("cli/remote", client),
            ("cli/serve", "use crate::service::run;"),
            ("service", "pub fn run() {}"),
            ("wire", ""),
        ])
    };
    let rooms: &[(&str, &[&str])] = &[("lib", &[]), ("cli", &["wire"]), ("service", &["wire"]), ("wire", &[])];
    let rules = Rules { rooms, doors: &[("cli/serve", &["service"])], crates: &[], circles: &[] };
    expect_none(&upward_uses(&house("use crate::wire;"), &rules));
    assert_eq!(upward_uses(&house("use crate::service::run;"), &rules).len(), 1);
    assert_eq!(upward_uses(&house("use super::super::service;"), &rules).len(), 1);
}

#[test]
fn rules_about_nothing_are_refused() {
    let tree = straw(&[STRAW_LIB, STRAW_HIGH, ("low", "mod part;"), ("low/part", "use crate::high::Tower;")]);
    let manifest = "tonic = \"1\"";
    expect_none(&rules_about_nothing(&tree, &STRAW, manifest));
    for rules in [
        Rules { rooms: &[("lib", &[]), ("low", &["attic"])], ..STRAW },
        Rules { doors: &[("low/attic", &["high"])], ..STRAW },
        Rules { crates: &[("tonic", &["low/attic"])], ..STRAW },
        Rules { crates: &[("none_such", &["low"])], ..STRAW },
        Rules { circles: &[("low/part", "low/attic", "")], ..STRAW },
    ] {
        assert_eq!(rules_about_nothing(&tree, &rules, manifest).len(), 1);
    }
    // A room without a rule, and a door that nobody goes through.
    assert!(!upward_uses(&tree, &Rules { rooms: &[("lib", &[]), ("low", &[])], ..STRAW }).is_empty());
    expect_none(&upward_uses(&tree, &Rules { doors: &[("low/part", &["high"])], ..STRAW }));
    assert_eq!(upward_uses(&tree, &Rules { doors: &[("low", &["high"]), ("low/part", &["high"])], ..STRAW }).len(), 1);
}

#[test]
fn circles_are_found() {
    let house = |a: &str, b: &str| {
        let low = ("low", "mod a; mod b; mod c; pub use c::Thing; use a::A;");
        straw(&[
            STRAW_LIB,
            STRAW_HIGH,
            low,
            ("low/a", a),
            ("low/b", b),
            ("low/c", "pub struct Thing; use super::a::A;"),
        ])
    };
    let count = |a: &str, b: &str| circles(&house(a, b), &STRAW).len();
    // A part may use what it is a part of, and is used by it.
    assert_eq!(count("pub struct A; use super::X;", "use super::a::A;"), 0);
    assert_eq!(count("pub struct A; use super::b::B;", "pub struct B; use super::a::A;"), 2);
    // Through what the module above passes on.
    assert_eq!(count("pub struct A; use super::Thing;", ""), 2);
    assert_eq!(count("pub struct A; use super::*; fn f(_: Thing) {}", ""), 2);
    assert_eq!(count("pub struct A;\n#[cfg(test)]\nuse super::c::Thing;", ""), 0);
    let listed = Rules { circles: &[("low/a", "low/c", "for now")], ..STRAW };
    expect_none(&circles(&house("pub struct A; use super::Thing;", ""), &listed));
    assert_eq!(circles(&house("pub struct A;", ""), &listed).len(), 1);
}
