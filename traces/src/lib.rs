//! Traces: what took time in a job, as spans that several processes send to one collector of OpenTelemetry.
//!
//! A job is one trace. The ids that more than one process has to know are derived ([`ids`]), so that a
//! coordinator that was restarted, or another one that took over, goes on with the same trace and nothing is
//! stored. A [`Span`] is made where something has ended, and [`Traces::send`] never waits: a thread of its
//! own sends spans in batches. Nothing that is computed depends on any of this.
//!
//! A span holds numbers, names of workers and fixed words. It has no place for other text, so that no path,
//! token or message gets into it.
//!
//! ```
//! use sightline_traces::{Begun, Span, TraceId, Traces};
//!
//! let traces = Traces::default(); // Goes nowhere: traces are off.
//! let trace = TraceId::of_job(&[7; 32], 1, 1_772_323_200_000);
//! let begun = Begun::now();
//! let span = Span::of(trace, "assemble", begun).below(trace.job()).number("sightline.bytes", 4096u32);
//! traces.send(span.end());
//! ```

pub mod ids;
mod sending;
mod span;
mod wire;

pub use ids::{SpanId, TraceId};
pub use sending::{Closing, Settings, Traces, TracesError};
pub use span::{Begun, Span};
