//! The first and the last step of a leaf tile: a block with the triangles that meet each cell, and the sets
//! of the sampled block.

use rayon::prelude::*;
use sightline_scene::{Aabb, overlap};
use sightline_trace::LineScene;
use sightline_trace::lines::grid::CellGrid;
use sightline_trace::lines::pairs::Pairs;
use sightline_trace::sight::SightLineTracer;
use sightline_viewcells::CellBox;

use super::block::{Block, Tools};
use crate::context::{JobContext, Watcher};

/// The inputs of a tile's sampling: the job, the scene's facts, the tracer and the watcher.
pub struct Work<'a> {
    pub job: &'a JobContext<'a>,
    pub scene: LineScene<'a>,
    pub sight: &'a SightLineTracer<'a>,
    pub watcher: &'a dyn Watcher,
    /// Which cells see which; `None` when the job does not ask.
    pub pairs: Option<&'a Pairs>,
}

impl Work<'_> {
    /// A block with `cells` cells along each axis of the box `within`. Each cell's set holds the triangles
    /// that meet it. `number` gives each cell a number that no other cell of the job has.
    /// `parts` gives the parts of each cell that hold viewpoints.
    pub fn block(
        &self,
        within: &CellBox,
        cells: [u32; 3],
        number: impl Fn([u32; 3]) -> u64,
        parts: impl Fn([u32; 3]) -> u64,
    ) -> Block<'_> {
        let tools = Tools {
            scene: self.scene.scene,
            surface: self.scene.surface,
            rows: self.job.rows(),
            sight: self.sight,
            seed: self.job.seed,
            watcher: self.watcher,
            deadline: self.job.deadline,
            pairs: self.pairs,
            places: self.job.places,
            crew: self.job.crew,
            ledger: None,
        };
        let (min, max) = within.world(&self.job.lattice);
        let mut block = Block::new(tools, CellGrid::new(min, max, cells), number, parts);
        meeting(self, within, &block);
        block.publish();
        block
    }
}

/// Credits every cell with the triangles that meet it where viewpoints are, I(C), decided exactly.
fn meeting(work: &Work<'_>, within: &CellBox, block: &Block<'_>) {
    let grid = block.grid();
    let cells = grid.cells();
    let planes: [Vec<f32>; 3] = std::array::from_fn(|a| {
        let step = (within.hi[a] - within.lo[a]) / cells[a];
        (0..=cells[a])
            .map(|k| work.job.lattice.coordinate(a, within.lo[a] + k * step))
            .collect()
    });
    work.scene
        .shown
        .par_iter()
        .with_min_len(1024)
        .for_each(|&id| {
            let triangle = &work.scene.scene.triangles()[id as usize];
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
                            let places = work.job.places;
                            places.is_none_or(|places| places.touch(triangle.v, cell))
                        };
                        if overlap::triangle_touches_box(triangle, &cell) && meets() {
                            let slot = grid.slot(at);
                            block.credit_one(id, slot);
                        }
                    }
                }
            }
        });
}

/// Returns the triangles seen from each cell, ascending; indexed by
/// [`sightline_trace::lines::grid::Slot::index`].
pub fn columns(block: &Block<'_>) -> Vec<Vec<u32>> {
    let words = block.grid().words() as u32;
    (0..words)
        .into_par_iter()
        .flat_map_iter(|w| block.bits().columns(w))
        .collect()
}

/// Gives triangles that are seen together the union of their rows: duplicates, and the items that share one.
pub fn share(work: &Work<'_>, block: &mut Block<'_>) {
    let rows = work.job.rows();
    if rows.of_triangles().is_empty() {
        block.bits_mut().share(work.scene.duplicates);
        if rows.are_finer() {
            block.bits_mut().to_items(rows.members());
        }
    } else {
        block.bits_mut().share_rows(rows.items(), rows.shared());
    }
}
