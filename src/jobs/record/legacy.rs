//! Specifications of record layouts 1 and 2, which had a schema of their own.
//!
//! Purpose: [`upgrade`] writes such a record as one of today. Invariant: records are only read by this, and a record of today
//! passes unchanged. Must not know: what options do.

use serde_json::{Map, Value, json};

/// A record of a specification as it is written today.
pub(super) fn upgrade(record: Value) -> Value {
    match record {
        Value::Object(old) if old.contains_key("work") => of_old(old),
        today => today,
    }
}

/// `SURFACE` as `PREFIX_SURFACE`; values whose names have changed by their new names.
fn value(prefix: &str, old: Value) -> Value {
    let Value::String(word) = old else { return old };
    let word = match (prefix, word.as_str()) {
        ("PROJECTION", "on_surface") => "surface",
        ("DENSITY_SOURCE", "feature_size") => "lfs",
        (_, other) => other,
    };
    format!("{prefix}_{word}").to_ascii_uppercase().into()
}

fn array(old: Value) -> Value {
    let Value::Object(mut old) = old else { return old };
    rename(&mut old, "blob", "digest", None);
    enumerate(&mut old, "form", "ARRAY_FORM");
    old.into()
}

fn attribute(old: Value) -> Value {
    let Value::Object(mut old) = old else { return old };
    enumerate(&mut old, "kind", "ATTRIBUTE_KIND");
    for name in ["values", "corners"] {
        rename(&mut old, name, name, Some(array));
    }
    old.into()
}

/// A field under its name of today.
fn rename(object: &mut Map<String, Value>, from: &str, to: &str, change: Option<fn(Value) -> Value>) {
    if let Some(value) = object.remove(from) {
        object.insert(to.to_owned(), change.map_or(value.clone(), |change| change(value)));
    }
}

fn enumerate(object: &mut Map<String, Value>, name: &str, prefix: &str) {
    if let Some(old) = object.remove(name) {
        object.insert(name.to_owned(), value(prefix, old));
    }
}

fn of_old(mut old: Map<String, Value>) -> Value {
    let mut spec = Map::new();
    let mut arrays = Map::new();
    if let Some(Value::Object(mesh)) = old.remove("mesh") {
        spec.insert("mesh".to_owned(), mesh.into_iter().map(of_mesh).collect::<Map<_, _>>().into());
    }
    if let Some(Value::Object(work)) = old.remove("work") {
        for (kind, work) in work {
            let Value::Object(mut work) = work else { continue };
            options(&mut work, &mut arrays);
            let work = match (kind.as_str(), work.remove("commands")) {
                ("cvt", Some(commands)) => json!({ "options": work, "commands": of_commands(commands) }),
                _ => work.into(),
            };
            spec.insert(kind, work);
        }
    }
    enumerate(&mut old, "backend", "BACKEND_CHOICE");
    for name in ["backend", "priority", "labels"] {
        spec.extend(old.remove(name).map(|value| (name.to_owned(), value)));
    }
    match old.remove("result") {
        Some(Value::String(arrays)) => _ = spec.insert("result".to_owned(), json!({ arrays: true })),
        Some(Value::Object(mut file)) => {
            enumerate(&mut file, "file", "MESH_FORMAT");
            spec.insert("result".to_owned(), file.into());
        }
        _ => {}
    }
    if let Some(Value::Object(deadlines)) = old.remove("deadlines") {
        for (old, name) in [("queue_ms", "queue_deadline"), ("run_ms", "run_deadline")] {
            if let Some(ms) = deadlines.get(old).and_then(Value::as_u64) {
                spec.insert(name.to_owned(), format!("{}.{:03}s", ms / 1000, ms % 1000).into());
            }
        }
    }
    if !arrays.is_empty() {
        spec.insert("arrays".to_owned(), arrays.into());
    }
    // What is left has its place beside the specification still.
    old.insert("spec".to_owned(), spec.into());
    old.into()
}

fn of_mesh((kind, source): (String, Value)) -> (String, Value) {
    let Value::Object(mut source) = source else { return (kind, source) };
    rename(&mut source, "blob", "digest", None);
    enumerate(&mut source, "format", "MESH_FORMAT");
    for name in ["positions", "facets"] {
        rename(&mut source, name, name, Some(array));
    }
    if let Some(Value::Array(all)) = source.get_mut("attributes") {
        all.iter_mut().for_each(|one| *one = attribute(one.take()));
    }
    (kind, source.into())
}

/// Options, and what of them are arrays today.
fn options(work: &mut Map<String, Value>, arrays: &mut Map<String, Value>) {
    if let Some(Value::Object(seeds)) = work.remove("seeds") {
        for (kind, seeds) in seeds {
            match (kind.as_str(), seeds) {
                ("sampled", Value::Object(mut drawn)) => {
                    rename(&mut drawn, "random_seed", "seed", None);
                    work.extend(drawn);
                }
                (_, given) => _ = arrays.insert("seeds".to_owned(), array(given)),
            }
        }
    }
    if let Some(Value::Object(density)) = work.get_mut("density") {
        enumerate(density, "source", "DENSITY_SOURCE");
        for name in ["edge_lengths", "weights"] {
            arrays.extend(density.remove(name).map(|old| (name.to_owned(), array(old))));
        }
    }
    // A density of arrays alone is not set today.
    if work.get("density").and_then(Value::as_object).is_some_and(Map::is_empty) {
        work.remove("density");
    }
    for name in ["weights", "creases"] {
        arrays.extend(work.remove(name).map(|old| (name.to_owned(), array(old))));
    }
    for (old, name) in [("lloyd_steps", "lloyd"), ("newton_steps", "newton"), ("crease_angle_deg", "crease_angle")] {
        rename(work, old, name, None);
    }
    for (name, prefix) in [
        ("projection", "PROJECTION"),
        ("placement", "PLACEMENT"),
        ("boundaries", "BOUNDARY_RULE"),
        ("thin", "THIN_RULE"),
        ("measure", "MEASURE"),
    ] {
        enumerate(work, name, prefix);
    }
    if let Some(Value::Object(mut refinement)) = work.remove("refinement") {
        if let Some(Value::Object(mut tolerance)) = refinement.remove("tolerance") {
            rename(&mut tolerance, "length", "max_deviation_length", None);
            rename(&mut tolerance, "diagonal_percent", "max_deviation", None);
            work.extend(tolerance);
        }
        work.extend(refinement);
    }
    if let Some(Value::Array(outputs)) = work.get_mut("outputs") {
        outputs.iter_mut().for_each(|output| *output = value("RVD_OUTPUT", output.take()));
    }
}

fn of_commands(commands: Value) -> Value {
    let Value::Array(mut commands) = commands else { return commands };
    for command in commands.iter_mut().filter_map(Value::as_object_mut) {
        for inner in command.values_mut().filter_map(Value::as_object_mut) {
            enumerate(inner, "kind", "STEP_KIND");
            enumerate(inner, "seeds", "SEEDS_WANTED");
            for edit in inner.get_mut("edits").and_then(Value::as_array_mut).into_iter().flatten() {
                let Value::Object(edit) = edit else { continue };
                rename(edit, "add", "add", Some(point));
                if let Some(Value::Object(moved)) = edit.get_mut("move") {
                    rename(moved, "to", "to", Some(point));
                }
            }
        }
    }
    commands.into()
}

fn point(old: Value) -> Value {
    json!({ "x": old[0], "y": old[1], "z": old[2] })
}
