//! The choice of the faster backend: each backend is timed on a few cubes, cells or rays of a scene.

use std::time::{Duration, Instant};

use sightline_model::Granularity;
use sightline_trace::PreparedScene;
use sightline_trace::TracerError;
use sightline_trace::cube::face_basis;
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::packet::{Halves, LANES, Packet};
use sightline_trace::sight::SightLineTracer;
use sightline_trace::{LineSet, Tracer};
use sightline_viewcells::Lattice;

use crate::context::{TileError, Unwatched};
use crate::crew::SoleMember;
use crate::lines::block::{Block, BlockInputs};
use crate::lines::rounds::Tolerance;

/// The number of cubes timed with each backend, after one cube to warm up.
const CUBES: u32 = 8;

/// The time that a backend needs for a unit of work: a cube in [`time`] and [`time_lines`], a cell in
/// [`time_rounds`].
#[derive(Clone, Debug, PartialEq)]
pub struct Timing {
    /// The backend's numerics profile.
    pub profile: String,
    /// The mean time per cube or cell.
    pub per_cube: Duration,
}

/// Returns points spread evenly over the view box: a Kronecker sequence (generalised golden ratio in three
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

/// Times `backend` on cubes at fixed points spread over the view box. The time excludes building the
/// geometry, which happens once.
///
/// # Errors
/// [`TracerError`] if the backend fails.
pub fn time(backend: &dyn Tracer, lattice: &Lattice) -> Result<Timing, TracerError> {
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

/// Times `backend` on rounds of sight lines, as the sampler casts them, from 64 cells that fill the view box.
///
/// The time excludes building the hierarchy and compiling kernels, which happens once.
///
/// # Errors
/// [`TileError::Backend`] if the backend fails.
pub fn time_rounds(
    backend: &dyn Tracer,
    scene: &PreparedScene,
    lattice: &Lattice,
) -> Result<Timing, TileError> {
    /// The number of cells along each axis.
    const CELLS: [u32; 3] = [4; 3];
    /// The target errors: a coarse target to warm up with, and the target that is timed.
    const TARGETS: [f64; 2] = [0.1, 0.01];
    let (facts, sight) = (
        scene.for_lines(),
        SightLineTracer::new(backend, scene.traced())?,
    );
    let (min, max) = (lattice.position([0; 3]), lattice.position(lattice.units()));
    let mut taken = Duration::ZERO;
    for target in TARGETS {
        let inputs = BlockInputs {
            scene: facts.scene,
            surface: facts.surface,
            rows: scene.fine_rows(Granularity::Triangles),
            sight: &sight,
            seed: 0,
            watcher: &Unwatched,
            deadline: None,
            pairs: None,
            region: None,
            crew: &SoleMember,
            observer: None,
        };
        let number = |[x, y, z]: [u32; 3]| u64::from((z * CELLS[1] + y) * CELLS[0] + x);
        let mut block = Block::new(inputs, CellGrid::new(min, max, CELLS), number, |_| u64::MAX);
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
/// [`TracerError`] if the backend fails.
pub fn time_lines(
    backend: &dyn Tracer,
    distinct: &[u32],
    lattice: &Lattice,
) -> Result<Timing, TracerError> {
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
    // Half of the packets are traced like uniform lines and half like aimed lines, which is about the
    // proportion in sampling.
    let half = packets.len() / 2;
    let mut both = || {
        packets
            .iter_mut()
            .for_each(|p| p.distance = [f32::INFINITY; LANES]);
        let (packets, singly) = packets.split_at_mut(half);
        tracer.trace(packets, Halves::Rays, true)?;
        tracer.trace(singly, Halves::Rays, false)
    };
    both()?;
    let start = Instant::now();
    both()?;
    Ok(Timing {
        profile: backend.profile().to_owned(),
        per_cube: start.elapsed() / CUBES,
    })
}
