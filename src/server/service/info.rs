//! `ServerService`: what the server says of itself.
//!
//! Invariant: it is answered whatever the condition of the server, from the values that health and metrics have.
//! Must not know: how faults are found, how jobs are done.

use std::time::{Duration, Instant};

use tonic::{Request, Response, Status};

use crate::config::Limits;
use crate::readiness::Readiness;
use geometry::rvd::{BackendChoice, BackendKind};
use jobs::{Engine, memory};
use wire::proto::{self, GetServerInfoRequest, GetServerInfoResponse};

#[derive(Clone)]
pub struct Info {
    pub(in crate::service) engine: Engine,
    pub(in crate::service) limits: Limits,
    pub(crate) readiness: Readiness,
    pub(in crate::service) about: About,
}

#[tonic::async_trait]
impl proto::server_service_server::ServerService for Info {
    async fn get_server_info(
        &self,
        _: Request<GetServerInfoRequest>,
    ) -> Result<Response<GetServerInfoResponse>, Status> {
        Ok(Response::new(self.describe()))
    }
}

impl Info {
    pub(crate) fn describe(&self) -> GetServerInfoResponse {
        let condition = self.readiness.condition();
        let readiness = proto::Readiness {
            ready: condition.is_ready(),
            reasons: condition.reasons().map(|reason| reason.name().to_owned()).collect(),
            degraded: condition.degraded().map(|reason| reason.name().to_owned()).collect(),
        };
        GetServerInfoResponse {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            revision: self.about.revision.unwrap_or_default().to_owned(),
            features: self.about.features.iter().map(|&name| name.to_owned()).collect(),
            uptime: duration(self.about.started.elapsed()),
            readiness: Some(readiness),
            backends: self.backends(),
            device: self.device(),
            memory: Some(proto::HostMemory {
                machine_bytes: self.about.machine_bytes,
                resident_bytes: memory::memory_bytes(),
                job_limit_bytes: self.about.job_limit_bytes,
                stream_limit_bytes: self.limits.memory_bytes,
            }),
            limits: Some(self.limits()),
        }
    }

    fn backends(&self) -> Vec<proto::BackendState> {
        let usual = self.engine.backend(BackendChoice::Auto).ok().map(|by| by.kind);
        let state = |kind: BackendKind| {
            let name = kind.name().to_owned();
            let is_default = usual == Some(kind);
            match self.engine.backend(BackendChoice::Only(kind)) {
                Ok(by) => proto::BackendState {
                    name,
                    is_default,
                    adapter: by.adapter.unwrap_or_default(),
                    threads: u32::try_from(by.threads).unwrap_or(u32::MAX),
                    unavailable: String::new(),
                },
                Err(error) => {
                    proto::BackendState { name, is_default, unavailable: error.to_string(), ..Default::default() }
                }
            }
        };
        BackendKind::ALL.map(state).to_vec()
    }

    fn device(&self) -> Option<proto::DeviceState> {
        let facts = self.engine.device_facts()?;
        Some(proto::DeviceState {
            adapter: facts.adapter,
            api: facts.api,
            driver: facts.driver,
            is_software: facts.is_software,
            max_buffer_bytes: facts.max_buffer_bytes,
            max_binding_bytes: facts.max_binding_bytes,
            max_workgroups: facts.max_workgroups,
            allocated_bytes: facts.allocated_bytes,
        })
    }

    fn limits(&self) -> proto::RequestLimits {
        let &Limits { max_vertices, max_facets, max_seeds, max_iterations, .. } = &self.limits;
        proto::RequestLimits {
            max_vertices,
            max_facets,
            max_seeds,
            max_iterations,
            max_message_bytes: self.limits.connections.message_bytes as u64,
            max_streams: self.limits.max_streams as u64,
            max_sessions: self.limits.max_sessions as u64,
            job_time: self.about.job_time.and_then(duration),
            jobs_at_once: u32::try_from(self.about.jobs_at_once).unwrap_or(u32::MAX),
        }
    }
}

fn duration(time: Duration) -> Option<prost_types::Duration> {
    prost_types::Duration::try_from(time).ok()
}

/// What a server knows of itself from its start on. Nothing here changes.
#[derive(Clone, Debug)]
pub struct About {
    /// Revision of the sources, if the build was told.
    pub revision: Option<&'static str>,
    pub features: Vec<&'static str>,
    pub started: Instant,
    /// Memory of the machine or its container, bytes, if it is known.
    pub machine_bytes: Option<u64>,
    /// By how many bytes the process may grow during a job, if there is a limit.
    pub job_limit_bytes: Option<u64>,
    /// Time at work of one job, if there is a limit.
    pub job_time: Option<Duration>,
    pub jobs_at_once: usize,
}

impl About {
    /// The revision that the build was told of by the variable `TESSERA_REVISION`.
    pub const REVISION: Option<&'static str> = option_env!("TESSERA_REVISION");
}

impl Default for About {
    fn default() -> Self {
        let features =
            [("gpu", true), ("otlp", cfg!(feature = "otlp")), ("pictures", true), ("s3", cfg!(feature = "s3"))];
        Self {
            revision: Self::REVISION,
            features: features.into_iter().filter_map(|(name, is_in)| is_in.then_some(name)).collect(),
            started: Instant::now(),
            machine_bytes: None,
            job_limit_bytes: None,
            job_time: None,
            jobs_at_once: 1,
        }
    }
}
