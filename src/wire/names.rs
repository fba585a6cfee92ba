//! What the command, HTTP and Python call the options of a remesh.
//!
//! Purpose: [`OPTIONS`] is the one list of options: the name that the command, HTTP and Python share, the fields of messages
//! that it stands for, and its default, read from [`RemeshOptions`]. Invariant: a test (`cli::defaults`) fails where an option
//! is missing in an interface, or a message has a field that is in no row. Must not know: what an option does.

use geometry::cvt::Projection;
use geometry::remesh::{Placement, RemeshOptions, Seeds};
use serde_json::{Value, json};

/// An option of a remesh.
#[derive(Debug)]
pub struct Name {
    /// The name: `--crease-angle` is `crease_angle`.
    pub name: &'static str,
    /// Paths in the header of a stream and in the specification of a job.
    pub paths: &'static [&'static str],
    /// The default; null where there is none.
    pub default: fn(&RemeshOptions) -> Value,
}

const fn row(name: &'static str, paths: &'static [&'static str], default: fn(&RemeshOptions) -> Value) -> Name {
    Name { name, paths, default }
}

/// All options of a remesh.
pub const OPTIONS: &[Name] = &[
    row("points", &["seeds.sampled.points", "seeds.drawn.points"], |_| Value::Null),
    row("seed", &["seeds.sampled.random_seed", "seeds.drawn.random_seed"], |_| json!(Seeds::RANDOM_SEED)),
    row("density", &["density.source", "density"], |_| json!("uniform")),
    row("edge_length", &["density.edge_length"], |_| Value::Null),
    row("sizes", &["density.edge_lengths"], |_| Value::Null),
    row("adaptivity", &["density.adaptivity"], |usual| json!(usual.density.adaptivity)),
    row("gradation", &["density.gradation"], |usual| json!(usual.density.gradation)),
    row("lloyd", &["lloyd_steps"], |usual| json!(usual.lloyd)),
    row("newton", &["newton_steps"], |usual| json!(usual.newton)),
    row("projection", &["projection"], |usual| match usual.projection {
        Projection::Free => json!("free"),
        Projection::OnSurface => json!("surface"),
    }),
    row("placement", &["placement"], |usual| match usual.placement {
        Placement::Fitted => json!("fitted"),
        Placement::Surface => json!("surface"),
        Placement::Centroids => json!("centroids"),
    }),
    row("crease_angle", &["crease_angle_deg"], |usual| json!(usual.crease_angle_deg)),
    row("creases", &["creases"], |_| Value::Null),
    row("boundaries", &["boundaries"], |usual| json!(if usual.keep_boundaries { "keep" } else { "free" })),
    row("thin", &["thin"], |usual| json!(if usual.keep_thin { "finer" } else { "even" })),
    row(
        "max_deviation",
        &["refinement.diagonal_percent", "refinement.tolerance", "refinement.length", "refinement"],
        |_| Value::Null,
    ),
    row("max_points", &["refinement.max_points"], |_| Value::Null),
];

/// Options that a message has and the command has not: seeds and weights that are given, and how much is measured.
pub const OTHERS: &[Name] = &[
    row("seeds", &["seeds.uploaded", "seeds.given", "seeds"], |_| Value::Null),
    row("weights", &["density.weights", "mesh.weights"], |_| Value::Null),
    row("measure", &["measure"], |usual| json!(if usual.measure { "full" } else { "topology" })),
];

/// Where the options lie in messages, and in records of jobs.
const ROOMS: &[&str] = &["header.", "spec.remesh.", "spec.rvd.", "spec.cvt.", "work.remesh.", "work.rvd.", "work.cvt."];

/// The name of the option that a path of a message stands for, and what follows it in the path.
pub fn of(path: &str) -> Option<(&'static str, &str)> {
    let path = ROOMS.iter().find_map(|room| path.strip_prefix(room))?;
    let named = OPTIONS.iter().chain(OTHERS).flat_map(|row| row.paths.iter().map(|path| (row.name, *path)));
    let begins = named.filter_map(|(name, begin)| {
        let rest = path.strip_prefix(begin)?;
        (rest.is_empty() || rest.starts_with(['.', '['])).then_some((begin.len(), name, rest))
    });
    begins.max_by_key(|(length, ..)| *length).map(|(_, name, rest)| (name, rest))
}

/// A text that begins with a path of a message, with the option's name in its place, as `name` writes it.
pub fn in_text(text: &str, name: impl Fn(&str) -> String) -> Option<String> {
    let (path, reason) = text.split_once(' ')?;
    let (path, colon) = path.strip_suffix(':').map_or((path, ""), |path| (path, ":"));
    let (option, rest) = of(path)?;
    Some(format!("{}{rest}{colon} {reason}", name(option)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_called_as_the_option_is() {
        for (path, named) in [
            ("spec.remesh.seeds.drawn.points", Some(("points", ""))),
            ("header.seeds.sampled.points", Some(("points", ""))),
            ("spec.remesh.density.gradation", Some(("gradation", ""))),
            ("spec.remesh.density", Some(("density", ""))),
            ("spec.remesh.density.edge_lengths.form", Some(("sizes", ".form"))),
            ("header.crease_angle_deg", Some(("crease_angle", ""))),
            ("spec.cvt.refinement.max_points", Some(("max_points", ""))),
            ("header.mesh.vertices", None),
            ("spec.priority", None),
            ("mesh.positions[3]", None),
        ] {
            assert_eq!(of(path), named, "{path}");
        }
        let flag = |name: &str| format!("--{}", name.replace('_', "-"));
        let text = in_text("header.crease_angle_deg is 200; give 0 to 180", flag);
        assert_eq!(text.as_deref(), Some("--crease-angle is 200; give 0 to 180"));
        let text = in_text("work.remesh.creases: line 3: not two vertices", flag);
        assert_eq!(text.as_deref(), Some("--creases: line 3: not two vertices"));
        assert_eq!(in_text("the queue is full", flag), None);
    }
}
