//! The worker's stream to its coordinator: sends the worker's profiles, takes grants, renews leases, and
//! reconnects after a broken connection.

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

/// Most tiles held at once: one that runs and one whose data is fetched.
const IN_HAND: usize = 2;
/// Interval between renewals of leases.
const RENEW: Duration = Duration::from_secs(1);
/// First and longest wait before a reconnection. After a restart the coordinator waits a little longer than
/// the longest one before it gives tiles at work to other workers.
const RECONNECT: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(1)];
/// After a connection that lasted this long, waits start at the shortest again. Short waits matter, since the
/// coordinator keeps the leases of a disconnected worker for less than two seconds.
const STEADY: Duration = Duration::from_secs(1);

/// Delay before a tile is reported as failed because of the machine or the network.
const AFTER_FAILURE: Duration = Duration::from_secs(1);
/// How long a draining worker waits until the coordinator has read its last messages.
const FAREWELL: Duration = Duration::from_secs(2);

type LeaseKey = (u64, u32, u64, u64);

fn key(l: &v1::Lease) -> LeaseKey {
    (l.job, l.tile, l.epoch, l.lease)
}

/// How long a worker whose name is taken tries again. The other worker may be its own predecessor on a
/// machine that vanished: the coordinator ends such a connection after 30 s without an answer to its pings.
const NAME_TAKEN: Duration = Duration::from_secs(40);

/// How one connection ended.
enum End {
    Stopped,
    Broken(String),
    /// Another worker of this name is connected.
    NameTaken(String),
}

/// A worker; it lives longer than a connection.
pub struct Worker {
    shop: Arc<TileRunner>,
    /// Random and not 0; distinguishes this worker from another worker of the same name.
    instance: u64,
    /// The identity from the first welcome; empty before.
    identity: Vec<u8>,
    held: BTreeMap<LeaseKey, Arc<LeasedTile>>,
    /// The leaders that this worker helps, by their leases: one, and those that it is just leaving.
    helping: BTreeMap<LeaseKey, Arc<LeasedTile>>,
    finished: (
        mpsc::UnboundedSender<Finished>,
        mpsc::UnboundedReceiver<Finished>,
    ),
    /// What has ended and no coordinator has heard of, as far as is known.
    unsaid: Vec<ToCoordinator>,
}

enum Finished {
    Tile(v1::Lease, Result<(), Failure>),
    Timed(v1::Timed),
    /// It helps the holder of this lease no more.
    Helped(v1::Lease, Arc<LeasedTile>),
}

