//! Calls about jobs and blobs: one after the other on a connection that is opened anew where it was lost.
//!
//! Invariant: a call is repeated only where that changes nothing. What cannot be reached at first is not tried again.
//! Must not know: what is asked.

use std::future::Future;
use std::time::Duration;

use anyhow::{Error, Result};
use tokio::time::Instant;
use tonic::{Response, Status};

use super::faults;
use super::faults::Fault;
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

    /// Waits before the next try.
    ///
    /// # Errors
    /// `cause`, once there is no time for another try.
    pub(super) async fn pause(&mut self, cause: Error) -> Result<()> {
        let now = Instant::now();
        let end = *self.since.get_or_insert(now) + self.limit;
        if now >= end {
            return match self.tries {
                0 => Err(cause),
                tries => {
                    let seconds = self.limit.as_secs_f32();
                    Err(cause.context(format!("gave up after {tries} more tries in {seconds:.0} s")))
                }
            };
        }
        tokio::time::sleep_until(end.min(now + self.pause)).await;
        self.pause = LONGEST.min(2 * self.pause);
        self.tries += 1;
        Ok(())
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
