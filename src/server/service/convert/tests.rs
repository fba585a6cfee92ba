//! Every option survives both directions; what a message must not say is named by its path.

use proptest::collection::{btree_map, vec};
use proptest::option::of;
use proptest::prelude::*;
use proptest::sample::select;
use prost::Message as _;

use super::*;
use geometry::mesh::io::Format;
use jobs::record::*;
use jobs::store::Page;

fn array() -> impl Strategy<Value = ArrayRef> {
    use ArrayForm::{F32, F64, Text, U8, U32};
    let form = select(vec![F32, F64, U32, U8, Text]);
    (any::<[u8; 32]>(), form, any::<u64>()).prop_map(|(blob, form, count)| ArrayRef { blob: blob.into(), form, count })
}

fn attribute() -> impl Strategy<Value = AttributeRef> {
    use AttributeKind::{Colours, Normals, Scalar, TextureCoordinates};
    let kind = select(vec![Normals, TextureCoordinates, Colours, Scalar]);
    (kind, "[a-z]{0,5}", array(), of(array())).prop_map(|(kind, name, values, corners)| AttributeRef {
        kind,
        name,
        values,
        corners,
    })
}

fn format() -> impl Strategy<Value = MeshFormat> {
    select(Format::ALL.map(MeshFormat::from).to_vec())
}

fn mesh() -> impl Strategy<Value = MeshSource> {
    let file = (any::<[u8; 32]>(), format(), of(any::<bool>()))
        .prop_map(|(blob, format, attributes)| MeshSource::File { blob: blob.into(), format, attributes });
    let arrays = (array(), array(), vec(attribute(), 0..3))
        .prop_map(|(positions, facets, attributes)| MeshSource::Arrays { positions, facets, attributes });
    prop_oneof![file, arrays]
}

fn seeds() -> impl Strategy<Value = SeedSource> {
    let drawn = (of(any::<u64>()), of(any::<u64>()))
        .prop_map(|(points, random_seed)| SeedSource::Sampled { points, random_seed });
    prop_oneof![drawn, array().prop_map(SeedSource::Given)]
}

fn number() -> impl Strategy<Value = f64> {
    prop::num::f64::NORMAL | prop::num::f64::ZERO | prop::num::f64::SUBNORMAL
}

fn density() -> impl Strategy<Value = DensitySpec> {
    use DensityKind::{Curvature, EdgeLengths, FeatureSize, Uniform, Weights};
    let source = of(select(vec![Uniform, Weights, EdgeLengths, Curvature, FeatureSize]));
    (source, of(number()), of(array()), of(array()), of(number()), of(number())).prop_map(
        |(source, edge_length, edge_lengths, weights, adaptivity, gradation)| DensitySpec {
            source,
            edge_length,
            edge_lengths,
            weights,
            adaptivity,
            gradation,
        },
    )
}

fn projection() -> impl Strategy<Value = Option<ProjectionRule>> {
    of(select(vec![ProjectionRule::Free, ProjectionRule::OnSurface]))
}

fn refinement() -> impl Strategy<Value = RefineSpec> {
    let tolerance = prop_oneof![number().prop_map(Tolerance::Length), number().prop_map(Tolerance::DiagonalPercent)];
    (tolerance, of(any::<u64>())).prop_map(|(tolerance, max_points)| RefineSpec { tolerance, max_points })
}

fn remesh() -> impl Strategy<Value = WorkSpec> {
    use PlacementRule::{Centroids, Fitted, Surface};
    let steps = (of(any::<u32>()), of(any::<u32>()), of(number()), of(array()));
    let rules = (
        projection(),
        of(select(vec![Fitted, Surface, Centroids])),
        of(select(vec![BoundaryRule::Keep, BoundaryRule::Free])),
        of(select(vec![ThinRule::Finer, ThinRule::Even])),
        of(select(vec![MeasureRule::Topology, MeasureRule::Full])),
    );
    (seeds(), density(), steps, rules, of(refinement())).prop_map(|(seeds, density, steps, rules, refinement)| {
        let (lloyd_steps, newton_steps, crease_angle_deg, creases) = steps;
        let (projection, placement, boundaries, thin, measure) = rules;
        WorkSpec::Remesh(Box::new(RemeshWork {
            seeds,
            density,
            lloyd_steps,
            newton_steps,
            projection,
            placement,
            crease_angle_deg,
            creases,
            boundaries,
            thin,
            refinement,
            measure,
        }))
    })
}

