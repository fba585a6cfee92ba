//! Arrays put together from chunks, at a server ([`Assembly`]) and at a client ([`Arrays`]).
//!
//! Purpose: [`Assembly`] checks chunks, takes them in order and gives a mesh and seeds at the end; [`Arrays`] takes those of an
//! answer as they come, with the same checks of order, CRC-32C and length, and gives whole arrays at the end.
//! Invariant: memory grows with what has arrived, and its budget is asked before it does; nothing is used before every
//! announced byte is there. Must not know: budgets, streams, jobs.

use std::borrow::Cow;
use std::collections::HashMap;

use glam::DVec3;

use super::attributes::{AttributeCounts, UploadedAttribute};
use super::counts::MeshCounts;
use super::options::ByVertex;
use super::proto::{ArrayKind, Chunk};
use super::{WireError, unknown_enum};
use geometry::mesh::numbers::NumberType::{self, F32, F64, U32};
use geometry::mesh::numbers::Order;
use geometry::mesh::tensor::Tensor;

#[derive(Debug)]
pub struct Uploaded {
    pub positions: Vec<DVec3>,
    pub facets: Vec<[u32; 3]>,
    pub by_vertex: ByVertex,
    pub seeds: Vec<DVec3>,
    pub creases: Vec<[u32; 2]>,
    /// What was announced beside the mesh, in this order.
    pub attributes: Vec<UploadedAttribute>,
}

#[derive(Debug)]
pub struct Assembly {
    arrays: [Array; 7],
    attributes: Vec<(AttributeCounts, Array, Array)>,
}

#[derive(Debug)]
struct Array {
    kind: ArrayKind,
    /// How it is called in errors.
    path: Cow<'static, str>,
    /// Bytes of one element, the type of its numbers, and how many were announced.
    element_bytes: u64,
    number: NumberType,
    announced: u64,
    received_bytes: u64,
    /// Start of an element whose end is in the next chunk.
    rest: Vec<u8>,
    store: Store,
}

#[derive(Debug)]
enum Store {
    Points(Vec<DVec3>),
    Triples(Vec<[u32; 3]>),
    Pairs(Vec<[u32; 2]>),
    Numbers(Vec<f64>),
}

impl Assembly {
    pub fn new(mesh: MeshCounts) -> Self {
        let points = if mesh.coordinate_bytes == 4 { F32 } else { F64 };
        let array = Array::new;
        Self {
            arrays: [
                array(ArrayKind::Positions, points, 3, mesh.vertices, Store::Points(Vec::new())),
                array(ArrayKind::Facets, U32, 3, mesh.facets, Store::Triples(Vec::new())),
                array(ArrayKind::Weights, F64, 1, mesh.weights, Store::Numbers(Vec::new())),
                array(ArrayKind::Seeds, points, 3, mesh.seeds, Store::Points(Vec::new())),
                array(ArrayKind::EdgeLengths, F64, 1, mesh.edge_lengths, Store::Numbers(Vec::new())),
                array(ArrayKind::Metric, F64, Tensor::NUMBERS as u64, mesh.metric, Store::Numbers(Vec::new())),
                array(ArrayKind::Creases, U32, 2, mesh.creases, Store::Pairs(Vec::new())),
            ],
            attributes: Vec::new(),
        }
    }

    /// Attributes of the mesh are to arrive as well.
    pub fn announce(mut self, facets: u64, attributes: Vec<AttributeCounts>) -> Self {
        let arrays = attributes.into_iter().enumerate().map(|(i, counts)| {
            let (values, corners) = counts.array_kinds();
            let store = Store::Numbers(Vec::new());
            let mut values = Array::new(values, counts.number, counts.numbers, counts.values, store);
            let announced = if counts.by_corner { facets } else { 0 };
            let mut corners = Array::new(corners, U32, 3, announced, Store::Triples(Vec::new()));
            values.path = format!("mesh.attributes[{i}].values").into();
            corners.path = format!("mesh.attributes[{i}].corners").into();
            (counts, values, corners)
        });
        self.attributes = arrays.collect();
        self
    }

