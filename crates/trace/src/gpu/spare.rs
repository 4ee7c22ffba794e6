//! Open devices that nobody uses at the moment: the next who opens one of the same choice takes it, which
//! saves tenths of a second.
//!
//! No device is closed while another is used or opened: a driver of NVIDIA (580.159, H100) did not end
//! `vkDestroyDevice` in one thread while other threads used devices of their own. So a process keeps as many
//! devices as it has used at the same time, until it uses none and [`close`] is called.

use std::sync::Mutex;

use super::choice::{AdapterChoice, AdapterSummary};
use super::locks::lock;

/// An open device with its queue, the summary of its adapter, and the choice that led to it.
pub(super) struct Opened {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) summary: AdapterSummary,
    pub(super) choice: AdapterChoice,
}

struct Devices {
    spare: Vec<Opened>,
    /// Devices that failed, until they can be closed.
    broken: Vec<Opened>,
    /// Devices that are used or being opened.
    in_use: usize,
}

static DEVICES: Mutex<Devices> = Mutex::new(Devices {
    spare: Vec::new(),
    broken: Vec::new(),
    in_use: 0,
});

/// A spare device of a choice. The caller counts as a user in any case; without a spare device it opens one.
pub(super) fn take(choice: &AdapterChoice) -> Option<Opened> {
    let mut devices = lock(&DEVICES);
    devices.in_use += 1;
    let place = devices
        .spare
        .iter()
        .position(|opened| opened.choice == *choice)?;
    Some(devices.spare.swap_remove(place))
}

/// The caller of [`take`] has opened none.
pub(super) fn none_opened() {
    lock(&DEVICES).release();
}

/// A user is done with a device, and has dropped what was made on it.
pub(super) fn give_back(opened: Opened) {
    let mut devices = lock(&DEVICES);
    devices.spare.push(opened);
    devices.release();
}

/// The same for a device that has failed.
pub(super) fn give_up(opened: Opened) {
    let mut devices = lock(&DEVICES);
    devices.broken.push(opened);
    devices.release();
}

/// Closes the spare devices, where no backend on them follows; none while another device is used.
pub fn close() {
    let mut devices = lock(&DEVICES);
    if devices.in_use == 0 {
        devices.spare.clear();
    }
}

impl Devices {
    fn release(&mut self) {
        self.in_use = self.in_use.saturating_sub(1);
        if self.in_use == 0 {
            self.broken.clear();
        }
    }
}
