//! Specifications of jobs, both ways.
//!
//! Invariant: patterns name every field, so that a new option does not compile until it is here.

use proto::cvt_job_command::Command;
use proto::job_mesh::Source as MeshOneof;
use proto::job_refinement::Tolerance as ToleranceOneof;
use proto::job_seeds::Source as SeedsOneof;
use proto::job_spec::Work as WorkOneof;
use proto::result_format::Form;

use super::{At, Choice, digest, duration, duration_ms};
use jobs::record::{
    ArrayRef, AttributeRef, CvtCommand, CvtWork, Deadlines, DensitySpec, JobSpec, MeshFormat, MeshSource, RefineSpec,
    RemeshWork, ResultFormat, RvdOutput, RvdWork, SeedChange, SeedSource, Tolerance, WorkSpec,
};
use wire::{WireError, proto};

type Read<T> = Result<T, WireError>;

/// The record of a message; the tenant and the request's number come from elsewhere.
pub(in crate::service) fn of(spec: Option<proto::JobSpec>, tenant: String, request_id: String) -> Read<JobSpec> {
    let at = At::Top("spec");
    let spec = at.need(spec, "say what the job is to do")?;
    let proto::JobSpec { mesh, work, backend, result, priority, queue_deadline, run_deadline, labels } = spec;
    let work = match at.to("work").need(work, "give remesh, rvd or cvt")? {
        WorkOneof::Remesh(work) => WorkSpec::Remesh(Box::new(remesh(&at.to("remesh"), work)?)),
        WorkOneof::Rvd(work) => WorkSpec::Rvd(rvd(&at.to("rvd"), work)?),
        WorkOneof::Cvt(work) => WorkSpec::Cvt(cvt(&at.to("cvt"), work)?),
    };
    let ms = |name, limit: Option<_>| limit.map(|limit| duration_ms(&at.to(name), limit)).transpose();
    Ok(JobSpec {
        mesh: mesh_source(&at.to("mesh"), mesh)?,
        work,
        backend: Choice::choice(&at.to("backend"), backend)?,
        result: result_format(&at.to("result"), result)?,
        priority,
        deadlines: Deadlines {
            queue_ms: ms("queue_deadline", queue_deadline)?,
            run_ms: ms("run_deadline", run_deadline)?,
        },
        labels: labels.into_iter().collect(),
        tenant,
        request_id,
    })
}

/// The message of a record, without its tenant and its request's number.
pub(in crate::service) fn message(spec: &JobSpec) -> proto::JobSpec {
    let JobSpec { mesh, work, backend, result, priority, deadlines, labels, tenant: _, request_id: _ } = spec;
    let Deadlines { queue_ms, run_ms } = *deadlines;
    proto::JobSpec {
        mesh: Some(mesh_message(mesh)),
        work: Some(match work {
            WorkSpec::Remesh(work) => WorkOneof::Remesh(remesh_message(work)),
            WorkSpec::Rvd(work) => WorkOneof::Rvd(rvd_message(work)),
            WorkSpec::Cvt(work) => WorkOneof::Cvt(cvt_message(work)),
        }),
        backend: Choice::value_of(*backend),
        result: result.map(|result| proto::ResultFormat {
            form: Some(match result {
                ResultFormat::File(format) => Form::File(format.value()),
                ResultFormat::Arrays => Form::Arrays(true),
            }),
        }),
        priority: *priority,
        queue_deadline: queue_ms.map(duration),
        run_deadline: run_ms.map(duration),
        labels: labels.iter().map(|(key, value)| (key.clone(), value.clone())).collect(),
    }
}

/// The path in a message of a field that a record's check names.
pub(in crate::service) fn path_of(field: &str) -> String {
    let field = field.strip_prefix("work.").unwrap_or(field);
    let path = match field {
        // No part of the specification in messages.
        "request_id" => return field.to_owned(),
        "tenant" => return "tessera-tenant".to_owned(),
        "" => return "spec".to_owned(),
        "deadlines.queue_ms" => "queue_deadline".to_owned(),
        "deadlines.run_ms" => "run_deadline".to_owned(),
        // A key of a label may look like anything.
        _ if field.starts_with("labels") => field.to_owned(),
        _ => field.replace("seeds.sampled", "seeds.drawn").replace("refinement.tolerance.", "refinement."),
    };
    format!("spec.{path}")
}