    fn array(&mut self, kind: ArrayKind, attribute: u32) -> Option<&mut Array> {
        if kind == ArrayKind::Scalars {
            let (_, values, _) = self.attributes.get_mut(attribute as usize)?;
            return Some(values).filter(|array| array.kind == kind);
        }
        let attributes = self.attributes.iter_mut().flat_map(|(_, values, corners)| [values, corners]);
        self.arrays.iter_mut().chain(attributes).find(|array| array.kind == kind)
    }

    /// Takes the next chunk of an array. `ask` is asked for the bytes of memory that it needs, once the chunk is in order.
    pub fn take<E: From<WireError>>(&mut self, chunk: &Chunk, ask: impl FnOnce(u64) -> Result<(), E>) -> Result<(), E> {
        let kind = ArrayKind::try_from(chunk.kind).map_err(|_| unknown_enum("chunk.kind", chunk.kind))?;
        let Some(array) = self.array(kind, chunk.attribute) else {
            let name = kind.as_str_name();
            let text = match kind {
                ArrayKind::Scalars => {
                    format!("is {name}, and header.mesh.attributes[{}] is no scalar", chunk.attribute)
                }
                _ => format!(
                    "is {name}; upload POSITIONS, FACETS, WEIGHTS, SEEDS, EDGE_LENGTHS, METRIC, CREASES or an array of an attribute in the header"
                ),
            };
            return Err(WireError::field("chunk.kind", text).into());
        };
        array.check(chunk)?;
        ask(array.memory_bytes(chunk.data.len() as u64))?;
        array.append(&chunk.data);
        Ok(())
    }

    pub fn finish(self) -> Result<Uploaded, WireError> {
        let attributes = self.attributes.iter().flat_map(|(_, values, corners)| [values, corners]);
        for array in self.arrays.iter().chain(attributes) {
            let whole = array.whole_bytes();
            if array.received_bytes != whole {
                let text = format!("{} of {whole} bytes arrived before finish", array.received_bytes);
                return Err(WireError::field(array.path(), text));
            }
        }
        let attributes = self.attributes.into_iter().map(|(counts, values, corners)| {
            let (Store::Numbers(numbers), Store::Triples(corners)) = (values.store, corners.store) else { return None };
            Some(UploadedAttribute { counts, numbers, corners })
        });
        let attributes = attributes.collect::<Option<Vec<_>>>();
        let [positions, facets, weights, seeds, edge_lengths, metric, creases] = self.arrays.map(|a| a.store);
        match (positions, facets, weights, seeds, edge_lengths, metric, creases, attributes) {
            (
                Store::Points(positions),
                Store::Triples(facets),
                Store::Numbers(weights),
                Store::Points(seeds),
                Store::Numbers(edge_lengths),
                Store::Numbers(metric),
                Store::Pairs(creases),
                Some(attributes),
            ) => {
                let weights = (!weights.is_empty()).then_some(weights);
                let edge_lengths = (!edge_lengths.is_empty()).then_some(edge_lengths);
                let metric = (!metric.is_empty()).then(|| tensors(&metric));
                let by_vertex = ByVertex { edge_lengths, weights, metric };
                Ok(Uploaded { positions, facets, by_vertex, seeds, creases, attributes })
            }
            _ => Err(WireError::field("chunk", "internal: arrays changed places")),
        }
    }
}

impl Array {
    fn new(kind: ArrayKind, number: NumberType, numbers: u64, announced: u64, store: Store) -> Self {
        let path = match kind {
            ArrayKind::Positions => "mesh.positions",
            ArrayKind::Facets => "mesh.facets",
            ArrayKind::Weights => "mesh.weights",
            ArrayKind::EdgeLengths => "mesh.edge_lengths",
            ArrayKind::Metric => "mesh.metric",
            ArrayKind::Creases => "mesh.creases",
            _ => "seeds",
        };
        let element_bytes = number.bytes() as u64 * numbers;
        let (path, rest) = (path.into(), Vec::new());
        Self { kind, path, element_bytes, number, announced, received_bytes: 0, rest, store }
    }

