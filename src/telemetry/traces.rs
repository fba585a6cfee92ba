//! Spans to a collector, by OTLP over gRPC.
//!
//! Purpose: [`Exporting`] sends spans in batches from a thread of its own. Invariant: spans that the collector does not take
//! are dropped, and work never waits for them; a collector that is away costs a log line now and then. Must not know: what
//! spans are about.

use std::time::Duration;

use opentelemetry::KeyValue;
use opentelemetry::trace::TracerProvider as _;
use opentelemetry_otlp::WithExportConfig as _;
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::error::OTelSdkResult;
use opentelemetry_sdk::trace::{Sampler, SdkTracerProvider, SpanData, SpanExporter};
use tokio::runtime::Runtime;
use tracing::level_filters::LevelFilter;
use tracing::{Level, Metadata, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::registry::LookupSpan;

use super::{Seldom, TelemetryError, Traces};

/// For the collector to take a batch.
const EXPORT_TIME: Duration = Duration::from_secs(5);

/// For what waits to be sent when the program ends.
const FLUSH_TIME: Duration = Duration::from_secs(2);

/// Between two lines about a collector that is away.
const PAUSE: Duration = Duration::from_secs(60);

/// See the module's head. Ends with what is sent until then.
#[derive(Debug)]
pub(super) struct Exporting {
    provider: SdkTracerProvider,
    /// The connection lives here.
    runtime: Option<Runtime>,
}

impl Exporting {
    /// Begins to export. Whether the collector is there shows later.
    pub(super) fn start(traces: &Traces) -> Result<Self, TelemetryError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .thread_name("tessera-otlp")
            .build()
            .map_err(|error| TelemetryError::Traces(error.to_string()))?;
        let inside = runtime.enter();
        let exporter = opentelemetry_otlp::SpanExporter::builder()
            .with_tonic()
            .with_endpoint(&traces.endpoint)
            .with_timeout(EXPORT_TIME)
            .build()
            .map_err(|error| TelemetryError::Traces(error.to_string()))?;
        drop(inside);
        let resource = Resource::builder()
            .with_service_name("tessera")
            .with_attribute(KeyValue::new("service.version", env!("CARGO_PKG_VERSION")))
            .build();
        let ratio = Sampler::TraceIdRatioBased(traces.ratio);
        let provider = SdkTracerProvider::builder()
            .with_sampler(Sampler::ParentBased(Box::new(ratio)))
            .with_resource(resource)
            .with_batch_exporter(Patient { exporter, log: Seldom::every(PAUSE) })
            .build();
        Ok(Self { provider, runtime: Some(runtime) })
    }

    /// Takes the spans.
    pub(super) fn layer<S: Subscriber + for<'a> LookupSpan<'a> + Send + Sync>(&self) -> impl Layer<S> + use<S> {
        let layer = tracing_opentelemetry::layer()
            .with_tracer(self.provider.tracer("tessera"))
            .with_location(false)
            .with_threads(false)
            .with_tracked_inactivity(false);
        layer.with_filter(filter_fn(is_exported).with_max_level_hint(LevelFilter::DEBUG))
    }
}

/// Passes of the device are spans of the level debug; of what is logged the log has enough.
fn is_exported(metadata: &Metadata<'_>) -> bool {
    let most = if metadata.is_span() { Level::DEBUG } else { Level::INFO };
    metadata.target().starts_with("tessera") && *metadata.level() <= most
}

impl Drop for Exporting {
    fn drop(&mut self) {
        // The end of the program does not wait for a collector that is away.
        let _ = self.provider.shutdown_with_timeout(FLUSH_TIME);
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// An exporter whose failures are seldom logged.
#[derive(Debug)]
struct Patient<E> {
    exporter: E,
    log: Seldom,
}

impl<E: SpanExporter> SpanExporter for Patient<E> {
    async fn export(&self, batch: Vec<SpanData>) -> OTelSdkResult {
        let spans = batch.len();
        let exported = self.exporter.export(batch).await;
        if let Err(error) = &exported
            && self.log.count().is_some()
        {
            tracing::warn!(%error, spans, "traces could not be exported, and are lost until the collector is back");
        }
        exported
    }

    fn shutdown_with_timeout(&self, time: Duration) -> OTelSdkResult {
        self.exporter.shutdown_with_timeout(time)
    }

    fn force_flush(&self) -> OTelSdkResult {
        self.exporter.force_flush()
    }

    fn set_resource(&mut self, resource: &Resource) {
        self.exporter.set_resource(resource);
    }
}
