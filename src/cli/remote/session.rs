//! Calls about jobs, blobs and the server itself, one after the other on a connection that is opened anew where it was lost.
//!
//! Invariant: a call is repeated only where that changes nothing. What cannot be reached at first is not tried again. A question
//! about health or the server takes no longer than it may; what does not answer is an error and not a state. Must not know: what
//! is asked of jobs and blobs, how it is printed.

use std::future::Future;
use std::time::Duration;

use anyhow::{Error, Result};
use tokio::time::Instant;
use tonic::{Code, Response};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_check_response::ServingStatus;
use tonic_health::pb::health_client::HealthClient;

use super::faults::{self, Fault};
use super::link::{Answered, Link, Patience};
use crate::exit::{Unavailable, Usage};
use crate::server::{Server, ServerArgs};
use wire::proto::server_service_client::ServerServiceClient;
use wire::proto::{GetServerInfoRequest, GetServerInfoResponse};

pub(crate) struct Session<'a> {
    server: &'a Server,
    patience: Patience,
    link: Option<Link<'a>>,
    pub(super) again: Again,
}

/// Does `work` with a server, and tries again after a lost connection.
pub(crate) fn session<R>(args: &ServerArgs, work: impl AsyncFnOnce(&mut Session<'_>) -> Result<R>) -> Result<R> {
    let server = &args.at.server()?;
    super::block_on(async {
        let patience = Patience::with(0);
        let link = Some(Link::open(server, patience).await?);
        let mut session =
            Session { server, patience, link, again: Again::within(Duration::from_secs_f64(args.retry_s)) };
        work(&mut session).await
    })
}

impl<'a> Session<'a> {
    pub(super) async fn once<T>(&mut self, ask: impl AsyncFnOnce(&Link<'a>) -> Result<T, Fault>) -> Result<T, Fault> {
        let fault = if self.again.is_again() { Fault::Lost } else { Fault::Final };
        let link = match self.link.take() {
            Some(link) => link,
            None => Link::open(self.server, self.patience).await.map_err(fault)?,
        };
        let answer = ask(&link).await;
        if !matches!(answer, Err(Fault::Lost(_))) {
            self.link = Some(link);
        }
        answer
    }

    /// Makes a call until its answer comes, or what is no loss of the connection.
    pub(super) async fn repeat<T>(&mut self, ask: impl AsyncFn(&Link<'a>) -> Result<T, Fault>) -> Result<T> {
        loop {
            match self.once(&ask).await {
                Ok(answer) => {
                    self.again.came();
                    return Ok(answer);
                }
                Err(fault) => self.lost(fault).await?,
            }
        }
    }

    /// Waits before the next try. Errors: `fault`, if it is final or no time is left.
    pub(super) async fn lost(&mut self, fault: Fault) -> Result<()> {
        match fault {
            Fault::Lost(cause) => self.again.pause(cause).await,
            Fault::Final(error) => Err(error),
        }
    }
}

/// Waits for the answer of a call that has only one.
pub(super) async fn one<T>(link: &Link<'_>, call: impl Future<Output = Answered<T>>) -> Result<T, Fault> {
    let answer = link.first(call).await?;
    answer.map(Response::into_inner).map_err(|status| faults::of_call(link.url, &status))
}

/// The first pause; each is twice the one before.
const FIRST: Duration = Duration::from_millis(100);
const LONGEST: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub(super) struct Again {
    limit: Duration,
    since: Option<Instant>,
    pause: Duration,
    tries: u32,
}

impl Again {
    /// Tries go on for `limit` after the last that came.
    pub(super) fn within(limit: Duration) -> Self {
        Self { limit, since: None, pause: FIRST, tries: 0 }
    }

    /// Something came: the next loss is a new one.
    pub(super) fn came(&mut self) {
        *self = Self::within(self.limit);
    }

    /// Whether this is not the first try since something came.
    pub(super) fn is_again(&self) -> bool {
        self.tries > 0
    }

    /// Waits before the next try. Errors: `cause`, once there is no time for another try.
    pub(super) async fn pause(&mut self, cause: Error) -> Result<()> {
        let now = Instant::now();
        let end = *self.since.get_or_insert(now) + self.limit;
        if now >= end {
            let (tries, seconds) = (self.tries, self.limit.as_secs_f32());
            let gave_up = format!("gave up after {tries} more tries in {seconds:.0} s");
            return Err(if tries == 0 { cause } else { cause.context(gave_up) });
        }
        tokio::time::sleep_until(end.min(now + self.pause)).await;
        self.pause = LONGEST.min(2 * self.pause);
        self.tries += 1;
        Ok(())
    }
}

/// Anything but these two is not serving.
fn state(status: i32) -> ServingStatus {
    let known =
        [ServingStatus::Serving, ServingStatus::ServiceUnknown].into_iter().find(|&known| known as i32 == status);
    known.unwrap_or(ServingStatus::NotServing)
}

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
        Err(status) => Err(faults::of_status(link.url, &status)),
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
    let mut states = watched.map_err(|status| faults::of_status(link.url, &status))?.into_inner();
    loop {
        match states.message().await {
            Ok(Some(next)) if tell(state(next.status))? => {}
            Ok(Some(_)) => return Ok(()),
            Ok(None) => return Err(Unavailable(format!("{} ended the watch; is it shutting down?", server.url)).into()),
            Err(status) => return Err(faults::of_status(link.url, &status)),
        }
    }
}

pub(crate) async fn info(server: &Server, limit: Duration) -> Result<GetServerInfoResponse> {
    let link = link(server, limit).await?;
    let mut client = ServerServiceClient::new(link.channel());
    match within(server, limit, client.get_server_info(GetServerInfoRequest {})).await? {
        Ok(answer) => Ok(answer.into_inner()),
        Err(status) if status.code() == Code::Unimplemented => {
            Err(Usage(format!("{} does not tell about itself; it is an older server", server.url)).into())
        }
        Err(status) => Err(faults::of_status(link.url, &status)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exit::{Unavailable, code};

    fn lost() -> Error {
        Unavailable("lost".to_owned()).into()
    }

    #[tokio::test]
    async fn tries_end() {
        let mut again = Again::within(Duration::ZERO);
        assert_eq!(again.pause(lost()).await.unwrap_err().to_string(), "lost");
        let mut again = Again::within(Duration::from_millis(150));
        let mut tries = 0;
        let error = loop {
            match again.pause(lost()).await {
                Ok(()) => tries += 1,
                Err(error) => break error,
            }
        };
        assert!(tries == 2 && code(&error) == 69, "{tries}, {error:#}");
        assert!(format!("{error:#}").starts_with("gave up after 2 more tries"), "{error:#}");
        again.came();
        assert!(!again.is_again() && again.pause(lost()).await.is_ok());
    }
}
