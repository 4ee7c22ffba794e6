//! The placeholder of a tile that cannot be computed, and the cells that the plan expects of a tile.

use sightline_model::{
    CellSet, CellSets, Node, Pack, PlannedJob, Task, TileOutput, Visibility, codec,
};
use sightline_viewcells::{CellBox, Division, Lattice, Tile, TileKind};

use crate::openness;

/// Encodes the placeholder of a tile: the tree of its cells with empty sets, because every cell will show
/// every triangle, including those without area. For a tile of samples: no samples.
///
/// # Errors
/// When compression fails.
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

/// Returns the subtree below a leaf tile's cell; `None` for an adaptive division, whose subtree depends on
/// the samples.
pub fn expected_nodes(task: &Visibility, tile: &Tile) -> Option<Vec<Node>> {
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

fn add_empty_cells(of: (&Division, &Lattice), cell: &CellBox, depth: u32, out: &mut CellSets) {
    let (division, lattice) = of;
    let is_known = !matches!(division, Division::Adaptive { .. });
    match division.split(lattice, cell, depth).filter(|_| is_known) {
        Some(split) => {
            out.nodes.push(Node::Split(split));
            for child in cell.children(split) {
                add_empty_cells(of, &child, depth + 1, out);
            }
        }
        None => {
            out.nodes.push(Node::Cell);
            out.cells.push(CellSet::default());
        }
    }
}
