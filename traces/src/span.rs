//! A span: a part of a job's work with its beginning and its end.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::ids::{SpanId, TraceId};

/// The beginning of something, by the clock that all machines have and by one that never jumps.
#[derive(Clone, Copy, Debug)]
pub struct Begun {
    /// Nanoseconds since 1970.
    at: u64,
    since: Instant,
}

impl Begun {
    /// Now.
    pub fn now() -> Self {
        let at = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        Self {
            at: at.as_nanos() as u64,
            since: Instant::now(),
        }
    }

    /// This long ago.
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

    /// How long ago.
    pub fn elapsed(self) -> Duration {
        self.since.elapsed()
    }

    /// The later of two.
    pub fn max(self, other: Self) -> Self {
        if other.since > self.since {
            other
        } else {
            self
        }
    }

    /// Whether this was after the other one.
    pub fn is_after(self, other: Self) -> bool {
        self.since > other.since
    }

    /// Nanoseconds since 1970 of a later moment, so that spans of one process nest, whatever its clock does.
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

/// A span of a job's trace. Without an end it is of no use: [`Span::end`] gives it one.
#[derive(Clone, Debug)]
#[must_use]
pub struct Span {
    pub(crate) trace: TraceId,
    /// A random one unless it was given.
    pub(crate) id: Option<SpanId>,
    pub(crate) parent: Option<SpanId>,
    pub(crate) name: &'static str,
    pub(crate) start: u64,
    pub(crate) end: u64,
    pub(crate) attributes: Vec<(&'static str, Value)>,
    pub(crate) link: Option<(TraceId, SpanId)>,
    /// Why it was of no use, if it was not.
    pub(crate) failed: Option<&'static str>,
    begun: Option<Begun>,
}

impl Span {
    /// A span of a trace, from `begun` on.
    pub fn of(trace: TraceId, name: &'static str, begun: Begun) -> Self {
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

    /// The same from a time on record, in milliseconds since 1970.
    pub fn since(trace: TraceId, name: &'static str, unix_ms: u64) -> Self {
        let start = unix_ms.saturating_mul(1_000_000);
        Self {
            start,
            begun: None,
            ..Self::of(trace, name, Begun::now())
        }
    }

    /// Gives it an id that others know.
    pub fn known_as(mut self, id: SpanId) -> Self {
        self.id = Some(id);
        self
    }

    /// Puts it below another one.
    pub fn below(mut self, parent: SpanId) -> Self {
        self.parent = Some(parent);
        self
    }

    /// Adds a number.
    pub fn number(mut self, name: &'static str, number: impl Into<u64>) -> Self {
        self.attributes.push((name, Value::Number(number.into())));
        self
    }

    /// Adds a fixed word.
    pub fn word(mut self, name: &'static str, word: &'static str) -> Self {
        self.attributes.push((name, Value::Word(word)));
        self
    }

    /// Adds the name of a worker or of a profile: nothing else.
    pub fn name(mut self, name: &'static str, of: &str) -> Self {
        self.attributes.push((name, Value::Name(of.to_owned())));
        self
    }

    /// Points to a span of another trace.
    pub fn linked(mut self, to: Option<(TraceId, SpanId)>) -> Self {
        self.link = to;
        self
    }

    /// Says that it was of no use, and why in a fixed word.
    pub fn failed(mut self, why: Option<&'static str>) -> Self {
        self.failed = why;
        self
    }

    /// Ends it now.
    pub fn end(self) -> Self {
        self.end_at(Begun::now())
    }

    /// Ends it at a moment that others have as their beginning or end, too.
    pub fn end_at(mut self, end: Begun) -> Self {
        // A job's record may be of a machine whose clock is ahead.
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
    fn a_span_does_not_end_before_it_begins() {
        let trace = TraceId::of_job(&[0; 32], 1, 0);
        let late = Begun::now();
        let early = Begun::ago(Duration::from_secs(3));
        let span = Span::of(trace, "wait", late).end_at(early);
        assert_eq!(span.start, span.end);
        let span = Span::of(trace, "wait", early).end_at(late);
        assert!(
            (span.end - span.start).abs_diff(3_000_000_000) < 100_000_000,
            "{span:?}"
        );
        // A record of the future.
        let span = Span::since(trace, "job", u64::MAX / 2_000_000).end();
        assert_eq!(span.start, span.end);
        assert!(late.is_after(early) && !early.is_after(late));
        assert_eq!(early.max(late).at, late.at);
    }
}
