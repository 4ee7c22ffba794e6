// A reader of .pvs results: view cells and their visible sets (docs/formats/pvs.md). No dependencies.
//
//   import { Pvs } from './pvs.mjs';
//   const pvs = Pvs.parse(await (await fetch('level.pvs')).arrayBuffer());   // checks every checksum
//   const cell = pvs.cellOf(1, 2, 3);                // -1 outside the view box
//   for (const id of pvs.visible(cell)) draw(id);    // Uint32Array, ascending
//
// Pvs.ranges(url) reads only the tables, and each set on request: its sets are promises without a checksum.
// Ids in sets are triangle ids, or the numbers of pvs.items (clusters or objects). Every error is a PvsError.

export class PvsError extends Error {
  name = 'PvsError';
}

const bad = (why) => { throw new PvsError(`${why}; copy or bake the file again`); };
const broken = (what) => bad(`the ${what} of the .pvs file is malformed`);
const CUT = 'the .pvs file is cut short';
const MAGIC = [0x89, 0x50, 0x56, 0x53, 13, 10, 26, 10];
const SECTIONS = ('info method tree objects flags visible undecided columns certificates pairs items '
  + 'contributions sources region portals').split(' ');

const CRC = Uint32Array.from({ length: 256 }, (_, c) => {
  for (let k = 0; k < 8; k++) c = c & 1 ? c >>> 1 ^ 0x82f63b78 : c >>> 1;
  return c;
});
function crc32c(bytes, before = 0) {
  let c = ~before;
  for (let i = 0; i < bytes.length; i++) c = CRC[(c ^ bytes[i]) & 255] ^ c >>> 8;
  return ~c >>> 0;
}
const matches = (bytes, crc, what, before) => {
  if (crc32c(bytes, before) !== crc) bad(`the .pvs file is damaged: its ${what} does not match its checksum`);
};
const viewOf = (b) => new DataView(b.buffer, b.byteOffset, b.byteLength);
const text = (bytes, what) => {
  try { return new TextDecoder('utf-8', { fatal: true, ignoreBOM: true }).decode(bytes); } catch { return broken(what); }
};
const u64 = (view, at) => {
  const n = view.getUint32(at, true) + view.getUint32(at + 4, true) * 2 ** 32;
  return Number.isSafeInteger(n) ? n : broken('header');
};

// Reads the fixed part of a file: all except the sections' bytes.
function header(bytes, length) {
  if (bytes.length < 12 || MAGIC.some((m, i) => bytes[i] !== m)) bad('this is not a .pvs file');
  const view = viewOf(bytes), version = view.getUint32(8, true);
  if (version !== 1 && version !== 2) bad(`the .pvs file has version ${version}, this reader supports 1 and 2`);
  if (bytes.length < 40) bad(CUT);
  const [count, triangles, cells, nodes, crc] = [12, 24, 28, 32, 36].map((at) => view.getUint32(at, true));
  if (count < (version === 1 ? 7 : 8) || count > (version === 1 ? 9 : 15)) broken('header');
  const end = 40 + 24 * count;
  if (bytes.length < end) bad(CUT);
  if (u64(view, 16) !== length) bad(`the .pvs file should have ${u64(view, 16)} bytes and has ${length}`);
  matches(bytes.subarray(40, end), crc, 'header', crc32c(bytes.subarray(0, 36)));
  if (cells < 1 || nodes !== 2 * cells - 1) broken('header');
  const sections = new Map();
  let next = end, last = -1;
  for (let i = 0; i < count; i++) {
    const at = 40 + 24 * i, number = view.getUint32(at, true);
    const [offset, size] = [u64(view, at + 8), u64(view, at + 16)];
    if (number <= last || number > 14 || ((version === 1 || i < 7) && number !== i) || offset !== next) {
      broken('header');
    }
    sections.set(number, { crc: view.getUint32(at + 4, true), offset, size });
    [next, last] = [offset + size, number];
  }
  if (next !== length) broken('header');
  return { triangles, cells, nodes, sections };
}

