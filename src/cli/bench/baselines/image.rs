//! Jump flooding on a geometry image (Rong, Liu, Wang, Yin, Guo 2011).
//!
//! Purpose: a disk is laid out on a square and sampled there in K² texels; the flood goes over the texture, with distances in
//! space. Invariant: only a disk has such an image; of another surface [`Texels::new`] says what it is. A texel counts for the
//! area of the surface on it. Must not know: what moves seeds, where the flood runs.

mod layout;

use std::time::Instant;

use glam::DVec3;

use super::flood::{Labels, Samples};
use super::session::Clustering;
use super::sums::{Part, Points};
use super::voxels::Unique;
use geometry::mesh::TriMesh;
use geometry::mesh::closest_point::{ClosestPoint, SurfacePoint};
use geometry::rvd::{CellSums, PassStats, RvdError, elapsed_ms};
use geometry::token::Token;
use layout::NotADisk;

/// Slack of the barycentric coordinates of a texel, so that none between two facets is left out.
const SLACK: f64 = 1e-9;

/// A disk laid out on K² texels.
pub(super) struct Texels {
    k: u32,
    facets: Vec<[u32; 3]>,
    /// Place of each vertex in the unit square.
    layout: Vec<[f64; 2]>,
    closest: ClosestPoint,
    pub(super) samples: Samples,
    points: Points,
}

impl Texels {
    /// Those of a surface in the unit frame.
    pub(super) fn new(mesh: &TriMesh, k: u32, token: &Token) -> Result<Result<Self, NotADisk>, RvdError> {
        let layout = match layout::square(mesh, token)? {
            Ok(layout) => layout,
            Err(reason) => return Ok(Err(reason)),
        };
        let mut parts = vec![Part::default(); (k * k) as usize];
        for (f, corners) in mesh.facets().iter().enumerate() {
            if !mesh.is_degenerate(f) {
                rasterise(corners.map(|v| layout[v as usize]), mesh.corners(f), k, &mut parts);
            }
        }
        let places = parts.iter().map(|part| part.centroid.to_array().map(|x| x as f32)).collect();
        Ok(Ok(Self {
            k,
            facets: mesh.facets().to_vec(),
            layout,
            closest: ClosestPoint::unless(mesh, token)?,
            samples: Samples::square(k, places),
            points: Points::new(mesh.area(), parts.iter().copied()),
        }))
    }

    fn texel_of(&self, at: &SurfacePoint) -> u32 {
        let corners = self.facets[at.facet as usize].map(|v| self.layout[v as usize]);
        let place = |axis: usize| (0..3).map(|c| at.barycentric[c] * corners[c][axis]).sum::<f64>();
        let [x, y] = [0, 1].map(|axis| ((place(axis) * f64::from(self.k)) as u32).min(self.k - 1));
        x + self.k * y
    }
}

/// Jump flooding on texels.
pub(super) struct Image<L> {
    texels: Texels,
    labels: L,
}

impl<L: Labels> Image<L> {
    pub(super) fn new(texels: Texels, labels: L) -> Self {
        Self { texels, labels }
    }

    fn label_of(&self, texel: usize) -> u32 {
        self.labels.label(texel, texel as u32)
    }
}

/// Gives the texels whose centres are in a facet their place and the area that they stand for.
fn rasterise(flat: [[f64; 2]; 3], corners: [DVec3; 3], k: u32, parts: &mut [Part]) {
    let [a, b, c] = flat;
    let cross = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let twice = cross(a, b, c);
    if twice.abs() < f64::MIN_POSITIVE {
        return;
    }
    let area = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length() / twice.abs();
    let range = |axis: usize| {
        let [p, q, r] = flat.map(|p| p[axis] * f64::from(k) - 0.5);
        let most = f64::from(k - 1);
        (p.min(q).min(r).ceil() - 1.0).clamp(0.0, most) as u32..=(p.max(q).max(r).floor() + 1.0).clamp(0.0, most) as u32
    };
    for y in range(1) {
        for x in range(0) {
            let at = [x, y].map(|x| (f64::from(x) + 0.5) / f64::from(k));
            let shares = [cross(b, c, at), cross(c, a, at), cross(a, b, at)].map(|part| part / twice);
            if shares.iter().all(|&share| share >= -SLACK) {
                let centroid = corners[0] * shares[0] + corners[1] * shares[1] + corners[2] * shares[2];
                parts[(x + k * y) as usize] = Part { area, centroid, spread: 0.0 };
            }
        }
    }
}

