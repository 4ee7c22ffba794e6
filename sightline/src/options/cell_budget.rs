//! The options of cells by cost: view cells with a small expected set for a budget.

use serde::{Deserialize, Serialize};
use sightline_model::numbers::{ByteCount, CellCount};
use sightline_model::{CellBudget, CellCost, CellsByCost};

use super::byte_size::ByteSize;
use crate::error::Error;

/// The options of cells by cost. The view cells are the leaves of a kd-tree over the planes of a fine grid.
/// The set of a leaf is the union of the sets of its fine cells.
///
/// ```
/// use sightline::{CellBudgetOptions, JobOptions};
///
/// let by_cost = CellBudgetOptions { cell_budget: Some(64), ..Default::default() };
/// let options = JobOptions { by_cost, ..Default::default() };
/// assert_eq!(serde_json::to_value(options).unwrap()["cell_budget"], 64);
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::Args))]
#[cfg_attr(feature = "clap", command(next_help_heading = "Cells by cost"))]
#[serde(default)]
pub struct CellBudgetOptions {
    /// At most M view cells with viewpoints, in place of --cells: boxes of cells of a fine grid, chosen for a
    /// small expected set. The expected set is the mean size of the set over all viewpoints, with the weights
    /// of --viewpoints. Cells without viewpoints do not count. --viewpoints needs --reach.
    #[cfg_attr(feature = "clap", arg(long, value_name = "M"))]
    #[cfg_attr(feature = "clap", arg(value_parser = clap::value_parser!(u64).range(1..)))]
    pub cell_budget: Option<u64>,
    /// Like --cell-budget, for at most N bytes of coded sets: a number with B, kB, MB or GB. Without a unit,
    /// the number is in bytes. Each set is coded separately here; the file is usually smaller.
    #[cfg_attr(feature = "clap", arg(long, value_name = "N"))]
    #[cfg_attr(feature = "clap", arg(value_parser = super::byte_size::parse_byte_size))]
    pub byte_budget: Option<ByteSize>,
    /// The fine grid: the numbers of cells along x, y and z, at most 32 each. Default: about 4096 cells if
    /// options restrict the viewpoints. Otherwise 8 for each cell of --cell-budget, at least 512 and at most
    /// 1728, and 1728 for --byte-budget.
    #[cfg_attr(feature = "clap", arg(long, value_name = "NXxNYxNZ", value_parser = super::text::parse_grid))]
    pub fine: Option<[u32; 3]>,
    /// The cost of a cell for a viewpoint in it. Default: triangles.
    #[cfg_attr(feature = "clap", arg(long, value_parser = super::arguments::named::<CellCost>()))]
    pub cost: Option<CellCost>,
}

impl CellBudgetOptions {
    /// Returns true if a budget is given.
    pub fn is_given(&self) -> bool {
        self.cell_budget.is_some() || self.byte_budget.is_some()
    }

    /// Returns the choice of cells by cost with the weights of the fine result; `None` without a budget.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] if a budget is out of its range.
    pub fn choice(&self) -> Result<Option<CellsByCost>, Error> {
        let budget = match (self.cell_budget, self.byte_budget) {
            (Some(cells), _) => CellBudget::Cells(CellCount::new(cells)?),
            (None, Some(ByteSize(bytes))) => CellBudget::Bytes(ByteCount::new(bytes)?),
            (None, None) => return Ok(None),
        };
        Ok(Some(CellsByCost::new(
            budget,
            self.cost.unwrap_or_default(),
        )))
    }
}