function varint(bytes, at, what) {
  let value = 0, scale = 1;
  for (let k = 0; k < 9; k++) {
    const byte = bytes[at.i++];
    if (byte === undefined) break;
    value += (byte & 127) * scale;
    scale *= 128;
    if (byte < 128) return value;
  }
  return broken(what);
}

// Returns a function that reads the next exponential Golomb code of order k; without k, it checks the end.
function codes(bytes, what) {
  const all = bytes.length * 8, bit = (i) => bytes[i >> 3] >> (i & 7);
  let at = 0;
  return (k) => {
    if (k === undefined) return all - at > 7 || (at < all && bit(at)) ? broken(what) : 0;
    let n = k, low = 0;
    while (at < all && !(bit(at) & 1)) { at++; n++; }
    if (++at + n > all || n > 32) broken(what);
    for (let got = 0; got < n;) {
      const take = Math.min(8 - (at & 7), n - got);
      low += (bit(at) & (1 << take) - 1) * 2 ** got;
      at += take;
      got += take;
    }
    return 2 ** n + low - 2 ** k;
  };
}

// Calls `each` with the start and the end of each run of a coded set. Returns true if the set is absolute.
function runs(bytes, limit, each, what) {
  if (!bytes.length) return false;
  if (bytes[0] === 3 && bytes.length === 1) return true;
  if (bytes[0] > 1 || bytes.length < 3 || bytes[1] > 31 || bytes[2] > 31) broken(what);
  const at = { i: 3 }, count = varint(bytes, at, what), size = varint(bytes, at, what);
  const gaps = bytes.subarray(at.i, at.i + size), rest = bytes.subarray(at.i + size);
  if (gaps.length !== size || !count || count > 8 * Math.min(size, rest.length)) {
    broken(what);
  }
  const a = codes(gaps, what), b = codes(rest, what);
  for (let k = 0, end = -1; k < count; k++) {
    const start = end + 1 + a(bytes[1]);
    end = start + 1 + b(bytes[2]);
    if (end > limit) broken(what);
    each(start, end);
  }
  a();
  b();
  return bytes[0] === 1;
}

// Returns the ids of runs, given by their starts and ends.
function between(bounds) {
  let total = 0, i = 0;
  for (let k = 0; k < bounds.length; k += 2) total += bounds[k + 1] - bounds[k];
  const out = new Uint32Array(total);
  for (let k = 0; k < bounds.length; k += 2) for (let id = bounds[k]; id < bounds[k + 1]; id++) out[i++] = id;
  return out;
}

// Returns the ids of an exclusive or of sets, given the boundaries of all their runs; equal pairs cancel.
function ids(flips) {
  const bounds = [];
  for (const at of Uint32Array.from(flips).sort()) {
    if (bounds.at(-1) === at) bounds.pop(); else bounds.push(at);
  }
  return between(bounds);
}

export class Pvs {
  // Reads a whole file from an ArrayBuffer or Uint8Array, and checks it.
  static parse(buffer) {
    const bytes = ArrayBuffer.isView(buffer)
      ? new Uint8Array(buffer.buffer, buffer.byteOffset, buffer.byteLength) : new Uint8Array(buffer);
    const head = header(bytes.subarray(0, 40 + 24 * 15), bytes.length);
    const of = (number) => {
      const s = head.sections.get(number);
      return s && bytes.subarray(s.offset, s.offset + s.size);
    };
    for (const [number, s] of head.sections) {
      matches(of(number), s.crc, SECTIONS[number]);
    }
    return new Pvs(head, of, (offset, size) => bytes.subarray(offset, offset + size));
  }

