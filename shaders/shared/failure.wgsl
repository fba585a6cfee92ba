// Entries of the list of failures: facet and seed, whether the pair begins its facet, and a code. Both indices are below
// 2^30. The code 0 says that the facet's set is full, the others are statuses. An entry that was put to the end of the list
// of pairs again has in its facet's place the number of clip rounds so far.

// In the first word: the pair was put to the end of the list again.
const REQUEUED: u32 = 0x40000000u;
// In the second word: the pair is the first of its facet.
const FIRST: u32 = 0x40000000u;
// The bits of the index in both.
const FAILED: u32 = 0x3fffffffu;

fn failure_code(first: u32, second: u32) -> u32 {
    return (first >> 31u) | ((second >> 31u) << 1u);
}

// `pair` is a seed, with ROOT if its facet begins with it.
fn failure_entry(facet: u32, pair: u32, code: u32) -> vec2u {
    let root = select(0u, FIRST, (pair & ROOT) != 0u);
    return vec2u(facet | ((code & 1u) << 31u), (pair & INDEX) | root | ((code >> 1u) << 31u));
}
