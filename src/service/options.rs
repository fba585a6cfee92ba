//! Options between messages and the library.
//!
//! Purpose: the header of a `Remesh` or `Cvt` to [`RemeshOptions`] or [`CvtOptions`], and back for a client.
//! Invariant: what a header leaves open has the library's default, and no number here is one. Both sides are
//! taken apart field by field, so that an option cannot be added to one of them alone.
//! Must not know: streams, queues, what an option does.

#[cfg(feature = "cli")]
use super::attributes;
use super::limits::SeedCounts;
use super::proto::{self, CvtHeader, RemeshHeader};
use super::{RequestError, convert};
use crate::config::Limits;
use crate::cvt::density::DensityOptions;
#[cfg(feature = "cli")]
use crate::cvt::density::DensitySource;
use crate::cvt::{CvtOptions, Projection};
use crate::job::spec::Input;
use crate::mesh::TriMesh;
use crate::mesh::features::FeatureError;
use crate::remesh::{Placement, Refine, RemeshError, RemeshOptions, Seeds};

/// What a header asks for, with the surface that is to be remeshed.
pub(crate) fn of_remesh(
    header: &RemeshHeader,
    input: Input,
    limits: &Limits,
) -> Result<(TriMesh, RemeshOptions), RequestError> {
    let Input { mesh, density, seeds, creases, attributes } = input;
    let counts = match &seeds {
        Seeds::Given(seeds) => SeedCounts::Uploaded(seeds.len() as u64),
        &Seeds::Sample { points, seed } => SeedCounts::Sampled { points: points as u64, seed },
        &Seeds::Implied { seed } => SeedCounts::Implied { seed },
    };
    let Numbers { lloyd, newton, crease_angle_deg, projection, placement, keep_boundaries, keep_thin, measure, refine } =
        Numbers::of(header, counts, limits)?;
    let options = RemeshOptions {
        seeds,
        lloyd,
        newton,
        density,
        projection,
        placement,
        crease_angle_deg,
        creases,
        refine,
        keep_boundaries,
        keep_thin,
        measure,
        attributes,
    };
    Ok((mesh, options))
}

/// Whether a header's options are in their ranges, before anything is uploaded.
pub(crate) fn check_remesh(header: &RemeshHeader, seeds: SeedCounts, limits: &Limits) -> Result<(), RequestError> {
    Numbers::of(header, seeds, limits).map(|_| ())
}

/// The options that come with the header and not in arrays.
struct Numbers {
    lloyd: usize,
    newton: usize,
    crease_angle_deg: f64,
    projection: Projection,
    placement: Placement,
    keep_boundaries: bool,
    keep_thin: bool,
    measure: bool,
    refine: Option<Refine>,
}

impl Numbers {
    fn of(header: &RemeshHeader, counts: SeedCounts, limits: &Limits) -> Result<Self, RequestError> {
        let RemeshHeader {
            mesh: _,
            seeds: _,
            backend: _,
            creases: _,
            density: _,
            attributes: _,
            lloyd_steps,
            newton_steps,
            crease_angle_deg,
            projection,
            measure,
            placement,
            boundaries,
            thin,
            ref refinement,
        } = *header;
        let usual = RemeshOptions::usual();
        let steps = |path, given: Option<u32>, usual: usize| match given {
            Some(steps) => {
                super::limits::within(path, steps.into(), 0, limits.max_iterations.into())?;
                Ok::<_, RequestError>(steps as usize)
            }
            // Who allows fewer iterations than that means it for everybody.
            None => Ok(usual.min(limits.max_iterations as usize)),
        };
        let crease_angle_deg = crease_angle_deg.unwrap_or(usual.crease_angle_deg);
        if !(0.0..=180.0).contains(&crease_angle_deg) {
            return Err(RemeshError::from(FeatureError::BadAngle(crease_angle_deg)).into());
        }
        let placement = convert::placement(placement)?.unwrap_or(usual.placement);
        if refinement.is_some() && placement != Placement::Fitted {
            return Err(RemeshError::RefineUnfitted.into());
        }
        Ok(Self {
            lloyd: steps("header.lloyd_steps", lloyd_steps, usual.lloyd)?,
            newton: steps("header.newton_steps", newton_steps, usual.newton)?,
            crease_angle_deg,
            projection: convert::projection(projection)?.unwrap_or(usual.projection),
            placement,
            keep_boundaries: convert::boundaries(boundaries)?.unwrap_or(usual.keep_boundaries),
            keep_thin: convert::thin(thin)?.unwrap_or(usual.keep_thin),
            measure: convert::measure(measure)?.unwrap_or(usual.measure),
            refine: refinement.as_ref().map_or(Ok(usual.refine), |given| refine(given, counts, limits).map(Some))?,
        })
    }
}

fn refine(given: &proto::Refinement, counts: SeedCounts, limits: &Limits) -> Result<Refine, RequestError> {
    let proto::Refinement { tolerance, max_points } = *given;
    if !(tolerance.is_finite() && tolerance > 0.0) {
        let text = format!("is {tolerance}; give a distance above 0");
        return Err(RequestError::field("header.refinement.tolerance", text));
    }
    let path = "header.refinement.max_points";
    match (max_points, counts) {
        (Some(most), _) => {
            super::limits::within(path, most, 1, limits.max_seeds)?;
            Ok(Refine { tolerance, max_points: most as usize })
        }
        (None, SeedCounts::Uploaded(points) | SeedCounts::Sampled { points, .. }) => {
            let Refine { tolerance, max_points } = Refine::new(tolerance, points as usize);
            Ok(Refine { tolerance, max_points: max_points.min(limits.max_seeds as usize) })
        }
        (None, SeedCounts::Implied { .. }) => Err(RequestError::field(
            path,
            "is missing; it must be given where edge lengths say how many points there are",
        )),
    }
}

