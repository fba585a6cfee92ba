//! What a server says of itself: health and information.
//!
//! Invariant: a question takes no longer than it may; what is not reached or does not answer is an error and not a state.
//! Must not know: how it is printed.

use std::time::Duration;

use anyhow::Result;
use tonic::Code;
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use super::faults;
use super::link::{Link, Patience};
use crate::exit::{Unavailable, Usage};
use crate::server::Server;
use wire::proto::server_service_client::ServerServiceClient;
use wire::proto::{GetServerInfoRequest, GetServerInfoResponse};

/// How a service is, as health says it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    /// It takes calls.
    Serving,
    /// It does not, for now.
    NotServing,
    /// There is no such service.
    Unknown,
}

impl State {
    /// As the protocol calls it.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Serving => "SERVING",
            Self::NotServing => "NOT_SERVING",
            Self::Unknown => "SERVICE_UNKNOWN",
        }
    }

    fn of(status: i32) -> Self {
        match ServingStatus::try_from(status) {
            Ok(ServingStatus::Serving) => Self::Serving,
            Ok(ServingStatus::ServiceUnknown) => Self::Unknown,
            _ => Self::NotServing,
        }
    }
}

fn patience(limit: Duration) -> Patience {
    Patience { connect: limit, ping: limit.max(Duration::from_secs(1)), first: limit }
}

async fn link(server: &Server, limit: Duration) -> Result<Link<'_>> {
    match tokio::time::timeout(limit, Link::open(server, patience(limit))).await {
        Ok(link) => link,
        Err(_) => Err(silent(server, limit)),
    }
}

fn silent(server: &Server, limit: Duration) -> anyhow::Error {
    let text = format!("{} did not answer within {} s; is a server running there?", server.url, limit.as_secs_f64());
    Unavailable(text).into()
}

/// How a service is; all of the server if none is named.
pub(crate) async fn health(server: &Server, service: &str, limit: Duration) -> Result<State> {
    let link = link(server, limit).await?;
    let mut client = HealthClient::new(link.channel());
    let asked = client.check(HealthCheckRequest { service: service.to_owned() });
    match tokio::time::timeout(limit, asked).await {
        Err(_) => Err(silent(server, limit)),
        Ok(Ok(answer)) => Ok(State::of(answer.into_inner().status)),
        Ok(Err(status)) if status.code() == Code::NotFound => Ok(State::Unknown),
        Ok(Err(status)) => Err(faults::of_status(link.url(), &status)),
    }
}

/// Tells every change of a service's state until `tell` wants no more or the server ends.
pub(crate) async fn watch_health(
    server: &Server,
    service: &str,
    limit: Duration,
    mut tell: impl FnMut(State) -> Result<bool>,
) -> Result<()> {
    let link = link(server, limit).await?;
    let mut client = HealthClient::new(link.channel());
    let watching = client.watch(HealthCheckRequest { service: service.to_owned() });
    let Ok(watched) = tokio::time::timeout(limit, watching).await else { return Err(silent(server, limit)) };
    let mut states = watched.map_err(|status| faults::of_status(link.url(), &status))?.into_inner();
    loop {
        match states.message().await {
            Ok(Some(state)) if tell(State::of(state.status))? => {}
            Ok(Some(_)) => return Ok(()),
            Ok(None) => return Err(Unavailable(format!("{} ended the watch; is it shutting down?", server.url)).into()),
            Err(status) => return Err(faults::of_status(link.url(), &status)),
        }
    }
}

/// What a server says of itself.
pub(crate) async fn info(server: &Server, limit: Duration) -> Result<GetServerInfoResponse> {
    let link = link(server, limit).await?;
    let mut client = ServerServiceClient::new(link.channel());
    match tokio::time::timeout(limit, client.get_server_info(GetServerInfoRequest {})).await {
        Err(_) => Err(silent(server, limit)),
        Ok(Ok(answer)) => Ok(answer.into_inner()),
        Ok(Err(status)) if status.code() == Code::Unimplemented => {
            Err(Usage(format!("{} does not tell about itself; it is an older server", server.url)).into())
        }
        Ok(Err(status)) => Err(faults::of_status(link.url(), &status)),
    }
}
