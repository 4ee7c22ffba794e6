//! Times the backends on a few cubes, a few cells or a few rays of a scene, to choose the faster backend.

use std::time::{Duration, Instant};

use sightline_model::Granularity;
use sightline_trace::BackendError;
use sightline_trace::PreparedScene;
use sightline_trace::cube::face_basis;
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::packet::{LANES, Packet};
use sightline_trace::sight::SightLineTracer;
use sightline_trace::{Backend, LineSet};
use sightline_viewcells::Lattice;

use crate::context::{TileError, Unwatched};
use crate::crew::Alone;
use crate::lines::block::{Block, Tools};
use crate::lines::rounds::Tolerance;

/// Cubes timed with each backend, after one cube to warm up.
const CUBES: u32 = 8;

/// The time that a backend takes for a cube, or for something else that is the same for all backends.
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// The backend's numerics profile.
    pub profile: String,
    /// Mean over a batch.
    pub per_cube: Duration,
}

/// Points spread evenly over the view box: a Kronecker sequence (generalised golden ratio in three
/// dimensions).
fn places(lattice: &Lattice) -> impl Iterator<Item = glam::Vec3> + '_ {
    let units = lattice.units();
    let step = [0.819_172_5, 0.671_043_6, 0.549_700_5f64];
    (0u32..).map(move |i| {
        let p = [0, 1, 2].map(|a| {
            let t = (0.5 + step[a] * f64::from(i + 1)).fract();
            (f64::from(units[a]) * t) as u32
        });
        lattice.position(p)
    })
}

/// Times `backend` at fixed points spread over the view box. The time excludes building the geometry, which
/// happens once.
///
/// # Errors
/// The backend's own failure.
pub fn time(backend: &dyn Backend, lattice: &Lattice) -> Result<Timing, BackendError> {
    let renderer = backend.prepare(None)?;
    let points: Vec<_> = places(lattice).take(CUBES as usize).collect();
    renderer.samples(&points[..1])?;
    let start = Instant::now();
    renderer.samples(&points)?;
    Ok(Timing {
        profile: backend.profile().to_owned(),
        per_cube: start.elapsed() / CUBES,
    })
}

/// Times `backend` on rounds of sight lines, as the sampler casts them, from a few cells that fill the view
/// box. The time excludes building the hierarchy and compiling kernels, which happens once.
///
/// # Errors
/// [`TileError::Backend`] with the backend's own failure.
pub fn time_rounds(
    backend: &dyn Backend,
    scene: &PreparedScene,
    lattice: &Lattice,
) -> Result<Timing, TileError> {
    /// Cells along each axis.
    const CELLS: [u32; 3] = [4; 3];
    /// A coarse target to warm up with, and the one that is timed.
    const TARGETS: [f64; 2] = [0.1, 0.01];
    let (facts, sight) = (
        scene.for_lines(),
        SightLineTracer::new(backend, scene.traced())?,
    );
    let (min, max) = (lattice.position([0; 3]), lattice.position(lattice.units()));
    let mut taken = Duration::ZERO;
    for target in TARGETS {
        let tools = Tools {
            scene: facts.scene,
            surface: facts.surface,
            rows: scene.fine_rows(Granularity::Triangles),
            sight: &sight,
            seed: 0,
            watcher: &Unwatched,
            deadline: None,
            pairs: None,
            places: None,
            crew: &Alone,
            ledger: None,
        };
        let number = |[x, y, z]: [u32; 3]| u64::from((z * CELLS[1] + y) * CELLS[0] + x);
        let mut block = Block::new(tools, CellGrid::new(min, max, CELLS), number, |_| u64::MAX);
        let start = Instant::now();
        block.sample(target, &[], Tolerance::Raised)?;
        taken = start.elapsed();
    }
    Ok(Timing {
        profile: backend.profile().to_owned(),
        per_cube: taken / CELLS.iter().product(),
    })
}

/// Times `backend` on single sight lines: packets of a cube's directions from the same points, half of them
/// traced ray by ray. A cube has as many lines as an item buffer cube with faces of 64² pixels.
///
/// # Errors
/// As [`time`].
pub fn time_lines(
    backend: &dyn Backend,
    distinct: &[u32],
    lattice: &Lattice,
) -> Result<Timing, BackendError> {
    const SIDE: u32 = 16;
    let tracer = backend.lines(LineSet::Blocking, distinct)?;
    let mut packets = Vec::new();
    for point in places(lattice).take(CUBES as usize) {
        for face in 0..6 {
            let [forward, right, up] = face_basis(face);
            for tile in 0..SIDE * SIDE {
                let mut packet = Packet::default();
                for lane in 0..LANES as u32 {
                    let at = |x: u32| (2 * x + 1) as f32 / (4 * SIDE) as f32 - 1.0;
                    let (x, y) = (tile % SIDE * 4 + lane % 4, tile / SIDE * 4 + lane / 4);
                    packet.push(
                        point.to_array(),
                        (forward + right * at(x) + up * at(y)).to_array(),
                    );
                }
                packets.push(packet);
            }
        }
    }
    // Half as uniform lines, half as aimed lines: about the proportion in sampling.
    let half = packets.len() / 2;
    let mut both = || {
        let (packets, singly) = packets.split_at_mut(half);
        tracer.trace(packets)?;
        tracer.trace_each(singly)
    };
    both()?;
    let start = Instant::now();
    both()?;
    Ok(Timing {
        profile: backend.profile().to_owned(),
        per_cube: start.elapsed() / CUBES,
    })
}
