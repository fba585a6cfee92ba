//! Promise: with periodic boundaries, a motion takes vertices and edges of one boundary to those of another, to the bit,
//! and the result has the topology of the input.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3, EulerRot, dvec3};
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::measure::topology;
use tessera::mesh::motion::Motion;
use tessera::mesh::regions::Regions;
use tessera::mesh::tensor::Tensor;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::{DensityOptions, DensitySource, Token, TriMesh};

use crate::rough::Random;

fn sample(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 0 })
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default())
}

fn motions(texts: &[&str]) -> Vec<Motion> {
    texts.iter().map(|text| text.parse().unwrap()).collect()
}

fn bits(p: DVec3) -> [u64; 3] {
    (p + DVec3::ZERO).to_array().map(f64::to_bits)
}

fn diagonal(mesh: &TriMesh) -> f64 {
    let (low, high) = mesh.bounds();
    (high - low).length()
}

fn moved(mesh: &TriMesh, to: impl Fn(DVec3) -> DVec3) -> TriMesh {
    TriMesh::new(mesh.positions().iter().map(|&p| to(p)).collect(), mesh.facets().to_vec()).unwrap()
}

/// Rows and columns of vertices. Vertices of the first and the last column are the same if it is `round`.
fn grid([rows, columns]: [u32; 2], round: bool, place: impl Fn(u32, u32) -> DVec3) -> TriMesh {
    let wide = if round { columns } else { columns + 1 };
    let positions = (0..=rows).flat_map(|i| (0..wide).map(move |j| (i, j))).map(|(i, j)| place(i, j)).collect();
    let at = |i: u32, j: u32| i * wide + j % wide;
    let cells = (0..rows).flat_map(|i| (0..columns).map(move |j| (i, j)));
    let facets = cells.flat_map(|(i, j)| {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        [[a, b, c], [a, c, d]]
    });
    TriMesh::new(positions, facets.collect()).unwrap()
}

/// A smooth function with period 1 in both of its arguments.
fn waves(random: &mut Random, height: f64) -> impl Fn(f64, f64) -> f64 + use<> {
    let all: Vec<[f64; 4]> = (0..4)
        .map(|_| [random.below(3) as f64, random.below(3) as f64, TAU * random.unit(), height * random.signed()])
        .collect();
    move |x: f64, y: f64| all.iter().map(|[k, l, phase, by]| by * (TAU * (k * x + l * y) + phase).sin()).sum::<f64>()
}

/// A height field with a period in x and another in y.
fn field(random: &mut Random, cells: [u32; 2], periods: [f64; 2], height: f64) -> TriMesh {
    let wave = waves(random, height);
    let share = |k: u32, n: u32| f64::from(k) / f64::from(n);
    grid(cells, false, |i, j| {
        let z = wave(share(i % cells[0], cells[0]), share(j % cells[1], cells[1]));
        dvec3(periods[0] * share(i, cells[0]), periods[1] * share(j, cells[1]), z)
    })
}

/// An open tube around z, one end the other moved by `length`.
fn tube(random: &mut Random, cells: [u32; 2], length: f64) -> TriMesh {
    let wave = waves(random, 0.03);
    grid(cells, true, |i, j| {
        let along = f64::from(i % cells[0]) / f64::from(cells[0]);
        let around = f64::from(j) / f64::from(cells[1]);
        let radius = 0.4 + wave(along, around);
        let (sin, cos) = (-TAU * around).sin_cos();
        dvec3(radius * cos, radius * sin, length * f64::from(i) / f64::from(cells[0]))
    })
}

/// A sector of a bumpy torus around z, `degrees` wide.
fn bent(random: &mut Random, cells: [u32; 2], degrees: f64) -> TriMesh {
    let wave = waves(random, 0.02);
    grid(cells, true, |i, j| {
        let along = f64::from(i % cells[0]) / f64::from(cells[0]);
        let (sin, cos) = (TAU * f64::from(j) / f64::from(cells[1])).sin_cos();
        let radius = 0.35 + wave(along, f64::from(j) / f64::from(cells[1]));
        let (s, c) = (degrees * f64::from(i) / f64::from(cells[0])).to_radians().sin_cos();
        dvec3((1.0 + radius * cos) * c, (1.0 + radius * cos) * s, radius * sin)
    })
}

