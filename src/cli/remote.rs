//! `--endpoint`: the same work on a server.
//!
//! Purpose: the calls of a client, from connecting to the last message.
//! Invariant: what is received is checked (`wire::arrays`) before it is used. Must not know: the server (`service`).

use std::future::Future;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use tonic::transport::{Channel, Endpoint};

use super::endpoint::ServerUrl;
use super::exit::{BadInput, Unavailable, Usage};
use super::interrupt;
use super::progress::Progress;
use super::rvd::{RvdResult, Sink, Wants};
use crate::config::BackendArg;
use crate::cvt::density::{DensityOptions, DensitySource};
use crate::mesh::TriMesh;
use crate::mesh::attributes::Attributes;
use crate::remesh::{RemeshOptions, Seeds};
use crate::rvd::RvdError;
use crate::token::Stopped;
use crate::wire::arrays::Arrays;
use crate::wire::cells::batch;
use crate::wire::chunks::{facet_chunks, index_chunks, number_chunks, point_chunks};
use crate::wire::counts::MeshCounts;
use crate::wire::proto::remesh_service_client::RemeshServiceClient;
use crate::wire::proto::{self, ArrayKind, Chunk};
use crate::wire::{attributes, options};

/// A remesh to ask for.
pub(crate) struct RemeshJob<'a> {
    /// The surface.
    pub(crate) mesh: &'a TriMesh,
    /// What to do.
    pub(crate) options: &'a RemeshOptions,
    /// Who should do it.
    pub(crate) backend: BackendArg,
}

/// What came back.
pub(crate) struct RemeshDone {
    /// The remesh.
    pub(crate) mesh: TriMesh,
    /// Its edges on creases and boundaries that were kept.
    pub(crate) curve_edges: Vec<[u32; 2]>,
    /// The server's report.
    pub(crate) report: serde_json::Value,
    /// What the remesh carries.
    pub(crate) attributes: Option<Attributes>,
}

/// Has `job` done at `endpoint`.
pub(crate) fn remesh(endpoint: &ServerUrl, job: &RemeshJob<'_>, progress: &Progress) -> Result<RemeshDone> {
    use proto::remesh_request::Message as Ask;
    use proto::remesh_response::Message as Answer;
    let options = job.options;
    let header = options::remesh_header(job.mesh, options, choice(job.backend));
    let announced = header.attributes.clone();
    let mut messages = vec![Ask::Header(header)];
    messages.extend(mesh_chunks(job.mesh).map(Ask::Chunk));
    match &options.density.source {
        DensitySource::Sizes(sizes) => {
            messages.extend(number_chunks(ArrayKind::EdgeLengths, sizes).map(Ask::Chunk));
        }
        DensitySource::Weights(weights) => {
            messages.extend(number_chunks(ArrayKind::Weights, weights).map(Ask::Chunk));
        }
        DensitySource::Uniform | DensitySource::Curvature | DensitySource::FeatureSize => {}
    }
    if let Seeds::Given(seeds) = &options.seeds {
        messages.extend(point_chunks(ArrayKind::Seeds, seeds).map(Ask::Chunk));
    }
    if !options.creases.is_empty() {
        messages.extend(index_chunks(ArrayKind::Creases, options.creases.as_flattened()).map(Ask::Chunk));
    }
    let carried =
        options.attributes.as_ref().map(|attributes| attributes::chunks(attributes, &announced)).unwrap_or_default();
    messages.extend(carried.into_iter().flatten().map(Ask::Chunk));
    messages.push(Ask::Finish(proto::Finish {}));
    let requests = messages.into_iter().map(|m| proto::RemeshRequest { message: Some(m) }).collect::<Vec<_>>();
    block_on(async {
        let mut client = connect(endpoint).await?;
        let mut answers =
            client.remesh(tokio_stream::iter(counted(requests, progress))).await.map_err(refused)?.into_inner();
        let mut arrays = Arrays::default();
        while let Some(answer) = answers.message().await.map_err(refused)? {
            match answer.message {
                Some(Answer::Accepted(accepted)) => waiting(progress, &accepted),
                Some(Answer::Progress(p)) => progress.stage(&p.stage, p.done, p.total),
                Some(Answer::Iteration(it)) => progress.iteration(it.index, it.total, it.energy_ratio),
                Some(Answer::Chunk(chunk)) => {
                    progress.stage("download", 0, 0);
                    arrays.take(&chunk)?;
                }
                Some(Answer::Done(done)) => {
                    let positions = arrays.points(ArrayKind::Positions)?;
                    let facets = arrays.facets(ArrayKind::Facets)?;
                    let mesh = TriMesh::new(positions, facets).context("the server's remesh is broken")?;
                    let curve_edges = arrays.pairs(ArrayKind::Creases);
                    let report = report(&arrays, &done.report_json)?;
                    let attributes = attributes_of(&arrays, &mesh, &done.attributes)?;
                    return Ok(RemeshDone { mesh, curve_edges, report, attributes });
                }
                _ => {}
            }
        }
        bail!("the server ended the stream before it was done")
    })
}

