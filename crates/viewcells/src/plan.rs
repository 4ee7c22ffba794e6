//! The plan of a bake: its tiles, and the tiles whose samples each tile needs.
//!
//! - A **face tile** samples one face of the view box.
//! - A **separator tile** samples the rectangle that splits one of the top cells of the kd-tree; all cells
//!   below share these samples.
//! - A **leaf tile** processes the subtree below and yields the sets of its cells.
//!
//! For samplers that share nothing between tiles, the plan has **blocks** instead: leaf tiles only, each of a
//! size that a worker holds at a time. In an adaptive tree a block is a subtree below the levels that are
//! always split.
//!
//! The plan depends on the division and the size of blocks and not on the number of workers. Its order is the
//! order of the leaf tiles' cells in the result.

use crate::division::FORCED_DEPTH;
use crate::{CellBox, Division, Lattice, Split};

/// Least number of leaf tiles of a grid with at least as many cells: enough for tens of workers.
const LEAF_TILES: u64 = 64;
/// Most grid cells of a leaf tile, so that large jobs have tiles of minutes, not hours.
const MAX_CELLS_PER_TILE: u64 = 64;

/// Most grid cells of a block, which takes two bits of memory for each pair of a cell and a triangle.
pub const MOST_BLOCK_CELLS: u32 = 4096;
/// Grid cells of a block unless a job says otherwise.
pub const USUAL_BLOCK_CELLS: u32 = 512;

/// How a job is divided into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Faces, separators and leaves that share samples on their borders.
    Samples,
    /// Blocks of at most this number of cells that share nothing. All cells of a block share the lines that
    /// cross them, so larger blocks cost less work in total but occupy fewer workers
    /// (docs/decisions/0005-sight-lines.md).
    Blocks(u32),
}

/// A node of the kd-tree above the leaf tiles, in preorder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outline {
    /// A split node; its two children follow, the lower one first.
    Split(Split),
    /// The subtree of the leaf tile with this number.
    Leaf(u32),
}

/// The work of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileKind {
    /// Samples face `0..6` of the view box.
    Face(usize),
    /// Samples the rectangle that splits its cell.
    Separator(Split),
    /// Yields the sets of all leaf cells in its cell.
    Leaf,
}

/// One unit of work.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tile {
    /// The work.
    pub kind: TileKind,
    /// The cell it belongs to (the view box for a face tile).
    pub cell: CellBox,
    /// The cell's depth in the kd-tree.
    pub depth: u32,
    /// Numbers of the tiles whose packs it reads, ascending; all come before it in the plan.
    pub needs: Vec<u32>,
    /// The number of its leaf cells in a grid, 1 in an adaptive tree, where it is not known yet; 0 for other
    /// kinds.
    pub cells: u64,
}

/// All tiles, each after the tiles that it needs.
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
        // Only rectangles that touch the cell's surface can have samples on it.
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

    /// A plan without a division: each tile has a number of things that are computed one by one, within
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

    /// Numbers of the leaf tiles, in the order of their cells.
    pub fn leaves(&self) -> impl Iterator<Item = u32> + '_ {
        self.tiles
            .iter()
            .enumerate()
            .filter(|(_, t)| t.kind == TileKind::Leaf)
            .map(|(i, _)| i as u32)
    }
}

/// Whether a box with more or with less cells than a tile is divided into tiles. Each box of a tree is a
/// tile: boxes of any size share few lines.
fn is_cut(division: &Division, is_larger: bool, depth: u32) -> bool {
    match division {
        Division::Grid(_) => is_larger,
        Division::Adaptive { .. } => depth < FORCED_DEPTH,
        Division::Tree(_) => true,
    }
}

/// The number of grid cells in a box; 1 for other divisions.
fn grid_cells(division: &Division, cell: &CellBox) -> u64 {
    match division {
        Division::Grid(_) => (0..3)
            .map(|a| u64::from((cell.hi[a] - cell.lo[a]) / crate::UNITS_PER_CELL))
            .product(),
        Division::Adaptive { .. } | Division::Tree(_) => 1,
    }
}
