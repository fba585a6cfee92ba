// The preconditioner: what a seed's part of a gradient is multiplied by, so that heavy cells do not go farther than light
// ones.

#import shared/from_fixed

// The mean mass over the cell's; 0 for a cell without mass, which has no part.
fn preconditioner(seed: u32) -> f32 {
    // With uniform weights mass is area.
    let mass = from_fixed(limbs(seed, select(0u, AREA, params.uniform_weights != 0u)));
    return select(0.0, params.mean_mass / mass, mass > 0.0);
}
