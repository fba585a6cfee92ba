//! Promise: progress and summaries are where they belong, and whoever stops listening ends nothing.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use super::rough::{self, Scan};
use tessera::mesh::io;
use tessera::mesh::shapes::Shape;

fn command(folder: &Path, line: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.env("RUST_BACKTRACE", "1").env("TESSERA_BACKEND", "parallel").current_dir(folder).args(line.split(' '));
    command
}

fn run(command: &mut Command) -> (Output, String, String) {
    let out = command.output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (said, told) = (text(&out.stdout), text(&out.stderr));
    (out, said, told)
}

fn sphere() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.ply"), &Shape::Sphere.build(2000)).unwrap();
    folder
}

/// A pipe that nobody reads.
fn closed() -> Stdio {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    writer.into()
}

/// Counts are written as people write them.
#[test]
fn points_are_a_count_a_share_or_facets() {
    let folder = sphere();
    let counted = |size: &str| {
        let line = format!("remesh in.ply -o out.ply --newton 0 --json {size}");
        let (out, said, told) = run(&mut command(folder.path(), &line));
        assert!(out.status.success(), "{size}: {told}");
        let report: serde_json::Value = serde_json::from_str(&said).unwrap();
        let of = |key: &str| report["result"][key].as_u64().unwrap();
        (of("vertices"), of("facets"))
    };
    let vertices = io::read(&folder.path().join("in.ply")).unwrap().positions().len() as u64;
    assert_eq!(counted("--points 0.3k").0, 300);
    assert_eq!(counted("--points 1,000").0, 1000);
    assert_eq!(counted("--points 25%").0, (vertices as f64 / 4.0).round() as u64);
    assert_eq!(counted("--facets 596").1, 596);
    for (line, words) in [
        ("--points 0%", "--points"),
        ("--points 1,5", "--points"),
        ("--points 10 --facets 20", "--facets"),
        ("--facets 0", "--facets"),
        ("--edge-length 1 --facets 20", "--facets"),
    ] {
        let (out, _, told) = run(&mut command(folder.path(), &format!("remesh in.ply -o out.ply {line}")));
        assert!(out.status.code() == Some(2) && told.contains(words), "{line}: {told}");
    }
}

#[test]
fn a_closed_pipe_ends_nothing() {
    let folder = sphere();
    for (line, file) in [
        ("doctor", None),
        ("--help", None),
        ("remesh --help", None),
        ("--version", None),
        ("completions bash", None),
        ("man", None),
        ("remesh in.ply -o out.ply --points 60 --newton 0", Some("out.ply")),
        ("remesh in.ply -o out2.ply --points 60 --newton 0 --json --report out.json", Some("out.json")),
        ("rvd in.ply --points 60 -o cells.ply", Some("cells.ply")),
        ("shape sphere --facets 100 -o shape.ply", Some("shape.ply")),
        ("bench rvd --facets 200 --points 20 --relax 1 --iterations 2 --json bench.json", Some("bench.json")),
    ] {
        let out = command(folder.path(), line).stdout(closed()).stderr(Stdio::piped()).output().unwrap();
        let told = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.success() && !told.contains("panic") && !told.contains("ipe"), "{line}: {told}");
        assert!(file.is_none_or(|file| folder.path().join(file).exists()), "{line}: the work is done all the same");
    }
    // What goes wrong has its code, though nobody hears why.
    for (line, code) in [
        ("remesh nowhere.ply -o out.ply --points 60", 66),
        ("remesh in.ply", 2),
        ("doctor --backend gpu --threads 0", 2),
        ("serve --listen nowhere", 2),
    ] {
        let status = command(folder.path(), line).stdout(closed()).stderr(closed()).status().unwrap();
        assert_eq!(status.code(), Some(code), "{line}");
    }
    // Lines of progress and of the log, to nobody.
    let mut busy = command(folder.path(), "remesh in.ply -o all.ply --points 60 --newton 0");
    busy.env("TESSERA_PROGRESS_S", "0.01").env("TESSERA_LOG", "trace");
    assert_eq!(busy.stdout(closed()).stderr(closed()).status().unwrap().code(), Some(0));
    assert!(folder.path().join("all.ply").exists());
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_is_no_closed_pipe() {
    let folder = sphere();
    for line in ["doctor", "rvd in.ply --points 9 --json"] {
        let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let out = command(folder.path(), line).stdout(full).stderr(Stdio::piped()).output().unwrap();
        let told = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(74) && told.contains("standard output"), "{line}: {told}");
    }
}

#[test]
fn a_run_that_takes_long_says_how_far_it_is() {
    let folder = sphere();
    let line = "remesh in.ply -o out.ply --points 400 --lloyd 200 --newton 0";
    let (out, said, told) = run(command(folder.path(), line).env("TESSERA_PROGRESS_S", "0.03"));
    assert!(out.status.success(), "{told}");
    assert!(said.contains("in.ply: ") && said.contains("out.ply: 400 vertices"), "{said}");
    let lines: Vec<&str> = told.lines().filter(|line| line.starts_with("tessera: in.ply: ")).collect();
    let percent = |line: &&str| line.split(": ").nth(2).unwrap().split(' ').next().unwrap().parse::<f64>().unwrap();
    let all: Vec<f64> = lines.iter().map(percent).collect();
    assert!(all.len() > 1 && all.is_sorted() && all.iter().all(|p| (0.0..100.0).contains(p)), "{told}");
    assert!(lines.iter().any(|line| line.contains(" of 200")), "{told}");
    // A short one does not, on a slow machine either.
    let line = "remesh in.ply -o out.ply --points 40 --newton 0";
    let (_, _, told) = run(command(folder.path(), line).env("TESSERA_PROGRESS_S", "600"));
    assert_eq!(told, "");
}

