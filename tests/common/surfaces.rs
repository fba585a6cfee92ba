//! temporary
use glam::DVec3;
use tessera::mesh::TriMesh;
pub fn all() -> Vec<(&'static str, TriMesh)> {
    let mut p = vec![DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z];
    let mut f: Vec<[u32; 3]> =
        vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
    for _ in 0..3 {
        let mut m = std::collections::HashMap::new();
        let mut g = vec![];
        for t in &f {
            let mut mid = [0; 3];
            for e in 0..3 {
                let (a, b) = (t[e], t[(e + 1) % 3]);
                mid[e] = *m.entry((a.min(b), a.max(b))).or_insert_with(|| {
                    p.push((p[a as usize] + p[b as usize]).normalize());
                    p.len() as u32 - 1
                });
            }
            g.extend([[t[0], mid[0], mid[2]], [t[1], mid[1], mid[0]], [t[2], mid[2], mid[1]], mid]);
        }
        f = g;
    }
    let square =
        TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::new(1., 1., 0.), DVec3::Y], vec![[0, 1, 2], [0, 2, 3]])
            .unwrap();
    let mut grid = vec![];
    let mut gf = vec![];
    for y in 0..9u32 {
        for x in 0..9u32 {
            grid.push(DVec3::new(x as f64, y as f64 * 0.001, 0.0));
        }
    }
    for y in 0..8u32 {
        for x in 0..8u32 {
            let a = y * 9 + x;
            gf.push([a, a + 1, a + 10]);
            gf.push([a, a + 10, a + 9]);
        }
    }
    vec![("sphere", TriMesh::new(p, f).unwrap()), ("square", square), ("slivers", TriMesh::new(grid, gf).unwrap())]
}
