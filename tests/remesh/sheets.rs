//! Promise: sheets that touch are remeshed as if they were apart, none joined to another or torn; boundaries with other vertices on
//! either side are joined; a gap is named, and closed by a distance that is given.

use std::f64::consts::TAU;

use geometry::mesh::crossings::crossings;
use glam::{DMat3, DVec3, dvec3};
use tessera::mesh::attributes::{Attributes, Scalar};
use tessera::mesh::measure::topology;
use tessera::mesh::shapes::Shape;
use tessera::remesh::{Remesh, RemeshOptions, Seeds, Tolerance, remesh};
use tessera::rvd::Parallel;
use tessera::{DensityOptions, DensitySource, Token, TriMesh};

use crate::rough::{Random, book};

fn run(mesh: &TriMesh, options: &RemeshOptions) -> Remesh {
    remesh(mesh, options, &Parallel::new(Some(2)).unwrap(), &mut (), &Token::default()).unwrap()
}

fn points(points: usize) -> RemeshOptions {
    RemeshOptions::new(Seeds::Sample { points, seed: 0 })
}

/// Surfaces in one list. `join`: vertices in one place are one.
fn together(parts: &[TriMesh], join: bool) -> TriMesh {
    let (mut positions, mut facets): (Vec<DVec3>, Vec<[u32; 3]>) = Default::default();
    let mut known = std::collections::HashMap::new();
    for part in parts {
        let number: Vec<u32> = part
            .positions()
            .iter()
            .map(|&p| {
                let mut new = || {
                    positions.push(p);
                    positions.len() as u32 - 1
                };
                if join {
                    *known.entry((p + DVec3::ZERO).to_array().map(f64::to_bits)).or_insert_with(new)
                } else {
                    new()
                }
            })
            .collect();
        facets.extend(part.facets().iter().map(|t| t.map(|v| number[v as usize])));
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A box seen from outside, `n` cells along each edge.
fn cube(low: DVec3, size: DVec3, n: u32) -> TriMesh {
    let mut sides = Vec::new();
    for (axis, high) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
        let place = |k: u32| {
            let mut at = [0.0; 3];
            let share = |x: u32| f64::from(x) / f64::from(n);
            (at[axis], at[(axis + 1) % 3], at[(axis + 2) % 3]) =
                (f64::from(high), share(k % (n + 1)), share(k / (n + 1)));
            low + size * DVec3::from_array(at)
        };
        let at = |x: u32, y: u32| y * (n + 1) + x;
        let quads = (0..n).flat_map(|x| (0..n).map(move |y| [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)]));
        let facets = quads.flat_map(|[a, b, c, d]| {
            let [b, d] = if high == 1 { [b, d] } else { [d, b] };
            [[a, b, c], [a, c, d]]
        });
        sides.push(TriMesh::new((0..(n + 1) * (n + 1)).map(place).collect(), facets.collect()).unwrap());
    }
    together(&sides, true)
}

fn turned(mesh: &TriMesh, by: DMat3) -> TriMesh {
    TriMesh::new(mesh.positions().iter().map(|&p| by * p).collect(), mesh.facets().to_vec()).unwrap()
}

/// Solids that touch in corners and along edges: the result has each, whole, at its place, and nothing crosses.
#[test]
fn solids_that_touch_stay_solids() {
    let mut random = Random::new(7);
    for (k, corners) in [
        &[[0, 0, 0], [1, 1, 1]][..],
        &[[0, 0, 0], [1, 1, 0]],
        &[[0, 0, 0], [1, 1, 0], [2, 2, 1]],
        &[[1, 1, 1], [0, 0, 1], [2, 0, 1], [1, 2, 2]],
    ]
    .into_iter()
    .enumerate()
    {
        let size = dvec3(1.0 + random.unit(), 1.0 + random.unit(), 1.0 + random.unit());
        let solids: Vec<TriMesh> =
            corners.iter().map(|c| cube(size * DVec3::from_array(c.map(f64::from)), size, 5)).collect();
        // Not along the axes, where the file's vertices are shared, and along them, where they are not.
        let turn = if k % 2 == 0 { DMat3::from_rotation_z(0.3) * DMat3::from_rotation_x(0.7) } else { DMat3::IDENTITY };
        for join in [true, false] {
            let mesh = turned(&together(&solids, join), turn);
            let asked = 250 * corners.len();
            let done = run(&mesh, &points(asked));
            let name = format!("{corners:?}, {join}");
            let (of, n) = (done.report.result.topology, corners.len());
            assert_eq!((of.components, of.euler, of.boundary_edges), (n, 2 * n as i64, 0), "{name}");
            assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{name}");
            let quality = done.report.result.quality.unwrap();
            assert!(quality.hausdorff_percent < 0.01, "{name}: {}", quality.hausdorff_percent);
            assert!((done.mesh.area() / mesh.area() - 1.0).abs() < 1e-3, "{name}");
            assert!(done.mesh.positions().len().abs_diff(asked) <= asked / 50, "{name}");
            assert!(done.report.topology_changes.is_empty(), "{name}: {:?}", done.report.topology_changes);
            assert_eq!(done.report.input.sheets, n, "{name}");
        }
    }
}

