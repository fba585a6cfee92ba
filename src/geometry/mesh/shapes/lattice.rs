//! Surfaces whose vertices are rows and columns.
//!
//! Purpose: a [`Lattice`] gives its vertices and facets one after the other, so that a surface larger than memory can be written.
//! Invariant: what is built of it and what is written of it are the same. Must not know: files.

use std::f64::consts::TAU;
use std::io::{self, Write};

use glam::{DVec3, dvec3};

use crate::mesh::TriMesh;

/// Vertices in rows, with two facets between four of them.
#[derive(Clone, Copy, Debug)]
pub struct Lattice {
    kind: Kind,
    rows: usize,
    columns: usize,
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    /// The unit square, with a height at each place.
    Grid(fn(f64, f64) -> f64),
    /// Radii 1 and [`TUBE`]; rings stand `ratio` : 1 apart in turn.
    Torus { ratio: f64 },
}

const TUBE: f64 = 0.4;

impl Lattice {
    /// The unit square with `n * n` cells.
    pub(super) fn grid(n: usize, height: fn(f64, f64) -> f64) -> Self {
        Self { kind: Kind::Grid(height), rows: n + 1, columns: n + 1 }
    }

    pub(super) fn torus(facets: usize, ratio: f64) -> Self {
        let quads = facets as f64 / 2.0;
        let around = ((quads * TUBE).sqrt().round() as usize).max(3);
        let pairs = ((quads / around as f64 / 2.0).round() as usize).max(3);
        Self { kind: Kind::Torus { ratio }, rows: 2 * pairs, columns: around }
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.rows * self.columns
    }

    /// Number of facets.
    pub fn facet_count(&self) -> usize {
        let (rows, columns) = self.cells();
        2 * rows * columns
    }

    /// Cells along rows and columns: a torus closes on itself.
    fn cells(&self) -> (usize, usize) {
        match self.kind {
            Kind::Grid(_) => (self.rows - 1, self.columns - 1),
            Kind::Torus { .. } => (self.rows, self.columns),
        }
    }

    /// Vertices in order.
    pub fn positions(self) -> impl Iterator<Item = DVec3> {
        (0..self.rows).flat_map(move |row| {
            let along = self.along(row);
            (0..self.columns).map(move |column| self.position(along, column))
        })
    }

    /// What the positions of a row share.
    fn along(&self, row: usize) -> (f64, f64) {
        match self.kind {
            Kind::Grid(_) => (row as f64 / (self.rows - 1) as f64, 0.0),
            Kind::Torus { ratio } => {
                let pair = TAU / (self.rows / 2) as f64;
                let further = if row % 2 == 1 { pair * ratio / (1.0 + ratio) } else { 0.0 };
                (pair * (row / 2) as f64 + further).sin_cos()
            }
        }
    }

    fn position(&self, along: (f64, f64), column: usize) -> DVec3 {
        match self.kind {
            Kind::Grid(height) => {
                let (x, y) = (column as f64 / (self.columns - 1) as f64, along.0);
                dvec3(x, y, height(x, y))
            }
            Kind::Torus { .. } => {
                let (sin, cos) = along;
                let (s, c) = (TAU * column as f64 / self.columns as f64).sin_cos();
                let r = 1.0 + TUBE * c;
                dvec3(r * cos, r * sin, TUBE * s)
            }
        }
    }

    /// Facets in order: two for each cell, counter-clockwise from outside.
    pub fn facets(self) -> impl Iterator<Item = [u32; 3]> {
        let (rows, columns) = self.cells();
        let at = move |row: usize, column: usize| (row % self.rows * self.columns + column % self.columns) as u32;
        let quad = move |row: usize, column: usize| match self.kind {
            Kind::Grid(_) => [at(row, column), at(row, column + 1), at(row + 1, column + 1), at(row + 1, column)],
            Kind::Torus { .. } => [at(row, column), at(row + 1, column), at(row + 1, column + 1), at(row, column + 1)],
        };
        let cells = (0..rows).flat_map(move |row| (0..columns).map(move |column| quad(row, column)));
        cells.flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
    }

    pub(super) fn build(self) -> TriMesh {
        TriMesh::assemble(self.positions().collect(), self.facets().collect())
    }

    /// Writes it as PLY: the bytes that [`crate::mesh::io::encode`] makes of what [`super::Shape::build`] builds.
    pub fn write_ply(self, out: &mut dyn Write) -> io::Result<()> {
        let (vertices, facets) = (self.vertices(), self.facet_count());
        write!(out, "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}\n")?;
        write!(out, "property double x\nproperty double y\nproperty double z\nelement face {facets}\n")?;
        write!(out, "property list uchar int vertex_indices\nend_header\n")?;
        let mut record = [0; 24];
        for p in self.positions() {
            for (out, x) in record.chunks_exact_mut(8).zip(p.to_array()) {
                out.copy_from_slice(&x.to_le_bytes());
            }
            out.write_all(&record)?;
        }
        let mut record = [3; 13];
        for facet in self.facets() {
            for (out, v) in record[1..].chunks_exact_mut(4).zip(facet) {
                out.copy_from_slice(&v.to_le_bytes());
            }
            out.write_all(&record)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::mesh::io::{Format, encode};
    use crate::mesh::shapes::Shape;

    #[test]
    fn what_is_written_is_what_is_built() {
        for shape in Shape::ALL {
            for facets in [1, 700, 3000] {
                let Some(lattice) = shape.lattice(facets) else { continue };
                let mut written = Vec::new();
                lattice.write_ply(&mut written).unwrap();
                assert!(written == encode(Format::Ply, &shape.build(facets)).unwrap(), "{shape} of {facets}");
            }
        }
    }
}
