//! Promise: inside the crates of `src/` the order holds that Cargo cannot keep, and the rules are about what there is.
//!
//! Cargo keeps what a crate may use of the others. Rooms are the modules at the top of a crate. Each may use the rooms below it and
//! none above; outside crates of weight have the modules they may appear in; the parts of a room do not go in circles. What is compiled for tests alone is
//! not looked at. A rule that names what is not there, or an exception that nobody needs, fails as well.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/source.rs"]
mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use source::{Target, Tree};

/// A crate of `src/`, and what Cargo cannot hold of its order.
struct House {
    name: &'static str,
    rules: Rules<'static>,
}

const fn house(name: &'static str, rooms: Rooms, crates: Rooms) -> House {
    House { name, rules: Rules { rooms, doors: &[], crates, circles: &[] } }
}

/// Names, and what each may use or where it may be used.
type Rooms = &'static [(&'static str, &'static [&'static str])];

/// Crates, each with its rooms, the rooms that each may use beside itself, and outside crates with the rooms they may appear in. What
/// a crate may use of the others stands in its `Cargo.toml`. Without rooms, only circles are looked for.
const HOUSES: &[House] = &[
    house(
        "geometry",
        &[
            ("token", &[]),
            ("tasks", &[]),
            ("mesh", &[]),
            ("knn", &["mesh"]),
            ("rvd", &["knn", "mesh"]),
            ("cvt", &["knn", "rvd", "mesh"]),
            ("remesh", &["cvt", "rvd", "mesh"]),
            ("lib", &[]),
        ],
        &[
            ("flate2", &["mesh/io/packed", "mesh/io/vtk"]),
            ("quick_xml", &["mesh/io/threemf", "mesh/io/vtk"]),
            ("zip", &["mesh/io/threemf"]),
            ("base64", &["mesh/io/gltf", "mesh/io/vtk"]),
            ("tobj", &["mesh/io"]),
            ("kiddo", &["knn"]),
        ],
    ),
    house("gpu", &[], &[]),
    house("picture", &[], &[("png", &["lib", "image"]), ("plotters", &["chart"])]),
    house("wire", &[], &[("tonic", &["proto"]), ("sha2", &["pieces"])]),
    house("telemetry", &[], &[("opentelemetry", &["trace", "traces"])]),
    house(
        "transport",
        &[],
        &[
            ("socket2", &["socket"]),
            ("rustls", &["tls", "handshake"]),
            ("tokio_rustls", &["handshake"]),
            ("x509_parser", &["tls"]),
            ("zstd", &["unpacking"]),
            ("flate2", &["unpacking"]),
            ("prometheus_client", &["counters", "account"]),
        ],
    ),
    house(
        "jobs",
        &[
            ("blob", &[]),
            ("beside", &[]),
            ("memory", &[]),
            ("places", &[]),
            ("record", &["blob"]),
            ("store", &["beside", "record", "blob"]),
            ("postgres", &["store", "beside", "record", "blob"]),
            ("observe", &["record"]),
            ("engine", &["beside", "observe", "places", "record", "memory"]),
            ("admission", &["engine", "observe", "places", "store", "record", "blob"]),
            ("executor", &["admission", "engine", "observe", "places", "postgres", "store", "record", "blob"]),
            ("lib", &[]),
        ],
        &[("redb", &["store"]), ("sqlx", &["postgres"]), ("object_store", &["blob"]), ("reqwest", &["blob/s3"])],
    ),
    house(
        "server",
        &[
            ("config", &[]),
            ("keys", &[]),
            ("hosts", &[]),
            ("readiness", &[]),
            ("metrics", &["readiness"]),
            ("lifecycle", &["metrics"]),
            // Knows nothing of gRPC, nor what finds faults.
            ("admin", &["hosts", "metrics", "readiness"]),
            ("cluster", &["metrics", "readiness"]),
            ("service", &["cluster", "hosts", "keys", "lifecycle", "config", "metrics", "readiness"]),
            // Sees what `service` has for every interface, and nothing of gRPC.
            ("http", &["service", "keys", "metrics"]),
            ("lib", &[]),
        ],
        &[
            ("tonic", &["service"]),
            ("prost", &["service"]),
            ("axum", &["admin", "hosts", "http", "service"]),
            ("tower_http", &["http"]),
            ("clap", &["config"]),
            ("toml", &["config"]),
            ("subtle", &["keys"]),
            ("governor", &["service/access"]),
            ("prometheus_client", &["metrics"]),
            ("form_urlencoded", &["http/options"]),
            ("multer", &["http/form"]),
        ],
    ),
    house(
        "cli",
        &[],
        &[("hdrhistogram", &["load"]), ("clap_complete", &["completions"]), ("temp_env", &["surroundings"])],
    ),
];

