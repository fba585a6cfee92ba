//! What a header announces, checked before anything else arrives.
//!
//! Purpose: counts of a mesh and of the arrays beside it, within [`Bounds`]. Invariant: counts exist only of headers that
//! make sense. Must not know: where bounds come from, memory, queues.

use super::WireError;
use super::options::{choice, within};
use super::proto::{MeshHeader, PositionType};
use geometry::cvt::density::DensityOptions;
use geometry::mesh::{MAX_ELEMENTS, TriMesh};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    pub max_vertices: u64,
    pub max_facets: u64,
    pub max_seeds: u64,
    pub max_iterations: u32,
}

impl Bounds {
    /// What indices can count.
    pub const WIDEST: Self = Self {
        max_vertices: MAX_ELEMENTS as u64,
        max_facets: MAX_ELEMENTS as u64,
        max_seeds: MAX_ELEMENTS as u64,
        max_iterations: u32::MAX,
    };

    /// The library's own.
    pub fn of_library() -> Self {
        Self { max_seeds: DensityOptions::default().max_points as u64, ..Self::WIDEST }
    }
}

/// The counts of a header, usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct MeshCounts {
    pub vertices: u64,
    pub facets: u64,
    pub weights: u64,
    /// Bytes a coordinate: 4 or 8.
    pub coordinate_bytes: u64,
    pub edge_lengths: u64,
    pub metric: u64,
    pub creases: u64,
    pub seeds: u64,
}

/// The header of a mesh that is uploaded alone, in double precision.
pub fn mesh_header(mesh: &TriMesh) -> MeshHeader {
    MeshHeader {
        vertices: mesh.positions().len() as u64,
        facets: mesh.facets().len() as u64,
        position_type: PositionType::F64.into(),
        ..MeshHeader::default()
    }
}

/// Which arrays a method reads beside positions, facets, weights and seeds.
#[derive(Clone, Copy, Debug)]
pub struct Reads {
    pub edge_lengths: bool,
    /// Creases, a metric and attributes.
    pub features: bool,
}

/// Checks the counts of a mesh and of `seeds`.
pub fn mesh(header: Option<&MeshHeader>, seeds: u64, reads: Reads, bounds: &Bounds) -> Result<MeshCounts, WireError> {
    let header = header.ok_or_else(|| WireError::field("mesh", "is missing; say how large the mesh is"))?;
    let &MeshHeader { vertices, facets, position_type, weights, edge_lengths, creases, metric, ref attributes } =
        header;
    within("mesh.vertices", vertices, 1, bounds.max_vertices)?;
    within("mesh.facets", facets, 1, bounds.max_facets)?;
    for (path, count) in [("mesh.weights", weights), ("mesh.edge_lengths", edge_lengths), ("mesh.metric", metric)] {
        if count != 0 && count != vertices {
            let text = format!("is {count}; give 0, or one for each of the {vertices} vertices");
            return Err(WireError::field(path, text));
        }
    }
    within("mesh.creases", creases, 0, 3 * facets)?;
    for (path, count, is_read) in [
        ("mesh.edge_lengths", edge_lengths, reads.edge_lengths),
        ("mesh.metric", metric, reads.features),
        ("mesh.creases", creases, reads.features),
        ("mesh.attributes", attributes.len() as u64, reads.features),
    ] {
        if count != 0 && !is_read {
            return Err(WireError::field(path, format!("has {count}; this method reads none")));
        }
    }
    let coordinate_bytes = match choice("mesh.position_type", position_type)? {
        PositionType::F32 => 4,
        PositionType::F64 | PositionType::Unspecified => 8,
    };
    within("seeds", seeds, 0, bounds.max_seeds)?;
    Ok(MeshCounts { vertices, facets, weights, coordinate_bytes, edge_lengths, metric, creases, seeds })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_checked_before_anything_arrives() {
        let bounds = Bounds { max_vertices: 10, max_facets: 10, max_seeds: 10, max_iterations: 10 };
        let reads = Reads { edge_lengths: false, features: false };
        let good = MeshHeader { vertices: 10, facets: 1, ..MeshHeader::default() };
        assert!(mesh(Some(&good), 10, reads, &bounds).is_ok());
        for (header, seeds, wrong) in [
            (MeshHeader { vertices: 11, ..good.clone() }, 0, "mesh.vertices"),
            (MeshHeader { facets: 0, ..good.clone() }, 0, "mesh.facets"),
            (MeshHeader { weights: 3, ..good.clone() }, 0, "mesh.weights"),
            (MeshHeader { creases: 2, ..good.clone() }, 0, "mesh.creases"),
            (MeshHeader { position_type: 9, ..good.clone() }, 0, "mesh.position_type"),
            (good.clone(), 11, "seeds"),
        ] {
            let error = mesh(Some(&header), seeds, reads, &bounds).unwrap_err();
            assert!(matches!(error, WireError::Field { ref path, .. } if path == wrong), "{error}");
        }
    }
}
