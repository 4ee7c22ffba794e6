//! The leader of a crew.
//!
//! The leader divides the items of each phase, computes the items that it has not assigned to helpers, and
//! publishes the outcomes. Without helpers, the leader computes all items and still publishes the outcomes.
//!
//! The leader stores outcomes until a recipient confirms their storage, so a leader whose stream broke can
//! continue with new helpers. The leader does not wait for helpers: if no item is free, it computes the items
//! that helpers have not answered yet, and the first answer counts. A slow, silent or lost helper therefore
//! costs at most the time that it would have saved.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use sightline_numbers::ids::PhaseIndex;

use super::member::{Crew, Phase};
use super::queue::{IN_HAND, Member, Queue};
use crate::context::Watcher;
use crate::error::TileError;

/// The interval at which a leader without helpers sends its outcomes to their storage.
const HAND_OVER: Duration = Duration::from_secs(1);

/// A message to the leader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ToLeader {
    /// A helper has joined. The helper has received all outcomes that the leader sent before.
    Joined(Member),
    /// A helper is ready for items of a phase and of every later phase.
    Ask {
        /// The helper that is ready.
        member: Member,
        /// The number of the phase, starting at 0.
        phase: PhaseIndex,
    },
    /// A helper's results for all items of one [`FromLeader::Take`].
    Found {
        /// The helper.
        member: Member,
        /// The phase.
        phase: PhaseIndex,
        /// The items.
        items: Vec<u32>,
        /// The bytes of [`Phase::take`].
        finds: Vec<u8>,
    },
    /// A helper has left.
    Left(Member),
    /// The outcomes of the first phases are stored. The field is the number of these phases.
    Kept(u32),
}

/// A message from the leader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FromLeader {
    /// Items for a helper.
    Take {
        /// The helper.
        member: Member,
        /// The phase.
        phase: PhaseIndex,
        /// The items.
        items: Vec<u32>,
    },
    /// The outcome of a phase, for all helpers and for the storage of outcomes.
    Outcome {
        /// The phase.
        phase: PhaseIndex,
        /// The bytes of [`Phase::outcome`].
        bytes: Arc<Vec<u8>>,
        /// The duration of the phase, including helpers' work and encoding.
        time: Duration,
    },
    /// The helper is dismissed, because its results could not be used.
    Dismiss(Member),
    /// No more phases follow.
    End,
}

/// The leader of a crew.
pub struct Leader {
    state: Mutex<LeaderState>,
    /// The condition variable that the leader notifies when a helper's results have arrived or the phase is
    /// over.
    news: Condvar,
    watcher: Arc<dyn Watcher + Send>,
    /// The function that sends a message to the other members. The function must not wait for them.
    out: Box<dyn Fn(FromLeader) + Send + Sync>,
}

#[derive(Default)]
struct LeaderState {
    /// The unused outcomes of an earlier leader, by phase.
    earlier: BTreeMap<PhaseIndex, Vec<u8>>,
    /// The number of the current phase, or of the next phase between two phases.
    number: PhaseIndex,
    /// The items of the current phase without answers. `None` between two phases.
    queue: Option<Queue>,
    helpers: BTreeSet<Member>,
    /// The helpers that have requested items, each with the first phase whose items the helper accepts.
    ready: BTreeMap<Member, PhaseIndex>,
    /// The helpers without items, with the phase for which each is ready.
    asking: VecDeque<(Member, PhaseIndex)>,
    /// The results of helpers that the leader has not added yet: helper, items, and encoded results.
    done: VecDeque<(Member, Vec<u32>, Vec<u8>)>,
    /// The outcomes whose storage is not confirmed yet: phase, bytes, and duration of the phase.
    outcomes: VecDeque<(PhaseIndex, Arc<Vec<u8>>, Duration)>,
    /// The number of the first phase whose outcome the leader has not sent yet.
    handed: PhaseIndex,
    /// The time at which the leader last sent outcomes.
    handed_over: Option<Instant>,
    /// The rays of helpers, by helper, for the log.
    rays: BTreeMap<Member, u64>,
    /// The time spent on preparing phases, computing items and encoding outcomes, for the log.
    times: [Duration; 3],
    /// True if no more phases follow.
    has_ended: bool,
}

