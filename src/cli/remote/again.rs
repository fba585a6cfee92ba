//! Another try after a lost connection.
//!
//! Purpose: pauses that grow, and an end to them. Invariant: without anything that comes, tries end after the time that was
//! given. Must not know: what is tried.

use std::time::Duration;

use anyhow::{Error, Result};
use tokio::time::Instant;

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
