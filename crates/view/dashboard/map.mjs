// The map of a job's tiles from above, coloured by state.
import { attempt, call } from './calls.mjs';
import { byId, element } from './words.mjs';

// The names and colours of the tile states 1 to 6.
export const STATES = [null, ['waiting', '#b8b8b8'], ['ready', '#7f9cc0'], ['leased', '#e0b34d'],
  ['running', '#2f7ed8'], ['done', '#2e9e5b'], ['set aside', '#c0392b']];
const NAMES = { WAITING: 1, READY: 2, LEASED: 3, RUNNING: 4, DONE: 5, SET_ASIDE: 6 };
const PAGE = 10000;

export class TileMap {
  constructor() {
    this.canvas = byId('map');
    this.boxes = new Float32Array(0);
    this.states = new Uint8Array(0);
    this.canvas.addEventListener('click', (e) => this.pick(e));
    byId('map-up').addEventListener('change', () => { this.layers(); this.draw(); });
    byId('map-layer').addEventListener('input', () => this.draw());
  }

  // Shows another job.
  async show(job) {
    this.job = job;
    this.states = new Uint8Array(0);
    this.boxes = new Float32Array(0);
    byId('map-tile').textContent = 'Click on a tile to see which workers compute it.';
    let next = 0;
    do {
      const page = await attempt(() => call('Farm', 'ListTiles', { job, first: next, limit: PAGE }));
      if (!page || this.job !== job) return;
      if (this.boxes.length === 0) {
        this.boxes = new Float32Array(6 * (page.total ?? 0)).fill(NaN);
        // The current states may have arrived before the positions.
        if (this.states.length !== (page.total ?? 0)) this.states = new Uint8Array(page.total ?? 0);
      }
      for (const tile of page.tiles ?? []) {
        const n = tile.tile ?? 0;
        if (tile.box && !tile.isPack) this.boxes.set(tile.box, 6 * n);
        if (this.states[n] === 0) this.states[n] = NAMES[tile.state.slice(11)] ?? 1;
      }
      next = page.next ?? 0;
    } while (next > 0);
    this.layers();
    this.draw();
  }

  // Processes the states of tiles: one digit per tile, or pairs of tile and state.
  heard(tiles) {
    if (typeof tiles === 'string') {
      this.states = Uint8Array.from(tiles, (digit) => Number(digit));
    } else {
      for (let i = 0; i < tiles.length; i += 2) this.states[tiles[i]] = tiles[i + 1];
    }
    this.draw();
  }

  // Returns the axis that points up, and the two axes of the map.
  axes() {
    const up = Number(byId('map-up').value);
    return [up, ...[[2, 1], [0, 2], [1, 0]][up]];
  }

  layers() {
    const [up] = this.axes(), levels = new Set();
    for (let i = up; i < this.boxes.length; i += 6) if (!Number.isNaN(this.boxes[i])) levels.add(this.boxes[i]);
    this.levels = [...levels].sort((a, b) => a - b);
    byId('map-layer').max = this.levels.length - 1;
    byId('map-layer').value = -1;
  }

  // Returns the transformation from the map to the canvas.
  scale() {
    const [, x, y] = this.axes();
    let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let i = 0; i < this.boxes.length; i += 6) {
      if (Number.isNaN(this.boxes[i])) continue;
      x0 = Math.min(x0, this.boxes[i + x]); x1 = Math.max(x1, this.boxes[i + 3 + x]);
      y0 = Math.min(y0, this.boxes[i + y]); y1 = Math.max(y1, this.boxes[i + 3 + y]);
    }
    const size = Math.min((this.canvas.width - 8) / (x1 - x0), (this.canvas.height - 8) / (y1 - y0));
    return { x, y, x0, y0, size };
  }

  isIn(tile, level) {
    const [up] = this.axes(), i = 6 * tile + up;
    return level === null || (this.boxes[i] <= level && level < this.boxes[i + 3]);
  }

  level() {
    const layer = Number(byId('map-layer').value);
    return layer < 0 || !this.levels ? null : this.levels[layer] ?? null;
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.paint(); });
  }

  paint() {
    const pen = this.canvas.getContext('2d'), level = this.level();
    byId('map-which').textContent = level === null ? 'all layers, upper tiles in front' : `layer from ${level}`;
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const counts = new Array(STATES.length).fill(0);
    for (const state of this.states) counts[state] += 1;
    byId('map-legend').replaceChildren(...STATES.slice(1).map(([name, color], i) => {
      const swatch = element('span', '', { class: 'swatch' });
      // The page's policy forbids style attributes.
      swatch.style.background = color;
      return element('li', [swatch, `${counts[i + 1]} ${name}`]);
    }));
    if (this.boxes.length === 0) return;
    const { x, y, x0, y0, size } = this.scale();
    pen.strokeStyle = '#0004';
    for (let tile = 0; tile < this.states.length; tile++) {
      const i = 6 * tile;
      if (Number.isNaN(this.boxes[i]) || !this.isIn(tile, level)) continue;
      const at = [4 + (this.boxes[i + x] - x0) * size, 4 + (this.boxes[i + y] - y0) * size];
      const wide = (this.boxes[i + 3 + x] - this.boxes[i + x]) * size;
      const high = (this.boxes[i + 3 + y] - this.boxes[i + y]) * size;
      pen.fillStyle = (STATES[this.states[tile]] ?? STATES[1])[1];
      pen.fillRect(...at, wide, high);
      if (wide > 4 && high > 4) pen.strokeRect(...at, wide, high);
    }
  }

  async pick(e) {
    const bounds = this.canvas.getBoundingClientRect(), level = this.level();
    const { x, y, x0, y0, size } = this.scale();
    const px = (e.clientX - bounds.left) * this.canvas.width / bounds.width;
    const py = (e.clientY - bounds.top) * this.canvas.height / bounds.height;
    const at = [(px - 4) / size + x0, (py - 4) / size + y0];
    let found = -1;
    for (let tile = 0; tile < this.states.length; tile++) {
      const i = 6 * tile;
      if (this.boxes[i + x] <= at[0] && at[0] < this.boxes[i + 3 + x] && this.boxes[i + y] <= at[1] &&
          at[1] < this.boxes[i + 3 + y] && this.isIn(tile, level)) found = tile;
    }
    if (found < 0) return;
    const page = await attempt(() => call('Farm', 'ListTiles', { job: this.job, first: found, limit: 1 }));
    const tile = page?.tiles?.[0];
    if (!tile) return;
    const failures = (tile.failures ?? []).map((f) => `; failed on ${f.worker}: ${f.reason}`).join('');
    byId('map-tile').textContent = `tile ${tile.tile ?? 0}: ${tile.state.slice(11).toLowerCase().replace('_', ' ')}` +
      `${(tile.workers ?? []).length ? ` on ${tile.workers.join(', ')}` : ''}, ${tile.cellsDone ?? 0} of ${tile.cells ?? 0} cells, ` +
      `${tile.samples ?? 0} samples${tile.millis ? `, ${tile.millis} ms` : ''}${failures}`;
  }
}
