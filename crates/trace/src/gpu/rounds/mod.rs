//! Rounds of sight lines that stay on the device. The kernels create lines, trace them, credit the cells of
//! the block and count. The host receives only the new bits of the table and a few numbers per cell.
//!
//! A phase is divided into parts with a limited number of lines ([`GpuRounds`]). For uniform lines, the
//! kernels of a part create the lines and cast them. Each ray that shows its cell a new triangle claims the
//! triangle. The kernels then gather the winning claims. Four times, they then claim the neighbours of the
//! found triangles, create lines to them, cast, claim and gather. Claims make the result independent of time:
//! of all lines with a claim, the line with the lowest number wins. For candidates, the kernels of a part
//! list the candidates of some triangles. As often as the plan requires, they create lines to the candidates
//! that no line has met yet, cast and gather.
//!
//! Two kernels cast lines: one with a thread per ray, and one that traverses the cells. If pairs of cells are
//! searched, a third kernel joins the cells that some of the lines cross.
//!
//! At the end of a phase, the host reads the words of the table with new bits, and the new table becomes the
//! table of the last barrier.

mod kernels;
mod memory;
mod phase_end;
mod phases;
mod profile;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, mpsc};
use std::time::Instant;

use kernels::{Kernel, Kernels, STORAGE_BUFFERS};
use memory::{BlockLists, Facts, Lists, PART_STRIDE, PARTS, Part, Tables};
use profile::Profile;

use super::device::{Gpu, PATIENCE};
use super::line_scene::DeviceLineScene;
use super::locks::lock;
use super::pipelines::{DeviceFault, scoped_by_kind};
use crate::error::TracerError;
use crate::lines::device::{DeviceBlock, Traffic};

/// The number of newly found triangles that a list contains. On a GPU it is large enough to keep the device
/// busy. On a software rasteriser it is small, because each part clears its claims.
const CAPACITY: u32 = 1 << 20;
const SOFTWARE_CAPACITY: u32 = 1 << 16;
/// The number of workgroups of a kernel. Each thread processes elements at a stride of the number of threads.
const GROUPS: u32 = 4096;
const SOFTWARE_GROUPS: u32 = 64;
/// The number of parts by which the device may lag behind.
const IN_FLIGHT: usize = 3;
/// The data that the blocks of a scene share: kernels, facts and spare lists.
#[derive(Default)]
pub(super) struct RoundsKit {
    /// The kernels for each combination of two properties.
    ///
    /// The properties are that the halves of a line are credited separately, and that a half is free only in
    /// its own direction.
    kernels: [Mutex<Option<Arc<Kernels>>>; 4],
    facts: Mutex<Option<Arc<Facts>>>,
    spare: Mutex<Vec<Lists>>,
}

/// A block on the device.
pub(super) struct GpuRounds<'a> {
    gpu: &'a Gpu,
    scene: &'a DeviceLineScene,
    kit: &'a RoundsKit,
    kernels: Arc<Kernels>,
    tables: Tables,
    /// Empty after the block is dropped.
    block_lists: Option<BlockLists>,
    capacity: u32,
    groups: u32,
    /// The joining intervals of uniform lines and of other lines: one line in this number joins cells.
    joined: [u32; 2],
    /// The slot of each cell of the block in the division's grid; empty without pairs.
    division_slots: Vec<u32>,
    /// The number of cells of the division.
    division: u32,
    profile: Option<Profile>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    traffic: Traffic,
    /// The number of parts written so far.
    parts: u32,
    flying: std::collections::VecDeque<wgpu::SubmissionIndex>,
}

/// Returns the reason why a device does not support a block, as a part of a sentence, or `None` if it does.
fn obstacle(gpu: &Gpu, block: &DeviceBlock<'_>, capacity: u32) -> Option<String> {
    let limits = gpu.device.limits();
    let most = limits
        .max_storage_buffer_binding_size
        .min(limits.max_buffer_size);
    let largest = Tables::bytes(block)
        .max(Tables::pair_bytes(block))
        .max(Facts::most_bytes(block))
        .max(Lists::most_bytes(capacity));
    if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS {
        return Some(format!(
            "it binds {} storage buffers, and rounds need {STORAGE_BUFFERS}",
            limits.max_storage_buffers_per_shader_stage
        ));
    }
    // Kernels number the triangles times the words of a row.
    if u64::from(block.scene.len()) * block.grid.words() as u64 >= 1 << 31 {
        return Some(format!(
            "{} triangles are more than it numbers for so many cells",
            block.scene.len()
        ));
    }
    (largest > most)
        .then(|| format!("{largest} bytes in one buffer are more than the {most} that it binds"))
}

