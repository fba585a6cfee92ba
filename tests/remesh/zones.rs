//! Parts of a surface whose edges have lengths of their own.

use glam::DVec3;
use tessera::cvt::DensityError;
use tessera::mesh::attributes::Attributes;
use tessera::mesh::parts::{PartError, Zone};
use tessera::mesh::regions::Regions;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::{DensityOptions, DensitySource, Token, TriMesh};

fn zones(texts: &[&str]) -> Vec<Zone> {
    texts.iter().map(|text| text.parse().unwrap()).collect()
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default())
}

fn sample(points: usize, texts: &[&str]) -> RemeshOptions {
    let density = DensityOptions::default().with_zones(zones(texts));
    RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_density(density)
}

fn implied(edge: f64, texts: &[&str]) -> RemeshOptions {
    let density = DensityOptions::default().with_edge_length(edge).with_zones(zones(texts));
    RemeshOptions::new(Seeds::Implied { seed: 0 }).with_density(density)
}

/// Mean length of the edges whose middles are in a part.
fn mean_edge(mesh: &TriMesh, holds: impl Fn(DVec3) -> bool) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for f in 0..mesh.facets().len() {
        let [a, b, c] = mesh.corners(f);
        for (a, b) in [(a, b), (b, c), (c, a)].into_iter().filter(|(a, b)| holds(a.midpoint(*b))) {
            (sum, count) = (sum + a.distance(b), count + 1);
        }
    }
    assert!(count > 20, "{count} edges");
    sum / f64::from(count)
}

#[test]
fn a_zone_in_the_middle_of_a_facet_is_seen() {
    // Two triangles, and twelve: no vertex is near the zones.
    let square = Shape::Square.build(2);
    let in_ball = |p: DVec3| p.distance(DVec3::new(0.3, 0.6, 0.0)) < 0.08;
    let far = |p: DVec3| p.distance(DVec3::new(0.3, 0.6, 0.0)) > 0.6;
    for (edge, options) in [
        (0.01, sample(3000, &["sphere:0.3,0.6,0,0.1=0.01"])),
        (0.02, implied(0.05, &["sphere:0.3,0.6,0,0.1=0.02"])),
        // More points than edges of a tenth everywhere have.
        (0.01, {
            let density = DensityOptions::from_source(DensitySource::Curvature).with_edge_length(0.1);
            let density = density.with_zones(zones(&["sphere:0.3,0.6,0,0.1=0.01"]));
            RemeshOptions::new(Seeds::Implied { seed: 0 }).with_density(density)
        }),
        // The shortest counts.
        (0.02, implied(0.05, &["sphere:0.3,0.6,0,0.1=0.02", "box:0,0,-1,1,1,1=0.04"])),
    ] {
        let done = run(&square, &options).unwrap();
        let mean = mean_edge(&done.mesh, in_ball);
        // Edges of a triangulation by cells are up to a tenth longer or shorter than the lengths that were asked for.
        assert!((mean / edge - 1.0).abs() < 0.12, "{mean} for {edge}");
        assert!(mean_edge(&done.mesh, far) > 1.7 * edge);
        let report = &done.report;
        let asked = report.vertex_count.asked as f64;
        assert!((report.result.vertices as f64 / asked - 1.0).abs() < 0.02, "{:?}", report.vertex_count);
        assert!(report.result.quality.as_ref().unwrap().theta_min_deg > 25.0);
    }
}

#[test]
fn zones_grow_by_gradation() {
    let mesh = Shape::Plane.build(2000);
    let done = run(&mesh, &implied(0.06, &["box:-1,-1,-1,0.1,2,1=0.01"])).unwrap();
    for (from, to) in [(0.12, 0.17), (0.17, 0.22)] {
        let mean = mean_edge(&done.mesh, |p| p.x > from && p.x < to);
        let bound = 0.01 + 0.3 * (to - 0.1);
        // As above, where edges are up to a tenth longer.
        assert!(mean < 1.12 * bound, "{mean} above {bound}");
    }
    assert!(mean_edge(&done.mesh, |p| p.x > 0.5) > 0.05);
}

