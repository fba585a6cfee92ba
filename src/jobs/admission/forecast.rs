//! What a job of the store will need.
//!
//! Purpose: [`Forecast`] finds the counts of a specification, from what it says and from its blobs, for
//! [`estimate`](super::estimate). Invariant: a blob is looked at once: its counts are remembered. One that is large is not
//! kept in memory for this; its size bounds what it can hold, that of what is packed in it if it is packed. Blobs that are not
//! the tenant's do not exist. Must not know: queues, stores of jobs.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures_util::TryStreamExt;

use super::{JobApiError, Memory};
use crate::admission::estimate::{Counts, Need, need};
use crate::blob::{BlobError, BlobStore, Digest, Owner};
use crate::engine::Engine;
use crate::lock;
use crate::places::Places;
use crate::record::{ArrayRef, Arrays, AttributeRef, Bytes, MeshSource, Operation, Spec, sets, steps};
use geometry::cvt::density::{Count, Expected};
use geometry::mesh::io::{self, DataError, Format};
use geometry::remesh::Seeds;
use geometry::rvd::{BackendChoice, BackendKind};
use geometry::token::Token;
use wire::proto::ArrayForm;

/// Larger blobs are not read for their counts, nor such in which more is packed.
const READ_BYTES: u64 = 64 << 20;
/// Bytes that reading a surface makes of each of its file, at most.
const MADE: u64 = 8;
/// Blobs that are read at once, one of a tenant.
const AT_ONCE: usize = 2;
/// Blobs whose counts are remembered.
const REMEMBERED: usize = 4096;

#[derive(Clone, Copy, Debug)]
struct File {
    counts: (u64, u64),
    /// What reading holds of it: its bytes, and what is packed in them.
    bytes: u64,
}

pub struct Forecast {
    blobs: Arc<dyn BlobStore>,
    engine: Engine,
    max_seeds: u64,
    /// Blobs that are read for their counts: they lie in memory meanwhile.
    reading: Places,
    known: Mutex<HashMap<(Digest, Format), File>>,
}

impl Forecast {
    /// Predicts with what `engine` may use; `max_seeds` bounds a job.
    pub fn new(blobs: Arc<dyn BlobStore>, engine: Engine, max_seeds: u64) -> Self {
        Self { blobs, engine, max_seeds, reading: Places::new(AT_ONCE), known: Mutex::default() }
    }

    pub fn need(&self, counts: &Counts) -> Need {
        let threads = self.engine.backend(BackendChoice::Auto).map_or(1, |by| by.threads);
        need(counts, threads)
    }

    /// The counts of a job; `given` are the surface's vertices and facets, if they are known. Errors: `Blob`; `Input` if a
    /// blob holds no surface; `TooLarge` and `Packed` if more is packed in it than may be.
    pub async fn counts(&self, spec: &Spec, given: Option<(u64, u64)>) -> Result<Counts, JobApiError> {
        self.counts_of(spec, given, None).await
    }

    /// The counts of a job whose surface has been looked at.
    pub(crate) async fn counts_with(&self, spec: &Spec, expected: &Expected) -> Result<Counts, JobApiError> {
        Ok(self.counts_of(spec, None, Some(expected.points as u64)).await?.of_surface(expected))
    }

    /// As [`Self::counts`], with a look at the surface itself if its file is not large: counts alone do not tell of needles,
    /// fans and soups, nor of points that a length implies.
    pub async fn counts_by_surface(&self, spec: &Spec, given: Option<(u64, u64)>) -> Result<Counts, JobApiError> {
        let counts = self.counts_of(spec, given, None).await?;
        let task = spec.task();
        let (MeshSource::File { blob, format, .. }, None, None) =
            (&task.mesh, given, task.arrays.edge_lengths.or(task.arrays.metric))
        else {
            return Ok(counts);
        };
        let (owner, format) = (Owner::of(&spec.tenant), *format);
        let size_bytes = self.size_of(owner, *blob).await?;
        // What is packed in it counts too.
        if counts.input_bytes.saturating_mul(MADE) > self.engine.memory().host.min(MADE * READ_BYTES) {
            return Ok(counts);
        }
        let (density, seeds) = match &task.operation {
            Operation::Remesh(options) => (options.density.clone(), options.seeds.clone()),
            Operation::Rvd(diagram) => (diagram.density.clone(), diagram.seeds.clone()),
            Operation::Cvt(session, _) => (session.density.clone(), session.seeds.clone()),
        };
        let _place = self.reading.wait(&owner.to_string()).await;
        let _mark = self.engine.mark();
        let bytes = self.whole(*blob, size_bytes).await?;
        let look = move || {
            let mesh = io::decode(format, &bytes).ok()?;
            let mut seeds = seeds;
            seeds.resolve(&mesh);
            Expected::of(&mesh, &density, seeds.count(), &Token::default()).ok()
        };
        // A surface that is of no use is told when the job reads it.
        match tokio::task::spawn_blocking(look).await.ok().flatten() {
            Some(expected) if task.arrays.seeds.is_none() => self.counts_with(spec, &expected).await,
            Some(expected) => Ok(counts.of_surface(&expected)),
            None => Ok(counts),
        }
    }

