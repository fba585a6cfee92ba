//! Promise: `-` is the standard input or output, with the bits of a file; many files take one command, and one that fails stops
//! no other.

use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use serde_json::Value;
use tessera::mesh::io;
use tessera::mesh::io::Format;
use tessera::mesh::shapes::Shape;
use tessera::mesh::shapes::parts::{PartKind, part};

use super::outputs::{said, tessera};

/// Runs a line with something on its standard input.
fn fed(folder: &Path, line: &str, input: &[u8]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.env_remove("RUST_BACKTRACE").env("TESSERA_BACKEND", "parallel").current_dir(folder);
    command.args(line.split_whitespace()).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    // Whoever refuses a line does not read.
    let _ = child.stdin.take().unwrap().write_all(input);
    child.wait_with_output().unwrap()
}

#[test]
fn the_standard_streams_have_the_bits_of_files() {
    let folder = tempfile::tempdir().unwrap();
    let input = folder.path().join("in.obj");
    io::write(&input, &Shape::Torus.build(800)).unwrap();
    let bytes = std::fs::read(&input).unwrap();
    for format in Format::ALL {
        let name = format!("out.{}", format.extension());
        let out = tessera(folder.path(), &format!("remesh in.obj -o {name} --points 60"));
        assert!(out.status.success(), "{name}: {}", said(&out));
        let wanted = std::fs::read(folder.path().join(&name)).unwrap();
        let line = format!("remesh - --input-format obj -o - --format {} --points 60 --quiet", format.extension());
        let out = fed(folder.path(), &line, &bytes);
        assert!(out.status.success() && out.stdout == wanted, "{name}: {}", said(&out));
        // And what comes out goes in.
        let line = format!("measure - in.obj --json --input-format {}", format.extension());
        let measured = fed(folder.path(), &line, &wanted);
        assert!(measured.status.success(), "{name}: {}", said(&measured));
        let figures: Value = serde_json::from_slice(&measured.stdout).unwrap();
        assert_eq!(figures["original"]["vertices"], 60, "{name}");
    }
    // Nothing but the mesh is on the standard output, summary or not.
    let loud = fed(folder.path(), "remesh - --input-format obj -o - --format off --points 60", &bytes);
    assert!(loud.stdout.starts_with(b"OFF"), "{}", said(&loud));
    assert!(loud.stdout == std::fs::read(folder.path().join("out.off")).unwrap());
    // A format that the name does not say, and one that it says otherwise.
    std::fs::copy(&input, folder.path().join("data.bin")).unwrap();
    let out = tessera(folder.path(), "remesh data.bin --input-format obj -o out.bin --format off --points 60");
    assert!(out.status.success(), "{}", said(&out));
    let read = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    assert_eq!(read("out.bin"), read("out.off"));
    let made = fed(folder.path(), "shape torus --facets 800 -o - --format obj", b"");
    assert!(made.stdout == bytes, "{}", said(&made));
    let gear = fed(folder.path(), "shape gear --feature 0.02 --seed 3 -o - --format obj", b"");
    std::fs::write(folder.path().join("gear.obj"), &gear.stdout).unwrap();
    assert!(io::read(&folder.path().join("gear.obj")).unwrap() == part(PartKind::Gear, 0.02, 3), "{}", said(&gear));
    let diagram = fed(folder.path(), "rvd - --input-format obj --points 20 --json", &bytes);
    assert!(diagram.status.success(), "{}", said(&diagram));
}

#[test]
fn what_a_stream_cannot_be_is_told() {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.obj"), &Shape::Torus.build(200)).unwrap();
    std::fs::write(folder.path().join("sizes.txt"), "1\n").unwrap();
    for (line, code, words) in [
        ("remesh - -o out.ply --points 20", 2, "--input-format"),
        ("remesh in.obj -o - --points 20", 2, "--format"),
        ("remesh - --input-format ply -o out.ply --points 20", 65, "-: "),
        ("remesh - --input-format xyz -o out.ply --points 20", 2, "obj, ply"),
        ("remesh in.obj -o - --format ply --json --points 20", 2, "--report"),
        ("remesh - --input-format obj --out-dir out --points 20", 2, "-o"),
        ("remesh - in.obj --input-format obj --out-dir out --points 20", 2, "no other input"),
        ("remesh - --input-format obj -o out.ply --sizes sizes.txt", 2, "read only once"),
        ("measure - - --input-format obj", 2, "one of the two"),
        ("measure -", 2, "--input-format"),
        ("shape gear --facets 900 -o out.ply", 2, "as many as it needs"),
        ("shape gear --feature 2 -o out.ply", 2, "to 0.3"),
        ("shape gear --feature -1 -o out.ply", 2, "above 0"),
        ("shape torus --seed 2 -o out.ply", 2, "mechanical parts"),
        ("shape wheel -o out.ply", 2, "gear"),
        ("shape torus -o -", 2, "--format"),
    ] {
        let out = fed(folder.path(), line, b"");
        assert!(
            out.status.code() == Some(code) && said(&out).contains(words),
            "{line}: {:?} {}",
            out.status,
            said(&out)
        );
    }
}

