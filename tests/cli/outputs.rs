//! Promise: no file is replaced that is still wanted, what cannot be written or had is said, and an option that is out of its
//! range says which it is.

use std::path::Path;
use std::process::{Command, Output};

use glam::DVec3;
use serde_json::Value;
use tessera::mesh::shapes::Shape;
use tessera::mesh::{TriMesh, io};

pub(super) fn tessera(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.env_remove("RUST_BACKTRACE").env("TESSERA_BACKEND", "parallel").current_dir(folder);
    command.args(line.split_whitespace()).output().unwrap()
}

pub(super) fn said(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
}

#[test]
fn files_are_named_once() {
    let folder = tempfile::tempdir().unwrap();
    let surface = folder.path().join("in.ply");
    io::write(&surface, &Shape::Sphere.build(200)).unwrap();
    std::fs::write(folder.path().join("seeds.xyz"), "0 0 1\n0 1 0\n1 0 0\n").unwrap();
    let before = std::fs::read(&surface).unwrap();
    let remesh = "remesh in.ply -o out.ply --points 20";
    for line in [
        format!("{remesh} --report out.ply"),
        format!("{remesh} --report ./in.ply"),
        format!("{remesh} --report out.png --picture ./out.png"),
        format!("{remesh} --report edges.txt --creases edges.txt"),
        "rvd in.ply --points 20 -o in.ply".to_owned(),
        "rvd in.ply --seeds seeds.xyz --centroids seeds.xyz".to_owned(),
        "rvd in.ply --points 20 --centroids same --report same".to_owned(),
    ] {
        let out = tessera(folder.path(), &line);
        assert!(out.status.code() == Some(2) && said(&out).contains("named twice"), "{line}: {}", said(&out));
    }
    assert_eq!(std::fs::read(&surface).unwrap(), before);
    // A surface may be replaced by its remesh, by who says so.
    for name in ["in.ply", "./in.ply"] {
        let out = tessera(folder.path(), &format!("remesh in.ply -o {name} --points 40 --newton 0"));
        assert!(out.status.code() == Some(2) && said(&out).contains("--overwrite"), "{name}: {}", said(&out));
    }
    assert_eq!(std::fs::read(&surface).unwrap(), before);
    let out = tessera(folder.path(), "remesh in.ply -o in.ply --points 40 --newton 0 --overwrite");
    assert!(out.status.success(), "{}", said(&out));
    assert_eq!(io::read(&surface).unwrap().positions().len(), 40);
}

/// Temporary files are beside the outputs, wherever these are, and where links lead.
#[cfg(target_os = "linux")]
#[test]
fn outputs_may_be_on_another_file_system() {
    let folder = tempfile::tempdir().unwrap();
    let Ok(other) = tempfile::tempdir_in("/dev/shm") else { return };
    io::write(&folder.path().join("in.ply"), &Shape::Sphere.build(200)).unwrap();
    std::fs::write(other.path().join("old.ply"), "old").unwrap();
    std::os::unix::fs::symlink(other.path().join("old.ply"), folder.path().join("link.ply")).unwrap();
    let at = other.path().display();
    let commands = [
        format!(
            "remesh in.ply -o {at}/a.ply --report {at}/a.json --picture {at}/a.png --picture-size 64x48 --points 40"
        ),
        format!("rvd in.ply -o {at}/cells.ply --centroids {at}/c.xyz --report {at}/c.json --points 40"),
        format!("shape sphere --facets 100 -o {at}/s.obj.gz"),
        "remesh in.ply -o link.ply --points 40 --overwrite".to_owned(),
        format!("remesh in.ply {at}/a.ply --out-dir {at}/all --points 40"),
    ];
    for line in &commands {
        let out = tessera(folder.path(), line);
        assert!(out.status.success(), "{line}: {}", said(&out));
    }
    let mut written: Vec<_> = std::fs::read_dir(&other).unwrap().map(|file| file.unwrap().file_name()).collect();
    written.sort();
    assert_eq!(written, ["a.json", "a.ply", "a.png", "all", "c.json", "c.xyz", "cells.ply", "old.ply", "s.obj.gz"]);
    assert!(folder.path().join("link.ply").is_symlink());
    let same = ["a.ply", "old.ply", "all/in.ply"].map(|name| std::fs::read(other.path().join(name)).unwrap());
    assert!(same[0] == same[1] && same[0] == same[2]);
}

