//! Binding a job to the numerics profile with which its tiles are computed.

use sightline_model::{NO_PROFILE, TracerChoice};
use sightline_records::ids::{JobId, WorkerId};

use super::event::{Effect, Note, StoreCommand};
use super::failures::MAX_ATTEMPTS;
use super::job::Parked;
use super::messages::{Now, ProfileTime, WorkerCommand};
use super::profile_choice::{Binding, CLEARLY, fastest, profile_for};
use super::state::{Scheduler, Timer};

/// Time limit for a worker to time its backends before another worker times its own, in milliseconds.
const TIMING_LIMIT: u64 = 300_000;
/// The time for which a job waits for more workers before it is bound, in milliseconds. A job waits if the
/// connected workers could bind it to different profiles.
const MORE_WORKERS: u64 = 1000;

impl Scheduler {
    /// Takes one step towards a numerics profile for the first unbound job that an idle worker could compute.
    ///
    /// The step binds the job, starts a measurement of the worker's backends, or lets the job wait for more
    /// workers. Returns false if no such job exists.
    pub(super) fn bind_one(&mut self, now: Now) -> bool {
        for choice in 0..self.queues.pools.unbound.len() {
            let Some(&worker) = self.queues.pools.hungry[choice].first() else {
                continue;
            };
            let Some(&(_, id)) = self.queues.pools.unbound[choice].first() else {
                continue;
            };
            self.bind(id, worker, now);
            return true;
        }
        false
    }

    /// Binds a job if only one profile is possible. Otherwise starts a measurement of the worker's backends,
    /// or lets the job wait for more workers.
    fn bind(&mut self, id: JobId, worker: WorkerId, now: Now) {
        let Some(choice) = self.jobs.get(&id).map(|j| j.planned.spec().tracer()) else {
            return;
        };
        let Some(w) = self.roster.workers.get(&worker) else {
            return;
        };
        let profiles: Vec<String> = w.profiles.iter().map(|p| p.to_string()).collect();
        match profile_for(choice, &profiles) {
            Binding::Bind(_) => match self.candidates(choice).as_slice() {
                [(only, _)] => self.ask_to_bind(id, only.clone()),
                _ => self.park(
                    id,
                    Parked::Binding(now.ms + MORE_WORKERS),
                    now.ms + MORE_WORKERS,
                ),
            },
            Binding::Time => {
                let Some(job) = self.jobs.get(&id) else {
                    return;
                };
                let planned = std::sync::Arc::clone(&job.planned);
                self.effects.push(Effect::Tell(
                    worker,
                    WorkerCommand::Time { job: id, planned },
                ));
                if let Some(w) = self.roster.workers.get_mut(&worker) {
                    w.timing.insert(id);
                }
                self.park(id, Parked::Timing(worker), now.ms + TIMING_LIMIT);
            }
            // Unreachable: the lists of hungry workers contain only workers that can serve the choice.
            Binding::Cannot => self.park(
                id,
                Parked::Binding(now.ms + MORE_WORKERS),
                now.ms + MORE_WORKERS,
            ),
        }
    }

    /// Returns the profiles that a job with this tracer choice can be bound to without timing.
    ///
    /// Each profile is returned with the number of connected workers that support it.
    fn candidates(&self, choice: Option<TracerChoice>) -> Vec<(String, u64)> {
        let votes = |(profile, pool): (&super::pools::Profile, &super::pools::Pool)| {
            let votes = match choice {
                Some(TracerChoice::Auto) => pool.alone,
                Some(choice) if choice.accepts(profile) => pool.able,
                None if &**profile == NO_PROFILE => pool.able,
                Some(_) | None => 0,
            };
            (votes > 0).then(|| (profile.to_string(), votes))
        };
        self.queues
            .pools
            .by_profile
            .iter()
            .filter_map(votes)
            .collect()
    }

    fn ask_to_bind(&mut self, id: JobId, profile: String) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.pending = true;
            self.effects
                .push(Effect::Run(StoreCommand::Bind(id, profile)));
            self.list_job(id);
        }
    }

    fn park(&mut self, id: JobId, parked: Parked, until: u64) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.parked = Some(parked);
            self.set_timer(until, Timer::Parked(id));
            self.list_job(id);
        }
    }

    /// Ends the wait of a job if the job waits for the reason `parked`.
    pub(super) fn unpark(&mut self, id: JobId, parked: Parked) {
        if let Some(job) = self.jobs.get_mut(&id)
            && job.parked == Some(parked)
        {
            job.parked = None;
            self.list_job(id);
        }
    }

    /// Ends the wait of a job whose time has passed. After a wait for more workers, binds the job to the
    /// profile that most workers support. After a timing without an answer, another worker can time its
    /// backends.
    pub(super) fn parked_timer(&mut self, id: JobId, now: Now) {
        let Some(job) = self.jobs.get(&id) else {
            return;
        };
        let (parked, choice) = (job.parked, job.planned.spec().tracer());
        match parked {
            Some(Parked::Timing(worker)) => {
                if let Some(w) = self.roster.workers.get_mut(&worker) {
                    w.timing.remove(&id);
                }
                self.unpark(id, Parked::Timing(worker));
            }
            Some(Parked::Binding(until)) if until <= now.ms => {
                self.unpark(id, Parked::Binding(until));
                let most = self
                    .candidates(choice)
                    .into_iter()
                    .rev()
                    .max_by_key(|(_, votes)| *votes);
                if let Some((profile, _)) = most {
                    self.ask_to_bind(id, profile);
                }
            }
            _ => {}
        }
    }

    /// Records that the store has bound a job.
    pub(super) fn bound(&mut self, id: JobId, profile: String) {
        if let Some(job) = self.jobs.get_mut(&id) {
            job.pending = false;
            job.record.profile = Some(profile);
            self.list_job(id);
            self.tell_watchers(id);
        }
    }

    /// Binds a job to the fastest backend that a worker has timed for it.
    ///
    /// After [`MAX_ATTEMPTS`] timings without a usable backend, the job fails.
    pub(super) fn timed(&mut self, number: WorkerId, id: JobId, times: &[ProfileTime]) {
        let Some(worker) = self.roster.workers.get_mut(&number) else {
            return;
        };
        // Only the answer of a worker that received a timing command counts, and only while the job is not
        // bound.
        if !worker.timing.remove(&id) {
            return;
        }
        let offers = |t: &&ProfileTime| worker.profiles.iter().any(|p| **p == *t.profile);
        let offered: Vec<ProfileTime> = times.iter().filter(offers).cloned().collect();
        let Some(job) = self.jobs.get_mut(&id) else {
            return;
        };
        if job.parked != Some(Parked::Timing(number)) || job.record.profile.is_some() {
            return;
        }
        job.parked = None;
        let Some(fastest) = fastest(&offered) else {
            job.timing_faults += 1;
            if job.timing_faults >= MAX_ATTEMPTS {
                let reason = "no worker that timed its backends can sample this scene; see the workers' \
                              logs";
                self.fail_job(id, reason.to_owned());
            }
            self.list_job(id);
            return;
        };
        let each: Vec<String> = offered
            .iter()
            .map(|t| format!("{} {:.2} ms per cube", t.profile, t.seconds_per_cube * 1e3))
            .collect();
        let chosen = format!(
            "{}; chosen: {} (auto chooses a hardware gpu only if it is {CLEARLY} times as fast as the cpu)",
            each.join(", "),
            fastest.profile
        );
        self.note(Note::Chosen(id, chosen));
        self.ask_to_bind(id, fastest.profile.clone());
    }
}
