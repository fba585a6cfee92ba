//! What a request may ask for, checked on its header.
//!
//! Purpose: counts against [`Limits`] before anything is reserved. Invariant: nothing is kept of a header that is
//! refused. Must not know: queues, backends.

use super::proto::{DensityOptions, MeshHeader, PositionType, SeedSource, seed_source};
use super::{RequestError, convert, options};
use crate::config::Limits;

/// A mesh header whose counts are usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(crate) struct MeshCounts {
    pub(crate) vertices: u64,
    pub(crate) facets: u64,
    pub(crate) weights: u64,
    /// Bytes a coordinate: 4 or 8.
    pub(crate) coordinate_bytes: u64,
    /// Target edge lengths.
    pub(crate) edge_lengths: u64,
    /// Creases.
    pub(crate) creases: u64,
}

/// A seed source whose count is usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SeedCounts {
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
    pub(crate) fn uploaded(self) -> u64 {
        match self {
            Self::Uploaded(count) => count,
            Self::Sampled { .. } | Self::Implied { .. } => 0,
        }
    }
}

/// Checks the counts of a mesh.
pub(crate) fn mesh(header: Option<&MeshHeader>, limits: &Limits) -> Result<MeshCounts, RequestError> {
    let header = header.ok_or_else(|| RequestError::field("header.mesh", "is missing; say how large the mesh is"))?;
    let MeshHeader { vertices, facets, weights, .. } = *header;
    within("header.mesh.vertices", vertices, 1, limits.max_vertices)?;
    if facets == 0 {
        return Err(RequestError::field("header.mesh.facets", "is 0; give at least one triangle"));
    }
    within("header.mesh.facets", facets, 1, limits.max_facets)?;
    if weights != 0 && weights != vertices {
        let text = format!("is {weights}; give 0, or one weight for each of the {vertices} vertices");
        return Err(RequestError::field("header.mesh.weights", text));
    }
    let coordinate_bytes = match PositionType::try_from(header.position_type) {
        Ok(PositionType::F32) => 4,
        Ok(PositionType::F64 | PositionType::Unspecified) => 8,
        Err(_) => return Err(RequestError::unknown_enum("header.mesh.position_type", header.position_type)),
    };
    Ok(MeshCounts { vertices, facets, weights, coordinate_bytes, edge_lengths: 0, creases: 0 })
}

/// Checks the number of seeds.
pub(crate) fn seeds(source: Option<&SeedSource>, limits: &Limits) -> Result<SeedCounts, RequestError> {
    match source.and_then(|s| s.source) {
        Some(seed_source::Source::Uploaded(count)) => {
            within("header.seeds.uploaded", count, 1, limits.max_seeds)?;
            Ok(SeedCounts::Uploaded(count))
        }
        Some(seed_source::Source::Sampled(sampled)) => {
            within("header.seeds.sampled.points", sampled.points, 1, limits.max_seeds)?;
            Ok(SeedCounts::Sampled { points: sampled.points, seed: sampled.random_seed })
        }
        None => Err(RequestError::field("header.seeds", "is missing; upload seeds or have them sampled")),
    }
}

/// Checks a mesh, seeds and the density that ties them.
pub(crate) fn with_density(
    header: Option<&MeshHeader>,
    source: Option<&SeedSource>,
    density: Option<&DensityOptions>,
    limits: &Limits,
) -> Result<(MeshCounts, SeedCounts), RequestError> {
    let mut mesh = mesh(header, limits)?;
    let Some(density) = density else { return Ok((mesh, seeds(source, limits)?)) };
    let DensityOptions { edge_length, edge_lengths, .. } = *density;
    if edge_lengths != 0 && edge_lengths != mesh.vertices {
        let text = format!("is {edge_lengths}; give 0, or one length for each of the {} vertices", mesh.vertices);
        return Err(RequestError::field("header.density.edge_lengths", text));
    }
    mesh.edge_lengths = edge_lengths;
    convert::density_kind(density, mesh.weights != 0)?;
    options::of_density(Some(density)).check().map_err(crate::remesh::RemeshError::from)?;
    match source.and_then(|s| s.source) {
        Some(seed_source::Source::Sampled(sampled))
            if sampled.points == 0 && (edge_length != 0.0 || edge_lengths != 0) =>
        {
            Ok((mesh, SeedCounts::Implied { seed: sampled.random_seed }))
        }
        Some(_) if edge_length != 0.0 => {
            let text = "is given beside a number of seeds; give one of the two (header.seeds.sampled.points = 0)";
            Err(RequestError::field("header.density.edge_length", text))
        }
        _ => Ok((mesh, seeds(source, limits)?)),
    }
}

/// Checks that `least <= value <= most`.
pub(crate) fn within(path: &str, value: u64, least: u64, most: u64) -> Result<(), RequestError> {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(RequestError::field(path, format!("is {value}; this server takes {least} to {most}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_checked_before_anything_arrives() {
        let limits = Limits { max_vertices: 10, ..Limits::default() };
        let header = MeshHeader { vertices: 11, facets: 1, ..MeshHeader::default() };
        let error = mesh(Some(&header), &limits).unwrap_err();
        assert!(matches!(error, RequestError::Field { ref path, .. } if path == "header.mesh.vertices"), "{error}");
        let none = SeedSource { source: Some(seed_source::Source::Uploaded(0)) };
        assert!(seeds(Some(&none), &limits).is_err());
    }
}
