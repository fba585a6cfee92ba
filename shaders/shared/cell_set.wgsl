// The cells that a facet is known to meet: one open-addressing hash set per facet in `slots`.
// A slot holds seed + 1, or 0 if it is free, and NAMED in its highest bit.

const PRESENT: u32 = 0u;
const INSERTED: u32 = 1u;
const FULL: u32 = 2u;

// First slot to look at.
fn first_slot(slot_mask: u32, seed: u32) -> u32 {
    return ((seed * 2654435769u) >> 8u) & slot_mask;
}

// `named` is NAMED or 0; once set it stays.
fn insert_cell(slot_begin: u32, slot_mask: u32, seed: u32, named: u32) -> u32 {
    let key = seed + 1u;
    var at = first_slot(slot_mask, seed);
    var probes = 0u;
    while probes <= slot_mask {
        let result = atomicCompareExchangeWeak(&slots[slot_begin + at], 0u, key | named);
        if result.exchanged {
            return INSERTED;
        }
        if (result.old_value & ~NAMED) == key {
            if (named & ~result.old_value) != 0u {
                atomicOr(&slots[slot_begin + at], named);
            }
            return PRESENT;
        }
        // The weak exchange may fail on a free slot; then the same slot is tried again.
        if result.old_value != 0u {
            at = (at + 1u) & slot_mask;
            probes += 1u;
        }
    }
    return FULL;
}

// Whether `seed` is in the set and NAMED.
fn is_named(slot_begin: u32, slot_mask: u32, seed: u32) -> bool {
    let key = seed + 1u;
    var at = first_slot(slot_mask, seed);
    for (var probes = 0u; probes <= slot_mask; probes += 1u) {
        let found = atomicLoad(&slots[slot_begin + at]);
        if (found & ~NAMED) == key {
            return (found & NAMED) != 0u;
        }
        if found == 0u {
            return false;
        }
        at = (at + 1u) & slot_mask;
    }
    return false;
}
