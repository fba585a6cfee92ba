//! `tessera bench` prints tables, writes JSON of the promised shape and plots that decode; reports count what a GPU is
//! kept busy with. Times are never judged.

use std::path::Path;
use std::process::{Command, Output};

use needs::needs;
use serde_json::Value;
use tessera::mesh::io;
use tessera::mesh::shapes::Shape;

fn tessera(folder: &Path, line: &str) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tessera"));
    command.current_dir(folder).args(line.split(' ')).env_remove("TESSERA_BACKEND").env_remove("TESSERA_THREADS");
    command.output().unwrap()
}

/// What `line` printed.
fn run(folder: &Path, line: &str) -> String {
    let out = tessera(folder, line);
    assert!(out.status.success(), "{line}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

fn json(folder: &Path, name: &str) -> Value {
    serde_json::from_str(&std::fs::read_to_string(folder.join(name)).unwrap()).unwrap()
}

/// Width, height, and how many colours there are.
fn picture(path: &Path) -> (u32, u32, usize) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    let mut colours: Vec<&[u8]> = pixels.chunks(3).collect();
    colours.sort_unstable();
    colours.dedup();
    (info.width, info.height, colours.len())
}

/// What the promised shape has, of each case; `cases` of them.
fn check(report: &Value, cases: usize) {
    assert!(report["backend"].is_string() && report["threads"].is_u64(), "{report}");
    assert!(report.get("adapter").is_some());
    let all = report["cases"].as_array().unwrap();
    assert_eq!(all.len(), cases, "{report}");
    for case in all {
        assert!(case["mesh"].is_string() && case["facets"].is_u64() && case["points"].is_u64(), "{case}");
        assert_eq!(case["exact"], true);
        let [min, median, max] = ["min", "median", "max"].map(|k| case["iteration_ms"][k].as_f64().unwrap());
        assert!(0.0 < min && min <= median && median <= max, "{case}");
        for phase in ["neighbours", "start", "clip", "update"] {
            assert!(case["phases_ms"][phase].as_f64().unwrap() >= 0.0, "{case}");
        }
    }
}

const SMALL: &str = "--facets 500 --relax 1 --iterations 3 --backend parallel --json out.json --plot out.png";

#[test]
fn a_diagram_and_steps_are_timed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = run(folder, &format!("bench rvd --points 200 {SMALL}"));
    assert!(text.contains("iteration") && text.contains("clip"), "{text}");
    check(&json(folder, "out.json"), 1);
    assert!(picture(&folder.join("out.png")).2 > 20);

    let text = run(folder, &format!("bench cvt --points 200 --density curvature --rounds 2 {SMALL}"));
    for wanted in ["Lloyd step", "L-BFGS evaluation", "L-BFGS : Lloyd", "curvature : uniform"] {
        assert!(text.contains(wanted), "{wanted}: {text}");
    }
    let report = json(folder, "out.json");
    check(&report, 4);
    let kinds: Vec<(&str, &str)> = report["cases"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| (c["density"].as_str().unwrap(), c["kind"].as_str().unwrap()))
        .collect();
    let wanted = [("uniform", "lloyd"), ("uniform", "lbfgs"), ("curvature", "lloyd"), ("curvature", "lbfgs")];
    assert_eq!(kinds, wanted);
    for case in report["cases"].as_array().unwrap() {
        assert_eq!(
            (&case["iterations"], &case["phases_by"]),
            (&6.into(), &"wall clock".into()),
            "3 in each of 2 rounds"
        );
        assert!(case["evaluations"].as_u64() >= Some(6) && case["evaluation_ms"]["median"].as_f64() > Some(0.0));
        assert_eq!(case["device_most"]["device_submissions"], 0);
    }
    assert_eq!(report["rounds"], 2);
    let ratio = &report["lbfgs_evaluation_per_lloyd_evaluation"];
    assert!(ratio["uniform"].as_f64() > Some(0.0) && ratio["curvature"].as_f64() > Some(0.0), "{report}");
    assert!(report["adaptive_per_uniform"]["lloyd"]["iteration"].as_f64() > Some(0.0));
    assert!(picture(&folder.join("out.png")).2 > 20);
}

