//! Vertices that are far from all others.
//!
//! Purpose: [`find`] names them: one wrong coordinate makes a surface of which nearly all is a spike. [`draw_in`] gives the
//! same surface with short spikes.
//! Invariant: depends on the vertices that facets use alone; linear time. Vertices and facets keep their numbers.
//! Must not know: the use of the surface.

use glam::DVec3;

use super::TriMesh;

/// Distance of an outlier from the middle of the vertices, as a multiple of their median distance.
const FAR: f64 = 1000.0;

/// Distance of an outlier after it is drawn in, in the same measure.
const REACH: f64 = 10.0;

/// The middle of the vertices that a facet uses, the distance that half of them have from it at most, and how far each
/// vertex is; all halved, since coordinates may be as far apart as numbers go.
fn spread(mesh: &TriMesh) -> (DVec3, f64, Vec<Option<f64>>) {
    let mut used = vec![false; mesh.positions().len()];
    mesh.facets().iter().flatten().for_each(|&v| used[v as usize] = true);
    let half: Vec<DVec3> =
        mesh.positions().iter().zip(&used).filter(|(_, used)| **used).map(|(p, _)| *p * 0.5).collect();
    let median = |mut values: Vec<f64>| {
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let centre = DVec3::from_array([0, 1, 2].map(|axis| median(half.iter().map(|p| p[axis]).collect())));
    let distance = |p: DVec3| (p - centre).abs().max_element();
    let near = median(half.iter().map(|&p| distance(p)).collect());
    let all = mesh.positions().iter().zip(&used).map(|(&p, used)| used.then(|| distance(p * 0.5))).collect();
    (centre, near, all)
}

/// The vertices that are farther from the median of all than 1000 times the median distance from it, ascending.
pub(crate) fn find(mesh: &TriMesh) -> Vec<u32> {
    let (_, near, all) = spread(mesh);
    let is_far = |distance: &Option<f64>| near > 0.0 && distance.is_some_and(|d| d / near > FAR);
    (0..).zip(&all).filter(|(_, distance)| is_far(distance)).map(|(v, _)| v).collect()
}

/// Returns `mesh` with outliers drawn in towards the middle of the others, each on its line. `None` without outliers.
pub(crate) fn draw_in(mesh: &TriMesh) -> Option<TriMesh> {
    let far = find(mesh);
    if far.is_empty() {
        return None;
    }
    let (centre, near, all) = spread(mesh);
    let mut positions = mesh.positions().to_vec();
    for v in far {
        let from = positions[v as usize] * 0.5 - centre;
        positions[v as usize] = 2.0 * (centre + from * (REACH * near / all[v as usize]?));
    }
    TriMesh::new(positions, mesh.facets().to_vec()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn a_wrong_coordinate_is_one_and_a_graded_surface_has_none() {
        for shape in Shape::ALL {
            let mesh = shape.build(300);
            assert!(find(&mesh).is_empty() && draw_in(&mesh).is_none(), "{shape}");
            let mut positions = mesh.positions().to_vec();
            let v = mesh.facets()[0][0] as usize;
            for far in [1e5, 1e8, 1e11] {
                positions[v].x = -far;
                let stray = TriMesh::new(positions.clone(), mesh.facets().to_vec()).unwrap();
                assert_eq!(find(&stray), [v as u32], "{shape}, {far:e}");
                let near = draw_in(&stray).unwrap();
                assert!(find(&near).is_empty() && near.facets() == mesh.facets(), "{shape}, {far:e}");
            }
        }
    }
}
