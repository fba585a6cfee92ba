//! Surfaces of several sheets that meet along curves, and regions of them.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::panic::{AssertUnwindSafe, catch_unwind};

use geometry::mesh::crossings::crossings;
use glam::{DQuat, DVec3, EulerRot};
use tessera::mesh::attributes::Attributes;
use tessera::mesh::regions::Regions;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshOptions, Seeds, remesh};
use tessera::rvd::Parallel;
use tessera::{Token, TriMesh};

use crate::long::is_long;
use crate::rough::Random;

pub fn run(mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap()
}

/// Complexes of each kind, of which there may be as many as seeds.
pub fn how_many(usual: usize) -> usize {
    if is_long() { 50 } else { usual }
}

/// Checks that report every complex that fails, not the first alone.
#[derive(Default)]
pub struct Failures(usize);

impl Failures {
    pub fn check(&mut self, case: impl FnOnce()) {
        self.0 += usize::from(catch_unwind(AssertUnwindSafe(case)).is_err());
    }

    pub fn finish(self) {
        assert_eq!(self.0, 0, "complexes that failed");
    }
}

/// A box of `cells` chambers with all outer walls and some of the inner ones, each of `s` x `s` squares, bent by `bend`. The regions are
/// the planes.
fn chambers(random: &mut Random, cells: [u32; 3], s: u32, bend: f64) -> (TriMesh, Regions) {
    let mut number: HashMap<[u32; 3], u32> = HashMap::new();
    let (mut positions, mut facets, mut labels) = (Vec::new(), Vec::new(), Vec::new());
    let mut vertex = |at: [u32; 3]| {
        *number.entry(at).or_insert_with(|| {
            let p = DVec3::from(at.map(|k| f64::from(k) / f64::from(s)));
            positions.push(p + bend * DVec3::new((2.1 * p.y).sin(), (1.7 * p.z).sin(), (1.9 * p.x).sin()));
            positions.len() as u32 - 1
        })
    };
    for axis in 0..3 {
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        for plane in 0..=cells[axis] {
            for i in 0..cells[u] {
                for j in 0..cells[v] {
                    let is_outer = plane == 0 || plane == cells[axis];
                    if !is_outer && random.unit() < 0.3 {
                        continue;
                    }
                    for (k, l) in (0..s).flat_map(|k| (0..s).map(move |l| (k, l))) {
                        let mut corner = |du: u32, dv: u32| {
                            let mut at = [0; 3];
                            (at[axis], at[u], at[v]) = (plane * s, i * s + k + du, j * s + l + dv);
                            vertex(at)
                        };
                        let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                        facets.extend([[a, b, c], [a, c, d]]);
                        labels.extend([(10 * axis as u32 + plane) as i64; 2]);
                    }
                }
            }
        }
    }
    (TriMesh::new(positions, facets).unwrap(), Regions::of_numbers(&labels).unwrap())
}

/// Facets with labels, of vertices that are one where they are in one place.
#[derive(Default)]
struct Films {
    number: HashMap<[i64; 3], u32>,
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    labels: Vec<i64>,
}

impl Films {
    /// The triangle with these corners in `s` x `s` triangles.
    fn add(&mut self, corners: [DVec3; 3], s: u32, label: i64) {
        let mut at = |i: u32, j: u32| {
            let [u, v] = [i, j].map(|k| f64::from(k) / f64::from(s));
            let p = corners[0] * (1.0 - u - v) + corners[1] * u + corners[2] * v;
            *self.number.entry((p * 1e6).round().to_array().map(|x| x as i64)).or_insert_with(|| {
                self.positions.push(p);
                self.positions.len() as u32 - 1
            })
        };
        for (i, j) in (0..s).flat_map(|i| (0..s - i).map(move |j| (i, j))) {
            let [a, b, c] = [at(i, j), at(i + 1, j), at(i, j + 1)];
            self.facets.push([a, b, c]);
            self.labels.push(label);
            if i + j + 2 <= s {
                self.facets.push([b, at(i + 1, j + 1), c]);
                self.labels.push(label);
            }
        }
    }

