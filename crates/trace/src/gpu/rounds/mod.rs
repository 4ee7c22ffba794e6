//! Rounds of sight lines that stay on the device: the kernels make lines, trace them, credit the cells of the
//! block and count; the host hears what is new in the table and a few numbers a cell.
//!
//! A phase is worked on in parts of so many lines ([`GpuRounds`]). For uniform lines a part is: make the
//! lines; cast them; let each ray that shows its cell a new triangle claim it; gather the claims that stand.
//! Then, four times: claim what lies beside the finds; make lines to it; cast; claim; gather. Claims make the
//! result independent of time: of all lines with a claim, the one with the least number has it. For
//! candidates a part is: list those of some triangles; then, as often as the plan says: make lines to those
//! that no line has met yet; cast; gather.
//!
//! Lines are cast by two kernels, one with a thread for each ray and one that walks through the cells; where
//! pairs of cells are looked for, a third joins the cells that some of the lines cross.
//!
//! When a phase is over, the words of the table with new bits go to the host, and the new table becomes that
//! of the last barrier.

mod ending;
mod kernels;
mod memory;
mod phases;
mod profile;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, mpsc};
use std::time::Instant;

use kernels::{Kernel, Kernels, STORAGE_BUFFERS};
use memory::{Facts, Lent, Lists, PART_STRIDE, PARTS, Part, Tables};
use profile::Profile;

use super::device::{Gpu, PATIENCE};
use super::line_scene::DeviceLineScene;
use super::locks::lock;
use super::pipelines::{Fault, scoped_by_kind};
use crate::error::BackendError;
use crate::lines::device::{DeviceBlock, Traffic};

/// Finds that a list holds: on a GPU as many as keep it busy, on a software rasteriser few, since each part
/// clears its claims.
const CAPACITY: u32 = 1 << 20;
const SOFTWARE_CAPACITY: u32 = 1 << 16;
/// Workgroups of a kernel; each thread takes every so many-th thing.
const GROUPS: u32 = 4096;
const SOFTWARE_GROUPS: u32 = 64;
/// Parts that the device may lag behind.
const IN_FLIGHT: usize = 3;
/// What the blocks of a scene share: kernels, facts and spare lists.
#[derive(Default)]
pub(super) struct RoundsKit {
    /// By whether the halves of a line are credited by themselves, and whether a half is free in its own
    /// direction alone.
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
    lent: Option<Lent>,
    capacity: u32,
    groups: u32,
    /// One line in so many joins cells: of uniform lines, of others.
    joined: [u32; 2],
    /// For each cell of the block its slot in the division's grid; empty without pairs.
    division_slots: Vec<u32>,
    /// Cells of the division.
    division: u32,
    profile: Option<Profile>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    traffic: Traffic,
    /// Parts written so far.
    parts: u32,
    flying: std::collections::VecDeque<wgpu::SubmissionIndex>,
}

/// Why a block cannot be on a device, as a part of a sentence; `None` when it can.
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

/// Says why the host makes and credits lines, each reason once a process.
fn say_once(why: &str) {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if lock(&SAID).insert(why.to_owned()) {
        tracing::warn!(
            "the host makes and credits lines, which takes longer than on the device: {why}"
        );
    }
}

