//! What a server says of itself: health and information.
//!
//! Invariant: a question takes no longer than it may; what is not reached or does not answer is an error and not a state.
//! Must not know: how it is printed.

use std::future::Future;
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

/// Anything but these two is not serving.
fn state(status: i32) -> ServingStatus {
    match ServingStatus::try_from(status) {
        Ok(known @ (ServingStatus::Serving | ServingStatus::ServiceUnknown)) => known,
        _ => ServingStatus::NotServing,
    }
}

/// Waits for `work` no longer than `limit`.
async fn within<T>(server: &Server, limit: Duration, work: impl Future<Output = T>) -> Result<T> {
    tokio::time::timeout(limit, work).await.map_err(|_| {
        let (url, seconds) = (&server.url, limit.as_secs_f64());
        Unavailable(format!("{url} did not answer within {seconds} s; is a server running there?")).into()
    })
}

async fn link(server: &Server, limit: Duration) -> Result<Link<'_>> {
    let patience = Patience { connect: limit, ping: limit.max(Duration::from_secs(1)), first: limit };
    within(server, limit, Link::open(server, patience)).await?
}

/// Health of a service; of the whole server if the name is empty.
pub(crate) async fn health(server: &Server, service: &str, limit: Duration) -> Result<ServingStatus> {
    let link = link(server, limit).await?;
    let mut client = HealthClient::new(link.channel());
    match within(server, limit, client.check(HealthCheckRequest { service: service.to_owned() })).await? {
        Ok(answer) => Ok(state(answer.into_inner().status)),
        Err(status) if status.code() == Code::NotFound => Ok(ServingStatus::ServiceUnknown),
        Err(status) => Err(faults::of_status(link.url(), &status)),
    }
}

/// Tells every change of a service's state until `tell` wants no more or the server ends.
pub(crate) async fn watch_health(
    server: &Server,
    service: &str,
    limit: Duration,
    mut tell: impl FnMut(ServingStatus) -> Result<bool>,
) -> Result<()> {
    let link = link(server, limit).await?;
    let mut client = HealthClient::new(link.channel());
    let watched = within(server, limit, client.watch(HealthCheckRequest { service: service.to_owned() })).await?;
    let mut states = watched.map_err(|status| faults::of_status(link.url(), &status))?.into_inner();
    loop {
        match states.message().await {
            Ok(Some(next)) if tell(state(next.status))? => {}
            Ok(Some(_)) => return Ok(()),
            Ok(None) => return Err(Unavailable(format!("{} ended the watch; is it shutting down?", server.url)).into()),
            Err(status) => return Err(faults::of_status(link.url(), &status)),
        }
    }
}

/// Version, backends, memory and limits of a server.
pub(crate) async fn info(server: &Server, limit: Duration) -> Result<GetServerInfoResponse> {
    let link = link(server, limit).await?;
    let mut client = ServerServiceClient::new(link.channel());
    match within(server, limit, client.get_server_info(GetServerInfoRequest {})).await? {
        Ok(answer) => Ok(answer.into_inner()),
        Err(status) if status.code() == Code::Unimplemented => {
            Err(Usage(format!("{} does not tell about itself; it is an older server", server.url)).into())
        }
        Err(status) => Err(faults::of_status(link.url(), &status)),
    }
}
