//! Open devices that are currently not in use. The next backend with the same choice uses such a device,
//! which saves tenths of a second.
//!
//! No device is closed while another device is used or opened: an NVIDIA driver (580.159, H100) did not end
//! `vkDestroyDevice` in one thread while other threads used other devices. A process therefore keeps as many
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
    /// The devices that failed, until they can be closed.
    broken: Vec<Opened>,
    /// The number of devices that are used or being opened.
    in_use: usize,
}

static DEVICES: Mutex<Devices> = Mutex::new(Devices {
    spare: Vec::new(),
    broken: Vec::new(),
    in_use: 0,
});

/// Returns a spare device of a choice, or `None` if there is none. In both cases the caller counts as a user;
/// without a spare device it opens a device.
pub(super) fn take(choice: &AdapterChoice) -> Option<Opened> {
    let mut devices = lock(&DEVICES);
    devices.in_use += 1;
    let place = devices
        .spare
        .iter()
        .position(|opened| opened.choice == *choice)?;
    Some(devices.spare.swap_remove(place))
}

/// Records that the caller of [`take`] has not opened a device.
pub(super) fn none_opened() {
    lock(&DEVICES).release();
}

/// Returns a device to the spare devices. The caller has dropped all resources of the device.
pub(super) fn give_back(opened: Opened) {
    let mut devices = lock(&DEVICES);
    devices.spare.push(opened);
    devices.release();
}

/// Returns a device that has failed. The device is closed when no device is in use.
pub(super) fn give_up(opened: Opened) {
    let mut devices = lock(&DEVICES);
    devices.broken.push(opened);
    devices.release();
}

/// Closes the spare devices, unless another device is in use. Call it if no backend on these devices follows.
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
