//! Promise: what somebody gets wrong who is new here is said in words that help, with an exit code of its kind.

use std::path::Path;
use std::process::{Command, Output};

use tessera::mesh::io;
use tessera::mesh::shapes::Shape;

fn tessera(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.env_remove("RUST_BACKTRACE").env("TESSERA_BACKEND", "parallel").current_dir(folder);
    command.args(line.split(' ')).output().unwrap()
}

/// Runs it and looks for an exit code and for words.
fn refused(folder: &Path, line: &str, code: i32, words: &[&str]) {
    let out = tessera(folder, line);
    let said = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(code), "{line}: {said}");
    assert!(out.stdout.is_empty(), "{line}: the standard output is for results");
    for word in words {
        assert!(said.contains(word), "{line}: {word:?} is not in {said}");
    }
}

fn sphere() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.ply"), &Shape::Sphere.build(200)).unwrap();
    std::fs::create_dir(folder.path().join("folder.ply")).unwrap();
    folder
}

#[test]
fn a_missing_input_is_named() {
    let folder = sphere();
    for line in [
        "remesh nowhere.ply -o out.ply --points 20",
        "remesh nowhere.ply -o out.ply --points 20 --no-attributes",
        "remesh in.ply -o out.ply --sizes nowhere.ply",
        "remesh in.ply -o out.ply --points 20 --creases nowhere.ply",
        "remesh folder.ply -o out.ply --points 20",
        "rvd nowhere.ply --points 20",
        "rvd in.ply --seeds nowhere.ply",
        "bench rvd --mesh nowhere.ply --points 20",
    ] {
        let name = if line.contains("folder") { "folder.ply" } else { "nowhere.ply" };
        refused(folder.path(), line, 66, &["cannot read", name]);
    }
    assert!(!folder.path().join("out.ply").exists());
}

#[test]
fn a_missing_folder_and_a_file_that_cannot_be_written_are_two_things() {
    let folder = sphere();
    let remesh = "remesh in.ply --points 20 --newton 0";
    for line in [
        &format!("{remesh} -o none/out.ply"),
        &format!("{remesh} -o out.ply --report none/r.json"),
        &format!("{remesh} -o out.ply --picture none/p.png"),
        "rvd in.ply --points 20 -o none/out.ply",
        "rvd in.ply --points 20 --centroids none/out.xyz",
        "shape sphere --facets 20 -o none/out.ply",
        "bench rvd --points 20 --json none/out.json",
    ] {
        refused(folder.path(), line, 73, &["there is no folder none", "make it"]);
    }
    for line in [
        &format!("{remesh} -o folder.ply"),
        "rvd in.ply --points 20 -o folder.ply",
        "shape sphere --facets 20 -o folder.ply",
    ] {
        refused(folder.path(), line, 74, &["cannot write folder.ply", "is a directory"]);
    }
    if cfg!(target_os = "linux") {
        refused(folder.path(), &format!("{remesh} -o /proc/out.ply"), 74, &["cannot write /proc/out.ply"]);
    }
    refused(folder.path(), &format!("{remesh} -o out.xyz"), 2, &["must end in .obj, .ply, .stl, .off"]);
    assert!(!folder.path().join("out.ply").exists());
}

/// A file that is there stays as it is until the new one is whole, with its rights and its links.
#[test]
fn a_file_is_replaced_as_a_whole() {
    let folder = sphere();
    let path = |name: &str| folder.path().join(name);
    let far = Shape::Sphere.build(200);
    let far = tessera::mesh::TriMesh::new(far.positions().iter().map(|&p| p + 1e9).collect(), far.facets().to_vec());
    io::write(&path("far.ply"), &far.unwrap()).unwrap();
    std::fs::write(path("out.stl"), "before").unwrap();
    refused(folder.path(), "remesh far.ply -o out.stl --points 40 --newton 0", 65, &["single precision"]);
    assert_eq!(std::fs::read(path("out.stl")).unwrap(), b"before");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        std::fs::set_permissions(path("out.stl"), std::fs::Permissions::from_mode(0o640)).unwrap();
        std::os::unix::fs::symlink("out.stl", path("link.stl")).unwrap();
        let out = tessera(folder.path(), "remesh in.ply -o link.stl --points 40 --newton 0");
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        assert!(path("link.stl").is_symlink());
        assert_eq!(std::fs::metadata(path("out.stl")).unwrap().permissions().mode() & 0o777, 0o640);
    }
    assert_eq!(
        std::fs::read_dir(folder.path())
            .unwrap()
            .filter(|e| { e.as_ref().unwrap().file_name().to_string_lossy().starts_with(".tmp") })
            .count(),
        0,
        "nothing is left behind"
    );
}

