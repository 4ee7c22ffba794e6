//! The `Farm` service: workers, tiles and events, for display.

use std::pin::Pin;
use std::sync::Arc;
use std::time::Duration;

use futures::Stream;
use prost::Message as _;
use sightline_proto::v1;
use sightline_records::ids::{JobId, TileIndex};
use sightline_store::StoreError;
use sightline_store::TileFilter;
use tokio::sync::mpsc;
use tonic::{Request, Response, Status};

use super::authorize::{caller, own_job};
use super::blocking::blocking;
use super::{Answer, status, wire};
use crate::coordinator::Coordinator;
use crate::jobs::invalidate;
use crate::jobs::tiles;
use crate::records::JobChanges;
use crate::workers::quarantine;

/// Maximum number of tiles in an answer.
const MOST_TILES: u32 = 10_000;
/// Maximum size of the tiles in an answer, in bytes, for messages of at most 4 MiB.
const MOST_BYTES: usize = 3 << 20;
/// The number of events that are read at a time.
const EVENTS_AT_ONCE: usize = 256;

/// Maximum time for which a client may leave an event unread.
const LONGEST_UNREAD: Duration = Duration::from_secs(60);

/// Serves [`v1::farm_server::Farm`].
pub(crate) struct FarmService(pub(crate) Arc<Coordinator>);

#[tonic::async_trait]
impl v1::farm_server::Farm for FarmService {
    async fn list_workers(
        &self,
        _: Request<v1::ListWorkersRequest>,
    ) -> Answer<v1::ListWorkersResponse> {
        let now = self.0.scheduler_now();
        let roster = self.0.dispatcher.read(|scheduler| scheduler.roster(now));
        let workers = roster.into_iter().map(wire::member).collect();
        let quarantined = blocking(&self.0, |c| {
            c.records.quarantined().map_err(|e| status::of_store(&e))
        })
        .await?;
        let quarantined = quarantined.into_iter().map(wire::quarantined).collect();
        Ok(Response::new(v1::ListWorkersResponse {
            workers,
            now_ms: now.unix_ms,
            quarantined,
        }))
    }

    async fn list_tiles(&self, r: Request<v1::ListTilesRequest>) -> Answer<v1::ListTilesResponse> {
        let job = own_job(&self.0, &r, r.get_ref().job).await?;
        let r = r.into_inner();
        let most = match r.limit {
            0 => MOST_TILES,
            limit @ 1..=MOST_TILES => limit,
            more => {
                return Err(Status::invalid_argument(format!(
                    "{more} tiles were requested; request at most {MOST_TILES} at once"
                )));
            }
        };
        let states = r
            .states()
            .map(wire::tile_status)
            .collect::<Result<Vec<_>, _>>()?;
        blocking(&self.0, move |c| {
            let page = tiles::list(c, job, TileIndex(r.first), most as usize, &states);
            let page = page.map_err(|e| status::of_store(&e))?;
            let mut answer = v1::ListTilesResponse {
                tiles: Vec::new(),
                next: page.next.map_or(0, |tile| tile.0),
                total: page.total,
            };
            let mut bytes = 0;
            for tile in page.tiles.into_iter().map(wire::tile) {
                bytes += tile.encoded_len();
                if bytes > MOST_BYTES && !answer.tiles.is_empty() {
                    answer.next = tile.tile;
                    break;
                }
                answer.tiles.push(tile);
            }
            Ok(Response::new(answer))
        })
        .await
    }

    async fn invalidate(
        &self,
        r: Request<v1::InvalidateRequest>,
    ) -> Answer<v1::InvalidateResponse> {
        let v1::InvalidateRequest {
            job,
            tiles,
            worker,
            from_ms,
            to_ms,
        } = r.into_inner();
        if job.is_none() && worker.is_empty() {
            return Err(Status::invalid_argument(
                "the request names neither a job nor a worker; name one or both",
            ));
        }
        if job.is_none() && !tiles.is_empty() {
            return Err(Status::invalid_argument(
                "tiles are numbered within a job; name the job as well",
            ));
        }
        let filter = TileFilter {
            job: job.map(JobId),
            tiles: tiles.into_iter().map(TileIndex).collect(),
            worker: Some(worker).filter(|worker| !worker.is_empty()),
            from_ms: from_ms.unwrap_or(0),
            to_ms: to_ms.unwrap_or(u64::MAX),
        };
        blocking(&self.0, move |c| {
            let mut changes = JobChanges::begin(c);
            let opened = invalidate::invalidate(&mut changes, &filter);
            changes.finish().run(c);
            let opened = opened.map_err(|e| status::of_store(&e))?;
            let jobs = opened
                .into_iter()
                .map(|(job, tiles)| v1::InvalidatedJob { job: job.0, tiles });
            Ok(Response::new(v1::InvalidateResponse {
                jobs: jobs.collect(),
            }))
        })
        .await
    }

    async fn release_worker(
        &self,
        r: Request<v1::ReleaseWorkerRequest>,
    ) -> Answer<v1::ReleaseWorkerResponse> {
        let worker = r.into_inner().worker;
        blocking(&self.0, move |c| {
            let was_quarantined =
                quarantine::release(c, &worker).map_err(|e| status::of_store(&e))?;
            Ok(Response::new(v1::ReleaseWorkerResponse { was_quarantined }))
        })
        .await
    }

    type EventsStream = Pin<Box<dyn Stream<Item = Result<v1::Event, Status>> + Send>>;

    async fn events(&self, r: Request<v1::EventsRequest>) -> Answer<Self::EventsStream> {
        if let Some(job) = r.get_ref().job {
            own_job(&self.0, &r, job).await?;
        } else if !caller(&self.0, &r)?.sees_all() {
            return Err(Status::permission_denied(
                "the events of all jobs need the scope admin; name one of your jobs",
            ));
        }
        let v1::EventsRequest { job, after, follow } = r.into_inner();
        let job = job.map(JobId);
        if let Some(job) = job {
            let known = blocking(&self.0, move |c| {
                c.records.job(job).map_err(|e| status::of_store(&e))
            })
            .await?;
            if known.is_none() {
                return Err(status::of_store(&StoreError::UnknownJob { job }));
            }
        }
        let (out, stream) = mpsc::channel(EVENTS_AT_ONCE);
        tokio::spawn(tell(Arc::clone(&self.0), job, after, follow, out));
        Ok(Response::new(Box::pin(
            tokio_stream::wrappers::ReceiverStream::new(stream),
        )))
    }
}

/// Sends the events of one job or of all jobs, and also later events if `follow` is true.
async fn tell(
    c: Arc<Coordinator>,
    job: Option<JobId>,
    mut after: u64,
    follow: bool,
    out: mpsc::Sender<Result<v1::Event, Status>>,
) {
    let mut grown = c.telemetry.event_log.grown();
    loop {
        grown.mark_unchanged();
        let (events, upto) = c.telemetry.event_log.after(job, after, EVENTS_AT_ONCE);
        let is_end = events.len() < EVENTS_AT_ONCE;
        for event in events {
            let sent =
                tokio::time::timeout(LONGEST_UNREAD, out.send(Ok(wire::event(&event)))).await;
            // The client has disconnected, or does not read.
            if !matches!(sent, Ok(Ok(()))) {
                return;
            }
        }
        after = upto;
        if is_end {
            if !follow {
                return;
            }
            tokio::select! {
                changed = grown.changed() => if changed.is_err() { return },
                // The client has disconnected.
                () = out.closed() => return,
            }
        }
    }
}
