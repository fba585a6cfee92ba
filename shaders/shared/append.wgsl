// Appending to the two lists.

#import shared/append_pair

// Both indices are below 2^31, which leaves a bit in each for the code: 0 says that the
// facet's set is full, the others are statuses.
fn append_failure(facet: u32, seed: u32, code: u32) {
    let at = atomicAdd(&state.failures, 1u);
    if at < params.list_capacity {
        failures[at] = vec2u(facet | ((code & 1u) << 31u), seed | ((code >> 1u) << 31u));
    }
}