/// The next step of a thread of the leader.
enum LeaderStep {
    Add(Member, Vec<u32>, Vec<u8>),
    Compute(usize),
    Nothing,
}

impl Leader {
    /// Creates the leader of a block whose first phases have these outcomes. `out` must not wait for the
    /// other members.
    pub fn new(
        outcomes: Vec<Vec<u8>>,
        watcher: Arc<dyn Watcher + Send>,
        out: impl Fn(FromLeader) + Send + Sync + 'static,
    ) -> Self {
        let state = LeaderState {
            earlier: (0..).map(PhaseIndex).zip(outcomes).collect(),
            ..LeaderState::default()
        };
        Self {
            state: Mutex::new(state),
            news: Condvar::new(),
            watcher,
            out: Box::new(out),
        }
    }

    /// Processes a message. Any thread may call this function, which never waits for a phase.
    pub fn hear(&self, message: ToLeader) {
        let mut state = self.lock();
        match message {
            ToLeader::Joined(member) => {
                state.helpers.insert(member);
                self.hand_over(&mut state);
            }
            ToLeader::Ask { member, phase } => {
                let is_new =
                    state.helpers.contains(&member) && state.ready.insert(member, phase).is_none();
                if is_new && phase < state.number {
                    // The phase is over, so the helper receives items of the current phase.
                    let now = state.number;
                    (0..IN_HAND).for_each(|_| state.asking.push_back((member, now)));
                    self.give(&mut state);
                } else if state.helpers.contains(&member)
                    && phase >= state.number
                    && state.asking.iter().filter(|(m, _)| *m == member).count() < IN_HAND
                {
                    state.asking.push_back((member, phase));
                    self.give(&mut state);
                }
            }
            ToLeader::Found {
                member,
                phase,
                items,
                finds,
            } => {
                // Late results are not needed, because the phase is over.
                if state.helpers.contains(&member) && phase == state.number && state.queue.is_some()
                {
                    state.done.push_back((member, items, finds));
                    self.news.notify_one();
                }
            }
            ToLeader::Left(member) => self.dismiss(&mut state, member),
            ToLeader::Kept(phases) => {
                while state
                    .outcomes
                    .front()
                    .is_some_and(|(phase, ..)| phase.0 < phases)
                {
                    state.outcomes.pop_front();
                }
            }
        }
    }

    /// Switches to a new connection. The other end of the connection has stored the outcomes of the first
    /// `there` phases.
    ///
    /// Returns true if the leader still has the outcomes of all later phases, which helpers need. `turn`
    /// redirects `out` to the new connection.
    pub fn reopened(&self, there: u32, turn: impl FnOnce()) -> bool {
        let mut state = self.lock();
        let first = state
            .outcomes
            .front()
            .map_or(state.number, |(phase, ..)| *phase);
        let there = PhaseIndex(there);
        if there < first {
            return false;
        }
        state.handed = there;
        // No message is sent in between, so the first outcome on the new connection is the outcome of phase
        // `there`.
        turn();
        self.hand_over(&mut state);
        true
    }

    /// Returns true if no more phases follow, so that helpers are not needed.
    pub fn has_ended(&self) -> bool {
        self.lock().has_ended
    }

    /// Returns the number of the current phase, or of the next phase between two phases.
    pub fn phase(&self) -> PhaseIndex {
        self.lock().number
    }

    /// Adds the outcomes of an earlier leader for the phases from `from` on, which were unknown when this
    /// leader was created. The leader ignores outcomes of phases that it has begun.
    pub fn learn(&self, from: PhaseIndex, outcomes: Vec<Vec<u8>>) {
        self.lock()
            .earlier
            .extend((from.0..).map(PhaseIndex).zip(outcomes));
    }

