// The pairs of cells of the division that see each other, like lines/pairs.rs and lines/cell_joins.rs on the
// host. Lines that search for triangles join the cells that they cross, and so do segments between random
// points of two cells. Needs candidates.wgsl and others.wgsl.
//
// Fields of an item of segments: number of the cell in the division; maximum number of segments from the
// cell; 1 to aim at any later cell, 0 to aim at open pairs. Counts of an item: segments, segments that reach
// their end, later cells at which the item can aim.

// Maximum number of words whose cells a line joins with each other. Other lines join the cells of further
// words.
const MOST_WORDS: u32 = 48u;
// Minimum number of segments per round from all cells together, as on the host.
const LEAST_SEGMENTS: u32 = 65536u;
// The first round in which segments aim only at cells of which a neighbour is joined.
const WHOLE_ROUNDS: u32 = 2u;

var<private> met_words: array<Crossed, MOST_WORDS>;

// Stores the cells of the division that a segment crosses in `met_words`. Returns the number of words.
fn crossed_words(origin: vec3<f32>, direction: vec3<f32>, least: f32, most: f32) -> u32 {
    var w = walk(DIVISION, origin, direction, least, most);
    var count = 0u;
    while count < MOST_WORDS {
        let crossed = advance(DIVISION, &w);
        if crossed.word == SKY {
            break;
        }
        met_words[count] = crossed;
        count += 1u;
    }
    return count;
}

// Joins all cells of the first `count` entries of `met_words` with each other.
fn join_words(count: u32) {
    for (var i = 0u; i < count; i++) {
        var rest = met_words[i].bits;
        while rest != 0u {
            let slot = 32u * met_words[i].word + firstTrailingBit(rest);
            rest &= rest - 1u;
            for (var k = 0u; k < count; k++) {
                let at = slot * block.grids[DIVISION].words + met_words[k].word;
                let bits = met_words[k].bits;
                if (bits & ~pairs[at]) != 0u && (bits & ~atomicLoad(&joined[at])) != 0u {
                    atomicOr(&joined[at], bits);
                }
            }
        }
    }
}

// Joins the cells that a part of the lines crosses: one line in `part.joins`.
@compute @workgroup_size(64)
fn join_lines(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = atomicLoad(&counters[LINES]);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        // The hash of the line decides, because its index in the list depends on timing.
        if hashed(line_to[i] ^ line_from[i]).x % part.joins != 0u {
            continue;
        }
        let origin = bitcast<vec3<f32>>(line_from[i].xyz);
        let direction = bitcast<vec3<f32>>(line_to[i].xyz);
        let least = reaches[2u * i + 1u];
        let most = reaches[2u * i];
        if !HALVES {
            join_words(crossed_words(origin, direction, least, most));
            continue;
        }
        var far = FAR;
        if block.far < FAR {
            far = block.far / length(direction);
        }
        join_words(crossed_words(origin, direction, max(least, -far), min(most, 0.0)));
        join_words(crossed_words(origin, direction, max(least, 0.0), min(most, far)));
    }
}

// Joins a cell that the segment crosses with all other cells that the segment crosses, without a maximum
// number of words.
fn join_one(slot: u32, origin: vec3<f32>, direction: vec3<f32>, most: f32) {
    var w = walk(DIVISION, origin, direction, 0.0, most);
    let words_of_row = block.grids[DIVISION].words;
    loop {
        let crossed = advance(DIVISION, &w);
        if crossed.word == SKY {
            break;
        }
        atomicOr(&joined[slot * words_of_row + crossed.word], crossed.bits);
        var rest = crossed.bits;
        while rest != 0u {
            let other = 32u * crossed.word + firstTrailingBit(rest);
            rest &= rest - 1u;
            atomicOr(&joined[other * words_of_row + (slot >> 5u)], 1u << (slot & 31u));
        }
    }
}

