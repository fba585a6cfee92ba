//! Curves that a remesh must keep: boundaries and creases.
//!
//! Purpose: [`Features::find`] names the edges that are a boundary, are bent by more than an angle, or were
//! given; joins them to curves between corners; and leaves out what is shorter than a remesh could
//! show, which on scans is noise.
//! Invariant: a curve is a chain of mesh edges through welded vertices, simple inside, either
//! closed or between two corners. A boundary is never left out. Depends on the mesh and the options alone.
//! Must not know: seeds, diagrams.

mod near;
mod ridges;

use std::collections::BTreeMap;

use glam::DVec3;

use super::TriMesh;
use super::adjacency::{Adjacency, EdgeKind};
use crate::token::{Stopped, Token};
use near::Near;
use ridges::Bends;

/// What counts as a feature. [`Default`] is boundaries alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FeatureOptions {
    /// Edges whose facets' normals differ by more than this are creases, degrees; 0 finds none.
    pub crease_angle_deg: f64,
    /// Edges that are creases whatever their angle: two vertices each.
    pub given: Vec<[u32; 2]>,
    /// Creases by angle go where they end freely within this length, and where all that hangs
    /// together is shorter than twice this, or a tangle of curves that are much shorter still. In the frame
    /// of the positions, as all lengths here.
    pub shortest: f64,
    /// Bends are measured over this length on either side.
    pub reach: f64,
    /// A ridge that is bent by half the angle of creases is one too where nothing within this length beside it is
    /// bent nearly as much, if it goes on from a crease or joins two. 0 finds none.
    pub alone: f64,
    /// Of two corners between which a boundary is shorter than this one is left out, if the curves hardly change by that. 0
    /// leaves none out.
    pub near: f64,
    /// How fine the remesh is to be at each vertex, at least 0: where this is f, lengths count f times, since what matters
    /// is how many edges of the remesh they are. 1 everywhere if empty.
    pub fineness: Vec<f64>,
}

/// A network whose curves are shorter on average than this share of the shortest crease is a tangle,
const TANGLE: f64 = 0.5;
/// or this share, where most of it is sharp: that is meant, and short only beside the edges of the remesh.
const TANGLE_OF_SHARP: f64 = 0.15;
/// Bends of less than this are creases only because the caller has asked for such: where they make a tangle of a network,
/// it is looked at without them.
const PLAIN_ANGLE: f64 = 30.0;
/// What is bent by more than this, degrees, is sharp.
const SHARP_ANGLE: f64 = 75.0;
/// So many edges are an end of a curve.
const END_EDGES: usize = 3;
/// A curve bends by more than this, degrees: there is a corner.
const CORNER_ANGLE: f64 = 60.0;
/// Curves hardly change if chords as long as [`FeatureOptions::reach`] leave them by less than this share of it, which is about
/// as far as they leave a bent curve.
const HARDLY: f64 = 0.1;

/// What a curve is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CurveKind {
    /// Edges with one facet.
    Boundary,
    /// Edges that are bent or were given.
    Crease,
}

/// A chain of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// What it is.
    pub kind: CurveKind,
    /// Mesh vertices, in order. A closed curve does not repeat its first vertex.
    pub vertices: Vec<u32>,
    /// Whether the last vertex joins the first. Otherwise both ends are corners.
    pub closed: bool,
    /// How much it is bent, degrees, mean over its edges; 180 for a boundary and where it was given.
    pub angle_deg: f64,
    /// The same of its first and its last edges alone.
    pub ends_deg: [f64; 2],
}

/// The curves of a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Ordered by their first vertices.
    pub curves: Vec<Curve>,
    /// Vertices where curves end or meet, ascending.
    pub corners: Vec<u32>,
    /// Edges that were bent enough and were left out as too short a crease.
    pub left_out: usize,
    /// Corners that are none any more, as another one is near ([`FeatureOptions::near`]).
    pub joined: usize,
}

