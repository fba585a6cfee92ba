//! Promise: an option that nobody sets has one value, at whatever door. Tests only.
//!
//! The Python client is compared by `tests/python`.

use clap::{Args, CommandFactory};
use prost::Message as _;
use prost_types::FileDescriptorSet;
use prost_types::field_descriptor_proto::Type;
use serde_json::Value;

use super::Cli;
use super::remesh::RemeshArgs;
use super::rvd::RvdArgs;
use geometry::cvt::CvtOptions;
use geometry::cvt::density::DensityOptions;
use geometry::mesh::shapes::Shape;
use geometry::remesh::{Refine, RemeshOptions, Seeds};
use wire::counts::Bounds;
use wire::options::RemeshArrays;
use wire::proto::{self, CvtHeader, RemeshHeader, SampledSeeds, seed_source};
use wire::{density, names, options};

fn arguments<A: Args>(line: &[&str]) -> A {
    let command = A::augment_args(clap::Command::new("tessera"));
    let matches = command.try_get_matches_from([&["tessera"], line].concat()).unwrap();
    A::from_arg_matches(&matches).unwrap()
}

/// Bounds that are no narrower than the library's.
fn bounds() -> Bounds {
    let max_seeds = DensityOptions::default().max_points as u64;
    Bounds { max_vertices: u64::MAX, max_facets: u64::MAX, max_seeds, max_iterations: u32::MAX }
}

fn arrays(density: Option<&proto::DensityOptions>, seeds: &Seeds) -> RemeshArrays {
    let density = density::of(density, None, None, bounds().max_seeds).unwrap();
    RemeshArrays { density, seeds: seeds.clone(), creases: Vec::new(), attributes: None }
}

/// Whatever there is of options is in what this prints.
fn all(options: &RemeshOptions) -> String {
    format!("{options:#?}")
}

#[test]
fn a_remesh_has_the_same_defaults_at_every_door() {
    let mesh = Shape::Sphere.build(100);
    let seeds = Seeds::Sample { points: 50, seed: SampledSeeds::default().random_seed };
    let library = all(&RemeshOptions::new(seeds.clone()));

    let command: RemeshArgs = arguments(&["in.ply", "-o", "out.ply", "--points", "50"]);
    assert_eq!(all(&command.options(&mesh, None).unwrap()), library);

    for density in [None, Some(proto::DensityOptions::default())] {
        let arrays = arrays(density.as_ref(), &seeds);
        let header = RemeshHeader { density, ..RemeshHeader::default() };
        let service = options::of_remesh(&header, arrays, &bounds()).unwrap();
        assert_eq!(all(&service), library);
    }
}

#[test]
fn points_are_added_up_to_the_same_count() {
    let mesh = Shape::Sphere.build(100);
    let seeds = Seeds::Sample { points: 50, seed: 0 };
    let command: RemeshArgs = arguments(&["in.ply", "-o", "out.ply", "--points", "50", "--max-deviation", "1"]);
    let command = command.options(&mesh, None).unwrap().refine.unwrap();
    assert_eq!(command, Refine::new(command.tolerance, 50));
    let refinement = Some(proto::Refinement { tolerance: command.tolerance, max_points: None });
    let header = RemeshHeader { refinement, ..RemeshHeader::default() };
    let service = options::of_remesh(&header, arrays(None, &seeds), &bounds()).unwrap();
    assert_eq!(service.refine, Some(command));
    // A server that allows fewer gives as many as it has.
    let few = Bounds { max_seeds: 70, max_iterations: 8, ..bounds() };
    let service = options::of_remesh(&header, arrays(None, &seeds), &few).unwrap();
    assert_eq!(service.refine.map(|r| r.max_points), Some(70));
    assert_eq!((service.lloyd, service.newton), (5, 8));
}

#[test]
fn zero_is_not_the_default() {
    let seeds = Seeds::Sample { points: 50, seed: 0 };
    let header = RemeshHeader {
        lloyd_steps: Some(0),
        newton_steps: Some(0),
        crease_angle_deg: Some(0.0),
        density: Some(proto::DensityOptions { adaptivity: Some(0.0), ..proto::DensityOptions::default() }),
        ..RemeshHeader::default()
    };
    let o = options::of_remesh(&header, arrays(header.density.as_ref(), &seeds), &bounds()).unwrap();
    assert_eq!((o.lloyd, o.newton, o.crease_angle_deg, o.density.adaptivity), (0, 0, 0.0, 0.0));
}

