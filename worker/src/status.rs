//! The coordinator's answers as text.

use sightline_proto::connection::broken;

/// Returns a status as text for users.
pub fn describe(status: &tonic::Status) -> String {
    broken(status).unwrap_or_else(|| format!("{} ({})", status.message(), status.code()))
}
