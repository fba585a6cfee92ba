//! Formats of surfaces in jobs: as messages name them.
//!
//! Invariant: a match names every format, so that a new one does not compile until it is here. Must not know: calls.

use geometry::mesh::io::Format;
use wire::proto::MeshFormat;

/// As messages name it.
pub(super) fn message(format: Format) -> MeshFormat {
    match format {
        Format::Ply => MeshFormat::Ply,
        Format::Obj => MeshFormat::Obj,
        Format::Stl => MeshFormat::Stl,
        Format::Off => MeshFormat::Off,
        Format::Vtk => MeshFormat::Vtk,
        Format::Vtp => MeshFormat::Vtp,
        Format::Gmsh => MeshFormat::Msh,
        Format::Medit => MeshFormat::Mesh,
        Format::MeditBinary => MeshFormat::Meshb,
        Format::Glb => MeshFormat::Glb,
        Format::Gltf => MeshFormat::Gltf,
    }
}

/// The format of a message, if this version knows it.
pub(super) fn of_message(value: i32) -> Option<Format> {
    Format::ALL.into_iter().find(|format| i32::from(message(*format)) == value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_name_every_format() {
        for format in Format::ALL {
            assert_eq!(of_message(message(format).into()), Some(format));
        }
        assert_eq!((of_message(0), of_message(99)), (None, None));
    }
}
