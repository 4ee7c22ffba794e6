//! Resources of this process: the thread pool, the async runtime, and the name of the process.

use std::sync::{Mutex, PoisonError};

use crate::error::Error;

/// Returns the number of threads to use: `given`, or otherwise the number of cores. The result is limited to
/// 1 to 1024.
pub fn threads(given: Option<usize>) -> usize {
    given
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
        .clamp(1, 1024)
}

/// Sets the size of the process's thread pool, which reads scenes, samples, answers queries and codes
/// results. The call has an effect only before the first use of the pool. Functions of this library that need
/// the pool make this call with one thread per core. Tiles run on separate threads, so that no tile waits
/// inside another one.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] if threads cannot be started.
pub fn use_threads(threads: usize) -> Result<(), Error> {
    static IS_SET: Mutex<bool> = Mutex::new(false);
    let mut is_set = IS_SET.lock().unwrap_or_else(PoisonError::into_inner);
    if !*is_set {
        let built = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global();
        // Only the error of a thread that cannot start has a source. Otherwise, another part of the process
        // has set the size of the pool.
        if let Err(e) = built
            && std::error::Error::source(&e).is_some()
        {
            return Err(Error::internal(e));
        }
        *is_set = true;
    }
    Ok(())
}

/// Creates an async runtime with two threads, which only transfer bytes.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] if threads cannot be started.
pub fn runtime() -> Result<tokio::runtime::Runtime, Error> {
    tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()
        .map_err(Error::internal)
}

/// Creates a name for this process from the host's name, the process's number and a random number. Containers
/// may share the first two.
///
/// # Errors
/// [`crate::ErrorKind::Internal`] if the system has no random numbers.
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
