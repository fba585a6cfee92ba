//! Options between messages and the library.
//!
//! Purpose: [`remesh`], [`session`] and [`diagram`] check the options of a message and give the library's; [`of_remesh`] writes
//! the message of options. Streams, jobs and the command share them. Invariant: all checks of an option's value are here; a
//! refusal has the field's path below the options. An option that is not set has the library's default, and no number here is
//! one. Must not know: streams, jobs, how arrays arrive, what an option does.

use std::fmt::Display;
use std::str::FromStr;

use glam::DVec3;

use super::counts::Bounds;
use super::proto::{self, BoundaryRule, Measure, NonManifoldRule, RvdOutput, ThinRule};
use super::{WireError, unknown_enum};
use geometry::cvt::density::{DensityOptions, DensitySource};
use geometry::cvt::{CvtOptions, Projection};
use geometry::mesh::motion::Motion;
use geometry::mesh::parts::{Part, Zone};
use geometry::mesh::plane::{Plane, PlaneError};
use geometry::mesh::tensor::Tensor;
use geometry::remesh::{Anisotropy, Placement, Refine, RemeshOptions, Seeds, Share, Tolerance};

type Read<T> = Result<T, WireError>;

/// Arrays that are given beside options.
#[derive(Clone, Copy, Debug, Default)]
pub struct Beside {
    /// Number of seeds; 0 if they are not counted yet.
    pub seeds: Option<u64>,
    pub edge_lengths: bool,
    pub weights: bool,
    pub metric: bool,
}

/// A session of iterations. Arrays are empty until [`fill`].
#[derive(Clone, Debug)]
pub struct Session {
    pub seeds: Seeds,
    pub density: DensityOptions,
    pub options: CvtOptions,
}

