//! Records a tile as a crew of one: the items are those that a crew shares out, because a crew is asked for
//! every phase.

use std::sync::{Mutex, MutexGuard, PoisonError};

use sightline_sampling::TileError;
use sightline_sampling::crew::{Crew, ForeignFinds, Phase};

use crate::clock::{now, timed};
use crate::trace::{BlockTrace, ItemTrace, PhaseTrace};

/// Whose work is timed.
pub enum As {
    /// A leader without helpers, which makes outcomes.
    Leader,
    /// A helper that computes every item and gives each away; with the outcomes of the leader.
    Helper(Vec<Vec<u8>>),
}

/// A crew of one that keeps times and sizes.
pub struct Recorder {
    role: As,
    state: Mutex<State>,
}

/// What was recorded so far.
pub struct State {
    /// The tile.
    pub block: BlockTrace,
    /// The outcomes that a leader made.
    pub outcomes: Vec<Vec<u8>>,
    /// When the last recorded part ended.
    last: u64,
}

impl Recorder {
    /// A recorder of a tile that begins now.
    pub fn new(role: As, cells: u64) -> Self {
        let block = BlockTrace {
            cells,
            begin: 0,
            phases: Vec::new(),
            end: 0,
            output: 0,
            assemble: 0,
        };
        Self {
            role,
            state: Mutex::new(State {
                block,
                outcomes: Vec::new(),
                last: now(),
            }),
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // Each change is whole before anything can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The recording of a tile that has ended with `output` bytes.
    pub fn ended(self, output: u64) -> State {
        let mut state = self
            .state
            .into_inner()
            .unwrap_or_else(PoisonError::into_inner);
        state.block.end = now() - state.last;
        state.block.output = output;
        state
    }
}

impl State {
    /// Counts the time since the last part for what lies between phases.
    fn close_gap(&mut self) {
        let gap = now() - self.last;
        match self.block.phases.last_mut() {
            Some(phase) => phase.gap = gap,
            None => self.block.begin = gap,
        }
    }
}

/// The recorder adds what the same program has found, so this does not happen.
fn foreign(_: ForeignFinds) -> TileError {
    TileError::Cancelled
}

impl Crew for Recorder {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        let mut state = self.state();
        state.close_gap();
        let ((), prepare) = timed(|| phase.prepare());
        let costs = phase.costs();
        let (mut items, mut finds) = (Vec::new(), Vec::new());
        for item in 0..phase.items() {
            let (done, compute) = timed(|| phase.compute(item, &|| false));
            done?;
            let mut trace = ItemTrace {
                compute,
                take: 0,
                bytes: 0,
                add: 0,
            };
            if let As::Helper(_) = self.role {
                let (found, take) = timed(|| phase.take(&[item]));
                (trace.take, trace.bytes) = (take, found.len() as u64);
                finds.push(found);
            }
            items.push(trace);
        }
        for (item, found) in items.iter_mut().zip(&finds) {
            let (added, add) = timed(|| phase.add(found));
            added.map_err(foreign)?;
            item.add = add;
        }
        let (outcome, encode) = match &self.role {
            As::Leader => timed(|| phase.outcome()),
            As::Helper(outcomes) => {
                let outcome = outcomes
                    .get(state.block.phases.len())
                    .ok_or(TileError::Cancelled)?;
                (outcome.clone(), u64::MAX)
            }
        };
        let (added, add) = timed(|| phase.add(&outcome));
        added.map_err(foreign)?;
        let bytes = outcome.len() as u64;
        state.block.phases.push(PhaseTrace {
            prepare,
            costs,
            items,
            encode,
            outcome: bytes,
            add,
            gap: 0,
        });
        state.outcomes.push(outcome);
        state.last = now();
        Ok(())
    }

    fn end(&self) -> Result<(), TileError> {
        let mut state = self.state();
        state.close_gap();
        state.last = now();
        Ok(())
    }
}