/// Why given creases were refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FeatureError {
    /// A pair of vertices is no edge of the surface.
    #[error("crease {crease} names vertices {a} and {b}, which no facet joins; name the two ends of a mesh edge")]
    NoSuchEdge {
        /// Its place in the list, from 0.
        crease: usize,
        /// First vertex.
        a: u32,
        /// Second vertex.
        b: u32,
    },
    /// The angle makes no sense.
    #[error("the crease angle is {0}°; give 0 (no creases) to 180")]
    BadAngle(f64),
    /// The caller asked to stop, or a limit was reached.
    #[error(transparent)]
    Stopped(#[from] Stopped),
}

type Edge = [u32; 2];
/// An edge and how much it is bent, degrees.
type Bent = (Edge, f64);

/// Lengths as [`FeatureOptions::fineness`] makes them.
#[derive(Clone, Copy)]
struct Ruler<'a> {
    positions: &'a [DVec3],
    fineness: &'a [f64],
}

impl Ruler<'_> {
    fn fineness(&self, v: u32) -> f64 {
        self.fineness.get(v as usize).copied().unwrap_or(1.0)
    }

    fn at(&self, v: u32) -> DVec3 {
        self.positions[v as usize]
    }

    /// Of an edge.
    fn edge(&self, a: u32, b: u32) -> f64 {
        self.at(a).distance(self.at(b)) * (0.5 * (self.fineness(a) + self.fineness(b)))
    }

    /// Of a chain of edges.
    fn chain(&self, chain: &[u32]) -> f64 {
        chain.windows(2).map(|p| self.edge(p[0], p[1])).sum()
    }
}

fn edge(a: u32, b: u32) -> Edge {
    [a.min(b), a.max(b)]
}

impl Features {
    /// Finds the curves of `mesh`. `positions` are its vertices in the frame in which lengths are meant.
    ///
    /// # Errors
    /// [`FeatureError`].
    pub fn find(
        mesh: &TriMesh,
        positions: &[DVec3],
        options: &FeatureOptions,
        token: &Token,
    ) -> Result<Self, FeatureError> {
        if !(0.0..=180.0).contains(&options.crease_angle_deg) {
            return Err(FeatureError::BadAngle(options.crease_angle_deg));
        }
        let adjacency = Adjacency::new(mesh);
        token.check()?;
        let class = adjacency.representative();
        let ruler = Ruler { positions, fineness: &options.fineness };
        let bends = Bends::new(mesh, ruler, &adjacency);
        token.check()?;
        let (bent, boundary) = classify(mesh, &bends, &adjacency, options.crease_angle_deg, token)?;
        token.check()?;
        let mut graph = Graph::default();
        let must = |kind| What { kind, kept: true, angle: 180.0 };
        for (k, &e) in boundary.iter().enumerate() {
            token.check_at(k)?;
            graph.insert(e, must(CurveKind::Boundary));
        }
        let edges = (!options.given.is_empty()).then(|| all_edges(mesh, &adjacency)).into_iter().flatten();
        let known: std::collections::HashSet<Edge> = edges.collect();
        for (crease, &[a, b]) in options.given.iter().enumerate() {
            let welded = |v: u32| class.get(v as usize).copied();
            match (welded(a), welded(b)) {
                (Some(p), Some(q)) if known.contains(&edge(p, q)) => graph.insert(edge(p, q), must(CurveKind::Crease)),
                _ => return Err(FeatureError::NoSuchEdge { crease, a, b }),
            }
        }
        for (k, &(e, angle)) in bent.iter().enumerate() {
            token.check_at(k)?;
            graph.insert(e, What { kind: CurveKind::Crease, kept: false, angle });
        }
        let left_out = graph.prune(ruler, options.shortest, token)?;
        if options.alone > 0.0 && options.crease_angle_deg > 0.0 {
            bends.add_ridges(&mut graph, options.crease_angle_deg, (options.alone, options.shortest), token)?;
        }
        let near = Near { length: options.near, reach: options.reach, off: HARDLY * options.reach };
        let (curves, corners, joined) = graph.curves(ruler, near, token)?;
        Ok(Self { curves, corners, left_out, joined })
    }

