//! The assembly of a job's leaf tiles into a result: one tree, one visible set per cell, one `.pvs` file.
//!
//! Tiles are read one at a time.

use std::io::Write;

use sightline_model::codec::{self, CodecError};
use sightline_model::{
    CellSet, CellSets, Granularity, MOST_FINE_BYTES, SubtreeNode, TileOutput, Visibility,
};
use sightline_pvs::{
    Builder, Cell, CellTree, Contribution, Header, Items, NOT_REACHED, Object, Pvs, PvsError,
    SET_ASIDE, Source,
};
use sightline_scene::clusters::clusters;
use sightline_scene::{Scene, TriangleId};
use sightline_viewcells::{CellBox, Division, Lattice, Outline, TileIndex};

use crate::cells_by_cost::write_cells_by_cost;
use crate::check::SceneSize;
use crate::columns::Statistics;
use crate::fine_sets::FineSetsError;
use crate::info::info;
use crate::pairs::PairJoin;
use crate::placeholder::empty_cells;
use crate::{Assembly, OutputState, Outputs, SceneSummary};

/// The error of a result that cannot be assembled.
#[derive(Debug, thiserror::Error)]
pub enum AssembleError<E> {
    /// An output cannot be read.
    #[error(transparent)]
    Read(E),
    /// A tile's output does not fit the plan.
    #[error("tile {tile}: {reason}")]
    Tile {
        /// The number of the tile.
        tile: TileIndex,
        /// The difference from the plan.
        reason: &'static str,
    },
    /// A tile's output cannot be decoded.
    #[error("tile {tile}: {error}")]
    Codec {
        /// The number of the tile.
        tile: TileIndex,
        /// The error of the decoder.
        error: CodecError,
    },
    /// The result cannot be written.
    #[error(transparent)]
    Pvs(#[from] PvsError),
    /// The cells by cost cannot be chosen.
    #[error(transparent)]
    Cells(#[from] FineSetsError),
}

/// Computes the items of the scene that the sets of a job name. Returns `None` for triangles.
pub fn items(scene: &Scene, items: Granularity) -> Option<Items> {
    match items {
        Granularity::Triangles => None,
        Granularity::Clusters => Some(Items::Clusters(clusters(scene))),
        Granularity::Objects => Some(Items::Objects {
            never: (0..scene.len())
                .filter(|t| !scene.shows(TriangleId(*t)))
                .collect(),
        }),
    }
}

/// Writes the `.pvs` file of a job of visibility and returns its length in bytes. Cells of tiles that are not
/// done or were set aside show all triangles, as undecided.
///
/// # Errors
/// [`AssembleError`] if an output cannot be read or does not fit the plan, or the result cannot be written.
pub fn write<O: Outputs>(
    input: Assembly<'_, O>,
    task: &Visibility,
    out: &mut impl Write,
) -> Result<u64, AssembleError<O::Error>> {
    let Some(choice) = task.cells_by_cost() else {
        return write_cells(input, task, out);
    };
    let mut fine = Vec::new();
    write_cells(input, task, &mut fine)?;
    let fine = Pvs::from_bytes(fine)?;
    Ok(write_cells_by_cost(&fine, choice, MOST_FINE_BYTES, None, out)?.file_bytes)
}

/// Writes the result of the cells of the plan.
fn write_cells<O: Outputs>(
    mut input: Assembly<'_, O>,
    task: &Visibility,
    out: &mut impl Write,
) -> Result<u64, AssembleError<O::Error>> {
    let scratch = input.scratch.take();
    let (plan, lattice, scene) = (input.job.plan(), task.lattice(), input.scene);
    let size = SceneSize {
        triangles: scene.triangles,
        objects: scene.objects.len() as u32,
    };
    let most = size.items(task);
    let read = |tile: TileIndex| read(&input, task, tile, most);
    // The file has the tree before the sets, so every tile is read twice, one at a time. Certificates are the
    // largest part of a tile: keeping all tiles in memory would cost more than the second reading.
    let mut nodes = Vec::new();
    // The cells of a plan's only tile, so that this tile is read once.
    let mut kept = None;
    for part in &plan.outline {
        match *part {
            Outline::Split(split) => nodes.push(pvs_node(SubtreeNode::Split(split), lattice)),
            Outline::Leaf(tile) => {
                let sets = read(TileIndex(tile))?;
                nodes.extend(sets.nodes.iter().map(|node| pvs_node(*node, lattice)));
                if plan.outline.len() == 1 {
                    kept = Some(sets);
                }
            }
        }
    }
    // The visible set of every cell of a tile that was set aside or is not done. Placeholders do not repeat
    // this set for every cell.
    let all: Vec<u32> = match &input.items {
        None => (0..scene.triangles)
            .filter(|t| scene.kinds.kind(TriangleId(*t)).shows())
            .collect(),
        Some(Items::Clusters(all)) => (0..all.len() as u32).collect(),
        Some(Items::Objects { .. }) => (0..scene.objects.len() as u32).collect(),
    };
    let tree = CellTree::new(task.view_box().corners().map(|c| c.to_array()), nodes)?;
    let cells = tree.cells();
    let mut builder = Builder::new(Header {
        triangles: scene.triangles,
        method: task.method.name().to_string(),
        tree,
        objects: objects(scene),
        info_json: info(&input, task),
    })?;
    if let Some(items) = &input.items {
        builder.set_items(items)?;
    }
    if let Some(region) = task.viewpoints().region() {
        builder.set_region(region.encode());
    }
    if let Some(file) = scratch {
        builder.keep_certificates_in(file);
    }
    let mut pairs = PairJoin::new(task, cells);
    let mut statistics = Statistics::default();
    let has_weights =
        task.viewpoints().mask().is_some() && matches!(task.division(), Division::Grid(_));
    for tile in plan.leaves().map(TileIndex) {
        let aside = input.outputs.state(tile) != OutputState::Done;
        let wrong = |reason| AssembleError::Tile { tile, reason };
        let mut sets = match kept.take() {
            Some(sets) => sets,
            None => read(tile)?,
        };
        if !sets.portals.is_empty() {
            builder.set_portals(std::mem::take(&mut sets.portals))?;
        }
        let shown = sets
            .cells
            .iter()
            .map(|cell| shown(cell, aside.then_some(&*all)));
        builder.push_cells(&shown.collect::<Vec<_>>())?;
        for cell in &sets.cells {
            if task.has_certificates() {
                let evidence = cell.decision.as_ref().map_or(&[][..], |d| &d.certificate);
                builder.push_certificate(evidence)?;
            }
            if task.has_contributions() {
                let cell_contributions =
                    contributions(cell, if aside { all.len() } else { cell.visible.len() });
                builder.push_contributions(&cell_contributions.ok_or_else(|| {
                    wrong("the numbers of contributions and of visible items of a cell differ")
                })?)?;
            }
            statistics.push(cell);
        }
        let boxes = boxes(&plan.tiles[tile.at()].cell, &sets.nodes);
        if has_weights {
            boxes
                .iter()
                .for_each(|at| statistics.push_weight(task.marks(at).count_ones()));
        }
        if let Some(join) = &mut pairs {
            if let Some(pairs) = &sets.pairs
                && !join.add_tile(pairs)
            {
                return Err(wrong(
                    "the pairs of cells are over another number of cells than the job's",
                ));
            }
            boxes
                .iter()
                .zip(&sets.cells)
                .for_each(|(at, cell)| join.add_cell(at, !cell.unreached, aside));
        }
    }
    if let Some(pairs) = &pairs {
        builder.set_pairs(&pairs.finish()?)?;
    }
    builder.set_columns(statistics.columns())?;
    Ok(builder.finish(out)?.file_bytes)
}

/// Reads the cells of a leaf tile, whose sets name at most `items` items. Cells of a tile that is not done or
/// was set aside are empty.
fn read<O: Outputs>(
    input: &Assembly<'_, O>,
    task: &Visibility,
    tile: TileIndex,
    items: u32,
) -> Result<CellSets, AssembleError<O::Error>> {
    let planned = &input.job.plan().tiles[tile.at()];
    if input.outputs.state(tile) == OutputState::Open {
        return Ok(empty_cells(task, planned));
    }
    let wrong = |reason| AssembleError::Tile { tile, reason };
    let bytes = input.outputs.read(tile).map_err(AssembleError::Read)?;
    let output =
        codec::decode(&bytes, items).map_err(|error| AssembleError::Codec { tile, error })?;
    let TileOutput::Cells(sets) = output else {
        return Err(wrong("the output contains samples in place of cells"));
    };
    // An adaptive tile counts as one cell in the plan, independent of its number of cells.
    if planned.cells > 1 && sets.cells.len() as u64 != planned.cells {
        return Err(wrong(
            "the number of cells differs from the number in the plan",
        ));
    }
    Ok(sets)
}

/// Returns the cell in the form of the file. `all` is the set of a cell of a tile without an output.
fn shown<'a>(cell: &'a CellSet, all: Option<&'a [u32]>) -> Cell<'a> {
    match all {
        // Triangles of a failed tile were neither seen nor proved hidden.
        Some(all) => Cell {
            visible: all,
            undecided: all,
            flags: SET_ASIDE,
        },
        None => Cell {
            visible: &cell.visible,
            undecided: &cell.undecided,
            flags: if cell.unreached { NOT_REACHED } else { 0 },
        },
    }
}

/// Returns the scene's objects in the form of the file.
fn objects(scene: &SceneSummary) -> Vec<Object> {
    let source = |at: usize| {
        scene.sources.get(at).map(|source| Source {
            node: source.node,
            mesh: source.mesh,
            primitive: source.primitive,
            instance: source.instance,
        })
    };
    let objects = scene.objects.iter().enumerate();
    objects
        .map(|(at, object)| Object {
            name: object.name.clone(),
            first: object.first,
            count: object.count,
            source: source(at),
        })
        .collect()
}

/// Returns the contributions of the `items` visible items of a cell. Returns `None` if the cell has counts
/// for another number of items.
fn contributions(cell: &CellSet, items: usize) -> Option<Vec<Contribution>> {
    let Some(hits) = &cell.hits else {
        // A tile that was set aside has no measurements.
        return Some(vec![Contribution::new(0.0, 0.0); items]);
    };
    let all = f64::from(hits.viewpoints) * f64::from(hits.lines);
    let to_contribution = |[hit, most]: &[u32; 2]| {
        Contribution::new(
            f64::from(*hit) / all,
            f64::from(*most) / f64::from(hits.lines),
        )
    };
    (hits.counts.len() == items).then(|| hits.counts.iter().map(to_contribution).collect())
}

/// Returns the boxes of the cells of a subtree, in preorder.
fn boxes(root: &CellBox, nodes: &[SubtreeNode]) -> Vec<CellBox> {
    let (mut boxes, mut open) = (Vec::new(), vec![*root]);
    for node in nodes {
        let Some(at) = open.pop() else { break };
        match node {
            SubtreeNode::Split(split) => {
                let [below, above] = at.children(*split);
                open.extend([above, below]);
            }
            SubtreeNode::Cell => boxes.push(at),
        }
    }
    boxes
}

fn pvs_node(node: SubtreeNode, lattice: &Lattice) -> sightline_pvs::Node {
    match node {
        SubtreeNode::Split(split) => sightline_pvs::Node::Split {
            axis: split.axis as u8,
            at: lattice.coordinate(split.axis, split.at),
        },
        SubtreeNode::Cell => sightline_pvs::Node::Leaf,
    }
}
