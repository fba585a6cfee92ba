//! The service through real clients.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/server.rs"]
#[allow(dead_code)]
mod server;

#[path = "../common/adversary.rs"]
mod adversary;
#[path = "../common/certificates.rs"]
#[allow(dead_code)]
mod certificates;
#[path = "../common/process.rs"]
mod process;
mod raw;

mod admission;
mod attributes;
mod blob_speed;
mod blobs;
mod ceilings;
mod connections;
mod density;
mod features;
mod floods;
mod health;
mod jobs;
mod keys;
mod life;
mod owners;
mod refusals;
mod shares;
mod shutdown;
mod slow_readers;
mod streams;
mod tls;
mod trial;
