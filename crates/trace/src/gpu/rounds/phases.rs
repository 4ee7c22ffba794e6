//! The phases that the device computes: the kernels and their order.

use super::GpuRounds;
use super::kernels::Kernel;
use super::memory::{BlockLists, Part, STRIPE, filled_words};
use super::phase_end::joined;
use super::profile::Profile;
use crate::error::TracerError;
use crate::gpu::locks::lock;
use crate::lines::bits::SeenBits;
use crate::lines::device::{
    AimPlan, AimWork, ContinueCheck, DevicePhaseResult, FLOOD_STEPS, KernelTime, Rounds,
    SegmentWork, Traffic, UniformWork,
};
use crate::packet::LANES;

/// The number of slots in the hash table of claims, per ray of a part.
const CLAIMS: u32 = 8;
/// The limit of the numbers of tiles and lines in a phase. A phase with more is cast as several phases.
const MOST_NUMBERED: u64 = 1 << 31;
/// The indices in the counters, as in `block.wgsl`: lines, and new ends of lines at candidates.
const LINES: u64 = 1;
const NEW_ENDS: u64 = 6;
/// The ways of casting, as in `block.wgsl`.
const AHEAD: u32 = 1;
const SEGMENT: u32 = 2;
/// Minimum number of segments per round from all cells together, as in `join.wgsl`.
const LEAST_SEGMENTS: u32 = 1 << 16;

/// A flood from the listed hits.
struct Flood {
    /// The offset of the part, for all kernels except the kernel that joins.
    offset: u32,
    /// The offset for the kernel that joins.
    joined: u32,
    /// The size of the claims in bytes.
    claims: u64,
    /// The kernel that creates the lines of each step.
    make: Kernel,
    /// The maximum number of steps.
    steps: u32,
}