/// A wall that stands on a floor, touching it in one vertex or along a line: neither is torn.
#[test]
fn a_sheet_that_stands_on_another_tears_nothing() {
    let floor = Shape::Plane.build(800);
    let (low, high) = floor.bounds();
    let row = floor.positions().iter().filter(|p| (p.y - high.y).abs() < 1e-12).count();
    let n = floor.positions().len() / row;
    // Through the floor's vertices nearest to its middle.
    let along: Vec<DVec3> = (0..row).map(|k| floor.positions()[(n / 2) * row + k]).collect();
    assert!(along.iter().all(|p| (p.y - along[0].y).abs() < 1e-12) && along.len() > 5);
    for touching in [1, along.len()] {
        let lift = |k: usize| if k < touching { 0.0 } else { 0.3 * (high.x - low.x) };
        let foot: Vec<DVec3> = along.iter().enumerate().map(|(k, &p)| p + DVec3::Z * lift(k)).collect();
        let mut wall: Vec<DVec3> = foot.clone();
        wall.extend(foot.iter().map(|&p| p + DVec3::Z * 0.5 * (high.x - low.x)));
        let m = foot.len() as u32;
        let facets = (0..m - 1).flat_map(|k| [[k, k + 1, m + k + 1], [k, m + k + 1, m + k]]).collect();
        let wall = TriMesh::new(wall, facets).unwrap();
        let mesh = together(&[floor.clone(), wall.clone()], true);
        let done = run(&mesh, &points(1200));
        let of = done.report.result.topology;
        assert_eq!((of.components, of.euler, of.non_manifold_edges), (2, 2, 0), "{touching}");
        let quality = done.report.result.quality.unwrap();
        // As if the wall stood a little higher.
        let raised = wall.positions().iter().map(|&p| p + DVec3::Z * 1e-3 * (high.x - low.x)).collect();
        let raised = TriMesh::new(raised, wall.facets().to_vec()).unwrap();
        let apart = run(&together(&[floor.clone(), raised], false), &points(1200)).report.result.quality.unwrap();
        let bound = 1.5 * apart.hausdorff_percent + 0.01;
        assert!(quality.hausdorff_percent < bound, "{touching}: {} {bound}", quality.hausdorff_percent);
        assert!((done.mesh.area() / mesh.area() - 1.0).abs() < 1e-3, "{touching}");
        assert_eq!(done.report.result.repair.non_manifold_facets, 0, "{touching}");
    }
}

/// Pages that meet in a spine, all oriented outwards: two of them are one sheet, and all sheets have the spine's vertices.
#[test]
fn sheets_that_meet_in_a_curve_have_its_vertices_in_common() {
    for pages in [3, 4, 6] {
        let done = run(&book(pages, 8, false), &points(150 * pages));
        let sheets = pages.div_ceil(2);
        assert_eq!((done.report.input.sheets, done.report.result.topology.components), (sheets, sheets), "{pages}");
        let on_spine = |p: &&DVec3| p.truncate().length() < 1e-12;
        let mut heights: Vec<f64> = done.mesh.positions().iter().filter(on_spine).map(|p| p.z).collect();
        heights.sort_by(f64::total_cmp);
        assert!(heights.len() > 5 * sheets && heights.len().is_multiple_of(sheets), "{pages}: {heights:?}");
        assert!(heights.chunks(sheets).all(|same| same.iter().all(|z| *z == same[0])), "{pages}: {heights:?}");
        assert_eq!(crossings(&done.mesh, &Token::default()).unwrap().count, 0, "{pages}");
    }
}

