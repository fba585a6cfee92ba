//! Pieces of sheets that touch themselves.
//!
//! Purpose: [`Sheets::in_pieces`] divides a sheet that has several fans of facets at one vertex, as of a solid that touches itself along
//! an edge, so that no piece has. Pieces end at creases, which a remesh keeps anyway, and where a patch between creases touches itself,
//! half way. A closed curve along which a patch comes back to itself is divided into stretches.
//! Invariant: depends on the mesh, the angle of creases and the least area alone. A sheet stays whole if a facet is of two fans at one
//! place, and if a piece would have less than the least area. Where a smooth patch touches itself in less than an edge, that is noise: a
//! sheet with much of it stays whole, and rare noise is no place to divide for. Must not know: why pieces are wanted.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use glam::DVec3;

use super::pairing::{Pairing, ends_of};
use super::{Link, Sheets, whole_facets};
use crate::mesh::adjacency::weld_unless;
use crate::mesh::edges::{DisjointSets, EdgeGroups, Half};
use crate::mesh::{TriMesh, normal};
use crate::token::{Stopped, Token};

/// How often pieces are divided further: a border between pieces may part what was one fan.
const MOST_ROUNDS: usize = 4;

/// Cells that the least area has room for.
const LEAST_CELLS: f64 = 4.0;

/// Noise is rare if no more than this share of the places in which a sheet touches itself are.
const RARE_NOISE: f64 = 0.1;

/// A piece is plane if the sum of its facets' areas with their directions is more than this share of its area.
const PLANE: f64 = 1.0 - 1e-6;

/// Stretches of a curve that is divided.
const BANDS: usize = 3;

/// What decides about pieces.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PieceOptions {
    /// Pieces have more area than this.
    pub least: f64,
    /// The same for plane ones: they are what their border is, and need few vertices of their own.
    pub least_plane: f64,
    /// As in [`Sheets::of`].
    pub go_on: bool,
    /// A crease is where facets make an angle of more than this, radians.
    pub crease: f64,
}

impl Sheets {
    /// The same with sheets that touch themselves in pieces; `None` if there are none, or none can be divided.
    pub(crate) fn in_pieces(
        &self,
        mesh: &TriMesh,
        options: PieceOptions,
        token: &Token,
    ) -> Result<Option<Self>, Stopped> {
        let class = weld_unless(mesh, token)?;
        let groups = EdgeGroups::unless(class.len(), whole_facets(mesh, &class), token)?;
        let pairing = Pairing::of(mesh, (&class, &groups), options.go_on, token)?;
        let whole = Whole { mesh, class: &class, groups: &groups, pairing, options, token };
        let given: Vec<usize> = self.of_facet.iter().map(|&sheet| sheet as usize).collect();
        let touching = whole.contacts(&given)?;
        // Sheets that stay whole, and places for which none is divided.
        let (mut left, noise) = whole.noise(&touching, &self.of_facet);
        let of_facet = loop {
            let mut of_facet = given.clone();
            let mut failed: BTreeSet<u32> = BTreeSet::new();
            for round in 0..=MOST_ROUNDS {
                let mut contacts = if round == 0 { touching.clone() } else { whole.contacts(&of_facet)? };
                contacts.retain(|c| !(left.contains(&self.of_facet[c.facet]) || noise.contains(&c.place)));
                if contacts.is_empty() {
                    break;
                }
                let all = || contacts.iter().map(|contact| self.of_facet[contact.facet]).collect();
                failed = if round == MOST_ROUNDS {
                    all()
                } else {
                    whole.divide(&mut of_facet, &contacts, &self.of_facet)?
                };
                if !failed.is_empty() {
                    break;
                }
            }
            if failed.is_empty() {
                break of_facet;
            }
            left.append(&mut failed);
        };
        // Facets that name a point twice are of a piece that they touch.
        let mut at: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        let mut first: BTreeMap<(u32, usize), usize> = BTreeMap::new();
        let mut sets = DisjointSets::new(of_facet.len());
        let mut is_placed = vec![false; of_facet.len()];
        for (f, corners) in whole_facets(mesh, &class) {
            is_placed[f] = true;
            sets.join(f, *first.entry((self.of_facet[f], of_facet[f])).or_insert(f));
            for v in corners {
                at.entry((v, self.of_facet[f])).or_insert(f);
            }
        }
        for f in (0..of_facet.len()).filter(|&f| !is_placed[f]) {
            let beside = mesh.facets()[f].iter().find_map(|&v| at.get(&(class[v as usize], self.of_facet[f])));
            sets.join(f, beside.copied().unwrap_or(f));
        }
        let mut pieces = Self::numbered(mesh, &class, &groups, &mut sets);
        if pieces.count <= self.count {
            return Ok(None);
        }
        let mut joined = Vec::new();
        whole.edges(|ends, _, links| {
            let parted = links.iter().filter(|[a, b]| pieces.of_facet[*a as usize] != pieces.of_facet[*b as usize]);
            joined.extend(parted.map(|&link| (ends, link)));
        });
        (pieces.joined, pieces.whole) = (joined, self.whole);
        Ok(Some(pieces))
    }
}