fn result_format(at: &At<'_>, result: Option<proto::ResultFormat>) -> Read<Option<ResultFormat>> {
    Ok(match result.and_then(|result| result.form) {
        None => None,
        Some(Form::File(format)) => {
            let format = MeshFormat::choice(&at.to("file"), format)?;
            Some(ResultFormat::File(format.unwrap_or(MeshFormat::Ply)))
        }
        Some(Form::Arrays(true)) => Some(ResultFormat::Arrays),
        Some(Form::Arrays(false)) => return Err(at.to("arrays").wrong("is false; set it to true, or give file")),
    })
}

fn mesh_source(at: &At<'_>, mesh: Option<proto::JobMesh>) -> Read<MeshSource> {
    let mesh = at.need(mesh, "say where the surface is")?;
    match at.to("source").need(mesh.source, "give file or arrays")? {
        MeshOneof::File(proto::MeshFile { digest: blob, format, attributes }) => {
            let at = at.to("file");
            let blob = digest(&at.to("digest"), &blob)?;
            Ok(MeshSource::File { blob, format: Choice::chosen(&at.to("format"), format)?, attributes })
        }
        MeshOneof::Arrays(proto::MeshArrays { positions, facets, attributes }) => {
            let at = at.to("arrays");
            let carried = at.to("attributes");
            let attributes = attributes.into_iter().enumerate();
            Ok(MeshSource::Arrays {
                positions: needed(&at.to("positions"), positions)?,
                facets: needed(&at.to("facets"), facets)?,
                attributes: attributes.map(|(i, given)| attribute(&carried.item(i), given)).collect::<Read<_>>()?,
            })
        }
    }
}

fn mesh_message(mesh: &MeshSource) -> proto::JobMesh {
    let source = match mesh {
        MeshSource::File { blob, format, attributes } => {
            let (digest, format) = (blob.to_string(), format.value());
            MeshOneof::File(proto::MeshFile { digest, format, attributes: *attributes })
        }
        MeshSource::Arrays { positions, facets, attributes } => MeshOneof::Arrays(proto::MeshArrays {
            positions: Some(array_message(*positions)),
            facets: Some(array_message(*facets)),
            attributes: attributes.iter().map(attribute_message).collect(),
        }),
    };
    proto::JobMesh { source: Some(source) }
}

fn attribute(at: &At<'_>, given: proto::AttributeArrays) -> Read<AttributeRef> {
    let proto::AttributeArrays { kind, name, values, corners } = given;
    Ok(AttributeRef {
        kind: Choice::chosen(&at.to("kind"), kind)?,
        name,
        values: needed(&at.to("values"), values)?,
        corners: array(&at.to("corners"), corners)?,
    })
}

fn attribute_message(attribute: &AttributeRef) -> proto::AttributeArrays {
    let AttributeRef { kind, name, values, corners } = attribute;
    proto::AttributeArrays {
        kind: kind.value(),
        name: name.clone(),
        values: Some(array_message(*values)),
        corners: corners.map(array_message),
    }
}

fn array(at: &At<'_>, array: Option<proto::ArrayRef>) -> Read<Option<ArrayRef>> {
    let Some(proto::ArrayRef { digest: blob, form, count }) = array else { return Ok(None) };
    let blob = digest(&at.to("digest"), &blob)?;
    Ok(Some(ArrayRef { blob, form: Choice::chosen(&at.to("form"), form)?, count }))
}

fn needed(at: &At<'_>, given: Option<proto::ArrayRef>) -> Read<ArrayRef> {
    at.need(array(at, given)?, "name a blob")
}

fn array_message(array: ArrayRef) -> proto::ArrayRef {
    let ArrayRef { blob, form, count } = array;
    proto::ArrayRef { digest: blob.to_string(), form: form.value(), count }
}

fn seeds(at: &At<'_>, seeds: Option<proto::JobSeeds>) -> Read<SeedSource> {
    match at.need(seeds.and_then(|seeds| seeds.source), "give drawn or given")? {
        SeedsOneof::Drawn(proto::DrawnSeeds { points, random_seed }) => Ok(SeedSource::Sampled { points, random_seed }),
        SeedsOneof::Given(given) => Ok(SeedSource::Given(needed(&at.to("given"), Some(given))?)),
    }
}