    async fn whole(&self, blob: Digest, size_bytes: u64) -> Result<Vec<u8>, BlobError> {
        let mut pieces = self.blobs.read(blob, 0..u64::MAX).await?.bytes;
        let mut all = Vec::with_capacity(usize::try_from(size_bytes).unwrap_or(0));
        while let Some(piece) = pieces.try_next().await? {
            all.extend_from_slice(&piece);
        }
        Ok(all)
    }

    async fn counts_of(
        &self,
        spec: &Spec,
        given: Option<(u64, u64)>,
        points: Option<u64>,
    ) -> Result<Counts, JobApiError> {
        let (owner, task) = (Owner::of(&spec.tenant), spec.task());
        // What a caller says of its file may be any number.
        let bytes = |(vertices, facets): (u64, u64), each: (u64, u64)| {
            vertices.saturating_mul(each.0).saturating_add(facets.saturating_mul(each.1))
        };
        let ((vertices, facets), input_bytes) = match (&task.mesh, given) {
            (MeshSource::Arrays { positions, facets, .. }, _) => {
                let counts = (positions.count, facets.count);
                (counts, bytes(counts, (24, 12)))
            }
            (MeshSource::File { .. }, Some(given)) => (given, bytes(given, (12, 13))),
            (MeshSource::File { blob, format, .. }, None) => self.of_file(owner, *blob, *format).await?,
        };
        // Another server may have the backend that this one lacks.
        let elsewhere = match task.backend {
            BackendChoice::Only(kind) => kind,
            BackendChoice::Auto => BackendKind::Parallel,
        };
        let backend = self.engine.backend(task.backend).map_or(elsewhere, |by| by.kind);
        let points = match (points, task.operation.seeds()) {
            (Some(points), _) => points,
            // By the vertices, of which as many may be there as corners.
            (None, Seeds::Share { of, .. }) => {
                let vertices = usize::try_from(vertices).unwrap_or(usize::MAX);
                (of.of_vertices(vertices) as u64).min(self.max_seeds)
            }
            (None, seeds) => self.points(owner, seeds.count(), task.arrays.seeds, facets).await,
        };
        let counts = Counts::new(task.operation.kind(), backend, vertices, facets, points);
        let attributes = match &task.mesh {
            MeshSource::Arrays { attributes, .. } => attributes.iter().map(numbers_of).fold(0, u64::saturating_add),
            // What is beside the surface, in single precision or as text.
            MeshSource::File { attributes: true, .. } => {
                input_bytes.saturating_sub(bytes((vertices, facets), (12, 12))) / 4
            }
            MeshSource::File { .. } => 0,
        };
        let list_bytes = self.list_bytes(owner, task.arrays, &counts).await;
        let counts = Counts { input_bytes, attributes, list_bytes, ..counts };
        Ok(match &task.operation {
            Operation::Remesh(options) => counts.of_remesh(options),
            Operation::Rvd(diagram) => Counts { cells: diagram.outputs.cells, ..counts.of_diagram(diagram) },
            Operation::Cvt(session, commands) => {
                Counts { steps: steps(commands), sets: sets(commands), ..counts.of_session(session) }
            }
        })
    }

    /// How many seeds there are at first. Of those that a density implies nothing is known here but that there are seldom
    /// more than half as many as facets.
    async fn points(&self, owner: Owner, count: Count, given: Option<ArrayRef>, facets: u64) -> u64 {
        match (given, count) {
            (Some(array), _) if array.count > 0 => array.count,
            (Some(array), _) => {
                self.lines_of(owner, array.blob).await.map_or(1, |lines| lines.clamp(1, self.max_seeds))
            }
            (None, Count::Points(points)) => points as u64,
            (None, Count::Implied) => (facets / 2).clamp(1, self.max_seeds),
        }
    }

