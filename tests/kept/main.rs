//! Promise: jobs outlive streams, crashes and restarts. The program itself, with a folder of its own, and real clients.
//!
//! `figures` are programs that print JSON (`cargo test --release --test kept -- --ignored --nocapture figures`).

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure
#![cfg(unix)]

mod commands;
mod damage;
mod device;
mod figures;
mod frames;
mod full_disk;
mod jobs;
mod keys;
mod kills;
mod load;
#[path = "../common/process.rs"]
mod process;
mod program;
#[path = "../service/raw.rs"]
#[allow(dead_code)]
mod raw;
#[path = "../common/server.rs"]
#[allow(dead_code)]
mod server;
mod sharing;
mod shutdown;
mod slow_readers;
mod soak;
