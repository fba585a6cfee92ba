//! Corners of facets that name their vertices.
//!
//! Purpose: as many vertices as memory allows are held at a time, in ranges by their numbers. Where one range does not hold all,
//! the facets are read once for each, and what is known of their corners waits in a scratch file. So the time does not depend on
//! the order of vertices: a cache of blocks would read one for nearly every corner of a shuffled file.
//! Invariant: corners do not depend on the ranges. Must not know: what becomes of facets.

use super::welds::Welds;
use super::{MeshFile, MeshFileError, Room, Window, position, put_position};
use crate::mesh::io::ply;
use crate::token::Token;

/// Positions of a range of vertices, and the lowest vertex at each place.
pub(super) struct Table {
    number: usize,
    first: usize,
    positions: Vec<u8>,
    welds: Option<Vec<u32>>,
}

impl Table {
    pub(super) fn new(number: usize, welds: bool) -> Self {
        Self { number, first: 0, positions: Vec::new(), welds: welds.then(Vec::new) }
    }

    fn vertex_bytes(&self) -> usize {
        3 * self.number + if self.welds.is_some() { 4 } else { 0 }
    }

    fn fill(
        &mut self,
        file: &MeshFile,
        range: std::ops::Range<usize>,
        welds: Option<&Welds>,
        token: &Token,
    ) -> Result<(), MeshFileError> {
        self.first = range.start;
        let each = 3 * self.number;
        self.positions.resize(range.len() * each, 0);
        file.each_positions(range.clone(), token, |v, p| {
            put_position(&mut self.positions[(v - range.start) * each..][..each], self.number, p);
            Ok(())
        })?;
        if let (Some(table), Some(welds)) = (&mut self.welds, welds) {
            table.clear();
            table.reserve_exact(range.len());
            welds.read(range.start, range.len(), |numbers| table.extend_from_slice(numbers))?;
        }
        Ok(())
    }

    /// The bytes of a vertex's position, and the lowest vertex at its place.
    fn get(&self, vertex: u32) -> Option<(&[u8], u32)> {
        let at = (vertex as usize).checked_sub(self.first)?;
        let position = self.positions.chunks_exact(3 * self.number).nth(at)?;
        Some((position, self.welds.as_ref().map_or(vertex, |welds| welds[at])))
    }
}

/// Visits all windows of facets with their corners.
pub(super) fn each_through_table<E: From<MeshFileError>>(
    file: &MeshFile,
    places: &ply::Places,
    room: Room<'_>,
    welds: Option<&Welds>,
    token: &Token,
    mut visit: impl FnMut(&Window) -> Result<(), E>,
) -> Result<(), E> {
    let vertices = places.vertices.count;
    let mut table = file.table(welds.is_some());
    let most = (room.vertex_bytes / table.vertex_bytes()).clamp(1, vertices.max(1));
    // As many in each range.
    let most = vertices.div_ceil(vertices.div_ceil(most).max(1)).max(1);
    let length = file.number;
    // Positions, then vertices.
    let record = 3 * (3 * length + 4);
    let known = if most < vertices { Some(room.scratch.file()?) } else { None };
    let mut bytes = Vec::new();
    let mut window = Window::default();
    for first_vertex in (0..vertices).step_by(most) {
        let range = first_vertex..vertices.min(first_vertex + most);
        let is_last = range.end == vertices;
        table.fill(file, range, welds, token)?;
        file.each_indices(places, token, |first, facets| -> Result<(), E> {
            bytes.resize(facets.len() * record, 0);
            let at = (first * record) as u64;
            if let Some(known) = known.as_ref().filter(|_| first_vertex > 0) {
                known.read(at, &mut bytes)?;
            }
            for (facet, record) in facets.iter().zip(bytes.chunks_exact_mut(record)) {
                let (positions, lowest) = record.split_at_mut(9 * length);
                let slots = positions.chunks_exact_mut(3 * length).zip(lowest.chunks_exact_mut(4));
                for (&vertex, (slot, lowest)) in facet.iter().zip(slots) {
                    if let Some((position, welded)) = table.get(vertex) {
                        slot.copy_from_slice(position);
                        lowest.copy_from_slice(&welded.to_le_bytes());
                    }
                }
            }
            match &known {
                Some(known) if !is_last => Ok(known.write(at, &bytes)?),
                _ => {
                    window.set(first, &bytes, record, length);
                    visit(&window)
                }
            }
        })?;
    }
    Ok(())
}

impl Window {
    fn set(&mut self, first: usize, bytes: &[u8], record: usize, length: usize) {
        self.first = first;
        let records = || bytes.chunks_exact(record);
        self.corners.clear();
        self.corners.extend(records().map(|r| [0, 1, 2].map(|c| position(&r[3 * length * c..], length))));
        self.welded.clear();
        let welded = |r: &[u8], c: usize| r[9 * length + 4 * c..].first_chunk().map_or(0, |&b| u32::from_le_bytes(b));
        self.welded.extend(records().map(|r| [0, 1, 2].map(|c| welded(r, c))));
    }
}
