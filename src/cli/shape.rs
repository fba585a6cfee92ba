//! `tessera shape`: writes a procedural surface.
//!
//! Purpose: input for trying things out. Must not know: how a shape is built.

use std::path::PathBuf;
use std::str::FromStr;

use super::exit::Usage;
use super::files;
use geometry::mesh::MAX_ELEMENTS;
use geometry::mesh::io::Format;
use geometry::mesh::shapes::parts::{PartKind, part};
use geometry::mesh::shapes::{Lattice, MAX_FACETS, Shape, UnknownShape};
pub(crate) use server::config::whole;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ShapeArgs {
    /// Surface: sphere, torus, genusN (0 to 99 holes), block, hills, sheets, slivers, square or plane; or a mechanical part:
    /// bracket, filleted, ribs, letters, thread, gear, frame, perforated, drilled, steps, cup, enclosure, wedge or slots.
    pub name: Name,
    /// Number of facets; the result is near it. More than 50 million: torus, slivers, hills or plane, as .ply. Not of parts.
    #[arg(long, value_name = "N", default_value_t = 10_000, value_parser = parse_any_facets)]
    pub facets: usize,
    /// Of a part, which is about 1 long: the thickness of its walls or the size of its smallest features.
    #[arg(long, value_name = "LENGTH", default_value_t = 0.03)]
    pub feature: f64,
    /// Of a part: what its proportions are drawn from.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// File to write.
    #[arg(short, long, value_name = "FILE", help = files::help_of("File to write", "- is the standard output"))]
    pub output: PathBuf,
    /// Format of the output, if the file name does not say it.
    #[arg(long, value_name = "FORMAT", value_parser = files::format())]
    pub format: Option<Format>,
}

/// What the name of a surface stands for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Name {
    Shape(Shape),
    Part(PartKind),
}

impl FromStr for Name {
    type Err = UnknownShape;

    fn from_str(name: &str) -> Result<Self, UnknownShape> {
        match PartKind::ALL.into_iter().find(|kind| kind.to_string() == name) {
            Some(kind) => Ok(Self::Part(kind)),
            None => name.parse().map(Self::Shape),
        }
    }
}

impl Name {
    fn lattice(self, facets: usize) -> Option<Lattice> {
        match self {
            Self::Shape(shape) => shape.lattice(facets),
            Self::Part(_) => None,
        }
    }
}

pub(crate) fn run(args: &ShapeArgs) -> anyhow::Result<()> {
    let output = files::Surface::new(&args.output, args.format);
    output.check_output()?;
    let is_packed = output.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
    let is_ply = output.format(files::OUTPUT_FORMAT)? == Format::Ply && !output.is_standard() && !is_packed;
    let (vertices, facets) = match args.name.lattice(args.facets).filter(|_| is_ply) {
        // Nothing of it is held, so that it may be larger than memory.
        Some(lattice) => {
            files::write(output.path(), |out| lattice.write_ply(out))?;
            (lattice.vertices(), lattice.facet_count())
        }
        None if args.facets > MAX_FACETS => {
            let text = format!(
                "--facets is {}; above {MAX_FACETS} write torus, slivers, hills or plane, as .ply",
                args.facets
            );
            return Err(Usage(text).into());
        }
        None => {
            let mesh = match args.name {
                Name::Shape(shape) => shape.build(args.facets),
                Name::Part(kind) => part(kind, args.feature, args.seed),
            };
            output.write(&mesh, None)?;
            (mesh.positions().len(), mesh.facets().len())
        }
    };
    if !output.is_standard() {
        outln!("{output}: {vertices} vertices, {facets} facets")?;
    }
    Ok(())
}

fn parse_any_facets(text: &str) -> Result<usize, String> {
    up_to(text, MAX_ELEMENTS / 2)
}

pub(crate) fn parse_facets(text: &str) -> Result<usize, String> {
    up_to(text, MAX_FACETS)
}

fn up_to(text: &str, most: usize) -> Result<usize, String> {
    let facets = whole(text).ok().filter(|facets| (1..=most).contains(facets));
    facets.ok_or_else(|| format!("a whole number from 1 to {most} is needed, as 10000 or 1e4"))
}
