//! The messages and services of `proto/tessera/v1`, generated.

#![allow(missing_docs, clippy::all, clippy::pedantic)]

tonic::include_proto!("tessera.v1");

/// Every descriptor, encoded, for reflection.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/tessera.bin"));
