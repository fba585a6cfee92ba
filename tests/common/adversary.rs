//! Jobs that somebody could send to hold a server up: a surface, options and seeds, all from one number.
#![allow(dead_code)]

use std::f64::consts::TAU;

use glam::{DVec3, dvec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tessera::DensitySource;
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::Attributes;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Refine, RemeshOptions, Seeds, Tolerance};

/// Kinds of surfaces, each hard for some stage.
pub const SURFACES: &[(&str, Make)] = &[
    ("soup", soup),
    ("flat soup", flat_soup),
    ("fan on an edge", edge_fan),
    ("fan on a vertex", vertex_fan),
    ("stray vertices", stray),
    ("coincident vertices", coincident),
    ("few vertices", few_vertices),
    ("needles", needles),
    ("lattice", lattice),
    ("nested shells", shells),
    ("layers", layers),
    ("dust", dust),
    ("noise", noise),
    ("two triangles", two_triangles),
    ("strip", strip),
    ("comb", comb),
    ("sheets", sheets),
    ("torn", torn),
    ("plain", plain),
];

type Make = fn(usize, &mut ChaCha8Rng) -> TriMesh;

/// A surface and what is asked of it.
pub struct Job {
    pub name: String,
    pub mesh: TriMesh,
    pub options: RemeshOptions,
}

/// The job of this number, of about so many facets and points.
pub fn job(number: u64, size: usize) -> Job {
    let mut rng = ChaCha8Rng::seed_from_u64(number);
    let (kind, make) = SURFACES[number as usize % SURFACES.len()];
    let facets = log_uniform(&mut rng, size / 50 + 4, size);
    let mesh = scaled(make(facets, &mut rng), &mut rng);
    let points = log_uniform(&mut rng, 8, (size / 4).max(9));
    let (seeds, how) = seeds(&mesh, points, &mut rng);
    let mut options = RemeshOptions::new(seeds);
    let asked = ask(&mesh, points, &mut options, &mut rng);
    Job { name: format!("{number}: {kind}, {} facets, {points} {how}, {asked}", mesh.facets().len()), mesh, options }
}

fn log_uniform(rng: &mut ChaCha8Rng, least: usize, most: usize) -> usize {
    ((least as f64).ln() + rng.random::<f64>() * (most as f64 / least as f64).ln()).exp() as usize
}

fn point(rng: &mut ChaCha8Rng) -> DVec3 {
    dvec3(rng.random(), rng.random(), rng.random())
}

fn mesh(positions: Vec<DVec3>, facets: Vec<[u32; 3]>) -> TriMesh {
    TriMesh::new(positions, facets).unwrap_or_else(|_| Shape::Sphere.build(100))
}

fn soup_of(facets: usize, positions: Vec<DVec3>, rng: &mut ChaCha8Rng) -> TriMesh {
    let count = positions.len() as u32;
    let corners = |_| [0, 1, 2].map(|_| rng.random_range(0..count));
    mesh(positions, (0..facets).map(corners).collect())
}

pub fn soup(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let vertices = (facets / 2).max(4);
    soup_of(facets, (0..vertices).map(|_| point(rng)).collect(), rng)
}

fn flat_soup(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let vertices = (facets / 4).max(4);
    soup_of(facets, (0..vertices).map(|_| point(rng) * dvec3(1.0, 1.0, 0.0)).collect(), rng)
}

/// As many facets as there may be on few vertices.
fn few_vertices(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let vertices = rng.random_range(5..200);
    soup_of(facets, (0..vertices).map(|_| point(rng)).collect(), rng)
}

/// Vertices that lie on one another, in few places.
fn coincident(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let places: Vec<DVec3> = (0..rng.random_range(4..1000)).map(|_| point(rng)).collect();
    let positions = (0..(facets / 2).max(4)).map(|_| places[rng.random_range(0..places.len())]).collect();
    soup_of(facets, positions, rng)
}

fn edge_fan(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let mut positions = vec![DVec3::ZERO, DVec3::Z];
    let flat = rng.random::<bool>();
    positions.extend((0..facets).map(|k| {
        let angle = TAU * k as f64 / facets as f64;
        let radius = if flat { 1.0 + k as f64 } else { 1.0 };
        let angle = if flat { 0.0 } else { angle };
        dvec3(radius * angle.cos(), radius * angle.sin(), rng.random())
    }));
    mesh(positions, (0..facets as u32).map(|k| [0, 1, k + 2]).collect())
}

fn vertex_fan(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let height = rng.random_range(-1.0..3.0);
    let mut positions = vec![dvec3(0.0, 0.0, height)];
    positions.extend((0..facets).map(|k| {
        let angle = TAU * k as f64 / facets as f64;
        dvec3(angle.cos(), angle.sin(), if rng.random::<bool>() { 0.0 } else { 0.01 * rng.random::<f64>() })
    }));
    mesh(positions, (0..facets as u32).map(|k| [0, 1 + k, 1 + (k + 1) % facets as u32]).collect())
}

