//! `tessera shape`: writes a procedural surface.
//!
//! Purpose: input for trying things out. Must not know: how a shape is built.

use std::path::PathBuf;
use std::str::FromStr;

use super::exit::Usage;
use super::files;
use geometry::mesh::io::Format;
use geometry::mesh::shapes::parts::{PartKind, SMALLEST, part};
use geometry::mesh::shapes::{MAX_FACETS, Shape, UnknownShape};
use geometry::mesh::{MAX_ELEMENTS, TriMesh};
pub(crate) use server::config::whole;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct ShapeArgs {
    /// Surface: sphere, torus, genusN (0 to 99 holes), block, hills, sheets, slivers, square or plane; or a mechanical part:
    /// bracket, filleted, ribs, letters, thread, gear, frame, perforated, drilled, steps, cup, enclosure, wedge or slots.
    pub name: Name,
    /// Number of facets (10000); the result is near it. More than 50 million: torus, slivers, hills or plane, as .ply. Not of parts.
    #[arg(long, value_name = "N", value_parser = parse_any_facets)]
    pub facets: Option<usize>,
    /// Of a part, which is about 1 long: the thickness of its walls or the size of its smallest features (0.03).
    #[arg(long, value_name = "LENGTH", value_parser = feature, allow_negative_numbers = true)]
    pub feature: Option<f64>,
    /// Of a part: what its proportions are drawn from (0).
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
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
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        if let Some(kind) = PartKind::ALL.into_iter().find(|kind| kind.to_string() == name) {
            return Ok(Self::Part(kind));
        }
        let parts = || PartKind::ALL.map(|kind| kind.to_string()).join(", ");
        name.parse().map(Self::Shape).map_err(|unknown: UnknownShape| format!("{unknown}; and the parts {}", parts()))
    }
}

const FACETS: usize = 10_000;
const FEATURE: f64 = 0.03;

impl ShapeArgs {
    /// The part of this kind. Refuses what parts do not have.
    fn part(&self, kind: PartKind) -> Result<TriMesh, Usage> {
        let (largest, feature) = (kind.largest(), self.feature.unwrap_or(FEATURE));
        if self.facets.is_some() {
            return Err(Usage(format!("--facets is of shapes; a {kind} has as many as it needs")));
        }
        if !(SMALLEST..=largest).contains(&feature) {
            return Err(Usage(format!("--feature is {feature}; of a {kind} it is from {SMALLEST} to {largest}")));
        }
        Ok(part(kind, feature, self.seed.unwrap_or(0)))
    }
}

pub(crate) fn run(args: &ShapeArgs) -> anyhow::Result<()> {
    if matches!(args.name, Name::Shape(_)) && (args.feature.is_some() || args.seed.is_some()) {
        return Err(Usage("--feature and --seed are of mechanical parts, as a gear".to_owned()).into());
    }
    let output = files::Surface::new(&args.output, args.format);
    output.check_output()?;
    let is_packed = output.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("gz"));
    let is_ply = output.format(files::OUTPUT_FORMAT)? == Format::Ply && !output.is_standard() && !is_packed;
    let wanted = args.facets.unwrap_or(FACETS);
    let lattice = match args.name {
        Name::Shape(shape) => shape.lattice(wanted).filter(|_| is_ply),
        Name::Part(_) => None,
    };
    let (vertices, facets) = if let Some(lattice) = lattice {
        // Nothing of it is held, so that it may be larger than memory.
        files::write(output.path(), |out| lattice.write_ply(out))?;
        (lattice.vertices(), lattice.facet_count())
    } else {
        let mesh = match args.name {
            Name::Part(kind) => args.part(kind)?,
            Name::Shape(_) if wanted > MAX_FACETS => {
                let text =
                    format!("--facets is {wanted}; above {MAX_FACETS} write torus, slivers, hills or plane, as .ply");
                return Err(Usage(text).into());
            }
            Name::Shape(shape) => shape.build(wanted),
        };
        output.write(&mesh, None)?;
        (mesh.positions().len(), mesh.facets().len())
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

fn feature(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|feature: &f64| *feature > 0.0)
        .ok_or_else(|| "a length above 0 is needed, as 0.02".to_owned())
}
