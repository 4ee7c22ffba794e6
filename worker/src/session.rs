//! The worker's stream to its coordinator: says what it can do, takes grants, renews leases, comes back after
//! a break.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures::StreamExt as _;
use sightline_proto::v1;
use sightline_proto::v1::coordinator_message::Message as FromCoordinator;
use sightline_proto::v1::worker_message::Message as ToCoordinator;
use sightline_proto::v1::workers_client::WorkersClient;
use tokio::sync::{Semaphore, mpsc, watch};
use tonic::transport::Channel;

use crate::config::{Config, Stop, WorkerError};
use crate::tiles::{Failure, Held, Shop, describe};

/// Tiles in hand: one running, one being fetched.
const IN_HAND: usize = 2;
/// How often leases are renewed.
const RENEW: Duration = Duration::from_secs(1);
/// First and longest wait before connecting again.
const RECONNECT: [Duration; 2] = [Duration::from_millis(200), Duration::from_secs(5)];
/// A connection that held so long was one: the waits begin anew. The coordinator keeps the leases of a worker
/// that has gone for three seconds.
const STEADY: Duration = Duration::from_secs(1);

/// How long a tile that the machine or the network kept from being done is held back.
const AFTER_FAILURE: Duration = Duration::from_secs(1);
/// How long a worker that stops waits for the coordinator to have read its last messages.
const FAREWELL: Duration = Duration::from_secs(2);

type LeaseKey = (u64, u32, u64, u64);

fn key(l: &v1::Lease) -> LeaseKey {
    (l.job, l.tile, l.epoch, l.lease)
}

/// How long a worker whose name is taken tries again. The other worker may be its own predecessor on a machine
/// that vanished: the coordinator ends such a connection after 30 s without an answer to its pings.
const NAME_TAKEN: Duration = Duration::from_secs(40);

/// How one connection ended.
enum End {
    Stopped,
    Broken(String),
    /// Another worker of this name is connected.
    NameTaken(String),
}

/// A worker between and during its connections.
pub struct Worker {
    shop: Arc<Shop>,
    /// Random and not 0: tells this worker from another one of its name.
    instance: u64,
    held: BTreeMap<LeaseKey, Arc<Held>>,
    finished: (mpsc::UnboundedSender<Finished>, mpsc::UnboundedReceiver<Finished>),
}

enum Finished {
    Tile(v1::Lease, Result<(), Failure>),
    Timed(v1::Timed),
}

impl Worker {
    /// A worker that has not connected yet.
    pub fn new(config: Config) -> Result<Self, WorkerError> {
        let channel: Channel = sightline_proto::endpoint(&config.coordinator)
            .map_err(|e| WorkerError::Address(config.coordinator.clone(), e))?
            .http2_keep_alive_interval(Duration::from_secs(10))
            .keep_alive_while_idle(true)
            .connect_lazy();
        let shop = Shop {
            client: WorkersClient::new(channel),
            config,
            packs: Default::default(),
            running: Semaphore::new(1),
        };
        let instance = getrandom::u64().map_err(|e| WorkerError::Random(e.to_string()))?.max(1);
        Ok(Self {
            shop: Arc::new(shop),
            instance,
            held: BTreeMap::new(),
            finished: mpsc::unbounded_channel(),
        })
    }

    /// Connects, works, and connects again, until it is told to stop.
    pub async fn run(mut self, mut stop: watch::Receiver<Stop>) -> Result<(), WorkerError> {
        let mut wait = RECONNECT[0];
        let mut since = Instant::now();
        let mut taken: Option<Instant> = None;
        loop {
            let connected = Instant::now();
            let reason = match self.connection(&mut stop).await? {
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
            if *stop.borrow() != Stop::No {
                // What is in hand cannot be delivered any more.
                return Ok(());
            }
            if connected.elapsed() > STEADY {
                (wait, since) = (RECONNECT[0], Instant::now());
            }
            if self.shop.config.give_up_after.is_some_and(|limit| since.elapsed() > limit) {
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
                    if changed.is_err() || *stop.borrow() != Stop::No {
                        return Ok(());
                    }
                }
            }
            wait = (wait * 2).min(RECONNECT[1]);
        }
    }