    /// Checks that an angle makes sense and that `given` edges are there.
    ///
    /// # Errors
    /// [`FeatureError::NoSuchEdge`].
    pub fn check(mesh: &TriMesh, crease_angle_deg: f64, given: &[[u32; 2]], token: &Token) -> Result<(), FeatureError> {
        if !(0.0..=180.0).contains(&crease_angle_deg) {
            return Err(FeatureError::BadAngle(crease_angle_deg));
        }
        if given.is_empty() {
            return Ok(());
        }
        let options = FeatureOptions { given: given.to_vec(), ..FeatureOptions::default() };
        Self::find(mesh, mesh.positions(), &options, token).map(|_| ())
    }

    /// Keeps the curves for which `keep` says so, and the corners that these have.
    pub fn retain(&mut self, mut keep: impl FnMut(usize, &Curve) -> bool) {
        let mut number = 0;
        self.curves.retain(|c| {
            number += 1;
            keep(number - 1, c)
        });
        let ends: std::collections::BTreeSet<u32> = self
            .curves
            .iter()
            .filter(|c| !c.closed)
            .flat_map(|c| [c.vertices[0], c.vertices[c.vertices.len() - 1]])
            .collect();
        self.corners.retain(|v| ends.contains(v));
    }
}

impl Curve {
    /// Its vertices in order, a closed curve's first one again at the end.
    pub fn round(&self) -> impl Iterator<Item = u32> + '_ {
        self.vertices.iter().copied().chain(self.closed.then(|| self.vertices[0]))
    }
}

fn all_edges<'a>(mesh: &'a TriMesh, adjacency: &'a Adjacency) -> impl Iterator<Item = Edge> + 'a {
    let class = adjacency.representative();
    (0..3 * mesh.facets().len()).map(move |half| {
        let corners = mesh.facets()[half / 3];
        edge(class[corners[half % 3] as usize], class[corners[(half + 1) % 3] as usize])
    })
}

/// Edges that are bent by more than `angle` degrees, with their angles, and boundary edges; both ascending.
fn classify(
    mesh: &TriMesh,
    bends: &Bends<'_>,
    adjacency: &Adjacency,
    angle: f64,
    token: &Token,
) -> Result<(Vec<Bent>, Vec<Edge>), Stopped> {
    let (mut bent, mut boundary) = (Vec::new(), Vec::new());
    for (half, e) in all_edges(mesh, adjacency).enumerate() {
        token.check_at(half)?;
        match (adjacency.kind(half), adjacency.opposite(half)) {
            (EdgeKind::Boundary, _) => boundary.push(e),
            (_, Some(other)) if angle > 0.0 && half < other => {
                bent.extend(bends.at(half).filter(|&bend| bend > angle).map(|bend| (e, bend)));
            }
            _ => {}
        }
    }
    bent.sort_unstable_by_key(|b| b.0);
    boundary.sort_unstable();
    Ok((bent, boundary))
}

/// Feature edges around each vertex.
#[derive(Default)]
struct Graph {
    around: BTreeMap<u32, Vec<u32>>,
    edges: BTreeMap<Edge, What>,
}

/// What a feature edge is.
#[derive(Clone, Copy)]
struct What {
    kind: CurveKind,
    /// Whether it must stay.
    kept: bool,
    /// How much it is bent, degrees.
    angle: f64,
}

impl Graph {
    /// Adds an edge that is not there yet.
    fn insert(&mut self, e: Edge, what: What) {
        if e[0] != e[1] && !self.edges.contains_key(&e) {
            self.edges.insert(e, what);
            self.around.entry(e[0]).or_default().push(e[1]);
            self.around.entry(e[1]).or_default().push(e[0]);
        }
    }

