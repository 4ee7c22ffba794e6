//! The sizes of rounds, the number of flood steps, and the costs of rays, on the host and on a device.

use sightline_trace::lines::FLOOD_STEPS;

/// The maximum number of flood steps from triangles that candidate lines found, for coarse target errors. In
/// towns, more steps cost more than they gain.
const COARSE_STEPS: u32 = 2;
/// The target error above which [`COARSE_STEPS`] applies.
const COARSE: f64 = 3e-3;

/// Returns the maximum number of flood steps from triangles that candidate lines found, for a target error.
pub(super) fn steps_from_candidates(target: f64) -> u32 {
    if target > COARSE {
        COARSE_STEPS
    } else {
        FLOOD_STEPS
    }
}

/// The pace of a tracer: the sizes of rounds, and the cost of an aimed ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePacing {
    /// The number of uniform tiles of the first round along a cube face: 3 give 27 pairs of packets, 864
    /// rays.
    pub first: u32,
    /// The number of uniform tiles of the first round along a cube face, for target errors above 0.005.
    pub first_coarse: u32,
    /// The growth of the minimum number of tiles along a face from round to round. In a cell that misses much
    /// for many rounds, small rounds would repeat each other.
    pub growth: f64,
    /// The work of an aimed ray in units of a uniform ray.
    pub aimed: u64,
}

impl LinePacing {
    /// The pace of the host, which traces uniform rays in packets. In measurements, an aimed ray cost 2 (wide
    /// tiles, small scenes) to 4.5 uniform rays.
    pub const HOST: Self = Self {
        first: 3,
        first_coarse: 2,
        growth: 1.25,
        aimed: 3,
    };
    /// The pace of a device, which casts whole rounds. Another ray costs less than another round, and an
    /// aimed ray costs little more than another ray (`docs/experiments/gpu-rounds.md`).
    pub const DEVICE: Self = Self {
        first: 6,
        first_coarse: 4,
        growth: 1.25,
        aimed: 2,
    };
}
