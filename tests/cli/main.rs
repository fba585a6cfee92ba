//! The program as its users call it.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/certificates.rs"]
#[allow(dead_code)]
mod certificates;
#[path = "../common/gpu.rs"]
mod gpu;
#[path = "../common/nobody.rs"]
mod nobody;
#[path = "../common/process.rs"]
mod process;
#[path = "../common/rough.rs"]
mod rough;

mod bad_servers;
mod batches;
mod bench;
mod config;
mod given_creases;
mod jobs;
mod large;
mod load;
mod manual;
mod metric;
mod newcomer;
mod outputs;
mod picture;
mod remote;
mod snapshots;
mod tls;
mod told;
