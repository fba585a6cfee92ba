//! The sheets of a surface: what is connected through edges.
//!
//! Purpose: [`Sheets::of`] says which facets form one sheet. Facets on both sides of an edge of two facets are of one sheet. Where an
//! edge has more, they are paired: first those that the file joins by its vertices, then those with material between them, then
//! those that continue each other best along the curve. Sheets that share a vertex or such an edge touch, and no more.
//! Invariant: depends on the mesh alone, and on the area below which a sheet counts as noise: that one stays with a sheet it
//! touches. A facet that names a point twice is of a sheet that it touches. Must not know: why sheets are wanted.

mod pairing;
mod patches;
pub(crate) mod pieces;

use std::collections::BTreeMap;

use self::pairing::Pairing;
use super::adjacency::weld_unless;
use super::edges::{DisjointSets, EdgeGroups, undirected};
use super::{TriMesh, normal};
use crate::token::{Stopped, Token};

/// Which facets are of which sheet. Sheets are numbered in the order of their first vertices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Sheets {
    /// The sheet of each facet.
    pub of_facet: Vec<u32>,
    pub count: usize,
    /// Without what divides sheets that touch themselves.
    pub whole: usize,
    /// Edges at which several sheets meet, by their lowest vertices; ascending.
    pub seams: Vec<[u32; 2]>,
    /// Seams at which one sheet was divided, with two facets of its pieces that go on in each other.
    pub joined: Vec<([u32; 2], Link)>,
    /// Whether any two sheets have a place in common that is a vertex of both.
    pub touch: bool,
}

/// Two facets with an edge, through which a sheet goes on.
pub(crate) type Link = [u32; 2];

impl Sheets {
    /// The sheets of `mesh`. Those of at most the area `least` are joined to a sheet that they touch. Unless sheets `go_on` through edges
    /// of more than two facets, all end there.
    pub(crate) fn of(mesh: &TriMesh, least: f64, go_on: bool, token: &Token) -> Result<Self, Stopped> {
        let class = weld_unless(mesh, token)?;
        let welded = |t: &[u32; 3]| t.map(|v| class[v as usize]);
        let groups = EdgeGroups::unless(class.len(), whole_facets(mesh, &class), token)?;
        let mut sets = DisjointSets::new(mesh.facets().len());
        let mut is_manifold = true;
        // Nearly all, without a list for each.
        groups.for_each(|_, halves| match *halves {
            [a, b] => sets.join(a.facet as usize, b.facet as usize),
            _ => is_manifold &= halves.len() < 2,
        });
        token.check()?;
        if !is_manifold {
            let pairing = Pairing::of(mesh, (&class, &groups), go_on, token)?;
            pairing.links().for_each(|&[a, b]| sets.join(a as usize, b as usize));
        }
        let mut area = vec![0.0; mesh.facets().len()];
        for f in 0..mesh.facets().len() {
            area[sets.root(f)] += 0.5 * normal(mesh.corners(f)).length();
        }
        // The facet that a vertex was met with first: another one there touches it.
        let mut first = vec![None; class.len()];
        for (f, corners) in mesh.facets().iter().enumerate() {
            token.check_at(f)?;
            for v in welded(corners) {
                let [a, b] = [sets.root(*first[v as usize].get_or_insert(f)), sets.root(f)];
                if a != b && area[a].min(area[b]) <= least {
                    sets.join(a, b);
                    area[a.min(b)] = area[a] + area[b];
                }
            }
        }
        Ok(Self::numbered(mesh, &class, &groups, &mut sets))
    }

