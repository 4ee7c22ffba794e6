// One job: its facts, the actions on it, and its events.
import { attempt, call, get } from './calls.mjs';
import { share, stateOf } from './jobs.mjs';
import { TileMap } from './map.mjs';
import { Timeline } from './timeline.mjs';
import { byId, clock, duration, element, number, short } from './words.mjs';

// The maximum number of listed events. The page lists the most recent events.
const MOST_EVENTS = 200;
// The maximum number of pages of earlier events, which suffices for all events in a coordinator's memory.
const MOST_PAGES = 60;
const TROUBLE = ['FAILED', 'TAKEN_BACK', 'SET_ASIDE', 'CONFLICT'];

// Returns the method of a job's specification, and its grid of cells if it has one.
function described(spec) {
  if (spec.ambient) return { method: 'ambient occlusion' };
  const { aggressive, exact, portals } = spec.visibility ?? {};
  const { lines, guided, cubes } = (exact ?? aggressive)?.sampling ?? {};
  const bounded = exact?.effort === 'EFFORT_BOUNDED';
  const method = portals ? 'portals' : exact ? (bounded ? 'verified' : 'exact') : 'aggressive';
  return { method, grid: (portals ?? lines ?? guided ?? cubes)?.grid };
}

export class JobPage {
  constructor() {
    this.map = new TileMap();
    this.time = new Timeline();
    this.events = [];
    this.buttons = '';
    byId('trouble-only').addEventListener('change', () => this.list());
  }

  async show(id) {
    this.id = id;
    this.job = undefined;
    this.events = [];
    this.buttons = '';
    this.time.clear();
    byId('job-title').textContent = `Job ${id}`;
    await this.map.show(id);
    // Load the events from before the start of the stream.
    for (let after = 0, pages = 0; pages < MOST_PAGES; pages++) {
      const page = await attempt(() => get(`events/${id}?after=${after}`));
      if (!page || this.id !== id || page.events.length === 0) return;
      page.events.forEach((event) => this.take(event));
      after = page.next;
    }
  }

  // Adds an event, unless the page knows it already.
  take(event) {
    if (number(event.number) <= this.time.seen) return;
    this.time.heard(event);
    if ((event.kind ?? '').slice(11) !== 'ROUND') this.events.push(event);
    if (this.events.length > 10000) this.events = this.events.slice(-5000);
  }

  // Processes a message about the job.
  heard(message) {
    if (message.failure) {
      byId('job-state').textContent = message.failure;
      return;
    }
    const first = this.job === undefined;
    this.job = message.job;
    if (first) {
      byId('map-up').value = this.job.spec?.visibility?.up === 'UP_Z' ? 2 : 1;
      this.map.layers();
    }
    this.map.heard(message.tiles);
    message.events.forEach((event) => this.take(event));
    this.facts();
    this.offer();
    this.list();
    this.time.draw(number(this.job.finishedAtMs) > 0, number(this.job.nowMs));
  }