    fn finish(self, bend: f64) -> (TriMesh, Regions) {
        let bent = |p: DVec3| p + bend * DVec3::new((2.1 * p.y).sin(), (1.7 * p.z).sin(), (1.9 * p.x).sin());
        let positions = self.positions.into_iter().map(bent).collect();
        (TriMesh::new(positions, self.facets).unwrap(), Regions::of_numbers(&self.labels).unwrap())
    }
}

/// The points farthest along a direction, counterclockwise as seen against it.
fn farthest(points: &[DVec3], along: DVec3) -> Vec<usize> {
    let most = points.iter().map(|p| p.dot(along)).fold(f64::NEG_INFINITY, f64::max);
    let mut found: Vec<usize> = (0..points.len()).filter(|&k| points[k].dot(along) > most - 1e-9).collect();
    let middle = found.iter().map(|&k| points[k]).sum::<DVec3>() / found.len() as f64;
    let (right, unit) = ((points[found[0]] - middle).normalize(), along.normalize());
    let angle = |k: &usize| (points[*k] - middle).dot(unit.cross(right)).atan2((points[*k] - middle).dot(right));
    found.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    found
}

/// What two solids have in common.
#[derive(Clone, Copy, PartialEq)]
enum Glue {
    Vertex,
    Edge,
    Face,
}

/// A convex solid. Its faces run counterclockwise as seen from outside.
#[derive(Clone)]
struct Solid {
    points: Vec<DVec3>,
    faces: Vec<Vec<usize>>,
}

impl Solid {
    /// A tetrahedron, a box or an octahedron, stretched and turned.
    fn random(random: &mut Random) -> Self {
        let signs = |k: u32| DVec3::from([k & 1, k >> 1 & 1, k >> 2 & 1].map(|bit| 2.0 * f64::from(bit) - 1.0));
        let corners: Vec<DVec3> = (0..8).map(signs).collect();
        let axes: Vec<DVec3> = DVec3::AXES.into_iter().flat_map(|axis| [axis, -axis]).collect();
        let four: Vec<DVec3> = [0, 3, 5, 6].map(signs).to_vec();
        let (points, normals) = match (3.0 * random.unit()) as u32 {
            0 => (four.clone(), four.iter().map(|p| -p).collect()),
            1 => (corners, axes),
            _ => (axes.iter().map(|axis| 1.4 * axis).collect(), corners),
        };
        let faces = normals.into_iter().map(|normal| farthest(&points, normal)).collect();
        let [stretch, turn] = [0, 1].map(|_| DVec3::from([0; 3].map(|_: i32| random.unit())));
        let turn = DQuat::from_euler(EulerRot::XYZ, 6.0 * turn.x, 6.0 * turn.y, 6.0 * turn.z);
        Self { points, faces }.moved(|p| turn * (p * (0.8 + 0.5 * stretch)), false)
    }

    fn moved(&self, place: impl Fn(DVec3) -> DVec3, is_reflected: bool) -> Self {
        let mut faces = self.faces.clone();
        faces.iter_mut().filter(|_| is_reflected).for_each(|face| face.reverse());
        Self { points: self.points.iter().map(|&p| place(p)).collect(), faces }
    }

    /// The middle of a ball that holds it, and its radius.
    fn ball(&self) -> (DVec3, f64) {
        let middle = self.points.iter().sum::<DVec3>() / self.points.len() as f64;
        (middle, self.points.iter().map(|p| p.distance(middle)).fold(0.0, f64::max))
    }

    /// A solid that has a vertex, an edge or a face in common with it, and that face. It lies beyond, as solids are convex.
    fn beside(&self, glue: Glue, random: &mut Random) -> (Self, Option<usize>) {
        let mut pick = |count: usize| (random.unit() * count as f64) as usize;
        let face = pick(self.faces.len());
        let first = pick(self.faces[face].len());
        let corner = |k: usize| self.points[self.faces[face][(first + k) % self.faces[face].len()]];
        let (a, b, c) = (corner(0), corner(1), corner(2));
        let along = (b - a).normalize();
        let normal = (b - a).cross(c - a).normalize();
        match glue {
            Glue::Vertex => {
                let scale = 0.5 + 0.7 * random.unit();
                (self.moved(|p| a - scale * (p - a), true), None)
            }
            Glue::Edge => (self.moved(|p| a + 2.0 * along * along.dot(p - a) - (p - a), false), None),
            Glue::Face => (self.moved(|p| p - 2.0 * normal * normal.dot(p - a), true), Some(face)),
        }
    }
}

