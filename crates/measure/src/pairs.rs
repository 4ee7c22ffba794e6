//! The error of the relation between cells. The error is a fraction of the random pairs of points that a free
//! segment connects: the pairs whose cells are not a pair in the result.

use rayon::prelude::*;
use serde::Serialize;
use sightline_numbers::random::SplitMix64;
use sightline_pvs::{Pvs, PvsError};
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sight::{Passed, SightLineTracer};

use crate::error::MeasureError;

/// The number of pairs per work item of a thread.
const AT_ONCE: u64 = 1 << 14;

/// The counts of a measurement of pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct PairReport {
    /// The number of pairs of points in different cells, at least one of them a possible viewpoint.
    pub pairs: u64,
    /// The number of pairs that a free segment connects.
    pub free: u64,
    /// The number of pairs of `free` whose cells are not a pair in the result.
    pub missed: u64,
    /// The quotient of `missed` and `free`; 0 if `free` is 0.
    pub missed_fraction: f64,
}

/// Draws `count` pairs of points, uniform in the view box, and compares their cells with the result's
/// relation. `step` is the minimum distance from a see-through triangle to the next search, in world units.
/// `is_place` returns true for positions that viewpoints can have; a pair without such a point does not
/// count. If lines end at a distance, longer segments do not count.
///
/// # Errors
/// [`MeasureError::Pvs`] if the result has no cell-to-cell relations. [`MeasureError::Backend`] if the tracer
/// fails.
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
                // The direction is the segment, so a free segment has no hit before 1.
                if packets[i / LANES].distance[i % LANES] >= 1.0 {
                    report.free += 1;
                    report.missed += u64::from(!found.has(from, to));
                }
            }
            Ok(report)
        })
        .collect::<Result<_, MeasureError>>()?;
    let sum = |count: fn(&PairReport) -> u64| parts.iter().map(count).sum::<u64>();
    let (pairs, free, missed) = (sum(|r| r.pairs), sum(|r| r.free), sum(|r| r.missed));
    Ok(PairReport {
        pairs,
        free,
        missed,
        missed_fraction: missed as f64 / free.max(1) as f64,
    })
}
