// Seeds and held-out lines, like lines/seeds.rs and lines/bound.rs on the host, and the words of the tables
// that the host reads and writes. Needs cast.wgsl.

const SEED_GROUP: u32 = 32u;
const ONE_IN: u32 = 2u;
const HALVINGS: f32 = 16.0;

// Returns a uniform direction, by rejection from the cube.
fn on_sphere(names: vec2<u32>) -> vec3<f32> {
    for (var draw = 0u; draw < 32u; draw++) {
        let bits = hashed(vec4<u32>(block.seed, names.x + draw, names.y)).xyz;
        let v = vec3<f32>(unit(bits.x), unit(bits.y), unit(bits.z)) * 2.0 - vec3<f32>(1.0);
        let square = dot(v, v);
        if square <= 1.0 && square > 1e-4 {
            return v / sqrt(square);
        }
    }
    return vec3<f32>(0.0, 0.0, 1.0);
}

// Creates one line from every second triangle of the groups from `part.first` on. A group has 32 consecutive
// triangles in Morton order.
@compute @workgroup_size(64)
fn make_seeds(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let group = part.first + i / LANES;
        let direction = on_sphere(vec2<u32>(64u * group, SEEDS));
        let random = hashed(vec4<u32>(block.seed, 64u * group + 40u, SEEDS));
        let halvings = u32(unit(random.x) * HALVINGS);
        let halved = bitcast<f32>((127u - halvings) << 23u);
        let distance = block.extent * 0.25 * halved * (0.5 + 0.5 * unit(random.y));
        let ordinal = group * SEED_GROUP + (random.z & 1u) + ONE_IN * (i % LANES);
        if ordinal >= block.ordered {
            continue;
        }
        let triangle = around[3u * block.triangles + ordinal];
        let a = corner_of(triangle, 0u);
        let normal = cross(corner_of(triangle, 1u) - a, corner_of(triangle, 2u) - a);
        let side = vertices[3u * triangle].w;
        // A triangle with side 1 shows on the side from which its vertices run counter-clockwise, and a
        // triangle with side 2 on the other side.
        let front = select((random.w & 1u) == 1u, side == 1u, side != 0u);
        let up = select(-direction, direction, (dot(normal, direction) > 0.0) == front);
        let own = hashed(vec4<u32>(block.seed, 64u * group + 41u + i % LANES, triangle));
        let origin = point_on(triangle, own.xy) + up * distance;
        atomicAdd(&counters[SEED_RAYS], 2u);
        let at = atomicAdd(&counters[LINES], 1u);
        put_line(at, 0u, origin, -up, triangle, vec2<u32>(0u));
    }
}

// Creates independent held-out lines. Fields of an item: index of the cell; slot of the cell in the division;
// unused; number of lines of all items before. Counts of an item: misses; misses of pairs.
@compute @workgroup_size(64)
fn make_check(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let number = part.first + i;
        let item = item_with(number);
        let cell = cell_of(item);
        let k = number - items[item].w;
        let one = drawn(cell, CHECK ^ (part.round << 4u), k, 0u);
        let two = drawn(cell, CHECK ^ (part.round << 4u), k, 1u);
        let origin = point_in(cell, vec3<f32>(unit(one.x), unit(one.y), unit(one.z)));
        let axis = two.z % 3u;
        var direction = vec3<f32>(1.0);
        direction[axis] = select(1.0, -1.0, (one.w & 1u) == 1u);
        direction[(axis + 1u) % 3u] = 2.0 * unit(two.x) - 1.0;
        direction[(axis + 2u) % 3u] = 2.0 * unit(two.y) - 1.0;
        put_line(i, item, origin, direction, SKY, vec2<u32>(0u));
    }
    if id.x == 0u {
        atomicStore(&counters[LINES], part.count);
    }
}

@compute @workgroup_size(64)
fn gather_check(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let item = line_from[i].w;
        let triangle = ends[2u * i];
        if triangle != SKY && !is_seen(triangle, cell_of(item).slot) {
            atomicAdd(&stats[4u * item], 1u);
        }
    }
}

// Lists the words from index `part.first` on that have new bits since the last barrier. The counter counts
// all words; the list contains at most three times `block.capacity` of them.
@compute @workgroup_size(64)
fn gather_words(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let place = part.first + i;
        let low = atomicLoad(&now[2u * place]) & ~seen[2u * place];
        let high = atomicLoad(&now[2u * place + 1u]) & ~seen[2u * place + 1u];
        if (low | high) != 0u {
            let at = atomicAdd(&counters[WORDS], 1u);
            if at < 3u * block.capacity {
                words[3u * at] = place;
                words[3u * at + 1u] = low;
                words[3u * at + 2u] = high;
            }
        }
    }
}

// Lists the words of the table of pairs with new bits, like `gather_words`.
@compute @workgroup_size(64)
fn gather_pairs(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let place = part.first + i;
        let low = atomicLoad(&joined[2u * place]) & ~pairs[2u * place];
        let high = atomicLoad(&joined[2u * place + 1u]) & ~pairs[2u * place + 1u];
        if (low | high) != 0u {
            let at = atomicAdd(&counters[PAIR_WORDS], 1u);
            if at < 3u * block.capacity {
                pair_words[3u * at] = place;
                pair_words[3u * at + 1u] = low;
                pair_words[3u * at + 2u] = high;
            }
        }
    }
}

// Adds the words that the host has written to `words` to the table.
@compute @workgroup_size(64)
fn put_words(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let place = words[3u * i];
        atomicOr(&now[2u * place], words[3u * i + 1u]);
        atomicOr(&now[2u * place + 1u], words[3u * i + 2u]);
    }
}

@compute @workgroup_size(64)
fn put_pairs(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let place = pair_words[3u * i];
        atomicOr(&joined[2u * place], pair_words[3u * i + 1u]);
        atomicOr(&joined[2u * place + 1u], pair_words[3u * i + 2u]);
    }
}
