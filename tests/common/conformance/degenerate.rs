//! Seeds in the places where ties are, and surfaces that are hardly surfaces: the diagram covers them all the same.

use std::sync::Arc;

use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{CellSums, MAX_SEED_DISTANCE, PassStats, Serial, Surface};

use super::exact::mass_of;
use super::input::{bumpy, square, surface, triangle};
use super::{Claims, Precision, compare, sums};
use crate::broken::{book, join, map, moebius, pillow, soup, spheres, with_facets_without_area};
use crate::points::noise;

/// Asserts that the cells cover the surface, carry its mass and are those of the reference. Seeds in the unit frame.
fn covered(claims: &Claims, name: &str, surface: &Arc<Surface>, seeds: &[DVec3]) -> (CellSums, PassStats) {
    let tolerance = claims.by_precision(1e-10, 1e-4);
    let (got, stats) = sums(claims.backend(), surface, seeds);
    let (want, _) = sums(&Serial, surface, seeds);
    let (area, mass): (f64, f64) = (got.area.iter().sum(), got.mass.iter().sum());
    let off = |x: f64, y: f64| (x - y).abs() > tolerance * y;
    assert!(!off(area, surface.area()), "{name}: area {area:e} of {:e}", surface.area());
    assert!(!off(mass, mass_of(surface)), "{name}: mass {mass:e} of {:e}", mass_of(surface));
    for i in 0..seeds.len() {
        let apart = (got.area[i] - want.area[i]).abs();
        // A boundary that is off by a rounding, along the whole cell.
        assert!(apart <= tolerance * surface.area().max(1.0), "{name}: cell {i} is off by {apart:e}");
    }
    (got, stats)
}

fn on(surface: &Surface, count: usize) -> Vec<DVec3> {
    noise(surface, count, 0.0, 9)
}

pub fn one_seed_and_few(claims: &Claims) {
    let surface = surface(&Shape::Sphere.build(500), None);
    let seeds = [DVec3::X * 0.5, DVec3::Y * 0.5, dvec3(-0.3, -0.3, 0.2)];
    for count in 1..=3 {
        covered(claims, &format!("{count} seeds"), &surface, &seeds[..count]);
    }
}

pub fn later_duplicates_have_no_cell(claims: &Claims) {
    let surface = surface(&Shape::Torus.build(600), None);
    let single = on(&surface, 80);
    for (name, seeds, duplicates) in [
        ("all the same", vec![single[3]; 500], 499),
        ("pairs", single.iter().flat_map(|&p| [p, p]).collect(), 80),
        ("a hundred times two", [single[0], single[1]].repeat(100), 198),
        // -0 is 0.
        ("signs of zero", [&[dvec3(0.4, 0.0, 0.0), dvec3(0.4, -0.0, -0.0)], &single[..]].concat(), 1),
    ] {
        let (got, stats) = covered(claims, name, &surface, &seeds);
        assert_eq!(stats.duplicate_seeds, duplicates, "{name}");
        for i in 0..seeds.len() {
            let first = seeds.iter().position(|p| *p == seeds[i]).unwrap();
            assert!(first == i || (got.area[i], got.mass[i]) == (0.0, 0.0), "{name}: seed {i}");
        }
    }
}

pub fn seeds_nearly_on_each_other(claims: &Claims) {
    let sphere = surface(&Shape::Sphere.build(500), None);
    let single = on(&sphere, 60);
    let pairs =
        |gap: f64| -> Vec<DVec3> { single.iter().flat_map(|&p| [p, p + gap * dvec3(0.3, -0.5, 0.8)]).collect() };
    for gap in [1e-3, 1e-5] {
        covered(claims, &format!("{gap} apart"), &sphere, &pairs(gap));
    }
    if claims.precision() == Precision::Double {
        for gap in [1e-7, 1e-9, 1e-12, 1e-15] {
            covered(claims, &format!("{gap} apart"), &sphere, &pairs(gap));
        }
    }
    // Off the surface, where the boundary of two is hardly known.
    let facet = surface(&triangle([dvec3(-0.5, -0.5, 0.5), dvec3(0.5, 0.5, 0.5), dvec3(0.5, -0.5, -0.5)]), None);
    for gap in [1e-6, 1e-7, 3.7e-9, 1e-12, 1e-15] {
        let near = dvec3(2.0, -0.375, 1.5);
        let seeds = [near + gap * dvec3(1.0, 1.0, 0.0), near, dvec3(1.0, 1.125, 1.5)];
        covered(claims, &format!("{gap} apart, off the surface"), &facet, &seeds);
    }
    // Their bisector is the plane of the facet.
    let facet = surface(&triangle([dvec3(0.5, -0.5, 0.0), dvec3(0.5, 0.5, 0.0), dvec3(-0.5, -0.5, 0.0)]), None);
    let seeds = [dvec3(-0.5, -0.5, -1.0), dvec3(-0.5, -0.5, 1.0), dvec3(0.5, 0.0, 0.0)];
    covered(claims, "mirror images", &facet, &seeds);
}

