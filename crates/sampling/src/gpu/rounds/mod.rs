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
//! When a phase is over, the words of the table with new bits go to the host, and the new table becomes that
//! of the last barrier.

mod kernels;
mod memory;
mod profile;

use std::sync::{Arc, Mutex, mpsc};
use std::time::Instant;

use super::device::{Gpu, PATIENCE, lock};
use super::line_scene::LineScene;
use super::pipelines::scoped;
use crate::error::BackendError;
use crate::lines::bits::SeenBits;
use crate::lines::device::{
    AimPlan, AimWork, DeviceBlock, Found, GoesOn, KernelTime, Rounds, SegmentWork, Traffic, UniformWork,
};
use crate::lines::yields::Tally;
use crate::packet::LANES;
use kernels::{Kernel, Kernels, STORAGE_BUFFERS};
use memory::{COUNTER_BYTES, Facts, Lent, Lists, PART_STRIDE, PARTS, Part, STRIPE, Tables, filled_words};
use profile::Profile;

/// Steps of a flood from triangle to triangle, as on the host.
const FLOOD_STEPS: usize = 4;
/// Finds that a list holds: on a GPU as many as keep it busy, on a software rasteriser few, since each part
/// clears its claims.
const CAPACITY: u32 = 1 << 20;
const SOFTWARE_CAPACITY: u32 = 1 << 16;
/// Workgroups of a kernel; each thread takes every so many-th thing.
const GROUPS: u32 = 4096;
const SOFTWARE_GROUPS: u32 = 64;
/// Places of claims for each ray of a part.
const CLAIMS: u32 = 8;
/// Numbers of tiles and lines in a phase stay below this; a phase of more is cast in several.
const MOST_NUMBERED: u64 = 1 << 31;
/// Parts that the device may lag behind.
const IN_FLIGHT: usize = 3;
/// Places in the counters, as in `block.wgsl`.
const LINES: u64 = 1;
const WORDS: usize = 2;
const SEED_RAYS: usize = 4;
const PAIR_WORDS: usize = 5;
const TALLY: usize = 8;
/// Ways of casting, as in `block.wgsl`.
const AHEAD: u32 = 1;
const SEGMENT: u32 = 2;
/// Least segments in a round from all cells together, as in `join.wgsl`.
const LEAST_SEGMENTS: u32 = 1 << 16;
/// Units of gains and of attempts, as in `candidates.wgsl`.
const GAIN_UNIT: f64 = 1.0 / (1u64 << 20) as f64;

/// What the blocks of a scene share: kernels, facts and spare lists.
#[derive(Default)]
pub(super) struct RoundsKit {
    /// By whether the halves of a line are credited by themselves.
    kernels: [Mutex<Option<Arc<Kernels>>>; 2],
    facts: Mutex<Option<Arc<Facts>>>,
    spare: Mutex<Vec<Lists>>,
}

/// A block on the device.
pub(super) struct GpuRounds<'a> {
    gpu: &'a Gpu,
    scene: &'a LineScene,
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
    let most = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
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
    (largest > most).then(|| format!("{largest} bytes in one buffer are more than the {most} that it binds"))
}

/// Says why the host makes and credits lines, once a process.
fn say_once(why: &str) {
    static SAID: std::sync::Once = std::sync::Once::new();
    SAID.call_once(|| {
        tracing::warn!(
            "the device traces lines, but the host makes and credits them, which takes longer: {why}"
        );
    });
}

