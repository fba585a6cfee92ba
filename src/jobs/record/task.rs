//! A specification for those that do it.
//!
//! Purpose: [`Task`] has the same as the message in the library's own types; [`Task::of`] makes it, with all checks that need
//! no blob. Options are checked by [`wire::options`], as those of streams are.
//! Invariant: a field of the message is read here or refused; paths of refusals are below the specification.
//! Must not know: stores, what blobs hold, limits of a server.

use std::time::Duration;

use super::Kind;
use crate::blob::{Digest, DigestError};
use geometry::cvt::{SeedEdit, StepKind};
use geometry::mesh::io::Format;
use geometry::remesh::{RemeshOptions, Seeds};
use geometry::rvd::{BackendChoice, BackendKind};
use wire::attributes::AttributeCounts;
use wire::counts::{Bounds, MeshCounts};
use wire::options::{self, Beside, Diagram, Session, choice, within};
use wire::proto::{self, ArrayForm, SeedsWanted, cvt_job_command, job_mesh, job_spec, result_format};
use wire::{WireError, attributes, codec};

const MAX_LABELS: u64 = 64;
/// Ten years: so that no time overflows.
const MAX_DEADLINE_MS: u64 = 10 * 366 * 24 * 3_600_000;
/// Commands of a session, and changes of a command.
const MAX_COMMANDS: u64 = 10_000;

type Read<T> = Result<T, WireError>;

#[derive(Clone, Debug)]
pub struct Task {
    pub mesh: MeshSource,
    pub arrays: Arrays,
    pub operation: Operation,
    pub backend: BackendChoice,
    pub result: ResultFormat,
    /// Jobs with a higher priority go first among those of their tenant; -100 to 100.
    pub priority: i32,
    pub deadlines: Deadlines,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Deadlines {
    pub queue: Option<Duration>,
    /// At work, each attempt.
    pub run: Option<Duration>,
}

/// The work of a job. Arrays of options are empty until they are read.
#[derive(Clone, Debug)]
pub enum Operation {
    Remesh(Box<RemeshOptions>),
    Rvd(Diagram),
    /// A session's commands in a row.
    Cvt(Session, Vec<Command>),
}

impl Operation {
    pub fn kind(&self) -> Kind {
        match self {
            Self::Remesh(_) => Kind::Remesh,
            Self::Rvd(_) => Kind::Rvd,
            Self::Cvt(..) => Kind::Cvt,
        }
    }

