//! Spans: parts of a job's work with their start and end.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::ids::{SpanId, TraceId};

/// The start of a span, by the wall clock and by a monotonic clock.
#[derive(Clone, Copy, Debug)]
pub struct SpanTime {
    /// The wall-clock time, in nanoseconds since 1970.
    at: u64,
    since: Instant,
}

impl SpanTime {
    /// Returns the current time.
    pub fn now() -> Self {
        let at = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        Self {
            at: at.as_nanos() as u64,
            since: Instant::now(),
        }
    }

    /// Returns the time this long ago.
    pub fn ago(time: Duration) -> Self {
        let now = Self::now();
        let Some(since) = now.since.checked_sub(time) else {
            return now;
        };
        Self {
            at: now.at.saturating_sub(time.as_nanos() as u64),
            since,
        }
    }

    /// Returns the duration since this time.
    pub fn elapsed(self) -> Duration {
        self.since.elapsed()
    }

    /// Returns the later of two times.
    pub fn max(self, other: Self) -> Self {
        if other.since > self.since {
            other
        } else {
            self
        }
    }

    /// Returns true if this time is later than the other one.
    pub fn is_after(self, other: Self) -> bool {
        self.since > other.since
    }

    /// Returns the time `end`, which is later, in nanoseconds since 1970. The monotonic clock determines the
    /// difference, so spans of one process nest even if the wall clock jumps.
    fn until(self, end: Instant) -> u64 {
        self.at
            .saturating_add(end.saturating_duration_since(self.since).as_nanos() as u64)
    }
}

/// The value of an attribute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Value {
    Number(u64),
    Word(&'static str),
    Name(String),
}

/// A span of a job's trace. Finish it with [`Span::end`] before sending it.
#[derive(Clone, Debug)]
#[must_use]
pub struct Span {
    pub(crate) trace: TraceId,
    /// The id of the span, or `None` for a random id.
    pub(crate) id: Option<SpanId>,
    pub(crate) parent: Option<SpanId>,
    pub(crate) name: &'static str,
    pub(crate) start: u64,
    pub(crate) end: u64,
    pub(crate) attributes: Vec<(&'static str, Value)>,
    pub(crate) link: Option<(TraceId, SpanId)>,
    /// A fixed word for the reason of the failure, or `None` if the work succeeded.
    pub(crate) failed: Option<&'static str>,
    begun: Option<SpanTime>,
}

impl Span {
    /// Creates a span of a trace that starts at `begun`.
    pub fn new(trace: TraceId, name: &'static str, begun: SpanTime) -> Self {
        Self {
            trace,
            id: None,
            parent: None,
            name,
            start: begun.at,
            end: begun.at,
            attributes: Vec::new(),
            link: None,
            failed: None,
            begun: Some(begun),
        }
    }

    /// Creates a span that starts at a recorded time, in milliseconds since 1970.
    pub fn since(trace: TraceId, name: &'static str, unix_ms: u64) -> Self {
        let start = unix_ms.saturating_mul(1_000_000);
        Self {
            start,
            begun: None,
            ..Self::new(trace, name, SpanTime::now())
        }
    }

    /// Sets an id that other processes know.
    pub fn known_as(mut self, id: SpanId) -> Self {
        self.id = Some(id);
        self
    }

    /// Sets the parent span.
    pub fn below(mut self, parent: SpanId) -> Self {
        self.parent = Some(parent);
        self
    }

    /// Adds a number as an attribute.
    pub fn number(mut self, name: &'static str, number: impl Into<u64>) -> Self {
        self.attributes.push((name, Value::Number(number.into())));
        self
    }

    /// Adds a fixed word as an attribute.
    pub fn word(mut self, name: &'static str, word: &'static str) -> Self {
        self.attributes.push((name, Value::Word(word)));
        self
    }

    /// Adds the name of a worker or of a profile as an attribute. Do not pass other text.
    pub fn name(mut self, name: &'static str, value: &str) -> Self {
        self.attributes.push((name, Value::Name(value.to_owned())));
        self
    }

    /// Adds a link to a span of another trace.
    pub fn linked(mut self, to: Option<(TraceId, SpanId)>) -> Self {
        self.link = to;
        self
    }

    /// Marks the work as failed, with a fixed word for the reason.
    pub fn failed(mut self, why: Option<&'static str>) -> Self {
        self.failed = why;
        self
    }

    /// Ends the span now.
    pub fn end(self) -> Self {
        self.end_at(SpanTime::now())
    }

    /// Ends the span at a given time, which other spans may share.
    pub fn end_at(mut self, end: SpanTime) -> Self {
        // The start may come from a machine whose clock is ahead.
        self.end = self
            .begun
            .map_or(end.at, |begun| begun.until(end.since))
            .max(self.start);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn span_ends_after_its_start() {
        let trace = TraceId::of_job(&[0; 32], 1, 0);
        let late = SpanTime::now();
        let early = SpanTime::ago(Duration::from_secs(3));
        let span = Span::new(trace, "wait", late).end_at(early);
        assert_eq!(span.start, span.end);
        let span = Span::new(trace, "wait", early).end_at(late);
        assert!(
            (span.end - span.start).abs_diff(3_000_000_000) < 100_000_000,
            "{span:?}"
        );
        // A recorded time in the future.
        let span = Span::since(trace, "job", u64::MAX / 2_000_000).end();
        assert_eq!(span.start, span.end);
        assert!(late.is_after(early) && !early.is_after(late));
        assert_eq!(early.max(late).at, late.at);
    }
}
