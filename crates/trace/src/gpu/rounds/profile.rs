//! The time of each kernel, measured with the device's time stamps. Measuring needs a separate pass for each
//! run of a kernel, so it is off by default.

use std::sync::Mutex;

use super::kernels::{ENTRY_POINTS, Kernel};
use crate::gpu::locks::lock;
use crate::lines::device::KernelTime;

/// The number of runs of kernels in a phase that are measured. Later runs are not measured.
const RUNS: u32 = 2048;

/// The time stamps of the runs of a phase, and the sums so far.
pub(super) struct Profile {
    set: wgpu::QuerySet,
    pub(super) stamps: wgpu::Buffer,
    /// The duration of a tick in nanoseconds.
    period: f64,
    state: Mutex<ProfileState>,
}

#[derive(Default)]
struct ProfileState {
    /// The kernels of the phase's runs.
    runs: Vec<Kernel>,
    /// The ticks and the runs of each kernel.
    sums: [(u64, u64); ENTRY_POINTS.len()],
}

impl Profile {
    /// Creates a profile, or returns `None` if the device has no time stamps.
    pub(super) fn new(device: &wgpu::Device, queue: &wgpu::Queue) -> Option<Self> {
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return None;
        }
        let set = device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("kernels"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * RUNS,
        });
        let stamps = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("time stamps"),
            size: 16 * u64::from(RUNS),
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Some(Self {
            set,
            stamps,
            period: f64::from(queue.get_timestamp_period()),
            state: Mutex::default(),
        })
    }

    /// Returns the places to which the pass of a kernel writes its stamps, or `None` after [`RUNS`] runs.
    pub(super) fn writes(&self, kernel: Kernel) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let mut state = lock(&self.state);
        let at = 2 * state.runs.len() as u32;
        if at >= 2 * RUNS {
            return None;
        }
        state.runs.push(kernel);
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.set,
            beginning_of_pass_write_index: Some(at),
            end_of_pass_write_index: Some(at + 1),
        })
    }

    /// Records the copy of the phase's stamps to `stamps` and returns their size in bytes.
    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) -> u64 {
        let runs = lock(&self.state).runs.len() as u32;
        if runs > 0 {
            encoder.resolve_query_set(&self.set, 0..2 * runs, &self.stamps, 0);
        }
        16 * u64::from(runs)
    }

    /// Adds the phase's stamps to the sums.
    pub(super) fn add(&self, stamps: &[u32]) {
        let mut state = lock(&self.state);
        let runs = std::mem::take(&mut state.runs);
        let at = |k: usize| u64::from(stamps[k]) | u64::from(stamps[k + 1]) << 32;
        for (i, kernel) in runs.into_iter().enumerate() {
            let sum = &mut state.sums[kernel as usize];
            sum.0 += at(4 * i + 2).saturating_sub(at(4 * i));
            sum.1 += 1;
        }
    }

    pub(super) fn times(&self) -> Vec<KernelTime> {
        let sums = lock(&self.state).sums;
        let named = ENTRY_POINTS
            .into_iter()
            .zip(sums)
            .filter(|(_, (_, runs))| *runs > 0);
        named
            .map(|(name, (ticks, runs))| KernelTime {
                name,
                seconds: ticks as f64 * self.period * 1e-9,
                runs,
            })
            .collect()
    }
}