    async fn connection(&mut self, stop: &mut watch::Receiver<Stop>) -> Result<End, WorkerError> {
        let (out, receiver) = mpsc::channel(64);
        let send = |m: ToCoordinator| out.try_send(v1::WorkerMessage { message: Some(m) });
        let hello = v1::Hello {
            name: self.shop.config.name.clone(),
            profiles: self.shop.config.backends.profiles(),
            held: self.held.values().map(|h| h.lease).collect(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            algorithm: sightline_model::ALGORITHM_VERSION,
            instance: self.instance,
        };
        let broken = |e: &dyn std::fmt::Display| End::Broken(e.to_string());
        if let Err(e) = send(ToCoordinator::Hello(hello)) {
            return Ok(broken(&e));
        }
        let stream = tokio_stream::wrappers::ReceiverStream::new(receiver);
        let mut inbound = match self.shop.client.clone().work(stream).await {
            Ok(response) => response.into_inner(),
            Err(s) if s.code() == tonic::Code::InvalidArgument => {
                return Err(WorkerError::Refused(describe(&s)));
            }
            Err(s) if s.code() == tonic::Code::AlreadyExists => return Ok(End::NameTaken(describe(&s))),
            Err(s) => return Ok(broken(&describe(&s))),
        };
        let mut renew = tokio::time::interval(RENEW);
        let mut draining = false;
        loop {
            if draining && self.held.is_empty() {
                // Ends the stream; the coordinator ends its side when it has read everything.
                drop(out);
                let read = async { while let Some(Ok(_)) = inbound.next().await {} };
                // A coordinator that does not answer cannot keep the worker from stopping.
                let _ = tokio::time::timeout(FAREWELL, read).await;
                tracing::info!(worker = self.shop.config.name, "drained: no tile is left here");
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
                            // A tile that has not begun is given back; the one that runs is finished.
                            self.held.values().filter(|h| !h.begun()).for_each(|h| h.cancel());
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
                            self.held.values().for_each(|h| h.cancel());
                            return Ok(End::Stopped);
                        }
                    }
                }
            }
        }
    }

    /// Acts on what the coordinator says; gives what to answer at once.
    fn heard(&mut self, message: FromCoordinator, draining: bool) -> Option<ToCoordinator> {
        match message {
            FromCoordinator::Welcome(w) => {
                // What is no longer this worker's is stopped.
                for (k, h) in &self.held {
                    if !w.kept.iter().any(|l| key(l) == *k) {
                        h.cancel();
                    }
                }
                let tiles = IN_HAND.saturating_sub(self.held.len()) as u32;
                (!draining && tiles > 0).then_some(ToCoordinator::Want(v1::Want { tiles }))
            }
            FromCoordinator::Grant(grant) => {
                let lease = grant.lease?;
                let held = Arc::new(Held::new(lease));
                self.held.insert(key(&lease), Arc::clone(&held));
                let (shop, report) = (Arc::clone(&self.shop), self.finished.0.clone());
                tokio::spawn(async move {
                    let result = shop.work(grant, held).await;
                    if matches!(result, Err(Failure::Infrastructure(_))) {
                        // What ails the machine may take a while to pass.
                        tokio::time::sleep(AFTER_FAILURE).await;
                    }
                    // The session may have ended; then nobody is left to tell.
                    let _ = report.send(Finished::Tile(lease, result));
                });
                None
            }
            FromCoordinator::Revoke(r) => {
                if let Some(h) = r.lease.and_then(|l| self.held.get(&key(&l))) {
                    h.cancel();
                }
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
                    // As above.
                    let _ = report.send(Finished::Timed(v1::Timed { job: t.job, times }));
                });
                None
            }
        }
    }

    /// What to say about something finished.
    fn done(&mut self, done: Finished, draining: bool) -> Vec<ToCoordinator> {
        let (lease, result) = match done {
            Finished::Timed(t) => return vec![ToCoordinator::Timed(t)],
            Finished::Tile(lease, result) => (lease, result),
        };
        self.held.remove(&key(&lease));
        let failed = |reason, infrastructure| {
            ToCoordinator::Failed(v1::TileFailed { lease: Some(lease), reason, infrastructure })
        };
        let mut say = match result {
            Err(Failure::Cancelled) if draining => vec![failed("its worker is going".to_owned(), true)],
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
