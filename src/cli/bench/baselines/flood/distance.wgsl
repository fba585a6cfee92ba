// Distances between seeds and samples.

#import params

// In the unit of the samples' places.
@group(0) @binding(1) var<storage, read> seeds: array<vec4f>;
#if PLACES
// Three numbers a sample.
@group(0) @binding(4) var<storage, read> places: array<f32>;
#end

// Where a sample is in the grid.
fn at_of(code: u32) -> vec3u {
    let size = params.size;
    return vec3u(code % size.x, code / size.x % size.y, code / size.x / size.y);
}

fn place_of(code: u32) -> vec3f {
#if PLACES
    return vec3f(places[3u * code], places[3u * code + 1u], places[3u * code + 2u]);
#end
#if 1 - PLACES
    // The middle of its unit cube.
    return vec3f(at_of(code)) + 0.5;
#end
}

// A label is seed + 1.
fn squared(label: u32, place: vec3f) -> f32 {
    let d = seeds[label - 1u].xyz - place;
    return dot(d, d);
}
