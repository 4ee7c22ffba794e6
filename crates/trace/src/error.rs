//! The errors of a tracer.

/// A backend that is not available, or that failed.
#[derive(Debug, thiserror::Error)]
pub enum TracerError {
    /// The backend is not available on this machine. The text names the missing part and its installation.
    #[error("{0}")]
    Unavailable(String),
    /// The device failed while working.
    #[error("the {profile} backend failed: {reason}")]
    Failed {
        /// The numerics profile of the backend.
        profile: String,
        /// The report of the device.
        reason: String,
    },
}
