//! Stamps of the clock of retention in the store, and reports of the pauses that the clock finds.

use std::time::Duration;

use crate::jobs::retention_clock::{Pause, SpanUse};
use crate::state::Coordinator;
use crate::telemetry::events::{self, LogEvent};

/// Returns the wall clock for the record of a job's end, in milliseconds since 1970. A step of the wall
/// clock is in the store before, so that a crash cannot hide that the time of the record is wrong.
pub(crate) fn end_time(c: &Coordinator) -> u64 {
    let now = c.now();
    if c.retention_clock().is_unrecorded(now) {
        record(c);
    }
    now.unix_ms
}

/// Returns true if [`record_if_due`] should be called.
pub(crate) fn is_due(c: &Coordinator) -> bool {
    let now = c.now();
    c.retention_clock().is_due(now, c.ages())
}

/// Records a stamp if it is still due and no other thread records one.
pub(crate) fn record_if_due(c: &Coordinator) {
    if let Some(one) = c.try_stamping()
        && is_due(c)
    {
        stamp(c);
        drop(one);
        report(c);
    }
}

/// Records a stamp of the clock in the store, and reports new pauses. A stamp that cannot be recorded is
/// logged, and tried again some seconds later, or at the next end of a job.
pub(crate) fn record(c: &Coordinator) {
    let one = c.stamping();
    stamp(c);
    drop(one);
    report(c);
}

fn stamp(c: &Coordinator) {
    let now = c.now();
    let stamp = c.retention_clock().stamp(now);
    match c.store.stamp_retention(stamp) {
        Ok(()) => c.retention_clock().recorded(&stamp),
        Err(e) => {
            c.retention_clock().failed(now);
            tracing::warn!("the clock of retention is not recorded yet: {e}");
        }
    }
}

/// Reports new pauses in the log and to users.
pub(crate) fn report(c: &Coordinator) {
    let pauses = c.retention_clock().take_pauses();
    for pause in pauses {
        let text = text(&pause);
        tracing::warn!("{text}");
        c.happened(LogEvent::of(events::Kind::Coordinator, text));
    }
}

fn text(pause: &Pause) -> String {
    let Pause {
        kind,
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
    let what = match (kind, at_start) {
        (SpanUse::Jobs, false) => "ended jobs and scenes are not deleted by age".to_owned(),
        (SpanUse::Blobs, false) => "unneeded blobs are not removed".to_owned(),
        (SpanUse::Jobs, true) => format!("ended jobs and scenes are deleted up to {jump} late"),
        (SpanUse::Blobs, true) => format!("unneeded blobs are removed up to {jump} late"),
    };
    format!(
        "{cause}: {what} until coordinators have run for another {}; check the time service of the machine",
        spoken(lasts_ms)
    )
}

/// Returns a duration in its largest unit.
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
