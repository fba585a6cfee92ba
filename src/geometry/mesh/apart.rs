//! Parts of a surface, set apart.
//!
//! Purpose: [`Apart::of`] translates the sheets of a surface until none is near another. Distances within a sheet do not change, so
//! that algorithms by distance treat each sheet alone: a seed's cell does not reach a neighbouring shell, nor one that touches.
//! Invariant: vertices and facets keep their numbers; a vertex of several sheets has a copy for each but the first, behind all
//! others. Moving back restores places, and vertices to the bit. Must not know: seeds, diagrams.

use std::collections::HashMap;

use glam::DVec3;

use super::sheets::Sheets;
use super::{MeshError, TriMesh, coincident};
use crate::token::{Stopped, Token};

/// Most sheets that are moved: a surface with more is a list of triangles, or dust.
const MOST: usize = 10_000;
/// What translations may change, share of the whole's size. The seeds of a curve are a chain, whose rounding grows with the square of
/// their number.
const ROUNDING: f64 = 1e-10;
/// Largest growth of the whole: each doubling costs a binary digit of single precision.
const LONGEST: f64 = 8.0;

#[derive(Clone, Debug)]
pub(crate) struct Apart {
    pub mesh: TriMesh,
    /// One above the other.
    layers: Vec<Layer>,
    /// By how much each part was moved.
    moved: Vec<DVec3>,
    /// Half of the least gap between two components.
    margin: f64,
    /// Where vertices were, by where they are.
    places: HashMap<[u64; 3], DVec3>,
    /// Whether sheets touched.
    touched: bool,
    /// For each copy of a vertex, the vertex.
    pub copied: Vec<u32>,
}

/// Rows beside each other along y.
#[derive(Clone, Debug, Default)]
struct Layer {
    /// Where it ends along z.
    top: f64,
    rows: Vec<Row>,
}

#[derive(Clone, Debug, Default)]
struct Row {
    /// Where it ends along y.
    end: f64,
    /// Where each part ends along x, and its number.
    parts: Vec<(f64, usize)>,
}

type Box = (DVec3, DVec3);

/// A place, for comparison.
pub(crate) fn bits(p: DVec3) -> [u64; 3] {
    // 0 and -0 are one place.
    (p + DVec3::ZERO).to_array().map(f64::to_bits)
}

impl Apart {
    /// Returns `mesh` with its sheets at least `gap` apart, if the boxes of any two are nearer than half of that. `None`
    /// if none are, or if there are too many.
    pub(crate) fn of(mesh: &TriMesh, sheets: &Sheets, gap: f64) -> Option<Self> {
        if sheets.count < 2 || sheets.count > MOST || !(gap.is_finite() && gap > 0.0) {
            return None;
        }
        let Parts { positions, facets, part, boxes, copied } = Parts::of(mesh, sheets);
        if !any_near(&boxes, 0.5 * gap) {
            return None;
        }
        let size = |b: &Box| b.1 - b.0 + gap;
        let (low, high) = mesh.bounds();
        let largest = |least: DVec3| boxes.iter().fold(least, |side, b| side.max(size(b)));
        // In one layer; or in a cube, which is smaller where parts are many, those of one height beside each other.
        let floor: f64 = boxes.iter().map(|b| size(b).x * size(b).y).sum();
        let mut order: Vec<usize> = (0..boxes.len()).collect();
        let mut shelves = Shelves::new(&boxes, &order, gap, largest(DVec3::splat(floor.sqrt())).with_y(f64::INFINITY));
        if shelves.longest() > LONGEST * (high - low).max_element() {
            let volume: f64 = boxes.iter().map(|b| size(b).element_product()).sum();
            order.sort_by(|&a, &b| {
                let [a, b] = [a, b].map(|part| size(&boxes[part]));
                b.z.total_cmp(&a.z).then(b.y.total_cmp(&a.y))
            });
            shelves = Shelves::new(&boxes, &order, gap, largest(DVec3::splat(volume.cbrt())));
        }
        if shelves.longest() > LONGEST * (high - low).max_element() {
            return None;
        }
        let Shelves { mut layers, places: by } = shelves;
        let by: Vec<DVec3> = by.iter().zip(&boxes).map(|(&at, b)| low + at - b.0).collect();
        let place = |(&p, &part): (&DVec3, &u32)| by.get(part as usize).map_or(p, |&by| p + by);
        let moved: Vec<DVec3> = positions.iter().zip(&part).map(place).collect();
        let places = moved.iter().zip(&positions).map(|(&now, &then)| (bits(now), then)).collect();
        for layer in &mut layers {
            layer.top += low.z;
            for row in &mut layer.rows {
                row.end += low.y;
                row.parts.iter_mut().for_each(|part| part.0 += low.x);
            }
        }
        let mesh = TriMesh::new(moved, facets).ok()?;
        Some(Self { mesh, layers, moved: by, margin: 0.5 * gap, places, touched: sheets.touch, copied })
    }

