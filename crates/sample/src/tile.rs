//! The sampling of one tile with the sampler of its job: the dispatcher above [`crate::lines`] and
//! `crate::cubes`.
//!
//! A tile's output is a pure function of the scene, the parameters, the backend's numerics profile and the
//! packs of the tiles that it needs.

use sightline_model::{Pack, TileOutput};
use sightline_viewcells::Tile;

use crate::context::{JobContext, TileError, TileSampler, Watcher};
use crate::cubes::cache::CacheCounters;
use crate::cubes::tile::CubeCounters;
use crate::{cubes, lines};

/// The counters of the work of a tile, for reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileCounters {
    /// The number of rendered cubes, or of traced rays.
    pub rendered: u64,
    /// The counters of the sample cache; zero unless the sampler is cubes.
    pub cache: CacheCounters,
}

/// Computes `tile` with the packs of the tiles that it needs, in the plan's order.
///
/// # Errors
/// [`TileError`] if the tile is cancelled or the backend fails.
///
/// # Panics
/// Panics on a thread of rayon's pool, because the thread could wait for itself.
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
