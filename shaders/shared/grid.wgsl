// The uniform grid over the unit box. Its outermost cells go on without end, so that every seed is in
// one. A row of cells along x is contiguous, and so are their seeds: entry (z side + y)(side + 1) + x is
// where cell (x, y, z) begins, and the entry after a row's last is where the row ends.

#import shared/sorted

const NOWHERE_NEAR: f32 = 1e18;

#import shared/place

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

// The cells of row (y, z) that `ring` adds to those of the ring before; the first ring has the middle too.
// Two ranges of the sorted seeds, as (begin, end, begin, end).
fn parts_of(place: vec3i, ring: i32, y: i32, z: i32) -> vec4u {
    let last = i32(params.side) - 1;
    if min(y, z) < 0 || max(y, z) > last {
        return vec4u(0u);
    }
    let row = row_of(y, z);
    let low = place.x - ring;
    let high = place.x + ring;
    if ring == 1 || abs(y - place.y) == ring || abs(z - place.z) == ring {
        return vec4u(cells[row + u32(max(low, 0))], cells[row + u32(min(high, last)) + 1u], 0u, 0u);
    }
    var parts = vec4u(0u);
    if low >= 0 {
        parts.x = cells[row + u32(low)];
        parts.y = cells[row + u32(low) + 1u];
    }
    if high <= last {
        parts.z = cells[row + u32(high)];
        parts.w = cells[row + u32(high) + 1u];
    }
    return parts;
}
