//! Sums of two backends that work differently.

use tessera::rvd::CellSums;

/// How two backends' sums differ by more than `area` in ∫ 1. Weights are at most 1, and no piece is farther from its
/// seed than `far`.
pub fn unlike(got: &CellSums, want: &CellSums, area: f64, far: f64) -> Option<String> {
    (0..want.area.len()).find_map(|i| {
        let apart = [
            ("area", (got.area[i] - want.area[i]).abs(), 1.0),
            ("mass", (got.mass[i] - want.mass[i]).abs(), 1.0),
            ("moment", got.moment[i].distance(want.moment[i]), far),
            ("energy", (got.energy[i] - want.energy[i]).abs(), far * far),
        ];
        let (what, apart, _) = apart.into_iter().find(|&(_, apart, reach)| apart > area * reach || apart.is_nan())?;
        Some(format!("the {what} of cell {i} is off by {apart:e}"))
    })
}