/// A restricted Voronoi diagram. Arrays are empty until [`fill`].
#[derive(Clone, Debug)]
pub struct Diagram {
    pub seeds: Seeds,
    pub density: DensityOptions,
    pub outputs: Outputs,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs {
    pub cells: bool,
    pub centroids: bool,
    pub sums: bool,
}

pub trait Start {
    fn seeds(&self) -> &Seeds;
    fn start(&mut self) -> (&mut Seeds, &mut DensityOptions);
}

macro_rules! start {
    ($($of:ty),*) => {
        $(impl Start for $of {
            fn seeds(&self) -> &Seeds {
                &self.seeds
            }

            fn start(&mut self) -> (&mut Seeds, &mut DensityOptions) {
                (&mut self.seeds, &mut self.density)
            }
        })*
    };
}

start!(RemeshOptions, Session, Diagram);

/// Arrays by vertex, of which options read one at most.
#[derive(Debug, Default)]
pub struct ByVertex {
    pub edge_lengths: Option<Vec<f64>>,
    pub weights: Option<Vec<f64>>,
    pub metric: Option<Vec<Tensor>>,
}

/// Puts the arrays that came into the options that were checked for them.
pub fn fill(options: &mut dyn Start, points: Vec<DVec3>, arrays: ByVertex) {
    let (seeds, density) = options.start();
    if let Seeds::Given(given) = seeds {
        *given = points;
    }
    match (&mut density.source, arrays) {
        (DensitySource::Sizes(sizes), ByVertex { edge_lengths: Some(lengths), .. }) => *sizes = lengths,
        (DensitySource::Weights(given), ByVertex { weights: Some(weights), .. }) => *given = weights,
        (DensitySource::Metric(given), ByVertex { metric: Some(metric), .. }) => *given = metric,
        _ => {}
    }
}

/// The number of points that one of three options says.
fn points(count: Option<u32>, percent: Option<f64>, facets: Option<u32>) -> Read<Option<Points>> {
    let all = [
        ("points", count.map(Points::Count)),
        ("points_percent", percent.map(|percent| Points::Share(Share::Percent(percent)))),
        ("facets", facets.map(|facets| Points::Share(Share::Facets(facets as usize)))),
    ];
    let mut said = all.into_iter().filter_map(|(name, points)| Some((name, points?)));
    let first = said.next();
    match (first, said.next()) {
        (Some((first, _)), Some((other, _))) => {
            Err(WireError::field(other, format!("is given beside {first}; give one of the two")))
        }
        (Some((name, Points::Share(Share::Percent(percent)))), None) if !(percent > 0.0 && percent <= MOST_PERCENT) => {
            Err(WireError::field(name, format!("is {percent} %; give more than 0 % and at most {MOST_PERCENT} %")))
        }
        (Some((name, Points::Share(Share::Facets(0)))), None) => Err(WireError::field(name, "is 0; give at least 1")),
        _ => Ok(first.map(|(_, points)| points)),
    }
}

/// Why an option is refused beside a metric.
const BESIDE_METRIC: &str = "is given beside a metric, which says how facets are to be; leave one of the two out";

/// The most percent of the vertices that points may be.
const MOST_PERCENT: f64 = 100_000.0;

#[derive(Clone, Copy)]
enum Points {
    Count(u32),
    Share(Share),
}

/// A remesh. Seeds and lengths or weights that are given beside the options are empty until [`fill`].
pub fn remesh(given: &proto::RemeshOptions, beside: Beside, bounds: &Bounds) -> Read<RemeshOptions> {
    let usual = RemeshOptions::usual();
    let points = points(given.points, given.points_percent, given.facets)?;
    let (seeds, density) = start(points, given.seed, given.density.as_ref(), beside, bounds)?;
    let steps = |path, steps: Option<u32>, usual: usize| match steps {
        Some(steps) => {
            within(path, steps.into(), 0, bounds.max_iterations.into())?;
            Ok::<_, WireError>(steps as usize)
        }
        // A server that allows fewer iterations than the default means that for all callers.
        None => Ok(usual.min(bounds.max_iterations as usize)),
    };
    if let Some(angle) = given.crease_angle.filter(|angle| !(0.0..=180.0).contains(angle)) {
        return Err(WireError::field("crease_angle", format!("is {angle}; give an angle from 0 to 180 degrees")));
    }
    let anisotropy = match given.anisotropy {
        Some(_) if given.anisotropy_auto => {
            return Err(WireError::field("anisotropy_auto", "is given beside anisotropy; give one of the two"));
        }
        None if given.anisotropy_auto => Anisotropy::Auto,
        None => usual.anisotropy,
        Some(0.0) => Anisotropy::None,
        Some(share) if Anisotropy::SHARES.contains(&share) => Anisotropy::Share(share),
        Some(share) => {
            let [least, most] = [Anisotropy::SHARES.start(), Anisotropy::SHARES.end()];
            return Err(WireError::field(
                "anisotropy",
                format!("is {share}; give a share of the diagonal from {least} to {most}"),
            ));
        }
    };
    let placement = match choice("placement", given.placement)? {
        proto::Placement::Unspecified => usual.placement,
        proto::Placement::Fitted => Placement::Fitted,
        proto::Placement::Surface => Placement::Surface,
        proto::Placement::Centroids => Placement::Centroids,
    };
    positive("weld", given.weld)?;
    positive("weld_percent", given.weld_percent)?;
    let weld = match (given.weld, given.weld_percent) {
        (Some(_), Some(_)) => {
            return Err(WireError::field("weld_percent", "is given beside weld; give one of the two"));
        }
        (length, percent) => length.map(Tolerance::Length).or(percent.map(Tolerance::DiagonalPercent)),
    };
    let (keep, only) = (parts("keep", &given.keep)?, parts("only", &given.only)?);
    let wrong_plane = |error: PlaneError| WireError::field("mirror", format!("is wrong: {error}"));
    let mirror = given.mirror.as_deref().map(str::parse::<Plane>).transpose().map_err(wrong_plane)?;
    let periodic: Vec<Motion> = texts("periodic", &given.periodic, MOST_MOTIONS, "motions")?;
    if matches!(density.source, DensitySource::Metric(_)) {
        let others = [
            ("anisotropy", given.anisotropy.is_some_and(|share| share != 0.0)),
            ("anisotropy_auto", given.anisotropy_auto),
            ("max_deviation", given.max_deviation.is_some()),
            ("max_deviation_length", given.max_deviation_length.is_some()),
            ("seeds", matches!(seeds, Seeds::Given(_))),
            ("non_manifold", given.non_manifold == NonManifoldRule::Keep as i32),
            ("keep", !keep.is_empty()),
            ("only", !only.is_empty()),
            ("keep_rims", given.keep_rims),
            ("mirror", mirror.is_some()),
            ("periodic", !periodic.is_empty()),
        ];
        if let Some((name, _)) = others.into_iter().find(|other| other.1) {
            return Err(WireError::field(name, BESIDE_METRIC));
        }
    }
    let counts = (!matches!(seeds, Seeds::Implied { .. }), first(&seeds, beside));
    let tolerances = (given.max_deviation, given.max_deviation_length);
    Ok(RemeshOptions {
        refine: refine(tolerances, given.max_points, placement, counts, bounds)?,
        seeds,
        lloyd: steps("lloyd", given.lloyd, usual.lloyd)?,
        newton: steps("newton", given.newton, usual.newton)?,
        density,
        projection: projection(given.projection)?,
        placement,
        crease_angle_deg: given.crease_angle.unwrap_or(usual.crease_angle_deg),
        keep_boundaries: match choice("boundaries", given.boundaries)? {
            BoundaryRule::Unspecified => usual.keep_boundaries,
            BoundaryRule::Keep => true,
            BoundaryRule::Free => false,
        },
        keep_thin: match choice("thin", given.thin)? {
            ThinRule::Unspecified => usual.keep_thin,
            ThinRule::Finer => true,
            ThinRule::Even => false,
        },
        keep_non_manifold: match choice("non_manifold", given.non_manifold)? {
            NonManifoldRule::Unspecified => usual.keep_non_manifold,
            NonManifoldRule::Keep => true,
            NonManifoldRule::Cut => false,
        },
        measure: match choice("measure", given.measure)? {
            Measure::Unspecified => usual.measure,
            Measure::Full => true,
            Measure::Topology => false,
        },
        anisotropy,
        weld,
        keep,
        only,
        keep_rims: given.keep_rims,
        strict_creases: given.strict_creases,
        mirror,
        periodic,
        source_map: given.source_map,
        creases: usual.creases,
        attributes: usual.attributes,
    })
}

/// The most parts that are named.
const MOST_PARTS: usize = 64;
/// The most motions between boundaries.
const MOST_MOTIONS: usize = 8;

/// Parts of a surface, or zones.
fn parts<T: FromStr<Err: Display>>(path: &str, given: &[String]) -> Read<Vec<T>> {
    texts(path, given, MOST_PARTS, "parts")
}

/// A list of texts, of which there are at most `most`.
fn texts<T: FromStr<Err: Display>>(path: &str, given: &[String], most: usize, what: &str) -> Read<Vec<T>> {
    if given.len() > most {
        return Err(WireError::field(path, format!("has {} {what}; at most {most} are possible", given.len())));
    }
    let one = |(k, text): (usize, &String)| {
        text.parse::<T>().map_err(|error| WireError::field(format!("{path}[{k}]"), format!("is wrong: {error}")))
    };
    given.iter().enumerate().map(one).collect()
}

pub fn session(given: &proto::CvtOptions, beside: Beside, bounds: &Bounds) -> Read<Session> {
    let &proto::CvtOptions { points, points_percent, seed, ref density, projection, max_seeds } = given;
    let points = self::points(points, points_percent, None)?;
    let (seeds, density) = start(points, seed, density.as_ref(), beside, bounds)?;
    if let Some(most) = max_seeds {
        within("max_seeds", most.into(), first(&seeds, beside).unwrap_or(1), bounds.max_seeds)?;
    }
    let options = CvtOptions { projection: self::projection(projection)?, max_seeds: max_seeds.unwrap_or(0) as usize };
    Ok(Session { seeds, density, options })
}

pub fn diagram(given: &proto::DiagramOptions, beside: Beside, bounds: &Bounds) -> Read<Diagram> {
    let &proto::DiagramOptions { points, points_percent, seed, ref outputs } = given;
    let points = self::points(points, points_percent, None)?;
    let (seeds, density) = start(points, seed, None, beside, bounds)?;
    let mut wanted = Outputs { cells: outputs.is_empty(), ..Outputs::default() };
    for (i, &output) in outputs.iter().enumerate() {
        match RvdOutput::try_from(output) {
            Ok(RvdOutput::Cells) => wanted.cells = true,
            Ok(RvdOutput::Centroids) => wanted.centroids = true,
            Ok(RvdOutput::Sums) => wanted.sums = true,
            Ok(RvdOutput::Unspecified) | Err(_) => return Err(unknown_enum(format!("outputs[{i}]"), output)),
        }
    }
    Ok(Diagram { seeds, density, outputs: wanted })
}

fn start(
    points: Option<Points>,
    seed: Option<u64>,
    density: Option<&proto::Density>,
    beside: Beside,
    bounds: &Bounds,
) -> Read<(Seeds, DensityOptions)> {
    let density = self::density(density, beside, bounds)?;
    let seed = seed.unwrap_or(Seeds::RANDOM_SEED);
    let implied = density.edge_length.is_some() || beside.edge_lengths || beside.metric;
    let counted = points.is_some() || beside.seeds.is_some();
    if counted && density.edge_length.is_some() {
        let text = "is given beside a number of points; give one of the two";
        return Err(WireError::field("density.edge_length", text));
    }
    let seeds = match (points, beside.seeds) {
        (Some(_), Some(_)) => return Err(WireError::field("points", "is given beside seeds; give one of the two")),
        (None, Some(_)) => Seeds::Given(Vec::new()),
        (Some(Points::Count(points)), None) => {
            within("points", points.into(), 1, bounds.max_seeds)?;
            Seeds::Sample { points: points as usize, seed }
        }
        (Some(Points::Share(of)), None) => Seeds::Share { of, seed },
        (None, None) if implied => Seeds::Implied { seed },
        (None, None) => {
            return Err(WireError::field(
                "points",
                "is missing; give points, seeds, or edge lengths where they are read",
            ));
        }
    };
    Ok((seeds, density))
}

/// How many seeds there are at first, if that is known.
fn first(seeds: &Seeds, beside: Beside) -> Option<u64> {
    match seeds {
        Seeds::Sample { points, .. } => Some(*points as u64),
        Seeds::Given(_) => beside.seeds.filter(|count| *count > 0),
        Seeds::Implied { .. } | Seeds::Share { .. } => None,
    }
}

fn density(given: Option<&proto::Density>, beside: Beside, bounds: &Bounds) -> Read<DensityOptions> {
    use proto::DensitySource as Source;
    let proto::Density { source, edge_length, adaptivity, gradation, size_in } = given.cloned().unwrap_or_default();
    let kind = match choice("density.source", source)? {
        Source::Unspecified if beside.edge_lengths => Source::EdgeLengths,
        Source::Unspecified if beside.weights => Source::Weights,
        Source::Unspecified if beside.metric => Source::Metric,
        Source::Unspecified => Source::Uniform,
        source => source,
    };
    for (what, given, of) in [
        ("edge lengths", beside.edge_lengths, Source::EdgeLengths),
        ("weights", beside.weights, Source::Weights),
        ("metric tensors", beside.metric, Source::Metric),
    ] {
        if given != (kind == of) {
            let name = word(&kind);
            let text = match given {
                true => format!("is {name}, but {what} are given; leave one of the two out"),
                false => format!("is {name}, but no {what} are given"),
            };
            return Err(WireError::field("density.source", text));
        }
    }
    if edge_length.is_some() && beside.edge_lengths {
        let text = "is given beside edge lengths of vertices; give one of the two";
        return Err(WireError::field("density.edge_length", text));
    }
    let others = [("edge_length", edge_length), ("adaptivity", adaptivity), ("gradation", gradation)];
    if let Some((name, _)) = others.into_iter().find(|(_, given)| beside.metric && given.is_some()) {
        return Err(WireError::field(format!("density.{name}"), BESIDE_METRIC));
    }
    positive("density.edge_length", edge_length)?;
    positive("density.gradation", gradation)?;
    if let Some(adaptivity) = adaptivity.filter(|share| !(0.0..=1.0).contains(share)) {
        return Err(WireError::field("density.adaptivity", format!("is {adaptivity}; give a number from 0 to 1")));
    }
    let zones = parts("density.size_in", &size_in)?;
    if !zones.is_empty() && matches!(kind, Source::Weights | Source::Metric) {
        let text = "is given beside weights or a metric, which say how long all edges are; leave one of the two out";
        return Err(WireError::field("density.size_in", text));
    }
    let usual = DensityOptions::default();
    Ok(DensityOptions {
        zones,
        source: match kind {
            Source::Unspecified | Source::Uniform => DensitySource::Uniform,
            Source::Weights => DensitySource::Weights(Vec::new()),
            Source::EdgeLengths => DensitySource::Sizes(Vec::new()),
            Source::Curvature => DensitySource::Curvature,
            Source::Lfs => DensitySource::FeatureSize,
            Source::Error => DensitySource::Error,
            Source::ErrorMax => DensitySource::ErrorMax,
            Source::Metric => DensitySource::Metric(Vec::new()),
        },
        edge_length,
        adaptivity: adaptivity.unwrap_or(usual.adaptivity),
        gradation: gradation.unwrap_or(usual.gradation),
        max_points: usize::try_from(bounds.max_seeds).unwrap_or(usize::MAX),
        ..usual
    })
}

fn refine(
    (percent, length): (Option<f64>, Option<f64>),
    max_points: Option<u32>,
    placement: Placement,
    (counted, first): (bool, Option<u64>),
    bounds: &Bounds,
) -> Read<Option<Refine>> {
    positive("max_deviation", percent)?;
    positive("max_deviation_length", length)?;
    let (path, tolerance) = match (percent, length) {
        (None, None) if max_points.is_some() => {
            return Err(WireError::field("max_points", "is given without max_deviation; give both"));
        }
        (None, None) => return Ok(None),
        (Some(_), Some(_)) => {
            let text = "is given beside max_deviation; give one of the two";
            return Err(WireError::field("max_deviation_length", text));
        }
        (Some(percent), None) => ("max_deviation", Tolerance::DiagonalPercent(percent)),
        (None, Some(length)) => ("max_deviation_length", Tolerance::Length(length)),
    };
    if placement != Placement::Fitted {
        return Err(WireError::field(path, "is for the placement fitted; leave one of the two out"));
    }
    let max_points = match (max_points, first) {
        (Some(most), first) => {
            within("max_points", most.into(), 1, bounds.max_seeds)?;
            if let Some(first) = first.filter(|first| u64::from(most) < *first) {
                return Err(WireError::field(
                    "max_points",
                    format!("is {most}, less than the {first} points at first"),
                ));
            }
            Some(most as usize)
        }
        (None, Some(first)) => {
            Some(usize::try_from(first.saturating_mul(2).min(bounds.max_seeds)).unwrap_or(usize::MAX))
        }
        (None, None) if counted => None,
        (None, None) => {
            let text = "is missing; it must be given where edge lengths say how many points there are";
            return Err(WireError::field("max_points", text));
        }
    };
    Ok(Some(Refine { tolerance, max_points }))
}

fn projection(value: i32) -> Read<Projection> {
    Ok(match choice("projection", value)? {
        proto::Projection::Unspecified => CvtOptions::default().projection,
        proto::Projection::Free => Projection::Free,
        proto::Projection::Surface => Projection::OnSurface,
    })
}

pub fn choice<E: TryFrom<i32>>(path: &str, value: i32) -> Read<E> {
    E::try_from(value).map_err(|_| unknown_enum(path, value))
}

fn positive(path: &str, given: Option<f64>) -> Read<()> {
    let Some(number) = given.filter(|number| !(number.is_finite() && *number > 0.0)) else { return Ok(()) };
    Err(WireError::field(path, format!("is {number}; give a finite number above 0")))
}

/// Checks that `least <= value <= most`.
pub fn within(path: &str, value: u64, least: u64, most: u64) -> Read<()> {
    let wrong = || WireError::field(path, format!("is {value}; give {least} to {most}"));
    (least..=most).contains(&value).then_some(()).ok_or_else(wrong)
}

/// The name of a source, as callers write it.
fn word(kind: &proto::DensitySource) -> String {
    kind.as_str_name().trim_start_matches("DENSITY_SOURCE_").to_ascii_lowercase()
}

pub fn source(density: &DensityOptions) -> proto::DensitySource {
    match density.source {
        DensitySource::Uniform => proto::DensitySource::Uniform,
        DensitySource::Weights(_) => proto::DensitySource::Weights,
        DensitySource::Sizes(_) => proto::DensitySource::EdgeLengths,
        DensitySource::Curvature => proto::DensitySource::Curvature,
        DensitySource::FeatureSize => proto::DensitySource::Lfs,
        DensitySource::Error => proto::DensitySource::Error,
        DensitySource::ErrorMax => proto::DensitySource::ErrorMax,
        DensitySource::Metric(_) => proto::DensitySource::Metric,
    }
}

/// The message of options, all numbers written out. Arrays are left aside.
pub fn of_remesh(options: &RemeshOptions) -> proto::RemeshOptions {
    let count = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    let tolerance = options.refine.map(|refine| refine.tolerance);
    // A metric is taken as it is.
    let bounded = !matches!(options.density.source, DensitySource::Metric(_));
    proto::RemeshOptions {
        points: if let Seeds::Sample { points, .. } = &options.seeds { Some(count(*points)) } else { None },
        points_percent: if let Seeds::Share { of: Share::Percent(x), .. } = options.seeds { Some(x) } else { None },
        facets: if let Seeds::Share { of: Share::Facets(n), .. } = options.seeds { Some(count(n)) } else { None },
        seed: (!matches!(options.seeds, Seeds::Given(_))).then(|| options.seeds.random_seed()),
        density: Some(proto::Density {
            source: source(&options.density).into(),
            edge_length: options.density.edge_length,
            adaptivity: bounded.then_some(options.density.adaptivity),
            gradation: bounded.then_some(options.density.gradation),
            size_in: options.density.zones.iter().map(Zone::to_string).collect(),
        }),
        lloyd: Some(count(options.lloyd)),
        newton: Some(count(options.newton)),
        projection: match options.projection {
            Projection::Free => proto::Projection::Free.into(),
            Projection::OnSurface => proto::Projection::Surface.into(),
        },
        placement: match options.placement {
            Placement::Fitted => proto::Placement::Fitted.into(),
            Placement::Surface => proto::Placement::Surface.into(),
            Placement::Centroids => proto::Placement::Centroids.into(),
        },
        crease_angle: Some(options.crease_angle_deg),
        boundaries: if options.keep_boundaries { BoundaryRule::Keep } else { BoundaryRule::Free }.into(),
        thin: if options.keep_thin { ThinRule::Finer } else { ThinRule::Even }.into(),
        max_deviation: if let Some(Tolerance::DiagonalPercent(percent)) = tolerance { Some(percent) } else { None },
        max_deviation_length: if let Some(Tolerance::Length(length)) = tolerance { Some(length) } else { None },
        max_points: options.refine.and_then(|refine| refine.max_points).map(count),
        measure: if options.measure { Measure::Full } else { Measure::Topology }.into(),
        anisotropy: match options.anisotropy {
            Anisotropy::None => Some(0.0),
            Anisotropy::Share(share) => Some(share),
            Anisotropy::Auto => None,
        },
        anisotropy_auto: options.anisotropy == Anisotropy::Auto,
        weld: if let Some(Tolerance::Length(length)) = options.weld { Some(length) } else { None },
        weld_percent: if let Some(Tolerance::DiagonalPercent(percent)) = options.weld { Some(percent) } else { None },
        non_manifold: if options.keep_non_manifold { NonManifoldRule::Keep } else { NonManifoldRule::Cut }.into(),
        keep: options.keep.iter().map(Part::to_string).collect(),
        only: options.only.iter().map(Part::to_string).collect(),
        keep_rims: options.keep_rims,
        strict_creases: options.strict_creases,
        mirror: options.mirror.as_ref().map(Plane::to_string),
        periodic: options.periodic.iter().map(Motion::to_string).collect(),
        source_map: options.source_map,
    }
}
