//! An answer's arrays, checked before anything is made of them.
//!
//! Purpose: [`Expected`] takes chunks only of arrays that were asked for, and no more of them than the request can
//! bring about; the rest of this file checks that arrays fit together. Invariant: memory for an answer follows from
//! the request, not from what a server says. All errors are the server's. Must not know: calls, files.

use std::collections::HashMap;

use anyhow::Result;

use super::faults::wrong;
use geometry::cvt::density::DensitySource;
use geometry::mesh::TriMesh;
use geometry::remesh::{RemeshOptions, Seeds};
use geometry::rvd::{PieceBatch, facet_edge};
use wire::attributes;
use wire::counts::MeshCounts;
use wire::proto::{ArrayKind, AttributeHeader, AttributeKind, CellsChunk, Chunk, RemeshDone};

/// As many elements as the protocol can count.
const MOST: u64 = i32::MAX as u64;
/// The longest report: some hundred bytes an iteration.
const REPORT_BYTES: u64 = 256 << 20;

#[derive(Clone, Copy, Debug)]
struct Room {
    /// The whole array is a multiple of this.
    element_bytes: u64,
    bytes: u64,
}

impl Room {
    fn of(element_bytes: u64, count: u64) -> Self {
        Self { element_bytes, bytes: element_bytes * count.min(3 * MOST) }
    }
}

/// Arrays on their way: what each may be, what has come, and what is to come.
#[derive(Debug, Default)]
pub(super) struct Expected {
    rooms: HashMap<(i32, u32), Room>,
    came: HashMap<(i32, u32), (u64, u64)>,
}

impl Expected {
    /// What a remesh brings. The bounds are generous: no result comes near them.
    pub(super) fn of_remesh(mesh: &TriMesh, options: &RemeshOptions, announced: &[AttributeHeader]) -> Self {
        let (vertices, facets) = most(mesh, options);
        let mut expected = Self::default();
        for (kind, bytes, count) in [
            (ArrayKind::Positions, 24, vertices),
            (ArrayKind::Facets, 12, facets),
            (ArrayKind::Creases, 8, 3 * facets),
            (ArrayKind::Report, 1, REPORT_BYTES),
        ] {
            expected.add(kind, 0, Room::of(bytes, count));
        }
        for (header, place) in announced.iter().zip(0..) {
            match AttributeKind::try_from(header.kind) {
                Ok(AttributeKind::Normals) => {
                    expected.add(ArrayKind::Normals, 0, Room::of(8, 9 * facets));
                    expected.add(ArrayKind::NormalCorners, 0, Room::of(12, facets));
                }
                Ok(AttributeKind::TextureCoordinates) => {
                    expected.add(ArrayKind::TextureCoordinates, 0, Room::of(8, 6 * facets));
                    expected.add(ArrayKind::TextureCorners, 0, Room::of(12, facets));
                }
                // Of a byte or of eight.
                Ok(AttributeKind::Colours) => expected.add(ArrayKind::Colours, 0, Room::of(4, 8 * vertices)),
                Ok(AttributeKind::Scalar) => {
                    let numbers = u64::from(header.components.max(1));
                    expected.add(ArrayKind::Scalars, place, Room::of(1, 8 * numbers * vertices));
                }
                Ok(AttributeKind::Regions) => expected.add(ArrayKind::Regions, 0, Room::of(8, facets)),
                Ok(AttributeKind::Unspecified) | Err(_) => {}
            }
        }
        expected
    }

    /// What a diagram of `seeds` seeds brings beside its pieces.
    pub(super) fn of_rvd(seeds: u64, centroids: bool) -> Self {
        let mut expected = Self::default();
        expected.add(ArrayKind::Report, 0, Room::of(1, REPORT_BYTES));
        if centroids {
            expected.add(ArrayKind::Centroids, 0, Room::of(24, seeds));
        }
        expected
    }

