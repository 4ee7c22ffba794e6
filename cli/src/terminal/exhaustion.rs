//! Exhausted memory, threads and descriptors: a command that exhausts one of them ends with exit code 1 and
//! an error message.
//!
//! Stable Rust ends a process with `abort` if an allocation fails, and panics if the system provides no
//! further thread. The program's allocator ends the process itself if a small allocation fails. It records
//! other failed allocations, so that the handler of SIGABRT can distinguish this end from others. The C
//! library aborts, too, for example if it cannot allocate the record of a thread's destructor; the handler
//! recognises this end by an allocation that fails. Callers that handle a large failed allocation themselves
//! (`try_reserve`) continue. Panics and errors are recognised by the error numbers that the standard library
//! writes into their texts, because the crates below return system errors as text.

use std::alloc::{GlobalAlloc, Layout, System};
use std::any::Any;
use std::cell::Cell;
use std::io::{Write as _, stderr};
use std::panic::PanicHookInfo;

/// The allocator of the program: the system's allocator, with a record of failed allocations per thread.
#[derive(Debug)]
pub struct Allocator;

thread_local! {
    /// True after an allocation of this thread has failed. Later allocations do not reset the flag: between
    /// the failure and `abort`, the standard library may print a backtrace, which allocates.
    static HAS_FAILED: Cell<bool> = const { Cell::new(false) };
}

/// Maximum size in bytes of an allocation whose failure ends the process at once.
///
/// Without such an amount, the process cannot report anything. The standard library reports a failed
/// allocation with a backtrace, which needs memory, too. If an allocation of this report fails, the standard
/// library waits forever for the lock of the backtrace, which the same thread holds.
#[cfg(unix)]
const ESSENTIAL: usize = 1 << 20;

/// Records a failed allocation of `bytes` bytes if `pointer` is null. Returns `pointer`.
#[cfg_attr(not(unix), allow(unused_variables, reason = "only Unix ends at once"))]
fn noted(pointer: *mut u8, bytes: usize) -> *mut u8 {
    if pointer.is_null() {
        HAS_FAILED.set(true);
        #[cfg(unix)]
        if bytes <= ESSENTIAL {
            abort::out_of_memory();
        }
    }
    pointer
}

#[allow(unsafe_code, reason = "an allocator is unsafe")]
// SAFETY: all calls are passed to the system's allocator unchanged, and its pointers are returned unchanged.
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        noted(unsafe { System.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        noted(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        // SAFETY: as the caller promises.
        noted(unsafe { System.realloc(pointer, layout, bytes) }, bytes)
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// Installs the handlers of exhausted resources. If an allocation fails, they end the process with exit code
/// 1 and an error message. If the system provides no further thread, they print a message and, on Unix, end
/// the process with exit code 1. Call this function before the first thread starts.
pub fn watch() {
    #[cfg(unix)]
    abort::watch();
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic: &PanicHookInfo<'_>| {
        match Exhausted::in_panic(panic.payload()) {
            // The panicking code may hold the lock of a progress bar. The write fails only if stderr is
            // closed.
            Some(what) => {
                drop(writeln!(
                    stderr(),
                    "error: {}; {}",
                    what.sentence(),
                    what.remedy()
                ));
                // Other threads may wait forever for a thread that could not start or that has panicked.
                #[cfg(unix)]
                if what != Exhausted::Files {
                    abort::end();
                }
            }
            None => usual(panic),
        }
    }));
}

/// An exhausted resource of the system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exhausted {
    /// Memory.
    Memory,
    /// Threads, or the memory for their stacks.
    Threads,
    /// File descriptors.
    Files,
}

impl Exhausted {
    /// Returns the resource that the text of an error names, or `None` for other errors.
    pub fn in_error(text: &str) -> Option<Self> {
        // These are the error numbers as errors display and debug them: EMFILE and ENFILE, ENOMEM, and EAGAIN
        // of Linux and macOS.
        let has = |numbers: &[u32]| {
            numbers.iter().any(|n| {
                text.contains(&format!("(os error {n})")) || text.contains(&format!("code: {n},"))
            })
        };
        let is_thread = text.contains("thread") || text.contains("ThreadPool");
        // The dynamic loader does not report error numbers.
        if has(&[24, 23]) || text.contains("Too many open files") {
            Some(Self::Files)
        } else if is_thread && has(&[11, 35, 12]) {
            Some(Self::Threads)
        } else if has(&[12])
            || [
                "out of memory",
                "failed to allocate",
                // zstd cannot allocate a context.
                "null pointer when creating new context",
                "not enough memory",
                "Cannot allocate memory",
            ]
            .iter()
            .any(|t| text.contains(t))
        {
            Some(Self::Memory)
        } else {
            None
        }
    }

