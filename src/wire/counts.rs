//! What a header announces, checked before anything else arrives.
//!
//! Purpose: counts of a mesh and of seeds, within [`Bounds`]. Invariant: counts exist only of headers that make sense.
//! Must not know: where bounds come from, memory, queues.

use super::proto::{DensityOptions, MeshHeader, PositionType, SeedSource, seed_source};
use super::{WireError, density};
use geometry::remesh::RemeshError;

/// The most that a request may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    pub max_vertices: u64,
    pub max_facets: u64,
    pub max_seeds: u64,
    pub max_iterations: u32,
}

/// A mesh header whose counts are usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct MeshCounts {
    pub vertices: u64,
    pub facets: u64,
    pub weights: u64,
    /// Bytes a coordinate: 4 or 8.
    pub coordinate_bytes: u64,
    /// Target edge lengths.
    pub edge_lengths: u64,
    /// Creases.
    pub creases: u64,
}

/// A seed source whose count is usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeedCounts {
    Uploaded(u64),
    Sampled {
        points: u64,
        seed: u64,
    },
    /// As many as the density implies.
    Implied {
        seed: u64,
    },
}

impl SeedCounts {
    pub fn uploaded(self) -> u64 {
        match self {
            Self::Uploaded(count) => count,
            Self::Sampled { .. } | Self::Implied { .. } => 0,
        }
    }
}

/// Checks the counts of a mesh.
pub fn mesh(header: Option<&MeshHeader>, bounds: &Bounds) -> Result<MeshCounts, WireError> {
    let header = header.ok_or_else(|| WireError::field("header.mesh", "is missing; say how large the mesh is"))?;
    let MeshHeader { vertices, facets, weights, .. } = *header;
    within("header.mesh.vertices", vertices, 1, bounds.max_vertices)?;
    if facets == 0 {
        return Err(WireError::field("header.mesh.facets", "is 0; give at least one triangle"));
    }
    within("header.mesh.facets", facets, 1, bounds.max_facets)?;
    if weights != 0 && weights != vertices {
        let text = format!("is {weights}; give 0, or one weight for each of the {vertices} vertices");
        return Err(WireError::field("header.mesh.weights", text));
    }
    let coordinate_bytes = match PositionType::try_from(header.position_type) {
        Ok(PositionType::F32) => 4,
        Ok(PositionType::F64 | PositionType::Unspecified) => 8,
        Err(_) => return Err(WireError::unknown_enum("header.mesh.position_type", header.position_type)),
    };
    Ok(MeshCounts { vertices, facets, weights, coordinate_bytes, edge_lengths: 0, creases: 0 })
}

/// Checks the number of seeds.
pub fn seeds(source: Option<&SeedSource>, bounds: &Bounds) -> Result<SeedCounts, WireError> {
    match source.and_then(|s| s.source) {
        Some(seed_source::Source::Uploaded(count)) => {
            within("header.seeds.uploaded", count, 1, bounds.max_seeds)?;
            Ok(SeedCounts::Uploaded(count))
        }
        Some(seed_source::Source::Sampled(sampled)) => {
            within("header.seeds.sampled.points", sampled.points, 1, bounds.max_seeds)?;
            Ok(SeedCounts::Sampled { points: sampled.points, seed: sampled.random_seed })
        }
        None => Err(WireError::field("header.seeds", "is missing; upload seeds or have them sampled")),
    }
}

/// Checks a mesh, seeds and the density that ties them.
pub fn with_density(
    header: Option<&MeshHeader>,
    source: Option<&SeedSource>,
    options: Option<&DensityOptions>,
    bounds: &Bounds,
) -> Result<(MeshCounts, SeedCounts), WireError> {
    let mut mesh = mesh(header, bounds)?;
    let Some(options) = options else { return Ok((mesh, seeds(source, bounds)?)) };
    let DensityOptions { edge_length, edge_lengths, .. } = *options;
    if edge_lengths != 0 && edge_lengths != mesh.vertices {
        let text = format!("is {edge_lengths}; give 0, or one length for each of the {} vertices", mesh.vertices);
        return Err(WireError::field("header.density.edge_lengths", text));
    }
    mesh.edge_lengths = edge_lengths;
    density::kind(options, mesh.weights != 0)?;
    density::numbers(Some(options)).check().map_err(RemeshError::from)?;
    match source.and_then(|s| s.source) {
        Some(seed_source::Source::Sampled(sampled))
            if sampled.points == 0 && (edge_length != 0.0 || edge_lengths != 0) =>
        {
            Ok((mesh, SeedCounts::Implied { seed: sampled.random_seed }))
        }
        Some(_) if edge_length != 0.0 => {
            let text = "is given beside a number of seeds; give one of the two (header.seeds.sampled.points = 0)";
            Err(WireError::field("header.density.edge_length", text))
        }
        _ => Ok((mesh, seeds(source, bounds)?)),
    }
}

/// Checks that `least <= value <= most`.
pub fn within(path: &str, value: u64, least: u64, most: u64) -> Result<(), WireError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(WireError::field(path, format!("is {value}; this server takes {least} to {most}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_checked_before_anything_arrives() {
        let bounds = Bounds { max_vertices: 10, max_facets: 10, max_seeds: 10, max_iterations: 10 };
        let header = MeshHeader { vertices: 11, facets: 1, ..MeshHeader::default() };
        let error = mesh(Some(&header), &bounds).unwrap_err();
        assert!(matches!(error, WireError::Field { ref path, .. } if path == "header.mesh.vertices"), "{error}");
        let none = SeedSource { source: Some(seed_source::Source::Uploaded(0)) };
        assert!(seeds(Some(&none), &bounds).is_err());
    }
}
