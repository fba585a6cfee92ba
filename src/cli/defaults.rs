//! Promise: an option that nobody sets has one value, at whatever door. Tests only.
//!
//! The Python client is compared by `tests/python`.

use clap::{Args, CommandFactory};

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
use wire::{density, options};

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

/// An option of the command has its place in the protocol, or is of the command alone. Who adds one says which.
#[test]
fn every_option_of_the_command_is_at_the_service() {
    const AT_BOTH: &[&str] = &[
        "points",
        "edge_length",
        "sizes",
        "density",
        "gradation",
        "adaptivity",
        "max_deviation",
        "max_points",
        "crease_angle",
        "creases",
        "boundaries",
        "thin",
        "placement",
        "lloyd",
        "newton",
        "projection",
        "seed",
        "backend",
        "no_attributes",
    ];
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
    let mut known: Vec<&str> = AT_BOTH.iter().chain(LOCAL).copied().collect();
    found.sort_unstable();
    known.sort_unstable();
    assert_eq!(found, known);

    // And of a job.
    let at = ["jobs", "submit", "remesh"];
    let submit = at.iter().fold(&command, |command, name| command.find_subcommand(name).unwrap());
    let of_job: Vec<&str> = submit.get_arguments().map(|a| a.get_id().as_str()).collect();
    for option in AT_BOTH {
        assert!(of_job.contains(option), "{option}");
    }
    for option in ["output", "overwrite", "threads", "gpu_software", "picture"] {
        assert!(!of_job.contains(&option), "{option}");
    }
}
