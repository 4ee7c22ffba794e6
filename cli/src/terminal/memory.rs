//! The memory of this process and of the system.

use std::path::{Path, PathBuf};

/// Returns the memory that this process can still allocate, in bytes, from Linux's /proc and the process's
/// control groups. Returns `None` if the system does not report it.
pub fn available() -> Option<u64> {
    let free = line("/proc/meminfo", "MemAvailable:")?.checked_mul(1024)?;
    let own = std::fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
    let own = own
        .lines()
        .find_map(|l| l.strip_prefix("0::"))
        .unwrap_or_default();
    let own = PathBuf::from("/sys/fs/cgroup").join(own.trim_start_matches('/'));
    let groups = own
        .ancestors()
        .take_while(|g| g.starts_with("/sys/fs/cgroup"));
    Some(groups.filter_map(left_in).fold(free, u64::min))
}

/// Returns the bytes that a control group can still allocate, or `None` without a limit (the file then
/// contains "max").
fn left_in(group: &Path) -> Option<u64> {
    let number = |file: &str| {
        std::fs::read_to_string(group.join(file))
            .ok()?
            .trim()
            .parse::<u64>()
            .ok()
    };
    let (most, used) = (number("memory.max")?, number("memory.current")?);
    // The kernel first reclaims pages of files that were not used recently.
    let files = line(group.join("memory.stat"), "inactive_file").unwrap_or(0);
    Some(most.saturating_sub(used.saturating_sub(files)))
}

/// Returns the resident memory of this process in bytes, or `None` if the system does not report it.
pub fn resident() -> Option<u64> {
    line("/proc/self/status", "VmRSS:")?.checked_mul(1024)
}

/// Returns the first number of the line that starts with `word`.
fn line(file: impl AsRef<Path>, word: &str) -> Option<u64> {
    let text = std::fs::read_to_string(file).ok()?;
    let rest = text.lines().find_map(|l| l.strip_prefix(word))?;
    rest.split_whitespace().next()?.parse().ok()
}

/// Formats a number of bytes in MB (10^6 bytes) or GB (10^9 bytes).
pub fn in_words(bytes: u64) -> String {
    match bytes as f64 {
        b if b < 1e9 => format!("{:.0} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}
