// Candidates of cells and the lines aimed at them, as lines/candidates.rs on the host, but each line has an
// eye of its own, and all triangles at the border of an item are candidates, not only the largest. Follows
// cast.wgsl.
//
// Items: the cell; the least part of the sphere that a candidate must cover, as a float; uniform rays of the
// cell, as a float. Counts of an item: rays, finds, rays of the flood, finds of the flood.

const STRIPE: u32 = 4096u;
// Greatest distance of an origin from the face it is close to, as a part of the cell's size.
const DEPTH: f32 = 0.1;
// Least cosine in a triangle's solid angle.
const LEAST_FACING: f32 = 0.25;
// Gains and attempts are counted in these parts of one.
const GAIN_UNITS: f32 = 262144.0;
const ATTEMPT_UNITS: f32 = 256.0;
// More attempts than these are not told apart. A workgroup has at most 3072 lines, so its sums stay below
// 3072 · 4096 · 256 and 3072 · 4 · 2^18, which 32 bits hold.
const MOST_ATTEMPTS: f32 = 4096.0;

@compute @workgroup_size(64)
fn place_items(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var item = id.x; item < part.items; item += groups.x * 64u) {
        atomicStore(&places[cell_of(item).slot], item + 1u);
    }
}

// 64 bits, low half first.
fn shifted_up(v: vec2<u32>, by: u32) -> vec2<u32> {
    if by >= 64u {
        return vec2<u32>(0u);
    }
    if by >= 32u {
        return vec2<u32>(0u, v.x << (by - 32u));
    }
    if by == 0u {
        return v;
    }
    return vec2<u32>(v.x << by, (v.y << by) | (v.x >> (32u - by)));
}

fn shifted_down(v: vec2<u32>, by: u32) -> vec2<u32> {
    if by >= 64u {
        return vec2<u32>(0u);
    }
    if by >= 32u {
        return vec2<u32>(v.y >> (by - 32u), 0u);
    }
    if by == 0u {
        return v;
    }
    return vec2<u32>((v.x >> by) | (v.y << (32u - by)), v.y >> by);
}

// A word of a row: that of a triangle, or that of a slot in the table of pairs when the grid is the
// division's.
fn word_of(grid: u32, row: u32, word: u32) -> vec2<u32> {
    if grid == DIVISION {
        let at = row * block.grids[DIVISION].words + 2u * word;
        return vec2<u32>(pairs[at], pairs[at + 1u]);
    }
    let at = word_at(row, 2u * word);
    return vec2<u32>(seen[at], seen[at + 1u]);
}

// The cells of a word in the row, and their face neighbours, as CellGrid::dilated.
fn dilated(grid: u32, row: u32, word: u32) -> vec2<u32> {
    let bricks = block.grids[grid].bricks;
    let places_of =
        vec3<u32>(word % bricks.x, word / bricks.x % bricks.y, word / (bricks.x * bricks.y));
    let strides = vec3<u32>(1u, bricks.x, bricks.x * bricks.y);
    let m = word_of(grid, row, word);
    var near = m;
    var apart = 0u;
    for (var axis = 0u; axis < 3u; axis++) {
        let first = block.grids[grid].first[axis].xy;
        let near_by = 1u << apart;
        let across = near_by * ((1u << block.grids[grid].side[axis]) - 1u);
        near |= shifted_up(m, near_by) & ~first;
        near |= shifted_down(m & ~first, near_by);
        if places_of[axis] > 0u {
            near |= shifted_down(word_of(grid, row, word - strides[axis]), across) & first;
        }
        if places_of[axis] + 1u < bricks[axis] {
            near |= shifted_up(word_of(grid, row, word + strides[axis]) & first, across);
        }
        apart += block.grids[grid].side[axis];
    }
    return near;
}

// The cells of a word that do not see the triangle, but one beside it, and have a neighbour that sees it.
fn cells_beside(triangle: u32, word: u32) -> vec2<u32> {
    var near = vec2<u32>(0u);
    for (var edge = 0u; edge < 3u; edge++) {
        let next = around[3u * triangle + edge];
        if next != SKY {
            near |= word_of(OWN, next, word);
        }
    }
    near &= ~word_of(OWN, triangle, word);
    if all(near == vec2<u32>(0u)) {
        return near;
    }
    return near & dilated(OWN, triangle, word);
}

// The part of the sphere that the triangle would cover as seen from the cell's centre.
fn part_of_sphere(cell: Cell, triangle: u32) -> f32 {
    let a = corner_of(triangle, 0u);
    let b = corner_of(triangle, 1u);
    let c = corner_of(triangle, 2u);
    let area = cross(b - a, c - a) * 0.5;
    let to = cell.low + cell.size * 0.5 - (a + b + c) / 3.0;
    // Within the cell's own extent the distance from its centre means nothing.
    let far = max(dot(to, to), dot(cell.size, cell.size) / 12.0);
    let facing = max(abs(dot(to, area)) / sqrt(far), LEAST_FACING * length(area));
    return facing / far * 0.07957747;
}

