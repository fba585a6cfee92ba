//! Surfaces: read, written, measured.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/readers.rs"]
mod readers;

mod geometry;
mod hostile_files;
mod io;
