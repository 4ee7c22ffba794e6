//! A helper of a crew: computes the items that the leader gives it, and takes the outcomes of the phases from
//! the leader.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rayon::prelude::*;

use super::member::{Crew, Phase};
use super::queue::IN_HAND;
use crate::context::Watcher;
use crate::error::TileError;

/// A helper that waits for the leader looks this often whether it is told to stop.
const LOOK: Duration = Duration::from_millis(200);

/// What a helper hears.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ToHelper {
    /// Items of a phase to compute.
    Take {
        /// The number of the phase, from 0.
        phase: u32,
        /// The items.
        items: Vec<u32>,
    },
    /// The outcome of a phase. The outcomes of all phases come, in their order.
    Outcome {
        /// The number of the phase.
        phase: u32,
        /// The bytes of [`Phase::outcome`].
        bytes: Vec<u8>,
    },
    /// Nothing more is needed.
    End,
}

/// What a helper says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FromHelper {
    /// It is ready for items of a phase. Those of later phases come unasked.
    Ask {
        /// The number of the phase.
        phase: u32,
    },
    /// Its finds of all items of a piece.
    Found {
        /// The number of the phase.
        phase: u32,
        /// The items.
        items: Vec<u32>,
        /// The bytes of [`Phase::take`].
        finds: Vec<u8>,
    },
}

/// A helper of a crew.
pub struct Helper {
    state: Mutex<HelperState>,
    changed: Condvar,
    watcher: Arc<dyn Watcher + Send>,
    /// Must not wait for the leader.
    out: Box<dyn Fn(FromHelper) + Send + Sync>,
}

#[derive(Default)]
struct HelperState {
    number: u32,
    outcomes: BTreeMap<u32, Vec<u8>>,
    pieces: VecDeque<(u32, Vec<u32>)>,
    is_over: bool,
    /// Whether it has asked for items of a phase before.
    has_asked: bool,
}

/// What a helper does next.
enum HelperStep {
    Finish(Vec<u8>),
    Compute(Vec<u32>),
    Stop,
}

impl Helper {
    /// A helper that has heard nothing. `out` must not wait for the leader.
    pub fn new(
        watcher: Arc<dyn Watcher + Send>,
        out: impl Fn(FromHelper) + Send + Sync + 'static,
    ) -> Self {
        Self {
            state: Mutex::default(),
            changed: Condvar::new(),
            watcher,
            out: Box::new(out),
        }
    }

    /// Takes a message. Called from any thread; never waits.
    pub fn hear(&self, message: ToHelper) {
        let mut state = self.lock();
        match message {
            ToHelper::Take { phase, items } => state.pieces.push_back((phase, items)),
            ToHelper::Outcome { phase, bytes } => {
                if phase >= state.number {
                    state.outcomes.insert(phase, bytes);
                }
            }
            ToHelper::End => state.is_over = true,
        }
        drop(state);
        self.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, HelperState> {
        // Each change is whole before anything can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether the outcome of a phase is here, so that its items are not needed any more.
    fn is_finished(&self, number: u32) -> bool {
        let state = self.lock();
        state.is_over || state.outcomes.contains_key(&number)
    }

    /// Waits for the next thing to do in a phase.
    fn step(&self, number: u32) -> HelperStep {
        let mut state = self.lock();
        loop {
            if state.is_over || self.watcher.cancelled() {
                return HelperStep::Stop;
            }
            if let Some(outcome) = state.outcomes.remove(&number) {
                state.number = number + 1;
                return HelperStep::Finish(outcome);
            }
            // Pieces of phases that are over are of no use.
            state.pieces.retain(|(phase, _)| *phase >= number);
            if state
                .pieces
                .front()
                .is_some_and(|(phase, _)| *phase == number)
                && let Some((_, items)) = state.pieces.pop_front()
            {
                return HelperStep::Compute(items);
            }
            let waited = self.changed.wait_timeout(state, LOOK);
            (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        }
    }
}

impl Crew for Helper {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        let number = self.lock().number;
        if !self.is_finished(number) {
            phase.prepare();
            if !std::mem::replace(&mut self.lock().has_asked, true) {
                (0..IN_HAND).for_each(|_| (self.out)(FromHelper::Ask { phase: number }));
            }
        }
        loop {
            match self.step(number) {
                HelperStep::Finish(outcome) => {
                    let added = phase.add(&outcome);
                    if let Err(e) = &added {
                        tracing::warn!("the outcome of phase {number} is of no use: {e}");
                    }
                    let whole = added.is_ok() && (0..phase.items()).all(|item| phase.has(item));
                    return if whole {
                        Ok(())
                    } else {
                        Err(TileError::Cancelled)
                    };
                }
                HelperStep::Compute(items) => {
                    if items.iter().any(|i| *i as usize >= phase.items()) {
                        tracing::warn!("the leader gave items that phase {number} does not have");
                        return Err(TileError::Cancelled);
                    }
                    items.par_iter().with_max_len(1).try_for_each(|item| {
                        match self.is_finished(number) {
                            true => Ok(()),
                            false => phase.compute(*item as usize, &|| self.is_finished(number)),
                        }
                    })?;
                    if !self.is_finished(number) {
                        let places: Vec<usize> = items.iter().map(|i| *i as usize).collect();
                        let finds = phase.take(&places);
                        (self.out)(FromHelper::Found {
                            phase: number,
                            items,
                            finds,
                        });
                        (self.out)(FromHelper::Ask { phase: number });
                    }
                }
                HelperStep::Stop => return Err(TileError::Cancelled),
            }
        }
    }

    fn end(&self) -> Result<(), TileError> {
        Err(TileError::Cancelled)
    }
}
