//! Promise: a specification is checked field by field, survives being written and read with the same bits, and what it leaves
//! open has the library's defaults. Records of all layouts can be read.

use jobs::blob::Digest;
use jobs::record::{self, JobId, Operation, Spec, Time};
use proptest::option::of;
use proptest::prelude::*;
use proptest::sample::select;
use tessera::proto::{self, *};
use tessera::{RemeshOptions as Options, Seeds};
use wire::WireError;

use super::{message, spec};

fn array(form: ArrayForm, count: u64) -> Option<proto::ArrayRef> {
    Some(proto::ArrayRef { digest: "01".repeat(32), form: form.into(), count })
}

fn remesh(spec: &mut JobSpec) -> &mut RemeshOptions {
    match &mut spec.work {
        Some(job_spec::Work::Remesh(options)) => options,
        other => panic!("{other:?}"),
    }
}

fn checked(message: JobSpec) -> Result<Spec, WireError> {
    Spec::new(message, "t".to_owned(), "r".to_owned())
}

/// The field of the error that a changed specification gets.
fn refused(change: impl FnOnce(&mut JobSpec)) -> String {
    let mut wrong = message(1);
    change(&mut wrong);
    match checked(wrong) {
        Err(WireError::Field { path, .. }) => path,
        other => panic!("{other:?}"),
    }
}

fn cvt(command: cvt_job_command::Command) -> Option<job_spec::Work> {
    let commands = vec![CvtJobCommand { command: Some(command) }];
    Some(job_spec::Work::Cvt(CvtJob { options: Some(CvtOptions { points: Some(5), ..Default::default() }), commands }))
}

fn edit(edits: Vec<seed_edit::Edit>) -> cvt_job_command::Command {
    let edits = edits.into_iter().map(|edit| SeedEdit { edit: Some(edit) }).collect();
    cvt_job_command::Command::Edit(CvtEdit { edits, seeds: 0 })
}