/// Logs the reason why the host creates and credits lines, each reason once per process.
fn say_once(why: &str) {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if lock(&SAID).insert(why.to_owned()) {
        tracing::warn!(
            "the host makes and credits lines, which takes longer than on the device: {why}"
        );
    }
}

impl<'a> GpuRounds<'a> {
    /// Creates a block without seen triangles on the device. Returns `None` if the device cannot hold the
    /// block, and logs the reason. The same block on the same adapter always has the same result.
    ///
    /// # Errors
    /// [`TracerError::Failed`] if the device fails.
    pub(super) fn new(
        gpu: &'a Gpu,
        scene: &'a DeviceLineScene,
        kit: &'a RoundsKit,
        block: &DeviceBlock<'_>,
    ) -> Result<Option<Self>, TracerError> {
        // All threads of the pool compile the kernels.
        crate::prepared::outside_the_pool();
        let (capacity, groups) = if gpu.software {
            (SOFTWARE_CAPACITY, SOFTWARE_GROUPS)
        } else {
            (CAPACITY, GROUPS)
        };
        if scene.empty {
            return Ok(None);
        }
        if let Some(why) = obstacle(gpu, block, capacity) {
            say_once(&why);
            return Ok(None);
        }
        let is_split = block.one_way || block.far < f32::INFINITY;
        let place = &kit.kernels[usize::from(is_split) + 2 * usize::from(block.one_way)];
        let make = || Kernels::new(&gpu.device, scene, is_split, block.one_way);
        let full = |message: String| {
            gpu.failed(format!(
                "{message}; smaller --block-cells need less memory, --backend cpu none of the \
                 device's"
            ))
        };
        let kernels = match once(place, make) {
            Ok(kernels) => kernels,
            // A driver that cannot compile the kernels never can, and the profile names the driver.
            Err(DeviceFault::Refused(why)) if gpu.check().is_ok() => {
                say_once(&format!("the driver does not compile the kernels: {why}"));
                return Ok(None);
            }
            Err(DeviceFault::Refused(why)) => return Err(gpu.failed(why)),
            Err(DeviceFault::Memory(why)) => return Err(full(why)),
        };
        let made = || -> Result<Self, DeviceFault> {
            let facts = once(&kit.facts, || {
                scoped_by_kind(&gpu.device, || {
                    Facts::new(&gpu.device, block).map_err(DeviceFault::Refused)
                })
            })?;
            let spare = lock(&kit.spare).pop();
            scoped_by_kind(&gpu.device, || {
                let tables = Tables::new(&gpu.device, &kernels, &facts, block, capacity);
                let tables = tables.map_err(DeviceFault::Refused)?;
                let lists = spare.unwrap_or_else(|| Lists::new(&gpu.device, capacity));
                let cells = block
                    .cells
                    .len()
                    .max(block.pairs.as_ref().map_or(0, |pairs| pairs.cells.len()));
                let block_lists = BlockLists::new(&gpu.device, &kernels, lists, &tables, cells);
                let profile = gpu
                    .measures
                    .then(|| Profile::new(&gpu.device, &gpu.queue))
                    .flatten();
                let (block_lists, state) = (Some(block_lists), Mutex::default());
                let (pairs, kernels) = (block.pairs.as_ref(), kernels.clone());
                let joined = pairs.map_or([0; 2], |pairs| pairs.joins);
                let division_slots = pairs.map_or_else(Vec::new, |pairs| pairs.slots.to_vec());
                let division = pairs.map_or(0, |pairs| pairs.cells.len() as u32);
                Ok(Self {
                    gpu,
                    scene,
                    kit,
                    kernels,
                    tables,
                    block_lists,
                    capacity,
                    groups,
                    joined,
                    division_slots,
                    division,
                    profile,
                    state,
                })
            })
        };
        made().map(Some).map_err(|fault| match fault {
            DeviceFault::Memory(why) => full(why),
            DeviceFault::Refused(why) => gpu.failed(why),
        })
    }

    fn block_lists(&self) -> Result<&BlockLists, TracerError> {
        self.block_lists
            .as_ref()
            .ok_or_else(|| self.gpu.failed("the block is gone"))
    }

    /// Writes the parameters of a part and returns the offset at which kernels find them.
    fn part(&self, block_lists: &BlockLists, part: &Part) -> u32 {
        let mut state = lock(&self.state);
        let offset = u64::from(state.parts % PARTS) * PART_STRIDE;
        state.parts += 1;
        state.traffic.up += size_of::<Part>() as u64;
        drop(state);
        self.gpu
            .queue
            .write_buffer(&block_lists.parts, offset, bytemuck::bytes_of(part));
        offset as u32
    }