/// What the caller says of vertices and edges holds where vertices have copies.
#[test]
fn sizes_creases_and_attributes_are_those_of_every_sheet() {
    let solids = [cube(DVec3::ZERO, DVec3::ONE, 6), cube(dvec3(1.0, 1.0, 0.0), DVec3::ONE, 6)];
    let mesh = together(&solids, true);
    let scalar = mesh.positions().iter().map(|p| p.x + 10.0 * p.y).collect();
    let mut attributes = Attributes::new(&mesh);
    attributes.add_scalar(Scalar::new("place", scalar)).unwrap();
    let source = DensitySource::Sizes(mesh.positions().iter().map(|p| 0.1 + 0.05 * p.z).collect());
    // The shared edge, which runs along z.
    let at = |z: f64| mesh.positions().iter().position(|p| p.distance(dvec3(1.0, 1.0, z)) < 1e-12).unwrap() as u32;
    let options = points(800)
        .with_density(DensityOptions { source, ..DensityOptions::default() })
        .with_creases(vec![[at(0.0), at(1.0 / 6.0)]])
        .with_attributes(attributes);
    let done = run(&mesh, &options);
    assert_eq!(done.report.result.topology.components, 2);
    let carried = done.attributes.unwrap();
    for (p, value) in done.mesh.positions().iter().zip(&carried.scalars()[0].values) {
        assert!((p.x + 10.0 * p.y - value).abs() < 1e-3, "{p} {value}");
    }
    for (p, place) in done.mesh.positions().iter().zip(&done.provenance) {
        let corners = mesh.corners(place.facet as usize);
        let at: DVec3 = (0..3).map(|k| corners[k] * place.barycentric[k]).sum();
        assert!(at.distance(*p) < 1e-3);
    }
}

/// A box of plates that are divided differently, with or without a gap between them.
fn plates(counts: [u32; 6], gap: f64) -> TriMesh {
    let boxes: Vec<TriMesh> = counts.iter().map(|&n| cube(DVec3::ZERO, dvec3(1.0, 1.2, 1.4), n)).collect();
    let side = |(k, of): (usize, &TriMesh)| {
        let each = of.facets().len() / 6;
        let facets = of.facets()[k * each..(k + 1) * each].to_vec();
        let out = DVec3::AXES[k / 2] * if k % 2 == 0 { -gap } else { gap };
        TriMesh::new(of.positions().iter().map(|&p| p + out).collect(), facets).unwrap()
    };
    together(&boxes.iter().enumerate().map(side).collect::<Vec<_>>(), false)
}

#[test]
fn boundaries_with_other_vertices_are_joined() {
    for counts in [[1, 2, 3, 4, 5, 6], [9, 2, 7, 3, 5, 1]] {
        let mesh = plates(counts, 0.0);
        let done = run(&mesh, &points(700));
        let of = topology(&done.mesh);
        assert_eq!((of.components, of.euler, of.boundary_edges), (1, 2, 0), "{counts:?}");
        assert!(done.report.result.quality.unwrap().hausdorff_percent < 0.01, "{counts:?}");
        assert!(done.report.input.divided_edges > 0);
        assert!(done.report.warnings.iter().any(|warning| warning.code == "divided_edges"));
    }
}

#[test]
fn a_gap_is_named_and_closed_by_its_distance() {
    let gap = 2e-4;
    let mesh = plates([4, 4, 4, 4, 4, 4], gap);
    let open = run(&mesh, &points(600));
    assert!(topology(&open.mesh).boundary_edges > 0);
    let input = &open.report.input;
    assert!(input.gap_edges > 40 && (gap..2.0 * gap).contains(&input.gap_distance), "{input:?}");
    let told = open.report.warnings.iter().find(|warning| warning.code == "gap_edges").unwrap();
    assert!(told.message.contains("`weld`"), "{}", told.message);
    let (low, high) = mesh.bounds();
    let percent = 100.0 * 1.01 * input.gap_distance / (high - low).length();
    for weld in [Tolerance::Length(1.01 * input.gap_distance), Tolerance::DiagonalPercent(percent)] {
        let closed = run(&mesh, &points(600).with_weld(weld));
        let of = topology(&closed.mesh);
        assert_eq!((of.components, of.euler, of.boundary_edges), (1, 2, 0), "{weld:?}");
        assert_eq!(closed.report.input.gap_edges, 0);
    }
}

