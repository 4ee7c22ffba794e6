//! The tracing of packets on the device.
//!
//! Uploads, dispatches and read-backs form a ring, so that the host copies one batch while the device traces
//! another.
//!
//! Rays are neither sorted nor changed, and each hit returns to the lane of its ray. Batch sizes and thread
//! numbers therefore do not change a result. Several threads may trace at once; each uses buffers from a
//! common pool.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, mpsc};

use super::device::{Gpu, PATIENCE};
use super::line_scene::DeviceLineScene;
use super::locks::lock;
use super::pipelines::scoped;
use super::rounds::{GpuRounds, RoundsKit};
use crate::cube::SKY;
use crate::error::TracerError;
use crate::lines::device::{DeviceBlock, Rounds};
use crate::packet::{Halves, LANES, LineTracer, Packet};

/// The number of batches of one call that are in flight.
const RING: usize = 3;
/// The number of batches into which a call is divided, unless they become smaller than [`LEAST_BATCH`].
const CUTS: usize = 6;
/// Minimum number of packets for which a submission is worth its cost.
const LEAST_BATCH: usize = 2048;
/// Maximum number of packets of a batch: a million rays, which need tens of milliseconds on a slow GPU.
const MOST_BATCH: usize = 1 << 16;
/// The number of slots that are stored for later calls.
const KEPT: usize = 16;
/// The number of packets of a workgroup, as in `trace.wgsl`.
const GROUP: usize = 4;
/// The number of 32-bit words of a packet's rays: origins and directions.
const RAY_WORDS: usize = 6 * LANES;
/// The number of 32-bit words of a packet's hits: distances and ids.
const HIT_WORDS: usize = 2 * LANES;

/// The buffers of one batch.
struct BatchBuffers {
    /// The number of packets that fit, in whole workgroups.
    capacity: usize,
    /// The upload buffer, which is mapped for writing while the slot is in the pool.
    upload: wgpu::Buffer,
    rays: wgpu::Buffer,
    hits: wgpu::Buffer,
    read_back: wgpu::Buffer,
    group: wgpu::BindGroup,
}

/// A batch that was submitted to the device.
struct LineBatch<'p> {
    packets: &'p mut [Packet],
    slot: BatchBuffers,
    submission: wgpu::SubmissionIndex,
    /// The receiver of two messages: the read-back is mapped, and the upload is mapped for the next batch.
    mapped: mpsc::Receiver<Result<(), wgpu::BufferAsyncError>>,
}

/// A scene on the device, and a pool of buffers for batches.
pub(super) struct LineKit {
    scene: DeviceLineScene,
    pool: Mutex<Vec<BatchBuffers>>,
    rounds: RoundsKit,
}

impl LineKit {
    pub(super) fn new(scene: DeviceLineScene) -> Self {
        Self {
            scene,
            pool: Mutex::default(),
            rounds: RoundsKit::default(),
        }
    }

    /// Returns the data that whole rounds on the device need.
    pub(super) fn for_rounds(&self) -> (&DeviceLineScene, &RoundsKit) {
        (&self.scene, &self.rounds)
    }

    /// Returns a slot for this number of packets, from the pool or new.
    fn slot(&self, device: &wgpu::Device, packets: usize) -> Result<BatchBuffers, String> {
        let spare = {
            let mut pool = lock(&self.pool);
            let fit = pool
                .iter()
                .enumerate()
                .filter(|(_, s)| s.capacity >= packets);
            let place = fit.min_by_key(|(_, s)| s.capacity).map(|(place, _)| place);
            place.map(|place| pool.swap_remove(place))
        };
        match spare {
            Some(slot) => Ok(slot),
            None => BatchBuffers::new(device, &self.scene, packets.next_power_of_two().max(GROUP)),
        }
    }

    fn put_back(&self, slot: BatchBuffers) {
        let mut pool = lock(&self.pool);
        pool.push(slot);
        if pool.len() > KEPT
            && let Some((least, _)) = pool.iter().enumerate().min_by_key(|(_, s)| s.capacity)
        {
            pool.swap_remove(least);
        }
    }
}

