// The work of the workers on a job, as bars over time.
import { byId, clock, duration, number } from './words.mjs';

// The maximum number of drawn bars. The page draws the most recent bars.
const MOST_BARS = 50000;
const COLORS = { done: '#2e9e5b', failed: '#c0392b', taken: '#e0b34d', open: '#2f7ed8' };
// The events after which no worker computes a tile of the job.
const STOPS = /^(the job (is cancelled|is done|has failed)|tiles at work are stopped)/;
const LEFT = 140, FOOT = 18;

export class Timeline {
  constructor() {
    this.canvas = byId('time');
    this.clear();
  }

  clear() {
    this.bars = [];
    this.open = new Map();
    this.rounds = [];
    this.first = Infinity;
    this.last = 0;
    this.seen = 0;
  }

  // Processes an event.
  heard(event) {
    this.seen = Math.max(this.seen, number(event.number));
    const at = number(event.atMs), kind = (event.kind ?? '').slice(11), tile = event.tile ?? -1;
    this.first = Math.min(this.first, at);
    this.last = Math.max(this.last, at);
    const key = `${tile} ${event.worker ?? ''}`;
    if (kind === 'LEASED') {
      this.close((bar) => bar.tile === tile && bar.worker === event.worker, at, 'taken');
      this.open.set(key, { tile, worker: event.worker ?? '', from: at });
    } else if (kind === 'DONE' || kind === 'FAILED' || kind === 'TAKEN_BACK') {
      const how = { DONE: 'done', FAILED: 'failed', TAKEN_BACK: 'taken' }[kind];
      // If a worker has disconnected, its name may be unknown.
      this.close((bar) => bar.tile === tile && (!event.worker || bar.worker === event.worker), at, how);
      // A tile that two workers computed is finished for both.
      if (kind === 'DONE') this.close((bar) => bar.tile === tile, at, 'taken');
    } else if (kind === 'ROUND') {
      for (const bar of this.open.values()) {
        if (bar.tile === tile) this.rounds.push({ worker: bar.worker, at });
      }
      if (this.rounds.length > 2 * MOST_BARS) this.rounds = this.rounds.slice(-MOST_BARS);
    } else if (kind === 'JOB' && STOPS.test(event.text ?? '')) {
      this.close(() => true, at, 'taken');
    }
  }

  // Ends the open bars for which `which` returns true. `how` is the key of their colour.
  close(which, at, how) {
    for (const [key, bar] of this.open) {
      if (which(bar)) {
        this.open.delete(key);
        this.bars.push({ ...bar, to: at, how });
      }
    }
    if (this.bars.length > 2 * MOST_BARS) this.bars = this.bars.slice(-MOST_BARS);
  }

  draw(isOver, now) {
    const end = isOver ? this.last : Math.max(this.last, now), start = this.first;
    const open = isOver ? [] : [...this.open.values()].map((bar) => ({ ...bar, to: end, how: 'open' }));
    const bars = [...this.bars.slice(-MOST_BARS), ...open];
    const names = [...new Set(bars.map((bar) => bar.worker))].sort();
    const rows = new Map(names.map((name, row) => [name, row]));
    const high = Math.max(1, Math.min(16, Math.floor(1600 / Math.max(1, names.length))));
    this.canvas.width = 960;
    this.canvas.height = Math.max(60, names.length * high + FOOT);
    const pen = this.canvas.getContext('2d'), wide = this.canvas.width - LEFT - 8;
    const x = (at) => LEFT + wide * (at - start) / Math.max(1, end - start);
    for (const bar of bars) {
      pen.fillStyle = COLORS[bar.how];
      const row = rows.get(bar.worker);
      pen.fillRect(x(bar.from), row * high, Math.max(1, x(bar.to) - x(bar.from)), Math.max(1, high - 1));
    }
    pen.fillStyle = '#000a';
    if (high >= 8) {
      for (const { worker, at } of this.rounds.slice(-MOST_BARS)) {
        if (rows.has(worker)) pen.fillRect(x(at), rows.get(worker) * high, 1, high - 1);
      }
    }
    pen.fillStyle = getComputedStyle(document.body).color;
    pen.font = '11px system-ui, sans-serif';
    if (high >= 10) names.forEach((name, row) => pen.fillText(name.slice(0, 22), 2, row * high + high - 4, LEFT - 6));
    const foot = this.canvas.height - 5;
    if (Number.isFinite(start)) {
      pen.fillText(clock(start), LEFT, foot);
      pen.fillText(clock(end), LEFT + wide - 60, foot);
    }
    byId('time-note').textContent = bars.length === 0 ? 'No tile was leased yet, or the page has no events from that time.' :
      `${names.length} ${names.length === 1 ? 'worker' : 'workers'} over ${duration(end - start)}: green bars are finished tiles, blue bars are tiles at work, ` +
      'yellow bars are tiles that were taken back, red bars are failed tiles; black marks end a phase.';
  }
}
