//! Promise: a bound on the deviation holds both ways at samples of both surfaces, or the report says why it does not; and
//! where it does not, no more even or curvature density is nearer.

use tessera::mesh::TriMesh;
use tessera::mesh::measure::quality;
use tessera::remesh::report::RefineEnd;
use tessera::remesh::{Refine, Remesh, RemeshOptions, Seeds, Tolerance, remesh};
use tessera::rvd::Parallel;
use tessera::token::Token;
use tessera::{DensityOptions, DensitySource};

use crate::generated::{arm, book, creature, joint};

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap()
}

fn options(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 3 }).with_newton(10).with_measure(false)
}

fn bounded(mesh: &TriMesh, points: usize, percent: f64, most: usize) -> Remesh {
    let (low, high) = mesh.bounds();
    let refine = Refine::new(Tolerance::Length(0.01 * percent * (high - low).length())).with_max_points(most);
    let out = run(mesh, &options(points).with_refine(refine));
    let figures = out.report.refine;
    println!("{points} points, {percent} %, {most} at most: {} seeds, {figures:?}", out.seeds.len());
    let deviation = figures.deviation_percent.unwrap();
    // What is looked at includes what the report's Hausdorff distance is made of.
    let measured = quality(mesh, &out.mesh).hausdorff_percent;
    assert!(measured <= deviation * (1.0 + 1e-9), "{measured} beside {deviation}");
    assert!(out.seeds.len() <= most);
    assert_eq!(figures.ended == Some(RefineEnd::Reached), deviation <= percent);
    assert_eq!(figures.ended == Some(RefineEnd::Reached), figures.out_of_tolerance == 0);
    if figures.ended == Some(RefineEnd::Budget) {
        assert!(out.seeds.len() as f64 > 0.9 * most as f64, "points are left");
    }
    if figures.ended != Some(RefineEnd::Reached) {
        for source in [DensitySource::Uniform, DensitySource::Curvature] {
            let density = DensityOptions::from_source(source.clone());
            let seeds = Seeds::Sample { points: out.seeds.len(), seed: 3 };
            let other = run(mesh, &options(1).with_seeds(seeds).with_density(density));
            let other = quality(mesh, &other.mesh).hausdorff_percent;
            // Edges are no part of the report's distance.
            assert!(measured <= 1.05 * other, "{measured} beside {other} of {source:?}");
        }
    }
    out
}

#[test]
fn an_arm_reaches_its_bound_while_points_are_left() {
    let mesh = arm(0.04);
    let out = bounded(&mesh, 400, 0.2, 50_000);
    assert_eq!(out.report.refine.ended, Some(RefineEnd::Reached));
}

#[test]
fn a_joint_of_long_facets_is_measured_between_its_vertices() {
    let mesh = joint(48);
    let out = bounded(&mesh, 400, 0.1, 20_000);
    assert_eq!(out.report.refine.ended, Some(RefineEnd::Reached));
}

#[test]
fn a_budget_that_is_used_up_is_said_so() {
    let out = bounded(&creature(0.05), 300, 0.02, 600);
    assert_eq!(out.report.refine.ended, Some(RefineEnd::Budget));
}

#[test]
fn what_ends_it_beside_sheets_that_meet_is_said() {
    bounded(&book(5, 8), 200, 0.05, 1000);
}

#[test]
fn given_seeds_are_measured_in_the_same_way() {
    let mesh = joint(48);
    let seeds = run(&mesh, &options(300)).seeds;
    let (low, high) = mesh.bounds();
    let refine = Refine::new(Tolerance::Length(0.002 * (high - low).length())).with_max_points(1500);
    let out = run(&mesh, &options(1).with_seeds(Seeds::Given(seeds)).with_refine(refine));
    let figures = out.report.refine;
    println!("{figures:?}");
    assert!(figures.ended.is_some());
    assert_eq!(figures.ended == Some(RefineEnd::Reached), figures.deviation_percent.unwrap() <= 0.2);
}
