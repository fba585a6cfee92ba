//! Promise: a specification is checked field by field, survives being written and read with the same bits, and what it leaves
//! open has the library's defaults. A record of the first layout can still be read.

use jobs::blob::Digest;
use jobs::record::*;
use tessera::DensitySource;
use tessera::{RemeshOptions, Seeds};

use super::spec;

fn array(form: ArrayForm, count: u64) -> ArrayRef {
    ArrayRef { blob: Digest::from([1; 32]), form, count }
}

fn remesh(spec: &mut JobSpec) -> &mut RemeshWork {
    match &mut spec.work {
        WorkSpec::Remesh(work) => work,
        other => panic!("{other:?}"),
    }
}

/// The field of the error that a changed specification gets.
fn refused(change: impl FnOnce(&mut JobSpec)) -> String {
    let mut wrong = spec("r", 1);
    change(&mut wrong);
    wrong.check().unwrap_err().field().to_owned()
}

#[test]
fn what_is_wrong_is_named() {
    assert_eq!(refused(|s| s.tenant = "a b".to_owned()), "tenant");
    assert_eq!(refused(|s| s.request_id = "x".repeat(129)), "request_id");
    assert_eq!(refused(|s| s.priority = Some(101)), "priority");
    assert_eq!(refused(|s| s.deadlines.run_ms = Some(0)), "deadlines.run_ms");
    assert_eq!(refused(|s| drop(s.labels.insert("a b".to_owned(), String::new()))), "labels");
    assert_eq!(refused(|s| drop(s.labels.insert("a".to_owned(), "\n".to_owned()))), "labels.a");
    let at = "work.remesh.";
    assert_eq!(refused(|s| remesh(s).crease_angle_deg = Some(f64::NAN)), format!("{at}crease_angle_deg"));
    assert_eq!(refused(|s| remesh(s).density.gradation = Some(0.0)), format!("{at}density.gradation"));
    assert_eq!(refused(|s| remesh(s).density.edge_length = Some(1.0)), format!("{at}density.edge_length"));
    assert_eq!(refused(|s| remesh(s).density.source = Some(DensityKind::Weights)), format!("{at}density.weights"));
    let none = SeedSource::Sampled { points: None, random_seed: None };
    assert_eq!(refused(|s| remesh(s).seeds = none), format!("{at}seeds.sampled.points"));
    let refinement = |length, max_points| Some(RefineSpec { tolerance: Tolerance::Length(length), max_points });
    let field = format!("{at}refinement.tolerance.length");
    assert_eq!(refused(|s| remesh(s).refinement = refinement(f64::INFINITY, None)), field);
    assert_eq!(refused(|s| remesh(s).refinement = refinement(1.0, Some(5))), format!("{at}refinement.max_points"));
    let unfitted = |s: &mut JobSpec| {
        remesh(s).refinement = refinement(1.0, None);
        remesh(s).placement = Some(PlacementRule::Surface);
    };
    assert_eq!(refused(unfitted), format!("{at}refinement"));
    let arrays = |s: &mut JobSpec| {
        let uv = AttributeKind::TextureCoordinates;
        let attribute = AttributeRef { kind: uv, name: String::new(), values: array(ArrayForm::F64, 9), corners: None };
        let (positions, facets) = (array(ArrayForm::F32, 10), array(ArrayForm::U32, 8));
        s.mesh = MeshSource::Arrays { positions, facets, attributes: vec![attribute] };
    };
    assert_eq!(refused(arrays), "mesh.arrays.attributes[0].corners");
    let seeds = spec("", 1).work;
    let WorkSpec::Remesh(seeds) = seeds else { panic!() };
    let cvt = |command| {
        let (density, seeds) = (DensitySpec::default(), seeds.seeds);
        WorkSpec::Cvt(CvtWork { seeds, density, projection: None, max_seeds: None, commands: vec![command] })
    };
    let step = CvtCommand::Step { iterations: 0, kind: None, seeds: None };
    assert_eq!(refused(|s| s.work = cvt(step)), "work.cvt.commands[0].step.iterations");
    let edit = CvtCommand::Edit { edits: vec![SeedChange::Add([0.0, f64::NAN, 0.0])], seeds: None };
    assert_eq!(refused(|s| s.work = cvt(edit)), "work.cvt.commands[0].edit.edits[0]");
    let long = CvtCommand::Edit { edits: vec![SeedChange::Add([0.1; 3]); 9_000], seeds: None };
    assert_eq!(refused(|s| s.work = cvt(long)), "");
}

#[test]
fn numbers_come_back_with_the_same_bits() {
    let mut whole = spec("r", 1);
    let work = remesh(&mut whole);
    let lengths = [0.1 + 0.2, 1e-300, std::f64::consts::PI * 1e200, 5e-324, f64::MAX];
    for length in lengths {
        work.refinement = Some(RefineSpec { tolerance: Tolerance::Length(length), max_points: None });
        work.creases = Some(array(ArrayForm::U32, 4));
        work.lloyd_steps = Some(0);
        let valid = JobSpec { work: WorkSpec::Remesh(Box::new(work.clone())), ..spec("r", 1) }.check().unwrap();
        let read: ValidSpec = serde_json::from_slice(&serde_json::to_vec(&valid).unwrap()).unwrap();
        assert_eq!(read, valid);
    }
}

#[test]
fn an_unknown_option_and_a_wrong_one_are_not_read() {
    let text = serde_json::to_string(&spec("r", 1).check().unwrap()).unwrap();
    assert!(serde_json::from_str::<ValidSpec>(&text).is_ok());
    let unknown = text.replacen("{\"mesh\"", "{\"later\":1,\"mesh\"", 1);
    assert!(serde_json::from_str::<ValidSpec>(&unknown).is_err());
    let wrong = text.replacen("\"points\":101", "\"points\":0", 1);
    assert!(serde_json::from_str::<ValidSpec>(&wrong).is_err(), "{wrong}");
}

/// Who changes the layout so that this fails needs a new version of records, and must read the old one.
#[test]
fn a_record_of_the_first_layout_is_read() {
    let text = format!(
        "{{\"mesh\":{{\"file\":{{\"blob\":\"{}\",\"format\":\"ply\"}}}},\
         \"work\":{{\"remesh\":{{\"seeds\":{{\"sampled\":{{\"points\":101}}}}}}}},\
         \"labels\":{{\"body\":\"1\"}},\"tenant\":\"t\",\"request_id\":\"r\"}}",
        "07".repeat(32)
    );
    assert_eq!(serde_json::from_str::<ValidSpec>(&text).unwrap(), spec("r", 1).check().unwrap());
    assert_eq!(serde_json::to_string(&spec("r", 1)).unwrap(), text);
}

#[test]
fn what_is_open_has_the_library_s_defaults() {
    let mut open = spec("r", 1);
    let seeds = || Seeds::Sample { points: 101, seed: Seeds::RANDOM_SEED };
    let options = remesh(&mut open).options(seeds(), DensitySource::Uniform);
    assert_eq!(format!("{options:?}"), format!("{:?}", RemeshOptions::new(seeds())));
    remesh(&mut open).newton_steps = Some(0);
    remesh(&mut open).boundaries = Some(BoundaryRule::Free);
    let options = remesh(&mut open).options(seeds(), DensitySource::Uniform);
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
