// The grid of samples, and what a dispatch does.

struct Params {
    // Samples of a row, rows of a layer, layers.
    size: vec3u,
    step: u32,
    items: u32,
}

@group(0) @binding(0) var<storage, read> params: Params;
