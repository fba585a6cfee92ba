//! `tessera shape`: writes a procedural surface.
//!
//! Purpose: input for trying things out. Must not know: how a shape is built.

use std::path::PathBuf;

use super::files;
use geometry::mesh::io::Format;
use geometry::mesh::shapes::{MAX_FACETS, Shape};
pub(crate) use server::config::whole;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ShapeArgs {
    /// Surface: sphere, torus, genusN (0 to 99 holes), block, hills, sheets, slivers, square or plane.
    pub name: Shape,
    /// Number of facets; the result is near it.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = parse_facets)]
    pub facets: usize,
    /// File to write.
    #[arg(short, long, value_name = "FILE", help = files::help_of("File to write", "- is the standard output"))]
    pub output: PathBuf,
    /// Format of the output, if the file name does not say it.
    #[arg(long, value_name = "FORMAT", value_parser = files::format())]
    pub format: Option<Format>,
}

pub(crate) fn run(args: &ShapeArgs) -> anyhow::Result<()> {
    let output = files::Surface::new(&args.output, args.format);
    output.check_output()?;
    let mesh = args.name.build(args.facets);
    output.write(&mesh, None)?;
    if !output.is_standard() {
        outln!("{output}: {} vertices, {} facets", mesh.positions().len(), mesh.facets().len())?;
    }
    Ok(())
}

pub(crate) fn parse_facets(text: &str) -> Result<usize, String> {
    let facets = whole(text).ok().filter(|facets| (1..=MAX_FACETS).contains(facets));
    facets.ok_or_else(|| format!("a whole number from 1 to {MAX_FACETS} is needed, as 10000 or 1e4"))
}
