//! Resources of this process: the pool of threads, the async runtime, and its name.

use std::sync::{Mutex, PoisonError};

use crate::error::Error;

/// Returns the number of threads to use: the given one, otherwise one per core; 1 to 1024.
pub fn threads(given: Option<usize>) -> usize {
    given
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
        .clamp(1, 1024)
}

/// Sets the size of the process's thread pool, which reads scenes, samples, answers queries and codes
/// results. It has an effect only before the first use of the pool; functions of this library that need the
/// pool make this call with one thread per core. Tiles run on separate threads, so that no tile waits inside
/// another one.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] for threads that cannot be started.
pub fn use_threads(threads: usize) -> Result<(), Error> {
    static IS_SET: Mutex<bool> = Mutex::new(false);
    let mut is_set = IS_SET.lock().unwrap_or_else(PoisonError::into_inner);
    if !*is_set {
        let built = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global();
        // Only a thread that cannot start has a source; another part of the process may have set the pool.
        if let Err(e) = built
            && std::error::Error::source(&e).is_some()
        {
            return Err(Error::internal(e));
        }
        *is_set = true;
    }
    Ok(())
}

/// Creates an async runtime. Its two threads only move bytes.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] for threads that cannot be started.
pub fn runtime() -> Result<tokio::runtime::Runtime, Error> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(Error::internal)
}

/// Creates a name for this process from the host's name, the process's number and a random number: containers
/// may share the first two.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] for a system without random numbers.
pub fn default_name() -> Result<String, Error> {
    let host = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
    let host: String = host
        .trim()
        .chars()
        .filter(|c| c.is_ascii_alphanumeric() || *c == '-')
        .take(40)
        .collect();
    let host = if host.is_empty() {
        "worker".to_owned()
    } else {
        host
    };
    let random = getrandom::u32().map_err(Error::internal)? as u16;
    Ok(format!("{host}-{}-{random:04x}", std::process::id()))
}
