//! Places in a journal, and the numbers that a store has given out up to there.

/// The numbers that the store has given out, for the watermark: a repair must not give them out again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Numbers {
    /// The number of the next job.
    pub(super) next_job: u64,
    /// The epoch begun last.
    pub(super) epoch: u64,
}

/// A place in a journal: the end of a frame, or of the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    /// The offset in bytes.
    pub(super) offset: u64,
    /// The running checksum of everything before.
    pub(super) chain: u64,
}
