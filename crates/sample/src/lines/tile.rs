//! Sampling of one leaf tile of the plan with sight lines. The tile's cells are a block. The cells of an
//! adaptive tree are joined from smaller cells ([`super::adaptive`]).

use std::time::Instant;

use rayon::prelude::*;
use sightline_model::{CellSet, CellSets, Crediting, Stop, SubtreeNode};
use sightline_trace::sight::SightLineTracer;
use sightline_viewcells::{CellBox, Division, Tile, UNITS_PER_CELL};

use super::block::Block;
use super::likely_items::{LikelyItem, completed_set};
use super::pairs::of_tile;
use super::rounds::Tolerance;
use super::tile_sampling::{TileSampling, share};
use super::{adaptive, cell_joins};
use crate::context::{JobContext, LineSampler, TileError, Watcher};

/// Computes a leaf tile and returns its sets and the number of rays.
///
/// # Errors
/// [`TileError`] if the tile is cancelled or the backend fails.
pub fn run(
    job: &JobContext<'_>,
    sampler: LineSampler,
    tile: &Tile,
    watcher: &dyn Watcher,
) -> Result<(CellSets, u64), TileError> {
    let start = Instant::now();
    let scene = job.scene.for_lines();
    let sight = SightLineTracer::new(job.backend, job.scene.traced())?.up_to(job.far);
    let pairs = cell_joins::table(job);
    // Pairs are searched after the lines that search for triangles, which leave fewer cells to join. The rays
    // of the sampler guided do not join cells.
    let rounds = match sampler {
        LineSampler::Guided { .. } => cell_joins::MANY_ROUNDS,
        LineSampler::Shared { .. } => cell_joins::FEW_ROUNDS,
    };
    let join = |block| match &pairs {
        Some(pairs) => cell_joins::search(job, &sight, pairs, &tile.cell, rounds, watcher, block),
        None => Ok(0),
    };
    let sampling = TileSampling {
        job,
        scene,
        sight: &sight,
        watcher,
        pairs: pairs.as_ref(),
    };
    tracing::debug!("ready to trace after {:?}", start.elapsed());
    if let (Division::Adaptive { .. }, LineSampler::Shared { error, .. }) = (&job.division, sampler)
    {
        let (sets, rays) = adaptive::run(&sampling, error, tile)?;
        let joined = join(None)?;
        job.crew.end()?;
        return Ok((
            CellSets {
                pairs: of_tile(job, pairs.as_ref()),
                ..sets
            },
            rays + joined,
        ));
    }
    let whole = job.lattice.units().map(|u| u64::from(u / UNITS_PER_CELL));
    let first = tile.cell.lo.map(|u| u64::from(u / UNITS_PER_CELL));
    let number = |c: [u32; 3]| {
        let [x, y, z] = [0, 1, 2].map(|a| first[a] + u64::from(c[a]));
        (z * whole[1] + y) * whole[0] + x
    };
    let parts = |c: [u32; 3]| {
        job.viewpoints
            .map_or(u64::MAX, |marks| marks.parts(number(c) as usize))
    };
    let mut block = sampling.block(&tile.cell, span(&tile.cell), number, parts);
    if job.completes {
        block.enable_completion(scene.duplicates);
    }
    tracing::debug!(
        "found the triangles that intersect each cell after {:?}",
        start.elapsed()
    );
    let joined = match sampler {
        LineSampler::Guided { rays, credit } => {
            match credit {
                Crediting::All if !block.credits_halves() => block.sample_guided_shared(rays)?,
                Crediting::All | Crediting::Own => block.sample_guided(rays)?,
            }
            join(Some(&mut block))?
        }
        LineSampler::Shared {
            error,
            stop: Stop::Bound(most),
        } => {
            let most = most.get();
            block.sample_before_bound(error, most)?;
            let joined = join(Some(&mut block))?;
            block.sample_to_bound(error, most)?;
            block.join_to_bound(most)?;
            joined
        }
        LineSampler::Shared { error, stop } => {
            if let Stop::Share(share) = stop {
                block.search_for_share(share.get());
            }
            block.sample(error, &[], Tolerance::Raised)?;
            join(Some(&mut block))?
        }
    };
    job.crew.end()?;
    tracing::debug!("sampled after {:?}", start.elapsed());
    block.publish();
    // The bounds hold with the likely items of the last looks.
    let is_bounded = matches!(
        sampler,
        LineSampler::Shared {
            stop: Stop::Bound(_),
            ..
        }
    );
    if !is_bounded {
        block.complete_all();
    }
    let likely = block.likely_items();
    share(&sampling, &mut block);
    let rays: u64 = block.stats().iter().flat_map(|s| s.rays).sum();
    let mut sets = sets(job, tile, &block, likely);
    sets.pairs = of_tile(job, pairs.as_ref());
    let rays = rays + joined;
    tracing::debug!("sets after {:?}", start.elapsed());
    Ok((sets, rays))
}

/// Returns the number of cells of a box along each axis.
fn span(cell: &CellBox) -> [u32; 3] {
    [0, 1, 2].map(|a| (cell.hi[a] - cell.lo[a]) / UNITS_PER_CELL)
}

/// Returns the sets in the order of the tile's subtree. `likely` contains the likely items of each cell.
fn sets(
    job: &JobContext<'_>,
    tile: &Tile,
    block: &Block<'_>,
    mut likely: Vec<Vec<LikelyItem>>,
) -> CellSets {
    let grid = block.grid();
    let [nx, ny, _] = grid.cells();
    let mut columns = block.bits().columns();
    let mut nodes = Vec::new();
    // The places of the cells in `CellGrid::each`, with their seen and likely items.
    let mut cells = Vec::new();
    let mut waiting = vec![(tile.cell, tile.depth)];
    while let Some((cell, depth)) = waiting.pop() {
        match job.division.split(&job.lattice, &cell, depth) {
            Some(split) => {
                nodes.push(SubtreeNode::Split(split));
                let [below, above] = cell.children(split);
                waiting.extend([(above, depth + 1), (below, depth + 1)]);
            }
            None => {
                let at = [0, 1, 2].map(|a| (cell.lo[a] - tile.cell.lo[a]) / UNITS_PER_CELL);
                let place = ((at[2] * ny + at[1]) * nx + at[0]) as usize;
                nodes.push(SubtreeNode::Cell);
                let seen = std::mem::take(&mut columns[grid.slot(at).index()]);
                cells.push((place, seen, std::mem::take(&mut likely[place])));
            }
        }
    }
    let set = |(place, seen, likely): (usize, Vec<u32>, Vec<LikelyItem>)| {
        let (visible, undecided) = completed_set(seen, likely, usize::MAX);
        CellSet {
            visible,
            undecided,
            stats: block.stats()[place],
            unreached: !block.is_reached(place),
            ..CellSet::default()
        }
    };
    CellSets {
        nodes,
        cells: cells.into_par_iter().map(set).collect(),
        ..CellSets::default()
    }
}