    pub fn seeds(&self) -> &Seeds {
        match self {
            Self::Remesh(options) => &options.seeds,
            Self::Rvd(diagram) => &diagram.seeds,
            Self::Cvt(session, _) => &session.seeds,
        }
    }
}

#[derive(Clone, Debug)]
pub enum Command {
    Step {
        /// At least 1.
        iterations: u32,
        kind: StepKind,
        /// Which seeds are a result.
        seeds: SeedsWanted,
    },
    /// Changes of the seeds: all or none.
    Edit {
        /// In this order.
        edits: Vec<SeedEdit>,
        /// Whether the seeds are a result: never or last.
        seeds: SeedsWanted,
    },
}

pub(crate) fn steps(commands: &[Command]) -> u64 {
    let steps =
        |command: &Command| if let Command::Step { iterations, .. } = command { u64::from(*iterations) } else { 0 };
    commands.iter().map(steps).sum()
}

/// Sets of seeds that commands ask for, and the last one.
pub(crate) fn sets(commands: &[Command]) -> u64 {
    let sets = |command: &Command| match command {
        Command::Step { iterations, seeds: SeedsWanted::Each, .. } => u64::from(*iterations),
        Command::Step { seeds, .. } | Command::Edit { seeds, .. } => u64::from(*seeds == SeedsWanted::Last),
    };
    commands.iter().map(sets).sum::<u64>() + 1
}

#[derive(Clone, Debug, PartialEq)]
pub enum MeshSource {
    File {
        blob: Digest,
        format: Format,
        /// Whether a remesh carries over what the surface carries.
        attributes: bool,
    },
    Arrays {
        /// Coordinates x y z of each vertex, F32 or F64.
        positions: ArrayRef,
        /// Three vertices of each facet, U32.
        facets: ArrayRef,
        /// What the surface carries and a remesh is to carry.
        attributes: Vec<AttributeRef>,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArrayRef {
    pub blob: Digest,
    pub form: ArrayForm,
    /// Elements: vertices, facets, edges, values; 0 for text.
    pub count: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct AttributeRef {
    pub counts: AttributeCounts,
    pub values: ArrayRef,
    /// Which value each corner of each facet has.
    pub corners: Option<ArrayRef>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Arrays {
    /// Coordinates x y z of each: F32, F64 or text.
    pub seeds: Option<ArrayRef>,
    /// One a vertex: F64 or text.
    pub edge_lengths: Option<ArrayRef>,
    /// One a vertex: F64.
    pub weights: Option<ArrayRef>,
    /// Six numbers a vertex: F64 or text.
    pub metric: Option<ArrayRef>,
    /// Two vertices each: U32 or text.
    pub creases: Option<ArrayRef>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResultFormat {
    File(Format),
    /// Arrays as the streams send them.
    Arrays,
}

impl Task {
    /// Whether no other backend will do.
    pub fn needs_gpu(&self) -> bool {
        self.backend == BackendChoice::Only(BackendKind::Gpu)
    }

    pub fn of(message: &proto::JobSpec) -> Read<Self> {
        let proto::JobSpec { mesh, work, backend, result, priority, queue_deadline, run_deadline, labels, arrays } =
            message;
        check_labels(labels)?;
        let priority = priority.unwrap_or(0);
        if !(-100..=100).contains(&priority) {
            return Err(WireError::field("priority", format!("is {priority}; give -100 to 100")));
        }
        let work = need("work", work.as_ref(), "give remesh, rvd or cvt")?;
        let carries = matches!(work, job_spec::Work::Remesh(_));
        let mesh = MeshSource::of(mesh.as_ref(), carries).map_err(|error| error.under("mesh"))?;
        let vertices = if let MeshSource::Arrays { positions, .. } = &mesh { Some(positions.count) } else { None };
        let arrays = Arrays::of(arrays.as_ref(), vertices, work).map_err(|error| error.under("arrays"))?;
        let beside = Beside {
            seeds: arrays.seeds.map(|array| array.count),
            edge_lengths: arrays.edge_lengths.is_some(),
            weights: arrays.weights.is_some(),
            metric: arrays.metric.is_some(),
        };
        let operation = match work {
            job_spec::Work::Remesh(given) => options::remesh(given, beside, &Bounds::WIDEST)
                .map(|options| Operation::Remesh(Box::new(options)))
                .map_err(|error| error.under("remesh"))?,
            job_spec::Work::Rvd(given) => options::diagram(given, beside, &Bounds::WIDEST)
                .map(Operation::Rvd)
                .map_err(|error| error.under("rvd"))?,
            job_spec::Work::Cvt(given) => session(given, beside).map_err(|error| error.under("cvt"))?,
        };
        Ok(Self {
            mesh,
            arrays,
            operation,
            backend: codec::backend(*backend)?,
            result: result_format(result.as_ref()).map_err(|error| error.under("result"))?,
            priority,
            deadlines: Deadlines {
                queue: deadline("queue_deadline", *queue_deadline)?,
                run: deadline("run_deadline", *run_deadline)?,
            },
        })
    }

    pub fn blobs(&self) -> Vec<Digest> {
        let Arrays { seeds, edge_lengths, weights, metric, creases } = self.arrays;
        let mut arrays = vec![seeds, edge_lengths, weights, metric, creases];
        let mut all = Vec::new();
        match &self.mesh {
            MeshSource::File { blob, .. } => all.push(*blob),
            MeshSource::Arrays { positions, facets, attributes } => {
                arrays.extend([Some(*positions), Some(*facets)]);
                arrays.extend(attributes.iter().flat_map(|attribute| [Some(attribute.values), attribute.corners]));
            }
        }
        all.extend(arrays.into_iter().flatten().map(|array| array.blob));
        all.sort_unstable();
        all.dedup();
        all
    }
}

fn need<'a, T>(path: &str, given: Option<&'a T>, hint: &str) -> Read<&'a T> {
    given.ok_or_else(|| WireError::field(path, format!("is missing; {hint}")))
}

fn deadline(path: &str, given: Option<prost_types::Duration>) -> Read<Option<Duration>> {
    let Some(given) = given else { return Ok(None) };
    let ms = codec::duration_ms(given).map_err(|error| error.under(path))?;
    match (1..=MAX_DEADLINE_MS).contains(&ms) {
        true => Ok(Some(Duration::from_millis(ms))),
        false => Err(WireError::field(path, format!("is {ms} ms; give 1 ms to {MAX_DEADLINE_MS} ms"))),
    }
}

fn check_labels(labels: &std::collections::HashMap<String, String>) -> Read<()> {
    within("labels", labels.len() as u64, 0, MAX_LABELS)?;
    for (key, value) in labels {
        let good = |c: char| c.is_ascii_alphanumeric() || "._-/".contains(c);
        if !(1..=63).contains(&key.len()) || !key.chars().all(good) {
            let shown: String = key.chars().take(63).collect();
            return Err(WireError::field(
                "labels",
                format!("has {shown:?}; a key has 1 to 63 ASCII letters, digits, and ._-/"),
            ));
        }
        if value.len() > 255 || value.chars().any(char::is_control) {
            let text = "is too long or has control characters; give at most 255 bytes";
            return Err(WireError::field(format!("labels.{key}"), text));
        }
    }
    Ok(())
}

fn digest(text: &str) -> Read<Digest> {
    text.parse().map_err(|error: DigestError| WireError::field("digest", format!("is no digest: {error}")))
}

impl ArrayRef {
    /// An array of one of these types, with `count` elements if that is known.
    fn of(path: &str, given: &proto::ArrayRef, forms: &[ArrayForm], count: Option<u64>) -> Read<Self> {
        let read = || {
            let form = choice("form", given.form)?;
            if !forms.contains(&form) {
                let word = |form: &ArrayForm| form.as_str_name().trim_start_matches("ARRAY_FORM_").to_ascii_lowercase();
                let all: Vec<_> = forms.iter().map(word).collect();
                return Err(WireError::field("form", format!("is {}; give {}", word(&form), all.join(" or "))));
            }
            match (form, count) {
                (ArrayForm::Text, _) => within("count", given.count, 0, 0)?,
                (_, Some(count)) => within("count", given.count, count, count)?,
                (_, None) => within("count", given.count, 1, Bounds::WIDEST.max_seeds)?,
            }
            Ok(Self { blob: digest(&given.digest)?, form, count: given.count })
        };
        read().map_err(|error: WireError| error.under(path))
    }
}

impl Arrays {
    fn of(given: Option<&proto::JobArrays>, vertices: Option<u64>, work: &job_spec::Work) -> Read<Self> {
        let Some(proto::JobArrays { seeds, edge_lengths, weights, creases, metric }) = given else {
            return Ok(Self::default());
        };
        for (path, given, is_read) in [
            ("edge_lengths", edge_lengths, !matches!(work, job_spec::Work::Rvd(_))),
            ("metric", metric, matches!(work, job_spec::Work::Remesh(_))),
            ("creases", creases, matches!(work, job_spec::Work::Remesh(_))),
        ] {
            if given.is_some() && !is_read {
                return Err(WireError::field(path, "are given, but this work reads none"));
            }
        }
        let read = |path, given: &Option<proto::ArrayRef>, forms: &[_], count| {
            given.as_ref().map(|given| ArrayRef::of(path, given, forms, count)).transpose()
        };
        use ArrayForm::{F32, F64, Text, U32};
        Ok(Self {
            seeds: read("seeds", seeds, &[F32, F64, Text], None)?,
            edge_lengths: read("edge_lengths", edge_lengths, &[F64, Text], vertices)?,
            weights: read("weights", weights, &[F64], vertices)?,
            metric: read("metric", metric, &[F64, Text], vertices)?,
            creases: read("creases", creases, &[U32, Text], None)?,
        })
    }
}

impl MeshSource {
    fn of(given: Option<&proto::JobMesh>, carries: bool) -> Read<Self> {
        let source = given.and_then(|mesh| mesh.source.as_ref());
        match need("source", source, "give a file or arrays")? {
            job_mesh::Source::File(proto::MeshFile { digest: blob, format, attributes }) => {
                let read = || {
                    if *attributes == Some(true) && !carries {
                        return Err(WireError::field("attributes", "is set, but only a remesh carries attributes"));
                    }
                    let format = Format::of_number(*format).ok_or_else(|| {
                        WireError::field("format", format!("is {format}, which is no format of a surface"))
                    })?;
                    Ok(Self::File { blob: digest(blob)?, format, attributes: carries && attributes.unwrap_or(true) })
                };
                read().map_err(|error: WireError| error.under("file"))
            }
            job_mesh::Source::Arrays(arrays) => Self::of_arrays(arrays, carries).map_err(|error| error.under("arrays")),
        }
    }

    fn of_arrays(given: &proto::MeshArrays, carries: bool) -> Read<Self> {
        let array = |path, given: &Option<proto::ArrayRef>, forms: &[_]| {
            ArrayRef::of(path, need(path, given.as_ref(), "name a blob")?, forms, None)
        };
        let positions = array("positions", &given.positions, &[ArrayForm::F32, ArrayForm::F64])?;
        let facets = array("facets", &given.facets, &[ArrayForm::U32])?;
        if !carries && !given.attributes.is_empty() {
            return Err(WireError::field("attributes", "are given, but only a remesh carries attributes"));
        }
        let headers: Vec<_> = given.attributes.iter().map(header).collect();
        // Values by corner may be as many as any array has: the estimate counts them.
        let counts = MeshCounts { vertices: positions.count, facets: facets.count, ..MeshCounts::default() };
        let counts = attributes::check_within(&headers, counts, Bounds::WIDEST.max_seeds).map_err(of_header)?;
        let attribute = |(i, (counts, given)): (usize, (AttributeCounts, &proto::AttributeArrays))| {
            let read = || {
                let values = need("values", given.values.as_ref(), "name a blob")?;
                let values = ArrayRef::of("values", values, &[values.form()], Some(counts.values))?;
                let corners = match (counts.by_corner, &given.corners) {
                    (true, corners) => {
                        let corners = need("corners", corners.as_ref(), "texture coordinates are given by corner")?;
                        Some(ArrayRef::of("corners", corners, &[ArrayForm::U32], Some(facets.count))?)
                    }
                    (false, Some(_)) => {
                        return Err(WireError::field("corners", "are for normals and texture coordinates"));
                    }
                    (false, None) => None,
                };
                Ok(AttributeRef { counts, values, corners })
            };
            read().map_err(|error: WireError| error.under(&format!("attributes[{i}]")))
        };
        let attributes = counts.into_iter().zip(&given.attributes).enumerate().map(attribute);
        Ok(Self::Arrays { positions, facets, attributes: attributes.collect::<Read<_>>()? })
    }
}

/// The header that a stream would have for an attribute.
fn header(given: &proto::AttributeArrays) -> proto::AttributeHeader {
    let form = given.values.as_ref().map_or(ArrayForm::Unspecified, proto::ArrayRef::form);
    // A form that is none of numbers has a type of no message.
    let r#type = attributes::type_of(form).map_or(-1, i32::from);
    proto::AttributeHeader {
        kind: given.kind,
        name: given.name.clone(),
        r#type,
        values: given.values.as_ref().map_or(0, |values| values.count),
        by_corner: given.corners.is_some(),
        components: given.components,
        regions: given.regions.clone(),
    }
}

/// A refusal of such a header, with the field of the arrays.
fn of_header(error: WireError) -> WireError {
    let fields = [(".type", ".values.form"), (".values", ".values.count"), (".by_corner", ".corners")];
    match error {
        WireError::Field { path, reason } => {
            let renamed = fields.iter().find_map(|(from, to)| Some(format!("{}{to}", path.strip_suffix(from)?)));
            WireError::Field { path: renamed.unwrap_or(path), reason }
        }
        other => other,
    }
}

fn result_format(given: Option<&proto::ResultFormat>) -> Read<ResultFormat> {
    match given.and_then(|given| given.form) {
        None | Some(result_format::Form::File(0)) => Ok(ResultFormat::File(Format::Ply)),
        Some(result_format::Form::File(format)) => Format::of_number(format)
            .map(ResultFormat::File)
            .ok_or_else(|| WireError::field("file", format!("is {format}, which is no format of a surface"))),
        Some(result_format::Form::Arrays(true)) => Ok(ResultFormat::Arrays),
        Some(result_format::Form::Arrays(false)) => {
            Err(WireError::field("arrays", "is false; leave it out, or choose a format of a file"))
        }
    }
}

fn session(given: &proto::CvtJob, beside: Beside) -> Read<Operation> {
    let proto::CvtJob { options, commands } = given;
    let options = options.clone().unwrap_or_default();
    let session = options::session(&options, beside, &Bounds::WIDEST).map_err(|error| error.under("options"))?;
    within("commands", commands.len() as u64, 1, MAX_COMMANDS)?;
    let commands = commands.iter().enumerate().map(|(i, command)| {
        let at = || format!("commands[{i}]");
        let command = command.command.as_ref();
        match command.ok_or_else(|| WireError::field(at(), "is missing; give step or edit"))? {
            cvt_job_command::Command::Step(step) => of_step(step).map_err(|error| error.under(&(at() + ".step"))),
            cvt_job_command::Command::Edit(edit) => of_edit(edit).map_err(|error| error.under(&(at() + ".edit"))),
        }
    });
    Ok(Operation::Cvt(session, commands.collect::<Read<_>>()?))
}

fn of_step(step: &proto::CvtStep) -> Read<Command> {
    let &proto::CvtStep { iterations, seeds, kind } = step;
    within("iterations", iterations.into(), 1, u32::MAX.into())?;
    Ok(Command::Step { iterations, kind: codec::step_kind(kind)?, seeds: codec::seeds_wanted(seeds)? })
}

fn of_edit(edit: &proto::CvtEdit) -> Read<Command> {
    let (edits, seeds) = (codec::edits(&edit.edits)?, codec::seeds_wanted(edit.seeds)?);
    within("edits", edits.len() as u64, 1, MAX_COMMANDS)?;
    if seeds == SeedsWanted::Each {
        return Err(WireError::field("seeds", "is EACH; an edit has LAST"));
    }
    let place = |edit: &SeedEdit| match edit {
        SeedEdit::Move { to: place, .. } | SeedEdit::Add { at: place } => place.is_finite(),
        SeedEdit::Remove { .. } => true,
    };
    match edits.iter().position(|edit| !place(edit)) {
        Some(i) => Err(WireError::field(format!("edits[{i}]"), "is not finite; give finite coordinates")),
        None => Ok(Command::Edit { edits, seeds }),
    }
}
