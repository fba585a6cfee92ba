//! Arrays put together from the chunks of an answer, at a client.
//!
//! Purpose: [`Arrays`] takes chunks as they come and gives whole arrays at the end.
//! Invariant: what is received is checked as a server checks what it receives: order, CRC-32C, length.
//! Must not know: which message a chunk travelled in, what is done with an array.

use std::collections::HashMap;

use glam::DVec3;

use super::WireError;
use super::attributes::{AttributeCounts, UploadedAttribute};
use super::proto::{ArrayKind, Chunk};

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
        Ok(points(self.bytes(kind)?))
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
        let data = self.bytes_of(values, place)?;
        let numbers = match counts.number_bytes {
            1 => data.iter().map(|&b| f64::from(b) / 255.0).collect(),
            4 => data.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect(),
            _ => numbers(data),
        };
        let corners = if counts.by_corner { self.facets(corners)? } else { Vec::new() };
        Ok(UploadedAttribute { counts, numbers, corners })
    }
}

fn broken<T>(what: impl Into<String>) -> Result<T, WireError> {
    Err(WireError::Answer(what.into()))
}

pub(super) fn numbers(data: &[u8]) -> Vec<f64> {
    data.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect()
}

pub(super) fn points(data: &[u8]) -> Vec<DVec3> {
    numbers(data).as_chunks::<3>().0.iter().map(|p| DVec3::from_array(*p)).collect()
}

pub(super) fn indices(data: &[u8]) -> Vec<u32> {
    data.as_chunks::<4>().0.iter().map(|b| u32::from_le_bytes(*b)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::chunks::{facet_chunks, point_chunks};
    use super::*;

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
