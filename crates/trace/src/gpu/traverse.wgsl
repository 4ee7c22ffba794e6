// Finds the nearest triangle along a ray, by a traversal of the hierarchy of bvh.rs with a stack.
//
// Units. A power of two scales the scene to a size of about 1, and another one scales each direction so that
// its largest component is 1 to 2. Both scalings are exact, so the size of scenes and directions does not
// affect the result.
//
// Watertight (Woop et al. 2013). Vertices are translated and sheared so that the ray becomes the third axis.
// The transformed vertex depends only on the vertex and the ray, so it is the same for all triangles that
// share the vertex. The side of the axis on which an edge lies is then decided exactly. So a hit is an exact
// statement about the transformed vertices, and no ray passes between two triangles that share an edge or a
// vertex. The device may fuse products and sums: only rounded products are compared, rounding is monotone,
// and equal rounded products are compared in integers.
//
// Boxes are widened by 2^-19 of the distance to the scene's farthest corner. Of that distance, shearing moves
// a vertex by at most 10 · 2^-24 (subtraction 1, its error sheared 1, quotient of 2.5 ulp 5, product 1, sum
// 2), and the slab test is wrong by at most 7 · 2^-24 (subtraction 1, reciprocal 5, product 1). The widening
// is 32 · 2^-24.
//
// Order. The distance of a hit is clamped to the span of the triangle's own box. Spans are monotone in the
// box, also after rounding, so the traversal skips no box with a hit at least as near as the nearest known
// hit. Among hits at equal distances, the triangle with the lowest id counts. So the order of the traversal
// does not affect the result.

struct Scene {
    low: vec3<f32>,
    // Powers of two: `scale` scales scene units so that the scene's size is about 1, and `unscale` is its
    // inverse.
    scale: f32,
    high: vec3<f32>,
    unscale: f32,
    // Minimum distance of a hit, exclusive, in scaled units.
    near: f32,
}

// PAGED: true if the buffers have more than one page. NODE_PAGE and TRIANGLE_PAGE: numbers of nodes and
// triangles in a page.
override PAGED: bool = false;
override NODE_PAGE: u32 = 1u;
override TRIANGLE_PAGE: u32 = 1u;
// True if some triangles are hit only from one side.
override CULL: bool = false;

// The depth of the stack, and the layout of a node's child word, as in bvh.rs.
const STACK: u32 = 40u;
const COUNT_BITS: u32 = 4u;
const COUNT_MASK: u32 = 15u;

const SKY: u32 = 0xffffffffu;
const INFINITE: u32 = 0x7f800000u;
// Distance of a ray without a hit; greater than every scaled distance.
const FAR: f32 = 3e38;
// 2^60: the maximum coordinate of an origin, in scaled units. A ray from a farther origin has no hit, so
// products of two translated coordinates stay finite.
const MOST_DISTANT: f32 = 1152921504606846976.0;
// 2^-60: box tests replace smaller components of a direction by this value. 2^-100: smaller sheared
// coordinates become zero.
const LEAST_DIRECTION: f32 = 8.673617379884035e-19;
const LEAST_SHEARED: f32 = 7.888609052210118e-31;
// 2^-19: the widening of boxes, as a fraction of the distance to the scene's farthest corner.
const WIDENING: f32 = 0.0000019073486328125;

@group(0) @binding(0) var<uniform> scene: Scene;
// Two elements for each node: minimum corner and child word; maximum corner and an unused word.
@group(0) @binding(1) var<storage, read> nodes_a: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> nodes_b: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read> nodes_c: array<vec4<u32>>;
// Three elements for each triangle: its vertices. The fourth word of the first element is the id, and of the
// second element the side.
@group(0) @binding(4) var<storage, read> triangles_a: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> triangles_b: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read> triangles_c: array<vec4<u32>>;

struct Node {
    low: vec3<f32>,
    child: u32,
    high: vec3<f32>,
}

