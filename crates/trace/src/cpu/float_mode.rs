//! The modes of the processor's floating-point unit during a trace.

#![allow(
    unsafe_code,
    reason = "only instructions read and write these modes; each use says what it relies on"
)]

/// Rounding to nearest with subnormal numbers, until it is dropped.
///
/// A host program, for example an audio engine that loads the C library, can have set other modes for its
/// thread. The earlier modes return when this value is dropped.
pub(super) struct FloatMode {
    /// The modes to restore, or `None` if they were the required ones.
    earlier: Option<Modes>,
}

#[cfg(target_arch = "x86_64")]
mod unit {
    pub(super) type Modes = u32;

    /// Rounding to nearest, subnormal numbers, and no exceptions.
    pub(super) const REQUIRED: Modes = 0x1f80;
    /// The bits of all modes: flushing of subnormal numbers, their use as zero, rounding, and exceptions.
    pub(super) const MASK: Modes = 0xffc0;

    pub(super) fn read() -> Modes {
        let mut modes: Modes = 0;
        // SAFETY: the instruction writes four bytes to a place of this function.
        unsafe {
            std::arch::asm!("stmxcsr [{}]", in(reg) &mut modes, options(nostack, preserves_flags));
        }
        modes
    }

    pub(super) fn write(modes: Modes) {
        // SAFETY: the instruction reads four bytes from a place of this function. `modes` is a value that was
        // read before, or REQUIRED, so no reserved bit is set.
        unsafe {
            std::arch::asm!("ldmxcsr [{}]", in(reg) &modes, options(nostack));
        }
    }
}

#[cfg(target_arch = "aarch64")]
mod unit {
    pub(super) type Modes = u64;

    /// Rounding to nearest, subnormal numbers, and no exceptions.
    pub(super) const REQUIRED: Modes = 0;
    /// The bits of all modes: flushing of subnormal numbers (FZ, FZ16, FIZ, AH), rounding, NaN (DN, NEP), and
    /// exceptions.
    pub(super) const MASK: Modes = 0x03c8_9f07;

    pub(super) fn read() -> Modes {
        let modes: Modes;
        // SAFETY: the instruction only reads a register.
        unsafe {
            std::arch::asm!("mrs {}, fpcr", out(reg) modes, options(nomem, nostack, preserves_flags));
        }
        modes
    }

    pub(super) fn write(modes: Modes) {
        // SAFETY: `modes` is a value that was read before, or REQUIRED, so no reserved bit is set.
        unsafe {
            std::arch::asm!("msr fpcr, {}", in(reg) modes, options(nostack));
        }
    }
}

/// WebAssembly has no such modes. The modes of other processors are not handled.
#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
mod unit {
    pub(super) type Modes = u32;
    pub(super) const REQUIRED: Modes = 0;
    pub(super) const MASK: Modes = 0;

    pub(super) fn read() -> Modes {
        REQUIRED
    }

    pub(super) fn write(_: Modes) {}
}

use unit::Modes;

impl FloatMode {
    /// Sets the required modes.
    pub(super) fn set() -> Self {
        let modes = unit::read();
        if modes & unit::MASK == unit::REQUIRED & unit::MASK {
            return Self { earlier: None };
        }
        unit::write(unit::REQUIRED);
        Self {
            earlier: Some(modes),
        }
    }
}

impl Drop for FloatMode {
    fn drop(&mut self) {
        if let Some(modes) = self.earlier {
            unit::write(modes);
        }
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    #[test]
    fn modes_are_set_and_restored() {
        let usual = unit::read();
        // Subnormal numbers are flushed and used as zero.
        let flushing = usual | 0x8040;
        unit::write(flushing);
        let during = {
            let _mode = FloatMode::set();
            unit::read()
        };
        let after = unit::read();
        unit::write(usual);
        assert_eq!(during & unit::MASK, unit::REQUIRED & unit::MASK);
        assert_eq!(after & unit::MASK, flushing & unit::MASK);
    }
}
