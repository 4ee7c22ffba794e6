//! The leader of a crew: divides the items of each phase, computes what it has not given away, and publishes
//! the outcomes. With no helpers it is a member that works alone and leaves outcomes behind.
//!
//! Outcomes stay here until somebody has kept them, so that a leader whose stream broke can go on with new
//! helpers. The leader waits for nobody: when no item is free it computes those that helpers have not
//! answered yet, and the first answer counts. So a helper that is slow, silent or gone costs what it would
//! have saved.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use super::member::{Crew, Phase};
use super::queue::{IN_HAND, Member, Queue};
use crate::context::Watcher;
use crate::error::TileError;

/// Without helpers, outcomes are handed over this often.
const HAND_OVER: Duration = Duration::from_secs(1);

/// What the leader hears.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ToLeader {
    /// A helper has come. It has been given the outcomes that were handed over.
    Joined(Member),
    /// A helper is ready for items of a phase, and then of every later one.
    Ask {
        /// The helper.
        member: Member,
        /// The number of the phase, from 0.
        phase: u32,
    },
    /// A helper's finds of all items of a piece.
    Found {
        /// The helper.
        member: Member,
        /// The number of the phase.
        phase: u32,
        /// The items.
        items: Vec<u32>,
        /// The bytes of [`Phase::take`].
        finds: Vec<u8>,
    },
    /// A helper has gone.
    Left(Member),
    /// The outcomes of this many phases have been kept.
    Kept(u32),
}

/// What the leader says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FromLeader {
    /// Items for a helper.
    Take {
        /// The helper.
        member: Member,
        /// The number of the phase.
        phase: u32,
        /// The items.
        items: Vec<u32>,
    },
    /// The outcome of a phase, for all helpers and for whoever keeps it.
    Outcome {
        /// The number of the phase.
        phase: u32,
        /// The bytes of [`Phase::outcome`].
        bytes: Arc<Vec<u8>>,
        /// How long the phase took, helpers' part and encoding included.
        time: Duration,
    },
    /// This helper is of no use.
    Dismiss(Member),
    /// There are no more phases.
    End,
}

/// The leader of a crew.
pub struct Leader {
    state: Mutex<LeaderState>,
    /// There are finds to add, or the phase is over.
    news: Condvar,
    watcher: Arc<dyn Watcher + Send>,
    /// Must not wait for the other members.
    out: Box<dyn Fn(FromLeader) + Send + Sync>,
}

#[derive(Default)]
struct LeaderState {
    /// Outcomes of an earlier leader that are not used yet, by phase.
    earlier: BTreeMap<u32, Vec<u8>>,
    /// The number of the next phase, or of the one in work.
    number: u32,
    queue: Option<Queue>,
    helpers: BTreeSet<Member>,
    /// Those of them that have asked for items, with the phase from which on they get some.
    ready: BTreeMap<Member, u32>,
    /// Helpers without items, and the phase that each is ready for.
    asking: VecDeque<(Member, u32)>,
    /// Pieces that helpers have done.
    done: VecDeque<(Member, Vec<u32>, Vec<u8>)>,
    /// Outcomes that nobody has said to have kept.
    outcomes: VecDeque<(u32, Arc<Vec<u8>>, Duration)>,
    /// Those from this phase on are not handed over yet.
    handed: u32,
    handed_over: Option<Instant>,
    /// Rays of helpers, by helper, for the log.
    rays: BTreeMap<Member, u64>,
    /// Time spent on preparing phases, computing items and encoding outcomes, for the log.
    times: [Duration; 3],
    /// Whether there are no more phases.
    has_ended: bool,
}

/// What a thread of the leader does next.
enum LeaderStep {
    Add(Member, Vec<u32>, Vec<u8>),
    Compute(usize),
    Nothing,
}

impl Leader {
    /// The leader of a block of which the first phases have these outcomes. `out` must not wait for the other
    /// members.
    pub fn new(
        outcomes: Vec<Vec<u8>>,
        watcher: Arc<dyn Watcher + Send>,
        out: impl Fn(FromLeader) + Send + Sync + 'static,
    ) -> Self {
        let state = LeaderState {
            earlier: (0..).zip(outcomes).collect(),
            ..LeaderState::default()
        };
        Self {
            state: Mutex::new(state),
            news: Condvar::new(),
            watcher,
            out: Box::new(out),
        }
    }