#[test]
fn the_table_has_its_columns_and_never_makes_up_a_figure() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = run(folder, &format!("bench table1 --points 50,60,70 {SMALL}"));
    assert_eq!(text.matches("not at hand").count(), 4, "{text}");
    let report = json(folder, "out.json");
    check(&report, 3);
    let rows = report["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 3);
    for (row, (mesh, points)) in rows.iter().zip([("torus", 50), ("sphere", 60), ("genus3", 70)]) {
        assert_eq!((&row["mesh"], &row["points"]), (&mesh.into(), &points.into()));
        assert!(row["gpu_ms"].is_null() && row["serial_ms"].is_null() && row["published"].is_null());
        assert!(row["parallel_ms"].as_f64() > Some(0.0));
    }
    assert!(picture(&folder.join("out.png")).2 > 20);

    io::write(&folder.join("Ball.ply"), &Shape::Sphere.build(300)).unwrap();
    io::write(&folder.join("ring.ply"), &Shape::Torus.build(300)).unwrap();
    let published = r#"{ "source": "somebody, 1999", "rows": [
        { "mesh": "ball", "facets": 300, "points": 40, "gpu_ms": 2.0, "serial_ms": 50.0, "parallel_ms": 9.0 },
        { "mesh": "cow", "gpu_ms": 3.25 } ] }"#;
    std::fs::write(folder.join("published.json"), published).unwrap();
    let line = "bench table1 --mesh Ball.ply --mesh ring.ply --points 40 --relax 0 --iterations 2 --backend serial \
                --published published.json --json out.json";
    let text = run(folder, line);
    assert!(text.contains("2.000, 50.000, 9.000, 25.00, 4.50"), "{text}");
    assert!(text.contains("cow") && text.contains("3.250") && text.contains("somebody, 1999"), "{text}");
    assert_eq!(text.matches("not at hand").count(), 1, "the ring's: {text}");
    let report = json(folder, "out.json");
    check(&report, 2);
    assert_eq!(report["rows"][0]["published"]["serial_ms"], 50.0);
    assert!(report["rows"][1]["published"].is_null());
    assert_eq!(report["published_source"], "somebody, 1999");
}

#[test]
fn times_grow_and_end() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let text = run(folder, &format!("bench fig3 --points 60 --max-points 200 --max-facets 6000 {SMALL}"));
    assert_eq!(text.matches("slope of log time").count(), 2, "{text}");
    let report = json(folder, "out.json");
    check(&report, 4 + 2);
    let points: Vec<u64> = report["cases"].as_array().unwrap().iter().map(|c| c["points"].as_u64().unwrap()).collect();
    assert_eq!(points, [20, 50, 100, 200, 60, 60]);
    assert!(report["slopes"].as_array().unwrap().iter().all(|s| s["slope"].is_f64()), "{report}");
    assert_eq!(report["left_out"].as_array().unwrap().len(), 0);
    let (width, height, colours) = picture(&folder.join("out.png"));
    assert!((width, height) == (1600, 600) && colours > 20);

    // A limit that nothing keeps: one case of each curve is measured, with three steps, and the others are named.
    let line = "--relax 3 --iterations 9 --backend parallel --json out.json";
    let text =
        run(folder, &format!("bench fig3 --time-limit 0.001 --facets 30000 --max-points 100 --points 20 {line}"));
    assert!(text.contains("left out"), "{text}");
    let report = json(folder, "out.json");
    check(&report, 2);
    assert_eq!(report["cases"][0]["iterations"], 3);
    assert_eq!(report["left_out"].as_array().unwrap().len(), 2 + 5);

    let text = run(folder, &format!("bench fig4 --points 30,60 {SMALL}"));
    assert!(text.contains("3 Lloyd steps"), "{text}");
    let report = json(folder, "out.json");
    check(&report, 2);
    assert!(report["cases"][1]["total_ms"].as_f64() > Some(0.0));
    assert!(picture(&folder.join("out.png")).2 > 20);
}

