// The list of workers.
import { byId, duration, element, number, serverNow, short } from './words.mjs';

// The maximum number of rows. A page with thousands of rows is not useful.
const MOST_ROWS = 300;
let last = { workers: [], nowMs: 0 };

export function heardWorkers(message) {
  last = message;
  showWorkers();
}

export function showWorkers() {
  const wanted = byId('worker-filter').value.toLowerCase();
  const all = (last.workers ?? []).filter((w) => (w.name ?? '').toLowerCase().includes(wanted));
  const shown = all.slice(0, MOST_ROWS);
  byId('worker-count').textContent =
    shown.length < all.length ? `${all.length} workers, of which ${shown.length} are shown` : `${all.length} workers`;
  byId('worker-rows').replaceChildren(...shown.map((w) => workerRow(w, serverNow())));
}

function workerRow(w, now) {
  const does = (w.tiles ?? []).map((held) => {
    const of = `tile ${held.tile ?? 0} of job ${held.job}`;
    return held.hasBegun ? `${of} for ${duration(now - number(held.sinceMs))}, ${number(held.cells)} cells` : `waits with ${of}`;
  });
  if (w.helps) does.push(`helps with tile ${w.helps.tile ?? 0} of job ${w.helps.job}`);
  if (w.draining) does.push('accepts no further tiles');
  if (w.trouble) does.push(w.trouble);
  const busy = number(w.busyMillis);
  return element('tr', [
    element('td', w.name ?? ''),
    element('td', does.join('; ') || 'idle', w.trouble ? { class: 'bad' } : {}),
    element('td', `${number(w.tilesDone)}`, { class: 'number' }),
    element('td', busy > 0 ? short(number(w.samplesDone) * 1000 / busy) : '', { class: 'number' }),
    element('td', duration(now - number(w.connectedAtMs))),
    element('td', `${duration(now - number(w.heardAtMs))} ago`),
    element('td', (w.profiles ?? []).join(', ')),
    element('td', w.version ?? ''),
  ]);
}