#[test]
fn a_zone_may_be_coarse_and_a_region() {
    let mesh = Shape::Torus.build(3000);
    let labels: Vec<i64> = (0..mesh.facets().len()).map(|f| i64::from(mesh.corners(f)[0].x > 0.0)).collect();
    let mut attributes = Attributes::new(&mesh);
    attributes.set_regions(Regions::of_numbers(&labels).unwrap()).unwrap();
    let options = sample(2500, &["1=0.2"]).with_attributes(attributes);
    let done = run(&mesh, &options).unwrap();
    let mean = mean_edge(&done.mesh, |p| p.x > 0.9);
    assert!((mean / 0.2 - 1.0).abs() < 0.15, "{mean}");
    assert!(mean_edge(&done.mesh, |p| p.x < -0.5) < 0.1);
    let missing = run(&mesh, &sample(2500, &["1=0.2"]));
    let expected = matches!(missing, Err(RemeshError::Part(PartError::NoRegions { .. })));
    assert!(expected || matches!(missing, Err(RemeshError::Density(DensityError::Part(PartError::NoRegions { .. })))));
}

/// Two boxes that touch are moved apart inside; zones stay where they are.
#[test]
fn zones_are_where_they_were_for_sheets_that_touch() {
    let block = Shape::Block.build(12);
    let (low, high) = block.bounds();
    let by = DVec3::new(high.x - low.x, 0.0, 0.0);
    let (mut positions, mut facets) = block.clone().into_parts();
    let first = positions.len() as u32;
    positions.extend(block.positions().iter().map(|&p| p + by));
    facets.extend(block.facets().iter().map(|t| t.map(|v| v + first)));
    let mesh = TriMesh::new(positions, facets).unwrap();
    let size = (high - low).min_element();
    let centre = high + by;
    let text = format!("sphere:{},{},{},{}={}", centre.x, centre.y, centre.z, 0.3 * size, 0.03 * size);
    let done = run(&mesh, &sample(3000, &[&text])).unwrap();
    let mean = mean_edge(&done.mesh, |p| p.distance(centre) < 0.25 * size);
    assert!((mean / (0.03 * size) - 1.0).abs() < 0.15, "{mean} for {}", 0.03 * size);
}

#[test]
fn what_cannot_be_is_refused() {
    let mesh = Shape::Sphere.build(500);
    let many = run(&mesh, &sample(300, &["sphere:0,0,1,1=0.03"])).unwrap_err();
    let RemeshError::Density(DensityError::ZonesNeed { needed, points: 300 }) = many else { panic!("{many}") };
    // Lengths that no memory has room for are refused before any facet is divided so often.
    let square = Shape::Square.build(2);
    for tiny in ["sphere:0.3,0.6,0,0.1=1e-300", "box:0,0,-1,1,1,1=1e-9"] {
        let none = run(&square, &sample(300, &[tiny])).unwrap_err();
        assert!(matches!(none, RemeshError::Density(DensityError::ZonesNeed { .. })), "{none}");
        let none = run(&square, &implied(0.1, &[tiny])).unwrap_err();
        assert!(matches!(none, RemeshError::Density(DensityError::TooManyPoints { .. })), "{none}");
    }
    // That many do.
    assert!(run(&mesh, &sample(needed * 11 / 10, &["sphere:0,0,1,1=0.03"])).is_ok(), "{needed}");
    // Facets that are not there, also where the surface is changed or a part of it stays.
    let count = mesh.facets().len();
    let twice: Vec<[u32; 3]> = mesh.facets().iter().chain(&mesh.facets()[..9]).copied().collect();
    let changed = TriMesh::new(mesh.positions().to_vec(), twice).unwrap();
    let kept = |options: RemeshOptions| options.with_keep(vec!["facets:3".parse().unwrap()]);
    for (mesh, there, options) in [
        (&mesh, count, sample(300, &["facets:0-4,99999=0.1"])),
        (&mesh, count, kept(sample(300, &["facets:0-4,99999=0.1"]))),
        (&changed, count + 9, sample(300, &["facets:0-4,99999=0.1"])),
    ] {
        let none = run(mesh, &options).unwrap_err();
        assert!(
            matches!(none, RemeshError::Part(PartError::NoSuchFacet { facet: 99_999, facets }) if facets == there),
            "{none}"
        );
    }
    let vertices = run(&mesh, &sample(300, &["vertices:3=0.1"])).unwrap_err();
    assert!(matches!(vertices, RemeshError::Density(DensityError::Part(PartError::VerticesAlone))), "{vertices}");
    let density = DensityOptions::from_source(DensitySource::Weights(vec![1.0; mesh.positions().len()]));
    let beside = sample(300, &[]).with_density(density.with_zones(zones(&["sphere:0,0,1,1=0.1"])));
    assert!(matches!(run(&mesh, &beside), Err(RemeshError::Density(DensityError::ZonesBeside { other: "weights" }))));
}
