// Traces lines in both directions, and credits all cells that the free part of a line crosses with the
// triangles at the line's ends. The operations and their order are the same as in Block::credit_line
// (lines/block.rs) and CellGrid::walk (lines/grid.rs) on the host. Needs block.wgsl.

// HALVES: true if lines end at a distance or some triangles have one side, so that the halves of a line are
// credited separately. ONE_WAY: true if some triangles have one side, so that a half is free only in its own
// direction.
override HALVES: bool = false;
override ONE_WAY: bool = false;

// Four units in the last place.
const OVERLAP: f32 = 4.76837158203125e-7;

// Returns `v` unchanged. The compiler cannot fuse the operation that computed `v` with the next operation.
fn rounded(v: vec3<f32>) -> vec3<f32> {
    return bitcast<vec3<f32>>(bitcast<vec3<u32>>(v) ^ vec3<u32>(block.zero));
}

// Returns 1 / x, rounded as on the host. A device's quotient may be off by 2.5 units in the last place; one
// step of Newton's method with a fused remainder corrects that, except beyond the range of its terms.
fn reciprocal(x: f32) -> f32 {
    let near = 1.0 / x;
    let size = abs(near);
    return select(near, fma(fma(-x, near, 1.0), near, near), size > 1e-30 && size < 1e30);
}

// Returns the square root of x, corrected in the same way.
fn root(x: f32) -> f32 {
    let near = sqrt(x);
    return select(near, fma(fma(-near, near, x), 0.5 / near, near), near > 1e-15 && near < 1e15);
}

fn quotient(x: f32, y: f32) -> f32 {
    let near = x / y;
    let size = abs(near);
    return select(near, fma(fma(-y, near, x), 1.0 / y, near), size > 1e-30 && size < 1e30 && abs(x) > 1e-20);
}

fn add(triangle: u32, word: u32, bits: u32) {
    if triangle == SKY {
        return;
    }
    let at = word_at(triangle, word);
    if (bits & ~seen[at]) != 0u && (bits & ~atomicLoad(&now[at])) != 0u {
        atomicOr(&now[at], bits);
    }
}

// The traversal of the cells of a grid that a segment crosses (Amanatides and Woo 1987).
struct Walk {
    cell: vec3<i32>,
    step: vec3<i32>,
    next: vec3<f32>,
    delta: vec3<f32>,
    // Minimum length of the segment in a crossed cell, in lengths of the direction.
    margin: f32,
    t: f32,
    end: f32,
    // The index of a word and its bits that `advance` has not returned yet; SKY without such a word.
    word: u32,
    bits: u32,
    is_over: bool,
}

// The index of a word, and the bits of its cells that a segment crosses; the index SKY after the last word.
struct Crossed {
    word: u32,
    bits: u32,
}

fn walk(grid: u32, origin: vec3<f32>, direction: vec3<f32>, least: f32, most: f32) -> Walk {
    var w: Walk;
    w.word = SKY;
    w.is_over = true;
    let start = (origin - block.grids[grid].low) * block.grids[grid].per_unit;
    let d = direction * block.grids[grid].per_unit;
    let sides = vec3<f32>(block.grids[grid].cells);
    var inverse: vec3<f32>;
    var t0 = least;
    var t1 = most;
    for (var axis = 0u; axis < 3u; axis++) {
        if d[axis] == 0.0 {
            if !(start[axis] >= 0.0 && start[axis] <= sides[axis]) {
                return w;
            }
            inverse[axis] = 0.0;
        } else {
            inverse[axis] = reciprocal(d[axis]);
            let u = -start[axis] * inverse[axis];
            let v = (sides[axis] - start[axis]) * inverse[axis];
            t0 = max(t0, min(u, v));
            t1 = min(t1, max(u, v));
        }
    }
    if !(t0 < t1) {
        return w;
    }
    let squares = rounded(d * d);
    w.margin = quotient(block.grids[grid].margin, root(squares.x + squares.y + squares.z));
    let along = rounded(d * t0);
    w.cell = clamp(vec3<i32>(start + along), vec3<i32>(0), vec3<i32>(block.grids[grid].cells) - vec3<i32>(1));
    let up = d > vec3<f32>(0.0);
    let still = d == vec3<f32>(0.0);
    w.step = select(select(vec3<i32>(-1), vec3<i32>(1), up), vec3<i32>(0), still);
    w.delta = abs(inverse);
    let planes = vec3<f32>(w.cell + select(vec3<i32>(0), vec3<i32>(1), up));
    w.next = select((planes - start) * inverse, vec3<f32>(FAR), still);
    w.t = t0;
    w.end = t1;
    w.is_over = false;
    return w;
}