fn rvd() -> impl Strategy<Value = WorkSpec> {
    let output = select(vec![RvdOutput::Cells, RvdOutput::Centroids, RvdOutput::Sums]);
    (seeds(), of(array()), vec(output, 0..4))
        .prop_map(|(seeds, weights, outputs)| WorkSpec::Rvd(RvdWork { seeds, weights, outputs }))
}

fn cvt() -> impl Strategy<Value = WorkSpec> {
    let point = || [number(), number(), number()];
    let change = prop_oneof![
        (any::<u32>(), point()).prop_map(|(index, to)| SeedChange::Move { index, to }),
        point().prop_map(SeedChange::Add),
        any::<u32>().prop_map(SeedChange::Remove),
    ];
    let wanted = || of(select(vec![SendSeeds::Never, SendSeeds::Last, SendSeeds::Each]));
    let kind = of(select(vec![StepKindName::Lloyd, StepKindName::Lbfgs]));
    let command = prop_oneof![
        (any::<u32>(), kind, wanted()).prop_map(|(iterations, kind, seeds)| CvtCommand::Step {
            iterations,
            kind,
            seeds
        }),
        (vec(change, 0..3), wanted()).prop_map(|(edits, seeds)| CvtCommand::Edit { edits, seeds }),
    ];
    (seeds(), density(), projection(), of(any::<u64>()), vec(command, 0..4)).prop_map(
        |(seeds, density, projection, max_seeds, commands)| {
            WorkSpec::Cvt(CvtWork { seeds, density, projection, max_seeds, commands })
        },
    )
}