impl<'a> GpuRounds<'a> {
    /// Puts a block with nothing seen on the device; `None` when the device cannot hold it, which is said in
    /// the log. The same block on the same adapter always gets the same answer.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    pub(super) fn new(
        gpu: &'a Gpu,
        scene: &'a DeviceLineScene,
        kit: &'a RoundsKit,
        block: &DeviceBlock<'_>,
    ) -> Result<Option<Self>, BackendError> {
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
        let make = || Kernels::new(&gpu.device, scene, (is_split, block.one_way));
        let full = |message: String| {
            gpu.failed(format!(
                "{message}; smaller --block-cells need less memory, --backend cpu none of the device's"
            ))
        };
        let kernels = match once(place, make) {
            Ok(kernels) => kernels,
            // A driver that does not compile them never does, and the profile names it.
            Err(Fault::Refused(why)) if gpu.check().is_ok() => {
                say_once(&format!("the driver does not compile the kernels: {why}"));
                return Ok(None);
            }
            Err(Fault::Refused(why)) => return Err(gpu.failed(why)),
            Err(Fault::Memory(why)) => return Err(full(why)),
        };
        let made = || -> Result<Self, Fault> {
            let facts = once(&kit.facts, || {
                scoped_by_kind(&gpu.device, || {
                    Facts::new(&gpu.device, block).map_err(Fault::Refused)
                })
            })?;
            let spare = lock(&kit.spare).pop();
            scoped_by_kind(&gpu.device, || {
                let tables = Tables::new(&gpu.device, &kernels, &facts, block, capacity);
                let tables = tables.map_err(Fault::Refused)?;
                let lists = spare.unwrap_or_else(|| Lists::new(&gpu.device, capacity));
                let cells = block
                    .cells
                    .len()
                    .max(block.pairs.as_ref().map_or(0, |pairs| pairs.cells.len()));
                let lent = Lent::new(&gpu.device, &kernels, lists, &tables, cells);
                let profile = gpu
                    .measures
                    .then(|| Profile::new(&gpu.device, &gpu.queue))
                    .flatten();
                let (lent, state) = (Some(lent), Mutex::default());
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
                    lent,
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
            Fault::Memory(why) => full(why),
            Fault::Refused(why) => gpu.failed(why),
        })
    }

    fn lent(&self) -> Result<&Lent, BackendError> {
        self.lent
            .as_ref()
            .ok_or_else(|| self.gpu.failed("the block is gone"))
    }

    /// Writes a part's numbers; the offset at which kernels find them.
    fn part(&self, lent: &Lent, part: &Part) -> u32 {
        let mut state = lock(&self.state);
        let offset = u64::from(state.parts % PARTS) * PART_STRIDE;
        state.parts += 1;
        state.traffic.up += size_of::<Part>() as u64;
        drop(state);
        self.gpu
            .queue
            .write_buffer(&lent.parts, offset, bytemuck::bytes_of(part));
        offset as u32
    }

    /// Begins a phase of items.
    fn begin(&self, items: &[[u32; 4]]) -> Result<(&Lent, wgpu::CommandEncoder), BackendError> {
        self.gpu.check()?;
        let lent = self.lent()?;
        self.gpu
            .queue
            .write_buffer(&lent.items, 0, bytemuck::cast_slice(items));
        lock(&self.state).traffic.up += size_of_val(items) as u64;
        let mut encoder = self.encoder();
        encoder.clear_buffer(&self.tables.met, 0, None);
        encoder.clear_buffer(&lent.stats, 0, None);
        encoder.clear_buffer(&lent.counters, 0, None);
        Ok((lent, encoder))
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
        lent: &Lent,
        offset: u32,
        kernels: &[Kernel],
    ) {
        // One pass for all, or one for each that is measured.
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
            pass.set_bind_group(2, &lent.group, &[offset]);
            for kernel in some {
                pass.set_pipeline(self.kernels.pipeline(*kernel));
                pass.dispatch_workgroups(self.groups, 1, 1);
            }
        }
    }

    /// Submits a part. The host does not run far ahead, so that a phase can be broken off.
    fn submit(&self, encoder: wgpu::CommandEncoder) -> Result<wgpu::SubmissionIndex, BackendError> {
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
        lent: &Lent,
        wanted: &[(&wgpu::Buffer, u64, u64)],
    ) -> Result<Vec<u32>, BackendError> {
        let mut end = 0;
        for (from, offset, bytes) in wanted.iter().filter(|w| w.2 > 0) {
            encoder.copy_buffer_to_buffer(from, *offset, &lent.read_back, end, *bytes);
            end += bytes;
        }
        let submission = self.submit(encoder)?;
        let start = Instant::now();
        let (sender, mapped) = mpsc::channel();
        lent.read_back
            .map_async(wgpu::MapMode::Read, ..end, move |r| drop(sender.send(r)));
        self.gpu.wait(submission)?;
        match mapped.recv_timeout(PATIENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => {
                return Err(self.gpu.failed(format!("mapping what was found: {error}")));
            }
            Err(_) => return Err(self.gpu.failed("what was found was not mapped")),
        }
        let numbers = {
            let view = lent.read_back.get_mapped_range(..end);
            let view = view.map_err(|e| self.gpu.failed(format!("reading what was found: {e}")))?;
            bytemuck::pod_collect_to_vec(&view)
        };
        lent.read_back.unmap();
        let mut state = lock(&self.state);
        state.traffic.down += end;
        state.traffic.waits += 1;
        state.traffic.seconds += start.elapsed().as_secs_f64();
        state.flying.clear();
        Ok(numbers)
    }
}

/// The value of a cell that is filled once; a failure is tried again.
fn once<T>(
    place: &Mutex<Option<Arc<T>>>,
    make: impl FnOnce() -> Result<T, Fault>,
) -> Result<Arc<T>, Fault> {
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
        if let Some(lent) = self.lent.take() {
            lock(&self.kit.spare).push(lent.lists);
        }
    }
}

#[cfg(test)]
mod tests;
