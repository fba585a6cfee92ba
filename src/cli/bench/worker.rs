//! Backends that are measured.
//!
//! Purpose: [`Worker`], one backend with its name and its clock. Must not know: what is measured.

use std::sync::Arc;

use anyhow::Result;
use serde_json::{Value, json};

use crate::backends;
use geometry::rvd::{Backend, BackendKind};
use gpu::diagram::Gpu;
use server::config::{BackendArg, BackendArgs};

pub(super) struct Worker {
    pub(super) backend: Arc<dyn Backend>,
    /// The same, if it is the GPU's.
    pub(super) gpu: Option<Arc<Gpu>>,
    /// The device's own clock times the phases.
    clock: bool,
}

impl Worker {
    fn on_gpu(gpu: Arc<Gpu>) -> Self {
        let backend: Arc<dyn Backend> = Arc::clone(&gpu) as Arc<dyn Backend>;
        Self { backend, gpu: Some(gpu), clock: false }
    }

    /// The one that the options ask for.
    pub(super) fn one(args: &BackendArgs) -> Result<Self> {
        if matches!(args.backend, BackendArg::Auto | BackendArg::Gpu)
            && let Ok(gpu) = backends::gpu(args)
        {
            return Ok(Self::on_gpu(gpu));
        }
        // Says why not, if only a GPU will do.
        Ok(Self { backend: backends::one(args)?, gpu: None, clock: false })
    }

    /// All that are there, if the options leave it open: GPU, parallel, serial.
    pub(super) fn all(args: &BackendArgs) -> Result<Vec<Self>> {
        if args.backend != BackendArg::Auto {
            return Ok(vec![Self::one(args)?]);
        }
        let mut workers = Vec::new();
        match backends::gpu(args) {
            Ok(gpu) => workers.push(Self::on_gpu(gpu)),
            Err(reason) => errln!("tessera: no GPU is measured: {reason}"),
        }
        for backend in [BackendArg::Parallel, BackendArg::Serial] {
            workers.push(Self::one(&BackendArgs { backend, ..args.clone() })?);
        }
        Ok(workers)
    }

    /// Has a GPU's own clock time the phases, if it has one.
    pub(super) fn keep_time(&mut self) -> Result<()> {
        if let Some(gpu) = &self.gpu {
            self.clock = gpu.keep_time()?;
        }
        Ok(())
    }

    /// "gpu", "parallel" or "serial".
    pub(super) fn name(&self) -> &'static str {
        self.backend.kind().name()
    }

    /// The same and what of the machine it uses.
    pub(super) fn describe(&self) -> String {
        let adapter = self.backend.adapter().map(|a| format!(" ({a})")).unwrap_or_default();
        match self.backend.threads() {
            1 => format!("{}{adapter}, 1 thread", self.name()),
            threads => format!("{}{adapter}, {threads} threads", self.name()),
        }
    }

    pub(super) fn json(&self) -> Value {
        let (adapter, threads) = (self.backend.adapter(), self.backend.threads());
        json!({ "backend": self.name(), "adapter": adapter, "threads": threads })
    }

    pub(super) fn phases_by(&self) -> &'static str {
        match (self.backend.kind(), self.clock) {
            (BackendKind::Gpu, true) => "device clock",
            // They are parts of one submission.
            (BackendKind::Gpu, false) => "none",
            _ => "wall clock",
        }
    }
}
