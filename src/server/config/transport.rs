//! Options of connections: limits on errors, frames and silence.
//!
//! Invariant: every limit of the transport that a stranger can meet is an option with a safe default. Must not know: HTTP.

use clap::Args;

use super::limits::Transport;
use super::values::{ConfigError, seconds, whole, within};

/// See the module's head.
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
