//! The end of a computation that lacks memory, if a C library reports the lack as an ordinary error.

use std::io;

/// Returns an error of zstd that has another cause than a lack of memory.
///
/// A failed allocation of this program ends the process. A failed allocation of zstd must not become a
/// statement about the data, such as damaged bytes.
///
/// # Panics
/// Panics if the cause is a lack of memory. The panic's text contains "not enough memory".
pub fn other_than_exhaustion(error: io::Error) -> io::Error {
    // zstd reports the cause only as text.
    assert!(!error.to_string().contains("not enough memory"), "{error}");
    error
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_of_data_are_returned() {
        let error = other_than_exhaustion(io::Error::other("Unknown frame descriptor"));
        assert_eq!(error.to_string(), "Unknown frame descriptor");
    }

    #[test]
    #[should_panic(expected = "not enough memory")]
    fn lack_of_memory_ends_computation() {
        let _ = other_than_exhaustion(io::Error::other("Allocation error : not enough memory"));
    }
}