/// Solids, each glued to one before it in one of these ways. Each is a region, and a face in common is of the earlier one.
fn glued(random: &mut Random, solids: usize, ways: &[Glue]) -> (TriMesh, Regions, usize) {
    let mut all = vec![(Solid::random(random), None)];
    for _ in 0..20 * solids {
        let parent = (random.unit() * all.len() as f64) as usize;
        let glue = ways[(random.unit() * ways.len() as f64) as usize];
        let (next, common) = all[parent].0.beside(glue, random);
        let (middle, radius) = next.ball();
        let is_clear = |(k, (other, _)): (usize, &(Solid, Option<usize>))| {
            let (there, reach) = other.ball();
            k == parent || middle.distance(there) > radius + reach
        };
        if all.len() < solids && all.iter().enumerate().all(is_clear) {
            all.push((next, common));
        }
    }
    let mut films = Films::default();
    for (label, (solid, common)) in (0..).zip(&all) {
        for (_, face) in solid.faces.iter().enumerate().filter(|(k, _)| Some(*k) != *common) {
            let corner = |k: usize| solid.points[face[k]];
            (1..face.len() - 1).for_each(|k| films.add([corner(0), corner(k), corner(k + 1)], 8, label));
        }
    }
    let (mesh, regions) = films.finish(0.0);
    (mesh, regions, all.len())
}

/// Cells of Kelvin's foam, as truncated octahedra: some of those in a box of 2 x 2 x 2 of their lattice. Each film is a region.
fn foam(random: &mut Random, share: f64, bend: f64) -> (TriMesh, Regions) {
    let (mut films, mut known) = (Films::default(), BTreeSet::new());
    let centres = (0..16).map(|k: u32| {
        let corner = DVec3::from([k & 1, k >> 1 & 1, k >> 2 & 1].map(|x| 4.0 * f64::from(x)));
        corner + DVec3::splat(2.0 * f64::from(k >> 3))
    });
    // The corners of a cell are all permutations of 0, ±1, ±2.
    let values = [-2.0, -1.0, 0.0, 1.0, 2.0];
    let all = values.iter().flat_map(|&x| values.iter().flat_map(move |&y| values.map(|z| DVec3::new(x, y, z))));
    let is_corner =
        |p: &DVec3| (p.abs().element_sum(), p.abs().max_element(), p.abs().min_element()) == (3.0, 2.0, 0.0);
    let all: Vec<DVec3> = all.filter(is_corner).collect();
    for (k, centre) in centres.enumerate() {
        if k > 0 && random.unit() > share {
            continue;
        }
        let squares = (0..3).flat_map(|axis| [-1.0, 1.0].map(|side| DVec3::AXES[axis] * side));
        let hexagons =
            (0..8).map(|k: u32| DVec3::from([k & 1, k >> 1 & 1, k >> 2 & 1].map(|x| 2.0 * f64::from(x) - 1.0)));
        for normal in squares.chain(hexagons) {
            let corners: Vec<DVec3> = farthest(&all, normal).into_iter().map(|k| all[k]).collect();
            let middle = corners.iter().sum::<DVec3>() / corners.len() as f64;
            let place = (2.0 * (centre + middle)).to_array().map(|x| x.round() as i64);
            if known.insert(place) {
                let label = known.len() as i64;
                for (k, &corner) in corners.iter().enumerate() {
                    let next = corners[(k + 1) % corners.len()];
                    films.add([middle, corner, next].map(|p| (p + centre) / 2f64.sqrt()), 8, label);
                }
            }
        }
    }
    films.finish(bend)
}