#[test]
fn many_files_take_one_command() {
    let folder = tempfile::tempdir().unwrap();
    let shapes =
        [("a.obj", Shape::Torus), ("b.ply", Shape::Sphere), ("c.stl", Shape::Block), ("d.off.gz", Shape::Torus)];
    for (name, shape) in shapes {
        io::write(&folder.path().join(name), &shape.build(600)).unwrap();
    }
    std::fs::write(folder.path().join("bad.obj"), "this is no mesh\n").unwrap();
    let line = "remesh a.obj bad.obj b.ply none.ply c.stl d.off.gz --out-dir made/of/them --points 80";
    let out = tessera(folder.path(), line);
    // The code is that of the first that failed.
    assert_eq!(out.status.code(), Some(65), "{}", said(&out));
    for words in ["bad.obj: ", "none.ply", "2 of 6 files failed"] {
        assert!(said(&out).contains(words), "{words}: {}", said(&out));
    }
    let told = String::from_utf8(out.stdout).unwrap();
    assert!(told.ends_with("4 of 6 files remeshed\n"), "{told}");
    for (name, _) in shapes {
        let alone = tessera(folder.path(), &format!("remesh {name} -o alone-{name} --points 80"));
        assert!(alone.status.success(), "{}", said(&alone));
        let read = |path: &Path| std::fs::read(path).unwrap();
        let (one, other) = (folder.path().join("made/of/them").join(name), folder.path().join(format!("alone-{name}")));
        assert!(read(&one) == read(&other), "{name}");
        assert!(told.contains(name), "{told}");
    }
    assert_eq!(std::fs::read_dir(folder.path().join("made/of/them")).unwrap().count(), 4);

    let out = tessera(folder.path(), "remesh a.obj bad.obj d.off.gz --out-dir as --format glb --points 80 --json");
    let lines: Vec<Value> =
        String::from_utf8(out.stdout).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 3);
    assert_eq!(
        (&lines[0]["report"]["result"]["vertices"], &lines[2]["report"]["result"]["vertices"]),
        (&80.into(), &80.into())
    );
    assert_eq!((&lines[1]["exit_code"], &lines[2]["output"]), (&65.into(), &"as/d.glb".into()));
    assert!(folder.path().join("as/a.glb").exists());
}

#[test]
fn a_batch_replaces_nothing_unasked() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("in")).unwrap();
    let mesh = Shape::Sphere.build(200);
    for name in ["a.ply", "in/a.ply", "b.ply", "b.obj"] {
        io::write(&folder.path().join(name), &mesh).unwrap();
    }
    let before = std::fs::read(folder.path().join("a.ply")).unwrap();
    for (line, words) in [
        ("remesh a.ply in/a.ply --out-dir out --points 20", "named twice"),
        ("remesh b.ply b.obj --out-dir out --format stl --points 20", "named twice"),
        ("remesh a.ply b.ply --out-dir . --points 20", "--overwrite"),
        ("remesh a.ply in/a.ply b.ply --out-dir in --points 20", ""),
        ("remesh a.ply b.ply -o out.ply --points 20", "--out-dir"),
        ("remesh a.ply b.ply --out-dir out --report r.json --points 20", "--json"),
        ("remesh a.ply b.ply --out-dir out --picture p.png --points 20", "--picture"),
        ("remesh a.ply b.ply --out-dir out --sizes s.txt", "--sizes"),
        ("remesh a.ply b.xyz --out-dir out --points 20", "b.xyz"),
        ("remesh a.ply -o out.ply --out-dir out --points 20", "cannot be used with"),
        ("remesh a.ply --points 20", "--output"),
        ("remesh a.ply --out-dir b.ply --points 20", "b.ply"),
    ] {
        let out = tessera(folder.path(), line);
        let code = if line.contains("--out-dir b.ply") { 74 } else { 2 };
        assert!(
            out.status.code() == Some(code) && said(&out).contains(words),
            "{line}: {:?} {}",
            out.status,
            said(&out)
        );
    }
    assert!(std::fs::read(folder.path().join("a.ply")).unwrap() == before);
    let out = tessera(folder.path(), "remesh a.ply b.ply --out-dir . --points 20 --overwrite");
    assert!(out.status.success(), "{}", said(&out));
    assert_eq!(io::read(&folder.path().join("a.ply")).unwrap().positions().len(), 20);
}

/// The bar and the lines of a batch: one measure over all files.
#[test]
fn a_batch_has_one_progress() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.ply", "b.ply", "c.ply"] {
        io::write(&folder.path().join(name), &Shape::Torus.build(20_000)).unwrap();
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.env("TESSERA_BACKEND", "parallel").env("TESSERA_PROGRESS_S", "0.02").current_dir(folder.path());
    let out = command.args("remesh a.ply b.ply c.ply --out-dir out --points 1000".split(' ')).output().unwrap();
    let text = said(&out);
    let percents: Vec<u32> = text
        .lines()
        .filter(|line| line.contains(" of 3, "))
        .map(|line| line.split(" %").next().unwrap().rsplit(' ').next().unwrap().parse().unwrap())
        .collect();
    assert!(percents.len() > 5 && percents.is_sorted(), "{text}");
    assert!(*percents.last().unwrap() > 66, "{text}");
}
