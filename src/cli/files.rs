//! Small files of the command line: points, cells, reports.
//!
//! Invariant: numbers are written so that reading gives the same bits.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use glam::DVec3;

use super::exit::{BadInput, Usage};
use crate::mesh::attributes::Attributes;
use crate::mesh::{TriMesh, io};

/// Reads a surface.
pub(crate) fn read_mesh(path: &Path) -> Result<TriMesh> {
    io::read(path).map_err(|e| BadInput(e.to_string()).into())
}

/// Reads a surface and what it carries; says what of that cannot be used.
pub(crate) fn read_loaded(path: &Path) -> Result<(TriMesh, Option<Attributes>)> {
    let loaded = io::read_with_attributes(path).map_err(|e| BadInput(e.to_string()))?;
    for reason in &loaded.left_aside {
        eprintln!("tessera: {}: left aside: {reason}", path.display());
    }
    Ok((loaded.mesh, Some(loaded.attributes).filter(|attributes| !attributes.is_empty())))
}

/// Writes a surface and what it carries; says what of that the format cannot hold.
pub(crate) fn write_loaded(path: &Path, mesh: &TriMesh, attributes: Option<&Attributes>) -> Result<()> {
    let Some(attributes) = attributes else { return Ok(io::write(path, mesh)?) };
    let left_out = io::write_with_attributes(path, mesh, attributes)?;
    if !left_out.is_empty() {
        eprintln!("tessera: {}: this format cannot hold: {}", path.display(), left_out.join(", "));
    }
    Ok(())
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

/// Refuses `outputs` that would replace a file in `kept`, or each other.
pub(crate) fn check_apart<'a>(
    kept: impl Iterator<Item = &'a Path>,
    outputs: impl Iterator<Item = &'a Path>,
) -> Result<()> {
    // A file that is not there yet has no place of its own, but its folder has.
    let place = |path: &Path| {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        path.canonicalize().ok().or_else(|| Some(folder.canonicalize().ok()?.join(path.file_name()?)))
    };
    let mut places: Vec<_> = kept.map(place).collect();
    for path in outputs {
        let own = place(path);
        if own.is_some() && places.contains(&own) {
            return Err(Usage(format!("{} is named twice; give each file a name of its own", path.display())).into());
        }
        places.push(own);
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
