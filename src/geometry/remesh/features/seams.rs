//! Curves that several sheets have.
//!
//! Purpose: [`Seams`] knows where sheets met before they were moved apart. There all of them get the same corners
//! ([`Seams::corners`]), so that their curves are copies of each other, which get the same seeds ([`Seams::share`]). Results of the
//! sheets then have the same vertices there. [`Joints`] says which of them are one vertex in the end.
//! Boundaries that motions take to others are such copies too, turned as these motions turn; they stay apart.
//! Invariant: depends on the surface alone. Must not know: how seeds of a curve are placed, how sheets were found.

pub(crate) mod periods;

use std::collections::{BTreeMap, HashMap, HashSet};

use glam::{DMat3, DVec3};

use crate::cvt::curves::{CurveSeeds, Twin};
use crate::mesh::edges::undirected;
use crate::mesh::features::{Curve, Features};
use periods::{Periods, Signs};

/// Which copies of a vertex, and of an edge, are one in the end.
#[derive(Clone, Debug)]
pub(crate) enum Joints {
    /// All in one place.
    All,
    /// Those of the pieces of one sheet.
    Pieces {
        /// For each vertex of the sheets apart the lowest one that it is joined to.
        vertices: Vec<u32>,
        /// For an edge of the sheets apart, by its vertices in ascending order, which edges it is one with.
        edges: HashMap<[u32; 2], u32>,
    },
}

/// What seeds have in common that are joined in one place: vertices of one number, or edges of one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(crate) enum Joint {
    Vertex(u32),
    Edge(u32),
    /// Copies of one curve, by the first of them.
    Curve(u32),
}

/// Where sheets met.
#[derive(Clone, Debug)]
pub(crate) struct Seams {
    /// For each vertex of the sheets apart, the lowest one that was in its place; `u32::MAX` where no facet has one. Vertices that divide
    /// facets are behind them.
    class: Vec<u32>,
    /// Where the vertices were, by `class`.
    places: Vec<DVec3>,
    /// Edges at which sheets met, by these.
    edges: HashSet<[u32; 2]>,
    /// Vertices of such edges.
    vertices: HashSet<u32>,
    /// Places that several sheets have without an edge in common, by the lowest vertices there: each sheet gets a corner.
    touching: HashSet<u32>,
    joints: Joints,
    /// Edges that motions take to others.
    periods: Option<Periods>,
}

/// An edge of a seam, the same for all of its copies, and whether a curve runs along it or against it.
type Step = ([u32; 2], bool);

/// A curve as all of its copies have it.
struct Key {
    steps: Vec<Step>,
    /// The vertex that is first there.
    start: u32,
    /// Whether the curve runs against that order.
    reversed: bool,
    /// What the motion from the first copy does to directions.
    turn: DMat3,
}

impl Seams {
    /// `places` are those of the vertices before sheets were moved.
    pub(crate) fn new((class, places): (Vec<u32>, &[DVec3]), edges: &[[u32; 2]], joints: Joints) -> Self {
        let vertices = edges.iter().flatten().copied().collect();
        let edges = edges.iter().copied().map(undirected).collect();
        let places = places.to_vec();
        Self { class, places, edges, vertices, touching: HashSet::new(), joints, periods: None }
    }

    /// The same with places in which sheets touch, by the lowest vertices there.
    pub(crate) fn with_touching(self, touching: HashSet<u32>) -> Self {
        Self { touching, ..self }
    }

    /// Whether results of the sheets have vertices in common.
    pub(crate) fn meet(&self) -> bool {
        !self.edges.is_empty() || matches!(self.joints, Joints::All)
    }

    /// The same with edges that motions take to others, by the classes of the vertices.
    pub(crate) fn with_periods(mut self, periods: Periods) -> Self {
        self.vertices.extend(periods.vertices());
        self.periods = Some(periods);
        self
    }