/// A diagram to ask for.
pub(crate) struct RvdJob<'a> {
    /// The surface.
    pub(crate) mesh: &'a TriMesh,
    /// The seeds.
    pub(crate) seeds: Seeds,
    /// What is to come back.
    pub(crate) wants: Wants,
    /// Who should do it.
    pub(crate) backend: BackendArg,
}

/// Has a diagram computed at `endpoint`.
pub(crate) fn rvd(endpoint: &ServerUrl, job: RvdJob<'_>, progress: &Progress, sink: Sink<'_>) -> Result<RvdResult> {
    use proto::compute_rvd_request::Message as Ask;
    use proto::compute_rvd_response::Message as Answer;
    let RvdJob { mesh, seeds, wants, backend } = job;
    let source = options::seed_source(&seeds);
    let points = if let Seeds::Given(points) = seeds { points } else { Vec::new() };
    let mut outputs = Vec::new();
    if wants.cells {
        outputs.push(proto::RvdOutput::Cells.into());
    }
    if wants.centroids {
        outputs.push(proto::RvdOutput::Centroids.into());
    }
    let header = proto::ComputeRvdHeader {
        mesh: Some(options::mesh_header(mesh, &DensityOptions::default())),
        seeds: Some(source),
        backend: choice(backend).into(),
        outputs,
    };
    let mut messages = vec![Ask::Header(header)];
    messages.extend(mesh_chunks(mesh).map(Ask::Chunk));
    messages.extend(point_chunks(ArrayKind::Seeds, &points).map(Ask::Chunk));
    messages.push(Ask::Finish(proto::Finish {}));
    let requests = messages.into_iter().map(|m| proto::ComputeRvdRequest { message: Some(m) }).collect::<Vec<_>>();
    block_on(async {
        let mut client = connect(endpoint).await?;
        let mut answers =
            client.compute_rvd(tokio_stream::iter(counted(requests, progress))).await.map_err(refused)?.into_inner();
        let mut arrays = Arrays::default();
        while let Some(answer) = answers.message().await.map_err(refused)? {
            match answer.message {
                Some(Answer::Accepted(accepted)) => waiting(progress, &accepted),
                Some(Answer::Progress(p)) => progress.stage(&p.stage, p.done, p.total),
                Some(Answer::Cells(chunk)) => sink(&batch(&chunk)?)?,
                Some(Answer::Chunk(chunk)) => arrays.take(&chunk)?,
                Some(Answer::Done(done)) => {
                    let centroids = if wants.centroids { arrays.points(ArrayKind::Centroids)? } else { Vec::new() };
                    let report = report(&arrays, &done.report_json)?;
                    return Ok(RvdResult { centroids, report });
                }
                _ => {}
            }
        }
        bail!("the server ended the stream before it was done")
    })
}

