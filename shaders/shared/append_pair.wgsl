// Appending to the list of pairs. A list that is full counts on, so that the host learns of it.

fn append_pair(facet: u32, seed: u32) {
    let at = atomicAdd(&state.length, 1u);
    if at < params.list_capacity {
        list[at] = vec2u(facet, seed);
    } else {
        atomicAdd(&state.list_overflow, 1u);
    }
}
