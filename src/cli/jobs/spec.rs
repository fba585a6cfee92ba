//! What a job is asked to do, from the options of `tessera remesh` and `tessera rvd`.
//!
//! Purpose: [`RemeshWork`] and [`RvdWork`] as clap has them, and [`Asked`]: the message and the files that it names.
//! Invariant: an option that is not set is not in the message. Files go as they are: what is in them is the server's to
//! judge. Must not know: calls.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::Result;
use clap::{ArgGroup, Args};

use crate::exit::Usage;
use crate::given::{Given, Words, words};
use crate::remesh::args::{self, ShapeArgs, SizeArgs, StepArgs, usage};
use crate::rvd::SeedArgs;
use crate::source::Source;
use crate::{files, remote};
use geometry::mesh::io::Format;
pub(super) use server::config::BackendArg;
use wire::counts::Bounds;
use wire::options;
use wire::proto::{
    ArrayForm, ArrayRef, DiagramOptions, JobArrays, JobMesh, JobSpec, MeshFile, ResultFormat, RvdOutput, job_mesh,
    job_spec, result_format,
};

/// A job that can be sent once its files are uploaded.
#[derive(Debug)]
pub(super) struct Asked {
    pub(super) spec: JobSpec,
    /// The files that it names by their digests.
    pub(super) sources: Vec<Source>,
    /// Where the surface is, and its format, if it is here.
    pub(super) input: Option<(PathBuf, Format)>,
}

/// A surface here or at the server.
#[derive(Clone, Debug)]
pub(super) enum Input {
    File(PathBuf),
    Blob(String),
}

impl FromStr for Input {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let blob = text.strip_prefix("blob:");
        blob.map_or_else(|| Ok(Self::File(text.into())), |rest| digest(rest).map(Self::Blob))
    }
}

/// A digest, as blobs are named.
pub(crate) fn digest(text: &str) -> Result<String, String> {
    let whole = text.len() == 64 && text.bytes().all(|b| b.is_ascii_hexdigit());
    let wrong = "a digest has 64 hexadecimal digits: the SHA-256 of the bytes";
    if whole { Ok(text.to_ascii_lowercase()) } else { Err(wrong.to_owned()) }
}

#[derive(Args, Debug)]
pub(super) struct InputArgs {
    /// The surface: a file of any format that `remesh` reads, packed by gzip or not, or blob:DIGEST for one that the server has.
    input: Input,
    /// The format of the surface, where its name does not say it.
    #[arg(long, value_parser = files::format(), value_name = "FORMAT")]
    input_format: Option<Format>,
    /// Which backend of the server should do the work.
    #[arg(long, value_enum, help_heading = "Backend")]
    backend: Option<BackendArg>,
}

impl InputArgs {
    fn format(&self) -> Result<Format> {
        match (self.input_format, &self.input) {
            (Some(format), _) => Ok(format),
            (None, Input::File(path)) => Ok(Format::of_path(path)?),
            (None, Input::Blob(_)) => {
                Err(Usage("a blob has no name that says its format; add --input-format".to_owned()).into())
            }
        }
    }

    fn begin(&self, attributes: Option<bool>) -> Result<Asked> {
        let format = self.format()?;
        let (digest, sources, input) = match &self.input {
            Input::Blob(digest) => (digest.clone(), Vec::new(), None),
            Input::File(path) => {
                let source = Source::surface(path, format)?;
                (source.digest.clone(), vec![source], Some((path.clone(), format)))
            }
        };
        let file = MeshFile { digest, format: format.number(), attributes };
        let spec = JobSpec {
            mesh: Some(JobMesh { source: Some(job_mesh::Source::File(file)) }),
            backend: self.backend.map(remote::choice).unwrap_or_default().into(),
            ..JobSpec::default()
        };
        Ok(Asked { spec, sources, input })
    }
}

#[derive(Args, Debug)]
#[command(group(ArgGroup::new("size").required(true).multiple(true).args(["points", "edge_length", "sizes", "metric"])))]
pub(super) struct RemeshWork {
    #[command(flatten)]
    input: InputArgs,
    /// The format of the result [default: ply].
    #[arg(long, value_parser = files::format())]
    format: Option<Format>,
    /// Leave aside normals, texture coordinates, colours and scalars of the input.
    #[arg(long)]
    no_attributes: bool,
    #[command(flatten)]
    size: Given<SizeArgs>,
    #[command(flatten)]
    shape: Given<ShapeArgs>,
    #[command(flatten)]
    steps: Given<StepArgs>,
}

