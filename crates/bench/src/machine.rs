//! The machine that times are of.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;
use sightline_trace::embree::CpuBackend;

/// What a reader needs to judge the times by.
#[derive(Debug, Serialize)]
pub struct Machine {
    /// The processor's name.
    pub cpu: String,
    /// That this process may use.
    pub cores: usize,
    /// All of the machine's, in words.
    pub memory: String,
    /// Distribution and kernel.
    pub os: String,
    /// What decides the last pixels of a result.
    pub numerics_profile: String,
    /// This program's.
    pub version: &'static str,
    /// UTC.
    pub date: String,
}

impl Machine {
    /// Asks the system; what it does not tell is said to be unknown.
    pub fn here() -> Self {
        let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
        let unknown = || "unknown".to_owned();
        let memory = value(&read("/proc/meminfo"), "MemTotal", ':')
            .and_then(|v| v.split_whitespace().next()?.parse::<f64>().ok())
            .map_or_else(unknown, |kib| {
                format!("{:.1} GiB", kib / f64::from(1 << 20))
            });
        let system = value(&read("/etc/os-release"), "PRETTY_NAME", '=');
        let kernel = read("/proc/sys/kernel/osrelease");
        let os = format!(
            "{}, {}",
            system.unwrap_or_else(|| std::env::consts::OS.to_owned()),
            kernel.trim()
        );
        Self {
            cpu: value(&read("/proc/cpuinfo"), "model name", ':').unwrap_or_else(unknown),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            memory,
            os: os.trim_end_matches([',', ' ']).to_owned(),
            numerics_profile: CpuBackend::probe().unwrap_or_else(|_| unknown()),
            version: env!("CARGO_PKG_VERSION"),
            date: date(
                SystemTime::now()
                    .duration_since(UNIX_EPOCH)
                    .map_or(0, |d| d.as_secs()),
            ),
        }
    }
}

/// The first `key`'s value in lines of keys and values.
fn value(text: &str, key: &str, separator: char) -> Option<String> {
    let mut lines = text.lines().filter_map(|l| l.split_once(separator));
    lines
        .find(|(k, _)| k.trim() == key)
        .map(|(_, v)| v.trim().trim_matches('"').to_owned())
}

/// The day of a Unix time, in UTC; counted from 1 March of the year 0, so that leap days come last in their
/// year.
fn date(seconds: u64) -> String {
    let days = seconds / 86_400 + 719_468;
    let era = days / 146_097;
    let day = days % 146_097;
    let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let of_month = day - (153 * month + 2) / 5 + 1;
    let (month, next) = if month < 10 {
        (month + 3, 0)
    } else {
        (month - 9, 1)
    };
    format!("{:04}-{month:02}-{of_month:02}", 400 * era + year + next)
}

/// The command line as it was typed, quoted where a shell needs it.
pub fn command_line() -> String {
    let words = std::env::args_os().map(|a| quoted(&a.to_string_lossy()));
    words.collect::<Vec<_>>().join(" ")
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./,=:+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_those_of_the_calendar() {
        let day = |n: u64| date(n * 86_400 + 86_399);
        assert_eq!(day(0), "1970-01-01");
        assert_eq!(day(11_016), "2000-02-29");
        assert_eq!(day(11_017), "2000-03-01");
        assert_eq!(day(20_088), "2024-12-31");
        assert_eq!(day(20_089), "2025-01-01");
    }

    #[test]
    fn values_and_words() {
        assert_eq!(
            value("a\t: 1\nb : x y\nb : z\n", "b", ':').as_deref(),
            Some("x y")
        );
        assert_eq!(
            value("PRETTY_NAME=\"An OS\"\n", "PRETTY_NAME", '=').as_deref(),
            Some("An OS")
        );
        assert_eq!(quoted("a-b/c.glb"), "a-b/c.glb");
        assert_eq!(quoted("it's"), "'it'\\''s'");
        assert_eq!(quoted(""), "''");
    }
}