/// A plain surface of which some vertices are far off.
fn stray(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let base = plain(facets, rng);
    let mut positions = base.positions().to_vec();
    for _ in 0..rng.random_range(1..4) {
        let v = rng.random_range(0..positions.len());
        positions[v] += (point(rng) - 0.5) * 10f64.powi(rng.random_range(1..30));
    }
    mesh(positions, base.facets().to_vec())
}

/// Slender as 1 to 10⁹.
fn needles(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let width = 10f64.powi(-rng.random_range(3..10));
    let mut positions = Vec::new();
    for k in 0..=facets / 2 {
        let x = k as f64 * width;
        positions.extend([dvec3(x, 0.0, 0.01 * rng.random::<f64>()), dvec3(x, 1.0, 0.0)]);
    }
    let corners = |k: u32| [[2 * k, 2 * k + 1, 2 * k + 2], [2 * k + 1, 2 * k + 3, 2 * k + 2]];
    mesh(positions, (0..(facets / 2) as u32).flat_map(corners).collect())
}

fn lattice(facets: usize, _: &mut ChaCha8Rng) -> TriMesh {
    Shape::Plane.build(facets)
}

fn shells(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let count = rng.random_range(2..200usize).min(facets / 20 + 2);
    let gap = 10f64.powi(-rng.random_range(1..8));
    let one = Shape::Sphere.build((facets / count).max(20));
    let scales: Vec<f64> = (0..count).map(|k| 1.0 + gap * k as f64).collect();
    copies(&one, scales.iter().map(|&scale| move |p: DVec3| scale * p))
}

/// The same facets many times over.
fn layers(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let count = rng.random_range(2..50usize);
    let one = plain((facets / count).max(20), rng);
    copies(&one, (0..count).map(|_| |p: DVec3| p))
}

fn copies<F: Fn(DVec3) -> DVec3>(one: &TriMesh, each: impl Iterator<Item = F>) -> TriMesh {
    let (mut positions, mut facets) = (Vec::new(), Vec::new());
    for place in each {
        let first = positions.len() as u32;
        positions.extend(one.positions().iter().map(|&p| place(p)));
        facets.extend(one.facets().iter().map(|t| t.map(|v| v + first)));
    }
    mesh(positions, facets)
}