    /// The vertices at which curves end since motions do, ascending.
    pub(crate) fn ends(&self) -> Vec<u32> {
        let ends = self.periods.as_ref().map_or(&[][..], Periods::ends);
        if ends.is_empty() { Vec::new() } else { self.in_places(&ends.iter().copied().collect()) }
    }

    /// The motions at a curve, if it is a boundary that one takes to another or another to it.
    pub(crate) fn signs(&self, curve: &Curve) -> Option<&Signs> {
        let known: Vec<u32> = curve.round().filter_map(|v| self.class(v)).collect();
        let periods = self.periods.as_ref()?;
        known.windows(2).find_map(|pair| periods.signs([pair[0], pair[1]]))
    }

    /// The first of a curve's edges in their places, the same for all copies.
    pub(crate) fn first_edge(&self, curve: &Curve) -> Option<[u32; 2]> {
        let known: Vec<u32> = curve.round().filter_map(|v| self.class(v)).collect();
        known.windows(2).map(|pair| undirected([pair[0], pair[1]])).min()
    }

    /// The lowest vertex in the place of a vertex.
    pub(crate) fn class(&self, v: u32) -> Option<u32> {
        self.class.get(v as usize).copied()
    }

    /// Where a vertex was before sheets were moved.
    pub(crate) fn before(&self, v: u32) -> Option<DVec3> {
        self.class(v).and_then(|class| self.places.get(class as usize).copied())
    }

    /// All vertices that are in the place of a corner at which sheets meet, ascending.
    pub(crate) fn corners(&self, features: &Features) -> Vec<u32> {
        let met = |&v: &u32| self.class(v).filter(|class| self.vertices.contains(class));
        self.in_places(&features.corners.iter().filter_map(met).collect())
    }

    /// All vertices at which sheets touch, ascending.
    pub(crate) fn points(&self) -> Vec<u32> {
        if self.touching.is_empty() { Vec::new() } else { self.in_places(&self.touching) }
    }

    /// All vertices in places of these classes, or where motions take them.
    fn in_places(&self, classes: &HashSet<u32>) -> Vec<u32> {
        let first = |class: u32| self.periods.as_ref().map_or(class, |periods| periods.class(class));
        let classes: HashSet<u32> = classes.iter().map(|&class| first(class)).collect();
        (0..self.class.len() as u32).filter(|&v| classes.contains(&first(self.class[v as usize]))).collect()
    }

    /// Gives curves that are copies of each other the same seeds. Returns for each seed with copies what it is joined by, and how many are
    /// joined to others. `positions` are those of the vertices, unit frame.
    pub(crate) fn share(
        &self,
        seeds: &mut CurveSeeds,
        features: &Features,
        positions: &[DVec3],
    ) -> (Vec<Option<Joint>>, usize) {
        let mut groups = self.twins(features, positions, true);
        seeds.share(features, &groups);
        if self.periods.is_some() {
            // What is in one place alone is joined.
            groups = self.twins(features, positions, false);
        }
        let mut of_curve = vec![None; features.curves.len()];
        let mut inner = vec![0usize; features.curves.len()];
        for (group, Twin { curve, .. }) in groups.iter().flat_map(|group| group.iter().map(move |twin| (group, twin))) {
            of_curve[*curve as usize] = Some(self.of_curve(&features.curves[*curve as usize], group[0].curve, *curve));
        }
        let mut joints = vec![None; seeds.len()];
        for segment in seeds.segments.iter().filter(|segment| of_curve[segment.curve as usize].is_some()) {
            segment.ends.iter().for_each(|&seed| joints[seed as usize] = of_curve[segment.curve as usize]);
            inner[segment.curve as usize] += 1;
        }
        let open = inner.iter_mut().zip(&features.curves).filter(|(_, curve)| !curve.closed);
        open.for_each(|(inner, _)| *inner = inner.saturating_sub(1));
        // Curves with one joint have as many seeds each.
        let mut met = HashSet::new();
        let again = |(joint, inner): (&Option<Joint>, usize)| joint.filter(|joint| !met.insert(*joint)).map(|_| inner);
        let mut copies: usize = of_curve.iter().zip(inner).filter_map(again).sum();
        let mut met = HashSet::new();
        for (joint, &v) in joints.iter_mut().zip(&features.corners) {
            let (joined, touches) = match &self.joints {
                Joints::All => (self.class(v), self.class(v).is_some_and(|v| self.touching.contains(&v))),
                Joints::Pieces { vertices, .. } => (vertices.get(v as usize).copied(), false),
            };
            if joint.is_none() && !touches {
                continue;
            }
            let joined = Joint::Vertex(joined.unwrap_or(v));
            copies += usize::from(!met.insert(joined));
            *joint = Some(joined);
        }
        (joints, copies)
    }

