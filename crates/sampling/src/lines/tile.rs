//! One leaf tile of the plan sampled with sight lines: its cells as a block, and the sets that come out. Of an adaptive tree
//! the cells are made of smaller ones ([`super::adaptive`]).

use std::time::Instant;

use rayon::prelude::*;
use sightline_scene::{Aabb, overlap};
use sightline_viewcells::{CellBox, Division, Tile, UNITS_PER_CELL};

use super::adaptive;
use super::bits::SeenBits;
use super::block::{Block, Tools};
use super::grid::CellGrid;
use super::rounds::Tolerance;
use crate::context::{JobContext, TileError, Watcher};
use crate::packet::LineTracer;
use crate::prepared::LineScene;
use sightline_model::Sampler;
use sightline_model::{CellSet, CellSets, Node};

/// Runs a leaf tile; gives its sets, and how many rays they took.
///
/// # Errors
/// [`TileError`] when it is cancelled or the backend fails.
pub fn run(job: &JobContext<'_>, tile: &Tile, watcher: &dyn Watcher) -> Result<(CellSets, u64), TileError> {
    let start = Instant::now();
    let scene = job.scene.for_lines();
    let tracer = job.backend.lines(scene.distinct)?;
    let work = Work { job, scene, tracer: &*tracer, watcher };
    tracing::debug!("ready to trace after {:?}", start.elapsed());
    if let Division::Adaptive { .. } = job.division {
        return adaptive::run(&work, tile);
    }
    let whole = job.lattice.units().map(|u| u64::from(u / UNITS_PER_CELL));
    let first = tile.cell.lo.map(|u| u64::from(u / UNITS_PER_CELL));
    let number = |c: [u32; 3]| {
        let [x, y, z] = [0, 1, 2].map(|a| first[a] + u64::from(c[a]));
        (z * whole[1] + y) * whole[0] + x
    };
    let mut block = work.block(&tile.cell, span(&tile.cell), number);
    tracing::debug!("know what meets each cell after {:?}", start.elapsed());
    let params = job.params;
    match (params.sampler, params.max_error) {
        (Sampler::Guided, _) => block.sample_guided(params.rays)?,
        (_, Some(most)) => block.sample_to_bound(params.target_error, most)?,
        (_, None) => block.sample(params.target_error, &[], Tolerance::Raised)?,
    }
    tracing::debug!("sampled after {:?}", start.elapsed());
    block.bits_mut().share(scene.duplicates);
    let rays = block.stats().iter().flat_map(|s| s.rays).sum();
    let sets = sets(job, tile, &block);
    tracing::debug!("sets after {:?}", start.elapsed());
    Ok((sets, rays))
}

/// Cells of a box along each axis.
fn span(cell: &CellBox) -> [u32; 3] {
    [0, 1, 2].map(|a| (cell.hi[a] - cell.lo[a]) / UNITS_PER_CELL)
}

/// What the tiles of a job are sampled with: the job, the scene's facts, the tracer and the watcher.
pub struct Work<'a> {
    pub job: &'a JobContext<'a>,
    pub scene: LineScene<'a>,
    pub tracer: &'a dyn LineTracer,
    pub watcher: &'a dyn Watcher,
}

impl Work<'_> {
    /// A block with `cells` cells along each axis of the box `within`. Each cell's set holds the triangles that meet it.
    /// `number` gives each cell a number that no other cell of the job has.
    pub fn block(&self, within: &CellBox, cells: [u32; 3], number: impl Fn([u32; 3]) -> u64) -> Block<'_> {
        let tools = Tools {
            scene: self.scene.scene,
            surface: self.scene.surface,
            tracer: self.tracer,
            seed: self.job.seed,
            watcher: self.watcher,
            deadline: self.job.deadline,
        };
        let (min, max) = within.world(&self.job.lattice);
        let mut block = Block::new(tools, CellGrid::new(min, max, cells), number);
        meeting(self, within, block.grid(), block.bits());
        block.bits_mut().publish();
        block
    }
}

/// Credits every cell with the triangles that meet it, I(C), decided exactly.
fn meeting(work: &Work<'_>, within: &CellBox, grid: &CellGrid, bits: &SeenBits) {
    let cells = grid.cells();
    let planes: [Vec<f32>; 3] = std::array::from_fn(|a| {
        let step = (within.hi[a] - within.lo[a]) / cells[a];
        (0..=cells[a]).map(|k| work.job.lattice.coordinate(a, within.lo[a] + k * step)).collect()
    });
    work.scene.distinct.par_iter().with_min_len(1024).for_each(|&id| {
        let triangle = &work.scene.scene.triangles()[id as usize];
        let bounds = triangle.bounds();
        // Closed cells whose slab the bounds touch, along each axis.
        let range = |a: usize| {
            let from = planes[a][1..].partition_point(|p| *p < bounds.min[a]) as u32;
            let to = planes[a][..cells[a] as usize].partition_point(|p| *p <= bounds.max[a]) as u32;
            from..to
        };
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    let at = [x, y, z];
                    let corner = |c: [u32; 3]| {
                        glam::Vec3::new(
                            planes[0][c[0] as usize],
                            planes[1][c[1] as usize],
                            planes[2][c[2] as usize],
                        )
                    };
                    let cell = Aabb { min: corner(at), max: corner(at.map(|c| c + 1)) };
                    if overlap::triangle_touches_box(triangle, &cell) {
                        let slot = grid.slot(at);
                        bits.credit(id, &[(slot.word, 1 << slot.bit)]);
                    }
                }
            }
        }
    });
}

/// What is seen from each cell, by the numbers of the cells' bits; ascending.
pub fn columns(block: &Block<'_>) -> Vec<Vec<u32>> {
    let words = block.grid().words() as u32;
    (0..words).into_par_iter().flat_map_iter(|w| block.bits().columns(w)).collect()
}

/// The sets in the order of the tile's subtree.
fn sets(job: &JobContext<'_>, tile: &Tile, block: &Block<'_>) -> CellSets {
    let grid = block.grid();
    let mut columns = columns(block);
    let mut out = CellSets::default();
    let mut waiting = vec![(tile.cell, tile.depth)];
    while let Some((cell, depth)) = waiting.pop() {
        match job.division.split(&job.lattice, &cell, depth) {
            Some(split) => {
                out.nodes.push(Node::Split(split));
                let [below, above] = cell.children(split);
                waiting.extend([(above, depth + 1), (below, depth + 1)]);
            }
            None => {
                let at = [0, 1, 2].map(|a| (cell.lo[a] - tile.cell.lo[a]) / UNITS_PER_CELL);
                let [nx, ny, _] = grid.cells();
                let stats = block.stats()[((at[2] * ny + at[1]) * nx + at[0]) as usize];
                out.nodes.push(Node::Cell);
                out.cells.push(CellSet {
                    visible: std::mem::take(&mut columns[grid.slot(at).index()]),
                    samples: 0,
                    stats,
                    decision: None,
                });
            }
        }
    }
    out
}
