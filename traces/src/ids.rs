//! The ids of traces and spans.
//!
//! The id of a trace is derived from the coordinator's record of a job. The ids of the job's span and of the
//! spans of leases, which are parents of other processes' spans, are derived from the id of the trace. The
//! submission time is part of the derivation, so job 1 of another farm, or of a recreated data directory, has
//! another trace.

use std::fmt;

/// The contexts of the derivations. They must never change: otherwise processes of two versions could not
/// find each other's spans.
const TRACE: &str = "sightline 2026-11 trace of a job";
const SPAN: &str = "sightline 2026-11 span of a trace";

/// The id of a trace, which is never zero.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TraceId([u8; 16]);

/// The id of a span within a trace, which is never zero.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SpanId([u8; 8]);

impl TraceId {
    /// Returns the trace of a job with this key, number and submission time in milliseconds since 1970.
    pub fn of_job(key: &[u8; 32], job: u64, submitted_at_ms: u64) -> Self {
        let mut hasher = blake3::Hasher::new_derive_key(TRACE);
        hasher
            .update(key)
            .update(&job.to_le_bytes())
            .update(&submitted_at_ms.to_le_bytes());
        let [mut id] = first(&hasher);
        // An id of zero means that there is no trace.
        if id == [0; 16] {
            id[15] = 1;
        }
        Self(id)
    }

    /// Returns the trace with these bytes, or `None` if they are not 16 bytes or all zero.
    pub fn of_bytes(bytes: &[u8]) -> Option<Self> {
        bytes.try_into().ok().filter(|id| *id != [0; 16]).map(Self)
    }

    /// Returns the bytes of the id.
    pub fn bytes(self) -> [u8; 16] {
        self.0
    }

    /// Returns the span of the whole job, the ancestor of all other spans.
    pub fn job(self) -> SpanId {
        self.derived("job", &[])
    }

    /// Returns the span of a lease of a tile, the parent of its worker's spans.
    pub fn lease(self, tile: u32, epoch: u64, number: u64) -> SpanId {
        self.derived("lease", &[u64::from(tile), epoch, number])
    }

    fn derived(self, name: &str, numbers: &[u64]) -> SpanId {
        let mut hasher = blake3::Hasher::new_derive_key(SPAN);
        hasher.update(&self.0).update(name.as_bytes()).update(&[0]);
        numbers.iter().for_each(|number| {
            hasher.update(&number.to_le_bytes());
        });
        let [id] = first(&hasher);
        SpanId::of_number(u64::from_be_bytes(id))
    }
}

/// Returns the first bytes of a hash.
fn first<const N: usize>(hasher: &blake3::Hasher) -> [[u8; N]; 1] {
    let mut bytes = [[0; N]];
    hasher.finalize_xof().fill(bytes.as_flattened_mut());
    bytes
}

impl SpanId {
    /// Returns the id with a number. Zero is replaced by one.
    pub(crate) fn of_number(number: u64) -> Self {
        Self(number.max(1).to_be_bytes())
    }

    /// Returns the bytes of the id.
    pub fn bytes(self) -> [u8; 8] {
        self.0
    }
}

/// Parses the W3C Trace Context header `traceparent`, and returns the trace and the parent span.
///
/// Returns `None` if the text is invalid. Accepts version 00, and later versions that begin like version 00.
pub fn parent_of(header: &str) -> Option<(TraceId, SpanId)> {
    let mut parts = header.trim().split('-');
    let [version, trace, span, flags] =
        [parts.next()?, parts.next()?, parts.next()?, parts.next()?];
    let [version] = digits::<1>(version)?;
    let _: [u8; 1] = digits(flags)?;
    let has_more = parts.next().is_some();
    if version == 0xff || version == 0 && has_more {
        return None;
    }
    let span: [u8; 8] = digits(span)?;
    Some((
        TraceId::of_bytes(&digits::<16>(trace)?)?,
        SpanId(Some(span).filter(|id| *id != [0; 8])?),
    ))
}

/// Parses lower-case hexadecimal digits into bytes.
fn digits<const N: usize>(text: &str) -> Option<[u8; N]> {
    let is_digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    if text.len() != 2 * N || !text.bytes().all(is_digit) {
        return None;
    }
    let mut bytes = [0; N];
    for (at, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * at..2 * at + 2)?, 16).ok()?;
    }
    Some(bytes)
}

impl fmt::Display for TraceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Display for SpanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for TraceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Debug for SpanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    const AT: u64 = 1_772_323_200_000;

    #[test]
    fn all_versions_derive_same_ids() {
        // The values were computed with the Python package blake3.
        let trace = TraceId::of_job(&[7; 32], 3, AT);
        assert_eq!(trace.to_string(), "40106705e0e84d101c4c4248afb877bb");
        assert_eq!(trace.job().to_string(), "0dd902fd6cce7328");
        assert_eq!(trace.lease(5, 2, 9).to_string(), "85adb4caf72427c6");
    }

    #[test]
    fn other_jobs_and_leases_have_other_ids() {
        let traces = [
            TraceId::of_job(&[7; 32], 3, AT),
            TraceId::of_job(&[8; 32], 3, AT),
            TraceId::of_job(&[7; 32], 4, AT),
            TraceId::of_job(&[7; 32], 3, AT + 1),
        ];
        assert_eq!(BTreeSet::from(traces).len(), 4);
        let [trace, other, ..] = traces;
        let spans = [
            trace.job(),
            other.job(),
            trace.lease(5, 2, 9),
            trace.lease(9, 2, 5),
            trace.lease(5, 9, 2),
            other.lease(5, 2, 9),
        ];
        assert_eq!(BTreeSet::from(spans).len(), 6);
    }

    #[test]
    fn ids_are_never_zero() {
        assert_eq!(SpanId::of_number(0).bytes(), [0, 0, 0, 0, 0, 0, 0, 1]);
        assert_eq!(TraceId::of_bytes(&[0; 16]), None);
        assert_eq!(TraceId::of_bytes(&[]), None);
        assert_eq!(TraceId::of_bytes(&[1; 15]), None);
        assert_eq!(
            TraceId::of_bytes(&[1; 16]).map(TraceId::bytes),
            Some([1; 16])
        );
    }

    #[test]
    fn traceparent_is_parsed_as_w3c_defines_it() {
        // The example of the recommendation.
        let header = "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01";
        let (trace, span) = parent_of(header).unwrap();
        assert_eq!(format!("00-{trace}-{span}-01"), header);
        assert!(
            parent_of("01-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01-more").is_some()
        );
        for bad in [
            "",
            "00",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01-more",
            "ff-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
            "00-00000000000000000000000000000000-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e4736-0000000000000000-01",
            "00-4BF92F3577B34DA6A3CE929D0E0E4736-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e473-00f067aa0ba902b7-01",
            "00-+bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01",
            "00-4bf92f3577b34da6a3ce929d0e0e473é-00f067aa0ba902b7-01",
        ] {
            assert_eq!(parent_of(bad), None, "{bad:?}");
        }
    }
}
