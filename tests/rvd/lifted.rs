//! Promise: the diagram of a surface lifted to R^6 by its normals is the one that brute force finds in the planes of its facets,
//! on every backend, with the same bits on any number of threads.

use std::sync::{Arc, OnceLock};

use glam::DVec3;
use needs::needs;
use rayon::prelude::*;
use tessera::mesh::shapes::Shape;
use tessera::rvd::{
    Backend, Capacities, CellSums, Lifted, Parallel, PassStats, PieceBatch, Point, Serial, Session, SessionOptions,
    Surface,
};
use tessera::token::Token;

use crate::backends::on_device;
use crate::lifts::{lifted, seeds_on};
use crate::surfaces;

/// Sums over all cells by clipping every facet, in a frame of its plane, by all bisectors: a lifted facet meets the cells in a
/// power diagram in two dimensions.
fn brute_force(surface: &Surface<Lifted>, seeds: &[Lifted]) -> CellSums<Lifted> {
    let mut sums = CellSums::default();
    sums.reset(seeds.len());
    for f in (0..surface.facets().len() as u32).filter(|&f| !surface.skips(f as usize)) {
        let corners = surface.corners(f);
        let weights = surface.facets()[f as usize].map(|v| surface.weights()[v as usize]);
        let side = [corners[1] - corners[0], corners[2] - corners[0]];
        let e1 = side[0] * (1.0 / side[0].length());
        let across = side[1] - e1 * e1.dot(side[1]);
        let e2 = across * (1.0 / across.length());
        for (i, &seed) in seeds.iter().enumerate() {
            let w = corners[0] - seed;
            let start = [e1.dot(w), e2.dot(w)];
            let rest = w - e1 * start[0] - e2 * start[1];
            let uv = |p: Lifted| [start[0] + e1.dot(p - corners[0]), start[1] + e2.dot(p - corners[0])];
            let mut polygon: Vec<[f64; 3]> =
                (0..3).map(|c| [uv(corners[c])[0], uv(corners[c])[1], weights[c]]).collect();
            for (j, &other) in seeds.iter().enumerate().filter(|(j, _)| *j != i) {
                let b = other - seed;
                if b == Lifted::ZERO {
                    if j < i {
                        polygon.clear();
                    }
                    continue;
                }
                let (g, c) = ([e1.dot(b), e2.dot(b)], 0.5 * b.length_squared() - rest.dot(b));
                let value = |p: &[f64; 3]| c - p[0] * g[0] - p[1] * g[1];
                let mut next = Vec::new();
                for k in 0..polygon.len() {
                    let (p, q) = (polygon[k], polygon[(k + 1) % polygon.len()]);
                    let (here, there) = (value(&p), value(&q));
                    if here > 0.0 {
                        next.push(p);
                    }
                    if (here > 0.0) != (there > 0.0) {
                        let t = here / (here - there);
                        next.push([0, 1, 2].map(|x| p[x] + t * (q[x] - p[x])));
                    }
                }
                polygon = next;
                if polygon.is_empty() {
                    break;
                }
            }
            let rest2 = rest.length_squared();
            for k in 2..polygon.len() {
                let corner = [polygon[0], polygon[k - 1], polygon[k]];
                let [a, b, c] = corner;
                let area = 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]));
                // The integral of a product of three linear functions, by the midpoints and corners that are exact for cubics.
                let mut middle = [0.0; 3];
                let mut add = |p: [f64; 3], share: f64| {
                    let dm = share * area * p[2];
                    sums.mass[i] += dm;
                    sums.energy[i] += dm * (p[0] * p[0] + p[1] * p[1] + rest2);
                    sums.moment[i] += (e1 * p[0] + e2 * p[1] + rest) * dm;
                };
                for e in 0..3 {
                    let (p, q) = (corner[e], corner[(e + 1) % 3]);
                    (0..3).for_each(|x| middle[x] += p[x] / 3.0);
                    add(p, 1.0 / 20.0);
                    add([0, 1, 2].map(|x| 0.5 * (p[x] + q[x])), 2.0 / 15.0);
                }
                add(middle, 9.0 / 20.0);
                sums.area[i] += area;
            }
        }
    }
    sums
}

