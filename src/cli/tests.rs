//! Promise: an option that is not set has one value, at every interface. Tests only.
//!
//! The Python client is compared by `tests/python`.

use clap::{Args, CommandFactory};
use serde_json::Value;

use super::Cli;
use super::remesh::RemeshArgs;
use super::rvd::RvdArgs;
use geometry::cvt::CvtOptions;
use geometry::mesh::shapes::Shape;
use geometry::remesh::{RemeshOptions, Seeds, Share};
use wire::counts::Bounds;
use wire::options::{self, Beside};
use wire::{fields, proto};

fn arguments<A: Args>(line: &[&str]) -> A {
    let command = A::augment_args(clap::Command::new("tessera"));
    let matches = command.try_get_matches_from([&["tessera"], line].concat()).unwrap();
    A::from_arg_matches(&matches).unwrap()
}

/// The options of a line that asks for 50 points.
fn asked(line: &str) -> (proto::RemeshOptions, RemeshOptions) {
    let line: Vec<&str> =
        ["in.ply", "-o", "out.ply", "--points", "50"].into_iter().chain(line.split_whitespace()).collect();
    arguments::<RemeshArgs>(&line).options(&Shape::Sphere.build(100), None, Vec::new()).unwrap()
}

/// Every option is in what this prints.
fn all(options: &RemeshOptions) -> String {
    format!("{options:#?}")
}

#[test]
fn a_remesh_has_the_same_defaults_at_every_interface() {
    let library = all(&RemeshOptions::new(Seeds::Sample { points: 50, seed: Seeds::RANDOM_SEED }));
    let (message, command) = asked("");
    assert_eq!(all(&command), library);
    assert_eq!(message, proto::RemeshOptions { points: Some(50), ..Default::default() });
    for density in [None, Some(proto::Density::default())] {
        let message = proto::RemeshOptions { density, ..message.clone() };
        let service = options::remesh(&message, Beside::default(), &Bounds::of_library()).unwrap();
        assert_eq!(all(&service), library);
    }
}

#[test]
fn points_are_added_up_to_twice_as_many() {
    let (message, command) = asked("--max-deviation 1");
    assert_eq!(command.refine.unwrap().max_points, Some(100));
    // A server that allows fewer gives as many as it has.
    let few = Bounds { max_seeds: 70, max_iterations: 8, ..Bounds::of_library() };
    let service = options::remesh(&message, Beside::default(), &few).unwrap();
    assert_eq!(service.refine.unwrap().max_points, Some(70));
    assert_eq!((service.lloyd, service.newton), (5, 8));
}

#[test]
fn zero_is_not_the_default() {
    let (_, o) = asked("--lloyd 0 --newton 0 --crease-angle 0 --adaptivity 0");
    assert_eq!((o.lloyd, o.newton, o.crease_angle_deg, o.density.adaptivity), (0, 0, 0.0, 0.0));
}

#[test]
fn lists_of_numbers_may_be_in_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("list.txt");
    std::fs::write(&path, "# A part.\n0-3, 7\n\t9 # and another\n8\n").unwrap();
    let (_, o) = asked(&format!("--keep facets:@{0} --keep vertices:@{0}", path.display()));
    assert_eq!(o.keep, ["facets:0-3,7-9", "vertices:0-3,7-9"].map(|text| text.parse().unwrap()));
    let args = ["tessera", "in.ply", "-o", "out.ply", "--points", "50", "--keep", "facets:@missing.txt"];
    let refused = RemeshArgs::augment_args(clap::Command::new("tessera")).try_get_matches_from(args).unwrap_err();
    assert!(refused.to_string().contains("missing.txt"), "{refused}");
}

/// The message of options asks for the same options.
#[test]
fn options_come_through_the_message() {
    for line in [
        "",
        "--lloyd 0 --newton 0 --seed 9 --crease-angle 0 --boundaries free --thin even --placement surface",
        "--lloyd 3 --newton 4 --projection surface --placement centroids --density curvature --gradation 0.5",
        "--density lfs --adaptivity 0 --max-deviation 2 --max-points 60",
        "--anisotropy auto --density error",
        "--anisotropy 0.1 --density error-max",
        "--weld 0.01",
        "--non-manifold keep",
        "--weld 0.01%",
        "--size-in steel=0.5 --size-in sphere:0,0,0,1=0.25 --gradation 0.5",
        "--keep facets:0-7,9 --keep vertices:3",
        "--keep steel --keep box:-1,0,0,1,1,1 --only sphere:0,0,0,1 --keep-rims --source-map",
        "--creases strict",
        "--mirror -x=0.5",
        "--mirror -y",
        "--mirror=1,2,-3,0.25",
        "--periodic translate:1,0,0 --periodic rotate:60,z",
        "--periodic rotate:-60,0,0,1,5,6,7",
    ] {
        let (_, given) = asked(line);
        let message = options::of_remesh(&given);
        let taken = options::remesh(&message, Beside::default(), &Bounds::of_library()).unwrap();
        assert_eq!(all(&taken), all(&given), "{line:?}");
    }
}

