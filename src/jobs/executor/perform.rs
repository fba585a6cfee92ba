//! A job that is done from its specification to the bytes of its result.
//!
//! Purpose: [`perform`] reads the blobs, works, and gives the parts of the result as bytes, each under its name.
//! Invariant: the same specification and blobs give the same bytes, but for the report, which has times.
//! Must not know: queues, stores of jobs, where results go.

use bytes::Bytes;
use glam::DVec3;
use serde_json::{Value, json};
use std::io::Cursor;
use std::sync::Arc;

use crate::executor::diagram::Diagram;
use crate::executor::input::{Reader, WorkError, failure};
use crate::executor::prepared::Prepared;
use crate::observe::activity::Activity;
use crate::record::{Command, FailureKind, Operation, ResultFormat, Task, steps};
use crate::{BackendInfo, Backends};
use geometry::cvt::density::{DensityOptions, Expected};
use geometry::cvt::{Cvt, StepKind};
use geometry::mesh::TriMesh;
use geometry::mesh::attributes::{Attributes, ColourDepth, Colours, Normals};
use geometry::mesh::io::{self, Format};
use geometry::mesh::numbers::{NumberType, Order};
use geometry::remesh::report::{IterationFigures, to_json};
use geometry::remesh::{Observer, Remesh, RemeshOptions, Seeds, Warning, remesh};
use geometry::rvd::cells::CellWriter;
use geometry::token::Token;
use wire::proto::SeedsWanted;
use wire::{attributes, options};

/// What a job gives: bytes, each part under its name.
pub(crate) type Parts = Vec<(String, Bytes)>;

pub(crate) struct JobContext<'a> {
    pub backends: &'a Backends,
    pub reader: Reader<'a>,
    pub token: &'a Token,
    /// Hears of stages and steps.
    pub(crate) activity: &'a Activity,
    /// Hears what the surface makes one expect, before the work on it.
    pub expects: &'a dyn Fn(&Expected) -> Result<(), WorkError>,
}

impl JobContext<'_> {
    fn look_at(&self, mesh: &TriMesh, options: &DensityOptions, seeds: &Seeds) -> Result<(), WorkError> {
        (self.expects)(&Expected::of(mesh, options, seeds.count(), self.token)?)
    }
}

pub(crate) fn perform(task: &Task, context: &JobContext<'_>) -> Result<Parts, WorkError> {
    context.token.check()?;
    match &task.operation {
        Operation::Remesh(options) => of_remesh(task, options, context),
        Operation::Rvd(diagram) => of_rvd(task, diagram.clone(), context),
        Operation::Cvt(session, commands) => of_cvt(task, session.clone(), commands, context),
    }
}

fn of_remesh(task: &Task, options: &RemeshOptions, context: &JobContext<'_>) -> Result<Parts, WorkError> {
    let (mesh, options, left_aside) = context.reader.remesh(task, options.clone())?;
    context.look_at(&mesh, &options.density, &options.seeds)?;
    let backend = Arc::clone(context.backends.choose(task.backend)?);
    let mut observer = context.activity;
    let mut done = remesh(&mesh, &options, backend.as_ref(), &mut observer, context.token)?;
    done.report.warnings.splice(0..0, left_aside.iter().map(Warning::left_aside));
    drop((mesh, options));
    context.token.enter("write");
    let mut parts = match task.result {
        ResultFormat::File(format) => {
            let (bytes, left_out) = file(format, &done)?;
            done.report.warnings.extend(Warning::not_held(&left_out));
            vec![("mesh".to_owned(), bytes)]
        }
        ResultFormat::Arrays => arrays(&done),
    };
    parts.push(("report".to_owned(), json_bytes(&done.report)));
    Ok(parts)
}

fn json_bytes(report: &impl serde::Serialize) -> Bytes {
    let mut bytes = to_json(report).and_then(|json| serde_json::to_vec_pretty(&json)).unwrap_or_default();
    bytes.push(b'\n');
    bytes.into()
}

