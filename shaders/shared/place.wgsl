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
