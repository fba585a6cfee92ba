//! What the command, HTTP and Python call the fields of a message.
//!
//! Purpose: [`of`] finds the option that a path stands for; [`in_text`] writes its name into an error. Invariant: an option is
//! called as its field; the few that differ are listed here. Must not know: what an option does.

/// Where options and their arrays lie in messages.
const ROOMS: &[&str] = &[
    "header.options.",
    "header.mesh.",
    "header.",
    "spec.remesh.",
    "spec.rvd.",
    "spec.cvt.options.",
    "spec.arrays.",
    "options.",
];

/// Fields that other interfaces call otherwise.
const OTHERS: &[(&str, &str)] = &[("density.source", "density"), ("edge_lengths", "sizes")];

/// What the messages have and the other interfaces have not: counts of uploads.
const NO_OPTIONS: &[&str] = &["vertices", "facets", "position_type", "attributes", "mesh", "backend", "options"];

/// The name of the option that a path of a message stands for, and what follows it in the path.
pub fn of(path: &str) -> Option<(&str, &str)> {
    let path = ROOMS.iter().find_map(|room| path.strip_prefix(room))?;
    for (field, name) in OTHERS {
        if let Some(rest) = path.strip_prefix(field).filter(|rest| rest.is_empty() || rest.starts_with(['.', '['])) {
            return Some((name, rest));
        }
    }
    let path = path.strip_prefix("density.").unwrap_or(path);
    let (name, rest) = path.split_at(path.find(['.', '[']).unwrap_or(path.len()));
    (!NO_OPTIONS.contains(&name)).then_some((name, rest))
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
            ("spec.remesh.points", Some(("points", ""))),
            ("header.options.points", Some(("points", ""))),
            ("spec.remesh.density.gradation", Some(("gradation", ""))),
            ("spec.cvt.options.density.source", Some(("density", ""))),
            ("spec.arrays.edge_lengths.form", Some(("sizes", ".form"))),
            ("header.mesh.weights", Some(("weights", ""))),
            ("header.options.crease_angle", Some(("crease_angle", ""))),
            ("header.seeds", Some(("seeds", ""))),
            ("header.mesh.vertices", None),
            ("header.backend", None),
            ("spec.priority", None),
            ("mesh.positions[3]", None),
        ] {
            assert_eq!(of(path), named, "{path}");
        }
        let flag = |name: &str| format!("--{}", name.replace('_', "-"));
        let text = in_text("header.options.crease_angle is 200; give 0 to 180", flag);
        assert_eq!(text.as_deref(), Some("--crease-angle is 200; give 0 to 180"));
        let text = in_text("spec.arrays.creases: line 3: not two vertices", flag);
        assert_eq!(text.as_deref(), Some("--creases: line 3: not two vertices"));
        assert_eq!(in_text("the queue is full", flag), None);
    }
}