/// A surface with seeds on it and near it, and what brute force says of their cells.
struct Case {
    what: String,
    surface: Arc<Surface<Lifted>>,
    seeds: Vec<Lifted>,
    want: CellSums<Lifted>,
}

/// Found once for all backends.
fn cases() -> &'static [Case] {
    static CASES: OnceLock<Vec<Case>> = OnceLock::new();
    CASES.get_or_init(|| {
        let mut cases = Vec::new();
        for (k, shape) in [Shape::Torus, Shape::Hills, Shape::Block, Shape::Sheets].into_iter().enumerate() {
            let mesh = shape.build(250);
            let uneven: Vec<f64> = (0..mesh.positions().len()).map(|v| 0.2 + (v % 5) as f64).collect();
            for (share, weights) in [(0.02, None), (0.1, Some(&uneven[..])), (0.3, None), (1.0, Some(&uneven[..]))] {
                let surface = lifted(&mesh, weights, share);
                for n in [1, 7, 60, 400] {
                    let mut seeds = seeds_on(&surface, n, (k * 10 + n) as u64);
                    if n == 60 {
                        // Later duplicates have no cell; one in the same place with another normal has.
                        seeds[40] = seeds[3];
                        seeds[41] = Lifted { lift: -seeds[3].lift, ..seeds[3] };
                    }
                    let (what, surface) = (format!("{shape}, s {share}, {n} seeds"), Arc::clone(&surface));
                    cases.push((what, surface, seeds));
                }
            }
        }
        let of = |(what, surface, seeds): (String, Arc<Surface<Lifted>>, Vec<Lifted>)| {
            let want = brute_force(&surface, &seeds);
            Case { what, surface, seeds, want }
        };
        cases.into_par_iter().map(of).collect()
    })
}

/// Sums and pieces of a backend are those of brute force, within so much of the mean cell.
fn compare(
    what: &str,
    session: &mut dyn Session<Lifted>,
    (surface, seeds): (&Surface<Lifted>, &[Lifted]),
    want: &CellSums<Lifted>,
    tolerance: f64,
) -> (CellSums<Lifted>, PassStats) {
    let n = seeds.len();
    let spacing = (surface.area() / n as f64).sqrt();
    let cell = spacing * spacing;
    let (mut sums, token) = (CellSums::default(), Token::default());
    session.set_seeds(seeds).unwrap();
    let stats = session.sums(&mut sums, &token).unwrap();
    let mut worst = 0f64;
    for i in 0..n {
        // Energies and moments about a seed that is far from its cell are larger than the cell's own.
        let far = spacing.max((want.energy[i] / want.mass[i].max(1e-30)).sqrt());
        let off = [
            (sums.area[i] - want.area[i]).abs() / cell,
            (sums.mass[i] - want.mass[i]).abs() / cell,
            (sums.energy[i] - want.energy[i]).abs() / (cell * far * far),
            (sums.moment[i] - want.moment[i]).length() / (cell * far),
        ];
        assert!(off.iter().all(|&off| off <= tolerance), "{what}: cell {i} is off by {off:?}");
        worst = off.into_iter().fold(worst, f64::max);
    }
    println!("{what}: {worst:.1e} of {tolerance:.0e}, {stats:?}");
    // Pieces are those of the surface in space.
    let mut pieces = PieceBatch::default();
    let facets = 0..surface.facets().len() as u32;
    session.pieces(facets.clone(), &mut pieces, &token).unwrap();
    let area: f64 = (0..pieces.len()).map(|p| pieces.area(p)).sum();
    let whole: f64 = facets.map(|f| area_in_space(surface, f)).sum();
    assert!((area - whole).abs() <= tolerance * whole, "{what}: {area} of {whole}");
    (sums, stats)
}

#[test]
fn cells_are_those_of_brute_force() {
    let parallel = Parallel::new(Some(2)).unwrap();
    for Case { what, surface, seeds, want } in cases() {
        for backend in [&Serial as &dyn Backend, &parallel] {
            let options = SessionOptions::new(seeds.len());
            let mut session = backend.lifted_session(Arc::clone(surface), options).unwrap();
            let what = format!("{what}, {}", backend.kind().name());
            compare(&what, &mut *session, (surface, seeds), want, 1e-10);
        }
    }
}