struct Corners {
    a: vec3<f32>,
    b: vec3<f32>,
    c: vec3<f32>,
    id: u32,
    // 0: rays hit the triangle from both sides. 1: only from the side on which the vertices run
    // counter-clockwise. 2: only from the side on which they run clockwise.
    side: u32,
}

struct Ray {
    origin: vec3<f32>,
    direction: vec3<f32>,
    // Values for box tests: the inverse of the direction, the widening, and true for each axis along which
    // the ray runs in negative direction.
    inverse: vec3<f32>,
    widening: vec3<f32>,
    backwards: vec3<bool>,
    // Values for triangle tests: the axis of the direction's largest component, and the shear of the other
    // two axes.
    major: u32,
    shear: vec2<f32>,
    // True if the ray runs in positive direction along the axis `major`.
    upwards: bool,
    near: f32,
}

fn node_at(index: u32) -> Node {
    var low: vec4<u32>;
    var high: vec4<u32>;
    if !PAGED || index < NODE_PAGE {
        low = nodes_a[2u * index];
        high = nodes_a[2u * index + 1u];
    } else if index < 2u * NODE_PAGE {
        let at = 2u * (index - NODE_PAGE);
        low = nodes_b[at];
        high = nodes_b[at + 1u];
    } else {
        let at = 2u * (index - 2u * NODE_PAGE);
        low = nodes_c[at];
        high = nodes_c[at + 1u];
    }
    return Node(bitcast<vec3<f32>>(low.xyz), low.w, bitcast<vec3<f32>>(high.xyz));
}

fn corners_at(index: u32) -> Corners {
    var a: vec4<u32>;
    var b: vec4<u32>;
    var c: vec4<u32>;
    if !PAGED || index < TRIANGLE_PAGE {
        a = triangles_a[3u * index];
        b = triangles_a[3u * index + 1u];
        c = triangles_a[3u * index + 2u];
    } else if index < 2u * TRIANGLE_PAGE {
        let at = 3u * (index - TRIANGLE_PAGE);
        a = triangles_b[at];
        b = triangles_b[at + 1u];
        c = triangles_b[at + 2u];
    } else {
        let at = 3u * (index - 2u * TRIANGLE_PAGE);
        a = triangles_c[at];
        b = triangles_c[at + 1u];
        c = triangles_c[at + 2u];
    }
    return Corners(
        bitcast<vec3<f32>>(a.xyz),
        bitcast<vec3<f32>>(b.xyz),
        bitcast<vec3<f32>>(c.xyz),
        a.w,
        b.w,
    );
}

// Returns the distances at which the ray enters and leaves the widened box. For a ray that misses the box,
// the first distance is larger.
fn span(ray: Ray, low: vec3<f32>, high: vec3<f32>) -> vec2<f32> {
    let first = select(low, high, ray.backwards) - ray.origin;
    let last = select(high, low, ray.backwards) - ray.origin;
    let enter = fma(first, ray.inverse, -ray.widening);
    let leave = fma(last, ray.inverse, ray.widening);
    return vec2<f32>(max(max(enter.x, enter.y), enter.z), min(min(leave.x, leave.y), leave.z));
}

// Rotates the axes so that the axis `major` is the last one.
fn turned(v: vec3<f32>, major: u32) -> vec3<f32> {
    return select(select(v.xyz, v.zxy, major == 1u), v.yzx, major == 0u);
}

// Returns the vertex in the sheared frame of the ray. An explicit fma rounds every vertex in the same way.
fn sheared(ray: Ray, vertex: vec3<f32>) -> vec2<f32> {
    let v = turned(vertex - ray.origin, ray.major);
    let s = fma(-ray.shear, v.zz, v.xy);
    return select(s, vec2<f32>(0.0), abs(s) < vec2<f32>(LEAST_SHEARED));
}

// An exact product: its sign (0 for zero), its exponent, and 48 bits of its significand, of which the highest
// bit is 1.
struct Product {
    sign: i32,
    exponent: u32,
    high: u32,
    low: u32,
}

