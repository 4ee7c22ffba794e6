//! Links that carry one message after the other, and a latency between a worker and the coordinator.

/// The network's figures.
#[derive(Clone, Copy, Debug)]
pub struct Network {
    /// Nanoseconds between a worker and the coordinator, one way.
    pub latency: u64,
    /// Bits per second of a worker, each way.
    pub worker: f64,
    /// Bits per second of the coordinator, each way.
    pub coordinator: f64,
}

/// Bytes of a message beside finds and outcomes.
pub const FRAME: u64 = 64;

/// A link; it is free from this time on.
#[derive(Clone, Copy, Debug, Default)]
pub struct Link(u64);

impl Link {
    /// Carries bytes that begin to come at `first` and are all there at `last`; the same two times behind it.
    fn carry(&mut self, (first, last): (u64, u64), bytes: u64, bits_per_second: f64) -> (u64, u64) {
        let begin = self.0.max(first);
        let end = (begin + (bytes as f64 * 8e9 / bits_per_second) as u64).max(last);
        self.0 = end;
        (begin, end)
    }
}

/// The links of all workers and of the coordinator.
#[derive(Debug)]
pub struct Links {
    network: Network,
    up: Vec<Link>,
    down: Vec<Link>,
    coordinator: [Link; 2],
    /// Bytes into and out of the coordinator.
    pub bytes: u64,
}

impl Links {
    /// Free links for a number of workers.
    pub fn new(network: Network, workers: usize) -> Self {
        let free = vec![Link::default(); workers];
        Self {
            network,
            up: free.clone(),
            down: free,
            coordinator: Default::default(),
            bytes: 0,
        }
    }

    /// When a message of a worker is at the coordinator.
    pub fn up(&mut self, now: u64, worker: usize, bytes: u64) -> u64 {
        self.bytes += bytes;
        let left = self.up[worker].carry((now, now), bytes, self.network.worker);
        self.coordinator[0]
            .carry(left, bytes, self.network.coordinator)
            .1
            + self.network.latency
    }

    /// When a message of the coordinator is at a worker.
    pub fn down(&mut self, now: u64, worker: usize, bytes: u64) -> u64 {
        self.bytes += bytes;
        let left = self.coordinator[1].carry((now, now), bytes, self.network.coordinator);
        self.down[worker].carry(left, bytes, self.network.worker).1 + self.network.latency
    }

    /// The time that a client needs to upload bytes.
    pub fn upload(&mut self, bytes: u64) -> u64 {
        self.bytes += bytes;
        (bytes as f64 * 8e9 / self.network.worker) as u64 + self.network.latency
    }
}
