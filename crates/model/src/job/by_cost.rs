//! Cells by cost: the limit and the cost by which a job chooses its view cells among the boxes of its grid.

use sightline_proto::v1;
use sightline_viewcells::cheapest::FineGrid;

use super::names::CellCost;
use super::numbers::{ByteCount, CellCount};
use super::{FieldValue, SpecError};

/// A limit on the view cells of a division.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CellBudget {
    /// The maximum number of cells with viewpoints.
    Cells(CellCount),
    /// The maximum sum of the sizes of the cells' sets, each coded separately, in bytes.
    Bytes(ByteCount),
}

/// The choice of view cells by their cost. The cells are the leaves of a kd-tree over the planes of a fine
/// grid, with the least expected set for a budget ([`sightline_viewcells::cheapest`]).
#[derive(Clone, Debug, PartialEq)]
pub struct CellsByCost {
    budget: CellBudget,
    cost: CellCost,
    weights: Vec<u32>,
}

impl CellsByCost {
    /// Creates a choice in which the weight of a fine cell is the number of its parts that contain
    /// viewpoints.
    pub fn new(budget: CellBudget, cost: CellCost) -> Self {
        Self {
            budget,
            cost,
            weights: Vec::new(),
        }
    }

    /// Sets the weights of the fine cells, x fastest, then y, then z. A cell without viewpoints has no weight
    /// in any case.
    ///
    /// # Errors
    /// [`SpecError`] if the sum of the weights is 0 or does not fit in 32 bits.
    pub fn with_weights(self, weights: Vec<u32>) -> Result<Self, SpecError> {
        let sum: u64 = weights.iter().map(|weight| u64::from(*weight)).sum();
        if !(1..=u64::from(u32::MAX)).contains(&sum) {
            return Err(SpecError::new(
                "viewpoints",
                "the weights of the fine cells have a sum of 0 or above 4294967295; give other weights",
            ));
        }
        Ok(Self { weights, ..self })
    }

    /// Returns the limit on the cells.
    pub fn budget(&self) -> CellBudget {
        self.budget
    }

    /// Returns the cost of a cell for a viewpoint in it.
    pub fn cost(&self) -> CellCost {
        self.cost
    }

    /// Returns the weights of the fine cells, x fastest, then y, then z. Empty if the weight of a cell is the
    /// number of its parts that contain viewpoints.
    pub fn weights(&self) -> &[u32] {
        &self.weights
    }

    /// Checks that the choice can be made over a grid with these numbers of cells.
    pub(super) fn check(&self, sides: [u32; 3]) -> Result<(), SpecError> {
        let grid = FineGrid::new(sides.map(|side| side as usize))?;
        let cells: usize = grid.cells().iter().product();
        if ![0, cells].contains(&self.weights.len()) {
            return Err(SpecError::new(
                "viewpoints",
                "the number of weights differs from the number of fine cells; give a weight for each cell",
            ));
        }
        Ok(())
    }

    pub(super) fn from_message(m: &v1::CellsByCost) -> Result<Self, SpecError> {
        let budget = match m.budget {
            Some(v1::cells_by_cost::Budget::CellBudget(cells)) => {
                CellBudget::Cells(CellCount::from_wire(cells)?)
            }
            Some(v1::cells_by_cost::Budget::ByteBudget(bytes)) => {
                CellBudget::Bytes(ByteCount::from_wire(bytes)?)
            }
            None => {
                return Err(SpecError::new(
                    CellCount::OPTION,
                    "cells by cost need a number of cells or of bytes; give one of them",
                ));
            }
        };
        let cost = m
            .cell_cost
            .map_or(Ok(CellCost::default()), CellCost::from_wire)?;
        let choice = Self::new(budget, cost);
        let (weights, rest) = m.weights.as_chunks::<4>();
        if !rest.is_empty() {
            return Err(SpecError::new(
                "viewpoints",
                "the weights of the fine cells do not have four bytes each; give whole numbers",
            ));
        }
        match weights {
            [] => Ok(choice),
            weights => {
                choice.with_weights(weights.iter().map(|b| u32::from_le_bytes(*b)).collect())
            }
        }
    }

    pub(super) fn to_message(&self) -> v1::CellsByCost {
        v1::CellsByCost {
            budget: Some(match self.budget {
                CellBudget::Cells(cells) => v1::cells_by_cost::Budget::CellBudget(cells.to_wire()),
                CellBudget::Bytes(bytes) => v1::cells_by_cost::Budget::ByteBudget(bytes.to_wire()),
            }),
            cell_cost: Some(self.cost.to_wire()),
            weights: self.weights.iter().flat_map(|w| w.to_le_bytes()).collect(),
        }
    }
}