    fn path(&self) -> &str {
        &self.path
    }

    fn whole_bytes(&self) -> u64 {
        self.announced * self.element_bytes
    }

    /// Bytes of memory for `wire` bytes of a message.
    fn memory_bytes(&self, wire: u64) -> u64 {
        match self.store {
            Store::Points(_) | Store::Numbers(_) => 8 / self.number.bytes() as u64 * wire,
            Store::Triples(_) | Store::Pairs(_) => wire,
        }
    }

    fn check(&self, chunk: &Chunk) -> Result<(), WireError> {
        let (name, at, length) = (self.path(), chunk.offset, chunk.data.len() as u64);
        let (received, whole) = (self.received_bytes, self.whole_bytes());
        if chunk.total_bytes != 0 && chunk.total_bytes != whole {
            let text = format!("is {} for {name}; the header's counts give {whole}", chunk.total_bytes);
            return Err(WireError::field("chunk.total_bytes", text));
        }
        if length == 0 {
            return Err(WireError::field("chunk.data", format!("is empty, at byte {at} of {name}")));
        }
        if at > received {
            let text =
                format!("is {at}, but {name} has arrived up to byte {received}: bytes {received}..{at} are missing");
            return Err(WireError::field("chunk.offset", text));
        }
        if at < received {
            let text = format!("is {at}, but {name} has arrived up to byte {received}: this chunk overlaps");
            return Err(WireError::field("chunk.offset", text));
        }
        if length > whole - received {
            let text = format!("ends at byte {} of {name}; the header announced {whole}", at.saturating_add(length));
            return Err(WireError::field("chunk.data", text));
        }
        let computed = crc32c::crc32c(&chunk.data);
        if computed != chunk.crc32c {
            let text = format!(
                "is {:#010x}, but the data at byte {at} of {name} has {computed:#010x} (CRC-32C, Castagnoli)",
                chunk.crc32c
            );
            return Err(WireError::field("chunk.crc32c", text));
        }
        Ok(())
    }

    fn append(&mut self, data: &[u8]) {
        self.received_bytes += data.len() as u64;
        let size = self.element_bytes as usize;
        let mut data = data;
        if !self.rest.is_empty() {
            let missing = (size - self.rest.len()).min(data.len());
            let (head, tail) = data.split_at(missing);
            self.rest.extend_from_slice(head);
            data = tail;
            if self.rest.len() < size {
                return;
            }
            let element = std::mem::take(&mut self.rest);
            self.store.decode(&element, self.number);
        }
        let whole = data.len() / size * size;
        self.store.decode(&data[..whole], self.number);
        self.rest.extend_from_slice(&data[whole..]);
    }
}

impl Store {
    fn decode(&mut self, data: &[u8], number: NumberType) {
        match self {
            Self::Points(all) => all.extend(points(data, number)),
            Self::Triples(facets) => facets.extend_from_slice(indices(data).as_chunks::<3>().0),
            Self::Pairs(edges) => edges.extend_from_slice(indices(data).as_chunks::<2>().0),
            Self::Numbers(all) => all.extend(number.floats(data, Order::Little)),
        }
    }
}

/// Arrays that a server sends: kind and attribute, bytes so far, bytes in all.
#[derive(Debug, Default)]
pub struct Arrays(HashMap<(i32, u32), (Vec<u8>, u64)>);

impl Arrays {
    pub fn take(&mut self, chunk: &Chunk) -> Result<(), WireError> {
        let (data, total) = self.0.entry((chunk.kind, chunk.attribute)).or_default();
        if chunk.offset != data.len() as u64 {
            return broken("the server left out or repeated a part of an array");
        }
        if crc32c::crc32c(&chunk.data) != chunk.crc32c {
            return broken("a chunk was damaged on its way from the server");
        }
        data.extend_from_slice(&chunk.data);
        *total = chunk.total_bytes;
        Ok(())
    }

    pub fn bytes(&self, kind: ArrayKind) -> Result<&[u8], WireError> {
        self.bytes_of(kind, 0)
    }

