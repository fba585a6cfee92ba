// A sum in a fixed order: each lane has added its own elements up, then lanes are added in a tree.

var<workgroup> lanes: array<f32, 64>;

// The sum over the workgroup. All lanes call this together.
fn add_lanes(lane: u32, own: f32) -> f32 {
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