    /// The vertex that this one is, or is a copy of.
    pub(crate) fn before(&self, v: u32) -> u32 {
        let vertices = (self.mesh.positions().len() - self.copied.len()) as u32;
        if v < vertices { v } else { self.copied[(v - vertices) as usize] }
    }

    /// Where a place beside the surface was.
    pub(crate) fn back(&self, p: DVec3) -> DVec3 {
        if let Some(&place) = self.places.get(&bits(p)) {
            return place;
        }
        p - self.moved[self.part(p)]
    }

    /// The part that a place is of or beside.
    pub(crate) fn part(&self, p: DVec3) -> usize {
        let beside = |end: f64, at: f64| end + self.margin < at;
        let layer = self.layers.partition_point(|layer| beside(layer.top, p.z)).min(self.layers.len() - 1);
        let rows = &self.layers[layer].rows;
        let row = rows.partition_point(|row| beside(row.end, p.y)).min(rows.len() - 1);
        let parts = &rows[row].parts;
        parts[parts.partition_point(|part| beside(part.0, p.x)).min(parts.len() - 1)].1
    }

    /// A surface beside this one, where it was; no error if it is still valid there. Where sheets touched, vertices that only
    /// rounding tells apart are in one place again.
    pub(crate) fn mesh_back(&self, mesh: &TriMesh, token: &Token) -> Result<Result<TriMesh, MeshError>, Stopped> {
        let mut positions: Vec<DVec3> = mesh.positions().iter().map(|&p| self.back(p)).collect();
        if self.touched {
            let (low, high) = self.mesh.bounds();
            let reach = ROUNDING * (high - low).max_element();
            for (v, u, _) in coincident::near(&positions.clone(), 0..positions.len() as u32, (low, reach), token)? {
                positions[v as usize] = positions[u as usize];
            }
        }
        Ok(TriMesh::new(positions, mesh.facets().to_vec()))
    }
}

/// Boxes in rows along x, rows beside each other along y, and layers of these above each other.
struct Shelves {
    layers: Vec<Layer>,
    /// Of each box, from the low corner of the whole.
    places: Vec<DVec3>,
}

impl Shelves {
    /// Puts boxes down in an order, `gap` apart, in rows and layers at most as long as a side unless a box is.
    fn new(boxes: &[Box], order: &[usize], gap: f64, side: DVec3) -> Self {
        let mut layers = vec![Layer::default()];
        let mut places = vec![DVec3::ZERO; boxes.len()];
        let mut at = DVec3::ZERO;
        for &part in order {
            let size = boxes[part].1 - boxes[part].0 + gap;
            let mut row = layers.last_mut().and_then(|layer| layer.rows.pop()).unwrap_or_default();
            if at.x > 0.0 && at.x + size.x > side.x {
                at = DVec3::new(0.0, row.end + gap, at.z);
                let above = layers.len() - 1;
                layers[above].rows.push(std::mem::take(&mut row));
                if at.y + size.y > side.y {
                    at = DVec3::new(0.0, 0.0, layers[above].top + gap);
                    layers.push(Layer::default());
                }
            }
            let end = at + size - gap;
            row.parts.push((end.x, part));
            row.end = row.end.max(end.y);
            places[part] = at;
            at.x += size.x;
            let above = layers.len() - 1;
            layers[above].top = layers[above].top.max(end.z);
            layers[above].rows.push(row);
        }
        Self { layers, places }
    }

    fn longest(&self) -> f64 {
        let rows = self.layers.iter().flat_map(|layer| &layer.rows);
        let ends = rows.flat_map(|row| row.parts.iter().map(|part| part.0).chain([row.end]));
        ends.chain(self.layers.iter().map(|layer| layer.top)).fold(0.0, f64::max)
    }
}

/// A surface of which no two sheets share a vertex.
struct Parts {
    positions: Vec<DVec3>,
    facets: Vec<[u32; 3]>,
    /// The sheet of each vertex; `u32::MAX` where no facet has it.
    part: Vec<u32>,
    /// Of each sheet.
    boxes: Vec<Box>,
    copied: Vec<u32>,
}

impl Parts {
    fn of(mesh: &TriMesh, sheets: &Sheets) -> Self {
        let mut positions = mesh.positions().to_vec();
        let mut part = vec![u32::MAX; positions.len()];
        let mut boxes = vec![(DVec3::INFINITY, DVec3::NEG_INFINITY); sheets.count];
        let mut copies: HashMap<(u32, u32), u32> = HashMap::new();
        let mut copied = Vec::new();
        let mut own = |v: u32, sheet: u32| {
            let (low, high) = &mut boxes[sheet as usize];
            let place = mesh.positions()[v as usize];
            (*low, *high) = (low.min(place), high.max(place));
            let first = &mut part[v as usize];
            if *first == u32::MAX {
                *first = sheet;
            }
            if *first == sheet {
                return v;
            }
            *copies.entry((v, sheet)).or_insert_with(|| {
                copied.push(v);
                positions.push(place);
                part.push(sheet);
                positions.len() as u32 - 1
            })
        };
        let of_sheet = |(facet, &sheet): (&[u32; 3], &u32)| facet.map(|v| own(v, sheet));
        let facets = mesh.facets().iter().zip(&sheets.of_facet).map(of_sheet).collect();
        Self { positions, facets, part, boxes, copied }
    }
}

