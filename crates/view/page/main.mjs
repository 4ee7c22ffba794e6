// The page: the triangles drawn from the cell of the eye, the panel, and clicks.

import { Pvs } from './pvs.mjs';
import { Renderer } from './draw.mjs';
import { Tracer } from './trace.mjs';
import { Camera } from './camera.mjs';
import { exactly, opening, why } from './why.mjs';
import { norm, product, projection, random, sub, viewMatrix } from './math.mjs';

const byId = (id) => document.getElementById(id);
const RED = 0xc8362f, YELLOW = 0xe8c547, BLUE = 0x4f9dff, ORANGE = 0xff8c2e;
const GREEN_LINE = [0.35, 1, 0.45, 1], RED_LINE = [1, 0.25, 0.5, 1], WHITE_LINE = [1, 1, 1, 0.9];
// The maximum number of drawn boxes. More boxes would hide each other.
const MOST_BOXES = 20000;

const number = (n) => n.toLocaleString('en').replaceAll(',', ' ');
const short = (x) => x === 0 ? '0' : Math.abs(x) < 1e-3 || Math.abs(x) >= 1e6 ? x.toExponential(2) : +x.toPrecision(4);
const percent = (a, b) => `${(100 * a / Math.max(1, b)).toFixed(1)} %`;

