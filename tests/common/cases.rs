//! Small diagrams made of bytes, and what must hold of each.
//!
//! Purpose: [`Case::from_bytes`] makes a mesh and seeds of any bytes, and [`check`] computes their
//! diagram in every way on the CPU and compares (`properties` has it for libFuzzer and for the tests).
//! Invariant: the same bytes give the same case everywhere; bytes that are missing read as 0. Most
//! coordinates lie on a coarse lattice, so that ties, twins and parallel bisectors are the rule.
//! Must not know: files, the service.
#![allow(dead_code)]

pub mod alike;

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::remesh::{RemeshError, RemeshOptions, Seeds, remesh};
use tessera::rvd::facet_edge;
use tessera::rvd::{Backend, Capacities, CellSums, PassStats, PieceBatch, SessionOptions, Surface};
use tessera::rvd::{Parallel, Serial};
use tessera::token::Token;

/// A surface, seeds in its unit frame, and capacities that make pairs run out of everything.
#[derive(Clone, Debug)]
pub struct Case {
    pub mesh: TriMesh,
    pub weights: Option<Vec<f64>>,
    pub seeds: Vec<DVec3>,
    pub tiny: Capacities,
}

/// Says what is wrong and returns.
macro_rules! ensure {
    ($holds:expr, $($text:tt)+) => {
        let holds: bool = $holds;
        if !holds {
            return Err(format!($($text)+));
        }
    };
}

/// Reads numbers off bytes; zeros follow the last one.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn byte(&mut self) -> u8 {
        match self.0.split_first() {
            Some((&first, rest)) => {
                self.0 = rest;
                first
            }
            None => 0,
        }
    }

    /// Below `n`, at most 256.
    fn below(&mut self, n: usize) -> usize {
        usize::from(self.byte()) % n
    }

    /// In [0, 1): any value.
    fn unit(&mut self) -> f64 {
        let bits = (0..4).fold(0u32, |sum, _| sum << 8 | u32::from(self.byte()));
        f64::from(bits) / 2f64.powi(32)
    }

    /// In [0, 1], on a lattice of `steps` a side, or anywhere with 0.
    fn coordinate(&mut self, steps: usize) -> f64 {
        if steps == 0 { self.unit() } else { self.below(steps + 1) as f64 / steps as f64 }
    }

    fn point(&mut self, steps: usize, flat: bool) -> DVec3 {
        let (x, y) = (self.coordinate(steps), self.coordinate(steps));
        dvec3(x, y, if flat { 0.0 } else { self.coordinate(steps) })
    }
}

/// Lattices: powers of two, whose points the unit frame holds exactly; thirds and sevenths, which it rounds.
const LATTICES: [usize; 8] = [1, 2, 4, 8, 16, 3, 7, 0];

impl Case {
    /// The case of these bytes, or `None` if they name no surface with an area.
    pub fn from_bytes(data: &[u8]) -> Option<Self> {
        let mut bytes = Bytes(data);
        let (positions, facets) = surface(&mut bytes);
        let mesh = TriMesh::new(positions, facets).ok()?;
        let weights = (bytes.below(4) == 0).then(|| {
            let mut weights: Vec<f64> = mesh.positions().iter().map(|_| bytes.below(4) as f64).collect();
            weights[mesh.facets()[0][0] as usize] = 1.0;
            weights
        });
        let tiny = Capacities::default()
            .with_neighbours(bytes.below(5))
            .with_polygon(bytes.below(7))
            .with_cells(bytes.below(3))
            .with_pairs_percent(1 + bytes.below(100));
        let seeds = seeds(&mut bytes, &Surface::new(&mesh, weights.as_deref()).ok()?);
        Some(Self { mesh, weights, seeds, tiny })
    }

    pub fn surface(&self) -> Arc<Surface> {
        Arc::new(Surface::new(&self.mesh, self.weights.as_deref()).unwrap())
    }
}

