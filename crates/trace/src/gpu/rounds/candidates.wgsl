// Candidates of cells, and the lines aimed at candidates. The kernels work like lines/candidates.rs on the
// host, with two differences: each line has a separate origin, and all triangles at the border of an item are
// candidates, not only the largest ones. Needs cast.wgsl.
//
// Fields of an item: index of the cell; minimum fraction of the sphere that a candidate covers, as a float;
// number of uniform rays of the cell, as a float. Counts of an item: rays, newly found triangles, rays of the
// flood, newly found triangles of the flood.

const STRIPE: u32 = 4096u;
// Maximum distance of an origin from its face, as a fraction of the cell's size.
const DEPTH: f32 = 0.1;
// Minimum cosine in a triangle's solid angle.
const LEAST_FACING: f32 = 0.25;
// Units of the counters: a counter of gains counts 1/GAIN_UNITS, and a counter of attempts 1/ATTEMPT_UNITS.
const GAIN_UNITS: f32 = 262144.0;
const ATTEMPT_UNITS: f32 = 256.0;
// Maximum counted number of earlier attempts. A workgroup has at most 3072 lines, so its sums stay below 3072
// · 4096 · 256 and 3072 · 4 · 2^18, which fit 32 bits.
const MOST_ATTEMPTS: f32 = 4096.0;

@compute @workgroup_size(64)
fn place_items(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var item = id.x; item < part.items; item += groups.x * 64u) {
        atomicStore(&places[cell_of(item).slot], item + 1u);
    }
}

// Shifts a word of 64 bits, low half first, to higher bits.
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

// Returns a word of 64 bits of a row. In the grid OWN, `row` is a triangle; in the grid DIVISION, `row` is a
// slot of the table of pairs.
fn word_of(grid: u32, row: u32, word: u32) -> vec2<u32> {
    if grid == DIVISION {
        let at = row * block.grids[DIVISION].words + 2u * word;
        return vec2<u32>(pairs[at], pairs[at + 1u]);
    }
    let at = word_at(row, 2u * word);
    return vec2<u32>(seen[at], seen[at + 1u]);
}

// Returns the cells of a word in the row together with their face neighbours, like CellGrid::dilated on the
// host.
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

// Returns the cells of a word that do not see the triangle, see a neighbour of the triangle, and have a
// neighbouring cell that sees the triangle.
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

// Returns the fraction of the sphere around the cell's centre that the triangle would cover.
fn part_of_sphere(cell: Cell, triangle: u32) -> f32 {
    let a = corner_of(triangle, 0u);
    let b = corner_of(triangle, 1u);
    let c = corner_of(triangle, 2u);
    let area = cross(b - a, c - a) * 0.5;
    let to = cell.low + cell.size * 0.5 - (a + b + c) / 3.0;
    // Within the cell's own extent, the distance from the cell's centre has no meaning.
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

// Counts the candidates of a triangle for the cells of a word. If `list` is true, also appends them to
// `candidates`. `ordinal` is the index of the triangle in Morton order.
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

// Counts the candidates of each stripe of triangles.
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

// Lists the candidates of `part.count` triangles in Morton order, from index `part.first` on.
@compute @workgroup_size(64)
fn list_candidates(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let each = block.grids[OWN].words / 2u;
    for (var i = id.x; i < part.count * each; i += groups.x * 64u) {
        each_candidate(part.first + i / each, i % each, true);
    }
}

// Returns true if the cell beyond a face of `cell` sees the triangle. The face is along axis `face / 2`, in
// positive direction if `face` is even.
fn sees_beyond(cell: Cell, face: u32, triangle: u32) -> bool {
    var at = vec3<i32>(cell.at);
    at[face / 2u] += select(-1, 1, face % 2u == 0u);
    if any(at < vec3<i32>(0)) || any(at >= vec3<i32>(block.grids[OWN].cells)) {
        return false;
    }
    return is_seen(triangle, slot_of(OWN, vec3<u32>(at)));
}

// Returns a point close to a random face of those through which neighbouring cells see the triangle. A point
// of such a face belongs to both cells.
fn eye_near_a_face(cell: Cell, triangle: u32, random: vec4<u32>) -> vec3<f32> {
    var at = vec3<f32>(unit(random.x), unit(random.y), unit(random.z));
    if !is_whole(cell) {
        // The viewpoints of such a cell need not reach its faces.
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

// Returns the origin of attempt `part.time` at a candidate in this round.
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

// Returns the number of a half of an aimed line, unique within the cell and the attempt. Each step of the
// flood triples the number. In scenes of more than 26 million triangles, the number wraps; if two lines then
// have the same number and target, both are cast.
fn number_of_half(line: u32, half: u32) -> u32 {
    return 2u * line_to[line].w + half;
}

// Lets every ray that shows a new triangle to its cell claim the triangle.
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

// Sums of a workgroup, three for each decade: number of attempts, gain, number of earlier attempts.
var<workgroup> sums: array<atomic<u32>, 24>;

// Returns a fraction of the sphere in the middle of a decade.
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

// Creates the lines of the flood from the triangles that aimed lines found, each from the origin of the line
// that found the triangle.
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
        // The lines of the next attempt have the same numbers, so the number of the attempt selects other
        // random numbers.
        let names = vec2<u32>(AIM_FLOOD ^ (part.round << 4u), number ^ (part.time * 0x85ebca6bu));
        let to = point_on(next, drawn(cell, names.x, next, names.y).xy);
        let at = atomicAdd(&counters[LINES], 1u);
        put_line(at, find.x, eye, to - eye, next, vec2<u32>(find.z, number));
    }
}
