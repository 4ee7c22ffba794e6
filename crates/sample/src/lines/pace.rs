//! How large rounds of sight lines are, how far they flood, and what their rays cost, on the host and on a
//! device.

use sightline_trace::lines::FLOOD_STEPS;

/// The same from what candidates find, where the target error is coarse: in towns, more steps then cost more
/// than they gain.
const COARSE_STEPS: u32 = 2;
/// Target errors above this one are coarse.
const COARSE: f64 = 3e-3;

/// Most steps of the flood from what candidates find, for a target error.
pub(super) fn steps_from_candidates(target: f64) -> u32 {
    if target > COARSE {
        COARSE_STEPS
    } else {
        FLOOD_STEPS
    }
}

/// What suits the tracer of a block: how large rounds are, and what an aimed ray costs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Uniform tiles of the first round along a cube face: 3 give 27 pairs of packets, 864 rays.
    pub first: u32,
    /// The same for coarse targets.
    pub first_coarse: u32,
    /// Growth of the least number of tiles along a face from round to round: in a cell that misses much for
    /// many rounds, small rounds would repeat each other.
    pub growth: f64,
    /// Work of an aimed ray in units of a uniform ray.
    pub aimed: u64,
}

impl Pace {
    /// The host traces: uniform rays in packets. An aimed ray was measured as 2 (wide tiles, small scenes) to
    /// 4.5 uniform ones.
    pub const HOST: Self = Self {
        first: 3,
        first_coarse: 2,
        growth: 1.25,
        aimed: 3,
    };
    /// A device casts whole rounds. A ray more costs it less than a round more, and an aimed ray little more
    /// than another one (`docs/experiments/gpu-rounds.md`).
    pub const DEVICE: Self = Self {
        first: 6,
        first_coarse: 4,
        growth: 1.25,
        aimed: 2,
    };
}
