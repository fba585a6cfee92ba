//! Promise: what a job takes is predicted. Each input and each option grows alone, and the memory of the process grows no more than
//! 1.5 times as much as was planned, and no less than a quarter of it. With `TESSERA_LONG=1` and a release build it takes at
//! most three times the predicted time.
//!
//! One test alone, since an allocator counts for the whole process. `attacks` prints figures of hostile jobs, with their times.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

#[path = "common/long.rs"]
mod long;

use std::collections::{BTreeSet, HashMap};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use geometry::cvt::density::{Count, DensityOptions, Expected};
use glam::DVec3;
use jobs::admission::estimate::{Counts, Kind, need};
use jobs::blob::{BlobOptions, Owner, put_of};
use jobs::executor::api::{JobApi, Reuse};
use jobs::record::Spec;
use jobs::record::state::State;
use jobs::{Backends, Engine, EngineOptions, Executor, ExecutorOptions, JobError, PoolFactory, Stores};
use peak_alloc::PeakAlloc;
use prost::Message as _;
use serde_json::json;
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::io::{self, Format};
use tessera::mesh::shapes::Shape;
use tessera::proto::*;
use tessera::rvd::{Backend, Parallel, Serial};
use tessera::{BackendChoice, BackendKind, Token};
use wire::counts::Bounds;

use self::long::is_long;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

const MIB: f64 = (1 << 20) as f64;

/// A job, and the same with one thing grown.
struct Case {
    name: &'static str,
    small: JobSpec,
    large: JobSpec,
    /// Whether all that was planned is used. Room for points that a tolerance may need is planned in any case.
    is_exact: bool,
}

/// What a job took.
#[derive(Clone, Copy, Debug)]
struct Taken {
    planned: f64,
    measured: f64,
    predicted_s: f64,
    measured_s: f64,
    /// CPU time of the process; none where the system does not say.
    cpu_s: Option<f64>,
}

/// CPU time of this process, whatever else the machine does.
fn cpu_s() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields = stat.rsplit_once(") ")?.1.split_whitespace().skip(11);
    let ticks: Option<f64> = fields.take(2).map(|field| field.parse::<f64>().ok()).sum();
    // Ticks of a hundredth of a second, in every build of Linux.
    ticks.map(|ticks| ticks / 100.0)
}

struct Server {
    runtime: tokio::runtime::Runtime,
    engine: Engine,
    executor: Executor,
    stores: Stores,
    _folder: tempfile::TempDir,
}

