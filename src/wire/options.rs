//! Options between messages and the library.
//!
//! Purpose: the header of a `Remesh` or `Cvt` to [`RemeshOptions`] or [`CvtOptions`], and back for a client.
//! Invariant: what a header leaves open has the library's default, and no number here is one. Both sides are
//! taken apart field by field, so that an option cannot be added to one of them alone.
//! Must not know: streams, queues, what an option does.
use super::attributes;
use super::counts::{Bounds, SeedCounts, within};
use super::density;
use super::proto::{self, CvtHeader, RemeshHeader};
use super::{WireError, codec};
use geometry::cvt::density::DensityOptions;
pub use geometry::cvt::density::DensitySource;
use geometry::cvt::{CvtOptions, Projection};
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::Attributes;
pub use geometry::mesh::features::FeatureError;
use geometry::remesh::{Placement, Refine, RemeshError, RemeshOptions, Seeds};

/// What came in arrays beside a header.
#[derive(Clone, Debug)]
pub struct RemeshArrays {
    pub density: DensityOptions,
    pub seeds: Seeds,
    pub creases: Vec<[u32; 2]>,
    pub attributes: Option<Attributes>,
}

/// What a header and its arrays ask for.
pub fn of_remesh(header: &RemeshHeader, arrays: RemeshArrays, bounds: &Bounds) -> Result<RemeshOptions, WireError> {
    let RemeshArrays { density, seeds, creases, attributes } = arrays;
    let counts = match &seeds {
        Seeds::Given(seeds) => SeedCounts::Uploaded(seeds.len() as u64),
        &Seeds::Sample { points, seed } => SeedCounts::Sampled { points: points as u64, seed },
        &Seeds::Implied { seed } => SeedCounts::Implied { seed },
    };
    let Numbers { lloyd, newton, crease_angle_deg, projection, placement, keep_boundaries, keep_thin, measure, refine } =
        Numbers::of(header, counts, bounds)?;
    Ok(RemeshOptions {
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
    })
}

/// Whether a header's options are in their ranges, before anything is uploaded.
pub fn check_remesh(header: &RemeshHeader, seeds: SeedCounts, bounds: &Bounds) -> Result<(), WireError> {
    Numbers::of(header, seeds, bounds).map(|_| ())
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
    fn of(header: &RemeshHeader, counts: SeedCounts, bounds: &Bounds) -> Result<Self, WireError> {
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
                within(path, steps.into(), 0, bounds.max_iterations.into())?;
                Ok::<_, WireError>(steps as usize)
            }
            // Who allows fewer iterations than that means it for everybody.
            None => Ok(usual.min(bounds.max_iterations as usize)),
        };
        let crease_angle_deg = crease_angle_deg.unwrap_or(usual.crease_angle_deg);
        if !(0.0..=180.0).contains(&crease_angle_deg) {
            return Err(RemeshError::from(FeatureError::BadAngle(crease_angle_deg)).into());
        }
        let placement = codec::placement(placement)?.unwrap_or(usual.placement);
        if refinement.is_some() && placement != Placement::Fitted {
            return Err(RemeshError::RefineUnfitted.into());
        }
        Ok(Self {
            lloyd: steps("header.lloyd_steps", lloyd_steps, usual.lloyd)?,
            newton: steps("header.newton_steps", newton_steps, usual.newton)?,
            crease_angle_deg,
            projection: codec::projection(projection)?.unwrap_or(usual.projection),
            placement,
            keep_boundaries: codec::boundaries(boundaries)?.unwrap_or(usual.keep_boundaries),
            keep_thin: codec::thin(thin)?.unwrap_or(usual.keep_thin),
            measure: codec::measure(measure)?.unwrap_or(usual.measure),
            refine: refinement.as_ref().map_or(Ok(usual.refine), |given| refine(given, counts, bounds).map(Some))?,
        })
    }
}

fn refine(given: &proto::Refinement, counts: SeedCounts, bounds: &Bounds) -> Result<Refine, WireError> {
    let proto::Refinement { tolerance, max_points } = *given;
    if !(tolerance.is_finite() && tolerance > 0.0) {
        let text = format!("is {tolerance}; give a distance above 0");
        return Err(WireError::field("header.refinement.tolerance", text));
    }
    let path = "header.refinement.max_points";
    match (max_points, counts) {
        (Some(most), _) => {
            within(path, most, 1, bounds.max_seeds)?;
            Ok(Refine { tolerance, max_points: most as usize })
        }
        (None, SeedCounts::Uploaded(points) | SeedCounts::Sampled { points, .. }) => {
            let Refine { tolerance, max_points } = Refine::new(tolerance, points as usize);
            Ok(Refine { tolerance, max_points: max_points.min(bounds.max_seeds as usize) })
        }
        (None, SeedCounts::Implied { .. }) => {
            Err(WireError::field(path, "is missing; it must be given where edge lengths say how many points there are"))
        }
    }
}

/// What the header of a session asks for.
pub fn of_cvt(header: &CvtHeader) -> Result<CvtOptions, WireError> {
    let CvtHeader { mesh: _, seeds: _, backend: _, density: _, projection, max_seeds } = *header;
    let usual = CvtOptions::default();
    Ok(CvtOptions {
        projection: codec::projection(projection)?.unwrap_or(usual.projection),
        // 0 means the same to both.
        max_seeds: max_seeds as usize,
    })
}

/// The header that asks for the same as `options`, of `mesh`; seeds that are given are to be uploaded.
pub fn remesh_header(mesh: &TriMesh, options: &RemeshOptions, backend: proto::BackendChoice) -> RemeshHeader {
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
        density: Some(density::message(density)),
        attributes: attributes.as_ref().map(attributes::headers).unwrap_or_default(),
    }
}

/// The counts of `mesh`, and of the weights that `density` reads.
pub fn mesh_header(mesh: &TriMesh, density: &DensityOptions) -> proto::MeshHeader {
    let weights = if let DensitySource::Weights(weights) = &density.source { weights.len() as u64 } else { 0 };
    proto::MeshHeader {
        vertices: mesh.positions().len() as u64,
        facets: mesh.facets().len() as u64,
        position_type: proto::PositionType::F64.into(),
        weights,
    }
}

/// Where seeds come from.
pub fn seed_source(seeds: &Seeds) -> proto::SeedSource {
    use proto::seed_source::Source;
    let sampled = |points, random_seed| Source::Sampled(proto::SampledSeeds { points, random_seed });
    let source = match *seeds {
        Seeds::Given(ref seeds) => Source::Uploaded(seeds.len() as u64),
        Seeds::Sample { points, seed } => sampled(points as u64, seed),
        Seeds::Implied { seed } => sampled(0, seed),
    };
    proto::SeedSource { source: Some(source) }
}
