//! Densities between messages and the library.
//!
//! Purpose: where the density of a header comes from, its numbers, and back for a client.
//! Invariant: what is uploaded is what the source reads. What is left open has the library's default.
//! Must not know: how many seeds there are, what a density does.

use super::{WireError, proto};
pub use geometry::cvt::density::{DensityOptions, DensitySource};

/// A density's source; what is uploaded must be what it reads.
pub(super) fn kind(density: &proto::DensityOptions, weights: bool) -> Result<proto::DensitySource, WireError> {
    use proto::DensitySource as Source;
    let lengths = density.edge_lengths != 0;
    let source = match Source::try_from(density.source) {
        Ok(Source::Unspecified) if lengths => Source::EdgeLengths,
        Ok(Source::Unspecified) if weights => Source::Weights,
        Ok(Source::Unspecified) => Source::Uniform,
        Ok(source) => source,
        Err(_) => return Err(WireError::unknown_enum("header.density.source", density.source)),
    };
    for (path, uploaded, read) in [
        ("header.density.edge_lengths", lengths, source == Source::EdgeLengths),
        ("header.mesh.weights", weights, source == Source::Weights),
    ] {
        if uploaded != read {
            let name = source.as_str_name();
            let text =
                if read { format!("is 0, but {name} reads them") } else { format!("is not 0, but {name} reads none") };
            return Err(WireError::field(path, text));
        }
    }
    Ok(source)
}

/// A density whose header was checked, with what was uploaded for it.
pub fn of(
    density: Option<&proto::DensityOptions>,
    weights: Option<Vec<f64>>,
    lengths: Option<Vec<f64>>,
    max_points: u64,
) -> Result<DensityOptions, WireError> {
    let kind = match density {
        Some(given) => kind(given, weights.is_some())?,
        None => proto::DensitySource::Unspecified,
    };
    let source = match (kind, lengths, weights) {
        (proto::DensitySource::Curvature, ..) => DensitySource::Curvature,
        (proto::DensitySource::FeatureSize, ..) => DensitySource::FeatureSize,
        (_, Some(lengths), _) => DensitySource::Sizes(lengths),
        (_, None, Some(weights)) => DensitySource::Weights(weights),
        (_, None, None) => DensitySource::Uniform,
    };
    let max_points = usize::try_from(max_points).unwrap_or(usize::MAX);
    Ok(DensityOptions { source, max_points, ..numbers(density) })
}

/// A density without what it reads per vertex. What is not said of the others is the library's.
pub(super) fn numbers(density: Option<&proto::DensityOptions>) -> DensityOptions {
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

/// What asks for the same as `options`.
pub(super) fn message(options: &DensityOptions) -> proto::DensityOptions {
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
