// The plane of a facet about a seed: a point is foot + u e1 + v e2, where foot is the point of the plane nearest to the seed.
// In R^3 the foot is as high over the seed as a number says, along the normal. LIFTED, it is a vector across both directions
// of the frame.

#if 1 - LIFTED
var<private> height: f32;
#end
#if LIFTED
var<private> height: Point;
#end

fn along_e1(facet: Facet, b: Point) -> f32 {
#if 1 - LIFTED
    return dot(facet.e1, b);
#end
#if LIFTED
    return dot(facet.e1, b.place) + dot(facet.lift_e1, b.lift);
#end
}

fn along_e2(facet: Facet, b: Point) -> f32 {
#if 1 - LIFTED
    return dot(facet.e2, b);
#end
#if LIFTED
    return dot(facet.e2, b.place) + dot(facet.lift_e2, b.lift);
#end
}

// Takes the plane about the seed from which the first corner is at w. Returns where that is from the foot.
fn set_plane(facet: Facet, w: Point) -> vec2f {
#if 1 - LIFTED
    height = dot(facet.n, w);
    return vec2f(dot(facet.e1, w), dot(facet.e2, w));
#end
#if LIFTED
    let corner = vec2f(along_e1(facet, w), along_e2(facet, w));
    height = Point(
        w.place - corner.x * facet.e1 - corner.y * facet.e2,
        w.lift - corner.x * facet.lift_e1 - corner.y * facet.lift_e2,
    );
    return corner;
#end
}

// The height times itself.
fn squared_height() -> f32 {
#if 1 - LIFTED
    return height * height;
#end
#if LIFTED
    return inner(height, height);
#end
}

// The height times what of b is along it.
fn height_times(facet: Facet, b: Point) -> f32 {
#if 1 - LIFTED
    return height * dot(facet.n, b);
#end
#if LIFTED
    return inner(height, b);
#end
}

// The energy of a mass at the foot.
fn foot_energy(mass: f32) -> f32 {
#if 1 - LIFTED
    return mass * height * height;
#end
#if LIFTED
    return mass * inner(height, height);
#end
}

// From the seed: p in the facet's frame, and so many times the height.
fn from_seed(facet: Facet, p: vec2f, times: f32) -> Point {
#if 1 - LIFTED
    return p.x * facet.e1 + p.y * facet.e2 + (times * height) * facet.n;
#end
#if LIFTED
    return Point(
        p.x * facet.e1 + p.y * facet.e2 + times * height.place,
        p.x * facet.lift_e1 + p.y * facet.lift_e2 + times * height.lift,
    );
#end
}
