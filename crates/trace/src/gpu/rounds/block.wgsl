// What all kernels of a block's rounds share: the block, its tables, lists and random numbers. Follows
// traverse.wgsl; the other files of this folder follow. rounds/mod.rs says how the kernels work together.
//
// Same bits. Within a kernel, what decides is read from tables that the kernel does not write, and what is
// written commutes: or, sum, maximum. The order of a list depends on timing, so no decision reads a place in
// a list; lines have numbers of their own. Random numbers hang on what a line is for and on such numbers.

// A grid of cells and how their bits are numbered.
struct Grid {
    low: vec3<f32>,
    // Least part of a cell that a segment must cross, in cells.
    margin: f32,
    // Cells per scene unit.
    per_unit: vec3<f32>,
    // Place of its first cell in `cells`.
    first_cell: u32,
    cells: vec3<u32>,
    // 32-bit words of a row.
    words: u32,
    // Binary logarithms of a brick's sides.
    side: vec3<u32>,
    // Place of its first word in `reached`.
    first_word: u32,
    bricks: vec3<u32>,
    unused: u32,
    // By axis, the first cells of a brick along the axis: low and high half.
    first: array<vec4<u32>, 3>,
}

struct Block {
    // The block's, and the whole division's, over which pairs are looked for.
    grids: array<Grid, 2>,
    // Length of the block's diagonal.
    extent: f32,
    // Least distance between the origin of a line and the start of its other half.
    step: f32,
    // Lines end at this distance; FAR when they do not.
    far: f32,
    // 0, which no compiler knows.
    zero: u32,
    // Key of the seeds' random numbers.
    seed: vec2<u32>,
    triangles: u32,
    // Triangles in Morton order.
    ordered: u32,
    // Finds that a list holds.
    capacity: u32,
    // Whether rows are other items than triangles; then `rows` holds the row of each triangle.
    has_rows: u32,
    unused_a: u32,
    unused_b: u32,
}

// Numbers of the grids.
const OWN: u32 = 0u;
const DIVISION: u32 = 1u;

// A part of a phase that is worked on at a time.
struct Part {
    // Lines of this part, or other things.
    count: u32,
    // Tiles, lines or places before this part.
    first: u32,
    // Items of the phase.
    items: u32,
    round: u32,
    // Places of `claims`, less one.
    mask: u32,
    // Number of the try.
    time: u32,
    // How lines are cast: BOTH_WAYS and so on.
    way: u32,
    // One line in so many joins the cells of the division that it crosses; 0 for none.
    joins: u32,
    // By decade of a candidate's part of the sphere: tries at it in this round, and in all before.
    times: array<vec4<f32>, 2>,
    so_far: array<vec4<f32>, 2>,
}

struct Cell {
    low: vec3<f32>,
    key_low: u32,
    size: vec3<f32>,
    key_high: u32,
    at: vec3<u32>,
    // Place of its bit in a row.
    slot: u32,
    // Which of its parts hold viewpoints, low half and high half; all bits when all do, or none does.
    parts: vec2<u32>,
    unused: vec2<u32>,
}

@group(1) @binding(0) var<uniform> block: Block;
// The table at the last barrier, by row, then word.
@group(1) @binding(1) var<storage, read> seen: array<u32>;
// The same with all credits since.
@group(1) @binding(2) var<storage, read_write> now: array<atomic<u32>>;
// What lines of the cell itself have met in this phase.
@group(1) @binding(3) var<storage, read_write> met: array<atomic<u32>>;
@group(1) @binding(4) var<storage, read> cells: array<Cell>;
// Words of a row without the cells that have no viewpoint.
@group(1) @binding(5) var<storage, read> reached: array<u32>;
// For each triangle its vertices; the first also holds the number of its side.
@group(1) @binding(6) var<storage, read> vertices: array<vec4<u32>>;
// For each triangle the three beside it; then the triangles in Morton order.
@group(1) @binding(7) var<storage, read> around: array<u32>;

// Which cells of the division see which: a row for each slot. At the last barrier, and with all joined since.
@group(1) @binding(8) var<storage, read> pairs: array<u32>;
@group(1) @binding(9) var<storage, read_write> joined: array<atomic<u32>>;

@group(1) @binding(10) var<storage, read> rows: array<u32>;