    fn add(&mut self, kind: ArrayKind, place: u32, room: Room) {
        self.rooms.insert((kind.into(), place), room);
    }

    /// Checks the next chunk. `None` if its array was not asked for, and is not kept.
    pub(super) fn check(&mut self, mut chunk: Chunk) -> Result<Option<Chunk>> {
        if chunk.kind != i32::from(ArrayKind::Scalars) {
            // Not looked at for other arrays, and not a way to send one of them twice.
            chunk.attribute = 0;
        }
        let key = (chunk.kind, chunk.attribute);
        let Some(room) = self.rooms.get(&key) else { return Ok(None) };
        let (whole, length) = (chunk.total_bytes, chunk.data.len() as u64);
        let name = name(chunk.kind);
        if whole > room.bytes {
            let most = room.bytes;
            return Err(wrong(format!("{name} has {whole} bytes; what was asked for has at most {most} of it")));
        }
        if !whole.is_multiple_of(room.element_bytes) {
            return Err(wrong(format!("{name} has {whole} bytes, which are no whole elements")));
        }
        let (came, before) = self.came.entry(key).or_insert((0, whole));
        if *before != whole {
            return Err(wrong(format!("{name} has {before} bytes and then {whole}")));
        }
        if length > whole - *came {
            return Err(wrong(format!("{name} has {whole} bytes, but more were sent")));
        }
        *came += length;
        Ok(Some(chunk))
    }

    /// Whether all that was begun was brought to its end.
    pub(super) fn whole(&self) -> Result<()> {
        let cut = self.came.iter().find(|(_, (came, whole))| came != whole);
        let Some(((kind, _), (came, whole))) = cut else { return Ok(()) };
        Err(wrong(format!("of the {whole} bytes of {} only {came} were sent", name(*kind))))
    }

    /// Whether the attributes of the last message are those that were sent, for `mesh`.
    pub(super) fn attributes(&self, mesh: &TriMesh, headers: &[AttributeHeader]) -> Result<()> {
        let (vertices, facets) = (mesh.positions().len() as u64, mesh.facets().len() as u64);
        let counts = MeshCounts { vertices, facets, coordinate_bytes: 8, ..MeshCounts::default() };
        for (counts, place) in attributes::check(headers, counts).map_err(wrong)?.iter().zip(0..) {
            let (values, _) = counts.array_kinds();
            let place = if values == ArrayKind::Scalars { place } else { 0 };
            let (came, _) = self.came.get(&(values.into(), place)).copied().unwrap_or_default();
            let said = counts.values.saturating_mul(counts.numbers * counts.number.bytes() as u64);
            if came != said {
                let name = values.as_str_name();
                return Err(wrong(format!("{name} has {came} bytes, but {said} were announced")));
            }
        }
        Ok(())
    }
}

/// The most vertices and facets that a remesh may have: many times the points, and what the input has, for pieces that
/// points share.
fn most(mesh: &TriMesh, options: &RemeshOptions) -> (u64, u64) {
    let of_length = |length: f64| (2.0 / 3f64.sqrt() * mesh.area() / length / length) as u64;
    let points = match (&options.seeds, &options.density.source) {
        (Seeds::Sample { points, .. }, _) => *points as u64,
        (Seeds::Given(seeds), _) => seeds.len() as u64,
        (Seeds::Implied { .. }, DensitySource::Sizes(sizes)) => {
            of_length(sizes.iter().copied().fold(f64::INFINITY, f64::min))
        }
        // A metric may ask for any number.
        (Seeds::Implied { .. }, DensitySource::Metric(_)) => MOST,
        (Seeds::Implied { .. }, _) => options.density.edge_length.map_or(MOST, of_length),
        (Seeds::Share { of, .. }, _) => of.points(mesh) as u64,
    };
    let points = points.max(options.refine.map_or(0, |refine| refine.max_points.unwrap_or(0) as u64)).min(MOST);
    let input = (mesh.positions().len() + mesh.facets().len()) as u64;
    let vertices = (16 * points + 4 * input + (1 << 16)).min(MOST);
    (vertices, (4 * vertices).min(MOST))
}

