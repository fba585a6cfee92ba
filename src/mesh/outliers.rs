//! Vertices that are far from all others.
//!
//! Purpose: [`count`] finds them for a report: one wrong coordinate makes a surface of which nearly all is a spike.
//! Invariant: depends on the vertices that facets use alone; linear time. Must not know: what is done about them.

use super::TriMesh;

/// An outlier is so many times as far from the middle of the vertices as half of them are.
const FAR: f64 = 1000.0;

/// How many vertices that a facet uses are farther from the median of all than 1000 times the median distance from it.
pub(crate) fn count(mesh: &TriMesh) -> usize {
    let mut used = vec![false; mesh.positions().len()];
    mesh.facets().iter().flatten().for_each(|&v| used[v as usize] = true);
    // Halves: coordinates may be as far apart as numbers go.
    let half: Vec<[f64; 3]> =
        mesh.positions().iter().zip(used).filter(|(_, used)| *used).map(|(p, _)| (*p * 0.5).to_array()).collect();
    let median = |mut values: Vec<f64>| {
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let centre = [0, 1, 2].map(|axis| median(half.iter().map(|p| p[axis]).collect()));
    let distance = |p: &[f64; 3]| (0..3).map(|axis| (p[axis] - centre[axis]).abs()).fold(0.0, f64::max);
    let near = median(half.iter().map(distance).collect());
    half.iter().filter(|p| near > 0.0 && distance(p) / near > FAR).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    #[test]
    fn a_wrong_coordinate_is_one_and_a_graded_surface_has_none() {
        for shape in Shape::ALL {
            let mesh = shape.build(300);
            assert_eq!(count(&mesh), 0, "{shape}");
            let mut positions = mesh.positions().to_vec();
            let v = mesh.facets()[0][0] as usize;
            for far in [1e5, 1e100, 1.5e308] {
                positions[v].x = -far;
                assert_eq!(
                    count(&TriMesh::new(positions.clone(), mesh.facets().to_vec()).unwrap()),
                    1,
                    "{shape}, {far:e}"
                );
            }
        }
    }
}
