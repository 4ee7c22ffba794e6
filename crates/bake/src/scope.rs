//! The cells of a tile, with the facts about them that sampling and exact queries need.
//!
//! A tile of a grid or an adaptive tree has the division of its job. Each box of a tree is a separate grid of
//! one cell. Boxes are open: a wall in a face blocks ([`sightline_portals::OpenFaces`]). Rays keep a distance
//! from these walls ([`sightline_portals::open_box()`]).

use std::sync::Arc;

use sightline_model::{PlannedJob, Visibility};
use sightline_numbers::Aabb;
use sightline_portals::open_box;
use sightline_scene::Scene;
use sightline_viewcells::division::{GAP, ROUNDING};
use sightline_viewcells::{
    Division, DivisionError, Lattice, Layout, PartMask, Plan, Tile, TileIndex,
};

use crate::outcome::{BakeError, tile_error};

/// A tile's cells, with their division, lattice and viewpoints.
pub struct TileScope {
    /// The tile in the plan of its division.
    pub tile: Tile,
    /// The division that contains the cells.
    pub division: Division,
    /// The division's lattice.
    pub lattice: Lattice,
    /// The box that the division divides, in world space.
    pub view_box: Aabb,
    /// The marked parts of the cells, which contain viewpoints; `None` for viewpoints everywhere.
    pub mask: Option<Arc<PartMask>>,
    /// The seed of the random numbers.
    pub seed: u64,
    /// True if the cell is a box whose faces are open.
    pub is_open: bool,
}

impl TileScope {
    /// Computes the scope of a tile of a job.
    ///
    /// # Errors
    /// [`BakeError::Tile`] if the plan has no tile with this number, or a box cannot be a grid of one cell.
    pub fn new(job: &PlannedJob, task: &Visibility, number: TileIndex) -> Result<Self, BakeError> {
        let tile = job.plan().tiles.get(number.at());
        let tile = tile
            .ok_or_else(|| BakeError::Tile("the plan has no tile with this number".to_owned()))?;
        let whole = Self {
            tile: tile.clone(),
            division: task.division().clone(),
            lattice: task.lattice().clone(),
            view_box: task.view_box(),
            mask: task.viewpoints().mask().cloned(),
            seed: task.seed,
            is_open: false,
        };
        match whole.division {
            Division::Tree(_) => whole.of_box().map_err(tile_error),
            Division::Grid(_) | Division::Adaptive { .. } => Ok(whole),
        }
    }

    /// Creates the scope of a box: a grid of one cell.
    fn of_box(self) -> Result<Self, DivisionError> {
        let (min, max) = self.tile.cell.world(&self.lattice);
        let number = self
            .division
            .number(&self.lattice, &self.tile.cell)
            .unwrap_or(0);
        let division = Division::Grid([1; 3]);
        let lattice = division.lattice(min, max)?;
        let mut plan = Plan::new(&division, &lattice, Layout::Blocks(1));
        Ok(Self {
            // A grid of one cell has one tile.
            tile: plan.tiles.swap_remove(0),
            mask: self
                .mask
                .map(|mask| Arc::new(PartMask::single(mask.parts(number)))),
            // Each box needs its own seed; otherwise all boxes use the same random numbers.
            seed: self
                .seed
                .wrapping_add((number as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15)),
            view_box: Aabb::new(min, max),
            division,
            lattice,
            is_open: true,
        })
    }

    /// Returns the lattice that positions rays. In an open box, rays keep a distance from the walls in the
    /// box's faces.
    ///
    /// # Errors
    /// [`DivisionError`] if the box is too thin.
    pub fn traced_lattice(&self, scene: &Scene) -> Result<Lattice, DivisionError> {
        if !self.is_open {
            return Ok(self.lattice.clone());
        }
        let Aabb { min, max } = self.view_box;
        let gap = min.abs().max(max.abs()).max_element() * f32::EPSILON * ROUNDING * GAP;
        let Aabb { min, max } = open_box(scene, self.view_box, gap);
        self.division.lattice(min, max)
    }

    /// Returns the marked parts of a cell. A bit is set for each part that contains viewpoints; all bits are
    /// set if there is no mask.
    pub fn marks(&self, cell: &sightline_viewcells::CellBox) -> u64 {
        let number = self.division.number(&self.lattice, cell);
        match (&self.mask, number) {
            (Some(mask), Some(number)) => mask.parts(number),
            _ => u64::MAX,
        }
    }
}