    /// Bytes of the lists beside a surface: their text, and the numbers that are made of it.
    async fn list_bytes(&self, owner: Owner, arrays: Arrays, surface: &Counts) -> u64 {
        let Arrays { seeds, edge_lengths, weights, metric, creases } = arrays;
        // How many numbers there are, at most.
        let (lengths, edges) = (surface.vertices, surface.facets.saturating_mul(3));
        let mut bytes = 0u64;
        for (array, most, least, each) in [
            (edge_lengths, lengths, 2, LENGTH_BYTES),
            (weights, lengths, 2, LENGTH_BYTES),
            (metric, lengths, 12, METRIC_BYTES),
            (creases, edges, 4, EDGE_BYTES),
            (seeds, 0, 6, LENGTH_BYTES),
        ] {
            let Some(array) = array else { continue };
            // As it comes. Text is as long as its blob, and has two bytes for a length and four for an edge.
            let size_bytes = self.size_of(owner, array.blob).await.unwrap_or(0);
            let count = if array.form == ArrayForm::Text { most.min(size_bytes / least) } else { array.count };
            bytes = bytes.saturating_add(size_bytes).saturating_add(count.saturating_mul(each));
        }
        bytes
    }

    /// The lines of a tenant's blob, which is not held.
    async fn lines_of(&self, owner: Owner, blob: Digest) -> Result<u64, BlobError> {
        self.size_of(owner, blob).await?;
        let mut pieces = self.blobs.read(blob, 0..u64::MAX).await?.bytes;
        let mut lines = 1;
        while let Some(piece) = pieces.try_next().await? {
            lines += piece.iter().filter(|&&byte| byte == b'\n').count() as u64;
        }
        Ok(lines)
    }

    /// The size of a tenant's blob. What others have tells it nothing.
    async fn size_of(&self, owner: Owner, blob: Digest) -> Result<u64, BlobError> {
        match self.blobs.is_owned(owner, blob).await? {
            true => Ok(self.blobs.stat(blob).await?.size_bytes),
            false => Err(BlobError::NotFound { digest: blob }),
        }
    }

    async fn of_file(&self, owner: Owner, blob: Digest, format: Format) -> Result<((u64, u64), u64), JobApiError> {
        let size_bytes = self.size_of(owner, blob).await?;
        let known = lock(&self.known).get(&(blob, format)).copied();
        if let Some(File { counts, bytes }) = known {
            return Ok((counts, bytes));
        }
        let _place = self.reading.wait(&owner.to_string()).await;
        let _mark = self.engine.mark();
        let file = self.look_at(blob, format, size_bytes).await?;
        let mut known = lock(&self.known);
        if known.len() >= REMEMBERED {
            known.clear();
        }
        known.insert((blob, format), file);
        Ok((file.counts, file.bytes))
    }

    async fn look_at(&self, blob: Digest, format: Format, size_bytes: u64) -> Result<File, JobApiError> {
        let limits = self.engine.memory();
        let most_bytes = io::unpacked_limit(usize::try_from(size_bytes).unwrap_or(usize::MAX));
        // What is longer than all memory for jobs is not unpacked to its end.
        let limit = most_bytes.min(usize::try_from(limits.host).unwrap_or(usize::MAX));
        let refused = move |error: DataError| match error {
            DataError::TooLong { limit } if limit < most_bytes => {
                let needed_bytes = size_bytes.saturating_add(limit as u64);
                JobApiError::TooLarge { of: Memory::Host, needed_bytes, limit_bytes: limits.host }
            }
            DataError::TooLong { limit } => JobApiError::Packed { limit_bytes: limit as u64 },
            error => JobApiError::Input {
                field: "spec.mesh.file".to_owned(),
                problem: format!("the blob cannot be read: {error}"),
            },
        };
        if size_bytes <= READ_BYTES {
            let all = self.whole(blob, size_bytes).await?;
            let counted = tokio::task::spawn_blocking(move || look_at(format, &all, limit)).await;
            return counted.unwrap_or(Ok(None)).map_err(refused)?.ok_or_else(no_surface);
        }
        let mut pieces = self.blobs.read(blob, 0..MAGIC_BYTES).await?.bytes;
        let mut all = Vec::new();
        while let Some(piece) = pieces.try_next().await? {
            all.extend_from_slice(&piece);
        }
        if !io::are_packed(&all) {
            return Ok(File { counts: most(format, size_bytes), bytes: size_bytes });
        }
        let mut pieces = self.blobs.read(blob, 0..u64::MAX).await?.bytes;
        let mut measure = io::Measure::new(limit);
        while let Some(piece) = pieces.try_next().await? {
            let added = tokio::task::spawn_blocking(move || measure.add(&piece).map(|()| measure)).await;
            measure = added.map_err(|_| no_surface())?.map_err(refused)?;
        }
        let unpacked = measure.finish().map_err(refused)? as u64;
        Ok(File { counts: most(format, unpacked), bytes: size_bytes.saturating_add(unpacked) })
    }
}