@group(2) @binding(0) var<uniform> part: Part;
// The items of the phase: the cell's place, and three numbers that depend on the kind of lines.
@group(2) @binding(1) var<storage, read> items: array<vec4<u32>>;
// Four counts for each item.
@group(2) @binding(2) var<storage, read_write> stats: array<atomic<u32>>;
@group(2) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;
// By hash of cell and triangle: the complement of the least number of a line that claims to be the first.
@group(2) @binding(4) var<storage, read_write> claims: array<atomic<u32>>;
// New triangles of a cell: item, triangle, what the eye is derived from (a tile of uniform lines, or the
// candidate that a line was aimed at), number of the line.
@group(2) @binding(5) var<storage, read_write> finds: array<vec4<u32>>;
// Lines: origin and item; direction and target; two more numbers of each kind of lines.
@group(2) @binding(6) var<storage, read_write> line_from: array<vec4<u32>>;
@group(2) @binding(7) var<storage, read_write> line_to: array<vec4<u32>>;
@group(2) @binding(8) var<storage, read_write> line_about: array<vec2<u32>>;
// For each line the triangles at its end ahead and at its end behind.
@group(2) @binding(9) var<storage, read_write> ends: array<u32>;
// Candidates: item, triangle, tries, part of the sphere.
@group(2) @binding(10) var<storage, read_write> candidates: array<vec4<u32>>;
// The item of each slot, plus one; then the number of candidates of each stripe of triangles.
@group(2) @binding(11) var<storage, read_write> places: array<atomic<u32>>;
// Words with new bits: place of the 64-bit word, its low half, its high half.
@group(2) @binding(12) var<storage, read_write> words: array<u32>;
// The same of the table of pairs.
@group(2) @binding(13) var<storage, read_write> pair_words: array<u32>;
// For each line where its free part ends ahead and where it begins behind, in lengths of the direction. Two
// threads write them, and a vector would be written as a whole.
@group(2) @binding(14) var<storage, read_write> reaches: array<f32>;

// Both halves of each line.
const BOTH_WAYS: u32 = 0u;
// The half ahead, which shows its cell a triangle.
const AHEAD: u32 = 1u;
// The half ahead, which credits nothing.
const SEGMENT: u32 = 2u;

// Places in `counters`.
const FINDS: u32 = 0u;
const LINES: u32 = 1u;
const WORDS: u32 = 2u;
const CANDIDATES: u32 = 3u;
const SEED_RAYS: u32 = 4u;
const PAIR_WORDS: u32 = 5u;
// Ends of lines at candidates that show their cells something new.
const NEW_ENDS: u32 = 6u;
// From here on, for each decade: tries, gain and attempts before, the last two as low and high half.
const TALLY: u32 = 8u;
const TALLIED: u32 = 5u;
const DECADES: u32 = 8u;

// Names of the streams of random numbers.
const SHIFT: u32 = 1u;
const JITTER: u32 = 2u;
const AIM: u32 = 3u;
const SEEDS: u32 = 4u;
const CHECK: u32 = 5u;
const FLOOD: u32 = 6u;
const JOIN: u32 = 7u;
const AIM_FLOOD: u32 = 8u;

const LANES: u32 = 16u;
// Parts of a cell along each axis.
const PARTS: u32 = 4u;

// Jarzynski and Olano 2020, "Hash Functions for GPU Rendering": pcg4d.
fn hashed(names: vec4<u32>) -> vec4<u32> {
    var v = names * 1664525u + 1013904223u;
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    v ^= v >> vec4<u32>(16u);
    v.x += v.y * v.w;
    v.y += v.z * v.x;
    v.z += v.x * v.y;
    v.w += v.y * v.z;
    return v;
}

// In [0, 1), with 24 bits.
fn unit(bits: u32) -> f32 {
    return f32(bits >> 8u) * 5.9604644775390625e-8;
}

// Four random numbers of a cell's stream.
fn drawn(cell: Cell, stream: u32, a: u32, b: u32) -> vec4<u32> {
    return hashed(vec4<u32>(cell.key_low ^ (stream * 0x9e3779b9u), cell.key_high, a, b));
}

fn cell_of(item: u32) -> Cell {
    return cells[items[item].x];
}

// The place of a word of the triangle's row, in the tables of triangles.
fn word_at(triangle: u32, word: u32) -> u32 {
    var row = triangle;
    if block.has_rows != 0u {
        row = rows[triangle];
    }
    return row * block.grids[OWN].words + word;
}

// Whether the cell with this slot had seen the triangle's item at the last barrier.
fn is_seen(triangle: u32, slot: u32) -> bool {
    return ((seen[word_at(triangle, slot >> 5u)] >> (slot & 31u)) & 1u) == 1u;
}

