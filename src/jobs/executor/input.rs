//! The input of a job, from its blobs.
//!
//! Purpose: [`load`] reads what a specification names and makes what the engine takes.
//! Invariant: what blobs hold is checked against what the specification says of them, and against the server's bounds,
//! before it is used. Bytes of a blob are let go of once they are read. Must not know: queues, stores of jobs.

use glam::{DVec2, DVec3};

use crate::JobError;
use crate::blob::{BlobError, Digest};
use crate::executor::prepared::Input;
use crate::record::{
    ArrayForm, ArrayRef, AttributeKind, AttributeRef, DensityKind, DensitySpec, Failure, FailureKind, JobSpec,
    MeshSource, RemeshWork, SeedSource, Tolerance, WorkSpec,
};
use geometry::cvt::density::{Count, DensitySource};
use geometry::mesh::attributes::{Attributes, ColourDepth, Colours, Normals, PerCorner};
use geometry::mesh::io::lists::{FileVertices, most_edges, points};
use geometry::mesh::io::{self, DataError};
use geometry::mesh::{MeshError, TriMesh};
use geometry::remesh::{Refine, RemeshOptions, Seeds};
use geometry::token::Token;

/// The most that a job may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JobBounds {
    /// Mesh vertices.
    pub max_vertices: u64,
    /// Mesh facets.
    pub max_facets: u64,
    /// Seeds.
    pub max_seeds: u64,
    /// Iterations.
    pub max_iterations: u32,
}

/// Why a job was not done.
#[derive(Debug)]
pub(crate) enum WorkError {
    /// It cannot be done, for this reason.
    Failure(Failure),
    /// It was stopped, or the engine failed.
    Job(JobError),
}

impl<E: Into<JobError>> From<E> for WorkError {
    fn from(error: E) -> Self {
        Self::Job(error.into())
    }
}

/// A failure of this kind.
pub(crate) fn failure(kind: FailureKind, message: impl Into<String>) -> WorkError {
    WorkError::Failure(Failure { kind, message: message.into() })
}

fn bad(field: &str, problem: impl std::fmt::Display) -> WorkError {
    failure(FailureKind::BadInput, format!("{field}: {problem}"))
}

/// Reads blobs, whole.
pub(crate) trait ReadBlob {
    /// The bytes of a blob.
    ///
    /// # Errors
    /// What the store says.
    fn read(&self, digest: Digest) -> Result<Vec<u8>, BlobError>;

    /// How many bytes it has.
    ///
    /// # Errors
    /// What the store says.
    fn size_bytes(&self, digest: Digest) -> Result<u64, BlobError>;
}

fn read(blobs: &dyn ReadBlob, field: &str, digest: Digest) -> Result<Vec<u8>, WorkError> {
    blobs.read(digest).map_err(|error| unread(field, &error))
}

fn unread(field: &str, error: &BlobError) -> WorkError {
    let kind = match error {
        BlobError::NotFound { .. } | BlobError::Damaged { .. } => FailureKind::MissingInput,
        _ => FailureKind::Unavailable,
    };
    failure(kind, format!("{field}: {error}"))
}

/// Reads arrays of one job.
struct Reader<'a> {
    blobs: &'a dyn ReadBlob,
    token: &'a Token,
}

