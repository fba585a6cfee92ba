//! The client of a server: `--endpoint`, jobs and blobs.
//!
//! Purpose: the calls of a client, from connecting to the last message. Streams of `--endpoint` are here; `jobs` and
//! `blobs` hold the calls of a [`Session`]. Invariant: what is received is checked (`wire::assemble`), then against the
//! request and against itself (`checks`), before it is used. Must not know: the server (`service`).

mod blobs;
mod checks;
mod faults;
mod jobs;
mod link;
mod session;

pub(crate) use blobs::blobs;
use std::future::Future;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result};
use checks::{Expected, Pieces};
pub(crate) use faults::is_lost;
use faults::wrong;
use glam::DVec3;
pub(crate) use link::{Answered, Door, Line, Windows};
use link::{Link, Patience, Sent};
use serde_json::Value;
pub(crate) use session::{Session, health, info, session, watch_health};

use super::interrupt;
use super::progress::Progress;
use super::say::plain;
use super::server::Server;
use geometry::cvt::density::DensitySource;
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::Attributes;
use geometry::remesh::{RemeshOptions, Seeds};
use geometry::rvd::{PieceBatch, RvdError};
use geometry::token::Stopped;
pub(crate) use jobs::{has_ended, is_id, jobs};
pub(crate) use server::config::BackendArg;
use wire::assemble::Arrays;
use wire::cells::batch;
use wire::chunks::{facet_chunks, index_chunks, number_chunks, point_chunks};
use wire::counts::{MeshCounts, mesh_header};
use wire::proto::remesh_service_client::RemeshServiceClient;
use wire::proto::{ArrayKind, Chunk};
use wire::{attributes, proto};

/// What to do, as the server is asked; and the same with the arrays.
pub(crate) type Task = (proto::RemeshOptions, RemeshOptions);

pub(crate) struct RemeshDone {
    pub(crate) mesh: TriMesh,
    /// Its edges on creases and boundaries that were kept.
    pub(crate) curve_edges: Vec<[u32; 2]>,
    pub(crate) report: serde_json::Value,
    pub(crate) attributes: Option<Attributes>,
}

/// Has `mesh` remeshed by `backend` at `server`.
pub(crate) fn remesh(
    server: &Server,
    mesh: &TriMesh,
    (message, options): &Task,
    backend: BackendArg,
    progress: &Progress,
) -> Result<RemeshDone> {
    use proto::remesh_request::Message as Ask;
    use proto::remesh_response::Message as Answer;
    let lengths = if let DensitySource::Sizes(sizes) = &options.density.source { &sizes[..] } else { &[] };
    let metric = if let DensitySource::Metric(metric) = &options.density.source { &metric[..] } else { &[] };
    let numbers: Vec<f64> = metric.iter().flat_map(|tensor| tensor.0).collect();
    let announced = options.attributes.as_ref().map(attributes::headers).unwrap_or_default();
    let described = proto::MeshHeader {
        edge_lengths: lengths.len() as u64,
        metric: metric.len() as u64,
        creases: options.creases.len() as u64,
        attributes: announced.clone(),
        ..mesh_header(mesh)
    };
    let (backend, options_sent) = (choice(backend).into(), Some(message.clone()));
    let header = proto::RemeshHeader { mesh: Some(described), seeds: 0, backend, options: options_sent };
    let mut messages = vec![Ask::Header(header)];
    messages.extend(mesh_chunks(mesh).map(Ask::Chunk));
    messages.extend(number_chunks(ArrayKind::EdgeLengths, lengths).map(Ask::Chunk));
    messages.extend(number_chunks(ArrayKind::Metric, &numbers).map(Ask::Chunk));
    if !options.creases.is_empty() {
        messages.extend(index_chunks(ArrayKind::Creases, options.creases.as_flattened()).map(Ask::Chunk));
    }
    let carried =
        options.attributes.as_ref().map(|attributes| attributes::chunks(attributes, &announced)).unwrap_or_default();
    messages.extend(carried.into_iter().flatten().map(Ask::Chunk));
    messages.push(Ask::Finish(proto::Finish {}));
    let requests = messages.into_iter().map(|m| proto::RemeshRequest { message: Some(m) }).collect::<Vec<_>>();
    let patience = Patience::with(mesh.positions().len() + mesh.facets().len());
    block_on(async {
        progress.stage("connect", 0, 0);
        let link = Link::open(server, patience).await?;
        let mut client = surfaces(link.channel());
        let requests = tokio_stream::iter(counted(requests, progress, link.sent()));
        let mut answers = link.asks(client.remesh(requests)).await?;
        // The facet and the coordinates of each vertex follow what was announced.
        let map = [1, 3].map(|components| proto::AttributeHeader {
            kind: proto::AttributeKind::Scalar.into(),
            components,
            ..Default::default()
        });
        let awaited: Vec<_> = announced.into_iter().chain(map.into_iter().filter(|_| options.source_map)).collect();
        let mut expected = Expected::of_remesh(mesh, options, &awaited);
        let mut arrays = Arrays::default();
        loop {
            match answers.next().await?.message {
                Some(Answer::Accepted(accepted)) => waiting(progress, &accepted),
                Some(Answer::Progress(p)) => progress.stage(&stage(&p.stage), p.done, p.total),
                Some(Answer::Iteration(it)) => progress.iteration(it.index, it.total, it.energy_ratio),
                Some(Answer::Chunk(chunk)) => {
                    progress.stage("download", 0, 0);
                    if let Some(chunk) = expected.check(chunk)? {
                        arrays.take(&chunk).map_err(wrong)?;
                    }
                }
                Some(Answer::Done(done)) => {
                    expected.whole()?;
                    return result(&arrays, &expected, &done);
                }
                _ => {}
            }
        }
    })
}