/// Bytes of an edge length: twice eight, while they are brought into another order, and as much in the density.
const LENGTH_BYTES: u64 = 32;
/// Bytes of a metric tensor: six numbers, as of an edge length, and their logarithms.
const METRIC_BYTES: u64 = 240;
/// Bytes of a crease: its two ends, while the list grows, and what finds it among the edges of the surface.
const EDGE_BYTES: u64 = 64;

fn numbers_of(AttributeRef { counts, values, corners }: &AttributeRef) -> u64 {
    let corners = corners.map_or(0, |corners| corners.count.saturating_mul(3));
    values.count.saturating_mul(counts.numbers).saturating_add(corners)
}

/// The first bytes of a blob, which say whether it is packed.
const MAGIC_BYTES: u64 = 3;

fn no_surface() -> JobApiError {
    JobApiError::Input {
        field: "spec.mesh.file".to_owned(),
        problem: "the blob is no surface in this format; see that the format is right".to_owned(),
    }
}

/// What is known of these bytes, of which no more than `limit` may be unpacked; `None` if they are no surface.
fn look_at(format: Format, bytes: &[u8], limit: usize) -> Result<Option<File>, DataError> {
    let size_bytes = bytes.len() as u64;
    let room = READ_BYTES as usize;
    let (plain, unpacked) = match io::unpack(bytes, limit.min(room)) {
        Ok(plain) => {
            let unpacked = if io::are_packed(bytes) { plain.len() as u64 } else { 0 };
            (Some(plain), unpacked)
        }
        Err(DataError::TooLong { .. }) if limit > room => {
            let mut measure = io::Measure::new(limit);
            measure.add(bytes)?;
            (None, measure.finish()? as u64)
        }
        Err(error) => return Err(error),
    };
    let bytes = size_bytes.saturating_add(unpacked);
    let Some(plain) = plain else { return Ok(Some(File { counts: most(format, unpacked), bytes })) };
    let counts = io::counts_of_plain(format, &plain);
    if counts.is_none() {
        // What is wrong with it, in the reader's words.
        io::decode(format, &plain)?;
    }
    Ok(counts.map(|counts| File {
        counts: (counts.vertices, counts.facets),
        bytes: bytes.saturating_add(counts.made_bytes),
    }))
}

/// Whether a job with this need could ever run where jobs may have `limits`. Errors: `TooLarge`.
pub fn must_fit(need: &Need, limits: Bytes) -> Result<(), JobApiError> {
    let both = [(Memory::Host, need.memory.host, limits.host), (Memory::Device, need.memory.device, limits.device)];
    match both.into_iter().find(|(_, needed, limit)| needed > limit) {
        Some((of, needed_bytes, limit_bytes)) => Err(JobApiError::TooLarge { of, needed_bytes, limit_bytes }),
        None => Ok(()),
    }
}

/// Predicted time of a job that is not begun, in limits on its time: predictions are within a factor of three.
const FAR_BEYOND: f64 = 5.0;

/// Whether a job with this need would be at work far beyond its limit. Errors: `TooLong`.
pub fn must_end(need: &Need, limit: Option<Duration>) -> Result<(), JobApiError> {
    match limit.filter(|limit| need.seconds > FAR_BEYOND * limit.as_secs_f64()) {
        Some(limit) => Err(JobApiError::TooLong { seconds: need.seconds.round(), limit_seconds: limit.as_secs_f64() }),
        None => Ok(()),
    }
}