fn area_in_space(surface: &Surface<Lifted>, f: u32) -> f64 {
    let [a, b, c] = surface.corners(f).map(|p| p.place);
    if surface.skips(f as usize) { 0.0 } else { 0.5 * (b - a).cross(c - a).length() }
}

/// In single precision relative to the seed, of cells some spacings wide.
const SINGLE: f64 = 1e-5;

#[needs(gpu)]
#[test]
fn cells_of_the_device_are_those_of_brute_force() {
    let Some(gpu) = on_device() else { return };
    let (mut pairs, mut in_double) = (0, 0);
    for Case { what, surface, seeds, want } in cases() {
        let open = |options| gpu.lifted_session(Arc::clone(surface), options).unwrap();
        let n = seeds.len();
        let mut session = open(SessionOptions::new(n));
        let (sums, stats) = compare(what, &mut *session, (surface, seeds), want, SINGLE);
        assert!(session.device_bytes() > 0, "{what}: on the device");
        pairs += stats.pairs;
        in_double += stats.f64_finished;
        if n < 60 {
            continue;
        }
        // A second run has the same bits, and so has one whose pairs run out of everything.
        let tiny = Capacities::new().with_neighbours(4).with_polygon(5).with_cells(2).with_pairs_percent(10);
        for (how, options) in
            [("again", SessionOptions::new(n)), ("tiny", SessionOptions::new(n).with_capacities(tiny))]
        {
            let (mut other, mut session) = (CellSums::default(), open(options));
            session.set_seeds(seeds).unwrap();
            let stats = session.sums(&mut other, &Token::default()).unwrap();
            assert!(other == sums, "{what}: {how}");
            if how == "tiny" && n == 400 {
                assert!(stats.relaunched_neighbours > 0 && stats.relaunched_cells > 0, "{what}: {stats:?}");
            }
        }
    }
    // Double precision is for what single precision cannot tell.
    assert!(in_double * 100 < pairs, "{in_double} of {pairs} pairs were finished in double precision");
}

/// Lloyd's steps, so that lists of neighbours are kept from pass to pass, with a jump and a seed that goes astray.
#[test]
fn threads_and_earlier_passes_change_no_bit() {
    for share in [0.05, 0.4] {
        let surface = lifted(&Shape::Torus.build(4000), None, share);
        let [one, two] = [1, 2].map(|threads| Parallel::new(Some(threads)).unwrap());
        let open = |backend: &Parallel| backend.lifted_session(Arc::clone(&surface), SessionOptions::new(700)).unwrap();
        let [mut first, mut second] = [open(&one), open(&two)];
        let (mut seeds, token) = (seeds_on(&surface, 700, 5), Token::default());
        for step in 0..12 {
            let [mut a, mut b, mut fresh] = [(); 3].map(|()| CellSums::default());
            for (session, sums) in [(&mut first, &mut a), (&mut second, &mut b), (&mut open(&one), &mut fresh)] {
                session.set_seeds(&seeds).unwrap();
                session.sums(sums, &token).unwrap();
            }
            assert!(a == b && a == fresh, "s {share}: step {step}");
            seeds = (0..seeds.len()).map(|i| a.centroid(i, seeds[i])).collect();
            if step == 7 {
                seeds[100].lift += DVec3::splat(0.2);
            }
        }
    }
}

#[test]
fn a_flat_lift_is_the_surface_itself() {
    let mesh = surfaces::all().into_iter().find(|(name, _)| name == "plane").unwrap().1;
    let surface = lifted(&mesh, None, 0.5);
    assert!((surface.area() - Surface::new(&mesh, None).unwrap().area()).abs() < 1e-14);
    let lift = vec![DVec3::NAN; mesh.positions().len()];
    assert!(Surface::lifted(&mesh, None, &lift, &Token::default()).is_err());
    assert!(Surface::lifted(&mesh, None, &[], &Token::default()).is_err());
    let lift = vec![DVec3::splat(1e12); mesh.positions().len()];
    assert!(Surface::lifted(&mesh, None, &lift, &Token::default()).is_err());
}
