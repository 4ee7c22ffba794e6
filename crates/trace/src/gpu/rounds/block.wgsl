// Declarations that all kernels of a block's rounds share: the block, its tables, lists and random numbers.
// The host concatenates this file after traverse.wgsl and before the other files of this folder.
// rounds/mod.rs describes the order of the kernels.
//
// Determinism. Every decision of a kernel reads tables that the kernel does not write, and every write is a
// commutative operation: or, sum, maximum. The order of a list depends on timing, so no decision uses an
// index into a list; each line has its own number instead. Random numbers depend on the purpose and the
// number of a line.

// A grid of cells, and the numbering of the cells' bits.
struct Grid {
    low: vec3<f32>,
    // Minimum length of a segment in a credited cell, in cells.
    margin: f32,
    // Cells per scene unit.
    per_unit: vec3<f32>,
    // Index of the grid's first cell in `cells`.
    first_cell: u32,
    cells: vec3<u32>,
    // Number of 32-bit words of a row.
    words: u32,
    // Binary logarithms of a brick's sides along x, y and z, in cells. The 64 cells of a brick share two
    // words.
    side: vec3<u32>,
    // Index of the grid's first word in `reached`.
    first_word: u32,
    bricks: vec3<u32>,
    unused: u32,
    // For each axis, the bits of a brick's cells whose coordinate along the axis is the lowest: low and high
    // half.
    first: array<vec4<u32>, 3>,
}

struct Block {
    // The grid of the block (OWN), and the grid of the whole division (DIVISION), over which pairs are
    // searched.
    grids: array<Grid, 2>,
    // Length of the block's diagonal, in scene units.
    extent: f32,
    // Minimum distance between the origin of a line and the start of the line's other half, in scene units.
    step: f32,
    // Distance at which lines end, in scene units; FAR for lines without such an end.
    far: f32,
    // The value 0, which the compiler cannot know in advance (see `rounded`).
    zero: u32,
    // Key of the random numbers of seeds.
    seed: vec2<u32>,
    triangles: u32,
    // Triangles in Morton order.
    ordered: u32,
    // Maximum number of entries of `finds`. Lists of lines, candidates and words have three times as many.
    capacity: u32,
    // 1 if rows are clusters or objects; `rows` then contains the row of each triangle. 0 if rows are
    // triangles.
    has_rows: u32,
    unused_a: u32,
    unused_b: u32,
}

// Indices in `Block::grids`.
const OWN: u32 = 0u;
const DIVISION: u32 = 1u;

// A part of a phase: the elements that one sequence of kernels processes.
struct Part {
    // Number of the part's elements: lines, items, triangles or words, depending on the kernel.
    count: u32,
    // Number of tiles, lines, items, triangles or words before this part.
    first: u32,
    // Items of the phase.
    items: u32,
    round: u32,
    // Number of entries of `claims`, a power of two, minus one.
    mask: u32,
    // Number of the attempt at the candidates, starting at 0.
    time: u32,
    // The direction of the rays of a line: BOTH_WAYS, AHEAD or SEGMENT.
    way: u32,
    // Joining interval: one line in this number joins the cells of the division that the line crosses; 0 for
    // no line.
    joins: u32,
    // By decade of a candidate's fraction of the sphere: the attempts per candidate in this round (`times`),
    // and in all earlier rounds (`so_far`).
    times: array<vec4<f32>, 2>,
    so_far: array<vec4<f32>, 2>,
}

struct Cell {
    low: vec3<f32>,
    key_low: u32,
    size: vec3<f32>,
    key_high: u32,
    at: vec3<u32>,
    // Index of the cell's bit in a row.
    slot: u32,
    // Bits of the cell's parts that contain viewpoints, low half and high half; all bits are 1 if every part
    // or no part contains viewpoints.
    parts: vec2<u32>,
    unused: vec2<u32>,
}

@group(1) @binding(0) var<uniform> block: Block;
// The table of the triangles seen from each cell, at the last barrier. A row has `words` consecutive words.
@group(1) @binding(1) var<storage, read> seen: array<u32>;
// The table with all credits since the last barrier.
@group(1) @binding(2) var<storage, read_write> now: array<atomic<u32>>;
// The triangles that a cell's own lines have met in this phase, in the layout of the table.
@group(1) @binding(3) var<storage, read_write> met: array<atomic<u32>>;
@group(1) @binding(4) var<storage, read> cells: array<Cell>;
// Bits of the cells with viewpoints, in the layout of a row, for both grids.
@group(1) @binding(5) var<storage, read> reached: array<u32>;
// Three elements for each triangle: xyz of its vertices. The fourth word of the first element is the number
// of the triangle's side.
@group(1) @binding(6) var<storage, read> vertices: array<vec4<u32>>;
// For each triangle, its neighbours across the three edges, or SKY; then the triangles in Morton order.
@group(1) @binding(7) var<storage, read> around: array<u32>;

// The pairs of cells of the division that see each other, with a row for each slot: at the last barrier
// (`pairs`), and with all pairs joined since (`joined`).
@group(1) @binding(8) var<storage, read> pairs: array<u32>;
@group(1) @binding(9) var<storage, read_write> joined: array<atomic<u32>>;

@group(1) @binding(10) var<storage, read> rows: array<u32>;

