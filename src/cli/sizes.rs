//! `--sizes` and `--creases`: files of numbers that go by the vertices of the input file.
//!
//! Purpose: reads them; what the numbers mean is `mesh::io::lists`. Invariant: errors name the file and the line.
//! Must not know: what lengths and pairs are for.

use std::path::Path;

use anyhow::Result;

use super::exit::{BadInput, Usage};
use super::files::{self, Surface};
use geometry::mesh::TriMesh;
use geometry::mesh::io::DataError;
use geometry::mesh::io::lists::{FileVertices, NO_NUMBERS};
use geometry::token::Token;

/// Refuses a file whose vertices have no numbers, for which `option` has a list.
pub(crate) fn check_format(input: &Surface, option: &str) -> Result<()> {
    if input.is_standard() {
        return Err(Usage(format!("{option}: needs a file; the standard input can be read only once")).into());
    }
    match FileVertices::are_numbered(input.format(files::INPUT_FORMAT)?) {
        true => Ok(()),
        false => Err(Usage(format!("{option}: {input}: {NO_NUMBERS}")).into()),
    }
}

/// Reads one number a line from `path`, for the vertices of the file `input`, which was read as `mesh`. Empty
/// lines and lines that begin with `#` are left out.
pub(crate) fn read(path: &Path, input: &Surface, mesh: &TriMesh) -> Result<Vec<f64>> {
    list(path, input, mesh, |vertices, text| vertices.lengths(text, &Token::default()))
}

/// Reads two vertices of the file `input` a line from `path`, numbered from 0: edges of `mesh`, which was read from it.
/// Empty lines and lines that begin with `#` are left out.
pub(crate) fn read_edges(path: &Path, input: &Surface, mesh: &TriMesh) -> Result<Vec<[u32; 2]>> {
    list(path, input, mesh, |vertices, text| vertices.edges(text, mesh.facets().len(), &Token::default()))
}

fn list<T>(
    path: &Path,
    input: &Surface,
    mesh: &TriMesh,
    read: impl FnOnce(&FileVertices, &str) -> Result<T, DataError>,
) -> Result<T> {
    let text = files::read_text(path)?;
    let format = input.format(files::INPUT_FORMAT)?;
    let bytes = match FileVertices::needs_bytes(format) {
        true => input.bytes()?,
        false => Vec::new(),
    };
    let vertices = FileVertices::of(format, &bytes, mesh);
    let vertices = vertices.map_err(|error| BadInput(format!("{input}: {error}")))?;
    Ok(read(&vertices, &text).map_err(|error| BadInput(format!("{}: {error}", path.display())))?)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use geometry::mesh::io;

    #[test]
    fn lengths_follow_the_vertices_of_an_obj() {
        let folder = tempfile::tempdir().unwrap();
        let (input, path) = (folder.path().join("a.obj"), folder.path().join("sizes.txt"));
        let obj = "v 9 9 9\nv 0 0 0 # first\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 4/1 \\\n 5/1 2/1\nf -4 -3 -2/1\n";
        std::fs::write(&input, obj).unwrap();
        std::fs::write(&path, "# a length each\n0.9\n0.1\n\n0.2\n0.3\n0.4\n").unwrap();
        let mesh = io::read(&input).unwrap();
        let sizes = read(&path, &Surface::new(&input, None), &mesh).unwrap();
        let want = |p: &DVec3| 0.1 + 0.1 * if p.y == 0.0 { p.x } else { 3.0 - p.x };
        assert_eq!(sizes.len(), 4, "the vertex that no face uses is left out");
        for (p, h) in mesh.positions().iter().zip(&sizes) {
            assert!((h - want(p)).abs() < 1e-12, "{p}: {h}");
        }
        // A homogeneous coordinate moves vertices, and changes no number.
        std::fs::write(&input, obj.replace("v 1 1 0", "v 2 2 0 2")).unwrap();
        let divided = io::read(&input).unwrap();
        assert_eq!(divided.positions(), mesh.positions());
        assert_eq!(read(&path, &Surface::new(&input, None), &divided).unwrap(), sizes);
    }

    #[test]
    fn a_bad_line_and_a_wrong_count_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (input, path) = (folder.path().join("a.off"), folder.path().join("sizes.txt"));
        std::fs::write(&input, "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").unwrap();
        let mesh = io::read(&input).unwrap();
        std::fs::write(&path, "1\n2\n3\n").unwrap();
        assert_eq!(read(&path, &Surface::new(&input, None), &mesh).unwrap(), [1.0, 2.0, 3.0]);
        std::fs::write(&path, "1\n2\n-3\n").unwrap();
        assert!(read(&path, &Surface::new(&input, None), &mesh).unwrap_err().to_string().contains("line 3"));
        std::fs::write(&path, "1\n2\n").unwrap();
        assert!(read(&path, &Surface::new(&input, None), &mesh).unwrap_err().to_string().contains("3 vertices"));
        assert!(check_format(&Surface::new(Path::new("a.stl"), None), "--sizes").is_err());
    }

    #[test]
    fn edges_follow_the_vertices_of_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("creases.txt");
        std::fs::write(&path, "# from 0\n1 2\n\n 4 1\n").unwrap();
        let files = [
            ("a.obj", "v 9 9 9\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 4 5 2\nf 2 3 4\n"),
            ("a.off", "OFF 5 2 0\n9 9 9\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n3 3 4 1\n3 1 2 3\n"),
        ];
        for (name, text) in files {
            let input = folder.path().join(name);
            std::fs::write(&input, text).unwrap();
            let mesh = io::read(&input).unwrap();
            let at = |v: u32| mesh.positions()[v as usize];
            let edges = read_edges(&path, &Surface::new(&input, None), &mesh).unwrap();
            let ends: Vec<[DVec3; 2]> = edges.iter().map(|e| e.map(at)).collect();
            assert_eq!(ends, [[DVec3::ZERO, DVec3::X], [DVec3::Y, DVec3::ZERO]], "{name}");
            for bad in ["1 2\n1\n", "1 2\n1 2 3\n", "1 2\n-1 2\n", "1 2\n1 5\n", "1 2\n1 x\n"] {
                let path = folder.path().join("bad.txt");
                std::fs::write(&path, bad).unwrap();
                let error = read_edges(&path, &Surface::new(&input, None), &mesh).unwrap_err().to_string();
                assert!(error.contains("line 2"), "{name}, {bad:?}: {error}");
            }
        }
    }
}
