//! Promise: mechanical parts keep their creases, however few the points and however narrow what lies between two creases.

use std::collections::HashMap;

use glam::DVec3;
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::distance_to_segment;
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::mesh::shapes::parts::{PartKind, part};
use tessera::remesh::report::CountReason;
use tessera::remesh::{Anisotropy, Observer, Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::token::Token;

use crate::long::some;

fn run(mesh: &TriMesh, points: usize, threads: usize) -> Remesh {
    let options = RemeshOptions::new(Seeds::Sample { points, seed: 0 });
    remesh(mesh, &options, &Parallel::new(Some(threads)).unwrap(), &mut (), &Token::default()).unwrap()
}

/// The edges at which facets make an angle of more than this, degrees.
pub(crate) fn sharp(mesh: &TriMesh, degrees: f64) -> Vec<[DVec3; 2]> {
    let normal = |f: usize| {
        let [a, b, c] = mesh.corners(f);
        (b - a).cross(c - a).normalize_or_zero()
    };
    let mut first: HashMap<[u32; 2], usize> = HashMap::new();
    let mut found = Vec::new();
    for (f, t) in mesh.facets().iter().enumerate() {
        for [a, b] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
            match first.remove(&[b, a]) {
                Some(other) if normal(f).dot(normal(other)) < degrees.to_radians().cos() => {
                    found.push([a, b].map(|v| mesh.positions()[v as usize]));
                }
                Some(_) => {}
                None => _ = first.insert([a, b], f),
            }
        }
    }
    found
}

/// The share of the length of the input's creases that has one of the result's within a quarter of an edge.
fn kept(input: &TriMesh, result: &TriMesh) -> f64 {
    let edge = (4.0 / 3f64.sqrt() * result.area() / result.facets().len() as f64).sqrt();
    let there = sharp(result, 20.0);
    let (mut all, mut near) = (0.0, 0.0);
    for [a, b] in sharp(input, 40.0) {
        let count = (a.distance(b) / (0.25 * edge)).ceil().max(1.0);
        for k in 0..count as usize {
            let p = a.lerp(b, (k as f64 + 0.5) / count);
            let length = a.distance(b) / count;
            all += length;
            if there.iter().any(|&ends| distance_to_segment(p, ends) < 0.25 * edge) {
                near += length;
            }
        }
    }
    if all > 0.0 { near / all } else { 1.0 }
}

#[test]
fn creases_stay_however_near_they_are_to_others() {
    let mut shares = Vec::new();
    // The tip of a needle that is thinner than an edge is not kept yet.
    for kind in PartKind::ALL.into_iter().filter(|kind| *kind != PartKind::Wedge) {
        for feature in [0.1, 0.02] {
            let mesh = part(kind, feature, 1);
            let done = run(&mesh, 1000, 2);
            let (given, now) = (topology(&mesh), topology(&done.mesh));
            let name = format!("{kind} {feature}");
            assert_eq!((now.euler, now.components, now.boundary_edges), (given.euler, 1, 0), "{name}");
            let share = kept(&mesh, &done.mesh);
            println!("{name}: {share:.4}, {} vertices", done.mesh.positions().len());
            shares.push((share, name));
        }
    }
    shares.sort_by(|a, b| a.0.total_cmp(&b.0));
    assert!(shares[0].0 > 0.95 && shares[shares.len() / 2].0 > 0.995, "{shares:?}");
}

#[test]
fn strips_narrower_than_an_edge_have_the_edges_of_their_curves() {
    // The flanks of a thread are strips of half an edge.
    let mesh = part(PartKind::Thread, 0.03, 102);
    let done = run(&mesh, 1500, 2);
    assert!(kept(&mesh, &done.mesh) > 0.995);
    assert_eq!(done.report.features.dropped_curves, 0);
}

