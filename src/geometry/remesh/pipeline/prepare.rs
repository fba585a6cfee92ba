//! What the steps of the seeds begin with.
//!
//! Purpose: [`prepare`] plans the density, finds the curves to keep and builds the search tree of the surface.
//! Invariant: depends on the surface and the options alone. Must not know: how the surface came about, seeds, backends.

use std::sync::Arc;

use glam::DVec3;

use crate::cvt::density::{self, Beside, DensityOptions, DensitySource, Plan};
use crate::cvt::lifts::CurveLifts;
use crate::mesh::TriMesh;
use crate::mesh::apart::Apart;
use crate::mesh::closest_point::ClosestPoint;
use crate::remesh::constants::{STEEPEST_LIFT, STEEPEST_SLIDING_LIFT};
use crate::remesh::features::{Held, KeptCurves};
use crate::remesh::lift::{Lift, Lifting};
use crate::remesh::triangle::{Norm, Shapes};
use crate::remesh::{Anisotropy, Placement, RemeshOptions, Result};
use crate::rvd::{Lifted, RvdError, Space, Surface};
use crate::token::Token;

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
pub(super) struct Asked<'a> {
    /// Diagonal of the input's bounding box, caller's units.
    pub(super) diagonal: f64,
    /// Whether edge lengths are for the least distance.
    pub(super) by_error: bool,
    pub(super) shapes: Shapes,
    /// The sheets that are apart.
    pub(super) apart: Option<&'a Apart>,
    /// Where sheets that are apart met, once that is known, and the edges that stay.
    pub(super) held: Held<'a>,
}

impl Asked<'_> {
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
        Self { diagonal: (high - low).length(), by_error, shapes, apart: None, held: Held::default() }
    }
}

/// `lengths` are those of a lift that there was, one for each vertex of the divided surface.
pub(super) fn prepare<'a>(
    separated: &'a TriMesh,
    options: &RemeshOptions,
    asked: Asked<'_>,
    lengths: Option<&[f64]>,
    token: &Token,
) -> Result<Prepared<'a>> {
    let lengths_of_rims = rim_lengths(separated, asked.held.rims);
    let before = asked.apart.map(|apart| |p: DVec3| apart.back(p));
    let before = before.as_ref().map(|before| before as &density::Before<'_>);
    let beside = Beside { lengths: &lengths_of_rims, before };
    let plan = density::plan_beside(separated, &options.density, options.seeds.count(), beside, token)?;
    let plan = plan.divided(token)?;
    token.check()?;
    let surface = Arc::new(Surface::unless(&plan.mesh, plan.weights.as_deref(), token)?);
    token.check()?;
    let find = || KeptCurves::find(separated, &plan, &surface, (options, asked.by_error), asked.held, token);
    let (curves, closest) = rayon::join(find, || surface.closest_points(token));
    let (mut curves, closest) = (curves?, closest?);
    let lift = match options.anisotropy {
        Anisotropy::None => None,
        anisotropy => {
            let edge = (2.0 / 3f64.sqrt() * separated.area() / plan.points.max(1) as f64).sqrt();
            let Asked { diagonal, by_error, .. } = asked;
            let slides = asked.shapes == Shapes::Nearest(Norm::Largest) && options.placement == Placement::Surface;
            let steepest = if slides { STEEPEST_SLIDING_LIFT } else { STEEPEST_LIFT };
            let lifting = Lifting { anisotropy, diagonal, edge, lengths, in_space: by_error, steepest };
            let lift = Lift::new(&plan.mesh, plan.weights.as_deref(), &surface, &curves, lifting, token)?;
            curves.place_lifted(&surface, &lift.along_curves, lift.surface.root_mass(), plan.points, token)?;
            Some(lift)
        }
    };
    Ok(Prepared { curves, closest, plan, surface, lift })
}

/// The edge length at each vertex of a rim: the geometric mean of its shortest and its longest edge there.
fn rim_lengths(mesh: &TriMesh, rims: &[[u32; 2]]) -> Vec<(u32, f64)> {
    let length = |&[a, b]: &[u32; 2]| mesh.positions()[a as usize].distance(mesh.positions()[b as usize]);
    let mut ends: Vec<(u32, f64)> =
        rims.iter().flat_map(|edge| edge.map(|v| (v, length(edge)))).filter(|end| end.1 > 0.0).collect();
    ends.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let of = |group: &[(u32, f64)]| (group[0].0, (group[0].1.sqrt() * group[group.len() - 1].1.sqrt()));
    ends.chunk_by(|a, b| a.0 == b.0).map(of).collect()
}

/// The same options with a density of another source, as it is.
pub(super) fn with_source(options: &RemeshOptions, source: DensitySource) -> RemeshOptions {
    let density = DensityOptions { source, edge_length: None, adaptivity: 1.0, ..options.density.clone() };
    RemeshOptions { density, ..options.clone() }
}
