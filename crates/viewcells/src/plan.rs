//! The plan of a bake: its tiles, and the tiles whose samples each tile needs.
//!
//! - A **face tile** samples one face of the view box.
//! - A **separator tile** samples the rectangle that splits one of the top cells of the kd-tree. All cells
//!   below this cell share these samples.
//! - A **leaf tile** computes the sets of all cells in a subtree of the kd-tree.
//!
//! For samplers that do not share samples between tiles, the plan has **blocks** instead. Blocks are leaf
//! tiles of a size that fits in a worker's memory. In an adaptive tree, a block is a subtree below the levels
//! that are always split.
//!
//! The plan depends on the division and the size of blocks, and not on the number of workers. The order of
//! the leaf tiles' cells is their order in the result.

use crate::division::FORCED_DEPTH;
use crate::{CellBox, Division, Lattice, Split};

/// The minimum number of leaf tiles of a grid with at least as many cells: enough for tens of workers.
const LEAF_TILES: u64 = 64;
/// The maximum number of grid cells of a leaf tile, so that tiles of large jobs need minutes and not hours.
const MAX_CELLS_PER_TILE: u64 = 64;

/// The maximum number of grid cells of a block. A block needs two bits of memory per pair of a cell and a
/// triangle.
pub const MOST_BLOCK_CELLS: u32 = 4096;
/// The default number of grid cells of a block.
pub const USUAL_BLOCK_CELLS: u32 = 512;

/// The strategy for the division of a job into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Faces, separators and leaves that share samples on their borders.
    Samples,
    /// Blocks of at most this number of cells. Blocks share no data. All cells of a block share the lines
    /// that cross these cells, so larger blocks cost less work in total but occupy fewer workers
    /// (docs/decisions/0005-sight-lines.md).
    Blocks(u32),
}

/// A node of the kd-tree above the leaf tiles, in preorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outline {
    /// A split node. The subtrees of its lower and then of its upper child follow.
    Split(Split),
    /// The subtree of the leaf tile with this index.
    Leaf(u32),
}

/// The work of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileKind {
    /// The tile samples face `0..6` of the view box.
    Face(usize),
    /// The tile samples the rectangle that splits its cell.
    Separator(Split),
    /// The tile computes the sets of all leaf cells in its cell.
    Leaf,
}

/// A tile: one unit of work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tile {
    /// The kind of work.
    pub kind: TileKind,
    /// The cell of the tile (the view box for a face tile).
    pub cell: CellBox,
    /// The depth of the cell in the kd-tree.
    pub depth: u32,
    /// The indices of the tiles whose packs this tile reads, ascending. All these tiles precede this tile in
    /// the plan.
    pub needs: Vec<u32>,
    /// The number of cells of a leaf tile, or 0 for other tiles. The value is 1 for a box of a tree, and in
    /// an adaptive tree, whose cells are unknown before the bake. [`Plan::of_counts`] stores numbers of
    /// items.
    pub cells: u64,
}

/// All tiles of a bake. Each tile follows the tiles that it needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The tiles, by tile index.
    pub tiles: Vec<Tile>,
    /// The kd-tree above the leaf tiles, in preorder.
    pub outline: Vec<Outline>,
}

impl Plan {
    /// Creates the plan for a division.
    pub fn new(division: &Division, lattice: &Lattice, layout: Layout) -> Self {
        let root = division.root(lattice);
        let mut plan = Self {
            tiles: Vec::new(),
            outline: Vec::new(),
        };
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
        let cut_here = is_cut(division, cells > most, depth);
        // Only faces and separators that touch the cell's surface can have samples on this surface.
        let root_face = |f: usize| self.tiles[f].cell.face(f);
        let mut needs: Vec<u32> = (0..6)
            .filter(|&f| cell.face(f).at == root_face(f).at)
            .map(|f| f as u32)
            .chain(
                above
                    .iter()
                    .copied()
                    .filter(|&t| match self.tiles[t as usize].kind {
                        TileKind::Separator(s) => {
                            cell.lo[s.axis] == s.at || cell.hi[s.axis] == s.at
                        }
                        TileKind::Face(_) | TileKind::Leaf => false,
                    }),
            )
            .collect();
        needs.sort_unstable();
        match division.split(lattice, &cell, depth).filter(|_| cut_here) {
            Some(split) => {
                let number = self.tiles.len() as u32;
                self.outline.push(Outline::Split(split));
                self.tiles.push(Tile {
                    kind: TileKind::Separator(split),
                    cell,
                    depth,
                    needs,
                    cells: 0,
                });
                above.push(number);
                for child in cell.children(split) {
                    self.add(division, lattice, child, depth + 1, above, most);
                }
                above.pop();
            }
            None => {
                self.outline.push(Outline::Leaf(self.tiles.len() as u32));
                self.tiles.push(Tile {
                    kind: TileKind::Leaf,
                    cell,
                    depth,
                    needs,
                    cells,
                });
            }
        }
    }

    fn add_blocks(
        &mut self,
        division: &Division,
        lattice: &Lattice,
        cell: CellBox,
        depth: u32,
        most: u64,
    ) {
        let cells = grid_cells(division, &cell);
        let cut_here = is_cut(division, cells > most, depth);
        match division.split(lattice, &cell, depth).filter(|_| cut_here) {
            Some(split) => {
                self.outline.push(Outline::Split(split));
                for child in cell.children(split) {
                    self.add_blocks(division, lattice, child, depth + 1, most);
                }
            }
            None => {
                self.outline.push(Outline::Leaf(self.tiles.len() as u32));
                self.tiles.push(Tile {
                    kind: TileKind::Leaf,
                    cell,
                    depth,
                    needs: Vec::new(),
                    cells,
                });
            }
        }
    }

    /// Creates a plan without a division. Each tile computes one of the given numbers of items, all within
    /// `cell`, and needs no other tile.
    pub fn of_counts(cell: CellBox, counts: impl Iterator<Item = u64>) -> Self {
        let tile = |cells| Tile {
            kind: TileKind::Leaf,
            cell,
            depth: 0,
            needs: Vec::new(),
            cells,
        };
        Self {
            tiles: counts.map(tile).collect(),
            outline: Vec::new(),
        }
    }

    /// Returns the indices of the leaf tiles, in the order of their cells in the result.
    pub fn leaves(&self) -> impl Iterator<Item = u32> + '_ {
        self.tiles
            .iter()
            .enumerate()
            .filter(|(_, t)| t.kind == TileKind::Leaf)
            .map(|(i, _)| i as u32)
    }
}

/// Returns true if a box is divided into several tiles. `is_larger` is true if the box has more cells than a
/// tile may have. Each undivided box of a tree is a tile, because boxes of different sizes share few lines.
fn is_cut(division: &Division, is_larger: bool, depth: u32) -> bool {
    match division {
        Division::Grid(_) => is_larger,
        Division::Adaptive { .. } => depth < FORCED_DEPTH,
        Division::Tree(_) => true,
    }
}

/// Returns the number of grid cells in a box, or 1 for other divisions.
fn grid_cells(division: &Division, cell: &CellBox) -> u64 {
    match division {
        Division::Grid(_) => (0..3)
            .map(|a| u64::from((cell.hi[a] - cell.lo[a]) / crate::UNITS_PER_CELL))
            .product(),
        Division::Adaptive { .. } | Division::Tree(_) => 1,
    }
}