/// The most vertices and facets that a file of `bytes` bytes is likely to hold: the shortest that writers make.
fn most(format: Format, bytes: u64) -> (u64, u64) {
    let facets = bytes / format.facet_bytes();
    (facets / 2, facets)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::blob::put_of;
    use geometry::mesh::shapes::Shape;
    use wire::proto::{self, JobArrays, JobSpec, MeshFile, RemeshOptions, job_mesh, job_spec};

    fn gzip(bytes: Vec<u8>) -> Vec<u8> {
        io::pack_for(Path::new("a.gz"), bytes).unwrap()
    }

    #[test]
    fn what_is_packed_counts_too() {
        let mesh = Shape::Torus.build(2000);
        for format in Format::ALL {
            let bytes = io::encode(format, &mesh).unwrap();
            let plain = look_at(format, &bytes, usize::MAX).unwrap().unwrap();
            let packed = gzip(bytes.clone());
            let file = look_at(format, &packed, usize::MAX).unwrap().unwrap();
            assert_eq!((file.counts, file.bytes), (plain.counts, plain.bytes + packed.len() as u64), "{format:?}");
            let refused = look_at(format, &packed, bytes.len() - 1).unwrap_err();
            assert_eq!(refused, DataError::TooLong { limit: bytes.len() - 1 });
            assert!(look_at(format, &packed[..packed.len() - 9], usize::MAX).is_err());
            // What is packed twice is no file.
            assert!(matches!(look_at(format, &gzip(packed), usize::MAX), Ok(None)));
        }
    }

    /// Whatever the bytes are, they are counted or refused; what can be read has no more than was counted.
    #[test]
    fn changed_files_are_counted_or_refused() {
        let mesh = Shape::Torus.build(24);
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for format in Format::ALL {
            let plain = io::encode(format, &mesh).unwrap();
            for original in [gzip(plain.clone()), plain] {
                for _ in 0..300 {
                    let mut bytes = original.clone();
                    let (at, value) = (rng.random_range(0..bytes.len()), rng.random());
                    match rng.random_range(0..4) {
                        0 => bytes[at] = value,
                        1 => bytes[at] = b"0123456789 -e"[usize::from(value) % 13],
                        2 => bytes.truncate(at),
                        _ => bytes.extend_from_within(at..),
                    }
                    let limit = 20 * original.len();
                    let file = look_at(format, &bytes, limit);
                    let Ok(mesh) = io::decode(format, &bytes) else { continue };
                    let (vertices, facets) = file.unwrap().unwrap().counts;
                    assert!(vertices >= mesh.positions().len() as u64 && facets >= mesh.facets().len() as u64);
                }
            }
        }
    }

    fn engine() -> (Engine, std::thread::JoinHandle<()>) {
        let backends = || {
            let parallel = Arc::new(geometry::rvd::parallel::Parallel::new(Some(1))?);
            let serial = Arc::new(geometry::rvd::serial::Serial);
            let gpu = Err("none".into());
            Ok(crate::Backends { gpu, parallel, serial, default: BackendChoice::Auto, pools: None })
        };
        Engine::start(backends, crate::EngineOptions::default()).unwrap()
    }

    /// A remesh of a file.
    fn spec(blob: Digest, format: Format, arrays: JobArrays, tenant: &str) -> Spec {
        let file = MeshFile { digest: blob.to_string(), format: format.number(), attributes: None };
        // With lengths, only their ratios count.
        let points = Some(100);
        let message = JobSpec {
            mesh: Some(proto::JobMesh { source: Some(job_mesh::Source::File(file)) }),
            work: Some(job_spec::Work::Remesh(RemeshOptions { points, ..RemeshOptions::default() })),
            arrays: Some(arrays),
            ..JobSpec::default()
        };
        Spec::new(message, tenant.to_owned(), String::new()).unwrap()
    }

    /// A tenant whose files are counted leaves a place for another one's.
    #[tokio::test(flavor = "multi_thread")]
    async fn files_of_one_tenant_are_counted_beside_those_of_others() {
        let (engine, thread) = engine();
        let blobs = crate::Stores::ephemeral(crate::blob::BlobOptions::default()).blobs;
        let forecast = Arc::new(Forecast::new(Arc::clone(&blobs), engine.clone(), 1_000_000));
        let put = async |tenant: &str, bytes: Vec<u8>| {
            let blob = put_of(&*blobs, tenant, None, bytes.into()).await.unwrap().digest;
            spec(blob, Format::Obj, JobArrays::default(), tenant)
        };
        let count = |spec: Spec| {
            let forecast = Arc::clone(&forecast);
            tokio::spawn(async move { forecast.counts(&spec, None).await.unwrap() })
        };
        let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
        let small = put("other", triangle.into()).await;
        let mut large = Vec::new();
        for number in 0..8 {
            large.push(put("greedy", format!("# {number}\n{}", triangle.repeat(1 << 19)).into_bytes()).await);
        }
        let greedy: Vec<_> = large.into_iter().map(count).collect();
        assert_eq!(count(small).await.unwrap().facets, 1);
        assert!(greedy.iter().any(|counted| !counted.is_finished()), "the other one waited for all of them");
        for counted in greedy {
            assert_eq!(counted.await.unwrap().facets, 1 << 19);
        }
        engine.close();
        tokio::task::spawn_blocking(move || thread.join()).await.unwrap().unwrap();
    }

    /// An estimate knows of needles, unless their file is large or unpacks to more than is looked at.
    #[tokio::test(flavor = "multi_thread")]
    async fn estimates_look_at_the_surface() {
        let (engine, thread) = engine();
        let blobs = crate::Stores::ephemeral(crate::blob::BlobOptions::default()).blobs;
        let forecast = Forecast::new(Arc::clone(&blobs), engine.clone(), 1_000_000);
        let mut fan = String::from("v 0 0 1\n");
        for k in 0..3000 {
            let angle = f64::from(k) * 0.002;
            fan.push_str(&format!("v {} {} 0\n", angle.cos(), angle.sin()));
        }
        (2..3001).for_each(|k| fan.push_str(&format!("f 1 {k} {}\n", k + 1)));
        // Longer than is looked at, and not packed so small that it is refused.
        let mut long = fan.clone();
        (0..READ_BYTES / 20).for_each(|k| long.push_str(&format!("# {k:020}\n")));
        for (bytes, is_looked_at) in [(fan.into_bytes(), true), (gzip(long.into_bytes()), false)] {
            let blob = put_of(&*blobs, "t", None, bytes.into()).await.unwrap().digest;
            let spec = spec(blob, Format::Obj, JobArrays::default(), "t");
            let counts = forecast.counts_by_surface(&spec, None).await.unwrap();
            assert_eq!(counts.extra_pairs > 0, is_looked_at);
        }
        engine.close();
        tokio::task::spawn_blocking(move || thread.join()).await.unwrap().unwrap();
    }

    /// Lists beside a surface are predicted: as long as their text, and as many numbers as the surface has places for.
    #[tokio::test(flavor = "multi_thread")]
    async fn lists_are_predicted() {
        let (engine, thread) = engine();
        let blobs = crate::Stores::ephemeral(crate::blob::BlobOptions::default()).blobs;
        let put = async |bytes: Vec<u8>| put_of(&*blobs, "t", None, bytes.into()).await.unwrap().digest;
        let mesh = Shape::Torus.build(2000);
        let blob = put(io::encode(io::Format::Ply, &mesh).unwrap()).await;
        let text = put(b"0 1\n".repeat(1 << 18)).await;
        let forecast = Forecast::new(Arc::clone(&blobs), engine.clone(), 1_000_000);
        let need_of = async |arrays: JobArrays| {
            let spec = spec(blob, Format::Ply, arrays, "t");
            forecast.need(&forecast.counts(&spec, None).await.unwrap()).memory.host
        };
        let without = need_of(JobArrays::default()).await;
        let array =
            |form: ArrayForm, count| Some(proto::ArrayRef { digest: text.to_string(), form: form.into(), count });
        let list = || array(ArrayForm::Text, 0);
        let (facets, vertices) = (mesh.facets().len() as u64, mesh.positions().len() as u64);
        assert_eq!(
            need_of(JobArrays { creases: list(), ..JobArrays::default() }).await,
            without + (1 << 20) + 3 * facets * EDGE_BYTES
        );
        let sizes = need_of(JobArrays { edge_lengths: list(), ..JobArrays::default() }).await;
        assert_eq!(sizes, without + (1 << 20) + vertices * LENGTH_BYTES);
        assert_eq!(
            need_of(JobArrays { creases: array(ArrayForm::U32, 1 << 17), ..JobArrays::default() }).await,
            without + (1 << 20) + (EDGE_BYTES << 17)
        );
        engine.close();
        tokio::task::spawn_blocking(move || thread.join()).await.unwrap().unwrap();
    }

    /// More than is unpacked here is measured, and none of it kept.
    #[test]
    fn what_is_long_is_measured() {
        let long = usize::try_from(READ_BYTES).unwrap() + 5;
        let packed = gzip(vec![b'\n'; long]);
        let file = look_at(Format::Obj, &packed, usize::MAX).unwrap().unwrap();
        assert_eq!((file.counts, file.bytes), (most(Format::Obj, long as u64), (long + packed.len()) as u64));
        let refused = look_at(Format::Obj, &packed, long - 1).unwrap_err();
        assert_eq!(refused, DataError::TooLong { limit: long - 1 });
    }
}
