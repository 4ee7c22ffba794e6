//! How a coordinator stands among those on its database: whether it leads, or who does.

use tokio::sync::watch;

use crate::error::StoreError;

/// The coordinator that leads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Leader {
    /// The number of its leadership.
    pub epoch: i64,
    /// Its name, for people.
    pub holder: String,
    /// Where it is called.
    pub address: String,
}

/// How a coordinator stands.
#[derive(Clone, Debug)]
pub enum Role {
    /// It stands by; the leader, if there is one that is known.
    StandsBy(Option<Leader>),
    /// It leads, under this epoch.
    Leads(i64),
    /// It led, or stood by, and does neither any more. The last state.
    Ended(StoreError),
}

/// A coordinator's standing, shared by those who change it and those who ask. Clones are the same.
#[derive(Clone, Debug)]
pub(super) struct Standing(watch::Sender<Role>);

impl Standing {
    pub(super) fn new() -> Self {
        Self(watch::Sender::new(Role::StandsBy(None)))
    }

    pub(super) fn follow(&self) -> watch::Receiver<Role> {
        self.0.subscribe()
    }

    /// Whether the coordinator leads under `epoch`.
    pub(super) fn leads(&self, epoch: i64) -> bool {
        matches!(*self.0.borrow(), Role::Leads(own) if own == epoch)
    }

    /// Another coordinator has taken over from `epoch`.
    pub(super) fn deposed(&self, epoch: i64) {
        self.set(Role::Ended(StoreError::Fenced { epoch }));
    }

    /// Changes the role. Nothing follows on the end.
    pub(super) fn set(&self, role: Role) {
        self.0.send_if_modified(|now| {
            let changes = match (&*now, &role) {
                (Role::Ended(_), _) => false,
                (Role::StandsBy(a), Role::StandsBy(b)) => a != b,
                (Role::Leads(a), Role::Leads(b)) => a != b,
                _ => true,
            };
            if changes {
                *now = role;
            }
            changes
        });
    }
}
