//! What must hold of a file reader, whatever the bytes.
#![allow(dead_code)]

use glam::DVec3;
use tessera::mesh::TriMesh;
use tessera::mesh::attributes::{Attributes, Normals, Scalar};
use tessera::mesh::io::{
    DataError, Format, Loaded, counts, decode, decode_with_attributes, encode, encode_with_attributes,
};

/// A surface that was read has no more than was counted; it is written and read again as the same one; an error is said in a line.
pub fn check(format: Format, bytes: &[u8]) -> Result<(), String> {
    let loaded = decode_with_attributes(format, bytes);
    let plain = decode(format, bytes);
    let same = match (&loaded, &plain) {
        (Ok(loaded), Ok(plain)) => loaded.mesh == *plain,
        // As text: an error may hold a NaN.
        (Err(a), Err(b)) => a.to_string() == b.to_string(),
        _ => false,
    };
    if !same {
        return Err(format!("{format:?}: with attributes another surface is read"));
    }
    // A server makes room by these counts.
    let counted = counts(format, bytes);
    if let Ok(mesh) = &plain {
        let (vertices, facets) = (mesh.positions().len() as u64, mesh.facets().len() as u64);
        if !counted.is_some_and(|(v, f)| v >= vertices && f >= facets) {
            return Err(format!("{format:?}: {vertices} vertices and {facets} facets are counted as {counted:?}"));
        }
    }
    if let Some(other) = detour(format, bytes) {
        let same = match (&decode(format, &other), &plain) {
            (Ok(a), Ok(b)) => a == b,
            (Err(a), Err(b)) => a.to_string() == b.to_string(),
            _ => false,
        };
        if !same {
            let result = |bytes: &[u8]| match decode(format, bytes) {
                Ok(mesh) => format!("{} vertices, {} facets", mesh.positions().len(), mesh.facets().len()),
                Err(error) => error.to_string(),
            };
            let (here, there) = (result(bytes), result(&other));
            return Err(format!(
                "{format:?}: read on all threads ({here}), another surface comes out than from beginning to end ({there})"
            ));
        }
    }
    if let Ok(loaded) = loaded {
        check_attributes(format, &loaded)?;
    }
    let mesh = match plain {
        Ok(mesh) => mesh,
        Err(error) => {
            let text = error.to_string();
            let short = !text.is_empty() && text.len() < 1000 && !text.contains('\n');
            return if short { Ok(()) } else { Err(format!("{format:?}: the error is {text:?}")) };
        }
    };
    for other in Format::ALL {
        let file = match encode(other, &mesh) {
            Ok(file) => file,
            Err(DataError::SinglePrecision { .. } | DataError::Collapsed { .. }) if is_single(other) => continue,
            Err(error) => return Err(format!("{other:?}: {error}")),
        };
        let again = match decode(other, &file) {
            Ok(again) => again,
            // Rounded to single precision, a surface may have no area left.
            Err(DataError::Mesh(_)) if is_single(other) => continue,
            Err(error) => return Err(format!("{format:?} as {other:?}: {error}")),
        };
        let same = match other {
            Format::Obj => corners(&again) == corners(&mesh),
            other if is_single(other) => again.facets().len() == mesh.facets().len(),
            _ => again == mesh,
        };
        if !same {
            return Err(format!("{format:?} as {other:?}: another surface comes back"));
        }
    }
    Ok(())
}

/// Whether coordinates are rounded to single precision.
pub fn is_single(format: Format) -> bool {
    matches!(format, Format::Stl | Format::Glb | Format::Gltf)
}

/// The same file with an addition that means nothing, but that the readers of common files leave to the general
/// ones: a continued comment, a list that no element has.
pub fn detour(format: Format, bytes: &[u8]) -> Option<Vec<u8>> {
    match format {
        _ if bytes.trim_ascii().is_empty() || bytes.starts_with(&[0x1f, 0x8b]) => None,
        Format::Obj => Some([bytes, b"\n# \\\n"].concat()),
        Format::Ply => {
            let end = b"\nend_header";
            let at = bytes.windows(end.len()).position(|window| window == end)? + 1;
            // A line that only begins so is refused by its number, which would be another one.
            bytes.get(at + end.len() - 1).filter(|b| b.is_ascii_whitespace())?;
            let list = b"element nothing 0\nproperty list uchar int a\n";
            Some([&bytes[..at], list, &bytes[at..]].concat())
        }
        _ => None,
    }
}

