// The page: which part is shown, and the stream that feeds it.
import { complain } from './calls.mjs';
import { JobPage } from './job.mjs';
import { heardJobs } from './jobs.mjs';
import { heardWorkers, showWorkers } from './workers.mjs';
import { byId } from './words.mjs';

const page = new JobPage();
let source;

// Shows the part that the address names: jobs, workers, or job=7.
function go() {
  const [part, id] = location.hash.slice(1).split('=');
  const shown = part === 'job' && Number(id) > 0 ? 'job' : part === 'workers' ? 'workers' : 'jobs';
  for (const name of ['jobs', 'job', 'workers']) byId(name).hidden = name !== shown;
  if (source) source.close();
  const query = shown === 'job' ? `?job=${Number(id)}` : shown === 'workers' ? '?workers=true' : '';
  const current = new EventSource(`live${query}`);
  source = current;
  current.addEventListener('open', () => complain());
  current.addEventListener('error', () => complain('The coordinator does not answer; connecting again.'));
  current.addEventListener('jobs', (e) => heardJobs(JSON.parse(e.data)));
  current.addEventListener('workers', (e) => heardWorkers(JSON.parse(e.data)));
  if (shown === 'job') {
    const ready = page.show(Number(id));
    // The first message has all tiles; their places come first.
    current.addEventListener('job', (e) => ready.then(() => source === current && page.heard(JSON.parse(e.data))));
  }
}

byId('worker-filter').addEventListener('input', showWorkers);
addEventListener('hashchange', go);
go();
