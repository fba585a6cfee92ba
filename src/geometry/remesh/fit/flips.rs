//! Flips that bring facets nearer to the input.
//!
//! Purpose: where facets may be slender, the dual's edges need not be those along which the surface bends least. [`flip`] takes the
//! other diagonal of two facets where the samples of the input that are nearest to these are nearer to it, in the mean square: the
//! data-dependent triangulation of Dyn, Levin and Rippa (1990), for samples of a surface.
//! [`unfold`] flips edges of facets that face away.
//! Invariant: the sum of squared distances falls with each flip of [`flip`], and no facet becomes more slender than is wanted, or than
//! its pair was; edges of curves stay. The same bits whatever the number of threads. Must not know: why facets are slender.

use glam::DVec3;

use super::Target;
use super::normal_equations::NearestFacets;
use crate::mesh::closest_point::closest_on_facet;
use crate::mesh::csr::{Csr, ascending};
use crate::mesh::measure::facet_quality;
use crate::remesh::constants::*;
use crate::remesh::manifold::{Flip, LocalMesh};
use crate::remesh::triangle::{Norm, Wanted, perimeter, unit_normal};
use crate::tasks;
use crate::token::Token;

/// Flips edges while that helps, and gives each sample to a corner of its facet.
pub(super) fn flip(mesh: &mut LocalMesh, target: &mut Target, (wanted, norm): (Wanted, Norm), token: &Token) {
    let mut near = Near::new(mesh, target, token);
    let mut changed: Vec<u32> = (0..mesh.facets().len() as u32).collect();
    for _ in 0..FLIPPING_ROUNDS {
        let of = |k: usize| {
            (0..3).filter_map(|side| near.better(mesh, changed[k], side, (wanted, norm))).collect::<Vec<_>>()
        };
        let mut candidates: Vec<(f64, u32, usize, Flip)> = tasks::flat_map(changed.len(), of);
        candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        changed.clear();
        let mut touched = vec![false; mesh.facets().len()];
        for (_, f, side, flip) in candidates {
            // An earlier flip of this round may have taken its facets, or joined its ends.
            let is_free = flip.facets.iter().all(|&f| !touched[f as usize]);
            if is_free && mesh.flip(f, side, FLIPPING_VALENCES).as_ref() == Some(&flip) {
                mesh.apply(&flip);
                near.follow(mesh, flip.facets);
                flip.facets.iter().for_each(|&f| touched[f as usize] = true);
                changed.extend(flip.facets);
            }
        }
        if changed.is_empty() || token.is_stopped() {
            break;
        }
        let corners = ascending(changed.iter().flat_map(|&f| mesh.facets()[f as usize]));
        changed = mesh.facets_around(&corners);
    }
    near.give_back(mesh, target);
}

/// Flips edges of facets that face away from the surface, where both facets face it then. The dual has few such facets, most of them
/// slivers, where the lifted surface bends within a cell.
pub(super) fn unfold(mesh: &mut LocalMesh, target: &Target, token: &Token) {
    let normal = |v: u32| target.input.samples.of(v).iter().map(|s| s.area * s.normal).sum::<DVec3>();
    let normals: Vec<DVec3> = tasks::map(mesh.positions.len(), |v| normal(v as u32));
    let facing = |t: [u32; 3]| t.iter().map(|&v| normals[v as usize].normalize_or_zero()).sum::<DVec3>();
    let is_turned =
        |mesh: &LocalMesh, f: u32| unit_normal(mesh.corners(f)).dot(facing(mesh.facets()[f as usize])) < 0.0;
    for _ in 0..UNFOLDING_ROUNDS {
        let turned: Vec<u32> = (0..mesh.facets().len() as u32).filter(|&f| is_turned(mesh, f)).collect();
        let mut flips = 0;
        for f in turned.into_iter().take_while(|_| !token.is_stopped()) {
            // A flip of a neighbour may have turned it.
            if !is_turned(mesh, f) {
                continue;
            }
            let flip = (0..3).filter_map(|side| mesh.flip_any(f, side, UNFOLDING_VALENCES)).find(|flip| {
                let direction = flip.facets.iter().map(|&f| facing(mesh.facets()[f as usize])).sum::<DVec3>();
                mesh.faces(flip, direction.normalize_or_zero(), FLIPPED_COSINE)
            });
            if let Some(flip) = flip {
                mesh.apply(&flip);
                flips += 1;
            }
        }
        if flips == 0 {
            break;
        }
    }
}

/// Samples by the facet that is nearest.
struct Near {
    places: Vec<(DVec3, f64)>,
    /// The vertex to which each sample belongs.
    owner: Vec<u32>,
    of_facet: Vec<Vec<u32>>,
}

impl Near {
    fn new(mesh: &LocalMesh, target: &Target, token: &Token) -> Self {
        let samples = &target.input.samples;
        let mut of_facet = vec![Vec::new(); mesh.facets().len()];
        for (&facet, sample) in NearestFacets::new(mesh, target, token).facet.iter().zip(0..) {
            if let Some(own) = of_facet.get_mut(facet as usize) {
                own.push(sample);
            }
        }
        let owner = (0..mesh.positions.len() as u32).flat_map(|v| std::iter::repeat_n(v, samples.of(v).len()));
        let places = samples.all().iter().map(|s| (s.position, s.area)).collect();
        Self { places, owner: owner.collect(), of_facet }
    }

