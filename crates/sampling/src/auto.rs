//! Which backend is faster here: a few cubes of the scene at hand, timed with each.

use std::time::{Duration, Instant};

use sightline_viewcells::Lattice;

use crate::backend::{Backend, BackendError};

/// Cubes timed with each backend, after one that warms it up.
const CUBES: u32 = 8;

/// The time one cube takes.
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// The backend's numerics profile.
    pub profile: String,
    /// Mean over a batch.
    pub per_cube: Duration,
}

/// Times `backend` at fixed places spread over the view box. Building its geometry is not counted: it is done once.
///
/// # Errors
/// The backend's own failure.
pub fn time(backend: &dyn Backend, lattice: &Lattice) -> Result<Timing, BackendError> {
    let renderer = backend.prepare(None)?;
    let units = lattice.units();
    // A Kronecker sequence spreads any number of points evenly (generalised golden ratio in three dimensions).
    let place = |i: u32| {
        let step = [0.819_172_5, 0.671_043_6, 0.549_700_5f64];
        let p = [0, 1, 2].map(|a| {
            let t = (0.5 + step[a] * f64::from(i + 1)).fract();
            (f64::from(units[a]) * t) as u32
        });
        lattice.position(p)
    };
    let points: Vec<_> = (0..CUBES).map(place).collect();
    renderer.samples(&points[..1])?;
    let start = Instant::now();
    renderer.samples(&points)?;
    Ok(Timing { profile: backend.profile().to_owned(), per_cube: start.elapsed() / CUBES })
}