fn is_met(triangle: u32, slot: u32) -> bool {
    return ((atomicLoad(&met[word_at(triangle, slot >> 5u)]) >> (slot & 31u)) & 1u) == 1u;
}

// Marks a triangle's item as met; whether it was not before.
fn mark(triangle: u32, slot: u32) -> bool {
    let bit = 1u << (slot & 31u);
    return (atomicOr(&met[word_at(triangle, slot >> 5u)], bit) & bit) == 0u;
}

// Where lines claim to be the first that shows a triangle to a cell. Two pairs that share a place share a
// claim, and one of them is not flooded from; its credit stays.
fn claim_of(slot: u32, triangle: u32) -> u32 {
    return hashed(vec4<u32>(slot, triangle, 0x2545f491u, 0x68e31da4u)).x & part.mask;
}

fn slot_of(grid: u32, c: vec3<u32>) -> u32 {
    let side = block.grids[grid].side;
    let bricks = block.grids[grid].bricks;
    let within = c & ((vec3<u32>(1u) << side) - vec3<u32>(1u));
    let brick = c >> side;
    let word = (brick.z * bricks.y + brick.y) * bricks.x + brick.x;
    let bit = (((within.z << side.y) | within.y) << side.x) | within.x;
    return word * 64u + bit;
}

// The item whose things include number `number`: items hold the number of things before them in `w`.
fn item_with(number: u32) -> u32 {
    var low = 0u;
    var high = part.items;
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if items[middle].w <= number {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

// Whether viewpoints are everywhere in the cell.
fn is_whole(cell: Cell) -> bool {
    return all(cell.parts == vec2<u32>(0xffffffffu));
}

// A viewpoint at fractions of the cell's size, as Cell::point on the host: where only some parts of the cell
// hold viewpoints, the first fraction chooses one of them as well.
fn point_in(cell: Cell, fractions: vec3<f32>) -> vec3<f32> {
    var f = fractions;
    if !is_whole(cell) {
        let low = countOneBits(cell.parts.x);
        let count = low + countOneBits(cell.parts.y);
        let place = f.x * f32(count);
        // Rounding may give the number of parts itself.
        var skip = min(u32(place), max(count, 1u) - 1u);
        let is_low = skip < low;
        var rest = select(cell.parts.y, cell.parts.x, is_low);
        skip = select(skip - low, skip, is_low);
        for (var i = 0u; i < skip; i++) {
            rest &= rest - 1u;
        }
        let number = firstTrailingBit(rest) + select(32u, 0u, is_low);
        let at = vec3<u32>(number % PARTS, number / PARTS % PARTS, number / PARTS / PARTS);
        f = (vec3<f32>(at) + vec3<f32>(fract(place), f.y, f.z)) / f32(PARTS);
    }
    return cell.low + cell.size * f;
}

// The eye of a tile of uniform lines: point `base + k` of the cell's sequence (Roberts 2018).
fn eye_of(item: u32, tile: u32) -> vec3<f32> {
    let cell = cell_of(item);
    let number = items[item].z + (tile - items[item].w);
    let shift = drawn(cell, SHIFT, 0u, 0u).xyz;
    let place = number * vec3<u32>(3518319155u, 2882110345u, 2360945575u) + shift;
    return point_in(cell, vec3<f32>(unit(place.x), unit(place.y), unit(place.z)));
}

fn corner_of(triangle: u32, corner: u32) -> vec3<f32> {
    return bitcast<vec3<f32>>(vertices[3u * triangle + corner].xyz);
}

// A random point of a triangle, uniform over its area up to rounding.
fn point_on(triangle: u32, random: vec2<u32>) -> vec3<f32> {
    var a = unit(random.x);
    var b = unit(random.y);
    if a + b > 1.0 {
        a = 1.0 - a;
        b = 1.0 - b;
    }
    let v = corner_of(triangle, 0u);
    return v + (corner_of(triangle, 1u) - v) * a + (corner_of(triangle, 2u) - v) * b;
}

fn put_line(at: u32, item: u32, origin: vec3<f32>, direction: vec3<f32>, target_id: u32, about: vec2<u32>) {
    line_from[at] = vec4<u32>(bitcast<vec3<u32>>(origin), item);
    line_to[at] = vec4<u32>(bitcast<vec3<u32>>(direction), target_id);
    line_about[at] = about;
}
