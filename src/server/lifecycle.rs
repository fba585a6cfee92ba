//! The steps of a server's life, from its options to its last word.
//!
//! Purpose: [`LifeCycle`] runs steps one after the other, each within a limit, and tells the log and the metrics how long each
//! took. Invariant: a step that begins ends, or is named by [`TooLong`]. Must not know: what a step does.

use std::time::{Duration, Instant};

use strum::IntoStaticStr;

use crate::metrics::Metrics;

/// A step, in the order in which they come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, IntoStaticStr)]
#[strum(serialize_all = "snake_case")]
pub enum Step {
    /// Options are checked, certificates read.
    Configuration,
    /// Folder, journal and blobs are opened.
    Storage,
    /// Backends are opened, and one remesh is made.
    Backends,
    /// The jobs of the journal are queued.
    Jobs,
    /// The port is bound.
    Port,
    /// A diagram whose answer is known is computed.
    Probe,
    /// Nothing new is admitted; what is at work may end.
    Drain,
    /// What is left is cancelled, and connections close.
    Close,
    /// The threads of the engine end.
    Engine,
}

impl Step {
    fn name(self) -> &'static str {
        self.into()
    }
}

#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the step \"{step}\" of the start did not end within {} s; mend what it waits for, or give it more time with --start-s",
    limit.as_secs_f64()
)]
pub struct TooLong {
    step: &'static str,
    limit: Duration,
}

#[derive(Clone, Debug)]
pub struct LifeCycle {
    metrics: Metrics,
    limit: Duration,
}

impl LifeCycle {
    /// With a limit for each step of the start.
    pub fn new(metrics: Metrics, limit: Duration) -> Self {
        Self { metrics, limit }
    }

    /// Runs a step of the start. Errors: [`TooLong`]: the step is dropped as it is.
    pub async fn step<T>(&self, step: Step, work: impl Future<Output = T>) -> Result<T, TooLong> {
        let begin = Instant::now();
        tracing::debug!(step = step.name(), "begins");
        let done = tokio::time::timeout(self.limit, work).await;
        let done = done.map_err(|_| TooLong { step: step.name(), limit: self.limit })?;
        ended(&self.metrics, step, begin);
        Ok(done)
    }
}

/// A step that has a limit of its own has ended.
pub fn ended(metrics: &Metrics, step: Step, begin: Instant) {
    let took = begin.elapsed();
    tracing::info!(step = step.name(), seconds = took.as_secs_f64(), "ended");
    metrics.step(step.name(), took);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn a_step_that_takes_too_long_is_named() {
        let life = LifeCycle::new(Metrics::default(), Duration::from_millis(500));
        assert!(life.step(Step::Storage, async {}).await.is_ok());
        let error = life.step(Step::Backends, std::future::pending::<()>()).await.unwrap_err();
        let expected = "the step \"backends\" of the start did not end within 0.5 s; mend what it waits for, or give it more \
             time with --start-s";
        assert_eq!(error.to_string(), expected);
    }

    #[tokio::test]
    async fn metrics_hear_of_steps_that_ended() {
        let metrics = Metrics::default();
        let life = LifeCycle::new(metrics.clone(), Duration::from_secs(3));
        life.step(Step::Port, async {}).await.unwrap();
        let text = metrics.text(crate::metrics::Format::Text);
        assert!(text.contains("tessera_step_seconds{step=\"port\"}"), "{text}");
        assert!(!text.contains("step=\"drain\""), "{text}");
    }
}
