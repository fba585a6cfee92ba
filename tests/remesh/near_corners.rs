//! Promise: corners of creases and boundaries that are closer together than edges of a remesh make no sharp triangles where one
//! of them says nothing; every curve is there all the same.

use glam::DVec3;
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::ClosestPoint;
use tessera::remesh::{Remesh, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::token::Token;

/// Points, and about how long edges are: √(2/√3 · area / points) on an area of 2.4.
const POINTS: usize = 600;
const EDGE: f64 = 0.068;

fn run(mesh: &TriMesh) -> Remesh {
    let options = RemeshOptions::new(Seeds::Sample { points: POINTS, seed: 5 });
    remesh(mesh, &options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap()
}

/// A sheet with two folds that come together: at its lower rim they are `gap` apart.
fn folded(gap: f64) -> TriMesh {
    let at = DVec3::new;
    let lower = [at(-1.0, 0.0, 0.7), at(-0.5 * gap, 0.0, 0.0), at(0.5 * gap, 0.0, 0.0), at(1.0, 0.0, 0.7)];
    let upper = [at(-1.0, 1.0, 0.35), at(-0.5, 1.0, 0.0), at(0.5, 1.0, 0.0), at(1.0, 1.0, 0.35)];
    let facets = (0..3).flat_map(|k| [[k, k + 1, k + 5], [k, k + 5, k + 4]]).collect();
    TriMesh::new([lower, upper].concat(), facets).unwrap()
}

#[test]
fn folds_that_come_together_make_no_sharp_triangle() {
    // With more a chord would leave the rim, which bends there by 35 degrees, by a tenth of an edge.
    for gap in [0.05, 0.1, 0.15].map(|share| share * EDGE) {
        let mesh = folded(gap);
        let out = run(&mesh);
        let (features, quality) = (&out.report.features, out.report.result.quality.as_ref().unwrap());
        assert_eq!(
            (features.creases, features.corners, features.merged_corners, features.missing_segments),
            (2, 7, 1, 0),
            "{gap}"
        );
        // What a triangle should have. With a vertex at either end of the gap there were 4, 8 and 12 degrees, and no crease.
        assert!(quality.theta_min_deg > 30.0, "{gap}: {}", quality.theta_min_deg);
        // Of the corner that was left out no more is missing than a chord may leave a curve by.
        let closest = ClosestPoint::new(&out.mesh);
        let off = |p: &DVec3| closest.project(*p).position.distance(*p);
        let farthest = mesh.positions().iter().map(off).fold(0.0, f64::max);
        assert!(farthest < 0.1 * EDGE, "{gap}: {farthest}");
    }
}

#[test]
fn folds_with_room_between_them_end_where_they_end() {
    let mesh = folded(0.8 * EDGE);
    let out = run(&mesh);
    let features = &out.report.features;
    assert_eq!((features.creases, features.corners, features.missing_segments), (2, 8, 0));
    for corner in mesh.positions() {
        assert!(out.mesh.positions().contains(corner), "{corner}");
    }
}