fn result(arrays: &Arrays, expected: &Expected, done: &proto::RemeshDone) -> Result<RemeshDone> {
    let positions = arrays.points(ArrayKind::Positions).map_err(wrong)?;
    let facets = arrays.facets(ArrayKind::Facets).map_err(wrong)?;
    let mesh = TriMesh::new(positions, facets).map_err(wrong)?;
    let curve_edges = arrays.pairs(ArrayKind::Creases);
    checks::remesh(&mesh, &curve_edges, done)?;
    expected.attributes(&mesh, &done.attributes)?;
    let report = checks::report(report(arrays, &done.report_json).map_err(wrong)?)?;
    let attributes = attributes_of(arrays, &mesh, &done.attributes).map_err(wrong)?;
    Ok(RemeshDone { mesh, curve_edges, report, attributes })
}

/// Has the diagram of a mesh and seeds computed at `server`.
pub(crate) fn rvd(
    (server, backend): (&Server, BackendArg),
    (mesh, seeds): (&TriMesh, Seeds),
    wants: Wants,
    progress: &Progress,
    sink: Sink<'_>,
) -> Result<RvdResult> {
    use proto::compute_rvd_request::Message as Ask;
    use proto::compute_rvd_response::Message as Answer;
    let mut options = proto::DiagramOptions::default();
    let (count, points) = match seeds {
        Seeds::Given(points) => (points.len() as u64, points),
        Seeds::Sample { points, seed } => {
            (options.points, options.seed) = (u32::try_from(points).ok(), Some(seed));
            (points as u64, Vec::new())
        }
        Seeds::Implied { .. } | Seeds::Share { .. } => (0, Vec::new()),
    };
    options.outputs.extend(wants.cells.then_some(i32::from(proto::RvdOutput::Cells)));
    options.outputs.extend(wants.centroids.then_some(i32::from(proto::RvdOutput::Centroids)));
    let header = proto::ComputeRvdHeader {
        mesh: Some(mesh_header(mesh)),
        seeds: points.len() as u64,
        backend: choice(backend).into(),
        options: Some(options),
    };
    let mut messages = vec![Ask::Header(header)];
    messages.extend(mesh_chunks(mesh).map(Ask::Chunk));
    messages.extend(point_chunks(ArrayKind::Seeds, &points).map(Ask::Chunk));
    messages.push(Ask::Finish(proto::Finish {}));
    let requests = messages.into_iter().map(|m| proto::ComputeRvdRequest { message: Some(m) }).collect::<Vec<_>>();
    let patience = Patience::with(mesh.positions().len() + mesh.facets().len() + count as usize);
    block_on(async {
        progress.stage("connect", 0, 0);
        let link = Link::open(server, patience).await?;
        let mut client = surfaces(link.channel());
        let requests = tokio_stream::iter(counted(requests, progress, link.sent()));
        let mut answers = link.asks(client.compute_rvd(requests)).await?;
        let mut expected = Expected::of_rvd(count, wants.centroids);
        let mut pieces = Pieces::of(mesh.facets().len(), count);
        let mut arrays = Arrays::default();
        loop {
            match answers.next().await?.message {
                Some(Answer::Accepted(accepted)) => waiting(progress, &accepted),
                Some(Answer::Progress(p)) => progress.stage(&stage(&p.stage), p.done, p.total),
                Some(Answer::Cells(chunk)) => {
                    Pieces::lengths(&chunk)?;
                    let batch = batch(&chunk).map_err(wrong)?;
                    pieces.check(&batch)?;
                    sink(&batch)?;
                }
                Some(Answer::Chunk(chunk)) => {
                    if let Some(chunk) = expected.check(chunk)? {
                        arrays.take(&chunk).map_err(wrong)?;
                    }
                }
                Some(Answer::Done(done)) => {
                    expected.whole()?;
                    let mut centroids = Vec::new();
                    if wants.centroids {
                        centroids = arrays.points(ArrayKind::Centroids).map_err(wrong)?;
                        checks::centroids(&centroids, count)?;
                    }
                    let report = checks::report(report(&arrays, &done.report_json).map_err(wrong)?)?;
                    return Ok(RvdResult { centroids, report });
                }
                _ => {}
            }
        }
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

fn counted<T: Send + 'static>(all: Vec<T>, bar: &Progress, sent: Sent) -> impl Iterator<Item = T> + Send + 'static {
    let mut told = bar.counter("upload", all.len() as u64);
    all.into_iter().inspect(move |_| {
        sent.fetch_add(1, Ordering::Relaxed);
        told();
    })
}

fn stage(name: &str) -> String {
    plain(name).chars().take(32).collect()
}

fn waiting(progress: &Progress, accepted: &proto::Accepted) {
    progress.stage("queued", 0, 0);
    if accepted.queue_position > 0 {
        progress.detail(&format!(" behind {}", accepted.queue_position));
    }
}

pub(crate) fn surfaces(door: Door) -> RemeshServiceClient<Door> {
    RemeshServiceClient::new(door).max_decoding_message_size(16 << 20)
}

pub(crate) fn choice(backend: BackendArg) -> proto::BackendChoice {
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

/// Takes each batch of pieces as it comes, caller's coordinates.
pub(crate) type Sink<'a> = &'a mut dyn FnMut(&PieceBatch) -> Result<()>;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Wants {
    pub(crate) cells: bool,
    pub(crate) centroids: bool,
}

/// What came out, wherever it was computed.
pub(crate) struct RvdResult {
    /// One a seed; empty if not wanted.
    pub(crate) centroids: Vec<DVec3>,
    pub(crate) report: Value,
}
