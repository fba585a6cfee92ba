//! Between messages and the types of the engine.
//!
//! Purpose: enums, figures, and arrays as chunks. Invariant: an unknown enum value is an error, never
//! a default; `None` is what is not specified. Must not know: streams, queues, defaults (`options`).

use glam::DVec3;
use prost::bytes::Bytes;

use super::RequestError;
use super::proto::{self, ArrayKind, BackendChoice, CellsChunk, Chunk};
use crate::cvt::density::{DensityOptions, DensitySource};
use crate::cvt::{Iteration, Projection, SeedEdit, StepKind};
use crate::job::session::SeedsWanted;
use crate::job::{BackendInfo, Wish};
use crate::remesh::Placement;
use crate::remesh::report::RvdFigures;
use crate::rvd::{BackendKind, PieceBatch};

/// Bytes of data in a chunk that is sent. Small, so that little waits for a slow reader.
const CHUNK_BYTES: usize = 64 << 10;

/// The longest report that the last message holds, bytes; a longer one goes ahead of it in chunks.
pub(crate) const REPORT_IN_DONE_BYTES: usize = 256 << 10;

pub(crate) fn wish(value: i32) -> Result<Wish, RequestError> {
    match BackendChoice::try_from(value) {
        Ok(BackendChoice::Unspecified | BackendChoice::Auto) => Ok(Wish::Auto),
        Ok(BackendChoice::Gpu) => Ok(Wish::Only(BackendKind::Gpu)),
        Ok(BackendChoice::Parallel) => Ok(Wish::Only(BackendKind::Parallel)),
        Ok(BackendChoice::Serial) => Ok(Wish::Only(BackendKind::Serial)),
        Err(_) => Err(RequestError::unknown_enum("header.backend", value)),
    }
}

pub(crate) fn projection(value: i32) -> Result<Option<Projection>, RequestError> {
    match proto::Projection::try_from(value) {
        Ok(proto::Projection::Unspecified) => Ok(None),
        Ok(proto::Projection::Free) => Ok(Some(Projection::Free)),
        Ok(proto::Projection::OnSurface) => Ok(Some(Projection::OnSurface)),
        Err(_) => Err(RequestError::unknown_enum("header.projection", value)),
    }
}

/// Whether shape and distance are measured.
pub(crate) fn measure(value: i32) -> Result<Option<bool>, RequestError> {
    match proto::Measure::try_from(value) {
        Ok(proto::Measure::Unspecified) => Ok(None),
        Ok(proto::Measure::Full) => Ok(Some(true)),
        Ok(proto::Measure::Topology) => Ok(Some(false)),
        Err(_) => Err(RequestError::unknown_enum("header.measure", value)),
    }
}

pub(crate) fn seeds_wanted(value: i32, path: &str) -> Result<SeedsWanted, RequestError> {
    match proto::SeedsWanted::try_from(value) {
        Ok(proto::SeedsWanted::Unspecified | proto::SeedsWanted::Never) => Ok(SeedsWanted::Never),
        Ok(proto::SeedsWanted::Last) => Ok(SeedsWanted::Last),
        Ok(proto::SeedsWanted::Each) => Ok(SeedsWanted::Each),
        Err(_) => Err(RequestError::unknown_enum(path, value)),
    }
}

pub(crate) fn placement(value: i32) -> Result<Option<Placement>, RequestError> {
    match proto::Placement::try_from(value) {
        Ok(proto::Placement::Unspecified) => Ok(None),
        Ok(proto::Placement::Fitted) => Ok(Some(Placement::Fitted)),
        Ok(proto::Placement::Surface) => Ok(Some(Placement::Surface)),
        Ok(proto::Placement::Centroids) => Ok(Some(Placement::Centroids)),
        Err(_) => Err(RequestError::unknown_enum("header.placement", value)),
    }
}

/// Whether boundaries are kept.
pub(crate) fn boundaries(value: i32) -> Result<Option<bool>, RequestError> {
    match proto::BoundaryRule::try_from(value) {
        Ok(proto::BoundaryRule::Unspecified) => Ok(None),
        Ok(proto::BoundaryRule::Keep) => Ok(Some(true)),
        Ok(proto::BoundaryRule::Free) => Ok(Some(false)),
        Err(_) => Err(RequestError::unknown_enum("header.boundaries", value)),
    }
}

/// Whether edges become shorter where the surface is thin.
pub(crate) fn thin(value: i32) -> Result<Option<bool>, RequestError> {
    match proto::ThinRule::try_from(value) {
        Ok(proto::ThinRule::Unspecified) => Ok(None),
        Ok(proto::ThinRule::Finer) => Ok(Some(true)),
        Ok(proto::ThinRule::Even) => Ok(Some(false)),
        Err(_) => Err(RequestError::unknown_enum("header.thin", value)),
    }
}

pub(crate) fn step_kind(value: i32) -> Result<StepKind, RequestError> {
    match proto::StepKind::try_from(value) {
        Ok(proto::StepKind::Unspecified | proto::StepKind::Lloyd) => Ok(StepKind::Lloyd),
        Ok(proto::StepKind::Lbfgs) => Ok(StepKind::Lbfgs),
        Err(_) => Err(RequestError::unknown_enum("step.kind", value)),
    }
}