    fn bytes_of(&self, kind: ArrayKind, attribute: u32) -> Result<&[u8], WireError> {
        let name = kind.as_str_name();
        match self.0.get(&(kind.into(), attribute)) {
            None => broken(format!("the server sent no {name}")),
            Some((data, total)) if data.len() as u64 != *total => {
                broken(format!("the server sent a part of {name} only"))
            }
            Some((data, _)) => Ok(data),
        }
    }

    pub fn points(&self, kind: ArrayKind) -> Result<Vec<DVec3>, WireError> {
        Ok(points(self.bytes(kind)?, F64))
    }

    pub fn facets(&self, kind: ArrayKind) -> Result<Vec<[u32; 3]>, WireError> {
        Ok(indices(self.bytes(kind)?).as_chunks::<3>().0.to_vec())
    }

    /// None if the server sent none: an empty array has no chunks.
    pub fn pairs(&self, kind: ArrayKind) -> Vec<[u32; 2]> {
        self.bytes(kind).map_or_else(|_| Vec::new(), |data| indices(data).as_chunks::<2>().0.to_vec())
    }

    /// The arrays of the attribute at `place` in the list of headers.
    pub fn attribute(&self, counts: AttributeCounts, place: u32) -> Result<UploadedAttribute, WireError> {
        let (values, corners) = counts.array_kinds();
        let place = if values == ArrayKind::Scalars { place } else { 0 };
        let numbers = counts.number.floats(self.bytes_of(values, place)?, Order::Little);
        let corners = if counts.by_corner { self.facets(corners)? } else { Vec::new() };
        Ok(UploadedAttribute { counts, numbers, corners })
    }
}

fn broken<T>(what: impl Into<String>) -> Result<T, WireError> {
    Err(WireError::Answer(what.into()))
}

pub(super) fn points(data: &[u8], number: NumberType) -> Vec<DVec3> {
    number.floats(data, Order::Little).as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}

/// Six numbers each; what is left over is none.
pub fn tensors(numbers: &[f64]) -> Vec<Tensor> {
    numbers.as_chunks().0.iter().map(|&numbers| Tensor(numbers)).collect()
}