    /// Sheets of these facets, by their first vertices.
    fn numbered(mesh: &TriMesh, class: &[u32], groups: &EdgeGroups, sets: &mut DisjointSets) -> Self {
        let mut lowest: BTreeMap<usize, u32> = BTreeMap::new();
        for (f, corners) in mesh.facets().iter().enumerate() {
            let low = lowest.entry(sets.root(f)).or_insert(u32::MAX);
            *low = corners.iter().copied().fold(*low, u32::min);
        }
        let mut order: Vec<(u32, usize)> = lowest.into_iter().map(|(root, low)| (low, root)).collect();
        order.sort_unstable();
        let mut number = vec![0; mesh.facets().len()];
        order.iter().zip(0..).for_each(|(&(_, root), k)| number[root] = k);
        let of_facet: Vec<u32> = (0..mesh.facets().len()).map(|f| number[sets.root(f)]).collect();
        let mut seams = Vec::new();
        groups.for_each(|_, halves| {
            let mut sheets = halves.iter().map(|half| of_facet[half.facet as usize]);
            if let Some(first) = sheets.next()
                && sheets.any(|sheet| sheet != first)
            {
                let t = mesh.facets()[halves[0].facet as usize].map(|v| class[v as usize]);
                seams.push(undirected([t[halves[0].side], t[(halves[0].side + 1) % 3]]));
            }
        });
        let mut first = vec![None; class.len()];
        let touches = |(sheet, corners): (&u32, &[u32; 3])| {
            corners.iter().any(|&v| *first[class[v as usize] as usize].get_or_insert(*sheet) != *sheet)
        };
        let touch = of_facet.iter().zip(mesh.facets()).any(touches);
        Self { of_facet, count: order.len(), whole: order.len(), seams, touch, joined: Vec::new() }
    }
}