/// What the header of a session asks for.
pub(crate) fn of_cvt(header: &CvtHeader) -> Result<CvtOptions, RequestError> {
    let CvtHeader { mesh: _, seeds: _, backend: _, density: _, projection, max_seeds } = *header;
    let usual = CvtOptions::default();
    Ok(CvtOptions {
        projection: convert::projection(projection)?.unwrap_or(usual.projection),
        // 0 means the same to both.
        max_seeds: max_seeds as usize,
    })
}

/// A density without what it reads per vertex. What is not said of the others is the library's.
pub(crate) fn of_density(density: Option<&proto::DensityOptions>) -> DensityOptions {
    let usual = DensityOptions::default();
    let Some(given) = density else { return usual };
    let proto::DensityOptions { source: _, edge_length, edge_lengths: _, adaptivity, gradation } = *given;
    DensityOptions {
        edge_length: (edge_length != 0.0).then_some(edge_length),
        adaptivity: adaptivity.unwrap_or(usual.adaptivity),
        gradation: gradation.unwrap_or(usual.gradation),
        ..usual
    }
}

/// The header that asks for the same as `options`, of `mesh`; seeds that are given are to be uploaded.
#[cfg(feature = "cli")]
pub(crate) fn remesh_header(mesh: &TriMesh, options: &RemeshOptions, backend: proto::BackendChoice) -> RemeshHeader {
    let RemeshOptions {
        seeds,
        lloyd,
        newton,
        density,
        projection,
        placement,
        crease_angle_deg,
        creases,
        refine,
        keep_boundaries,
        keep_thin,
        measure,
        attributes,
    } = options;
    let steps = |steps: usize| Some(u32::try_from(steps).unwrap_or(u32::MAX));
    RemeshHeader {
        mesh: Some(mesh_header(mesh, density)),
        seeds: Some(seed_source(seeds)),
        backend: backend.into(),
        lloyd_steps: steps(*lloyd),
        newton_steps: steps(*newton),
        crease_angle_deg: Some(*crease_angle_deg),
        creases: creases.len() as u64,
        projection: match projection {
            Projection::Free => proto::Projection::Free.into(),
            Projection::OnSurface => proto::Projection::OnSurface.into(),
        },
        measure: match measure {
            true => proto::Measure::Full.into(),
            false => proto::Measure::Topology.into(),
        },
        placement: match placement {
            Placement::Fitted => proto::Placement::Fitted.into(),
            Placement::Surface => proto::Placement::Surface.into(),
            Placement::Centroids => proto::Placement::Centroids.into(),
        },
        boundaries: match keep_boundaries {
            true => proto::BoundaryRule::Keep.into(),
            false => proto::BoundaryRule::Free.into(),
        },
        thin: match keep_thin {
            true => proto::ThinRule::Finer.into(),
            false => proto::ThinRule::Even.into(),
        },
        refinement: refine.map(|r| proto::Refinement { tolerance: r.tolerance, max_points: Some(r.max_points as u64) }),
        density: Some(density_options(density)),
        attributes: attributes.as_ref().map(attributes::headers).unwrap_or_default(),
    }
}

/// The counts of `mesh`, and of the weights that `density` reads.
#[cfg(feature = "cli")]
pub(crate) fn mesh_header(mesh: &TriMesh, density: &DensityOptions) -> proto::MeshHeader {
    let weights = if let DensitySource::Weights(weights) = &density.source { weights.len() as u64 } else { 0 };
    proto::MeshHeader {
        vertices: mesh.positions().len() as u64,
        facets: mesh.facets().len() as u64,
        position_type: proto::PositionType::F64.into(),
        weights,
    }
}

/// Where seeds come from.
#[cfg(feature = "cli")]
pub(crate) fn seed_source(seeds: &Seeds) -> proto::SeedSource {
    use proto::seed_source::Source;
    let sampled = |points, random_seed| Source::Sampled(proto::SampledSeeds { points, random_seed });
    let source = match *seeds {
        Seeds::Given(ref seeds) => Source::Uploaded(seeds.len() as u64),
        Seeds::Sample { points, seed } => sampled(points as u64, seed),
        Seeds::Implied { seed } => sampled(0, seed),
    };
    proto::SeedSource { source: Some(source) }
}

#[cfg(feature = "cli")]
fn density_options(options: &DensityOptions) -> proto::DensityOptions {
    // The last three are for users of the library: a server has bounds of its own.
    let DensityOptions { source, edge_length, adaptivity, gradation, clamp: _, ratio: _, max_points: _ } = options;
    let kind = match source {
        DensitySource::Uniform => proto::DensitySource::Uniform,
        DensitySource::Weights(_) => proto::DensitySource::Weights,
        DensitySource::Sizes(_) => proto::DensitySource::EdgeLengths,
        DensitySource::Curvature => proto::DensitySource::Curvature,
        DensitySource::FeatureSize => proto::DensitySource::FeatureSize,
    };
    proto::DensityOptions {
        source: kind.into(),
        edge_length: edge_length.unwrap_or(0.0),
        edge_lengths: if let DensitySource::Sizes(sizes) = source { sizes.len() as u64 } else { 0 },
        adaptivity: Some(*adaptivity),
        gradation: Some(*gradation),
    }
}