/// A sector of rings around z, `degrees` wide, with heights that go around.
fn rings(random: &mut Random, cells: [u32; 2], degrees: f64) -> TriMesh {
    let wave = waves(random, 0.03);
    grid(cells, false, |i, j| {
        let r = 0.3 + 0.7 * f64::from(i) / f64::from(cells[0]);
        let (sin, cos) = (degrees * f64::from(j) / f64::from(cells[1])).to_radians().sin_cos();
        dvec3(r * cos, r * sin, r * wave(0.4 * r, f64::from(j % cells[1]) / f64::from(cells[1])))
    })
}

/// A wedge of a cone around z with its tip on the axis, `degrees` wide.
fn wedge([rows, columns]: [u32; 2], degrees: f64) -> TriMesh {
    let mut positions = vec![dvec3(0.0, 0.0, 0.5)];
    for (i, j) in (1..=rows).flat_map(|i| (0..=columns).map(move |j| (i, j))) {
        let r = f64::from(i) / f64::from(rows);
        let (sin, cos) = (degrees * f64::from(j) / f64::from(columns)).to_radians().sin_cos();
        positions.push(dvec3(r * cos, r * sin, 0.5 * (1.0 - r)));
    }
    let at = |i: u32, j: u32| if i == 0 { 0 } else { 1 + (i - 1) * (columns + 1) + j };
    let mut facets: Vec<[u32; 3]> = (0..columns).map(|j| [0, at(1, j), at(1, j + 1)]).collect();
    for (i, j) in (1..rows).flat_map(|i| (0..columns).map(move |j| (i, j))) {
        let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
        facets.extend([[a, b, c], [a, c, d]]);
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Where cos 2πx + cos 2πy + cos 2πz = 0 in the unit cube (Schwarz P), by tetrahedra of `n` cells a side.
fn cell(n: u32) -> TriMesh {
    let wide = n + 1;
    let split = |v: u32| [v % wide, v / wide % wide, v / wide / wide];
    // The same bits on opposite faces.
    let height = |v: u32| -> f64 { split(v).map(|k| (TAU * f64::from(k % n) / f64::from(n)).cos()).iter().sum() };
    let place = |v: u32| DVec3::from(split(v).map(|k| f64::from(k) / f64::from(n)));
    let (mut positions, mut facets) = (Vec::new(), Vec::new());
    let mut known: HashMap<[u32; 2], u32> = HashMap::new();
    let mut own = |a: u32, b: u32| {
        *known.entry([a.min(b), a.max(b)]).or_insert_with_key(|&[a, b]| {
            let share = height(a) / (height(a) - height(b));
            positions.push(place(a).lerp(place(b), share.clamp(0.02, 0.98)));
            positions.len() as u32 - 1
        })
    };
    let cells = (0..n).flat_map(|k| (0..n).flat_map(move |j| (0..n).map(move |i| [i, j, k])));
    for (low, axes) in cells.flat_map(|low| PATHS.map(|axes| (low, axes))) {
        let mut at = low;
        let mut corners = vec![low];
        for axis in axes {
            at[axis] += 1;
            corners.push(at);
        }
        let corners: Vec<u32> = corners.into_iter().map(|[i, j, k]| i + wide * (j + wide * k)).collect();
        let (below, above): (Vec<u32>, Vec<u32>) = corners.iter().partition(|&&v| height(v) < 0.0);
        let polygon: Vec<u32> = match (&below[..], &above[..]) {
            (&[a], others) | (others, &[a]) => others.iter().map(|&b| own(a, b)).collect(),
            (&[a, b], &[c, d]) => vec![own(a, c), own(a, d), own(b, d), own(b, c)],
            _ => continue,
        };
        let middle = |all: &[u32]| all.iter().map(|&v| place(v)).sum::<DVec3>() / all.len() as f64;
        let up = middle(&above) - middle(&below);
        facets.extend((1..polygon.len() - 1).map(|k| ([polygon[0], polygon[k], polygon[k + 1]], up)));
    }
    // Seen from where the function is above 0.
    let facets = facets.into_iter().map(|([a, b, c], up): ([u32; 3], DVec3)| {
        let [p, q, r] = [a, b, c].map(|v: u32| -> DVec3 { positions[v as usize] });
        if (q - p).cross(r - p).dot(up) < 0.0 { [a, c, b] } else { [a, b, c] }
    });
    let facets = facets.collect();
    TriMesh::new(positions, facets).unwrap()
}

/// Along three edges from the low corner of a cell to the high one.
const PATHS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// Edges with one facet, as their facets have them.
fn boundary(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let sides = || mesh.facets().iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let all: BTreeSet<[u32; 2]> = sides().collect();
    sides().filter(|&[a, b]| !all.contains(&[b, a])).collect()
}

/// The same surface with further vertices on boundary edges, those whose middle is picked.
fn divided(mesh: &TriMesh, random: &mut Random, pick: impl Fn(DVec3) -> bool) -> TriMesh {
    let rim: BTreeSet<[u32; 2]> = boundary(mesh).into_iter().collect();
    let (mut positions, facets) = mesh.clone().into_parts();
    let mut all = Vec::new();
    for mut t in facets {
        let picked = |&[a, b]: &[u32; 2]| {
            rim.contains(&[a, b]) && pick(0.5 * (mesh.positions()[a as usize] + mesh.positions()[b as usize]))
        };
        if let Some(k) = (0..3).find(|&k| picked(&[t[k], t[(k + 1) % 3]])) {
            t.rotate_left(k);
            let [a, b, c] = t;
            let share = 0.2 + 0.6 * random.unit();
            positions.push(positions[a as usize].lerp(positions[b as usize], share));
            let middle = positions.len() as u32 - 1;
            all.extend([[a, middle, c], [middle, b, c]]);
        } else {
            all.push(t);
        }
    }
    TriMesh::new(positions, all).unwrap()
}

/// How far a place is from the line between two others.
fn distance(p: DVec3, [a, b]: [DVec3; 2]) -> f64 {
    let along = b - a;
    let share = ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0);
    p.distance(a + share * along)
}

/// The length of the boundary that a motion takes to another.
fn side_length(mesh: &TriMesh, motion: &Motion) -> f64 {
    let reach = 1e-6 * diagonal(mesh);
    let edges: Vec<[DVec3; 2]> =
        boundary(mesh).into_iter().map(|edge| edge.map(|v| mesh.positions()[v as usize])).collect();
    let is_paired = |&&[a, b]: &&[DVec3; 2]| {
        let image = motion.apply(0.5 * (a + b));
        edges.iter().any(|&edge| distance(image, edge) < reach)
    };
    edges.iter().filter(is_paired).map(|[a, b]| a.distance(*b)).sum()
}

/// On each pair of boundaries, the vertices and edges are the same, to the bit.
fn assert_paired(name: &str, mesh: &TriMesh, motions: &[Motion], done: &Remesh) {
    let reach = 1e-6 * diagonal(mesh);
    let edges: Vec<[DVec3; 2]> =
        boundary(&done.mesh).into_iter().map(|edge| edge.map(|v| done.mesh.positions()[v as usize])).collect();
    let places: BTreeMap<[u64; 3], DVec3> = edges.iter().flatten().map(|&p| (bits(p), p)).collect();
    let key = |ends: [DVec3; 2]| {
        let mut key = ends.map(bits);
        key.sort_unstable();
        key
    };
    let known: BTreeSet<[[u64; 3]; 2]> = edges.iter().map(|&edge| key(edge)).collect();
    let mut all = 0;
    for motion in motions {
        let name = format!("{name}, {motion}");
        // Places of the axis stay.
        let image = |p: DVec3| Some(motion.apply(p)).filter(|q| q.distance(p) > reach).unwrap_or(p);
        let mut first: BTreeSet<[u64; 3]> = BTreeSet::new();
        for (&own, &p) in &places {
            let goes_to = image(p);
            if places.values().any(|q| q.distance(goes_to) <= reach) {
                assert!(places.contains_key(&bits(goes_to)), "{name}: {p} goes to {goes_to}, near a vertex, not to it");
                first.insert(own);
            }
        }
        let mut length = 0.0;
        let mut count = 0;
        for &[a, b] in edges.iter().filter(|edge| edge.iter().all(|&p| first.contains(&bits(p)))) {
            let other = key([image(a), image(b)]);
            if other != key([a, b]) {
                assert!(known.contains(&other), "{name}: the edge from {a} to {b} has no image");
                length += a.distance(b);
                count += 1;
            }
        }
        assert!(count >= 3, "{name}: {count} edges");
        let given = side_length(mesh, motion);
        assert!((length / given - 1.0).abs() < 0.05, "{name}: {length} of {given} is paired");
        all += count;
    }
    let figures = done.report.result.periodic.unwrap();
    assert_eq!((figures.edges, figures.unpaired_edges), (all, 0), "{name}");
    assert!(!warns(done, "unpaired_edges"), "{name}");
}

fn warns(done: &Remesh, code: &str) -> bool {
    done.report.warnings.iter().any(|warning| warning.code == code)
}

/// The topology and the area of `mesh`, as many vertices as asked for, nothing that crosses.
fn assert_like(name: &str, mesh: &TriMesh, done: &Remesh) {
    let key = |mesh: &TriMesh| {
        let of = topology(mesh);
        (of.euler, of.components, of.boundary_loops, of.non_manifold_edges, of.non_manifold_vertices)
    };
    assert_eq!(key(&done.mesh), key(mesh), "{name}");
    let report = &done.report;
    assert!(report.topology_changes.is_empty(), "{name}: {:?}", report.topology_changes);
    assert_eq!(report.result.crossings.as_ref().unwrap().count, 0, "{name}");
    let area = done.mesh.area() / mesh.area();
    assert!((area - 1.0).abs() < 0.02, "{name}: {area} of the area");
    let (vertices, asked) = (done.mesh.positions().len(), report.vertex_count.asked);
    let off = vertices.abs_diff(asked);
    assert!(off * 50 <= asked || off <= 3, "{name}: {vertices} vertices, {asked} asked for");
    assert_eq!((report.result.vertices, report.result.facets), (vertices, done.mesh.facets().len()), "{name}");
    assert_eq!(done.vertex_seed.len(), vertices, "{name}");
    assert!(done.vertex_seed.iter().all(|&seed| (seed as usize) < done.seeds.len()), "{name}");
    let sides = |&[a, b, c]: &[u32; 3]| [[a, b], [b, c], [c, a]];
    let edges: BTreeSet<[u32; 2]> = done.mesh.facets().iter().flat_map(sides).collect();
    let is_edge = |&[a, b]: &[u32; 2]| edges.contains(&[a, b]) || edges.contains(&[b, a]);
    assert!(done.curve_edges.iter().all(is_edge), "{name}: curves are edges");
}

/// Remeshes `mesh` and checks the result.
fn check(name: &str, mesh: &TriMesh, motions: &[Motion], points: usize) -> Remesh {
    let name = format!("{name}, {points}");
    let options = sample(points).with_periodic(motions.to_vec());
    let done = run(mesh, &options).unwrap_or_else(|error| panic!("{name}: {error}"));
    assert_like(&name, mesh, &done);
    assert_paired(&name, mesh, motions, &done);
    assert_eq!(done.report.vertex_count.asked, points, "{name}");
    done
}

fn slant(random: &mut Random) -> DMat3 {
    let [a, b, c] = [0; 3].map(|_| 3.0 * random.signed());
    DMat3::from_quat(DQuat::from_euler(EulerRot::XYZ, a, b, c))
}

/// Fields with two periods: corners are on two boundaries, and all four of them are images of one.
#[test]
fn height_fields_with_two_periods() {
    let mut random = Random::new(21);
    let unit = field(&mut random, [24, 24], [1.0, 1.0], 0.015);
    let both = motions(&["translate:1,0,0", "translate:0,1,0"]);
    check("unit", &unit, &both, 300);
    check("unit", &unit, &both, 1200);
    check("one of two", &unit, &both[..1], 500);
    check("back", &unit, &motions(&["translate:0,-1,0", "translate:-1,0,0"]), 500);
    let long = field(&mut random, [30, 16], [1.7, 0.9], 0.02);
    let both = motions(&["translate:1.7,0,0", "translate:0,0.9,0"]);
    check("long", &long, &both, 800);
    // Other vertices on the second side.
    let far = divided(&long, &mut random, |p| p.x > 1.7 - 1e-9);
    assert!(far.positions().len() > long.positions().len() + 10);
    check("divided at x", &far, &both, 800);
    let far = divided(&far, &mut random, |p| p.y < 1e-9 && p.x < 0.8);
    check("divided at x and y", &far, &both, 800);
    // Off the origin.
    let by = dvec3(3.25, -7.5, 1.0);
    check("off", &moved(&long, |p| p + by), &both, 500);
}

/// Tubes whose ends are closed curves.
#[test]
fn tubes_with_ends_that_are_translated() {
    let mut random = Random::new(22);
    for (k, points) in [300, 700, 1500].into_iter().enumerate() {
        let mesh = tube(&mut random, [20, 30], 1.5);
        check("tube", &mesh, &motions(&["translate:0,0,1.5"]), points);
        let turn = slant(&mut random);
        let shift = 2.0 * random.point();
        let by = turn * dvec3(0.0, 0.0, if k == 1 { -1.5 } else { 1.5 });
        let mesh = divided(&mesh, &mut random, |p| p.z < 1e-9 && (k == 2 || p.x > 0.0));
        check("slanted tube", &moved(&mesh, |p| turn * p + shift), &[Motion::Translation(by)], points);
    }
}

/// Bent tubes: one end is the other, turned.
#[test]
fn sectors_of_a_torus() {
    let mut random = Random::new(23);
    for (degrees, points) in [(60.0, 300), (90.0, 1000), (135.0, 700)] {
        let mesh = bent(&mut random, [24, 30], degrees);
        let angle = if degrees == 90.0 { -degrees } else { degrees };
        check("bent", &mesh, &motions(&[&format!("rotate:{angle},z")]), points);
        let (turn, centre) = (slant(&mut random), 2.0 * random.point());
        let motion = Motion::Rotation { degrees, axis: turn * DVec3::Z, centre };
        check("slanted", &moved(&mesh, |p| turn * p + centre), &[motion], points);
    }
}

/// Sectors of rings and of a cone, whose tip is on both of its sides.
#[test]
fn sectors_of_discs() {
    let mut random = Random::new(24);
    for (degrees, points) in [(60.0, 300), (90.0, 900), (40.0, 500)] {
        let motion = motions(&[&format!("rotate:{degrees},z")]);
        let mesh = rings(&mut random, [20, 24], degrees);
        check("rings", &mesh, &motion, points);
        // Its first side has y = 0.
        let mesh = divided(&mesh, &mut random, |p| p.y < 1e-9);
        check("divided rings", &mesh, &motion, points);
        let back = motions(&[&format!("rotate:-{degrees},z")]);
        let motion = if degrees == 90.0 { back } else { motion };
        let done = check("wedge", &wedge([24, 16], degrees), &motion, points);
        assert!(done.mesh.positions().iter().any(|p| p.distance(dvec3(0.0, 0.0, 0.5)) < 1e-6), "{degrees}: the tip");
    }
}

/// Rims that a rotation takes to themselves. Where it comes back to its beginning, one place is up to rounding.
#[test]
fn boundaries_that_motions_take_to_themselves() {
    let turn = |k: u32, n: u32| (std::f64::consts::TAU * f64::from(k % n) / f64::from(n)).sin_cos();
    let annulus = grid([12, 60], true, |i, j| {
        let (r, (sin, cos)) = (0.4 + 0.05 * f64::from(i), turn(j, 60));
        dvec3(r * cos, r * sin, 0.0)
    });
    let pipe = grid([20, 60], true, |i, j| {
        let (sin, cos) = turn(j, 60);
        dvec3(cos, sin, 0.1 * f64::from(i) - 1.0)
    });
    let half = grid([30, 40], false, |i, j| {
        let (sin, cos) = (std::f64::consts::PI * f64::from(j) / 40.0).sin_cos();
        dvec3(cos * f64::from(i) / 30.0, sin * f64::from(i) / 30.0, 0.0)
    });
    let all: [(&str, &TriMesh, &[&str]); 7] = [
        ("annulus", &annulus, &["rotate:60,z"]),
        ("annulus", &annulus, &["rotate:-18,z"]),
        ("pipe", &pipe, &["rotate:90,z"]),
        ("pipe", &pipe, &["rotate:180,x"]),
        ("pipe", &pipe, &["rotate:180,z", "translate:0,0,2"]),
        ("pipe", &pipe, &["translate:0,0,2", "rotate:36,z"]),
        ("half a disc", &half, &["rotate:180,z"]),
    ];
    for (name, mesh, texts) in all {
        for points in [250, 900] {
            let (name, motions) = (format!("{name}, {texts:?}, {points}"), motions(texts));
            let options = sample(points).with_periodic(motions.clone());
            let done = run(mesh, &options).unwrap_or_else(|error| panic!("{name}: {error}"));
            assert_like(&name, mesh, &done);
            let reach = 1e-9 * diagonal(mesh);
            let edges: Vec<[DVec3; 2]> =
                boundary(&done.mesh).into_iter().map(|edge| edge.map(|v| done.mesh.positions()[v as usize])).collect();
            let mut paired = 0;
            for motion in &motions {
                let length = |edges: &[[DVec3; 2]]| edges.iter().map(|[a, b]| a.distance(*b)).sum::<f64>();
                let is_image = |&&[a, b]: &&[DVec3; 2]| {
                    let [p, q] = [a, b].map(|p| motion.apply(p));
                    let is = |c: DVec3, d: DVec3| p.distance(c) < reach && q.distance(d) < reach;
                    edges.iter().any(|&[c, d]| is(c, d) || is(d, c))
                };
                let own: Vec<[DVec3; 2]> = edges.iter().filter(is_image).copied().collect();
                let given = side_length(mesh, motion);
                assert!((length(&own) / given - 1.0).abs() < 0.05, "{name}, {motion}: {} of {given}", length(&own));
                paired += own.len();
            }
            assert_eq!(done.report.result.periodic.unwrap().edges, paired, "{name}");
        }
    }
}

/// Creases everywhere at the boundary leave no room for its edges, and are dropped.
#[test]
fn rough_tiles_stay_periodic() {
    let mut random = Random::new(29);
    for k in 0..4 {
        let heights: Vec<f64> = (0..16 * 16).map(|_| 0.04 * random.signed()).collect();
        let mesh = grid([16, 16], false, |i, j| {
            dvec3(f64::from(i) / 16.0, f64::from(j) / 16.0, heights[(i % 16 * 16 + j % 16) as usize])
        });
        let motions = motions(&["translate:1,0,0", "translate:0,1,0"]);
        for points in [1200, 2500] {
            let name = format!("rough tile {k}, {points}");
            let done =
                run(&mesh, &sample(points).with_periodic(motions.clone())).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_paired(&name, &mesh, &motions, &done);
            assert_eq!(topology(&done.mesh).euler, 1, "{name}");
        }
    }
}

/// A cell of a surface with three periods.
#[test]
fn a_cell_with_three_periods() {
    let mut random = Random::new(25);
    let three = motions(&["translate:1,0,0", "translate:0,1,0", "translate:0,0,1"]);
    for (n, points) in [(9, 500), (11, 1500)] {
        let mesh = cell(n);
        let of = topology(&mesh);
        assert_eq!((of.euler, of.components, of.boundary_loops), (-4, 1, 6), "{n}");
        check("cell", &mesh, &three, points);
        let turn = slant(&mut random);
        let turned: Vec<Motion> = DVec3::AXES.map(|axis| Motion::Translation(turn * axis)).to_vec();
        check("slanted cell", &moved(&mesh, |p| turn * p), &turned, points);
    }
    let mesh = divided(&cell(11), &mut random, |p| p.x < 1e-9 || p.y > 1.0 - 1e-9);
    check("divided cell", &mesh, &three, 900);
}

/// Creases that go on behind the boundary, a hole, densities, edge lengths, attributes.
#[test]
fn other_options_are_met() {
    let mut random = Random::new(26);
    // A roof: its ridge runs from one side to the other.
    let roof = grid([20, 24], false, |i, j| {
        dvec3(f64::from(i) / 20.0, f64::from(j) / 24.0, 0.3 - (f64::from(j) - 12.0).abs() / 40.0)
    });
    let both = motions(&["translate:1,0,0", "translate:0,1,0"]);
    let done = check("roof", &roof, &both, 600);
    let distance = done.report.result.quality.unwrap().hausdorff_percent;
    assert!(distance < 0.1, "roof: {distance}");

    let mesh = field(&mut random, [30, 30], [1.0, 1.0], 0.015);
    let mut kept = mesh.facets().to_vec();
    kept.retain(|&[v, ..]| mesh.positions()[v as usize].truncate().distance(DVec3::splat(0.5).truncate()) > 0.2);
    let holed = TriMesh::new(mesh.positions().to_vec(), kept).unwrap();
    assert_eq!(topology(&holed).boundary_loops, 2);
    check("hole", &holed, &both, 900);

    let density = DensityOptions::from_source;
    let sizes = mesh.positions().iter().map(|p| 0.05 + 0.02 * (TAU * p.x).cos()).collect();
    let edge_length = DensityOptions::default().with_edge_length(0.05);
    for (name, options) in [
        ("curvature", sample(800).with_density(density(DensitySource::Curvature))),
        ("sizes", sample(800).with_density(density(DensitySource::Sizes(sizes)))),
        ("edge length", RemeshOptions::new(Seeds::Implied { seed: 2 }).with_density(edge_length)),
        ("keep", sample(500).with_keep_non_manifold(true)),
    ] {
        let done = run(&mesh, &options.with_periodic(both.clone())).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_like(name, &mesh, &done);
        assert_paired(name, &mesh, &both, &done);
    }

    // What the two sides have need not be the same.
    let middle = |f: usize| mesh.corners(f).into_iter().sum::<DVec3>() / 3.0;
    let labels: Vec<i64> = (0..mesh.facets().len()).map(|f| i64::from(middle(f).x > 0.5)).collect();
    let mut attributes = Attributes::new(&mesh);
    attributes.set_regions(Regions::of_numbers(&labels).unwrap()).unwrap();
    attributes.add_scalar(Scalar::new("x", mesh.positions().iter().map(|p| p.x).collect())).unwrap();
    let done = run(&mesh, &sample(900).with_periodic(both.clone()).with_attributes(attributes)).unwrap();
    assert_like("attributes", &mesh, &done);
    assert_paired("attributes", &mesh, &both, &done);
    let carried = done.attributes.as_ref().unwrap();
    for (p, value) in done.mesh.positions().iter().zip(&carried.scalars()[0].values) {
        assert!((value - p.x).abs() < 0.01, "{value} at {p}");
    }
    assert_eq!(done.report.result.regions.len(), 2);
    for region in &done.report.result.regions {
        assert!((region.area / region.input_area - 1.0).abs() < 0.03, "region {}: {}", region.number, region.area);
    }
    for (f, number) in carried.regions().unwrap().numbers().enumerate() {
        let x = done.mesh.corners(f).into_iter().sum::<DVec3>().x / 3.0;
        assert!((x - 0.5).abs() < 0.05 || number == i64::from(x > 0.5), "facet {f} at {x} is of {number}");
    }
}

#[test]
fn the_same_bits_on_all_threads() {
    let mut random = Random::new(27);
    for (mesh, all) in [
        (field(&mut random, [24, 24], [1.0, 1.0], 0.015), motions(&["translate:1,0,0", "translate:0,1,0"])),
        (bent(&mut random, [24, 30], 60.0), motions(&["rotate:60,z"])),
        (cell(9), motions(&["translate:1,0,0", "translate:0,1,0", "translate:0,0,1"])),
    ] {
        let options = sample(700).with_periodic(all);
        let of = |threads| {
            let backend = Parallel::new(Some(threads)).unwrap();
            remesh(&mesh, &options, &backend, &mut (), &Token::default()).unwrap()
        };
        let (one, two) = (of(1), of(2));
        assert!(one.mesh == two.mesh, "{:?}", options.periodic);
        assert_eq!(one.curve_edges, two.curve_edges, "{:?}", options.periodic);
        assert_eq!(one.seeds, two.seeds, "{:?}", options.periodic);
    }
}

#[test]
fn what_is_not_periodic_is_refused() {
    let mut random = Random::new(28);
    let mesh = field(&mut random, [16, 16], [1.0, 1.0], 0.015);
    let x = || motions(&["translate:1,0,0"]);
    let error = |options: RemeshOptions| run(&mesh, &options).map(|done| done.report).unwrap_err();
    for texts in [&["translate:5,0,0"][..], &["translate:1,0,0", "translate:0,1.01,0"], &["rotate:60,z"]] {
        let refused = error(sample(300).with_periodic(motions(texts)));
        let RemeshError::NotPeriodic { motion, reach } = refused else { panic!("{texts:?}: {refused}") };
        assert_eq!(motion, texts[texts.len() - 1].parse::<Motion>().unwrap());
        assert!(reach > 0.0 && reach < 1e-3, "{reach}");
    }
    let beside = |options: RemeshOptions| match error(options.with_periodic(x())) {
        RemeshError::Beside { one: "periodic boundaries", other } => other,
        error => panic!("{error}"),
    };
    let metric = DensitySource::Metric(vec![Tensor::of_length(0.1); mesh.positions().len()]);
    assert_eq!(beside(RemeshOptions::new(Seeds::Given(mesh.positions().to_vec()))), "seeds");
    assert_eq!(beside(sample(200).with_density(DensityOptions::from_source(metric))), "a metric");
    let part = || vec!["box:0,0,-1,0.3,0.3,1".parse().unwrap()];
    assert_eq!(beside(sample(200).with_keep(part())), "kept parts");
    assert_eq!(beside(sample(200).with_only(part())), "kept parts");
    assert_eq!(beside(sample(200).with_keep_rims(true)), "kept parts");
    assert_eq!(beside(sample(200).with_keep_boundaries(false)), "free boundaries");
    let mirrored = error(sample(200).with_periodic(x()).with_mirror("x=0.5".parse().unwrap()));
    assert!(matches!(mirrored, RemeshError::Beside { one: "a mirror plane", other: "periodic boundaries" }));
    // Too few points are refused, or enough after all.
    for points in [3, 6, 12, 25] {
        match run(&mesh, &sample(points).with_periodic(x())) {
            Ok(done) => assert!(done.report.result.periodic.unwrap().edges > 0, "{points}"),
            Err(RemeshError::TooFewSeeds { .. } | RemeshError::PeriodicLost { .. }) => {}
            Err(error) => panic!("{points}: {error}"),
        }
    }
}
