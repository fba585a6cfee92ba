//! What a job of the store will need.
//!
//! Purpose: [`Forecast`] finds the counts of a specification, from what it says and from its blobs, for
//! [`estimate`](super::estimate). Invariant: a blob is looked at once: its counts are remembered. One that is large is not
//! read for this; its size bounds what it can hold. Blobs that are not the tenant's do not exist. Must not know: queues, stores of jobs.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use futures_util::TryStreamExt;
use tokio::sync::Semaphore;

use super::api::{JobApiError, Memory};
use super::bytes::Bytes;
use super::engine::Engine;
use super::estimate::{Counts, Kind, Need, need};
use super::record::{DensityKind, JobSpec, MeshFormat, MeshSource, PlacementRule, RvdOutput, SeedSource, WorkSpec};
use crate::blob::{BlobError, BlobStore, Digest, Owner};
use crate::mesh::io;
use crate::remesh::RemeshOptions;
use crate::rvd::{BackendChoice, BackendKind};

/// Larger blobs are not read for their counts.
const READ_BYTES: u64 = 64 << 20;
/// Blobs that are read at once.
const AT_ONCE: usize = 2;
/// Bytes of a point in a text, at the least.
const TEXT_BYTES: u64 = 6;
/// Blobs whose counts are remembered.
const REMEMBERED: usize = 4096;

/// See the module's head.
pub(crate) struct Forecast {
    blobs: Arc<dyn BlobStore>,
    engine: Engine,
    /// The most seeds that a job may have.
    max_seeds: u64,
    /// Who reads a blob for its counts: they lie in memory meanwhile.
    reading: Semaphore,
    known: Mutex<HashMap<(Digest, MeshFormat), (u64, u64)>>,
}

impl Forecast {
    pub(crate) fn new(blobs: Arc<dyn BlobStore>, engine: Engine, max_seeds: u64) -> Self {
        Self { blobs, engine, max_seeds, reading: Semaphore::new(AT_ONCE), known: Mutex::default() }
    }

    /// What a job with these counts needs here.
    pub(crate) fn need(&self, counts: &Counts) -> Need {
        let threads = self.engine.backend(BackendChoice::Auto).map_or(1, |by| by.threads);
        need(counts, threads)
    }

    /// What jobs here may need.
    pub(crate) fn limits(&self) -> Bytes {
        self.engine.memory()
    }

    /// The counts of a job; `given` are the surface's vertices and facets, if they are known.
    ///
    /// # Errors
    /// `Blob`; `Input` if a blob holds no surface.
    pub(crate) async fn counts(&self, spec: &JobSpec, given: Option<(u64, u64)>) -> Result<Counts, JobApiError> {
        let owner = Owner::of(&spec.tenant);
        // What a caller says of its file may be any number.
        let bytes = |(vertices, facets): (u64, u64), each: (u64, u64)| {
            vertices.saturating_mul(each.0).saturating_add(facets.saturating_mul(each.1))
        };
        let ((vertices, facets), input_bytes) = match (&spec.mesh, given) {
            (MeshSource::Arrays { positions, facets, .. }, _) => {
                let counts = (positions.count, facets.count);
                (counts, bytes(counts, (24, 12)))
            }
            (MeshSource::File { .. }, Some(given)) => (given, bytes(given, (12, 13))),
            (MeshSource::File { blob, format, .. }, None) => self.of_file(owner, *blob, *format).await?,
        };
        let kind = match &spec.work {
            WorkSpec::Remesh(_) => Kind::Remesh,
            WorkSpec::Rvd(_) => Kind::Rvd,
            WorkSpec::Cvt(_) => Kind::Cvt,
        };
        let backend = self.engine.backend(spec.choice()).map_or(BackendKind::Parallel, |by| by.kind);
        let mut counts = Counts { input_bytes, ..Counts::new(kind, backend, vertices, facets, 0) };
        match &spec.work {
            WorkSpec::Remesh(work) => {
                let usual = RemeshOptions::usual();
                let steps = |given: Option<u32>, usual: usize| given.map_or(usual as u64, u64::from);
                counts.steps = steps(work.lloyd_steps, usual.lloyd) + steps(work.newton_steps, usual.newton);
                counts.density = work.density.kind();
                counts.placement = work.placement.unwrap_or(PlacementRule::Fitted);
                counts.refines = work.refinement.is_some();
                let first = self.points(owner, &work.seeds, facets).await;
                counts.points = match work.refinement {
                    Some(refinement) => refinement.max_points.unwrap_or(first.saturating_mul(2)).max(first),
                    None => first,
                };
            }
            WorkSpec::Rvd(work) => {
                counts.points = self.points(owner, &work.seeds, facets).await;
                counts.steps = 0;
                counts.cells = work.outputs.is_empty() || work.outputs.contains(&RvdOutput::Cells);
                counts.density = if work.weights.is_some() { DensityKind::Weights } else { DensityKind::Uniform };
            }
            WorkSpec::Cvt(work) => {
                counts.points = work.max_seeds.unwrap_or(0).max(self.points(owner, &work.seeds, facets).await);
                counts.steps = work.commands.iter().map(super::perform::steps_of).sum();
                counts.density = work.density.kind();
            }
        }
        Ok(counts)
    }

