//! A surface and its first seeds, as the service prepares them for diagrams and steps.

use std::sync::Arc;

use geometry::cvt::density::plan;
use glam::DVec3;
use tessera::mesh::sample::sample;
use tessera::rvd::Surface;
use tessera::{DensityOptions, RemeshError, Seeds, Token, TriMesh};

/// For a session.
pub(crate) struct Start {
    /// With its density.
    pub(crate) surface: Arc<Surface>,
    /// Given or drawn, caller's coordinates.
    pub(crate) seeds: Vec<DVec3>,
}

/// `steps`: facets that are long beside the cells are divided, so that steps take less time; pieces then are not of the
/// caller's facets.
pub(crate) fn start(
    mesh: &TriMesh,
    density: &DensityOptions,
    mut seeds: Seeds,
    steps: bool,
    token: &Token,
) -> Result<Start, RemeshError> {
    seeds.resolve(mesh);
    let plan = plan(mesh, density, seeds.count(), token)?;
    let seeds = match seeds {
        Seeds::Sample { seed, .. } | Seeds::Implied { seed } | Seeds::Share { seed, .. } => {
            let points = sample(&plan.mesh, plan.weights.as_deref(), plan.points, seed);
            points.into_iter().map(|point| point.position).collect()
        }
        Seeds::Given(seeds) => seeds,
    };
    let plan = if steps { plan.divided(token)? } else { plan };
    let surface = Arc::new(Surface::new(&plan.mesh, plan.weights.as_deref())?);
    Ok(Start { surface, seeds })
}