impl<'a> GpuRounds<'a> {
    /// Puts a block with nothing seen on the device; `None` when the device cannot hold it, which is said in
    /// the log. The same block on the same adapter always gets the same answer.
    ///
    /// # Errors
    /// [`BackendError::Failed`] when the device does.
    pub(super) fn new(
        gpu: &'a Gpu,
        scene: &'a LineScene,
        kit: &'a RoundsKit,
        block: &DeviceBlock<'_>,
    ) -> Result<Option<Self>, BackendError> {
        let (capacity, groups) =
            if gpu.software { (SOFTWARE_CAPACITY, SOFTWARE_GROUPS) } else { (CAPACITY, GROUPS) };
        if scene.empty {
            return Ok(None);
        }
        if let Some(why) = obstacle(gpu, block, capacity) {
            say_once(&why);
            return Ok(None);
        }
        let is_split = block.one_way || block.far < f32::INFINITY;
        let place = &kit.kernels[usize::from(is_split)];
        let make = || Kernels::new(&gpu.device, scene, (is_split, block.one_way));
        let kernels = match once(place, make) {
            Ok(kernels) => kernels,
            // A driver that is there does so always, and the profile names it.
            Err(why) if gpu.check().is_ok() => {
                say_once(&format!("its driver does not compile the kernels: {why}"));
                return Ok(None);
            }
            Err(why) => return Err(gpu.failed(why)),
        };
        let made = || -> Result<Self, String> {
            let facts = once(&kit.facts, || scoped(&gpu.device, || Facts::new(&gpu.device, block)))?;
            let spare = lock(&kit.spare).pop();
            scoped(&gpu.device, || {
                let tables = Tables::new(&gpu.device, &kernels, &facts, block, capacity)?;
                let lists = spare.unwrap_or_else(|| Lists::new(&gpu.device, capacity));
                let cells = block.cells.len().max(block.pairs.as_ref().map_or(0, |pairs| pairs.cells.len()));
                let lent = Lent::new(&gpu.device, &kernels, lists, &tables, cells);
                let profile = gpu.measures.then(|| Profile::new(&gpu.device, &gpu.queue)).flatten();
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
        made().map(Some).map_err(|reason| gpu.failed(reason))
    }

    fn lent(&self) -> Result<&Lent, BackendError> {
        self.lent.as_ref().ok_or_else(|| self.gpu.failed("the block is gone"))
    }

    /// Writes a part's numbers; the offset at which kernels find them.
    fn part(&self, lent: &Lent, part: &Part) -> u32 {
        let mut state = lock(&self.state);
        let offset = u64::from(state.parts % PARTS) * PART_STRIDE;
        state.parts += 1;
        state.traffic.up += size_of::<Part>() as u64;
        drop(state);
        self.gpu.queue.write_buffer(&lent.parts, offset, bytemuck::bytes_of(part));
        offset as u32
    }

    /// Begins a phase of items.
    fn begin(&self, items: &[[u32; 4]]) -> Result<(&Lent, wgpu::CommandEncoder), BackendError> {
        self.gpu.check()?;
        let lent = self.lent()?;
        self.gpu.queue.write_buffer(&lent.items, 0, bytemuck::cast_slice(items));
        lock(&self.state).traffic.up += size_of_val(items) as u64;
        let mut encoder = self.encoder();
        encoder.clear_buffer(&self.tables.met, 0, None);
        encoder.clear_buffer(&lent.stats, 0, None);
        encoder.clear_buffer(&lent.counters, 0, None);
        Ok((lent, encoder))
    }

    fn encoder(&self) -> wgpu::CommandEncoder {
        self.gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Records kernels that follow each other.
    fn run(&self, encoder: &mut wgpu::CommandEncoder, lent: &Lent, offset: u32, kernels: &[Kernel]) {
        // One pass for all, or one for each that is measured.
        let each = if self.profile.is_some() { 1 } else { kernels.len() };
        for some in kernels.chunks(each.max(1)) {
            let timestamp_writes = self.profile.as_ref().and_then(|profile| profile.writes(some[0]));
            let descriptor = wgpu::ComputePassDescriptor { label: None, timestamp_writes };
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
        let oldest = if state.flying.len() > IN_FLIGHT { state.flying.pop_front() } else { None };
        drop(state);
        if let Some(oldest) = oldest {
            let start = Instant::now();
            self.gpu.wait(oldest)?;
            lock(&self.state).traffic.seconds += start.elapsed().as_secs_f64();
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
        let start = Instant::now();
        let submission = self.submit(encoder)?;
        let (sender, mapped) = mpsc::channel();
        lent.read_back.map_async(wgpu::MapMode::Read, ..end, move |r| drop(sender.send(r)));
        self.gpu.wait(submission)?;
        match mapped.recv_timeout(PATIENCE) {
            Ok(Ok(())) => {}
            Ok(Err(error)) => return Err(self.gpu.failed(format!("mapping what was found: {error}"))),
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

    /// The new words of a table, of which there are `new`.
    fn new_words(&self, lent: &Lent, table: &Table<'_>, new: u32) -> Result<Vec<(u32, u64)>, BackendError> {
        let mut words = Vec::with_capacity(new as usize);
        let mut keep = |count: u32| -> Result<(), BackendError> {
            let numbers = self.read(self.encoder(), lent, &[(table.list, 0, 12 * u64::from(count))])?;
            let some = numbers.chunks_exact(3);
            words.extend(some.map(|w| (w[0], u64::from(w[1]) | u64::from(w[2]) << 32)));
            Ok(())
        };
        let fit = 3 * self.capacity;
        if new <= fit {
            if new > 0 {
                keep(new)?;
            }
            return Ok(words);
        }
        // More than the list holds: by ranges of places that cannot be more.
        for first in (0..table.places).step_by(fit as usize) {
            let count = fit.min(table.places - first);
            let offset = self.part(lent, &Part { count, first, ..Part::default() });
            let mut encoder = self.encoder();
            encoder.clear_buffer(&lent.counters, 4 * table.counter as u64, Some(4));
            self.run(&mut encoder, lent, offset, &[table.kernel]);
            let counter = (&lent.counters, 4 * table.counter as u64, 4);
            if let Some(new) = self.read(encoder, lent, &[counter])?.first().filter(|new| **new > 0) {
                keep(*new)?;
            }
        }
        Ok(words)
    }

    /// The tables whose new words go to the host: that of triangles, and that of pairs where there is one.
    fn tables<'b>(&self, lent: &'b Lent) -> [Table<'b>; 2] {
        let (kernel, counter, list) = (Kernel::GatherWords, WORDS, &lent.words);
        let seen = Table { kernel, counter, list, places: self.tables.places };
        let (kernel, counter, list) = (Kernel::GatherPairs, PAIR_WORDS, &lent.pair_words);
        [seen, Table { kernel, counter, list, places: self.tables.pair_places }]
    }

    /// Makes the tables with all credits those of the last barrier.
    fn publish(&self) -> Result<(), BackendError> {
        let mut encoder = self.encoder();
        let t = &self.tables;
        encoder.copy_buffer_to_buffer(&t.now, 0, &t.seen, 0, t.seen.size());
        encoder.copy_buffer_to_buffer(&t.joined, 0, &t.pairs, 0, t.pairs.size());
        self.submit(encoder).map(drop)
    }

    /// The kernel that joins cells, where pairs are looked for.
    fn joins(&self) -> &'static [Kernel] {
        if self.tables.pair_places > 0 { &[Kernel::JoinLines] } else { &[] }
    }

    /// Ends a phase: reads counts and new words, and publishes the table.
    fn end(
        &self,
        lent: &Lent,
        mut encoder: wgpu::CommandEncoder,
        items: usize,
    ) -> Result<Found, BackendError> {
        let tables = self.tables(lent);
        for table in tables.iter().filter(|t| t.places > 0) {
            let offset = self.part(lent, &Part { count: table.places, ..Part::default() });
            self.run(&mut encoder, lent, offset, &[table.kernel]);
        }
        let wanted = [(&lent.counters, 0, COUNTER_BYTES), (&lent.stats, 0, 16 * items as u64)];
        let numbers = self.read(encoder, lent, &wanted)?;
        if let Some(profile) = &self.profile {
            let mut encoder = self.encoder();
            let bytes = profile.resolve(&mut encoder);
            profile.add(&self.read(encoder, lent, &[(&profile.stamps, 0, bytes)])?);
        }
        let (counters, counts) = numbers.split_at(COUNTER_BYTES as usize / 4);
        let counts = counts.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]).collect();
        let [words, pair_words] = tables.map(|table| self.new_words(lent, &table, counters[table.counter]));
        let (words, pair_words) = (words?, pair_words?);
        self.publish()?;
        let rays = u64::from(counters[SEED_RAYS]);
        let tally = Tally::of_device(
            std::array::from_fn(|d| {
                let at = |k: usize| u64::from(counters[TALLY + 5 * d + k]);
                [at(0), at(1) | at(2) << 32, at(3) | at(4) << 32]
            }),
            GAIN_UNIT,
        );
        Ok(Found { counts, rays, tally, words, pair_words })
    }

    /// Casts the uniform lines of some items and floods from what they find.
    fn uniform_part(&self, lent: &Lent, part: &Part) -> Result<(), BackendError> {
        let offset = self.part(lent, part);
        let mut encoder = self.encoder();
        let claims = 4 * (u64::from(part.mask) + 1);
        encoder.clear_buffer(&lent.counters, 0, Some(8));
        encoder.clear_buffer(&lent.claims, 0, Some(claims));
        use Kernel::*;
        self.run(&mut encoder, lent, offset, &[MakeUniform, TraceRays, CreditLines]);
        self.run(&mut encoder, lent, offset, self.joins());
        self.run(&mut encoder, lent, offset, &[ClaimUniform, GatherUniform]);
        let aimed = self.part(lent, &Part { joins: self.joined[1], ..*part });
        for _ in 0..FLOOD_STEPS {
            encoder.clear_buffer(&lent.counters, 4 * LINES, Some(4));
            encoder.clear_buffer(&lent.claims, 0, Some(claims));
            self.run(&mut encoder, lent, offset, &[ClaimNext, MakeFlood, TraceRays, CreditLines]);
            self.run(&mut encoder, lent, aimed, self.joins());
            encoder.clear_buffer(&lent.counters, 0, Some(4));
            encoder.clear_buffer(&lent.claims, 0, Some(claims));
            self.run(&mut encoder, lent, offset, &[ClaimFlood, GatherFlood]);
        }
        self.submit(encoder).map(drop)
    }

    /// For runs of consecutive triangles in Morton order, few enough candidates for the list.
    fn runs_of_candidates(&self, counts: &[u32], open: usize) -> Vec<(u32, u32)> {
        let most = u64::from(3 * self.capacity);
        let (mut runs, mut first, mut sum) = (Vec::new(), 0u32, 0u64);
        let mut close = |from: u32, to: u32, sum: u64| {
            if sum > most {
                // One stripe alone: each triangle has at most one candidate a cell.
                let step = (most / open.max(1) as u64).max(1) as usize;
                runs.extend((from..to).step_by(step).map(|at| (at, to.min(at + step as u32))));
            } else if sum > 0 {
                runs.push((from, to));
            }
        };
        for (stripe, count) in counts.iter().enumerate() {
            let start = (stripe * STRIPE) as u32;
            if sum + u64::from(*count) > most {
                close(first, start, sum);
                (first, sum) = (start, 0);
            }
            sum += u64::from(*count);
        }
        close(first, self.tables.ordered, sum);
        runs
    }
}

/// A table whose new words go to the host.
struct Table<'a> {
    /// The kernel that lists them.
    kernel: Kernel,
    /// Where it counts them.
    counter: usize,
    list: &'a wgpu::Buffer,
    /// 64-bit words of the table.
    places: u32,
}

/// The value of a cell that is filled once; a failure is tried again.
fn once<T>(
    place: &Mutex<Option<Arc<T>>>,
    make: impl FnOnce() -> Result<T, String>,
) -> Result<Arc<T>, String> {
    let mut place = lock(place);
    if let Some(made) = &*place {
        return Ok(Arc::clone(made));
    }
    let made = Arc::new(make()?);
    *place = Some(Arc::clone(&made));
    Ok(made)
}

impl Rounds for GpuRounds<'_> {
    fn restart(&self, bits: &SeenBits, pairs: Option<&[u64]>) -> Result<(), BackendError> {
        self.gpu.check()?;
        let lent = self.lent()?;
        let mut encoder = self.encoder();
        encoder.clear_buffer(&self.tables.now, 0, None);
        encoder.clear_buffer(&self.tables.joined, 0, None);
        self.submit(encoder)?;
        let tables = [
            (filled_words(bits.table()), &lent.words, Kernel::PutWords),
            (filled_words(pairs.unwrap_or_default()), &lent.pair_words, Kernel::PutPairs),
        ];
        for (words, list, kernel) in tables {
            for run in words.chunks(3 * self.capacity as usize) {
                self.gpu.queue.write_buffer(list, 0, bytemuck::cast_slice(run));
                lock(&self.state).traffic.up += size_of_val(run) as u64;
                let offset = self.part(lent, &Part { count: run.len() as u32, ..Part::default() });
                let mut encoder = self.encoder();
                self.run(&mut encoder, lent, offset, &[kernel]);
                self.submit(encoder)?;
            }
        }
        self.publish()
    }

    fn uniform(&self, work: &[UniformWork], goes_on: GoesOn<'_>) -> Result<Found, BackendError> {
        let mut tiles = 0u64;
        let items: Vec<[u32; 4]> = work
            .iter()
            .map(|w| {
                let before = tiles;
                tiles += 3 * u64::from(w.tiles) * u64::from(w.tiles);
                [w.cell as u32, w.tiles, w.base as u32, before as u32]
            })
            .collect();
        if tiles >= MOST_NUMBERED {
            let (one, two) = work.split_at(work.len() / 2);
            return Ok(joined(self.uniform(one, goes_on)?, self.uniform(two, goes_on)?));
        }
        let (lent, encoder) = self.begin(&items)?;
        self.submit(encoder)?;
        // Each line has two rays, and each of them may be a find.
        let each = self.capacity / 2 / LANES as u32;
        let mut rays = 0;
        for first in (0..tiles as u32).step_by(each as usize) {
            if !goes_on() {
                return self.end(lent, self.encoder(), 0);
            }
            let count = each.min(tiles as u32 - first) * LANES as u32;
            let mask = (CLAIMS * 2 * count).next_power_of_two().min(CLAIMS * self.capacity) - 1;
            let items = items.len() as u32;
            let joins = self.joined[0];
            self.uniform_part(lent, &Part { count, first, items, mask, joins, ..Part::default() })?;
            rays += 2 * u64::from(count);
        }
        let found = self.end(lent, self.encoder(), items.len())?;
        let flood: u64 = found.counts.iter().map(|c| u64::from(c[2])).sum();
        lock(&self.state).traffic.rays += rays + flood;
        Ok(found)
    }

    fn aim(&self, work: &[AimWork], plan: &AimPlan, goes_on: GoesOn<'_>) -> Result<Found, BackendError> {
        let items: Vec<[u32; 4]> = work
            .iter()
            .map(|w| [w.cell as u32, (w.least as f32).to_bits(), (w.rays as f32).to_bits(), 0])
            .collect();
        let of = |part: Part| Part {
            items: items.len() as u32,
            round: plan.round,
            times: plan.times,
            so_far: plan.so_far,
            joins: self.joined[1],
            ..part
        };
        let (lent, mut encoder) = self.begin(&items)?;
        encoder.clear_buffer(&lent.places, 0, None);
        let offset = self.part(lent, &of(Part::default()));
        self.run(&mut encoder, lent, offset, &[Kernel::PlaceItems, Kernel::CountCandidates]);
        let slots = 256 * u64::from(self.tables.words);
        let counts = self.read(encoder, lent, &[(&lent.places, slots, lent.places.size() - slots)])?;
        let most = plan.times.iter().fold(1.0f32, |most, t| most.max(*t)).ceil() as u32;
        for (from, to) in self.runs_of_candidates(&counts, items.len()) {
            if !goes_on() {
                return self.end(lent, self.encoder(), 0);
            }
            let mut encoder = self.encoder();
            // Finds, lines, words and candidates, but not the tally.
            encoder.clear_buffer(&lent.counters, 0, Some(16));
            let part = of(Part { first: from, count: to - from, ..Part::default() });
            let offset = self.part(lent, &part);
            self.run(&mut encoder, lent, offset, &[Kernel::ListCandidates]);
            for time in 0..most {
                encoder.clear_buffer(&lent.counters, 4 * LINES, Some(4));
                let offset = self.part(lent, &Part { time, ..part });
                use Kernel::*;
                self.run(&mut encoder, lent, offset, &[MakeAimed, TraceRays, CreditLines, GatherAimed]);
                self.run(&mut encoder, lent, offset, self.joins());
            }
            self.submit(encoder)?;
        }
        let found = self.end(lent, self.encoder(), items.len())?;
        lock(&self.state).traffic.rays += found.counts.iter().map(|c| u64::from(c[0])).sum::<u64>();
        Ok(found)
    }

    fn seeds(&self, goes_on: GoesOn<'_>) -> Result<Found, BackendError> {
        let (lent, encoder) = self.begin(&[[0; 4]])?;
        self.submit(encoder)?;
        let groups = self.tables.ordered.div_ceil(2 * LANES as u32);
        let each = self.capacity / LANES as u32;
        for first in (0..groups).step_by(each as usize) {
            if !goes_on() {
                break;
            }
            let count = each.min(groups - first) * LANES as u32;
            let joins = self.joined[1];
            let offset = self.part(lent, &Part { first, count, items: 1, joins, ..Part::default() });
            let mut encoder = self.encoder();
            encoder.clear_buffer(&lent.counters, 4 * LINES, Some(4));
            self.run(
                &mut encoder,
                lent,
                offset,
                &[Kernel::MakeSeeds, Kernel::TraceRays, Kernel::CreditLines],
            );
            self.run(&mut encoder, lent, offset, self.joins());
            self.submit(encoder)?;
        }
        let found = self.end(lent, self.encoder(), 0)?;
        lock(&self.state).traffic.rays += found.rays;
        Ok(found)
    }

    fn check(&self, work: &[(usize, u64)], look: u32, goes_on: GoesOn<'_>) -> Result<Found, BackendError> {
        let lines: u64 = work.iter().map(|w| w.1).sum();
        if lines >= MOST_NUMBERED && work.len() > 1 {
            let (one, two) = work.split_at(work.len() / 2);
            return Ok(joined(self.check(one, look, goes_on)?, self.check(two, look, goes_on)?));
        }
        let mut before = 0;
        let items: Vec<[u32; 4]> = work
            .iter()
            .map(|(cell, lines)| {
                let own =
                    [*cell as u32, self.division_slots.get(*cell).copied().unwrap_or(0), 0, before as u32];
                before += lines;
                own
            })
            .collect();
        let (lent, encoder) = self.begin(&items)?;
        self.submit(encoder)?;
        let items = items.len();
        for first in (0..lines).step_by(self.capacity as usize) {
            if !goes_on() {
                return self.end(lent, self.encoder(), 0);
            }
            let count = u64::from(self.capacity).min(lines - first) as u32;
            let part = Part {
                count,
                first: first as u32,
                items: items as u32,
                round: look,
                way: AHEAD,
                ..Part::default()
            };
            let offset = self.part(lent, &part);
            let mut encoder = self.encoder();
            use Kernel::*;
            self.run(&mut encoder, lent, offset, &[MakeCheck, TraceRays, CreditLines, GatherCheck]);
            if self.tables.pair_places > 0 {
                self.run(&mut encoder, lent, offset, &[CheckPairs]);
            }
            self.submit(encoder)?;
        }
        let found = self.end(lent, self.encoder(), items)?;
        lock(&self.state).traffic.rays += lines;
        Ok(found)
    }

    fn segments(&self, work: &SegmentWork<'_>, goes_on: GoesOn<'_>) -> Result<Found, BackendError> {
        let any = u32::from(work.at_any);
        let items: Vec<[u32; 4]> = work.cells.iter().map(|c| [*c, work.most, any, 0]).collect();
        let (lent, mut encoder) = self.begin(&items)?;
        let of = |first: usize, count: usize| Part {
            first: first as u32,
            count: count as u32,
            items: items.len() as u32,
            round: work.round,
            way: SEGMENT,
            ..Part::default()
        };
        let offset = self.part(lent, &of(0, items.len()));
        self.run(&mut encoder, lent, offset, &[Kernel::CountAims]);
        self.submit(encoder)?;
        // So many lines are expected of an item at most; a part leaves room for the chance of more.
        let each = work.most + LEAST_SEGMENTS.div_ceil(self.division.max(1));
        let step = (2 * self.capacity / each).max(1) as usize;
        for first in (0..items.len()).step_by(step) {
            if !goes_on() {
                return self.end(lent, self.encoder(), 0);
            }
            let offset = self.part(lent, &of(first, step.min(items.len() - first)));
            let mut encoder = self.encoder();
            encoder.clear_buffer(&lent.counters, 4 * LINES, Some(4));
            use Kernel::*;
            self.run(&mut encoder, lent, offset, &[MakeSegments, TraceRays, GatherSegments]);
            self.submit(encoder)?;
        }
        let found = self.end(lent, self.encoder(), items.len())?;
        lock(&self.state).traffic.rays += found.counts.iter().map(|c| u64::from(c[0])).sum::<u64>();
        Ok(found)
    }

    fn traffic(&self) -> Traffic {
        lock(&self.state).traffic
    }

    fn kernel_times(&self) -> Vec<KernelTime> {
        self.profile.as_ref().map_or_else(Vec::new, Profile::times)
    }
}

/// The finds of two phases that are one for the caller.
fn joined(mut one: Found, two: Found) -> Found {
    one.counts.extend(two.counts);
    one.words.extend(two.words);
    one.pair_words.extend(two.pair_words);
    one.rays += two.rays;
    one.tally = one.tally.and(&two.tally);
    one
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