impl BatchBuffers {
    /// Creates buffers for `capacity` packets.
    fn new(
        device: &wgpu::Device,
        scene: &DeviceLineScene,
        capacity: usize,
    ) -> Result<Self, String> {
        scoped(device, || {
            let make = |label, words: usize, usage, mapped_at_creation| {
                let size = (capacity * words * 4) as u64;
                device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some(label),
                    size,
                    usage,
                    mapped_at_creation,
                })
            };
            use wgpu::BufferUsages as Use;
            let rays = make("rays", RAY_WORDS, Use::STORAGE | Use::COPY_DST, false);
            let hits = make("hits", HIT_WORDS, Use::STORAGE | Use::COPY_SRC, false);
            let bind = |binding, resource| wgpu::BindGroupEntry { binding, resource };
            let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("rays"),
                layout: &scene.rays_layout,
                entries: &[
                    bind(0, rays.as_entire_binding()),
                    bind(1, hits.as_entire_binding()),
                ],
            });
            Ok(Self {
                capacity,
                upload: make(
                    "ray upload",
                    RAY_WORDS,
                    Use::MAP_WRITE | Use::COPY_SRC,
                    true,
                ),
                read_back: make(
                    "hit read-back",
                    HIT_WORDS,
                    Use::MAP_READ | Use::COPY_DST,
                    false,
                ),
                rays,
                hits,
                group,
            })
        })
    }

    /// Copies the packets' rays into the upload buffer and unmaps it. Unused lanes have the direction zero,
    /// which never hits a triangle.
    fn fill(&self, packets: &[Packet]) -> Result<(), wgpu::MapRangeError> {
        {
            let bytes = 4 * RAY_WORDS;
            let mut view = self
                .upload
                .get_mapped_range_mut(..(packets.len() * bytes) as u64)?;
            for (i, packet) in packets.iter().enumerate() {
                let mut direction = packet.direction;
                if packet.count < LANES {
                    direction
                        .iter_mut()
                        .for_each(|d| d[packet.count..].fill(0.0));
                }
                let halves = [&packet.origin, &direction];
                for (half, at) in halves.into_iter().zip([i * bytes, i * bytes + bytes / 2]) {
                    view.slice(at..at + bytes / 2)
                        .copy_from_slice(bytemuck::cast_slice(half));
                }
            }
        }
        self.upload.unmap();
        Ok(())
    }
}

/// A tracer of lines through the whole scene of a [`super::GpuBackend`].
pub(super) struct GpuTracer<'a> {
    gpu: &'a Gpu,
    kit: Arc<LineKit>,
    /// The maximum number of packets of a batch.
    most: usize,
}