#[test]
fn baselines_are_measured_beside_the_exact_diagram() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let methods = "--baseline jfa --baseline band --baseline geometry-image --voxels 24 --shell 2 --texels 64";
    let text = run(folder, &format!("bench fig4 --points 30,60 {methods} {SMALL}"));
    assert_eq!(text.matches("not run: the surface is no disk").count(), 4, "{text}");
    let report = json(folder, "out.json");
    check(&report, 2);
    assert_eq!(report["baseline_options"], serde_json::json!({ "voxels": 24, "shell": 2, "texels": 64 }));
    let names = ["exact", "jfa", "jfa, warm", "band", "geometry-image", "geometry-image, L-BFGS"];
    let rows = report["baselines"].as_array().unwrap();
    assert_eq!(rows.len(), 2 * names.len());
    for (k, row) in rows.iter().enumerate() {
        assert_eq!((&row["method"], &row["points"]), (&names[k % 6].into(), &[30, 60][k / 6].into()));
        if k % 6 >= 4 {
            assert!(row["not_run"].is_string() && row["iteration_ms"].is_null(), "{row}");
            continue;
        }
        let exact = k % 6 == 0;
        assert_eq!((&row["exact"], &row["iterations"]), (&exact.into(), &3.into()));
        assert!(
            row["iteration_ms"]["median"].as_f64() > Some(0.0) && row["energy_ratio"].as_f64() > Some(0.9),
            "{row}"
        );
        assert!(row["exact_dual"]["q_avg"].as_f64() > Some(0.3), "{row}");
        for key in ["memory_bytes", "wrong_area_percent", "wrong_labels_percent", "own_dual"] {
            assert_eq!(row[key].is_null(), exact, "{key}: {row}");
        }
    }
    assert!(picture(&folder.join("out.png")).2 > 20);

    io::write(&folder.join("hills.ply"), &Shape::Hills.build(500)).unwrap();
    let line = "bench fig4 --mesh hills.ply --points 40 --baseline geometry-image --texels 64 --iterations 3 \
                --backend serial --json out.json";
    run(folder, line);
    let report = json(folder, "out.json");
    let rows = report["baselines"].as_array().unwrap();
    let kinds: Vec<&str> = rows.iter().map(|row| row["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["lloyd", "lloyd", "lbfgs"]);
    assert!(rows[1]["wrong_labels_percent"].as_f64() < Some(5.0), "{report}");
}

#[test]
fn wrong_usage_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    std::fs::write(folder.join("bad.json"), r#"{ "rows": [ { "mesh": "a", "gpu_ms": -1 } ] }"#).unwrap();
    std::fs::write(folder.join("odd.json"), r#"{ "rows": [ { "model": "a" } ] }"#).unwrap();
    std::fs::write(folder.join("seeds.xyz"), "0 0 0\n").unwrap();
    let lines = [
        ("bench", 2),
        ("bench fig5", 2),
        ("bench cvt --density sizes", 2),
        ("bench cvt --iterations 0", 2),
        ("bench cvt --rounds 0", 2),
        ("bench cvt --points 9 --seeds seeds.xyz", 2),
        ("bench cvt --plot out.jpg", 2),
        ("bench fig3 --plot nowhere/out.png", 73),
        ("bench fig3 --time-limit 0", 2),
        ("bench fig3 --seeds seeds.xyz", 2),
        ("bench fig3 --threads 0", 2),
        ("bench fig4 --points 10,x", 2),
        ("bench fig4 --baseline dijkstra", 2),
        ("bench fig4 --baseline jfa --voxels 4", 2),
        ("bench fig4 --voxels 64", 2),
        ("bench fig4 --json nowhere/out.json", 73),
        ("bench table1 --points 10,20", 2),
        ("bench table1 --facets 10,20", 2),
        ("bench table1 --seeds seeds.xyz", 2),
        ("bench table1 --mesh a.ply --mesh b.ply --seeds seeds.xyz", 2),
        ("bench table1 --mesh a.ply --facets 10", 2),
        ("bench table1 --published bad.json", 65),
        ("bench table1 --published odd.json", 65),
        ("bench table1 --published nowhere.json", 66),
        ("bench cvt --mesh nowhere.ply", 66),
    ];
    for (line, code) in lines {
        let out = tessera(folder, line);
        assert_eq!(out.status.code(), Some(code), "{line}: {}", String::from_utf8_lossy(&out.stderr));
        assert!(!out.stderr.is_empty(), "{line}");
    }
}

#[cfg(unix)]
#[test]
fn an_interrupt_ends_it() {
    use std::io::{BufRead, BufReader};
    let line = "bench fig4 --facets 500 --points 50 --iterations 100000000 --backend serial";
    let mut child = Command::new(env!("CARGO_BIN_EXE_tessera"))
        .args(line.split(' '))
        .stdout(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // It listens for signals before it says who works.
    let mut first = String::new();
    BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut first).unwrap();
    assert!(first.contains("serial"), "{first}");
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(child.wait().unwrap().code(), Some(130));
}

const WORK: [&str; 5] =
    ["host_searches", "device_submissions", "device_allocations", "uploaded_bytes", "read_back_bytes"];

fn work(of: &Value) -> [u64; 5] {
    WORK.map(|key| of[key].as_u64().unwrap_or_else(|| panic!("{key}: {of}")))
}

#[test]
fn reports_of_a_cpu_count_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    io::write(&folder.join("in.ply"), &Shape::Sphere.build(500)).unwrap();
    run(folder, "remesh in.ply -o out.ply --points 60 --backend parallel --report report.json");
    let report = json(folder, "report.json");
    let device = &report["device"];
    assert!([device, &device["iterations"], &device["later_iteration_most"]].iter().all(|of| work(of) == [0; 5]));
    assert!(report["iterations"].as_array().unwrap().iter().all(|step| work(step) == [0; 5]));
    run(folder, "rvd in.ply --points 60 --backend serial --report report.json");
    assert_eq!(work(&json(folder, "report.json")["device"]), [0; 5]);
}

#[needs(gpu)]
#[test]
fn jump_flooding_on_a_gpu_has_the_labels_of_the_cpu() {
    if crate::gpu::device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let line = "bench fig4 --facets 2000 --points 100 --iterations 5 --baseline jfa --voxels 37 --gpu-software --json out.json";
    run(folder, line);
    let report = json(folder, "out.json");
    let row = |name: &str| report["baselines"].as_array().unwrap().iter().find(|row| row["method"] == name).unwrap();
    for (cpu, gpu) in [("jfa", "jfa, GPU"), ("jfa, warm", "jfa, warm, GPU")] {
        let [cpu, gpu] = [cpu, gpu].map(|name| row(name)["energy_ratio"].as_f64().unwrap());
        assert!((cpu / gpu - 1.0).abs() < 0.01, "{cpu} {gpu}");
        assert!(row("jfa, warm, GPU")["wrong_labels_percent"].as_f64() < Some(0.5), "{report}");
    }
}

#[needs(gpu)]
#[test]
fn bands_and_images_on_a_gpu_have_the_labels_of_the_cpu() {
    if crate::gpu::device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    io::write(&folder.join("hills.ply"), &Shape::Hills.build(2000)).unwrap();
    let methods = "--baseline band --voxels 37 --shell 2 --baseline geometry-image --texels 96";
    let line = "bench fig4 --mesh hills.ply --points 100 --iterations 5 --gpu-software --json out.json";
    run(folder, &format!("{line} {methods}"));
    let report = json(folder, "out.json");
    let rows = report["baselines"].as_array().unwrap();
    let row = |name: &str| rows.iter().find(|row| row["method"] == name).unwrap();
    for cpu in ["band", "geometry-image", "geometry-image, L-BFGS"] {
        let (cpu, gpu) = (row(cpu), row(&format!("{cpu}, GPU")));
        assert_eq!(cpu["kind"], gpu["kind"]);
        let [energies, wrong] =
            ["energy_ratio", "wrong_labels_percent"].map(|key| [cpu, gpu].map(|row| row[key].as_f64().unwrap()));
        assert!((energies[0] / energies[1] - 1.0).abs() < 1e-3, "{cpu} {gpu}");
        assert!((wrong[0] - wrong[1]).abs() < 0.5, "{cpu} {gpu}");
        assert!(gpu["memory_bytes"].as_u64() > cpu["memory_bytes"].as_u64(), "{cpu} {gpu}");
    }
    assert!(row("band, GPU")["wrong_labels_percent"].as_f64() < Some(0.1), "{report}");

    // A torus is no disk on a device either.
    let line =
        "bench fig4 --facets 500 --points 40 --iterations 3 --baseline geometry-image --gpu-software --json out.json";
    run(folder, line);
    let report = json(folder, "out.json");
    let rows = report["baselines"].as_array().unwrap();
    assert_eq!(rows.iter().filter(|row| row["not_run"].is_string()).count(), 4, "{report}");
}

#[needs(gpu)]
#[test]
fn a_gpu_is_timed_by_its_clock_and_counted() {
    if crate::gpu::device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let line = "bench cvt --facets 2000 --points 800 --relax 3 --iterations 4 --rounds 1 --backend gpu --gpu-software --json out.json";
    let text = run(folder, line);
    assert!(text.contains("submissions"), "{text}");
    let report = json(folder, "out.json");
    check(&report, 2);
    assert!(report["adapter"].is_string());
    for case in report["cases"].as_array().unwrap() {
        // Seeds stay where they are: nothing is allocated, and what crosses does not grow with them (800 seeds of
        // 12 bytes would be 9600).
        let most = work(&case["device_most"]);
        assert_eq!((most[0], most[2]), (0, 0), "{case}");
        assert!(most[1] > 0 && most[3] < 4096 && most[4] < 4096, "{case}");
        if case["phases_by"] == "device clock" {
            let clip = case["phases_ms"]["clip"].as_f64().unwrap();
            assert!(clip > 0.0 && clip < case["iteration_ms"]["max"].as_f64().unwrap(), "{case}");
            assert!(case["phases_ms"]["neighbours"].as_f64() > Some(0.0), "{case}");
        }
    }
    io::write(&folder.join("in.ply"), &Shape::Torus.build(2000)).unwrap();
    run(folder, "remesh in.ply -o out.ply --points 400 --newton 4 --backend gpu --gpu-software --report report.json");
    let report = json(folder, "report.json");
    let steps: Vec<[u64; 5]> = report["iterations"].as_array().unwrap().iter().map(work).collect();
    // Quasi-Newton steps ask the host on the way; Lloyd steps may go several in one submission, told of the first.
    let newton = |step: &&Value| step["kind"] == "lbfgs";
    let mut asked = report["iterations"].as_array().unwrap().iter().filter(newton).map(work);
    assert!(steps.len() > 4 && steps[0][1] > 0 && asked.all(|step| step[1] >= 2), "{report}");
    let facets = |of: &Value| ["divided_facets", "paired_facets"].map(|key| of[key].as_u64().unwrap());
    let [divided, paired] = facets(&report["device"]["iterations"]);
    assert!(divided > 0 && (divided + paired) % report["input"]["facets"].as_u64().unwrap() == 0, "{report}");
    let sum: [u64; 5] = std::array::from_fn(|k| steps.iter().map(|step| step[k]).sum());
    let most: [u64; 5] = std::array::from_fn(|k| steps[1..].iter().map(|step| step[k]).max().unwrap());
    let device = &report["device"];
    assert_eq!(work(&device["iterations"]), sum);
    assert_eq!(work(&device["later_iteration_most"]), most);
    let median = work(&device["later_iteration_median"]);
    // 400 seeds of 12 bytes would be 4800.
    assert!((median[0], median[2]) == (0, 0) && median[4] < 2048, "{device}");
    assert!(work(device).iter().zip(sum).all(|(all, part)| *all >= part), "{device}");
    assert!(work(device)[2] > 0, "buffers were allocated: {device}");
    run(folder, "rvd in.ply --points 400 --backend gpu --gpu-software --report report.json");
    let device = &json(folder, "report.json")["device"];
    assert!(work(device)[1] > 0 && work(device)[2] > 0 && work(&device["iterations"]) == [0; 5], "{device}");
}