/// A density's source; what is uploaded must be what it reads.
pub(crate) fn density_kind(
    density: &proto::DensityOptions,
    weights: bool,
) -> Result<proto::DensitySource, RequestError> {
    use proto::DensitySource as Source;
    let lengths = density.edge_lengths != 0;
    let source = match Source::try_from(density.source) {
        Ok(Source::Unspecified) if lengths => Source::EdgeLengths,
        Ok(Source::Unspecified) if weights => Source::Weights,
        Ok(Source::Unspecified) => Source::Uniform,
        Ok(source) => source,
        Err(_) => return Err(RequestError::unknown_enum("header.density.source", density.source)),
    };
    for (path, uploaded, read) in [
        ("header.density.edge_lengths", lengths, source == Source::EdgeLengths),
        ("header.mesh.weights", weights, source == Source::Weights),
    ] {
        if uploaded != read {
            let name = source.as_str_name();
            let text =
                if read { format!("is 0, but {name} reads them") } else { format!("is not 0, but {name} reads none") };
            return Err(RequestError::field(path, text));
        }
    }
    Ok(source)
}

/// A density whose header was checked, with what was uploaded for it.
pub(crate) fn density(
    density: Option<&proto::DensityOptions>,
    weights: Option<Vec<f64>>,
    lengths: Option<Vec<f64>>,
    max_points: u64,
) -> Result<DensityOptions, RequestError> {
    let kind = match density {
        Some(given) => density_kind(given, weights.is_some())?,
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
    Ok(DensityOptions { source, max_points, ..super::options::of_density(density) })
}

/// What of a diagram is to be sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Outputs {
    pub(crate) cells: bool,
    pub(crate) centroids: bool,
    pub(crate) sums: bool,
}

pub(crate) fn outputs(values: &[i32]) -> Result<Outputs, RequestError> {
    let mut outputs = Outputs { cells: values.is_empty(), ..Outputs::default() };
    for (i, &value) in values.iter().enumerate() {
        match proto::RvdOutput::try_from(value) {
            Ok(proto::RvdOutput::Cells) => outputs.cells = true,
            Ok(proto::RvdOutput::Centroids) => outputs.centroids = true,
            Ok(proto::RvdOutput::Sums) => outputs.sums = true,
            _ => return Err(RequestError::unknown_enum(&format!("header.outputs[{i}]"), value)),
        }
    }
    Ok(outputs)
}

pub(crate) fn edits(edits: &[proto::SeedEdit]) -> Result<Vec<SeedEdit>, RequestError> {
    let point = |p: &proto::Point| DVec3::new(p.x, p.y, p.z);
    let one = |(i, edit): (usize, &proto::SeedEdit)| {
        let missing = |what: &str| RequestError::field(format!("edit.edits[{i}]{what}"), "is missing");
        match &edit.edit {
            Some(proto::seed_edit::Edit::Move(m)) => {
                let to = m.to.as_ref().ok_or_else(|| missing(".move.to"))?;
                Ok(SeedEdit::Move { index: m.index, to: point(to) })
            }
            Some(proto::seed_edit::Edit::Add(at)) => Ok(SeedEdit::Add { at: point(at) }),
            Some(proto::seed_edit::Edit::Remove(index)) => Ok(SeedEdit::Remove { index: *index }),
            None => Err(missing("")),
        }
    };
    if edits.is_empty() {
        return Err(RequestError::field("edit.edits", "is empty; give at least one change"));
    }
    edits.iter().enumerate().map(one).collect()
}

pub(crate) fn accepted(position: usize, by: &BackendInfo) -> proto::Accepted {
    proto::Accepted {
        queue_position: u32::try_from(position).unwrap_or(u32::MAX),
        backend: by.kind.name().to_owned(),
        adapter: by.adapter.clone().unwrap_or_default(),
        threads: u32::try_from(by.threads).unwrap_or(u32::MAX),
    }
}

pub(crate) fn iteration(it: &Iteration, total: usize, queue_ms: f64) -> proto::Iteration {
    proto::Iteration {
        index: it.index as u64,
        kind: it.kind.name().to_owned(),
        energy: it.energy,
        energy_ratio: it.energy_ratio,
        gradient_norm: it.gradient_norm,
        evaluations: u32::try_from(it.evaluations).unwrap_or(u32::MAX),
        empty_cells: u32::try_from(it.empty_cells).unwrap_or(u32::MAX),
        area: it.area,
        pairs: it.stats.pairs,
        ms: it.ms,
        relaunched_pairs: it.stats.relaunched(),
        total: total as u64,
        queue_ms,
        host_searches: it.stats.host_searches,
        divided_facets: it.stats.divided_facets,
        paired_facets: it.stats.paired_facets,
        device_submissions: it.stats.device_submissions,
        device_allocations: it.stats.device_allocations,
        uploaded_bytes: it.stats.uploaded_bytes,
        read_back_bytes: it.stats.read_back_bytes,
    }
}

