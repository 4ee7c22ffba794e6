//! The state of a block's device.

use sightline_trace::lines::device::Rounds;

/// The device that casts the rounds of a block, if there is one.
pub(super) enum OnDevice<'a> {
    /// Not queried yet.
    Unknown,
    /// No device; the host casts them.
    No,
    /// A device.
    Yes {
        /// The device's block.
        rounds: Box<dyn Rounds + 'a>,
        /// True if its table lags behind the block's.
        stale: bool,
    },
}
