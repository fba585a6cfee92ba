//! Parts are what a solid has to be.

use std::collections::HashSet;

use super::*;
use crate::mesh::adjacency::Adjacency;
use crate::mesh::crossings::crossings;
use crate::mesh::measure::{Topology, topology};
use crate::token::Token;

const FEATURES: [f64; 5] = [0.3, 0.1, 0.03, 0.01, 0.004];

fn volume(mesh: &TriMesh) -> f64 {
    (0..mesh.facets().len()).map(|f| mesh.corners(f)).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

/// Checks a part, and returns its Euler characteristic.
fn check(kind: PartKind, feature: f64, seed: u64) -> i64 {
    let mesh = part(kind, feature, seed);
    let name = format!("{kind} of {feature}, seed {seed}");
    let (positions, facets) = mesh.clone().into_parts();
    assert_eq!(TriMesh::new(positions, facets).as_ref(), Ok(&mesh), "{name}");
    assert_eq!(mesh.degenerate_count(), 0, "{name}");
    let places: HashSet<_> = mesh.positions().iter().map(|p| p.to_array().map(f64::to_bits)).collect();
    assert_eq!(places.len(), mesh.positions().len(), "{name}");
    let used: HashSet<u32> = mesh.facets().iter().flatten().copied().collect();
    assert_eq!(used.len(), mesh.positions().len(), "{name}");
    assert_eq!(Adjacency::new(&mesh).inconsistent_edges, 0, "{name}");
    let found = topology(&mesh);
    let manifold = Topology { euler: found.euler, components: 1, ..Topology::default() };
    assert_eq!(found, manifold, "{name}");
    assert_eq!(found.euler.rem_euclid(2), 0, "{name}");
    assert!(volume(&mesh) > 0.0, "{name}: {}", volume(&mesh));
    let (low, high) = mesh.bounds();
    let extent = (high - low).max_element();
    assert!((0.6..=1.5).contains(&extent), "{name}: {extent}");
    assert_eq!(crossings(&mesh, &Token::default()).unwrap().count, 0, "{name}");
    found.euler
}

#[test]
fn every_part_is_a_solid() {
    for kind in PartKind::ALL {
        for feature in FEATURES {
            for seed in 0..6 {
                let euler = check(kind, feature, seed);
                match kind {
                    PartKind::Bracket
                    | PartKind::Filleted
                    | PartKind::Ribs
                    | PartKind::Letters
                    | PartKind::Thread
                    | PartKind::Cup
                    | PartKind::Enclosure
                    | PartKind::Wedge => assert_eq!(euler, 2, "{kind} of {feature}, seed {seed}"),
                    PartKind::Steps => assert!(euler == 0 || euler == 2),
                    PartKind::Slots => assert!(euler <= 2),
                    PartKind::Gear | PartKind::Perforated | PartKind::Drilled => assert!(euler <= 0),
                    PartKind::Frame => assert!(euler <= -8),
                }
            }
        }
    }
}

#[test]
fn any_feature_is_taken() {
    for kind in PartKind::ALL {
        assert_eq!(part(kind, 1.0, 3), part(kind, kind.largest(), 3), "{kind}");
        for small in [f64::NAN, -1.0, 0.0] {
            assert_eq!(part(kind, small, 3), part(kind, SMALLEST, 3), "{kind}");
        }
        [1.0, 0.5, SMALLEST].into_iter().for_each(|feature| _ = check(kind, feature, 7));
        assert_ne!(part(kind, 0.05, 1), part(kind, 0.05, 2), "{kind}");
    }
}