/// The rules, apart from the tables, so that the checks can be tried on a house of straw.
struct Rules<'a> {
    rooms: &'a [(&'a str, &'a [&'a str])],
    doors: &'a [(&'a str, &'a [&'a str])],
    crates: &'a [(&'a str, &'a [&'a str])],
    circles: &'a [(&'a str, &'a str, &'a str)],
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// All crates of `src/` with their modules.
fn trees() -> &'static [(&'static House, Tree)] {
    static TREES: LazyLock<Vec<(&'static House, Tree)>> = LazyLock::new(|| {
        let read = |house: &'static House| {
            let root = root().join(house.name);
            (house, Tree::read(&|file| fs::read_to_string(root.join(file).with_extension("rs")).ok()))
        };
        HOUSES.iter().map(read).collect()
    });
    &TREES
}

/// What `find` finds in each crate, with the crate's name.
fn in_all(find: impl Fn(&House, &Tree) -> Vec<String>) -> Vec<String> {
    let named = |(house, tree): &(&'static House, Tree)| -> Vec<String> {
        find(house, tree).into_iter().map(|wrong| format!("{}: {wrong}", house.name)).collect()
    };
    trees().iter().flat_map(named).collect()
}

fn tree_of(name: &str) -> &'static Tree {
    &trees().iter().find(|(house, _)| house.name == name).unwrap().1
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
            // The root passes on what the interface is made of. All listen to the token and share their loops' items.
            if room == "lib"
                || other == room
                || other == "token"
                || other == "tasks"
                || allowed.contains(&other.as_str())
            {
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
        let is = |line: &str| line.split([' ', '.']).next().is_some_and(|name| name.replace('-', "_") == *word);
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
fn every_crate_has_its_rules() {
    let mut there: Vec<_> =
        fs::read_dir(root()).unwrap().map(|entry| entry.unwrap()).filter(|entry| entry.path().is_dir()).collect();
    there.sort_by_key(fs::DirEntry::file_name);
    let mut named: Vec<_> = HOUSES.iter().map(|house| house.name).collect();
    named.sort_unstable();
    assert_eq!(there.iter().map(|entry| entry.file_name().into_string().unwrap()).collect::<Vec<_>>(), named);
}

#[test]
fn rooms_use_only_what_lies_below_them() {
    expect_none(&in_all(|house, tree| match house.rules.rooms {
        [] => Vec::new(),
        _ => upward_uses(tree, &house.rules),
    }));
}

#[test]
fn rules_are_about_what_there_is() {
    expect_none(&in_all(|house, tree| {
        let manifest = fs::read_to_string(root().join(house.name).join("Cargo.toml")).unwrap();
        rules_about_nothing(tree, &house.rules, &manifest)
    }));
}

#[test]
fn crates_stay_in_their_rooms() {
    expect_none(&in_all(|house, tree| crates_elsewhere(tree, &house.rules)));
}

#[test]
fn the_parts_of_a_room_do_not_go_in_circles() {
    expect_none(&in_all(|house, tree| circles(tree, &house.rules)));
}

#[test]
fn every_file_is_part_of_the_house() {
    expect_none(&in_all(|house, tree| {
        let root = root().join(house.name);
        let mut all = Vec::new();
        files(&root, &mut all);
        let name =
            |path: &PathBuf| path.strip_prefix(&root).unwrap().with_extension("").to_string_lossy().replace('\\', "/");
        let declared = |file: &String| {
            file == "build"
                || tree.modules.iter().any(|m| m.file == *file)
                || tree.test_files.iter().any(|test| within(file, test))
        };
        all.iter()
            .map(name)
            .filter(|file| !declared(file))
            .map(|file| format!("{file}.rs is declared by no module"))
            .collect()
    }));
}

#[test]
fn cvt_and_the_dual_cannot_name_a_backend() {
    let tree = tree_of("geometry");
    let mut wrong = Vec::new();
    for (at, module) in tree.modules.iter().enumerate() {
        let from = name(&module.path);
        if !(within(&from, "cvt") || within(&from, "rvd/dual")) {
            continue;
        }
        for used in &module.uses {
            let Target::Here(path) = tree.resolve(at, &used.path) else { continue };
            let home = tree.home(&path).map(|home| name(&tree.modules[home].path)).unwrap_or_default();
            if ["rvd/serial", "rvd/parallel"].iter().any(|backend| within(&home, backend)) {
                wrong.push(format!("{}.rs:{}: {}", module.file, used.line, used.path.join("::")));
            }
        }
    }
    expect_none(&wrong);
}

/// What the device computes is the diagram's matter: layouts and plans that speak of it are in `diagram`.
#[test]
fn the_device_knows_no_seed_and_no_facet() {
    let mut wrong = Vec::new();
    let above = ["diagram", "backends", "lib"];
    for module in &tree_of("gpu").modules {
        let from = name(&module.path);
        if above.iter().any(|room| within(&from, room)) {
            continue;
        }
        let text = fs::read_to_string(root().join("gpu").join(&module.file).with_extension("rs")).unwrap();
        let code = text.lines().enumerate().filter(|(_, line)| !line.starts_with("//!"));
        let of_geometry = module.uses.iter().filter(|used| used.path.first().is_some_and(|first| first == "geometry"));
        for used in of_geometry.filter(|used| used.path.get(1).is_none_or(|room| room != "token")) {
            wrong.push(format!("{}.rs:{}: {}", module.file, used.line, used.path.join("::")));
        }
        for (k, line) in code {
            let words = line.split(|c: char| !c.is_alphanumeric()).map(str::to_lowercase);
            let of_diagrams = ["seed", "seeds", "facet", "facets", "cell", "cells", "corner", "mesh"];
            for word in words.filter(|word| of_diagrams.contains(&word.as_str())) {
                wrong.push(format!("{}.rs:{}: {word}", module.file, k + 1));
            }
        }
    }
    expect_none(&wrong);
}

/// The generated code has a half for the client and one for the server, in modules of their own. Beside the command that serves,
/// the command line is a client.
#[test]
fn the_client_and_the_wire_know_no_server() {
    let clients = ["remote", "endpoint", "trust", "load", "jobs", "blobs", "info", "health"];
    expect_none(&in_all(|house, tree| {
        let mut wrong = Vec::new();
        for module in tree.modules.iter().filter(|_| ["cli", "wire"].contains(&house.name)) {
            let from = name(&module.path);
            let is_client = house.name == "wire" || clients.iter().any(|room| within(&from, room));
            for used in module.uses.iter().filter(|_| from != "serve") {
                let of_server = used.path.first().is_some_and(|first| first == "server")
                    && used.path.get(1).is_some_and(|room| room != "config");
                if used.path.iter().any(|part| part.ends_with("_server")) || is_client && of_server {
                    wrong.push(format!("{}.rs:{}: {}", module.file, used.line, used.path.join("::")));
                }
            }
        }
        wrong
    }));
}

/// What prints by itself panics when nobody reads any more.
#[test]
fn one_place_prints() {
    expect_none(&in_all(|_, tree| {
        let calls = tree.modules.iter().flat_map(|module| module.macros.iter().map(move |call| (module, call)));
        calls
            .filter(|(_, (called, _))| ["println", "eprintln", "print", "eprint", "dbg"].contains(&called.as_str()))
            .map(|(module, (called, line))| format!("{}.rs:{line}: use outln! or errln!, not {called}!", module.file))
            .collect()
    }));
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
