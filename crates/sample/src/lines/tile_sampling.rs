//! The first and the last step of a leaf tile.
//!
//! The first step creates a block with the triangles that meet each cell. The last step collects the sets of
//! the sampled block.

use rayon::prelude::*;
use sightline_scene::{Aabb, overlap};
use sightline_trace::LineScene;
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::sight::SightLineTracer;
use sightline_viewcells::CellBox;

use super::block::{Block, BlockInputs};
use crate::context::{JobContext, Watcher};

/// The inputs of a tile's sampling: the job, the scene's facts, the tracer and the watcher.
pub struct TileSampling<'a> {
    pub job: &'a JobContext<'a>,
    pub scene: LineScene<'a>,
    pub sight: &'a SightLineTracer<'a>,
    pub watcher: &'a dyn Watcher,
    /// The pairs of cells that see each other; `None` if the job does not request pairs.
    pub pairs: Option<&'a Pairs>,
}

impl TileSampling<'_> {
    /// Creates a block with `cells` cells along each axis of the box `within`.
    ///
    /// Each cell's set contains the triangles that meet the cell. `number` returns a number of a cell that no
    /// other cell of the job has. `parts` returns the parts of a cell that contain viewpoints.
    pub fn block(
        &self,
        within: &CellBox,
        cells: [u32; 3],
        number: impl Fn([u32; 3]) -> u64,
        parts: impl Fn([u32; 3]) -> u64,
    ) -> Block<'_> {
        let inputs = BlockInputs {
            scene: self.scene.scene,
            surface: self.scene.surface,
            rows: self.job.rows(),
            sight: self.sight,
            seed: self.job.seed,
            watcher: self.watcher,
            deadline: self.job.deadline,
            pairs: self.pairs,
            region: self.job.region,
            crew: self.job.crew,
            observer: None,
        };
        let (min, max) = within.world(&self.job.lattice);
        let mut block = Block::new(inputs, CellGrid::new(min, max, cells), number, parts);
        meeting(self, within, &block);
        block.publish();
        block
    }
}

/// Credits every cell C with I(C): the triangles that show and meet the part of C with viewpoints.
///
/// The tests of intersection are exact.
fn meeting(sampling: &TileSampling<'_>, within: &CellBox, block: &Block<'_>) {
    let grid = block.grid();
    let cells = grid.cells();
    let planes: [Vec<f32>; 3] = std::array::from_fn(|a| {
        let step = (within.hi[a] - within.lo[a]) / cells[a];
        (0..=cells[a])
            .map(|k| sampling.job.lattice.coordinate(a, within.lo[a] + k * step))
            .collect()
    });
    sampling
        .scene
        .shown
        .par_iter()
        .with_min_len(1024)
        .for_each(|&id| {
            let triangle = &sampling.scene.scene.triangles()[id as usize];
            let bounds = triangle.bounds();
            // The cells whose closed slab the bounds touch, along each axis.
            let range = |a: usize| {
                let from = planes[a][1..].partition_point(|p| *p < bounds.min[a]) as u32;
                let to =
                    planes[a][..cells[a] as usize].partition_point(|p| *p <= bounds.max[a]) as u32;
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
                        let cell = Aabb {
                            min: corner(at),
                            max: corner(at.map(|c| c + 1)),
                        };
                        let meets = || {
                            let region = sampling.job.region;
                            region.is_none_or(|region| region.touch(triangle.v, cell))
                        };
                        if overlap::triangle_touches_box(triangle, &cell) && meets() {
                            let slot = grid.slot(at);
                            block.table.credit_one(id, slot);
                        }
                    }
                }
            }
        });
}

/// Merges the rows of duplicate triangles, and of items that share a triangle, because they are seen
/// together.
pub fn share(sampling: &TileSampling<'_>, block: &mut Block<'_>) {
    let rows = sampling.job.rows();
    if rows.of_triangles().is_empty() {
        block.bits_mut().share(sampling.scene.duplicates);
        if rows.are_finer() {
            block.bits_mut().to_items(rows.members());
        }
    } else {
        block.bits_mut().share_rows(rows.items(), rows.shared());
    }
}
