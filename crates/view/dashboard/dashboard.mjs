// The page: selects the visible part, and opens the stream with the data of this part.
import { complain } from './calls.mjs';
import { JobPage } from './job.mjs';
import { heardJobs, showJobs } from './jobs.mjs';
import { heardWorkers, showWorkers } from './workers.mjs';
import { byId, setClock } from './words.mjs';

const page = new JobPage();
let source;

// Shows the part in the address: jobs, workers, or job=7.
function go() {
  const [part, id] = location.hash.slice(1).split('=');
  const shown = part === 'job' && /^[1-9][0-9]*$/.test(id ?? '') ? 'job' : part === 'workers' ? 'workers' : 'jobs';
  for (const name of ['jobs', 'job', 'workers']) byId(name).hidden = name !== shown;
  if (source) source.close();
  const query = shown === 'job' ? `?job=${Number(id)}` : shown === 'workers' ? '?workers=true' : '';
  const current = new EventSource(`live${query}`);
  source = current;
  current.addEventListener('open', () => complain());
  current.addEventListener('error', () => {
    complain('The coordinator does not answer; connecting again.');
    // A browser does not retry after an answer that is not a stream.
    if (current.readyState === EventSource.CLOSED) setTimeout(() => { if (source === current) go(); }, 3000);
  });
  current.addEventListener('clock', (e) => { setClock(Number(e.data)); showJobs(); });
  current.addEventListener('jobs', (e) => heardJobs(JSON.parse(e.data)));
  current.addEventListener('workers', (e) => heardWorkers(JSON.parse(e.data)));
  if (shown === 'job') {
    const ready = page.show(Number(id));
    // The first message contains all tiles, so load their positions before.
    current.addEventListener('job', (e) => ready.then(() => source === current && page.heard(JSON.parse(e.data))));
  }
}

byId('worker-filter').addEventListener('input', showWorkers);
setInterval(showJobs, 30000);
addEventListener('hashchange', go);
go();