/// Closed, open or arbitrary: what is a manifold in the first place, and what is not.
fn surface(bytes: &mut Bytes) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let steps = LATTICES[bytes.below(LATTICES.len())];
    let (mut positions, facets) = match bytes.below(4) {
        0 => {
            let flat = bytes.below(2) == 0;
            let corners = 3 + bytes.below(8);
            let positions: Vec<DVec3> = (0..corners).map(|_| bytes.point(steps, flat)).collect();
            let mut corner = || bytes.below(corners) as u32;
            let count = 1 + corner() as usize * 2;
            (positions, (0..count).map(|_| [corner(), corner(), corner()]).collect())
        }
        1 => grid(bytes),
        2 => octahedron(bytes.below(3)),
        // Triangles of their own: seams, double facets, facets turned over.
        _ => {
            let count = 1 + bytes.below(8);
            let flat = bytes.below(2) == 0;
            let positions = (0..3 * count).map(|_| bytes.point(steps, flat)).collect();
            (positions, (0..count as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect())
        }
    };
    // A few vertices moved: by a lattice step, by next to nothing, or onto another one.
    for _ in 0..bytes.below(3) {
        let (v, w) = (bytes.below(positions.len()), bytes.below(positions.len()));
        positions[v] = match bytes.below(4) {
            0 => positions[v] + 0.25 * bytes.point(4, false),
            1 => positions[v] + 2f64.powi(-30 - bytes.below(25) as i32) * bytes.point(2, false),
            2 => positions[w] + 2f64.powi(-(bytes.below(55) as i32)) * bytes.point(2, false),
            _ => positions[w],
        };
    }
    // The caller's units and offset; powers of two, so that the lattice stays one.
    let scale = 2f64.powi([0, 0, 0, 100, -100][bytes.below(5)]);
    let offset = [0.0, 0.0, 64.0, -1048576.0][bytes.below(4)];
    (positions.into_iter().map(|p| (p + DVec3::splat(offset)) * scale).collect(), facets)
}

/// A square grid of up to 3 by 3, flat or folded.
fn grid(bytes: &mut Bytes) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let (side, fold) = (1 + bytes.below(3) as u32, bytes.below(3) as f64 * 0.25);
    let at = |x: u32, y: u32| dvec3(f64::from(x), f64::from(y), fold * f64::from((x + y) % 2)) / f64::from(side);
    let positions = (0..(side + 1) * (side + 1)).map(|k| at(k % (side + 1), k / (side + 1))).collect();
    let mut facets = Vec::new();
    for k in (0..side * (side + 1)).filter(|k| k % (side + 1) != side) {
        let (a, b, c, d) = (k, k + 1, k + side + 2, k + side + 1);
        facets.extend(if bytes.below(2) == 0 { [[a, b, c], [a, c, d]] } else { [[a, b, d], [b, c, d]] });
    }
    (positions, facets)
}

/// A closed surface: an octahedron whose edges are halved up to twice, not rounded, so that facets share planes.
fn octahedron(depth: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut positions = [DVec3::X, DVec3::Y, DVec3::Z].into_iter().flat_map(|p| [p, -p]).collect::<Vec<_>>();
    let mut facets = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    for _ in 0..depth {
        let mut middles = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                positions.push(0.5 * (positions[a as usize] + positions[b as usize]));
                positions.len() as u32 - 1
            })
        };
        let quarter = |[a, b, c]: [u32; 3]| {
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        };
        facets = facets.into_iter().flat_map(quarter).collect();
    }
    (positions, facets)
}

