//! The table of open connections: caps, and the choice of the connection to close when a cap is reached.
//!
//! Connections of workers are counted separately, so that other connections cannot displace a worker.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::Notify;

use super::limits::ConnectionLimits;

/// The number of times per idle limit that the server checks if a connection still has open requests.
const CHECKS: u32 = 4;

/// The open connections of all listeners of a process.
#[derive(Debug)]
pub struct Connections {
    limits: ConnectionLimits,
    open: Mutex<Table>,
}

#[derive(Debug, Default)]
struct Table {
    next: u64,
    all: BTreeMap<u64, Arc<Connection>>,
}

/// The trust in a connection, from the callers of its requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::services) enum Trust {
    /// No request of the connection was admitted.
    Unknown,
    /// A request was admitted.
    Admitted,
    /// A worker's request was admitted.
    Worker,
}

/// An open connection.
#[derive(Debug)]
pub(in crate::services) struct Connection {
    from: IpAddr,
    state: Mutex<State>,
    evicted: Notify,
}

#[derive(Debug)]
struct State {
    is_handshaking: bool,
    trust: Trust,
    /// The number of requests whose answers have not ended.
    requests: u32,
    /// The time of the last byte while requests are open. Otherwise the end of the last request, or the start
    /// of the connection.
    since: Instant,
}

/// A connection's entry in the table. Dropping it removes the connection.
#[derive(Debug)]
pub(super) struct ConnectionEntry {
    table: Arc<Connections>,
    number: u64,
    pub(super) connection: Arc<Connection>,
}

/// A request whose answer has not ended.
#[derive(Debug)]
pub(super) struct OpenRequest(Arc<Connection>);

impl Connections {
    /// Creates a table without connections.
    pub fn new(limits: ConnectionLimits) -> Arc<Self> {
        Arc::new(Self {
            limits,
            open: Mutex::default(),
        })
    }

    /// Returns the limits of the table.
    pub(super) fn limits(&self) -> &ConnectionLimits {
        &self.limits
    }

    /// Adds a connection. If a cap is reached, closes the connection that has been idle longest.
    pub(super) fn add(self: &Arc<Self>, from: IpAddr, is_handshaking: bool) -> ConnectionEntry {
        let ConnectionLimits {
            general,
            of_address,
            handshakes,
            handshakes_of_address,
            ..
        } = self.limits;
        let state = State {
            is_handshaking,
            trust: Trust::Unknown,
            requests: 0,
            since: Instant::now(),
        };
        let connection = Arc::new(Connection {
            from,
            state: Mutex::new(state),
            evicted: Notify::new(),
        });
        let mut table = self.table();
        if is_handshaking {
            table.make_room(handshakes_of_address, |c, state| {
                state.is_handshaking && c.from == from
            });
            table.make_room(handshakes, |_, state| state.is_handshaking);
        }
        table.make_room(of_address, |c, state| {
            state.trust < Trust::Worker && c.from == from
        });
        table.make_room(general, |_, state| state.trust < Trust::Worker);
        let number = table.next;
        table.next += 1;
        table.all.insert(number, Arc::clone(&connection));
        ConnectionEntry {
            table: Arc::clone(self),
            number,
            connection,
        }
    }

    /// Closes the connection that has been idle longest, because the process has no free descriptor.
    pub(super) fn evict_one(&self) {
        let mut table = self.table();
        let is_evictable = |_: &Connection, state: &State| state.trust < Trust::Worker;
        let count = table
            .all
            .values()
            .filter(|c| is_evictable(c, &c.state()))
            .count();
        table.make_room(count, is_evictable);
    }

    /// Returns true if another connection may become a worker's.
    fn has_room_for_worker(&self) -> bool {
        let is_worker = |c: &&Arc<Connection>| c.state().trust == Trust::Worker;
        self.table().all.values().filter(is_worker).count() < self.limits.workers
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    /// Closes connections that `counts` selects, until one more connection fits below the cap.
    fn make_room(&mut self, cap: usize, counts: impl Fn(&Connection, &State) -> bool) {
        loop {
            let mut count = 0;
            let mut first = None;
            for (number, connection) in &self.all {
                let state = connection.state();
                if counts(connection, &state) {
                    count += 1;
                    // Connections with open requests of admitted callers are closed last.
                    let is_at_work = state.trust > Trust::Unknown && state.requests > 0;
                    let order = (is_at_work, state.since, *number);
                    first =
                        Some(first.map_or(order, |first: (bool, Instant, u64)| first.min(order)));
                }
            }
            let Some((_, _, number)) = first.filter(|_| count >= cap) else {
                return;
            };
            if let Some(evicted) = self.all.remove(&number) {
                tracing::debug!(
                    "a connection with {} is closed: the cap of {cap} connections is reached",
                    evicted.from
                );
                evicted.evicted.notify_one();
            }
        }
    }
}

impl Connection {
    /// Marks a connection whose request was admitted. If the workers' cap is reached, a worker's connection
    /// counts like any other.
    pub(in crate::services) fn admitted(&self, table: &Connections, is_worker: bool) {
        let before = self.state().trust;
        let now = match is_worker && before < Trust::Worker && table.has_room_for_worker() {
            true => Trust::Worker,
            false => Trust::Admitted,
        };
        self.state().trust = now.max(before);
    }

    /// Registers a new request.
    pub(super) fn begin(self: &Arc<Self>) -> OpenRequest {
        let mut state = self.state();
        state.requests += 1;
        state.since = Instant::now();
        OpenRequest(Arc::clone(self))
    }

