//! Options of every benchmark.
//!
//! Purpose: one set of options for all benchmarks: surface, seeds, steps, backend and files of figures.
//! Invariant: a file that cannot be written is refused before anything is measured. Must not know: what is measured.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;

use super::output::OutputArgs;
use super::worker::Worker;
use crate::{files, interrupt};
use geometry::mesh::TriMesh;
use geometry::mesh::shapes::Shape;
use geometry::remesh::Seeds;
use geometry::token::Token;
pub(super) use server::config::{BackendArgs, count, whole};

/// One surface.
#[derive(Args, Debug)]
pub(super) struct SurfaceArgs {
    /// The surface, as `remesh` takes it; a torus if not given.
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Facets of the torus.
    #[arg(long, value_name = "N", default_value_t = 20_000, conflicts_with = "mesh", value_parser = count)]
    facets: u32,
}

impl SurfaceArgs {
    pub(super) fn mesh(&self) -> Result<(String, TriMesh)> {
        mesh(self.mesh.as_deref(), Shape::Torus, self.facets as usize)
    }
}

/// One set of seeds.
#[derive(Args, Debug)]
pub(super) struct SeedsArgs {
    /// Seeds to draw.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = count)]
    points: u32,
    /// The seeds, `x y z` a line, instead.
    #[arg(long, value_name = "FILE.xyz", conflicts_with = "points")]
    seeds: Option<PathBuf>,
}

impl SeedsArgs {
    /// Those of the file, or such as are to be drawn.
    pub(super) fn seeds(&self, run: &RunArgs) -> Result<Seeds> {
        match &self.seeds {
            Some(path) => Ok(Seeds::Given(files::read_points(path)?)),
            None => Ok(run.drawn(self.points)),
        }
    }
}

/// How a benchmark runs.
#[derive(Args, Debug)]
pub(super) struct RunArgs {
    /// Random seed of the points.
    #[arg(long, value_name = "N", default_value_t = Seeds::RANDOM_SEED, value_parser = whole::<u64>)]
    seed: u64,
    /// Lloyd steps before anything is timed; what warms up comes after them.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = whole::<u32>)]
    pub(super) relax: u32,
    /// Steps of each kind that are timed.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = count)]
    pub(super) iterations: u32,
    #[command(flatten)]
    backend: BackendArgs,
    #[command(flatten)]
    pub(super) output: OutputArgs,
}

impl RunArgs {
    /// Checks what can be checked before anything is read. Returns the token of the process.
    pub(super) fn begin(&self) -> Result<Token> {
        self.backend.check()?;
        self.output.check()?;
        token()
    }

    pub(super) fn drawn(&self, points: u32) -> Seeds {
        Seeds::Sample { points: points as usize, seed: self.seed }
    }

    pub(super) fn worker(&self) -> Result<Worker> {
        Worker::one(&self.backend)
    }

    /// All backends, or the one that is asked for; they are named in a line each, and keep time.
    pub(super) fn workers(&self) -> Result<Vec<Worker>> {
        let mut workers = Worker::all(&self.backend)?;
        workers.iter_mut().try_for_each(Worker::keep_time)?;
        workers.iter().try_for_each(|worker| outln!("{}", worker.describe()))?;
        Ok(workers)
    }
}

/// Set by Ctrl-C.
pub(super) fn token() -> Result<Token> {
    let token = Token::default();
    interrupt::cancel_on_signal(&token).context("cannot listen for signals")?;
    Ok(token)
}

/// A mesh and its name: a file's, or a shape of about `facets` facets.
pub(super) fn mesh(file: Option<&Path>, shape: Shape, facets: usize) -> Result<(String, TriMesh)> {
    Ok(match file {
        Some(path) => (path.file_stem().unwrap_or_default().to_string_lossy().into_owned(), files::read_mesh(path)?),
        None => (shape.to_string(), shape.build(facets)),
    })
}