/// One to about thirty seeds, unit frame, in all the places where ties are.
fn seeds(bytes: &mut Bytes, surface: &Surface) -> Vec<DVec3> {
    let steps = LATTICES[bytes.below(LATTICES.len())];
    let count = [1, 2, 3, 4, 6, 8, 12, 20, 30][bytes.below(9)];
    let flat = bytes.below(3) == 0;
    let mut seeds: Vec<DVec3> = Vec::with_capacity(count);
    for _ in 0..count {
        let lattice = bytes.point(steps, flat) - if flat { dvec3(0.5, 0.5, 0.0) } else { DVec3::splat(0.5) };
        let corners = surface.facets()[bytes.below(surface.facets().len())].map(|v| surface.positions()[v as usize]);
        let before = seeds.get(bytes.below(count)).copied();
        seeds.push(match (bytes.below(16), before) {
            (0, _) => corners[0],
            (1, _) => 0.5 * (corners[0] + corners[1]),
            (2, _) => (corners[0] + corners[1] + corners[2]) / 3.0,
            (3, Some(p)) => p,
            // The nearest neighbours that the grid of positions allows.
            (4, Some(p)) => p + 2f64.powi(-52) * (bytes.point(2, false) * 2.0 - DVec3::ONE),
            (5, Some(p)) => p + 2f64.powi(-10 - bytes.below(40) as i32) * bytes.point(2, false),
            (6, _) => lattice * 10f64.powi(bytes.below(7) as i32),
            // Mirror images: their bisector runs through vertices and along edges.
            (7, Some(p)) => 2.0 * corners[0] - p,
            (8, Some(p)) => corners[0] + corners[1] - p,
            (9, _) => bytes.point(0, false) - DVec3::splat(0.5),
            (10, _) => corners[0].lerp(corners[1], bytes.unit()),
            _ => lattice,
        });
    }
    for p in &mut seeds {
        *p = p.clamp(DVec3::splat(-1e6), DVec3::splat(1e6));
    }
    seeds
}

/// All that one session says.
pub fn everything(
    backend: &dyn Backend,
    surface: &Arc<Surface>,
    seeds: &[DVec3],
    capacities: Capacities,
) -> Result<(CellSums, PieceBatch, PassStats), String> {
    let options = SessionOptions::new(seeds.len()).with_capacities(capacities);
    let (mut sums, mut pieces) = (CellSums::default(), PieceBatch::default());
    let flag = Token::default();
    let mut work = || {
        let mut session = backend.session(Arc::clone(surface), options)?;
        session.set_seeds(seeds)?;
        let stats = session.sums(&mut sums, &flag)?;
        session.pieces(0..surface.facets().len() as u32, &mut pieces, &flag)?;
        Ok(stats)
    };
    let stats = work().map_err(|e: tessera::rvd::RvdError| format!("{}: {e}", backend.kind().name()))?;
    Ok((sums, pieces, stats))
}

/// The sums of a session that found its first cells for other seeds before: these in reverse, less one.
fn reused(case: &Case, surface: &Arc<Surface>, parallel: &Parallel) -> Result<CellSums, String> {
    let text = |e: tessera::rvd::RvdError| format!("reused: {e}");
    let mut session = parallel.session(Arc::clone(surface), SessionOptions::new(case.seeds.len())).map_err(text)?;
    let mut sums = CellSums::default();
    let other: Vec<DVec3> = case.seeds.iter().rev().take(case.seeds.len().max(2) - 1).copied().collect();
    for seeds in [&other, &case.seeds] {
        session.set_seeds(seeds).map_err(text)?;
        session.sums(&mut sums, &Token::default()).map_err(text)?;
    }
    Ok(sums)
}

/// The sums of a session whose seeds came nearer and nearer by steps of `by` and less, each in a direction of its own; but
/// for one that comes from afar in the last step, one that was afar in the step before, and the last one, which is new.
fn moved(case: &Case, surface: &Arc<Surface>, parallel: &Parallel, by: f64) -> Result<CellSums, String> {
    let text = |e: tessera::rvd::RvdError| format!("moved: {e}");
    let n = case.seeds.len();
    let mut session = parallel.session(Arc::clone(surface), SessionOptions::new(n)).map_err(text)?;
    let mut sums = CellSums::default();
    for left in [3.0, 2.0, 1.5, 1.25, 1.0, 0.5, 0.0] {
        let away = |k: usize| dvec3((k as f64).sin(), (k as f64 * 1.7).cos(), (k as f64 * 2.3).sin());
        let afar = |k: usize| k == n / 2 && left > 0.0 || k == n / 3 && left == 0.5;
        let offset = |k: usize| left * by * away(k) + if afar(k) { dvec3(0.13, -0.07, 0.05) } else { DVec3::ZERO };
        let seeds = case.seeds.iter().enumerate().map(|(k, &p)| p + offset(k));
        let seeds: Vec<DVec3> = seeds.map(|p| p.clamp(DVec3::splat(-1e6), DVec3::splat(1e6))).collect();
        let count = if left > 0.0 { (n - 1).max(1) } else { n };
        session.set_seeds(&seeds[..count]).map_err(text)?;
        session.sums(&mut sums, &Token::default()).map_err(text)?;
    }
    Ok(sums)
}