    /// Marks the end of the handshake.
    pub(super) fn shaken(&self) {
        self.state().is_handshaking = false;
    }

    /// Records that bytes were transferred. Bytes do not affect the idle time of a connection without
    /// requests.
    pub(super) fn moved(&self) {
        let mut state = self.state();
        if state.requests > 0 {
            state.since = Instant::now();
        }
    }

    /// Returns true if a request's answer has not ended.
    pub(super) fn has_requests(&self) -> bool {
        self.state().requests > 0
    }

    /// Waits until the table closes the connection.
    pub(super) async fn evicted(&self) {
        self.evicted.notified().await;
    }

    /// Waits until the connection has had no request for the duration `limit`.
    pub(super) async fn idle_for(&self, limit: Duration) {
        loop {
            let (requests, since) = {
                let state = self.state();
                (state.requests, state.since)
            };
            let rest = match requests {
                0 => limit.saturating_sub(since.elapsed()),
                _ => limit / CHECKS,
            };
            if rest.is_zero() {
                return;
            }
            tokio::time::sleep(rest).await;
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        let mut state = self.0.state();
        state.requests -= 1;
        state.since = Instant::now();
    }
}

impl Drop for ConnectionEntry {
    fn drop(&mut self) {
        self.table.table().all.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);
    const THERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::new(10, 0, 0, 1));

    fn table(general: usize, of_address: usize, workers: usize) -> Arc<Connections> {
        let limits = ConnectionLimits {
            general,
            of_address,
            workers,
            ..ConnectionLimits::for_descriptors(1024)
        };
        Connections::new(limits)
    }

    fn is_open(entry: &ConnectionEntry) -> bool {
        entry.table.table().all.contains_key(&entry.number)
    }

    #[test]
    fn table_closes_longest_idle_connection_at_cap() {
        let table = table(3, 3, 1);
        let [first, second, third] = [(); 3].map(|()| table.add(HERE, false));
        // After a finished request, the first connection has been idle for the shortest time.
        first.connection.admitted(&table, false);
        drop(first.connection.begin());
        let _fourth = table.add(HERE, false);
        assert!(is_open(&first) && !is_open(&second) && is_open(&third));
        assert_eq!(table.table().all.len(), 3);
    }

    #[test]
    fn half_sent_request_of_unknown_caller_does_not_protect() {
        let table = table(2, 2, 1);
        let [admitted, stranger] = [(); 2].map(|()| table.add(HERE, false));
        admitted.connection.admitted(&table, false);
        let _call = admitted.connection.begin();
        let _half_sent = stranger.connection.begin();
        let _third = table.add(HERE, false);
        assert!(is_open(&admitted) && !is_open(&stranger));
    }

    #[test]
    fn table_keeps_connections_of_workers_and_of_open_calls() {
        let table = table(2, 2, 1);
        let worker = table.add(HERE, false);
        worker.connection.admitted(&table, true);
        let watcher = table.add(HERE, false);
        watcher.connection.admitted(&table, false);
        let _call = watcher.connection.begin();
        for _ in 0..50 {
            drop(table.add(HERE, false));
        }
        let flood: Vec<ConnectionEntry> = (0..50).map(|_| table.add(HERE, false)).collect();
        assert!(is_open(&worker) && is_open(&watcher));
        assert_eq!(flood.iter().filter(|entry| is_open(entry)).count(), 1);
        // The second worker exceeds the workers' cap, so its connection can be closed.
        let second = table.add(THERE, false);
        second.connection.admitted(&table, true);
        drop(second.connection.begin());
        assert_eq!(second.connection.state().trust, Trust::Admitted);
    }

    #[test]
    fn lack_of_descriptors_closes_longest_idle_connection_except_workers() {
        let table = table(100, 100, 2);
        let [first, worker, second] = [(); 3].map(|()| table.add(HERE, false));
        worker.connection.admitted(&table, true);
        table.evict_one();
        assert_eq!([&first, &worker, &second].map(is_open), [false, true, true]);
        table.evict_one();
        table.evict_one();
        assert_eq!(
            [&first, &worker, &second].map(is_open),
            [false, true, false]
        );
    }

    #[test]
    fn caps_of_address_and_of_handshakes_close_oldest() {
        let table = table(100, 2, 1);
        let elsewhere = table.add(THERE, false);
        let here: Vec<ConnectionEntry> = (0..5).map(|_| table.add(HERE, false)).collect();
        assert!(is_open(&elsewhere));
        assert_eq!(
            here.iter().map(is_open).collect::<Vec<_>>(),
            [false, false, false, true, true]
        );
        drop((elsewhere, here));
        assert!(table.table().all.is_empty());

        let limits = ConnectionLimits {
            handshakes: 3,
            handshakes_of_address: 2,
            ..ConnectionLimits::for_descriptors(1024)
        };
        let table = Connections::new(limits);
        let shaking: Vec<ConnectionEntry> = [HERE, HERE, HERE, THERE, THERE]
            .map(|from| table.add(from, true))
            .into();
        assert_eq!(
            shaking.iter().map(is_open).collect::<Vec<_>>(),
            [false, false, true, true, true]
        );
        // A finished handshake does not count.
        shaking[2].connection.shaken();
        let _next = [table.add(HERE, true), table.add(HERE, false)];
        assert!(shaking.iter().skip(2).all(is_open));
    }
}