#[test]
fn a_surface_that_cannot_be_written_is_said_once() {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.ply"), &Shape::Sphere.build(200)).unwrap();
    std::fs::create_dir(folder.path().join("folder.ply")).unwrap();
    let out = tessera(folder.path(), "remesh in.ply -o folder.ply --points 40 --newton 0");
    assert_eq!(out.status.code(), Some(74), "{}", said(&out));
    let words = "cannot write folder.ply";
    assert_eq!(said(&out).matches("is a directory").count(), 1, "{}", said(&out));
    assert_eq!(said(&out).matches(words).count(), 1, "{}", said(&out));
    // Far from the origin, so that single precision has one place for all of it.
    let far = Shape::Sphere.build(200);
    let far = TriMesh::new(far.positions().iter().map(|&p| p + 1e9).collect(), far.facets().to_vec()).unwrap();
    io::write(&folder.path().join("far.ply"), &far).unwrap();
    let out = tessera(folder.path(), "remesh far.ply -o out.stl --points 40 --newton 0");
    assert_eq!(out.status.code(), Some(65), "{}", said(&out));
    assert_eq!(said(&out).matches("single precision").count(), 1, "{}", said(&out));
    assert!(!folder.path().join("out.stl").exists());
}

#[test]
fn wrong_numbers_are_told_what_is_allowed() {
    let folder = tempfile::tempdir().unwrap();
    for (option, words) in [
        ("--points 20 --crease-angle -1", "0 to 180"),
        ("--points 20 --max-deviation -1", "above 0"),
        ("--points 20 --max-deviation 1 --placement surface", "for the placement fitted"),
        ("--points 20 --gradation -1", "above 0"),
        ("--edge-length -0.5", "above 0"),
        ("--points -5", "from 1 to 4294967295"),
        ("--points 1e10", "from 1 to 4294967295"),
        ("--points 1.5", "as 10000, 1e4 or 10k"),
        ("--points 20 --lloyd -1", "unexpected argument"),
        ("--seed 3", "<--points <N|P%>|--facets <N>|--edge-length <H>|--sizes <FILE>|--metric <FILE>>"),
    ] {
        let out = tessera(folder.path(), &format!("remesh nowhere.ply -o out.ply {option}"));
        assert!(out.status.code() == Some(2) && said(&out).contains(words), "{option}: {}", said(&out));
    }
}

/// A texture index that no line brings is named as it is in the file, less one, and not by a number that stands for none.
#[test]
fn an_index_that_is_missing_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1/1 3/1 2/1\nf 1/3 2/1 4/1\nf 2/1 3/1 4/1\nf 3/1 1/1 4/1\n";
    std::fs::write(folder.path().join("in.obj"), text).unwrap();
    let out = tessera(folder.path(), "remesh in.obj -o out.ply --points 20 --newton 0");
    assert!(out.status.success() && said(&out).contains("left aside"), "{}", said(&out));
    assert!(said(&out).contains("names value 0, but there are 0"), "{}", said(&out));
}

/// Writes tube.ply, a tube of twelve rings of 48 facets' edges. Gives the edges of the inner rings, two vertices a
/// line.
fn write_tube(folder: &Path) -> String {
    let (around, along) = (48u32, 12u32);
    let place = |k: u32| {
        let (sin, cos) = (f64::from(k % around) / f64::from(around) * std::f64::consts::TAU).sin_cos();
        DVec3::new(cos, sin, f64::from(k / around) / 3.0)
    };
    let at = |i: u32, j: u32| j * around + i % around;
    let cells = (0..along).flat_map(|j| (0..around).map(move |i| (i, j)));
    let facets = cells.flat_map(|(i, j)| {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [[a, b, c], [a, c, d]]
    });
    let tube = TriMesh::new((0..around * (along + 1)).map(place).collect(), facets.collect()).unwrap();
    io::write(&folder.join("tube.ply"), &tube).unwrap();
    (1..along).flat_map(|j| (0..around).map(move |i| format!("{} {}\n", at(i, j), at(i + 1, j)))).collect()
}

