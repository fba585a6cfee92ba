//! What the steps of the seeds begin with.
//!
//! Purpose: [`preprocess`] stitches boundary vertices that nearly coincide, leaves out duplicate facets, then makes orientations
//! consistent; each step exposes the defects of the next. [`prepare`] plans the density, finds the curves to keep and builds the
//! search tree of the surface; [`separation`] says how far components have to be apart.
//! Invariant: depends on the surface and the options alone. Vertices keep their numbers in [`preprocess`]; every change is counted.
//! Must not know: seeds, backends.

use std::sync::Arc;

use glam::DVec3;

use crate::cvt::density::{self, DensityOptions, DensitySource, Plan};
use crate::cvt::lifts::CurveLifts;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::closest_point::ClosestPoint;
use crate::mesh::input::{make_consistent, stitch_boundaries};
use crate::mesh::{TriMesh, duplicates};
use crate::remesh::constants::{POINTS_PER_COMPONENT, SEPARATION_DIAGONAL, SEPARATION_EDGES};
use crate::remesh::features::KeptCurves;
use crate::remesh::lift::{Lift, Lifting};
use crate::remesh::report::InputFigures;
use crate::remesh::triangle::{Norm, Shapes};
use crate::remesh::{Anisotropy, RemeshOptions, Result, Seeds};
use crate::rvd::{Lifted, RvdError, Space, Surface};
use crate::token::{Stopped, Token};

pub(super) struct Prepared<'a> {
    pub(super) plan: Plan<'a>,
    pub(super) surface: Arc<Surface>,
    pub(super) curves: KeptCurves,
    /// Unit frame.
    pub(super) closest: ClosestPoint,
    /// For anisotropic cells.
    pub(super) lift: Option<Lift>,
}

/// A surface, and what finds the sides of seeds on creases where it is lifted.
type Measured<P> = (Arc<Surface<P>>, Option<Arc<CurveLifts>>);

/// What is measured between points: distances in R^3, or on the lifted surface.
pub(super) trait Metric: Space {
    /// The surface, and what finds the sides of seeds on creases.
    fn surface(prepared: &Prepared<'_>) -> Result<Measured<Self>>;
}

impl Metric for DVec3 {
    fn surface(prepared: &Prepared<'_>) -> Result<Measured<Self>> {
        Ok((Arc::clone(&prepared.surface), None))
    }
}

impl Metric for Lifted {
    fn surface(prepared: &Prepared<'_>) -> Result<Measured<Self>> {
        let not_lifted = || RvdError::Internal("the surface was not lifted".to_owned());
        let Lift { surface, curves, .. } = prepared.lift.as_ref().ok_or_else(not_lifted)?;
        Ok((Arc::clone(surface), Some(Arc::clone(curves))))
    }
}

/// What the caller asked for, whatever densities later rounds have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Asked {
    /// Diagonal of the input's bounding box, caller's units.
    pub(super) diagonal: f64,
    /// Whether edge lengths are for the least distance.
    pub(super) by_error: bool,
    pub(super) shapes: Shapes,
}

impl Asked {
    pub(super) fn new(given: &TriMesh, options: &RemeshOptions) -> Self {
        let (low, high) = given.bounds();
        let source = &options.density.source;
        let shapes = match (options.anisotropy, source) {
            (Anisotropy::None, _) => Shapes::Round,
            (_, DensitySource::ErrorMax) => Shapes::Nearest(Norm::Largest),
            (Anisotropy::Auto, _) | (_, DensitySource::Error) => Shapes::Nearest(Norm::MeanSquare),
            (Anisotropy::Share(_), _) => Shapes::Slender,
        };
        let by_error = matches!(source, DensitySource::Error | DensitySource::ErrorMax);
        Self { diagonal: (high - low).length(), by_error, shapes }
    }
}

