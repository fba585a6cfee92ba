//! Pieces of a diagram as messages.
//!
//! Purpose: [`cells_chunks`] cuts a batch into messages; [`batch`] makes a batch of a message again. Invariant: a piece is
//! never split. What does not fit together is refused. Must not know: how pieces are computed.

use super::WireError;
use super::assemble::{indices, points};
use super::chunks::CHUNK_BYTES;
use super::proto::CellsChunk;
use geometry::mesh::numbers::NumberType::F64;
use geometry::mesh::numbers::Order;
use geometry::rvd::PieceBatch;
use prost::bytes::Bytes;

/// Bytes of a polygon vertex in a cells message.
pub const CELLS_VERTEX_BYTES: usize = 36;

/// Polygon vertices in a cells message.
const CELLS_VERTICES: usize = CHUNK_BYTES / CELLS_VERTEX_BYTES;

/// A batch of pieces as messages of about [`CHUNK_BYTES`], made one at a time. A piece is never split.
pub fn cells_chunks(batch: &PieceBatch) -> impl Iterator<Item = CellsChunk> + '_ {
    let mut first = 0;
    std::iter::from_fn(move || {
        if first >= batch.len() {
            return None;
        }
        let base = batch.vertices(first).start;
        let mut end = first + 1;
        while end < batch.len() && batch.vertices(end).end - base <= CELLS_VERTICES {
            end += 1;
        }
        let pieces = first..end;
        let vertices = base..batch.vertices(end - 1).end;
        first = end;
        let u32s = |values: &[u32]| -> Bytes { values.iter().flat_map(|v| v.to_le_bytes()).collect() };
        let counts: Vec<u32> = pieces.clone().map(|i| batch.vertices(i).len() as u32).collect();
        let positions = &batch.position[vertices.clone()];
        Some(CellsChunk {
            pieces: pieces.len() as u32,
            vertices: vertices.len() as u32,
            facet: u32s(&batch.facet[pieces.clone()]),
            seed: u32s(&batch.seed[pieces]),
            vertex_count: u32s(&counts),
            positions: positions.iter().flat_map(|p| p.to_array()).flat_map(f64::to_le_bytes).collect(),
            weights: batch.weight[vertices.clone()].iter().flat_map(|w| w.to_le_bytes()).collect(),
            opposite: u32s(&batch.opposite[vertices]),
        })
    })
}

pub fn batch(chunk: &CellsChunk) -> Result<PieceBatch, WireError> {
    let mut cells = PieceBatch::default();
    let (facet, seed, count) = (indices(&chunk.facet), indices(&chunk.seed), indices(&chunk.vertex_count));
    let (position, weight, opposite) =
        (points(&chunk.positions, F64), F64.floats(&chunk.weights, Order::Little), indices(&chunk.opposite));
    let vertices: u64 = count.iter().map(|c| u64::from(*c)).sum();
    let whole = facet.len() == seed.len()
        && facet.len() == count.len()
        && [position.len(), weight.len(), opposite.len()].iter().all(|n| *n as u64 == vertices);
    if !whole {
        return Err(WireError::Answer("the server sent cells whose arrays do not fit together".to_owned()));
    }
    let mut first = 0;
    for ((facet, seed), count) in facet.into_iter().zip(seed).zip(count) {
        let range = first..first + count as usize;
        first = range.end;
        cells.push(facet, seed, range.map(|v| (position[v], weight[v], opposite[v])));
    }
    Ok(cells)
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    #[test]
    fn pieces_are_not_split() {
        let mut batch = PieceBatch::default();
        for i in 0..20_000 {
            batch.push(i, 0, (0..5).map(|_| (DVec3::ZERO, 1.0, 7)));
        }
        let all: Vec<CellsChunk> = cells_chunks(&batch).collect();
        assert!(all.len() > 2);
        assert_eq!(all.iter().map(|c| c.pieces).sum::<u32>(), 20_000);
        for chunk in &all {
            assert_eq!(chunk.vertices, 5 * chunk.pieces);
            assert_eq!(chunk.positions.len(), 24 * chunk.vertices as usize);
            assert_eq!(chunk.opposite.len(), 4 * chunk.vertices as usize);
        }
    }
    #[test]
    fn pieces_come_back_as_they_went() {
        let mut sent = PieceBatch::default();
        for i in 0..3_000_u32 {
            let corner = |k: u32| (DVec3::new(f64::from(i), f64::from(k), 0.1), 1.0 / f64::from(k + 1), i ^ k);
            sent.push(i, i / 7, (0..3 + i % 5).map(corner));
        }
        let mut came = PieceBatch::default();
        for chunk in cells_chunks(&sent) {
            let part = batch(&chunk).unwrap();
            for i in 0..part.len() {
                let corner = |v| (part.position[v], part.weight[v], part.opposite[v]);
                came.push(part.facet[i], part.seed[i], part.vertices(i).map(corner));
            }
        }
        assert_eq!(format!("{came:?}"), format!("{sent:?}"));
    }
    #[test]
    fn arrays_that_do_not_fit_together_are_refused() {
        let mut sent = PieceBatch::default();
        sent.push(0, 0, (0..3).map(|_| (DVec3::ZERO, 1.0, 7)));
        let whole = cells_chunks(&sent).next().unwrap();
        assert!(batch(&whole).is_ok());
        assert!(batch(&CellsChunk { seed: Bytes::new(), ..whole.clone() }).is_err());
        assert!(batch(&CellsChunk { vertex_count: 4_u32.to_le_bytes().to_vec().into(), ..whole.clone() }).is_err());
        assert!(batch(&CellsChunk { positions: whole.positions.slice(24..), ..whole }).is_err());
    }
}