/// Layers that faults cut and throw. Each layer is a region, and so is each fault.
fn strata(random: &mut Random, layers: i64, faults: i64, bend: f64) -> (TriMesh, Regions) {
    let (mut films, s) = (Films::default(), 12);
    let mut add = |corner: DVec3, [u, v]: [DVec3; 2], label| {
        let [a, b, c, d] = [corner, corner + u, corner + u + v, corner + v];
        films.add([a, b, d], s, label);
        films.add([c, d, b], s, label);
    };
    for block in 0..=faults {
        // Twelfths, so that the vertices of a fault are those of the layers that end on it.
        let thrown = (3.0 * random.unit()).floor() / 4.0;
        for layer in 0..layers {
            add(DVec3::new(block as f64, 0.0, layer as f64 + thrown), [DVec3::X, DVec3::Y], layer);
        }
        if block > 0 {
            for k in 0..=layers {
                add(DVec3::new(block as f64, 0.0, k as f64 - 0.5), [DVec3::Y, DVec3::Z], 100 + block);
            }
        }
    }
    films.finish(bend)
}

pub fn edges(mesh: &TriMesh) -> BTreeMap<[u32; 2], usize> {
    let mut edges = BTreeMap::new();
    for &[a, b, c] in mesh.facets() {
        for [p, q] in [[a, b], [b, c], [c, a]] {
            *edges.entry([p.min(q), p.max(q)]).or_default() += 1;
        }
    }
    edges
}

/// Vertices less edges plus facets, with vertices as the facets name them.
pub fn euler(mesh: &TriMesh) -> i64 {
    let used: BTreeSet<u32> = mesh.facets().iter().flatten().copied().collect();
    used.len() as i64 - edges(mesh).len() as i64 + mesh.facets().len() as i64
}

fn area_by_label(mesh: &TriMesh, regions: &Regions) -> BTreeMap<i64, f64> {
    let mut areas = BTreeMap::new();
    for (f, label) in regions.numbers().enumerate() {
        let [a, b, c] = mesh.corners(f);
        *areas.entry(label).or_default() += 0.5 * (b - a).cross(c - a).length();
    }
    areas
}

/// The lengths of the edges of each region's border.
fn borders(mesh: &TriMesh, regions: &Regions) -> BTreeMap<i64, Vec<f64>> {
    let mut of_label: BTreeMap<i64, Vec<[u32; 3]>> = BTreeMap::new();
    regions.numbers().zip(mesh.facets()).for_each(|(label, facet)| of_label.entry(label).or_default().push(*facet));
    let at = |v: u32| mesh.positions()[v as usize];
    let lengths = |facets| {
        let part = TriMesh::new(mesh.positions().to_vec(), facets).unwrap();
        let border = edges(&part).into_iter().filter(|edge| edge.1 == 1);
        border.map(|([a, b], _)| at(a).distance(at(b))).collect()
    };
    of_label.into_iter().map(|(label, facets)| (label, lengths(facets))).collect()
}

/// Edges with one facet, or with facets of two regions.
fn border_edges(mesh: &TriMesh, regions: &Regions) -> Vec<[DVec3; 2]> {
    let mut labels: BTreeMap<[u32; 2], Vec<i64>> = BTreeMap::new();
    for (label, &[a, b, c]) in regions.numbers().zip(mesh.facets()) {
        [[a, b], [b, c], [c, a]].iter().for_each(|&[p, q]| labels.entry([p.min(q), p.max(q)]).or_default().push(label));
    }
    let ends = labels.into_iter().filter(|(_, of)| of.len() == 1 || of[0] != of[1]).map(|(edge, _)| edge);
    ends.map(|edge| edge.map(|v| mesh.positions()[v as usize])).collect()
}

/// Length of the edges that have this many facets.
fn length_of(mesh: &TriMesh, facets: impl Fn(usize) -> bool) -> f64 {
    let at = |v: u32| mesh.positions()[v as usize];
    edges(mesh).into_iter().filter(|e| facets(e.1)).map(|([a, b], _)| at(a).distance(at(b))).sum()
}