// Decodes and decompresses a block of the page.
async function unpack(id) {
  const text = byId(id).textContent.trim();
  if (!text) return null;
  byId(id).textContent = '';
  const packed = atob(text), bytes = new Uint8Array(packed.length);
  for (let i = 0; i < packed.length; i++) bytes[i] = packed.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// Decodes the corners and kinds of the scene's triangles. For each of 4 bytes and 9 coordinates, the block
// contains the bytes of all triangles. One byte per triangle follows: bit 0 if it blocks, bit 1 if it shows.
function geometry(bytes, count) {
  const out = new Uint8Array(36 * count);
  for (let b = 0; b < 4; b++) {
    for (let c = 0; c < 9; c++) {
      for (let i = 0, from = (b * 9 + c) * count; i < count; i++) out[(i * 9 + c) * 4 + b] = bytes[from + i];
    }
  }
  return { at: new Float32Array(out.buffer), kinds: bytes.subarray(36 * count) };
}

// Returns a pale colour for each object.
function paint(k) {
  const h = (k * 0.618034 + 0.1) % 1 * 6, f = (s) => 0.72 + 0.2 * Math.max(-1, Math.min(1, Math.abs((h + s) % 6 - 3) - 1.5));
  return [0, 4, 2].reduce((all, s) => all * 256 + Math.round(255 * f(s)), 0);
}

function heatColour(t) {
  const stops = [[0.17, 0.25, 0.56], [0.16, 0.65, 0.63], [0.94, 0.84, 0.35], [0.89, 0.31, 0.23]];
  const k = Math.min(2, Math.floor(t * 3)), f = t * 3 - k;
  return [0, 1, 2].map((a) => stops[k][a] * (1 - f) + stops[k + 1][a] * f);
}

class Page {
  constructor(meta, pvs, scene, values) {
    Object.assign(this, { meta, pvs, values });
    const { at, kinds } = scene ?? { at: new Float32Array(0), kinds: new Uint8Array(0) };
    this.at = at;
    this.kinds = kinds;
    this.renderer = new Renderer(byId('canvas'), at);
    const box = pvs.viewBox, size = norm(sub([box[3], box[4], box[5]], box));
    this.camera = new Camera(meta.up, size);
    this.size = size;
    this.objectOf = new Uint32Array(pvs.triangles);
    pvs.objects.forEach((o, k) => this.objectOf.fill(k, o.first, o.first + o.count));
    this.colours = Uint32Array.from({ length: Math.max(1, pvs.objects.length) }, (_, k) => paint(k));
    this.cell = -1;
    this.selected = null;
    this.frames = 0;
    this.answer = null;
    this.dirty = true;
  }

  get tracer() { return this.built ??= new Tracer(this.at, this.kinds.map((k) => k & 1)); }

  start() {
    const first = this.meta.start ?? 0;
    this.controls();
    this.go(first);
    let last = performance.now(), shown = last, count = 0;
    const frame = (now) => {
      const moved = this.camera.move(Math.min(0.1, (now - last) / 1000), this.camera.walks ? this.tracer : null);
      last = now;
      if (moved) this.dirty = true;
      if (this.dirty || this.renderer.canvas.clientWidth !== this.width) this.draw();
      count++;
      if (now - shown > 500) {
        this.rate = Math.round(1000 * count / (now - shown));
        [shown, count] = [now, 0];
        this.tell();
      }
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  // Returns a known viewpoint of a cell, or the centre of the cell.
  place(cell) {
    const p = this.values?.places?.subarray(3 * cell, 3 * cell + 3);
    if (p && Number.isFinite(p[0])) return [...p];
    const b = this.pvs.boxes.subarray(6 * cell, 6 * cell + 6);
    return [0, 1, 2].map((k) => (b[k] + b[k + 3]) / 2);
  }

  go(cell) {
    if (!(Number.isInteger(cell) && cell >= 0 && cell < this.pvs.cells)) {
      return this.say(`There is no cell ${cell}: the result has ${number(this.pvs.cells)} cells, counted from 0.`);
    }
    this.jump(this.place(cell), this.widest(this.place(cell)));
  }

  // Returns the horizontal direction with the longest free distance to a triangle. If no ray meets a
  // triangle, returns the direction to the centre of the view box.
  widest(from) {
    const box = this.pvs.viewBox, middle = [0, 1, 2].map((k) => (box[k] + box[k + 3]) / 2 - from[k]);
    let best = [0, norm(middle) > 0 ? middle : null];
    for (let k = 0; k < 16 && this.at.length && this.pvs.triangles < 4e5; k++) {
      const w = Math.PI * k / 8, d = this.camera.turned([Math.sin(w), 0, -Math.cos(w)]);
      const [hit, t] = this.tracer.first_hit(from, d);
      if (hit >= 0 && t > best[0]) best = [t, d];
    }
    return best[1];
  }

  jump(eye, toward) {
    this.camera.eye = [...eye];
    if (toward) this.camera.toward(toward);
    this.say('');
    this.dirty = true;
    this.draw();
  }

  // Draws a frame. If the eye is in another cell than before, first loads the set of this cell.
  draw() {
    const { camera, renderer, pvs } = this;
    const here = pvs.cellOf(...camera.eye);
    if (!byId('freeze').checked && here !== this.cell) {
      this.cell = here;
      this.recolour();
    }
    const aspect = renderer.resize();
    const near = this.size * 2e-5, view = viewMatrix(camera.eye, camera.forward, camera.up);
    this.matrix = product(projection(camera.angle, aspect, near, this.size * 8), view);
    renderer.draw(this.matrix, camera.eye);
    this.width = renderer.canvas.clientWidth;
    this.dirty = false;
    this.frames++;
  }

  isCell() { return this.cell >= 0 && this.pvs.isReached(this.cell); }

  // Loads the set of the current cell, and colours the triangles.
  recolour() {
    const { pvs, cell } = this, n = pvs.triangles, state = this.state = new Uint8Array(n);
    const ofCell = this.isCell();
    if (this.selected) this.choose(-1);
    try {
      if (ofCell) {
        for (const id of pvs.trianglesOf(pvs.visible(cell))) state[id] = 1;
        for (const id of pvs.trianglesOf(pvs.undecided(cell))) state[id] |= 2;
      }
    } catch (e) {
      this.say(String(e.message ?? e));
    }
    this.paint();
    byId('cell').value = Math.max(0, cell);
  }

  paint() {
    const { state, kinds, objectOf, colours, selected } = this;
    const all = byId('show').value === 'all' || !this.isCell(), red = byId('hidden').checked;
    const yellow = byId('undecided').checked, chosen = selected && new Set(selected.ids);
    const lit = new Set((this.answer?.blockers ?? []).map(([id]) => id));
    let inSet = 0, undecided = 0;
    for (const s of state) { inSet += s & 1; undecided += s >> 1; }
    this.counts = { inSet, undecided };
    if (this.at.length) {
      this.drawn = this.renderer.colour((id) => {
        if (!(kinds[id] & 2)) return -1;
        if (chosen?.has(id)) return BLUE;
        if (lit.has(id)) return ORANGE;
        const s = state[id];
        if (!(s & 1)) return red && this.isCell() ? RED : all ? colours[objectOf[id]] : -1;
        return yellow && s & 2 ? YELLOW : colours[objectOf[id]];
      });
    }
    this.overlay();
    this.tell();
    this.dirty = true;
  }

  // Updates the lines and boxes.
  overlay() {
    const { pvs, values } = this, lines = [], boxes = [], which = byId('boxes').value, heat = byId('heat').value;
    const edges = (b, c, lines) => {
      const at = (k) => [b[k & 1 ? 3 : 0], b[k & 2 ? 4 : 1], b[k & 4 ? 5 : 2]];
      for (const [i, j] of [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]]) {
        lines.push([at(i), at(j), c]);
      }
    };
    const box = (cell) => pvs.boxes.subarray(6 * cell, 6 * cell + 6);
    const some = Math.min(pvs.cells, MOST_BOXES);
    if (which !== 'none' && this.cell >= 0) edges(box(this.cell), WHITE_LINE, lines);
    byId('scale').hidden = heat === '';
    // The boxes of all cells change only when the user selects another option.
    const isNew = this.overlaid !== `${which} ${heat}`;
    this.overlaid = `${which} ${heat}`;
    if (isNew) {
      const all = [];
      if (which === 'all') for (let k = 0; k < some; k++) if (pvs.isReached(k)) edges(box(k), [0.5, 0.6, 0.75, 0.6], all);
      this.renderer.lines(all, 'cells');
      if (some < pvs.cells && (which === 'all' || heat !== '')) this.say(`Only the boxes of the first ${number(some)} cells are drawn.`, false);
    }
    if (heat !== '') {
      const { data, name } = values.maps[+heat];
      let [lo, hi] = [Infinity, -Infinity];
      for (let k = 0; k < pvs.cells; k++) {
        if (pvs.isReached(k) && Number.isFinite(data[k])) [lo, hi] = [Math.min(lo, data[k]), Math.max(hi, data[k])];
      }
      for (let k = 0; isNew && k < some; k++) {
        if (!pvs.isReached(k) || !Number.isFinite(data[k])) continue;
        boxes.push([box(k), [...heatColour(hi > lo ? (data[k] - lo) / (hi - lo) : 0), 0.16]]);
      }
      const own = this.isCell() ? `; this cell: ${short(data[this.cell])}` : '';
      byId('scale').innerHTML = '';
      const bar = document.createElement('span');
      bar.className = 'scale';
      byId('scale').append(`${name}: ${short(lo)}`, bar, `${short(hi)}${own}`);
    }
    const answer = this.answer;
    if (answer?.seen) {
      lines.push([answer.seen[0], answer.seen[1], answer.missed ? RED_LINE : GREEN_LINE]);
      const ring = answer.opening?.ring ?? [];
      ring.forEach((p, k) => lines.push([p, ring[(k + 1) % ring.length], WHITE_LINE]));
    }
    this.renderer.lines(lines);
    if (isNew) this.renderer.boxes(boxes);
  }

  say(text, isWarning = true) {
    const note = byId('note');
    note.hidden = !text;
    note.textContent = text;
    note.classList.toggle('warning', isWarning);
  }

  tell() {
    const { pvs, cell, counts } = this;
    if (!counts) return;
    const n = pvs.triangles;
    const where = cell < 0 ? 'Outside of the view box: everything is drawn'
      : !pvs.isReached(cell) ? `Cell ${cell}: no viewpoints are in it, everything is drawn`
      : `Cell ${number(cell)} of ${number(pvs.cells)}: ${number(counts.inSet)} of ${number(n)} triangles (${percent(counts.inSet, n)})`;
    const undecided = counts.undecided ? `, ${number(counts.undecided)} of them undecided` : '';
    const aside = cell >= 0 && pvs.isSetAside(cell) ? '; the tile of the cell failed, so the cell shows everything' : '';
    const frozen = byId('freeze').checked ? ' – frozen' : '';
    const text = `${where}${undecided}${aside}${frozen}. ${this.rate ? `${this.rate} frames per second.` : ''}`;
    if (byId('status').textContent !== text) byId('status').textContent = text;
  }

  // Selects the clicked triangle, and explains why it is visible or hidden from the current cell.
  click(x, y) {
    const id = this.renderer.at(x, y, this.matrix, this.camera.eye);
    this.dirty = true;
    return this.choose(id);
  }

  choose(id) {
    if (id < 0 || id >= this.pvs.triangles) {
      [this.selected, this.answer] = [null, null];
      byId('ask').hidden = true;
      byId('why').textContent = 'Click a triangle to see why it is visible or hidden.';
      return this.paint();
    }
    const object = this.pvs.objects[this.objectOf[id]];
    const whole = byId('pick').value === 'object';
    const ids = whole ? Array.from({ length: object.count }, (_, k) => object.first + k).filter((k) => this.kinds[k] & 2) : [id];
    this.selected = { id, object, whole, ids, cell: this.cell };
    byId('ask').hidden = !this.meta.ask || !this.isCell();
    byId('ask').disabled = false;
    const name = whole ? `Object “${object.name}”` : `Triangle ${id} of “${object.name}”`;
    if (!this.isCell()) {
      this.answer = null;
      byId('why').textContent = `${name}. The eye is in no cell with viewpoints, so the page cannot give a reason.`;
      return this.paint();
    }
    const seen = ids.filter((k) => this.state[k] & 1), open = seen.filter((k) => this.state[k] & 2);
    const box = this.pvs.boxes.subarray(6 * this.cell, 6 * this.cell + 6);
    // If viewpoints are restricted to a region, use only points that a free segment connects with the known
    // viewpoint.
    const from = { base: this.values.places ? this.base() : null, eye: this.camera.eye, far: this.meta.far ?? Infinity };
    const answer = why(this.tracer, [...box], from, seen.length ? seen : ids, id + 1);
    answer.missed = !seen.length && !!answer.seen;
    if (answer.seen) answer.opening = opening(this.tracer, answer.seen, this.size);
    this.answer = answer;
    const is = seen.length ? (open.length === seen.length ? 'undecided, and drawn' : 'visible') : 'hidden';
    byId('why').textContent = `${name} is ${is} from cell ${this.cell}. ${this.reason(answer, seen.length > 0)}`;
    this.paint();
  }

  // Requests an exact answer about the clicked triangle. Ignores the answer if the user has selected another
  // triangle.
  async ask() {
    const { selected, meta } = this;
    byId('ask').disabled = true;
    byId('why').textContent = `Asking about triangle ${selected.id}…`;
    const answer = await exactly(meta.ask, selected.cell, selected.id);
    if (this.selected !== selected) return;
    byId('ask').hidden = true;
    if (answer.seen) answer.opening = opening(this.tracer, answer.seen, this.size);
    this.answer = answer;
    const names = [...new Set(answer.blockers.map(([id]) => this.pvs.objects[this.objectOf[id]].name))].slice(0, 4);
    const by = names.length ? ` ${answer.blockers.length === 1 ? 'One triangle hides' : `${number(answer.blockers.length)} triangles hide`} the target (orange), in ${names.map((n) => `“${n}”`).join(', ')}.` : '';
    const at = answer.opening ? ` The segment passes an opening ${short(answer.opening.width)} wide (white).` : '';
    const along = answer.seen ? ` The segment from (${answer.seen[0].map(short).join(', ')}) is the witness (green).${at}` : '';
    byId('why').textContent = `Triangle ${selected.id} of “${selected.object.name}” from cell ${selected.cell}: ${answer.words}${along}${by}`;
    this.paint();
  }

  // Returns a viewpoint of the current cell, or null if no viewpoint is known.
  base() {
    const p = this.place(this.cell);
    return p.every(Number.isFinite) ? p : null;
  }

  reason({ seen, rays, opening: at, blockers, missed }, inSet) {
    const from = seen && ` from (${seen[0].map(short).join(', ')})`;
    const ask = this.meta.ask ? '“Ask exactly”' : `\`sightline query OUT.pvs ${this.place(this.cell).map(short).join(' ')} --why ${this.selected.id} --scene SCENE\``;
    const { caveat } = this.meta, exact = this.pvs.method !== 'aggressive';
    if (missed && (caveat || exact)) return `A free segment${from} reaches the target in the page (red)${caveat ? `, which ignores ${caveat}` : ''}. ${ask} gives the exact answer.`;
    if (missed) return `But a free segment${from} reaches the target (red): the set misses the target. A smaller --target-error or --method exact avoids this.`;
    if (seen) {
      const passes = at ? ` The segment passes an opening ${short(at.width)} wide (white).` : '';
      return `A free segment${from} reaches the target (green).${passes}`;
    }
    if (!rays) return 'The page found no viewpoint in the cell from which to cast rays.';
    const names = [...new Set(blockers.map(([id]) => this.pvs.objects[this.objectOf[id]].name))].slice(0, 4);
    const by = `the first ${blockers.length} blocking triangles are orange (${names.map((n) => `“${n}”`).join(', ')})`;
    return inSet
      ? `None of ${number(rays)} rays reached the target; ${by}. The page did not find a witness, or the target is undecided and therefore drawn.`
      : `All of ${number(rays)} rays were blocked; ${by}. Rays do not prove that the target is hidden; ${ask} does.`;
  }

  controls() {
    const { camera, meta, pvs, values } = this, canvas = byId('canvas');
    const heat = byId('heat');
    heat.append(new Option('none', ''));
    (values?.maps ?? []).forEach((map, k) => heat.append(new Option(map.name, k)));
    byId('about').textContent = meta.about;
    byId('cell').max = pvs.cells - 1;
    byId('go').onclick = () => this.go(+byId('cell').value);
    byId('cell').onkeydown = (e) => { if (e.key === 'Enter') this.go(+byId('cell').value); };
    const any = random(Date.now());
    byId('random').onclick = () => {
      const reached = Array.from({ length: pvs.cells }, (_, k) => k).filter((k) => pvs.isReached(k));
      this.go(reached[Math.floor(any() * reached.length)] ?? 0);
    };
    byId('ask').onclick = () => this.ask();
    byId('freeze').onchange = () => { this.dirty = true; this.draw(); this.tell(); };
    byId('walk').onchange = () => {
      camera.walks = byId('walk').checked;
      if (camera.walks) camera.height = Math.min(this.camera.above(this.tracer) ?? Infinity, this.size / 20);
    };
    for (const id of ['show', 'hidden', 'undecided', 'boxes', 'heat']) byId(id).onchange = () => this.paint();
    byId('fold').onclick = () => {
      const folded = byId('panel').classList.toggle('folded');
      byId('fold').textContent = folded ? '+' : '–';
      byId('fold').setAttribute('aria-expanded', String(!folded));
    };
    byId('worst').hidden = !meta.worst.length;
    for (const frame of meta.worst) {
      const item = document.createElement('li'), link = document.createElement('a');
      link.href = '#';
      link.textContent = `${(100 * frame.error).toFixed(3)} % wrong pixels, cell ${frame.cell}`;
      link.onclick = (e) => { e.preventDefault(); this.jump(frame.viewpoint, this.widest(frame.viewpoint)); };
      item.append(link);
      byId('frames').append(item);
    }
    this.pointers(canvas);
    addEventListener('keydown', (e) => {
      if (e.ctrlKey || e.metaKey || e.altKey || e.target.tagName === 'SELECT' || e.target.type === 'number') return;
      const toggle = { KeyF: 'freeze', KeyG: 'walk', KeyH: 'hidden' }[e.code];
      if (!toggle) camera.keys.add(e.code); else if (!e.repeat) byId(toggle).click();
      if (e.code.startsWith('Arrow')) e.preventDefault();
    });
    addEventListener('keyup', (e) => camera.keys.delete(e.code));
    addEventListener('blur', () => camera.keys.clear());
    addEventListener('resize', () => { this.dirty = true; });
    canvas.addEventListener('webglcontextlost', () => this.say('The browser stopped WebGL for this page; load the page again.'));
    canvas.addEventListener('wheel', (e) => {
      e.preventDefault();
      camera.speed = Math.max(this.size * 1e-4, Math.min(this.size, camera.speed * Math.exp(-e.deltaY / 600)));
    }, { passive: false });
  }

  pointers(canvas) {
    const down = new Map();
    let moved = 0;
    // The distance in pixels up to which a movement counts as a click. A finger is less steady than a mouse.
    const least = (e) => e.pointerType === 'touch' ? 12 : 4;
    canvas.onpointerdown = (e) => {
      canvas.setPointerCapture(e.pointerId);
      canvas.focus();
      down.set(e.pointerId, [e.clientX, e.clientY]);
      if (down.size === 1) moved = 0;
    };
    canvas.onpointermove = (e) => {
      const before = down.get(e.pointerId);
      if (!before) return;
      const [dx, dy] = [e.clientX - before[0], e.clientY - before[1]];
      moved += Math.abs(dx) + Math.abs(dy);
      if (moved < least(e)) return;
      down.set(e.pointerId, [e.clientX, e.clientY]);
      if (down.size === 1) {
        this.camera.look(-dx * 0.004, dy * 0.004);
      } else {
        const far = this.camera.speed * 0.006;
        this.camera.drag(dx * far, -dy * far, this.camera.walks ? this.tracer : null);
      }
      this.dirty = true;
    };
    const end = (e) => {
      if (down.delete(e.pointerId) && moved < least(e) && e.type === 'pointerup') this.click(e.offsetX, e.offsetY);
    };
    canvas.onpointerup = end;
    canvas.onpointercancel = end;
  }
}

async function open() {
  const meta = JSON.parse(byId('meta').textContent);
  if (typeof DecompressionStream === 'undefined') throw new Error('This browser is too old for this page. Use a current Chromium, Firefox or Safari.');
  const [result, scene, packed] = await Promise.all(['result', 'scene', 'values'].map(unpack));
  const pvs = Pvs.parse(result), floats = new Float32Array(packed.buffer);
  const of = (k, width) => floats.subarray(k, k + width * pvs.cells);
  const maps = meta.maps.map((name, k) => ({ name, data: of(k * pvs.cells, 1) }));
  const places = meta.places ? of(maps.length * pvs.cells, 3) : null;
  const page = new Page(meta, pvs, scene && geometry(scene, pvs.triangles), { maps, places });
  if (!scene) byId('boxes').value = 'all';
  page.start();
  if (!scene) page.say('Without the scene, the page draws only cells. Pass the scene to `sightline view`, too.', false);
  return page;
}

// The state of the page, for tests and consoles.
globalThis.sightline = open().catch((e) => {
  byId('status').textContent = '';
  byId('note').hidden = false;
  byId('note').classList.add('warning');
  byId('note').textContent = String(e.message ?? e);
  return null;
});