/// `lengths` are those of a lift that there was, one for each vertex of the divided surface.
pub(super) fn prepare<'a>(
    separated: &'a TriMesh,
    options: &RemeshOptions,
    asked: Asked,
    lengths: Option<&[f64]>,
    token: &Token,
) -> Result<Prepared<'a>> {
    let plan = density::plan(separated, &options.density, options.seeds.count(), token)?.divided(token)?;
    token.check()?;
    let surface = Arc::new(Surface::unless(&plan.mesh, plan.weights.as_deref(), token)?);
    token.check()?;
    let find = || KeptCurves::find(separated, &plan, &surface, (options, asked.by_error), token);
    let (curves, closest) = rayon::join(find, || surface.closest_points(token));
    let (mut curves, closest) = (curves?, closest?);
    let lift = match options.anisotropy {
        Anisotropy::None => None,
        anisotropy => {
            let edge = (2.0 / 3f64.sqrt() * separated.area() / plan.points.max(1) as f64).sqrt();
            let Asked { diagonal, by_error, .. } = asked;
            let lifting = Lifting { anisotropy, diagonal, edge, lengths, in_space: by_error };
            let lift = Lift::new(&plan.mesh, plan.weights.as_deref(), &surface, &curves, lifting, token)?;
            curves.place_lifted(&surface, &lift.along_curves, lift.surface.root_mass(), plan.points, token)?;
            Some(lift)
        }
    };
    Ok(Prepared { curves, closest, plan, surface, lift })
}

/// The same options with a density of another source, as it is.
pub(super) fn with_source(options: &RemeshOptions, source: DensitySource) -> RemeshOptions {
    let density = DensityOptions { source, edge_length: None, adaptivity: 1.0, ..options.density.clone() };
    RemeshOptions { density, ..options.clone() }
}

/// Distance to keep between the components of the preprocessed input: two edge lengths, and a share of the diagonal. `None`
/// where seeds are given, since no seed's component is known, and where points are too few for each component.
pub(super) fn separation(clean: &TriMesh, components: usize, options: &RemeshOptions) -> Option<f64> {
    let (low, high) = clean.bounds();
    // Edge length of a uniform triangulation: equilateral triangles, two for each vertex.
    let uniform = |points: usize| (2.0 / 3f64.sqrt() * clean.area() / points.max(1) as f64).sqrt();
    let edge = match (&options.seeds, &options.density) {
        (Seeds::Given(_), _) => return None,
        (Seeds::Sample { points, .. }, _) => uniform(*points),
        (_, DensityOptions { source: DensitySource::Sizes(sizes), .. }) => {
            sizes.iter().copied().fold(0.0, f64::max).min((high - low).length())
        }
        // Edges may be long in one direction.
        (_, DensityOptions { source: DensitySource::Metric(_), .. }) => uniform(POINTS_PER_COMPONENT * components),
        (_, density) => density.edge_length?,
    };
    let gap = SEPARATION_EDGES * edge + SEPARATION_DIAGONAL * (high - low).length();
    (edge <= uniform(POINTS_PER_COMPONENT * components)).then_some(gap)
}

/// The figures of the input, and the changed surface if anything had to be changed.
pub(super) fn preprocess(given: &TriMesh, token: &Token) -> Result<(InputFigures, Option<TriMesh>), Stopped> {
    let adjacency = Adjacency::unless(given, token)?;
    let (mut figures, mut changed) = match stitch_boundaries(given, &adjacency, token)? {
        Some((stitched, moved)) => {
            (InputFigures { stitched_vertices: moved, ..InputFigures::of(&stitched, token)? }, Some(stitched))
        }
        None => (InputFigures::with(given, &adjacency, token)?, None),
    };
    token.check()?;
    if figures.inconsistent_edges + figures.topology.non_manifold_edges > 0
        && let Some((single, spare)) = duplicates::remove(changed.as_ref().unwrap_or(given), token)?
    {
        let stitched_vertices = figures.stitched_vertices;
        figures = InputFigures { stitched_vertices, coincident_facets: spare, ..InputFigures::of(&single, token)? };
        changed = Some(single);
    }
    token.check()?;
    if figures.inconsistent_edges > 0
        && let Some((consistent, flipped)) = make_consistent(changed.as_ref().unwrap_or(given), token)?
    {
        figures.reoriented_facets = flipped;
        changed = Some(consistent);
    }
    Ok((figures, changed))
}