#[test]
fn creases_that_are_given_up_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let rings = write_tube(folder.path());
    std::fs::write(folder.path().join("rings.txt"), rings).unwrap();
    for (points, dropped_curves) in [(8, true), (60, false), (1200, false)] {
        let line = format!("remesh tube.ply -o out.ply --points {points} --newton 0 --creases rings.txt");
        let out = tessera(folder.path(), &line);
        let text = said(&out);
        assert!(out.status.success(), "{points}: {text}");
        assert_eq!(text.contains("creases and boundaries were dropped"), dropped_curves, "{points}: {text}");
    }
}

/// Where creases are strict, there is a result with all of them or none. Files are read in turn, also one that is called
/// as the word is.
#[test]
fn strict_creases_are_kept_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let rings = write_tube(folder.path());
    std::fs::write(at("rings.txt"), &rings).unwrap();
    let remesh = |points: u32, creases: &str| {
        let line =
            format!("remesh tube.ply -o out.ply --report r.json --points {points} --newton 0 --creases {creases}");
        tessera(folder.path(), &line)
    };
    let out = remesh(20, "rings.txt --creases strict");
    assert_eq!(out.status.code(), Some(65), "{}", said(&out));
    assert!(said(&out).contains("could not be kept") && said(&out).contains("give more points"), "{}", said(&out));
    assert!(!at("out.ply").exists() && !at("r.json").exists());
    // Of the files, one has five rings and one six.
    let (first, second) = rings.split_at(rings.match_indices('\n').nth(5 * 48 - 1).unwrap().0 + 1);
    std::fs::write(at("strict"), first).unwrap();
    std::fs::write(at("others.txt"), second).unwrap();
    for (creases, kept) in
        [("strict --creases ./strict --creases others.txt", 11), ("./strict", 5), ("others.txt", 6), ("strict", 0)]
    {
        let out = remesh(1200, creases);
        assert!(out.status.success(), "{creases}: {}", said(&out));
        let report: Value = serde_json::from_slice(&std::fs::read(at("r.json")).unwrap()).unwrap();
        assert_eq!(report["features"]["creases"], kept, "{creases}");
    }
}

/// What `measure` finds in two files is what the remesh said of itself.
#[test]
fn a_mesh_is_measured_as_the_report_has_it() {
    let folder = tempfile::tempdir().unwrap();
    io::write(&folder.path().join("in.ply"), &Shape::Torus.build(3000)).unwrap();
    let made =
        tessera(folder.path(), "remesh in.ply -o out.ply --points 400 --newton 3 --backend parallel --report r.json");
    assert!(made.status.success(), "{}", said(&made));
    let report: Value = serde_json::from_slice(&std::fs::read(folder.path().join("r.json")).unwrap()).unwrap();
    let out = tessera(folder.path(), "measure in.ply out.ply --json");
    assert!(out.status.success(), "{}", said(&out));
    let measured: Value = serde_json::from_slice(&out.stdout).unwrap();
    for what in ["q_min", "q_avg", "theta_min_deg", "v567_percent", "hausdorff_percent", "rms_percent"] {
        let [told, found] = [&report["result"][what], &measured["quality"][what]].map(|x| x.as_f64().unwrap());
        assert!((told - found).abs() <= 1e-9 * told, "{what}: {told} in the report, {found} measured");
    }
    for what in ["vertices", "facets", "euler", "components", "boundary_loops"] {
        assert_eq!(report["result"][what], measured["remesh"][what], "{what}");
    }
    let alone = tessera(folder.path(), "measure out.ply");
    assert!(String::from_utf8_lossy(&alone.stdout).contains("Q 0."), "{}", said(&alone));
    let none = tessera(folder.path(), "measure out.ply missing.ply");
    assert_eq!(none.status.code(), Some(66), "{}", said(&none));
}