impl Worker {
    /// A worker without a connection.
    pub fn new(config: Config) -> Result<Self, WorkerError> {
        let endpoint = config
            .credentials
            .endpoint(&config.coordinator)
            .map_err(|e| WorkerError::Address(config.coordinator.clone(), e))?
            .http2_keep_alive_interval(Duration::from_secs(10))
            .keep_alive_while_idle(true);
        let shop = TileRunner {
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
            shop: Arc::new(shop),
            instance,
            identity: Vec::new(),
            held: BTreeMap::new(),
            helping: BTreeMap::new(),
            finished: mpsc::unbounded_channel(),
            unsaid: Vec::new(),
        })
    }

    /// Connects and works until `stop` tells the worker to stop; reconnects after a broken connection.
    pub async fn run(mut self, mut stop: watch::Receiver<Stop>) -> Result<(), WorkerError> {
        let mut wait = RECONNECT[0];
        let mut since = Instant::now();
        let mut taken: Option<Instant> = None;
        loop {
            let connected = Instant::now();
            let end = self.connection(&mut stop).await;
            self.shop.config.counters.connected(false);
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
                .shop
                .config
                .give_up_after
                .is_some_and(|limit| since.elapsed() > limit)
            {
                let address = self.shop.config.coordinator.clone();
                return Err(WorkerError::Unreachable { address, reason });
            }
            tracing::warn!(
                worker = self.shop.config.name,
                "the connection to {} ended ({reason}); trying again in {wait:?}",
                self.shop.config.coordinator
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

    /// Whether a worker without a connection has nothing to stay for. One that drains delivers its tiles
    /// first.
    fn may_stop(&self, stop: &watch::Receiver<Stop>) -> bool {
        match *stop.borrow() {
            Stop::No => false,
            Stop::Drain => !self.held.values().any(|h| h.begun()),
            Stop::Now => true,
        }
    }

    /// Gives back what a draining worker does not finish: tiles that have not begun, and crews.
    fn give_back(&self) {
        self.held
            .values()
            .filter(|h| !h.begun())
            .for_each(|h| h.cancel());
        self.helping.values().for_each(|h| h.cancel());
    }

    async fn connection(&mut self, stop: &mut watch::Receiver<Stop>) -> Result<End, WorkerError> {
        // The coordinator has forgotten whom this worker helped.
        self.helping.values().for_each(|h| h.cancel());
        let mut draining = *stop.borrow_and_update() == Stop::Drain;
        // A tile that has ended since the last connection is not claimed: nobody would work on it.
        while let Ok(done) = self.finished.1.try_recv() {
            let said = self.done(done, draining);
            // How many tiles it wants it says when it is welcome.
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
        // Jobs that need no backend are for every worker.
        let backends = self.shop.config.backends.profiles();
        let profiles = backends
            .into_iter()
            .chain([sightline_model::NO_PROFILE.to_owned()]);
        let hello = v1::Hello {
            name: self.shop.config.name.clone(),
            profiles: profiles.collect(),
            held: self.held.values().map(|h| h.lease).collect(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            algorithm: sightline_model::ALGORITHM_VERSION,
            protocol: sightline_proto::PROTOCOL,
            instance: self.instance,
            identity: self.identity.clone(),
            helps: self.shop.config.helps,
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
        let mut inbound = match self.shop.client.clone().work(stream).await {
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
                // Ends the stream; the coordinator ends its side after it has read everything.
                drop(out);
                let read = async { while let Some(Ok(_)) = inbound.next().await {} };
                // The worker stops even if the coordinator does not answer.
                let _ = tokio::time::timeout(FAREWELL, read).await;
                tracing::info!(
                    worker = self.shop.config.name,
                    "drained: no tile is left here"
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
                                tracing::info!(worker = self.shop.config.name, "finishing the tile in hand, \
                                    taking no more; interrupt again to stop at once");
                            } else {
                                tracing::info!(worker = self.shop.config.name, "taking no more tiles");
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

    /// Handles a message from the coordinator; returns the immediate answer, if any.
    fn heard(&mut self, message: FromCoordinator, draining: bool) -> Option<ToCoordinator> {
        match message {
            FromCoordinator::Welcome(w) => {
                self.shop.config.counters.connected(true);
                self.unsaid.clear();
                self.shop.direct.welcome(w.direct);
                self.identity = w.identity;
                // Tiles whose lease was not kept are stopped.
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
                    // It crossed with the word that this worker takes no more.
                    return Some(ToCoordinator::Failed(v1::TileFailed {
                        lease: Some(lease),
                        reason: "the worker takes no more tiles".to_owned(),
                        infrastructure: true,
                    }));
                }
                let held = Arc::new(LeasedTile::new(lease));
                self.held.insert(key(&lease), Arc::clone(&held));
                let (shop, report) = (Arc::clone(&self.shop), self.finished.0.clone());
                tokio::spawn(async move {
                    let result = shop.work(grant, held).await;
                    if matches!(result, Err(Failure::Infrastructure(_))) {
                        // A fault of the machine or the network may need some time to pass.
                        tokio::time::sleep(AFTER_FAILURE).await;
                    }
                    // Fails only when the worker has ended.
                    let _ = report.send(Finished::Tile(lease, result));
                });
                None
            }
            FromCoordinator::Revoke(r) => {
                let key = r.lease.map(|l| key(&l));
                let mut known = false;
                for of in [&self.held, &self.helping] {
                    if let Some(h) = key.and_then(|key| of.get(&key)) {
                        h.cancel();
                        known = true;
                    }
                }
                // The coordinator took a tile for held that was not, and did not count on that hand.
                if known { None } else { self.wanted(draining) }
            }
            FromCoordinator::Help(help) => {
                let lease = help.lease?;
                if draining {
                    return Some(ToCoordinator::Helped(v1::Helped { lease: Some(lease) }));
                }
                let held = Arc::new(LeasedTile::new(lease));
                self.helping.insert(key(&lease), Arc::clone(&held));
                let (shop, report) = (Arc::clone(&self.shop), self.finished.0.clone());
                tokio::spawn(async move {
                    let begun = Instant::now();
                    if let Err(e) = shop.help(help, Arc::clone(&held)).await {
                        tracing::info!("no help for tile {} of job {}: {e}", lease.tile, lease.job);
                    }
                    if begun.elapsed() < AFTER_FAILURE {
                        // It would be sent back at once.
                        tokio::time::sleep(AFTER_FAILURE).await;
                    }
                    // Fails only when the worker has ended.
                    let _ = report.send(Finished::Helped(lease, held));
                });
                None
            }
            FromCoordinator::Time(t) => {
                let (shop, report) = (Arc::clone(&self.shop), self.finished.0.clone());
                tokio::spawn(async move {
                    let spec = t.spec.unwrap_or_default();
                    let times = shop.time(&spec).await.unwrap_or_else(|e| {
                        tracing::warn!("the backends could not be timed: {e}");
                        Vec::new()
                    });
                    // Fails only when the worker has ended.
                    let _ = report.send(Finished::Timed(v1::Timed { job: t.job, times }));
                });
                None
            }
        }
    }

    /// Asks for as many tiles as this worker may hold beside those that it holds. The coordinator counts no
    /// hand twice.
    fn wanted(&self, draining: bool) -> Option<ToCoordinator> {
        let tiles = IN_HAND.saturating_sub(self.held.len()) as u32;
        (!draining && tiles > 0).then_some(ToCoordinator::Want(v1::Want { tiles }))
    }

    /// The messages to send after a tile or a timing has finished.
    fn done(&mut self, done: Finished, draining: bool) -> Vec<ToCoordinator> {
        let (lease, result) = match done {
            Finished::Timed(t) => return vec![ToCoordinator::Timed(t)],
            Finished::Helped(lease, held) => {
                // After a reconnection it may help the same leader again.
                if !self
                    .helping
                    .get(&key(&lease))
                    .is_some_and(|now| Arc::ptr_eq(now, &held))
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
        self.shop.config.counters.ended(match &result {
            Ok(()) => Ended::Done,
            Err(Failure::Cancelled) => Ended::Cancelled,
            Err(Failure::Infrastructure(_) | Failure::Tile(_)) => Ended::Failed,
        });
        let mut say = match result {
            Err(Failure::Cancelled) if draining => {
                vec![failed("its worker is going".to_owned(), true)]
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
