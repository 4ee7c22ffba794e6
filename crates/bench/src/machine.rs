//! The facts about the machine that times depend on.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;
use sightline_trace::cpu;

/// The facts that a reader needs to judge the times.
#[derive(Debug, Serialize)]
pub struct MachineFacts {
    /// The name of the processor.
    pub cpu: String,
    /// The number of cores that this process may use.
    pub cores: usize,
    /// The memory of the machine, as text.
    pub memory: String,
    /// The distribution and the kernel.
    pub os: String,
    /// The numerics profile of the cpu backend. Results of different profiles differ in a few pixels.
    pub numerics_profile: String,
    /// The version of this program.
    pub version: &'static str,
    /// The date in UTC.
    pub date: String,
}

impl MachineFacts {
    /// Reads the facts from the system. A fact that the system does not report is "unknown".
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
            numerics_profile: cpu::PROFILE.to_owned(),
            version: env!("CARGO_PKG_VERSION"),
            date: date(
                SystemTime::now()
                    .duration_since(UNIX_EPOCH)
                    .map_or(0, |d| d.as_secs()),
            ),
        }
    }
}

/// Returns the value of the first line with `key`, in lines of keys and values.
fn value(text: &str, key: &str, separator: char) -> Option<String> {
    let mut lines = text.lines().filter_map(|l| l.split_once(separator));
    lines
        .find(|(k, _)| k.trim() == key)
        .map(|(_, v)| v.trim().trim_matches('"').to_owned())
}

/// Returns the day of a Unix time, in UTC. The computation counts from 1 March of the year 0, so that leap
/// days are the last days of their years.
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

/// Returns the command line as it was typed, quoted for a shell if necessary.
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
    fn dates_match_calendar() {
        let day = |n: u64| date(n * 86_400 + 86_399);
        assert_eq!(day(0), "1970-01-01");
        assert_eq!(day(11_016), "2000-02-29");
        assert_eq!(day(11_017), "2000-03-01");
        assert_eq!(day(20_088), "2024-12-31");
        assert_eq!(day(20_089), "2025-01-01");
    }

    #[test]
    fn value_finds_key_and_quoted_escapes_words() {
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