#[test]
fn quiet_and_json_say_what_they_promise() {
    let folder = sphere();
    for line in ["remesh in.ply -o out.ply --points 40 --newton 0", "rvd in.ply --points 40 -o cells.ply"] {
        let run = |more: &str| {
            let (out, said, told) =
                run(command(folder.path(), &format!("{line}{more}")).env("TESSERA_PROGRESS_S", "0.01"));
            assert!(out.status.success(), "{told}");
            (said, told)
        };
        assert_eq!(run(" --quiet"), (String::new(), String::new()), "{line}");
        let (said, _) = run(" --json --report report.json");
        let printed: serde_json::Value = serde_json::from_str(&said).unwrap();
        let written = std::fs::read_to_string(folder.path().join("report.json")).unwrap();
        assert_eq!(said, written, "{line}");
        assert_eq!(printed["backend"], "parallel");
        let (said, told) = run(" --json -q");
        assert!(serde_json::from_str::<serde_json::Value>(&said).is_ok() && told.is_empty(), "{told}");
        assert!(run("").0.contains("out.ply") || run("").0.contains("cells.ply"));
    }
}

#[test]
fn what_is_no_surface_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, mesh: &_| io::write(&folder.path().join(name), mesh).unwrap();
    write("volume.ply", &rough::tetrahedra(4, false, 1));
    write("book.ply", &rough::book(3, 10, false));
    let torus = Shape::Torus.build(2000);
    write("torus.ply", &torus);
    let lengths: String = rough::noise(&torus, 100.0, 1).iter().map(|h| format!("{h}\n")).collect();
    std::fs::write(folder.path().join("sizes.txt"), lengths).unwrap();
    write("scan.ply", &Scan::RAW.of(Shape::Torus, 8000, 5));
    for (file, more, words) in [
        ("volume", "", ["facets of the input lie between others", "remesh its boundary"]),
        ("book", "", ["edges of the input have more than two facets", "--non-manifold keep joins it"]),
        ("torus", " --sizes sizes.txt --gradation 5", ["lengths that no triangles can follow", "lower --gradation"]),
        ("scan", "", ["parts of the input", "more points"]),
    ] {
        let line = format!("remesh {file}.ply -o {file}.off --points 300 --newton 0{more}");
        for way in ["", " --quiet", " --json"] {
            let (out, said, told) = run(&mut command(folder.path(), &format!("{line}{way}")));
            assert!(out.status.success(), "{told}");
            let warned = format!("tessera: warning: {file}.ply: ");
            assert!(words.iter().all(|word| told.contains(word)) && told.contains(&warned), "{file}: {told}");
            let report: serde_json::Value = serde_json::from_str(&said).unwrap_or_default();
            let count = report["warnings"].as_array().map_or(0, Vec::len);
            assert!(way != " --json" || count == told.matches("warning: ").count(), "{file}: {said}");
        }
    }
    let (_, _, told) = run(&mut command(folder.path(), "remesh torus.ply -o even.ply --points 300 --newton 0"));
    assert_eq!(told, "");
}

#[test]
fn an_edge_that_is_too_long_is_told_as_a_length() {
    let folder = sphere();
    let run =
        |length: &str| run(&mut command(folder.path(), &format!("remesh in.ply -o out.ply --edge-length {length} -q")));
    let (out, _, told) = run("50");
    assert!(out.status.code() == Some(65) && told.contains("an edge length of 50 is too long"), "{told}");
    let fits = told.trim_end().rsplit(' ').next().unwrap();
    assert!(run(fits).0.status.success(), "{told}");
}

/// What was asked for and missed, and what does not fit into the output.
#[test]
fn a_missed_bound_and_lost_data_are_warnings() {
    let folder = tempfile::tempdir().unwrap();
    let torus = Shape::Torus.build(2000);
    let scalar = (0..torus.positions().len()).map(|i| i as f64).collect();
    let mut attributes = tessera::mesh::attributes::Attributes::new(&torus);
    attributes.add_scalar(tessera::mesh::attributes::Scalar::new("height", scalar)).unwrap();
    let (bytes, _) = io::encode_with_attributes(io::Format::Ply, &torus, &attributes).unwrap();
    std::fs::write(folder.path().join("in.ply"), bytes).unwrap();
    let line = "remesh in.ply -o out.stl --points 60 --newton 0 --max-deviation 0.001 --max-points 80 --quiet";
    let (out, said, told) = run(&mut command(folder.path(), line));
    assert!(out.status.success() && said.is_empty(), "{told}");
    for words in [
        "in.ply: the bound on the deviation is missed",
        "a larger --max-points",
        "out.stl: this format cannot hold: scalar height",
    ] {
        assert!(told.contains(words), "{told}");
    }
}

/// Mesa's device selection layer asks for a desktop, which a container has not.
#[test]
fn a_container_has_no_desktop_and_needs_none() {
    for variable in [None, Some("")] {
        let mut command = command(Path::new("."), "doctor --gpu-software");
        command.env_remove("XDG_RUNTIME_DIR").env_remove("WAYLAND_DISPLAY").env_remove("DISPLAY");
        if let Some(value) = variable {
            command.env("XDG_RUNTIME_DIR", value);
        }
        let (out, said, told) = run(&mut command);
        assert!(out.status.success() && !told.contains("XDG_RUNTIME_DIR"), "{told}");
        if !said.contains("adapter") {
            eprintln!("SKIPPED in part: there is no Vulkan driver here, so nothing could have been said");
        }
    }
}
