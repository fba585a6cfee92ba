//! Promise: a surface that is read in windows gives the files of one that is read as a whole, in the memory that was planned and told.

use std::path::Path;

use serde_json::Value;
use tessera::mesh::io;
use tessera::mesh::shapes::Shape;

use super::outputs::{said, tessera};

fn report(folder: &Path, line: &str) -> Value {
    // Each thread takes memory of its own.
    let out = tessera(folder, &format!("{line} --threads 2 --json"));
    assert!(out.status.success(), "{line}: {}", said(&out));
    serde_json::from_slice(&out.stdout).unwrap()
}

#[test]
fn windows_and_the_whole_write_the_same_files() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    assert!(tessera(at, "shape hills --facets 40000 -o in.ply").status.success());
    io::write(&at.join("in.stl"), &Shape::Torus.build(9000)).unwrap();
    std::fs::write(at.join("seeds.xyz"), "# three\n0.1 0.2 0\n\n0.5 0.5 0.1\n0.9 0.1 0\n").unwrap();
    for (name, seeds) in
        [("in.ply", "--points 2000 --seed 3 --lloyd 2"), ("in.ply", "--seeds seeds.xyz"), ("in.stl", "--points 1k")]
    {
        let whole = report(at, &format!("rvd {name} {seeds} --centroids whole.xyz"));
        let windows = report(at, &format!("rvd {name} {seeds} --memory-mib 128 --centroids windows.xyz"));
        let read = |name: &str| std::fs::read(at.join(name)).unwrap();
        assert!(read("whole.xyz") == read("windows.xyz"), "{name} {seeds}");
        for key in ["/rvd/area", "/rvd/pairs", "/rvd/empty_cells", "/input/facets", "/input/area", "/seeds"] {
            assert_eq!(whole.pointer(key), windows.pointer(key), "{name} {seeds}: {key}");
        }
        let steps = |report: &Value| {
            let all = report["iterations"].as_array().unwrap();
            all.iter().map(|step| step["energy_ratio"].as_f64().unwrap()).collect::<Vec<_>>()
        };
        assert_eq!(steps(&whole), steps(&windows), "{name} {seeds}");
        let plan = &windows["memory"]["plan"];
        assert!(plan["total_bytes"].as_u64().unwrap() <= plan["limit_bytes"].as_u64().unwrap(), "{plan}");
        assert!(plan["windows"].as_u64().unwrap() >= 1, "{plan}");
    }
    // The plan is told before the work.
    let out = tessera(at, "rvd in.ply --points 100 --memory-mib 128 --threads 2");
    let told = String::from_utf8_lossy(&out.stdout).into_owned();
    assert!(told.starts_with("plan: ") && told.contains("at the peak"), "{told}");
}

#[test]
fn what_windows_cannot_do_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    io::write(&at.join("in.ply"), &Shape::Torus.build(500)).unwrap();
    io::write(&at.join("in.obj"), &Shape::Torus.build(500)).unwrap();
    for (line, code, words) in [
        ("rvd in.ply --points 50 --memory-mib 1", 2, "bytes of memory are needed"),
        ("rvd in.ply --points 50 --memory-mib 100 -o cells.ply", 2, "--centroids"),
        ("rvd in.ply --points 50 --memory-mib 100 --picture p.png", 2, "--picture"),
        ("rvd in.ply --points 50% --memory-mib 100", 2, "give a number"),
        ("rvd in.ply --points 50 --memory-mib 100 --backend serial", 2, "--backend"),
        ("rvd in.ply --points 50 --memory-mib 100 --endpoint http://127.0.0.1:1", 2, "--endpoint"),
        ("rvd - --points 50 --memory-mib 100 --input-format ply", 2, "from a file"),
        ("rvd in.obj --points 50 --memory-mib 100", 65, "binary"),
        ("rvd none.ply --points 50 --memory-mib 100", 66, "none.ply"),
        ("rvd in.ply --points 50 --memory-mib 100 --threads 2 --scratch nowhere", 74, "nowhere"),
        ("rvd in.ply --points 50 --lloyd 2 --endpoint http://127.0.0.1:1", 2, "--lloyd"),
        ("shape sphere --facets 60000000 -o big.ply", 2, "torus"),
    ] {
        let out = tessera(at, line);
        assert!(out.status.code() == Some(code) && said(&out).contains(words), "{line}: {}", said(&out));
    }
}

/// A surface and seeds of which the process holds a part: `TESSERA_LARGE_FACETS` (2e7) and `TESSERA_LARGE_SEEDS` (1e6), with
/// `TESSERA_LARGE_MIB` (1000) of memory. Prints figures.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "minutes, and 4 GB of disk"]
fn figures_of_a_large_surface() {
    let number = |name: &str, usual: &str| std::env::var(name).unwrap_or_else(|_| usual.to_owned());
    let (facets, seeds) = (number("TESSERA_LARGE_FACETS", "2e7"), number("TESSERA_LARGE_SEEDS", "1e6"));
    let limit = number("TESSERA_LARGE_MIB", "1000");
    // Not in a folder that lies in memory.
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let at = folder.path();
    assert!(tessera(at, &format!("shape torus --facets {facets} -o in.ply")).status.success());
    let report = report(at, &format!("rvd in.ply --points {seeds} --lloyd 1 --memory-mib {limit} --scratch ."));
    let bytes = |key: &str| report.pointer(key).and_then(Value::as_u64).unwrap();
    let (peak, planned) = (bytes("/memory/host_peak_bytes"), bytes("/memory/plan/total_bytes"));
    println!("{report:#}");
    println!("{} MiB at the peak, {} planned, {limit} allowed", peak >> 20, planned >> 20);
    let area = |key: &str| report.pointer(key).and_then(Value::as_f64).unwrap();
    assert!((area("/rvd/area") / area("/input/area") - 1.0).abs() < 1e-9);
    assert!(peak <= planned && peak * 4 >= planned * 3, "{peak} for {planned}");
}