  // Fetches the tables of a file by range requests; sets are fetched on request.
  static async ranges(url) {
    let length = 0;
    const range = async (offset, size) => {
      if (!size) return new Uint8Array(0);
      const answer = await fetch(url, { headers: { Range: `bytes=${offset}-${offset + size - 1}` } });
      const all = /^bytes (\d+)-\d+\/(\d+)$/.exec(answer.headers.get('content-range') ?? '');
      if (answer.status !== 206 || !all || +all[1] !== offset) bad(`${url}: the server does not support range requests`);
      length = +all[2];
      return new Uint8Array(await answer.arrayBuffer());
    };
    const head = header(await range(0, 40 + 24 * 15), length), parts = new Map();
    await Promise.all([...head.sections].map(async ([number, s]) => {
      // Fetch only the offsets of the sets, and no other large section.
      const table = number === 5 || number === 6;
      if (table || number <= 4 || number === 10) {
        parts.set(number, await range(s.offset, table && s.size ? 8 * (head.nodes + 1) : s.size));
        if (!table) matches(parts.get(number), s.crc, SECTIONS[number]);
      }
    }));
    return new Pvs(head, (number) => parts.get(number), range);
  }

  #head; #read; #axis; #at; #parent; #upper; #leaf; #offsets = {};

  constructor(head, of, read) {
    this.#head = head;
    this.#read = read;
    this.triangles = head.triangles;
    this.cells = head.cells;
    this.info = text(of(0), 'info');
    this.method = text(of(1), 'method');
    this.#tree(of(2));
    this.objects = this.#objects(of(3));
    const flags = of(4);
    if (flags.length !== 4 * this.cells) broken('flags');
    this.flags = new Uint32Array(flags.slice().buffer);
    for (const number of [5, 6]) this.#offsets[number] = this.#check(number, of(number));
    const items = of(10);
    this.items = { kind: 'triangles', count: this.triangles };
    if (items) {
      const kind = ['clusters', 'objects'][items[0] - 1], count = items.length > 4 && viewOf(items).getUint32(1, true);
      if (!kind || count === false || (kind === 'objects' && count !== this.objects.length)) {
        broken('items');
      }
      this.items = { kind, count };
      const at = { i: 5 }, sets = kind === 'clusters' ? count : 1;
      // The runs of the triangles of each cluster; for objects, the runs of triangles that are never visible.
      this.#items = [];
      for (let k = 0; k < sets; k++) {
        const size = varint(items, at, 'items'), coded = items.subarray(at.i, at.i += size);
        if (coded.length !== size) broken('items');
        const found = [];
        runs(coded, this.triangles, (start, end) => found.push(start, end), 'items');
        this.#items.push(found);
      }
      if (at.i !== items.length) broken('items');
    }
  }

  #items = null;