/// A facet at a place where its sheet touches itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Contact {
    /// A vertex twice, or the ends of an edge.
    place: [u32; 2],
    sheet: usize,
    fan: usize,
    facet: usize,
}

/// Two facets of one sheet, and the edge between them.
struct Across {
    link: Link,
    is_crease: bool,
    length: f64,
}

/// The surface before it is divided.
struct Whole<'a> {
    mesh: &'a TriMesh,
    class: &'a [u32],
    groups: &'a EdgeGroups,
    pairing: Pairing,
    options: PieceOptions,
    token: &'a Token,
}

impl Whole<'_> {
    /// Calls `visit` with the ends of each edge, the lower first, its sides, and the pairs of facets through which a sheet goes on there.
    fn edges(&self, mut visit: impl FnMut([u32; 2], &[Half], &[Link])) {
        self.groups.for_each(|low, halves| {
            let ends = ends_of((self.mesh, self.class), low, halves);
            visit(ends, halves, &self.pairing.at(ends, halves));
        });
    }

    /// Where sheets have several fans of facets, in order.
    fn contacts(&self, of_facet: &[usize]) -> Result<Vec<Contact>, Stopped> {
        let Self { mesh, class, .. } = *self;
        let corner = |facet: u32, v: u32| {
            let corners = mesh.facets()[facet as usize];
            3 * facet as usize + (0..3).find(|&k| class[corners[k] as usize] == v).unwrap_or(0)
        };
        let mut fans = DisjointSets::new(3 * of_facet.len());
        let mut contacts: Vec<Contact> = Vec::new();
        self.edges(|place, halves, links| {
            let within = || links.iter().filter(|[a, b]| of_facet[*a as usize] == of_facet[*b as usize]);
            for [a, b] in within() {
                place.iter().for_each(|&v| fans.join(corner(*a, v), corner(*b, v)));
            }
            // Where all sheets end, two sides of one are as an edge of a manifold; more, or two that face opposite sides, are not.
            if links.is_empty() && halves.len() > 2 {
                let sheet = |half: &Half| of_facet[half.facet as usize];
                let forward = |half: &Half| {
                    let first = mesh.facets()[half.facet as usize][half.side];
                    class[first as usize] == place[0]
                };
                let touches = |half: &Half| {
                    let own: Vec<&Half> = halves.iter().filter(|other| sheet(other) == sheet(half)).collect();
                    own.len() > 2 || own.len() == 2 && forward(own[0]) == forward(own[1])
                };
                for (fan, half) in halves.iter().enumerate().filter(|(_, half)| touches(half)) {
                    contacts.push(Contact { place, sheet: sheet(half), fan, facet: half.facet as usize });
                }
            }
            // Where several pairs have the edge, each is a fan of its own.
            if links.len() > 1 && links.windows(2).all(|pair| pair[0][1] != pair[1][0]) {
                for (fan, facet) in within().enumerate().flat_map(|(fan, link)| link.map(|f| (fan, f as usize))) {
                    contacts.push(Contact { place, sheet: of_facet[facet], fan, facet });
                }
            }
        });
        self.token.check()?;
        let mut first = vec![None; class.len()];
        let mut several = vec![false; class.len()];
        for (f, corners) in whole_facets(mesh, class) {
            self.token.check_at(f)?;
            for (k, v) in corners.into_iter().enumerate() {
                let fan = fans.root(3 * f + k);
                several[v as usize] |= *first[v as usize].get_or_insert(fan) != fan;
            }
        }
        for (facet, corners) in whole_facets(mesh, class) {
            for (k, v) in corners.into_iter().enumerate().filter(|(_, v)| several[*v as usize]) {
                let fan = fans.root(3 * facet + k);
                contacts.push(Contact { place: [v, v], sheet: of_facet[facet], fan, facet });
            }
        }
        contacts.sort_unstable();
        let touches = |group: &&[Contact]| group[0].fan != group[group.len() - 1].fan;
        Ok(contacts.chunk_by(at_one_place).filter(touches).flatten().copied().collect())
    }

    /// Divides the sheets of the contacts. Returns the sheets of `given` that cannot be divided, then `of_facet` is of no use.
    fn divide(&self, of_facet: &mut [usize], contacts: &[Contact], given: &[u32]) -> Result<BTreeSet<u32>, Stopped> {
        let divided: BTreeSet<usize> = contacts.iter().map(|contact| contact.sheet).collect();
        let across = self.across(|link| {
            let [a, b] = link.map(|f| of_facet[f as usize]);
            a == b && divided.contains(&a)
        });
        self.token.check()?;
        let mut patches = patches_of(of_facet.len(), &across);
        let groups = contacts.chunk_by(at_one_place);
        let touching: BTreeSet<usize> = groups.flat_map(|group| twice(&mut patches, group)).collect();
        if !touching.is_empty() {
            let part = self.parts((&mut patches, &touching), contacts, &across)?;
            let is_inner = |across: &&Across| part[across.link[0] as usize] == part[across.link[1] as usize];
            patches = patches_of(of_facet.len(), across.iter().filter(is_inner));
        }
        let mut failed = self.merge(&mut patches, contacts, &across, given)?;
        // Of each piece its area, and the sum of what its facets have with their directions.
        let mut sizes: BTreeMap<usize, (f64, DVec3)> = BTreeMap::new();
        for (f, _) in whole_facets(self.mesh, self.class).filter(|(f, _)| divided.contains(&of_facet[*f])) {
            let (area, sum) = sizes.entry(patches.root(f)).or_default();
            let directed = 0.5 * normal(self.mesh.corners(f));
            *area += directed.length();
            *sum += directed;
        }
        let least = |(area, sum): (f64, DVec3)| {
            if sum.length() > PLANE * area { self.options.least_plane } else { self.options.least }
        };
        failed.extend(sizes.into_iter().filter(|(_, size)| size.0 <= least(*size)).map(|(f, _)| given[f]));
        // Numbers of sheets are below the number of facets.
        let count = of_facet.len();
        let facets = of_facet.iter_mut().enumerate().filter(|(_, sheet)| divided.contains(sheet));
        facets.for_each(|(f, sheet)| *sheet = count + patches.root(f));
        Ok(failed)
    }

    /// Places where a patch touches itself in less than an edge, and the sheets of `given` in which they are not rare.
    fn noise(&self, contacts: &[Contact], given: &[u32]) -> (BTreeSet<u32>, BTreeSet<[u32; 2]>) {
        let touching: BTreeSet<u32> = contacts.iter().map(|contact| given[contact.facet]).collect();
        let across =
            self.across(|[a, b]| given[a as usize] == given[b as usize] && touching.contains(&given[a as usize]));
        let mut patches = patches_of(given.len(), &across);
        let groups = || contacts.chunk_by(at_one_place);
        let mut chains = DisjointSets::new(self.class.len());
        let edges = || groups().map(|group| group[0].place).filter(|[a, b]| a != b);
        edges().for_each(|[a, b]| chains.join(a as usize, b as usize));
        let mut length: BTreeMap<usize, f64> = BTreeMap::new();
        for place in edges() {
            let [p, q] = place.map(|v| self.mesh.positions()[v as usize]);
            *length.entry(chains.root(place[0] as usize)).or_default() += p.distance(q);
        }
        // The side of one of the cells that a piece has at least.
        let edge = (self.options.least / LEAST_CELLS).sqrt();
        let mut noise = BTreeSet::new();
        // By sheet: the places, and those of them that are noise.
        let mut counts: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
        for group in groups() {
            let chain = chains.root(group[0].place[0] as usize);
            let is_noise =
                length.get(&chain).is_none_or(|length| *length < edge) && !twice(&mut patches, group).is_empty();
            let [all, noisy] = counts.entry(given[group[0].facet]).or_default();
            *all += 1;
            if is_noise {
                *noisy += 1;
                noise.insert(group[0].place);
            }
        }
        let is_noisy = |[all, noisy]: [usize; 2]| noisy as f64 > RARE_NOISE * all as f64;
        (counts.into_iter().filter(|(_, counts)| is_noisy(*counts)).map(|(sheet, _)| sheet).collect(), noise)
    }

    /// Edges between facets of one sheet.
    fn across(&self, wanted: impl Fn(Link) -> bool) -> Vec<Across> {
        let Self { mesh, class, .. } = *self;
        let unit = |f: u32| normal(mesh.corners(f as usize)).normalize_or_zero();
        let mut found = Vec::new();
        self.edges(|ends, _, links| {
            // Facets that face opposite sides run along the edge the same way.
            let runs = |f: u32| {
                let t = mesh.facets()[f as usize].map(|v| class[v as usize]);
                (0..3).any(|k| [t[k], t[(k + 1) % 3]] == ends)
            };
            for &link in links.iter().filter(|link| wanted(**link)) {
                let [a, b] = link;
                let way = if runs(a) == runs(b) { -1.0 } else { 1.0 };
                let is_crease = way * unit(a).dot(unit(b)) < self.options.crease.cos();
                let [p, q] = ends.map(|v| mesh.positions()[v as usize]);
                found.push(Across { link, is_crease, length: p.distance(q) });
            }
        });
        found
    }

    /// For each facet of the `touching` patches the fan that it is nearest to, through facets of its patch. Fans with a common facet
    /// count as one, unless that makes two of one place one.
    fn parts(
        &self,
        (patches, touching): (&mut DisjointSets, &BTreeSet<usize>),
        contacts: &[Contact],
        across: &[Across],
    ) -> Result<Vec<usize>, Stopped> {
        let count = self.mesh.facets().len();
        let of_patches = contacts.iter().filter(|contact| touching.contains(&patches.root(contact.facet)));
        let of_patches: Vec<Contact> = of_patches.copied().collect();
        let node = |contact: &Contact| BANDS * contact.facet;
        let mut fans = DisjointSets::new(BANDS * count);
        for group in of_patches.chunk_by(at_one_place) {
            let mut first: BTreeMap<(usize, usize), usize> = BTreeMap::new();
            for contact in group {
                let key = (patches.root(contact.facet), contact.fan);
                fans.join(*first.entry(key).or_insert(node(contact)), node(contact));
            }
        }
        let is_whole = of_patches.chunk_by(at_one_place).all(|group| {
            let mut met: BTreeMap<usize, usize> = BTreeMap::new();
            group.iter().all(|contact| *met.entry(fans.root(node(contact))).or_insert(contact.fan) == contact.fan)
        });
        let band;
        let in_bands;
        let node: &dyn Fn(&Contact) -> usize = if is_whole {
            &node
        } else {
            // A curve that comes back to a fan from another side is divided into stretches.
            band = bands(&of_patches);
            in_bands = |contact: &Contact| BANDS * contact.facet + band.get(&contact.place[0]).copied().unwrap_or(0);
            fans = self.parted_fans(&of_patches, &in_bands);
            &in_bands
        };
        let mut queue: BinaryHeap<Reverse<(u64, usize, usize)>> = BinaryHeap::new();
        of_patches.iter().for_each(|contact| queue.push(Reverse((0, contact.facet, node(contact)))));
        let mut beside: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for Across { link, .. } in across.iter().filter(|across| !across.is_crease) {
            let [a, b] = link.map(|f| f as usize);
            if touching.contains(&patches.root(a)) {
                beside.entry(a).or_default().push(b);
                beside.entry(b).or_default().push(a);
            }
        }
        let middle = |f: usize| self.mesh.corners(f).iter().sum::<DVec3>() / 3.0;
        let mut part: Vec<usize> = vec![usize::MAX; count];
        // Lengths are not negative, so that their bits are in their order.
        while let Some(Reverse((bits, f, from))) = queue.pop() {
            self.token.check()?;
            if part[f] != usize::MAX {
                continue;
            }
            part[f] = fans.root(from);
            for &g in beside.get(&f).into_iter().flatten().filter(|g| part[**g] == usize::MAX) {
                let length = f64::from_bits(bits) + middle(f).distance(middle(g));
                queue.push(Reverse((length.to_bits(), g, from)));
            }
        }
        Ok(part)
    }

    /// Sets of facets at the places of contact, by the numbers that `node` has for them: neighbours of a fan are in one, unless it then has
    /// two fans at one place.
    fn parted_fans(&self, contacts: &[Contact], node: &dyn Fn(&Contact) -> usize) -> DisjointSets {
        let mut nodes: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
        contacts.iter().for_each(|contact| _ = nodes.entry(contact.facet).or_default().insert(node(contact)));
        let mut sets = PartedSets::new(DisjointSets::new(BANDS * self.mesh.facets().len()));
        let pairs = |group: &[Contact]| {
            let all = group.to_vec();
            (0..all.len()).flat_map(move |k| all[k + 1..].iter().map(|other| (all[k], *other)).collect::<Vec<_>>())
        };
        for (a, b) in contacts.chunk_by(at_one_place).flat_map(pairs).filter(|(a, b)| a.fan != b.fan) {
            nodes[&a.facet].iter().for_each(|&a| nodes[&b.facet].iter().for_each(|&b| sets.part(a, b)));
        }
        let corners = |f: usize| self.mesh.facets()[f].map(|v| self.class[v as usize]);
        let meet = |a: usize, b: usize| corners(a).iter().filter(|v| corners(b).contains(v)).count() > 1;
        for (a, b) in contacts.chunk_by(at_one_place).flat_map(pairs) {
            if a.fan == b.fan && meet(a.facet, b.facet) {
                sets.join(node(&a), node(&b));
            }
        }
        sets.sets
    }

    /// Joins patches until any further one would have a piece touch itself. Returns the sheets that have a patch which does.
    fn merge(
        &self,
        patches: &mut DisjointSets,
        contacts: &[Contact],
        across: &[Across],
        given: &[u32],
    ) -> Result<BTreeSet<u32>, Stopped> {
        let mut failed = BTreeSet::new();
        let mut parted = PartedSets::new(std::mem::replace(patches, DisjointSets::new(0)));
        for group in contacts.chunk_by(at_one_place) {
            let mut of_fans: Vec<(usize, usize)> = group.iter().map(|c| (c.fan, parted.sets.root(c.facet))).collect();
            of_fans.dedup();
            for (k, &(fan, patch)) in of_fans.iter().enumerate() {
                for &(_, other) in of_fans[k + 1..].iter().filter(|other| other.0 != fan) {
                    if patch == other {
                        failed.insert(given[patch]);
                    }
                    parted.part(patch, other);
                }
            }
        }
        let mut borders: BTreeMap<[usize; 2], (f64, f64)> = BTreeMap::new();
        for Across { link, is_crease, length } in across {
            let [p, q] = link.map(|f| parted.sets.root(f as usize));
            if p != q {
                let (smooth, creased) = borders.entry([p.min(q), p.max(q)]).or_default();
                *(if *is_crease { creased } else { smooth }) += length;
            }
        }
        // The longest borders are taken away first, those that are no creases before all others.
        let mut borders: Vec<([usize; 2], (f64, f64))> = borders.into_iter().collect();
        borders.sort_by(|(a, (p, q)), (b, (r, s))| r.total_cmp(p).then(s.total_cmp(q)).then(a.cmp(b)));
        for ([p, q], _) in borders {
            self.token.check()?;
            parted.join(p, q);
        }
        *patches = parted.sets;
        Ok(failed)
    }
}