#[test]
fn what_is_wrong_is_named() {
    let path =
        |tenant: &str, request: &str| Spec::new(message(1), tenant.into(), request.into()).unwrap_err().to_string();
    assert!(path("a b", "").starts_with("tessera-tenant is \"a b\""));
    assert!(path("t", &"x".repeat(129)).starts_with("request_id is"));
    assert_eq!(refused(|s| s.priority = Some(101)), "spec.priority");
    assert_eq!(refused(|s| s.run_deadline = super::millis(0)), "spec.run_deadline");
    assert_eq!(refused(|s| s.queue_deadline = super::millis(-1)), "spec.queue_deadline");
    assert_eq!(refused(|s| drop(s.labels.insert("a b".to_owned(), String::new()))), "spec.labels");
    assert_eq!(refused(|s| drop(s.labels.insert("a".to_owned(), "\n".to_owned()))), "spec.labels.a");
    assert_eq!(refused(|s| s.backend = 77), "spec.backend");
    assert_eq!(refused(|s| s.work = None), "spec.work");
    assert_eq!(refused(|s| s.mesh = None), "spec.mesh.source");
    let form = |form| Some(proto::ResultFormat { form: Some(form) });
    assert_eq!(refused(|s| s.result = form(result_format::Form::Arrays(false))), "spec.result.arrays");
    assert_eq!(refused(|s| s.result = form(result_format::Form::File(99))), "spec.result.file");
    let open = JobSpec { result: form(result_format::Form::File(0)), ..message(1) };
    assert_eq!(checked(open).unwrap().task().result, record::ResultFormat::File(tessera::mesh::io::Format::Ply));

    let at = |field: &str| format!("spec.remesh.{field}");
    assert_eq!(refused(|s| remesh(s).crease_angle = Some(f64::NAN)), at("crease_angle"));
    assert_eq!(refused(|s| remesh(s).placement = 9), at("placement"));
    assert_eq!(refused(|s| remesh(s).points = None), at("points"));
    assert_eq!(refused(|s| remesh(s).points = Some(0)), at("points"));
    let density = |density| move |s: &mut JobSpec| remesh(s).density = Some(density);
    assert_eq!(refused(density(Density { gradation: Some(0.0), ..Default::default() })), at("density.gradation"));
    assert_eq!(refused(density(Density { adaptivity: Some(1.5), ..Default::default() })), at("density.adaptivity"));
    assert_eq!(refused(density(Density { edge_length: Some(1.0), ..Default::default() })), at("density.edge_length"));
    let weights = Density { source: DensitySource::Weights.into(), ..Default::default() };
    assert_eq!(refused(density(weights)), at("density.source"));
    assert_eq!(refused(|s| remesh(s).max_deviation = Some(f64::INFINITY)), at("max_deviation"));
    assert_eq!(refused(|s| remesh(s).max_points = Some(500)), at("max_points"));
    let refine = |most, placement: Placement| {
        move |s: &mut JobSpec| {
            let options = remesh(s);
            (options.max_deviation_length, options.max_points) = (Some(1.0), most);
            options.placement = placement.into();
        }
    };
    assert_eq!(refused(refine(Some(5), Placement::Fitted)), at("max_points"));
    assert_eq!(refused(refine(None, Placement::Surface)), at("max_deviation_length"));

    let beside = |arrays| move |s: &mut JobSpec| s.arrays = Some(arrays);
    let seeds = JobArrays { seeds: array(ArrayForm::F64, 9), ..Default::default() };
    assert_eq!(refused(beside(seeds)), at("points"));
    let creases = JobArrays { creases: array(ArrayForm::F64, 9), ..Default::default() };
    assert_eq!(refused(beside(creases)), "spec.arrays.creases.form");
    let lengths = JobArrays { edge_lengths: array(ArrayForm::Text, 9), ..Default::default() };
    assert_eq!(refused(beside(lengths)), "spec.arrays.edge_lengths.count");
    let metric = |form| JobArrays { metric: array(form, 9), ..Default::default() };
    assert_eq!(refused(beside(metric(ArrayForm::F32))), "spec.arrays.metric.form");
    assert_eq!(refused(beside(metric(ArrayForm::Text))), "spec.arrays.metric.count");
    let with_metric = |change: fn(&mut RemeshOptions)| {
        move |s: &mut JobSpec| {
            s.arrays = Some(JobArrays { metric: array(ArrayForm::Text, 0), ..Default::default() });
            change(remesh(s));
        }
    };
    assert_eq!(refused(with_metric(|o| o.anisotropy_auto = true)), at("anisotropy_auto"));
    assert_eq!(refused(with_metric(|o| o.anisotropy = Some(0.5))), at("anisotropy"));
    assert_eq!(refused(with_metric(|o| o.max_deviation = Some(0.5))), at("max_deviation"));
    let graded = |o: &mut RemeshOptions| o.density = Some(Density { gradation: Some(0.3), ..Default::default() });
    assert_eq!(refused(with_metric(graded)), at("density.gradation"));
    let curvature = |o: &mut RemeshOptions| {
        o.density = Some(Density { source: DensitySource::Curvature.into(), ..Default::default() });
    };
    assert_eq!(refused(with_metric(curvature)), at("density.source"));
    let diagram = |s: &mut JobSpec| {
        s.work = Some(job_spec::Work::Rvd(DiagramOptions { points: Some(4), ..Default::default() }));
        s.arrays = Some(JobArrays { creases: array(ArrayForm::U32, 3), ..Default::default() });
    };
    assert_eq!(refused(diagram), "spec.arrays.creases");
    let outputs = DiagramOptions { points: Some(4), outputs: vec![1, 0], ..Default::default() };
    assert_eq!(refused(|s| s.work = Some(job_spec::Work::Rvd(outputs))), "spec.rvd.outputs[1]");
    let arrays = |s: &mut JobSpec| {
        let kind = AttributeKind::TextureCoordinates.into();
        let attribute = AttributeArrays { kind, values: array(ArrayForm::F64, 9), ..Default::default() };
        let (positions, facets) = (array(ArrayForm::F32, 10), array(ArrayForm::U32, 8));
        let arrays = MeshArrays { positions, facets, attributes: vec![attribute] };
        s.mesh = Some(JobMesh { source: Some(job_mesh::Source::Arrays(arrays)) });
    };
    assert_eq!(refused(arrays), "spec.mesh.arrays.attributes[0].corners");

    let step = cvt_job_command::Command::Step(CvtStep::default());
    assert_eq!(refused(|s| s.work = cvt(step)), "spec.cvt.commands[0].step.iterations");
    let add = |y| seed_edit::Edit::Add(Point { x: 0.1, y, z: 0.1 });
    assert_eq!(refused(|s| s.work = cvt(edit(vec![add(f64::NAN)]))), "spec.cvt.commands[0].edit.edits[0]");
    let lost = seed_edit::Edit::Move(MoveSeed { index: 0, to: None });
    assert_eq!(refused(|s| s.work = cvt(edit(vec![lost]))), "spec.cvt.commands[0].edit.edits[0].move.to");
    assert_eq!(refused(|s| s.work = cvt(edit(vec![add(0.1); 9_000]))), "spec");
}

