// A seed in the order of the grid.
struct Sorted {
    hi: vec3f,
    seed: u32,
    lo: vec3f,
    // The earliest seed at the same place.
    first: u32,
}