impl Server {
    fn start() -> Self {
        let factory = || -> Result<Backends, JobError> {
            let pools: PoolFactory = |threads| Ok(Arc::new(Parallel::new(Some(threads))?));
            Ok(Backends {
                gpu: Err("none".to_owned()),
                parallel: Arc::new(Parallel::new(Some(2))?) as Arc<dyn Backend>,
                serial: Arc::new(Serial),
                default: BackendChoice::Auto,
                pools: Some(pools),
            })
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let (engine, _thread) = Engine::start(factory, EngineOptions::default()).unwrap();
        // On the disk: what is stored takes no memory.
        let stores = runtime.block_on(Stores::in_folder(folder.path().to_owned(), BlobOptions::default())).unwrap();
        let options = ExecutorOptions::new(Bounds::of_library());
        let executor = runtime.block_on(Executor::start(engine.clone(), stores.clone(), options)).unwrap();
        Self { runtime, engine, executor, stores, _folder: folder }
    }

    fn put(&self, bytes: Vec<u8>) -> String {
        self.runtime.block_on(put_of(&*self.stores.blobs, "t", None, bytes.into())).unwrap().digest.to_string()
    }

    fn array(&self, form: ArrayForm, count: usize, bytes: Vec<u8>) -> Option<ArrayRef> {
        Some(ArrayRef { digest: self.put(bytes), form: form.into(), count: count as u64 })
    }

    fn file(&self, format: Format, bytes: Vec<u8>) -> Option<JobMesh> {
        let file = MeshFile { digest: self.put(bytes), format: format.number(), attributes: None };
        Some(JobMesh { source: Some(job_mesh::Source::File(file)) })
    }

    fn mesh(&self, mesh: &TriMesh) -> Option<JobMesh> {
        self.file(Format::Ply, io::encode(Format::Ply, mesh).unwrap())
    }

    fn run(&self, spec: &JobSpec) -> Taken {
        let (taken, state) = self.run_to_any_end(spec);
        assert_eq!(state, State::Succeeded);
        taken
    }

    fn run_to_any_end(&self, spec: &JobSpec) -> (Taken, State) {
        let spec = |tenant: &str| Spec::new(spec.clone(), tenant.to_owned(), String::new()).unwrap();
        let estimate = self.runtime.block_on(self.executor.estimate(spec("t"), None, None)).unwrap();
        // The job before has ended for its caller first.
        while self.engine.load().1 {
            std::thread::sleep(Duration::from_millis(1));
        }
        MEMORY.reset_peak_usage();
        let (before, begin, cpu) = (MEMORY.current_usage(), Instant::now(), cpu_s());
        let id = self.runtime.block_on(self.executor.create(spec("t"), Reuse::Never)).unwrap().job.id;
        let mut planned = estimate.host_bytes;
        let state = loop {
            planned = planned.max(self.engine.planned().host);
            match self.runtime.block_on(self.executor.get("t", id)).unwrap().status.state {
                State::Queued | State::Running => std::thread::sleep(Duration::from_millis(2)),
                state => break state,
            }
        };
        let measured = MEMORY.peak_usage().saturating_sub(before) as f64 / MIB;
        let measured_s = begin.elapsed().as_secs_f64();
        let cpu_s = cpu_s().zip(cpu).map(|(now, before)| now - before);
        (Taken { planned: planned as f64 / MIB, measured, predicted_s: estimate.seconds, measured_s, cpu_s }, state)
    }
}

fn of(mesh: Option<JobMesh>, work: job_spec::Work) -> JobSpec {
    JobSpec { mesh, work: Some(work), ..JobSpec::default() }
}

/// As cheap as a remesh can be.
fn remesh(points: u32) -> RemeshOptions {
    RemeshOptions { points: Some(points), lloyd: Some(1), newton: Some(0), ..RemeshOptions::default() }
}

fn job_spec_of(mesh: Option<JobMesh>, options: RemeshOptions) -> JobSpec {
    of(mesh, job_spec::Work::Remesh(options))
}

fn cvt(points: u32, step: CvtStep) -> CvtJob {
    let command = Some(cvt_job_command::Command::Step(step));
    let options = Some(CvtOptions { points: Some(points), ..CvtOptions::default() });
    CvtJob { options, commands: vec![CvtJobCommand { command }] }
}

fn numbers(values: impl IntoIterator<Item = f64>) -> Vec<u8> {
    values.into_iter().flat_map(f64::to_le_bytes).collect()
}

fn text(lines: impl IntoIterator<Item = String>) -> Vec<u8> {
    lines
        .into_iter()
        .fold(String::new(), |mut text, line| {
            let _ = writeln!(text, "{line}");
            text
        })
        .into_bytes()
}

/// A surface with this many scalars.
fn with_scalars(mesh: &TriMesh, scalars: usize) -> Vec<u8> {
    let mut attributes = Attributes::new(mesh);
    for k in 0..scalars {
        let values = mesh.positions().iter().map(|p| p.x + k as f64).collect();
        attributes.add_scalar(Scalar::new(format!("scalar{k}"), values)).unwrap();
    }
    io::encode_with_attributes(Format::Ply, mesh, &attributes).unwrap().0
}

/// A flat polygon with this many corners, as OBJ.
fn polygon(corners: usize) -> Vec<u8> {
    let angle = |k: usize| std::f64::consts::TAU * k as f64 / corners as f64;
    let vertices = (0..corners).map(|k| format!("v {} {} 0", angle(k).cos(), angle(k).sin()));
    let face = (1..=corners).fold("f".to_owned(), |face, k| format!("{face} {k}"));
    text(vertices.chain([face]))
}

/// Slender facets around one vertex, at this height above the others.
fn fan(facets: u32, height: f64) -> TriMesh {
    let angle = |k: u32| std::f64::consts::TAU * f64::from(k) / f64::from(facets);
    let rim = (0..facets).map(|k| DVec3::new(angle(k).cos(), angle(k).sin(), 0.0));
    let facet = |k: u32| [0, 1 + k, 1 + (k + 1) % facets];
    TriMesh::new([DVec3::Z * height].into_iter().chain(rim).collect(), (0..facets).map(facet).collect()).unwrap()
}

fn strip(facets: u32) -> TriMesh {
    let ends = |k: u32| [0.0, 10.0].map(|x| DVec3::new(x, f64::from(2 * k) / f64::from(facets), 0.0));
    let pair = |k: u32| [[2 * k, 2 * k + 1, 2 * k + 3], [2 * k, 2 * k + 3, 2 * k + 2]];
    TriMesh::new((0..=facets / 2).flat_map(ends).collect(), (0..facets / 2).flat_map(pair).collect()).unwrap()
}

/// Facets anywhere in a cube.
fn soup(facets: u32) -> TriMesh {
    let mut state = 1u64;
    let mut random = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let places = (0..3 * facets).map(|_| DVec3::new(random(), random(), random())).collect();
    TriMesh::new(places, (0..facets).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect()).unwrap()
}

fn cases(server: &Server) -> Vec<Case> {
    let (torus, fine, cube) = (Shape::Torus.build(2000), Shape::Torus.build(150_000), Shape::Block.build(12));
    let vertices = fine.positions().len();
    let case = |name, small, large| Case { name, small, large, is_exact: true };
    let upper = |name, small, large| Case { name, small, large, is_exact: false };
    let base = || job_spec_of(server.mesh(&torus), remesh(200));
    let on = |mesh: &TriMesh, options: RemeshOptions| job_spec_of(server.mesh(mesh), options);
    let beside = |spec: &JobSpec, arrays: JobArrays| JobSpec { arrays: Some(arrays), ..spec.clone() };
    let with = |change: &dyn Fn(&mut RemeshOptions)| {
        let mut options = remesh(200);
        change(&mut options);
        on(&torus, options)
    };
    let dense = |source: DensitySource| Some(Density { source: source.into(), ..Density::default() });
    let length = |edge_length| Some(Density { edge_length: Some(edge_length), ..Density::default() });
    let zoned = |edge: f64| {
        let size_in = vec![format!("sphere:0.5,0.5,0.5,9={edge}")];
        let density = Some(Density { edge_length: Some(0.2), size_in, ..Density::default() });
        RemeshOptions { points: None, density, ..remesh(0) }
    };
    let implied = |edge| RemeshOptions { points: None, density: length(edge), ..remesh(0) };
    let arrays = |scalars: usize| {
        let positions = numbers(fine.positions().iter().flat_map(|p| p.to_array()));
        let facets = fine.facets().as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
        let values = |k: usize| numbers(fine.positions().iter().map(|p| p.y * k as f64));
        let attribute = |k: usize| AttributeArrays {
            kind: AttributeKind::Scalar.into(),
            name: format!("scalar{k}"),
            values: server.array(ArrayForm::F64, vertices, values(k)),
            corners: None,
            components: 0,
            regions: Vec::new(),
        };
        let source = job_mesh::Source::Arrays(MeshArrays {
            positions: server.array(ArrayForm::F64, vertices, positions),
            facets: server.array(ArrayForm::U32, fine.facets().len(), facets),
            attributes: (0..scalars).map(attribute).collect(),
        });
        job_spec_of(Some(JobMesh { source: Some(source) }), remesh(200))
    };
    let lifted = |options| RemeshOptions { anisotropy_auto: true, ..options };
    let on_fine = on(&fine, remesh(200));
    let seeds = |count: usize, form| {
        let seeds: Vec<DVec3> = fine.positions().iter().copied().step_by(vertices / count).take(count).collect();
        let array = match form {
            ArrayForm::Text => server.array(form, 0, text(seeds.iter().map(|p| format!("{} {} {}", p.x, p.y, p.z)))),
            _ => server.array(form, seeds.len(), numbers(seeds.iter().flat_map(|p| p.to_array()))),
        };
        let spec = on(&fine, RemeshOptions { points: None, ..remesh(0) });
        beside(&spec, JobArrays { seeds: array, ..JobArrays::default() })
    };
    let lengths = |form| {
        let array = match form {
            ArrayForm::Text => server.array(form, 0, text((0..vertices).map(|_| "0.1".to_owned()))),
            _ => server.array(form, vertices, numbers((0..vertices).map(|_| 0.1))),
        };
        beside(&on_fine, JobArrays { edge_lengths: array, ..JobArrays::default() })
    };
    let weights = server.array(ArrayForm::F64, vertices, numbers((0..vertices).map(|_| 1.0)));
    let tensors =
        server.array(ArrayForm::F64, vertices, numbers((0..vertices).flat_map(|_| [9.0, 0.0, 9.0, 0.0, 0.0, 9.0])));
    let metric = beside(&on_fine, JobArrays { metric: tensors, ..JobArrays::default() });
    let edges = |form| {
        let edge = fine.facets()[0];
        let count = 3 * fine.facets().len() - 7;
        let array = match form {
            ArrayForm::Text => server.array(form, 0, text((0..count).map(|_| format!("{} {}", edge[0], edge[1])))),
            _ => server.array(
                form,
                count,
                (0..count).flat_map(|_| [edge[0], edge[1]]).flat_map(u32::to_le_bytes).collect(),
            ),
        };
        beside(&on_fine, JobArrays { creases: array, ..JobArrays::default() })
    };
    let cells = |points: u32| {
        let outputs = vec![RvdOutput::Cells.into()];
        of(
            server.mesh(&torus),
            job_spec::Work::Rvd(DiagramOptions { points: Some(points), outputs, ..Default::default() }),
        )
    };
    let sums = |points: u32| {
        let outputs = vec![RvdOutput::Centroids.into(), RvdOutput::Sums.into()];
        of(
            server.mesh(&torus),
            job_spec::Work::Rvd(DiagramOptions { points: Some(points), outputs, ..Default::default() }),
        )
    };
    let session = |points, iterations, seeds: SeedsWanted| {
        let step = CvtStep { iterations, seeds: seeds.into(), kind: StepKind::Lloyd.into() };
        of(server.mesh(&torus), job_spec::Work::Cvt(cvt(points, step)))
    };
    let room = |max_seeds| {
        let mut work = cvt(200, CvtStep { iterations: 1, ..CvtStep::default() });
        work.options.as_mut().unwrap().max_seeds = Some(max_seeds);
        of(server.mesh(&torus), job_spec::Work::Cvt(work))
    };
    let result = |form| JobSpec {
        result: Some(ResultFormat { form: Some(form) }),
        ..job_spec_of(server.mesh(&torus), remesh(3_000))
    };
    let plain = io::encode(Format::Obj, &fine).unwrap();
    let packed = io::pack_for(Path::new("a.gz"), plain.clone()).unwrap();
    let obj = |bytes| job_spec_of(server.file(Format::Obj, bytes), remesh(200));
    let mut cases = vec![
        case("facets", base(), on_fine.clone()),
        case("facets of a text", base(), obj(plain)),
        case("facets of a packed text", base(), obj(packed)),
        case("facets of arrays", base(), arrays(0)),
        case("points", base(), with(&|o| o.points = Some(20_000))),
        case("points as a share", base(), with(&|o| (o.points, o.points_percent) = (None, Some(1000.0)))),
        case("points by facets", base(), with(&|o| (o.points, o.facets) = (None, Some(20_000)))),
        case("lloyd", base(), with(&|o| o.lloyd = Some(3000))),
        case("newton", base(), with(&|o| o.newton = Some(1000))),
        case(
            "scalars of a file",
            on_fine.clone(),
            job_spec_of(server.file(Format::Ply, with_scalars(&fine, 40)), remesh(200)),
        ),
        case("scalars of arrays", arrays(0), arrays(40)),
        case("seeds", seeds(200, ArrayForm::F64), seeds(20_000, ArrayForm::F64)),
        case("seeds of a text", seeds(200, ArrayForm::F64), seeds(20_000, ArrayForm::Text)),
        case("sizes", on_fine.clone(), lengths(ArrayForm::F64)),
        case("sizes of a text", on_fine.clone(), lengths(ArrayForm::Text)),
        upper("a metric", on_fine.clone(), metric),
        case("weights", on_fine.clone(), beside(&on_fine, JobArrays { weights, ..JobArrays::default() })),
        case("creases", on_fine.clone(), edges(ArrayForm::U32)),
        case("creases of a text", on_fine.clone(), edges(ArrayForm::Text)),
        case("edge lengths of a part", on(&cube, zoned(0.2)), on(&cube, zoned(0.02))),
        case("edge length without points", on(&cube, implied(0.2)), on(&cube, implied(0.02))),
        upper("tolerance", base(), with(&|o| (o.max_deviation, o.max_points) = (Some(0.5), Some(5000)))),
        upper("a lift", base(), with(&|o| (o.points, o.anisotropy) = (Some(5000), Some(1.0)))),
        upper("a lift of a fine surface", on_fine.clone(), on(&fine, lifted(remesh(200)))),
        upper("a lift by curvature", base(), with(&|o| (o.points, o.anisotropy_auto) = (Some(20_000), true))),
        upper(
            "curvature",
            on_fine.clone(),
            on(&fine, RemeshOptions { density: dense(DensitySource::Curvature), ..remesh(200) }),
        ),
        upper(
            "feature size",
            on_fine.clone(),
            on(&fine, RemeshOptions { density: dense(DensitySource::Lfs), ..remesh(200) }),
        ),
        case("cells", cells(200), cells(100_000)),
        case("sums", sums(200), sums(100_000)),
        case("seeds of a session", session(200, 1, SeedsWanted::Never), session(100_000, 1, SeedsWanted::Never)),
        case("sets of seeds", session(2000, 1, SeedsWanted::Never), session(2000, 900, SeedsWanted::Each)),
        upper("room for seeds", room(200), room(100_000)),
        case("a polygon", obj(polygon(100)), obj(polygon(2500))),
        case("a fan", base(), on(&fan(6000, 0.5), remesh(200))),
        case("needles", base(), on(&strip(3000), remesh(500))),
        upper("a soup", base(), on(&soup(200), remesh(300))),
    ];
    let files = Format::ALL.map(|format| result(result_format::Form::File(format.number())));
    let forms = files.into_iter().chain([result(result_format::Form::Arrays(true))]);
    let first = result(result_format::Form::File(Format::Ply.number()));
    cases.extend(forms.map(|spec| upper("the result's form", first.clone(), spec)));
    cases
}

/// Fields that choose among things of one size, or that admission bounds to a few bytes.
const CHOICES: &[&str] = &[
    "ArrayRef.digest",
    "ArrayRef.form",
    "AttributeArrays.kind",
    "AttributeArrays.name",
    "CvtOptions.projection",
    "CvtOptions.seed",
    "CvtStep.kind",
    "Density.adaptivity",
    "Density.gradation",
    "DiagramOptions.seed",
    "Duration.nanos",
    "Duration.seconds",
    "JobSpec.backend",
    "JobSpec.priority",
    "LabelsEntry.key",
    "LabelsEntry.value",
    "MeshFile.digest",
    "MoveSeed.index",
    "Point.x",
    "Point.y",
    "Point.z",
    "Region.name",
    "Region.number",
    "RemeshOptions.boundaries",
    "RemeshOptions.crease_angle",
    "RemeshOptions.keep",
    "RemeshOptions.keep_rims",
    "RemeshOptions.measure",
    "RemeshOptions.mirror",
    "RemeshOptions.non_manifold",
    "RemeshOptions.only",
    "RemeshOptions.periodic",
    "RemeshOptions.placement",
    "RemeshOptions.projection",
    "RemeshOptions.seed",
    "RemeshOptions.source_map",
    "RemeshOptions.strict_creases",
    "RemeshOptions.thin",
    "RemeshOptions.weld",
    "RemeshOptions.weld_percent",
    // At most 64 KiB of a specification.
    "CvtEdit.seeds",
    "SeedEdit.remove",
];

/// Fields that make a job larger: the cases above grow them.
const GROWN: &[&str] = &[
    "ArrayRef.count",
    "AttributeArrays.components",
    "CvtOptions.points_percent",
    "DiagramOptions.points_percent",
    "RemeshOptions.points_percent",
    "RemeshOptions.anisotropy",
    "RemeshOptions.anisotropy_auto",
    "RemeshOptions.facets",
    "CvtOptions.max_seeds",
    "CvtOptions.points",
    "CvtStep.iterations",
    "CvtStep.seeds",
    "Density.edge_length",
    "Density.size_in",
    "Density.source",
    "DiagramOptions.outputs",
    "DiagramOptions.points",
    "MeshFile.attributes",
    "MeshFile.format",
    "RemeshOptions.lloyd",
    "RemeshOptions.max_deviation",
    "RemeshOptions.max_deviation_length",
    "RemeshOptions.max_points",
    "RemeshOptions.newton",
    "RemeshOptions.points",
    "ResultFormat.arrays",
    "ResultFormat.file",
];

/// An option of the schema is in one of the lists, so that a new one is thought of.
fn check_options() {
    let mut open = vec![wire::json::descriptor::<JobSpec>().unwrap()];
    let (mut seen, mut fields) = (BTreeSet::new(), BTreeSet::new());
    while let Some(message) = open.pop() {
        if !seen.insert(message.full_name().to_owned()) {
            continue;
        }
        for field in message.fields() {
            match field.kind().as_message() {
                Some(inner) => open.push(inner.clone()),
                None => drop(fields.insert(format!("{}.{}", message.name(), field.name()))),
            }
        }
    }
    let listed: BTreeSet<String> = CHOICES.iter().chain(GROWN).map(|name| (*name).to_owned()).collect();
    let (new, gone): (Vec<_>, Vec<_>) = (fields.difference(&listed).collect(), listed.difference(&fields).collect());
    assert!(new.is_empty() && gone.is_empty(), "not in a list: {new:?}; no such option: {gone:?}");
}

/// What is planned for the allocator, which this test does not see, and for small things.
const SLACK: [f64; 2] = [4.0, 40.0];

/// CPU time may be this many times what was predicted. It is looked at instead of time, since others may use the machine too;
/// both threads of a job together may use as much of it as twice its time.
const TIMES: f64 = 3.0;
/// CPU time beside the job's: of its blobs and its journal, of this test's questions for its state, and of two ticks of the clock.
const SLACK_S: f64 = 0.5;

/// Rows that take long, or differ little from others: with `TESSERA_LONG=1` alone.
const LONG: [&str; 16] = [
    "a lift by curvature",
    "creases of a text",
    "edge lengths of a part",
    "needles",
    "seeds of a text",
    "sizes of a text",
    "edge length without points",
    "facets of a packed text",
    "facets of a text",
    "feature size",
    "points",
    "points by facets",
    "seeds",
    "sizes",
    "creases",
    "scalars of arrays",
];

#[test]
fn each_input_and_option_is_planned() {
    check_options();
    let server = Server::start();
    let mut wrong = Vec::new();
    // Many grow from the same job.
    let mut known: HashMap<Vec<u8>, Taken> = HashMap::new();
    for Case { name, small, large, is_exact } in cases(&server) {
        if LONG.contains(&name) && !is_long() {
            continue;
        }
        let before = *known.entry(small.encode_to_vec()).or_insert_with(|| server.run(&small));
        let after = server.run(&large);
        let (planned, measured) = (after.planned - before.planned, after.measured - before.measured);
        let line = json!({
            "grown": name,
            "planned_mib": planned.round(),
            "measured_mib": measured.round(),
            "predicted_s": after.predicted_s,
            "measured_s": after.measured_s,
            "cpu_s": after.cpu_s,
        });
        println!("{line}");
        // Figures of time are those of a release build.
        let times = is_long() && !cfg!(debug_assertions);
        let is_slow = after.cpu_s.is_some_and(|cpu| cpu > TIMES * after.predicted_s + SLACK_S);
        let is_less = measured > 1.5 * planned + SLACK[0];
        let is_more = is_exact && planned > 4.0 * measured + SLACK[1];
        if is_less || is_more || after.measured > 1.5 * after.planned || (times && is_slow) {
            wrong.push(line);
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// How long an attack may be at work, seconds.
const LIMIT_S: i64 = 120;

/// Seconds that are predicted once the surface has been looked at.
fn seconds(mesh: &TriMesh, points: usize, steps: u64) -> f64 {
    let expected = Expected::of(mesh, &DensityOptions::default(), Count::Points(points), &Token::default()).unwrap();
    let (vertices, facets) = (mesh.positions().len() as u64, mesh.facets().len() as u64);
    let counts = Counts::new(Kind::Remesh, BackendKind::Parallel, vertices, facets, points as u64);
    need(&Counts { steps, ..counts.of_surface(&expected) }, 2).seconds
}

/// Jobs that took much more than was predicted, or kept others waiting: a line of figures for each.
#[test]
#[ignore = "minutes; prints figures"]
fn attacks() {
    let server = Server::start();
    let torus = Shape::Torus.build(2000);
    let limited =
        |spec: JobSpec| JobSpec { run_deadline: Some(prost_types::Duration { seconds: LIMIT_S, nanos: 0 }), ..spec };
    let text = |line: &str| server.array(ArrayForm::Text, 0, line.repeat((200 << 20) / line.len()).into_bytes());
    let on_torus = || job_spec_of(server.mesh(&torus), remesh(200));
    let lists = [
        ("200 MB of sizes", JobArrays { edge_lengths: text("1\n"), ..JobArrays::default() }),
        ("200 MB of creases", JobArrays { creases: text("0 1\n"), ..JobArrays::default() }),
        ("200 MB of one number", JobArrays { edge_lengths: text("1"), ..JobArrays::default() }),
    ];
    let lists = lists.map(|(name, arrays)| (name, JobSpec { arrays: Some(arrays), ..on_torus() }, None));
    let each = CvtStep { iterations: 990, seeds: SeedsWanted::Each.into(), kind: StepKind::Lloyd.into() };
    let density = Some(Density { edge_length: Some(0.01), ..Density::default() });
    let implied = RemeshOptions { points: None, density, ..remesh(0) };
    let corners = server.file(Format::Obj, polygon(100_000));
    let sets = of(server.mesh(&torus), job_spec::Work::Cvt(cvt(5000, each)));
    let usual = |points: u32| RemeshOptions { points: Some(points), ..RemeshOptions::default() };
    let surfaces = [
        ("a fan of 100,000", fan(100_000, 0.0)),
        ("a cone of 100,000", fan(100_000, 1.0)),
        ("needles, 10,000", strip(10_000)),
        ("a soup of 1,000", soup(1000)),
        ("a soup of 10,000", soup(10_000)),
    ];
    let surfaces = surfaces
        .iter()
        .map(|(name, mesh)| (*name, job_spec_of(server.mesh(mesh), usual(2000)), Some(seconds(mesh, 2000, 35))));
    let others = [
        ("990 sets of 5,000 seeds", sets, None),
        ("an edge length without points", job_spec_of(server.mesh(&Shape::Block.build(12)), implied), None),
        ("a polygon of 100,000 corners", job_spec_of(corners, remesh(200)), None),
    ];
    for (name, spec, predicted_s) in lists.into_iter().chain(others).chain(surfaces) {
        let (taken, state) = server.run_to_any_end(&limited(spec));
        let line = json!({
            "attack": name,
            "ended": format!("{state:?}"),
            "planned_mib": taken.planned.round(),
            "measured_mib": taken.measured.round(),
            "predicted_s": predicted_s.unwrap_or(taken.predicted_s),
            "measured_s": taken.measured_s,
            "cpu_s": taken.cpu_s,
        });
        println!("{line}");
    }
    // Three of them under three names, and a tiny job of a fourth.
    let create = |tenant: &str, spec: &JobSpec| {
        let spec = Spec::new(spec.clone(), tenant.to_owned(), String::new()).unwrap();
        let blobs = spec.task().blobs();
        let owner = Owner::of(tenant);
        server.runtime.block_on(server.stores.blobs.claim(owner, &blobs)).unwrap();
        server.runtime.block_on(server.executor.create(spec, Reuse::Never)).unwrap().job.id
    };
    let long = job_spec_of(server.mesh(&strip(20_000)), usual(2000));
    let jobs = ["a", "b", "c"].map(|tenant| (tenant, create(tenant, &long)));
    std::thread::sleep(Duration::from_secs(2));
    for _ in 0..3 {
        let begin = Instant::now();
        let id = create("d", &on_torus());
        while server.runtime.block_on(server.executor.get("d", id)).unwrap().status.state != State::Succeeded {
            std::thread::sleep(Duration::from_millis(5));
        }
        println!("{}", json!({"attack": "three names", "tiny_job_s": begin.elapsed().as_secs_f64()}));
    }
    for (tenant, id) in jobs {
        server.runtime.block_on(server.executor.cancel(tenant, id)).unwrap();
    }
}
