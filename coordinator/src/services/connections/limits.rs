//! Limits of connections, derived from the number of file descriptors.

use std::time::Duration;

/// Maximum number of connections of callers that are not workers, regardless of the number of descriptors.
const MAX_GENERAL: usize = 4096;
/// Maximum number of connections from one address, except workers' connections.
const MAX_OF_ADDRESS: usize = 1024;
/// Maximum number of workers' connections.
const MAX_WORKERS: usize = 4096;
/// Maximum number of simultaneous handshakes in total.
const MAX_HANDSHAKES: usize = 1024;
/// Maximum number of simultaneous handshakes from one address.
const MAX_HANDSHAKES_OF_ADDRESS: usize = 64;
/// The share of descriptors that is reserved for files and for calls to other machines, in eighths.
const RESERVED_EIGHTHS: u64 = 3;
/// The assumed limit of descriptors if the system does not report one.
const USUAL_DESCRIPTORS: u64 = 1024;
/// The number of descriptors that the coordinator requests from the system.
const WANTED_DESCRIPTORS: u64 = 65_536;
/// Minimum number of descriptors for a server. With fewer, each new connection would soon close an idle one,
/// whose peer would connect again and close another.
const MIN_DESCRIPTORS: u64 = 48;

/// A limit of descriptors that is too low to serve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "this process may have {0} open files, but a server needs {MIN_DESCRIPTORS}; raise the limit \
     (ulimit -n)"
)]
pub struct FewDescriptors(u64);

/// The limits of a process's connections.
#[derive(Clone, Copy, Debug)]
pub struct ConnectionLimits {
    /// Maximum number of connections of callers that are not workers.
    pub general: usize,
    /// Maximum number of connections from one address, except workers' connections.
    pub of_address: usize,
    /// Maximum number of connections of workers.
    pub workers: usize,
    /// Maximum number of simultaneous handshakes.
    pub handshakes: usize,
    /// Maximum number of simultaneous handshakes from one address.
    pub handshakes_of_address: usize,
    /// Maximum duration of a handshake. Default: 5 s.
    pub handshake: Duration,
    /// The time after which a connection without a request is closed. It includes the time until the head of
    /// the first request has arrived. Default: 30 s.
    pub idle: Duration,
    /// The time that an idle connection has to end by itself before it is closed. Default: 5 s.
    pub grace: Duration,
    /// Maximum time between two parts of a request's body over HTTP/1. Default: 30 s.
    pub silence: Duration,
    /// Maximum time between two parts of a gRPC call's request. Default: 60 s.
    pub call_silence: Duration,
    /// Maximum time that the peer may leave bytes unread. Default: 60 s.
    pub unread: Duration,
}

impl ConnectionLimits {
    /// Returns the limits for a process with this many descriptors. Three eighths are reserved for files, and
    /// a third of the others is reserved for workers.
    pub fn for_descriptors(descriptors: u64) -> Self {
        let sockets =
            usize::try_from(descriptors - descriptors / 8 * RESERVED_EIGHTHS).unwrap_or(usize::MAX);
        let workers = (sockets / 3).clamp(1, MAX_WORKERS);
        let general = sockets.saturating_sub(workers).clamp(1, MAX_GENERAL);
        Self {
            general,
            of_address: (general - general / 4).min(MAX_OF_ADDRESS),
            workers,
            handshakes: MAX_HANDSHAKES.min(general),
            handshakes_of_address: MAX_HANDSHAKES_OF_ADDRESS.min(general),
            handshake: Duration::from_secs(5),
            idle: Duration::from_secs(30),
            grace: Duration::from_secs(5),
            silence: Duration::from_secs(30),
            call_silence: Duration::from_secs(60),
            unread: Duration::from_secs(60),
        }
    }

    /// Raises the process's limit of descriptors as far as the system allows, and returns the resulting
    /// limits.
    ///
    /// # Errors
    /// [`FewDescriptors`] if the system allows too few descriptors.
    pub fn of_process() -> Result<Self, FewDescriptors> {
        Self::for_process(raise_descriptors())
    }

    fn for_process(descriptors: u64) -> Result<Self, FewDescriptors> {
        if descriptors < MIN_DESCRIPTORS {
            return Err(FewDescriptors(descriptors));
        }
        Ok(Self::for_descriptors(descriptors))
    }
}

/// Raises the soft limit of descriptors, and returns the current limit. On a system without such a limit,
/// returns [`WANTED_DESCRIPTORS`].
fn raise_descriptors() -> u64 {
    match rlimit::increase_nofile_limit(WANTED_DESCRIPTORS) {
        Ok(descriptors) => descriptors,
        Err(e) => {
            tracing::warn!(
                "the limit of open files cannot be raised: {e}; raise it with ulimit -n \
                 {WANTED_DESCRIPTORS}"
            );
            USUAL_DESCRIPTORS
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_leave_descriptors_for_files() {
        for descriptors in [64, 256, 1024, 4096, 65_536, u64::MAX] {
            let limits = ConnectionLimits::for_descriptors(descriptors);
            let sockets = (limits.general + limits.workers) as u64;
            assert!(
                sockets <= descriptors - descriptors / 4,
                "{descriptors}: {limits:?}"
            );
            assert!(limits.of_address < limits.general && limits.handshakes <= limits.general);
            assert!(limits.handshakes_of_address <= 64 && limits.handshakes <= 1024);
            let seconds = [
                limits.handshake,
                limits.idle,
                limits.silence,
                limits.call_silence,
                limits.unread,
            ];
            assert_eq!(seconds.map(|limit| limit.as_secs()), [5, 30, 30, 60, 60]);
        }
    }

    #[test]
    fn few_descriptors_are_rejected() {
        assert_eq!(
            ConnectionLimits::for_process(47).unwrap_err(),
            FewDescriptors(47)
        );
        assert!(ConnectionLimits::for_process(48).is_ok());
    }

    #[test]
    fn process_raises_its_descriptor_limit() {
        let raised = raise_descriptors();
        let (now, most) = rlimit::Resource::NOFILE.get().unwrap();
        assert_eq!(now, raised);
        assert!(raised >= WANTED_DESCRIPTORS.min(most));
    }
}
