//! The state of the device of a block.

use sightline_trace::lines::device::Rounds;

/// The device that casts the rounds of a block, if it exists.
pub(super) enum OnDevice<'a> {
    /// The tracer was not queried yet.
    Unknown,
    /// The tracer has no device; the host casts the rounds.
    No,
    /// A device casts the rounds.
    Yes {
        /// The device's block.
        rounds: Box<dyn Rounds + 'a>,
        /// True if the device's table lags behind the block's table.
        stale: bool,
    },
}
