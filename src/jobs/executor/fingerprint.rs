//! What decides the bits of a result.
//!
//! Purpose: [`fingerprint`] is a digest of the work, of the program, and of the backend that does it. Invariant: two jobs with the
//! same fingerprint have the same result, but for times in the report. A field that may change bits is in it. Must not know:
//! stores, tenants.

use prost::Message;

use crate::BackendInfo;
use crate::blob::Digest;
use wire::counts::Bounds;
use wire::proto::JobSpec;

/// The program, and the machine that it was built for.
const PROGRAM: [&str; 4] = [
    env!("CARGO_PKG_VERSION"),
    match option_env!("TESSERA_REVISION") {
        Some(revision) => revision,
        None => "",
    },
    std::env::consts::ARCH,
    std::env::consts::OS,
];

/// `by` does the work within `bounds`.
pub(super) fn fingerprint(wanted: &JobSpec, by: &BackendInfo, bounds: &Bounds) -> Digest {
    let JobSpec { mesh, work, backend: _, result, priority: _, queue_deadline: _, run_deadline: _, labels: _, arrays } =
        wanted;
    // Number of threads and the other bounds refuse work, or change its time.
    let BackendInfo { kind, adapter, driver, threads: _ } = by;
    let device = [adapter, driver].map(|text| text.as_deref().unwrap_or_default());
    let mut bytes = Vec::new();
    for text in PROGRAM.into_iter().chain([kind.name()]).chain(device) {
        bytes.extend((text.len() as u64).to_le_bytes());
        bytes.extend(text.as_bytes());
    }
    // As many points as an adaptive remesh may add.
    bytes.extend(bounds.max_seeds.to_le_bytes());
    // Fields are encoded in the order of their numbers, and none of these has a map.
    let (mesh, work, arrays) = (mesh.clone(), work.clone(), arrays.clone());
    bytes.extend(JobSpec { mesh, work, result: *result, arrays, ..JobSpec::default() }.encode_to_vec());
    Digest::of(&bytes)
}

#[cfg(test)]
mod tests {
    use geometry::rvd::BackendKind;
    use serde_json::{Value, json};
    use wire::json::{from_value, to_value};
    use wire::proto::*;

    use super::*;

    fn gpu() -> BackendInfo {
        let text = |text: &str| Some(text.to_owned());
        BackendInfo { kind: BackendKind::Gpu, adapter: text("a"), driver: text("vulkan 1"), threads: 4 }
    }

    fn of(message: &JobSpec) -> Digest {
        fingerprint(message, &gpu(), &Bounds::WIDEST)
    }

    fn array(form: ArrayForm) -> Option<ArrayRef> {
        Some(ArrayRef { digest: "01".repeat(32), form: form.into(), count: 5 })
    }

    /// Specifications that together set every field. Those without `..` stop compiling when one is added.
    fn all() -> Vec<JobSpec> {
        let density = Density {
            source: DensitySource::Lfs.into(),
            edge_length: Some(0.5),
            adaptivity: Some(0.25),
            gradation: Some(0.3),
            size_in: vec!["steel=0.5".to_owned()],
        };
        let remesh = RemeshOptions {
            points: Some(100),
            seed: Some(1),
            density: Some(density.clone()),
            lloyd: Some(3),
            newton: Some(4),
            projection: Projection::Surface.into(),
            placement: Placement::Fitted.into(),
            crease_angle: Some(30.0),
            boundaries: BoundaryRule::Keep.into(),
            thin: ThinRule::Even.into(),
            non_manifold: NonManifoldRule::Keep.into(),
            keep: vec!["steel".to_owned()],
            only: vec!["sphere:0,0,0,1".to_owned()],
            keep_rims: true,
            strict_creases: true,
            mirror: Some("x=0.5".to_owned()),
            periodic: vec!["translate:1,0,0".to_owned()],
            source_map: true,
            max_deviation: Some(0.5),
            max_deviation_length: Some(0.01),
            max_points: Some(1000),
            measure: Measure::Full.into(),
            points_percent: Some(50.0),
            facets: Some(200),
            anisotropy: Some(0.1),
            anisotropy_auto: true,
            weld: Some(0.5),
            weld_percent: Some(0.5),
        };
        let rvd = DiagramOptions { points: Some(9), seed: Some(1), outputs: vec![1, 2], points_percent: Some(50.0) };
        let options = CvtOptions {
            points: Some(9),
            seed: Some(1),
            density: Some(density),
            projection: Projection::Surface.into(),
            max_seeds: Some(20),
            points_percent: Some(50.0),
        };
        let point = Point { x: 0.5, y: 0.25, z: 0.125 };
        let edits = vec![
            SeedEdit { edit: Some(seed_edit::Edit::Move(MoveSeed { index: 1, to: Some(point) })) },
            SeedEdit { edit: Some(seed_edit::Edit::Add(point)) },
            SeedEdit { edit: Some(seed_edit::Edit::Remove(3)) },
        ];
        let step = CvtStep { iterations: 5, seeds: SeedsWanted::Each.into(), kind: StepKind::Lbfgs.into() };
        let commands = [
            cvt_job_command::Command::Step(step),
            cvt_job_command::Command::Edit(CvtEdit { edits, seeds: SeedsWanted::Last.into() }),
        ];
        let commands = commands.map(|command| CvtJobCommand { command: Some(command) }).to_vec();
        let works = [
            job_spec::Work::Remesh(remesh),
            job_spec::Work::Rvd(rvd),
            job_spec::Work::Cvt(CvtJob { options: Some(options), commands }),
        ];
        let attribute = AttributeArrays {
            kind: AttributeKind::Scalar.into(),
            name: "a".to_owned(),
            values: array(ArrayForm::F32),
            corners: array(ArrayForm::U32),
            components: 2,
            regions: vec![Region { number: 7, name: "steel".to_owned() }],
        };
        let file = MeshFile { digest: "02".repeat(32), format: MeshFormat::Obj.into(), attributes: Some(true) };
        let (positions, facets) = (array(ArrayForm::F64), array(ArrayForm::U32));
        let arrays = MeshArrays { positions, facets, attributes: vec![attribute] };
        let meshes = [job_mesh::Source::File(file), job_mesh::Source::Arrays(arrays)];
        let results = [result_format::Form::File(MeshFormat::Stl.into()), result_format::Form::Arrays(true)];
        let duration = |seconds| Some(prost_types::Duration { seconds, nanos: 0 });
        let whole = |((work, mesh), form): ((_, &_), &_)| JobSpec {
            mesh: Some(JobMesh { source: Some(job_mesh::Source::clone(mesh)) }),
            work: Some(work),
            backend: BackendChoice::Gpu.into(),
            result: Some(ResultFormat { form: Some(result_format::Form::clone(form)) }),
            priority: Some(3),
            queue_deadline: duration(4),
            run_deadline: duration(5),
            labels: [("k".to_owned(), "v".to_owned())].into(),
            arrays: Some(JobArrays {
                seeds: array(ArrayForm::F32),
                edge_lengths: array(ArrayForm::F64),
                weights: array(ArrayForm::F64),
                metric: array(ArrayForm::F64),
                creases: array(ArrayForm::Text),
            }),
        };
        works.into_iter().zip(meshes.iter().cycle()).zip(results.iter().cycle()).map(whole).collect()
    }