/// Everything that must hold of a case on the CPU.
///
/// # Errors
/// What does not.
pub fn check(case: &Case, parallel: &Parallel) -> Result<(), String> {
    let surface = case.surface();
    let want = everything(&Serial, &surface, &case.seeds, Capacities::default())?;
    let all: [(&str, &dyn Backend, Capacities); 3] = [
        ("serial with tiny capacities", &Serial, case.tiny),
        ("parallel", parallel, Capacities::default()),
        ("parallel with tiny capacities", parallel, case.tiny),
    ];
    // Strips as wide as a vertex may be off, along all sides of all pieces.
    let edges: f64 = (0..surface.facets().len()).map(|f| longest(&surface, f)).sum();
    let slack = 4.0 * rounding(&case.seeds) * edges * case.seeds.len() as f64;
    let far = 2.0 + case.seeds.iter().map(|p| p.length()).fold(0.0, f64::max);
    for (who, backend, capacities) in all {
        let got = everything(backend, &surface, &case.seeds, capacities)?;
        if backend.threads() == 1 {
            ensure!(got.0 == want.0, "sums of {who} differ");
        } else if let Some(what) = alike::unlike(&got.0, &want.0, slack, far) {
            return Err(format!("sums of {who} differ: {what}"));
        }
        ensure!(got.1 == want.1, "pieces of {who} differ");
        ensure!(got.2.pairs == want.2.pairs, "pairs of {who} differ");
    }
    let fresh = everything(parallel, &surface, &case.seeds, Capacities::default())?;
    let again = reused(case, &surface, parallel)?;
    ensure!(again == fresh.0, "sums of a session that had other seeds before differ");
    for by in [1e-2, 1e-4, 1e-9] {
        ensure!(moved(case, &surface, parallel, by)? == fresh.0, "sums after moves by {by:e} differ");
    }
    let seeds: Vec<DVec3> = case.seeds.iter().map(|&p| geometry::rvd::surface::snap(p)).collect();
    well_formed(&surface, &seeds, &want.1)?;
    tiles(&surface, &seeds, &want)?;
    nearest(&surface, &seeds, &want.1)?;
    remeshes(case, parallel)
}

/// How far a position may be off, unit frame: it is kept relative to its seed, so this grows with the
/// distance of the farthest one. A vertex is placed with some ten roundings (`rvd::clip`, `MAX_SLIP`).
fn rounding(seeds: &[DVec3]) -> f64 {
    let far = seeds.iter().map(|p| p.length()).fold(1.0, f64::max);
    (1e-11f64 + 16.0 * f64::EPSILON) * far
}

fn well_formed(surface: &Surface, seeds: &[DVec3], pieces: &PieceBatch) -> Result<(), String> {
    let key = |i: usize| (pieces.facet[i], pieces.seed[i]);
    for i in 0..pieces.len() {
        let ((f, s), range) = (key(i), pieces.vertices(i));
        ensure!(i == 0 || key(i - 1) < key(i), "piece {i} is out of order");
        ensure!(range.len() >= 3, "piece {i} has {} vertices", range.len());
        ensure!(!surface.skips(f as usize), "piece {i} lies in facet {f}, which has no area");
        let first = seeds.iter().position(|p| *p == seeds[s as usize]);
        ensure!(first == Some(s as usize), "piece {i} belongs to seed {s}, a later duplicate");
        for v in range {
            ensure!(pieces.position[v].is_finite(), "piece {i} has the vertex {}", pieces.position[v]);
            let label = pieces.opposite[v];
            ensure!(
                facet_edge(label).is_some() || (label != s && (label as usize) < seeds.len()),
                "piece {i} has the label {label}"
            );
        }
    }
    Ok(())
}