// Returns two values: true if the segment crosses the cell with this slot, and true if the segment crosses a
// cell that forms no pair with it.
fn meets(slot: u32, origin: vec3<f32>, direction: vec3<f32>, most: f32) -> vec2<bool> {
    let row = slot * block.grids[DIVISION].words;
    var w = walk(DIVISION, origin, direction, 0.0, most);
    var has = vec2<bool>(false);
    loop {
        let crossed = advance(DIVISION, &w);
        if crossed.word == SKY {
            break;
        }
        let is_own = crossed.word == slot >> 5u && ((crossed.bits >> (slot & 31u)) & 1u) == 1u;
        has |= vec2<bool>(is_own, (crossed.bits & ~pairs[row + crossed.word]) != 0u);
    }
    return has;
}

// Counts held-out lines that cross a cell which forms no pair with the line's own cell, and joins the crossed
// cells.
@compute @workgroup_size(64)
fn check_pairs(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    for (var i = id.x; i < part.count; i += groups.x * 64u) {
        let item = line_from[i].w;
        let origin = bitcast<vec3<f32>>(line_from[i].xyz);
        let direction = bitcast<vec3<f32>>(line_to[i].xyz);
        // The slot, in the division, of the line's cell of the block.
        let slot = items[item].y;
        let end = reaches[2u * i];
        let has = meets(slot, origin, direction, end);
        if has.y {
            atomicAdd(&stats[4u * item + 1u], 1u);
        }
        if has.x && has.y {
            join_one(slot, origin, direction, end);
        }
        join_words(crossed_words(origin, direction, 0.0, end));
    }
}

// Returns the coordinates of the cell with a slot. They are outside the grid if no cell has the slot.
fn cell_at(grid: u32, slot: u32) -> vec3<u32> {
    let side = block.grids[grid].side;
    let bricks = block.grids[grid].bricks;
    let word = slot >> 6u;
    let brick = vec3<u32>(word % bricks.x, word / bricks.x % bricks.y, word / (bricks.x * bricks.y));
    let bit = slot & 63u;
    let within = vec3<u32>(
        bit & ((1u << side.x) - 1u),
        (bit >> side.x) & ((1u << side.y) - 1u),
        bit >> (side.x + side.y),
    );
    return (brick << side) | within;
}

fn number_of(c: vec3<u32>) -> u32 {
    let sides = block.grids[DIVISION].cells;
    return (c.z * sides.y + c.y) * sides.x + c.x;
}

fn is_reached(slot: u32) -> bool {
    return ((reached[block.grids[DIVISION].first_word + (slot >> 5u)] >> (slot & 31u)) & 1u) == 1u;
}

// Returns the later cells of a word (cells with larger numbers) at which the segments of an item can aim.
fn aims(item: u32, word: u32) -> vec2<u32> {
    let own = cells[block.grids[DIVISION].first_cell + items[item].x];
    var bits = vec2<u32>(0xffffffffu);
    if items[item].z == 0u {
        bits = ~word_of(DIVISION, own.slot, word);
        if part.round >= WHOLE_ROUNDS {
            var near = dilated(DIVISION, own.slot, word);
            for (var face = 0u; face < 6u; face++) {
                var at = vec3<i32>(own.at);
                at[face / 2u] += select(-1, 1, face % 2u == 0u);
                if all(at >= vec3<i32>(0)) && all(at < vec3<i32>(block.grids[DIVISION].cells)) {
                    near |= word_of(DIVISION, slot_of(DIVISION, vec3<u32>(at)), word);
                }
            }
            bits &= near;
        }
    }
    let number = number_of(own.at);
    let from_anywhere = is_reached(own.slot);
    var rest = bits;
    while any(rest != vec2<u32>(0u)) {
        let low = rest.x != 0u;
        let bit = select(32u + firstTrailingBit(rest.y), firstTrailingBit(rest.x), low);
        let mask = select(vec2<u32>(0u, 1u << (bit & 31u)), vec2<u32>(1u << (bit & 31u), 0u), low);
        rest &= ~mask;
        let slot = 64u * word + bit;
        let at = cell_at(DIVISION, slot);
        let is_one = all(at < block.grids[DIVISION].cells) && number_of(at) > number;
        if !is_one || !(from_anywhere || is_reached(slot)) {
            bits &= ~mask;
        }
    }
    return bits;
}

