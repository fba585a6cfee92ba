//! Surfaces: read, written, measured, their attributes and their creases.
//!
//! One program for all of it, since every test program links the whole library.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/carried.rs"]
mod carried;
#[path = "../common/parts.rs"]
mod parts;
#[path = "../common/readers.rs"]
mod readers;

mod attributes;
mod features;
mod formats;
mod geometry;
mod hostile_files;
mod io;
mod left_aside;
mod other_formats;
mod packages;
