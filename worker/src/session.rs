//! The worker's stream to its coordinator.
//!
//! The session sends the worker's profiles, accepts grants, renews leases, and reconnects after a broken
//! connection.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use sightline_proto::v1;
use sightline_proto::v1::coordinator_message::Message as FromCoordinator;
use sightline_proto::v1::worker_message::Message as ToCoordinator;
use sightline_proto::v1::workers_client::WorkersClient;
use tokio::sync::{Semaphore, mpsc, watch};

use crate::config::{Config, Stop, WorkerError};
use crate::connect;
use crate::counters::Ended;
use crate::direct::Direct;
use crate::leased_tile::LeasedTile;
use crate::status::describe;
use crate::tile_runner::{Failure, TileRunner};

/// Maximum number of held tiles: one that runs and one whose data is fetched.
const IN_HAND: usize = 2;
/// The interval between renewals of leases.
const RENEW: Duration = Duration::from_secs(1);
/// The minimum and the maximum wait before a reconnection. After a restart, the coordinator waits a little
/// longer than the maximum before it grants running tiles to other workers.
const RECONNECT: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(1)];
/// The duration of a connection after which waits start at the minimum again. Short waits matter, because the
/// coordinator keeps the leases of a disconnected worker for less than two seconds.
const STEADY: Duration = Duration::from_secs(1);

/// Delay before a tile is reported as failed because of the machine or the network.
const AFTER_FAILURE: Duration = Duration::from_secs(1);
/// Timeout for a draining worker's wait until the coordinator has read its last messages.
const FAREWELL: Duration = Duration::from_secs(2);

type LeaseKey = (u64, u32, u64, u64);

fn key(l: &v1::Lease) -> LeaseKey {
    (l.job, l.tile, l.epoch, l.lease)
}

/// The time for which a worker whose name is taken retries. The other worker may be its own predecessor on a
/// machine that vanished: the coordinator ends such a connection after 30 s without an answer to its pings.
const NAME_TAKEN: Duration = Duration::from_secs(40);

/// The way in which a connection ended.
enum End {
    Stopped,
    Broken(String),
    /// Another worker with the same name is connected.
    NameTaken(String),
}

/// A worker, which outlives its connections.
pub struct Worker {
    runner: Arc<TileRunner>,
    /// A random number other than 0, which distinguishes this worker from another worker of the same name.
    instance: u64,
    /// The identity from the first welcome; empty before the first welcome.
    identity: Vec<u8>,
    held: BTreeMap<LeaseKey, Arc<LeasedTile>>,
    /// The leases of the leaders that this worker helps: one leader, and leaders that it is leaving.
    helping: BTreeMap<LeaseKey, Arc<LeasedTile>>,
    finished: (
        mpsc::UnboundedSender<Finished>,
        mpsc::UnboundedReceiver<Finished>,
    ),
    /// Messages about ended work that no coordinator has received, as far as is known.
    unsaid: Vec<ToCoordinator>,
}

enum Finished {
    Tile(v1::Lease, Result<(), Failure>),
    Timed(v1::Timed),
    /// The worker no longer helps the holder of this lease.
    Helped(v1::Lease, Arc<LeasedTile>),
}

impl Worker {
    /// Creates a worker without a connection.
    pub fn new(config: Config) -> Result<Self, WorkerError> {
        let endpoint = config
            .credentials
            .endpoint(&config.coordinator)
            .map_err(|e| WorkerError::Address(config.coordinator.clone(), e))?
            .http2_keep_alive_interval(Duration::from_secs(10))
            .keep_alive_while_idle(true);
        let runner = TileRunner {
            planned: Default::default(),
            client: WorkersClient::new(connect::channel(&endpoint, &config.credentials)),
            direct: Direct::new(config.direct),
            config,
            packs: Default::default(),
            running: Semaphore::new(1),
        };
        let instance = getrandom::u64()
            .map_err(|e| WorkerError::Random(e.to_string()))?
            .max(1);
        Ok(Self {
            runner: Arc::new(runner),
            instance,
            identity: Vec::new(),
            held: BTreeMap::new(),
            helping: BTreeMap::new(),
            finished: mpsc::unbounded_channel(),
            unsaid: Vec::new(),
        })
    }

