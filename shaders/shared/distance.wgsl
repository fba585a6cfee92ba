// Distances in which neighbours are ordered. The host computes the same bits (Seed::key), whatever the
// compiler of this text may fuse: a product goes through an integer operation before it is added.

fn rounded(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ params.zero);
}

fn squared_part(b: vec3f) -> f32 {
    return (rounded(b.x * b.x) + rounded(b.y * b.y)) + rounded(b.z * b.z);
}

fn squared(b: Point) -> f32 {
#if 1 - LIFTED
    return squared_part(b);
#end
#if LIFTED
    return squared_part(b.place) + squared_part(b.lift);
#end
}

// The order of neighbours, a strict one: distance, then index.
fn before(key: f32, seed: u32, other_key: f32, other: u32) -> bool {
    return key < other_key || (key == other_key && seed < other);
}