fn assert_is_the_same_complex(name: &str, mesh: &TriMesh, regions: &Regions, bend: f64) {
    let edge = 1.0 / 5.0;
    let points = (mesh.area() / (3f64.sqrt() / 2.0 * edge * edge)) as usize;
    let mut attributes = Attributes::new(mesh);
    attributes.set_regions(regions.clone()).unwrap();
    let options =
        RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_attributes(attributes).with_keep_non_manifold(true);
    let done = run(mesh, &options);
    let report = &done.report;
    let name = format!("{name}: {:?} {:?}", report.features, report.result.topology);
    assert_eq!(euler(&done.mesh), euler(mesh), "{name}");
    // A chord of length h is shorter than its arc of curvature k by (h k)² / 24 of it; k is up to 4.4 times `bend`. A curve has a whole
    // number of chords, so that they may be half as long again as an edge.
    let (chord, bent) = (1.5 * edge, 4.4 * bend);
    let chords = (chord * bent).powi(2) / 24.0;
    for (what, count) in [("rims", 1), ("joints of three", 3), ("of four", 4)] {
        let [before, after] = [mesh, &done.mesh].map(|mesh| length_of(mesh, |k| k == count));
        assert!((after - before).abs() <= (1e-6 + chords) * before, "{name}: {what} {before} {after}");
    }
    assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{name}");
    let after = area_by_label(&done.mesh, done.attributes.as_ref().unwrap().regions().unwrap());
    let before = area_by_label(mesh, regions);
    // Between a chord of length h and its arc of curvature k are h³ k / 12; facets within are as much smaller as chords are shorter.
    let at_border = borders(&done.mesh, done.attributes.as_ref().unwrap().regions().unwrap());
    for (label, before) in &before {
        let after = after.get(label).copied().unwrap_or(0.0);
        let cubes: f64 = at_border.get(label).into_iter().flatten().map(|length| length.powi(3)).sum();
        let most = (1e-3 + chords) * before + cubes * bent / 12.0;
        assert!((after - before).abs() <= most, "{name}: region {label} has {after} of {before}");
    }
    assert_eq!(after.len(), before.len(), "{name}");
    let vertices = done.mesh.positions().len();
    assert!(vertices.abs_diff(points) * 50 <= points, "{name}: {vertices} for {points}");
}

#[test]
fn chambers_are_the_same_complex() {
    let (mut random, mut failures) = (Random::new(7), Failures::default());
    for (cells, bend) in [([1, 1, 2], 0.0), ([2, 2, 1], 0.0), ([2, 2, 2], 0.0), ([3, 2, 1], 0.15), ([2, 2, 2], 0.15)] {
        for k in 0..how_many(2) {
            let (mesh, regions) = chambers(&mut random, cells, 12, bend);
            let name = format!("{cells:?} {k}, bent by {bend}");
            failures.check(|| assert_is_the_same_complex(&name, &mesh, &regions, bend));
        }
    }
    failures.finish();
}

/// Balls that have one vertex in common, each with its own size.
#[test]
fn balls_that_touch_in_a_vertex_have_it_in_common() {
    let ball = Shape::Sphere.build(800);
    let at = ball.positions()[0];
    for balls in [2, 3] {
        // One that touches none is the first.
        let start = ball.positions().len() as u32;
        let mut positions: Vec<DVec3> = ball.positions().iter().map(|&p| p + 5.0 * DVec3::X).collect();
        let mut facets = ball.facets().to_vec();
        positions.push(at);
        for k in 0..balls {
            // On the other side, or within.
            let scale = [1.0, -0.8, 0.6][k];
            let first = positions.len() as u32 - 1;
            positions.extend(ball.positions()[1..].iter().map(|&p| at + scale * (p - at)));
            let own = |v: u32| if v == 0 { start } else { first + v };
            facets.extend(
                ball.facets().iter().map(|&[a, b, c]| if scale < 0.0 { [a, c, b] } else { [a, b, c] }.map(own)),
            );
        }
        // A copy of the vertex that no facet has is no place of the surface.
        positions.push(at);
        let mesh = TriMesh::new(positions, facets).unwrap();
        let done = run(&mesh, &RemeshOptions::new(Seeds::Sample { points: 900, seed: 0 }).with_keep_non_manifold(true));
        assert_eq!(euler(&done.mesh), euler(&mesh), "{balls}");
        let there = done.mesh.positions().iter().filter(|p| p.distance(at) < 1e-9).count();
        assert_eq!((there, crossings(&done.mesh, &Token::default()).unwrap().count), (1, 0), "{balls}");
        assert!(done.mesh.positions().len().abs_diff(900) <= 18, "{balls}: {}", done.mesh.positions().len());
    }
}

