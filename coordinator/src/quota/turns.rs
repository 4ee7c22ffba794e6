//! Turns for work that runs one at a time. Users alternate, regardless of the number of their requests.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

use super::LimitExceeded;

/// Maximum number of waiting requests of a user.
const MAX_WAITING: usize = 64;

/// The queue of a kind of work.
#[derive(Clone, Debug)]
pub(crate) struct FairQueue {
    queue: Arc<Mutex<Queue>>,
    /// Maximum number of waiting requests of a user.
    most_waiting: usize,
}

#[derive(Debug, Default)]
struct Queue {
    is_busy: bool,
    /// The users with waiting requests, in the order of their turns.
    users: VecDeque<String>,
    waiting: BTreeMap<String, VecDeque<oneshot::Sender<QueueTurn>>>,
}

/// The right to work until the value is dropped.
#[derive(Debug)]
pub(crate) struct QueueTurn(Option<FairQueue>);

impl Default for FairQueue {
    fn default() -> Self {
        Self {
            queue: Arc::default(),
            most_waiting: MAX_WAITING,
        }
    }
}

impl FairQueue {
    /// Creates a queue without a limit, for requests that another limit bounds.
    pub(crate) fn of_bounded_requests() -> Self {
        Self {
            queue: Arc::default(),
            most_waiting: usize::MAX,
        }
    }

    /// Waits for the turn of a user. A request whose future is dropped leaves the queue.
    ///
    /// # Errors
    /// [`LimitExceeded::Waiting`] if the user has too many requests in the queue.
    pub(crate) async fn take(&self, user: &str) -> Result<QueueTurn, LimitExceeded> {
        let granted = {
            let mut queue = self.queue();
            if !queue.is_busy {
                queue.is_busy = true;
                return Ok(QueueTurn(Some(self.clone())));
            }
            let own = queue.waiting.entry(user.to_owned()).or_default();
            own.retain(|waiting| !waiting.is_closed());
            if own.len() >= self.most_waiting {
                return Err(self.beyond(user));
            }
            let (grant, granted) = oneshot::channel();
            own.push_back(grant);
            if !queue.users.iter().any(|other| other == user) {
                queue.users.push_back(user.to_owned());
            }
            granted
        };
        // This value keeps the queue alive, and the queue grants a turn to every waiting request, so this
        // error does not occur.
        granted.await.map_err(|_| self.beyond(user))
    }

    fn beyond(&self, user: &str) -> LimitExceeded {
        LimitExceeded::Waiting {
            user: user.to_owned(),
            most: u32::try_from(self.most_waiting).unwrap_or(u32::MAX),
        }
    }

    /// Removes the next request from the queue. Marks the queue as free if no request waits.
    fn next(&self) -> Option<oneshot::Sender<QueueTurn>> {
        let mut queue = self.queue();
        while let Some(user) = queue.users.pop_front() {
            let Some(own) = queue.waiting.get_mut(&user) else {
                continue;
            };
            let next = own.pop_front();
            if own.is_empty() {
                queue.waiting.remove(&user);
            } else {
                queue.users.push_back(user);
            }
            if next.is_some() {
                return next;
            }
        }
        queue.is_busy = false;
        None
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for QueueTurn {
    fn drop(&mut self) {
        let Some(turns) = self.0.take() else { return };
        while let Some(next) = turns.next() {
            match next.send(Self(Some(turns.clone()))) {
                Ok(()) => return,
                // The request no longer exists. The loop gives the turn to the next one.
                Err(mut turn) => drop(turn.0.take()),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::pin::Pin;

    use futures::FutureExt as _;

    use super::*;

    type Waiting<'a> = Pin<Box<dyn Future<Output = Result<QueueTurn, LimitExceeded>> + Send + 'a>>;

    /// Returns the turn if the queue has granted it.
    fn come(waiting: &mut Waiting<'_>) -> Option<QueueTurn> {
        waiting.as_mut().now_or_never().map(Result::unwrap)
    }

    /// Adds a request to the queue.
    fn wait<'a>(turns: &'a FairQueue, user: &'a str) -> Waiting<'a> {
        let mut waiting: Waiting<'a> = Box::pin(turns.take(user));
        assert!(come(&mut waiting).is_none());
        waiting
    }

    #[test]
    fn users_take_turns() {
        let turns = FairQueue::default();
        let mut turn = turns.take("eve").now_or_never().unwrap().unwrap();
        let names = ["eve", "eve", "eve", "ada", "eve", "bob", "ada"];
        let mut queue: Vec<Waiting<'_>> = names.iter().map(|user| wait(&turns, user)).collect();
        let mut order = Vec::new();
        for _ in names {
            drop(turn);
            let mut came = queue
                .iter_mut()
                .enumerate()
                .filter_map(|(at, w)| Some((at, come(w)?)));
            let (at, next) = came.next().unwrap();
            assert!(came.next().is_none());
            drop(came);
            drop(queue.remove(at));
            queue.insert(at, Box::pin(std::future::pending()));
            order.push(names[at]);
            turn = next;
        }
        assert_eq!(order, ["eve", "ada", "bob", "eve", "ada", "eve", "eve"]);
        drop(turn);
        assert!(!turns.queue().is_busy && turns.queue().waiting.is_empty());
    }

    #[test]
    fn dropped_request_returns_its_turn() {
        let turns = FairQueue::default();
        let turn = turns.take("eve").now_or_never().unwrap().unwrap();
        let gone: Vec<Waiting<'_>> = (0..MAX_WAITING).map(|_| wait(&turns, "eve")).collect();
        // Dropped requests do not count for the limit of a user.
        assert!(matches!(
            turns.take("eve").now_or_never(),
            Some(Err(LimitExceeded::Waiting { .. }))
        ));
        let mut ada = wait(&turns, "ada");
        drop(gone);
        let mut eve = wait(&turns, "eve");
        let granted = wait(&turns, "bob");
        drop(turn);
        let first = come(&mut eve).or_else(|| come(&mut ada));
        assert!(first.is_some());
        // The queue has sent the turn to a request that is dropped at this moment.
        drop(first);
        drop((eve, ada));
        drop(granted);
        assert!(
            turns
                .take("root")
                .now_or_never()
                .is_some_and(|turn| turn.is_ok())
        );
    }
}