fn seeds_message(seeds: SeedSource) -> proto::JobSeeds {
    let source = match seeds {
        SeedSource::Sampled { points, random_seed } => SeedsOneof::Drawn(proto::DrawnSeeds { points, random_seed }),
        SeedSource::Given(given) => SeedsOneof::Given(array_message(given)),
    };
    proto::JobSeeds { source: Some(source) }
}

fn density(at: &At<'_>, density: Option<proto::JobDensity>) -> Read<DensitySpec> {
    let Some(density) = density else { return Ok(DensitySpec::default()) };
    let proto::JobDensity { source, edge_length, edge_lengths, weights, adaptivity, gradation } = density;
    Ok(DensitySpec {
        source: Choice::choice(&at.to("source"), source)?,
        edge_length,
        edge_lengths: array(&at.to("edge_lengths"), edge_lengths)?,
        weights: array(&at.to("weights"), weights)?,
        adaptivity,
        gradation,
    })
}

fn density_message(density: DensitySpec) -> Option<proto::JobDensity> {
    let DensitySpec { source, edge_length, edge_lengths, weights, adaptivity, gradation } = density;
    (density != DensitySpec::default()).then(|| proto::JobDensity {
        source: Choice::value_of(source),
        edge_length,
        edge_lengths: edge_lengths.map(array_message),
        weights: weights.map(array_message),
        adaptivity,
        gradation,
    })
}

fn refinement(at: &At<'_>, refinement: proto::JobRefinement) -> Read<RefineSpec> {
    let proto::JobRefinement { max_points, tolerance } = refinement;
    let tolerance = match at.to("tolerance").need(tolerance, "give length or diagonal_percent")? {
        ToleranceOneof::Length(length) => Tolerance::Length(length),
        ToleranceOneof::DiagonalPercent(percent) => Tolerance::DiagonalPercent(percent),
    };
    Ok(RefineSpec { tolerance, max_points })
}

fn refinement_message(refinement: RefineSpec) -> proto::JobRefinement {
    let RefineSpec { tolerance, max_points } = refinement;
    let tolerance = match tolerance {
        Tolerance::Length(length) => ToleranceOneof::Length(length),
        Tolerance::DiagonalPercent(percent) => ToleranceOneof::DiagonalPercent(percent),
    };
    proto::JobRefinement { max_points, tolerance: Some(tolerance) }
}

fn remesh(at: &At<'_>, work: proto::RemeshJob) -> Read<RemeshWork> {
    let proto::RemeshJob {
        seeds: source,
        density: lengths,
        lloyd_steps,
        newton_steps,
        projection,
        placement,
        crease_angle_deg,
        creases,
        boundaries,
        thin,
        refinement: refined,
        measure,
    } = work;
    Ok(RemeshWork {
        seeds: seeds(&at.to("seeds"), source)?,
        density: density(&at.to("density"), lengths)?,
        lloyd_steps,
        newton_steps,
        projection: Choice::choice(&at.to("projection"), projection)?,
        placement: Choice::choice(&at.to("placement"), placement)?,
        crease_angle_deg,
        creases: array(&at.to("creases"), creases)?,
        boundaries: Choice::choice(&at.to("boundaries"), boundaries)?,
        thin: Choice::choice(&at.to("thin"), thin)?,
        refinement: refined.map(|refined| refinement(&at.to("refinement"), refined)).transpose()?,
        measure: Choice::choice(&at.to("measure"), measure)?,
    })
}

fn remesh_message(work: &RemeshWork) -> proto::RemeshJob {
    let RemeshWork {
        seeds,
        density,
        lloyd_steps,
        newton_steps,
        projection,
        placement,
        crease_angle_deg,
        creases,
        boundaries,
        thin,
        refinement,
        measure,
    } = *work;
    proto::RemeshJob {
        seeds: Some(seeds_message(seeds)),
        density: density_message(density),
        lloyd_steps,
        newton_steps,
        projection: Choice::value_of(projection),
        placement: Choice::value_of(placement),
        crease_angle_deg,
        creases: creases.map(array_message),
        boundaries: Choice::value_of(boundaries),
        thin: Choice::value_of(thin),
        refinement: refinement.map(refinement_message),
        measure: Choice::value_of(measure),
    }
}