@group(2) @binding(0) var<uniform> part: Part;
// The items of the phase: the index of a cell, and three numbers that depend on the kind of lines.
@group(2) @binding(1) var<storage, read> items: array<vec4<u32>>;
// Four counts for each item, which depend on the kind of lines.
@group(2) @binding(2) var<storage, read_write> stats: array<atomic<u32>>;
@group(2) @binding(3) var<storage, read_write> counters: array<atomic<u32>>;
// Claims by hash of cell and triangle (`claim_of`): the complement of the lowest number of a ray that shows
// the triangle to the cell.
@group(2) @binding(4) var<storage, read_write> claims: array<atomic<u32>>;
// Newly found triangles of a cell: item, triangle, source of the origin (the tile of uniform lines, or the
// candidate at which the line was aimed), number of the ray.
@group(2) @binding(5) var<storage, read_write> finds: array<vec4<u32>>;
// Lines: origin and item (`line_from`), direction and target triangle (`line_to`), and two numbers that
// depend on the kind of lines (`line_about`).
@group(2) @binding(6) var<storage, read_write> line_from: array<vec4<u32>>;
@group(2) @binding(7) var<storage, read_write> line_to: array<vec4<u32>>;
@group(2) @binding(8) var<storage, read_write> line_about: array<vec2<u32>>;
// For each line, the triangle at its end ahead and the triangle at its end behind; SKY for an end without a
// triangle.
@group(2) @binding(9) var<storage, read_write> ends: array<u32>;
// Candidates: item, triangle, number of planned attempts, fraction of the sphere as a float.
@group(2) @binding(10) var<storage, read_write> candidates: array<vec4<u32>>;
// For each slot of the block, the number of its item plus one, or 0; then the number of candidates of each
// stripe of triangles.
@group(2) @binding(11) var<storage, read_write> places: array<atomic<u32>>;
// Words with new bits: index of the 64-bit word in the table, its low half, its high half.
@group(2) @binding(12) var<storage, read_write> words: array<u32>;
// Words with new bits in the table of pairs, in the same layout.
@group(2) @binding(13) var<storage, read_write> pair_words: array<u32>;
// For each line, the distances at which its free part ends ahead and begins behind, in lengths of the
// direction. Two threads write the two numbers, so the array contains no vectors, which a thread writes as a
// whole.
@group(2) @binding(14) var<storage, read_write> reaches: array<f32>;

// Trace both halves of each line.
const BOTH_WAYS: u32 = 0u;
// Trace only the half ahead, and credit the cells that the line crosses.
const AHEAD: u32 = 1u;
// Trace only the half ahead, without credits.
const SEGMENT: u32 = 2u;

// Indices in `counters`.
const FINDS: u32 = 0u;
const LINES: u32 = 1u;
const WORDS: u32 = 2u;
const CANDIDATES: u32 = 3u;
const SEED_RAYS: u32 = 4u;
const PAIR_WORDS: u32 = 5u;
// Number of ends of aimed lines that show a new triangle to the line's cell.
const NEW_ENDS: u32 = 6u;
// From this index on, five words for each decade: number of attempts, gain (low and high half), and earlier
// attempts (low and high half).
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
// Number of parts of a cell along each axis.
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

// Returns a number in [0, 1) from the highest 24 bits.
fn unit(bits: u32) -> f32 {
    return f32(bits >> 8u) * 5.9604644775390625e-8;
}

// Returns four random words of the stream `stream` of a cell.
fn drawn(cell: Cell, stream: u32, a: u32, b: u32) -> vec4<u32> {
    return hashed(vec4<u32>(cell.key_low ^ (stream * 0x9e3779b9u), cell.key_high, a, b));
}

fn cell_of(item: u32) -> Cell {
    return cells[items[item].x];
}

// Returns the index of a word of the triangle's row in the tables of triangles.
fn word_at(triangle: u32, word: u32) -> u32 {
    var row = triangle;
    if block.has_rows != 0u {
        row = rows[triangle];
    }
    return row * block.grids[OWN].words + word;
}

// Returns true if the row of the triangle was credited to the cell with this slot before the last barrier.
fn is_seen(triangle: u32, slot: u32) -> bool {
    return ((seen[word_at(triangle, slot >> 5u)] >> (slot & 31u)) & 1u) == 1u;
}

fn is_met(triangle: u32, slot: u32) -> bool {
    return ((atomicLoad(&met[word_at(triangle, slot >> 5u)]) >> (slot & 31u)) & 1u) == 1u;
}

// Marks the row of the triangle as met by the cell. Returns true if the row was not marked before.
fn mark(triangle: u32, slot: u32) -> bool {
    let bit = 1u << (slot & 31u);
    return (atomicOr(&met[word_at(triangle, slot >> 5u)], bit) & bit) == 0u;
}

// Returns the index in `claims` at which rays claim to be the first to show a triangle to a cell. If two
// pairs of a cell and a triangle have the same index, only one of them is flooded from; both are credited.
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

// Returns the item that contains element `number` (a tile or a line). The field `w` of an item is the number
// of elements of all items before it.
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

// Returns true if all parts of the cell contain viewpoints.
fn is_whole(cell: Cell) -> bool {
    return all(cell.parts == vec2<u32>(0xffffffffu));
}

// Returns a viewpoint at fractions of the cell's size, like Cell::point on the host. If only some parts of
// the cell contain viewpoints, the first fraction also selects one of these parts.
fn point_in(cell: Cell, fractions: vec3<f32>) -> vec3<f32> {
    var f = fractions;
    if !is_whole(cell) {
        let low = countOneBits(cell.parts.x);
        let count = low + countOneBits(cell.parts.y);
        let place = f.x * f32(count);
        // Rounding may result in the number of parts itself.
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

// Returns the origin of a tile of uniform lines: the point of the cell's sequence (Roberts 2018) whose number
// is `items[item].z` plus the tile's number within the item.
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

// Returns a random point of a triangle, uniform over the triangle's area up to rounding.
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