/// Patches of a bent sheet: borders and areas of regions stay where few cells are between them.
#[test]
fn borders_of_regions_lie_on_those_of_the_input() {
    let n = 40u32;
    for (k, points) in [(1, 60), (2, 150), (3, 400), (5, 900)] {
        let mut films = Films::default();
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let at = |i: u32, j: u32| DVec3::new(f64::from(i), f64::from(j), 0.0) / f64::from(n);
            let label = i64::from(i * k / n + k * (j * k / n));
            films.add([at(i, j), at(i + 1, j), at(i, j + 1)], 1, label);
            films.add([at(i + 1, j + 1), at(i, j + 1), at(i + 1, j)], 1, label);
        }
        let (mesh, regions) = films.finish(0.15);
        let mut attributes = Attributes::new(&mesh);
        attributes.set_regions(regions.clone()).unwrap();
        let done = run(&mesh, &RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_attributes(attributes));
        let after = done.attributes.as_ref().unwrap().regions().unwrap().clone();
        // The edges of a result are as long as those of triangles with the same area, and a chord of length h loses h³ k / 12 at its arc.
        let edge = (mesh.area() / (3f64.sqrt() / 2.0 * points as f64)).sqrt();
        let (mut farthest, areas) = (0.0f64, area_by_label(&done.mesh, &after));
        let border: Vec<[DVec3; 2]> = border_edges(&mesh, &regions);
        for p in border_edges(&done.mesh, &after).into_iter().flatten() {
            let distance = |&ends: &[DVec3; 2]| geometry::mesh::closest_point::distance_to_segment(p, ends);
            farthest = farthest.max(border.iter().map(distance).fold(f64::INFINITY, f64::min));
        }
        assert!(farthest <= 0.03 * edge, "{k} {points}: a border is {farthest} off, with edges of {edge}");
        for (label, before) in area_by_label(&mesh, &regions) {
            let most = 1e-3 * before + 4.4 * 0.15 * edge.powi(2) / 12.0 * 4.0 / f64::from(k);
            assert!((areas[&label] - before).abs() <= most, "{k} {points}: {label}: {} of {before}", areas[&label]);
        }
    }
}

/// Solids that touch in vertices and edges alone are as many closed surfaces.
fn assert_is_apart(name: &str, mesh: &TriMesh, regions: &Regions, count: usize) {
    let points = (mesh.area() / (3f64.sqrt() / 2.0 / 25.0)) as usize;
    let mut attributes = Attributes::new(mesh);
    attributes.set_regions(regions.clone()).unwrap();
    let done = run(mesh, &RemeshOptions::new(Seeds::Sample { points, seed: 0 }).with_attributes(attributes));
    let topology = &done.report.result.topology;
    let name = format!("{name}, apart: {topology:?}");
    assert_eq!((topology.components, topology.euler), (count, 2 * count as i64), "{name}");
    assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{name}");
    let after = area_by_label(&done.mesh, done.attributes.as_ref().unwrap().regions().unwrap());
    for (label, before) in area_by_label(mesh, regions) {
        let share = after[&label] / before;
        assert!((share - 1.0).abs() < 1e-3, "{name}: region {label} has {share} of its area");
    }
}

