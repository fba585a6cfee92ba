//! Surfaces for tests: one of each procedural shape, and real ones where a folder is named.
#![allow(dead_code)]

use std::path::PathBuf;

use glam::DVec3;
use tessera::mesh::shapes::Shape;
use tessera::mesh::{TriMesh, io};

/// One of each shape, small.
pub fn all() -> Vec<(String, TriMesh)> {
    Shape::ALL.into_iter().map(|s| (s.to_string(), s.build(700))).collect()
}

/// The closed shapes with at least so many facets.
pub fn closed(facets: usize) -> Vec<(Shape, TriMesh)> {
    Shape::ALL.into_iter().filter(|s| s.is_closed()).map(|s| (s, s.build(facets))).collect()
}

fn folder(variable: &str) -> PathBuf {
    std::env::var_os(variable).map(PathBuf::from).unwrap_or_else(|| panic!("{variable} names no folder"))
}

/// A mesh from the folder that `TESSERA_MESHES` names, for tests that `#[needs(meshes)]`.
pub fn real(file: &str) -> TriMesh {
    let path = folder("TESSERA_MESHES").join(file);
    io::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Points from the folder that `TESSERA_SEEDS` names, for tests that `#[needs(seeds)]`: `x y z` a line.
pub fn points(file: &str) -> Vec<DVec3> {
    let path = folder("TESSERA_SEEDS").join(file);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let point = |line: &str| {
        let c: Vec<f64> = line.split_whitespace().map(|x| x.parse().unwrap()).collect();
        DVec3::new(c[0], c[1], c[2])
    };
    text.lines().map(point).collect()
}
