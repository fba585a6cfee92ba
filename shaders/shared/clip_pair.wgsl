// Clipping one facet to one Voronoi cell ([HYWZ17], Algorithm 2), in the facet's plane and the
// seed's frame (shared/plane). Nothing here is larger than the polygon, so nothing cancels.

#import shared/plane

const UNCUT: u32 = 0u;
const CUT: u32 = 1u;
const EMPTY: u32 = 2u;
const OVERFLOW: u32 = 3u;
const BROKEN: u32 = 4u;

// Farther than this from its seed (in bounding boxes) a polygon is finished in double precision:
// a float would round its corners to more than 1e-6 of the box.
const RANGE2: f32 = 64.0;

// Where the edge from `i` (inside) to `o` (outside) meets the bisector; the third coordinate is
// the distance to it. Always from the inside, so that the direction of the edge does not matter.
fn cut_point(i: vec3f, o: vec3f) -> vec2f {
    let t = i.z / (i.z - o.z);
    return i.xy + t * (o.xy - i.xy);
}

#if ARRAY
#import shared/polygon_array
#end
#if 1 - ARRAY
#import shared/polygon_registers
#end

// The first corner in the seed's frame.
var<private> corner0: vec2f;

// A polygon that shrank by more than this in radius has its vertices computed anew.
const SHRUNK2: f32 = 256.0;

// The line of an edge as (g, c): g.p = c.
fn edge_line(facet: Facet, seed: Seed, label: u32) -> vec3f {
    if label < FACET_EDGE - 2u {
        let b = to_seed(seed, seeds[label]);
        let c = 0.5 * inner(b, b) - height_times(facet, b);
        return vec3f(along_e1(facet, b), along_e2(facet, b), c);
    }
    let corner1 = vec2f(facet.corner1_u, 0.0);
    let corner2 = vec2f(facet.corner2_u, facet.corner2_v);
    let e = FACET_EDGE - label;
    let tail = select(select(corner2, corner1, e == 1u), vec2f(0.0), e == 0u);
    let tip = select(select(vec2f(0.0), corner2, e == 1u), corner1, e == 0u);
    let along = normalize(tip - tail);
    let g = vec2f(-along.y, along.x);
    return vec3f(g, dot(g, corner0 + tail));
}

// In a facet much larger than the cell, vertices come from cutting long edges with large
// coordinates, and keep their rounding. The lines that meet in a vertex are near the seed and
// know nothing of that, so the vertex is put where they meet.
fn polygon_refine(facet: Facet, seed: Seed, radius2: f32) {
    var before = edge_line(facet, seed, polygon_edge(count - 1u));
    for (var k = 0u; k < count; k += 1u) {
        let after = edge_line(facet, seed, polygon_edge(k));
        let area = before.x * after.y - before.y * after.x;
        // Lines that are nearly one say nothing of where on them the vertex is.
        if area * area > 1e-4 * dot(before.xy, before.xy) * dot(after.xy, after.xy) {
            let p = vec2f(before.z * after.y - before.y * after.z, before.x * after.z - before.z * after.x) / area;
            let old = polygon_vertex(k);
            if dot(p - old, p - old) < 1e-4 * radius2 {
                polygon_move(k, p);
            }
        }
        before = after;
    }
}

// Leaves the polygon in `count` and the slots. Empty if the cell does not meet the facet.
fn clip_pair(facet: Facet, i: u32) -> u32 {
    let seed = seeds[i];
    var first_radius2 = 0.0;
    var radius2 = 0.0;
    let status = clip_to_row(facet, seed, i, &first_radius2, &radius2);
    if status == DONE && count != 0u && first_radius2 > SHRUNK2 * radius2 {
        polygon_refine(facet, seed, radius2);
    }
    return status;
}

fn clip_to_row(
    facet: Facet,
    seed: Seed,
    i: u32,
    first_radius2: ptr<function, f32>,
    last_radius2: ptr<function, f32>,
) -> u32 {
    corner0 = set_plane(facet, to_corner(seed, facet));
    polygon_start(
        corner0,
        vec2f(corner0.x + facet.corner1_u, corner0.y),
        vec2f(corner0.x + facet.corner2_u, corner0.y + facet.corner2_v),
    );
    let height2 = squared_height();
    var radius2 = polygon_radius2() + height2;
    *first_radius2 = radius2;
    *last_radius2 = radius2;
    // Written so that NaN fails too.
    if !(radius2 <= RANGE2) {
        return FINISH;
    }
    let complete = (seed.row_length & COMPLETE) != 0u;
    let row_end = seed.row_begin + (seed.row_length & INDEX);
    var at = seed.row_begin;
    if at >= row_end {
        return select(NEIGHBOURS, DONE, complete);
    }
    // Left at its end: a driver on a CPU runs a body once more after the last lane has left at the head.
    loop {
        let j = table[at];
        let b = to_seed(seed, seeds[j]);
        let b2 = inner(b, b);
        // The security radius ([LB12]), widened by what rounding can do to either side.
        if b2 > 4.00004 * radius2 {
            return DONE;
        }
        let c = 0.5 * b2 - height_times(facet, b);
        let outcome = polygon_cut(c, vec2f(along_e1(facet, b), along_e2(facet, b)), j, i < j);
        if outcome == CUT {
            radius2 = polygon_radius2() + height2;
            *last_radius2 = radius2;
        } else if outcome == EMPTY {
            return DONE;
        } else if outcome == OVERFLOW {
            return POLYGON;
        } else if outcome == BROKEN {
            return FINISH;
        }
        at += 1u;
        if at >= row_end {
            break;
        }
    }
    return select(NEIGHBOURS, DONE, complete);
}

// Density weight at a point of the facet.
fn weight_at(facet: Facet, p: vec2f) -> f32 {
    let d = p - corner0;
    return clamp(facet.weight + facet.weight_u * d.x + facet.weight_v * d.y, 0.0, facet.weight_top);
}
