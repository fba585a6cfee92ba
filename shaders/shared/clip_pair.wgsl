// Clipping one facet to one Voronoi cell ([HYWZ17], Algorithm 2), in the facet's plane and the
// seed's frame: a point is foot + u e1 + v e2, where foot is the seed's projection to the plane
// and h the signed height of the plane over the seed. Nothing here is larger than the polygon,
// so nothing cancels.

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

// Height of the facet's plane over the seed, and the first corner in the seed's frame.
var<private> height: f32;
var<private> corner0: vec2f;

// Leaves the polygon in `count` and the slots. Empty if the cell does not meet the facet.
fn clip_pair(facet: Facet, i: u32) -> u32 {
    let seed = seeds[i];
    let w = (facet.hi - seed.hi) + (facet.lo - seed.lo);
    height = dot(facet.n, w);
    corner0 = vec2f(dot(facet.e1, w), dot(facet.e2, w));
    polygon_start(
        corner0,
        vec2f(corner0.x + facet.corner1_u, corner0.y),
        vec2f(corner0.x + facet.corner2_u, corner0.y + facet.corner2_v),
    );
    let height2 = height * height;
    var radius2 = polygon_radius2() + height2;
    // Written so that NaN fails too.
    if !(radius2 <= RANGE2) {
        return FINISH;
    }
    let complete = (seed.row_length & COMPLETE) != 0u;
    let row_end = seed.row_begin + (seed.row_length & INDEX);
    for (var at = seed.row_begin; at < row_end; at += 1u) {
        let j = table[at];
        let other = seeds[j];
        let b = (other.hi - seed.hi) + (other.lo - seed.lo);
        let b2 = dot(b, b);
        // The security radius ([LB12]), widened by what rounding can do to either side.
        if b2 > 4.00004 * radius2 {
            return DONE;
        }
        let c = 0.5 * b2 - height * dot(facet.n, b);
        let outcome = polygon_cut(c, vec2f(dot(facet.e1, b), dot(facet.e2, b)), j, i < j);
        if outcome == CUT {
            radius2 = polygon_radius2() + height2;
        } else if outcome == EMPTY {
            return DONE;
        } else if outcome == OVERFLOW {
            return POLYGON;
        } else if outcome == BROKEN {
            return FINISH;
        }
    }
    return select(NEIGHBOURS, DONE, complete);
}

// Density weight at a point of the facet.
fn weight_at(facet: Facet, p: vec2f) -> f32 {
    let d = p - corner0;
    return clamp(facet.weight + facet.weight_u * d.x + facet.weight_v * d.y, 0.0, facet.weight_top);
}
