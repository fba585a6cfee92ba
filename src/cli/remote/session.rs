//! Calls about jobs and blobs: one after the other on a connection that is opened anew where it was lost.
//!
//! Invariant: a call is repeated only where that changes nothing. What cannot be reached at first is not tried again.
//! Must not know: what is asked.

use std::future::Future;

use anyhow::Result;
use tonic::{Response, Status};

use super::again::Again;
use super::faults::{self, Fault};
use super::link::{Link, Patience};
use crate::server::{Server, ServerArgs};

pub(crate) struct Session<'a> {
    server: &'a Server,
    patience: Patience,
    link: Option<Link<'a>>,
    pub(super) again: Again,
}

/// Does `work` with a server, and tries again after a lost connection.
pub(crate) fn session<R>(args: &ServerArgs, work: impl AsyncFnOnce(&mut Session<'_>) -> Result<R>) -> Result<R> {
    let server = &args.server()?;
    super::block_on(async {
        let patience = Patience::with(0);
        let link = Some(Link::open(server, patience).await?);
        let mut session = Session { server, patience, link, again: Again::within(args.retry()) };
        work(&mut session).await
    })
}

impl<'a> Session<'a> {
    pub(super) async fn once<T>(&mut self, ask: impl AsyncFnOnce(&Link<'a>) -> Result<T, Fault>) -> Result<T, Fault> {
        let link = match self.link.take() {
            Some(link) => link,
            None => Link::open(self.server, self.patience).await.map_err(|error| match self.again.is_again() {
                true => Fault::Lost(error),
                false => Fault::Final(error),
            })?,
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

    /// Waits before the next try.
    ///
    /// # Errors
    /// `fault`, if it is final or no time is left.
    pub(super) async fn lost(&mut self, fault: Fault) -> Result<()> {
        match fault {
            Fault::Lost(cause) => self.again.pause(cause).await,
            Fault::Final(error) => Err(error),
        }
    }
}

/// Waits for the answer of a call that has only one.
pub(super) async fn one<T>(
    link: &Link<'_>,
    call: impl Future<Output = Result<Response<T>, Status>>,
) -> Result<T, Fault> {
    match link.first(call).await? {
        Ok(answer) => Ok(answer.into_inner()),
        Err(status) => Err(faults::of_call(link.url(), &status)),
    }
}
