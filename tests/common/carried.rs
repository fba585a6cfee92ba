//! Surfaces that carry attributes.
#![allow(dead_code)]

use glam::{DVec2, DVec3, dvec2, dvec3};
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{Attributes, ColourDepth, Colours, Normals, PerCorner, Scalar};
use tessera::mesh::shapes::Shape;

pub fn texture(values: Vec<DVec2>, corners: Vec<[u32; 3]>) -> PerCorner<DVec2> {
    PerCorner { values, corners }
}

/// Every corner a value of its own, made by `uv(facet, position)`.
pub fn wedges(mesh: &TriMesh, uv: impl Fn(usize, DVec3) -> DVec2) -> PerCorner<DVec2> {
    let facets = 0..mesh.facets().len();
    let values = facets.clone().flat_map(|f| mesh.corners(f).map(|p| uv(f, p))).collect();
    texture(values, facets.map(|f| [0, 1, 2].map(|k| 3 * f as u32 + k)).collect())
}

pub fn centroid(mesh: &TriMesh, facet: usize) -> DVec3 {
    mesh.corners(facet).iter().sum::<DVec3>() / 3.0
}

/// Uv of each corner of a facet.
pub fn uvs(texture: &PerCorner<DVec2>, facet: usize) -> [DVec2; 3] {
    texture.corners[facet].map(|i| texture.values[i as usize])
}

/// A mesh with everything: two charts, normals, 8-bit colours, two scalars.
pub fn everything() -> (TriMesh, Attributes) {
    let mesh = Shape::Hills.build(300);
    let mut all = Attributes::new(&mesh);
    all.set_texture(wedges(&mesh, |f, p| {
        dvec2(p.x / 3.0 + if centroid(&mesh, f).x < 0.4 { 0.0 } else { 2.0 }, p.y / 7.0)
    }))
    .unwrap();
    all.set_normals(Normals::PerVertex(mesh.positions().iter().map(|p| dvec3(p.x, 0.3, 1.0)).collect())).unwrap();
    let values = (0..mesh.positions().len()).map(|i| [7, 11, 13, 17].map(|k| f64::from((i * k % 256) as u8) / 255.0));
    all.set_colours(Colours { values: values.collect(), depth: ColourDepth::Eight }).unwrap();
    all.add_scalar(Scalar::new("density", mesh.positions().iter().map(|p| p.x / 3.0).collect())).unwrap();
    all.add_scalar(Scalar::new("t", mesh.positions().iter().map(|p| p.z * 1e-300).collect())).unwrap();
    (mesh, all)
}