fn decade_of(share: f32) -> u32 {
    var least = 0.1;
    var decade = 0u;
    while share < least && decade + 1u < DECADES {
        least *= 0.1;
        decade += 1u;
    }
    return decade;
}

// Calls for each candidate of a triangle and a word: counts them, or lists them.
fn each_candidate(ordinal: u32, word: u32, list: bool) -> u32 {
    let triangle = around[3u * block.triangles + ordinal];
    var rest = cells_beside(triangle, word);
    var found = 0u;
    while any(rest != vec2<u32>(0u)) {
        var bit = firstTrailingBit(rest.x);
        if rest.x != 0u {
            rest.x &= rest.x - 1u;
        } else {
            bit = 32u + firstTrailingBit(rest.y);
            rest.y &= rest.y - 1u;
        }
        let item = atomicLoad(&places[64u * word + bit]);
        if item == 0u {
            continue;
        }
        let cell = cell_of(item - 1u);
        let share = part_of_sphere(cell, triangle);
        if share < bitcast<f32>(items[item - 1u].y) {
            continue;
        }
        found += 1u;
        if list {
            let decade = decade_of(share);
            let times = part.times[decade / 4u][decade % 4u];
            let draw = unit(drawn(cell, AIM ^ (part.round << 4u), triangle, 0xffffffffu).x);
            let tries = max(u32(times) + select(0u, 1u, draw < fract(times)), 1u);
            let at = atomicAdd(&counters[CANDIDATES], 1u);
            if at < 3u * block.capacity {
                candidates[at] = vec4<u32>(item - 1u, triangle, tries, bitcast<u32>(share));
            }
        }
    }
    return found;
}

// For each stripe of triangles the number of its candidates.
@compute @workgroup_size(64)
fn count_candidates(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let each = block.grids[OWN].words / 2u;
    for (var i = id.x; i < block.ordered * each; i += groups.x * 64u) {
        let found = each_candidate(i / each, i % each, false);
        if found > 0u {
            atomicAdd(&places[32u * block.grids[OWN].words + i / each / STRIPE], found);
        }
    }
}

// The candidates of the triangles from `first` on.
@compute @workgroup_size(64)
fn list_candidates(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let each = block.grids[OWN].words / 2u;
    for (var i = id.x; i < part.count * each; i += groups.x * 64u) {
        each_candidate(part.first + i / each, i % each, true);
    }
}

// Whether the cell beyond a face of `cell` sees the triangle. Face: along axis face / 2, upwards where even.
fn sees_beyond(cell: Cell, face: u32, triangle: u32) -> bool {
    var at = vec3<i32>(cell.at);
    at[face / 2u] += select(-1, 1, face % 2u == 0u);
    if any(at < vec3<i32>(0)) || any(at >= vec3<i32>(block.grids[OWN].cells)) {
        return false;
    }
    return is_seen(triangle, slot_of(OWN, vec3<u32>(at)));
}

// A point close to one of the faces through which neighbours see the triangle: a point of that face belongs
// to both cells.
fn eye_near_a_face(cell: Cell, triangle: u32, random: vec4<u32>) -> vec3<f32> {
    var at = vec3<f32>(unit(random.x), unit(random.y), unit(random.z));
    if !is_whole(cell) {
        // Its viewpoints need not reach the faces.
        return point_in(cell, at);
    }
    var faces = 0u;
    for (var face = 0u; face < 6u; face++) {
        faces |= select(0u, 1u << face, sees_beyond(cell, face, triangle));
    }
    let wanted = min(u32(unit(random.w) * f32(countOneBits(faces))), max(countOneBits(faces), 1u) - 1u);
    for (var i = 0u; i < wanted; i++) {
        faces &= faces - 1u;
    }
    if faces != 0u {
        let face = firstTrailingBit(faces);
        let depth = at[face / 2u] * DEPTH;
        at[face / 2u] = select(depth, 1.0 - depth, face % 2u == 0u);
    }
    return cell.low + cell.size * at;
}

// The eye from which a candidate is tried in this round, by the number of the try.
fn eye_at_try(cell: Cell, triangle: u32) -> vec3<f32> {
    return eye_near_a_face(cell, triangle, drawn(cell, AIM ^ (part.round << 4u), triangle, 2u * part.time));
}

@compute @workgroup_size(64)
fn make_aimed(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(atomicLoad(&counters[CANDIDATES]), 3u * block.capacity);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let candidate = candidates[i];
        let cell = cell_of(candidate.x);
        if part.time > 0u && (candidate.z <= part.time || is_met(candidate.y, cell.slot)) {
            continue;
        }
        let random = drawn(cell, AIM ^ (part.round << 4u), candidate.y, 2u * part.time + 1u);
        let eye = eye_at_try(cell, candidate.y);
        let to = point_on(candidate.y, random.xy);
        let at = atomicAdd(&counters[LINES], 1u);
        put_line(at, candidate.x, eye, to - eye, candidate.y, vec2<u32>(candidate.w, 0u));
    }
}