pub(crate) fn figures(figures: &RvdFigures) -> proto::RvdFigures {
    proto::RvdFigures {
        area: figures.area,
        pairs: figures.pairs,
        relaunched_pairs: figures.relaunched_pairs,
        f64_finished_pairs: figures.f64_finished_pairs,
        empty_cells: figures.empty_cells as u64,
        duplicate_seeds: figures.duplicate_seeds as u64,
    }
}

/// An array of points as chunks, made one at a time.
pub(crate) fn point_chunks(kind: ArrayKind, points: &[DVec3]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, points, 24, |p, out| p.to_array().iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes())))
}

/// An array of facets as chunks.
pub(crate) fn facet_chunks(kind: ArrayKind, facets: &[[u32; 3]]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, facets, 12, |f, out| f.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes())))
}

/// An array of numbers as chunks.
pub(crate) fn number_chunks(kind: ArrayKind, numbers: &[f64]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, numbers, 8, |x, out| out.extend_from_slice(&x.to_le_bytes()))
}

/// An array of indices as chunks.
pub(crate) fn index_chunks(kind: ArrayKind, indices: &[u32]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, indices, 4, |i, out| out.extend_from_slice(&i.to_le_bytes()))
}

/// Bytes as chunks.
pub(crate) fn byte_chunks(kind: ArrayKind, bytes: &[u8]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, bytes, 1, |byte, out| out.push(*byte))
}

pub(super) fn chunks<'a, T>(
    kind: ArrayKind,
    items: &'a [T],
    item_bytes: usize,
    encode: impl Fn(&T, &mut Vec<u8>) + 'a,
) -> impl Iterator<Item = Chunk> + 'a {
    let total_bytes = (items.len() * item_bytes) as u64;
    let per_chunk = CHUNK_BYTES / item_bytes;
    items.chunks(per_chunk).enumerate().map(move |(i, part)| {
        let mut data = Vec::with_capacity(part.len() * item_bytes);
        part.iter().for_each(|item| encode(item, &mut data));
        let crc32c = crc32c::crc32c(&data);
        let offset = (i * per_chunk * item_bytes) as u64;
        Chunk { kind: kind.into(), offset, data: data.into(), crc32c, total_bytes, ..Chunk::default() }
    })
}

/// Bytes of a polygon vertex in a cells message.
pub(crate) const CELLS_VERTEX_BYTES: usize = 36;

/// Polygon vertices in a cells message.
const CELLS_VERTICES: usize = CHUNK_BYTES / CELLS_VERTEX_BYTES;

/// A batch of pieces as messages of about [`CHUNK_BYTES`], made one at a time. A piece is never split.
pub(crate) fn cells_chunks(batch: &PieceBatch) -> impl Iterator<Item = CellsChunk> + '_ {
    let mut first = 0;
    std::iter::from_fn(move || {
        if first >= batch.len() {
            return None;
        }
        let base = batch.vertices(first).start;
        let mut end = first + 1;
        while end < batch.len() && batch.vertices(end).end - base <= CELLS_VERTICES {
            end += 1;
        }
        let pieces = first..end;
        let vertices = base..batch.vertices(end - 1).end;
        first = end;
        let u32s = |values: &[u32]| -> Bytes { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
        let counts: Vec<u32> = pieces.clone().map(|i| batch.vertices(i).len() as u32).collect();
        let positions = &batch.position[vertices.clone()];
        Some(CellsChunk {
            pieces: pieces.len() as u32,
            vertices: vertices.len() as u32,
            facet: u32s(&batch.facet[pieces.clone()]),
            seed: u32s(&batch.seed[pieces]),
            vertex_count: u32s(&counts),
            positions: positions.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect(),
            weights: batch.weight[vertices.clone()].iter().flat_map(|w| w.to_le_bytes()).collect(),
            opposite: u32s(&batch.opposite[vertices]),
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_cut_at_elements_and_say_where_they_are() {
        let points = vec![DVec3::ONE; 100_000];
        let all: Vec<Chunk> = point_chunks(ArrayKind::Seeds, &points).collect();
        assert_eq!(all.len(), 2_400_000_usize.div_ceil(CHUNK_BYTES / 24 * 24));
        assert!(all.iter().all(|c| c.data.len() % 24 == 0 && c.total_bytes == 2_400_000));
        assert_eq!(all[1].offset as usize, all[0].data.len());
        assert_eq!(all.iter().map(|c| c.data.len()).sum::<usize>(), 2_400_000);
    }

    #[test]
    fn pieces_are_not_split() {
        let mut batch = PieceBatch::default();
        for i in 0..20_000 {
            batch.push(i, 0, (0..5).map(|_| (DVec3::ZERO, 1.0, 7)));
        }
        let all: Vec<CellsChunk> = cells_chunks(&batch).collect();
        assert!(all.len() > 2);
        assert_eq!(all.iter().map(|c| c.pieces).sum::<u32>(), 20_000);
        for chunk in &all {
            assert_eq!(chunk.vertices, 5 * chunk.pieces);
            assert_eq!(chunk.positions.len(), 24 * chunk.vertices as usize);
            assert_eq!(chunk.opposite.len(), 4 * chunk.vertices as usize);
        }
    }
}