/// Plates whose sides have other vertices, a gap apart: the distance that the warning names joins them as it says.
#[test]
fn the_distance_of_welding_that_is_named_joins() {
    let mut random = Random::new(3);
    let mut closed = 0;
    for k in 0..12 {
        let counts = [0; 6].map(|_| 1 + random.below(9) as u32);
        let gap = 10f64.powf(-5.5 + 2.0 * random.unit());
        let mesh = plates(counts, gap);
        let open = run(&mesh, &points(700));
        let input = &open.report.input;
        let named = open.report.warnings.iter().find(|warning| warning.code == "gap_edges").unwrap();
        let name = format!("{k}: {counts:?} {gap:.2e}: {}", named.message);
        assert!(input.gap_weld > 0.0, "{name}");
        // As a reader of the text gives it.
        let (_, rest) = named.message.split_once("`weld` of ").unwrap();
        let weld: f64 = rest.split(' ').next().unwrap().parse().unwrap();
        let done = run(&mesh, &points(700).with_weld(Tolerance::Length(weld)));
        assert_eq!(done.report.input.gap_edges, input.gap_edges_left, "{name}");
        if input.gap_edges_left == 0 {
            let of = topology(&done.mesh);
            assert_eq!((of.components, of.euler, of.boundary_edges), (1, 2, 0), "{name}");
            closed += 1;
        }
    }
    assert!(closed >= 10, "{closed} of 12");
}

