//! How much memory there is for more.

/// Bytes that this process can still take before the system has none, from Linux's /proc and the process's
/// control group; `None` where the system does not tell.
pub fn available() -> Option<u64> {
    let number = |text: &str| text.trim().parse::<u64>().ok();
    let meminfo = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = meminfo.lines().find_map(|l| l.strip_prefix("MemAvailable:"))?;
    let free = number(line.trim().trim_end_matches("kB"))?.checked_mul(1024)?;
    let of_group = |file: &str| number(&std::fs::read_to_string(format!("/sys/fs/cgroup/{file}")).ok()?);
    // A group without a limit says "max".
    match (of_group("memory.max"), of_group("memory.current")) {
        (Some(most), Some(used)) => Some(free.min(most.saturating_sub(used))),
        _ => Some(free),
    }
}

/// Bytes in words.
pub fn in_words(bytes: u64) -> String {
    match bytes as f64 {
        b if b < 1e9 => format!("{:.0} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}
