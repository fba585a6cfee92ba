//! Surfaces of the kinds that collections and scanners give, made from a random seed: volumes, sheets that meet in an edge,
//! thin parts, raw scans, and edge lengths that are noise.
#![allow(dead_code)]

use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::TAU;

use glam::{DVec3, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::shapes::Shape;

/// Random numbers, the same everywhere (SplitMix64).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// From 0 to 1, 1 excluded.
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn below(&mut self, n: usize) -> usize {
        (self.unit() * n as f64) as usize
    }

    /// In the unit cube.
    pub fn point(&mut self) -> DVec3 {
        dvec3(self.unit(), self.unit(), self.unit())
    }

    /// From -1 to 1.
    pub fn signed(&mut self) -> f64 {
        2.0 * self.unit() - 1.0
    }
}

/// The facets of a mesh of tetrahedra that fills the unit cube, `n` cells along a side: those inside once, or once for
/// either side.
pub fn tetrahedra(n: usize, twice: bool, seed: u64) -> TriMesh {
    let mut random = Random::new(seed);
    let side = n + 1;
    let mut positions = Vec::new();
    for k in 0..side.pow(3) {
        let cell = [k % side, k / side % side, k / side / side];
        let place = |i: usize, random: &mut Random| {
            let inside = if i > 0 && i < n { 0.2 * random.signed() } else { 0.0 };
            (i as f64 + inside) / n as f64
        };
        positions.push(DVec3::from(cell.map(|i| place(i, &mut random))));
    }
    let vertex = |c: [usize; 3]| (c[0] + side * (c[1] + side * c[2])) as u32;
    let mut facets: Vec<[u32; 3]> = Vec::new();
    for k in 0..n.pow(3) {
        let low = [k % n, k / n % n, k / n / n];
        for axes in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            // Along three edges from the low corner to the high one.
            let mut corner = low;
            let mut path = vec![vertex(corner)];
            for axis in axes {
                corner[axis] += 1;
                path.push(vertex(corner));
            }
            let even = axes[1] == (axes[0] + 1) % 3;
            let [a, b, c, d] = [path[0], path[1], path[2], path[3]];
            let outward = [[a, c, b], [a, b, d], [a, d, c], [b, c, d]];
            facets.extend(outward.map(|[a, b, c]| if even { [a, b, c] } else { [a, c, b] }));
        }
    }
    if !twice {
        let mut seen = BTreeSet::new();
        facets.retain(|t| {
            let mut corners = *t;
            corners.sort_unstable();
            seen.insert(corners)
        });
    }
    TriMesh::new(positions, facets).unwrap()
}

