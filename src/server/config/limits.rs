//! Limits of a request and of all together, and the options of connections.
//!
//! Invariant: every limit that a caller can meet is an option with a safe default. The defaults equal those of the command
//! line; a test compares them.
//! Must not know: how limits are enforced.

use std::time::Duration;

use clap::Args;
use transport::ConnectionLimits;
use wire::counts::Bounds;

use crate::config::values::{ConfigError, seconds, whole, within};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    pub max_vertices: u64,
    pub max_facets: u64,
    pub max_seeds: u64,
    pub max_iterations: u32,
    pub max_streams: usize,
    pub max_sessions: usize,
    /// Uploaded geometry and waiting results in memory, all streams together, bytes.
    pub memory_bytes: u64,
    /// For a whole upload.
    pub upload: Duration,
    /// Between two messages of an upload.
    pub upload_idle: Duration,
    /// Between two commands of a session.
    pub session_idle: Duration,
    /// For work to end after the shutdown began.
    pub grace: Duration,
    /// Between two probes of an idle backend.
    pub probe: Duration,
    pub connections: ConnectionLimits,
}

impl Limits {
    /// What a request may ask for, as the checks of messages take it.
    pub fn bounds(&self) -> Bounds {
        let &Self { max_vertices, max_facets, max_seeds, max_iterations, .. } = self;
        Bounds { max_vertices, max_facets, max_seeds, max_iterations }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_vertices: 20_000_000,
            max_facets: 40_000_000,
            max_seeds: 4_000_000,
            max_iterations: 10_000,
            max_streams: 256,
            max_sessions: 16,
            memory_bytes: 4 << 30,
            upload: Duration::from_secs(1800),
            upload_idle: Duration::from_secs(60),
            session_idle: Duration::from_secs(600),
            grace: Duration::from_secs(30),
            probe: Duration::from_secs(60),
            connections: ConnectionLimits::default(),
        }
    }
}

#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Connections")]
pub struct ConnectionArgs {
    /// Streams open at once on one connection; --max-streams and 16 for health and reflection if not given. One more is refused.
    #[arg(long, value_name = "N", value_parser = whole::<u32>, env = "TESSERA_CONNECTION_STREAMS")]
    pub connection_streams: Option<u32>,
    /// Bytes of all headers of a request, each counted with 32 more; a request with more is refused.
    #[arg(long, value_name = "BYTES", default_value_t = 16_384, value_parser = whole::<u32>, env = "TESSERA_MAX_HEADER_BYTES")]
    pub max_header_bytes: u32,
    /// MiB of one message, compressed and not; a larger one is refused with RESOURCE_EXHAUSTED.
    #[arg(long, value_name = "MIB", default_value_t = 4, value_parser = whole::<u32>, env = "TESSERA_MAX_MESSAGE_MIB")]
    pub max_message_mib: u32,
    /// Streams that a client may open and reset before the server has looked at them; one more closes the connection.
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = whole::<u32>, env = "TESSERA_MAX_PENDING_RESETS")]
    pub max_pending_resets: u32,
    /// Streams of a connection that the server may reset for faults of the client; one more closes the connection.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = whole::<u32>, env = "TESSERA_MAX_FAULT_RESETS")]
    pub max_fault_resets: u32,
    /// Control frames per second and connection: pings, settings, resets. Bursts of ten seconds' worth are allowed, and each
    /// 64 bytes of answers allow one more; beyond that the connection is closed.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = whole::<u32>, env = "TESSERA_MAX_CONTROL_FRAMES")]
    pub max_control_frames: u32,
    /// Seconds between two pings of a connection.
    #[arg(long, value_name = "S", default_value_t = 20.0, env = "TESSERA_PING_EVERY_S")]
    pub ping_every_s: f64,
    /// Seconds for the answer to a ping, and at least --stall-s; then the connection is closed.
    #[arg(long, value_name = "S", default_value_t = 60.0, env = "TESSERA_PING_TIMEOUT_S")]
    pub ping_timeout_s: f64,
    /// Seconds until a new connection must have sent its first byte.
    #[arg(long, value_name = "S", default_value_t = 10.0, env = "TESSERA_FIRST_BYTE_S")]
    pub first_byte_s: f64,
    /// TLS handshakes at the same time. If there are more, the oldest one above a second is dropped.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = whole::<u32>, env = "TESSERA_MAX_HANDSHAKES")]
    pub max_handshakes: u32,
    /// Seconds for a TLS handshake.
    #[arg(long, value_name = "S", default_value_t = 10.0, env = "TESSERA_HANDSHAKE_S")]
    pub handshake_s: f64,
}

impl ConnectionArgs {
    pub(super) fn check(&self) -> Result<ConnectionLimits, ConfigError> {
        let count = |option, value: u32| within(option, value, 1..=100_000);
        Ok(ConnectionLimits {
            streams: self.connection_streams.map(|streams| count("--connection-streams", streams)).transpose()?,
            // The usual headers need at least this. The upper limit bounds the memory of each request.
            header_bytes: within("--max-header-bytes", self.max_header_bytes, 1024..=1 << 20)?,
            // A chunk and a result have up to 1 MiB; frames of gRPC end at 4 GiB, and all messages are held in memory.
            message_bytes: (within("--max-message-mib", self.max_message_mib, 2..=1024)? as usize) << 20,
            pending_resets: count("--max-pending-resets", self.max_pending_resets)? as usize,
            fault_resets: count("--max-fault-resets", self.max_fault_resets)? as usize,
            control_frames: count("--max-control-frames", self.max_control_frames)?,
            ping_every: seconds("--ping-every-s", self.ping_every_s)?,
            ping_timeout: seconds("--ping-timeout-s", self.ping_timeout_s)?,
            first_byte: seconds("--first-byte-s", self.first_byte_s)?,
            handshakes: count("--max-handshakes", self.max_handshakes)? as usize,
            handshake: seconds("--handshake-s", self.handshake_s)?,
            ..ConnectionLimits::default()
        })
    }
}