impl Reader<'_> {
    /// The bytes of an array, as many as its count says.
    fn bytes(&self, field: &str, array: &ArrayRef, numbers: u64) -> Result<Vec<u8>, WorkError> {
        let each = match array.form {
            ArrayForm::F64 => 8,
            ArrayForm::F32 | ArrayForm::U32 => 4,
            ArrayForm::U8 => 1,
            ArrayForm::Text => return read(self.blobs, field, array.blob),
        };
        let expected = array.count.saturating_mul(numbers * each);
        // Before it takes memory that nobody counted on.
        let found = self.blobs.size_bytes(array.blob).map_err(|error| unread(field, &error))?;
        match found == expected {
            true => read(self.blobs, field, array.blob),
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
        let bytes = self.bytes(field, array, each)?;
        Ok(match array.form {
            ArrayForm::F32 => bytes.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
            ArrayForm::U8 => bytes.iter().map(|&b| f64::from(b) / 255.0).collect(),
            _ => bytes.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        })
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

    /// Edges of a surface of so many facets.
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

    fn density(&self, field: &str, spec: &DensitySpec, vertices: &FileVertices) -> Result<DensitySource, WorkError> {
        let at = |name: &str| format!("{field}.{name}");
        Ok(match (spec.kind(), &spec.edge_lengths, &spec.weights) {
            (DensityKind::EdgeLengths, Some(array), _) => {
                let field = at("edge_lengths");
                DensitySource::Sizes(match array.form {
                    ArrayForm::Text => self.text(&field, array, |text| vertices.lengths(text, self.token))?,
                    _ => self.numbers(&field, array, 1)?,
                })
            }
            (DensityKind::Weights, _, Some(array)) => DensitySource::Weights(self.numbers(&at("weights"), array, 1)?),
            (DensityKind::Curvature, ..) => DensitySource::Curvature,
            (DensityKind::FeatureSize, ..) => DensitySource::FeatureSize,
            // A specification that was checked has what its source reads.
            (DensityKind::Uniform | DensityKind::EdgeLengths | DensityKind::Weights, ..) => DensitySource::Uniform,
        })
    }

    fn seeds(&self, field: &str, source: &SeedSource, bounds: &JobBounds) -> Result<Seeds, WorkError> {
        let seeds = match source {
            SeedSource::Given(array) => {
                Seeds::Given(self.points(&format!("{field}.given"), array, bounds.max_seeds)?)
            }
            &SeedSource::Sampled { points, random_seed } => {
                let seed = random_seed.unwrap_or(Seeds::RANDOM_SEED);
                match points {
                    Some(points) => Seeds::Sample { points: usize::try_from(points).unwrap_or(usize::MAX), seed },
                    None => Seeds::Implied { seed },
                }
            }
        };
        match seeds.count() {
            Count::Points(count) if count as u64 > bounds.max_seeds => {
                Err(bad(field, format!("{count} seeds; this server takes at most {}", bounds.max_seeds)))
            }
            Count::Points(_) | Count::Implied => Ok(seeds),
        }
    }

    fn attributes(&self, mesh: &TriMesh, arrays: &[AttributeRef]) -> Result<Option<Attributes>, WorkError> {
        if arrays.is_empty() {
            return Ok(None);
        }
        let mut attributes = Attributes::new(mesh);
        for (index, AttributeRef { kind, name, values, corners }) in arrays.iter().enumerate() {
            let field = format!("mesh.arrays.attributes[{index}]");
            let at = format!("{field}.values");
            let corners = corners.as_ref().map(|array| self.triples(&format!("{field}.corners"), array)).transpose()?;
            let taken = match (kind, corners) {
                (AttributeKind::Normals, Some(corners)) => {
                    let values = self.points(&at, values, u64::MAX)?;
                    attributes.set_normals(Normals::PerCorner(PerCorner { values, corners }))
                }
                (AttributeKind::Normals, None) => {
                    attributes.set_normals(Normals::PerVertex(self.points(&at, values, u64::MAX)?))
                }
                (AttributeKind::TextureCoordinates, corners) => {
                    let numbers = self.numbers(&at, values, 2)?;
                    let values = numbers.as_chunks::<2>().0.iter().map(|&uv| DVec2::from_array(uv)).collect();
                    attributes.set_texture(PerCorner { values, corners: corners.unwrap_or_default() })
                }
                (AttributeKind::Colours, _) => {
                    let depth = if values.form == ArrayForm::U8 { ColourDepth::Eight } else { ColourDepth::Float };
                    let values = self.numbers(&at, values, 4)?.as_chunks::<4>().0.to_vec();
                    attributes.set_colours(Colours { values, depth })
                }
                (AttributeKind::Scalar, _) => attributes.add_scalar(name.clone(), self.numbers(&at, values, 1)?),
            };
            taken.map_err(|error| bad(&field, error))?;
        }
        Ok(Some(attributes))
    }
}

/// A surface, and how its vertices are numbered where lists go by them.
struct Surface {
    mesh: TriMesh,
    attributes: Option<Attributes>,
    vertices: FileVertices,
}

/// Reads the surface.
fn surface(reader: &Reader<'_>, spec: &JobSpec, bounds: &JobBounds, token: &Token) -> Result<Surface, WorkError> {
    let carries = matches!(spec.work, WorkSpec::Remesh(_));
    let surface = match &spec.mesh {
        MeshSource::File { blob, format, attributes } => {
            let format = *format;
            let bytes = read(reader.blobs, "mesh.file", *blob)?;
            token.check()?;
            let wrong = |error| bad("mesh.file", error);
            let (mesh, attributes) = if carries && attributes.unwrap_or(true) {
                let loaded = io::decode_with_attributes(format, &bytes).map_err(wrong)?;
                (loaded.mesh, Some(loaded.attributes).filter(|attributes| !attributes.is_empty()))
            } else {
                (io::decode(format, &bytes).map_err(wrong)?, None)
            };
            let vertices = match names_vertices(&spec.work) {
                true => FileVertices::of(format, &bytes, &mesh).map_err(wrong)?,
                false => FileVertices::of_arrays(&mesh),
            };
            Surface { mesh, attributes, vertices }
        }
        MeshSource::Arrays { positions, facets, attributes } => {
            let points = reader.points("mesh.arrays.positions", positions, u64::MAX)?;
            let triples = reader.triples("mesh.arrays.facets", facets)?;
            token.check()?;
            let mesh = TriMesh::new(points, triples).map_err(|error: MeshError| bad("mesh.arrays", error))?;
            let attributes = reader.attributes(&mesh, attributes)?;
            let vertices = FileVertices::of_arrays(&mesh);
            Surface { mesh, attributes, vertices }
        }
    };
    token.check()?;
    let (vertices, facets) = (surface.mesh.positions().len() as u64, surface.mesh.facets().len() as u64);
    for (what, count, most) in [("vertices", vertices, bounds.max_vertices), ("facets", facets, bounds.max_facets)] {
        if count > most {
            return Err(bad("mesh", format!("{count} {what}; this server takes at most {most}")));
        }
    }
    Ok(surface)
}

/// Whether a list of the work goes by the numbers of the file's vertices.
fn names_vertices(work: &WorkSpec) -> bool {
    let is_text = |array: &Option<ArrayRef>| array.is_some_and(|array| array.form == ArrayForm::Text);
    match work {
        WorkSpec::Remesh(work) => is_text(&work.density.edge_lengths) || is_text(&work.creases),
        WorkSpec::Cvt(work) => is_text(&work.density.edge_lengths),
        WorkSpec::Rvd(_) => false,
    }
}

/// Reads everything that a diagram or a session needs.
///
/// # Errors
/// A failure that names the field, or why it was stopped.
pub(crate) fn load(
    spec: &JobSpec,
    blobs: &dyn ReadBlob,
    bounds: &JobBounds,
    token: &Token,
) -> Result<Input, WorkError> {
    token.enter("read");
    let reader = Reader { blobs, token };
    let Surface { mesh, vertices, .. } = surface(&reader, spec, bounds, token)?;
    let max_points = usize::try_from(bounds.max_seeds).unwrap_or(usize::MAX);
    let (seeds, mut density) = match &spec.work {
        WorkSpec::Rvd(work) => {
            let density = DensitySpec { weights: work.weights, ..DensitySpec::default() };
            let source = reader.density("work.rvd", &density, &vertices)?;
            (reader.seeds("work.rvd.seeds", &work.seeds, bounds)?, density.options(source))
        }
        WorkSpec::Cvt(work) => {
            let source = reader.density("work.cvt.density", &work.density, &vertices)?;
            (reader.seeds("work.cvt.seeds", &work.seeds, bounds)?, work.density.options(source))
        }
        WorkSpec::Remesh(_) => return Err(failure(FailureKind::Internal, "a remesh is loaded by other means")),
    };
    density.max_points = max_points;
    Ok(Input { mesh, density, seeds, creases: Vec::new(), attributes: None })
}

/// Reads everything that a remesh needs.
///
/// # Errors
/// As [`load`].
pub(crate) fn load_remesh(
    spec: &JobSpec,
    work: &RemeshWork,
    blobs: &dyn ReadBlob,
    bounds: &JobBounds,
    token: &Token,
) -> Result<(TriMesh, RemeshOptions), WorkError> {
    token.enter("read");
    let reader = Reader { blobs, token };
    let Surface { mesh, attributes, vertices } = surface(&reader, spec, bounds, token)?;
    let source = reader.density("work.remesh.density", &work.density, &vertices)?;
    let seeds = reader.seeds("work.remesh.seeds", &work.seeds, bounds)?;
    let refine = match work.refinement {
        Some(refinement) => {
            let tolerance = match refinement.tolerance {
                Tolerance::Length(length) => length,
                Tolerance::DiagonalPercent(percent) => {
                    let (low, high) = mesh.bounds();
                    let extent = (high - low).max_element();
                    percent / 100.0 * ((high - low) / extent).length() * extent
                }
            };
            let most = refinement.max_points.unwrap_or(match seeds.count() {
                Count::Points(count) => 2 * count as u64,
                // A specification that was checked says how many.
                Count::Implied => bounds.max_seeds,
            });
            let max_points = usize::try_from(most.min(bounds.max_seeds)).unwrap_or(usize::MAX);
            Some(Refine { tolerance, max_points })
        }
        None => None,
    };
    let mut options = work.options(seeds, source);
    let steps = options.lloyd + options.newton;
    if steps > bounds.max_iterations as usize {
        let text = format!("{steps} steps; this server takes at most {}", bounds.max_iterations);
        return Err(bad("work.remesh", text));
    }
    options.density.max_points = usize::try_from(bounds.max_seeds).unwrap_or(usize::MAX);
    options.refine = refine;
    options.attributes = attributes;
    if let Some(array) = &work.creases {
        options.creases = reader.edges("work.remesh.creases", array, &vertices, mesh.facets().len())?;
    }
    Ok((mesh, options))
}

impl JobSpec {
    /// All blobs that it names.
    pub fn blobs(&self) -> Vec<Digest> {
        let mut arrays: Vec<Option<ArrayRef>> = Vec::new();
        let mut all = Vec::new();
        match &self.mesh {
            MeshSource::File { blob, .. } => all.push(*blob),
            MeshSource::Arrays { positions, facets, attributes } => {
                arrays.extend([Some(*positions), Some(*facets)]);
                arrays.extend(attributes.iter().flat_map(|attribute| [Some(attribute.values), attribute.corners]));
            }
        }
        let given = |seeds: &SeedSource| if let SeedSource::Given(array) = seeds { Some(*array) } else { None };
        match &self.work {
            WorkSpec::Remesh(work) => {
                arrays.extend([given(&work.seeds), work.density.edge_lengths, work.density.weights, work.creases]);
            }
            WorkSpec::Rvd(work) => arrays.extend([given(&work.seeds), work.weights]),
            WorkSpec::Cvt(work) => {
                arrays.extend([given(&work.seeds), work.density.edge_lengths, work.density.weights]);
            }
        }
        all.extend(arrays.into_iter().flatten().map(|array| array.blob));
        all.sort_unstable();
        all.dedup();
        all
    }
}