fn longest(surface: &Surface, f: usize) -> f64 {
    let [a, b, c] = surface.facets()[f].map(|v| surface.positions()[v as usize]);
    a.distance(b).max(b.distance(c)).max(c.distance(a))
}

/// The pieces cover every facet once, and the sums are theirs.
fn tiles(surface: &Surface, seeds: &[DVec3], got: &(CellSums, PieceBatch, PassStats)) -> Result<(), String> {
    let (sums, pieces, stats) = got;
    ensure!(stats.pairs == pieces.len() as u64, "{} pairs and {} pieces", stats.pairs, pieces.len());
    let mut covered = vec![0.0; surface.facets().len()];
    let mut cells = vec![0.0; seeds.len()];
    for i in 0..pieces.len() {
        covered[pieces.facet[i] as usize] += pieces.area(i);
        cells[pieces.seed[i] as usize] += pieces.area(i);
    }
    let rounding = rounding(seeds);
    let mut slack = 0.0;
    for (f, &covered) in covered.iter().enumerate().filter(|&(f, _)| !surface.skips(f)) {
        // A strip as wide as a vertex may be off, along all sides of all pieces.
        let allowed = 4.0 * rounding * longest(surface, f) * seeds.len() as f64;
        slack += allowed;
        let error = (covered - surface.facet_area(f as u32)).abs();
        ensure!(error <= allowed, "facet {f}: {covered:e} of {:e} is covered", surface.facet_area(f as u32));
    }
    for (i, cell) in cells.iter().enumerate() {
        ensure!((sums.area[i] - cell).abs() <= slack, "cell {i}: {:e}, but {:e} of pieces", sums.area[i], cell);
        let numbers = [sums.mass[i], sums.energy[i], sums.moment[i].element_sum()];
        ensure!(numbers.iter().all(|x| x.is_finite()), "cell {i}: {numbers:?}");
        ensure!(sums.mass[i] >= 0.0 && sums.energy[i] >= 0.0, "cell {i}: {numbers:?}");
    }
    Ok(())
}

/// Points of every facet lie in the cell of a nearest seed.
fn nearest(surface: &Surface, seeds: &[DVec3], pieces: &PieceBatch) -> Result<(), String> {
    let rounding = 4.0 * rounding(seeds);
    for f in (0..surface.facets().len()).filter(|&f| !surface.skips(f)) {
        let [a, b, c] = surface.facets()[f].map(|v| surface.positions()[v as usize]);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let normal = (b - a).cross(c - a);
        // In a sliver, or in a facet as small as a rounding, "inside" has no direction.
        if normal.length() < 1e-3 * longest * longest || longest < 1e3 * rounding {
            continue;
        }
        let normal = normal.normalize();
        for (s, t) in [(0.31, 0.27), (0.83, 0.11), (0.07, 0.04), (0.09, 0.85), (0.5, 0.49), (1.0 / 3.0, 1.0 / 3.0)] {
            let p = a + s * (b - a) + t * (c - a);
            let distances: Vec<f64> = seeds.iter().map(|x| x.distance(p)).collect();
            let least = distances.iter().copied().fold(f64::INFINITY, f64::min);
            let found = (0..pieces.len()).filter(|&i| pieces.facet[i] == f as u32).any(|i| {
                distances[pieces.seed[i] as usize] <= least + rounding
                    && inside(&pieces.position[pieces.vertices(i)], p, normal, rounding)
            });
            ensure!(found, "facet {f}: the point {p} lies in no cell of a nearest seed");
        }
    }
    Ok(())
}

