//! `sightline logs`: prints the events of a job or of the whole farm.

use serde_json::{Value, json};
use sightline::Error;
use sightline_proto::v1;

use crate::args::remote::LogsArgs;
use crate::jobs::timeline::Timeline;
use crate::terminal::exit::unless_cancelled;
use crate::terminal::progress::Terminal;
use crate::terminal::stdout::print;

/// Prints the events of a job or of the farm.
pub fn run(args: &LogsArgs, json: bool) -> Result<(), Error> {
    let request = v1::EventsRequest {
        job: args.id,
        after: args.after,
        follow: args.follow,
    };
    let mut traced = args.trace.then(Timeline::default);
    let mut show = |event: v1::Event| {
        if let Some(traced) = &mut traced {
            traced.add(&event);
            return Ok(());
        }
        print(&match json {
            true => event_value(&event).to_string(),
            false => event_line(&event),
        })
    };
    let done = args
        .remote
        .client()?
        .events(request, &mut show, &Terminal::new());
    unless_cancelled(done)?;
    match traced {
        Some(traced) => print(&traced.finish().to_string()),
        None => Ok(()),
    }
}

/// Returns the kind of an event as one word.
fn kind(event: &v1::Event) -> String {
    event
        .kind()
        .as_str_name()
        .trim_start_matches("EVENT_KIND_")
        .to_ascii_lowercase()
}

fn event_line(e: &v1::Event) -> String {
    let job = if e.job > 0 {
        format!("job {}: ", e.job)
    } else {
        String::new()
    };
    format!("{} {job}{}", time(e.at_ms), e.text)
}

fn event_value(e: &v1::Event) -> Value {
    json!({
        "number": e.number, "at_ms": e.at_ms, "kind": kind(e), "job": (e.job > 0).then_some(e.job),
        "tile": e.tile, "worker": (!e.worker.is_empty()).then_some(&e.worker), "text": e.text,
    })
}

/// Formats a time in milliseconds since 1970 as UTC, in the form of RFC 3339. The date is computed as in
/// Hinnant 2021.
fn time(unix_ms: u64) -> String {
    let (days, ms) = (unix_ms / 86_400_000, unix_ms % 86_400_000);
    let z = days + 719_468;
    let (era, of_era) = (z / 146_097, z % 146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let month = (5 * of_year + 2) / 153;
    let day = of_year - (153 * month + 2) / 5 + 1;
    let (month, shift) = if month < 10 {
        (month + 3, 0)
    } else {
        (month - 9, 1)
    };
    format!(
        "{:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}.{:03}Z",
        year + era * 400 + shift,
        ms / 3_600_000,
        ms / 60_000 % 60,
        ms / 1000 % 60,
        ms % 1000
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_formats_calendar_dates() {
        assert_eq!(time(0), "1970-01-01T00:00:00.000Z");
        // The expected values are from `date -u -d @951827696` and similar commands.
        assert_eq!(time(951_827_696_000), "2000-02-29T12:34:56.000Z");
        assert_eq!(time(1_735_689_599_999), "2024-12-31T23:59:59.999Z");
        assert_eq!(time(1_772_323_200_000), "2026-03-01T00:00:00.000Z");
    }
}