  facts() {
    const job = this.job, state = stateOf(job), now = number(job.nowMs), end = number(job.finishedAtMs);
    byId('job-title').textContent = `Job ${this.id}: ${job.name ?? ''}`;
    const left = job.leftMillis === undefined ? '' : `, about ${duration(number(job.leftMillis))} left`;
    byId('job-state').textContent = `${state}${job.reason ? `: ${job.reason}` : ''}${left}`;
    byId('job-progress').value = share(job);
    const { method, grid } = described(job.spec ?? {});
    const facts = {
      'Tiles': `${number(job.tilesDone)} of ${number(job.tilesTotal)} done, ${number(job.tilesRunning)} at work` +
        (number(job.tilesSetAside) ? `, ${job.tilesSetAside} SET ASIDE` : ''),
      'Cells': `${number(job.cellsDone)}${number(job.cellsTotal) ? ` of ${job.cellsTotal}` : ''}` +
        (grid ? ` (${grid.x}×${grid.y}×${grid.z})` : ''),
      'Samples': short(number(job.samples)),
      'Work': `${duration(number(job.tileMillis))} on finished tiles`,
      'Submitted': `${new Date(number(job.submittedAtMs)).toLocaleString()}${job.user ? ` by ${job.user}` : ''}`,
      'Took': duration((end || now) - number(job.submittedAtMs)),
      'Method': method,
      'Backend': job.profile || 'not chosen yet',
    };
    if (number(job.resultBytes)) facts.Result = `${short(number(job.resultBytes))}B`;
    for (const team of (job.teams ?? []).slice(0, 8)) {
      const name = `Tile ${team.tile ?? 0}`, before = facts[name] ? `${facts[name]}; ` : '';
      facts[name] = `${before}${team.leader}${team.hasBegun ? '' : ' (has not begun)'}` +
        (team.helpers?.length ? `, helped by ${team.helpers.join(', ')}` : '');
    }
    for (const unable of job.unable ?? []) facts[`Cannot help: ${unable.names.join(', ')}`] = unable.reason;
    byId('job-facts').replaceChildren(...Object.entries(facts).flatMap(([name, text]) =>
      [element('dt', name), element('dd', text)]));
  }

  // Shows the actions that the job's state allows.
  offer() {
    const state = stateOf(this.job), open = ['queued', 'running', 'paused'].includes(state);
    const some = number(this.job.tilesDone) > 0, aside = number(this.job.tilesSetAside) > 0;
    const now = `${state} ${some} ${aside}`;
    // Keep the buttons, because the user may be about to press one.
    if (this.buttons === now) return;
    this.buttons = now;
    const button = (text, method, request = {}, question = null) => {
      const made = element('button', text, { 'data-call': method });
      made.addEventListener('click', () => {
        if (question && !confirm(question)) return;
        attempt(async () => {
          await call('Jobs', method, { job: this.id, ...request });
          if (method === 'Delete') location.hash = 'jobs';
        });
      });
      return made;
    };
    const all = [];
    if (state === 'queued' || state === 'running') {
      all.push(button('Pause', 'Pause'), button('Pause and stop tiles at work', 'Pause', { now: true }));
    }
    if (state === 'paused') all.push(button('Resume', 'Resume'));
    if (open) {
      all.push(button('Cancel', 'Cancel', {}, `Cancel job ${this.id}? Its finished tiles are kept for a retry.`));
      const input = element('input', '', { type: 'number', min: -1000, max: 1000, value: number(this.job.priority) });
      input.addEventListener('change', () =>
        attempt(() => call('Jobs', 'Prioritize', { job: this.id, priority: Number(input.value) })));
      all.push(element('label', ['Priority ', input]));
    }
    if (state === 'failed' || state === 'cancelled' || (state === 'done' && aside)) all.push(button('Retry', 'Retry'));
    if (!open) all.push(button('Delete', 'Delete', {}, `Delete job ${this.id} and its result?`));
    if (some) {
      const what = state === 'done' ? 'the result' : 'the finished tiles';
      all.push(element('a', `View ${what}`, { href: `view/${this.id}`, target: '_blank' }));
      all.push(element('a', `Download ${what}`, { href: `results/${this.id}.pvs`, download: `job-${this.id}.pvs` }));
    }
    byId('job-buttons').replaceChildren(...all);
  }

  list() {
    const kind = (event) => (event.kind ?? '').slice(11), only = byId('trouble-only').checked;
    const wanted = this.events.filter((event) => !only || TROUBLE.includes(kind(event)));
    byId('events').replaceChildren(...wanted.slice(-MOST_EVENTS).reverse().map((event) => element('li', [
      element('time', clock(number(event.atMs))),
      element('span', event.text ?? '', TROUBLE.includes(kind(event)) ? { class: 'bad' } : {}),
    ])));
  }
}