/// Whether a convex polygon in the plane with this normal holds `p`, to within `margin`.
fn inside(polygon: &[DVec3], p: DVec3, normal: DVec3, margin: f64) -> bool {
    (0..polygon.len()).all(|k| {
        let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
        // An edge as short as the margin has no direction.
        (b - a).cross(p - a).dot(normal) >= -margin * ((b - a).length() + 4.0 * margin) - margin * (p - a).length()
    })
}

/// The whole pipeline on these seeds: an oriented 2-manifold, or too few seeds.
fn remeshes(case: &Case, parallel: &Parallel) -> Result<(), String> {
    let surface = case.surface();
    let options = RemeshOptions::plain(
        Seeds::Given(case.seeds.iter().map(|&p| surface.frame().to_world(p)).collect()),
        case.tiny.cells,
    )
    .with_density(case.weights.clone().into());
    let out = match remesh(&case.mesh, &options, parallel, &mut (), &Token::default()) {
        Ok(out) => out,
        Err(RemeshError::TooFewSeeds { .. } | RemeshError::NoThickness) => return Ok(()),
        // Rounding to the caller's coordinates moved a seed from the limit over it.
        Err(RemeshError::Rvd(tessera::rvd::RvdError::SeedTooFar { .. })) => return Ok(()),
        Err(error) => return Err(format!("remesh: {error}")),
    };
    let slack = 64.0 * rounding(&[]) * surface.facets().len() as f64;
    let (area, scale) = (out.report.rvd.area, surface.frame().scale);
    // Corners that are nearly in one place were put into one, and of facets that are there twice one was taken; the report's
    // figures are of that.
    let input = &out.report.input;
    let whole = match input.stitched_vertices + input.coincident_facets {
        0 => surface.area(),
        _ => input.area * scale * scale,
    };
    ensure!((area * scale * scale - whole).abs() <= slack, "remesh: area {area:e} of {:e}", case.mesh.area());
    ensure!(out.vertex_seed.len() == out.mesh.positions().len(), "remesh: vertices without a seed");
    manifold(out.mesh.facets(), out.mesh.positions().len())?;
    let repair = out.report.result.repair;
    ensure!(repair.inconsistent_vertices == 0, "remesh: inconsistent vertices, {repair:?}");
    Ok(())
}

/// Every edge has at most one facet in each direction, every vertex one fan; no facet twice, none without area by name.
pub fn manifold(facets: &[[u32; 3]], vertices: usize) -> Result<(), String> {
    let mut next: HashMap<(u32, u32), u32> = HashMap::new();
    let mut corners = vec![0usize; vertices];
    let mut seen = HashSet::new();
    for &[a, b, c] in facets {
        ensure!(a != b && b != c && c != a, "facet {:?} names a vertex twice", [a, b, c]);
        let mut key = [a, b, c];
        key.sort_unstable();
        ensure!(seen.insert(key), "facet {:?} is there twice", [a, b, c]);
        for (from, to, apex) in [(a, b, c), (b, c, a), (c, a, b)] {
            ensure!(next.insert((from, to), apex).is_none(), "edge {from} -> {to} has two facets");
            corners[from as usize] += 1;
        }
    }
    // Around each vertex, from facet to facet: all of them are met, from any one.
    for &[a, b, c] in facets {
        for (v, first) in [(a, b), (b, c), (c, a)] {
            let (mut met, mut edge) = (0, first);
            while let Some(&apex) = next.get(&(v, edge)) {
                met += 1;
                edge = apex;
                if edge == first {
                    break;
                }
            }
            if edge != first {
                // Open: the facets on the other side, v -> x -> first backwards.
                let mut edge = first;
                while let Some(&apex) = next.get(&(edge, v)) {
                    met += 1;
                    edge = apex;
                }
            }
            ensure!(met == corners[v as usize], "vertex {v} has {} facets and a fan of {met}", corners[v as usize]);
        }
    }
    ensure!(corners.iter().all(|&n| n > 0), "a vertex has no facet");
    Ok(())
}