impl<L: Labels> Clustering for Image<L> {
    fn assign(&mut self, seeds: &[DVec3], token: &Token) -> Result<PassStats, RvdError> {
        let begin = Instant::now();
        let Self { texels, labels } = self;
        let places: Vec<[f32; 3]> = seeds.iter().map(|p| p.to_array().map(|x| x as f32)).collect();
        let on_surface = texels.closest.project_all(seeds, token)?;
        let planted = texels.samples.plant(&places, on_surface.iter().map(|at| texels.texel_of(at)));
        let mut stats = PassStats { start_ms: elapsed_ms(begin), ..PassStats::default() };
        let begin = Instant::now();
        labels.flood(&places, &planted, false, texels.samples.first_step(), token)?;
        stats.clip_ms = elapsed_ms(begin);
        Ok(stats)
    }

    fn sums(&self, seeds: &[DVec3], out: &mut CellSums) {
        self.texels.points.add_up(|k| self.label_of(k), seeds, out);
    }

    fn label(&self, at: &SurfacePoint) -> u32 {
        self.label_of(self.texels.texel_of(at) as usize)
    }

    fn samples(&self) -> Vec<(DVec3, f64, u32)> {
        let Texels { samples, points, .. } = &self.texels;
        let place = |k: usize| DVec3::from_array(samples.place(k as u32).map(f64::from));
        (0..points.len()).map(|k| (place(k), points.area(k), self.label_of(k))).collect()
    }

    fn triangles(&self, seeds: &[DVec3]) -> Vec<[u32; 3]> {
        let (k, mut found) = (self.texels.k as usize, Unique::default());
        for corner in (0..k * (k - 1)).filter(|corner| corner % k < k - 1) {
            // Counter-clockwise in the square, as facets are.
            let texels = [corner, corner + 1, corner + k + 1, corner + k];
            let mut labels = texels.map(|texel| self.label_of(texel)).to_vec();
            labels.dedup();
            if labels.len() > 1 && labels.first() == labels.last() {
                labels.pop();
            }
            let mut sorted = labels.clone();
            sorted.sort_unstable();
            sorted.dedup();
            // A label at two opposite corners separates the other two.
            if sorted.len() == labels.len() && sorted.iter().all(|&label| (label as usize) < seeds.len()) {
                found.fan(labels, seeds);
            }
        }
        found.triangles
    }

    fn bytes(&self) -> u64 {
        let Texels { facets, layout, samples, points, .. } = &self.texels;
        let vertices = layout.len() * size_of::<[f64; 2]>() + facets.len() * size_of::<[u32; 3]>();
        let texels = samples.count() as usize * size_of::<[f32; 3]>();
        points.bytes() + (vertices + texels) as u64 + self.labels.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::super::flood::OnHost;
    use super::super::tests::seeds_on;
    use super::*;
    use geometry::mesh::shapes::Shape;
    use geometry::rvd::Surface;

    fn unit(mesh: &TriMesh) -> (Surface, TriMesh) {
        let surface = Surface::new(mesh, None).unwrap();
        let mesh = TriMesh::new(surface.positions().to_vec(), surface.welded().to_vec()).unwrap();
        (surface, mesh)
    }

    #[test]
    fn a_disk_has_an_image_and_others_say_why_not() {
        let (surface, mesh) = unit(&Shape::Hills.build(1000));
        let texels = Texels::new(&mesh, 64, &Token::default()).unwrap().ok().unwrap();
        let labels = OnHost::new(texels.samples.clone());
        let mut image = Image::new(texels, labels);
        let seeds = seeds_on(&surface, 40);
        image.assign(&seeds, &Token::default()).unwrap();
        let wrong = image.samples().into_iter().filter(|&(at, _, label)| {
            let least = seeds.iter().map(|seed| seed.distance(at)).fold(f64::INFINITY, f64::min);
            seeds[label as usize].distance(at) > least * (1.0 + 1e-6)
        });
        let share = wrong.count() as f64 / 64f64.powi(2);
        assert!(share < 0.02, "{share}");
        let mut sums = CellSums::default();
        image.sums(&seeds, &mut sums);
        assert!((sums.mass.iter().sum::<f64>() / surface.area() - 1.0).abs() < 1e-6);
        // All texels are on the surface, and no two are far from each other.
        let off = image.samples().into_iter().map(|(at, ..)| image.texels.closest.distance(at));
        assert!(off.fold(0.0, f64::max) < 1e-6);
        for shape in [Shape::Sphere, Shape::Torus, Shape::Sheets] {
            let (_, mesh) = unit(&shape.build(300));
            let reason = Texels::new(&mesh, 16, &Token::default()).unwrap().err().unwrap();
            assert!(reason.to_string().contains("no disk"), "{reason}");
        }
    }
}