fn block_on<R>(work: impl Future<Output = Result<R>>) -> Result<R> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let signals = interrupt::signals().context("cannot listen for signals")?;
        // Dropping the stream cancels the work at the server.
        tokio::select! {
            result = work => result,
            Ok(()) = signals => Err(RvdError::Stopped(Stopped::Cancelled).into()),
        }
    })
}

/// Messages, whose leaving is told.
fn counted<T: Send + 'static>(messages: Vec<T>, progress: &Progress) -> impl Iterator<Item = T> + Send + 'static {
    let mut sent = progress.counter("upload", messages.len() as u64);
    messages.into_iter().inspect(move |_| sent())
}

/// The job was taken in.
fn waiting(progress: &Progress, accepted: &proto::Accepted) {
    progress.stage("queued", 0, 0);
    if accepted.queue_position > 0 {
        progress.detail(&format!(" behind {}", accepted.queue_position));
    }
}

async fn connect(endpoint: &ServerUrl) -> Result<RemeshServiceClient<Channel>> {
    let channel = Endpoint::from_shared(endpoint.to_string())
        .map_err(|e| Usage(format!("--endpoint {endpoint}: {e}; an example is http://127.0.0.1:50051")))?;
    let channel = channel.connect_timeout(Duration::from_secs(10)).connect().await.map_err(|e| {
        let cause = std::error::Error::source(&e).map(|s| format!(": {s}")).unwrap_or_default();
        Unavailable(format!("cannot reach {endpoint}{cause}; is a server running there?"))
    })?;
    Ok(RemeshServiceClient::new(channel).max_decoding_message_size(16 << 20))
}

/// A refusal, with the server's words.
fn refused(status: tonic::Status) -> anyhow::Error {
    let text = format!("the server says: {}", status.message());
    match status.code() {
        tonic::Code::InvalidArgument => BadInput(text).into(),
        _ => anyhow::Error::new(status).context(text),
    }
}

fn choice(backend: BackendArg) -> proto::BackendChoice {
    match backend {
        BackendArg::Auto => proto::BackendChoice::Auto,
        BackendArg::Gpu => proto::BackendChoice::Gpu,
        BackendArg::Parallel => proto::BackendChoice::Parallel,
        BackendArg::Serial => proto::BackendChoice::Serial,
    }
}

fn mesh_chunks(mesh: &TriMesh) -> impl Iterator<Item = Chunk> + '_ {
    let positions = point_chunks(ArrayKind::Positions, mesh.positions());
    positions.chain(facet_chunks(ArrayKind::Facets, mesh.facets()))
}

/// The report: in the last message, or in chunks if it is long.
fn report(arrays: &Arrays, in_done: &str) -> Result<serde_json::Value> {
    let broken = "the server's report is broken";
    match in_done.is_empty() {
        false => serde_json::from_str(in_done).context(broken),
        true => serde_json::from_slice(arrays.bytes(ArrayKind::Report)?).context(broken),
    }
}

/// What the mesh carries, as the last message announces it.
fn attributes_of(arrays: &Arrays, mesh: &TriMesh, headers: &[proto::AttributeHeader]) -> Result<Option<Attributes>> {
    if headers.is_empty() {
        return Ok(None);
    }
    let broken = "the server's attributes are broken";
    let (vertices, facets) = (mesh.positions().len() as u64, mesh.facets().len() as u64);
    let counts = MeshCounts { vertices, facets, coordinate_bytes: 8, ..MeshCounts::default() };
    let announced = attributes::check(headers, counts).context(broken)?;
    let all = announced.into_iter().zip(0u32..).map(|(counts, place)| arrays.attribute(counts, place));
    let all = all.collect::<Result<Vec<_>, _>>()?;
    Ok(Some(attributes::collect(mesh, all).context(broken)?))
}
