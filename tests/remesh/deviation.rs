//! Promise: a bound on the deviation holds both ways at samples of both surfaces, or the report says why it does not; and
//! where it does not, no more even or curvature density is nearer. How many points it takes goes with the surface and the bound alone.

use geometry::mesh::crossings::crossings;
use glam::DVec3;
use tessera::mesh::TriMesh;
use tessera::mesh::measure::{quality, topology};
use tessera::mesh::shapes::Shape;
use tessera::mesh::shapes::parts::{PartKind, part};
use tessera::remesh::report::{CountReason, RefineEnd};
use tessera::remesh::{Refine, Remesh, RemeshOptions, Seeds, Tolerance, remesh};
use tessera::rvd::Parallel;
use tessera::token::Token;
use tessera::{DensityOptions, DensitySource};

use crate::generated::{arm, book, creature, joint};
use crate::mechanical::sharp;

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
    // Of what is flat, both are rounding.
    assert!(measured <= deviation * (1.0 + 1e-9) + 1e-9, "{measured} beside {deviation}");
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
fn as_many_points_from_any_start() {
    for mesh in [Shape::Torus.build(8000), part(PartKind::Bracket, 0.05, 1)] {
        let counts = [100, 700, 5000].map(|points| bounded(&mesh, points, 0.3, 20_000).mesh.positions().len());
        assert_eq!(counts, [counts[0]; 3]);
        // Its limit decides where it begins, and not where it ends.
        let tight = bounded(&mesh, 100, 0.3, 2 * counts[0]).mesh.positions().len();
        assert!(tight.abs_diff(counts[0]) * 10 <= counts[0], "{tight} beside {}", counts[0]);
    }
}

#[test]
fn points_are_taken_away_where_the_bound_allows() {
    let mesh = Shape::Torus.build(8000);
    let loose = bounded(&mesh, 5000, 1.0, 10_000);
    assert_eq!(loose.report.refine.ended, Some(RefineEnd::Reached));
    assert!(loose.mesh.positions().len() < 500, "{}", loose.mesh.positions().len());
    // Most of the bound is used.
    assert!(loose.report.refine.deviation_percent.unwrap() > 0.6);
}

/// A ball within a ball, the inner one turned inwards.
fn shells(inner: f64) -> TriMesh {
    let ball = |radius: f64, facets: usize| {
        let (positions, facets) = Shape::Sphere.build(facets).into_parts();
        TriMesh::new(positions.into_iter().map(|p| radius * p.normalize()).collect(), facets).unwrap()
    };
    let (outer, inner) = (ball(1.0, 4000), ball(inner, 3000));
    let (mut positions, mut facets) = outer.into_parts();
    let first = positions.len() as u32;
    positions.extend(inner.positions());
    facets.extend(inner.facets().iter().map(|&[a, b, c]| [first + a, first + c, first + b]));
    TriMesh::new(positions, facets).unwrap()
}

#[test]
fn shells_nearer_than_the_bound_do_not_cross() {
    let done = bounded(&shells(0.97), 1000, 1.0, 10_000);
    assert_eq!(done.report.refine.ended, Some(RefineEnd::Reached));
    assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0);
}

#[test]
fn shells_nearer_than_chords_are_off_get_a_few_vertices_more() {
    let done = run(&shells(0.98), &options(290));
    assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0);
    let (vertices, count) = (done.report.result.vertices, done.report.vertex_count);
    assert!(vertices <= 319, "{vertices}");
    assert_eq!(count.reason, Some(CountReason::CloseSheets), "{vertices}");
}

#[test]
fn thin_walls_have_no_more_points_than_are_allowed() {
    // Both of its sheets have the vertices of a curve, which count once.
    let refine = Refine::new(Tolerance::DiagonalPercent(0.05)).with_max_points(600);
    let done = run(&part(PartKind::Cup, 0.02, 7), &options(500).with_refine(refine));
    assert_eq!(done.report.refine.ended, Some(RefineEnd::Budget));
    let vertices = done.report.result.vertices;
    assert!(vertices <= 612, "{vertices}");
}

#[test]
fn flat_parts_come_down_to_their_corners() {
    for kind in [PartKind::Ribs, PartKind::Letters, PartKind::Slots, PartKind::Enclosure, PartKind::Frame] {
        let mesh = part(kind, 0.05, 3);
        let done = bounded(&mesh, 1000, 0.1, 20_000);
        let (least, facets) = (least_facets(&mesh), done.mesh.facets().len());
        println!("{kind}: {facets} facets, {least} at least");
        assert!(facets <= 3 * least, "{kind}: {facets} facets, {least} would do");
        assert_eq!(topology(&done.mesh).euler, topology(&mesh).euler, "{kind}");
        assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{kind}");
    }
}

/// The facets of a closed polyhedron whose vertices are its corners alone: where edges between planes do not go straight on.
fn least_facets(mesh: &TriMesh) -> usize {
    let mut along: Vec<Vec<DVec3>> = vec![Vec::new(); mesh.positions().len()];
    for [p, q] in sharp(mesh, 1.0) {
        for (v, at) in mesh.positions().iter().enumerate() {
            if *at == p {
                along[v].push((q - p).normalize());
            } else if *at == q {
                along[v].push((p - q).normalize());
            }
        }
    }
    let is_corner = |to: &&Vec<DVec3>| to.len() > 2 || to.len() == 2 && to[0].dot(to[1]) > -1.0 + 1e-9;
    let corners = along.iter().filter(is_corner).count() as i64;
    (2 * (corners - topology(mesh).euler)) as usize
}

#[test]
fn a_budget_that_is_used_up_is_said_so() {
    let out = bounded(&creature(0.08), 300, 0.02, 600);
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