@compute @workgroup_size(64)
fn count_aims(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let each = block.grids[DIVISION].words / 2u;
    for (var i = id.x; i < part.count * each; i += groups.x * 64u) {
        let item = part.first + i / each;
        let bits = aims(item, i % each);
        let found = countOneBits(bits.x) + countOneBits(bits.y);
        if found > 0u {
            atomicAdd(&stats[4u * item + 2u], found);
        }
    }
}

fn point_of(cell: Cell, random: vec3<u32>) -> vec3<f32> {
    return point_in(cell, vec3<f32>(unit(random.x), unit(random.y), unit(random.z)));
}

@compute @workgroup_size(64)
fn make_segments(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let each = block.grids[DIVISION].words / 2u;
    let sides = block.grids[DIVISION].cells;
    let all_cells = sides.x * sides.y * sides.z;
    for (var i = id.x; i < part.count * each; i += groups.x * 64u) {
        let item = part.first + i / each;
        let count = atomicLoad(&stats[4u * item + 2u]);
        if count == 0u {
            continue;
        }
        let most = items[item].y;
        let first = block.grids[DIVISION].first_cell;
        let own = cells[first + items[item].x];
        let share = f32(most) / f32(count);
        let wanted = (LEAST_SEGMENTS + all_cells - 1u) / all_cells;
        let times = min((wanted + count - 1u) / count, most);
        var rest = aims(item, i % each);
        while any(rest != vec2<u32>(0u)) {
            var bit = firstTrailingBit(rest.x);
            if rest.x != 0u {
                rest.x &= rest.x - 1u;
            } else {
                bit = 32u + firstTrailingBit(rest.y);
                rest.y &= rest.y - 1u;
            }
            let number = number_of(cell_at(DIVISION, 64u * (i % each) + bit));
            let other = cells[first + number];
            let stream = JOIN ^ (part.round << 4u) ^ (items[item].z << 3u);
            if count > most && unit(drawn(own, stream, number, 0u).x) >= share {
                continue;
            }
            for (var time = 0u; time < times; time++) {
                var a = point_of(own, drawn(own, stream, number, 2u * time + 1u).xyz);
                var b = point_of(other, drawn(own, stream, number, 2u * time + 2u).xyz);
                if part.round % 2u == 1u {
                    let c = a;
                    a = b;
                    b = c;
                }
                if all(a == b) {
                    continue;
                }
                let at = atomicAdd(&counters[LINES], 1u);
                if at < 3u * block.capacity {
                    put_line(at, item, a, b - a, SKY, vec2<u32>(0u));
                }
            }
        }
    }
}

@compute @workgroup_size(64)
fn gather_segments(@builtin(global_invocation_id) id: vec3<u32>, @builtin(num_workgroups) groups: vec3<u32>) {
    let count = min(atomicLoad(&counters[LINES]), 3u * block.capacity);
    for (var i = id.x; i < count; i += groups.x * 64u) {
        let item = line_from[i].w;
        let end = reaches[2u * i];
        atomicAdd(&stats[4u * item], 1u);
        if end >= 1.0 {
            atomicAdd(&stats[4u * item + 1u], 1u);
        }
        let origin = bitcast<vec3<f32>>(line_from[i].xyz);
        let direction = bitcast<vec3<f32>>(line_to[i].xyz);
        // In every second round, a segment begins in the other cell, so the item determines the own cell.
        let slot = cells[block.grids[DIVISION].first_cell + items[item].x].slot;
        if all(meets(slot, origin, direction, end)) {
            join_one(slot, origin, direction, end);
        }
        join_words(crossed_words(origin, direction, 0.0, end));
    }
}
