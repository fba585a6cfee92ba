//! `tessera bench table1`: several models, all backends.
//!
//! Purpose: Table 1 of \[HYWZ17\] laid out the same way, beside what was published: the file of `--published`. Invariant: all
//! backends of a row begin at the same seeds; no published figure that is not in the file. Must not know: how a step is taken.

use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::args::{RunArgs, Worker, mesh, ratio, report};
use super::measure::{Load, Timed};
use crate::exit::{BadInput, Usage};
use crate::files;
use geometry::cvt::density::DensityOptions;
use geometry::mesh::shapes::Shape;
use geometry::remesh::Seeds;
use picture::chart::{Axis, Figure, Panel, Series};
use server::config::count;

#[derive(Args, Debug)]
pub(super) struct Table1Args {
    /// A model, as `remesh` takes it. May be repeated. If not given: a torus, a sphere and a slab with three holes.
    #[arg(long, value_name = "FILE")]
    mesh: Vec<PathBuf>,
    /// Seeds to draw: one number for all models, or one for each; 10000 a file, 15000,20000,50000 otherwise.
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = count)]
    points: Vec<u32>,
    /// The seeds of the one --mesh, `x y z` a line, instead.
    #[arg(long, value_name = "FILE.xyz", conflicts_with = "points", requires = "mesh")]
    seeds: Option<PathBuf>,
    /// Facets of the models that are not files: one number for all, or one for each [default: 20000,69000,100000].
    #[arg(long, value_name = "N", value_delimiter = ',', conflicts_with = "mesh",
          value_parser = count)]
    facets: Vec<u32>,
    #[command(flatten)]
    run: RunArgs,
    /// Figures to put beside: {"source": "...", "rows": [{"mesh", "facets", "points", "gpu_ms", "serial_ms",
    /// "parallel_ms"}]}. Rows go by the name of the model; a figure may be missing.
    #[arg(long, value_name = "FILE.json")]
    published: Option<PathBuf>,
}

/// Models that need no file: shape, facets, points.
const MODELS: [(Shape, u32, u32); 3] =
    [(Shape::Torus, 20_000, 15_000), (Shape::Sphere, 69_000, 20_000), (Shape::Genus(3), 100_000, 50_000)];
/// Seeds on a file, if --points is not given.
const POINTS: u32 = 10_000;

/// The columns of times: name in reports, head.
const COLUMNS: [(&str, &str); 3] = [("gpu", "GPU"), ("serial", "CPU"), ("parallel", "multi-core")];
const NOT_AT_HAND: &str = "not at hand";

struct Model<'a> {
    file: Option<&'a PathBuf>,
    shape: Shape,
    facets: u32,
    points: u32,
}

struct Row {
    load: Load,
    /// In the order of the workers.
    times: Vec<(&'static str, Timed)>,
}

pub(super) fn run(args: &Table1Args) -> Result<()> {
    let token = args.run.begin()?;
    let models = models(args)?;
    let published = args.published.as_deref().map(Published::read).transpose()?.unwrap_or_default();
    let given = args.seeds.as_deref().map(files::read_points).transpose()?;
    let workers = args.run.workers()?;
    outln!("milliseconds per Lloyd step, {} after {}; means", args.run.iterations, args.run.relax)?;
    outln!("{}", head_line())?;
    let mut rows: Vec<Row> = Vec::new();
    for model in &models {
        let seeds = given.clone().map_or_else(|| args.run.drawn(model.points), Seeds::Given);
        let mesh = mesh(model.file.map(PathBuf::as_path), model.shape, model.facets as usize)?;
        let mut load = Load::new(mesh, seeds, DensityOptions::default())?;
        let times = load.time_all(&workers, &args.run, Duration::MAX, &token)?;
        let row = Row { load, times: workers.iter().map(Worker::name).zip(times).collect() };
        outln!("{}", row.line(&published))?;
        rows.push(row);
    }
    close(&published, &rows)?;
    let cases = rows.iter().flat_map(|row| row.times.iter().zip(&workers).map(|((_, t), w)| t.json(&row.load, w)));
    let mut report = report(&workers, cases.collect());
    report["rows"] = rows.iter().map(|row| row.json(&published)).collect::<Vec<_>>().into();
    report["published_source"] = json!(Some(&published.source).filter(|_| args.published.is_some()));
    args.run.output.write(&report, &figure(&rows, &published))
}

fn models(args: &Table1Args) -> Result<Vec<Model<'_>>> {
    let pick = |name: &str, given: &[u32], k: usize, models: usize, default: u32| match given.len() {
        0 => Ok(default),
        1 => Ok(given[0]),
        n if n == models => Ok(given[k]),
        n => Err(Usage(format!("{name}: {n} numbers for {models} models; give one, or one for each"))),
    };
    if args.seeds.is_some() && args.mesh.len() != 1 {
        return Err(Usage(format!("--seeds is for one --mesh, and there are {}", args.mesh.len())).into());
    }
    let mut models = Vec::new();
    for (k, file) in args.mesh.iter().enumerate() {
        let points = pick("--points", &args.points, k, args.mesh.len(), POINTS)?;
        models.push(Model { file: Some(file), shape: Shape::Torus, facets: 0, points });
    }
    if models.is_empty() {
        for (k, &(shape, facets, points)) in MODELS.iter().enumerate() {
            let facets = pick("--facets", &args.facets, k, MODELS.len(), facets)?;
            let points = pick("--points", &args.points, k, MODELS.len(), points)?;
            models.push(Model { file: None, shape, facets, points });
        }
    }
    Ok(models)
}