    /// Acts on a message. Called from any thread; never waits for a phase.
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
                    // The phase is over; the helper is given some of the present one.
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
                // Late finds are not needed: the phase is over.
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
                    .is_some_and(|(phase, ..)| *phase < phases)
                {
                    state.outcomes.pop_front();
                }
            }
        }
    }

    /// There is a new way to helpers, on which the outcomes of `there` phases are known. Returns whether the
    /// leader has all others; without them helpers are of no use. `turn` makes `out` lead that way.
    pub fn reopened(&self, there: u32, turn: impl FnOnce()) -> bool {
        let mut state = self.lock();
        let first = state
            .outcomes
            .front()
            .map_or(state.number, |(phase, ..)| *phase);
        if there < first {
            return false;
        }
        state.handed = there;
        // Nothing is said in between, so the first outcome on the new way is that of phase `there`.
        turn();
        self.hand_over(&mut state);
        true
    }

    /// Whether there are no more phases, and no use for helpers.
    pub fn has_ended(&self) -> bool {
        self.lock().has_ended
    }

    /// The number of the next phase, or of the one in work.
    pub fn phase(&self) -> u32 {
        self.lock().number
    }

    /// An earlier leader has left the outcomes of the phases from `from` on, which were not known at first.
    /// Those of phases that have begun here are not used.
    pub fn learn(&self, from: u32, outcomes: Vec<Vec<u8>>) {
        self.lock().earlier.extend((from..).zip(outcomes));
    }

    fn lock(&self) -> MutexGuard<'_, LeaderState> {
        // Each change is whole before anything can panic.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives free items to helpers that ask.
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

    /// Forgets a helper, and what it was given.
    fn dismiss(&self, state: &mut LeaderState, member: Member) {
        state.helpers.remove(&member);
        state.ready.remove(&member);
        // Later finds leave out what earlier ones held.
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

    /// Hands the outcomes over that are still here.
    fn hand_over(&self, state: &mut LeaderState) {
        let from = state.handed;
        for (phase, bytes, time) in state.outcomes.iter().filter(|(phase, ..)| *phase >= from) {
            let (phase, bytes, time) = (*phase, Arc::clone(bytes), *time);
            (self.out)(FromLeader::Outcome { phase, bytes, time });
        }
        state.handed = state
            .outcomes
            .back()
            .map_or(from, |(phase, ..)| from.max(phase + 1));
        state.handed_over = Some(Instant::now());
    }

    /// Whether the phase has its answers from an earlier leader.
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
                    "an earlier outcome of this block is of no use, the block goes on without: {e}"
                );
                false
            }
        };
        if !whole {
            self.lock().earlier.clear();
        }
        whole
    }

    /// What a thread does next in a phase.
    fn step(&self) -> LeaderStep {
        let mut state = self.lock();
        if let Some((member, items, finds)) = state.done.pop_front() {
            return LeaderStep::Add(member, items, finds);
        }
        let queue = state.queue.as_mut();
        let item = queue.and_then(|queue| queue.next_free().or_else(|| queue.next_given()));
        item.map_or(LeaderStep::Nothing, LeaderStep::Compute)
    }

    /// Adds the finds of a helper.
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

    /// Adds the finds of helpers as they come, until the phase is over: the other threads may be busy with
    /// long items that helpers have answered.
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

    /// Computes items until there are none without answers, as one of the leader's threads.
    fn work(&self, phase: &dyn Phase, failed: &Mutex<Option<TileError>>) {
        let is_failed = || failed.lock().is_ok_and(|f| f.is_some());
        while !is_failed() {
            match self.step() {
                LeaderStep::Add(member, items, finds) => self.add(phase, member, &items, &finds),
                LeaderStep::Compute(item) if phase.has(item) => {}
                // A helper's answer may come while a long item is computed once more here.
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
            state.number += 1;
            return Ok(());
        }
        let begun = Instant::now();
        phase.prepare();
        let prepared = begun.elapsed();
        {
            let mut state = self.lock();
            state.queue = Some(Queue::new(phase.costs()));
            let number = state.number;
            // One piece each in turn. Whoever has asked already is ready.
            state.asking.clear();
            for _ in 0..IN_HAND {
                // One that knows the outcomes of later phases drops items of this one.
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
            let _over = Over(self);
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
        state.number += 1;
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
    /// Helpers of a tile that failed or was taken back are of no use.
    fn drop(&mut self) {
        if !self.has_ended() {
            (self.out)(FromLeader::End);
        }
    }
}

/// Ends the adding of finds when a phase is over, also by a panic.
struct Over<'a>(&'a Leader);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        let mut state = self.0.lock();
        state.queue = None;
        state.done.clear();
        drop(state);
        self.0.news.notify_all();
    }
}
