// 64-bit fixed-point sums in two u32 limbs, low limb first, two's complement.
//
// Integer addition has no order, so the sums have the same bits on every run, which float
// atomics would not give.

// A float, already scaled to units, as (low, high). |v| must be below 2^63.
fn to_fixed(v: f32) -> vec2u {
    let m = round(abs(v));
    let high = u32(m * (1.0 / 4294967296.0));
    // Exact: both are multiples of the last place of m.
    let low = u32(m - f32(high) * 4294967296.0);
    if v < 0.0 {
        return vec2u(~low + 1u, ~high + select(0u, 1u, low == 0u));
    }
    return vec2u(low, high);
}

// Adds to the sum whose low limb is word `at`.
fn add_fixed(at: u32, v: f32) {
    add_limbs(at, to_fixed(v));
}

// Half the atomics where the device has them in 64 bits: the same sums.
#if WIDE
fn add_limbs(at: u32, x: vec2u) {
    atomicAdd(&sums[at / 2u], (u64(x.y) << 32u) | u64(x.x));
}
#end
#if 1 - WIDE
fn add_limbs(at: u32, x: vec2u) {
    let before = atomicAdd(&sums[at], x.x);
    let carry = select(0u, 1u, before + x.x < x.x);
    if (x.y + carry) != 0u {
        atomicAdd(&sums[at + 1u], x.y + carry);
    }
}
#end
