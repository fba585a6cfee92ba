//! The service through real clients.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/server.rs"]
#[allow(dead_code)]
mod server;

#[path = "../common/adversary.rs"]
mod adversary;
mod raw;

mod admission;
mod attributes;
mod blob_speed;
mod blobs;
mod ceilings;
mod connections;
mod density;
mod features;
mod jobs;
mod keys;
mod life;
mod owners;
mod refusals;
mod shutdown;
mod slow_readers;
mod streams;
mod trial;
