//! The error of the relation between cells: of random pairs of points that a free segment joins, the fraction
//! whose cells are no pair.

use rayon::prelude::*;
use serde::Serialize;
use sightline_numbers::random::SplitMix64;
use sightline_pvs::{Pvs, PvsError};
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sight::{Passed, SightLineTracer};

use crate::error::MeasureError;

/// Pairs that a thread takes at a time.
const AT_ONCE: u64 = 1 << 14;

/// What was found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PairReport {
    /// Pairs of points in different cells, one of them at least a possible viewpoint.
    pub pairs: u64,
    /// Those of them that a free segment joins.
    pub free: u64,
    /// Those of `free` whose cells are no pair in the result.
    pub missed: u64,
    /// `missed` of `free`; 0 when there are none.
    pub missed_fraction: f64,
}

/// Draws `count` pairs of points, uniform in the view box, and compares. `step` is the least distance from a
/// see-through triangle to the next search, in world units. `is_place` says where viewpoints can be: a pair
/// without any does not count. Where lines end at a distance, longer segments do
/// not count.
///
/// # Errors
/// [`MeasureError::Pvs`] when the result does not say which cells see which, [`MeasureError::Backend`] when
/// the tracer fails.
pub fn measure_pairs(
    sight: &SightLineTracer<'_>,
    pvs: &Pvs,
    count: u64,
    seed: u64,
    step: f32,
    is_place: &(dyn Fn([f32; 3]) -> bool + Sync),
) -> Result<PairReport, MeasureError> {
    let found = &pvs.cell_pairs()?.ok_or(PvsError::NoPairs)?.visible;
    let [min, max] = pvs.tree().view_box();
    let parts: Vec<u64> = (0..count.div_ceil(AT_ONCE)).collect();
    let parts: Vec<PairReport> = parts
        .par_iter()
        .map(|part| {
            let mut random = SplitMix64::named(&[seed, *part]);
            let mut point = || {
                [0, 1, 2].map(|a| {
                    let (lo, hi) = (f64::from(min[a]), f64::from(max[a]));
                    (lo + (hi - lo) * f64::from(random.unit_f32())) as f32
                })
            };
            let mut report = PairReport::default();
            let (mut packets, mut cells): (Vec<Packet>, Vec<[u32; 2]>) = (Vec::new(), Vec::new());
            for _ in 0..AT_ONCE.min(count - part * AT_ONCE) {
                let (a, b) = (point(), point());
                let (Some(from), Some(to)) = (pvs.find_cell(a), pvs.find_cell(b)) else {
                    continue;
                };
                if from == to || !(is_place(a) || is_place(b)) {
                    continue;
                }
                if cells.len() % LANES == 0 {
                    packets.push(Packet::default());
                }
                let Some(packet) = packets.last_mut() else {
                    continue;
                };
                packet.push(a, [0, 1, 2].map(|k| b[k] - a[k]));
                cells.push([from, to]);
            }
            sight.trace_each(&mut packets, &mut Passed::default(), step)?;
            for (i, [from, to]) in cells.into_iter().enumerate() {
                report.pairs += 1;
                // The direction is the segment, so a free one has no hit before 1.
                if packets[i / LANES].distance[i % LANES] >= 1.0 {
                    report.free += 1;
                    report.missed += u64::from(!found.has(from, to));
                }
            }
            Ok(report)
        })
        .collect::<Result<_, MeasureError>>()?;
    let sum = |of: fn(&PairReport) -> u64| parts.iter().map(of).sum::<u64>();
    let (pairs, free, missed) = (sum(|r| r.pairs), sum(|r| r.free), sum(|r| r.missed));
    Ok(PairReport {
        pairs,
        free,
        missed,
        missed_fraction: missed as f64 / free.max(1) as f64,
    })
}
