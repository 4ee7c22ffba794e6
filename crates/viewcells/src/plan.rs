//! The plan of a bake: which tiles there are, and which need which.
//!
//! - A **face tile** samples one face of the view box.
//! - A **separator tile** samples the rectangle that splits one of the top cells of the kd-tree; everything below
//!   shares those samples.
//! - A **leaf tile** works through the subtree below, and gives the sets of its cells.
//!
//! Samplers that share nothing between tiles have **blocks** instead: leaf tiles alone, each as large as one worker should
//! hold at a time; of an adaptive tree, all below the levels that are always split.
//!
//! The plan depends on the division and the size of blocks, never on how many workers there are, and its order is the order of the
//! leaf tiles' cells in the result.

use crate::division::FORCED_DEPTH;
use crate::{CellBox, Division, Lattice, Split};

/// Leaf tiles a grid is cut into, at least, when it has that many cells: enough for tens of workers.
const LEAF_TILES: u64 = 64;
/// Most grid cells of a leaf tile, so that large jobs have tiles of minutes, not hours.
const MAX_CELLS_PER_TILE: u64 = 64;

/// Most grid cells a block may have: its memory is a bit a cell and triangle, twice.
pub const MOST_BLOCK_CELLS: u32 = 512;

/// How a job is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Faces, separators and leaves that share samples on their borders.
    Samples,
    /// Blocks of at most so many cells that share nothing. Lines are shared by all cells they cross in a block, so larger
    /// ones cost less in all, but fewer workers find one (docs/decisions/0005-sight-lines.md).
    Blocks(u32),
}

/// A node of the kd-tree above the leaf tiles, in preorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outline {
    /// Its two children follow, the one below the plane first.
    Split(Split),
    /// The subtree of a leaf tile.
    Leaf(u32),
}

/// What a tile does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileKind {
    /// Samples face `0..6` of the view box.
    Face(usize),
    /// Samples the rectangle that splits its cell.
    Separator(Split),
    /// Gives the sets of all leaf cells in its cell.
    Leaf,
}

/// One unit of work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tile {
    /// What it does.
    pub kind: TileKind,
    /// The cell it belongs to (the view box for a face tile).
    pub cell: CellBox,
    /// The cell's depth in the kd-tree.
    pub depth: u32,
    /// Tiles whose packs it reads, ascending; all are before it in the plan.
    pub needs: Vec<u32>,
    /// Leaf cells below it when the division is a grid, 1 when that is not known yet, 0 for other kinds.
    pub cells: u64,
}

/// All tiles, in an order in which every tile comes after those it needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The tiles; index = tile number.
    pub tiles: Vec<Tile>,
    /// The tree above the leaf tiles.
    pub outline: Vec<Outline>,
}

impl Plan {
    /// The plan for a division.
    pub fn new(division: &Division, lattice: &Lattice, layout: Layout) -> Self {
        let root = division.root(lattice);
        let mut plan = Self { tiles: Vec::new(), outline: Vec::new() };
        if let Layout::Blocks(most) = layout {
            plan.add_blocks(division, lattice, root, 0, u64::from(most));
            return plan;
        }
        for f in 0..6 {
            plan.tiles.push(Tile {
                kind: TileKind::Face(f),
                cell: root,
                depth: 0,
                needs: Vec::new(),
                cells: 0,
            });
        }
        let total = grid_cells(division, &root);
        let most = (total / LEAF_TILES).clamp(1, MAX_CELLS_PER_TILE);
        plan.add(division, lattice, root, 0, &mut Vec::new(), most);
        plan
    }

    fn add(
        &mut self,
        division: &Division,
        lattice: &Lattice,
        cell: CellBox,
        depth: u32,
        above: &mut Vec<u32>,
        most: u64,
    ) {
        let cells = grid_cells(division, &cell);
        let cut_here = match division {
            Division::Grid(_) => cells > most,
            Division::Adaptive { .. } => depth < FORCED_DEPTH,
        };
        // Only what touches the cell's surface can hold samples on it.
        let root_face = |f: usize| self.tiles[f].cell.face(f);
        let mut needs: Vec<u32> = (0..6)
            .filter(|&f| cell.face(f).at == root_face(f).at)
            .map(|f| f as u32)
            .chain(above.iter().copied().filter(|&t| match self.tiles[t as usize].kind {
                TileKind::Separator(s) => cell.lo[s.axis] == s.at || cell.hi[s.axis] == s.at,
                TileKind::Face(_) | TileKind::Leaf => false,
            }))
            .collect();
        needs.sort_unstable();
        match division.split(lattice, &cell, depth).filter(|_| cut_here) {
            Some(split) => {
                let number = self.tiles.len() as u32;
                self.outline.push(Outline::Split(split));
                self.tiles.push(Tile { kind: TileKind::Separator(split), cell, depth, needs, cells: 0 });
                above.push(number);
                for child in cell.children(split) {
                    self.add(division, lattice, child, depth + 1, above, most);
                }
                above.pop();
            }
            None => {
                self.outline.push(Outline::Leaf(self.tiles.len() as u32));
                self.tiles.push(Tile { kind: TileKind::Leaf, cell, depth, needs, cells });
            }
        }
    }

    fn add_blocks(&mut self, division: &Division, lattice: &Lattice, cell: CellBox, depth: u32, most: u64) {
        let cells = grid_cells(division, &cell);
        let cut_here = match division {
            Division::Grid(_) => cells > most,
            Division::Adaptive { .. } => depth < FORCED_DEPTH,
        };
        match division.split(lattice, &cell, depth).filter(|_| cut_here) {
            Some(split) => {
                self.outline.push(Outline::Split(split));
                for child in cell.children(split) {
                    self.add_blocks(division, lattice, child, depth + 1, most);
                }
            }
            None => {
                self.outline.push(Outline::Leaf(self.tiles.len() as u32));
                self.tiles.push(Tile { kind: TileKind::Leaf, cell, depth, needs: Vec::new(), cells });
            }
        }
    }

    /// Numbers of the leaf tiles, in the order of their cells.
    pub fn leaves(&self) -> impl Iterator<Item = u32> + '_ {
        self.tiles.iter().enumerate().filter(|(_, t)| t.kind == TileKind::Leaf).map(|(i, _)| i as u32)
    }
}

/// Grid cells in a box; 1 for an adaptive division, whose number is not known before it is baked.
fn grid_cells(division: &Division, cell: &CellBox) -> u64 {
    match division {
        Division::Grid(_) => {
            (0..3).map(|a| u64::from((cell.hi[a] - cell.lo[a]) / crate::UNITS_PER_CELL)).product()
        }
        Division::Adaptive { .. } => 1,
    }
}