impl<'a> GpuTracer<'a> {
    pub(super) fn new(gpu: &'a Gpu, kit: Arc<LineKit>) -> Self {
        let limits = gpu.device.limits();
        let bytes = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size);
        let room = usize::try_from(bytes / (4 * RAY_WORDS as u64)).unwrap_or(MOST_BATCH);
        let groups = limits.max_compute_workgroups_per_dimension as usize * GROUP;
        // A power of two, like the capacities of slots.
        let most = (room.min(groups).clamp(GROUP, MOST_BATCH) + 1).next_power_of_two() / 2;
        Self { gpu, kit, most }
    }

    fn trace_in(&self, packets: &mut [Packet], batch: usize) -> Result<(), TracerError> {
        self.gpu.check()?;
        if self.kit.scene.empty {
            for packet in packets {
                packet.distance = [f32::INFINITY; LANES];
                packet.triangle = [SKY; LANES];
            }
            return Ok(());
        }
        let mut flights = VecDeque::with_capacity(RING);
        for run in packets.chunks_mut(batch) {
            if flights.len() == RING
                && let Some(oldest) = flights.pop_front()
            {
                self.land(oldest)?;
            }
            flights.push_back(self.launch(run)?);
        }
        flights.into_iter().try_for_each(|flight| self.land(flight))
    }

    /// Records and submits one batch.
    fn launch<'p>(&self, packets: &'p mut [Packet]) -> Result<LineBatch<'p>, TracerError> {
        let b = self.gpu;
        let slot = self
            .kit
            .slot(&b.device, packets.len())
            .map_err(|reason| b.failed(reason))?;
        slot.fill(packets)
            .map_err(|e| b.failed(format!("writing rays: {e}")))?;
        let pipeline = self
            .kit
            .scene
            .pipeline(&b.device)
            .map_err(|reason| b.failed(reason))?;
        let mut encoder = b
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let bytes = |words: usize| (packets.len() * words * 4) as u64;
        encoder.copy_buffer_to_buffer(&slot.upload, 0, &slot.rays, 0, bytes(RAY_WORDS));
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, &self.kit.scene.group, &[]);
            pass.set_bind_group(1, &slot.group, &[]);
            // The last group may also trace rays of an earlier batch, whose hits are not read. There are at
            // most `most` / GROUP groups.
            pass.dispatch_workgroups(packets.len().div_ceil(GROUP) as u32, 1, 1);
        }
        encoder.copy_buffer_to_buffer(&slot.hits, 0, &slot.read_back, 0, bytes(HIT_WORDS));
        let submission = b.queue.submit([encoder.finish()]);
        let (sender, mapped) = mpsc::channel();
        let again = sender.clone();
        // The receiver no longer exists if an earlier batch failed.
        slot.read_back
            .map_async(wgpu::MapMode::Read, ..bytes(HIT_WORDS), move |r| {
                drop(sender.send(r))
            });
        slot.upload
            .map_async(wgpu::MapMode::Write, .., move |r| drop(again.send(r)));
        b.check()?;
        Ok(LineBatch {
            packets,
            slot,
            submission,
            mapped,
        })
    }

    /// Waits for a batch and reads its hits. The slot returns to the pool only on success.
    fn land(&self, flight: LineBatch<'_>) -> Result<(), TracerError> {
        let b = self.gpu;
        let LineBatch {
            packets,
            slot,
            submission,
            mapped,
        } = flight;
        b.wait(submission)?;
        for _ in 0..2 {
            match mapped.recv_timeout(PATIENCE) {
                Ok(Ok(())) => {}
                Ok(Err(error)) => return Err(b.failed(format!("mapping a batch of rays: {error}"))),
                Err(_) => return Err(b.failed("a batch of rays was not mapped")),
            }
        }
        {
            let end = (packets.len() * HIT_WORDS * 4) as u64;
            let view = slot
                .read_back
                .get_mapped_range(..end)
                .map_err(|e| b.failed(format!("reading hits back: {e}")))?;
            let halves = view.chunks_exact(4 * LANES);
            let (distances, ids) = (halves.clone().step_by(2), halves.skip(1).step_by(2));
            for ((packet, distance), id) in packets.iter_mut().zip(distances).zip(ids) {
                bytemuck::cast_slice_mut(&mut packet.distance).copy_from_slice(distance);
                bytemuck::cast_slice_mut(&mut packet.triangle).copy_from_slice(id);
            }
        }
        slot.read_back.unmap();
        self.kit.put_back(slot);
        Ok(())
    }
}

impl LineTracer for GpuTracer<'_> {
    fn batch(&self) -> usize {
        2 * LEAST_BATCH
    }

    fn trace(&self, packets: &mut [Packet], _: Halves, _: bool) -> Result<(), TracerError> {
        let batch = packets
            .len()
            .div_ceil(CUTS)
            .max(LEAST_BATCH)
            .next_power_of_two()
            .min(self.most);
        self.trace_in(packets, batch)
    }

    fn rounds<'b>(
        &'b self,
        block: &DeviceBlock<'_>,
    ) -> Result<Option<Box<dyn Rounds + 'b>>, TracerError> {
        let (scene, kit) = self.kit.for_rounds();
        let made = GpuRounds::new(self.gpu, scene, kit, block)?;
        Ok(made.map(|rounds| Box::new(rounds) as Box<dyn Rounds + 'b>))
    }
}

#[cfg(test)]
#[path = "tracer_tests.rs"]
mod tests;
