//! Promise: what the server tells of itself is so: its counters are what its clients counted, a trace leads from a client to
//! a pass of the backend, readiness and health say what is the matter, and the documents name what there is.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // a failure here is the test's failure

#[path = "../common/nobody.rs"]
mod nobody;
#[path = "../common/process.rs"]
mod process;

mod counted;
mod documents;
mod program;
mod ready;
mod traced;
