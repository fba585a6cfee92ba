// Fixed-point sums as floats, rounded.

// Words per seed: mass, moment x y z, energy, area; two each, as in shared/accumulate.
const SUM_WORDS: u32 = 12u;

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

fn moment_of(seed: u32) -> vec3f {
    return vec3f(from_fixed(limbs(seed, 1u)), from_fixed(limbs(seed, 2u)), from_fixed(limbs(seed, 3u)));
}