fn name(kind: i32) -> &'static str {
    ArrayKind::try_from(kind).map_or("an array", |kind| kind.as_str_name())
}

/// Whether a remesh has the counts that the last message says, and its edges their vertices.
pub(super) fn remesh(mesh: &TriMesh, curve_edges: &[[u32; 2]], done: &RemeshDone) -> Result<()> {
    let (vertices, facets) = (mesh.positions().len() as u64, mesh.facets().len() as u64);
    if (done.vertices, done.facets) != (vertices, facets) {
        let RemeshDone { vertices: v, facets: f, .. } = done;
        return Err(wrong(format!("{vertices} vertices and {facets} facets were sent, but it says {v} and {f}")));
    }
    let no_edge = curve_edges.iter().find(|[a, b]| a == b || u64::from(*a.max(b)) >= vertices);
    let Some([a, b]) = no_edge else { return Ok(()) };
    Err(wrong(format!("there is no edge from vertex {a} to {b}; there are {vertices} vertices")))
}

pub(super) fn report(value: serde_json::Value) -> Result<serde_json::Value> {
    if value.is_object() { Ok(crate::say::plain_json(value)) } else { Err(wrong("its report is no report")) }
}

/// Whether there is one finite centroid for each seed.
pub(super) fn centroids(points: &[glam::DVec3], seeds: u64) -> Result<()> {
    if points.len() as u64 != seeds {
        return Err(wrong(format!("{} centroids were sent for {seeds} seeds", points.len())));
    }
    let odd = points.iter().position(|p| !p.is_finite());
    odd.map_or(Ok(()), |at| Err(wrong(format!("centroid {at} is not finite"))))
}

/// Pieces on their way: each (facet, seed) once, in order, so that there is an end to them.
#[derive(Debug)]
pub(super) struct Pieces {
    facets: u64,
    seeds: u64,
    last: Option<(u32, u32)>,
}

impl Pieces {
    /// Of a diagram with these counts.
    pub(super) fn of(facets: usize, seeds: u64) -> Self {
        Self { facets: facets as u64, seeds, last: None }
    }

    pub(super) fn lengths(chunk: &CellsChunk) -> Result<()> {
        let (pieces, vertices) = (chunk.pieces as usize, chunk.vertices as usize);
        let fits = [(&chunk.facet, 4), (&chunk.seed, 4), (&chunk.vertex_count, 4)].map(|(a, n)| a.len() == n * pieces);
        let full = [(&chunk.positions, 24), (&chunk.weights, 8), (&chunk.opposite, 4)];
        if fits.into_iter().chain(full.map(|(a, n)| a.len() == n * vertices)).all(|fit| fit) {
            return Ok(());
        }
        Err(wrong("pieces whose arrays do not fit together"))
    }

