//! Results with cells by cost: the choice of boxes of fine cells, and the unions of their sets.
//!
//! The result of the fine grid is complete before the choice, so the choice works in the same way for every
//! method, and for a result that an earlier bake wrote.

use std::io::Write;

use rayon::prelude::*;
use serde_json::{Map, Value, json};
use sightline_model::statistics::VIEWPOINT_WEIGHT;
use sightline_model::{CellBudget, CellsByCost, NamedValue as _};
use sightline_pvs::{
    Builder, Cell, CellPairs, CellTree, Column, Header, NOT_REACHED, Node, Pvs, PvsError, Relation,
    SET_ASIDE, runs,
};
use sightline_viewcells::cheapest::{FineBox, FineNode};

use crate::fine_sets::{FineSets, FineSetsError, leaves, set_bits};

/// The number of cells whose sets are in memory at once.
const BATCH: usize = 256;

/// The outcome of a choice of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChosenCells {
    /// The length of the file, in bytes.
    pub file_bytes: u64,
    /// The least size of a division, if every division is larger than the budget. The result then has the
    /// smallest division.
    pub least: Option<u64>,
}

/// Writes the result of the cells by cost of a fine result. `origin` is the digest of the fine result as
/// text, if an earlier bake wrote it.
///
/// # Errors
/// [`FineSetsError`] if the cells of the fine result are not a grid, are too many or have no viewpoints, or
/// if a result cannot be read or written.
pub fn write_cells_by_cost(
    fine: &Pvs,
    choice: &CellsByCost,
    most_bytes: u64,
    origin: Option<&str>,
    out: &mut impl Write,
) -> Result<ChosenCells, FineSetsError> {
    let sets = FineSets::read(fine, choice.cost(), choice.weights(), most_bytes)?;
    let costs = sets.costs(choice.budget(), &|| false)?;
    let (tree, least) = match costs.within_budget() {
        Ok(tree) => (tree, None),
        Err(least) => (costs.smallest(), Some(least)),
    };
    let leaves = leaves(&tree);
    let node = |node: &FineNode| match *node {
        FineNode::Split { axis, at } => Node::Split {
            axis: axis as u8,
            at: sets.plane(axis, at),
        },
        FineNode::Leaf(_) => Node::Leaf,
    };
    let nodes = tree.nodes.iter().map(node).collect();
    let mut info = match serde_json::from_str(fine.info_json()) {
        Ok(Value::Object(info)) => info,
        // Another program may have written the fine result.
        _ => Map::from_iter([("fine_info".to_owned(), fine.info_json().into())]),
    };
    info.insert(
        "cells_by_cost".to_owned(),
        json!({
            "fine": sets.grid().cells(),
            "budget": match choice.budget() {
                CellBudget::Cells(cells) => json!({"cells": cells.get()}),
                CellBudget::Bytes(bytes) => json!({"bytes": bytes.get()}),
            },
            "cost": choice.cost().name(),
            "grid": sets.division(&sets.cells()),
            "chosen": sets.division(&leaves),
            "is_within_budget": least.is_none(),
            "hull": sets.hull(&costs),
        }),
    );
    if let Some(digest) = origin {
        info.insert("from".to_owned(), digest.into());
    }
    let mut builder = Builder::new(Header {
        triangles: fine.triangle_count(),
        method: fine.method().to_owned(),
        tree: CellTree::new(fine.tree().view_box(), nodes)?,
        objects: fine.objects().to_vec(),
        info_json: Value::Object(info).to_string(),
    })?;
    builder.set_scene_parts(fine.scene_parts())?;
    for leaves in leaves.chunks(BATCH) {
        let unions: Vec<CellUnion> = leaves
            .par_iter()
            .map(|leaf| union(fine, &sets, *leaf))
            .collect::<Result<_, _>>()?;
        let cells: Vec<Cell<'_>> = unions.iter().map(CellUnion::cell).collect();
        builder.push_cells(&cells)?;
    }
    builder.set_columns(columns(fine, &sets, &leaves)?)?;
    if let Some(pairs) = fine.cell_pairs()? {
        builder.set_pairs(&joined_pairs(pairs, &sets, &leaves)?)?;
    }
    Ok(ChosenCells {
        file_bytes: builder.finish(out)?.file_bytes,
        least,
    })
}

/// The set of a box of fine cells.
struct CellUnion {
    visible: Vec<u32>,
    undecided: Vec<u32>,
    flags: u32,
}

impl CellUnion {
    fn cell(&self) -> Cell<'_> {
        Cell {
            visible: &self.visible,
            undecided: &self.undecided,
            flags: self.flags,
        }
    }
}