/// Any specification, whether it makes sense or not.
fn any_spec() -> impl Strategy<Value = JobSpec> {
    use BackendName::{Auto, Gpu, Parallel, Serial};
    let result = prop_oneof![format().prop_map(ResultFormat::File), Just(ResultFormat::Arrays)];
    let rest = (
        of(select(vec![Auto, Gpu, Parallel, Serial])),
        of(result),
        of(any::<i32>()),
        (of(any::<u64>()), of(any::<u64>())),
        btree_map("[a-z]{1,4}", "[a-z ]{0,4}", 0..3),
        ("[a-z]{0,4}", "[a-z]{0,4}"),
    );
    (mesh(), prop_oneof![remesh(), rvd(), cvt()], rest).prop_map(|(mesh, work, rest)| {
        let (backend, result, priority, (queue_ms, run_ms), labels, (tenant, request_id)) = rest;
        let deadlines = Deadlines { queue_ms, run_ms };
        JobSpec { mesh, work, backend, result, priority, deadlines, labels, tenant, request_id }
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_option_survives(given in any_spec()) {
        // As bytes, so that what a message cannot hold is lost here.
        let sent = spec::message(&given).encode_to_vec();
        let came = proto::JobSpec::decode(&sent[..]).unwrap();
        prop_assert_eq!(&came, &spec::message(&given));
        let read = spec::of(Some(came), given.tenant.clone(), given.request_id.clone()).unwrap();
        prop_assert_eq!(read, given);
    }

    #[test]
    fn a_wrong_message_is_refused_and_nothing_panics(bytes in vec(any::<u8>(), 0..300)) {
        if let Ok(message) = proto::JobSpec::decode(&bytes[..]) {
            let _ = spec::of(Some(message), String::new(), String::new());
        }
        if let Ok(message) = proto::ListJobsRequest::decode(&bytes[..]) {
            let _ = job::query(message, String::new());
        }
    }

    #[test]
    fn times_come_back(ms in any::<u64>()) {
        let at = At::Top("at");
        prop_assert_eq!(duration_ms(&at, duration(ms)).unwrap(), ms);
        prop_assert_eq!(time(&at, timestamp(Time(ms))).unwrap(), Time(ms));
    }
}

#[test]
fn parts_of_a_millisecond_count_as_a_whole_one() {
    let at = At::Top("at");
    let of = |seconds, nanos| duration_ms(&at, prost_types::Duration { seconds, nanos });
    assert_eq!(of(1, 1).unwrap(), 1001);
    assert_eq!(of(0, 999_999_999).unwrap(), 1000);
    assert_eq!(of(i64::MAX, 0).unwrap(), u64::MAX, "what is refused later, and by its range");
    for (seconds, nanos) in [(-1, 0), (0, -1), (0, 1_000_000_000)] {
        assert!(of(seconds, nanos).is_err());
    }
    let of = |seconds, nanos| time(&at, prost_types::Timestamp { seconds, nanos });
    assert_eq!(of(-5, 0).unwrap(), Time(0));
    assert_eq!(of(5, 1).unwrap(), Time(5001));
    assert!(of(0, -1).is_err());
}

fn small() -> JobSpec {
    let seeds = SeedSource::Sampled { points: Some(5), random_seed: None };
    JobSpec {
        mesh: MeshSource::File { blob: Digest::from([7; 32]), format: MeshFormat::Stl, attributes: None },
        work: WorkSpec::Remesh(Box::new(RemeshWork::new(seeds))),
        backend: None,
        result: None,
        priority: None,
        deadlines: Deadlines::default(),
        labels: Default::default(),
        tenant: "t".to_owned(),
        request_id: "r".to_owned(),
    }
}

#[test]
fn what_is_not_chosen_is_named() {
    use proto::job_spec::Work;
    let refused = |spoil: &dyn Fn(&mut proto::JobSpec)| {
        let mut message = spec::message(&small());
        spoil(&mut message);
        match spec::of(Some(message), String::new(), String::new()) {
            Err(WireError::Field { path, .. }) => path,
            other => panic!("{other:?}"),
        }
    };
    let seeds = || {
        spec::message(&small()).work.map(|work| match work {
            Work::Remesh(work) => work.seeds,
            _ => None,
        })
    };
    let cvt =
        |commands| Some(Work::Cvt(proto::CvtJob { seeds: seeds().unwrap(), commands, ..proto::CvtJob::default() }));
    let edit = |edit| {
        let edit = proto::CvtEdit { edits: vec![proto::SeedEdit { edit }], seeds: 0 };
        proto::CvtJobCommand { command: Some(proto::cvt_job_command::Command::Edit(edit)) }
    };
    let none = || proto::CvtJobCommand { command: None };
    assert_eq!(refused(&|m| m.work = cvt(vec![none()])), "spec.cvt.commands[0]");
    assert_eq!(refused(&|m| m.work = cvt(vec![edit(None)])), "spec.cvt.commands[0].edit.edits[0]");
    let lost = proto::seed_edit::Edit::Move(proto::MoveSeed { index: 0, to: None });
    assert_eq!(refused(&|m| m.work = cvt(vec![edit(Some(lost))])), "spec.cvt.commands[0].edit.edits[0].move.to");
    let rvd = |outputs| Some(Work::Rvd(proto::RvdJob { seeds: seeds().unwrap(), weights: None, outputs }));
    assert_eq!(refused(&|m| m.work = rvd(vec![1, 0])), "spec.rvd.outputs[1]");
    assert_eq!(refused(&|m| m.work = Some(Work::Rvd(proto::RvdJob::default()))), "spec.rvd.seeds");
    let form = |form| Some(proto::ResultFormat { form: Some(form) });
    assert_eq!(refused(&|m| m.result = form(proto::result_format::Form::Arrays(false))), "spec.result.arrays");
    assert_eq!(refused(&|m| m.result = form(proto::result_format::Form::File(99))), "spec.result.file");
    let arrays = |m: &mut proto::JobSpec| {
        let arrays = proto::MeshArrays { attributes: vec![proto::AttributeArrays::default()], ..Default::default() };
        m.mesh = Some(proto::JobMesh { source: Some(proto::job_mesh::Source::Arrays(arrays)) });
    };
    assert_eq!(refused(&arrays), "spec.mesh.arrays.positions");
    assert_eq!(refused(&|m| m.mesh = Some(proto::JobMesh { source: None })), "spec.mesh.source");
    let open = form(proto::result_format::Form::File(0));
    let read = spec::of(Some(proto::JobSpec { result: open, ..spec::message(&small()) }), String::new(), String::new());
    assert_eq!(read.unwrap().result, Some(ResultFormat::File(MeshFormat::Ply)));
}

#[test]
fn fields_are_named_as_messages_call_them() {
    for (field, path) in [
        ("work.remesh.density.gradation", "spec.remesh.density.gradation"),
        ("work.cvt.seeds.sampled.points", "spec.cvt.seeds.drawn.points"),
        ("work.remesh.refinement.tolerance.length", "spec.remesh.refinement.length"),
        ("deadlines.run_ms", "spec.run_deadline"),
        ("labels.seeds.sampled", "spec.labels.seeds.sampled"),
        ("mesh.arrays.attributes[3].name", "spec.mesh.arrays.attributes[3].name"),
        ("tenant", "tessera-tenant"),
        ("request_id", "request_id"),
        ("", "spec"),
    ] {
        assert_eq!(spec::path_of(field), path);
    }
}

#[test]
fn an_end_is_told_with_its_reason() {
    let valid = small().check().unwrap();
    let status = |outcome| Status { outcome, ..Status::new(&valid, Time(1500)) };
    let told =
        |outcome| job::message(&Job { id: JobId::new(Time(1), 1), spec: valid.clone(), status: status(outcome) });
    let open = told(None);
    assert_eq!((open.created.unwrap().nanos, open.started, &open.request_id[..]), (500_000_000, None, "r"));
    for (cause, name) in
        [(Cause::QueueDeadline, "queue_deadline"), (Cause::RunDeadline, "run_deadline"), (Cause::Kept, "kept")]
    {
        assert_eq!(told(Some(Outcome::Expired(cause))).expired_by, name);
    }
    let failure = Failure { kind: FailureKind::Crashed, message: "m".to_owned() };
    let failure = told(Some(Outcome::Failed(failure))).failure.unwrap();
    assert_eq!((failure.kind(), &failure.message[..]), (proto::JobFailureKind::Crashed, "m"));
    let blobs = [("mesh".to_owned(), Digest::from([1; 32]))].into();
    let results = told(Some(Outcome::Succeeded(ResultSet { blobs }))).results;
    assert_eq!((&results[0].name[..], &results[0].digest), ("mesh", &"01".repeat(32)));
}

#[test]
fn a_page_is_no_longer_than_a_message() {
    let edits = vec![SeedChange::Add([0.5; 3]); 2900];
    let command = CvtCommand::Edit { edits, seeds: None };
    let seeds = SeedSource::Sampled { points: Some(5), random_seed: None };
    let (density, projection, max_seeds) = (DensitySpec::default(), None, None);
    let work = WorkSpec::Cvt(CvtWork { seeds, density, projection, max_seeds, commands: vec![command] });
    let valid = JobSpec { work, ..small() }.check().unwrap();
    let status = Status::new(&valid, Time(1));
    let job = |k| Job { id: JobId::new(Time(1), k), spec: valid.clone(), status: status.clone() };
    let page = Page { jobs: (0..100).rev().map(job).collect(), next: None };
    let message = job::page(&page);
    assert!(message.encoded_len() < 4 << 20 && message.jobs.len() > 10 && message.jobs.len() < 100);
    assert_eq!(message.next_page_token, message.jobs.last().unwrap().id);
}

/// What is kept of a job names its formats by these words, for ever.
#[test]
fn formats_are_kept_by_their_extensions() {
    for format in Format::ALL {
        let kept = serde_json::to_value(MeshFormat::from(format)).unwrap();
        assert_eq!((kept, Format::from(MeshFormat::from(format))), (format.extension().into(), format));
    }
}