/// Triangles that hang together with nothing.
fn dust(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let size = 10f64.powi(-rng.random_range(0..6));
    let mut positions = Vec::new();
    for _ in 0..facets {
        let at = point(rng);
        positions.extend([0, 1, 2].map(|_| at + size * point(rng)));
    }
    mesh(positions, (0..facets as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect())
}

/// A surface that is all creases.
fn noise(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let base = plain(facets, rng);
    let (low, high) = base.bounds();
    let spacing = (high - low).length() / (facets as f64).sqrt() * rng.random_range(0.1..2.0);
    let positions = base.positions().iter().map(|&p| p + spacing * (point(rng) - 0.5)).collect();
    mesh(positions, base.facets().to_vec())
}

fn two_triangles(_: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let bend = rng.random_range(-1.0..1.0);
    mesh(vec![DVec3::ZERO, DVec3::X, DVec3::Y, dvec3(1.0, 1.0, bend)], vec![[0, 1, 2], [1, 3, 2]])
}

/// Narrow and long, wound up.
fn strip(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let (width, turns) = (10f64.powi(-rng.random_range(1..7)), rng.random_range(1.0..50.0));
    let steps = (facets / 2).max(2);
    let mut positions = Vec::new();
    for k in 0..=steps {
        let t = k as f64 / steps as f64;
        let p = dvec3((TAU * turns * t).cos(), (TAU * turns * t).sin(), t);
        positions.extend([p, p + dvec3(0.0, 0.0, width)]);
    }
    let corners = |k: u32| [[2 * k, 2 * k + 1, 2 * k + 2], [2 * k + 1, 2 * k + 3, 2 * k + 2]];
    mesh(positions, (0..steps as u32).flat_map(corners).collect())
}

/// Spikes side by side.
fn comb(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let (count, height) = (facets / 2, 10f64.powi(rng.random_range(-1..4)));
    let mut positions = Vec::new();
    for k in 0..count {
        let x = k as f64 / count as f64;
        positions.extend([dvec3(x, 0.0, 0.0), dvec3(x, height, 0.0), dvec3(x, 0.0, 1.0)]);
    }
    let corners = |k: u32| [[3 * k, 3 * k + 1, 3 * k + 2], [3 * k, 3 * k + 2, 3 * k + 3]];
    mesh(positions, (0..count.max(2) as u32 - 1).flat_map(corners).collect())
}

/// Sheets that lie close to one another, or cross.
fn sheets(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let count = rng.random_range(2..100usize);
    let one = Shape::Plane.build((facets / count).max(8));
    let gap = 10f64.powi(-rng.random_range(2..9));
    let tilts: Vec<f64> = (0..count).map(|_| if rng.random::<bool>() { rng.random() } else { 0.0 }).collect();
    copies(
        &one,
        tilts.iter().enumerate().map(|(k, &tilt)| move |p: DVec3| p + dvec3(0.0, 0.0, gap * k as f64 + tilt * p.x)),
    )
}

/// A plain surface that lacks facets, with others turned over.
fn torn(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let base = plain(facets, rng);
    let all = base.facets().iter().copied().filter(|_| rng.random_range(0..10) > 0).collect::<Vec<_>>();
    let turned = all.into_iter().map(|[a, b, c]| if rng.random_range(0..4) == 0 { [a, c, b] } else { [a, b, c] });
    mesh(base.positions().to_vec(), turned.collect())
}

fn plain(facets: usize, rng: &mut ChaCha8Rng) -> TriMesh {
    let all = Shape::ALL;
    all[rng.random_range(0..all.len())].build(facets.max(20))
}

/// Now and then somewhere else, or of another size.
fn scaled(surface: TriMesh, rng: &mut ChaCha8Rng) -> TriMesh {
    let (scale, offset) = match rng.random_range(0..8) {
        0 => (10f64.powi(rng.random_range(-200..200)), DVec3::ZERO),
        1 => (1.0, (point(rng) - 0.5) * 10f64.powi(rng.random_range(1..7))),
        _ => return surface,
    };
    let positions = surface.positions().iter().map(|&p| scale * p + offset).collect();
    TriMesh::new(positions, surface.facets().to_vec()).unwrap_or(surface)
}

fn seeds(mesh: &TriMesh, points: usize, rng: &mut ChaCha8Rng) -> (Seeds, &'static str) {
    let (low, high) = mesh.bounds();
    let vertex = |rng: &mut ChaCha8Rng| mesh.positions()[rng.random_range(0..mesh.positions().len())];
    match rng.random_range(0..12) {
        0 => (Seeds::Given(vec![vertex(rng); points]), "seeds in one place"),
        1 => {
            let few: Vec<DVec3> = (0..points / 50 + 2).map(|_| vertex(rng)).collect();
            (Seeds::Given((0..points).map(|k| few[k % few.len()]).collect()), "seeds in few places")
        }
        2 => {
            let side = ((points as f64).cbrt() as usize).max(2);
            let at = |k: usize| {
                dvec3((k % side) as f64, (k / side % side) as f64, (k / side / side) as f64) / (side - 1) as f64
            };
            (Seeds::Given((0..side.pow(3)).map(|k| low + (high - low) * at(k)).collect()), "seeds of a lattice")
        }
        3 => {
            let extent = (high - low).max_element();
            let at = |rng: &mut ChaCha8Rng| vertex(rng) + extent * 1e-9 * (point(rng) - 0.5);
            let crowd = vertex(rng);
            let all = (0..points).map(|k| if k % 10 == 0 { at(rng) } else { crowd + extent * 1e-7 * point(rng) });
            (Seeds::Given(all.collect()), "seeds in a crowd")
        }
        4 => (Seeds::Given((0..points).map(|_| low + (high - low) * point(rng)).collect()), "seeds in the box"),
        _ => (Seeds::Sample { points, seed: rng.random() }, "points"),
    }
}

fn ask(mesh: &TriMesh, points: usize, options: &mut RemeshOptions, rng: &mut ChaCha8Rng) -> String {
    let mut asked = Vec::new();
    let (low, high) = mesh.bounds();
    let extent = (high - low).max_element();
    match rng.random_range(0..8) {
        0 => options.density.source = DensitySource::Curvature,
        1 => options.density.source = DensitySource::FeatureSize,
        2 => {
            let size = |_| extent * 10f64.powf(rng.random_range(-6.0..0.0));
            options.density.source = DensitySource::Sizes((0..mesh.positions().len()).map(size).collect());
        }
        3 => {
            let weight = |_| 10f64.powf(rng.random_range(-30.0..0.0));
            options.density.source = DensitySource::Weights((0..mesh.positions().len()).map(weight).collect());
        }
        _ => {}
    }
    asked.push(options.density.source.name().to_owned());
    if rng.random_range(0..4) == 0 {
        let tolerance = extent * 10f64.powf(rng.random_range(-300.0..-1.0));
        options.refine = Some(Refine::new(Tolerance::Length(tolerance)).with_max_points(4 * points));
        asked.push(format!("tolerance {tolerance:.0e}"));
    }
    if rng.random_range(0..3) == 0 {
        options.crease_angle_deg = rng.random_range(0.0..60.0);
        asked.push(format!("creases {:.0}", options.crease_angle_deg));
    }
    if rng.random_range(0..4) == 0 {
        options.attributes = Some(Attributes::new(mesh));
        asked.push("attributes".to_owned());
    }
    options.keep_boundaries = rng.random_range(0..4) > 0;
    asked.join(", ")
}