#[test]
fn too_few_points_are_told_how_many_it_takes() {
    let folder = tempfile::tempdir().unwrap();
    for (name, shape, least) in [("sphere", Shape::Sphere, 4), ("torus", Shape::Torus, 7), ("square", Shape::Square, 3)]
    {
        io::write(&folder.path().join(format!("{name}.ply")), &shape.build(400)).unwrap();
        for points in 1..=9 {
            let line = format!("remesh {name}.ply -o out.ply --points {points}");
            if points < least {
                let (words, example) = (format!("fewer than {least} vertices"), format!("for example {}", 10 * least));
                refused(folder.path(), &line, 65, &[&format!("number of points, {points},"), &words, &example]);
            } else {
                let out = tessera(folder.path(), &line);
                assert!(matches!(out.status.code(), Some(0 | 65)), "{line}: {}", String::from_utf8_lossy(&out.stderr));
            }
        }
        let out = tessera(folder.path(), &format!("remesh {name}.ply -o out.ply --points {}", 10 * least));
        assert!(out.status.success(), "{name}: {}", String::from_utf8_lossy(&out.stderr));
    }
}

#[test]
fn whole_numbers_may_have_an_exponent() {
    let folder = sphere();
    let report = |line: &str| -> serde_json::Value {
        let out = tessera(folder.path(), line);
        assert!(out.status.success(), "{line}: {}", String::from_utf8_lossy(&out.stderr));
        serde_json::from_slice(&out.stdout).unwrap()
    };
    let remesh = report("remesh in.ply -o out.ply --points 1e2 --lloyd 1e0 --newton 0e0 --json");
    assert_eq!((&remesh["result"]["vertices"], remesh["iterations"].as_array().unwrap().len()), (&100.into(), 1));
    assert_eq!(report("rvd in.ply --points 2e1 --json")["seeds"], 20);
    // Percent are of the vertices.
    let vertices = remesh["input"]["vertices"].as_f64().unwrap();
    assert_eq!(report("rvd in.ply --points 25% --json")["seeds"], (0.25 * vertices).round() as u64);
    assert!(tessera(folder.path(), "shape sphere --facets 1e3 -o s.ply").status.success());
}

#[test]
fn an_endpoint_that_cannot_be_is_refused_before_anything_is_read() {
    let folder = sphere();
    for (url, words) in [
        ("https://127.0.0.1", "port is missing"),
        ("127.0.0.1:50051", "http://127.0.0.1:50051"),
        ("http://127.0.0.1", "port is missing"),
        ("http://user:pass@127.0.0.1:50051", "before @"),
        ("http://127.0.0.1:50051/v1", "without /v1"),
    ] {
        for line in ["remesh nowhere.ply -o out.ply --points 9", "rvd nowhere.ply --points 9"] {
            refused(folder.path(), &format!("{line} --endpoint {url}"), 2, &[words]);
        }
    }
    // Nobody is there.
    refused(folder.path(), "rvd in.ply --points 9 --endpoint http://127.0.0.1:1", 69, &["is a server running there"]);
}

/// Headings in an order, general options last, and the exit codes.
#[test]
fn help_is_in_groups() {
    let help = |line: &str| String::from_utf8(tessera(Path::new("."), line).stdout).unwrap();
    let in_order = |text: &str, words: &[&str]| {
        let places: Vec<_> =
            words.iter().map(|word| text.find(word).unwrap_or_else(|| panic!("{word}: {text}"))).collect();
        assert!(places.is_sorted(), "{words:?}: {places:?}");
    };
    in_order(
        &help("remesh --help"),
        &[
            "\nFiles:",
            "\nSize (",
            "\nShape of the result:",
            "\nSteps:",
            "\nPicture:",
            "\nBackend:",
            "--endpoint",
            "\nMessages:",
            "\nGeneral:",
            "--log-format",
        ],
    );
    in_order(&help("rvd -h"), &["\nSeeds (", "\nFiles:", "\nPicture:", "\nBackend:", "\nGeneral:"]);
    in_order(
        &help("serve -h"),
        &["\nServer and its limits:", "--listen", "--stall-s", "\nBackend:", "--threads", "\nGeneral:"],
    );
    for command in ["remesh", "rvd", "serve", "bench rvd", "shape", "doctor"] {
        let text = help(&format!("{command} -h"));
        in_order(&text, &["Usage:", "\nGeneral:", "--log-format", "--help"]);
        assert!(!text.split("\nGeneral:").nth(1).unwrap().contains(":\n"), "{command}: nothing comes after: {text}");
    }
    for code in ["\n  66 ", "\n  73 ", "\n  74 "] {
        assert!(help("--help").contains(code), "{code}");
    }
    assert!(help("--version").starts_with("tessera "));
}
