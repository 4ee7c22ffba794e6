//! The farm of a coordinator: its workers, the tiles of jobs, events, and the invalidation of tiles.

use futures::StreamExt as _;
use sightline_proto::v1;
use sightline_proto::v1::farm_client::FarmClient;

use super::Client;
use crate::error::Error;
use crate::observer::Observer;

/// Maximum number of tiles in the answer to one request.
const TILES_AT_ONCE: u32 = 10_000;

/// The connected workers of a coordinator, and its quarantined workers.
pub type WorkerList = v1::ListWorkersResponse;

/// The filter of the tiles to compute again: by job, worker and time.
pub type Invalidation = v1::InvalidateRequest;

impl Client {
    /// Lists the connected workers and the quarantined ones.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call.
    pub fn workers(&self, observer: &dyn Observer) -> Result<WorkerList, Error> {
        self.run(observer, async |connection| {
            let answer = FarmClient::new(connection)
                .list_workers(v1::ListWorkersRequest {})
                .await;
            Ok(answer.map_err(|s| Error::status(&s))?.into_inner())
        })
    }

    /// Releases a worker from quarantine, by its name or its signature. Returns false if the worker was not
    /// quarantined.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call.
    pub fn release_worker(&self, worker: &str, observer: &dyn Observer) -> Result<bool, Error> {
        let request = v1::ReleaseWorkerRequest {
            worker: worker.to_owned(),
        };
        self.run(observer, async |connection| {
            let answer = FarmClient::new(connection).release_worker(request).await;
            let answer = answer.map_err(|s| Error::status(&s))?.into_inner();
            Ok(answer.was_quarantined)
        })
    }

    /// Reopens finished tiles whose outputs you no longer trust, so that workers compute them again. Returns
    /// the jobs of these tiles, each with the number of reopened tiles.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call.
    pub fn invalidate(
        &self,
        tiles: Invalidation,
        observer: &dyn Observer,
    ) -> Result<Vec<v1::InvalidatedJob>, Error> {
        self.run(observer, async |connection| {
            let answer = FarmClient::new(connection).invalidate(tiles).await;
            Ok(answer.map_err(|s| Error::status(&s))?.into_inner().jobs)
        })
    }

    /// Passes the tiles of a job to `take`, in several batches in ascending order of the tile numbers.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call, or the
    /// errors of `take`.
    pub fn tiles(
        &self,
        job: u64,
        take: &mut dyn FnMut(Vec<v1::TileInfo>) -> Result<(), Error>,
        observer: &dyn Observer,
    ) -> Result<(), Error> {
        self.run(observer, async |connection| {
            let mut farm = FarmClient::new(connection);
            let mut first = 0;
            loop {
                let request = v1::ListTilesRequest {
                    job,
                    first,
                    limit: TILES_AT_ONCE,
                    states: Vec::new(),
                };
                let page = farm.list_tiles(request).await;
                let page = page.map_err(|s| Error::status(&s))?.into_inner();
                take(page.tiles)?;
                first = page.next;
                if first == 0 {
                    return Ok(());
                }
            }
        })
    }

    /// Passes the events of the coordinator to `take`, and also later events if `request.follow` is true.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Coordinator`] if the coordinator cannot be reached or rejects the call, or the
    /// errors of `take`.
    pub fn events(
        &self,
        request: v1::EventsRequest,
        take: &mut dyn FnMut(v1::Event) -> Result<(), Error>,
        observer: &dyn Observer,
    ) -> Result<(), Error> {
        self.run(observer, async |connection| {
            let events = FarmClient::new(connection).events(request).await;
            let mut events = events.map_err(|s| Error::status(&s))?.into_inner();
            while let Some(event) = events.next().await {
                take(event.map_err(|s| Error::status(&s))?)?;
            }
            Ok(())
        })
    }
}
