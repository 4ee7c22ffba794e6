//! A job with its coordinator: waiting for the job, changing it, and downloading its result.

use std::path::Path;

use sightline_proto::connection::Connection;
use sightline_proto::v1;
use sightline_proto::v1::jobs_client::JobsClient;

use super::job::Job;
use super::{Client, follow_across_restarts, transfer};
use crate::error::Error;
use crate::observer::{Observer, warn};
use crate::output::{Format, Output};

/// A change of a job's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JobAction {
    /// Ends the job. [`JobAction::Retry`] reuses the finished tiles of the job.
    Cancel,
    /// Pauses the job: the coordinator leases no more of its tiles.
    Pause {
        /// True to stop the running tiles, too.
        now: bool,
    },
    /// Continues a paused job.
    Resume,
    /// Continues a failed or cancelled job, or bakes again the tiles that a finished job has set aside.
    Retry,
    /// Removes an ended job and its result.
    Delete,
}

/// A job with the client of its coordinator.
///
/// ```no_run
/// use sightline::{Client, Endpoint, JobAction, Silent};
///
/// let client = Client::new(Endpoint::new("http://127.0.0.1:7600"))?;
/// let mut handle = client.job(7, &Silent)?;
/// handle.act(JobAction::Pause { now: true }, &Silent)?;
/// handle.act(JobAction::Resume, &Silent)?;
/// println!("{}", handle.wait(&Silent)?.state_name());
/// # Ok::<(), sightline::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct JobHandle<'c> {
    client: &'c Client,
    job: Job,
    existing: bool,
}

impl<'c> JobHandle<'c> {
    /// Creates the handle of a job.
    pub(crate) fn new(client: &'c Client, job: Job, existing: bool) -> Self {
        Self {
            client,
            job,
            existing,
        }
    }

    /// Returns the client.
    pub(crate) fn client(&self) -> &'c Client {
        self.client
    }

    /// Returns the job in its last known state.
    pub fn job(&self) -> &Job {
        &self.job
    }

    /// Returns true if the coordinator had the job before the submission.
    pub fn is_existing(&self) -> bool {
        self.existing
    }

    /// Requests the current state of the job.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call.
    pub fn refresh(&mut self, observer: &dyn Observer) -> Result<&Job, Error> {
        let job = self.client.job(self.job.id(), observer)?.job;
        Ok(self.update(job))
    }

    fn update(&mut self, job: Job) -> &Job {
        self.job = job;
        &self.job
    }

    /// Waits until the job ends, regardless of the number of coordinator restarts in between. Returns the
    /// job's last state. If the observer cancels, the waiting ends, but the job continues.
    /// [`Job::ensure_done`] checks that the job has a result.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call, or
    /// [`crate::ErrorKind::Cancelled`] if the observer cancels.
    pub fn wait(&mut self, observer: &dyn Observer) -> Result<&Job, Error> {
        let (client, id) = (self.client, self.job.id());
        let ended = client.run(observer, async |connection| {
            let jobs = JobsClient::new(connection);
            follow_across_restarts(jobs, client.endpoint(), id, observer).await
        })?;
        Ok(self.update(ended))
    }

    /// Changes the state of the job.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached, or the job's state does not
    /// permit the change.
    pub fn act(&mut self, action: JobAction, observer: &dyn Observer) -> Result<&Job, Error> {
        let job = self.client.act(self.job.id(), action, observer)?;
        Ok(self.update(job))
    }

    /// Changes the priority of the job, -1000 to 1000.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call.
    pub fn prioritize(&mut self, priority: i32, observer: &dyn Observer) -> Result<&Job, Error> {
        let job = self.client.prioritize(self.job.id(), priority, observer)?;
        Ok(self.update(job))
    }

    /// Downloads the result of a finished job to a file. Returns the size of the file in bytes. The file
    /// appears only when it is complete, and replaces only a file of the same format.
    ///
    /// # Errors
    /// As for [`Client::fetch`].
    pub fn fetch(&self, path: &Path, observer: &dyn Observer) -> Result<u64, Error> {
        self.client.fetch(self.job.id(), path, observer)
    }
}

impl Client {
    /// Changes the state of the job with this number. Returns the job.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached, or the job's state does not
    /// permit the change.
    pub fn act(
        &self,
        number: u64,
        action: JobAction,
        observer: &dyn Observer,
    ) -> Result<Job, Error> {
        let request = v1::ShowRequest { job: number };
        let changed = self.call(observer, async |client| match action {
            JobAction::Cancel => client.cancel(request).await,
            JobAction::Pause { now } => {
                let request = v1::PauseRequest { job: number, now };
                client.pause(request).await
            }
            JobAction::Resume => client.resume(request).await,
            JobAction::Retry => client.retry(request).await,
            JobAction::Delete => client.delete(request).await,
        });
        Ok(changed?.into())
    }

    /// Changes the priority of the job with this number, -1000 to 1000. Returns the job.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call.
    pub fn prioritize(
        &self,
        number: u64,
        priority: i32,
        observer: &dyn Observer,
    ) -> Result<Job, Error> {
        let request = v1::PrioritizeRequest {
            job: number,
            priority,
        };
        let changed = self.call(observer, async |client| client.prioritize(request).await);
        Ok(changed?.into())
    }

    /// Downloads the result of a finished job to a file. Returns the size of the file in bytes. The file
    /// appears only when it is complete, and replaces only a file of the same format.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Job`] if the job has no result, [`crate::ErrorKind::Usage`] if the path cannot be
    /// written, or [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the
    /// call.
    pub fn fetch(&self, number: u64, path: &Path, observer: &dyn Observer) -> Result<u64, Error> {
        let output = Output::check(path, Format::Pvs, None)?;
        self.download(number, observer, async |client, job| {
            job.ensure_done()?;
            transfer::fetch(client, job, &output).await
        })
    }

    /// Downloads the partial result of a job to a file. Returns the size of the file in bytes. The sets of
    /// unfinished cells contain every triangle, as undecided.
    ///
    /// # Errors
    /// As for [`Self::fetch`].
    pub fn fetch_partial(
        &self,
        number: u64,
        path: &Path,
        observer: &dyn Observer,
    ) -> Result<u64, Error> {
        let output = Output::check(path, Format::Pvs, None)?;
        self.download(number, observer, async |client, job| {
            if job.is_done() {
                return transfer::fetch(client, job, &output).await;
            }
            let bytes = transfer::fetch_partial(client, job, &output).await?;
            let (done, total) = (job.message().tiles_done, job.message().tiles_total);
            warn(
                observer,
                format!(
                    "job {number} has not ended: this result contains {done} of {total} tiles; the sets \
                     of all other cells contain every triangle"
                ),
            );
            Ok(bytes)
        })
    }

    /// Requests the current state of a job and passes the state to `download`, which returns a size in bytes.
    ///
    /// Returns an error for a job that computes ambient occlusion, because its result has no sets.
    fn download(
        &self,
        number: u64,
        observer: &dyn Observer,
        download: impl AsyncFnOnce(&mut JobsClient<Connection>, &Job) -> Result<u64, Error>,
    ) -> Result<u64, Error> {
        self.run(observer, async |connection| {
            let mut client = JobsClient::new(connection);
            let job = client.show(v1::ShowRequest { job: number }).await;
            let job = Job::from(job.map_err(|s| Error::status(&s))?.into_inner());
            if job.has_receivers() {
                return Err(Error::usage(format!(
                    "job {number} computes ambient occlusion and has no sets; the client that submitted \
                     the job downloads its result"
                )));
            }
            download(&mut client, &job).await
        })
    }
}
