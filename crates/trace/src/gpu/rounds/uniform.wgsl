// Uniform lines, and the flood from the triangles that they find, like lines/uniform.rs and lines/flood.rs on
// the host. Needs cast.wgsl.
//
// Fields of an item: index of the cell; number of tiles along a cube face; number of the first origin in the
// cell's sequence; number of tiles of all items before. Counts of an item: misses, newly found triangles of
// uniform lines, rays of the flood, newly found triangles of the flood. The number of a ray in its part
// identifies the ray that claims a triangle; each step of the flood triples the numbers.

@compute @workgroup_size(64)
fn make_uniform(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let tile = part.first + i / LANES;
        let lane = i % LANES;
        let item = item_with(tile);
        let cell = cell_of(item);
        let tiles = items[item].y;
        let k = tile - items[item].w;
        let pair = k / (tiles * tiles);
        let r = k % (tiles * tiles);
        let jitter = drawn(cell, JITTER, items[item].z + k, lane);
        let pixel = 2.0 / f32(4u * tiles);
        var direction = vec3<f32>(1.0);
        direction[(pair + 1u) % 3u] = (f32(r % tiles * 4u + lane % 4u) + unit(jitter.x)) * pixel - 1.0;
        direction[(pair + 2u) % 3u] = (f32(r / tiles * 4u + lane / 4u) + unit(jitter.y)) * pixel - 1.0;
        put_line(i, item, eye_of(item, tile), direction, SKY, vec2<u32>(tile, 0u));
    }
    if id.x == 0u {
        atomicStore(&counters[LINES], part.count);
    }
}

// Counts the misses, and lets every ray that shows a new triangle to its cell claim the triangle.
@compute @workgroup_size(64)
fn claim_uniform(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var ray = id.x; ray < 2u * part.count; ray += groups.x * 64u) {
        let triangle = ends[ray];
        if triangle == SKY {
            continue;
        }
        let item = line_from[ray / 2u].w;
        let slot = cell_of(item).slot;
        if is_seen(triangle, slot) {
            ends[ray] = SKY;
            continue;
        }
        atomicAdd(&stats[4u * item], 1u);
        if is_met(triangle, slot) {
            ends[ray] = SKY;
            continue;
        }
        atomicMax(&claims[claim_of(slot, triangle)], ~ray);
    }
}

@compute @workgroup_size(64)
fn gather_uniform(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var ray = id.x; ray < 2u * part.count; ray += groups.x * 64u) {
        let triangle = ends[ray];
        if triangle == SKY {
            continue;
        }
        let item = line_from[ray / 2u].w;
        let slot = cell_of(item).slot;
        if mark(triangle, slot) {
            atomicAdd(&stats[4u * item + 1u], 1u);
        }
        if atomicLoad(&claims[claim_of(slot, triangle)]) == ~ray {
            let at = atomicAdd(&counters[FINDS], 1u);
            finds[at] = vec4<u32>(item, triangle, line_about[ray / 2u].x, ray);
        }
    }
}

// Returns the neighbour of the triangle of `finds[j / 3]` across edge `j % 3` if the cell has neither seen
// nor met the neighbour, and otherwise SKY.
fn beside(j: u32) -> u32 {
    let find = finds[j / 3u];
    let next = around[3u * find.y + j % 3u];
    if next == SKY {
        return SKY;
    }
    let slot = cell_of(find.x).slot;
    return select(next, SKY, is_seen(next, slot) || is_met(next, slot));
}

@compute @workgroup_size(64)
fn claim_next(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = 3u * min(atomicLoad(&counters[FINDS]), block.capacity);
    for (var j = id.x; j < count; j += groups.x * 64u) {
        let next = beside(j);
        if next != SKY {
            let find = finds[j / 3u];
            atomicMax(&claims[claim_of(cell_of(find.x).slot, next)], ~(3u * find.w + j % 3u));
        }
    }
}

// Returns the triangle at which the flood from `finds[j / 3]` aims across edge `j % 3`: the neighbour, unless
// another entry of `finds` has claimed it. Returns SKY otherwise.
fn flooded(j: u32) -> u32 {
    let next = beside(j);
    if next == SKY {
        return SKY;
    }
    let find = finds[j / 3u];
    let claim = atomicLoad(&claims[claim_of(cell_of(find.x).slot, next)]);
    return select(SKY, next, claim == ~(3u * find.w + j % 3u));
}

@compute @workgroup_size(64)
fn make_flood(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = 3u * min(atomicLoad(&counters[FINDS]), block.capacity);
    for (var j = id.x; j < count; j += groups.x * 64u) {
        let next = flooded(j);
        if next == SKY {
            continue;
        }
        let find = finds[j / 3u];
        let number = 3u * find.w + j % 3u;
        let cell = cell_of(find.x);
        let eye = eye_of(find.x, find.z);
        let to = point_on(next, drawn(cell, FLOOD ^ (find.z << 4u), next, number).xy);
        let at = atomicAdd(&counters[LINES], 1u);
        put_line(at, find.x, eye, to - eye, next, vec2<u32>(find.z, number));
    }
}

// Returns true if the flood uses a newly found triangle. If `most`, the maximum number of newly found
// triangles, exceeds the capacity of `finds`, a hash selects the triangles that the flood uses.
fn is_kept(slot: u32, triangle: u32, most: u32) -> bool {
    if most <= block.capacity {
        return true;
    }
    let share = 0.9 * f32(block.capacity) / f32(most);
    return unit(hashed(vec4<u32>(triangle, slot, 0x1b873593u, part.first)).y) < share;
}

@compute @workgroup_size(64)
fn claim_flood(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = atomicLoad(&counters[LINES]);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let item = line_from[i].w;
        let slot = cell_of(item).slot;
        atomicAdd(&stats[4u * item + 2u], 2u);
        let triangle = ends[2u * i];
        if triangle == SKY {
            continue;
        }
        if is_seen(triangle, slot) || is_met(triangle, slot) {
            ends[2u * i] = SKY;
            continue;
        }
        atomicMax(&claims[claim_of(slot, triangle)], ~line_about[i].y);
    }
}

@compute @workgroup_size(64)
fn gather_flood(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = atomicLoad(&counters[LINES]);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let triangle = ends[2u * i];
        if triangle == SKY {
            continue;
        }
        let item = line_from[i].w;
        let slot = cell_of(item).slot;
        if mark(triangle, slot) {
            atomicAdd(&stats[4u * item + 3u], 1u);
        }
        let number = line_about[i].y;
        if atomicLoad(&claims[claim_of(slot, triangle)]) == ~number && is_kept(slot, triangle, count) {
            let at = atomicAdd(&counters[FINDS], 1u);
            if at < block.capacity {
                finds[at] = vec4<u32>(item, triangle, line_about[i].x, number);
            }
        }
    }
}