/// Sets that are joined unless two of them are to stay apart.
struct PartedSets {
    sets: DisjointSets,
    /// By the least of each set, those of the sets that it stays apart from.
    apart: BTreeMap<usize, BTreeSet<usize>>,
}

impl PartedSets {
    fn new(sets: DisjointSets) -> Self {
        Self { sets, apart: BTreeMap::new() }
    }

    fn part(&mut self, a: usize, b: usize) {
        let [a, b] = [a, b].map(|k| self.sets.root(k));
        self.apart.entry(a).or_default().insert(b);
        self.apart.entry(b).or_default().insert(a);
    }

    fn join(&mut self, a: usize, b: usize) {
        let [a, b] = [a, b].map(|k| self.sets.root(k));
        if a == b || self.apart.get(&a).is_some_and(|of| of.contains(&b)) {
            return;
        }
        self.sets.join(a, b);
        let [kept, gone] = [a.min(b), a.max(b)];
        for other in self.apart.remove(&gone).unwrap_or_default() {
            if let Some(of) = self.apart.get_mut(&other) {
                of.remove(&gone);
                of.insert(kept);
            }
            self.apart.entry(kept).or_default().insert(other);
        }
    }
}

/// For each vertex at which a sheet touches itself the stretch that it is in: by its distance along facets from the lowest that is
/// connected to it, the nearest third, the middle one, or the farthest.
fn bands(contacts: &[Contact]) -> BTreeMap<u32, usize> {
    let mut of_facet: BTreeMap<usize, BTreeSet<u32>> = BTreeMap::new();
    contacts.iter().for_each(|contact| of_facet.entry(contact.facet).or_default().extend(contact.place));
    let mut beside: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for places in of_facet.values() {
        places.iter().for_each(|v| beside.entry(*v).or_default().extend(places));
    }
    let mut band = BTreeMap::new();
    for &start in beside.keys() {
        if band.contains_key(&start) {
            continue;
        }
        let mut steps: BTreeMap<u32, usize> = BTreeMap::from([(start, 0)]);
        let mut queue = vec![start];
        let mut next = 0;
        while let Some(&v) = queue.get(next) {
            next += 1;
            for &u in &beside[&v] {
                if !steps.contains_key(&u) {
                    steps.insert(u, steps[&v] + 1);
                    queue.push(u);
                }
            }
        }
        let most = steps.values().max().copied().unwrap_or(0);
        band.extend(steps.into_iter().map(|(v, step)| (v, BANDS * step / (most + 1))));
    }
    band
}

/// Sets of facets between which there is no crease.
fn patches_of<'a>(facets: usize, across: impl IntoIterator<Item = &'a Across>) -> DisjointSets {
    let mut patches = DisjointSets::new(facets);
    for Across { link: [a, b], .. } in across.into_iter().filter(|across| !across.is_crease) {
        patches.join(*a as usize, *b as usize);
    }
    patches
}

/// The patches that have several fans at one place.
fn twice(patches: &mut DisjointSets, group: &[Contact]) -> Vec<usize> {
    let mut of_fans: Vec<(usize, usize)> = group.iter().map(|c| (patches.root(c.facet), c.fan)).collect();
    of_fans.sort_unstable();
    of_fans.dedup();
    of_fans.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[0].0).collect()
}

fn at_one_place(a: &Contact, b: &Contact) -> bool {
    (a.place, a.sheet) == (b.place, b.sheet)
}
