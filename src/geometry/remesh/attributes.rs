//! Attributes of the input, carried to the remesh.
//!
//! Purpose: [`provenance`] tells where on the input the vertices of the result lie, [`carry`] brings its attributes there.
//! Invariant: what is given per vertex is interpolated in the facet and stays between its corners' values; whole numbers are
//! those of the nearest corner. What is given per corner comes from one side of a seam for each result facet. The result depends on the meshes alone, not on threads.
//! Must not know: how the result came about, files, messages.

pub(super) mod regions;
mod seams;

use glam::DVec3;
use rayon::prelude::*;

use crate::mesh::TriMesh;
use crate::mesh::attributes::{AttributeError, Attributes, Colours, Normals, PerCorner, Scalar, unit};
use crate::mesh::closest_point::{ClosestPoint, SurfacePoint};
use crate::mesh::coincident;
use crate::mesh::numbers::NumberType;
use crate::remesh::constants::{ROUNDING_SQUARED, SAME_NORMAL};
use crate::tasks;
use crate::token::{Stopped, Token};
use seams::{Seams, Source};

/// Where on the input surface a vertex of the result lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Provenance {
    /// The input's facet.
    pub facet: u32,
    /// Barycentric coordinates in it: at least 0, their sum is 1 up to rounding.
    pub barycentric: [f64; 3],
}

/// The closest point of the input to each of `positions`.
pub fn provenance(closest: &ClosestPoint, positions: &[DVec3], token: &Token) -> Result<Vec<Provenance>, Stopped> {
    let place = |p: SurfacePoint| Provenance { facet: p.facet, barycentric: p.barycentric };
    Ok(closest.project_all(positions, token)?.into_iter().map(place).collect())
}

/// The attributes of `result`, whose vertices lie on `mesh` where `provenance` says. `closest` answers for `mesh`.
///
/// Normals come out of unit length: where the interpolated one vanishes, or none is known, it is the input facet's. Texture
/// coordinates beyond a seam or a border are extrapolated linearly from the facet at it.
///
/// # Errors
/// `OtherMesh` if the attributes are not `mesh`'s, `Count` if the provenance is not `result`'s.
pub fn carry(
    mesh: &TriMesh,
    attributes: &Attributes,
    closest: &ClosestPoint,
    result: &TriMesh,
    provenance: &[Provenance],
) -> Result<Attributes, AttributeError> {
    attributes.check_mesh(mesh)?;
    let vertices = result.positions().len();
    if provenance.len() != vertices {
        let (attribute, count) = ("provenance".to_owned(), provenance.len());
        return Err(AttributeError::Count { attribute, count, expected: vertices, of: "vertices" });
    }
    let mut carried = Attributes::new(result);
    let facets = mesh.facets();
    // Vertices that are split so that each side has a normal of its own are corners by another name.
    let split = match attributes.normals() {
        Some(Normals::PerVertex(normals)) if has_hard_edges(mesh, normals) => {
            Some(Normals::PerCorner(PerCorner { values: normals.clone(), corners: facets.to_vec() }))
        }
        _ => None,
    };
    let normals = split.as_ref().or(attributes.normals());
    let needs_seams = matches!(normals, Some(Normals::PerCorner(_))) || attributes.texture().is_some();
    let seams = needs_seams.then(|| Seams::new(mesh, closest, result, provenance));
    match (normals, &seams) {
        (Some(Normals::PerVertex(normals)), _) => {
            let at = |p: &Provenance| normal(mesh, p.facet, facets[p.facet as usize], normals, p.barycentric);
            carried.set_normals(Normals::PerVertex(tasks::map(vertices, |v| at(&provenance[v]))))?;
        }
        (Some(Normals::PerCorner(normals)), Some(seams)) => {
            let at =
                |p: &Source| normal(mesh, p.facet, normals.corners[p.facet as usize], &normals.values, p.barycentric);
            carried.set_normals(Normals::PerCorner(seams.split(normals, at)))?;
        }
        _ => {}
    }
    if let (Some(texture), Some(seams)) = (attributes.texture(), &seams) {
        carried.set_texture(seams.split(texture, |p| seams.texture_at(texture, p)))?;
    }
    if let Some(Colours { values, depth }) = attributes.colours() {
        let colour = |p: &Provenance| {
            let [a, b, c] = facets[p.facet as usize].map(|v| values[v as usize]);
            std::array::from_fn(|i| between([a[i], b[i], c[i]], p.barycentric))
        };
        let values = tasks::map(vertices, |v| colour(&provenance[v]));
        carried.set_colours(Colours { values, depth: *depth })?;
    }
    for Scalar { name, number, components, values: given } in attributes.scalars() {
        let (name, n) = (name.clone(), *components);
        let of = |vertex: u32| &given[n * vertex as usize..][..n];
        let mut values = vec![0.0; n * vertices];
        values.par_chunks_exact_mut(n).zip(provenance).for_each(|(to, p)| {
            if number.is_float() {
                let [a, b, c] = facets[p.facet as usize].map(of);
                to.iter_mut().enumerate().for_each(|(i, to)| *to = between([a[i], b[i], c[i]], p.barycentric));
            } else {
                to.copy_from_slice(of(nearest_corner(mesh, p)));
            }
        });
        carried.add_scalar(Scalar { name, number: *number, components: n, values })?;
    }
    Ok(carried)
}

