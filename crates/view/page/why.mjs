// Why triangles are visible from a cell, or hidden: rays from its viewpoints, in the page. What rays show is seen;
// what none of them shows may still be seen, so a hidden triangle is proved by `sightline query --why` alone.

import { add, cross, norm, random, scaled, sub, unit } from './math.mjs';

// Rays that are cast at most, and in how many goes.
const RAYS = 6000;
const BLOCKERS = 12;

// Looks for a segment from a viewpoint of a cell to one of `targets`. Viewpoints are the eye, if it is in the cell,
// and points of the cell that a free segment joins with it. Gives { rays, seen: [from, to, triangle] or null,
// blockers: [[triangle, rays], …] }.
export function why(tracer, box, eye, targets, seed = 1) {
  const next = random(seed), inside = eye.every((x, k) => x >= box[k] && x <= box[k + 3]);
  const at = tracer.at, counts = new Map();
  const viewpoint = () => {
    const p = [0, 1, 2].map((k) => box[k] + (box[k + 3] - box[k]) * next());
    if (!inside) return p;
    return tracer.first_hit(eye, sub(p, eye), 1)[0] < 0 ? p : null;
  };
  const isTarget = new Set(targets);
  let rays = 0;
  for (let go = 0; go < RAYS; go++) {
    const from = inside && go < RAYS / 4 ? eye : viewpoint();
    if (!from) continue;
    const id = targets[Math.floor(next() * targets.length)], r = Math.sqrt(next()), s = next();
    const [a, b, c] = [1 - r, r * (1 - s), r * s];
    const to = [0, 1, 2].map((k) => a * at[9 * id + k] + b * at[9 * id + 3 + k] + c * at[9 * id + 6 + k]);
    const d = sub(to, from);
    // A little short of the target, so that it is not met itself where it blocks.
    const [hit] = tracer.first_hit(from, d, 1 - 1e-5, id);
    rays++;
    if (hit < 0 || isTarget.has(hit)) return { rays, seen: [from, to, hit < 0 ? id : hit], blockers: [] };
    counts.set(hit, (counts.get(hit) ?? 0) + 1);
  }
  const blockers = [...counts].sort((a, b) => b[1] - a[1] || a[0] - b[0]).slice(0, BLOCKERS);
  return { rays, seen: null, blockers };
}

// The narrowest place that a segment passes: rays across it at several places. Gives { width, ring } or null in
// the open.
export function opening(tracer, [from, to], across = 24, around = 16) {
  const d = sub(to, from), along = unit(d);
  const u = unit(cross(along, Math.abs(along[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0])), v = cross(along, u);
  let best = null;
  for (let k = 1; k < across; k++) {
    const p = add(from, d, k / across), ring = [];
    for (let j = 0; j < around; j++) {
      const w = 2 * Math.PI * j / around, dir = add(scaled(u, Math.cos(w)), v, Math.sin(w));
      const [hit, t] = tracer.first_hit(p, dir);
      ring.push(hit < 0 ? null : add(p, dir, t));
    }
    // Between hits on opposite sides.
    let width = Infinity;
    for (let j = 0; j < around / 2; j++) {
      const [a, b] = [ring[j], ring[j + around / 2]];
      if (a && b) width = Math.min(width, norm(sub(a, b)));
    }
    if (width < (best?.width ?? Infinity)) best = { width, ring: ring.filter((q) => q) };
  }
  return best;
}
