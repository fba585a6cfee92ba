// What the stages of the optimizer share. A vector has a float for each coordinate of each seed, seed by seed.

struct OptimizerParams {
    seeds: u32,
    // Workgroups of a reduction: partial sums.
    groups: u32,
    // How far along the direction.
    step: f32,
    // Where in the history the new pair goes.
    slot: u32,
    // 1 if there is a direction.
    directed: u32,
    uniform_weights: u32,
    // Mass units times this are moment units.
    moment_per_mass: f32,
    // Units of the gradient: -2 over the moment's scale.
    gradient_unit: f32,
    // Coefficients of the direction: steps, changes of the gradient, the gradient.
    coefficients: array<vec4f, 5>,
    // Units of area between which the pieces cover the surface.
    least_area: vec2u,
    most_area: vec2u,
    // Mean mass of a cell, in its units.
    mean_mass: f32,
    // Slots of the history that hold pairs, as bits.
    used: u32,
    padding: vec2u,
}