    /// Returns the resource that the payload of a panic names.
    pub fn in_panic(payload: &(dyn Any + Send)) -> Option<Self> {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        text.or_else(|| payload.downcast_ref::<&str>().copied())
            .and_then(Self::in_error)
    }

    fn sentence(self) -> &'static str {
        match self {
            Self::Memory => "the system has no memory left for this process",
            Self::Threads => "the system gives this process no further thread",
            Self::Files => "this process has too many open files",
        }
    }

    /// Returns the second part of the error message: the remedy for the user.
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Memory => {
                "give the process more memory (ulimit -v), or a smaller scene or result"
            }
            Self::Threads => {
                "raise the limits of processes and memory (ulimit -u and ulimit -v), or use fewer threads"
            }
            Self::Files => "raise the limit of open files (ulimit -n)",
        }
    }
}

#[cfg(unix)]
mod abort {
    //! The end of the process in a handler of SIGABRT, or if a thread cannot start.

    use crate::terminal::exhaustion::HAS_FAILED;

    const SENTENCE: &[u8] =
        b"error: the system has no memory left for this process; give it more memory \
        (ulimit -v), use fewer threads, or a smaller scene or result\n";

    /// Length of the mapping that shows whether the system has memory left, in bytes.
    const PROBE_BYTES: usize = 1 << 20;

    /// Returns true if the system gives this process no further megabyte.
    fn memory_is_exhausted() -> bool {
        #[allow(
            unsafe_code,
            reason = "a handler of signals cannot allocate, and these system calls take no locks"
        )]
        // SAFETY: the system selects the address of the mapping, nothing uses the mapping, and the second
        // call removes it.
        unsafe {
            let (access, kind) = (
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_PRIVATE | libc::MAP_ANON,
            );
            let mapping = libc::mmap(std::ptr::null_mut(), PROBE_BYTES, access, kind, -1, 0);
            mapping == libc::MAP_FAILED || libc::munmap(mapping, PROBE_BYTES) != 0
        }
    }

    /// Writes the error message and ends the process if an allocation of this thread has failed, or if no
    /// memory is left. Otherwise returns, and `abort` ends the process.
    extern "C" fn on_abort(_: libc::c_int) {
        if !HAS_FAILED.get() && !memory_is_exhausted() {
            return;
        }
        out_of_memory();
    }

    /// Writes the error message and ends the process with exit code 1.
    pub(super) fn out_of_memory() -> ! {
        #[allow(
            unsafe_code,
            reason = "neither a handler of signals nor an allocator may allocate"
        )]
        // SAFETY: the bytes outlive the call. The write fails only if stderr is closed, and then the error
        // cannot be shown either.
        let _ = unsafe {
            libc::write(
                libc::STDERR_FILENO,
                SENTENCE.as_ptr().cast(),
                SENTENCE.len(),
            )
        };
        end();
    }

    /// Ends the process with exit code 1.
    pub(super) fn end() -> ! {
        #[allow(
            unsafe_code,
            reason = "the standard library's exit runs handlers, which may need threads and memory"
        )]
        // SAFETY: the function has no preconditions.
        unsafe {
            libc::_exit(1);
        }
    }

    /// Installs the handler of SIGABRT.
    pub(super) fn watch() {
        let handler = on_abort as extern "C" fn(libc::c_int);
        #[allow(unsafe_code, reason = "a handler of signals is set by a function of C")]
        // SAFETY: the handler calls only system calls and functions that are permitted in handlers. It reads
        // a thread-local variable that needs no initialisation.
        unsafe {
            libc::signal(libc::SIGABRT, handler as libc::sighandler_t);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Error, ErrorKind};

    use super::*;

    #[test]
    fn error_texts_name_exhausted_resource() {
        let os_error = |number| Error::from_raw_os_error(number);
        let in_error =
            |error: Error| Exhausted::in_error(&format!("a.pvs cannot be read: {error}"));
        assert_eq!(in_error(os_error(24)), Some(Exhausted::Files));
        assert_eq!(in_error(os_error(23)), Some(Exhausted::Files));
        assert_eq!(in_error(os_error(12)), Some(Exhausted::Memory));
        assert_eq!(
            in_error(ErrorKind::OutOfMemory.into()),
            Some(Exhausted::Memory)
        );
        assert_eq!(in_error(os_error(2)), None);
        // A socket without data reports the same number as a thread that cannot start.
        assert_eq!(in_error(os_error(11)), None);
        for panic in [
            format!("failed to spawn thread: {:?}", os_error(11)),
            format!("OS can't spawn worker thread: {}", os_error(11)),
            format!(
                "The global thread pool has not been initialized.: {:?}",
                os_error(12)
            ),
        ] {
            let payload: Box<dyn Any + Send> = Box::new(panic);
            assert_eq!(Exhausted::in_panic(&*payload), Some(Exhausted::Threads));
        }
    }
}