pub fn seeds_in_lattices_and_on_circles(claims: &Claims) {
    for side in [2, 5, 16] {
        let surface = surface(&Shape::Plane.build(2 * side * side), None);
        // In the corners and in the middles of the facets' own grid.
        for shift in [0.0, 0.5] {
            let seeds: Vec<DVec3> = (0..(side + 1) * (side + 1))
                .map(|k| dvec3((k % (side + 1)) as f64, (k / (side + 1)) as f64, 0.0))
                .map(|p| (p + dvec3(shift, shift, 0.0)) / side as f64 - dvec3(0.5, 0.5, 0.0))
                .collect();
            covered(claims, &format!("{side} by {side} shifted {shift}"), &surface, &seeds);
        }
    }
    // All vertices of the diagram are ties of four seeds, and facet edges run through them.
    let two = surface(&square(), None);
    let seeds: Vec<DVec3> =
        (0..1024).map(|i| dvec3(f64::from(i % 32) / 31.0 - 0.5, f64::from(i / 32) / 31.0 - 0.5, 0.0)).collect();
    let (want, _) = sums(&Serial, &two, &seeds);
    let (got, _) = covered(claims, "lattice", &two, &seeds);
    compare("lattice", &two, &got, &want, claims.by_precision(1e-11, 1e-5));
    let plane = surface(&Shape::Plane.build(200), None);
    for count in [4, 6, 12, 64] {
        let seeds: Vec<DVec3> = (0..count)
            .map(|k| (k as f64 / count as f64 * std::f64::consts::TAU).sin_cos())
            .map(|(sin, cos)| 0.25 * dvec3(cos, sin, 0.0))
            .collect();
        covered(claims, &format!("{count} on a circle"), &plane, &seeds);
    }
    // In space: all corners of cubes.
    let sphere = surface(&Shape::Sphere.build(500), None);
    let seeds: Vec<DVec3> = (0..343)
        .map(|k| dvec3((k % 7) as f64, (k / 7 % 7) as f64, (k / 49) as f64) / 6.0 - DVec3::splat(0.5))
        .collect();
    covered(claims, "a lattice through a sphere", &sphere, &seeds);
}

pub fn seeds_on_the_mesh_itself(claims: &Claims) {
    for mesh in [Shape::Torus.build(500), Shape::Plane.build(300), Shape::Block.build(500)] {
        let surface = surface(&mesh, None);
        let corners = |f: usize| surface.facets()[f].map(|v| surface.positions()[v as usize]);
        let facets = 0..surface.facets().len();
        let sets: [(&str, Vec<DVec3>); 4] = [
            ("vertices", surface.positions().to_vec()),
            ("middles of edges", facets.clone().map(|f| 0.5 * (corners(f)[0] + corners(f)[1])).collect()),
            ("middles of facets", facets.clone().map(|f| surface.centroid(f as u32)).collect()),
            // More seeds than facets, on every corner of every facet.
            ("corners", facets.flat_map(corners).collect()),
        ];
        for (name, seeds) in sets {
            covered(claims, name, &surface, &seeds);
        }
    }
}