    /// What the seeds within a curve are joined by; `first` is the first of its copies.
    fn of_curve(&self, curve: &Curve, first: u32, number: u32) -> Joint {
        let Joints::Pieces { edges, .. } = &self.joints else { return Joint::Curve(first) };
        let known: Vec<u32> = curve.round().filter(|&v| self.class(v).is_some()).collect();
        let of = |pair: &[u32]| edges.get(&undirected([pair[0], pair[1]])).copied();
        known.windows(2).filter_map(of).min().map_or(Joint::Curve(number), Joint::Edge)
    }

    /// Curves that are copies of each other, in groups of at least two; with `moved`, also where a motion takes one to the other.
    /// `positions` are those of the vertices, unit frame.
    fn twins(&self, features: &Features, positions: &[DVec3], moved: bool) -> Vec<Vec<Twin>> {
        let mut groups: BTreeMap<(bool, Vec<Step>), Vec<Twin>> = BTreeMap::new();
        let periods = self.periods.as_ref().filter(|_| moved);
        for (curve, number) in features.curves.iter().zip(0..) {
            let Some(Key { steps, start, reversed, turn }) = self.key(curve, periods) else { continue };
            let twin = Twin { curve: number, reversed, place: positions[start as usize], turn };
            groups.entry((curve.closed, steps)).or_default().push(twin);
        }
        groups.into_values().filter(|group| group.len() > 1).collect()
    }

    /// A seam's curve in the order that all copies have in common; `None` if it is no seam.
    fn key(&self, curve: &Curve, periods: Option<&Periods>) -> Option<Key> {
        let mut chain: Vec<(u32, u32)> =
            curve.vertices.iter().filter_map(|&v| self.class(v).map(|class| (class, v))).collect();
        if chain.len() < 2 {
            return None;
        }
        if curve.closed {
            chain.push(chain[0]);
        }
        let step = |pair: &[(u32, u32)]| -> Option<Step> {
            let edge = [pair[0].0, pair[1].0];
            let along = edge[0] < edge[1];
            match periods.and_then(|periods| periods.edge(edge)) {
                Some(moved) => Some((moved.first, along != moved.reversed)),
                None => self.edges.contains(&undirected(edge)).then_some((undirected(edge), along)),
            }
        };
        let there: Vec<Step> = chain.windows(2).map(step).collect::<Option<_>>()?;
        let back: Vec<Step> = there.iter().rev().map(|&(edge, along)| (edge, !along)).collect();
        let begin = |way: &[Step]| (0..way.len()).min_by_key(|&k| way[k]).filter(|_| curve.closed).unwrap_or(0);
        let from = |mut way: Vec<Step>| {
            let first = begin(&way);
            way.rotate_left(first);
            (way, first)
        };
        let ((there, first), (back, last)) = (from(there), from(back));
        let reversed = back < there;
        let at = if reversed { chain.len() - 1 - last } else { first };
        let start = chain[at];
        let next = chain[if reversed { at - 1 } else { at + 1 }];
        let moved = periods.and_then(|periods| periods.edge([start.0, next.0]));
        let turn = moved.map_or(DMat3::IDENTITY, |moved| moved.turn);
        Some(Key { steps: if reversed { back } else { there }, start: start.1, reversed, turn })
    }
}