    fn remove(&mut self, e: Edge) {
        self.edges.remove(&e);
        for (v, u) in [(e[0], e[1]), (e[1], e[0])] {
            if let Some(list) = self.around.get_mut(&v) {
                list.retain(|&x| x != u);
                if list.is_empty() {
                    self.around.remove(&v);
                }
            }
        }
    }

    fn degree(&self, v: u32) -> usize {
        self.around.get(&v).map_or(0, Vec::len)
    }

    /// The chain that begins with the edge from `v` to `next`, through vertices of two edges.
    fn chain(&self, v: u32, next: u32) -> Vec<u32> {
        let mut chain = vec![v, next];
        let (mut before, mut here) = (v, next);
        while self.degree(here) == 2 && here != v {
            let list = &self.around[&here];
            let ahead = if list[0] == before { list[1] } else { list[0] };
            chain.push(ahead);
            (before, here) = (here, ahead);
        }
        chain
    }

    /// Takes creases out that end freely within `shortest`, again and again, and then whole
    /// networks of them that are shorter. Returns how many edges went.
    fn prune(&mut self, ruler: Ruler<'_>, shortest: f64, token: &Token) -> Result<usize, Stopped> {
        let before = self.edges.len();
        loop {
            self.drop_loose_ends(ruler, shortest, token)?;
            if !self.drop_short_networks(ruler, shortest, token)? {
                return Ok(before - self.edges.len());
            }
        }
    }

    fn drop_loose_ends(&mut self, ruler: Ruler<'_>, shortest: f64, token: &Token) -> Result<(), Stopped> {
        loop {
            let ends: Vec<u32> = self.around.iter().filter(|(_, l)| l.len() == 1).map(|(&v, _)| v).collect();
            let mut loose: Vec<(f64, Vec<u32>)> = Vec::new();
            for v in ends {
                token.check()?;
                let chain = self.chain(v, self.around[&v][0]);
                let length = ruler.chain(&chain);
                if length < shortest && self.may_go(&chain) {
                    loose.push((length, chain));
                }
            }
            // The shortest first, one at a time where they meet: what is left of a junction may be one long curve.
            loose.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
            let mut touched = std::collections::BTreeSet::new();
            let mut gone = 0;
            for (_, chain) in loose {
                token.check()?;
                let ends = [chain[0], chain[chain.len() - 1]];
                if ends.iter().any(|v| touched.contains(v)) {
                    continue;
                }
                touched.extend(ends);
                chain.windows(2).for_each(|p| self.remove(edge(p[0], p[1])));
                gone += 1;
            }
            if gone == 0 {
                return Ok(());
            }
        }
    }

    fn may_go(&self, chain: &[u32]) -> bool {
        chain.windows(2).all(|p| self.edges.get(&edge(p[0], p[1])).is_none_or(|what| !what.kept))
    }