/// `pages` around a circle, each of which ends where the one `turns` further began.
fn twisted_book(pages: usize, turns: usize, n: usize) -> TriMesh {
    let rows = n / 6;
    let number = |k: usize, page: usize, row: usize| {
        let (k, page) = if k == n { (0, (page + turns) % pages) } else { (k, page) };
        (if row == 0 { k } else { n + (k * pages + page) * rows + row - 1 }) as u32
    };
    let mut positions = vec![DVec3::ZERO; n + n * pages * rows];
    let mut facets = Vec::new();
    for (k, page) in (0..n).flat_map(|k| (0..pages).map(move |page| (k, page))) {
        let share = k as f64 / n as f64;
        let around = TAU * share;
        let tilt = TAU * (page as f64 + turns as f64 * share) / pages as f64;
        let out = dvec3(around.cos(), around.sin(), 0.0);
        for row in 0..=rows {
            let r = 0.5 * row as f64 / rows as f64;
            positions[number(k, page, row) as usize] = out + r * (tilt.cos() * out + tilt.sin() * DVec3::Z);
            if row < rows {
                let at = |k, row| number(k, page, row);
                facets.push([at(k, row), at(k, row + 1), at(k + 1, row + 1)]);
                facets.push([at(k, row), at(k + 1, row + 1), at(k + 1, row)]);
            }
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// Pages that go on in each other around their spine: one sheet that meets itself along a closed curve.
#[test]
fn a_sheet_that_meets_itself_along_a_closed_curve_is_kept() {
    for (pages, turns) in [(3, 1), (3, 2), (4, 1), (4, 2), (5, 2), (3, 0)] {
        let mesh = twisted_book(pages, turns, 60);
        let options = points(300 * pages).with_keep_non_manifold(true);
        let done = run(&mesh, &options);
        let name = format!("{pages} pages, {turns} turns");
        let (given, of) = (topology(&mesh), done.report.result.topology);
        assert_eq!((of.components, of.euler), (given.components, given.euler), "{name}");
        assert!(of.non_manifold_edges > 20, "{name}: {of:?}");
        assert_eq!(done.report.result.crossings.as_ref().map_or(0, |crossings| crossings.count), 0, "{name}");
        let area = done.mesh.area() / mesh.area();
        assert!((area - 1.0).abs() < 0.01, "{name}: {area}");
    }
}

/// Where smooth sheets touch, they have a common vertex if they are kept, and each its own if they are cut.
#[test]
fn sheets_that_touch_in_a_vertex_have_it() {
    let sphere = Shape::Sphere.build(600);
    let top = sphere.positions().iter().copied().enumerate().max_by(|a, b| a.1.z.total_cmp(&b.1.z)).unwrap().0;
    let at = sphere.positions()[top];
    let other =
        TriMesh::new(sphere.positions().iter().map(|p| 2.0 * at - *p).collect(), sphere.facets().to_vec()).unwrap();
    let flipped = other.facets().iter().map(|&[a, b, c]| [a, c, b]).collect();
    let other = TriMesh::new(other.positions().to_vec(), flipped).unwrap();
    let mesh = together(&[sphere, other], true);
    for (keep, count, euler) in [(true, 1, 3), (false, 2, 4)] {
        let done = run(&mesh, &points(500).with_keep_non_manifold(keep));
        assert_eq!(done.mesh.positions().iter().filter(|p| **p == at).count(), count);
        assert_eq!(done.report.result.topology.euler, euler);
    }
}

/// The walls between cells of a grid that have other labels, 0 outside; `n` cells along each side, walls of `s` x `s` squares.
fn labelled_cells(random: &mut Random, n: usize, s: u32) -> TriMesh {
    let label: Vec<usize> = (0..n * n * n).map(|_| random.below(4)).collect();
    let of = |cell: [i64; 3]| {
        let inside = cell.iter().all(|&k| (0..n as i64).contains(&k));
        if inside { cell.iter().fold(0, |at, &k| at * n + k as usize) } else { usize::MAX }
    };
    let of = |cell| label.get(of(cell)).copied().unwrap_or(0);
    let mut walls = Vec::new();
    let n = n as i64;
    for (axis, k) in (0..3).flat_map(|axis| (0..(n + 1).pow(3)).map(move |k| (axis, k))) {
        let cell = [k % (n + 1) - 1, k / (n + 1) % (n + 1) - 1, k / (n + 1) / (n + 1) - 1];
        let mut next = cell;
        next[axis] += 1;
        if of(cell) == of(next) {
            continue;
        }
        let mut at = DVec3::from_array(cell.map(|k| k as f64));
        at[axis] += 1.0;
        let [mut u, mut v] = [DVec3::AXES[(axis + 1) % 3], DVec3::AXES[(axis + 2) % 3]];
        if of(cell) == 0 {
            (u, v) = (v, u);
        }
        let place = |k: u32| at + (u * f64::from(k % (s + 1)) + v * f64::from(k / (s + 1))) / f64::from(s);
        let number = |x: u32, y: u32| y * (s + 1) + x;
        let quads = (0..s * s).map(|k| (k % s, k / s));
        let facets = quads.flat_map(|(x, y)| {
            let [a, b, c, d] = [number(x, y), number(x + 1, y), number(x + 1, y + 1), number(x, y + 1)];
            [[a, b, c], [a, c, d]]
        });
        walls.push(TriMesh::new((0..(s + 1) * (s + 1)).map(place).collect(), facets.collect()).unwrap());
    }
    together(&walls, true)
}

/// Cells with labels that are left aside: where one place of many is noise, or plane pieces are small, the others are divided.
#[test]
fn rare_noise_and_small_plane_pieces_do_not_keep_sheets_whole() {
    let mut random = Random::new(30);
    let models: Vec<TriMesh> = (0..4).map(|_| labelled_cells(&mut random, 4, 4)).collect();
    let whole = models.iter().filter(|mesh| {
        let done = run(mesh, &points(700));
        let [given, of] = [mesh, &done.mesh].map(topology);
        let is_whole = (of.euler, of.components, of.boundary_edges) == (given.euler, given.components, 0);
        is_whole && (done.mesh.area() / mesh.area() - 1.0).abs() < 1e-3
    });
    assert_eq!(whole.count(), 4);
}

/// Cells with labels and few points: every wall is there, with all of its edges.
#[test]
fn cells_with_labels_are_whole_with_few_points() {
    let mut random = Random::new(11);
    for k in 0..6 {
        let mesh = labelled_cells(&mut random, 2, 6);
        for (count, keep) in [(100, true), (150, true), (250, true), (150, false), (600, false)] {
            let done = run(&mesh, &points(count).with_keep_non_manifold(keep));
            let name = format!("{k}, {count} points, keep {keep}");
            let [given, of] = [&mesh, &done.mesh].map(topology);
            assert_eq!((of.euler, of.components, of.boundary_edges), (given.euler, given.components, 0), "{name}");
            assert!((done.mesh.area() / mesh.area() - 1.0).abs() < 1e-3, "{name}");
            assert_eq!(done.report.features.dropped_curves, 0, "{name}");
        }
    }
}
