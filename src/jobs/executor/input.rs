//! The input of a job, from its blobs.
//!
//! Purpose: [`Reader`] reads the blobs that a task names and makes what the engine takes.
//! Invariant: what blobs hold is checked against what the task says of them, and against the server's bounds,
//! before it is used. Bytes of a blob are let go of once they are read. Must not know: queues, stores of jobs.

use futures_util::TryStreamExt;
use glam::DVec3;

use super::Inner;
use super::storage::StorageError;
use crate::JobError;
use crate::blob::{BlobError, Digest};
use crate::executor::prepared::Input;
use crate::record::{ArrayRef, AttributeRef, Failure, FailureKind, MeshSource, Task};
use geometry::cvt::density::Count;
use geometry::mesh::attributes::{AttributeError, Attributes};
use geometry::mesh::io::lists::{FileVertices, most_edges, points};
use geometry::mesh::io::{self, DataError, Loaded};
use geometry::mesh::numbers::Order;
use geometry::mesh::parts::Part;
use geometry::mesh::tensor::Tensor;
use geometry::mesh::{MeshError, TriMesh};
use geometry::remesh::{RemeshOptions, Seeds};
use geometry::token::Token;
use wire::WireError;
use wire::assemble::tensors;
use wire::attributes::{self, UploadedAttribute};
use wire::counts::Bounds;
use wire::options::{ByVertex, Start, fill};
use wire::proto::ArrayForm;

#[derive(Debug)]
pub(crate) enum WorkError {
    Failure(Failure),
    /// It was stopped, or the engine failed.
    Job(JobError),
}

impl<E: Into<JobError>> From<E> for WorkError {
    fn from(error: E) -> Self {
        Self::Job(error.into())
    }
}

pub(crate) fn failure(kind: FailureKind, message: impl Into<String>) -> WorkError {
    WorkError::Failure(Failure { kind, message: message.into() })
}

fn bad(field: &str, problem: impl std::fmt::Display) -> WorkError {
    failure(FailureKind::BadInput, format!("{field}: {problem}"))
}

/// Reads blobs on a thread that may wait.
pub(crate) struct Blobs<'a>(pub(super) &'a Inner, pub(super) &'a Token);

impl Blobs<'_> {
    fn patiently<T>(&self, call: impl FnMut() -> Result<T, BlobError>) -> Result<T, BlobError> {
        self.0.storage.patiently(self.1, call).map_err(|unstored| match unstored {
            StorageError::Blob(error) => error,
            // The reader asks the token next.
            StorageError::Stopped(reason) => BlobError::Unavailable(reason.to_string()),
        })
    }

    /// Ends early with what is there once the token is stopped.
    fn read_once(&self, digest: Digest) -> Result<Vec<u8>, BlobError> {
        self.0.runtime.block_on(async {
            let read = self.0.stores.blobs.read(digest, 0..u64::MAX).await?;
            let mut all = Vec::with_capacity(usize::try_from(read.info.size_bytes).unwrap_or(0));
            let mut bytes = read.bytes;
            // A file that another program changed would give another result in silence: the store checks it.
            while let Some(piece) = bytes.try_next().await? {
                if self.1.is_stopped() {
                    break;
                }
                all.extend_from_slice(&piece);
            }
            Ok(all)
        })
    }

    fn read(&self, field: &str, digest: Digest) -> Result<Vec<u8>, WorkError> {
        let bytes = self.patiently(|| self.read_once(digest)).map_err(|error| unread(field, &error))?;
        self.1.check()?;
        Ok(bytes)
    }

    fn size_bytes(&self, field: &str, digest: Digest) -> Result<u64, WorkError> {
        let stat = || self.0.runtime.block_on(self.0.stores.blobs.stat(digest));
        Ok(self.patiently(stat).map_err(|error| unread(field, &error))?.size_bytes)
    }
}

fn unread(field: &str, error: &BlobError) -> WorkError {
    let kind = match error {
        BlobError::NotFound { .. } | BlobError::Damaged { .. } => FailureKind::MissingInput,
        _ => FailureKind::Unavailable,
    };
    failure(kind, format!("{field}: {error}"))
}

