//! `--sizes` and `--creases`: an edge length for each vertex of a file, and pairs of its vertices.
//!
//! Purpose: numbers that go by the file's own vertices, brought to those of the surface that was read.
//! Invariant: PLY and OFF vertices keep their numbers. OBJ vertices are numbered by first use in a face, and the
//! ones that no face uses are left out; the order is read from the file once more and compared with the surface, so
//! that a length never lands on another vertex. STL has no vertices to speak of. Must not know: what lengths and pairs are for.

use std::path::Path;

use anyhow::Result;
use glam::DVec3;

use super::exit::{BadInput, NoInput, Usage};
use super::files;
use crate::mesh::TriMesh;
use crate::mesh::io::Format;

/// Refuses a file whose vertices have no numbers, for which `option` has a list.
pub(crate) fn check_format(input: &Path, option: &str) -> Result<()> {
    match Format::of_path(input)? {
        Format::Stl => {
            let text =
                format!("{option}: {} has no numbered vertices; convert it to .ply, .obj or .off", input.display());
            Err(Usage(text).into())
        }
        Format::Obj | Format::Ply | Format::Off => Ok(()),
    }
}

/// Reads one number a line from `path`, for the vertices of the file `input`, which was read as `mesh`. Empty
/// lines and lines that begin with `#` are left out.
pub(crate) fn read(path: &Path, input: &Path, mesh: &TriMesh) -> Result<Vec<f64>> {
    let bad = |text: String| BadInput(format!("{}: {text}", path.display()));
    let text = files::read_text(path)?;
    let mut sizes = Vec::new();
    for (i, line) in text.lines().enumerate().map(|(i, line)| (i, line.trim())) {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        match line.parse::<f64>() {
            Ok(size) if size.is_finite() && size > 0.0 => sizes.push(size),
            _ => return Err(bad(format!("line {} is not a finite number above 0: {line:?}", i + 1)).into()),
        }
    }
    let count = |vertices: usize| {
        let text =
            format!("{} lengths, but {} has {vertices} vertices; give one for each", sizes.len(), input.display());
        if sizes.len() == vertices { Ok(()) } else { Err(bad(text)) }
    };
    let Some(order) = file_order(input, mesh)? else {
        count(mesh.positions().len())?;
        return Ok(sizes);
    };
    count(order.file_vertices)?;
    Ok(order.of_vertex.iter().map(|&v| sizes[v]).collect())
}

/// Reads two vertices of the file `input` a line from `path`, numbered from 0: edges of `mesh`, which was read from it.
/// Empty lines and lines that begin with `#` are left out.
pub(crate) fn read_edges(path: &Path, input: &Path, mesh: &TriMesh) -> Result<Vec<[u32; 2]>> {
    let bad = |text: String| BadInput(format!("{}: {text}", path.display()));
    let text = files::read_text(path)?;
    let order = file_order(input, mesh)?;
    let vertices = order.as_ref().map_or(mesh.positions().len(), |o| o.file_vertices);
    // Where the file's vertices are in the surface.
    let place: Option<Vec<Option<u32>>> = order.map(|order| {
        let mut place = vec![None; order.file_vertices];
        order.of_vertex.iter().zip(0..).for_each(|(&v, k)| place[v] = Some(k));
        place
    });
    let mut edges = Vec::new();
    for (i, line) in text.lines().enumerate().map(|(i, line)| (i, line.trim())) {
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let at = |text: String| bad(format!("line {}: {text}", i + 1));
        let numbers: Result<Vec<usize>, _> = line.split_whitespace().map(str::parse).collect();
        let Ok(&[a, b]) = numbers.as_deref() else {
            return Err(at(format!("not two numbers of vertices, which begin at 0: {line:?}")).into());
        };
        let vertex = |v: usize| match &place {
            _ if v >= vertices => {
                Err(at(format!("there is no vertex {v}; {} has {vertices}, numbered from 0", input.display())))
            }
            Some(place) => place[v].ok_or_else(|| at(format!("no facet has vertex {v}"))),
            None => Ok(v as u32),
        };
        edges.push([vertex(a)?, vertex(b)?]);
    }
    Ok(edges)
}

/// Which vertex of its file each vertex of a surface is.
struct Order {
    of_vertex: Vec<usize>,
    file_vertices: usize,
}