/// A thread of 20 turns, whose chords leave it by more than its depth; a plate of 36 holes, whose corners alone are more than the points; a
/// bent plate and a cup of a thirtieth of an edge.
#[test]
fn parts_without_room_for_their_edges_get_more_points() {
    let cases = [
        // All of its curves have seeds, but half of their length is a quarter of an edge from the chords.
        (PartKind::Thread, 0.005, 242, CountReason::FewPoints),
        (PartKind::Perforated, 0.005, 77, CountReason::FewPoints),
        (PartKind::Thread, 0.01, 32, CountReason::FewPoints),
        // A tenth more is enough.
        (PartKind::Cup, 0.005, 80, CountReason::NarrowPatches),
        (PartKind::Bracket, 0.005, 238, CountReason::FewPoints),
    ];
    let cases = some(3, cases);
    for (kind, feature, seed, reason) in cases {
        let mesh = part(kind, feature, seed);
        let done = run(&mesh, 500, 2);
        let (count, result) = (done.report.vertex_count, &done.report.result);
        assert_eq!((count.asked, count.reason), (500, Some(reason)), "{kind}");
        assert!((500..=2_040).contains(&result.vertices), "{kind}: {}", result.vertices);
        assert!(sharp(&done.mesh, 150.0).is_empty() && done.report.topology_changes.is_empty(), "{kind}");
        assert_eq!(result.crossings.as_ref().map(|found| found.count), Some(0), "{kind}");
        assert!(kept(&mesh, &done.mesh) > 0.95, "{kind}");
        assert!(done.report.warnings.iter().any(|warning| warning.code == "vertex_count"), "{kind}");
    }
    // What is strict takes no more points.
    let mesh = part(PartKind::Thread, 0.01, 32);
    let options = RemeshOptions::new(Seeds::Sample { points: 500, seed: 0 }).with_strict_creases(true);
    let strict = remesh(&mesh, &options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default());
    assert!(strict.is_ok_and(|done| done.mesh.positions().len() <= 510));
}

/// How often the stages are run.
struct Runs(usize);

impl Observer for Runs {
    fn stage(&mut self, name: &'static str) {
        self.0 += usize::from(name == "prepare");
    }
}

/// Where facets of the input cross, those of any result do.
#[test]
fn parts_that_pass_through_each_other_are_not_tried_again() {
    let (one, other) = (prism(90.0), prism(60.0));
    let count = one.positions().len() as u32;
    let positions = other.positions().iter().map(|&p| p + DVec3::new(0.3, 0.2, 0.4));
    let positions = one.positions().iter().copied().chain(positions).collect();
    let facets = other.facets().iter().map(|t| t.map(|v| v + count));
    let mesh = TriMesh::new(positions, one.facets().iter().copied().chain(facets).collect()).unwrap();
    let (options, mut runs) = (RemeshOptions::new(Seeds::Sample { points: 400, seed: 0 }), Runs(0));
    let done = remesh(&mesh, &options, &Parallel::new(Some(2)).unwrap(), &mut runs, &Token::default()).unwrap();
    assert!(done.report.result.crossings.as_ref().unwrap().count > 0);
    assert!((392..=408).contains(&done.mesh.positions().len()) && done.report.vertex_count.reason.is_none());
    assert!(runs.0 <= 2, "{}", runs.0);
}

#[test]
fn vertices_of_a_thin_wedge_are_in_places_of_their_own() {
    for (feature, seed, points) in [(0.1, 180, 500), (0.03, 110, 1500)] {
        let mesh = part(PartKind::Wedge, feature, seed);
        let done = run(&mesh, points, 2);
        assert_eq!(done.report.result.coincident_vertices, 0, "wedge {feature} {seed}");
        assert_eq!(topology(&done.mesh).euler, topology(&mesh).euler, "wedge {feature} {seed}");
    }
}

#[test]
fn results_of_flat_faces_are_in_them() {
    // Strips between slots are narrower than an edge: cells of one reach over a slot to the next.
    for (feature, seed) in [(0.01, 293), (0.02, 153), (0.005, 251)] {
        let done = run(&part(PartKind::Slots, feature, seed), 1500, 2);
        let quality = done.report.result.quality.unwrap();
        // Rounding leaves about 1e-7 of the diagonal.
        assert!(quality.hausdorff_percent < 1e-4, "slots {feature} {seed}: {quality:?}");
        assert_eq!(done.report.result.repair.extra_vertices, 0, "slots {feature} {seed}");
    }
}

#[test]
fn folds_that_few_points_leave_are_counted_and_warned_of() {
    // The wall is a fiftieth of an edge thick.
    let done = run(&part(PartKind::Cup, 0.005, 3), 60, 2);
    let folded = sharp(&done.mesh, 150.0).len();
    assert!(folded > 0);
    assert_eq!(done.report.result.folded_edges, Some(folded));
    let warning = done.report.warnings.iter().find(|warning| warning.code == "folded_edges").unwrap();
    assert_eq!(warning.count, Some(folded));
}

