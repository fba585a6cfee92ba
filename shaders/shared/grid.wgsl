// The uniform grid over the unit box. Its outermost cells go on without end, so that every seed is in
// one. A row of cells along x is contiguous, and so are their seeds: entry (z side + y)(side + 1) + x is
// where cell (x, y, z) begins, and the entry after a row's last is where the row ends.

#import shared/sorted

#import shared/place

// The cells of row (y, z) that are at most `ring` from `place`: a range of the sorted seeds.
fn row_around(place: vec3i, ring: i32, y: i32, z: i32) -> vec2u {
    let last = i32(params.side) - 1;
    if min(y, z) < 0 || max(y, z) > last {
        return vec2u(0u);
    }
    let row = row_of(y, z);
    return vec2u(cells[row + u32(max(place.x - ring, 0))], cells[row + u32(min(place.x + ring, last)) + 1u]);
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
