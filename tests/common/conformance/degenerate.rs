//! Seeds in the places where ties are, and surfaces that are hardly surfaces: the diagram covers them all the same.

use std::sync::Arc;

use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{CellSums, MAX_SEED_DISTANCE, PassStats, Serial, Surface};

use super::exact::mass_of;
use super::input::{bumpy, square, surface, triangle};
use super::{Claims, Precision, compare, sums};
use crate::broken::*;
use crate::points::{
    cluster, cube_lattice, duplicate_sets, far_sets, nearly_twice, noise, on_circle, on_the_mesh, square_lattice,
};

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
    for (name, seeds, duplicates) in duplicate_sets(&single) {
        let (got, stats) = covered(claims, name, &surface, &seeds);
        assert_eq!(stats.duplicate_seeds, duplicates as u64, "{name}");
        for i in 0..seeds.len() {
            let first = seeds.iter().position(|p| *p == seeds[i]).unwrap();
            assert!(first == i || (got.area[i], got.mass[i]) == (0.0, 0.0), "{name}: seed {i}");
        }
    }
}

pub fn seeds_nearly_on_each_other(claims: &Claims) {
    let sphere = surface(&Shape::Sphere.build(500), None);
    let single = on(&sphere, 60);
    for gap in [1e-3, 1e-5] {
        covered(claims, &format!("{gap} apart"), &sphere, &nearly_twice(&single, gap));
    }
    if claims.precision() == Precision::Double {
        for gap in [1e-7, 1e-9, 1e-12, 1e-15] {
            covered(claims, &format!("{gap} apart"), &sphere, &nearly_twice(&single, gap));
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

pub fn clusters_have_the_cells_of_the_reference(claims: &Claims) {
    let torus = surface(&Shape::Torus.build(2000), None);
    let around = on(&torus, 150);
    for width in [1e-3, 1e-4, 1e-5, 1e-6, 1e-7] {
        // Off the surface too, so that some have no cell.
        let seeds: Vec<DVec3> = around.iter().copied().chain(cluster(around[0], 40, width, 5)).collect();
        let name = format!("a cluster as wide as {width}");
        let (got, _) = covered(claims, &name, &torus, &seeds);
        let (want, _) = sums(&Serial, &torus, &seeds);
        for i in 0..seeds.len() {
            // In single precision the bisector of close seeds is off by their distance's share of a rounding.
            let most = claims.by_precision(1e-9, 0.05) * (want.area[i] + (1e-3 * width).powi(2));
            assert!(
                (got.area[i] - want.area[i]).abs() <= most,
                "{name}: cell {i}: {} of {}",
                got.area[i],
                want.area[i]
            );
        }
    }
}

pub fn seeds_in_lattices_and_on_circles(claims: &Claims) {
    for side in [2, 5, 16] {
        let surface = surface(&Shape::Plane.build(2 * side * side), None);
        // In the corners and in the middles of the facets' own grid.
        for shift in [0.0, 0.5] {
            covered(claims, &format!("{side} by {side} shifted {shift}"), &surface, &square_lattice(side, shift));
        }
    }
    // All vertices of the diagram are ties of four seeds, and facet edges run through them.
    let two = surface(&square(), None);
    let seeds = square_lattice(31, 0.0);
    let (want, _) = sums(&Serial, &two, &seeds);
    let (got, _) = covered(claims, "lattice", &two, &seeds);
    compare("lattice", &two, &got, &want, claims.by_precision(1e-11, 1e-5));
    let plane = surface(&Shape::Plane.build(200), None);
    for count in [4, 6, 12, 64] {
        covered(claims, &format!("{count} on a circle"), &plane, &on_circle(count));
    }
    let sphere = surface(&Shape::Sphere.build(500), None);
    covered(claims, "a lattice through a sphere", &sphere, &cube_lattice());
}

pub fn seeds_on_the_mesh_itself(claims: &Claims) {
    for mesh in [Shape::Torus.build(500), Shape::Plane.build(300), Shape::Block.build(500)] {
        let surface = surface(&mesh, None);
        for (name, seeds) in on_the_mesh(&surface) {
            covered(claims, name, &surface, &seeds);
        }
    }
}

pub fn seeds_far_from_the_surface(claims: &Claims) {
    let surface = surface(&Shape::Torus.build(500), None);
    let near = on(&surface, 50);
    for far in [1.0, 1e2, 1e4, MAX_SEED_DISTANCE] {
        for (name, seeds) in far_sets(&near, far) {
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
    for altitude in ALTITUDES {
        let surface = surface(&sliver(altitude), None);
        covered(claims, &format!("a sliver of {altitude}"), &surface, &on(&surface, 60));
    }
}

pub fn surfaces_that_are_no_manifold(claims: &Claims) {
    let sphere = Shape::Sphere.build(500);
    let mut all: Vec<(String, TriMesh, usize)> =
        [3, 4, 5].map(|pages| (format!("book of {pages}"), book(pages, 6), 150)).into();
    all.push(("two spheres that touch".to_owned(), touching(&sphere), 200));
    all.push(("through each other".to_owned(), join(&[&sphere, &map(&sphere, |p| p + 0.7 * DVec3::X)]), 300));
    let torus = Shape::Torus.build(500);
    let turned = map(&torus, |p| dvec3(p.x, p.z, p.y));
    all.push(("a torus through itself".to_owned(), join(&[&torus, &turned]), 300));
    all.push(("27 spheres".to_owned(), spheres(&Shape::Sphere.build(80)), 600));
    all.push(("no thickness".to_owned(), pillow(200), 80));
    all.push(("facets without area".to_owned(), with_facets_without_area(&torus), 200));
    all.push(("Möbius".to_owned(), moebius(40, 4), 150));
    all.push(("triangles alone".to_owned(), soup(&sphere), 300));
    all.push(("facets turned over".to_owned(), turned_over(&sphere, 3), 200));
    all.push(("corners that are nearly one".to_owned(), nearly_one(&sphere), 200));
    all.push(("facets twice".to_owned(), facets_twice(&sphere, 10..30), 200));
    all.push(("a sphere and dust".to_owned(), with_dust(&sphere), 200));
    for (name, mesh, count) in all {
        let surface = surface(&mesh, None);
        covered(claims, &name, &surface, &on(&surface, count));
    }
}

pub fn units_offsets_and_weights_of_any_size(claims: &Claims) {
    let torus = Shape::Torus.build(500);
    for (name, mesh) in units(&torus) {
        let surface = surface(&mesh, None);
        covered(claims, &name, &surface, &on(&surface, 150));
    }
    for scale in [1e-100, 1e-200, 1e-304] {
        let surface = surface(&triangle([DVec3::ZERO, DVec3::X * scale, DVec3::Y * scale]), None);
        covered(claims, &format!("scale {scale:e}"), &surface, &[dvec3(0.1, 0.2, 0.0), dvec3(-0.2, 0.1, 0.1)]);
    }
    let (torus, all) = with_extreme_weights(&torus);
    for (name, weights) in all {
        let surface = surface(&torus, Some(&weights));
        covered(claims, name, &surface, &on(&surface, 100));
    }
}
