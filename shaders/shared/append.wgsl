// Appending to the two lists. A list that is full counts on, so that the host learns of it.

fn append_pair(facet: u32, seed: u32) {
    let at = atomicAdd(&state.length, 1u);
    if at < params.list_capacity {
        list[at] = vec2u(facet, seed);
    } else {
        atomicAdd(&state.list_overflow, 1u);
    }
}

// Both indices are below 2^31, which leaves a bit in each for the code: 0 says that the
// facet's set is full, the others are statuses.
fn append_failure(facet: u32, seed: u32, code: u32) {
    let at = atomicAdd(&state.failures, 1u);
    if at < params.list_capacity {
        failures[at] = vec2u(facet | ((code & 1u) << 31u), seed | ((code >> 1u) << 31u));
    }
}