/// Returns the union of the sets of a box. An item is undecided if no fine cell saw it. If a cell of the box
/// was set aside, the box is set aside, and all items of its set are undecided.
fn union(fine: &Pvs, sets: &FineSets, of_cells: FineBox) -> Result<CellUnion, PvsError> {
    let words = (fine.item_count() as usize).div_ceil(64);
    let [mut visible, mut seen] = [(); 2].map(|()| vec![0u64; words]);
    let [mut own, mut own_open] = [(); 2].map(|()| vec![0u64; words]);
    let (mut flags, mut items, mut open) = (NOT_REACHED, Vec::new(), Vec::new());
    for cell in sets.reached_cells(of_cells) {
        fine.visible_items(cell, &mut items)?;
        fine.undecided_items(cell, &mut open)?;
        own.fill(0);
        set_bits(&mut own, &items);
        own_open.fill(0);
        set_bits(&mut own_open, &open);
        for (at, word) in own.iter().enumerate() {
            visible[at] |= word;
            seen[at] |= word & !own_open[at];
        }
        if flags == NOT_REACHED {
            flags = 0;
        }
        if fine.is_set_aside(cell)? {
            flags = SET_ASIDE;
        }
    }
    if flags == SET_ASIDE {
        seen.fill(0);
    }
    let unseen: Vec<u64> = visible.iter().zip(&seen).map(|(v, s)| v & !s).collect();
    Ok(CellUnion {
        visible: ids(&visible),
        undecided: ids(&unseen),
        flags,
    })
}

/// Returns the items of a row of bits, ascending.
fn ids(bits: &[u64]) -> Vec<u32> {
    let bounds = runs::from_bits(bits);
    bounds
        .chunks_exact(2)
        .flat_map(|run| run[0]..run[1])
        .collect()
}

/// Returns the columns of the boxes: the sums or the maxima over their cells, without bounds, which hold only
/// for the fine cells.
fn columns(fine: &Pvs, sets: &FineSets, leaves: &[FineBox]) -> Result<Vec<Column>, PvsError> {
    let mut joined = Vec::new();
    for column in fine.columns()? {
        if column.name.starts_with("bound_") || column.name == VIEWPOINT_WEIGHT {
            continue;
        }
        let join: fn(u64, u64) -> u64 = match column.name.as_str() {
            "rounds" | "unfinished" | "spared" | "exact_vectors" => u64::max,
            _ => u64::saturating_add,
        };
        let value = |leaf: &FineBox| {
            let values = sets
                .all_cells(*leaf)
                .map(|cell| column.values[cell as usize]);
            values.fold(0, join)
        };
        joined.push(Column {
            values: leaves.iter().map(value).collect(),
            name: column.name,
        });
    }
    joined.push(Column {
        name: VIEWPOINT_WEIGHT.to_owned(),
        values: leaves.iter().map(|leaf| sets.weight(*leaf)).collect(),
    });
    Ok(joined)
}

/// Returns the relations between the boxes. Two boxes see each other if a cell of one sees a cell of the
/// other.
fn joined_pairs(
    pairs: &CellPairs,
    sets: &FineSets,
    leaves: &[FineBox],
) -> Result<CellPairs, PvsError> {
    let count = leaves.len() as u32;
    let (mut visible, mut undecided) = (Relation::empty(count)?, Relation::empty(count)?);
    let cells: Vec<Vec<u32>> = leaves
        .iter()
        .map(|leaf| sets.all_cells(*leaf).collect())
        .collect();
    let sees = |row: &[u64], other: &[u32]| {
        other
            .iter()
            .any(|cell| row[*cell as usize / 64] >> (cell % 64) & 1 == 1)
    };
    for (a, own) in cells.iter().enumerate() {
        let mut drawn = vec![0u64; pairs.visible.row(0).len()];
        let mut seen = drawn.clone();
        for cell in own {
            let open = pairs.undecided.as_ref().map(|open| open.row(*cell));
            for (at, word) in pairs.visible.row(*cell).iter().enumerate() {
                drawn[at] |= word;
                seen[at] |= word & !open.map_or(0, |open| open[at]);
            }
        }
        for (b, other) in cells.iter().enumerate().skip(a) {
            if a == b || sees(&drawn, other) {
                visible.insert(a as u32, b as u32);
                if a != b && !sees(&seen, other) {
                    undecided.insert(a as u32, b as u32);
                }
            }
        }
    }
    Ok(CellPairs {
        visible,
        undecided: Some(undecided).filter(|open| open.pairs() > 0),
    })
}