/// What a client asks for is what the server does.
#[test]
fn options_come_through_the_protocol() {
    let mesh = Shape::Sphere.build(100);
    for line in [
        "",
        "--lloyd 0 --newton 0 --seed 9 --crease-angle 0 --boundaries free --thin even --placement surface",
        "--lloyd 3 --newton 4 --projection surface --placement centroids --density curvature --gradation 0.5",
        "--density lfs --adaptivity 0 --max-deviation 2 --max-points 60",
    ] {
        let line: Vec<&str> =
            ["in.ply", "-o", "out.ply", "--points", "50"].into_iter().chain(line.split_whitespace()).collect();
        let given = arguments::<RemeshArgs>(&line).options(&mesh, None).unwrap();
        let header = options::remesh_header(&mesh, &given, proto::BackendChoice::Auto);
        let Some(seed_source::Source::Sampled(sampled)) = header.seeds.and_then(|s| s.source) else {
            panic!("{line:?}")
        };
        let seeds = Seeds::Sample { points: sampled.points as usize, seed: sampled.random_seed };
        let arrays = arrays(header.density.as_ref(), &seeds);
        let taken = options::of_remesh(&header, arrays, &bounds()).unwrap();
        assert_eq!(all(&taken), all(&given), "{line:?}");
    }
}

#[test]
fn sessions_and_diagrams_have_the_library_s_defaults() {
    let service = options::of_cvt(&CvtHeader::default()).unwrap();
    assert_eq!(format!("{service:?}"), format!("{:?}", CvtOptions::default()));
    let seeds = arguments::<RvdArgs>(&["in.ply", "--points", "5"]).seeds().unwrap();
    let Seeds::Sample { seed, .. } = seeds else { panic!("{seeds:?}") };
    assert_eq!((seed, seed), (Seeds::RANDOM_SEED, SampledSeeds::default().random_seed));
}

/// A file of the repository, wherever this crate lies in it.
fn text_of(path: &str) -> String {
    let here = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = here.ancestors().find(|folder| folder.join("proto/tessera").is_dir()).unwrap();
    std::fs::read_to_string(root.join(path)).unwrap()
}

/// The fields of a message that have a value of their own, by their paths.
fn fields(all: &FileDescriptorSet, message: &str, path: &str, found: &mut Vec<String>) {
    let messages = all.file.iter().flat_map(|file| &file.message_type);
    let Some(fields_of) = messages.into_iter().find(|found| found.name() == message) else { panic!("{message}") };
    for field in &fields_of.field {
        let path = format!("{path}{}", field.name());
        match field.type_name().strip_prefix(".tessera.v1.") {
            Some(inner) if field.r#type() == Type::Message && inner != "ArrayRef" && inner != "AttributeHeader" => {
                fields(all, inner, &format!("{path}."), found);
            }
            _ => found.push(path),
        }
    }
}