impl GpuRounds<'_> {
    /// Returns the kernel that joins cells, or an empty list if no pairs are searched.
    fn joins(&self) -> &'static [Kernel] {
        if self.tables.pair_places > 0 {
            &[Kernel::JoinLines]
        } else {
            &[]
        }
    }

    /// Casts the uniform lines of some items and floods from the newly found triangles.
    fn uniform_part(&self, block_lists: &BlockLists, part: &Part) -> Result<(), TracerError> {
        let offset = self.part(block_lists, part);
        let mut encoder = self.encoder();
        let claims = part.bytes_of_claims();
        encoder.clear_buffer(&block_lists.counters, 0, Some(8));
        encoder.clear_buffer(&block_lists.claims, 0, Some(claims));
        use Kernel::*;
        self.run(
            &mut encoder,
            block_lists,
            offset,
            &[MakeUniform, TraceRays, CreditLines],
        );
        self.run(&mut encoder, block_lists, offset, self.joins());
        self.run(
            &mut encoder,
            block_lists,
            offset,
            &[ClaimUniform, GatherUniform],
        );
        let aimed = self.part(
            block_lists,
            &Part {
                joins: self.joined[1],
                ..*part
            },
        );
        self.flood(
            &mut encoder,
            block_lists,
            Flood {
                offset,
                joined: aimed,
                claims,
                make: MakeFlood,
                steps: FLOOD_STEPS,
            },
        );
        self.submit(encoder).map(drop)
    }

    /// Floods from the listed hits.
    fn flood(&self, encoder: &mut wgpu::CommandEncoder, block_lists: &BlockLists, flood: Flood) {
        use Kernel::*;
        let Flood {
            offset,
            joined,
            claims,
            make,
            steps,
        } = flood;
        for _ in 0..steps {
            encoder.clear_buffer(&block_lists.counters, 4 * LINES, Some(4));
            encoder.clear_buffer(&block_lists.claims, 0, Some(claims));
            self.run(
                encoder,
                block_lists,
                offset,
                &[ClaimNext, make, TraceRays, CreditLines],
            );
            self.run(encoder, block_lists, joined, self.joins());
            encoder.clear_buffer(&block_lists.counters, 0, Some(4));
            encoder.clear_buffer(&block_lists.claims, 0, Some(claims));
            self.run(encoder, block_lists, offset, &[ClaimFlood, GatherFlood]);
        }
    }

    /// Casts one line at each open candidate and floods from the newly found triangles.
    fn one_try(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        block_lists: &BlockLists,
        offset: u32,
        claims: u64,
        steps: u32,
    ) {
        use Kernel::*;
        encoder.clear_buffer(&block_lists.counters, 0, Some(8));
        encoder.clear_buffer(&block_lists.counters, 4 * NEW_ENDS, Some(4));
        encoder.clear_buffer(&block_lists.claims, 0, Some(claims));
        self.run(
            encoder,
            block_lists,
            offset,
            &[MakeAimed, TraceRays, CreditLines],
        );
        self.run(encoder, block_lists, offset, self.joins());
        self.run(encoder, block_lists, offset, &[ClaimAimed, GatherAimed]);
        self.flood(
            encoder,
            block_lists,
            Flood {
                offset,
                joined: offset,
                claims,
                make: MakeAimedFlood,
                steps,
            },
        );
    }

    /// Returns the number of slots in the hash table of claims for `rays` rays, minus one.
    fn claims_for(&self, rays: u64) -> u32 {
        let places = (u64::from(CLAIMS) * rays).next_power_of_two();
        places.min(u64::from(CLAIMS * self.capacity)) as u32 - 1
    }

    /// Returns runs of consecutive triangles in Morton order, with few enough candidates for the list. A run
    /// has its start, its end, and its maximum number of candidates.
    fn runs_of_candidates(&self, counts: &[u32], open: usize) -> Vec<(u32, u32, u64)> {
        // The kernel that counts and the kernel that lists may round a candidate's part differently.
        let slack = u64::from(self.capacity / 16);
        let most = u64::from(3 * self.capacity) - slack;
        let (mut runs, mut first, mut sum) = (Vec::new(), 0u32, 0u64);
        let mut close = |from: u32, to: u32, sum: u64| {
            if sum > most {
                // Only one stripe: each triangle has at most one candidate per cell.
                let step = (most / open.max(1) as u64).max(1) as usize;
                runs.extend(
                    (from..to)
                        .step_by(step)
                        .map(|at| (at, to.min(at + step as u32), most)),
                );
            } else if sum > 0 {
                runs.push((from, to, sum + slack));
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

impl Rounds for GpuRounds<'_> {
    fn restart(&self, bits: &SeenBits, pairs: Option<&[u64]>) -> Result<(), TracerError> {
        self.gpu.check()?;
        let block_lists = self.block_lists()?;
        let mut encoder = self.encoder();
        encoder.clear_buffer(&self.tables.now, 0, None);
        encoder.clear_buffer(&self.tables.joined, 0, None);
        self.submit(encoder)?;
        let tables = [
            (
                filled_words(bits.table()),
                &block_lists.words,
                Kernel::PutWords,
            ),
            (
                filled_words(pairs.unwrap_or_default()),
                &block_lists.pair_words,
                Kernel::PutPairs,
            ),
        ];
        for (words, list, kernel) in tables {
            for run in words.chunks(3 * self.capacity as usize) {
                self.gpu
                    .queue
                    .write_buffer(list, 0, bytemuck::cast_slice(run));
                lock(&self.state).traffic.up += size_of_val(run) as u64;
                let offset = self.part(
                    block_lists,
                    &Part {
                        count: run.len() as u32,
                        ..Part::default()
                    },
                );
                let mut encoder = self.encoder();
                self.run(&mut encoder, block_lists, offset, &[kernel]);
                self.submit(encoder)?;
            }
        }
        self.publish()
    }

    fn uniform(
        &self,
        work: &[UniformWork],
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError> {
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
            return Ok(joined(
                self.uniform(one, goes_on)?,
                self.uniform(two, goes_on)?,
            ));
        }
        let (block_lists, encoder) = self.begin(&items)?;
        self.submit(encoder)?;
        // Each line has two rays, and each ray may find a triangle.
        let each = self.capacity / 2 / LANES as u32;
        let (mut rays, mut last) = (0, 0);
        for first in (0..tiles as u32).step_by(each as usize) {
            if !goes_on(last) {
                return self.end(block_lists, self.encoder(), 0);
            }
            let count = each.min(tiles as u32 - first) * LANES as u32;
            let mask = self.claims_for(2 * u64::from(count));
            let items = items.len() as u32;
            let joins = self.joined[0];
            self.uniform_part(
                block_lists,
                &Part {
                    count,
                    first,
                    items,
                    mask,
                    joins,
                    ..Part::default()
                },
            )?;
            last = 2 * u64::from(count);
            rays += last;
        }
        let found = self.end(block_lists, self.encoder(), items.len())?;
        let flood: u64 = found.counts.iter().map(|c| u64::from(c[2])).sum();
        lock(&self.state).traffic.rays += rays + flood;
        Ok(found)
    }

    fn aim(
        &self,
        work: &[AimWork],
        plan: &AimPlan,
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError> {
        let items: Vec<[u32; 4]> = work
            .iter()
            .map(|w| {
                [
                    w.cell as u32,
                    (w.least as f32).to_bits(),
                    (w.rays as f32).to_bits(),
                    0,
                ]
            })
            .collect();
        let with_plan = |part: Part| Part {
            items: items.len() as u32,
            round: plan.phase,
            times: plan.times,
            so_far: plan.so_far,
            joins: self.joined[1],
            ..part
        };
        let (block_lists, mut encoder) = self.begin(&items)?;
        encoder.clear_buffer(&block_lists.places, 0, None);
        let offset = self.part(block_lists, &with_plan(Part::default()));
        self.run(
            &mut encoder,
            block_lists,
            offset,
            &[Kernel::PlaceItems, Kernel::CountCandidates],
        );
        let slots = 256 * u64::from(self.tables.words);
        let counts = self.read(
            encoder,
            block_lists,
            &[(
                &block_lists.places,
                slots,
                block_lists.places.size() - slots,
            )],
        )?;
        let most = plan
            .times
            .iter()
            .fold(1.0f32, |most, t| most.max(*t))
            .ceil() as u32;
        for (from, to, candidates) in self.runs_of_candidates(&counts, items.len()) {
            // Before the end, only the device has the number of lines of a part.
            if !goes_on(0) {
                return self.end(block_lists, self.encoder(), 0);
            }
            let mut encoder = self.encoder();
            // The counters of hits, lines, words and candidates are cleared, but not the tally.
            encoder.clear_buffer(&block_lists.counters, 0, Some(16));
            let mask = self.claims_for(2 * candidates);
            let part = with_plan(Part {
                first: from,
                count: to - from,
                mask,
                ..Part::default()
            });
            let offset = self.part(block_lists, &part);
            self.run(&mut encoder, block_lists, offset, &[Kernel::ListCandidates]);
            for time in 0..most {
                let offset = self.part(block_lists, &Part { time, ..part });
                self.one_try(
                    &mut encoder,
                    block_lists,
                    offset,
                    part.bytes_of_claims(),
                    plan.flood_steps,
                );
            }
            self.submit(encoder)?;
        }
        let found = self.end(block_lists, self.encoder(), items.len())?;
        let rays = found
            .counts
            .iter()
            .map(|c| u64::from(c[0]) + u64::from(c[2]));
        lock(&self.state).traffic.rays += rays.sum::<u64>();
        Ok(found)
    }

    fn seeds(&self, goes_on: ContinueCheck<'_>) -> Result<DevicePhaseResult, TracerError> {
        let (block_lists, encoder) = self.begin(&[[0; 4]])?;
        self.submit(encoder)?;
        let groups = self.tables.ordered.div_ceil(2 * LANES as u32);
        let each = self.capacity / LANES as u32;
        let mut last = 0;
        for first in (0..groups).step_by(each as usize) {
            if !goes_on(last) {
                break;
            }
            let count = each.min(groups - first) * LANES as u32;
            let joins = self.joined[1];
            let offset = self.part(
                block_lists,
                &Part {
                    first,
                    count,
                    items: 1,
                    joins,
                    ..Part::default()
                },
            );
            let mut encoder = self.encoder();
            encoder.clear_buffer(&block_lists.counters, 4 * LINES, Some(4));
            self.run(
                &mut encoder,
                block_lists,
                offset,
                &[Kernel::MakeSeeds, Kernel::TraceRays, Kernel::CreditLines],
            );
            self.run(&mut encoder, block_lists, offset, self.joins());
            self.submit(encoder)?;
            last = 2 * u64::from(count);
        }
        let found = self.end(block_lists, self.encoder(), 0)?;
        lock(&self.state).traffic.rays += found.rays;
        Ok(found)
    }

    fn check(
        &self,
        work: &[(usize, u64)],
        look: u32,
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError> {
        let lines: u64 = work.iter().map(|w| w.1).sum();
        if lines >= MOST_NUMBERED && work.len() > 1 {
            let (one, two) = work.split_at(work.len() / 2);
            return Ok(joined(
                self.check(one, look, goes_on)?,
                self.check(two, look, goes_on)?,
            ));
        }
        let mut before = 0;
        let items: Vec<[u32; 4]> = work
            .iter()
            .map(|(cell, lines)| {
                let own = [
                    *cell as u32,
                    self.division_slots.get(*cell).copied().unwrap_or(0),
                    0,
                    before as u32,
                ];
                before += lines;
                own
            })
            .collect();
        let (block_lists, encoder) = self.begin(&items)?;
        self.submit(encoder)?;
        let items = items.len();
        let mut last = 0;
        for first in (0..lines).step_by(self.capacity as usize) {
            if !goes_on(last) {
                return self.end(block_lists, self.encoder(), 0);
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
            let offset = self.part(block_lists, &part);
            let mut encoder = self.encoder();
            use Kernel::*;
            self.run(
                &mut encoder,
                block_lists,
                offset,
                &[MakeCheck, TraceRays, CreditLines, GatherCheck],
            );
            if self.tables.pair_places > 0 {
                self.run(&mut encoder, block_lists, offset, &[CheckPairs]);
            }
            self.submit(encoder)?;
            last = u64::from(count);
        }
        let found = self.end(block_lists, self.encoder(), items)?;
        lock(&self.state).traffic.rays += lines;
        Ok(found)
    }

    fn segments(
        &self,
        work: &SegmentWork<'_>,
        goes_on: ContinueCheck<'_>,
    ) -> Result<DevicePhaseResult, TracerError> {
        let any = u32::from(work.at_any);
        let items: Vec<[u32; 4]> = work.cells.iter().map(|c| [*c, work.most, any, 0]).collect();
        let (block_lists, mut encoder) = self.begin(&items)?;
        let part_for = |first: usize, count: usize| Part {
            first: first as u32,
            count: count as u32,
            items: items.len() as u32,
            round: work.round,
            way: SEGMENT,
            ..Part::default()
        };
        let offset = self.part(block_lists, &part_for(0, items.len()));
        self.run(&mut encoder, block_lists, offset, &[Kernel::CountAims]);
        self.submit(encoder)?;
        // The expected maximum number of lines of an item. A part has spare room for more.
        let each = work.most + LEAST_SEGMENTS.div_ceil(self.division.max(1));
        let step = (2 * self.capacity / each).max(1) as usize;
        for first in (0..items.len()).step_by(step) {
            if !goes_on(0) {
                return self.end(block_lists, self.encoder(), 0);
            }
            let offset = self.part(block_lists, &part_for(first, step.min(items.len() - first)));
            let mut encoder = self.encoder();
            encoder.clear_buffer(&block_lists.counters, 4 * LINES, Some(4));
            use Kernel::*;
            self.run(
                &mut encoder,
                block_lists,
                offset,
                &[MakeSegments, TraceRays, GatherSegments],
            );
            self.submit(encoder)?;
        }
        let found = self.end(block_lists, self.encoder(), items.len())?;
        let rays = found.counts.iter().map(|c| u64::from(c[0])).sum();
        lock(&self.state).traffic.rays += rays;
        Ok(DevicePhaseResult { rays, ..found })
    }

    fn traffic(&self) -> Traffic {
        lock(&self.state).traffic
    }

    fn kernel_times(&self) -> Vec<KernelTime> {
        self.profile.as_ref().map_or_else(Vec::new, Profile::times)
    }
}