fn head_line() -> String {
    let mut line = format!("{:<16}{:>9}{:>9}", "model", "facets", "points");
    for (_, head) in COLUMNS {
        line += &format!("{head:>11}");
    }
    line += &format!("{:>9}{:>12}", "CPU/GPU", "multi/GPU");
    line + "   published: GPU, CPU, multi-core, CPU/GPU, multi/GPU"
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |v| format!("{v:.digits$}"))
}

impl Row {
    fn ms(&self, backend: &str) -> Option<f64> {
        self.times.iter().find(|(name, _)| *name == backend).map(|(_, timed)| timed.step_ms().mean)
    }

    /// How much longer one core and all cores take than the GPU.
    fn speedups(&self) -> [Option<f64>; 2] {
        speedups(COLUMNS.map(|(column, _)| self.ms(column)))
    }

    fn line(&self, published: &Published) -> String {
        let Load { name, facets, seeds, .. } = &self.load;
        let mut line = format!("{name:<16}{facets:>9}{:>9}", seeds.len());
        for (column, _) in COLUMNS {
            line += &format!("{:>11}", number(self.ms(column), 3));
        }
        let [one, all] = self.speedups();
        line += &format!("{:>9}{:>12}", number(one, 2), number(all, 2));
        line + "   " + &published.row(name).map_or(NOT_AT_HAND.to_owned(), said)
    }

    fn json(&self, published: &Published) -> Value {
        let [one, all] = self.speedups();
        json!({
            "mesh": self.load.name,
            "facets": self.load.facets,
            "points": self.load.seeds.len(),
            "gpu_ms": self.ms("gpu"),
            "serial_ms": self.ms("serial"),
            "parallel_ms": self.ms("parallel"),
            "speedup_serial": one,
            "speedup_parallel": all,
            "published": published.row(&self.load.name),
        })
    }
}

fn speedups([gpu, serial, parallel]: [Option<f64>; 3]) -> [Option<f64>; 2] {
    [serial, parallel].map(|cpu| ratio(cpu?, gpu?))
}

fn said(row: &PublishedRow) -> String {
    let [gpu, serial, parallel] = row.times().map(|ms| number(ms, 3));
    let [one, all] = speedups(row.times()).map(|ratio| number(ratio, 2));
    format!("{gpu}, {serial}, {parallel}, {one}, {all}")
}

/// What the publication has beside, and where its figures are from.
fn close(published: &Published, rows: &[Row]) -> Result<()> {
    if published.rows.is_empty() {
        outln!("published figures: {NOT_AT_HAND}; --published FILE.json puts them beside")?;
        return Ok(());
    }
    let measured = |mesh: &str| rows.iter().any(|row| row.load.name.eq_ignore_ascii_case(mesh));
    for row in published.rows.iter().filter(|row| !measured(&row.mesh)) {
        let count = |n: Option<u64>| n.map_or("-".to_owned(), |n| n.to_string());
        let (mesh, facets, points) = (&row.mesh, count(row.facets), count(row.points));
        outln!("{mesh:<16}{facets:>9}{points:>9}   not measured; published: {}", said(row))?;
    }
    outln!("published figures: {}", if published.source.is_empty() { "no source given" } else { &published.source })?;
    Ok(())
}

fn figure(rows: &[Row], published: &Published) -> Figure {
    let mut series = Vec::new();
    for (column, head) in COLUMNS {
        let points = rows.iter().enumerate().filter_map(|(k, row)| Some((k as f64, row.ms(column)?)));
        series.push(Series { name: head.to_owned(), points: points.collect() });
    }
    for (column, (_, head)) in COLUMNS.into_iter().enumerate() {
        let time = |row: &Row| published.row(&row.load.name)?.times()[column];
        let points = rows.iter().enumerate().filter_map(|(k, row)| Some((k as f64, time(row)?)));
        series.push(Series { name: format!("{head}, published"), points: points.collect() });
    }
    series.retain(|s| !s.points.is_empty());
    let group = |row: &Row| format!("{} {}/{}", row.load.name, row.load.facets, row.load.seeds.len());
    let panel = Panel {
        x: Axis::linear("model facets/points"),
        y: Axis::log("ms per Lloyd step"),
        series,
        groups: rows.iter().map(group).collect(),
        ..Panel::default()
    };
    Figure { title: "Lloyd steps by model and backend".to_owned(), panels: vec![panel] }
}

/// One row of the table, milliseconds.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct PublishedRow {
    /// The model: a file's name without ending, in any case.
    mesh: String,
    facets: Option<u64>,
    points: Option<u64>,
    gpu_ms: Option<f64>,
    serial_ms: Option<f64>,
    parallel_ms: Option<f64>,
}

impl PublishedRow {
    /// Times of the GPU, one core and all cores.
    fn times(&self) -> [Option<f64>; 3] {
        [self.gpu_ms, self.serial_ms, self.parallel_ms]
    }
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Published {
    #[serde(default)]
    source: String,
    rows: Vec<PublishedRow>,
}

impl Published {
    fn read(path: &Path) -> Result<Self> {
        let bad = |text: String| BadInput(format!("{}: {text}", path.display()));
        let text = files::read_text(path)?;
        let published: Self = serde_json::from_str(&text).map_err(|e| {
            bad(format!(
                "{e}; it should be {{\"source\": \"...\", \"rows\": [{{\"mesh\": \"bunny\", \"gpu_ms\": 1.5, ...}}]}}"
            ))
        })?;
        let times = published.rows.iter().flat_map(PublishedRow::times).flatten();
        let wrong = times.into_iter().find(|ms| !(ms.is_finite() && *ms > 0.0));
        let Some(ms) = wrong else { return Ok(published) };
        Err(bad(format!("{ms} is no time; milliseconds are above 0")).into())
    }

    fn row(&self, mesh: &str) -> Option<&PublishedRow> {
        self.rows.iter().find(|row| row.mesh.eq_ignore_ascii_case(mesh))
    }
}
