//! Positions in a journal, and the numbers that a store has assigned up to a position.

/// The numbers that the store has assigned. The watermark records them, so that a repair never reuses them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Numbers {
    /// The number of the next job.
    pub(super) next_job: u64,
    /// The epoch that began last.
    pub(super) epoch: u64,
}

/// A position in a journal: the end of a frame or of the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct JournalPosition {
    /// The offset in bytes.
    pub(super) offset: u64,
    /// The running checksum of all frames before the position.
    pub(super) chain: u64,
}