#[test]
fn glued_solids_are_the_same_complex_or_apart() {
    let (mut random, mut failures) = (Random::new(3), Failures::default());
    for solids in [2, 3, 5] {
        for k in 0..how_many(1) {
            let (mesh, regions, _) = glued(&mut random, solids, &[Glue::Vertex, Glue::Edge, Glue::Face]);
            failures.check(|| assert_is_the_same_complex(&format!("{solids} solids {k}"), &mesh, &regions, 0.0));
            let (mesh, regions, count) = glued(&mut random, solids, &[Glue::Vertex, Glue::Edge]);
            failures.check(|| assert_is_apart(&format!("{solids} solids {k}"), &mesh, &regions, count));
        }
    }
    failures.finish();
}

/// Each once lacked an edge of a curve: in a sheet, with its own random seed, and where the cell of a curve's seed is in parts.
#[test]
fn no_edge_of_a_curve_is_missing() {
    let [two, three, five] = [2, 3, 5];
    for (before, solids) in [(vec![(two, 14)], two), (vec![(two, 25), (three, 25), (five, 20)], five)] {
        let mut random = Random::new(3);
        for (solids, count) in before {
            for _ in 0..count {
                glued(&mut random, solids, &[Glue::Vertex, Glue::Edge, Glue::Face]);
                glued(&mut random, solids, &[Glue::Vertex, Glue::Edge]);
            }
        }
        let (mesh, regions, _) = glued(&mut random, solids, &[Glue::Vertex, Glue::Edge, Glue::Face]);
        assert_is_the_same_complex(&format!("{solids} solids"), &mesh, &regions, 0.0);
    }
}

#[test]
fn foams_and_strata_are_the_same_complex() {
    let (mut random, mut failures) = (Random::new(5), Failures::default());
    for k in 0..how_many(1) {
        for (share, bend) in [(0.2, 0.0), (0.4, 0.1)] {
            let (mesh, regions) = foam(&mut random, share, bend);
            let name = format!("foam {k}, {share}, bent by {bend}");
            failures.check(|| assert_is_the_same_complex(&name, &mesh, &regions, bend));
        }
        for (layers, faults, bend) in [(2, 1, 0.0), (3, 2, 0.1)] {
            let (mesh, regions) = strata(&mut random, layers, faults, bend);
            let name = format!("strata {k}, {layers}, {faults}, {bend}");
            failures.check(|| assert_is_the_same_complex(&name, &mesh, &regions, bend));
        }
    }
    failures.finish();
}

/// Cells of a grid of `n` cells a side that are full.
struct Voxels {
    n: i32,
    full: Vec<bool>,
}

impl Voxels {
    fn random(random: &mut Random, n: i32, share: f64) -> Self {
        let mut full: Vec<bool> = (0..n * n * n).map(|_| random.unit() < share).collect();
        full[0] = true;
        Self { n, full }
    }

    fn is_full(&self, at: [i32; 3]) -> bool {
        at.iter().all(|k| (0..self.n).contains(k)) && self.full[((at[0] * self.n + at[1]) * self.n + at[2]) as usize]
    }

    /// The surface, each side of a cell in `s` x `s` squares, bent by `bend`; and the cell of each facet.
    fn surface(&self, s: i32, bend: f64) -> (TriMesh, Vec<[i32; 3]>) {
        let mut number: HashMap<[i32; 3], u32> = HashMap::new();
        let (mut positions, mut facets, mut cells) = (Vec::new(), Vec::new(), Vec::new());
        let all = (0..self.n).flat_map(|i| (0..self.n).flat_map(move |j| (0..self.n).map(move |k| [i, j, k])));
        for cell in all.filter(|&cell| self.is_full(cell)) {
            for (axis, up) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                let mut beside = cell;
                beside[axis] += 2 * up - 1;
                if self.is_full(beside) {
                    continue;
                }
                let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
                for (k, l) in (0..s).flat_map(|k| (0..s).map(move |l| (k, l))) {
                    let mut corner = |du: i32, dv: i32| {
                        let mut at = cell.map(|c| c * s);
                        at[axis] += up * s;
                        at[u] += k + du;
                        at[v] += l + dv;
                        *number.entry(at).or_insert_with(|| {
                            let p = DVec3::from(at.map(|x| f64::from(x) / f64::from(s)));
                            positions.push(p + bend * DVec3::new((1.1 * p.y).sin(), (0.9 * p.z).sin(), p.x.sin()));
                            positions.len() as u32 - 1
                        })
                    };
                    let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                    let out = if up == 1 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                    facets.extend(out);
                    cells.extend([cell; 2]);
                }
            }
        }
        (TriMesh::new(positions, facets).unwrap(), cells)
    }
}

