//! The role of a coordinator among the coordinators on its database: leader or standby.

use tokio::sync::watch;

use crate::error::StoreError;

/// The coordinator that leads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Leader {
    /// The epoch of the leadership.
    pub epoch: i64,
    /// The name of the coordinator, for display.
    pub holder: String,
    /// The address at which the coordinator is called.
    pub address: String,
}

/// The role of a coordinator.
#[derive(Clone, Debug)]
pub enum Role {
    /// The coordinator stands by. Contains the leader if one is known.
    StandsBy(Option<Leader>),
    /// The coordinator leads under this epoch.
    Leads(i64),
    /// The coordinator neither leads nor stands by any longer. This is the final role.
    Ended(StoreError),
}

/// The shared role of a coordinator. Clones share it.
#[derive(Clone, Debug)]
pub(super) struct SharedRole(watch::Sender<Role>);

impl SharedRole {
    pub(super) fn new() -> Self {
        Self(watch::Sender::new(Role::StandsBy(None)))
    }

    pub(super) fn follow(&self) -> watch::Receiver<Role> {
        self.0.subscribe()
    }

    /// Returns true if the coordinator leads under `epoch`.
    pub(super) fn leads(&self, epoch: i64) -> bool {
        matches!(*self.0.borrow(), Role::Leads(own) if own == epoch)
    }

    /// Ends the role, because another coordinator has taken over from `epoch`.
    pub(super) fn deposed(&self, epoch: i64) {
        self.set(Role::Ended(StoreError::Fenced { epoch }));
    }

    /// Changes the role. A role that has ended does not change.
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
