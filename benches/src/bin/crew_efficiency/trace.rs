//! What was measured of a bake. Times are nanoseconds of processor time with one thread.

use serde::{Deserialize, Serialize};

/// The measurements of one scene with one set of parameters.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Trace {
    /// What every process does with the scene.
    pub scene: SceneTrace,
    /// Leaf tiles of the whole job.
    pub tiles: usize,
    /// Cells of the whole job.
    pub cells: u64,
    /// The measured tiles.
    pub blocks: Vec<BlockTrace>,
}

/// The preparation of a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SceneTrace {
    /// Reading the user's file.
    pub load: u64,
    /// Bytes of the scene as workers fetch it.
    pub bytes: u64,
    /// Checking and parsing these bytes.
    pub parse: u64,
    /// Neighbours, orders and the hierarchy.
    pub facts: u64,
}

/// One tile.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BlockTrace {
    /// Its cells.
    pub cells: u64,
    /// What comes before the first phase: the table, and which triangles meet which cells.
    pub begin: u64,
    /// The phases.
    pub phases: Vec<PhaseTrace>,
    /// What comes after the last phase: columns, and the bytes of the output.
    pub end: u64,
    /// Bytes of the output.
    pub output: u64,
    /// What the coordinator does with the output when it assembles the result.
    pub assemble: u64,
}

/// One phase.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PhaseTrace {
    /// Lists of candidates.
    pub prepare: u64,
    /// The expected costs by which items are shared out.
    pub costs: Vec<u64>,
    /// The items.
    pub items: Vec<ItemTrace>,
    /// Encoding the outcome.
    pub encode: u64,
    /// Its bytes.
    pub outcome: u64,
    /// Decoding and adding it.
    pub add: u64,
    /// What every member does alone until the next phase begins: the barrier and decisions.
    pub gap: u64,
}

/// One item.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ItemTrace {
    /// Computing it.
    pub compute: u64,
    /// Taking its finds out and encoding them.
    pub take: u64,
    /// Bytes of its finds.
    pub bytes: u64,
    /// Decoding and adding them.
    pub add: u64,
}

impl PhaseTrace {
    /// Computing all items.
    pub fn work(&self) -> u64 {
        self.items.iter().map(|i| i.compute).sum()
    }

    /// Keeps the least of each time, of this and another recording of the same phase.
    fn least(&mut self, other: &Self) {
        for (a, b) in [
            (&mut self.prepare, other.prepare),
            (&mut self.encode, other.encode),
            (&mut self.add, other.add),
            (&mut self.gap, other.gap),
        ] {
            *a = b.min(*a);
        }
        for (a, b) in self.items.iter_mut().zip(&other.items) {
            a.compute = a.compute.min(b.compute);
        }
    }

    /// Bytes of the finds of some items together. Items of a phase find the same things in part: the bytes
    /// grow as a power of the number of items, which the measured sizes of one and of all items give.
    pub fn finds(&self, items: &[u32]) -> u64 {
        let sum: u64 = items.iter().map(|i| self.items[*i as usize].bytes).sum();
        let mean =
            self.items.iter().map(|i| i.bytes).sum::<u64>() as f64 / self.items.len().max(1) as f64;
        if items.len() < 2 || mean <= 0.0 {
            return sum;
        }
        let power = (self.outcome as f64 / mean).ln() / (self.items.len() as f64).ln();
        (sum as f64 * (items.len() as f64).powf(power.clamp(0.0, 1.0) - 1.0)) as u64
    }

    /// Taking out and encoding the finds of some items: what the cheapest item took, and time for each byte
    /// as of the outcome.
    pub fn take(&self, items: &[u32]) -> u64 {
        let least = self.items.iter().map(|i| i.take).min().unwrap_or(0);
        least + self.finds(items) * self.encode / self.outcome.max(1)
    }

    /// Decoding and adding the finds of some items.
    pub fn add_finds(&self, items: &[u32]) -> u64 {
        let (bytes, add) = self
            .items
            .iter()
            .fold((0, 0), |(b, a), i| (b + i.bytes, a + i.add));
        self.finds(items) * add / bytes.max(1)
    }
}

impl BlockTrace {
    /// Keeps the least of each time, of this and another recording of the same tile.
    pub fn least(&mut self, other: &Self) {
        self.begin = self.begin.min(other.begin);
        self.end = self.end.min(other.end);
        self.phases
            .iter_mut()
            .zip(&other.phases)
            .for_each(|(a, b)| a.least(b));
    }

    /// The time of one worker alone, without the bytes of outcomes.
    pub fn alone(&self) -> u64 {
        let phases: u64 = self
            .phases
            .iter()
            .map(|p| p.prepare + p.work() + p.gap)
            .sum();
        self.begin + phases + self.end
    }
}
