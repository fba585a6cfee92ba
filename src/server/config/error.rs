//! A value that makes no sense, in one sentence.
//!
//! Must not know: options.

/// A value that makes no sense.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{option} is {value}; it must be {must}")]
pub struct ConfigError {
    /// The option's name on the command line.
    pub option: &'static str,
    /// As given.
    pub value: String,
    /// The allowed values.
    pub must: &'static str,
}
