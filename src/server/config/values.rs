//! Values as people write them: whole numbers, times, addresses.
//!
//! Invariant: the error for a wrong value says what to write. Must not know: options.

use std::borrow::Cow;
use std::fmt::Display;
use std::net::{SocketAddr, ToSocketAddrs};
use std::ops::RangeInclusive;
use std::time::Duration;

use wire::fields;

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{option} is {value}; it must be {must}")]
pub struct ConfigError {
    /// The option's name on the command line.
    pub option: &'static str,
    pub value: String,
    pub must: Cow<'static, str>,
}

impl ConfigError {
    pub(super) fn new(option: &'static str, value: impl Display, must: impl Into<Cow<'static, str>>) -> Self {
        Self { option, value: value.to_string(), must: must.into() }
    }
}

/// A URL without its password; any other text as it is.
pub(super) fn without_password(text: &str) -> Cow<'_, str> {
    let parts = text.split_once("://").and_then(|(scheme, rest)| {
        // The last one: a password may have such letters, though it should not.
        let (user, host) = rest.rsplit_once('@')?;
        Some(format!("{scheme}://{}@{host}", user.split_once(':')?.0))
    });
    parts.map_or(Cow::Borrowed(text), Cow::Owned)
}

/// A time as people write it: a number and s, m, h or d.
pub fn period(text: &str) -> Result<Duration, String> {
    let unit = |letter| match letter {
        's' => Some(1.0),
        'm' => Some(60.0),
        'h' => Some(3600.0),
        'd' => Some(86_400.0),
        _ => None,
    };
    let parsed = text.char_indices().next_back().and_then(|(at, letter)| {
        let seconds = text[..at].parse::<f64>().ok()? * unit(letter)?;
        (0.0..=1e9).contains(&seconds).then(|| Duration::from_secs_f64(seconds))
    });
    parsed.ok_or_else(|| "a time is needed, as 90s, 30m, 24h or 7d".to_owned())
}

pub(super) fn within<N: Display + Default + PartialOrd>(
    option: &'static str,
    value: N,
    allowed: RangeInclusive<N>,
) -> Result<N, ConfigError> {
    let (least, most) = (allowed.start(), allowed.end());
    match allowed.contains(&value) {
        true => Ok(value),
        false if *least == N::default() => Err(ConfigError::new(option, value, format!("at most {most}"))),
        false => Err(ConfigError::new(option, value, format!("{least} to {most}"))),
    }
}

/// Checks a size that is given in MiB. Returns it in bytes.
pub(super) fn mebibytes(option: &'static str, mib: Option<u64>) -> Result<Option<u64>, ConfigError> {
    mib.map(|mib| Ok(within(option, mib, 1..=1 << 24)? << 20)).transpose()
}

/// What a name and a port stand for, addresses of IPv4 first: a client that asks for one by number asks for those.
pub(super) fn addresses(option: &'static str, listen: &str) -> Result<Vec<SocketAddr>, ConfigError> {
    let wrong = |must: &'static str| ConfigError::new(option, format!("{listen:?}"), must);
    let (host, port) = listen
        .rsplit_once(':')
        .filter(|(host, _)| !host.contains("//"))
        .ok_or_else(|| wrong("an address and a port, as 127.0.0.1:50051, localhost:50051 or [::]:50051"))?;
    port.parse::<u16>().map_err(|_| wrong("an address and a port from 0 to 65535, as 127.0.0.1:50051"))?;
    if host.is_empty() {
        return Err(wrong("an address and a port; 0.0.0.0:50051 or [::]:50051 listens on all"));
    }
    let found =
        listen.to_socket_addrs().map_err(|_| wrong("an address of this machine or a name that can be resolved"))?;
    let mut found: Vec<SocketAddr> = found.collect();
    found.sort_by_key(SocketAddr::is_ipv6);
    match found.is_empty() {
        true => Err(wrong("a name that has an address")),
        false => Ok(found),
    }
}

/// A whole number as people write it: `10000`, `1e4`, `10k`, `10,000`.
pub fn whole<N: TryFrom<u64>>(text: &str) -> Result<N, String> {
    fields::whole(text).and_then(|n| n.try_into().ok()).ok_or_else(|| {
        let words = "a whole number is needed, as 10000, 1e4 or 10k";
        if fields::whole(text).is_some() { format!("{words}, and a smaller one") } else { words.to_owned() }
    })
}

/// The same, from 1 on.
pub fn count(text: &str) -> Result<u32, String> {
    match whole(text) {
        Ok(number) if number > 0 => Ok(number),
        _ => Err(format!("a whole number from 1 to {} is needed, as 10000, 1e4 or 10k", u32::MAX)),
    }
}

pub(super) fn seconds(option: &'static str, value: f64) -> Result<Duration, ConfigError> {
    match (0.01..=86_400.0).contains(&value) {
        true => Ok(Duration::from_secs_f64(value)),
        false => Err(ConfigError::new(option, value, "0.01 to 86400 seconds")),
    }
}
