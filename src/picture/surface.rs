//! A whole mesh as a picture.
//!
//! Purpose: [`draw_mesh`] paints facets and draws edges; [`shading_normals`] hides the facets of a dense
//! mesh behind smooth light. Invariant: every edge is drawn once. Must not know: how the mesh came about.

use glam::DVec3;

use super::{Canvas, Face, Image, PLAIN, Pens, Rgb, View, distinct, of_quality};
use geometry::mesh::TriMesh;
use geometry::mesh::adjacency::weld;
use geometry::mesh::csr::Csr;
use geometry::mesh::edges::{sides, undirected};
use geometry::mesh::measure::facet_quality;

/// What the colours of a mesh say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Paint {
    /// Nothing: one colour.
    #[default]
    Plain,
    /// The quality of each triangle, by [`of_quality`](super::of_quality).
    Quality,
    /// Which vertex is near: the thirds of a facet that belong to its corners.
    Cell,
    /// The region of each triangle; nothing where there are none.
    Region,
}

/// Faces that are made at a time.
const BATCH: usize = 1 << 16;

/// Draws `mesh` with its edges and, as bold lines, `features`, whose ends lie on it. `regions` has a number for each facet, or none.
pub fn draw_mesh(
    (mesh, regions): (&TriMesh, Option<&[u32]>),
    view: View,
    paint: Paint,
    features: &[[DVec3; 2]],
) -> Image {
    // An equilateral triangle's edge is longer than the side of a square of its area.
    let edge = (4.0 / 3f64.sqrt()).sqrt() * spacing(mesh, &view, mesh.facets().len());
    let pens = Pens::for_spacing(edge);
    let mut canvas = Canvas::new(view);
    let facets: Vec<usize> = (0..mesh.facets().len()).collect();
    let mut faces = Vec::new();
    for batch in facets.chunks(BATCH) {
        faces.clear();
        batch.iter().for_each(|&facet| paint_facet((mesh, regions), facet, paint, &mut faces));
        canvas.faces(&faces);
    }
    for [from, to] in edges(mesh) {
        canvas.line(mesh.positions()[from as usize], mesh.positions()[to as usize]);
    }
    features.iter().for_each(|ends| canvas.bold_line(ends[0], ends[1]));
    canvas.finish(&pens)
}

/// Pixels from one to the next of `count` things that share `mesh`: the side of a square of a share's area.
pub fn spacing(mesh: &TriMesh, view: &View, count: usize) -> f64 {
    // In pixels, where the areas of tiny and huge meshes are numbers too.
    let area = |facet: usize| {
        let [a, b, c] = mesh.corners(facet).map(|p| view.place(p));
        0.5 * (b - a).cross(c - a).length()
    };
    ((0..mesh.facets().len()).map(area).sum::<f64>() / count.max(1) as f64).sqrt()
}

fn paint_facet((mesh, regions): (&TriMesh, Option<&[u32]>), facet: usize, paint: Paint, faces: &mut Vec<Face>) {
    let corners = mesh.corners(facet);
    let whole = |colour: Rgb| Face { corners, colour, normal: None };
    match paint {
        Paint::Plain => faces.push(whole(PLAIN)),
        Paint::Region => {
            let region = regions.and_then(|regions| regions.get(facet));
            faces.push(whole(region.map_or(PLAIN, |&region| distinct(region))));
        }
        Paint::Quality => {
            // Scaled, so that lengths in a tiny or huge mesh can be squared.
            let sides = corners.map(|p| p - corners[0]);
            let size = sides[1].abs().max(sides[2].abs()).max_element();
            let unit = sides.map(|p| p / size);
            faces.push(whole(of_quality(facet_quality(unit))));
        }
        Paint::Cell => {
            let [a, b, c] = corners.map(|p| p / 3.0);
            let middle = a + b + c;
            for i in 0..3 {
                let (p, next, before) = (corners[i], corners[(i + 1) % 3], corners[(i + 2) % 3]);
                let third = [p, 0.5 * p + 0.5 * next, middle, 0.5 * p + 0.5 * before];
                faces.extend(Face::fan(&third, distinct(mesh.facets()[facet][i]), None));
            }
        }
    }
}

/// Each edge once, as the lower and the higher vertex.
fn edges(mesh: &TriMesh) -> Vec<[u32; 2]> {
    let all = mesh.facets().iter().flat_map(|&facet| sides(facet)).map(undirected);
    let mut edges: Vec<[u32; 2]> = all.filter(|[a, b]| a != b).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

/// Cosine of the angle up to which two facets count as one smooth surface: 45°.
pub const SOFT: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// A normal for each facet that takes up those of the facets around it, as far as they do not lie across a
/// crease (an angle whose cosine is below [`SOFT`]). [`Face::normal`] of a facet without area is `Some` zero.
pub fn shading_normals(mesh: &TriMesh) -> Vec<DVec3> {
    let (low, high) = mesh.bounds();
    let half = (0.5 * high - 0.5 * low).max_element();
    let own = |facet: usize| {
        let [a, b, c] = mesh.corners(facet).map(|p| (p - low) / half);
        (b - a).cross(c - a)
    };
    let own: Vec<DVec3> = (0..mesh.facets().len()).map(own).collect();
    let representative = weld(mesh);
    let facets: Vec<[u32; 3]> = mesh.facets().iter().map(|f| f.map(|v| representative[v as usize])).collect();
    let around = Csr::one_rings(mesh.positions().len(), &facets);
    let smooth = |(facet, corners): (usize, &[u32; 3])| {
        let unit = own[facet].normalize_or_zero();
        let near = corners.iter().flat_map(|&v| around.of(v));
        near.map(|&f| own[f as usize]).filter(|n| n.dot(unit) >= SOFT * n.length()).sum()
    };
    facets.iter().enumerate().map(smooth).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::mesh::shapes::Shape;

    #[test]
    fn edges_are_drawn_once() {
        let mesh = Shape::Sphere.build(500);
        assert_eq!(edges(&mesh).len(), mesh.facets().len() * 3 / 2);
    }

    #[test]
    fn light_is_smooth_on_a_sphere_and_keeps_a_crease() {
        let sphere = Shape::Sphere.build(2000);
        for (facet, normal) in shading_normals(&sphere).into_iter().enumerate() {
            let out = sphere.corners(facet).iter().sum::<DVec3>();
            assert!(normal.angle_between(out) < 0.02, "facet {facet}: {normal}");
        }
        let block = Shape::Block.build(1000);
        for normal in shading_normals(&block) {
            let unit = normal.normalize();
            assert!((unit.abs().max_element() - 1.0).abs() < 1e-12, "{unit} is not along an axis");
        }
    }

    #[test]
    fn a_facet_without_area_has_no_normal() {
        let points = vec![DVec3::ZERO, DVec3::X, DVec3::Y, 2.0 * DVec3::X];
        let mesh = TriMesh::new(points, vec![[0, 1, 2], [0, 1, 3]]).unwrap();
        assert!(shading_normals(&mesh)[1].is_finite());
    }
}