/// Names of the scalars that say where on the input a vertex lies.
const SOURCE: [&str; 2] = ["source_facet", "source_barycentric"];

/// Adds where on the input the vertices lie, in place of what an input carries from a remesh before.
pub(super) fn add_source_map(attributes: &mut Attributes, places: &[Provenance]) -> Result<(), AttributeError> {
    attributes.retain_scalars(|name| !SOURCE.contains(&name));
    let [facet, barycentric] = SOURCE.map(str::to_owned);
    let values = places.iter().map(|place| f64::from(place.facet)).collect();
    attributes.add_scalar(Scalar { name: facet, number: NumberType::I32, components: 1, values })?;
    let values = places.iter().flat_map(|place| place.barycentric).collect();
    attributes.add_scalar(Scalar { name: barycentric, number: NumberType::F64, components: 3, values })
}

/// The vertex of the facet that is nearest; of equally near ones the first.
fn nearest_corner(mesh: &TriMesh, place: &Provenance) -> u32 {
    let corners = mesh.corners(place.facet as usize);
    let point: DVec3 = corners.iter().zip(place.barycentric).map(|(&corner, weight)| corner * weight).sum();
    let facet = mesh.facets()[place.facet as usize];
    let distance = |&(_, corner): &(u32, DVec3)| corner.distance_squared(point);
    let order = |a: &(u32, DVec3), b: &(u32, DVec3)| distance(a).total_cmp(&distance(b)).then(a.0.cmp(&b.0));
    facet.into_iter().zip(corners).min_by(order).map_or(facet[0], |(vertex, _)| vertex)
}

/// Whether vertices in one place have different normals.
fn has_hard_edges(mesh: &TriMesh, normals: &[DVec3]) -> bool {
    let differ = |&(later, earliest): &(u32, u32)| {
        let [p, q] = [later, earliest].map(|v| unit(normals[v as usize]));
        p.dot(q) < SAME_NORMAL
    };
    coincident::find(mesh.positions()).iter().any(differ)
}

/// Interpolated, and despite rounding not outside of what it is interpolated from.
fn between(values: [f64; 3], weights: [f64; 3]) -> f64 {
    let [a, b, c] = values;
    if !(a + b + c).is_finite() && !values.iter().all(|x| x.is_finite()) {
        // A value counts where it has weight, and is a gap there.
        return (0..3).filter(|&i| weights[i] > 0.0).map(|i| values[i] * weights[i]).sum();
    }
    // Halves, so that a sum near the largest double does not overflow on its way.
    let half = (0.5 * a) * weights[0] + (0.5 * b) * weights[1] + (0.5 * c) * weights[2];
    (2.0 * half).clamp(a.min(b).min(c), a.max(b).max(c))
}

/// The normal inside of `facet`, at whose corners are the `normals` with these indices.
fn normal(mesh: &TriMesh, facet: u32, indices: [u32; 3], normals: &[DVec3], weights: [f64; 3]) -> DVec3 {
    let [a, b, c] = indices.map(|i| normals[i as usize]);
    let sum = a * weights[0] + b * weights[1] + c * weights[2];
    if sum.length_squared() > ROUNDING_SQUARED { unit(sum) } else { facet_normal(mesh.corners(facet as usize)) }
}

/// Of unit length; zero for a facet without area.
fn facet_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    // Scaled first, so that a small surface keeps its normals.
    let (ab, ac) = (b - a, c - a);
    let size = ab.abs().max(ac.abs()).max_element();
    let scale = if size > 0.0 { size } else { 1.0 };
    unit((ab / scale).cross(ac / scale))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn interpolation_stays_between_and_keeps_corners() {
        let third = 1.0 / 3.0;
        assert_eq!(between([0.1, 0.1, 0.1], [third; 3]), 0.1);
        assert_eq!(between([0.3, 1e300, -7.0], [1.0, 0.0, 0.0]), 0.3);
        assert_eq!(between([f64::MAX; 3], [third, third, third + 1e-16]), f64::MAX);
        assert_eq!(between([f64::NAN, 2.0, 4.0], [0.0, 0.5, 0.5]), 3.0);
        assert!(between([f64::NAN, 2.0, 4.0], [0.1, 0.5, 0.4]).is_nan());
    }

    #[test]
    fn where_normals_cancel_the_facets_own_is_taken() {
        let mesh = Shape::Square.build(2);
        let opposite = [DVec3::X, DVec3::NEG_X, DVec3::ZERO];
        assert_eq!(normal(&mesh, 0, [0, 1, 2], &opposite, [0.5, 0.5, 0.0]), DVec3::Z);
        assert_eq!(normal(&mesh, 0, [0, 1, 2], &opposite, [0.75, 0.25, 0.0]), DVec3::X);
    }

    #[test]
    fn attributes_of_another_mesh_are_refused() {
        let (mesh, other) = (Shape::Plane.build(500), Shape::Square.build(2));
        let closest = ClosestPoint::new(&mesh);
        let places = provenance(&closest, other.positions(), &Token::default()).unwrap();
        let wrong = carry(&mesh, &Attributes::new(&other), &closest, &other, &places);
        assert!(matches!(wrong, Err(AttributeError::OtherMesh { .. })));
        let short = carry(&mesh, &Attributes::new(&mesh), &closest, &other, &places[1..]);
        assert!(matches!(short, Err(AttributeError::Count { .. })));
    }
}
