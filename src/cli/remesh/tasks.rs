//! What `tessera remesh` reads and writes: one file, or many into a folder.
//!
//! Invariant: what cannot be is refused before any work. No output replaces an input unasked, or another output. Must not know:
//! how a remesh is made.

use std::path::{Path, PathBuf};

use anyhow::Result;

use super::args::{FileArgs, RemeshArgs};
use crate::exit::{NotWritten, Usage};
use crate::files::{self, Surface};

#[derive(Debug)]
pub(super) struct Task {
    pub(super) input: Surface,
    pub(super) output: Surface,
}

pub(super) fn of(args: &RemeshArgs) -> Result<Vec<Task>> {
    args.backend.check()?;
    args.picture.check()?;
    args.asked()?;
    check_together(args)?;
    let FileArgs { output, out_dir, report, .. } = &args.files;
    report.iter().try_for_each(|path| files::check_output(path, &[]))?;
    if let Some(folder) = out_dir {
        std::fs::create_dir_all(folder)
            .map_err(|error| NotWritten(format!("cannot make the folder {}: {error}", folder.display())))?;
    }
    let tasks = args.input.iter().map(|path| task(args, path, output.as_deref())).collect::<Result<Vec<_>>>()?;
    check_files(args, &tasks)?;
    Ok(tasks)
}

fn check_together(args: &RemeshArgs) -> Result<()> {
    let FileArgs { output, out_dir, report, .. } = &args.files;
    let is_standard = |path: &PathBuf| path.as_os_str() == "-";
    let (several, reads_standard) = (args.input.len() > 1, args.input.iter().any(is_standard));
    let for_one = |option: &str| format!("there are several inputs, and {option} is for one");
    let refused = [
        (
            several && out_dir.is_none(),
            "there are several inputs, and one output; give --out-dir instead of -o".to_owned(),
        ),
        (several && report.is_some(), for_one("--report") + "; --json prints a report a line"),
        (several && args.size.sizes.is_some(), for_one("--sizes")),
        (several && args.size.metric.is_some(), for_one("--metric")),
        (several && args.shape.has_crease_files(), for_one("--creases FILE")),
        (several && args.picture.picture.is_some(), for_one("--picture")),
        (several && reads_standard, "- is the standard input; it goes with no other input".to_owned()),
        (
            args.say.json && output.as_ref().is_some_and(is_standard),
            "-o - and --json both write to the standard output; give --report instead of --json".to_owned(),
        ),
        (
            out_dir.is_some() && reads_standard,
            "the standard input has no name; give -o instead of --out-dir".to_owned(),
        ),
    ];
    let wrong = refused.into_iter().find(|(is_wrong, _)| *is_wrong);
    wrong.map_or(Ok(()), |(_, text)| Err(Usage(text).into()))
}

fn task(args: &RemeshArgs, path: &Path, output: Option<&Path>) -> Result<Task> {
    let FileArgs { out_dir, format, input_format, .. } = &args.files;
    let input = Surface::new(path, *input_format);
    input.format(files::INPUT_FORMAT)?;
    let output = match (output, out_dir) {
        (Some(output), _) => Surface::new(output, *format),
        (None, folder) => {
            let folder = folder.as_deref().unwrap_or(Path::new("."));
            Surface::new(&place(folder, path, *format)?, format.or(*input_format))
        }
    };
    output.check_output()?;
    Ok(Task { input, output })
}

/// Where the remesh of a file goes in a folder: under its own name, with the extension of the format if that is another.
fn place(folder: &Path, input: &Path, format: Option<geometry::mesh::io::Format>) -> Result<PathBuf> {
    let Some(name) = input.file_name() else {
        return Err(Usage(format!("{}: this is no file", input.display())).into());
    };
    let mut name = PathBuf::from(name);
    if let Some(format) = format {
        if name.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz")) {
            name.set_extension("");
        }
        name.set_extension(format.extension());
    }
    Ok(folder.join(name))
}

/// Refuses outputs that would replace what is needed, or each other.
fn check_files(args: &RemeshArgs, tasks: &[Task]) -> Result<()> {
    let RemeshArgs { files: FileArgs { report, overwrite, .. }, size, shape, picture, .. } = args;
    let lists = [size.sizes.as_deref(), size.metric.as_deref()];
    let named = || shape.crease_files().chain(lists.into_iter().flatten());
    for Task { input, output } in tasks {
        if !output.is_standard() && files::same(input.path(), output.path()) && !overwrite {
            return Err(Usage(format!(
                "{output} is the input, and the remesh would replace it; name another output, or add --overwrite"
            ))
            .into());
        }
        let numbers = [
            (size.sizes.is_some(), "--sizes"),
            (size.metric.is_some(), "--metric"),
            (shape.has_crease_files(), "--creases"),
        ];
        for (_, option) in numbers.iter().filter(|(is_given, _)| *is_given) {
            files::check_numbered(input, option)?;
        }
    }
    let paths = |of: fn(&Task) -> &Surface| tasks.iter().map(of).filter(|one| !one.is_standard()).map(Surface::path);
    let outputs = || paths(|task| &task.output);
    // An input may be the output of its own task alone.
    let inputs = paths(|task| &task.input);
    files::check_apart(named(), outputs())?;
    let kept: Vec<&Path> = inputs.chain(outputs()).chain(named()).collect();
    files::check_apart(kept.into_iter(), [report.as_deref(), picture.picture.as_deref()].into_iter().flatten())?;
    tasks.iter().try_for_each(|task| check_others(task, tasks))
}

/// Refuses a task whose output is the input of another.
fn check_others(task: &Task, tasks: &[Task]) -> Result<()> {
    let others = tasks.iter().filter(|other| !std::ptr::eq(*other, task));
    for other in others {
        if files::same(task.output.path(), other.input.path()) {
            let text = format!("{} is an input, and the remesh of {} would replace it", other.input, task.input);
            return Err(Usage(text).into());
        }
    }
    Ok(())
}
