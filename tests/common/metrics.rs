//! Analytic metrics on a square, a cylinder and a wing, and smooth ones made from a random seed.
#![allow(dead_code)]

use std::f64::consts::TAU;

use glam::{DVec3, dvec3};
use tessera::TriMesh;
use tessera::mesh::tensor::Tensor;

use crate::rough::Random;

/// A surface over the unit square of parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ground {
    /// The unit square.
    Square,
    /// Open at both ends, of height 1 and radius 0.3.
    Cylinder,
    /// A NACA 0012 section that tapers and is swept, open at both ends, with a sharp trailing edge.
    Wing,
}

impl Ground {
    pub const ALL: [Self; 3] = [Self::Square, Self::Cylinder, Self::Wing];

    fn at(self, u: f64, v: f64) -> DVec3 {
        match self {
            Self::Square => dvec3(u, v, 0.0),
            Self::Cylinder => {
                let (sin, cos) = (TAU * u).sin_cos();
                dvec3(0.3 * cos, 0.3 * sin, v)
            }
            Self::Wing => {
                // From the trailing edge below to the leading edge and back above.
                let x = 0.5 * (1.0 + (TAU * u).cos());
                let half =
                    0.6 * (0.2969 * x.sqrt() - 0.126 * x - 0.3516 * x * x + 0.2843 * x.powi(3) - 0.1036 * x.powi(4));
                let chord = 1.0 - 0.5 * v;
                dvec3(chord * x + 0.4 * v, 1.2 * v, chord * half * -(TAU * u).sin().signum())
            }
        }
    }

    /// A grid of so many squares along each side.
    pub fn mesh(self, side: u32) -> TriMesh {
        let is_round = self != Self::Square;
        let columns = if is_round { side } else { side + 1 };
        let of = |k: u32| self.at(f64::from(k % columns) / f64::from(side), f64::from(k / columns) / f64::from(side));
        let positions = (0..columns * (side + 1)).map(of).collect();
        let vertex = |i: u32, j: u32| if is_round { i % side } else { i } + columns * j;
        let square = |k: u32| {
            let (i, j) = (k % side, k / side);
            let [a, b, c, d] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)].map(|(i, j)| vertex(i, j));
            [[a, b, c], [a, c, d]]
        };
        TriMesh::new(positions, (0..side * side).flat_map(square).collect()).unwrap()
    }
}

/// A smooth metric.
#[derive(Clone, Copy, Debug)]
pub enum Wanted {
    /// Short edges across a plane through a point, and long ones along it.
    Shock { through: DVec3, across: DVec3, least: f64, growth: f64, most: f64 },
    /// Short edges across the wall y = 0 of the square, or the ends at v = 0 of the others, that grow by a factor per length.
    Layer { across: DVec3, wall: f64, least: f64, growth: f64, most: f64 },
    /// Short edges across a sphere's surface, and longer ones along it.
    Ring { centre: DVec3, radius: f64, least: f64, growth: f64, along: f64, most: f64 },
    /// Lengths and directions that vary smoothly.
    Waves { phases: [f64; 6], mean: f64, aspect: f64 },
}

impl Wanted {
    /// With edges of this length at least in the mean of both directions, and up to ten times as long as wide.
    pub fn random(random: &mut Random, mean: f64) -> Self {
        Self::Waves {
            phases: [(); 6].map(|()| TAU * random.unit()),
            mean: mean * (1.0 + 0.75 * random.unit()),
            aspect: 1.0 + 9.0 * random.unit(),
        }
    }

    /// The metric at a place.
    pub fn at(&self, p: DVec3) -> Tensor {
        let tensor = |across: DVec3, short: f64, long: f64| {
            let (x, y) = across.any_orthonormal_pair();
            Tensor::of_lengths([across, x, y], [short, long, long])
        };
        match *self {
            Self::Shock { through, across, least, growth, most } => {
                tensor(across, (least + growth * (p - through).dot(across).abs()).min(most), most)
            }
            Self::Layer { across, wall, least, growth, most } => {
                tensor(across, (least * (growth * (p.dot(across) - wall).abs()).exp()).min(most), most)
            }
            Self::Ring { centre, radius, least, growth, along, most } => {
                let away = p - centre;
                let off = (away.length() - radius).abs();
                let long = (along + growth * off).min(most);
                tensor(away.normalize_or(DVec3::X), (least + growth * off).min(long), long)
            }
            Self::Waves { phases: [a, b, c, d, e, f], mean, aspect } => {
                let wave = |phase: f64, way: DVec3| (phase + 3.0 * p.dot(way)).sin();
                let across = dvec3(wave(a, DVec3::Y), wave(b, DVec3::Z), 1.3 + wave(c, DVec3::X)).normalize();
                let short = mean * (1.0 + 0.3 * wave(d, DVec3::X + DVec3::Y));
                let longer = 1.0 + (aspect - 1.0) * 0.5 * (1.0 + wave(e, DVec3::X) * wave(f, DVec3::Y));
                tensor(across, short / longer.sqrt(), short * longer.sqrt())
            }
        }
    }

    pub fn on(&self, mesh: &TriMesh) -> Vec<Tensor> {
        mesh.positions().iter().map(|&p| self.at(p)).collect()
    }

    /// The length of an edge, integrated.
    pub fn length(&self, a: DVec3, b: DVec3) -> f64 {
        const POINTS: usize = 16;
        let at = |k: usize| self.at(a.lerp(b, (k as f64 + 0.5) / POINTS as f64)).length(b - a);
        (0..POINTS).map(at).sum::<f64>() / POINTS as f64
    }
}

/// Each edge once.
pub fn edges(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let sides = mesh.facets().iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let mut edges: Vec<[u32; 2]> = sides.map(|[a, b]| [a.min(b), a.max(b)]).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// Percent of the edges whose length in the analytic metric is from 0.71 to 1.41, of a metric whose lengths are `scale` times as large.
pub fn unit_edges(mesh: &TriMesh, wanted: &Wanted, scale: f64) -> f64 {
    let edges = edges(mesh);
    let at = |v: u32| mesh.positions()[v as usize];
    let is_unit = |&&[a, b]: &&[u32; 2]| (0.71..=1.41).contains(&(scale * wanted.length(at(a), at(b))));
    100.0 * edges.iter().filter(is_unit).count() as f64 / edges.len() as f64
}
