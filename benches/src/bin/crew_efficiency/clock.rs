//! Processor time of this process: it does not count the time in which other programs have the core.

/// Nanoseconds of processor time of all threads of this process. The measurement runs one thread at a time.
#[cfg(unix)]
pub fn now() -> u64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// Nanoseconds of a clock, where there is no clock of processor time.
#[cfg(not(unix))]
pub fn now() -> u64 {
    use std::sync::OnceLock;
    use std::time::Instant;
    static BEGUN: OnceLock<Instant> = OnceLock::new();
    BEGUN.get_or_init(Instant::now).elapsed().as_nanos() as u64
}

/// Calls `f`; its value and its time.
pub fn timed<R>(f: impl FnOnce() -> R) -> (R, u64) {
    let begun = now();
    let value = f();
    (value, now() - begun)
}