    /// Takes networks out that are short or tangled; of such that are tangled since edges count that are bent but little,
    /// these edges alone. Returns whether there were any of those, so that what is left is to be looked at again.
    fn drop_short_networks(&mut self, ruler: Ruler<'_>, shortest: f64, token: &Token) -> Result<bool, Stopped> {
        let mut thinned = false;
        let mut seen = std::collections::BTreeSet::new();
        let starts: Vec<u32> = self.around.keys().copied().collect();
        for start in starts {
            if !seen.insert(start) {
                continue;
            }
            let (mut stack, mut edges) = (vec![start], std::collections::BTreeSet::new());
            let mut ends = 0;
            token.check()?;
            while let Some(v) = stack.pop() {
                token.check_at(edges.len())?;
                ends += if self.degree(v) == 2 { 0 } else { self.degree(v) };
                for &u in self.around.get(&v).into_iter().flatten() {
                    edges.insert(edge(v, u));
                    if seen.insert(u) {
                        stack.push(u);
                    }
                }
            }
            if edges.iter().any(|e| self.edges.get(e).is_some_and(|what| what.kept)) {
                continue;
            }
            let length = |e: &Edge| ruler.edge(e[0], e[1]);
            let total: f64 = edges.iter().map(length).sum();
            let sharp: f64 = edges.iter().filter(|e| self.edges[*e].angle >= SHARP_ANGLE).map(length).sum();
            let chains = (ends / 2).max(1) as f64;
            let least = if sharp >= 0.5 * total { TANGLE_OF_SHARP } else { TANGLE };
            let tangled = total < least * shortest * chains;
            let weakest = edges.iter().map(|e| self.edges[e].angle).fold(f64::INFINITY, f64::min);
            let gone = if total < 2.0 * shortest {
                f64::INFINITY
            } else if !tangled {
                continue;
            } else if weakest < PLAIN_ANGLE {
                thinned = true;
                PLAIN_ANGLE.min(2.0 * weakest)
            } else {
                f64::INFINITY
            };
            let bent = |e: &Edge| self.edges[e].angle;
            let gone: Vec<Edge> = edges.into_iter().filter(|e| bent(e) < gone || bent(e) == weakest).collect();
            for (k, e) in gone.into_iter().enumerate() {
                token.check_at(64 * k)?;
                self.remove(e);
            }
        }
        Ok(thinned)
    }

    /// The curves between corners, the corners, and how many of them have become part of others.
    fn curves(&self, ruler: Ruler<'_>, near: Near, token: &Token) -> Result<(Vec<Curve>, Vec<u32>, usize), Stopped> {
        let kind = |a: u32, b: u32| self.edges[&edge(a, b)].kind;
        let bend =
            |c: &[u32]| c.windows(2).map(|p| self.edges[&edge(p[0], p[1])].angle).sum::<f64>() / (c.len() - 1) as f64;
        let mut corners: std::collections::BTreeSet<u32> = self
            .around
            .iter()
            .filter(|(v, l)| l.len() != 2 || kind(**v, l[0]) != kind(**v, l[1]))
            .map(|(&v, _)| v)
            .collect();
        let mut curves = Vec::new();
        let mut done = std::collections::BTreeSet::new();
        let ends: Vec<u32> = corners.iter().copied().chain(self.around.keys().copied()).collect();
        for v in ends {
            token.check()?;
            for &next in &self.around[&v] {
                if done.contains(&edge(v, next)) {
                    continue;
                }
                let chain = self.chain_to(v, next, &corners);
                chain.windows(2).for_each(|p| {
                    done.insert(edge(p[0], p[1]));
                });
                let closed = chain[0] == chain[chain.len() - 1] && !corners.contains(&v);
                split(&chain, closed, kind(v, next), (ruler, near.reach), (&mut corners, &mut curves), token)?;
            }
        }
        for (k, curve) in curves.iter_mut().enumerate() {
            token.check_at(k)?;
            let chain: Vec<u32> = curve.round().collect();
            curve.angle_deg = bend(&chain);
            let few = chain.len().min(END_EDGES + 1);
            curve.ends_deg = [bend(&chain[..few]), bend(&chain[chain.len() - few..])];
        }
        token.check()?;
        let joined = near::join(&mut curves, &mut corners, ruler, near, token)?;
        token.check()?;
        curves.sort_by(|a: &Curve, b| a.vertices.cmp(&b.vertices));
        Ok((curves, corners.into_iter().collect(), joined))
    }

    fn chain_to(&self, v: u32, next: u32, corners: &std::collections::BTreeSet<u32>) -> Vec<u32> {
        let mut chain = vec![v, next];
        let (mut before, mut here) = (v, next);
        while here != v && !corners.contains(&here) {
            let list = &self.around[&here];
            let ahead = if list[0] == before { list[1] } else { list[0] };
            chain.push(ahead);
            (before, here) = (here, ahead);
        }
        chain
    }
}

