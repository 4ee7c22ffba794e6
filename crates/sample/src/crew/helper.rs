//! A helper of a crew: computes the items that the leader assigns, and receives the outcomes of the phases
//! from the leader.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rayon::prelude::*;
use sightline_numbers::ids::PhaseIndex;

use super::member::{Crew, Phase};
use super::queue::IN_HAND;
use crate::context::Watcher;
use crate::error::TileError;

/// The interval at which a waiting helper checks if its watcher has cancelled the tile.
const LOOK: Duration = Duration::from_millis(200);

/// A message to a helper.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ToHelper {
    /// Items of a phase to compute.
    Take {
        /// The number of the phase, starting at 0.
        phase: PhaseIndex,
        /// The indices of the items in the phase.
        items: Vec<u32>,
    },
    /// The outcome of a phase. A helper receives the outcomes of all phases, in their order.
    Outcome {
        /// The phase.
        phase: PhaseIndex,
        /// The encoded results of all items, from [`Phase::outcome`].
        bytes: Vec<u8>,
    },
    /// The work has ended; the helper is no longer needed.
    End,
}

/// A message from a helper.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FromHelper {
    /// The helper is ready for items of a phase. The helper receives items of later phases without another
    /// request.
    Ask {
        /// The phase.
        phase: PhaseIndex,
    },
    /// The helper's results for all items of one [`ToHelper::Take`].
    Found {
        /// The phase.
        phase: PhaseIndex,
        /// The items.
        items: Vec<u32>,
        /// The encoded results of these items, from [`Phase::take`].
        finds: Vec<u8>,
    },
}

/// A helper of a crew.
pub struct Helper {
    state: Mutex<HelperState>,
    changed: Condvar,
    watcher: Arc<dyn Watcher + Send>,
    /// The function that sends a message to the leader. The function must not wait for the leader.
    out: Box<dyn Fn(FromHelper) + Send + Sync>,
}

#[derive(Default)]
struct HelperState {
    number: PhaseIndex,
    outcomes: BTreeMap<PhaseIndex, Vec<u8>>,
    pieces: VecDeque<(PhaseIndex, Vec<u32>)>,
    is_over: bool,
    /// True if the helper has sent its first requests for items.
    has_asked: bool,
}

/// The next step of a helper in a phase.
enum HelperStep {
    Finish(Vec<u8>),
    Compute(Vec<u32>),
    Stop,
}

impl Helper {
    /// Creates a helper that has received no message. `out` must not wait for the leader.
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

    /// Receives a message. Any thread may call this function, which never waits.
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
        // Each change of the state is complete before code can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns true if the outcome of a phase has arrived or the work has ended, so that its items are not
    /// needed.
    fn is_finished(&self, number: PhaseIndex) -> bool {
        let state = self.lock();
        state.is_over || state.outcomes.contains_key(&number)
    }

    /// Waits for the next step in phase `number`.
    fn step(&self, number: PhaseIndex) -> HelperStep {
        let mut state = self.lock();
        loop {
            if state.is_over || self.watcher.cancelled() {
                return HelperStep::Stop;
            }
            if let Some(outcome) = state.outcomes.remove(&number) {
                state.number = PhaseIndex(number.0 + 1);
                return HelperStep::Finish(outcome);
            }
            // Pieces of finished phases are not needed.
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
                        tracing::warn!("the outcome of phase {number} is unusable: {e}");
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
                        tracing::warn!(
                            "the leader assigned items that phase {number} does not have"
                        );
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