/// The facets that do not name a point twice, with their numbers, by the lowest vertices at their corners.
fn whole_facets<'a>(mesh: &'a TriMesh, class: &'a [u32]) -> impl Iterator<Item = (usize, [u32; 3])> + Clone + 'a {
    let facets = mesh.facets().iter().map(|t| t.map(|v| class[v as usize])).enumerate();
    facets.filter(|(_, [a, b, c])| a != b && b != c && c != a)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use glam::DVec3;

    use super::pieces::PieceOptions;
    use super::*;
    use crate::mesh::adjacency::Adjacency;
    use crate::mesh::apart::Apart;
    use crate::mesh::measure::topology;
    use crate::mesh::shapes::Shape;

    /// Cubes of a grid, seen from outside; sides between two of them are left out. `own`: each with vertices of its own.
    fn voxels(cubes: &[[u32; 3]], own: bool) -> TriMesh {
        let (mut positions, mut facets) = (Vec::new(), Vec::new());
        let mut number = std::collections::HashMap::new();
        for (k, cube) in cubes.iter().enumerate() {
            for (axis, side) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                let mut other = cube.map(i64::from);
                other[axis] += 2 * side - 1;
                if cubes.iter().any(|c| c.map(i64::from) == other) {
                    continue;
                }
                let mut at = |u: u32, v: u32| {
                    let mut p = *cube;
                    p[axis] += side as u32;
                    p[(axis + 1) % 3] += u;
                    p[(axis + 2) % 3] += v;
                    *number.entry((if own { k } else { 0 }, p)).or_insert_with(|| {
                        positions.push(DVec3::from_array(p.map(f64::from)));
                        positions.len() as u32 - 1
                    })
                };
                let quad = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                let [a, b, c, d] = if side == 1 { quad } else { [quad[0], quad[3], quad[2], quad[1]] };
                facets.extend([[a, b, c], [a, c, d]]);
            }
        }
        TriMesh::new(positions, facets).unwrap()
    }

    fn turned(mesh: &TriMesh) -> TriMesh {
        let facets = mesh.facets().iter().map(|&[a, b, c]| [a, c, b]).collect();
        TriMesh::new(mesh.positions().to_vec(), facets).unwrap()
    }

    fn of(mesh: &TriMesh) -> Sheets {
        Sheets::of(mesh, 0.0, true, &Token::default()).unwrap()
    }

    #[test]
    fn solids_that_touch_are_solids_each() {
        // In a corner; along an edge; both; a chain of edges; three at an edge of the same two places.
        for cubes in [
            &[[0, 0, 0], [1, 1, 1]][..],
            &[[0, 0, 0], [1, 1, 0]],
            &[[0, 0, 0], [1, 1, 0], [2, 2, 1]],
            &[[0, 0, 0], [1, 1, 0], [0, 2, 0], [1, 3, 0]],
            &[[1, 1, 1], [0, 0, 1], [2, 0, 1], [1, 2, 2]],
        ] {
            for mesh in [false, true].map(|own| voxels(cubes, own)) {
                for mesh in [mesh.clone(), turned(&mesh)] {
                    let sheets = of(&mesh);
                    assert_eq!(sheets.count, cubes.len(), "{cubes:?}");
                    let apart = Apart::of(&mesh, &sheets, 0.5).unwrap().mesh;
                    let (whole, n) = (topology(&apart), cubes.len());
                    assert_eq!((whole.components, whole.euler, whole.boundary_edges), (n, 2 * n as i64, 0));
                    assert_eq!(Adjacency::new(&apart).non_manifold_edges, 0);
                }
            }
        }
        // Solids that share a side are one if the side is left out.
        assert_eq!(of(&voxels(&[[0, 0, 0], [1, 0, 0]], false)).count, 1);
    }

    #[test]
    fn a_solid_that_touches_itself_is_in_pieces() {
        let options = PieceOptions { least: 0.5, least_plane: 0.5, go_on: true, crease: 0.5 };
        let pieces = |mesh: &TriMesh| of(mesh).in_pieces(mesh, options, &Token::default()).unwrap();
        // Ends of a chain that meet in an edge; in a corner; two squares of one plane; a ring around nothing.
        for cubes in [
            &[[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 1, 0], [1, 1, 1]][..],
            &[[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 1, 1], [1, 1, 1]],
            &[[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 1, 0], [1, 1, 1]],
        ] {
            for mesh in [voxels(cubes, false), turned(&voxels(cubes, false))] {
                let whole = of(&mesh);
                let pieces = pieces(&mesh).unwrap();
                assert_eq!((whole.count, pieces.whole), (1, 1), "{cubes:?}");
                assert!(pieces.count > 1 && !pieces.joined.is_empty());
                let apart = Apart::of(&mesh, &pieces, 0.5).unwrap().mesh;
                let topology = topology(&apart);
                let flaws = (topology.non_manifold_edges, topology.non_manifold_vertices);
                assert_eq!((topology.components, flaws), (pieces.count, (0, 0)), "{cubes:?}");
                // Whatever is smaller than a piece would have to be stays as it is.
                let least = PieceOptions { least: mesh.area(), least_plane: mesh.area(), ..options };
                assert_eq!(whole.in_pieces(&mesh, least, &Token::default()), Ok(None));
            }
        }
        let ring = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [2, 1, 0], [0, 2, 0], [1, 2, 0], [2, 2, 0]];
        assert_eq!(pieces(&voxels(&ring, false)), None);
    }

    #[test]
    fn a_sheet_that_ends_on_another_is_one_of_its_own() {
        // A wall on a floor, that the file joins to it, or not.
        let (floor, n) = (Shape::Plane.build(800), 800);
        let (low, high) = floor.bounds();
        let middle =
            floor.positions().iter().map(|p| (p.x - (low.x + high.x) / 2.0).abs()).fold(f64::INFINITY, f64::min);
        let line: Vec<u32> = (0..floor.positions().len() as u32)
            .filter(|&v| ((floor.positions()[v as usize].x - (low.x + high.x) / 2.0).abs() - middle).abs() < 1e-9)
            .collect();
        assert!(line.len() > 5 && floor.facets().len() <= 2 * n);
        let x = floor.positions()[line[0] as usize].x;
        let mut line: Vec<u32> =
            line.into_iter().filter(|&v| (floor.positions()[v as usize].x - x).abs() < 1e-9).collect();
        line.sort_by(|&a, &b| floor.positions()[a as usize].y.total_cmp(&floor.positions()[b as usize].y));
        for joined in [true, false] {
            let (mut positions, mut facets) = floor.clone().into_parts();
            let mut foot = line.clone();
            if !joined {
                for v in &mut foot {
                    positions.push(positions[*v as usize]);
                    *v = positions.len() as u32 - 1;
                }
            }
            let top: Vec<u32> = foot
                .iter()
                .map(|&v| {
                    positions.push(positions[v as usize] + DVec3::Z);
                    positions.len() as u32 - 1
                })
                .collect();
            for (f, t) in foot.windows(2).zip(top.windows(2)) {
                facets.extend([[f[0], f[1], t[1]], [f[0], t[1], t[0]]]);
            }
            let mesh = TriMesh::new(positions, facets).unwrap();
            let sheets = of(&mesh);
            assert_eq!(sheets.count, 2, "{joined}");
            let floor_facets = floor.facets().len();
            assert!(sheets.of_facet[..floor_facets].iter().all(|&s| s == sheets.of_facet[0]));
            // A wall that is smaller than what counts stays with the floor.
            let wall = mesh.area() - floor.area();
            assert_eq!(Sheets::of(&mesh, 1.01 * wall, true, &Token::default()).unwrap().count, 1);
        }
    }
}