/// The columns of scalars: PLY has one for each number of a vector, and Gmsh's vectors have three or nine.
fn columns(scalars: &[Scalar], format: Format) -> impl Iterator<Item = Vec<f64>> + '_ {
    scalars.iter().flat_map(move |Scalar { components: n, values, .. }| {
        let wide = match format {
            Format::Gmsh => [1, 3, 9].into_iter().find(|wide| wide >= n).unwrap_or(*n),
            _ => *n,
        };
        let of = move |i: usize| values.chunks_exact(*n).map(|v| v.get(i).copied().unwrap_or(0.0)).collect();
        (0..wide).map(of)
    })
}

/// The same numbers, and the same names and types where a format has vectors; a gap is the same as another.
fn same_scalars(format: Format, before: &[Scalar], after: &[Scalar]) -> bool {
    let same = |(a, b): (&f64, &f64)| a == b || a.is_nan() && b.is_nan();
    let kept = |(a, b): (&Scalar, &Scalar)| (&a.name, a.number, a.components) == (&b.name, b.number, b.components);
    let all = !matches!(format, Format::Vtk | Format::Vtp) || before.iter().zip(after).all(kept);
    let (before, after) = (columns(before, format), columns(after, Format::Vtk));
    all && before.zip(after).all(|(a, b)| a.len() == b.len() && a.iter().zip(&b).all(same))
}

/// What was read is written and read again as the same, corner by corner, as far as a format can hold it.
fn check_attributes(format: Format, loaded: &Loaded) -> Result<(), String> {
    for reason in &loaded.left_aside {
        let text = reason.to_string();
        if text.is_empty() || text.len() > 1000 || text.contains('\n') {
            return Err(format!("{format:?}: the reason is {text:?}"));
        }
    }
    for other in Format::ALL.into_iter().filter(|&other| !is_single(other)) {
        let (file, left_out) = encode_with_attributes(other, &loaded.mesh, &loaded.attributes)
            .map_err(|error| format!("{other:?}: {error}"))?;
        let again = decode_with_attributes(other, &file).map_err(|error| format!("{other:?}: {error}"))?;
        // Numbers that are no colours stay so, and are told again.
        if again.left_aside.iter().any(|reason| !loaded.left_aside.contains(reason)) {
            return Err(format!("{format:?} as {other:?}: {:?}", again.left_aside));
        }
        let (before, after) =
            (on_corners(&loaded.mesh, &loaded.attributes), on_corners(&again.mesh, &again.attributes));
        for (i, (before, after)) in before.iter().zip(&after).enumerate() {
            // Opacity may be lost alone.
            let whole = i != 2 || left_out.is_empty();
            let right =
                if after.is_empty() { before.is_empty() || !left_out.is_empty() } else { before == after || !whole };
            if !right {
                return Err(format!("{format:?} as {other:?}: array {i} comes back otherwise"));
            }
        }
        if matches!(other, Format::Ply | Format::Vtk | Format::Vtp | Format::Gmsh)
            && !same_scalars(other, loaded.attributes.scalars(), again.attributes.scalars())
        {
            return Err(format!("{format:?} as {other:?}: other scalars come back"));
        }
    }
    Ok(())
}

/// Normals, texture coordinates and colours at all corners; empty if there are none.
pub fn on_corners(mesh: &TriMesh, attributes: &Attributes) -> [Vec<Vec<f64>>; 3] {
    let vertices = mesh.facets().as_flattened();
    let normals = attributes.normals().map_or(Vec::new(), |normals| match normals {
        Normals::PerVertex(n) => vertices.iter().map(|&v| n[v as usize].to_array().to_vec()).collect(),
        Normals::PerCorner(n) => {
            n.corners.as_flattened().iter().map(|&i| n.values[i as usize].to_array().to_vec()).collect()
        }
    });
    let texture = attributes.texture().map_or(Vec::new(), |t| {
        t.corners.as_flattened().iter().map(|&i| t.values[i as usize].to_array().to_vec()).collect()
    });
    let colours =
        attributes.colours().map_or(Vec::new(), |c| vertices.iter().map(|&v| c.values[v as usize].to_vec()).collect());
    [normals, texture, colours]
}

fn corners(mesh: &TriMesh) -> Vec<[DVec3; 3]> {
    (0..mesh.facets().len()).map(|f| mesh.corners(f)).collect()
}
