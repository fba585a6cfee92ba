// Appending to the two lists.

#import shared/append_pair
#import shared/failure

// `pair` is a seed, with ROOT if its facet begins with it.
fn append_failure(facet: u32, pair: u32, code: u32) {
    let at = atomicAdd(&state.failures, 1u);
    if at < params.list_capacity {
        failures[at] = failure_entry(facet, pair, code);
    }
}