fn any_near(boxes: &[Box], near: f64) -> bool {
    let beside = |a: &Box, b: &Box| (a.0 - near).cmple(b.1).all() && (b.0 - near).cmple(a.1).all();
    let mut sorted: Vec<&Box> = boxes.iter().collect();
    sorted.sort_by(|a, b| a.0.x.total_cmp(&b.0.x));
    let reached = |a: &Box, b: &Box| b.0.x - near <= a.1.x;
    (0..sorted.len())
        .any(|i| sorted[i + 1..].iter().take_while(|b| reached(sorted[i], b)).any(|b| beside(sorted[i], b)))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::mesh::shapes::Shape;

    /// Shells around each other, and a plane through them.
    fn nested(shells: u32) -> TriMesh {
        let (mut positions, mut facets) = Shape::Plane.build(200).into_parts();
        for k in 0..shells {
            let (p, f) = Shape::Sphere.build(300).into_parts();
            let base = positions.len() as u32;
            positions.extend(p.iter().map(|&p| (1.0 + 0.01 * f64::from(k)) * p));
            facets.extend(f.iter().map(|f| f.map(|v| v + base)));
        }
        TriMesh::new(positions, facets).unwrap()
    }

    fn sheets(mesh: &TriMesh) -> Sheets {
        Sheets::of(mesh, 0.0, true, &Token::default()).unwrap()
    }

    #[test]
    fn parts_keep_their_shape_and_come_back_to_the_bit() {
        let mesh = nested(10);
        let gap = 0.3;
        let sheets = sheets(&mesh);
        let apart = Apart::of(&mesh, &sheets, gap).unwrap();
        let boxes = Parts::of(&apart.mesh, &sheets).boxes;
        assert_eq!(boxes.len(), 11);
        assert!(!any_near(&boxes, 0.999 * gap) && apart.copied.is_empty());
        for f in 0..mesh.facets().len() {
            let lengths = |[a, b, c]: [DVec3; 3]| [a.distance(b), b.distance(c), c.distance(a)];
            let (then, now) = (lengths(mesh.corners(f)), lengths(apart.mesh.corners(f)));
            assert!(then.iter().zip(now).all(|(a, b)| (a - b).abs() < 1e-14));
        }
        assert_eq!(apart.mesh_back(&apart.mesh, &Token::default()).unwrap().unwrap(), mesh);
        // Points near a component move with it.
        let side = 0.45 * gap;
        for (k, (&now, &then)) in apart.mesh.positions().iter().zip(mesh.positions()).enumerate() {
            let off = side * DVec3::new((k as f64).sin(), (2.0 * k as f64).cos(), 0.3);
            assert!(apart.back(now + off).distance(then + off) < 1e-14);
        }
    }

    #[test]
    fn what_is_one_or_apart_already_stays() {
        let of = |mesh: &TriMesh, gap| Apart::of(mesh, &sheets(mesh), gap);
        assert!(of(&Shape::Sphere.build(300), 0.1).is_none());
        let mesh = nested(1);
        assert!(of(&mesh, f64::NAN).is_none());
        let apart = of(&mesh, 0.5).unwrap();
        assert!(of(&apart.mesh, 0.5).is_none());
    }

    #[test]
    fn a_vertex_of_several_sheets_has_copies() {
        // Three spheres that share a vertex.
        let sphere = Shape::Sphere.build(100);
        let n = sphere.positions().len() as u32;
        let at = sphere.positions()[0];
        let (mut positions, mut facets) = sphere.clone().into_parts();
        for k in 1..3 {
            let scale = 1.0 - 0.3 * f64::from(k);
            positions.extend(sphere.positions().iter().map(|&p| at + scale * (p - at)));
            let own = |v: u32| if v == 0 { 0 } else { v + k * n };
            facets.extend(sphere.facets().iter().map(|t| t.map(own)));
        }
        let mesh = TriMesh::new(positions, facets).unwrap();
        let sheets = sheets(&mesh);
        assert_eq!(sheets.count, 3);
        let apart = Apart::of(&mesh, &sheets, 0.5).unwrap();
        assert_eq!((&apart.copied[..], apart.mesh.positions().len()), (&[0, 0][..], mesh.positions().len() + 2));
        assert!(Apart::of(&apart.mesh, &sheets, 0.5).is_none());
        let back = apart.mesh_back(&apart.mesh, &Token::default()).unwrap().unwrap();
        assert!((0..mesh.facets().len()).all(|f| back.corners(f) == mesh.corners(f)));
    }
}
