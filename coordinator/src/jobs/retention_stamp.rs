//! Stamps of the clock of retention in the store, and reports of the pauses that the clock detects.

use std::time::Duration;

use crate::coordinator::Coordinator;
use crate::jobs::retention_clock::{Pause, SpanUse};
use crate::telemetry::events::{self, LogEvent};

/// Returns the wall clock for the record of a job's end, in milliseconds since 1970. A step of the wall clock
/// is written to the store first, so that a crash cannot hide that the time of the record is wrong.
pub(crate) fn end_time(c: &Coordinator) -> u64 {
    let now = c.now();
    if c.clock.retention().is_unrecorded(now) {
        record(c);
    }
    now.unix_ms
}

/// Returns true if the caller should call [`record_if_due`].
pub(crate) fn is_due(c: &Coordinator) -> bool {
    let now = c.now();
    c.clock.retention().is_due(now, c.config.ages())
}

/// Records a stamp if it is still due and no other thread records one.
pub(crate) fn record_if_due(c: &Coordinator) {
    if let Some(one) = c.clock.try_stamping()
        && is_due(c)
    {
        stamp(c);
        drop(one);
        report(c);
    }
}

/// Records a stamp of the clock in the store, and reports new pauses. A stamp that cannot be recorded is
/// logged. It is tried again some seconds later, or at the next end of a job.
pub(crate) fn record(c: &Coordinator) {
    let one = c.clock.stamping();
    stamp(c);
    drop(one);
    report(c);
}

fn stamp(c: &Coordinator) {
    let now = c.now();
    let stamp = c.clock.retention().stamp(now);
    match c.records.stamp_retention(stamp) {
        Ok(()) => c.clock.retention().recorded(&stamp),
        Err(e) => {
            c.clock.retention().failed(now);
            tracing::warn!("the stamp of the clock of retention is not recorded yet: {e}");
        }
    }
}

/// Reports new pauses in the log and to users.
pub(crate) fn report(c: &Coordinator) {
    let pauses = c.clock.retention().take_pauses();
    for pause in pauses {
        let text = text(&pause);
        tracing::warn!("{text}");
        c.record_event(LogEvent::new(events::EventKind::Coordinator, text));
    }
}

fn text(pause: &Pause) -> String {
    let Pause {
        span_use,
        jump_ms,
        at_start,
        lasts_ms,
    } = *pause;
    let jump = spoken(jump_ms.unsigned_abs());
    let cause = match (at_start, jump_ms < 0) {
        (true, true) => format!("the wall clock is {jump} behind its last time in the store"),
        (true, false) => {
            format!(
                "no coordinator ran for {jump} by the wall clock, or the wall clock was set forward"
            )
        }
        (false, true) => format!("the wall clock stepped back by {jump}"),
        (false, false) => {
            format!("the wall clock stepped forward by {jump}, or this machine slept")
        }
    };
    let what = match (span_use, at_start) {
        (SpanUse::Jobs, false) => "ended jobs and scenes are not deleted by age".to_owned(),
        (SpanUse::Blobs, false) => "unreferenced blobs are not removed".to_owned(),
        (SpanUse::Jobs, true) => format!("ended jobs and scenes are deleted up to {jump} late"),
        (SpanUse::Blobs, true) => format!("unreferenced blobs are removed up to {jump} late"),
    };
    format!(
        "{cause}: {what} until coordinators have run for another {}; check the time service of the \
         machine",
        spoken(lasts_ms)
    )
}

/// Formats a duration in its largest unit.
fn spoken(milliseconds: u64) -> String {
    let seconds = Duration::from_millis(milliseconds).as_secs_f64();
    let units = [
        (86_400.0 * 365.25, "years"),
        (86_400.0, "days"),
        (3600.0, "hours"),
        (60.0, "minutes"),
    ];
    match units.into_iter().find(|(unit, _)| seconds >= 2.0 * unit) {
        Some((unit, name)) => format!("{:.1} {name}", seconds / unit),
        None => format!("{seconds:.1} seconds"),
    }
}
