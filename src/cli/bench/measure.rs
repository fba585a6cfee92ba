//! Steps that are timed.
//!
//! Purpose: a surface with seeds ([`Load`]), and the steps that are taken and timed on it ([`Timed`]). Invariant: workers
//! that are compared begin at the same seeds. What warms up is not counted. Must not know: tables, plots.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anyhow::Result;
use glam::DVec3;
use serde::Serialize;
use serde_json::{Value, json};

use super::args::{RunArgs, Worker};
use geometry::cvt::density::DensityOptions;
use geometry::cvt::{Cvt, CvtOptions, Iteration, StepKind};
use geometry::mesh::TriMesh;
use geometry::remesh::Seeds;
use geometry::rvd::{DeviceWork, Surface};
use geometry::token::Token;
use jobs::executor::prepared::{Input, Prepared};

/// Steps of a kind before the first that is timed: buffers and rows of neighbours get their sizes.
const WARM_UP: usize = 2;
/// Steps that are timed whatever a limit says.
const FEWEST: usize = 3;

pub(super) struct Load {
    pub(super) name: String,
    pub(super) surface: Arc<Surface>,
    /// How many facets the mesh has; the surface's may be divided.
    pub(super) facets: usize,
    /// Caller's coordinates.
    pub(super) seeds: Vec<DVec3>,
    /// "uniform", "curvature" or "lfs".
    pub(super) density: &'static str,
    /// Lloyd steps that the seeds were moved by.
    pub(super) relaxed: usize,
}

impl Load {
    /// Prepares the surface as a remesh does, and draws the seeds, if they are to be drawn.
    pub(super) fn new((name, mesh): (String, TriMesh), seeds: Seeds, density: DensityOptions) -> Result<Self> {
        let (source, facets) = (density.source.name(), mesh.facets().len());
        let input = Input { mesh, density, seeds, creases: Vec::new(), attributes: None };
        let Prepared { surface, seeds, .. } = Prepared::for_steps(input, &Token::default())?;
        Ok(Self { name, surface, facets, seeds: seeds.to_vec(), density: source, relaxed: 0 })
    }

    /// The surface as it was prepared: its facets may have been divided for a density.
    pub(super) fn mesh(&self) -> Result<TriMesh> {
        let positions = self.surface.positions().iter().map(|&p| self.surface.frame().to_world(p)).collect();
        Ok(TriMesh::new(positions, self.surface.facets().to_vec())?)
    }

    /// Moves the seeds by `steps` Lloyd steps, fewer if `limit` is over.
    pub(super) fn relax(&mut self, by: &Worker, steps: usize, limit: Duration, token: &Token) -> Result<()> {
        let begin = Instant::now();
        let mut cvt = self.cvt(by)?;
        let mut taken = 0;
        while taken < steps && begin.elapsed() < limit {
            taken += cvt.relax(steps - taken, token)?.len();
        }
        if taken > 0 {
            self.seeds = cvt.seeds()?;
        }
        self.relaxed += taken;
        Ok(())
    }

    fn cvt(&self, by: &Worker) -> Result<Cvt> {
        let surface = Arc::clone(&self.surface);
        Ok(Cvt::new(by.backend.as_ref(), surface, &self.seeds, CvtOptions::default())?)
    }

    /// Relaxes the seeds on the first of some workers, and times Lloyd steps on all of them.
    pub(super) fn time_all<'a>(
        &mut self,
        workers: impl IntoIterator<Item = &'a Worker>,
        run: &RunArgs,
        limit: Duration,
        token: &Token,
    ) -> Result<Vec<Timed>> {
        let mut all = Vec::new();
        for (k, worker) in workers.into_iter().enumerate() {
            if k == 0 {
                self.relax(worker, run.relax as usize, limit, token)?;
            }
            all.push(self.time(worker, StepKind::Lloyd, run.iterations as usize, limit, token)?);
        }
        Ok(all)
    }

    /// Takes `steps` steps that are timed, and some before them that are not; fewer, but three, if `limit` is over.
    pub(super) fn time(
        &self,
        by: &Worker,
        kind: StepKind,
        steps: usize,
        limit: Duration,
        token: &Token,
    ) -> Result<Timed> {
        let mut cvt = self.cvt(by)?;
        let mut take = |most| match kind {
            StepKind::Lloyd => cvt.relax(most, token),
            StepKind::Lbfgs => cvt.lbfgs(token).map(|step| vec![step]),
        };
        let begin = Instant::now();
        let mut warmed = 0;
        while warmed < WARM_UP {
            warmed += take(WARM_UP - warmed)?.len();
        }
        let (first, mut taken) = (Instant::now(), Vec::with_capacity(steps));
        while taken.len() < steps && (taken.len() < FEWEST || begin.elapsed() < limit) {
            taken.append(&mut take(steps - taken.len())?);
        }
        let total_ms = first.elapsed().as_secs_f64() * 1e3;
        let cut = taken.len() < steps && taken.len() <= FEWEST;
        let last = cvt.present(token)?;
        Ok(Timed { kind, steps: taken, total_ms, cut, energy_ratio: last.energy_ratio, seeds: cvt.seeds()? })
    }
}

pub(super) struct Timed {
    /// As was asked for; a step that failed as such is one of Lloyd's.
    pub(super) kind: StepKind,
    pub(super) steps: Vec<Iteration>,
    /// From the first to the last.
    pub(super) total_ms: f64,
    /// A limit ended it after the fewest steps.
    pub(super) cut: bool,
    /// After the last.
    pub(super) energy_ratio: f64,
    /// The same, caller's coordinates.
    pub(super) seeds: Vec<DVec3>,
}

