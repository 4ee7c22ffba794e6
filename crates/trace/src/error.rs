//! The errors of a tracer.

/// A backend that is not available, or that failed.
#[derive(Debug, thiserror::Error)]
pub enum BackendError {
    /// The backend is not on this machine. The text names the missing part and how to install it.
    #[error("{0}")]
    Unavailable(String),
    /// The device failed while working.
    #[error("the {profile} backend failed: {reason}")]
    Failed {
        /// Numerics profile of the backend.
        profile: String,
        /// The report of the device.
        reason: String,
    },
}