    pub(super) fn check(&mut self, batch: &PieceBatch) -> Result<()> {
        for i in 0..batch.len() {
            let (facet, seed, range) = (batch.facet[i], batch.seed[i], batch.vertices(i));
            if u64::from(facet) >= self.facets || u64::from(seed) >= self.seeds {
                return Err(wrong(format!("there is no piece of seed {seed} on facet {facet}")));
            }
            if self.last.replace((facet, seed)).is_some_and(|last| last >= (facet, seed)) {
                return Err(wrong(format!("the piece of seed {seed} on facet {facet} comes too late or twice")));
            }
            let known = |&label: &u32| facet_edge(label).is_some() || u64::from(label) < self.seeds;
            let finite = batch.position[range.clone()].iter().all(|p| p.is_finite())
                && batch.weight[range.clone()].iter().all(|w| w.is_finite());
            if range.len() < 3 || !finite || !batch.opposite[range].iter().all(known) {
                return Err(wrong(format!("the piece of seed {seed} on facet {facet} is no polygon")));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::exit::code;
    use geometry::mesh::shapes::Shape;

    fn chunk(kind: ArrayKind, bytes: usize, total_bytes: u64) -> Chunk {
        Chunk { kind: kind.into(), data: vec![0; bytes].into(), total_bytes, ..Chunk::default() }
    }

    fn said<T>(result: Result<T>) -> String {
        let error = result.err().expect("it is wrong");
        assert_eq!(code(&error), 69);
        format!("{error:#}")
    }

    #[test]
    fn no_more_is_kept_than_was_asked_for() {
        let mesh = Shape::Sphere.build(100);
        let seeds = Seeds::Sample { points: 50, seed: 1 };
        let mut expected = Expected::of_remesh(&mesh, &RemeshOptions::new(seeds), &[]);
        assert!(said(expected.check(chunk(ArrayKind::Positions, 24, 1 << 30))).contains("at most"));
        assert!(said(expected.check(chunk(ArrayKind::Positions, 24, 25))).contains("whole elements"));
        assert!(expected.check(chunk(ArrayKind::Positions, 24, 48)).unwrap().is_some());
        assert!(said(expected.check(chunk(ArrayKind::Positions, 24, 72))).contains("48 bytes and then 72"));
        assert!(said(expected.check(chunk(ArrayKind::Positions, 25, 48))).contains("more were sent"));
        assert!(said(expected.whole()).contains("only 24"));
        // Another number of the attribute is the same array, and an array that was not asked for is not kept.
        let again = Chunk { attribute: 9, ..chunk(ArrayKind::Positions, 24, 48) };
        assert_eq!(expected.check(again).unwrap().unwrap().attribute, 0);
        assert!(expected.whole().is_ok());
        for other in [ArrayKind::Colours, ArrayKind::VertexSeeds, ArrayKind::Unspecified] {
            assert!(expected.check(chunk(other, 8, u64::MAX)).unwrap().is_none());
        }
        assert!(expected.check(Chunk { kind: -5, ..chunk(ArrayKind::Seeds, 8, 8) }).unwrap().is_none());
    }

    #[test]
    fn pieces_have_an_order_and_corners() {
        let mut good = PieceBatch::default();
        let corners = |n: usize| (0..n).map(|i| (DVec3::splat(i as f64), 1.0, [3, u32::MAX, 0][i % 3]));
        good.push(0, 1, corners(3));
        good.push(0, 2, corners(4));
        let mut pieces = Pieces::of(2, 4);
        assert!(pieces.check(&good).is_ok());
        assert!(said(pieces.check(&good)).contains("twice"));
        for (facet, seed, n, label, x) in [
            (2, 0, 3, 0, 0.0),
            (1, 4, 3, 0, 0.0),
            (1, 0, 2, 0, 0.0),
            (1, 0, 0, 0, 0.0),
            (1, 0, 3, 4, 0.0),
            (1, 0, 3, 0, f64::NAN),
        ] {
            let mut batch = PieceBatch::default();
            batch.push(facet, seed, (0..n).map(|_| (DVec3::splat(x), 1.0, label)));
            said(Pieces::of(2, 4).check(&batch));
        }
        let lengths = |pieces, vertices| CellsChunk { pieces, vertices, ..CellsChunk::default() };
        assert!(Pieces::lengths(&lengths(0, 0)).is_ok());
        said(Pieces::lengths(&lengths(1, 0)));
        said(Pieces::lengths(&lengths(0, u32::MAX)));
    }

    #[test]
    fn a_report_is_an_object_and_centroids_are_points() {
        assert!(report(serde_json::json!({})).is_ok());
        said(report(serde_json::json!([1])));
        assert!(centroids(&[DVec3::ZERO], 1).is_ok());
        said(centroids(&[DVec3::ZERO], 2));
        said(centroids(&[DVec3::NAN], 1));
    }
}
