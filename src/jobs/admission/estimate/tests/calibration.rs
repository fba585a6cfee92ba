//! Needs against runs.
//!
//! Purpose: [`CASES`] has the memory that runs took when the formula was made, and a test holds the formula to them.
//! `measure` runs them again: it prints what is predicted and what a `tessera` takes, as JSON, one line a case.
//! Invariant: what is held out was measured after the formula had its numbers, and changed none of them.
//! Must not know: how needs are computed.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};

use super::super::*;
use geometry::mesh::io::{self, Format};

/// A run, with two threads of the parallel backend.
struct Case {
    kind: Kind,
    /// A shape's name and the facets that it is asked for, or a file in the folder that `TESSERA_MESHES` names.
    surface: Source,
    vertices: u64,
    facets: u64,
    points: u64,
    steps: u64,
    density: DensitySource,
    placement: Placement,
    /// Bytes that it took.
    measured: u64,
}

enum Source {
    Shape(&'static str, u32),
    File(&'static str),
}

use DensitySource::{Curvature, Lfs, Uniform};
use Kind::{Remesh, Rvd};
use Placement::{Fitted, Surface};
use Source::{File, Shape};

#[rustfmt::skip]
const fn case(
    kind: Kind, surface: Source, [vertices, facets]: [u64; 2], [points, steps]: [u64; 2],
    density: DensitySource, placement: Placement, measured: u64,
) -> Case {
    Case { kind, surface, vertices, facets, points, steps, density, placement, measured }
}

/// What the formula was fitted to. Megabytes beyond those of an idle process.
#[rustfmt::skip]
const FITTED: &[Case] = &[
    case(Remesh, Shape("torus", 1000), [504, 1008], [300, 35], Uniform, Fitted, 26_900_000),
    case(Remesh, Shape("sphere", 10_000), [4842, 9680], [1000, 35], Uniform, Fitted, 44_000_000),
    case(Remesh, File("rocker-arm.obj"), [10_044, 20_088], [15_000, 35], Lfs, Fitted, 134_400_000),
    case(Remesh, File("dragon_vrip_res3.ply"), [22_998, 47_486], [5000, 35], Uniform, Fitted, 134_300_000),
    case(Remesh, File("stanford-bunny.obj"), [34_834, 69_451], [300, 35], Uniform, Fitted, 74_400_000),
    case(Remesh, File("stanford-bunny.obj"), [34_834, 69_451], [10_000, 35], Uniform, Fitted, 135_200_000),
    case(Remesh, File("stanford-bunny.obj"), [34_834, 69_451], [10_000, 35], Curvature, Fitted, 139_600_000),
    case(Remesh, File("stanford-bunny.obj"), [34_834, 69_451], [10_000, 35], Uniform, Surface, 118_300_000),
    case(Remesh, File("stanford-bunny.obj"), [34_834, 69_451], [100_000, 6], Uniform, Fitted, 578_700_000),
    case(Remesh, File("nefertiti.obj"), [49_971, 99_938], [50_000, 35], Uniform, Fitted, 270_800_000),
    case(Remesh, Shape("genus3", 100_000), [49_568, 99_144], [100_000, 35], Uniform, Fitted, 441_500_000),
    case(Remesh, Shape("genus3", 100_000), [49_568, 99_144], [100_000, 35], Uniform, Surface, 343_500_000),
    case(Remesh, Shape("plane", 20_000), [10_201, 20_000], [300_000, 8], Uniform, Fitted, 1_151_800_000),
    case(Remesh, Shape("hills", 300_000), [150_544, 299_538], [30_000, 15], Uniform, Fitted, 356_100_000),
    case(Remesh, Shape("torus", 1_000_000), [499_746, 999_492], [1000, 35], Uniform, Fitted, 496_600_000),
    case(Remesh, Shape("torus", 1_000_000), [499_746, 999_492], [10_000, 9], Lfs, Fitted, 547_300_000),
    case(Remesh, Shape("torus", 1_000_000), [499_746, 999_492], [100_000, 10], Uniform, Fitted, 845_500_000),
    case(Remesh, Shape("torus", 1_000_000), [499_746, 999_492], [1_000_000, 4], Uniform, Fitted, 3_551_300_000),
    case(Remesh, Shape("torus", 2_000_000), [999_824, 1_999_648], [10_000, 9], Uniform, Fitted, 988_000_000),
    case(Rvd, Shape("hills", 300_000), [150_544, 299_538], [30_000, 0], Uniform, Fitted, 90_800_000),
    case(Rvd, Shape("torus", 1_000_000), [499_746, 999_492], [100_000, 0], Uniform, Fitted, 175_600_000),
    case(Rvd, Shape("torus", 1_000_000), [499_746, 999_492], [1_000_000, 0], Uniform, Fitted, 507_300_000),
    case(Rvd, File("stanford-bunny.obj"), [34_834, 69_451], [1_000_000, 0], Uniform, Fitted, 553_500_000),
];

/// What it was not fitted to.
#[rustfmt::skip]
const HELD_OUT: &[Case] = &[
    case(Remesh, Shape("plane", 5000), [2601, 5000], [500, 35], Uniform, Fitted, 34_100_000),
    case(Remesh, Shape("block", 5000), [2414, 4824], [2000, 35], Uniform, Fitted, 40_400_000),
    case(Remesh, File("fandisk.obj"), [6475, 12_946], [20_000, 35], Curvature, Fitted, 140_900_000),
    case(Remesh, File("rocker-arm.obj"), [10_044, 20_088], [50_000, 35], Uniform, Fitted, 249_200_000),
    case(Remesh, Shape("genus12", 60_000), [30_008, 60_060], [20_000, 35], Uniform, Fitted, 150_900_000),
    case(Remesh, File("nefertiti.obj"), [49_971, 99_938], [10_000, 35], Lfs, Fitted, 149_900_000),
    case(Remesh, Shape("sphere", 200_000), [100_002, 200_000], [500_000, 9], Uniform, Fitted, 1_675_700_000),
    case(Remesh, Shape("hills", 400_000), [200_704, 399_618], [100_000, 15], Uniform, Surface, 501_700_000),
    case(Remesh, Shape("sheets", 800_000), [401_408, 799_236], [5000, 9], Uniform, Fitted, 453_700_000),
    case(Remesh, Shape("genus7", 1_500_000), [750_720, 1_501_464], [150_000, 9], Uniform, Fitted, 1_220_100_000),
    case(Rvd, File("nefertiti.obj"), [49_971, 99_938], [200_000, 0], Uniform, Fitted, 133_600_000),
    case(Rvd, Shape("genus7", 1_500_000), [750_720, 1_501_464], [20_000, 0], Uniform, Fitted, 273_000_000),
];

const THREADS: usize = 2;
/// Predicted over measured.
const RATIOS: std::ops::RangeInclusive<f64> = 0.8..=1.5;

impl Case {
    fn counts(&self) -> Counts {
        let &Self { kind, vertices, facets, points, steps, density, placement, .. } = self;
        let counts = Counts::new(kind, BackendKind::Parallel, vertices, facets, points);
        Counts { steps, density, placement, ..counts }
    }

    fn name(&self) -> String {
        let surface = match self.surface {
            Shape(name, _) => name,
            File(name) => name,
        };
        let Self { kind, facets, points, density, placement, .. } = self;
        format!("{kind:?} of {surface}, {facets} facets, {points} points, {density:?}, {placement:?}")
    }

    /// The file of the surface, made in `folder` if it is a shape; `None` if it is not there.
    fn file(&self, tessera: &Path, folder: &Path) -> Option<PathBuf> {
        let path = match self.surface {
            File(name) => PathBuf::from(std::env::var_os("TESSERA_MESHES")?).join(name),
            Shape(name, facets) => {
                let path = folder.join(format!("{name}-{facets}.ply"));
                let mut made = Command::new(tessera);
                made.args(["shape", name, "--facets", &facets.to_string(), "-o"]).arg(&path);
                assert!(made.output().unwrap().status.success(), "{made:?}");
                path
            }
        };
        path.exists().then_some(path)
    }

    /// Runs it, and says what was predicted and what it took.
    fn run(&self, tessera: &Path, folder: &Path, idle: u64) -> Option<Value> {
        let input = self.file(tessera, folder)?;
        let bytes = std::fs::read(&input).unwrap();
        let format = Format::of_path(&input).unwrap();
        let (vertices, facets) = io::counts(format, &bytes).unwrap();
        let counted = Counts { vertices, facets, input_bytes: bytes.len() as u64, ..self.counts() };
        drop(bytes);
        let mut args = vec!["--points".to_owned(), self.points.to_string()];
        if self.kind == Remesh {
            let newton = self.steps.saturating_sub(5);
            let (density, placement) = match (self.density, self.placement) {
                (density, Surface) => (density, "surface"),
                (density, _) => (density, "fitted"),
            };
            let density = match density {
                Curvature => "curvature",
                Lfs => "lfs",
                _ => "uniform",
            };
            let (lloyd, newton) = ((self.steps - newton).to_string(), newton.to_string());
            let more = ["--lloyd", &lloyd, "--newton", &newton, "--density", density, "--placement", placement];
            args.extend(more.map(str::to_owned));
            args.extend(["-o".to_owned(), folder.join("out.ply").display().to_string()]);
        }
        let kind = if self.kind == Remesh { "remesh" } else { "rvd" };
        let report = run(tessera, folder, kind, &input, &args);
        let need = need(&counted, THREADS);
        let measured = peak(&report) - idle;
        let measured_seconds = report["timings_ms"]["total"].as_f64().unwrap() / 1e3;
        Some(json!({
            "case": self.name(),
            "vertices": vertices,
            "facets": facets,
            "points": self.points,
            "predicted_bytes": need.memory.host,
            "measured_bytes": measured,
            "ratio": need.memory.host as f64 / measured as f64,
            "predicted_seconds": need.seconds,
            "measured_seconds": measured_seconds,
        }))
    }
}

/// The report of a run.
fn run(tessera: &Path, folder: &Path, kind: &str, input: &Path, args: &[String]) -> Value {
    let report = folder.join("report.json");
    let mut command = Command::new(tessera);
    command.args([kind, "--quiet", "--backend", "parallel", "--threads", &THREADS.to_string(), "--report"]);
    let output = command.arg(&report).args(args).arg(input).output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&std::fs::read(&report).unwrap()).unwrap()
}

fn peak(report: &Value) -> u64 {
    report["memory"]["host_peak_bytes"].as_u64().unwrap()
}

/// Measures the cases of `TESSERA_NEED` (`fitted` or `held-out`; both if not set) with the program `TESSERA_PROGRAM`.
#[test]
#[ignore = "minutes of work and 4 GB; docs/performance.md has the command"]
fn measure() {
    let tessera = PathBuf::from(std::env::var_os("TESSERA_PROGRAM").unwrap());
    let wanted = std::env::var("TESSERA_NEED").ok();
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // A job of one point on two triangles stands for an idle process.
    let square = Case { surface: Shape("square", 2), ..case(Rvd, Shape("", 0), [4, 2], [1, 0], Uniform, Fitted, 0) };
    let input = square.file(&tessera, folder).unwrap();
    let idle = peak(&run(&tessera, folder, "rvd", &input, &["--points".to_owned(), "1".to_owned()]));
    let mut off = Vec::new();
    for (group, cases) in [("fitted", FITTED), ("held-out", HELD_OUT)] {
        if wanted.as_ref().is_some_and(|wanted| wanted != group) {
            continue;
        }
        for case in cases {
            let Some(mut line) = case.run(&tessera, folder, idle) else {
                println!("{}", json!({"case": case.name(), "skipped": "the surface is not there"}));
                continue;
            };
            line["group"] = group.into();
            println!("{line}");
            if !RATIOS.contains(&line["ratio"].as_f64().unwrap()) {
                off.push(line["case"].to_string());
            }
        }
    }
    assert!(off.is_empty(), "not within {RATIOS:?}: {off:#?}");
}

#[test]
fn predictions_are_near_what_runs_took() {
    for case in FITTED.iter().chain(HELD_OUT) {
        let ratio = need(&case.counts(), THREADS).memory.host as f64 / case.measured as f64;
        assert!(RATIOS.contains(&ratio), "{}: {ratio:.2}", case.name());
    }
}
