// Dot products in a fixed order: each lane adds its elements up, then lanes are added in a tree.

var<workgroup> lanes: array<vec3f, 64>;

// The sum over the workgroup. All lanes call this together.
fn add_lanes(lane: u32, own: vec3f) -> vec3f {
    lanes[lane] = own;
    workgroupBarrier();
    for (var half = 32u; half > 0u; half /= 2u) {
        if lane < half {
            lanes[lane] = lanes[lane] + lanes[lane + half];
        }
        workgroupBarrier();
    }
    return lanes[0];
}