    fn lock(&self) -> MutexGuard<'_, LeaderState> {
        // Each change of the state is complete before code can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Assigns free items to helpers that have asked for items.
    fn give(&self, state: &mut LeaderState) {
        let (number, members) = (state.number, state.helpers.len() + 1);
        let Some(queue) = &mut state.queue else {
            return;
        };
        let mut waiting = VecDeque::new();
        while let Some((member, phase)) = state.asking.pop_front() {
            let piece = if phase == number {
                queue.piece(member, members)
            } else {
                Vec::new()
            };
            if piece.is_empty() {
                waiting.push_back((member, phase));
            } else {
                let items = piece.into_iter().map(|i| i as u32).collect();
                (self.out)(FromLeader::Take {
                    member,
                    phase,
                    items,
                });
            }
        }
        state.asking = waiting;
    }

    /// Removes a helper and frees the items that were assigned to it.
    fn dismiss(&self, state: &mut LeaderState, member: Member) {
        state.helpers.remove(&member);
        state.ready.remove(&member);
        // Later results of a helper omit the bits that its earlier results contained.
        state.done.retain(|(m, ..)| *m != member);
        state.asking.retain(|(m, _)| *m != member);
        if state
            .queue
            .as_mut()
            .is_some_and(|queue| queue.take_back(member))
        {
            self.give(state);
        }
    }

    /// Sends the outcomes in `state` that the leader has not sent yet.
    fn hand_over(&self, state: &mut LeaderState) {
        let from = state.handed;
        for (phase, bytes, time) in state.outcomes.iter().filter(|(phase, ..)| *phase >= from) {
            let (phase, bytes, time) = (*phase, Arc::clone(bytes), *time);
            (self.out)(FromLeader::Outcome { phase, bytes, time });
        }
        state.handed = state
            .outcomes
            .back()
            .map_or(from, |(phase, ..)| from.max(PhaseIndex(phase.0 + 1)));
        state.handed_over = Some(Instant::now());
    }

    /// Adds the outcome of an earlier leader to the phase. Returns true if every item then has an answer.
    fn is_known(&self, phase: &dyn Phase) -> bool {
        let outcome = {
            let mut state = self.lock();
            let number = state.number;
            state.earlier.remove(&number)
        };
        let Some(outcome) = outcome else { return false };
        let whole = match phase.add(&outcome) {
            Ok(rays) => {
                self.watcher.rendered(rays);
                (0..phase.items()).all(|item| phase.has(item))
            }
            Err(e) => {
                tracing::warn!(
                    "an earlier outcome of this block is unusable, and the block continues without \
                     it: {e}"
                );
                false
            }
        };
        if !whole {
            self.lock().earlier.clear();
        }
        whole
    }

    /// Returns the next step of a thread in a phase.
    fn step(&self) -> LeaderStep {
        let mut state = self.lock();
        if let Some((member, items, finds)) = state.done.pop_front() {
            return LeaderStep::Add(member, items, finds);
        }
        let queue = state.queue.as_mut();
        let item = queue.and_then(|queue| queue.next_free().or_else(|| queue.next_given()));
        item.map_or(LeaderStep::Nothing, LeaderStep::Compute)
    }

    /// Adds the results of a helper to the phase, or dismisses the helper if the results are invalid.
    fn add(&self, phase: &dyn Phase, member: Member, items: &[u32], finds: &[u8]) {
        match phase.add(finds) {
            Ok(rays) => {
                self.watcher.rendered(rays);
                let mut state = self.lock();
                *state.rays.entry(member).or_default() += rays;
                if let Some(queue) = &mut state.queue {
                    let there = items.iter().map(|i| *i as usize).filter(|i| phase.has(*i));
                    there.for_each(|item| queue.answered(item));
                }
            }
            Err(e) => {
                tracing::warn!("helper {member} is dismissed: {e}");
                self.dismiss(&mut self.lock(), member);
                (self.out)(FromLeader::Dismiss(member));
            }
        }
    }

    /// Adds the results of helpers as they arrive, until the phase is over. The other threads may be busy
    /// with long items that helpers have answered.
    fn add_all(&self, phase: &dyn Phase) {
        let mut state = self.lock();
        while state.queue.is_some() {
            if let Some((member, items, finds)) = state.done.pop_front() {
                drop(state);
                self.add(phase, member, &items, &finds);
                state = self.lock();
            } else {
                state = self
                    .news
                    .wait(state)
                    .unwrap_or_else(PoisonError::into_inner);
            }
        }
    }

