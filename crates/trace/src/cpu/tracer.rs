//! The tracer of sight lines through one hierarchy.

use std::sync::{Arc, Mutex, PoisonError};

use fearless_simd::{Level, dispatch};

use super::batch::{self, BatchScratch};
use super::float_mode::FloatMode;
use super::hierarchy::WideHierarchy;
use super::lines::{Hits, Lines};
use super::tile::{self, TileScratch};
use crate::cube::SKY;
use crate::error::TracerError;
use crate::packet::{Halves, LANES, LineTracer, Packet, PassingTracer};

/// A hierarchy over triangles of a scene, and the memory of the threads that trace through it.
pub(super) struct CpuScene {
    pub(super) hierarchy: WideHierarchy,
    pub(super) near: f32,
    pub(super) level: Level,
    scratch: Mutex<Vec<Scratch>>,
}

/// The memory of one trace.
struct Scratch {
    batch: Box<BatchScratch>,
    tile: Box<TileScratch>,
    chosen: Vec<u32>,
    hits: Hits,
}

impl CpuScene {
    /// Creates the scene for the best instruction set of this processor. `near` is the distance below which
    /// rays meet nothing, in lengths of the direction.
    pub(super) fn new(hierarchy: WideHierarchy, near: f32) -> Self {
        Self {
            hierarchy,
            near,
            level: Level::new(),
            scratch: Mutex::default(),
        }
    }
}

/// A tracer of packets through one hierarchy.
pub(super) struct CpuTracer(pub(super) Arc<CpuScene>);

impl CpuTracer {
    /// Traces packets up to the distances that they have on entry, and adds the triangles that lines pass to
    /// `passed`.
    pub(super) fn trace_packets(
        &self,
        packets: &mut [Packet],
        halves: Halves,
        coherent: bool,
        passed: Option<&mut Vec<(u32, u32, f32)>>,
    ) {
        let CpuScene {
            hierarchy,
            near,
            level,
            scratch: pool,
        } = &*self.0;
        let _mode = FloatMode::set();
        let spare = pool.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut scratch = spare.unwrap_or_else(Scratch::new);
        let Scratch {
            batch,
            tile,
            chosen,
            hits,
        } = &mut scratch;
        for packet in packets.iter_mut() {
            packet.triangle = [SKY; LANES];
        }
        let (step, stride) = match halves {
            Halves::Rays => (None, 1),
            Halves::Lines { step } => (Some(step), 2),
        };
        chosen.clear();
        chosen.extend((0..packets.len() as u32).step_by(stride));
        hits.passed.clear();
        hits.ends.resize(packets.len() * LANES, 0.0);
        let mut lines = Lines {
            packets,
            chosen: &[],
            step,
            near: *near,
        };
        if coherent {
            dispatch!(*level, simd => tile::trace(simd, hierarchy, &mut lines, chosen, tile, hits));
        }
        // The packets that are not coherent.
        lines.chosen = chosen;
        dispatch!(*level, simd => batch::trace(simd, hierarchy, &mut lines, batch, hits));
        if let Some(passed) = passed {
            let first = passed.len();
            let Hits { passed: met, ends } = hits;
            met.retain(|(line, _, scaled)| *scaled <= ends[*line as usize]);
            passed.extend(met.drain(..).map(|(line, triangle, scaled)| {
                let (packet, lane) = (line as usize / LANES, line as usize % LANES);
                let at = lines.distance(hierarchy, packet, lane, scaled);
                (line, triangle, at)
            }));
            passed[first..].sort_unstable_by_key(|p| p.0);
        }
        pool.lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(scratch);
    }
}

impl Scratch {
    fn new() -> Self {
        Self {
            batch: bytemuck::zeroed_box(),
            tile: bytemuck::zeroed_box(),
            chosen: Vec::new(),
            hits: Hits::default(),
        }
    }
}

impl LineTracer for CpuTracer {
    fn trace(
        &self,
        packets: &mut [Packet],
        halves: Halves,
        coherent: bool,
    ) -> Result<(), TracerError> {
        self.trace_packets(packets, halves, coherent, None);
        Ok(())
    }
}

impl PassingTracer for CpuTracer {
    fn trace_passing(
        &self,
        packets: &mut [Packet],
        halves: Halves,
        coherent: bool,
        found: &mut Vec<(u32, u32, f32)>,
    ) -> Result<(), TracerError> {
        self.trace_packets(packets, halves, coherent, Some(found));
        Ok(())
    }
}