/// Names of the phases, and what else a step takes.
pub(super) const PHASES: [&str; 5] = ["neighbours", "start", "clip", "update", "rest"];

impl Timed {
    /// Those of several rounds, each of which began at the same seeds.
    pub(super) fn joined<'a>(kind: StepKind, rounds: impl Iterator<Item = &'a Self>) -> Self {
        let none = Self { kind, steps: Vec::new(), total_ms: 0.0, cut: false, energy_ratio: 0.0, seeds: Vec::new() };
        rounds.fold(none, |mut all, round| {
            all.steps.extend_from_slice(&round.steps);
            all.total_ms += round.total_ms;
            all.cut |= round.cut;
            Self { energy_ratio: round.energy_ratio, ..all }
        })
    }

    pub(super) fn step_ms(&self) -> Spread {
        Spread::of(self.steps.iter().map(|s| s.ms))
    }

    /// Times of the steps by their evaluations: passes over the diagram and what follows from each.
    pub(super) fn evaluation_ms(&self) -> Spread {
        Spread::of(self.steps.iter().map(|s| s.ms / s.evaluations.max(1) as f64))
    }

    pub(super) fn evaluations(&self) -> usize {
        self.steps.iter().map(|s| s.evaluations).sum()
    }

    /// Quasi-Newton steps that failed and were Lloyd's.
    pub(super) fn fallbacks(&self) -> usize {
        self.steps.iter().filter(|s| s.kind != self.kind).count()
    }

    /// Times of the phases, and the rest: launches, round trips, vectors of a quasi-Newton step.
    pub(super) fn phases(&self) -> [(&'static str, Spread); 5] {
        let times = |s: &Iteration| {
            let [a, b, c, d] = [s.stats.neighbours_ms, s.stats.start_ms, s.stats.clip_ms, s.stats.update_ms];
            [a, b, c, d, (s.ms - a - b - c - d).max(0.0)]
        };
        std::array::from_fn(|k| (PHASES[k], Spread::of(self.steps.iter().map(|s| times(s)[k]))))
    }

    /// The most that a step had a device do.
    pub(super) fn device(&self) -> DeviceWork {
        self.steps.iter().fold(DeviceWork::default(), |most, s| most.with(&s.stats.device, u64::max))
    }

    pub(super) fn json(&self, load: &Load, by: &Worker) -> Value {
        let mut case = by.json();
        let phases = self.phases();
        let means: BTreeMap<_, _> = phases.iter().map(|(name, spread)| (name, spread.mean)).collect();
        let spreads: BTreeMap<_, _> = phases.iter().copied().collect();
        let sum = |of: fn(&Iteration) -> u64| self.steps.iter().map(of).sum::<u64>();
        let fields = [
            ("mesh", json!(load.name)),
            ("facets", json!(load.facets)),
            ("facets_divided_into", json!(load.surface.facets().len())),
            ("points", json!(load.seeds.len())),
            ("density", json!(load.density)),
            ("kind", json!(self.kind.name())),
            ("relax", json!(load.relaxed)),
            ("iterations", json!(self.steps.len())),
            ("iteration_ms", json!(self.step_ms())),
            ("evaluations", json!(self.evaluations())),
            ("evaluation_ms", json!(self.evaluation_ms())),
            ("lloyd_fallbacks", json!(self.fallbacks())),
            ("total_ms", json!(self.total_ms)),
            ("energy_ratio", json!(self.energy_ratio)),
            ("phases_ms", json!(means)),
            ("phases_spread_ms", json!(spreads)),
            ("phases_by", json!(by.phases_by())),
            ("pairs", json!(sum(|s| s.stats.pairs) / self.evaluations().max(1) as u64)),
            ("relaunched_pairs", json!(sum(|s| s.stats.relaunched()))),
            ("f64_finished_pairs", json!(sum(|s| s.stats.f64_finished))),
            ("device_most", json!(self.device())),
            ("exact", json!(true)),
        ];
        for (name, value) in fields {
            case[name] = value;
        }
        case
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    pub(super) min: f64,
    pub(super) median: f64,
    pub(super) max: f64,
    /// What a step costs, where some make what several use.
    pub(super) mean: f64,
}

impl Spread {
    /// Of these; 0 of none.
    pub(super) fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_unstable_by(f64::total_cmp);
        let at = |k: usize| sorted.get(k).copied().unwrap_or(0.0);
        let mean = sorted.iter().sum::<f64>() / sorted.len().max(1) as f64;
        Self { min: at(0), median: at(sorted.len() / 2), max: at(sorted.len().saturating_sub(1)), mean }
    }

    pub(super) fn row(&self, name: &str) -> String {
        format!("{name:<22}{:>10.3}{:>10.3}{:>10.3}{:>10.3}", self.min, self.median, self.max, self.mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_least_middle_and_most() {
        let of = |values: &[f64]| Spread::of(values.iter().copied());
        assert_eq!(of(&[3.0, 1.0, 2.0]), Spread { min: 1.0, median: 2.0, max: 3.0, mean: 2.0 });
        assert_eq!(of(&[5.0]), Spread { min: 5.0, median: 5.0, max: 5.0, mean: 5.0 });
        assert_eq!(of(&[]), Spread { min: 0.0, median: 0.0, max: 0.0, mean: 0.0 });
    }
}
