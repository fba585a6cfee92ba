//! Facets divided among their cells.
//!
//! Purpose: the integrals of all pieces of several facets at once, one facet in each lane of a register, without polygons.
//! Invariant: what comes of a facet depends on nothing in the other lanes. Must not know: where lists of seeds come from.

pub(super) mod facets;
pub(super) mod lanes;
pub(super) mod moments;