// Continues the traversal, and returns the next word.
fn advance(grid: u32, kept: ptr<function, Walk>) -> Crossed {
    var w = *kept;
    var out = Crossed(SKY, 0u);
    while !w.is_over && out.word == SKY {
        let first = select(w.next.y, w.next.x, w.next.x < w.next.y);
        let is_z = first >= w.next.z;
        let is_x = !is_z && w.next.x < w.next.y;
        let is_y = !is_z && !is_x;
        let through = select(first, w.next.z, is_z);
        let end = select(through, w.end, w.end < through);
        if end - w.t > w.margin {
            let slot = slot_of(grid, vec3<u32>(w.cell));
            if slot >> 5u != w.word {
                if w.bits != 0u {
                    out = Crossed(w.word, w.bits);
                }
                w.word = slot >> 5u;
                w.bits = 0u;
            }
            w.bits |= 1u << (slot & 31u);
        }
        if through >= w.end {
            w.is_over = true;
        } else {
            w.t = max(w.t, end);
            let is = vec3<bool>(is_x, is_y, is_z);
            w.next += select(vec3<f32>(0.0), w.delta, is);
            w.cell += select(vec3<i32>(0), w.step, is);
            w.is_over = any(w.cell < vec3<i32>(0)) || any(w.cell >= vec3<i32>(block.grids[grid].cells));
        }
    }
    if out.word == SKY && w.bits != 0u {
        out = Crossed(w.word, w.bits);
        w.bits = 0u;
    }
    *kept = w;
    return out;
}

// Credits the cells that the line crosses between the distances `least` and `most` with the triangles `a` and
// `b`; SKY for no triangle.
fn credit(origin: vec3<f32>, direction: vec3<f32>, least: f32, most: f32, a: u32, b: u32) {
    var w = walk(OWN, origin, direction, least, most);
    loop {
        let crossed = advance(OWN, &w);
        if crossed.word == SKY {
            break;
        }
        let bits = crossed.bits & reached[crossed.word];
        add(a, crossed.word, bits);
        add(b, crossed.word, bits);
    }
}

// Returns the hit, or SKY at the distance `far` if the hit is beyond the end of the line.
fn ended(hit: Hit, far: f32) -> Hit {
    if HALVES && (hit.id == SKY || hit.distance > far) {
        return Hit(far, SKY);
    }
    return hit;
}

// Traces the rays of all lines: first all halves ahead, then all halves behind, so that neighbouring threads
// trace neighbouring rays.
@compute @workgroup_size(128)
fn trace_rays(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(atomicLoad(&counters[LINES]), 3u * block.capacity);
    let rays = select(count, 2u * count, part.way == BOTH_WAYS);
    for (var ray = id.x; ray < rays; ray += groups.x * 128u) {
        let is_behind = ray >= count;
        let i = select(ray, ray - count, is_behind);
        let origin = bitcast<vec3<f32>>(line_from[i].xyz);
        let direction = bitcast<vec3<f32>>(line_to[i].xyz);
        var far = FAR;
        if HALVES && block.far < FAR {
            far = block.far / length(direction);
        }
        if !is_behind {
            let ahead = ended(nearest_along(origin, direction), far);
            ends[2u * i] = ahead.id;
            reaches[2u * i] = ahead.distance;
            if part.way != BOTH_WAYS {
                ends[2u * i + 1u] = SKY;
                reaches[2u * i + 1u] = 0.0;
            }
            continue;
        }
        let size = abs(direction);
        let longest = max(max(size.x, size.y), size.z);
        let largest = max(max(abs(origin.x), abs(origin.y)), abs(origin.z));
        var ahead_by = 0.0;
        if longest > 0.0 {
            ahead_by = max(block.step, largest * OVERLAP) / longest;
        }
        let behind = ended(nearest_along(origin + rounded(direction * ahead_by), -direction), far);
        ends[2u * i + 1u] = behind.id;
        reaches[2u * i + 1u] = ahead_by - behind.distance;
    }
}

// Credits the cells that the traced lines cross.
@compute @workgroup_size(64)
fn credit_lines(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(atomicLoad(&counters[LINES]), 3u * block.capacity);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let ahead = ends[2u * i];
        let behind = ends[2u * i + 1u];
        if ahead == SKY && behind == SKY {
            continue;
        }
        let origin = bitcast<vec3<f32>>(line_from[i].xyz);
        let direction = bitcast<vec3<f32>>(line_to[i].xyz);
        let least = reaches[2u * i + 1u];
        let most = reaches[2u * i];
        if part.way == AHEAD && is_seen(ahead, cell_of(line_from[i].w).slot) {
            continue;
        }
        if !HALVES || part.way == AHEAD {
            credit(origin, direction, least, most, ahead, behind);
            continue;
        }
        // Each triangle is visible up to the distance `far` on both sides of the triangle.
        var far = FAR;
        if block.far < FAR {
            far = block.far / length(direction);
        }
        let from_here = select(least, max(least, 0.0), ONE_WAY);
        let to_here = select(most, min(most, 0.0), ONE_WAY);
        let is_bounded = far < FAR;
        if ahead != SKY {
            let first = select(from_here, max(from_here, most - far), is_bounded);
            credit(origin, direction, first, most, ahead, SKY);
        }
        if behind != SKY {
            let last = select(to_here, min(to_here, least + far), is_bounded);
            credit(origin, direction, least, last, behind, SKY);
        }
    }
}
