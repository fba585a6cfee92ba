// The cells that a facet is known to meet: one open-addressing hash set per facet in `slots`.
// A slot holds seed + 1, or 0 if it is free.

const PRESENT: u32 = 0u;
const INSERTED: u32 = 1u;
const FULL: u32 = 2u;

fn insert_cell(slot_begin: u32, slot_mask: u32, seed: u32) -> u32 {
    let key = seed + 1u;
    var at = ((seed * 2654435769u) >> 8u) & slot_mask;
    var probes = 0u;
    while probes <= slot_mask {
        let result = atomicCompareExchangeWeak(&slots[slot_begin + at], 0u, key);
        if result.exchanged {
            return INSERTED;
        }
        if result.old_value == key {
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
