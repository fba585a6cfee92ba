//! What a caller wants done, made ready before its turn.
//!
//! Purpose: [`Input`] is what was given; [`Prepared`] is checked, scaled and seeded. Invariant: preparing touches no
//! backend, so that it can run on any thread. Must not know: where the input came from.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::DVec3;

use crate::JobError;
use geometry::cvt::density::{self, DensityOptions};
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::Attributes;
use geometry::mesh::sample::sample;
use geometry::remesh::report::{InputFigures, Timings};
use geometry::remesh::{RemeshError, Seeds};
use geometry::rvd::{RvdError, Surface};
use geometry::token::Token;

#[derive(Clone, Debug)]
pub struct Input {
    /// The surface, caller's coordinates.
    pub mesh: TriMesh,
    pub density: DensityOptions,
    pub seeds: Seeds,
    /// Edges that are creases whatever their angle; of no use but to a remesh.
    pub creases: Vec<[u32; 2]>,
    /// What the surface carries and a remesh is to carry. Diagrams do without.
    pub attributes: Option<Attributes>,
}

/// A surface in the unit frame and seeds in the caller's.
#[derive(Clone, Debug)]
pub struct Prepared {
    pub surface: Arc<Surface>,
    /// At least one, finite, caller's coordinates.
    pub seeds: Arc<Vec<DVec3>>,
    pub random_seed: Option<u64>,
    pub figures: InputFigures,
    /// `prepare` and `sample` are set.
    pub timings: Timings,
}

impl Prepared {
    /// Checks the density and the seeds, and draws seeds if asked. Lengths per vertex, curvature and feature size may
    /// divide facets; with weights and uniform the surface's facets are the mesh's. Errors: `WeightCount`, `BadWeight`,
    /// `NoSeeds`, `NonFiniteSeed`, `Density`, `Stopped`.
    pub fn new(input: Input, token: &Token) -> Result<Self, JobError> {
        Self::with(input, token, false)
    }

    /// The same for steps alone, as a remesh takes them: facets that are long beside the cells are divided, so that steps
    /// take less time ([`geometry::cvt::density::Plan::divided`]).
    pub fn for_steps(input: Input, token: &Token) -> Result<Self, JobError> {
        Self::with(input, token, true)
    }

    fn with(input: Input, token: &Token, divides: bool) -> Result<Self, JobError> {
        token.enter("prepare");
        let start = Instant::now();
        let Input { mesh, density, seeds, .. } = input;
        let plan = density::plan(&mesh, &density, seeds.count(), token).map_err(RemeshError::from)?;
        let mut surface = Arc::new(Surface::unless(&plan.mesh, plan.weights.as_deref(), token)?);
        token.check()?;
        let figures = InputFigures::of(&mesh, token)?;
        token.check()?;
        let mut prepare = start.elapsed();
        let start = Instant::now();
        // Before facets are divided: the same number draws the same seeds for every kind of job.
        let (seeds, random_seed) = match seeds {
            Seeds::Given(seeds) => (seeds, None),
            Seeds::Sample { seed, .. } | Seeds::Implied { seed } | Seeds::Share { seed, .. } => {
                let points = sample(&plan.mesh, plan.weights.as_deref(), plan.points, seed);
                (points.into_iter().map(|p| p.position).collect(), Some(seed))
            }
        };
        let sampled = start.elapsed();
        let start = Instant::now();
        if divides {
            let facets = plan.mesh.facets().len();
            let plan = plan.divided(token)?;
            if plan.mesh.facets().len() != facets {
                surface = Arc::new(Surface::unless(&plan.mesh, plan.weights.as_deref(), token)?);
            }
        }
        prepare += start.elapsed();
        let ms = |time: Duration| time.as_secs_f64() * 1e3;
        let timings = Timings { prepare: ms(prepare), sample: ms(sampled), ..Timings::default() };
        if seeds.is_empty() {
            return Err(RvdError::NoSeeds.into());
        }
        if let Some(seed) = seeds.iter().position(|p: &DVec3| !p.is_finite()) {
            return Err(RvdError::NonFiniteSeed { seed }.into());
        }
        Ok(Self { surface, seeds: Arc::new(seeds), random_seed, figures, timings })
    }
}
