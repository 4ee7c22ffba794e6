//! The placeholder of a tile that cannot be computed, and the cells that the plan expects of a tile.

use sightline_model::{
    CellSet, CellSets, Pack, PlannedJob, SubtreeNode, Task, TileOutput, Visibility, codec,
};
use sightline_viewcells::{CellBox, Division, Lattice, Tile, TileKind};

use crate::openness;

/// Encodes the placeholder of a tile that cannot be computed. A leaf tile gets the tree of its cells with
/// empty sets, because the result lists all triangles that show for every cell of such a tile. A tile of
/// samples gets no samples.
///
/// # Errors
/// [`std::io::Error`] if compression fails.
pub fn placeholder(job: &PlannedJob, tile: &Tile) -> Result<Vec<u8>, std::io::Error> {
    let task = match &job.spec().task {
        Task::Ambient(ambient) => return openness::placeholder(ambient),
        Task::Visibility(task) => task,
    };
    let output = match tile.kind {
        TileKind::Leaf => TileOutput::Cells(empty_cells(task, tile)),
        TileKind::Face(_) | TileKind::Separator(_) => TileOutput::Pack(Pack::default()),
    };
    codec::encode(&output)
}

/// Returns the subtree below a leaf tile's cell. Returns `None` for an adaptive division, whose subtree
/// depends on the samples.
pub fn expected_nodes(task: &Visibility, tile: &Tile) -> Option<Vec<SubtreeNode>> {
    let is_known = !matches!(task.division(), Division::Adaptive { .. });
    is_known.then(|| empty_cells(task, tile).nodes)
}

/// Returns the tree of a tile's cells, with empty sets.
pub(crate) fn empty_cells(task: &Visibility, tile: &Tile) -> CellSets {
    let mut sets = CellSets::default();
    add_empty_cells(
        (task.division(), task.lattice()),
        &tile.cell,
        tile.depth,
        &mut sets,
    );
    sets
}

fn add_empty_cells(space: (&Division, &Lattice), cell: &CellBox, depth: u32, out: &mut CellSets) {
    let (division, lattice) = space;
    let is_known = !matches!(division, Division::Adaptive { .. });
    match division.split(lattice, cell, depth).filter(|_| is_known) {
        Some(split) => {
            out.nodes.push(SubtreeNode::Split(split));
            for child in cell.children(split) {
                add_empty_cells(space, &child, depth + 1, out);
            }
        }
        None => {
            out.nodes.push(SubtreeNode::Cell);
            out.cells.push(CellSet::default());
        }
    }
}