pub fn seeds_far_from_the_surface(claims: &Claims) {
    let surface = surface(&Shape::Torus.build(500), None);
    let near = on(&surface, 50);
    for far in [1.0, 1e2, 1e4, MAX_SEED_DISTANCE] {
        let away: Vec<DVec3> =
            near.iter().map(|p| (p.normalize() * far).clamp(DVec3::splat(-far), DVec3::splat(far))).collect();
        // Cells that the surface meets at all angles, and cells that it does not meet.
        for (name, seeds) in [("all", away.clone()), ("half", [&near[..25], &away[..25]].concat())] {
            let (got, _) = sums(claims.backend(), &surface, &seeds);
            let error = (got.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
            // A boundary is right to a rounding of the seeds' distance.
            let rounding = 1e-11 * far.max(1.0);
            assert!(error < claims.by_precision(rounding, rounding.max(1e-4)), "{name} at {far}: {error:e}");
        }
    }
}

pub fn far_seeds_and_duplicates_are_those_of_the_reference(claims: &Claims) {
    let surface = surface(&bumpy(2), None);
    let mut seeds = vec![dvec3(1000.0, 0.0, 0.0), dvec3(-1000.0, 3.0, 0.0), dvec3(0.0, 1000.5, 0.0)];
    let (want, _) = sums(&Serial, &surface, &seeds);
    let (got, stats) = sums(claims.backend(), &surface, &seeds);
    assert!(claims.precision() == Precision::Double || stats.f64_finished > 0, "{stats:?}");
    for i in 0..seeds.len() {
        assert!((got.mass[i] - want.mass[i]).abs() < 1e-9, "{} {}", got.mass[i], want.mass[i]);
        assert!((got.energy[i] - want.energy[i]).abs() < 1e-9 * want.energy[i].max(1.0));
    }
    seeds.extend(noise(&surface, 50, 0.0, 1));
    seeds.extend_from_within(10..20);
    let (want, _) = sums(&Serial, &surface, &seeds);
    let (got, _) = sums(claims.backend(), &surface, &seeds);
    compare("duplicates", &surface, &got, &want, claims.by_precision(1e-10, 1e-5));
    assert!(got.mass[53..].iter().all(|m| *m == 0.0));
}

/// From afar a whole cluster is at one distance, so that a row ends before it: it must grow until it holds all of it.
pub fn a_cluster_at_one_rounded_distance(claims: &Claims) {
    let surface = surface(&Shape::Plane.build(50), None);
    let mut seeds = vec![dvec3(-9e5, 0.0, 0.0)];
    seeds.extend((0..600).map(|k| dvec3(9e5, 0.0, 1e-9 * f64::from(k))));
    let (got, _) = sums(claims.backend(), &surface, &seeds);
    let error = (got.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
    // As in `seeds_far_from_the_surface`.
    assert!(error < claims.by_precision(1e-10_f64, 1e-4).max(1e-11 * 9e5), "{error:e}");
}

/// The centroid is as far from two seeds as rounding can tell, and the cell of the one that is taken for the nearest
/// does not meet the facet.
pub fn a_first_cell_that_misses_its_facet(claims: &Claims) {
    // In single precision the two are in one place.
    if claims.precision() == Precision::Single {
        return;
    }
    let corners = vec![dvec3(9.5367431640625e-7, -0.5, 0.0), dvec3(0.25, -0.25, 0.0), dvec3(0.25, 0.0, -0.25)];
    // The rest of an octahedron, so that the box stays where it is.
    let rest = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|p| [0.5 * p, -0.5 * p]);
    let mesh = TriMesh::new(corners.into_iter().chain(rest).collect(), vec![[0, 1, 2], [3, 5, 7], [4, 6, 8]]).unwrap();
    let surface = surface(&mesh, None);
    let one = dvec3(-0.4375, -0.1875, -0.1875);
    let seeds = [
        dvec3(0.5, 0.1875, -0.375),
        dvec3(0.125, 0.25, -0.5),
        dvec3(0.25, 0.4375, -0.5),
        dvec3(-0.75, -0.1875, 0.75),
        one,
        one + 2f64.powi(-52) * DVec3::Z,
    ];
    let (got, _) = sums(claims.backend(), &surface, &seeds);
    let error = (got.area.iter().sum::<f64>() / surface.area() - 1.0).abs();
    assert!(error < 1e-10, "{error:e}");
}

pub fn facets_that_are_slivers(claims: &Claims) {
    for altitude in [1e-4, 1e-6, 1e-8, 1e-10] {
        let corners = [dvec3(-0.5, altitude, 0.5), dvec3(0.5, -altitude, -0.5), dvec3(-0.5, -altitude, 0.5)];
        covered(
            claims,
            &format!("altitude {altitude}"),
            &surface(&triangle(corners), None),
            &[dvec3(-0.3, 0.38, 0.46)],
        );
    }
    let slivers = surface(&Shape::Slivers.build(1500), None);
    covered(claims, "slivers", &slivers, &on(&slivers, 300));
    // T-shaped: slivers of an altitude of a rounding and of next to nothing between proper facets.
    for altitude in [1e-7, 1e-12, 3e-16, 1e-17] {
        let corners = vec![
            dvec3(0.0, 0.0, 0.0),
            dvec3(1.0, 0.0, 0.0),
            dvec3(0.5, altitude, 0.0),
            dvec3(0.5, 1.0, 0.0),
            dvec3(0.5, -1.0, 0.0),
        ];
        let mesh = TriMesh::new(corners, vec![[0, 1, 2], [2, 1, 3], [0, 2, 3], [1, 0, 4]]).unwrap();
        let surface = surface(&mesh, None);
        covered(claims, &format!("a sliver of {altitude}"), &surface, &on(&surface, 60));
    }
}

pub fn surfaces_that_are_no_manifold(claims: &Claims) {
    let sphere = Shape::Sphere.build(500);
    let mut all: Vec<(String, TriMesh, usize)> =
        [3, 4, 5].map(|pages| (format!("book of {pages}"), book(pages, 6), 150)).into();
    let top = sphere.positions().iter().copied().fold(DVec3::splat(-2.0), |a, b| if b.z > a.z { b } else { a });
    all.push(("two spheres that touch".to_owned(), join(&[&sphere, &map(&sphere, |p| 2.0 * top - p)]), 200));
    all.push(("through each other".to_owned(), join(&[&sphere, &map(&sphere, |p| p + 0.7 * DVec3::X)]), 300));
    let torus = Shape::Torus.build(500);
    let turned = map(&torus, |p| dvec3(p.x, p.z, p.y));
    all.push(("a torus through itself".to_owned(), join(&[&torus, &turned]), 300));
    all.push(("27 spheres".to_owned(), spheres(&Shape::Sphere.build(80)), 600));
    all.push(("no thickness".to_owned(), pillow(200), 80));
    all.push(("facets without area".to_owned(), with_facets_without_area(&torus), 200));
    all.push(("Möbius".to_owned(), moebius(40, 4), 150));
    all.push(("triangles alone".to_owned(), soup(&sphere), 300));
    let turned =
        sphere.facets().iter().enumerate().map(|(f, &[a, b, c])| if f % 3 == 0 { [a, c, b] } else { [a, b, c] });
    let turned = TriMesh::new(sphere.positions().to_vec(), turned.collect()).unwrap();
    all.push(("facets turned over".to_owned(), turned, 200));
    // As from a list of triangles whose corners were rounded one by one.
    let off = |k: usize| DVec3::new(k as f64, (k * k) as f64, (3 * k) as f64).map(f64::sin);
    let corners = sphere.facets().iter().flatten().enumerate();
    let places = corners.map(|(k, &v)| sphere.positions()[v as usize] + 1e-8 * off(k)).collect();
    let alone = (0..sphere.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    all.push(("corners that are nearly one".to_owned(), TriMesh::new(places, alone).unwrap(), 200));
    let mut facets = sphere.facets().to_vec();
    facets.extend_from_within(10..30);
    all.push(("facets twice".to_owned(), TriMesh::new(sphere.positions().to_vec(), facets).unwrap(), 200));
    let dust = map(&Shape::Sphere.build(80), |p| p * 1e-6 + DVec3::X * 2.0);
    all.push(("a sphere and dust".to_owned(), join(&[&sphere, &dust]), 200));
    for (name, mesh, count) in all {
        let surface = surface(&mesh, None);
        covered(claims, &name, &surface, &on(&surface, count));
    }
}

pub fn units_offsets_and_weights_of_any_size(claims: &Claims) {
    let torus = Shape::Torus.build(500);
    for scale in [1e-30, 1e-12, 1e12, 1e30] {
        for boxes in [0.0, 1e6] {
            let mesh = map(&torus, |p| (p + dvec3(1.0, -0.5, 0.25) * 3.0 * boxes) * scale);
            let surface = surface(&mesh, None);
            covered(claims, &format!("scale {scale}, {boxes} boxes off"), &surface, &on(&surface, 150));
        }
    }
    for scale in [1e-100, 1e-200, 1e-304] {
        let surface = surface(&triangle([DVec3::ZERO, DVec3::X * scale, DVec3::Y * scale]), None);
        covered(claims, &format!("scale {scale:e}"), &surface, &[dvec3(0.1, 0.2, 0.0), dvec3(-0.2, 0.1, 0.1)]);
    }
    let (mut positions, facets) = torus.into_parts();
    positions.push(DVec3::ONE);
    let torus = TriMesh::new(positions, facets).unwrap();
    let count = torus.positions().len();
    let like = |of: &dyn Fn(usize) -> f64| -> Vec<f64> { (0..count).map(of).collect() };
    let ramp = |v: usize| 1.0 + (v % 7) as f64;
    for (name, weights) in [
        ("tiny", like(&|v| 1e-300 * ramp(v))),
        ("subnormal", like(&|v| f64::from_bits(1 << (v % 7)))),
        ("huge", like(&|v| 1e307 * ramp(v))),
        ("zero but for one", like(&|v| f64::from(v == 17))),
        ("an unused vertex's is the largest", like(&|v| if v + 1 == count { 1e300 } else { ramp(v) })),
    ] {
        let surface = surface(&torus, Some(&weights));
        covered(claims, name, &surface, &on(&surface, 100));
    }
}
