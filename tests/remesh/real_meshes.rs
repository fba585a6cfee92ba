//! Remeshes of real scans and CAD parts, where `TESSERA_MESHES` and `TESSERA_SEEDS` name folders with them.

use crate::long::is_long;
use crate::surfaces;
use geometry::mesh::adjacency::{Adjacency, EdgeKind};
use glam::DVec3;
use needs::needs;
use rayon::prelude::*;
use tessera::cvt::{DensityOptions, DensitySource};
use tessera::mesh::TriMesh;
use tessera::mesh::closest_point::ClosestPoint;
use tessera::mesh::measure::topology;
use tessera::mesh::sample::sample;
use tessera::remesh::{RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::token::Token;

/// One answer for each seed, in their order, as many at once as there are cores. A remesh has the same bits on any number of
/// threads, and on one it keeps a core busy from its begin to its end.
fn of_seeds<R: Send>(seeds: std::ops::Range<u64>, of: impl Fn(u64, &Parallel) -> R + Sync) -> Vec<R> {
    seeds.into_par_iter().map(|seed| of(seed, &Parallel::new(Some(1)).unwrap())).collect()
}

fn remesh_real(file: &str, points: usize, lloyd: usize) -> (TriMesh, tessera::remesh::Remesh) {
    let mesh = surfaces::real(file);
    let options = RemeshOptions::plain(Seeds::Sample { points, seed: 0 }, lloyd);
    let backend = Parallel::new(None).unwrap();
    let result = remesh(&mesh, &options, &backend, &mut (), &Token::default()).unwrap();
    (mesh, result)
}

#[needs(meshes)]
#[test]
fn remeshes_keep_the_topology() {
    for (file, points) in [("stanford-bunny.obj", 10_000), ("rocker-arm.obj", 5000), ("nefertiti.obj", 50_000)] {
        let (mesh, result) = remesh_real(file, points, 10);
        let (before, after) = (topology(&mesh), topology(&result.mesh));
        println!("{file}: {after:?}");
        assert_eq!((after.euler, after.components, after.boundary_loops), {
            (before.euler, before.components, before.boundary_loops)
        });
        assert_eq!((after.non_manifold_edges, after.non_manifold_vertices), (0, 0), "{file}");
        let report = &result.report;
        assert!((report.rvd.area / report.input.area - 1.0).abs() < 1e-10, "{file}: area");
        assert!(report.iterations.windows(2).all(|w| w[1].energy < w[0].energy), "{file}: energy rose");
    }
}

/// A raw scan with 2,094 non-manifold edges, some of them of facets that are there twice: said so, covered, and the result is a
/// manifold.
#[needs(meshes)]
#[test]
fn a_non_manifold_scan_is_remeshed_and_described() {
    let (mesh, result) = remesh_real("dragon_vrip_res3.ply", 20_000, 5);
    let report = &result.report;
    assert_eq!(topology(&mesh).non_manifold_edges, 2094);
    assert_eq!((report.input.coincident_facets, report.input.topology.non_manifold_edges), (308, 1643));
    assert!((report.rvd.area / report.input.area - 1.0).abs() < 1e-10);
    let after = topology(&result.mesh);
    println!("dragon: {after:?} {:?}", report.result.repair);
    assert_eq!((after.non_manifold_edges, after.non_manifold_vertices), (0, 0));
}

/// What a result has to come up to: at least Qmin, Qavg, the smallest angle (degrees) and the share of inner
/// valences from 5 to 7 (%); at most the share of facets with an angle under 30° and the Hausdorff distance (% of the
/// diagonal).
struct Bars {
    file: &'static str,
    points: usize,
    q: [f64; 2],
    angle: f64,
    under_30: f64,
    v567: f64,
    distance: f64,
    /// Of the boundary, both ways: at most and in the mean, % of the diagonal; 0 where there is none.
    rim: [f64; 2],
}

/// 5 + 30 steps, as a user gets them. The bars are the project's own promises for these meshes and counts; the last
/// mesh has fewer points than its promise (50,000, 0.15 %), for time, and a distance for its longer edges. The second one
/// is here for its rims; no angle is promised of it but that none is under 30°. The rocker-arm has
/// a groove of 93° that is half an edge deep, and fandisk fillets that are no creases: their distance differs from seed to
/// seed; see the next test.
#[needs(meshes)]
#[test]
fn remeshes_come_up_to_the_bars() {
    let bars = [
        ("stanford-bunny.obj", 10_000, [0.55, 0.920], 32.0, 0.0, 99.5, 0.20, [0.10, 0.02]),
        ("stanford-bunny.obj", 20_000, [0.55, 0.920], 30.0, 0.0, 99.5, 0.15, [0.10, 0.01]),
        ("rocker-arm.obj", 5000, [0.60, 0.920], 34.0, 0.0, 100.0, 0.30, [0.0; 2]),
        ("fandisk.obj", 3000, [0.50, 0.900], 28.0, 0.2, 99.0, 0.15, [0.0; 2]),
        ("nefertiti.obj", 20_000, [0.50, 0.915], 30.0, 0.05, 99.5, 0.17, [0.0; 2]),
    ];
    for (file, points, q, angle, under_30, v567, distance, rim) in bars {
        let bars = Bars { file, points, q, angle, under_30, v567, distance, rim };
        let mesh = surfaces::real(file);
        let options = RemeshOptions::new(Seeds::Sample { points, seed: 0 });
        let backend = Parallel::new(None).unwrap();
        let result = remesh(&mesh, &options, &backend, &mut (), &Token::default()).unwrap();
        bars.check(&mesh, &result);
    }
}

/// Graded edges keep triangles nearly as round. When a scan's noise beside coarse edges counted as creases, as if all edges
/// were as short as the shortest, 0.23 and 0.22 % of the facets had an angle under 30°.
#[needs(meshes)]
#[test]
fn graded_remeshes_are_of_round_triangles_too() {
    for (file, points, source, q) in [
        ("stanford-bunny.obj", 10_000, DensitySource::FeatureSize, 0.89),
        ("rocker-arm.obj", 15_000, DensitySource::FeatureSize, 0.90),
    ] {
        let mesh = surfaces::real(file);
        let density = DensityOptions::from_source(source);
        let options = RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_density(density);
        let backend = Parallel::new(None).unwrap();
        let result = remesh(&mesh, &options, &backend, &mut (), &Token::default()).unwrap();
        let quality = result.report.result.quality.unwrap();
        println!("{file}: {quality:?}");
        assert!(quality.q_avg > q && quality.under_30_percent <= 0.03 && quality.v567_percent > 99.9, "{quality:?}");
    }
}

/// In the mean over some seeds, since one alone may be lucky: 0.272 and 0.131 %. Triangles keep a least score, whose price is .02 % of
/// rocker-arm: with none, the mean is 0.251, and the smallest angle 35 degrees instead of 37. Those of rocker-arm differ by 0.03
/// among themselves, so that the mean of five is off by 0.014, more than what is left to the bar; of twenty by half of that.
#[needs(meshes)]
#[test]
fn results_are_near_whatever_the_seed() {
    for (file, points, most, mean) in [("rocker-arm.obj", 5000, 0.30, 0.28), ("fandisk.obj", 3000, 0.15, 0.135)] {
        let mesh = surfaces::real(file);
        let distance = |seed: u64, backend: &Parallel| {
            let options = RemeshOptions::new(Seeds::Sample { points, seed });
            let result = remesh(&mesh, &options, backend, &mut (), &Token::default()).unwrap();
            result.report.result.quality.unwrap().hausdorff_percent
        };
        let all = of_seeds(0..if is_long() { 20 } else { 6 }, distance);
        println!("{file}: {all:?}");
        assert!(all.iter().take(5).all(|&d| d <= most), "{file}: {all:?}");
        assert!(all.iter().sum::<f64>() / all.len() as f64 <= mean, "{file}: {all:?}");
    }
}

/// What could not be mended is mended now and then from the vertex beside it. As long as it counted all the same, what was not
/// much nearer was left as it was: these were off by .19 to .24 %.
#[needs(meshes)]
#[test]
fn a_place_that_was_mended_after_all_holds_no_other_back() {
    let mesh = surfaces::real("nefertiti.obj");
    let backend = Parallel::new(None).unwrap();
    for seed in [1, 9, 23] {
        let options = RemeshOptions::new(Seeds::Sample { points: 20_000, seed });
        let result = remesh(&mesh, &options, &backend, &mut (), &Token::default()).unwrap();
        let distance = result.report.result.quality.unwrap().hausdorff_percent;
        assert!(distance <= 0.17, "seed {seed}: {distance}");
    }
}

/// Where the cell of a seed beside a boundary reaches it, the boundary has its edge all the same.
#[needs(meshes)]
#[test]
fn boundaries_are_whole_whatever_the_seed() {
    let mesh = surfaces::real("stanford-bunny.obj");
    let features = of_seeds(1..7, |seed, backend| {
        let options = RemeshOptions::new(Seeds::Sample { points: 3000, seed }).with_measure(false);
        remesh(&mesh, &options, backend, &mut (), &Token::default()).unwrap().report.features
    });
    for (seed, features) in (1..7).zip(features) {
        assert_eq!((features.missing_segments, features.broken_curves), (0, 0), "seed {seed}: {features:?}");
    }
}

impl Bars {
    fn check(&self, mesh: &TriMesh, result: &tessera::remesh::Remesh) {
        let figures = result.report.result.quality.unwrap();
        println!("{}, {} points: {figures:?} {:?}", self.file, self.points, result.report.features);
        let at_least = [
            ("Qmin", figures.q_min, self.q[0]),
            ("Qavg", figures.q_avg, self.q[1]),
            ("smallest angle", figures.theta_min_deg, self.angle),
            ("V567", figures.v567_percent, self.v567),
        ];
        for (name, is, bar) in at_least {
            assert!(is >= bar, "{}: {name} is {is}, the bar {bar}", self.file);
        }
        let (low, high) = mesh.bounds();
        let percent = 100.0 / (high - low).length();
        let dense = percent * farthest(mesh, &result.mesh).max(farthest(&result.mesh, mesh));
        let rims = [rim(mesh), rim(&result.mesh)];
        let [there, back] = [from_rim(&rims[0], &rims[1]), from_rim(&rims[1], &rims[0])];
        let (most, mean) = (percent * there[0].max(back[0]), percent * there[1].max(back[1]));
        println!("{}: {dense:.4} % from a million points, rim {most:.4} %, {mean:.4} % in the mean", self.file);
        let at_most = [
            ("under 30°", figures.under_30_percent, self.under_30),
            ("Hausdorff distance", figures.hausdorff_percent.max(dense), self.distance),
            ("the rim's distance", most, self.rim[0]),
            ("its mean", mean, self.rim[1]),
        ];
        for (name, is, bar) in at_most {
            assert!(is <= bar, "{}: {name} is {is}, the bar {bar}", self.file);
        }
        assert_eq!(result.report.features.missing_segments, 0, "{}: edges of curves", self.file);
        let (before, after) = (topology(mesh), topology(&result.mesh));
        let of = |t: &tessera::mesh::measure::Topology| (t.euler, t.components, t.boundary_loops);
        assert_eq!((of(&after), after.non_manifold_edges, after.non_manifold_vertices), (of(&before), 0, 0));
    }
}

/// The largest distance of a million points, and of all vertices, from another surface.
fn farthest(from: &TriMesh, to: &TriMesh) -> f64 {
    let mut points: Vec<DVec3> = sample(from, None, 1_000_000, 7).iter().map(|s| s.position).collect();
    points.extend(from.positions());
    let all = ClosestPoint::new(to).distances(&points, &Token::default()).unwrap();
    all.into_iter().fold(0.0, f64::max)
}

/// Edges of the boundary.
fn rim(mesh: &TriMesh) -> Vec<[DVec3; 2]> {
    let adjacency = Adjacency::new(mesh);
    let at = |h: usize| mesh.positions()[mesh.facets()[h / 3][h % 3] as usize];
    let halves = (0..3 * mesh.facets().len()).filter(|&h| adjacency.kind(h) == EdgeKind::Boundary);
    halves.map(|h| [at(h), at(h - h % 3 + (h + 1) % 3)]).collect()
}

/// How far points of one boundary, 16 an edge, are from another: at most, and in the mean over its length.
fn from_rim(rim: &[[DVec3; 2]], other: &[[DVec3; 2]]) -> [f64; 2] {
    let off = |p: DVec3, [a, b]: [DVec3; 2]| {
        let way = b - a;
        p.distance(a + way * ((p - a).dot(way) / way.length_squared()).clamp(0.0, 1.0))
    };
    let (mut most, mut sum, mut length) = (0.0f64, 0.0, 0.0);
    for [a, b] in rim {
        let weight = a.distance(*b) / 16.0;
        for k in 0..16 {
            let p = a.lerp(*b, (f64::from(k) + 0.5) / 16.0);
            let far = other.iter().map(|&edge| off(p, edge)).fold(f64::INFINITY, f64::min);
            (most, sum, length) = (most.max(far), sum + weight * far, length + weight);
        }
    }
    [most, if length > 0.0 { sum / length } else { 0.0 }]
}

/// The energy beside that of regular hexagons in the plane. Curvature lowers it, irregular vertices raise it; what
/// the literature reports after so many steps.
#[needs(meshes)]
#[test]
fn the_energy_comes_down_as_published() {
    let mesh = surfaces::real("rocker-arm.obj");
    for (newton, most) in [(30, 0.997), (100, 0.994)] {
        let options = RemeshOptions::new(Seeds::Sample { points: 2000, seed: 0 })
            .with_newton(newton)
            .with_crease_angle_deg(0.0)
            .with_measure(false);
        let backend = Parallel::new(None).unwrap();
        let result = remesh(&mesh, &options, &backend, &mut (), &Token::default()).unwrap();
        let ratio = result.report.last.energy_ratio;
        println!("5 + {newton} steps: E/E_hex {ratio}");
        assert!(ratio <= most, "5 + {newton} steps: {ratio}");
    }
}