pub(super) fn indices(data: &[u8]) -> Vec<u32> {
    data.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::chunks::{facet_chunks, point_chunks};
    use super::*;

    /// Takes a chunk where memory is no matter.
    fn take(assembly: &mut Assembly, chunk: &Chunk) -> Result<(), WireError> {
        assembly.take(chunk, |_| Ok(()))
    }

    fn assembly() -> Assembly {
        let counts =
            MeshCounts { vertices: 3, facets: 1, weights: 3, coordinate_bytes: 4, seeds: 1, ..Default::default() };
        Assembly::new(counts)
    }

    fn chunk(kind: ArrayKind, offset: u64, data: &[u8]) -> Chunk {
        let crc32c = crc32c::crc32c(data);
        Chunk { kind: kind.into(), offset, data: data.to_vec().into(), crc32c, ..Chunk::default() }
    }

    fn path(error: WireError) -> String {
        match error {
            WireError::Field { path, .. } => path,
            other => panic!("{other}"),
        }
    }

    #[test]
    fn elements_may_straddle_chunks() {
        let mut assembly = assembly();
        let positions: Vec<u8> = (0..9).flat_map(|i| (i as f32).to_le_bytes()).collect();
        for (i, part) in positions.chunks(7).enumerate() {
            take(&mut assembly, &chunk(ArrayKind::Positions, 7 * i as u64, part)).unwrap();
        }
        let facet: Vec<u8> = [0u32, 1, 2].iter().flat_map(|i| i.to_le_bytes()).collect();
        take(&mut assembly, &chunk(ArrayKind::Facets, 0, &facet)).unwrap();
        take(&mut assembly, &chunk(ArrayKind::Weights, 0, &[0u8; 24])).unwrap();
        take(&mut assembly, &chunk(ArrayKind::Seeds, 0, &[0u8; 12])).unwrap();
        let up = assembly.finish().unwrap();
        assert_eq!(up.positions[2].to_array(), [6.0, 7.0, 8.0]);
        assert_eq!(up.facets, [[0, 1, 2]]);
        assert_eq!(up.by_vertex.weights.unwrap().len(), 3);
    }

    #[test]
    fn holes_overlaps_bad_sums_and_excess_are_refused() {
        let mut a = assembly();
        take(&mut a, &chunk(ArrayKind::Positions, 0, &[0; 12])).unwrap();
        assert_eq!(path(take(&mut a, &chunk(ArrayKind::Positions, 13, &[0; 1])).unwrap_err()), "chunk.offset");
        assert_eq!(path(take(&mut a, &chunk(ArrayKind::Positions, 0, &[0; 12])).unwrap_err()), "chunk.offset");
        assert_eq!(path(take(&mut a, &chunk(ArrayKind::Positions, 12, &[0; 25])).unwrap_err()), "chunk.data");
        assert_eq!(path(take(&mut a, &chunk(ArrayKind::Positions, 12, &[])).unwrap_err()), "chunk.data");
        let wrong = Chunk { crc32c: 1, ..chunk(ArrayKind::Positions, 12, &[0; 24]) };
        assert_eq!(path(take(&mut a, &wrong).unwrap_err()), "chunk.crc32c");
        assert_eq!(path(take(&mut a, &chunk(ArrayKind::Centroids, 0, &[0; 24])).unwrap_err()), "chunk.kind");
        assert_eq!(path(a.finish().unwrap_err()), "mesh.positions");
    }

    #[test]
    fn memory_is_taken_for_what_arrives() {
        let counts = MeshCounts { vertices: 1 << 30, facets: 1, coordinate_bytes: 8, ..MeshCounts::default() };
        let mut a = Assembly::new(counts);
        let mut left = 30;
        let mut grow = |bytes: u64| {
            left = u64::checked_sub(left, bytes).ok_or(WireError::Order("no memory"))?;
            Ok::<_, WireError>(())
        };
        a.take(&chunk(ArrayKind::Positions, 0, &[0; 24]), &mut grow).unwrap();
        let refused = a.take(&chunk(ArrayKind::Positions, 24, &[0; 24]), &mut grow);
        assert!(matches!(refused, Err(WireError::Order("no memory"))));
        // Nothing was kept of it, and a chunk that is not in order asks for nothing.
        assert_eq!(path(a.take(&chunk(ArrayKind::Positions, 48, &[0; 24]), grow).unwrap_err()), "chunk.offset");
        assert_eq!(left, 6);
    }

    #[test]
    fn arrays_come_back_as_they_went() {
        let points: Vec<DVec3> = (0..10_000).map(|i| DVec3::new(f64::from(i), 0.1, -1e-300)).collect();
        let facets: Vec<[u32; 3]> = (0..10_000).map(|i| [i, i + 1, u32::MAX]).collect();
        let mut arrays = Arrays::default();
        for chunk in point_chunks(ArrayKind::Positions, &points).chain(facet_chunks(ArrayKind::Facets, &facets)) {
            arrays.take(&chunk).unwrap();
        }
        assert_eq!(arrays.points(ArrayKind::Positions).unwrap(), points);
        assert_eq!(arrays.facets(ArrayKind::Facets).unwrap(), facets);
        assert!(arrays.bytes(ArrayKind::Seeds).is_err());
        assert!(arrays.pairs(ArrayKind::Creases).is_empty());
    }

    #[test]
    fn what_is_damaged_or_incomplete_is_refused() {
        let points = vec![DVec3::ONE; 10_000];
        let chunks: Vec<Chunk> = point_chunks(ArrayKind::Positions, &points).collect();
        let mut arrays = Arrays::default();
        assert!(arrays.take(&chunks[1]).is_err(), "a part is missing");
        assert!(arrays.take(&Chunk { crc32c: !chunks[0].crc32c, ..chunks[0].clone() }).is_err());
        arrays.take(&chunks[0]).unwrap();
        assert!(arrays.take(&chunks[0]).is_err(), "it came twice");
        assert!(arrays.points(ArrayKind::Positions).is_err(), "the rest has not come");
    }
}
