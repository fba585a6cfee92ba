// Where in the grid of seeds a point is, and where that is in memory (see shared/grid).

fn place_of(p: vec3f) -> vec3i {
    let side = f32(params.side);
    return vec3i(clamp((p + 0.5) * side, vec3f(0.0), vec3f(side - 1.0)));
}

fn row_of(y: i32, z: i32) -> u32 {
    return u32(z * i32(params.side) + y) * (params.side + 1u);
}

fn cell_at(place: vec3i) -> u32 {
    return row_of(place.y, place.z) + u32(place.x);
}

const NOWHERE_NEAR: f32 = 1e18;

// A distance from p within which everything is in the cells at most `ring` from `place`, p's own;
// less than the truth by more than rounding could have moved a seed across a wall.
fn covered(p: vec3f, place: vec3i, ring: i32) -> f32 {
    let last = i32(params.side) - 1;
    let low = vec3f(place - ring) / f32(params.side) - 0.5;
    let high = vec3f(place + ring + 1) / f32(params.side) - 0.5;
    let below = select(p - low, vec3f(NOWHERE_NEAR), place - ring <= vec3i(0));
    let above = select(high - p, vec3f(NOWHERE_NEAR), place + ring >= vec3i(last));
    let least = min(below, above);
    return max(min(min(least.x, least.y), least.z) - 1e-6, 0.0);
}