pub(crate) struct Reader<'a> {
    pub(crate) blobs: Blobs<'a>,
    pub(crate) bounds: &'a Bounds,
    pub(crate) token: &'a Token,
}

/// Places of arrays in a request.
const ARRAYS: &str = "spec.mesh.arrays";
const FILE: &str = "spec.mesh.file";
const SEEDS: &str = "spec.arrays.seeds";
const LENGTHS: &str = "spec.arrays.edge_lengths";
const WEIGHTS: &str = "spec.arrays.weights";
const METRIC: &str = "spec.arrays.metric";
const CREASES: &str = "spec.arrays.creases";

/// The surface of a job, and how its vertices are numbered where lists go by them.
struct Surface {
    mesh: TriMesh,
    attributes: Option<Attributes>,
    /// Edges that its file names.
    creases: Vec<[u32; 2]>,
    /// Vertices that its file names.
    required: Vec<u32>,
    /// What its file holds and the reader leaves aside.
    left_aside: Vec<AttributeError>,
    vertices: FileVertices,
}

impl Reader<'_> {
    /// The bytes of an array, as many as its count says.
    fn bytes(&self, field: &str, array: &ArrayRef, numbers: u64) -> Result<Vec<u8>, WorkError> {
        let each = match array.form {
            ArrayForm::Text | ArrayForm::Unspecified => return self.blobs.read(field, array.blob),
            form => attributes::number_of(form).bytes() as u64,
        };
        let expected = array.count.saturating_mul(numbers * each);
        // Before it takes memory that no estimate has.
        let found = self.blobs.size_bytes(field, array.blob)?;
        match found == expected {
            true => self.blobs.read(field, array.blob),
            false => Err(bad(field, format!("the blob has {found} bytes; its count and form give {expected}"))),
        }
    }

    /// Parses an array that is text. The result of `parse` is dropped if the token was stopped meanwhile.
    fn text<T>(
        &self,
        field: &str,
        array: &ArrayRef,
        parse: impl FnOnce(&str) -> Result<T, DataError>,
    ) -> Result<T, WorkError> {
        let bytes = self.bytes(field, array, 1)?;
        self.token.check()?;
        let text = String::from_utf8(bytes).map_err(|_| bad(field, "is no text in UTF-8"))?;
        let parsed = parse(&text);
        self.token.check()?;
        parsed.map_err(|error| bad(field, error))
    }

    fn numbers(&self, field: &str, array: &ArrayRef, each: u64) -> Result<Vec<f64>, WorkError> {
        Ok(attributes::number_of(array.form).floats(&self.bytes(field, array, each)?, Order::Little))
    }

    /// Points; of a text one more than `most`, at most.
    fn points(&self, field: &str, array: &ArrayRef, most: u64) -> Result<Vec<DVec3>, WorkError> {
        if array.form == ArrayForm::Text {
            let most = usize::try_from(most).unwrap_or(usize::MAX);
            return self.text(field, array, |text| points(text, most, self.token));
        }
        let numbers = self.numbers(field, array, 3)?;
        Ok(numbers.as_chunks::<3>().0.iter().map(|&p| DVec3::from_array(p)).collect())
    }

    fn triples(&self, field: &str, array: &ArrayRef) -> Result<Vec<[u32; 3]>, WorkError> {
        let bytes = self.bytes(field, array, 3)?;
        let indices = bytes.as_chunks::<4>().0.as_chunks::<3>().0;
        Ok(indices.iter().map(|triple| triple.map(u32::from_le_bytes)).collect())
    }

    /// Edges of a surface with `facets` facets.
    fn edges(
        &self,
        field: &str,
        array: &ArrayRef,
        vertices: &FileVertices,
        facets: usize,
    ) -> Result<Vec<[u32; 2]>, WorkError> {
        if array.form == ArrayForm::Text {
            return self.text(field, array, |text| vertices.edges(text, facets, self.token));
        }
        if array.count > most_edges(facets) as u64 {
            return Err(bad(field, format!("{} edges are more than {facets} facets have", array.count)));
        }
        let bytes = self.bytes(field, array, 2)?;
        let indices = bytes.as_chunks::<4>().0.as_chunks::<2>().0;
        Ok(indices.iter().map(|pair| pair.map(u32::from_le_bytes)).collect())
    }

    /// Reads the arrays beside the surface that options go by.
    fn fill(&self, options: &mut dyn Start, task: &Task, surface: &FileVertices) -> Result<(), WorkError> {
        let arrays = &task.arrays;
        let seeds = arrays.seeds.as_ref().map(|array| self.points(SEEDS, array, self.bounds.max_seeds)).transpose()?;
        let lengths = |array: &ArrayRef| match array.form {
            ArrayForm::Text => self.text(LENGTHS, array, |text| surface.lengths(text, self.token)),
            _ => self.numbers(LENGTHS, array, 1),
        };
        let lengths = arrays.edge_lengths.as_ref().map(lengths).transpose()?;
        let weights = arrays.weights.as_ref().map(|array| self.numbers(WEIGHTS, array, 1)).transpose()?;
        let metric = |array: &ArrayRef| match array.form {
            ArrayForm::Text => {
                self.text(METRIC, array, |text| surface.tensors(io::lists::tensors(text, surface.count(), self.token)?))
            }
            _ => Ok(tensors(&self.numbers(METRIC, array, Tensor::NUMBERS as u64)?)),
        };
        let metric = arrays.metric.as_ref().map(metric).transpose()?;
        fill(options, seeds.unwrap_or_default(), ByVertex { edge_lengths: lengths, weights, metric });
        let (seeds, density) = options.start();
        density.max_points = usize::try_from(self.bounds.max_seeds).unwrap_or(usize::MAX);
        match seeds.count() {
            Count::Points(count) if count as u64 > self.bounds.max_seeds => {
                let field = if matches!(seeds, Seeds::Given(_)) { SEEDS } else { "spec" };
                Err(bad(field, format!("{count} seeds; this server takes at most {}", self.bounds.max_seeds)))
            }
            Count::Points(_) | Count::Implied => Ok(()),
        }
    }

    fn attributes(&self, mesh: &TriMesh, arrays: &[AttributeRef]) -> Result<Option<Attributes>, WorkError> {
        let read = |(i, AttributeRef { counts, values, corners }): (usize, &AttributeRef)| {
            let field = format!("{ARRAYS}.attributes[{i}]");
            let numbers = self.numbers(&format!("{field}.values"), values, counts.numbers)?;
            let corners = corners.as_ref().map(|array| self.triples(&format!("{field}.corners"), array)).transpose()?;
            Ok(UploadedAttribute { counts: counts.clone(), numbers, corners: corners.unwrap_or_default() })
        };
        if arrays.is_empty() {
            return Ok(None);
        }
        let read = arrays.iter().enumerate().map(read).collect::<Result<Vec<_>, WorkError>>()?;
        let collected = attributes::collect(mesh, read).map_err(|error| match error.under(ARRAYS) {
            WireError::Field { path, reason } => bad(&path, reason),
            other => failure(FailureKind::BadInput, other.to_string()),
        });
        Ok(Some(collected?))
    }

    /// `names_vertices`: whether options name vertices of the file.
    fn surface(&self, task: &Task, names_vertices: bool) -> Result<Surface, WorkError> {
        self.token.enter("read");
        let surface = match &task.mesh {
            MeshSource::File { blob, format, attributes } => {
                let format = *format;
                let bytes = self.blobs.read(FILE, *blob)?;
                self.token.check()?;
                let wrong = |error| bad(FILE, error);
                let (mesh, attributes, creases, required, left_aside) = if *attributes {
                    let Loaded { mesh, attributes, creases, vertices, left_aside } =
                        io::decode_with_attributes(format, &bytes).map_err(wrong)?;
                    (mesh, Some(attributes).filter(|attributes| !attributes.is_empty()), creases, vertices, left_aside)
                } else {
                    (io::decode(format, &bytes).map_err(wrong)?, None, Vec::new(), Vec::new(), Vec::new())
                };
                // Lists that are text go by the numbers of the file's vertices.
                let lists = [task.arrays.edge_lengths, task.arrays.metric, task.arrays.creases];
                let has_lists = lists.iter().flatten().any(|list| list.form == ArrayForm::Text);
                let vertices = match has_lists || names_vertices && FileVertices::needs_bytes(format) {
                    true => FileVertices::of(format, &bytes, &mesh).map_err(wrong)?,
                    false => FileVertices::of_arrays(&mesh),
                };
                Surface { mesh, attributes, creases, required, left_aside, vertices }
            }
            MeshSource::Arrays { positions, facets, attributes } => {
                let points = self.points(&format!("{ARRAYS}.positions"), positions, u64::MAX)?;
                let triples = self.triples(&format!("{ARRAYS}.facets"), facets)?;
                self.token.check()?;
                let mesh = TriMesh::new(points, triples).map_err(|error: MeshError| bad(ARRAYS, error))?;
                let attributes = self.attributes(&mesh, attributes)?;
                let vertices = FileVertices::of_arrays(&mesh);
                let (creases, required, left_aside) = Default::default();
                Surface { mesh, attributes, creases, required, left_aside, vertices }
            }
        };
        self.token.check()?;
        let (vertices, facets) = (surface.mesh.positions().len() as u64, surface.mesh.facets().len() as u64);
        let Bounds { max_vertices, max_facets, .. } = *self.bounds;
        for (what, count, most) in [("vertices", vertices, max_vertices), ("facets", facets, max_facets)] {
            if count > most {
                return Err(bad("spec.mesh", format!("{count} {what}; this server takes at most {most}")));
            }
        }
        Ok(surface)
    }

    /// Reads everything that a diagram or a session needs.
    pub(crate) fn input(&self, task: &Task, options: &mut dyn Start) -> Result<Input, WorkError> {
        let Surface { mesh, vertices, .. } = self.surface(task, false)?;
        options.start().0.resolve(&mesh);
        self.fill(options, task, &vertices)?;
        let (seeds, density) = options.start();
        Ok(Input { mesh, density: density.clone(), seeds: seeds.clone(), creases: Vec::new(), attributes: None })
    }

    /// Reads everything that a remesh needs; and what of the file is left aside.
    pub(crate) fn remesh(
        &self,
        task: &Task,
        mut options: RemeshOptions,
    ) -> Result<(TriMesh, RemeshOptions, Vec<AttributeError>), WorkError> {
        let names_vertices = options.keep.iter().any(|part| matches!(part, Part::Vertices(_)));
        let Surface { mesh, attributes, creases, required, mut left_aside, vertices } =
            self.surface(task, names_vertices)?;
        vertices.renumber(&mut options.keep).map_err(|error| bad("spec.remesh.keep", error))?;
        options.seeds.resolve(&mesh);
        self.fill(&mut options, task, &vertices)?;
        let (steps, most) = (options.lloyd + options.newton, self.bounds.max_iterations);
        if steps > most as usize {
            return Err(bad("spec.remesh", format!("{steps} steps; this server takes at most {most}")));
        }
        let (first, most) = (options.seeds.count(), usize::try_from(self.bounds.max_seeds).unwrap_or(usize::MAX));
        if let Some(refine) = &mut options.refine {
            let usual = if let Count::Points(count) = first { count.saturating_mul(2) } else { most };
            refine.max_points = Some(refine.max_points.unwrap_or(usual).min(most));
        }
        options.attributes = attributes;
        options.creases = creases;
        left_aside.extend(options.keep_vertices(&required));
        if let Some(array) = &task.arrays.creases {
            options.creases.extend(self.edges(CREASES, array, &vertices, mesh.facets().len())?);
        }
        Ok((mesh, options, left_aside))
    }
}