/// The order of the vertices of `mesh`, which was read from `input`; `None` if it is the file's.
fn file_order(input: &Path, mesh: &TriMesh) -> Result<Option<Order>> {
    if Format::of_path(input)? != Format::Obj {
        return Ok(None);
    }
    let bytes = std::fs::read(input).map_err(|cause| NoInput { path: input.to_owned(), cause })?;
    let (positions, order) = obj_order(&String::from_utf8_lossy(&bytes));
    let found: Option<Vec<&DVec3>> = order.iter().map(|&v| positions.get(v)).collect();
    if found.is_none_or(|found| !found.into_iter().eq(mesh.positions())) {
        let text = format!("cannot tell which vertex of {} is which; convert it to .ply", input.display());
        return Err(BadInput(text).into());
    }
    Ok(Some(Order { of_vertex: order, file_vertices: positions.len() }))
}

/// Vertices of an OBJ file, and those that faces use, by first use. NaN for what is no number.
fn obj_order(text: &str) -> (Vec<DVec3>, Vec<usize>) {
    let text = text.trim_start_matches('\u{feff}').replace("\\\r\n", " ").replace("\\\n", " ");
    let (mut positions, mut corners) = (Vec::new(), Vec::new());
    for line in text.lines() {
        let mut words = line.split('#').next().unwrap_or_default().split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let mut number = || words.next().and_then(|word| word.parse().ok()).unwrap_or(f64::NAN);
                positions.push(DVec3::new(number(), number(), number()));
            }
            Some("f") => corners.extend(words.filter_map(|word| {
                let index: i64 = word.split('/').next()?.parse().ok()?;
                // From 1, or from the last one back.
                usize::try_from(if index < 0 { positions.len() as i64 + index } else { index - 1 }).ok()
            })),
            _ => {}
        }
    }
    let mut seen = vec![false; positions.len()];
    corners.retain(|&v| seen.get_mut(v).is_none_or(|seen| !std::mem::replace(seen, true)));
    (positions, corners)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::io;

    #[test]
    fn lengths_follow_the_vertices_of_an_obj() {
        let folder = tempfile::tempdir().unwrap();
        let (input, path) = (folder.path().join("a.obj"), folder.path().join("sizes.txt"));
        let obj = "v 9 9 9\nv 0 0 0 # first\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 4/1 \\\n 5/1 2/1\nf -4 -3 -2/1\n";
        std::fs::write(&input, obj).unwrap();
        std::fs::write(&path, "# a length each\n0.9\n0.1\n\n0.2\n0.3\n0.4\n").unwrap();
        let mesh = io::read(&input).unwrap();
        let sizes = read(&path, &input, &mesh).unwrap();
        let want = |p: &DVec3| 0.1 + 0.1 * if p.y == 0.0 { p.x } else { 3.0 - p.x };
        assert_eq!(sizes.len(), 4, "the vertex that no face uses is left out");
        for (p, h) in mesh.positions().iter().zip(&sizes) {
            assert!((h - want(p)).abs() < 1e-12, "{p}: {h}");
        }
        // A homogeneous coordinate moves vertices; that is noticed.
        std::fs::write(&input, obj.replace("v 1 1 0", "v 2 2 0 2")).unwrap();
        let mesh = io::read(&input).unwrap();
        assert!(read(&path, &input, &mesh).unwrap_err().to_string().contains(".ply"));
    }

    #[test]
    fn a_bad_line_and_a_wrong_count_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let (input, path) = (folder.path().join("a.off"), folder.path().join("sizes.txt"));
        std::fs::write(&input, "OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").unwrap();
        let mesh = io::read(&input).unwrap();
        std::fs::write(&path, "1\n2\n3\n").unwrap();
        assert_eq!(read(&path, &input, &mesh).unwrap(), [1.0, 2.0, 3.0]);
        std::fs::write(&path, "1\n2\n-3\n").unwrap();
        assert!(read(&path, &input, &mesh).unwrap_err().to_string().contains("line 3"));
        std::fs::write(&path, "1\n2\n").unwrap();
        assert!(read(&path, &input, &mesh).unwrap_err().to_string().contains("3 vertices"));
        assert!(check_format(Path::new("a.stl"), "--sizes").is_err());
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
            let edges = read_edges(&path, &input, &mesh).unwrap();
            let ends: Vec<[DVec3; 2]> = edges.iter().map(|e| e.map(at)).collect();
            assert_eq!(ends, [[DVec3::ZERO, DVec3::X], [DVec3::Y, DVec3::ZERO]], "{name}");
            for bad in ["1 2\n1\n", "1 2\n1 2 3\n", "1 2\n-1 2\n", "1 2\n1 5\n", "1 2\n1 x\n"] {
                let path = folder.path().join("bad.txt");
                std::fs::write(&path, bad).unwrap();
                let error = read_edges(&path, &input, &mesh).unwrap_err().to_string();
                assert!(error.contains("line 2"), "{name}, {bad:?}: {error}");
            }
        }
    }
}
