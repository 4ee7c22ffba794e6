//! The memory of requests that were not handled yet, with a limit for all callers and one for each user.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{AcquireError, OwnedSemaphorePermit, Semaphore};

/// The memory of all requests, in KiB.
const ALL: usize = 256 << 10;
/// The memory of the requests of all users, in KiB. The rest is for workers.
const OF_USERS: usize = 192 << 10;
/// The memory of the requests of one user, in KiB.
const OF_USER: usize = 64 << 10;

/// The memory that is available for requests.
#[derive(Debug)]
pub(crate) struct Intake {
    all: Arc<Semaphore>,
    of_all_users: Arc<Semaphore>,
    of_users: Mutex<BTreeMap<String, Arc<Semaphore>>>,
}

/// The memory that a request has reserved, until it is dropped.
#[derive(Debug, Default)]
pub(crate) struct RequestMemory(Vec<OwnedSemaphorePermit>);

impl RequestMemory {
    /// Releases the memory beyond the given number of bytes.
    pub(crate) fn shrink(&mut self, bytes: u64) {
        let kept = usize::try_from(bytes.div_ceil(1024)).unwrap_or(usize::MAX);
        for permits in &mut self.0 {
            let more = permits.num_permits().saturating_sub(kept);
            // Dropping the split part releases it.
            drop(permits.split(more));
        }
    }
}

impl Default for Intake {
    fn default() -> Self {
        Self {
            all: Arc::new(Semaphore::new(ALL)),
            of_all_users: Arc::new(Semaphore::new(OF_USERS)),
            of_users: Mutex::default(),
        }
    }
}

impl Intake {
    /// Waits for `bytes` of memory for a user. The name is empty if the limit of a user does not apply.
    ///
    /// # Errors
    /// [`AcquireError`] if the coordinator is stopping.
    pub(crate) async fn room(&self, user: &str, bytes: u64) -> Result<RequestMemory, AcquireError> {
        if bytes == 0 {
            return Ok(RequestMemory::default());
        }
        // A request that exceeds the limit reserves the whole limit, so that it does not wait forever.
        let most = if user.is_empty() { ALL } else { OF_USER };
        let permits = usize::try_from(bytes.div_ceil(1024))
            .unwrap_or(usize::MAX)
            .min(most) as u32;
        let mut room = Vec::new();
        if !user.is_empty() {
            room.push(self.of_user(user).acquire_many_owned(permits).await?);
            room.push(
                Arc::clone(&self.of_all_users)
                    .acquire_many_owned(permits)
                    .await?,
            );
        }
        room.push(Arc::clone(&self.all).acquire_many_owned(permits).await?);
        Ok(RequestMemory(room))
    }

    fn of_user(&self, user: &str) -> Arc<Semaphore> {
        // A poisoned lock is safe to use: no step of a change can panic before the change is complete.
        let mut users = self.of_users.lock().unwrap_or_else(PoisonError::into_inner);
        // Remove users without requests.
        users.retain(|_, own| Arc::strong_count(own) > 1);
        let own = users
            .entry(user.to_owned())
            .or_insert_with(|| Arc::new(Semaphore::new(OF_USER)));
        Arc::clone(own)
    }
}

#[cfg(test)]
mod tests {
    use futures::FutureExt as _;

    use super::*;

    #[test]
    fn requests_wait_for_room_of_their_user_and_of_all() {
        let intake = Intake::default();
        let room = |user: &str, kib: usize| {
            intake
                .room(user, kib as u64 * 1024)
                .now_or_never()
                .map(Result::unwrap)
        };
        let ada = room("ada", OF_USER).unwrap();
        assert!(room("ada", 1).is_none() && room("ada", 0).is_some());
        // A request that exceeds the limit reserves the whole limit.
        let bob = room("bob", 10 * OF_USER).unwrap();
        let eve = room("eve", OF_USERS - 2 * OF_USER).unwrap();
        // Users cannot reserve the part that is for workers.
        assert!(room("dan", 1).is_none());
        let workers = room("", ALL - OF_USERS).unwrap();
        assert!(room("", 1).is_none());
        drop((ada, bob, eve));
        assert!(room("eve", 1).is_some() && room("", 1).is_some());
        drop(workers);
        let mut shrunk = room("bob", OF_USER).unwrap();
        shrunk.shrink(1000);
        let rest = room("bob", OF_USER - 1).unwrap();
        assert!(room("bob", 1).is_none());
        drop((shrunk, rest));
        assert_eq!(
            (
                intake.all.available_permits(),
                intake.of_users.lock().unwrap().len()
            ),
            (ALL, 1)
        );
    }
}