    /// A flip of a side of `f` that brings the two facets nearer to their samples, and by how much.
    fn better(
        &self,
        mesh: &LocalMesh,
        f: u32,
        side: usize,
        (wanted, norm): (Wanted, Norm),
    ) -> Option<(f64, u32, usize, Flip)> {
        let flip = mesh.flip(f, side, FLIPPING_VALENCES)?;
        // Each edge once.
        let [_, other] = flip.facets;
        if other < f {
            return None;
        }
        let before = flip.facets.map(|f| mesh.facets()[f as usize]);
        let lack = |t: [u32; 3]| wanted.lack(mesh.places(t), facet_quality(mesh.places(t)));
        if lack(flip.corners[0]).max(lack(flip.corners[1])) > lack(before[0]).max(lack(before[1])) {
            return None;
        }
        // On a flat part, rounding alone would decide.
        let worth = FLIPPING_DISTANCE * perimeter(mesh.corners(f)) / 3.0;
        let samples = || flip.facets.iter().flat_map(|&f| &self.of_facet[f as usize]).map(|&s| self.places[s as usize]);
        let off = |pair: [[u32; 3]; 2]| {
            let squared = |p: DVec3| pair.map(|t| closest_on_facet(p, mesh.places(t), t).0);
            let least = |p: DVec3| squared(p)[0].min(squared(p)[1]);
            samples().fold((0.0, 0.0f64), |(sum, most), (p, area)| {
                let squared = least(p);
                (sum + area * squared.powi(norm.power()), most.max(squared))
            })
        };
        let [(old, most), (new, _)] = [before, flip.corners].map(off);
        (most > worth * worth && new < FLIPPING_SHARE * old).then_some((old - new, f, side, flip))
    }

    /// Divides the samples of two facets between them again.
    fn follow(&mut self, mesh: &LocalMesh, facets: [u32; 2]) {
        let samples = facets.map(|f| std::mem::take(&mut self.of_facet[f as usize])).concat();
        for sample in samples {
            let p = self.places[sample as usize].0;
            let [a, b] = facets.map(|f| closest_on_facet(p, mesh.corners(f), mesh.facets()[f as usize]).0);
            self.of_facet[facets[usize::from(b < a)] as usize].push(sample);
        }
    }

    /// Samples whose facet has lost their vertex belong to the nearest corner from now on.
    fn give_back(mut self, mesh: &LocalMesh, target: &mut Target) {
        for (t, own) in mesh.facets().iter().zip(&self.of_facet) {
            for &sample in own {
                let p = self.places[sample as usize].0;
                let owner = &mut self.owner[sample as usize];
                if !t.contains(owner) {
                    let far = |v: &&u32| mesh.positions[**v as usize].distance_squared(p);
                    *owner = t.iter().min_by(|a, b| far(a).total_cmp(&far(b))).copied().unwrap_or(*owner);
                }
            }
        }
        let all = target.input.samples.all();
        target.input.samples = Csr::group(mesh.positions.len(), &self.owner, |k| all[k]);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::remesh::distance::{InputSamples, SurfaceSample};

    /// Two facets of a square, with an edge from 0 to 2, and samples of a ridge from 1 to 3 beside vertex 0.
    fn ridge(height: f64) -> (LocalMesh, Target) {
        let at = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        let positions = vec![at(0.0, 0.0, 0.0), at(1.0, 0.0, height), at(1.0, 1.0, 0.0), at(0.0, 1.0, height)];
        let mesh = LocalMesh::new(positions, vec![[0, 1, 2], [0, 2, 3]], HashSet::new());
        let sample = |k: usize| {
            let t = k as f64 / 10.0;
            SurfaceSample { position: at(t, 1.0 - t, height), normal: DVec3::Z, area: 0.1 }
        };
        let samples = Csr::group(4, &[0; 11], sample);
        let input = InputSamples { samples, vertices: Csr::group(4, &[], |_| DVec3::ZERO) };
        (mesh, Target { input, curves: Vec::new(), fixed: vec![false; 4] })
    }

    fn joined(mesh: &LocalMesh, a: u32, b: u32) -> bool {
        mesh.facets().iter().all(|t| t.contains(&a) && t.contains(&b))
    }

    #[test]
    fn an_edge_goes_along_the_ridge_and_stays_on_a_plane() {
        let wanted = Wanted::new(SLENDER_SCORE, SLENDER_ANGLE);
        for norm in [Norm::MeanSquare, Norm::Largest] {
            for (height, flips) in [(0.2, true), (1e-7, false)] {
                let (mut mesh, mut target) = ridge(height);
                flip(&mut mesh, &mut target, (wanted, norm), &Token::default());
                assert!(if flips { joined(&mesh, 1, 3) } else { joined(&mesh, 0, 2) }, "{norm:?}, {height}");
                assert_eq!(target.input.samples.all().len(), 11);
            }
        }
    }

    #[test]
    fn a_facet_that_faces_away_is_flipped() {
        let (mut mesh, target) = ridge(0.0);
        // Vertex 3 beyond the edge from 0 to 2: the second facet lies on the first, upside down.
        mesh.positions[3] = DVec3::new(0.6, 0.5, 0.0);
        mesh.positions[1] = DVec3::new(1.0, 0.0, 0.0);
        mesh.mark();
        unfold(&mut mesh, &target, &Token::default());
        assert!((0..2).all(|f| unit_normal(mesh.corners(f)).z > 0.0), "{:?}", mesh.facets());
    }
}