fn rvd(at: &At<'_>, work: proto::RvdJob) -> Read<RvdWork> {
    let proto::RvdJob { seeds: source, weights, outputs } = work;
    let wanted = at.to("outputs");
    let output = |(i, value)| RvdOutput::chosen(&wanted.item(i), value);
    Ok(RvdWork {
        seeds: seeds(&at.to("seeds"), source)?,
        weights: array(&at.to("weights"), weights)?,
        outputs: outputs.into_iter().enumerate().map(output).collect::<Read<_>>()?,
    })
}

fn rvd_message(work: &RvdWork) -> proto::RvdJob {
    let RvdWork { seeds, weights, outputs } = work;
    proto::RvdJob {
        seeds: Some(seeds_message(*seeds)),
        weights: weights.map(array_message),
        outputs: outputs.iter().map(|output| output.value()).collect(),
    }
}

fn cvt(at: &At<'_>, work: proto::CvtJob) -> Read<CvtWork> {
    let proto::CvtJob { seeds: source, density: lengths, projection, max_seeds, commands } = work;
    let row = at.to("commands");
    let commands = commands.into_iter().enumerate();
    Ok(CvtWork {
        seeds: seeds(&at.to("seeds"), source)?,
        density: density(&at.to("density"), lengths)?,
        projection: Choice::choice(&at.to("projection"), projection)?,
        max_seeds,
        commands: commands.map(|(i, given)| command(&row.item(i), given)).collect::<Read<_>>()?,
    })
}

fn cvt_message(work: &CvtWork) -> proto::CvtJob {
    let CvtWork { seeds, density, projection, max_seeds, commands } = work;
    proto::CvtJob {
        seeds: Some(seeds_message(*seeds)),
        density: density_message(*density),
        projection: Choice::value_of(*projection),
        max_seeds: *max_seeds,
        commands: commands.iter().map(command_message).collect(),
    }
}

fn command(at: &At<'_>, given: proto::CvtJobCommand) -> Read<CvtCommand> {
    match at.need(given.command, "give step or edit")? {
        Command::Step(proto::CvtStep { iterations, seeds, kind }) => {
            let at = at.to("step");
            let kind = Choice::choice(&at.to("kind"), kind)?;
            Ok(CvtCommand::Step { iterations, kind, seeds: Choice::choice(&at.to("seeds"), seeds)? })
        }
        Command::Edit(proto::CvtEdit { edits, seeds }) => {
            let at = at.to("edit");
            let row = at.to("edits");
            let edits = edits.into_iter().enumerate().map(|(i, edit)| change(&row.item(i), edit));
            let edits = edits.collect::<Read<_>>()?;
            Ok(CvtCommand::Edit { edits, seeds: Choice::choice(&at.to("seeds"), seeds)? })
        }
    }
}

fn command_message(command: &CvtCommand) -> proto::CvtJobCommand {
    let command = match command {
        CvtCommand::Step { iterations, kind, seeds } => Command::Step(proto::CvtStep {
            iterations: *iterations,
            seeds: Choice::value_of(*seeds),
            kind: Choice::value_of(*kind),
        }),
        CvtCommand::Edit { edits, seeds } => Command::Edit(proto::CvtEdit {
            edits: edits.iter().map(|edit| change_message(*edit)).collect(),
            seeds: Choice::value_of(*seeds),
        }),
    };
    proto::CvtJobCommand { command: Some(command) }
}

fn change(at: &At<'_>, edit: proto::SeedEdit) -> Read<SeedChange> {
    use proto::seed_edit::Edit;
    let point = |proto::Point { x, y, z }| [x, y, z];
    match at.need(edit.edit, "give move, add or remove")? {
        Edit::Move(proto::MoveSeed { index, to }) => {
            let to = at.to("move").to("to").need(to, "say where the seed goes")?;
            Ok(SeedChange::Move { index, to: point(to) })
        }
        Edit::Add(to) => Ok(SeedChange::Add(point(to))),
        Edit::Remove(index) => Ok(SeedChange::Remove(index)),
    }
}

fn change_message(change: SeedChange) -> proto::SeedEdit {
    use proto::seed_edit::Edit;
    let point = |[x, y, z]: [f64; 3]| proto::Point { x, y, z };
    let edit = match change {
        SeedChange::Move { index, to } => Edit::Move(proto::MoveSeed { index, to: Some(point(to)) }),
        SeedChange::Add(to) => Edit::Add(point(to)),
        SeedChange::Remove(index) => Edit::Remove(index),
    };
    proto::SeedEdit { edit: Some(edit) }
}