/// Cuts a chain where it turns sharply.
fn split(
    chain: &[u32],
    closed: bool,
    kind: CurveKind,
    (ruler, reach): (Ruler<'_>, f64),
    (corners, curves): (&mut std::collections::BTreeSet<u32>, &mut Vec<Curve>),
    token: &Token,
) -> Result<(), Stopped> {
    let turns = sharp_turns(chain, closed, (ruler, reach), token)?;
    let last = chain.len() - 1;
    if turns.is_empty() {
        let vertices = if closed { chain[..last].to_vec() } else { chain.to_vec() };
        curves.push(Curve { kind, vertices, closed, angle_deg: 0.0, ends_deg: [0.0; 2] });
        return Ok(());
    }
    corners.extend(turns.iter().map(|&k| chain[k]));
    let mut pieces: Vec<Vec<u32>> = Vec::new();
    if closed {
        for (i, &from) in turns.iter().enumerate() {
            let to = turns.get(i + 1).copied().unwrap_or(turns[0] + last);
            pieces.push((from..=to).map(|k| chain[k % last]).collect());
        }
    } else {
        let cuts: Vec<usize> = std::iter::once(0).chain(turns).chain(std::iter::once(last)).collect();
        pieces.extend(cuts.windows(2).map(|c| chain[c[0]..=c[1]].to_vec()));
    }
    curves.extend(pieces.into_iter().map(|vertices| Curve {
        kind,
        vertices,
        closed: false,
        angle_deg: 0.0,
        ends_deg: [0.0; 2],
    }));
    Ok(())
}

/// Places in a chain where it turns by more than [`CORNER_ANGLE`] between the points `reach` behind and
/// ahead: the sharpest within each stretch of that length.
fn sharp_turns(
    chain: &[u32],
    closed: bool,
    (ruler, reach): (Ruler<'_>, f64),
    token: &Token,
) -> Result<Vec<usize>, Stopped> {
    let p: Vec<DVec3> = chain.iter().map(|&v| ruler.at(v)).collect();
    let last = p.len() - 1;
    let mut along = vec![0.0];
    chain.windows(2).for_each(|w| along.push(along[along.len() - 1] + ruler.edge(w[0], w[1])));
    let total = along[last];
    // The point at arc length s.
    let at = |s: f64| {
        let s = if closed { s.rem_euclid(total) } else { s.clamp(0.0, total) };
        let k = along.partition_point(|&a| a <= s).clamp(1, last);
        let width = along[k] - along[k - 1];
        if width > 0.0 { p[k - 1].lerp(p[k], (s - along[k - 1]) / width) } else { p[k] }
    };
    let limit = CORNER_ANGLE.to_radians().cos();
    let inner = if closed { 0..last } else { 1..last };
    let reach = reach.min(total / 3.0);
    let cosine = |k: usize| {
        let (back, ahead) = (p[k] - at(along[k] - reach), at(along[k] + reach) - p[k]);
        back.normalize_or_zero().dot(ahead.normalize_or_zero())
    };
    let mut found: Vec<(f64, usize)> = inner.map(|k| (cosine(k), k)).filter(|&(c, _)| c < limit).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let apart = |j: usize, k: usize| {
        let d = (along[k] - along[j]).abs();
        if closed { d.min(total - d) } else { d }
    };
    // Arc length ascends with the place, so that of those taken only the next ones count, and round the end of a closed
    // chain the first and the last.
    let mut taken = std::collections::BTreeSet::new();
    for (n, (_, k)) in found.into_iter().enumerate() {
        token.check_at(n)?;
        let beside = [taken.range(..=k).next_back(), taken.range(k..).next(), taken.first(), taken.last()];
        if beside.into_iter().flatten().all(|&j| apart(j, k) > reach) {
            taken.insert(k);
        }
    }
    Ok(taken.into_iter().collect())
}
