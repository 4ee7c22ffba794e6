// The reasons why triangles are visible or hidden from a cell, from rays that the page casts from viewpoints
// of the cell. A triangle that a ray reaches is visible. A triangle that no ray reaches may still be visible,
// so only an exact query proves that the triangle is hidden. The page's server, if any, and
// `sightline query --why` answer such queries.

import { add, cross, dot, norm, random, scaled, sub, unit } from './math.mjs';

// The maximum number of rays, and the maximum number of listed blockers.
const RAYS = 6000;
const BLOCKERS = 12;

// Searches for a segment from a viewpoint of a cell to one of `targets`. Viewpoints are `base` and the points
// of the cell that a free segment connects with `base`. Without a base, all points of the cell's box are
// viewpoints. The eye is used if it is a viewpoint. Segments are at most `far` long. Returns { rays, seen:
// [from, to, triangle] or null, blockers: [[triangle, rays], …] }.
export function why(tracer, box, { base, eye, far }, targets, seed = 1) {
  const next = random(seed), at = tracer.at, counts = new Map(), isTarget = new Set(targets);
  const isIn = (p) => p.every((x, k) => x >= box[k] && x <= box[k + 3]);
  const isJoined = (p) => !base || tracer.first_hit(base, sub(p, base), 1)[0] < 0;
  const first = isIn(eye) && isJoined(eye) ? eye : base;
  const viewpoint = () => {
    const p = [0, 1, 2].map((k) => box[k] + (box[k + 3] - box[k]) * next());
    return isJoined(p) ? p : null;
  };
  let rays = 0;
  for (let go = 0; go < RAYS; go++) {
    const from = first && go < RAYS / 4 ? first : viewpoint();
    if (!from) continue;
    const id = targets[Math.floor(next() * targets.length)], r = Math.sqrt(next()), s = next();
    const [a, b, c] = [1 - r, r * (1 - s), r * s];
    const to = [0, 1, 2].map((k) => a * at[9 * id + k] + b * at[9 * id + 3 + k] + c * at[9 * id + 6 + k]);
    const d = sub(to, from);
    if (norm(d) > far) continue;
    const [hit, t] = tracer.first_hit(from, d, 1, id);
    rays++;
    if (hit < 0) return { rays, seen: [from, to, id], blockers: [] };
    if (isTarget.has(hit)) return { rays, seen: [from, add(from, d, t), hit], blockers: [] };
    counts.set(hit, (counts.get(hit) ?? 0) + 1);
  }
  const blockers = [...counts].sort((a, b) => b[1] - a[1] || a[0] - b[0]).slice(0, BLOCKERS);
  return { rays, seen: null, blockers };
}

// Returns the opening that a segment passes as { width, ring }, or null if no two opposite sides are bounded.
// The function moves the segment sideways in several directions until a triangle blocks it, which is the edge
// of the opening. The function ignores triangles next to the ends, which
// belong to the viewpoint or the target.
export function opening(tracer, [from, to], size, around = 16) {
  const d = sub(to, from), along = unit(d);
  const u = unit(cross(along, Math.abs(along[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0])), v = cross(along, u);
  const start = add(from, d, 0.02), middle = scaled(d, 0.83);
  const edge = (w) => {
    const aside = add(scaled(u, Math.cos(w)), v, Math.sin(w));
    const blocked = (r) => tracer.first_hit(add(start, aside, r), middle, 1);
    let free = 0, r = size * 1e-5;
    while (r < size && blocked(r)[0] < 0) { free = r; r *= 1.6; }
    if (r >= size) return null;
    for (let k = 0; k < 16; k++) {
      const half = (free + r) / 2;
      if (blocked(half)[0] < 0) free = half; else r = half;
    }
    return { r, at: add(add(start, aside, r), middle, blocked(r)[1]) };
  };
  const edges = Array.from({ length: around }, (_, k) => edge(2 * Math.PI * k / around));
  const ring = edges.filter((e) => e).map((e) => e.at);
  let width = Infinity;
  for (let k = 0; k < around / 2; k++) {
    if (!edges[k] || !edges[k + around / 2]) continue;
    // The extent of the opening along a direction in which both sides are bounded.
    const w = 2 * Math.PI * k / around, aside = add(scaled(u, Math.cos(w)), v, Math.sin(w));
    const along = ring.map((p) => dot(sub(p, from), aside));
    width = Math.min(width, Math.max(...along) - Math.min(...along));
  }
  return Number.isFinite(width) ? { width, ring } : null;
}

// Requests an exact answer from the server. Returns { words, seen: [from, to, triangle] or null, blockers:
// [[triangle, 1], …] }.
export async function exactly({ url, job }, cell, triangle) {
  const none = (words) => ({ words, seen: null, blockers: [] });
  try {
    const body = JSON.stringify({ ...(job === null ? {} : { job }), cell, triangle });
    const answer = await fetch(url, { method: 'POST', headers: { 'content-type': 'application/json' }, body });
    const text = await answer.text();
    if (!answer.ok) return none(`the server rejects the query: ${text.startsWith('{') ? JSON.parse(text).message : text}`);
    const told = JSON.parse(text);
    const w = told.witness ?? [], blockers = (told.blockers ?? []).map((id) => [id, 1]);
    const because = told.reason ? ` (${told.reason})` : '';
    const itself = told.state === 'hidden' && !blockers.length && !because;
    const words = `${told.state}, decided exactly${because}${itself ? ': the triangle shows only the inside of its closed surface to the cell.' : '.'}`;
    return { words, seen: w.length ? [w.slice(0, 3), w.slice(3), triangle] : null, blockers };
  } catch (e) {
    return none(`the server cannot be reached: ${e.message}`);
  }
}