    /// How many seeds there are at first. Of those that a density implies nothing is known here but that there are seldom
    /// more than half as many as facets.
    async fn points(&self, owner: Owner, seeds: &SeedSource, facets: u64) -> u64 {
        match seeds {
            SeedSource::Sampled { points: Some(points), .. } => *points,
            SeedSource::Sampled { points: None, .. } => (facets / 2).clamp(1, self.max_seeds),
            SeedSource::Given(array) if array.count > 0 => array.count,
            SeedSource::Given(array) => {
                let text = self.size_of(owner, array.blob).await;
                text.map_or(1, |size_bytes| (size_bytes / TEXT_BYTES).clamp(1, self.max_seeds))
            }
        }
    }

    /// The size of a tenant's blob. What others have tells it nothing.
    async fn size_of(&self, owner: Owner, blob: Digest) -> Result<u64, BlobError> {
        match self.blobs.is_owned(owner, blob).await? {
            true => Ok(self.blobs.stat(blob).await?.size_bytes),
            false => Err(BlobError::NotFound { digest: blob }),
        }
    }

    /// Vertices, facets and bytes of a surface's file.
    async fn of_file(&self, owner: Owner, blob: Digest, format: MeshFormat) -> Result<((u64, u64), u64), JobApiError> {
        let size_bytes = self.size_of(owner, blob).await?;
        let known = |forecast: &Self| {
            forecast.known.lock().unwrap_or_else(PoisonError::into_inner).get(&(blob, format)).copied()
        };
        if let Some(counts) = known(self) {
            return Ok((counts, size_bytes));
        }
        let counts = if size_bytes > READ_BYTES {
            most(format, size_bytes)
        } else {
            let _turn = self.reading.acquire().await;
            let mut bytes = self.blobs.read(blob, 0..u64::MAX).await?.bytes;
            let mut all = Vec::with_capacity(usize::try_from(size_bytes).unwrap_or(0));
            while let Some(piece) = bytes.try_next().await? {
                all.extend_from_slice(&piece);
            }
            let counted = tokio::task::spawn_blocking(move || io::counts(format.into(), &all)).await.ok().flatten();
            counted.ok_or_else(|| JobApiError::Input {
                field: "mesh.file".to_owned(),
                problem: "the blob is no surface in this format; see that the format is right".to_owned(),
            })?
        };
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if known.len() >= REMEMBERED {
            known.clear();
        }
        known.insert((blob, format), counts);
        Ok((counts, size_bytes))
    }
}

/// Whether a job with this need could ever run where jobs may have `limits`.
///
/// # Errors
/// `TooLarge`.
pub(crate) fn must_fit(need: &Need, limits: Bytes) -> Result<(), JobApiError> {
    let both = [(Memory::Host, need.memory.host, limits.host), (Memory::Device, need.memory.device, limits.device)];
    match both.into_iter().find(|(_, needed, limit)| needed > limit) {
        Some((of, needed_bytes, limit_bytes)) => Err(JobApiError::TooLarge { of, needed_bytes, limit_bytes }),
        None => Ok(()),
    }
}

/// The most vertices and facets that a file of so many bytes is likely to hold: the shortest that writers make.
fn most(format: MeshFormat, bytes: u64) -> (u64, u64) {
    let facets = match format {
        // Half a vertex of three floats, and a face of a byte and three indices.
        MeshFormat::Ply => bytes / 19,
        MeshFormat::Stl => bytes / 50,
        // Half a vertex of three short numbers, and a face of three indices.
        MeshFormat::Obj | MeshFormat::Off => bytes / 30,
    };
    (facets / 2, facets)
}
