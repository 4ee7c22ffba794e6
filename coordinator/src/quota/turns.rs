//! Turns for work of which one is done at a time: users come one after the other, however many requests each
//! has.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::oneshot;

use super::LimitExceeded;

/// Maximum number of requests of a user that wait.
const MAX_WAITING: usize = 64;

/// The queue of a kind of work.
#[derive(Clone, Debug)]
pub(crate) struct Turns {
    queue: Arc<Mutex<Queue>>,
    /// Maximum number of requests of a user that wait.
    most_waiting: usize,
}

#[derive(Debug, Default)]
struct Queue {
    is_busy: bool,
    /// The users with waiting requests, the next one first.
    users: VecDeque<String>,
    waiting: BTreeMap<String, VecDeque<oneshot::Sender<Turn>>>,
}

/// The right to work, until it is dropped.
#[derive(Debug)]
pub(crate) struct Turn(Option<Turns>);

impl Default for Turns {
    fn default() -> Self {
        Self {
            queue: Arc::default(),
            most_waiting: MAX_WAITING,
        }
    }
}

impl Turns {
    /// Creates a queue for requests whose number others bound.
    pub(crate) fn of_bounded_requests() -> Self {
        Self {
            queue: Arc::default(),
            most_waiting: usize::MAX,
        }
    }

    /// Waits for the turn of a user. A request that is no longer wanted leaves the queue.
    ///
    /// # Errors
    /// [`LimitExceeded::Waiting`] when the user has too many requests in the queue.
    pub(crate) async fn take(&self, user: &str) -> Result<Turn, LimitExceeded> {
        let granted = {
            let mut queue = self.queue();
            if !queue.is_busy {
                queue.is_busy = true;
                return Ok(Turn(Some(self.clone())));
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
        // The queue grants every request that waits, and lives as long as this.
        granted.await.map_err(|_| self.beyond(user))
    }

    fn beyond(&self, user: &str) -> LimitExceeded {
        LimitExceeded::Waiting {
            user: user.to_owned(),
            most: u32::try_from(self.most_waiting).unwrap_or(u32::MAX),
        }
    }

    /// Removes the next request from the queue, which is free without one.
    fn next(&self) -> Option<oneshot::Sender<Turn>> {
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
        // Each change is whole before anything can panic.
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let Some(turns) = self.0.take() else { return };
        while let Some(next) = turns.next() {
            match next.send(Self(Some(turns.clone()))) {
                Ok(()) => return,
                // The request has gone; the loop gives the turn to the next one.
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

    type Waiting<'a> = Pin<Box<dyn Future<Output = Result<Turn, LimitExceeded>> + Send + 'a>>;

    /// Returns the turn if it has come.
    fn come(waiting: &mut Waiting<'_>) -> Option<Turn> {
        waiting.as_mut().now_or_never().map(Result::unwrap)
    }

    /// Enters the queue.
    fn wait<'a>(turns: &'a Turns, user: &'a str) -> Waiting<'a> {
        let mut waiting: Waiting<'a> = Box::pin(turns.take(user));
        assert!(come(&mut waiting).is_none());
        waiting
    }

    #[test]
    fn users_come_one_after_the_other() {
        let turns = Turns::default();
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
    fn request_that_has_gone_gives_its_turn_back() {
        let turns = Turns::default();
        let turn = turns.take("eve").now_or_never().unwrap().unwrap();
        let gone: Vec<Waiting<'_>> = (0..MAX_WAITING).map(|_| wait(&turns, "eve")).collect();
        // Requests that have gone do not count for the bound of a user.
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
        // The turn is on its way to a request that leaves at this moment.
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
