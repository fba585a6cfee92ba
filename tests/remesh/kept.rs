//! Parts that stay to the bit, and rims that keep their vertices.

use std::collections::{BTreeMap, BTreeSet};

use geometry::mesh::crossings::crossings;
use glam::DVec3;
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::parts::{Indices, Part, PartError};
use tessera::mesh::regions::Regions;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::{Backend, Parallel, Serial};
use tessera::{Token, TriMesh};

use crate::rough::Random;

fn sample(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 0 })
}

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Result<Remesh, RemeshError> {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default())
}

fn bits(p: DVec3) -> [u64; 3] {
    (p + DVec3::ZERO).to_array().map(f64::to_bits)
}

/// How many facets each edge has, by the places of its ends.
fn edges(corners: impl Iterator<Item = [DVec3; 3]>) -> BTreeMap<[[u64; 3]; 2], usize> {
    let mut all = BTreeMap::new();
    for t in corners {
        for k in 0..3 {
            let mut ends = [bits(t[k]), bits(t[(k + 1) % 3])];
            ends.sort_unstable();
            *all.entry(ends).or_default() += 1;
        }
    }
    all
}

fn edges_of(mesh: &TriMesh) -> BTreeMap<[[u64; 3]; 2], usize> {
    edges((0..mesh.facets().len()).map(|f| mesh.corners(f)))
}

/// Checks that the first facets are those that stay, and that all of their edges have as many facets as before.
fn assert_stays(name: &str, mesh: &TriMesh, done: &Remesh, must: impl Fn([DVec3; 3]) -> bool) {
    let kept = done.report.result.kept.unwrap();
    let name = format!("{name}: {kept:?}");
    let told = |code: &str| done.report.warnings.iter().find(|warning| warning.code == code);
    assert_eq!(told("further_kept").and_then(|warning| warning.count).unwrap_or(0), kept.further_facets, "{name}");
    assert_eq!(told("nothing_kept").is_some(), kept.facets + kept.rim_edges == 0, "{name}");
    let given: Vec<[[u64; 3]; 3]> = (0..mesh.facets().len()).map(|f| mesh.corners(f).map(bits)).collect();
    let mut left = given.iter();
    for f in 0..kept.facets {
        let corners = done.mesh.corners(f).map(bits);
        assert!(left.any(|t| *t == corners), "{name}: facet {f} is none of the input's, or out of order");
    }
    let stay = (0..mesh.facets().len()).filter(|&f| must(mesh.corners(f))).count();
    assert_eq!(kept.facets, stay + kept.further_facets, "{name}");
    let (before, after) = (edges_of(mesh), edges_of(&done.mesh));
    for (edge, _) in edges((0..kept.facets).map(|f| done.mesh.corners(f))) {
        assert_eq!(after.get(&edge), before.get(&edge), "{name}: an edge of a facet that stays");
    }
    let mut curves: Vec<[u32; 2]> = done.curve_edges.iter().map(|&[a, b]| [a.min(b), a.max(b)]).collect();
    curves.sort_unstable();
    curves.dedup();
    assert_eq!(curves.len(), done.curve_edges.len(), "{name}: each edge once");
    let ends = |&[a, b]: &[u32; 2]| {
        let mut ends = [a, b].map(|v| bits(done.mesh.positions()[v as usize]));
        ends.sort_unstable();
        ends
    };
    let curves: BTreeSet<_> = curves.iter().map(ends).collect();
    let first = edges((0..kept.facets).map(|f| done.mesh.corners(f)));
    let rims = first.iter().filter(|(edge, count)| after[*edge] > **count);
    assert!(rims.clone().all(|(edge, _)| curves.contains(edge)), "{name}: rims are curves");
    let (result, input) = (&done.report.result, &done.report.input);
    assert_eq!(
        (result.topology.euler, result.topology.components, result.topology.boundary_loops),
        (input.topology.euler, input.topology.components, input.topology.boundary_loops),
        "{name}"
    );
    assert_eq!(result.topology.non_manifold_edges, input.topology.non_manifold_edges, "{name}");
    assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{name}");
}

fn touches(part: &Part, t: [DVec3; 3]) -> bool {
    let &Part::Sphere { centre, radius } = part else { unreachable!("spheres are drawn") };
    geometry::mesh::closest_point::closest_on_facet(centre, t, [0, 1, 2]).0.sqrt() <= radius
}

