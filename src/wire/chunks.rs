//! Arrays as chunks.
//!
//! Purpose: an array becomes [`Chunk`]s, made one at a time, each with its offset and its CRC-32C. Invariant: chunks are cut
//! between elements, and every chunk says how many bytes the array has. Must not know: which message a chunk travels in.

use glam::DVec3;

use super::proto::{ArrayKind, Chunk};

/// Bytes of data in a chunk that is sent. Small, so that little waits for a slow reader.
pub(super) const CHUNK_BYTES: usize = 64 << 10;

/// An array of points as chunks, made one at a time.
pub fn point_chunks(kind: ArrayKind, points: &[DVec3]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, points, 24, |p, out| p.to_array().iter().for_each(|x| out.extend_from_slice(&x.to_le_bytes())))
}

pub fn facet_chunks(kind: ArrayKind, facets: &[[u32; 3]]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, facets, 12, |f, out| f.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes())))
}

pub fn number_chunks(kind: ArrayKind, numbers: &[f64]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, numbers, 8, |x, out| out.extend_from_slice(&x.to_le_bytes()))
}

pub fn index_chunks(kind: ArrayKind, indices: &[u32]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, indices, 4, |i, out| out.extend_from_slice(&i.to_le_bytes()))
}

pub fn byte_chunks(kind: ArrayKind, bytes: &[u8]) -> impl Iterator<Item = Chunk> + '_ {
    chunks(kind, bytes, 1, |byte, out| out.push(*byte))
}

pub(super) fn chunks<'a, T>(
    kind: ArrayKind,
    items: &'a [T],
    item_bytes: usize,
    encode: impl Fn(&T, &mut Vec<u8>) + 'a,
) -> impl Iterator<Item = Chunk> + 'a {
    let total_bytes = (items.len() * item_bytes) as u64;
    let per_chunk = CHUNK_BYTES / item_bytes;
    items.chunks(per_chunk).enumerate().map(move |(i, part)| {
        let mut data = Vec::with_capacity(part.len() * item_bytes);
        part.iter().for_each(|item| encode(item, &mut data));
        let crc32c = crc32c::crc32c(&data);
        let offset = (i * per_chunk * item_bytes) as u64;
        Chunk { kind: kind.into(), offset, data: data.into(), crc32c, total_bytes, ..Chunk::default() }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_are_cut_at_elements_and_say_where_they_are() {
        let points = vec![DVec3::ONE; 100_000];
        let all: Vec<Chunk> = point_chunks(ArrayKind::Seeds, &points).collect();
        assert_eq!(all.len(), 2_400_000_usize.div_ceil(CHUNK_BYTES / 24 * 24));
        assert!(all.iter().all(|c| c.data.len() % 24 == 0 && c.total_bytes == 2_400_000));
        assert_eq!(all[1].offset as usize, all[0].data.len());
        assert_eq!(all.iter().map(|c| c.data.len()).sum::<usize>(), 2_400_000);
    }
}