/// An option has its place in every interface: messages, the command, HTTP, the page's document, Python, docs.
#[test]
fn no_interface_lacks_an_option() {
    let descriptors = FileDescriptorSet::decode(proto::DESCRIPTORS).unwrap();
    // What is no option of a remesh: sizes of uploads, and what is carried along.
    let beside = ["mesh.vertices", "mesh.facets", "mesh.position_type", "backend", "attributes"];
    let (mut stream, mut job) = (Vec::new(), Vec::new());
    fields(&descriptors, "RemeshHeader", "", &mut stream);
    fields(&descriptors, "RemeshJob", "", &mut job);
    for path in stream.iter().chain(&job).filter(|path| !beside.contains(&path.as_str())) {
        let has = |row: &names::Name| row.paths.contains(&path.as_str());
        assert!(names::OPTIONS.iter().chain(names::OTHERS).any(has), "wire/names.rs: no name for the field {path}");
    }

    let document: Value = serde_json::from_str(&server::http::OPENAPI).unwrap();
    let query = document["paths"]["/v1/remesh"]["post"]["parameters"].as_array().unwrap();
    let object = &document["components"]["schemas"]["Options"]["properties"];
    let of_http = text_of("src/server/http/options.rs");
    let python = text_of("clients/python/python/tessera_remesh/calls.py");
    let stubs = text_of("clients/python/src/options.rs");
    let flows = text_of("clients/python/python/tessera_remesh/service/flows.py");
    let mut command = Cli::command();
    command.build();
    let remesh = command.find_subcommand("remesh").unwrap();
    let usual = RemeshOptions::usual();
    for row in names::OPTIONS {
        let name = row.name;
        let lies_in = |all: &[String]| row.paths.iter().any(|path| all.iter().any(|field| field == path));
        assert!(lies_in(&stream), "proto: the header of a stream has no field for {name}");
        assert!(lies_in(&job), "proto: a job has no field for {name}");
        let Some(argument) = remesh.get_arguments().find(|argument| argument.get_id() == name) else {
            panic!("the command has no option {name}")
        };
        let parameter = query.iter().find(|parameter| parameter["name"] == name);
        let Some(parameter) = parameter else { panic!("openapi.json: /v1/remesh has no parameter {name}") };
        assert!(object[name].is_object(), "openapi.json: the schema Options has no {name}");
        assert!(of_http.contains(&format!("\"{name}\"")), "server/http/options.rs does not read {name}");
        assert!(python.contains(&format!("\n    {name}: ")), "calls.py: remesh has no keyword {name}");
        assert!(stubs.contains(&format!("\"{name}\"")), "clients/python/src/options.rs does not read {name}");
        assert!(flows.contains(&format!("\"{name}\"")), "flows.py does not send {name}");

        // The default has one value.
        let default = (row.default)(&usual);
        let said = argument.get_default_values().first().map(|value| value.to_str().unwrap());
        let same = match (&default, said) {
            (Value::Null, said) => said.is_none(),
            (Value::String(word), said) => said == Some(word),
            (number, said) => said.and_then(|said| said.parse::<f64>().ok()) == number.as_f64(),
        };
        assert!(same, "{name}: the command's default is {said:?}, the library's {default}");
        for schema in [&parameter["schema"], &object[name]] {
            assert_eq!(schema.get("default").unwrap_or(&Value::Null), &default, "{name}: {schema}");
        }
        // The page shows the default in an empty field.
        let page = text_of("ui/src/index.html");
        if let Some(field) = page.lines().find(|line| line.contains(&format!("name=\"{name}\"")))
            && let Some((_, rest)) = field.split_once("placeholder=\"")
            && default.is_number()
        {
            let shown: f64 = rest.split('"').next().unwrap().parse().unwrap();
            assert_eq!(Some(shown), default.as_f64(), "the page's {name}");
        }
    }
}

/// An option of the command has its place in the protocol, or is of the command alone.
#[test]
fn every_option_of_the_command_is_at_the_service() {
    let at_both: Vec<&str> = names::OPTIONS.iter().map(|row| row.name).chain(["backend", "no_attributes"]).collect();
    const LOCAL: &[&str] = &[
        "input",
        "input_format",
        "output",
        "out_dir",
        "format",
        "overwrite",
        "report",
        "picture",
        "picture_size",
        "view",
        "up",
        "colour",
        "gpu_software",
        "threads",
        "endpoint",
        "tenant",
        "ca",
        "client_cert",
        "client_key",
        "key_file",
        "quiet",
        "json",
        "log_format",
        "help",
    ];
    let mut command = Cli::command();
    command.build();
    let remesh = command.find_subcommand("remesh").unwrap();
    let mut found: Vec<&str> = remesh.get_arguments().map(|a| a.get_id().as_str()).collect();
    let mut known: Vec<&str> = at_both.iter().chain(LOCAL).copied().collect();
    found.sort_unstable();
    known.sort_unstable();
    assert_eq!(found, known);

    // And of a job.
    let at = ["jobs", "submit", "remesh"];
    let submit = at.iter().fold(&command, |command, name| command.find_subcommand(name).unwrap());
    let of_job: Vec<&str> = submit.get_arguments().map(|a| a.get_id().as_str()).collect();
    for option in &at_both {
        assert!(of_job.contains(option), "{option}");
    }
    for option in ["output", "overwrite", "threads", "gpu_software", "picture"] {
        assert!(!of_job.contains(&option), "{option}");
    }
}
