//! Promise: `--creases` keeps the edges that a file names, and says which line of it is wrong; edges that the surface's file
//! names are kept too, and so are vertices that it requires.

use std::path::Path;
use std::process::{Command, Output};

use tessera::mesh::io;
use tessera::mesh::shapes::Shape;

fn remesh(input: &Path, creases: Option<&Path>, output: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.env_remove("RUST_BACKTRACE").arg("remesh").arg(input).arg("-o").arg(output);
    command.args(["--points", "300", "--backend", "serial", "--lloyd", "3", "--newton", "0"]);
    command.arg("--report").arg(output.with_extension("json"));
    if let Some(creases) = creases {
        command.arg("--creases").arg(creases);
    }
    command.output().unwrap()
}

#[test]
fn edges_of_a_file_become_creases() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let sphere = Shape::Sphere.build(2000);
    io::write(&at("sphere.ply"), &sphere).unwrap();
    // As read: the numbers are those of the file.
    let sphere = io::read(&at("sphere.ply")).unwrap();
    let (from, to) = (sphere.facets()[0][0], sphere.facets()[0][1]);
    // Along the sphere by the edges that lead on best.
    let (mut line, mut before, mut here) = (vec![format!("{from} {to}")], from, to);
    while line.len() < 12 {
        let p = |v: u32| sphere.positions()[v as usize];
        let way = (p(here) - p(before)).normalize();
        let next = sphere.facets().iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let next = next.filter(|e| e[0] == here && e[1] != before).map(|e| e[1]);
        let ahead = |v: &u32| (p(*v) - p(here)).normalize().dot(way);
        (before, here) = (here, next.max_by(|a, b| ahead(a).total_cmp(&ahead(b))).unwrap());
        line.push(format!("{before} {here}"));
    }
    let creases = at("creases.txt");
    let kept_of = |input: &str, creases: Option<&Path>| {
        let done = remesh(&at(input), creases, &at("out.ply"));
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let report: serde_json::Value = serde_json::from_slice(&std::fs::read(at("out.json")).unwrap()).unwrap();
        (report["features"]["creases"].as_u64().unwrap(), report["features"]["missing_segments"].as_u64().unwrap())
    };
    let kept = |lines: &[String]| {
        std::fs::write(&creases, lines.join("\n")).unwrap();
        kept_of("sphere.ply", Some(&creases))
    };
    assert_eq!(kept(&["# none".to_owned()]).0, 0);
    assert_eq!(kept(&line), (1, 0));
    // The same edges in the surface's own file, counted from 1.
    let text = String::from_utf8(io::encode(io::Format::Medit, &sphere).unwrap()).unwrap();
    let count = line.len();
    let from_1 = |edge: &String| {
        let ends: Vec<u32> = edge.split(' ').map(|v| v.parse::<u32>().unwrap() + 1).collect();
        format!("{} {} 0\n", ends[0], ends[1])
    };
    let edges: String = line.iter().map(from_1).collect();
    let numbers: String = (1..=count).map(|n| format!("{n}\n")).collect();
    std::fs::write(at("none.mesh"), &text).unwrap();
    let named = text.replace("End\n", &format!("Edges\n{count}\n{edges}RequiredEdges\n{count}\n{numbers}End\n"));
    std::fs::write(at("named.mesh"), named).unwrap();
    assert_eq!(kept_of("none.mesh", None).0, 0);
    assert_eq!(kept_of("named.mesh", None), (1, 0));
}

#[test]
fn required_vertices_of_a_file_stay() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let sphere = Shape::Sphere.build(2000);
    let text = String::from_utf8(io::encode(io::Format::Medit, &sphere).unwrap()).unwrap();
    std::fs::write(at("named.mesh"), text.replace("End\n", "RequiredVertices\n3\n1\n700\n1\nEnd\n")).unwrap();
    let done = remesh(&at("named.mesh"), None, &at("out.ply"));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(at("out.json")).unwrap()).unwrap();
    assert_eq!(report["result"]["kept"]["single_vertices"], 2, "{report}");
    let (given, result) = (io::read(&at("named.mesh")).unwrap(), io::read(&at("out.ply")).unwrap());
    for v in [0, 699] {
        let p = given.positions()[v];
        assert!(result.positions().iter().any(|q| q.distance(p) < 1e-6), "{p}");
    }
}

#[test]
fn parts_of_a_list_stay() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    io::write(&at("sphere.obj"), &Shape::Sphere.build(2000)).unwrap();
    std::fs::write(at("list.txt"), "# two rows\n3-5, 9\n20\n\n").unwrap();
    let part = format!("facets:@{}", at("list.txt").display());
    let run = |options: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
        command.env_remove("RUST_BACKTRACE").arg("remesh").arg(at("sphere.obj")).arg("-o").arg(at("out.ply"));
        command.args(["--points", "400", "--backend", "serial", "--overwrite", "--report"]).arg(at("out.json"));
        command.args(options).output().unwrap()
    };
    let done = run(&["--keep", &part, "--size-in", &format!("{part}=0.1")]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(at("out.json")).unwrap()).unwrap();
    let kept = &report["result"]["kept"];
    assert_eq!(kept["facets"].as_u64().unwrap() - kept["further_facets"].as_u64().unwrap(), 5, "{report}");
    let wrong = run(&["--keep", "facets:@nowhere.txt"]);
    let said = String::from_utf8_lossy(&wrong.stderr).into_owned();
    assert_eq!(wrong.status.code(), Some(2), "{said}");
    assert!(said.contains("nowhere.txt"), "{said}");
}

#[test]
fn a_wrong_line_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let sphere = Shape::Sphere.build(200);
    ["sphere.obj", "sphere.stl"].iter().for_each(|name| io::write(&at(name), &sphere).unwrap());
    let last = sphere.positions().len();
    for (text, code, words) in [
        ("0 1\n0 one\n".to_owned(), 65, "line 2"),
        (format!("0 {last}\n"), 65, "line 1"),
        (format!("0 {}\n", last - 1), 65, "no facet joins"),
    ] {
        std::fs::write(at("creases.txt"), &text).unwrap();
        let out = remesh(&at("sphere.obj"), Some(&at("creases.txt")), &at("out.ply"));
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(code), "{text:?}: {said}");
        assert!(said.contains(words) && !at("out.ply").exists(), "{text:?}: {said}");
    }
    let out = remesh(&at("sphere.obj"), Some(&at("nowhere.txt")), &at("out.ply"));
    assert_eq!(out.status.code(), Some(66), "{}", String::from_utf8_lossy(&out.stderr));
    let out = remesh(&at("sphere.stl"), Some(&at("creases.txt")), &at("out.ply"));
    assert_eq!(out.status.code(), Some(2), "{}", String::from_utf8_lossy(&out.stderr));
}
