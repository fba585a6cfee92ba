//! Small files of the command line: points, cells, reports.
//!
//! Invariant: numbers are written so that reading gives the same bits.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use glam::DVec3;

use super::exit::{BadInput, Usage};
use crate::mesh::{TriMesh, io};
use crate::rvd::PieceBatch;

/// Reads a surface.
pub(crate) fn read_mesh(path: &Path) -> Result<TriMesh> {
    io::read(path).map_err(|e| BadInput(e.to_string()).into())
}

/// Refuses an output whose folder is not there or whose name is wrong, before any work is done.
pub(crate) fn check_output(path: &Path, extensions: &[&str]) -> Result<()> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    if !extensions.is_empty() && !extensions.contains(&extension.as_str()) {
        let text = format!("{}: the name must end in .{}", path.display(), extensions.join(", ."));
        return Err(Usage(text).into());
    }
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(Usage(format!("{}: there is no folder {}", path.display(), folder.display())).into());
    }
    Ok(())
}

/// Reads points, `x y z` a line. Empty lines and lines that begin with `#` are left out.
pub(crate) fn read_points(path: &Path) -> Result<Vec<DVec3>> {
    let bad = |text: String| BadInput(format!("{}: {text}", path.display()));
    let file = File::open(path).map_err(|e| bad(e.to_string()))?;
    let mut points = Vec::new();
    for (i, line) in BufReader::new(file).lines().enumerate() {
        let line = line.map_err(|e| bad(format!("line {}: {e}", i + 1)))?;
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
        match numbers.as_deref() {
            Ok([x, y, z]) if x.is_finite() && y.is_finite() && z.is_finite() => points.push(DVec3::new(*x, *y, *z)),
            _ => return Err(bad(format!("line {} is not three finite numbers: {line:?}", i + 1)).into()),
        }
    }
    if points.is_empty() {
        return Err(bad("there are no points".to_owned()).into());
    }
    Ok(points)
}

/// Writes points, `x y z` a line, 17 significant digits.
pub(crate) fn write_points(path: &Path, points: &[DVec3]) -> Result<()> {
    write(path, |out| {
        for p in points {
            writeln!(out, "{:.16e} {:.16e} {:.16e}", p.x, p.y, p.z)?;
        }
        Ok(())
    })
}

/// Writes a report.
pub(crate) fn write_json(path: &Path, report: &impl serde::Serialize) -> Result<()> {
    write(path, |out| {
        serde_json::to_writer_pretty(&mut *out, report)?;
        writeln!(out)
    })
}

/// Writes pieces as a polygon PLY (binary, little-endian): double positions; for each polygon its
/// seed, its facet and a colour by seed.
pub(crate) fn write_cells(path: &Path, cells: &PieceBatch) -> Result<()> {
    let most = (0..cells.len()).map(|i| cells.vertices(i).len()).max().unwrap_or(0);
    let (count_type, wide) = if most > 255 { ("uint", true) } else { ("uchar", false) };
    write(path, |out| {
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\ncomment pieces of a restricted Voronoi diagram\n\
             element vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
             element face {}\nproperty list {count_type} int vertex_indices\nproperty int seed\n\
             property int facet\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
            cells.position.len(),
            cells.len()
        )?;
        for x in cells.position.iter().flat_map(DVec3::to_array) {
            out.write_all(&x.to_le_bytes())?;
        }
        for i in 0..cells.len() {
            let vertices = cells.vertices(i);
            match wide {
                true => out.write_all(&(vertices.len() as u32).to_le_bytes())?,
                false => out.write_all(&[vertices.len() as u8])?,
            }
            for v in vertices {
                out.write_all(&(v as u32).to_le_bytes())?;
            }
            out.write_all(&cells.seed[i].to_le_bytes())?;
            out.write_all(&cells.facet[i].to_le_bytes())?;
            out.write_all(&colour(cells.seed[i]))?;
        }
        Ok(())
    })
}

/// A colour that neighbours in number do not share: the index, well mixed, never dark.
fn colour(seed: u32) -> [u8; 3] {
    let mut h = seed.wrapping_mul(0x9e37_79b1) ^ 0x85eb_ca6b;
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    h ^= h >> 15;
    [h as u8, (h >> 8) as u8, (h >> 16) as u8].map(|c| 64 + (c >> 1) + (c >> 2))
}

fn write(path: &Path, body: impl FnOnce(&mut BufWriter<File>) -> std::io::Result<()>) -> Result<()> {
    let all = || {
        let mut out = BufWriter::new(File::create(path)?);
        body(&mut out)?;
        out.flush()
    };
    all().with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_come_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.xyz");
        let points = vec![DVec3::new(0.1, -1e-300, 123_456_789.123_456_79), DVec3::new(1.0 / 3.0, 0.0, f64::MAX)];
        write_points(&path, &points).unwrap();
        assert_eq!(read_points(&path).unwrap(), points);
    }

    #[test]
    fn a_bad_line_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.xyz");
        std::fs::write(&path, "0 0 0\n# fine\n1 2 nan\n").unwrap();
        assert!(read_points(&path).unwrap_err().to_string().contains("line 3"));
    }
}