    /// Connects and works until `stop` contains a command to stop. Reconnects after a broken connection.
    pub async fn run(mut self, mut stop: watch::Receiver<Stop>) -> Result<(), WorkerError> {
        let mut wait = RECONNECT[0];
        let mut since = Instant::now();
        let mut taken: Option<Instant> = None;
        loop {
            let connected = Instant::now();
            let end = self.connection(&mut stop).await;
            self.runner.config.counters.connected(false);
            let reason = match end? {
                End::Stopped => return Ok(()),
                End::Broken(reason) => {
                    taken = None;
                    reason
                }
                End::NameTaken(reason) => {
                    if taken.get_or_insert_with(Instant::now).elapsed() > NAME_TAKEN {
                        return Err(WorkerError::Refused(reason));
                    }
                    reason
                }
            };
            if self.may_stop(&stop) {
                return Ok(());
            }
            if connected.elapsed() > STEADY {
                (wait, since) = (RECONNECT[0], Instant::now());
            }
            if self
                .runner
                .config
                .give_up_after
                .is_some_and(|limit| since.elapsed() > limit)
            {
                let address = self.runner.config.coordinator.clone();
                return Err(WorkerError::Unreachable { address, reason });
            }
            tracing::warn!(
                worker = self.runner.config.name,
                "the connection to {} ended ({reason}); trying again in {wait:?}",
                self.runner.config.coordinator
            );
            tokio::select! {
                () = tokio::time::sleep(wait) => {}
                changed = stop.changed() => {
                    if changed.is_err() || self.may_stop(&stop) {
                        return Ok(());
                    }
                    self.give_back();
                }
            }
            wait = (wait * 2).min(RECONNECT[1]);
        }
    }

    /// Returns true if a worker without a connection may end. A draining worker delivers its running tiles
    /// first.
    fn may_stop(&self, stop: &watch::Receiver<Stop>) -> bool {
        match *stop.borrow() {
            Stop::No => false,
            Stop::Drain => !self.held.values().any(|h| h.begun()),
            Stop::Now => true,
        }
    }

    /// Returns the tiles that a draining worker does not finish, and leaves crews.
    fn give_back(&self) {
        self.held
            .values()
            .filter(|h| !h.begun())
            .for_each(|h| h.cancel());
        self.helping.values().for_each(|h| h.cancel());
    }

