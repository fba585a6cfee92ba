// Two ways to add a piece to its cell's sums ([HYWZ17]: atomics to global memory, or partial sums in
// the memory of a workgroup, merged in a second phase). Integers, so both give the same bits. SHARED
// decides at compile time: the barriers alone, not taken, cost a software adapter a tenth of the clip.

// Words per seed: mass, moment coordinate by coordinate, energy, area; two each.
const SUM_WORDS: u32 = $(12 + 6 * LIFTED)u;
const LANES: u32 = 64u;

// In units. Mass is 0 with uniform weights, where the host takes the area for it.
struct PieceSums {
    mass: f32,
    moment: Point,
    energy: f32,
    area: f32,
}

fn add_direct(i: u32, s: PieceSums) {
    let at = i * SUM_WORDS;
    if s.mass != 0.0 {
        add_fixed(at, s.mass);
    }
    let place = place_in(s.moment);
    add_fixed(at + 2u, place.x);
    add_fixed(at + 4u, place.y);
    add_fixed(at + 6u, place.z);
#if LIFTED
    add_fixed(at + 8u, s.moment.lift.x);
    add_fixed(at + 10u, s.moment.lift.y);
    add_fixed(at + 12u, s.moment.lift.z);
#end
    add_fixed(at + SUM_WORDS - 4u, s.energy);
    add_fixed(at + SUM_WORDS - 2u, s.area);
}

#if SHARED
// The workgroup's seeds, plus 1; as many slots as pieces, so that each finds one.
var<workgroup> part_seeds: array<atomic<u32>, 64>;
var<workgroup> part_sums: array<atomic<u32>, $(64 * (12 + 6 * LIFTED))>;

// As add_fixed, to partial sums.
fn add_part(at: u32, v: f32) {
    let x = to_fixed(v);
    let before = atomicAdd(&part_sums[at], x.x);
    let high = x.y + select(0u, 1u, before + x.x < x.x);
    if high != 0u {
        atomicAdd(&part_sums[at + 1u], high);
    }
}

// All lanes of the workgroup call this together.
fn add_shared(lane: u32, piece: bool, i: u32, s: PieceSums) {
    atomicStore(&part_seeds[lane], 0u);
    for (var k = 0u; k < SUM_WORDS; k += 1u) {
        atomicStore(&part_sums[k * LANES + lane], 0u);
    }
    workgroupBarrier();
    if piece {
        var slot = (i * 2654435769u) >> 26u;
        loop {
            let result = atomicCompareExchangeWeak(&part_seeds[slot], 0u, i + 1u);
            if result.exchanged || result.old_value == i + 1u {
                break;
            }
            // The weak exchange may fail on a free slot; then the same slot is tried again.
            if result.old_value != 0u {
                slot = (slot + 1u) % LANES;
            }
        }
        let at = slot * SUM_WORDS;
        if s.mass != 0.0 {
            add_part(at, s.mass);
        }
        let place = place_in(s.moment);
        add_part(at + 2u, place.x);
        add_part(at + 4u, place.y);
        add_part(at + 6u, place.z);
#if LIFTED
        add_part(at + 8u, s.moment.lift.x);
        add_part(at + 10u, s.moment.lift.y);
        add_part(at + 12u, s.moment.lift.z);
#end
        add_part(at + SUM_WORDS - 4u, s.energy);
        add_part(at + SUM_WORDS - 2u, s.area);
    }
    workgroupBarrier();
    let seed = atomicLoad(&part_seeds[lane]);
    if seed != 0u {
        for (var k = 0u; k < SUM_WORDS; k += 2u) {
            let low = atomicLoad(&part_sums[lane * SUM_WORDS + k]);
            let high = atomicLoad(&part_sums[lane * SUM_WORDS + k + 1u]);
            if (low | high) != 0u {
                add_limbs((seed - 1u) * SUM_WORDS + k, vec2u(low, high));
            }
        }
    }
}
#end
