//! The handling of Ctrl-C and SIGTERM.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::terminal::stderr::say;

/// True after the first signal.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);
/// True if the second signal ends the process.
static ENDS_AT_SECOND: AtomicBool = AtomicBool::new(false);

/// Returns true if Ctrl-C or SIGTERM arrived since the first call of this function. Before that call, a
/// signal ends the process in the ordinary way, because no handler is installed.
pub fn is_interrupted() -> bool {
    static WATCH: OnceLock<bool> = OnceLock::new();
    WATCH.get_or_init(|| {
        let thread = std::thread::Builder::new().name("interrupt".to_owned());
        // Without the thread, signals end the process in the ordinary way.
        thread.spawn(watch).is_ok()
    });
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Makes the second signal end the process, for a command without temporary files.
pub fn end_at_second() {
    ENDS_AT_SECOND.store(true, Ordering::Relaxed);
}

#[expect(
    clippy::disallowed_methods,
    reason = "only commands without temporary files let the second signal end the process"
)]
fn watch() {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build();
    let Ok(runtime) = runtime else {
        return;
    };
    runtime.block_on(async {
        stop_signal().await;
        INTERRUPTED.store(true, Ordering::Relaxed);
        if ENDS_AT_SECOND.load(Ordering::Relaxed) {
            say("interrupted: finishing the claims in progress; press Ctrl-C again to stop immediately");
            stop_signal().await;
            std::process::exit(130);
        }
        // Later signals have no further effect.
        std::future::pending::<()>().await;
    });
}

/// Resolves at the next SIGTERM or Ctrl-C.
pub async fn stop_signal() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut term) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = term.recv() => {}
                _ = tokio::signal::ctrl_c() => {}
            }
            return;
        }
    }
    // Ctrl-C can be caught even on systems without SIGTERM.
    let _ = tokio::signal::ctrl_c().await;
}