    /// The paths of all fields and elements.
    fn paths(value: &Value, path: &str, all: &mut Vec<String>) {
        if !path.is_empty() {
            all.push(path.to_owned());
        }
        match value {
            Value::Object(fields) => {
                fields.iter().for_each(|(name, value)| paths(value, &format!("{path}/{name}"), all))
            }
            Value::Array(items) => {
                items.iter().enumerate().for_each(|(i, value)| paths(value, &format!("{path}/{i}"), all));
            }
            _ => {}
        }
    }

    /// The message with another value at a path, for each value that can be there.
    fn others(message: &JobSpec, whole: &Value, path: &str) -> Vec<JobSpec> {
        let old = whole.pointer(path).unwrap();
        let longer = |text: &str| json!(format!("{text}x"));
        let candidates = match old {
            Value::Number(number) => {
                vec![json!(number.as_f64().unwrap_or(0.0) + 1.0), json!(number.as_i64().unwrap_or(0) + 1)]
            }
            // An enum's value may be a number, a duration ends with its unit, and 64 bits are a text.
            Value::String(text) => vec![json!(1), json!(2), json!("77s"), json!("77"), longer(text)],
            Value::Bool(is) => vec![json!(!is)],
            _ => Vec::new(),
        };
        let mut changed: Vec<Value> = candidates
            .into_iter()
            .filter_map(|candidate| {
                let mut other = whole.clone();
                *other.pointer_mut(path)? = candidate;
                Some(other)
            })
            .collect();
        // Without it.
        let (parent, name) = path.rsplit_once('/').unwrap();
        let mut without = whole.clone();
        match without.pointer_mut(parent) {
            Some(Value::Object(fields)) => drop(fields.shift_remove(name)),
            Some(Value::Array(items)) => drop(items.remove(name.parse().unwrap())),
            _ => {}
        }
        changed.push(without);
        changed
            .into_iter()
            .filter_map(|other| from_value::<JobSpec>(other).ok())
            .filter(|other| other != message)
            .collect()
    }

    #[test]
    fn every_field_counts_but_those_that_change_no_bits() {
        const IGNORED: [&str; 5] = ["/backend", "/priority", "/queueDeadline", "/runDeadline", "/labels"];
        for message in all() {
            let whole = to_value(&message);
            let mut fields = Vec::new();
            paths(&whole, "", &mut fields);
            assert!(fields.len() > 20, "{whole}");
            for path in fields {
                let others = others(&message, &whole, &path);
                assert!(!others.is_empty(), "{path}");
                let snake = path.replace("_deadline", "Deadline");
                let is_ignored = IGNORED.iter().any(|ignored| snake.starts_with(ignored));
                for other in others {
                    assert_eq!(of(&other) == of(&message), is_ignored, "{path}: {other:?}");
                }
            }
        }
    }

    #[test]
    fn another_backend_and_another_bound_count() {
        let message = &all()[0];
        let text = |text: &str| Some(text.to_owned());
        for other in [
            BackendInfo { kind: BackendKind::Parallel, ..gpu() },
            BackendInfo { adapter: text("b"), ..gpu() },
            BackendInfo { adapter: None, ..gpu() },
            BackendInfo { driver: text("vulkan 2"), ..gpu() },
            BackendInfo { adapter: text("av"), driver: text("ulkan 1"), ..gpu() },
        ] {
            assert_ne!(fingerprint(message, &other, &Bounds::WIDEST), of(message), "{other:?}");
        }
        let fewer = Bounds { max_seeds: 1000, ..Bounds::WIDEST };
        assert_ne!(fingerprint(message, &gpu(), &fewer), of(message));
        let threads = BackendInfo { threads: 1, ..gpu() };
        assert_eq!(fingerprint(message, &threads, &Bounds::WIDEST), of(message));
    }
}