  #tree(bytes) {
    const nodes = this.#head.nodes, view = viewOf(bytes);
    if (bytes.length !== 24 + 8 * nodes) broken('tree');
    const float = (at) => view.getFloat32(at, true);
    this.viewBox = Float32Array.from({ length: 6 }, (_, k) => float(4 * k));
    if (!this.viewBox.every((x, k) => Number.isFinite(x) && (k < 3 || this.viewBox[k - 3] <= x))) broken('tree');
    this.#axis = new Uint8Array(nodes);
    this.#at = new Float32Array(nodes);
    this.#parent = new Uint32Array(nodes);
    this.#upper = new Uint32Array(nodes);
    this.#leaf = new Uint32Array(this.cells);
    // The cells' boxes: six numbers each, minimum corner first.
    this.boxes = new Float32Array(6 * this.cells);
    const open = [{ parent: 0, box: this.viewBox, depth: 0, isUpper: false }];
    let cell = 0;
    for (let i = 0; i < nodes; i++) {
      const next = open.pop(), axis = view.getUint32(24 + 8 * i, true), at = float(28 + 8 * i);
      if (!next || axis > 3 || (axis === 3 && cell === this.cells)) broken('tree');
      const { parent, box, depth, isUpper } = next;
      this.#axis[i] = axis;
      this.#at[i] = at;
      this.#parent[i] = parent;
      if (isUpper) this.#upper[parent] = i;
      if (axis === 3) {
        this.boxes.set(box, 6 * cell);
        this.#upper[i] = cell;
        this.#leaf[cell++] = i;
      } else {
        if (!(box[axis] < at && at < box[axis + 3]) || depth === 64) broken('tree');
        const [below, above] = [box.slice(), box.slice()];
        below[axis + 3] = above[axis] = at;
        open.push({ parent: i, box: above, depth: depth + 1, isUpper: true },
          { parent: i, box: below, depth: depth + 1, isUpper: false });
      }
    }
    if (open.length) broken('tree');
  }

  #objects(bytes) {
    const view = viewOf(bytes), count = bytes.length < 4 ? NaN : view.getUint32(0, true);
    if (!(4 + 12 * count <= bytes.length)) broken('objects');
    let name = 4 + 12 * count, next = 0;
    const objects = Array.from({ length: count }, (_, k) => {
      const [first, size, length] = [4, 8, 12].map((at) => view.getUint32(at + 12 * k, true));
      if (first !== next || name + length > bytes.length) broken('objects');
      next += size;
      return { name: text(bytes.subarray(name, name += length), 'objects'), first, count: size };
    });
    if (name !== bytes.length || next !== this.triangles) broken('objects');
    return objects;
  }

  #check(number, bytes) {
    const { nodes, sections } = this.#head, size = sections.get(number).size, table = 8 * (nodes + 1);
    if (!size && number === 6) return null;
    if (size < table) broken(SECTIONS[number]);
    const view = viewOf(bytes), offsets = Float64Array.from({ length: nodes + 1 }, (_, k) => u64(view, 8 * k));
    if (offsets[0] || offsets.some((o, k) => k && o < offsets[k - 1]) || offsets[nodes] !== size - table) {
      broken(SECTIONS[number]);
    }
    return offsets;
  }

  // Returns the number of the cell that contains a point, or -1 outside the view box.
  cellOf(x, y, z) {
    const p = [x, y, z];
    if (!p.every((c, k) => c >= this.viewBox[k] && c <= this.viewBox[k + 3])) return -1;
    let node = 0;
    while (this.#axis[node] < 3) node = p[this.#axis[node]] < this.#at[node] ? node + 1 : this.#upper[node];
    return this.#upper[node];
  }

  // isReached: true if the cell contains viewpoints. isSetAside: true if its tile failed; the set contains all ids.
  isReached(cell) { return !(this.flags[cell] & 2); }
  isSetAside(cell) { return !!(this.flags[cell] & 1); }

  // Returns the ids to draw from a cell, ascending; with Pvs.ranges a promise if bytes must be fetched.
  visible(cell) { return this.#set(5, cell); }

  // Returns the ids of the visible set that were neither seen nor proved hidden.
  undecided(cell) { return this.#set(6, cell); }

  // Returns the triangles of items, ascending.
  trianglesOf(items) {
    if (!this.#items) return items;
    const objects = this.items.kind === 'objects' && this.objects, bounds = [];
    for (const k of items) {
      if (objects) bounds.push(objects[k].first, objects[k].first + objects[k].count);
      else for (const at of this.#items[k]) bounds.push(at);
    }
    const never = objects ? this.#items[0] : [];
    let n = 0;
    return between(bounds).sort().filter((id) => {
      while (never[n + 1] <= id) n += 2;
      return !(never[n] <= id);
    });
  }

  #set(number, cell) {
    if (!(Number.isInteger(cell) && cell >= 0 && cell < this.cells)) {
      throw new PvsError(`there is no cell ${cell}; the result has ${this.cells} cells`);
    }
    const offsets = this.#offsets[number], limit = this.items.count;
    if (!offsets) return new Uint32Array(0);
    const base = this.#head.sections.get(number).offset + 8 * (this.#head.nodes + 1);
    const flips = [], each = (start, end) => flips.push(start, end);
    const step = (node) => {
      const bytes = this.#read(base + offsets[node], offsets[node + 1] - offsets[node]);
      const go = (coded) => {
        const done = runs(coded, limit, each, `${SECTIONS[number]} set of cell ${cell}`) || !node;
        return done ? ids(flips) : step(this.#parent[node]);
      };
      return bytes instanceof Promise ? bytes.then(go) : go(bytes);
    };
    return step(this.#leaf[cell]);
  }
}