fn product(a: f32, b: f32) -> Product {
    let x = bitcast<u32>(a);
    let y = bitcast<u32>(b);
    let ex = (x >> 23u) & 0xffu;
    let ey = (y >> 23u) & 0xffu;
    if ex == 0u || ey == 0u {
        return Product(0, 0u, 0u, 0u);
    }
    let m = (x & 0x7fffffu) | 0x800000u;
    let n = (y & 0x7fffffu) | 0x800000u;
    let below = (m & 0xfffu) * (n & 0xfffu);
    let between = (m >> 12u) * (n & 0xfffu) + (m & 0xfffu) * (n >> 12u) + (below >> 12u);
    var high = (m >> 12u) * (n >> 12u) + (between >> 12u);
    var low = ((between & 0xfffu) << 12u) | (below & 0xfffu);
    var exponent = ex + ey + 1u;
    if high < 0x800000u {
        high = (high << 1u) | (low >> 23u);
        low = (low << 1u) & 0xffffffu;
        exponent -= 1u;
    }
    return Product(select(1, -1, ((x ^ y) >> 31u) != 0u), exponent, high, low);
}

// Returns the exact sign of a·b − c·d.
fn exact_order(a: f32, b: f32, c: f32, d: f32) -> i32 {
    let p = product(a, b);
    let q = product(c, d);
    if p.sign != q.sign {
        return select(-1, 1, p.sign > q.sign);
    }
    if p.exponent != q.exponent {
        return select(-p.sign, p.sign, p.exponent > q.exponent);
    }
    if p.high != q.high {
        return select(-p.sign, p.sign, p.high > q.high);
    }
    if p.low != q.low {
        return select(-p.sign, p.sign, p.low > q.low);
    }
    return 0;
}

// Returns the side of the edge from p to q on which the point (0, 0) of the sheared frame lies: −1, 0 or 1.
fn side(p: vec2<f32>, q: vec2<f32>) -> i32 {
    let u = p.x * q.y;
    let v = p.y * q.x;
    if u > v {
        return 1;
    }
    if u < v {
        return -1;
    }
    return exact_order(p.x, q.y, p.y, q.x);
}

// Returns the scaled distance of the triangle along the ray, or FAR without a hit.
fn meet(ray: Ray, t: Corners) -> f32 {
    let a = sheared(ray, t.a);
    let b = sheared(ray, t.b);
    let c = sheared(ray, t.c);
    let u = side(b, c);
    let v = side(c, a);
    let w = side(a, b);
    let least = min(min(u, v), w);
    let most = max(max(u, v), w);
    // Hits count on both sides and on the border. A ray in the plane of a triangle hits its neighbours
    // instead.
    if (least == 0 && most == 0) || (least < 0 && most > 0) {
        return FAR;
    }
    // The rotated axes are right-handed. If the origin is on the left of each edge, the vertices run
    // counter-clockwise as seen from the positive end of the third axis. A ray in positive direction hits
    // such a triangle from behind.
    if CULL && t.side != 0u && ((most > 0) == ray.upwards) == (t.side == 1u) {
        return FAR;
    }
    // The distance to the triangle's plane. The distance is exactly 0 if the ray begins in the plane of an
    // axis-aligned wall.
    let normal = cross(t.b - t.a, t.c - t.a);
    let height = dot(normal, t.a - ray.origin);
    let slope = dot(normal, ray.direction);
    let reach = span(ray, min(min(t.a, t.b), t.c), max(max(t.a, t.b), t.c));
    var distance = reach.x;
    if abs(slope) > 1e-36 {
        distance = height / slope;
    }
    distance = max(min(distance, reach.y), reach.x);
    return select(FAR, distance, distance > ray.near);
}

struct Hit {
    // The distance in lengths of the direction; FAR without a hit.
    distance: f32,
    // The id of the triangle; SKY without a hit.
    id: u32,
}

