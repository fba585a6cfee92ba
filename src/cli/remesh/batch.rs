//! Many files in one run.
//!
//! Invariant: a file that fails stops no other. Each has one line, on the standard output if it was remeshed, else on the
//! standard error stream; the exit code is that of the first failure. Must not know: how a remesh is made.

use anyhow::Result;
use serde_json::{Value, json};

use super::tasks::Task;
use super::{RemeshArgs, Remeshed, Worker, one};
use crate::exit::{self, NotWritten};
use crate::progress::Progress;
use crate::{interrupt, plain, say};

/// Remeshes them, one after the other: each has all threads.
///
/// # Errors
/// The first failure, after all were tried; a signal or an output that cannot be written, at once.
pub(super) fn run(args: &RemeshArgs, tasks: &[Task], mut worker: Worker) -> Result<()> {
    worker.listen()?;
    let sizes: Vec<u64> = tasks.iter().map(size).collect();
    let total = sizes.iter().sum::<u64>() as f64;
    let mut progress = Progress::begin(std::path::Path::new("batch"), args.say.quiet);
    let (mut failed, mut first, mut before) = (0, None, 0);
    for (k, (task, bytes)) in tasks.iter().zip(sizes).enumerate() {
        let span = (before as f64 / total, (before + bytes) as f64 / total);
        progress.next(&format!("{} of {}, {}", k + 1, tasks.len(), task.input), span);
        before += bytes;
        worker.token.check()?;
        match one(args, task, &mut worker, &mut progress, false) {
            Ok(done) => told(args, task, &done, &progress)?,
            Err(error) => {
                let code = exit::code(&error);
                if code == interrupt::CODE {
                    return Err(error);
                }
                failed += 1;
                progress.note(&format!("tessera: {}: {}", task.input, plain::lines(&format!("{error:#}"))));
                if args.say.json {
                    let line = json!({ "input": name(task), "error": format!("{error:#}"), "exit_code": code });
                    progress.aside(|| say::json_line(&line))?;
                }
                first.get_or_insert(error);
            }
        }
    }
    drop(progress);
    let all = tasks.len();
    if args.say.summary() {
        outln!("{} of {all} files remeshed", all - failed)?;
    }
    first.map_or(Ok(()), |error| Err(error.context(format!("{failed} of {all} files failed, the first"))))
}

fn name(task: &Task) -> String {
    task.input.to_string()
}

/// Bytes of an input, for the bar; a file that is not there has few.
fn size(task: &Task) -> u64 {
    std::fs::metadata(task.input.path()).map_or(1, |meta| meta.len().max(1))
}

fn told(args: &RemeshArgs, task: &Task, done: &Remeshed, progress: &Progress) -> Result<(), NotWritten> {
    done.left_out.iter().for_each(|note| progress.note(note));
    if args.say.json {
        let mut line = json!({ "input": name(task), "output": task.output.to_string() });
        line["report"] = done.report.clone();
        progress.aside(|| say::json_line(&line))?;
    }
    if args.say.summary() {
        progress.aside(|| outln!("{}", summary(task, done)))?;
    }
    Ok(())
}

fn summary(task: &Task, done: &Remeshed) -> String {
    let at = |pointer: &str| done.report.pointer(pointer).unwrap_or(&Value::Null);
    let count = |pointer: &str| at(pointer).as_u64().unwrap_or(0);
    let mut line = format!(
        "{} -> {}: {} vertices, {} facets",
        task.input,
        task.output,
        count("/result/vertices"),
        count("/result/facets")
    );
    if let Some(angle) = at("/result/theta_min_deg").as_f64() {
        line += &format!(", angle min {angle:.2}°");
    }
    if let Some(distance) = at("/result/hausdorff_percent").as_f64() {
        line += &format!(", Hausdorff {distance:.4} %");
    }
    line + &format!(", {:.0} ms", done.total_ms)
}
