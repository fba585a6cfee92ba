//! Edges that motions take to others, in classes.
//!
//! Purpose: [`Periods`] knows for each boundary edge the first of all edges that motions make of it, and how directions turn from there.
//! Invariant: depends on the pairs alone. Must not know: curves, seeds.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet, VecDeque};

use glam::DMat3;

use crate::mesh::edges::{DisjointSets, undirected};
use crate::mesh::motion::Motion;
use crate::mesh::pairs::{Pair, Pairs};

/// An edge, and the first one of its class.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moved {
    /// By its vertices, the lower one first.
    pub(crate) first: [u32; 2],
    /// Whether the lower vertex is at the end where that one's upper vertex is.
    pub(crate) reversed: bool,
    /// What the motion from there does to directions.
    pub(crate) turn: DMat3,
}

/// An edge that a motion takes one to, whether ascending vertices become descending ones, and the turn to there.
type Next = ([u32; 2], bool, DMat3);

#[derive(Clone, Debug, Default)]
pub(crate) struct Periods {
    /// By the vertices of an edge, the lower one first.
    edges: HashMap<[u32; 2], Moved>,
    /// For a vertex of such an edge the first one of its class.
    vertices: HashMap<u32, u32>,
    /// Vertices between edges with different motions, and such as divide boundaries that motions take to themselves.
    ends: Vec<u32>,
    /// The motions that take an edge to another, and those that take another to it, by its vertices, the lower one first.
    signs: HashMap<[u32; 2], Signs>,
}

/// Motions, and whether they end at an edge or begin there.
pub(crate) type Signs = BTreeSet<(u32, bool)>;

impl Periods {
    /// Vertices are the lowest ones in their places.
    pub(crate) fn new(Pairs { all, boundary, .. }: &Pairs, motions: &[Motion]) -> Self {
        let mut next: BTreeMap<[u32; 2], Vec<Next>> = BTreeMap::new();
        let mut arrived: HashSet<[u32; 2]> = HashSet::new();
        let mut signs: HashMap<[u32; 2], Signs> = HashMap::new();
        for &Pair { motion, from, to } in all {
            let (a, b) = (undirected(from), undirected(to));
            let reversed = (a == from) != (b == to);
            let turn = motions[motion as usize].turn();
            next.entry(a).or_default().push((b, reversed, turn));
            next.entry(b).or_default().push((a, reversed, turn.transpose()));
            arrived.insert(b);
            signs.entry(a).or_default().insert((motion, false));
            signs.entry(b).or_default().insert((motion, true));
        }
        let mut edges: HashMap<[u32; 2], Moved> = HashMap::new();
        let (later, first): (Vec<[u32; 2]>, Vec<[u32; 2]>) = next.keys().partition(|edge| arrived.contains(*edge));
        for root in first.into_iter().chain(later) {
            if edges.contains_key(&root) {
                continue;
            }
            edges.insert(root, Moved { first: root, reversed: false, turn: DMat3::IDENTITY });
            let mut open = VecDeque::from([root]);
            while let Some(edge) = open.pop_front() {
                let own = edges[&edge];
                for &(to, reversed, turn) in &next[&edge] {
                    edges.entry(to).or_insert_with(|| {
                        open.push_back(to);
                        Moved { first: root, reversed: own.reversed != reversed, turn: turn * own.turn }
                    });
                }
            }
        }
        let known: Vec<u32> = edges.keys().flatten().copied().collect::<BTreeSet<u32>>().into_iter().collect();
        let index = |v: u32| known.partition_point(|&own| own < v);
        let mut classes = DisjointSets::new(known.len());
        for (a, b) in all.iter().flat_map(|pair| pair.from.into_iter().zip(pair.to)) {
            classes.join(index(a), index(b));
        }
        let vertices: HashMap<u32, u32> = known.iter().map(|&v| (v, known[classes.root(index(v))])).collect();
        let mut around: BTreeMap<u32, Vec<[u32; 2]>> = BTreeMap::new();
        boundary.iter().for_each(|&edge| edge.iter().for_each(|&v| around.entry(v).or_default().push(edge)));
        let differ = |edges: &[[u32; 2]]| edges.windows(2).any(|pair| signs.get(&pair[0]) != signs.get(&pair[1]));
        let mut ends: BTreeSet<u32> = around.iter().filter(|(_, edges)| differ(edges)).map(|(&v, _)| v).collect();
        ends.extend(dividing(&edges, &vertices, &around, &ends));
        Self { edges, vertices, ends: ends.into_iter().collect(), signs }
    }

    /// The motions at an edge.
    pub(crate) fn signs(&self, edge: [u32; 2]) -> Option<&Signs> {
        self.signs.get(&undirected(edge))
    }

    /// An edge, if a motion takes it to another or another to it.
    pub(crate) fn edge(&self, edge: [u32; 2]) -> Option<&Moved> {
        self.edges.get(&undirected(edge))
    }

    /// The first vertex of the class of one.
    pub(crate) fn class(&self, v: u32) -> u32 {
        self.vertices.get(&v).copied().unwrap_or(v)
    }

    pub(crate) fn vertices(&self) -> impl Iterator<Item = u32> {
        self.vertices.keys().copied()
    }

    /// Vertices at which curves end, ascending.
    pub(crate) fn ends(&self) -> &[u32] {
        &self.ends
    }
}

/// Vertices that divide boundaries which motions take to themselves: in their parts no edge is of the class of another. `around` has the
/// edges at each vertex of a boundary, `ends` are vertices that divide them already.
fn dividing(
    edges: &HashMap<[u32; 2], Moved>,
    vertices: &HashMap<u32, u32>,
    around: &BTreeMap<u32, Vec<[u32; 2]>>,
    ends: &BTreeSet<u32>,
) -> Vec<u32> {
    let (mut classes, mut found): (HashSet<u32>, Vec<u32>) = Default::default();
    let mut met: HashSet<[u32; 2]> = HashSet::new();
    // From the ends first: what is left are loops.
    let starts = ends.iter().chain(around.keys());
    for (&start, first) in starts.flat_map(|start| around[start].iter().map(move |edge| (start, *edge))) {
        if met.contains(&first) || !edges.contains_key(&first) {
            continue;
        }
        let (mut v, mut edge) = (start, first);
        let mut of_chain: HashSet<[u32; 2]> = HashSet::new();
        let mut last = None;
        while let Some(Moved { first, .. }) = edges.get(&edge).filter(|_| met.insert(edge)) {
            if !of_chain.insert(*first) {
                // The motion that turns a curve around leaves the vertex there.
                if last == Some(*first) {
                    found.push(v);
                }
                classes.extend(vertices.get(&start));
            }
            last = Some(*first);
            v = if edge[0] == v { edge[1] } else { edge[0] };
            let Some(&next) = around[&v].iter().find(|&&next| next != edge) else { break };
            if ends.contains(&v) || around[&v].len() != 2 {
                break;
            }
            edge = next;
        }
    }
    found.extend(vertices.iter().filter(|(_, class)| classes.contains(class)).map(|(&v, _)| v));
    found
}