#[test]
fn sessions_and_diagrams_have_the_library_s_defaults() {
    let message = proto::CvtOptions { points: Some(5), ..Default::default() };
    let service = options::session(&message, Beside::default(), &Bounds::of_library()).unwrap();
    assert_eq!(format!("{:?}", service.options), format!("{:?}", CvtOptions::default()));
    let message = proto::DiagramOptions { points: Some(5), ..Default::default() };
    let service = options::diagram(&message, Beside::default(), &Bounds::of_library()).unwrap();
    let mesh = Shape::Sphere.build(200);
    let seeds = |points: &str| arguments::<RvdArgs>(&["in.ply", "--points", points]).seeds(&mesh);
    assert_eq!(format!("{:?}", service.seeds), format!("{:?}", seeds("5").unwrap()));
    // As people say numbers.
    let vertices = mesh.positions().len();
    for (text, points) in [("1k", 1000), ("1,000", 1000), ("50%", vertices.div_ceil(2)), ("1e-9%", 1)] {
        assert_eq!(seeds(text).unwrap().drawn(), Some(points), "{text}");
    }
    let told = seeds("1e9%").unwrap_err().to_string();
    assert!(told.starts_with("--points is 1000000000 %; "), "{told}");
}

/// Percent of the vertices, where a session or a diagram is asked for.
#[test]
fn points_are_percent_of_the_vertices() {
    let (points, points_percent) = (Some(5), Some(50.0));
    let bounds = Bounds::of_library();
    let diagram = |message| options::diagram(&message, Beside::default(), &bounds).map(|diagram| diagram.seeds);
    let session = |message| options::session(&message, Beside::default(), &bounds).map(|session| session.seeds);
    let half = Seeds::Share { of: Share::Percent(50.0), seed: 0 };
    let asked = proto::DiagramOptions { points_percent, ..Default::default() };
    assert_eq!(format!("{:?}", diagram(asked).unwrap()), format!("{half:?}"));
    let asked = proto::CvtOptions { points_percent, ..Default::default() };
    assert_eq!(format!("{:?}", session(asked).unwrap()), format!("{half:?}"));
    diagram(proto::DiagramOptions { points, points_percent, ..Default::default() }).unwrap_err();
    session(proto::CvtOptions { points, points_percent, ..Default::default() }).unwrap_err();
    session(proto::CvtOptions { points_percent: Some(0.0), ..Default::default() }).unwrap_err();
}

/// A file of the repository, wherever this crate lies in it.
fn text_of(path: &str) -> String {
    let here = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = here.ancestors().find(|folder| folder.join("proto/tessera").is_dir()).unwrap();
    std::fs::read_to_string(root.join(path)).unwrap()
}

/// Options of the message that the command has not: some are words of others, as `strict` of `--creases`.
const NOT_OF_COMMAND: &[&str] =
    &["anisotropy_auto", "max_deviation_length", "measure", "points_percent", "strict_creases", "weld_percent"];
/// Options of the message that Python has not: `points` takes a share too, and `anisotropy` a word.
const NOT_OF_PYTHON: &[&str] = &["anisotropy_auto", "max_deviation_length", "points_percent", "weld_percent"];

/// An option of the message has its place in every interface: the command, HTTP, the page's document, Python, docs.
#[test]
fn no_interface_lacks_an_option() {
    let document: Value = serde_json::from_str(&server::http::OPENAPI).unwrap();
    let query = document["paths"]["/v1/remesh"]["post"]["parameters"].as_array().unwrap();
    let object = &document["components"]["schemas"]["Options"]["properties"];
    let python = text_of("clients/python/python/tessera_remesh/calls.py");
    let engine = text_of("clients/python/src/options.rs");
    let docs = text_of("docs/remeshing.md");
    let mut command = Cli::command();
    command.build();
    let remesh = command.find_subcommand("remesh").unwrap();
    for field in fields::all() {
        let name = &*field.name;
        let default = field.schema().get("default").cloned().unwrap_or_default();
        let parameter = query.iter().find(|parameter| parameter["name"] == name);
        assert_eq!(parameter.unwrap()["schema"], field.schema(), "OpenAPI: /v1/remesh has another {name}");
        assert_eq!(object[name], field.schema(), "OpenAPI: the schema Options has another {name}");
        if !NOT_OF_PYTHON.contains(&name) {
            assert!(python.contains(&format!("\n    {name}: ")), "calls.py: remesh has no keyword {name}");
            assert!(engine.contains(&format!("\"{name}\"")), "clients/python/src/options.rs does not read {name}");
        }
        if NOT_OF_COMMAND.contains(&name) {
            continue;
        }
        assert!(docs.contains(&format!("--{}", name.replace('_', "-"))), "docs/remeshing.md does not name {name}");
        let Some(argument) = remesh.get_arguments().find(|argument| argument.get_id() == name) else {
            panic!("the command has no option {name}")
        };

        // The default has one value.
        let said = argument.get_default_values().first().map(|value| value.to_str().unwrap());
        let same = match (&default, said) {
            (Value::Null, said) => said.is_none(),
            (Value::String(word), said) => said == Some(word),
            (Value::Bool(is_set), said) => said == Some(&*is_set.to_string()),
            (number, said) => said.and_then(|said| said.parse::<f64>().ok()) == number.as_f64(),
        };
        assert!(same, "{name}: the command's default is {said:?}, the library's {default}");
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
    let fields = fields::all();
    let options = fields.iter().map(|field| &*field.name).filter(|name| !NOT_OF_COMMAND.contains(name));
    let at_both: Vec<&str> = options.chain(["sizes", "metric", "creases", "backend", "no_attributes"]).collect();
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
        "gpu_adapters",
        "gpu_memory_mib",
        "gpu_software",
        "threads",
        "endpoint",
        "tenant",
        "ca",
        "client_cert",
        "client_key",
        "key_file",
        "quiet",
        "regions",
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
    for option in ["output", "overwrite", "threads", "gpu_software", "gpu_adapters", "picture"] {
        assert!(!of_job.contains(&option), "{option}");
    }
}

#[test]
fn the_command_line_is_consistent() {
    super::config::command().debug_assert();
}