impl RemeshWork {
    pub(super) fn asked(&self) -> Result<Asked> {
        let Self { input, size, shape, steps, .. } = self;
        let message = args::message(size, shape, steps)?;
        options::remesh(&message, size.beside(), &Bounds::WIDEST).map_err(usage)?;
        if let Input::File(path) = &input.input {
            let format = input.format()?;
            let named = [
                (size.sizes.is_some(), "--sizes"),
                (size.metric.is_some(), "--metric"),
                (shape.has_crease_files(), "--creases"),
            ];
            named
                .iter()
                .filter(|(is_given, _)| *is_given)
                .try_for_each(|(_, option)| files::check_numbered(&files::Surface::new(path, Some(format)), option))?;
        }
        let mut asked = input.begin(self.no_attributes.then_some(false))?;
        let edge_lengths = size.sizes.as_deref().map(|path| text(path, &mut asked.sources)).transpose()?;
        let creases = creases(shape, &mut asked.sources)?;
        let metric = size.metric.as_deref().map(|path| metric(path, &mut asked.sources)).transpose()?;
        asked.spec.arrays = Some(JobArrays { edge_lengths, creases, metric, ..JobArrays::default() })
            .filter(|arrays| *arrays != JobArrays::default());
        asked.spec.work = Some(job_spec::Work::Remesh(message));
        asked.spec.result =
            self.format.map(|format| ResultFormat { form: Some(result_format::Form::File(format.number())) });
        Ok(asked)
    }
}

const OUTPUTS: Words<RvdOutput> = &[
    ("cells", "The pieces, as a PLY file of polygons", RvdOutput::Cells),
    ("centroids", "The centroid of each cell", RvdOutput::Centroids),
    ("sums", "Mass, area and energy of each cell", RvdOutput::Sums),
];

#[derive(Args, Debug)]
#[command(group(ArgGroup::new("of").required(true).args(["seeds", "points"])))]
pub(super) struct RvdWork {
    #[command(flatten)]
    input: InputArgs,
    /// Outputs, separated by commas [default: cells].
    #[arg(long, value_parser = words(OUTPUTS), value_delimiter = ',')]
    outputs: Vec<RvdOutput>,
    /// The format of the cells: a PLY file.
    #[arg(long, value_parser = ["ply"])]
    format: Option<String>,
    #[command(flatten)]
    seeds: Given<SeedArgs>,
}

impl RvdWork {
    pub(super) fn asked(&self) -> Result<Asked> {
        let mut asked = self.input.begin(None)?;
        let seeds = &self.seeds;
        if let Some(path) = &seeds.seeds {
            let seeds = Some(text(path, &mut asked.sources)?);
            asked.spec.arrays = Some(JobArrays { seeds, ..JobArrays::default() });
        }
        asked.spec.work = Some(job_spec::Work::Rvd(DiagramOptions {
            outputs: self.outputs.iter().map(|&output| output.into()).collect(),
            ..seeds.asked()?.0
        }));
        Ok(asked)
    }
}

/// The tensors of a file, as text: by the vertices of the surface's file, whose numbers the server knows.
fn metric(path: &Path, sources: &mut Vec<Source>) -> Result<ArrayRef> {
    let mut text = String::new();
    for tensor in files::read_tensors(path)? {
        let numbers = tensor.0.map(|m| format!("{m:e}"));
        text += &numbers.join(" ");
        text.push('\n');
    }
    Ok(added(Source::of(path, text.as_bytes())?, sources))
}

/// The files with edges that are creases, as one text.
fn creases(shape: &ShapeArgs, sources: &mut Vec<Source>) -> Result<Option<ArrayRef>> {
    let paths: Vec<&Path> = shape.crease_files().collect();
    match paths[..] {
        [] => Ok(None),
        [path] => text(path, sources).map(Some),
        [first, ..] => {
            let texts = paths.iter().map(|path| files::read_text(path)).collect::<Result<Vec<_>>>()?;
            Ok(Some(added(Source::of(first, texts.join("\n").as_bytes())?, sources)))
        }
    }
}

/// A file of text that an option names.
fn text(path: &Path, sources: &mut Vec<Source>) -> Result<ArrayRef> {
    Ok(added(Source::open(path)?, sources))
}

/// A text that is sent too.
fn added(source: Source, sources: &mut Vec<Source>) -> ArrayRef {
    let array = ArrayRef { digest: source.digest.clone(), form: ArrayForm::Text.into(), count: 0 };
    sources.push(source);
    array
}