fn number() -> impl Strategy<Value = f64> {
    (any::<u64>(), 1e-300f64..1e300).prop_map(|(bits, number)| {
        let any = f64::from_bits(bits).abs();
        if any.is_finite() && any > 0.0 { any } else { number }
    })
}

/// Options that make sense, any of which may be open.
fn options() -> impl Strategy<Value = RemeshOptions> {
    let numbers = (of(any::<u64>()), of(0u32..900), of(0u32..900), of(0.0..=180.0f64), of(0.0..=1.0f64), of(number()));
    let rules = (0..3i32, 0..3i32, 0..3i32, 0..3i32, select(vec![0, 1, 4, 5, 6, 7]), 0..3usize);
    (1..1000u32, numbers, rules, of((number(), any::<bool>(), of(1000..2000u32)))).prop_map(
        |(points, (seed, lloyd, newton, crease_angle, adaptivity, gradation), rules, refine)| {
            let (projection, boundaries, thin, measure, source, lift) = rules;
            let (mut max_deviation, mut max_deviation_length) = (None, None);
            let (anisotropy, anisotropy_auto) = [(None, false), (Some(0.25), false), (None, true)][lift];
            let max_points = refine.and_then(|(tolerance, percent, most)| {
                *(if percent { &mut max_deviation } else { &mut max_deviation_length }) = Some(tolerance);
                most
            });
            RemeshOptions {
                points: Some(points),
                seed,
                density: Some(Density { source, edge_length: None, adaptivity, gradation, size_in: Vec::new() }),
                lloyd,
                newton,
                projection,
                placement: 0,
                crease_angle,
                boundaries,
                thin,
                max_deviation,
                max_deviation_length,
                max_points,
                measure,
                points_percent: None,
                facets: None,
                anisotropy,
                anisotropy_auto,
                weld: None,
                non_manifold: 0,
                keep: Vec::new(),
                only: Vec::new(),
                keep_rims: false,
                strict_creases: false,
                mirror: None,
                periodic: Vec::new(),
                source_map: false,
                weld_percent: None,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn numbers_come_back_with_the_same_bits(options in options(), priority in of(-100..=100i32)) {
        let arrays = Some(JobArrays { creases: array(ArrayForm::U32, 4), ..Default::default() });
        let work = Some(job_spec::Work::Remesh(options));
        let valid = checked(JobSpec { work, arrays, priority, ..message(1) }).unwrap();
        let read: Spec = serde_json::from_slice(&serde_json::to_vec(&valid).unwrap()).unwrap();
        prop_assert_eq!(read, valid);
    }
}

#[test]
fn an_unknown_option_and_a_wrong_one_are_not_read() {
    let text = serde_json::to_string(&spec("r", 1)).unwrap();
    assert!(serde_json::from_str::<Spec>(&text).is_ok());
    for (from, to) in [
        ("{\"tenant\"", "{\"later\":1,\"tenant\""),
        ("\"points\":101", "\"points\":101,\"later\":1"),
        ("\"points\":101", "\"points\":0"),
    ] {
        let wrong = text.replacen(from, to, 1);
        assert_ne!(wrong, text);
        assert!(serde_json::from_str::<Spec>(&wrong).is_err(), "{wrong}");
    }
}

/// A change of the layout that makes this fail needs a new version of records, and must read the old one.
#[test]
fn a_record_is_written_as_ever() {
    let text = format!(
        "{{\"tenant\":\"t\",\"request_id\":\"r\",\"spec\":{{\
         \"mesh\":{{\"file\":{{\"digest\":\"{}\",\"format\":\"MESH_FORMAT_PLY\"}}}},\
         \"remesh\":{{\"points\":101}},\"labels\":{{\"body\":\"1\"}}}}}}",
        "07".repeat(32)
    );
    assert_eq!(serde_json::from_str::<Spec>(&text).unwrap(), spec("r", 1));
    assert_eq!(serde_json::to_string(&spec("r", 1)).unwrap(), text);
}

/// Records of layouts 1 and 2, one of each kind with all that they can have, ask for what the message beside them asks.
#[test]
fn records_of_older_layouts_are_read() {
    let all: serde_json::Value = serde_json::from_str(include_str!("records.json")).unwrap();
    for one in all.as_array().unwrap() {
        let read: Spec = serde_json::from_value(one["record"].clone()).unwrap();
        let asked: JobSpec = wire::json::from_value(one["message"].clone()).unwrap();
        assert_eq!(*read.message(), asked);
        assert_eq!((&*read.tenant, &*read.request_id), ("t", "r"));
    }
    assert_eq!(all.as_array().unwrap().len(), 5);
}

/// Layouts 1 and 2 measured the JSON, which is shorter than the message where numbers are short; and had no bound on values
/// that are given by corner.
#[test]
fn what_was_kept_is_read_whatever_its_length() {
    let edits = vec![serde_json::json!({ "add": [0.5, 1.0, 2.0] }); 2500];
    let array = |form, count| serde_json::json!({ "blob": "01".repeat(32), "form": form, "count": count });
    let file = serde_json::json!({ "file": { "blob": "01".repeat(32), "format": "off" } });
    let commands = serde_json::json!([{ "edit": { "edits": edits } }]);
    let seeds = serde_json::json!({ "sampled": { "points": 5 } });
    let attribute = serde_json::json!({ "kind": "normals", "values": array("f32", 1000), "corners": array("u32", 8) });
    let arrays = serde_json::json!({ "arrays": {
        "positions": array("f64", 6), "facets": array("u32", 8), "attributes": [attribute],
    } });
    for (mesh, work) in [
        (file, serde_json::json!({ "cvt": { "seeds": seeds, "commands": commands } })),
        (arrays, serde_json::json!({ "remesh": { "seeds": seeds } })),
    ] {
        let record = serde_json::json!({ "mesh": mesh, "work": work, "tenant": "t" });
        serde_json::from_value::<Spec>(record).unwrap();
    }
}

#[test]
fn what_is_open_has_the_library_s_defaults() {
    let mut open = message(1);
    let of = |message: &JobSpec| match &checked(message.clone()).unwrap().task().operation {
        Operation::Remesh(options) => (**options).clone(),
        other => panic!("{other:?}"),
    };
    let mut usual = Options::new(Seeds::Sample { points: 101, seed: Seeds::RANDOM_SEED });
    usual.density.max_points = wire::counts::Bounds::WIDEST.max_seeds as usize;
    assert_eq!(format!("{:?}", of(&open)), format!("{usual:?}"));
    remesh(&mut open).newton = Some(0);
    remesh(&mut open).boundaries = BoundaryRule::Free.into();
    let options = of(&open);
    assert_eq!((options.newton, options.keep_boundaries, options.lloyd), (0, false, 5));
}

#[test]
fn names_are_texts_and_sort_by_time() {
    let (early, late) = (JobId::new(Time(5), u128::MAX), JobId::new(Time(6), 0));
    assert!(early < late);
    assert_eq!(early.to_string().parse::<JobId>().unwrap(), early);
    assert!("xyz".parse::<JobId>().is_err());
    let digest = Digest::from([0xab; 32]);
    assert_eq!(digest.to_string().parse::<Digest>().unwrap(), digest);
    assert!("AB".repeat(32).parse::<Digest>().is_err());
}
