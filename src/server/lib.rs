//! The server: gRPC, HTTP, keys, metrics, administration and configuration.
//!
//! | module | what it is for | may use |
//! | --- | --- | --- |
//! | [`config`] | options of the server, from file, environment and command line | nothing here |
//! | [`keys`] | keys of callers: made, hashed, kept in a file | nothing here |
//! | [`readiness`] | why the server is not ready, if it is not | nothing here |
//! | [`metrics`] | what is counted, and its text for Prometheus | `readiness` |
//! | [`hosts`] | hosts and sites whose requests a server without keys answers | nothing here |
//! | [`lifecycle`] | the steps of a start and an end, each with its time | `metrics` |
//! | [`admin`] | metrics and readiness over HTTP, for operators | `hosts`, `metrics`, `readiness` |
//! | [`service`] | gRPC: handlers, streams, status codes, limits | all above |
//! | [`http`] | HTTP: routes over the same jobs, blobs, keys and limits | `service`, without gRPC |
//!
//! Invariant: nothing waits without a limit, and every error has one place where it becomes an answer.
//! Must not know: how a diagram is computed, the command line.

#![warn(unreachable_pub)]
// Fields and variants that their names explain; the callers are crates of this workspace.
#![allow(missing_docs)]

pub mod admin;
pub mod cluster;
pub mod config;
pub mod hosts;
pub mod http;
pub mod keys;
pub mod lifecycle;
pub mod metrics;
pub mod readiness;
pub mod service;