/// The file of a result, and the names of what the format cannot hold.
fn file(format: Format, done: &Remesh) -> Result<(Bytes, Vec<String>), WorkError> {
    let none = Attributes::new(&done.mesh);
    let encoded = io::encode_with_attributes(format, &done.mesh, done.attributes.as_ref().unwrap_or(&none));
    let refused = |error| failure(FailureKind::BadInput, format!("spec.result.file: {error}"));
    encoded.map(|(bytes, left_out)| (bytes.into(), left_out)).map_err(refused)
}

fn numbers(values: &[f64]) -> Bytes {
    values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>().into()
}

fn points(values: &[DVec3]) -> Bytes {
    values.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect::<Vec<u8>>().into()
}

fn indices(values: &[u32]) -> Bytes {
    values.iter().flat_map(|i| i.to_le_bytes()).collect::<Vec<u8>>().into()
}

fn arrays(done: &Remesh) -> Parts {
    let mut parts: Parts = vec![
        ("positions".to_owned(), points(done.mesh.positions())),
        ("facets".to_owned(), indices(done.mesh.facets().as_flattened())),
        ("vertex_seeds".to_owned(), indices(&done.vertex_seed)),
        ("creases".to_owned(), indices(done.curve_edges.as_flattened())),
        ("seeds".to_owned(), points(&done.seeds)),
    ];
    if let Some(attributes) = &done.attributes {
        carried(attributes, &mut parts);
    }
    parts
}

fn carried(attributes: &Attributes, parts: &mut Parts) {
    let mut push = |name: &str, bytes| parts.push((name.to_owned(), bytes));
    match attributes.normals() {
        Some(Normals::PerVertex(normals)) => push("normals", points(normals)),
        Some(Normals::PerCorner(normals)) => {
            push("normals", points(&normals.values));
            push("normal_corners", indices(normals.corners.as_flattened()));
        }
        None => {}
    }
    if let Some(texture) = attributes.texture() {
        let values: Vec<f64> = texture.values.iter().flat_map(|uv| uv.to_array()).collect();
        push("texture_coordinates", numbers(&values));
        push("texture_corners", indices(texture.corners.as_flattened()));
    }
    if let Some(Colours { values, depth }) = attributes.colours() {
        push(
            "colours",
            match depth {
                ColourDepth::Eight => {
                    values.iter().flatten().map(|x| (x * 255.0).round() as u8).collect::<Vec<u8>>().into()
                }
                ColourDepth::Float => numbers(values.as_flattened()),
            },
        );
    }
    for scalar in attributes.scalars() {
        let mut bytes = Vec::with_capacity(scalar.number.bytes() * scalar.values.len());
        scalar.values.iter().for_each(|&x| scalar.number.put(x, Order::Little, &mut bytes));
        let mut name = format!("scalar.{}", scalar.name);
        if (scalar.number, scalar.components) != (NumberType::F64, 1) {
            name.push_str(&format!(".{}.{}", attributes::word_of(scalar.number), scalar.components));
        }
        push(&name, bytes.into());
    }
    if let Some(regions) = attributes.regions() {
        push("regions", regions.numbers().flat_map(i64::to_le_bytes).collect::<Vec<u8>>().into());
        let named: Vec<Value> =
            regions.all().iter().map(|region| json!({ "number": region.number, "name": region.name })).collect();
        push("region_names", Value::from(named).to_string().into());
    }
}

/// What cannot be written to memory; it always can.
fn unwritten(error: std::io::Error) -> WorkError {
    failure(FailureKind::BadInput, format!("the pieces cannot be written: {error}"))
}