    /// Starts a phase of items.
    fn begin(
        &self,
        items: &[[u32; 4]],
    ) -> Result<(&BlockLists, wgpu::CommandEncoder), TracerError> {
        self.gpu.check()?;
        let block_lists = self.block_lists()?;
        self.gpu
            .queue
            .write_buffer(&block_lists.items, 0, bytemuck::cast_slice(items));
        lock(&self.state).traffic.up += size_of_val(items) as u64;
        let mut encoder = self.encoder();
        encoder.clear_buffer(&self.tables.met, 0, None);
        encoder.clear_buffer(&block_lists.stats, 0, None);
        encoder.clear_buffer(&block_lists.counters, 0, None);
        Ok((block_lists, encoder))
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Records kernels that follow each other.
    fn run(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        block_lists: &BlockLists,
        offset: u32,
        kernels: &[Kernel],
    ) {
        // One pass for all kernels, or one pass per kernel if kernels are measured.
        let each = if self.profile.is_some() {
            1
        } else {
            kernels.len()
        };
        for some in kernels.chunks(each.max(1)) {
            let timestamp_writes = self
                .profile
                .as_ref()
                .and_then(|profile| profile.writes(some[0]));
            let descriptor = wgpu::ComputePassDescriptor {
                label: None,
                timestamp_writes,
            };
            let mut pass = encoder.begin_compute_pass(&descriptor);
            pass.set_bind_group(0, &self.scene.group, &[]);
            pass.set_bind_group(1, &self.tables.group, &[]);
            pass.set_bind_group(2, &block_lists.group, &[offset]);
            for kernel in some {
                pass.set_pipeline(self.kernels.pipeline(*kernel));
                pass.dispatch_workgroups(self.groups, 1, 1);
            }
        }
    }

    /// Submits a part. If more than [`IN_FLIGHT`] parts are submitted, waits for the oldest part, so that a
    /// phase can be interrupted.
    fn submit(&self, encoder: wgpu::CommandEncoder) -> Result<wgpu::SubmissionIndex, TracerError> {
        let submission = self.gpu.queue.submit([encoder.finish()]);
        let mut state = lock(&self.state);
        state.flying.push_back(submission.clone());
        let oldest = if state.flying.len() > IN_FLIGHT {
            state.flying.pop_front()
        } else {
            None
        };
        drop(state);
        if let Some(oldest) = oldest {
            let start = Instant::now();
            self.gpu.wait(oldest)?;
            let traffic = &mut lock(&self.state).traffic;
            traffic.waits += 1;
            traffic.seconds += start.elapsed().as_secs_f64();
        }
        Ok(submission)
    }

    /// Submits, waits, and reads parts of buffers one after the other.
    fn read(
        &self,
        mut encoder: wgpu::CommandEncoder,
        block_lists: &BlockLists,
        wanted: &[(&wgpu::Buffer, u64, u64)],
    ) -> Result<Vec<u32>, TracerError> {
        let mut end = 0;
        for (from, offset, bytes) in wanted.iter().filter(|w| w.2 > 0) {
            encoder.copy_buffer_to_buffer(from, *offset, &block_lists.read_back, end, *bytes);
            end += bytes;
        }
        let submission = self.submit(encoder)?;
        let start = Instant::now();
        let (sender, mapped) = mpsc::channel();
        block_lists
            .read_back
            .map_async(wgpu::MapMode::Read, ..end, move |r| drop(sender.send(r)));
        self.gpu.wait(submission)?;
        match mapped.recv_timeout(PATIENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                return Err(self
                    .gpu
                    .failed(format!("the results cannot be mapped: {error}")));
            }
            Err(_) => return Err(self.gpu.failed("the results were not mapped")),
        }
        let numbers = {
            let view = block_lists.read_back.get_mapped_range(..end);
            let view =
                view.map_err(|e| self.gpu.failed(format!("the results cannot be read: {e}")))?;
            bytemuck::pod_collect_to_vec(&view)
        };
        block_lists.read_back.unmap();
        let mut state = lock(&self.state);
        state.traffic.down += end;
        state.traffic.waits += 1;
        state.traffic.seconds += start.elapsed().as_secs_f64();
        state.flying.clear();
        Ok(numbers)
    }
}

/// Returns the value of a cell that is filled once. After a failure, the next call tries again.
fn once<T>(
    place: &Mutex<Option<Arc<T>>>,
    make: impl FnOnce() -> Result<T, DeviceFault>,
) -> Result<Arc<T>, DeviceFault> {
    let mut place = lock(place);
    if let Some(made) = &*place {
        return Ok(Arc::clone(made));
    }
    let made = Arc::new(make()?);
    *place = Some(Arc::clone(&made));
    Ok(made)
}

impl Drop for GpuRounds<'_> {
    fn drop(&mut self) {
        if let Some(block_lists) = self.block_lists.take() {
            lock(&self.kit.spare).push(block_lists.lists);
        }
    }
}

#[cfg(test)]
mod tests;