// Returns the nearest triangle along the ray from `given_origin` in the direction `given`, both in scene
// units.
fn nearest_along(given_origin: vec3<f32>, given: vec3<f32>) -> Hit {
    let missed = Hit(FAR, SKY);
    // Test the bits for infinities and NaN, because a device may assume that such numbers do not occur.
    let origin_exponents = (bitcast<vec3<u32>>(given_origin) >> vec3<u32>(23u)) & vec3<u32>(0xffu);
    let exponents = (bitcast<vec3<u32>>(given) >> vec3<u32>(23u)) & vec3<u32>(0xffu);
    let exponent = max(max(exponents.x, exponents.y), exponents.z);
    let origin_exponent = max(max(origin_exponents.x, origin_exponents.y), origin_exponents.z);
    if exponent == 0u || exponent == 0xffu || origin_exponent == 0xffu {
        return missed;
    }
    // Powers of two that scale the largest component to 1 to 2 (to 4 for the longest directions), and back.
    let shortening = bitcast<f32>((254u - min(exponent, 253u)) << 23u);
    let lengthening = bitcast<f32>(min(exponent, 253u) << 23u);

    var ray: Ray;
    ray.origin = given_origin * scene.scale;
    if any(abs(ray.origin) > vec3<f32>(MOST_DISTANT)) {
        return missed;
    }
    ray.direction = given * shortening;
    let size = abs(ray.direction);
    let tiny = size < vec3<f32>(LEAST_DIRECTION);
    let signed_least =
        select(vec3<f32>(LEAST_DIRECTION), vec3<f32>(-LEAST_DIRECTION), ray.direction < vec3<f32>(0.0));
    ray.inverse = vec3<f32>(1.0) / select(ray.direction, signed_least, tiny);
    ray.backwards = ray.inverse < vec3<f32>(0.0);
    let corner = max(abs(scene.low - ray.origin), abs(scene.high - ray.origin));
    ray.widening = (max(max(corner.x, corner.y), corner.z) * WIDENING) * abs(ray.inverse);
    ray.major = select(select(2u, 1u, size.y >= size.z), 0u, size.x >= size.y && size.x >= size.z);
    let d = turned(ray.direction, ray.major);
    ray.shear = d.xy / d.z;
    ray.upwards = d.z > 0.0;
    ray.near = scene.near * lengthening;

    var nearest = FAR;
    var met = SKY;
    var aside: array<u32, STACK>;
    var aside_at: array<f32, STACK>;
    var height = 0u;
    var child = node_at(0u).child;
    loop {
        let count = child & COUNT_MASK;
        let place = child >> COUNT_BITS;
        var descended = false;
        if count == 0u {
            let left = node_at(place);
            let right = node_at(place + 1u);
            let l = span(ray, left.low, left.high);
            let r = span(ray, right.low, right.high);
            let to_left = l.x <= l.y && l.x <= nearest && l.y > ray.near;
            let to_right = r.x <= r.y && r.x <= nearest && r.y > ray.near;
            if to_left && to_right {
                let left_first = l.x <= r.x;
                aside[height] = select(left.child, right.child, left_first);
                aside_at[height] = select(l.x, r.x, left_first);
                height += 1u;
                child = select(right.child, left.child, left_first);
            } else {
                child = select(right.child, left.child, to_left);
            }
            descended = to_left || to_right;
        } else {
            for (var i = 0u; i < count; i++) {
                let t = corners_at(place + i);
                let distance = meet(ray, t);
                if distance < nearest || (distance == nearest && distance < FAR && t.id < met) {
                    nearest = distance;
                    met = t.id;
                }
            }
        }
        while !descended && height > 0u {
            height -= 1u;
            child = aside[height];
            descended = aside_at[height] <= nearest;
        }
        if !descended {
            break;
        }
    }
    if met == SKY {
        return missed;
    }
    return Hit(nearest * (shortening * scene.unscale), met);
}
