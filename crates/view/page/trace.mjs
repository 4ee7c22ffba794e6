// Rays against the scene's triangles: a bounding volume hierarchy in typed arrays, built at its first use.

const LEAF = 4;

export class Tracer {
  // `at` contains nine numbers per triangle. `blocks` selects the triangles that a ray can hit.
  constructor(at, blocks) {
    const n = at.length / 9, order = new Uint32Array(n), centre = new Float32Array(3 * n);
    let count = 0;
    for (let i = 0; i < n; i++) {
      if (!blocks[i]) continue;
      for (let a = 0; a < 3; a++) centre[3 * i + a] = (at[9 * i + a] + at[9 * i + 3 + a] + at[9 * i + 6 + a]) / 3;
      order[count++] = i;
    }
    this.at = at;
    this.order = order.subarray(0, count);
    // For each node: the box, the first child or triangle, and the number of triangles (0 for an inner node).
    const most = Math.max(1, 2 * count);
    this.box = new Float32Array(6 * most);
    this.first = new Uint32Array(most);
    this.size = new Uint32Array(most);
    this.nodes = 1;
    this.#bound(0, 0, count);
    const open = [[0, 0, count]];
    while (open.length) {
      const [node, from, to] = open.pop(), axis = this.#widest(node);
      if (to - from <= LEAF) continue;
      const middle = this.#divide(centre, from, to, axis);
      const child = this.nodes;
      this.nodes += 2;
      this.first[node] = child;
      this.size[node] = 0;
      this.#bound(child, from, middle);
      this.#bound(child + 1, middle, to);
      open.push([child, from, middle], [child + 1, middle, to]);
    }
    // The stack needs two entries per level. Halves of equal numbers would be 32 levels deep.
    this.stack = new Uint32Array(4096);
  }

  #widest(node) {
    const b = this.box.subarray(6 * node, 6 * node + 6);
    const w = [b[3] - b[0], b[4] - b[1], b[5] - b[2]];
    return w[0] >= w[1] && w[0] >= w[2] ? 0 : w[1] >= w[2] ? 1 : 2;
  }

  #bound(node, from, to) {
    const { at, order, box } = this, o = 6 * node;
    box.fill(Infinity, o, o + 3);
    box.fill(-Infinity, o + 3, o + 6);
    for (let k = from; k < to; k++) {
      for (let c = 0; c < 9; c++) {
        const x = at[9 * order[k] + c], a = c % 3;
        if (x < box[o + a]) box[o + a] = x;
        if (x > box[o + 3 + a]) box[o + 3 + a] = x;
      }
    }
    this.first[node] = from;
    this.size[node] = to - from;
  }

  // Sorts the triangles from `from` to `to` into the halves of their box, or into two equal parts.
  #divide(centre, from, to, axis) {
    const { order } = this;
    let lo = Infinity, hi = -Infinity;
    for (let k = from; k < to; k++) {
      const c = centre[3 * order[k] + axis];
      if (c < lo) lo = c;
      if (c > hi) hi = c;
    }
    const plane = (lo + hi) / 2;
    let i = from, j = to;
    while (i < j) {
      if (centre[3 * order[i] + axis] < plane) i++;
      else { j--; const t = order[i]; order[i] = order[j]; order[j] = t; }
    }
    return i > from && i < to ? i : (from + to) >>> 1;
  }

  // Returns the first triangle that a ray meets before `most` lengths of its direction, and the distance t of
  // the intersection in lengths of the direction: [triangle, t].
  first_hit(p, d, most = Infinity, except = -1) {
    const { at, order, box, first, size, stack } = this;
    let hit = -1, best = most, top = 0;
    const inv = [1 / d[0], 1 / d[1], 1 / d[2]];
    // Without a triangle the root has no children.
    if (order.length) stack[top++] = 0;
    while (top) {
      const node = stack[--top], o = 6 * node;
      let near = 0, far = best;
      for (let a = 0; a < 3; a++) {
        // A ray parallel to a slab is inside or outside of the slab along its whole length.
        if (d[a] === 0) {
          if (p[a] < box[o + a] || p[a] > box[o + 3 + a]) far = -1;
          continue;
        }
        const u = (box[o + a] - p[a]) * inv[a], v = (box[o + 3 + a] - p[a]) * inv[a];
        if (u < v) { if (u > near) near = u; if (v < far) far = v; } else { if (v > near) near = v; if (u < far) far = u; }
      }
      if (near > far * (1 + 1e-6)) continue;
      if (!size[node]) {
        stack[top++] = first[node];
        stack[top++] = first[node] + 1;
        continue;
      }
      for (let k = first[node], end = k + size[node]; k < end; k++) {
        const i = order[k];
        if (i === except) continue;
        const t = meet(at, 9 * i, p, d);
        if (t > 1e-9 && t < best) { best = t; hit = i; }
      }
    }
    return [hit, best];
  }
}

// Returns the distance at which a ray meets a triangle, in lengths of the ray's direction, or Infinity
// without a hit (Möller and Trumbore).
export function meet(at, o, p, d) {
  const e = [at[o + 3] - at[o], at[o + 4] - at[o + 1], at[o + 5] - at[o + 2]];
  const f = [at[o + 6] - at[o], at[o + 7] - at[o + 1], at[o + 8] - at[o + 2]];
  const hx = d[1] * f[2] - d[2] * f[1], hy = d[2] * f[0] - d[0] * f[2], hz = d[0] * f[1] - d[1] * f[0];
  const a = e[0] * hx + e[1] * hy + e[2] * hz;
  if (a === 0) return Infinity;
  const s = [p[0] - at[o], p[1] - at[o + 1], p[2] - at[o + 2]], u = (s[0] * hx + s[1] * hy + s[2] * hz) / a;
  if (!(u >= 0 && u <= 1)) return Infinity;
  const qx = s[1] * e[2] - s[2] * e[1], qy = s[2] * e[0] - s[0] * e[2], qz = s[0] * e[1] - s[1] * e[0];
  const v = (d[0] * qx + d[1] * qy + d[2] * qz) / a;
  return v >= 0 && u + v <= 1 ? (f[0] * qx + f[1] * qy + f[2] * qz) / a : Infinity;
}
