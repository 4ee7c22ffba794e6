// Reduces the six item buffers of each cube of a batch to one entry for each visible slot: (slot, strata
// mask, pixel count). The entries of all cubes of a batch are in one list, cube after cube.
//
// All masks and counts are zero before `reduce`. `reduce` adds to the masks and counts, and appends each slot
// to the list at its first pixel. `gather` copies masks and counts to the list and resets them to zero.
// `close` stores the end of the cube's entries. The order of the entries of a cube differs between runs, so
// the host sorts them.

struct Params {
    // Side of a face in pixels.
    n: u32,
    // Maximum number of entries of the list.
    capacity: u32,
    // 0: one stratum per cube, 1: one stratum per face, 2: four strata per face (quadrants).
    strata: u32,
    unused: u32,
}

struct List {
    count: atomic<u32>,
    // The index of the first entry of the current cube, and the cube's number in the batch.
    first: u32,
    cube: u32,
    unused: u32,
    // For each cube, the index after its last entry. The length of the array is `CUBES` in tally.rs.
    ends: array<u32, 64>,
    // Three words for each entry: slot, strata mask, pixel count.
    entries: array<u32>,
}

@group(0) @binding(0) var items: texture_2d<u32>;
@group(0) @binding(1) var<storage, read_write> masks: array<atomic<u32>>;
@group(0) @binding(2) var<storage, read_write> counts: array<atomic<u32>>;
@group(0) @binding(3) var<storage, read_write> list: List;
@group(0) @binding(4) var<uniform> params: Params;

// The number of pixels of a row that one invocation reads. A run of equal pixels needs one pair of atomic
// operations.
const SEGMENT: u32 = 16u;

fn stratum_bit(face: u32, x: u32, y: u32) -> u32 {
    if params.strata == 0u {
        return 1u;
    }
    if params.strata == 1u {
        return 1u << face;
    }
    let quadrant = select(0u, 2u, 2u * y >= params.n) + select(0u, 1u, 2u * x >= params.n);
    return 1u << (face * 4u + quadrant);
}

fn add(item: u32, bit: u32, run: u32) {
    if item == 0u {
        return;
    }
    let slot = item - 1u;
    // In most cases, the bit is already set, and a load costs much less than an atomic or.
    if (atomicLoad(&masks[slot]) & bit) == 0u {
        atomicOr(&masks[slot], bit);
    }
    if atomicAdd(&counts[slot], run) == 0u {
        let at = atomicAdd(&list.count, 1u);
        if at < params.capacity {
            list.entries[3u * at] = slot;
        }
    }
}

@compute @workgroup_size(8, 8)
fn reduce(@builtin(global_invocation_id) id: vec3u) {
    let n = params.n;
    let start = id.x * SEGMENT;
    if id.y >= 6u * n || start >= n {
        return;
    }
    let face = id.y / n;
    let y = id.y % n;
    let row = vec2u((face % 3u) * n, (face / 3u) * n + y);
    var item = 0u;
    var bit = 0u;
    var run = 0u;
    for (var x = start; x < min(start + SEGMENT, n); x++) {
        let next = textureLoad(items, row + vec2u(x, 0u), 0).r;
        let next_bit = stratum_bit(face, x, y);
        if next == item && next_bit == bit {
            run++;
        } else {
            add(item, bit, run);
            item = next;
            bit = next_bit;
            run = 1u;
        }
    }
    add(item, bit, run);
}

@compute @workgroup_size(64)
fn gather(@builtin(global_invocation_id) id: vec3u, @builtin(num_workgroups) groups: vec3u) {
    let count = min(atomicLoad(&list.count), params.capacity);
    for (var i = list.first + id.x; i < count; i += groups.x * 64u) {
        let slot = list.entries[3u * i];
        list.entries[3u * i + 1u] = atomicLoad(&masks[slot]);
        list.entries[3u * i + 2u] = atomicLoad(&counts[slot]);
        atomicStore(&masks[slot], 0u);
        atomicStore(&counts[slot], 0u);
    }
}

@compute @workgroup_size(1)
fn close() {
    let count = atomicLoad(&list.count);
    list.ends[min(list.cube, 63u)] = count;
    list.first = min(count, params.capacity);
    list.cube++;
}
