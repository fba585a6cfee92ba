//! What a request may ask for, checked on its header.
//!
//! Purpose: counts against [`Limits`] before anything is reserved, and the memory that all streams
//! share. Invariant: memory is taken for what has arrived, never for what was announced.
//! Must not know: queues, backends.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

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

/// Memory for uploads that all streams share.
#[derive(Clone, Debug)]
pub(crate) struct Budget {
    left: Arc<AtomicU64>,
}

impl Budget {
    pub(crate) fn new(bytes: u64) -> Self {
        Self { left: Arc::new(AtomicU64::new(bytes)) }
    }

    /// An empty share, which grows.
    pub(crate) fn share(&self) -> Share {
        Share { budget: self.clone(), taken: 0 }
    }
}

/// What one stream holds of the budget; given back when dropped.
#[derive(Debug)]
pub(crate) struct Share {
    budget: Budget,
    taken: u64,
}

impl Share {
    /// Takes `bytes` more.
    pub(crate) fn grow(&mut self, bytes: u64) -> Result<(), RequestError> {
        let take = |left: u64| left.checked_sub(bytes);
        self.budget
            .left
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, take)
            .map_err(|left| RequestError::Memory { needed_bytes: bytes, left_bytes: left })?;
        self.taken += bytes;
        Ok(())
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.budget.left.fetch_add(self.taken, Ordering::AcqRel);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_share_is_given_back() {
        let budget = Budget::new(100);
        let mut one = budget.share();
        one.grow(60).unwrap();
        let mut two = budget.share();
        assert!(matches!(two.grow(50), Err(RequestError::Memory { left_bytes: 40, .. })));
        drop(one);
        two.grow(100).unwrap();
    }

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
