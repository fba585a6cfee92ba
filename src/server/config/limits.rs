//! Limits of a request, of a connection, and of all together; and the options of connections.
//!
//! Invariant: every limit of the transport that a stranger can meet is an option with a safe default. The defaults equal those of the command line; a test compares them.
//! Must not know: how limits are enforced.

use std::time::Duration;

use clap::Args;
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
    pub max_connections: usize,
    pub max_connections_per_peer: usize,
    /// For a new connection to send its first request.
    pub first_request: Duration,
    /// For a connection without open streams.
    pub idle_connection: Duration,
    /// For a whole upload.
    pub upload: Duration,
    /// Between two messages of an upload.
    pub upload_idle: Duration,
    /// Between two commands of a session.
    pub session_idle: Duration,
    /// For a client to take any of the bytes that wait for it.
    pub stall: Duration,
    /// For work to end after the shutdown began.
    pub grace: Duration,
    /// Between two probes of an idle backend.
    pub probe: Duration,
    pub transport: Transport,
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
            max_connections: 1024,
            max_connections_per_peer: 256,
            first_request: Duration::from_secs(20),
            idle_connection: Duration::from_secs(300),
            upload: Duration::from_secs(1800),
            upload_idle: Duration::from_secs(60),
            session_idle: Duration::from_secs(600),
            stall: Duration::from_secs(120),
            grace: Duration::from_secs(30),
            probe: Duration::from_secs(60),
            transport: Transport::default(),
        }
    }
}

/// Limits of a connection: errors, frames and silence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transport {
    /// Open streams of a connection; default: all streams plus [`Self::EXTRA_STREAMS`].
    pub streams: Option<u32>,
    /// All headers of a request, bytes.
    pub header_bytes: u32,
    /// Size of a message, bytes, compressed and uncompressed.
    pub message_bytes: usize,
    /// Streams that the client reset before the server processed them.
    pub pending_resets: usize,
    /// Streams that were reset for faults of the client.
    pub fault_resets: usize,
    /// Frames of a connection a second that carry neither a request nor its bytes.
    pub control_frames: u32,
    /// Between two pings, which keep boxes between here and the client from forgetting the connection.
    pub ping_every: Duration,
    /// Time for the answer to a ping; at least the time that a stream may stall, since it waits behind the data of a slow
    /// reader.
    pub ping_timeout: Duration,
    /// For a new connection to send anything.
    pub first_byte: Duration,
    pub handshakes: usize,
    /// For a TLS handshake, waiting for its turn included.
    pub handshake: Duration,
}

impl Transport {
    /// Streams of a connection for health and reflection.
    pub const EXTRA_STREAMS: usize = 16;
}

impl Default for Transport {
    fn default() -> Self {
        Self {
            streams: None,
            header_bytes: 16 << 10,
            message_bytes: 4 << 20,
            pending_resets: 32,
            fault_resets: 256,
            control_frames: 1000,
            ping_every: Duration::from_secs(20),
            ping_timeout: Duration::from_secs(60),
            first_byte: Duration::from_secs(10),
            handshakes: 256,
            handshake: Duration::from_secs(10),
        }
    }
}

#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Connections")]
pub struct TransportArgs {
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

impl TransportArgs {
    pub(super) fn check(&self) -> Result<Transport, ConfigError> {
        let count = |option, value: u32| within(option, value, 1..=100_000);
        Ok(Transport {
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
        })
    }
}
