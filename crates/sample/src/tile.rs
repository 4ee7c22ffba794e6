//! Samples one tile with the sampler of its job: the dispatcher above [`crate::lines`] and `crate::cubes`.
//!
//! A tile's output is a pure function of the scene, the parameters, the backend's numerics profile and the
//! packs of the tiles it needs.

use sightline_model::{Pack, TileOutput};
use sightline_viewcells::Tile;

use crate::context::{JobContext, TileError, TileSampler, Watcher};
use crate::cubes::cache::CacheCounters;
use crate::cubes::tile::CubeCounters;
use crate::{cubes, lines};

/// The work of a tile, for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileCounters {
    /// Cubes rendered, or rays traced.
    pub rendered: u64,
    /// The counters of the sample cache; only cubes have one.
    pub cache: CacheCounters,
}

/// Runs `tile` with the packs of the tiles it needs, in the plan's order.
///
/// # Errors
/// [`TileError`] when the tile is cancelled or the backend fails.
///
/// # Panics
/// On a thread of rayon's pool, which could wait for itself.
pub fn run(
    job: &JobContext<'_>,
    tile: &Tile,
    packs: &[Pack],
    watcher: &dyn Watcher,
) -> Result<(TileOutput, TileCounters), TileError> {
    match &job.sampler {
        TileSampler::Cubes(params) => {
            let (output, CubeCounters { rendered, cache }) =
                cubes::run(job, params, tile, packs, watcher)?;
            Ok((output, TileCounters { rendered, cache }))
        }
        TileSampler::Lines(sampler) => {
            let (sets, rendered) = lines::run(job, *sampler, tile, watcher)?;
            Ok((
                TileOutput::Cells(sets),
                TileCounters {
                    rendered,
                    ..TileCounters::default()
                },
            ))
        }
    }
}
