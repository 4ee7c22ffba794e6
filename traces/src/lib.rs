//! Traces: the durations of a job's steps, as spans that several processes send to one OpenTelemetry
//! collector.
//!
//! A job is one trace. The ids that several processes must know are derived ([`ids`]). So a restarted
//! coordinator, or another one that took over, continues the same trace without stored state. A [`Span`] is
//! created after a step has ended. [`Traces::send`] never waits: a separate thread sends spans in batches.
//! Traces do not affect results.
//!
//! A span contains numbers, names of workers and fixed words. It cannot contain other text, so that no path,
//! token or message is sent.
//!
//! ```
//! use sightline_traces::{Span, SpanTime, TraceId, Traces};
//!
//! let traces = Traces::default(); // Discards all spans: traces are off.
//! let trace = TraceId::of_job(&[7; 32], 1, 1_772_323_200_000);
//! let begun = SpanTime::now();
//! let span = Span::new(trace, "assemble", begun).below(trace.job()).number("sightline.bytes", 4096u32);
//! traces.send(span.end());
//! ```

pub mod ids;
mod sender;
mod span;
mod wire;

pub use ids::{SpanId, TraceId};
pub use sender::{FlushGuard, Settings, Traces, TracesError};
pub use span::{Span, SpanTime};