fn within_box(part: &Part, t: [DVec3; 3]) -> bool {
    let &Part::Box { low, high } = part else { unreachable!("it is a box") };
    // Facets are small beside the box.
    let middle = (t[0] + t[1] + t[2]) / 3.0;
    t.iter().chain([&middle]).any(|p| p.cmpge(low).all() && p.cmple(high).all())
}

fn within(part: &Part, t: [DVec3; 3]) -> bool {
    let &Part::Sphere { centre, radius } = part else { unreachable!("spheres are drawn") };
    t.iter().all(|p| p.distance(centre) <= radius)
}

fn ball(random: &mut Random, mesh: &TriMesh) -> Part {
    let (low, high) = mesh.bounds();
    let facet = (random.unit() * mesh.facets().len() as f64) as usize;
    Part::Sphere { centre: mesh.corners(facet)[0], radius: (0.08 + 0.25 * random.unit()) * (high - low).length() }
}

#[test]
fn parts_stay_to_the_bit_and_the_rest_meets_them() {
    let mut random = Random::new(3);
    for shape in [Shape::Sphere, Shape::Torus, Shape::Block, Shape::Plane] {
        let mesh = shape.build(800);
        let mut refused = 0;
        for k in 0..2 {
            let part = ball(&mut random, &mesh);
            // From a fifth of the vertices to four times as many.
            for points in [200, 500, 2000] {
                let name = format!("{shape}, {part} {k}, {points}");
                let keep = sample(points).with_keep(vec![part.clone()]);
                let only = sample(points).with_only(vec![part.clone()]);
                for (what, options) in [("keep", keep), ("only", only)] {
                    let name = format!("{name} {what}");
                    let done = match run(&mesh, &options) {
                        Ok(done) => done,
                        Err(RemeshError::TooFewForRims { .. } | RemeshError::AllKept) if points < 800 => {
                            refused += 1;
                            continue;
                        }
                        Err(error) => panic!("{name}: {error}"),
                    };
                    let must = |t| if what == "keep" { touches(&part, t) } else { !within(&part, t) };
                    assert_stays(&name, &mesh, &done, must);
                    let vertices = done.mesh.positions().len();
                    assert!(vertices.abs_diff(points) * 50 <= points, "{name}: {vertices} vertices");
                    assert_eq!(done.vertex_seed.len(), vertices);
                    assert!(done.vertex_seed.iter().all(|&seed| (seed as usize) < done.seeds.len()), "{name}");
                }
            }
        }
        assert!(refused <= 4, "{shape}: {refused} of 12 were refused");
    }
}

#[test]
fn rims_keep_their_vertices() {
    for (shape, facets) in [(Shape::Plane, 800), (Shape::Square, 2), (Shape::Hills, 900), (Shape::Sheets, 600)] {
        let mesh = shape.build(facets);
        let boundary: Vec<_> = edges_of(&mesh).into_iter().filter(|edge| edge.1 == 1).map(|edge| edge.0).collect();
        for points in [400, 1500] {
            let done = run(&mesh, &sample(points).with_keep_rims(true)).unwrap();
            let after: Vec<_> =
                edges_of(&done.mesh).into_iter().filter(|edge| edge.1 == 1).map(|edge| edge.0).collect();
            assert_eq!(after, boundary, "{shape}, {points}: {:?}", done.report.result.kept);
            assert_stays(&format!("{shape}, {points}"), &mesh, &done, |_| false);
        }
    }
}

#[test]
fn the_same_bits_on_all_threads_and_backends() {
    let mesh = Shape::Torus.build(2000);
    let part: Part = "box:-2,-2,-2,0.1,0.3,2".parse().unwrap();
    let options = sample(1500).with_keep(vec![part]);
    let of = |backend: &dyn Backend| remesh(&mesh, &options, backend, &mut (), &Token::default()).unwrap().mesh;
    let one = of(&Parallel::new(Some(1)).unwrap());
    assert!(of(&Parallel::new(Some(3)).unwrap()) == one);
    let serial = remesh(&mesh, &options, &Serial, &mut (), &Token::default()).unwrap();
    assert_stays("serial", &mesh, &serial, |t| within_box(&options.keep[0], t));
}