/// So many pages, `n` cells high, that meet in one edge; each of two sides if it has a back.
pub fn book(pages: usize, n: usize, backs: bool) -> TriMesh {
    let mut positions: Vec<DVec3> = (0..=n).map(|j| DVec3::Z * (j as f64 / n as f64)).collect();
    let mut facets = Vec::new();
    for page in 0..pages {
        let angle = TAU * page as f64 / pages as f64;
        let first = positions.len() as u32;
        for i in 1..=n {
            let r = i as f64 / n as f64;
            positions.extend((0..=n).map(|j| dvec3(r * angle.cos(), r * angle.sin(), j as f64 / n as f64)));
        }
        let at = |i: usize, j: usize| if i == 0 { j as u32 } else { first + ((i - 1) * (n + 1) + j) as u32 };
        for (i, j) in (0..n).flat_map(|i| (0..n).map(move |j| (i, j))) {
            let quad = [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]];
            facets.extend(quad);
            facets.extend(quad.into_iter().filter(|_| backs).map(|[a, b, c]| [a, c, b]));
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A plate about the plane z = 0: where `inside(x, y)` is below 0, a signed distance, and as thick as `thickness(x, y)`.
/// Squares of this side; outlines are moved to where the distance is 0.
pub fn plate(
    side: f64,
    [low, high]: [[f64; 2]; 2],
    inside: impl Fn(f64, f64) -> f64,
    thickness: impl Fn(f64, f64) -> f64,
) -> TriMesh {
    let count = [0, 1].map(|k| ((high[k] - low[k]) / side).ceil() as i64);
    let at = |i: i64, j: i64| [low[0] + i as f64 * side, low[1] + j as f64 * side];
    let full = |i: i64, j: i64| {
        let [x, y] = at(i, j);
        (0..count[0]).contains(&i) && (0..count[1]).contains(&j) && inside(x + side / 2.0, y + side / 2.0) < 0.0
    };
    let snapped = |i: i64, j: i64| {
        let [mut x, mut y] = at(i, j);
        let around = [full(i, j), full(i - 1, j), full(i, j - 1), full(i - 1, j - 1)];
        if around.contains(&true) && around.contains(&false) {
            for _ in 0..3 {
                let (d, step) = (inside(x, y), 1e-3 * side);
                let slope = [inside(x + step, y) - inside(x - step, y), inside(x, y + step) - inside(x, y - step)];
                let slope = slope.map(|s| s / (2.0 * step));
                let square = slope[0] * slope[0] + slope[1] * slope[1];
                if square > 1e-6 {
                    x -= (d * slope[0] / square).clamp(-0.4 * side, 0.4 * side);
                    y -= (d * slope[1] / square).clamp(-0.4 * side, 0.4 * side);
                }
            }
        }
        [x, y]
    };
    let mut positions = Vec::new();
    let mut number: BTreeMap<(i64, i64, bool), u32> = BTreeMap::new();
    let mut vertex = |i: i64, j: i64, top: bool| {
        *number.entry((i, j, top)).or_insert_with(|| {
            let [x, y] = snapped(i, j);
            let [wide, deep] = at(i, j);
            positions.push(dvec3(x, y, if top { 0.5 } else { -0.5 } * thickness(wide, deep)));
            positions.len() as u32 - 1
        })
    };
    let mut facets = Vec::new();
    for (i, j) in (0..count[0]).flat_map(|i| (0..count[1]).map(move |j| (i, j))).filter(|&(i, j)| full(i, j)) {
        for top in [true, false] {
            let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| vertex(i, j, top));
            facets.extend(if top { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] });
        }
        for (beside, from, to) in [
            ((i, j - 1), (i, j), (i + 1, j)),
            ((i + 1, j), (i + 1, j), (i + 1, j + 1)),
            ((i, j + 1), (i + 1, j + 1), (i, j + 1)),
            ((i - 1, j), (i, j + 1), (i, j)),
        ] {
            if !full(beside.0, beside.1) {
                let [a, b] = [from, to].map(|(i, j)| vertex(i, j, false));
                let [c, d] = [to, from].map(|(i, j)| vertex(i, j, true));
                facets.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// A plate with holes, as thick as `thickness` of its longer side.
pub fn holed_plate(side: f64, thickness: f64) -> TriMesh {
    let hole = |x: f64, y: f64| 0.07 - ((x % 0.25 - 0.125).powi(2) + (y % 0.25 - 0.125).powi(2)).sqrt();
    let outline = |x: f64, y: f64| (x - 0.5).abs().max(((y - 0.25) * 2.0).abs()) - 0.49;
    plate(side, [[0.0, 0.0], [1.0, 0.5]], |x, y| outline(x, y).max(hole(x, y)), |_, _| thickness)
}

/// A crank: two thick bosses with bores, joined by a web as thin as `thickness`.
pub fn crank(side: f64, thickness: f64) -> TriMesh {
    let disc = |x: f64, y: f64, cx: f64, r: f64| ((x - cx).powi(2) + y * y).sqrt() - r;
    let web = |x: f64, y: f64| y.abs().max((x - 0.5).abs() - 0.4) - 0.1 + 0.04 * (x - 0.2);
    let bores = |x: f64, y: f64| (-disc(x, y, 0.2, 0.08)).max(-disc(x, y, 0.8, 0.05));
    let slots = |x: f64, y: f64| 0.035 - (((x - 0.5) / 3.0).powi(2) + y * y).sqrt();
    let solid = |x: f64, y: f64| disc(x, y, 0.2, 0.18).min(disc(x, y, 0.8, 0.13)).min(web(x, y));
    let boss = |x: f64, y: f64| disc(x, y, 0.2, 0.14).min(disc(x, y, 0.8, 0.1));
    plate(
        side,
        [[0.0, -0.2], [1.0, 0.2]],
        |x, y| solid(x, y).max(bores(x, y)).max(slots(x, y)),
        |x, y| thickness + (0.12 - thickness) * (0.5 - boss(x, y) / side).clamp(0.0, 1.0),
    )
}

/// A bowl with a wall as thin as `thickness`: a half of a sphere of radius 1, another one inside, and the rim between them.
pub fn bowl(rings: usize, thickness: f64) -> TriMesh {
    let angle = |k: usize| -TAU / 4.0 + TAU / 4.0 * k as f64 / rings as f64;
    let outer = (0..=rings).map(|k| (angle(k).sin(), angle(k).cos()));
    let inner = (0..=rings).rev().map(|k| ((1.0 - thickness) * angle(k).sin(), (1.0 - thickness) * angle(k).cos()));
    let profile: Vec<(f64, f64)> = outer.chain(inner).collect();
    turned(&profile, 4 * rings as u32)
}

/// A closed surface around the z axis, from heights and radii; the first and the last are on the axis.
pub fn turned(profile: &[(f64, f64)], around: u32) -> TriMesh {
    let rings = profile.len() as u32 - 2;
    let mut positions = vec![DVec3::Z * profile[0].0];
    for &(z, r) in &profile[1..=rings as usize] {
        let angle = |k: u32| f64::from(k) * TAU / f64::from(around);
        positions.extend((0..around).map(|k| dvec3(r * angle(k).cos(), r * angle(k).sin(), z)));
    }
    positions.push(DVec3::Z * profile[profile.len() - 1].0);
    let at = |ring: u32, k: u32| 1 + ring * around + k % around;
    let last = positions.len() as u32 - 1;
    let mut facets = Vec::new();
    for k in 0..around {
        facets.extend([[0, at(0, k + 1), at(0, k)], [last, at(rings - 1, k), at(rings - 1, k + 1)]]);
        for ring in 1..rings {
            let (low, high) = (|k| at(ring - 1, k), |k| at(ring, k));
            facets.extend([[low(k), low(k + 1), high(k + 1)], [low(k), high(k + 1), high(k)]]);
        }
    }
    TriMesh::new(positions, facets).unwrap()
}

/// What a scan has wrong with it. Lengths are in edges of its facets.
#[derive(Clone, Copy, Debug)]
pub struct Scan {
    /// Vertices are off along their normals by up to this.
    pub noise: f64,
    /// Pieces that are missing.
    pub holes: usize,
    /// Small pieces that float above the rest.
    pub islands: usize,
    /// Pieces that are there twice, a fraction of an edge apart.
    pub doubles: usize,
    /// Two-sided strips that hang on an inner edge of the surface.
    pub flaps: usize,
    /// Height of such a strip, edges.
    pub flap_height: usize,
    /// Edges that are nearly without length.
    pub slivers: usize,
    /// Radius of the pieces.
    pub radius: f64,
}

impl Scan {
    pub const RAW: Self =
        Self { noise: 0.2, holes: 12, islands: 6, doubles: 6, flaps: 8, flap_height: 10, slivers: 60, radius: 8.0 };

    /// The scan of a shape.
    pub fn of(self, shape: Shape, facets: usize, seed: u64) -> TriMesh {
        let mut random = Random::new(seed);
        let (mut positions, mut triangles) = shape.build(facets).into_parts();
        let area: f64 = triangles.iter().map(|t| twice_area(&positions, *t).length() / 2.0).sum();
        let edge = (4.0 / 3f64.sqrt() * area / triangles.len() as f64).sqrt();
        let mut normals = vec![DVec3::ZERO; positions.len()];
        triangles.iter().for_each(|&t| t.iter().for_each(|&v| normals[v as usize] += twice_area(&positions, t)));
        let normal = |v: u32| normals[v as usize].normalize_or_zero();
        let clean = positions.clone();
        positions.iter_mut().zip(0..).for_each(|(p, v)| *p += self.noise * edge * random.signed() * normal(v));
        for _ in 0..self.slivers {
            let [a, b, _] = triangles[random.below(triangles.len())];
            positions[a as usize] = positions[b as usize].lerp(positions[a as usize], 1e-3);
        }
        let piece = |triangles: &[[u32; 3]], radius: f64, random: &mut Random| -> Vec<usize> {
            // Copies are not copied again.
            let mut vertex = triangles[random.below(triangles.len())][0] as usize;
            while vertex >= clean.len() {
                vertex = triangles[random.below(triangles.len())][0] as usize;
            }
            let middle = clean[vertex];
            let reach = radius * edge * (0.5 + random.unit());
            let near =
                |t: &[u32; 3]| t.iter().all(|&v| clean.get(v as usize).is_some_and(|p| p.distance(middle) < reach));
            (0..triangles.len()).filter(|&f| near(&triangles[f])).collect()
        };
        for _ in 0..self.holes {
            let gone: BTreeSet<usize> = piece(&triangles, self.radius, &mut random).into_iter().collect();
            let mut number = 0..;
            triangles.retain(|_| !gone.contains(&number.next().unwrap()));
        }
        let copies = [(self.islands, 6.0 * edge, 0.5 * self.radius), (self.doubles, 0.3 * edge, self.radius)];
        for (count, above, radius) in copies {
            for _ in 0..count {
                let copied: Vec<[u32; 3]> =
                    piece(&triangles, radius, &mut random).into_iter().map(|f| triangles[f]).collect();
                let mut number = BTreeMap::new();
                for t in copied {
                    let t = t.map(|v| {
                        *number.entry(v).or_insert_with(|| {
                            positions.push(positions[v as usize] + above * normal(v));
                            positions.len() as u32 - 1
                        })
                    });
                    triangles.push(t);
                }
            }
        }
        for _ in 0..self.flaps {
            let [mut a, mut b, _] = triangles[random.below(triangles.len())];
            if a.max(b) as usize >= clean.len() {
                continue;
            }
            let up = [a, b].map(|v| edge * normal(v));
            for _ in 0..self.flap_height {
                let top = positions.len() as u32;
                positions.extend([positions[a as usize] + up[0], positions[b as usize] + up[1]]);
                let front = [[a, b, top + 1], [a, top + 1, top]];
                triangles.extend(front.into_iter().chain(front.map(|[a, b, c]| [a, c, b])));
                (a, b) = (top, top + 1);
            }
        }
        TriMesh::new(positions, triangles).unwrap()
    }
}

fn twice_area(positions: &[DVec3], t: [u32; 3]) -> DVec3 {
    let [a, b, c] = t.map(|v| positions[v as usize]);
    (b - a).cross(c - a)
}

/// Edge lengths from 1 to `ratio`, drawn for each vertex by itself, evenly in their logarithm.
pub fn noise(mesh: &TriMesh, ratio: f64, seed: u64) -> Vec<f64> {
    let mut random = Random::new(seed);
    mesh.positions().iter().map(|_| ratio.powf(random.unit())).collect()
}