#[test]
fn rims_of_a_thin_wall_have_their_vertices_side_by_side() {
    // The wall is a twentieth of an edge thick.
    let mesh = part(PartKind::Cup, 0.005, 248);
    let done = run(&mesh, 500, 2);
    assert!(sharp(&done.mesh, 150.0).is_empty() && kept(&mesh, &done.mesh) > 0.995);
    assert_eq!(done.report.result.folded_edges, Some(0));
    assert_eq!(done.report.features.dropped_curves, 0);
    // Which way a part goes does not depend on what the report is to have.
    let options = RemeshOptions::new(Seeds::Sample { points: 500, seed: 0 }).with_measure(false);
    let other = remesh(&mesh, &options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap();
    assert_eq!((other.mesh.facets(), other.mesh.positions()), (done.mesh.facets(), done.mesh.positions()));
    assert!(other.report.result.quality.is_none() && other.report.result.crossings.is_none());
}

#[test]
fn the_last_crossing_facets_are_divided() {
    // A bent plate a twentieth of an edge thick.
    let done = run(&part(PartKind::Bracket, 0.005, 70), 500, 2);
    assert_eq!(done.report.result.crossings.as_ref().unwrap().count, 0);
    assert!(done.mesh.positions().len() <= 510 && done.report.topology_changes.is_empty());
}

#[test]
fn divided_parts_have_the_same_bits_at_any_number_of_threads() {
    let mesh = part(PartKind::Cup, 0.01, 3);
    let of = |threads| {
        let done = run(&mesh, 500, threads);
        assert!(done.report.features.dropped_curves == 0 && done.report.features.missing_segments == 0);
        (done.mesh.positions().to_vec(), done.mesh.facets().to_vec())
    };
    assert_eq!(of(1), of(3));
}

/// A frame of struts that are narrower than an edge: its creases alone are nearly all of the points.
#[test]
fn struts_narrower_than_an_edge_stay_straight() {
    let mesh = part(PartKind::Frame, 0.05, 2);
    let done = run(&mesh, 400, 2);
    let quality = done.report.result.quality.as_ref().unwrap();
    assert!(quality.hausdorff_percent < 0.01, "{quality:?}");
    assert_eq!(done.report.features.dropped_curves, 0);
}

/// A lattice has as many patches as an object of hundreds of parts.
#[test]
fn lattices_keep_all_their_struts() {
    for (feature, seed) in [(0.1, 6), (0.03, 20)] {
        let mesh = part(PartKind::Frame, feature, seed);
        for points in [600, 1500] {
            let done = run(&mesh, points, 2);
            let (quality, features) = (done.report.result.quality.as_ref().unwrap(), &done.report.features);
            let name = format!("{feature}, {points}");
            assert!(quality.hausdorff_percent < 0.01, "{name}: {quality:?}");
            assert_eq!((features.dropped_curves, features.missing_segments), (0, 0), "{name}");
            assert_eq!(topology(&done.mesh).euler, topology(&mesh).euler, "{name}");
        }
    }
}

/// A circle begins anywhere in each of its copies.
#[test]
fn patches_are_joined_all_around_their_holes() {
    for (kind, seed) in
        [PartKind::Gear, PartKind::Perforated].into_iter().flat_map(|k| some(2, 2..7).into_iter().map(move |s| (k, s)))
    {
        let mesh = part(kind, 0.02, seed);
        let found = topology(&run(&mesh, 400, 2).mesh);
        assert_eq!((found.boundary_edges, found.euler), (0, topology(&mesh).euler), "{kind}, {seed}");
    }
}

/// A plate between two bores has seeds of its own, and walls narrower than an edge; a needle may be a cone of ten creases; a skin is
/// bent with a smaller radius than an edge. Distances are percent of the diagonal.
#[test]
fn walls_bores_and_bends_are_whole_with_few_points() {
    let cases = [
        (PartKind::Drilled, 0.01, 1, 2.2),
        (PartKind::Drilled, 0.03, 1, 1.8),
        (PartKind::Drilled, 0.1, 1, 1.2),
        (PartKind::Steps, 0.1, 1, 0.5),
        (PartKind::Gear, 0.1, 1, 1.0),
        (PartKind::Bracket, 0.01, 1, 1.0),
        (PartKind::Wedge, 0.01, 1, 0.5),
        (PartKind::Wedge, 0.01, 40, 0.8),
    ];
    for (kind, feature, seed, farthest) in cases {
        let mesh = part(kind, feature, seed);
        let done = run(&mesh, 500, 2);
        let (result, features) = (&done.report.result, &done.report.features);
        let name = format!("{kind}, {feature}, {seed}");
        assert_eq!((features.dropped_curves, features.missing_segments), (0, 0), "{name}");
        assert_eq!(result.crossings.as_ref().map_or(0, |found| found.count), 0, "{name}");
        assert_eq!(topology(&done.mesh).euler, topology(&mesh).euler, "{name}");
        assert!((490..=510).contains(&result.vertices), "{name}: {}", result.vertices);
        let quality = result.quality.as_ref().unwrap();
        assert!(quality.hausdorff_percent < farthest, "{name}: {quality:?}");
    }
}

/// Where creases are strict, a result has all of their edges, or there is none.
#[test]
fn strict_parts_are_whole_or_refused() {
    let mut refused = 0;
    let kinds = [PartKind::Drilled, PartKind::Thread, PartKind::Cup, PartKind::Frame];
    let cases = some(5, kinds.into_iter().flat_map(|kind| [(kind, 500), (kind, 200)]));
    for &(kind, points) in &cases {
        let mesh = part(kind, 0.01, 1);
        let options = RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_strict_creases(true);
        match remesh(&mesh, &options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()) {
            Ok(done) => {
                let features = &done.report.features;
                assert_eq!((features.dropped_curves, features.missing_segments), (0, 0), "{kind}");
            }
            Err(RemeshError::CreasesDropped { curves, length, .. }) => {
                assert!(curves > 0 && length > 0.0, "{kind}");
                refused += 1;
            }
            Err(RemeshError::CreasesBroken { curves, edges }) => {
                assert!(edges >= curves && curves > 0, "{kind}");
                refused += 1;
            }
            Err(error) => panic!("{kind}: {error}"),
        }
    }
    assert!((1..cases.len()).contains(&refused), "{refused}");
}

/// The facets of a coarse torus make angles like creases, with flat diagonals between. None of them is a feature.
#[test]
fn round_surfaces_of_few_facets_are_not_divided() {
    for facets in [500, 700] {
        let mesh = Shape::Torus.build(facets);
        for points in [60, 100, 200, 300] {
            let done = run(&mesh, points, 2);
            let quality = done.report.result.quality.as_ref().unwrap();
            assert_eq!(done.report.result.vertices, points);
            assert!(quality.theta_min_deg > 30.0 && quality.hausdorff_percent < 3.0, "{facets}, {points}: {quality:?}");
        }
    }
}

/// Its foot is a curve with room for cells, and its shaft is thinner than an edge.
#[test]
fn needles_keep_their_length() {
    for feature in [0.03, 0.01] {
        let mesh = part(PartKind::Wedge, feature, 1);
        let done = run(&mesh, 500, 2);
        let quality = done.report.result.quality.as_ref().unwrap();
        assert!(quality.hausdorff_percent < 1.0, "{feature}: {quality:?}");
    }
}

/// A prism with an angle of `degrees` between two of its sides.
fn prism(degrees: f64) -> TriMesh {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let below = [DVec3::ZERO, DVec3::X, DVec3::new(cos, sin, 0.0)];
    let facets = vec![[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4], [2, 0, 3], [2, 3, 5]];
    TriMesh::new(below.into_iter().chain(below.map(|p| p + DVec3::Z)).collect(), facets).unwrap()
}

#[test]
fn a_report_has_the_smallest_angle_that_corners_leave() {
    for (degrees, expected) in [(15.0, 15.0), (35.0, 35.0), (90.0, 45.0)] {
        let report = run(&prism(degrees), 400, 2).report;
        let (bound, least) = (report.features.angle_bound_deg.unwrap(), report.result.quality.unwrap().theta_min_deg);
        assert!((bound - expected).abs() < 1e-6, "{degrees}: {bound}");
        // Nothing else about a prism is narrower; facets beside the edge may be by a degree.
        assert!(least <= bound + 1e-6 && least > 0.9 * bound.min(33.0), "{degrees}: {least} of {bound}");
    }
    let sphere = Shape::Sphere.build(5_000);
    assert_eq!(run(&sphere, 400, 2).report.features.angle_bound_deg, None);
}

/// With an anisotropy parts are not divided, and the rims of small holes are shorter than eight edges.
#[test]
fn creases_too_short_to_be_kept_are_named() {
    let seeds = Seeds::Sample { points: 300, seed: 0 };
    let options = RemeshOptions { anisotropy: Anisotropy::Auto, ..RemeshOptions::new(seeds) };
    let mesh = part(PartKind::Drilled, 0.05, 1);
    let report = remesh(&mesh, &options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap().report;
    let warning = report.warnings.iter().find(|warning| warning.code == "short_creases");
    let short = report.features.short_crease_edges;
    assert!(short > 0 && warning.is_some_and(|warning| warning.count == Some(short)), "{short} {:?}", report.warnings);
}