#[test]
fn attributes_and_regions_stay() {
    let mesh = Shape::Torus.build(2000);
    let labels: Vec<i64> = (0..mesh.facets().len()).map(|f| i64::from(mesh.corners(f)[0].x > 0.0)).collect();
    let mut attributes = Attributes::new(&mesh);
    attributes.set_regions(Regions::of_numbers(&labels).unwrap()).unwrap();
    let values = mesh.positions().iter().map(|p| (7.0 * p.x).sin()).collect();
    attributes.add_scalar(Scalar::new("wave", values)).unwrap();
    let done = run(&mesh, &sample(1200).with_attributes(attributes).with_keep(vec!["1".parse().unwrap()])).unwrap();
    let kept = done.report.result.kept.unwrap();
    assert_eq!(kept.facets - kept.further_facets, labels.iter().filter(|&&label| label == 1).count());
    let carried = done.attributes.unwrap();
    let after: Vec<i64> = carried.regions().unwrap().numbers().collect();
    assert_eq!(after.len(), done.mesh.facets().len());
    assert!(after[kept.facets..].iter().all(|&label| label == 0));
    assert!(after[..kept.facets].iter().filter(|&&label| label == 0).count() == kept.further_facets);
    // Edges are up to 0.15 long, and a chord of this wave is off by (7 · 0.15)² / 8.
    for (v, (p, value)) in done.mesh.positions().iter().zip(&carried.scalars()[0].values).enumerate() {
        assert!((value - (7.0 * p.x).sin()).abs() < if v < kept.vertices { 1e-300 } else { 0.2 }, "{v}: {value}");
    }
    for (p, place) in done.mesh.positions().iter().zip(&done.provenance) {
        let corners = mesh.corners(place.facet as usize);
        let there: DVec3 = (0..3).map(|k| corners[k] * place.barycentric[k]).sum();
        assert!(p.distance(there) < 0.05, "{p} {there}");
    }
}

#[test]
fn single_vertices_stay_where_they_are() {
    let mut random = Random::new(5);
    for shape in [Shape::Sphere, Shape::Plane, Shape::Block, Shape::Hills] {
        let mesh = shape.build(900);
        for (points, count) in [(150, 1), (300, 8), (1500, 40)] {
            let list: Indices = (0..count).map(|_| (random.unit() * mesh.positions().len() as f64) as u32).collect();
            let name = format!("{shape}, {points}, vertices:{list}");
            let done = run(&mesh, &sample(points).with_keep(vec![Part::Vertices(list.clone())])).unwrap();
            let places: BTreeSet<_> =
                (0..done.mesh.facets().len()).flat_map(|f| done.mesh.corners(f).map(bits)).collect();
            assert!(list.iter().all(|v| places.contains(&bits(mesh.positions()[v as usize]))), "{name}");
            let kept = done.report.result.kept.unwrap();
            assert_eq!(kept.single_vertices + kept.vertices.min(kept.further_facets), list.iter().count(), "{name}");
            assert_eq!(kept.further_facets, 0, "{name}");
            let [before, after] = [&done.report.input.topology, &done.report.result.topology];
            assert_eq!((after.euler, after.boundary_loops), (before.euler, before.boundary_loops), "{name}");
            assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{name}");
            let vertices = done.mesh.positions().len();
            assert!(vertices.abs_diff(points) * 50 <= points, "{name}: {vertices} vertices");
        }
    }
}

#[test]
fn vertices_and_lists_of_facets_stay_together() {
    let mesh = Shape::Torus.build(2000);
    let facets: Indices = (100..160).chain([7, 9]).collect();
    let (within, apart) = (mesh.facets()[110][0], mesh.facets()[1500][0]);
    let vertices = Part::Vertices([within, apart].into_iter().collect());
    let done = run(&mesh, &sample(900).with_keep(vec![Part::Facets(facets.clone()), vertices.clone()])).unwrap();
    let kept = done.report.result.kept.unwrap();
    assert_eq!((kept.facets - kept.further_facets, kept.single_vertices), (62, 1));
    let mut first = (0..kept.facets).map(|f| done.mesh.corners(f));
    assert!(facets.iter().all(|f| first.any(|corners| corners == mesh.corners(f as usize))), "in their order");
    assert!(done.mesh.positions().contains(&mesh.positions()[apart as usize]));
    // The first vertex is none of any facet.
    let (mut positions, facets) = mesh.clone().into_parts();
    positions.insert(0, DVec3::splat(9.0));
    let facets = facets.into_iter().map(|t| t.map(|v| v + 1)).collect();
    let more = TriMesh::new(positions, facets).unwrap();
    let refused = |mesh: &TriMesh, options: RemeshOptions| match run(mesh, &options) {
        Err(RemeshError::Part(error)) => error,
        other => panic!("{:?}", other.map(|done| done.report)),
    };
    let of = |vertex: u32| vec![Part::Vertices([vertex].into_iter().collect())];
    assert!(matches!(refused(&more, sample(900).with_keep(of(0))), PartError::NoSuchVertex { vertex: 0, .. }));
    assert!(matches!(refused(&mesh, sample(900).with_keep(of(5000))), PartError::NoSuchVertex { vertex: 5000, .. }));
    assert!(matches!(refused(&mesh, sample(900).with_only(vec![vertices])), PartError::VerticesAlone));
}

