// Fixed-point sums as floats, rounded.

#import shared/point

// Words per seed: mass, moment coordinate by coordinate, energy, area; two each, as in shared/accumulate.
const SUM_WORDS: u32 = $(12 + 6 * LIFTED)u;
// Which of the sums these are.
const ENERGY: u32 = $(4 + 3 * LIFTED)u;
const AREA: u32 = $(5 + 3 * LIFTED)u;

fn limbs(seed: u32, which: u32) -> vec2u {
    let at = seed * SUM_WORDS + 2u * which;
    return vec2u(sums[at], sums[at + 1u]);
}

fn from_fixed(x: vec2u) -> f32 {
    if (x.y & 0x80000000u) != 0u {
        let low = ~x.x + 1u;
        let high = ~x.y + select(0u, 1u, low == 0u);
        return -(f32(high) * 4294967296.0 + f32(low));
    }
    return f32(x.y) * 4294967296.0 + f32(x.x);
}

fn three_of(seed: u32, first: u32) -> vec3f {
    return vec3f(
        from_fixed(limbs(seed, first)),
        from_fixed(limbs(seed, first + 1u)),
        from_fixed(limbs(seed, first + 2u)),
    );
}

fn moment_of(seed: u32) -> Point {
#if 1 - LIFTED
    return three_of(seed, 1u);
#end
#if LIFTED
    return Point(three_of(seed, 1u), three_of(seed, 4u));
#end
}
