//! `tessera bench`: how long what takes.
//!
//! Purpose: passes of a diagram, steps of an iteration, and the table and figures of \[HYWZ17\], each as a table, as JSON
//! and as a plot. Invariant: what is timed is the exact diagram, every pass of it. Times are printed and never judged; what
//! warms up is not counted. Must not know: how a phase is done.

mod args;
mod baselines;
mod cvt;
mod figures;
mod measure;
mod rvd;
mod table1;

use anyhow::Result;
use clap::{Args, Subcommand};

#[derive(Args, Debug)]
pub(crate) struct BenchArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Passes of the restricted Voronoi diagram, by phase: seeds go in, sums come out.
    Rvd(rvd::RvdBenchArgs),
    /// Lloyd and L-BFGS steps, by phase: seeds stay where they are, on a GPU on the device.
    Cvt(cvt::CvtBenchArgs),
    /// GPU, one core and all cores over several models: Table 1 of Han, Yan, Wang, Zhao (Pacific Graphics 2017).
    ///
    /// Milliseconds per Lloyd step of relaxed seeds, which stay on the device. The published figures do not come
    /// with this program; --published fills their columns, which say "not at hand" otherwise.
    Table1(table1::Table1Args),
    /// Times against the number of points, and against the number of facets: Figure 3 of the same.
    Fig3(figures::Fig3Args),
    /// Times of a fixed number of Lloyd steps for a few thousand points: Figure 4 of the same.
    ///
    /// `--baseline` puts the methods beside it that the publication compares with, and says what they cost and miss.
    Fig4(figures::Fig4Args),
}

pub(crate) fn run(args: &BenchArgs) -> Result<()> {
    match &args.what {
        What::Rvd(args) => rvd::run(args),
        What::Cvt(args) => cvt::run(args),
        What::Table1(args) => table1::run(args),
        What::Fig3(args) => figures::fig3(args),
        What::Fig4(args) => figures::fig4(args),
    }
}
