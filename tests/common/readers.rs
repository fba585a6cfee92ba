//! What must hold of a file reader, whatever the bytes.
#![allow(dead_code)]

use glam::DVec3;
use tessera::mesh::TriMesh;
use tessera::mesh::io::{DataError, Format, decode, encode};

/// A surface that was read is written and read again as the same one; an error is said in a line.
pub fn check(format: Format, bytes: &[u8]) -> Result<(), String> {
    let mesh = match decode(format, bytes) {
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
            Err(DataError::SinglePrecision { .. }) if other == Format::Stl => continue,
            Err(error) => return Err(format!("{other:?}: {error}")),
        };
        let again = match decode(other, &file) {
            Ok(again) => again,
            // Rounded to single precision, a surface may have no area left.
            Err(DataError::Mesh(_)) if other == Format::Stl => continue,
            Err(error) => return Err(format!("{format:?} as {other:?}: {error}")),
        };
        let same = match other {
            Format::Ply | Format::Off => again == mesh,
            Format::Obj => corners(&again) == corners(&mesh),
            Format::Stl => again.facets().len() == mesh.facets().len(),
        };
        if !same {
            return Err(format!("{format:?} as {other:?}: another surface comes back"));
        }
    }
    Ok(())
}

fn corners(mesh: &TriMesh) -> Vec<[DVec3; 3]> {
    (0..mesh.facets().len()).map(|f| mesh.corners(f)).collect()
}
