// The list of jobs.
import { byId, duration, element, number, serverNow } from './words.mjs';

const listed = new Map();

export const stateOf = (job) => (job.state ?? 'JOB_STATE_UNSPECIFIED').slice(10).toLowerCase();

// Returns the finished share of a job: the share of its cells if their number is known, otherwise of its
// tiles.
export function share(job) {
  const cells = number(job.cellsTotal);
  if (stateOf(job) === 'done') return 1;
  if (cells > 0) return Math.min(1, number(job.cellsDone) / cells);
  const tiles = number(job.tilesTotal);
  return tiles > 0 ? (number(job.tilesDone) + number(job.tilesSetAside)) / tiles : 0;
}

// Processes a message about jobs.
export function heardJobs(message) {
  if (message.whole) listed.clear();
  for (const job of message.jobs) listed.set(number(job.id), job);
  for (const id of message.gone) listed.delete(id);
  byId('farm').textContent = `${message.workers} ${message.workers === 1 ? 'worker' : 'workers'}`;
  byId('older').hidden = !message.older;
  byId('no-jobs').hidden = listed.size > 0;
  showJobs();
}

// The ages of jobs grow without messages, so this also runs on a timer.
export function showJobs() {
  const ids = [...listed.keys()].sort((a, b) => b - a);
  byId('job-rows').replaceChildren(...ids.map((id) => row(listed.get(id), serverNow())));
}

function row(job, now) {
  const id = number(job.id), state = stateOf(job), aside = number(job.tilesSetAside);
  const tiles = `${number(job.tilesDone)}/${number(job.tilesTotal)}`;
  const bar = element('progress', '', { max: 1, value: share(job) });
  const end = number(job.finishedAtMs);
  const cells = [
    element('td', element('a', `${id}`, { href: `#job=${id}` })),
    element('td', job.name ?? ''),
    element('td', job.user ?? ''),
    element('td', aside > 0 ? `${state}, ${aside} ${aside === 1 ? 'tile' : 'tiles'} set aside` : state,
      state === 'failed' || aside > 0 ? { class: 'bad' } : {}),
    element('td', [bar, ` ${tiles}`]),
    element('td', job.leftMillis === undefined ? '' : `about ${duration(number(job.leftMillis))}`),
    element('td', duration(now - (end || number(job.submittedAtMs)))),
    element('td', `${number(job.priority)}`, { class: 'number' }),
  ];
  const made = element('tr', cells, { class: 'open' });
  made.addEventListener('click', () => { location.hash = `job=${id}`; });
  return made;
}