fn of_rvd(task: &Task, mut wanted: options::Diagram, context: &JobContext<'_>) -> Result<Parts, WorkError> {
    let input = context.reader.input(task, &mut wanted)?;
    context.look_at(&input.mesh, &input.density, &input.seeds)?;
    let backend = Arc::clone(context.backends.choose(task.backend)?);
    context.token.enter("prepare");
    let prepared = Prepared::new(input, context.token)?;
    context.token.enter("diagram");
    let mut diagram = Diagram::open(&prepared, backend.as_ref())?;
    let options::Outputs { cells, centroids, sums } = wanted.outputs;
    let mut parts = Parts::new();
    if cells {
        let mut cells = CellWriter::new(Cursor::new(Vec::new()), Cursor::new(Vec::new())).map_err(unwritten)?;
        while let Some(batch) = diagram.batch(backend.as_ref(), context.token)? {
            cells.append(&batch).map_err(unwritten)?;
            let (done, total) = diagram.progress();
            context.activity.advance("diagram", done, total);
        }
        parts.push(("cells".to_owned(), cells.finish().map_err(unwritten)?.into_inner().into()));
    }
    if centroids || sums {
        let all = diagram.sums(backend.as_ref(), context.token)?;
        if centroids {
            parts.push(("centroids".to_owned(), points(&all.centroids)));
        }
        if sums {
            for (name, values) in [("masses", &all.masses), ("areas", &all.areas), ("energies", &all.energies)] {
                parts.push((name.to_owned(), numbers(values)));
            }
        }
    }
    if prepared.random_seed.is_some() {
        parts.push(("seeds".to_owned(), points(&prepared.seeds)));
    }
    let report = diagram.report(&prepared, &BackendInfo::of(backend.as_ref()));
    parts.push(("report".to_owned(), json_bytes(&report)));
    Ok(parts)
}

fn of_cvt(
    task: &Task,
    mut session: options::Session,
    commands: &[Command],
    context: &JobContext<'_>,
) -> Result<Parts, WorkError> {
    let input = context.reader.input(task, &mut session)?;
    context.look_at(&input.mesh, &input.density, &input.seeds)?;
    let backend = Arc::clone(context.backends.choose(task.backend)?);
    let (total, most) = (steps(commands), context.reader.bounds.max_iterations);
    if total > u64::from(most) {
        let text = format!("spec.cvt.commands: {total} steps; this server takes {most}");
        return Err(failure(FailureKind::BadInput, text));
    }
    context.token.enter("prepare");
    let prepared = Prepared::for_steps(input, context.token)?;
    let mut cvt = Cvt::new(backend.as_ref(), Arc::clone(&prepared.surface), &prepared.seeds, session.options)?;
    context.token.enter("iterations");
    let (mut parts, mut iterations) = (Parts::new(), Vec::new());
    let mut observer = context.activity;
    for command in commands {
        match command {
            Command::Step { iterations: count, kind, seeds } => {
                for step in 1..=*count {
                    context.token.check()?;
                    let it = match kind {
                        StepKind::Lloyd => cvt.lloyd(context.token)?,
                        StepKind::Lbfgs => cvt.lbfgs(context.token)?,
                    };
                    observer.iteration(&it, total as usize);
                    iterations.push(it);
                    if observer.wants_seeds() {
                        observer.seeds(iterations.len(), &cvt.seeds()?);
                    }
                    if *seeds == SeedsWanted::Each || (*seeds == SeedsWanted::Last && step == *count) {
                        keep(&mut cvt, &mut parts)?;
                    }
                }
            }
            Command::Edit { edits, seeds } => {
                cvt.edit(edits)?;
                if *seeds == SeedsWanted::Last {
                    keep(&mut cvt, &mut parts)?;
                }
            }
        }
    }
    let seeds = cvt.seeds()?;
    parts.push(("seeds".to_owned(), points(&seeds)));
    let by = BackendInfo::of(backend.as_ref());
    let figures: Vec<IterationFigures> = iterations.iter().map(IterationFigures::of).collect();
    let report = json!({
        "backend": by.kind.name(),
        "adapter": by.adapter,
        "threads": by.threads,
        "seed": prepared.random_seed,
        "seeds": seeds.len(),
        "input": prepared.figures,
        "iterations": figures,
    });
    parts.push(("report".to_owned(), json_bytes(&report)));
    Ok(parts)
}

/// The most sets of seeds that a session's job keeps.
const MOST_SEEDS: usize = 1000;

fn keep(cvt: &mut Cvt, parts: &mut Parts) -> Result<(), WorkError> {
    if parts.len() >= MOST_SEEDS {
        let text = format!("spec.cvt.commands: more than {MOST_SEEDS} sets of seeds are asked for; ask for fewer");
        return Err(failure(FailureKind::BadInput, text));
    }
    let name = format!("seeds.{:04}", parts.len() + 1);
    parts.push((name, points(&cvt.seeds()?)));
    Ok(())
}