    async fn connection(&mut self, stop: &mut watch::Receiver<Stop>) -> Result<End, WorkerError> {
        // The coordinator has forgotten which leaders this worker helped.
        self.helping.values().for_each(|h| h.cancel());
        let mut draining = *stop.borrow_and_update() == Stop::Drain;
        // A tile that has ended since the last connection is not claimed, because no worker would compute it.
        while let Ok(done) = self.finished.1.try_recv() {
            let said = self.done(done, draining);
            // The worker requests tiles again after its welcome.
            self.unsaid.extend(
                said.into_iter()
                    .filter(|m| !matches!(m, ToCoordinator::Want(_))),
            );
        }
        let (out, receiver) = mpsc::channel(64);
        let send = |m: ToCoordinator| {
            out.try_send(v1::WorkerMessage { message: Some(m) })
                .map_err(|e| e.to_string())
        };
        // Every worker can take jobs that need no backend.
        let backends = self.runner.config.backends.profiles();
        let profiles = backends
            .into_iter()
            .chain([sightline_model::NO_PROFILE.to_owned()]);
        let hello = v1::Hello {
            name: self.runner.config.name.clone(),
            profiles: profiles.collect(),
            held: self.held.values().map(|h| h.lease).collect(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            algorithm: sightline_model::ALGORITHM_VERSION,
            protocol: sightline_proto::PROTOCOL,
            instance: self.instance,
            identity: self.identity.clone(),
            helps: self.runner.config.helps,
        };
        let broken = |e: &dyn std::fmt::Display| End::Broken(e.to_string());
        for m in std::iter::once(ToCoordinator::Hello(hello)).chain(self.unsaid.iter().cloned()) {
            if let Err(e) = send(m) {
                return Ok(broken(&e));
            }
        }
        if draining {
            self.give_back();
            if let Err(e) = send(ToCoordinator::Draining(v1::Draining {})) {
                return Ok(broken(&e));
            }
        }
        let stream = tokio_stream::wrappers::ReceiverStream::new(receiver);
        let mut inbound = match self.runner.client.clone().work(stream).await {
            Ok(response) => response.into_inner(),
            Err(s)
                if matches!(
                    s.code(),
                    tonic::Code::InvalidArgument
                        | tonic::Code::Unauthenticated
                        | tonic::Code::PermissionDenied
                ) =>
            {
                return Err(WorkerError::Refused(describe(&s)));
            }
            Err(s) if s.code() == tonic::Code::AlreadyExists => {
                return Ok(End::NameTaken(describe(&s)));
            }
            Err(s) => return Ok(broken(&describe(&s))),
        };
        let mut renew = tokio::time::interval(RENEW);
        loop {
            if draining && self.held.is_empty() {
                // Close the stream; the coordinator closes its side after it has read all messages.
                drop(out);
                let read = async { while let Some(Ok(_)) = inbound.next().await {} };
                // The worker stops even if the coordinator does not answer.
                let _ = tokio::time::timeout(FAREWELL, read).await;
                tracing::info!(
                    worker = self.runner.config.name,
                    "drained: the worker holds no tile"
                );
                return Ok(End::Stopped);
            }
            tokio::select! {
                message = inbound.next() => {
                    let message = match message {
                        Some(Ok(m)) => m.message,
                        Some(Err(s)) => return Ok(broken(&describe(&s))),
                        None => return Ok(broken(&"the coordinator closed the stream")),
                    };
                    let Some(message) = message else { continue };
                    if let Some(reply) = self.heard(message, draining)
                        && let Err(e) = send(reply)
                    {
                        return Ok(broken(&e));
                    }
                }
                Some(done) = self.finished.1.recv() => {
                    for m in self.done(done, draining) {
                        if let Err(e) = send(m) {
                            return Ok(broken(&e));
                        }
                    }
                }
                _ = renew.tick() => {
                    for h in self.held.values() {
                        if let Err(e) = send(ToCoordinator::Progress(h.progress())) {
                            return Ok(broken(&e));
                        }
                    }
                }
                changed = stop.changed() => {
                    let now = if changed.is_err() { Stop::Now } else { *stop.borrow() };
                    match now {
                        Stop::No => {}
                        Stop::Drain if !draining => {
                            draining = true;
                            self.give_back();
                            if self.held.values().any(|h| h.begun()) {
                                tracing::info!(
                                    worker = self.runner.config.name,
                                    "finishing the running tile and accepting no more tiles; interrupt \
                                     again to stop at once"
                                );
                            } else {
                                tracing::info!(
                                    worker = self.runner.config.name,
                                    "accepting no more tiles"
                                );
                            }
                            if let Err(e) = send(ToCoordinator::Draining(v1::Draining {})) {
                                return Ok(broken(&e));
                            }
                        }
                        Stop::Drain => {}
                        Stop::Now => {
                            self.held.values().chain(self.helping.values()).for_each(|h| h.cancel());
                            return Ok(End::Stopped);
                        }
                    }
                }
            }
        }
    }

    /// Handles a message from the coordinator. Returns the immediate answer, if any.
    fn heard(&mut self, message: FromCoordinator, draining: bool) -> Option<ToCoordinator> {
        match message {
            FromCoordinator::Welcome(w) => {
                self.runner.config.counters.connected(true);
                self.unsaid.clear();
                self.runner.direct.welcome(w.direct);
                self.identity = w.identity;
                // Stop the tiles whose leases were not kept.
                for (k, h) in &self.held {
                    if !w.kept.iter().any(|l| key(l) == *k) {
                        h.cancel();
                    }
                }
                self.wanted(draining)
            }
            FromCoordinator::Grant(grant) => {
                let lease = grant.lease?;
                if draining {
                    // The grant crossed the message that this worker accepts no further tiles.
                    return Some(ToCoordinator::Failed(v1::TileFailed {
                        lease: Some(lease),
                        reason: "the worker accepts no more tiles".to_owned(),
                        infrastructure: true,
                    }));
                }
                let leased = Arc::new(LeasedTile::new(lease));
                self.held.insert(key(&lease), Arc::clone(&leased));
                let (runner, report) = (Arc::clone(&self.runner), self.finished.0.clone());
                tokio::spawn(async move {
                    let result = runner.work(grant, leased).await;
                    if matches!(result, Err(Failure::Infrastructure(_))) {
                        // A fault of the machine or the network may need some time to pass.
                        tokio::time::sleep(AFTER_FAILURE).await;
                    }
                    // The send fails only if the worker has ended.
                    let _ = report.send(Finished::Tile(lease, result));
                });
                None
            }
            FromCoordinator::Revoke(r) => {
                let key = r.lease.map(|l| key(&l));
                let mut known = false;
                for leases in [&self.held, &self.helping] {
                    if let Some(h) = key.and_then(|key| leases.get(&key)) {
                        h.cancel();
                        known = true;
                    }
                }
                // The coordinator assumed that this worker holds the tile, so it counted too few tiles that
                // the worker can accept.
                // the worker can accept.
                if known { None } else { self.wanted(draining) }
            }
            FromCoordinator::Help(help) => {
                let lease = help.lease?;
                if draining {
                    return Some(ToCoordinator::Helped(v1::Helped { lease: Some(lease) }));
                }
                let leased = Arc::new(LeasedTile::new(lease));
                self.helping.insert(key(&lease), Arc::clone(&leased));
                let (runner, report) = (Arc::clone(&self.runner), self.finished.0.clone());
                tokio::spawn(async move {
                    let begun = Instant::now();
                    if let Err(e) = runner.help(help, Arc::clone(&leased)).await {
                        tracing::info!(
                            "this worker cannot help with tile {} of job {}: {e}",
                            lease.tile,
                            lease.job
                        );
                    }
                    if begun.elapsed() < AFTER_FAILURE {
                        // Otherwise the coordinator would send the worker back at once.
                        tokio::time::sleep(AFTER_FAILURE).await;
                    }
                    // The send fails only if the worker has ended.
                    let _ = report.send(Finished::Helped(lease, leased));
                });
                None
            }
            FromCoordinator::Time(t) => {
                let (runner, report) = (Arc::clone(&self.runner), self.finished.0.clone());
                tokio::spawn(async move {
                    let spec = t.spec.unwrap_or_default();
                    let times = runner.time(&spec).await.unwrap_or_else(|e| {
                        tracing::warn!("the backends could not be timed: {e}");
                        Vec::new()
                    });
                    // The send fails only if the worker has ended.
                    let _ = report.send(Finished::Timed(v1::Timed { job: t.job, times }));
                });
                None
            }
        }
    }

    /// Requests as many tiles as this worker may hold in addition to its held tiles. The coordinator limits
    /// the sum of held and requested tiles, so a repeated request has no effect.
    fn wanted(&self, draining: bool) -> Option<ToCoordinator> {
        let tiles = IN_HAND.saturating_sub(self.held.len()) as u32;
        (!draining && tiles > 0).then_some(ToCoordinator::Want(v1::Want { tiles }))
    }

    /// Returns the messages to send after a tile, a timing or help has finished.
    fn done(&mut self, done: Finished, draining: bool) -> Vec<ToCoordinator> {
        let (lease, result) = match done {
            Finished::Timed(t) => return vec![ToCoordinator::Timed(t)],
            Finished::Helped(lease, leased) => {
                // After a reconnection the worker may help the same leader again.
                if !self
                    .helping
                    .get(&key(&lease))
                    .is_some_and(|now| Arc::ptr_eq(now, &leased))
                {
                    return Vec::new();
                }
                self.helping.remove(&key(&lease));
                return vec![ToCoordinator::Helped(v1::Helped { lease: Some(lease) })];
            }
            Finished::Tile(lease, result) => (lease, result),
        };
        self.held.remove(&key(&lease));
        let failed = |reason, infrastructure| {
            ToCoordinator::Failed(v1::TileFailed {
                lease: Some(lease),
                reason,
                infrastructure,
            })
        };
        self.runner.config.counters.ended(match &result {
            Ok(()) => Ended::Done,
            Err(Failure::Cancelled) => Ended::Cancelled,
            Err(Failure::Infrastructure(_) | Failure::Tile(_)) => Ended::Failed,
        });
        let mut say = match result {
            Err(Failure::Cancelled) if draining => {
                vec![failed(
                    "the worker drains and does not finish the tile".to_owned(),
                    true,
                )]
            }
            Ok(()) | Err(Failure::Cancelled) => Vec::new(),
            Err(Failure::Infrastructure(reason)) => vec![failed(reason, true)],
            Err(Failure::Tile(reason)) => vec![failed(reason, false)],
        };
        if !draining {
            say.push(ToCoordinator::Want(v1::Want { tiles: 1 }));
        }
        say
    }
}