#[test]
fn what_cannot_be_is_refused() {
    let mesh = Shape::Sphere.build(500);
    let all: Part = "box:-2,-2,-2,2,2,2".parse().unwrap();
    assert!(matches!(run(&mesh, &sample(100).with_keep(vec![all.clone()])), Err(RemeshError::AllKept)));
    let none: Part = "sphere:9,9,9,1".parse().unwrap();
    assert!(matches!(run(&mesh, &sample(100).with_only(vec![none.clone()])), Err(RemeshError::AllKept)));
    assert!(run(&mesh, &sample(100).with_only(vec![none.clone(), all])).is_ok());
    let nothing = run(&mesh, &sample(100).with_keep(vec![none])).unwrap();
    assert!(nothing.report.warnings.iter().any(|warning| warning.code == "nothing_kept"));
    assert_eq!(nothing.mesh, run(&mesh, &sample(100)).unwrap().mesh, "what keeps nothing changes nothing");
    assert!(matches!(run(&mesh, &sample(100).with_keep(vec!["1".parse().unwrap()])), Err(RemeshError::Part(_))));
    let half: Part = "box:-2,-2,-2,0,2,2".parse().unwrap();
    let few = run(&mesh, &sample(20).with_keep(vec![half.clone()])).unwrap_err();
    assert!(matches!(few, RemeshError::TooFewForRims { points: 20, .. }), "{few}");
    let seeds = RemeshOptions::new(Seeds::Given(mesh.positions().to_vec())).with_keep(vec![half]);
    assert!(matches!(run(&mesh, &seeds), Err(RemeshError::KeptBesideSeeds)));
}

#[test]
fn vertices_of_facets_of_their_own_are_joined_and_sheets_face_as_before() {
    // As files that name no vertices have them.
    let torus = Shape::Torus.build(1200);
    let positions = (0..torus.facets().len()).flat_map(|f| torus.corners(f)).collect();
    let facets = (0..torus.facets().len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
    let loose = TriMesh::new(positions, facets).unwrap();
    let options = sample(900).with_keep(vec!["box:-2,-2,-2,0.037,2,2".parse().unwrap()]);
    let done = run(&loose, &options).unwrap();
    let used: BTreeSet<u32> = done.mesh.facets().iter().flatten().copied().collect();
    assert_eq!(used.len(), done.mesh.positions().len());
    assert_eq!(used.len(), done.mesh.positions().iter().map(|&p| bits(p)).collect::<BTreeSet<_>>().len());
    assert_stays("loose", &loose, &done, |t| t.iter().any(|p| p.x <= 0.037));

    // Three pages at one spine, each with its own way to face.
    let (mut positions, mut facets) = (Vec::new(), Vec::new());
    for page in 0..3 {
        let (sin, cos) = (f64::from(page) * std::f64::consts::TAU / 3.0).sin_cos();
        let first = positions.len() as u32;
        positions.extend((0..=10).flat_map(|i| (0..=10).map(move |j| (i, j))).map(|(i, j)| {
            let r = f64::from(i) / 10.0;
            DVec3::new(r * cos, r * sin, f64::from(j) / 10.0) + DVec3::ZERO
        }));
        for (i, j) in (0..10).flat_map(|i| (0..10).map(move |j| (i, j))) {
            let at = |i: u32, j: u32| first + 11 * i + j;
            facets.extend([[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)]]);
        }
    }
    let book = TriMesh::new(positions, facets).unwrap();
    for keep in [false, true] {
        let part = "box:-2,-2,0.35,2,2,0.75".parse().unwrap();
        let done = run(&book, &sample(400).with_only(vec![part]).with_keep_non_manifold(keep)).unwrap();
        let mut sides: BTreeMap<[[u64; 3]; 2], usize> = BTreeMap::new();
        for f in 0..done.mesh.facets().len() {
            let t = done.mesh.corners(f).map(bits);
            (0..3).for_each(|k| *sides.entry([t[k], t[(k + 1) % 3]]).or_default() += 1);
        }
        let spine = |side: &[[u64; 3]; 2]| side.iter().all(|p| f64::from_bits(p[0]).hypot(f64::from_bits(p[1])) < 1e-9);
        let odd = sides.iter().filter(|(side, count)| **count > 1 && !spine(side)).count();
        assert_eq!(odd, 0, "keep: {keep}");
    }
}

