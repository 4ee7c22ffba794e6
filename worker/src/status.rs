//! The coordinator's answers as text.

/// A status as text for users.
pub fn describe(status: &tonic::Status) -> String {
    format!("{} ({})", status.message(), status.code())
}