    /// Computes items until every item has an answer, as one of the leader's threads.
    fn work(&self, phase: &dyn Phase, failed: &Mutex<Option<TileError>>) {
        let is_failed = || failed.lock().is_ok_and(|f| f.is_some());
        while !is_failed() {
            match self.step() {
                LeaderStep::Add(member, items, finds) => self.add(phase, member, &items, &finds),
                LeaderStep::Compute(item) if phase.has(item) => {}
                // A helper's answer may arrive while the leader computes a long item again.
                LeaderStep::Compute(item) => match phase.compute(item, &|| phase.has(item)) {
                    Ok(()) => {
                        if let Some(queue) = &mut self.lock().queue {
                            queue.answered(item);
                        }
                    }
                    Err(e) => {
                        if let Ok(mut failed) = failed.lock() {
                            failed.get_or_insert(e);
                        }
                    }
                },
                LeaderStep::Nothing => break,
            }
        }
    }
}

impl Crew for Leader {
    fn run(&self, phase: &dyn Phase) -> Result<(), TileError> {
        if self.is_known(phase) {
            let mut state = self.lock();
            state.number.0 += 1;
            return Ok(());
        }
        let begun = Instant::now();
        phase.prepare();
        let prepared = begun.elapsed();
        {
            let mut state = self.lock();
            state.queue = Some(Queue::new(phase.costs()));
            let number = state.number;
            // Helpers receive one piece each in turn. A helper that has asked once stays ready.
            state.asking.clear();
            for _ in 0..IN_HAND {
                // A helper that knows the outcomes of later phases drops items of this phase.
                let ready = state.ready.iter().filter(|(_, from)| **from <= number);
                let ready: Vec<Member> = ready.map(|(member, _)| *member).collect();
                state
                    .asking
                    .extend(ready.into_iter().map(|member| (member, number)));
            }
            self.give(&mut state);
        }
        let failed = Mutex::new(None);
        std::thread::scope(|threads| {
            threads.spawn(|| self.add_all(phase));
            let _over = PhaseEnd(self);
            rayon::scope(|scope| {
                (0..rayon::current_num_threads())
                    .for_each(|_| scope.spawn(|_| self.work(phase, &failed)));
            });
        });
        let failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
        let mut state = self.lock();
        if let Some(e) = failed {
            return Err(e);
        }
        let number = state.number;
        state.number.0 += 1;
        state.asking.clear();
        let since = *state.handed_over.get_or_insert_with(Instant::now);
        drop(state);
        let computed = begun.elapsed();
        let bytes = phase.outcome();
        let mut state = self.lock();
        let times = [prepared, computed - prepared, begun.elapsed() - computed];
        state
            .times
            .iter_mut()
            .zip(times)
            .for_each(|(sum, time)| *sum += time);
        state
            .outcomes
            .push_back((number, Arc::new(bytes), begun.elapsed()));
        if !state.helpers.is_empty() || since.elapsed() >= HAND_OVER {
            self.hand_over(&mut state);
        }
        Ok(())
    }

    fn end(&self) -> Result<(), TileError> {
        let mut state = self.lock();
        state.has_ended = true;
        (self.out)(FromLeader::End);
        let [prepared, computed, encoded] = state.times;
        tracing::debug!("prepared {prepared:?}, computed {computed:?}, encoded {encoded:?}");
        if !state.rays.is_empty() {
            tracing::debug!("rays of helpers: {:?}", state.rays);
        }
        Ok(())
    }
}

impl Drop for Leader {
    /// Dismisses the helpers of a tile that failed or was cancelled.
    fn drop(&mut self) {
        if !self.has_ended() {
            (self.out)(FromLeader::End);
        }
    }
}

/// A guard that stops the adding of results at the end of a phase, also after a panic.
struct PhaseEnd<'a>(&'a Leader);

impl Drop for PhaseEnd<'_> {
    fn drop(&mut self) {
        let mut state = self.0.lock();
        state.queue = None;
        state.done.clear();
        drop(state);
        self.0.news.notify_all();
    }
}