#[test]
fn what_would_tear_is_refused() {
    let cube = Shape::Block.build(12);
    let four = run(&cube, &sample(4).with_keep(vec![Part::Facets([0, 1].into_iter().collect())]));
    assert!(four.is_err(), "{:?}", four.map(|done| done.report.result.topology));
    // Two grids, of which one has vertices on the edges of the other.
    let grid = |n: u32, x: f64| {
        let positions: Vec<DVec3> = (0..=n)
            .flat_map(|i| {
                (0..=n).map(move |j| DVec3::new(x + f64::from(i) / f64::from(n), f64::from(j) / f64::from(n), 0.0))
            })
            .collect();
        let facets: Vec<[u32; 3]> = (0..n)
            .flat_map(|i| (0..n).map(move |j| (i * (n + 1) + j, (i + 1) * (n + 1) + j)))
            .flat_map(|(a, b)| [[a, b, a + 1], [b, b + 1, a + 1]])
            .collect();
        (positions, facets)
    };
    let ((mut positions, mut facets), (more, others)) = (grid(6, 0.0), grid(9, 1.0));
    let first = positions.len() as u32;
    positions.extend(more);
    facets.extend(others.iter().map(|t| t.map(|v| v + first)));
    let mesh = TriMesh::new(positions, facets).unwrap();
    assert!(run(&mesh, &sample(300)).is_ok());
    let part = "box:0,0,0,0.95,1,0".parse().unwrap();
    let torn = run(&mesh, &sample(300).with_keep(vec![part]));
    assert!(matches!(torn, Err(RemeshError::KeptAcrossJunction { .. })));
}

/// Facets here and there, drawn at random: one of `share`.
fn scattered(random: &mut Random, mesh: &TriMesh, share: usize) -> BTreeSet<u32> {
    let facets = mesh.facets().len();
    (0..facets / share).map(|_| random.below(facets) as u32).collect()
}

fn part(facets: &BTreeSet<u32>) -> Part {
    Part::Facets(facets.iter().copied().collect())
}

#[test]
fn scattered_facets_stay_and_few_others() {
    let random = &mut Random::new(11);
    for shape in [Shape::Sphere, Shape::Torus, Shape::Hills] {
        let mesh = shape.build(2000);
        let keep = scattered(random, &mesh, 40);
        let corners: BTreeSet<_> = keep.iter().map(|&f| mesh.corners(f as usize).map(bits)).collect();
        for points in [600, 1500] {
            let done = run(&mesh, &sample(points).with_keep(vec![part(&keep)])).unwrap();
            let name = format!("{shape}, {points}");
            assert_stays(&name, &mesh, &done, |t| corners.contains(&t.map(bits)));
            let kept = done.report.result.kept.unwrap();
            assert!(kept.further_facets <= corners.len() / 2, "{name}: {kept:?}");
        }
    }
}

#[test]
fn facets_without_room_stay_beside_what_stays() {
    let random = &mut Random::new(12);
    let mesh = Shape::Torus.build(2000);
    // Facets on their own, and a patch with vertices of its own.
    let only = vec![ball(random, &mesh), part(&scattered(random, &mesh, 20))];
    let done = run(&mesh, &sample(1000).with_only(only)).unwrap();
    let kept = done.report.result.kept.unwrap();
    assert!(kept.further_facets > 50 && kept.facets < 1990, "{kept:?}");
    assert!(done.mesh.positions().len().abs_diff(1000) <= 20, "{}", done.mesh.positions().len());
    assert!(done.report.topology_changes.is_empty());
}