// The number of a half of a line at a candidate, among those of its cell in a try. The flood triples it with
// each step; in scenes of more than 26 million triangles it wraps, and where two lines then have the same
// number and target, both are cast.
fn number_of_half(line: u32, half: u32) -> u32 {
    return 2u * line_to[line].w + half;
}

// Lets every ray that shows its cell a new triangle claim it.
@compute @workgroup_size(64)
fn claim_aimed(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = 2u * atomicLoad(&counters[LINES]);
    for (var ray = id.x; ray < count; ray += groups.x * 64u) {
        let triangle = ends[ray];
        if triangle == SKY {
            continue;
        }
        let slot = cell_of(line_from[ray / 2u].w).slot;
        if is_seen(triangle, slot) || is_met(triangle, slot) {
            continue;
        }
        atomicAdd(&counters[NEW_ENDS], 1u);
        atomicMax(&claims[claim_of(slot, triangle)], ~number_of_half(ray / 2u, ray % 2u));
    }
}

// Sums of a workgroup, by decade: tries, gain, attempts before.
var<workgroup> sums: array<atomic<u32>, 24>;

// A part of the sphere in the middle of a decade.
fn middle_of(decade: u32) -> f32 {
    var middle = 0.3;
    for (var i = 0u; i < decade; i++) {
        middle *= 0.1;
    }
    return middle;
}

@compute @workgroup_size(64)
fn gather_aimed(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if local < 3u * DECADES {
        atomicStore(&sums[local], 0u);
    }
    workgroupBarrier();
    let count = atomicLoad(&counters[LINES]);
    let new_ends = atomicLoad(&counters[NEW_ENDS]);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let item = line_from[i].w;
        let slot = cell_of(item).slot;
        let target_id = line_to[i].w;
        let share = bitcast<f32>(line_about[i].x);
        let decade = decade_of(share);
        let so_far = part.so_far[decade / 4u][decade % 4u];
        let before = so_far + f32(part.time) + bitcast<f32>(items[item].z) * share;
        atomicAdd(&sums[3u * decade], 1u);
        atomicAdd(&sums[3u * decade + 2u], u32(min(before, MOST_ATTEMPTS) * ATTEMPT_UNITS));
        if ends[2u * i] == target_id {
            let gain = min(share / middle_of(decade), 4.0) / (before + 1.0);
            atomicAdd(&sums[3u * decade + 1u], u32(gain * GAIN_UNITS));
        }
        atomicAdd(&stats[4u * item], 2u);
        for (var half = 0u; half < 2u; half++) {
            let triangle = ends[2u * i + half];
            if triangle == SKY || is_seen(triangle, slot) {
                continue;
            }
            if mark(triangle, slot) {
                atomicAdd(&stats[4u * item + 1u], 1u);
            }
            let number = number_of_half(i, half);
            let is_first = atomicLoad(&claims[claim_of(slot, triangle)]) == ~number;
            if is_first && is_kept(slot, triangle, new_ends) {
                let at = atomicAdd(&counters[FINDS], 1u);
                if at < block.capacity {
                    finds[at] = vec4<u32>(item, triangle, target_id, number);
                }
            }
        }
    }
    workgroupBarrier();
    if local < DECADES {
        let at = TALLY + TALLIED * local;
        atomicAdd(&counters[at], atomicLoad(&sums[3u * local]));
        for (var k = 0u; k < 2u; k++) {
            let more = atomicLoad(&sums[3u * local + 1u + k]);
            let old = atomicAdd(&counters[at + 1u + 2u * k], more);
            if old + more < old {
                atomicAdd(&counters[at + 2u + 2u * k], 1u);
            }
        }
    }
}

// The flood from what lines at candidates find, each from the eye of its line.
@compute @workgroup_size(64)
fn make_aimed_flood(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
) {
    let count = 3u * min(atomicLoad(&counters[FINDS]), block.capacity);
    for (var j = id.x; j < count; j += groups.x * 64u) {
        let next = flooded(j);
        if next == SKY {
            continue;
        }
        let find = finds[j / 3u];
        let number = 3u * find.w + j % 3u;
        let cell = cell_of(find.x);
        let eye = eye_at_try(cell, find.z);
        // The lines of the next try have the same numbers.
        let names = vec2<u32>(AIM_FLOOD ^ (part.round << 4u), number ^ (part.time * 0x85ebca6bu));
        let to = point_on(next, drawn(cell, names.x, next, names.y).xy);
        let at = atomicAdd(&counters[LINES], 1u);
        put_line(at, find.x, eye, to - eye, next, vec2<u32>(find.z, number));
    }
}
