//! Consistent orientation of facets.
//!
//! Purpose: [`make_consistent`] flips the facets that are oriented unlike most of the area of their component. A component
//! is connected through edges of two facets.
//! Invariant: a component that is not orientable (a Möbius strip) and one that is consistent, inward or outward, stay as
//! they are. Facets keep their numbers, and their first corners.
//! Must not know: the use of the surface.

use super::TriMesh;
use super::adjacency::{Adjacency, EdgeKind};
use crate::token::{Stopped, Token};

/// `mesh` with each component oriented as most of its area is, and how many facets were flipped; `None` if
/// none had to be. Linear in the facets.
pub(crate) fn make_consistent(mesh: &TriMesh, token: &Token) -> Result<Option<(TriMesh, usize)>, Stopped> {
    let adjacency = Adjacency::new(mesh);
    token.check()?;
    if adjacency.inconsistent_edges() == 0 {
        return Ok(None);
    }
    let area = |f: usize| {
        let [a, b, c] = mesh.corners(f);
        (b - a).cross(c - a).length()
    };
    let mut flipped: Vec<Option<bool>> = vec![None; mesh.facets().len()];
    let mut facets = mesh.facets().to_vec();
    let mut count = 0;
    for start in 0..facets.len() {
        if flipped[start].is_some() {
            continue;
        }
        flipped[start] = Some(false);
        let mut component = vec![start];
        let mut orientable = true;
        let mut next = 0;
        while let Some(&f) = component.get(next) {
            token.check_at(next)?;
            next += 1;
            for half in 3 * f..3 * f + 3 {
                let Some(other) = adjacency.opposite(half) else { continue };
                let inconsistent = adjacency.kind(half) == EdgeKind::Inconsistent;
                let expected = flipped[f].map(|t| t != inconsistent);
                match flipped[other / 3] {
                    None => {
                        flipped[other / 3] = expected;
                        component.push(other / 3);
                    }
                    known => orientable &= known == expected,
                }
            }
        }
        if !orientable {
            continue;
        }
        let of = |side: bool| component.iter().filter(|&&f| flipped[f] == Some(side)).map(|&f| area(f)).sum::<f64>();
        let fewer = of(true) <= of(false);
        for &f in component.iter().filter(|&&f| flipped[f] == Some(fewer)) {
            facets[f].swap(1, 2);
            count += 1;
        }
    }
    let flipped = (count > 0).then(|| TriMesh::new(mesh.positions().to_vec(), facets).ok()).flatten();
    Ok(flipped.map(|flipped| (flipped, count)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::shapes::Shape;

    fn flip(mesh: &TriMesh, which: impl Fn(usize) -> bool) -> TriMesh {
        let mut facets = mesh.facets().to_vec();
        facets.iter_mut().enumerate().filter(|(f, _)| which(*f)).for_each(|(_, t)| t.swap(1, 2));
        TriMesh::new(mesh.positions().to_vec(), facets).unwrap()
    }

    #[test]
    fn the_lesser_part_is_turned() {
        for shape in [Shape::Sphere, Shape::Plane, Shape::Torus, Shape::Sheets] {
            let mesh = shape.build(2000);
            assert!(
                make_consistent(&mesh, &Token::default()).unwrap().is_none()
                    && make_consistent(&flip(&mesh, |_| true), &Token::default()).unwrap().is_none(),
                "{shape}"
            );
            for every in [3, 7, 1000] {
                let (back, count) =
                    make_consistent(&flip(&mesh, |f| f % every == 0), &Token::default()).unwrap().unwrap();
                assert_eq!((back.facets(), count), (mesh.facets(), mesh.facets().len().div_ceil(every)), "{shape}");
            }
        }
    }

    #[test]
    fn what_has_no_orientation_stays() {
        // A strip of quadrilaterals whose ends meet with half a turn.
        let n = 12u32;
        let point = |k: u32| {
            let (t, side) =
                (f64::from(k / 2) / f64::from(n) * std::f64::consts::TAU, if k.is_multiple_of(2) { 0.3 } else { -0.3 });
            let r = 1.0 + side * (0.5 * t).cos();
            glam::dvec3(r * t.cos(), r * t.sin(), side * (0.5 * t).sin())
        };
        let at = |k: u32| if k >= 2 * n { (k - 2 * n) ^ 1 } else { k };
        let quad = |k: u32| [[at(2 * k), at(2 * k + 1), at(2 * k + 2)], [at(2 * k + 1), at(2 * k + 3), at(2 * k + 2)]];
        let mesh = TriMesh::new((0..2 * n).map(point).collect(), (0..n).flat_map(quad).collect()).unwrap();
        assert!(Adjacency::new(&mesh).inconsistent_edges() > 0);
        assert!(make_consistent(&mesh, &Token::default()).unwrap().is_none());
    }
}