/// Euler characteristic and number of components where the sides of each cell stay together, and cells that touch in an edge or a vertex
/// alone do not.
fn resolved(mesh: &TriMesh, cells: &[[i32; 3]]) -> (i64, usize) {
    let mut at_edge: BTreeMap<[u32; 2], Vec<usize>> = BTreeMap::new();
    for (f, t) in mesh.facets().iter().enumerate() {
        for [a, b] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
            at_edge.entry([a.min(b), a.max(b)]).or_default().push(f);
        }
    }
    // Corners of facets around one vertex of the resolved surface, and facets of one component.
    let count = mesh.facets().len();
    let (mut corners, mut parts): (Vec<usize>, Vec<usize>) = ((0..3 * count).collect(), (0..count).collect());
    fn root(of: &mut [usize], mut k: usize) -> usize {
        while of[k] != k {
            of[k] = of[of[k]];
            k = of[k];
        }
        k
    }
    let mut pairs = 0;
    for (edge, facets) in &at_edge {
        let joined: Vec<[usize; 2]> = match facets[..] {
            [f, g] => vec![[f, g]],
            _ => (0..facets.len())
                .flat_map(|i| (0..i).map(move |j| [facets[j], facets[i]]))
                .filter(|[f, g]| cells[*f] == cells[*g])
                .collect(),
        };
        assert_eq!(2 * joined.len(), facets.len());
        pairs += joined.len() as i64;
        for [f, g] in joined {
            let (p, q) = (root(&mut parts, f), root(&mut parts, g));
            parts[p] = q;
            for v in edge {
                let corner = |f: usize| 3 * f + mesh.facets()[f].iter().position(|u| u == v).unwrap();
                let (p, q) = (root(&mut corners, corner(f)), root(&mut corners, corner(g)));
                corners[p] = q;
            }
        }
    }
    let vertices = (0..3 * count).filter(|&k| root(&mut corners, k) == k).count() as i64;
    let components = (0..count).filter(|&k| root(&mut parts, k) == k).count();
    (vertices - pairs + count as i64, components)
}

/// Cells that touch have the components and the Euler characteristic of the surface where they are apart.
fn assert_is_resolved(name: &str, mesh: &TriMesh, cells: &[[i32; 3]], bend: f64) {
    let (euler, components) = resolved(mesh, cells);
    let edge = 1.0 / 5.0;
    let points = (mesh.area() / (3f64.sqrt() / 2.0 * edge * edge)) as usize;
    let done = run(mesh, &RemeshOptions::new(Seeds::Sample { points, seed: 0 }));
    let result = &done.report.result;
    let name = format!("{name}: {:?}", result.topology);
    assert_eq!((result.topology.euler, result.topology.components), (euler, components), "{name}");
    let chords = (edge * 1.1 * bend).powi(2) / 8.0;
    let share = done.mesh.area() / mesh.area();
    assert!((share - 1.0).abs() < 1e-3 + chords, "{name}: {share} of the area");
    assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{name}");
    let vertices = done.mesh.positions().len();
    assert!(vertices.abs_diff(points) * 50 <= points, "{name}: {vertices} for {points}");
}

#[test]
fn cells_that_touch_are_apart() {
    let (mut random, mut failures) = (Random::new(11), Failures::default());
    for (n, share, bend) in [(2, 0.4, 0.0), (2, 0.5, 0.1), (3, 0.3, 0.0), (3, 0.5, 0.1), (3, 0.6, 0.0)] {
        for k in 0..how_many(2) {
            let (mesh, cells) = Voxels::random(&mut random, n, share).surface(6, bend);
            failures.check(|| assert_is_resolved(&format!("{n} {share} {bend} {k}"), &mesh, &cells, bend));
        }
    }
    failures.finish();
}
