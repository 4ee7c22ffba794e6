//! Budgets: the limits on the content of a cell, the cells that exceed them, and the costliest objects there.

use serde::{Deserialize, Serialize};
use sightline_numbers::ids::CellIndex;
use sightline_pvs::Pvs;

use crate::costs::Costs;

/// The default size of a triangle in bytes: three corners of three floats.
const BYTES_A_TRIANGLE: u64 = 36;
/// The maximum number of objects that are named per cell.
const NAMED: usize = 8;

/// The limits on the content of a cell. An absent limit means no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// The maximum number of triangles in the set.
    pub triangles: Option<u64>,
    /// The maximum number of objects with a triangle in the set.
    pub objects: Option<u64>,
    /// The maximum size of these objects in bytes, with all of their triangles.
    pub bytes: Option<u64>,
    /// The size of a triangle in bytes. Default: 36.
    pub bytes_per_triangle: Option<u64>,
}

/// A cell that exceeds its budget, or without a budget one of the cells that draw most.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OverBudget {
    /// The index of the cell.
    pub cell: CellIndex,
    /// The box of the cell, in world space.
    pub bounds: [[f32; 3]; 2],
    /// The number of triangles in the cell's set.
    pub triangles: u64,
    /// The number of objects with a triangle in the cell's set.
    pub objects: u64,
    /// The size of these objects, in bytes.
    pub bytes: u64,
    /// The largest quotient of a cost and its limit; 0 without a budget.
    pub times: f64,
    /// The costliest objects: names, and the number of their triangles in the cell's set.
    pub costliest: Vec<(String, u32)>,
}

/// Returns all cells that exceed the budget, the largest excess first. Without a budget, returns the `most`
/// cells that draw the most triangles.
pub fn over_budget(
    pvs: &Pvs,
    costs: &Costs,
    budget: Option<&Budget>,
    most: usize,
) -> Vec<OverBudget> {
    let each = budget
        .and_then(|b| b.bytes_per_triangle)
        .unwrap_or(BYTES_A_TRIANGLE);
    let size = |group: u32| costs.groups[group as usize].triangles.len() as u64;
    let mut all = Vec::new();
    for (cell, drawn) in (0u32..).map(CellIndex).zip(&costs.cells) {
        let triangles: u64 = drawn.iter().map(|(_, count)| u64::from(*count)).sum();
        let objects = drawn.len() as u64;
        let bytes = drawn
            .iter()
            .map(|(group, _)| size(*group))
            .sum::<u64>()
            .saturating_mul(each);
        let usage_ratio = |is: u64, limit: Option<u64>| match limit {
            // A budget of 0 is exceeded by an infinite factor.
            Some(0) if is > 0 => f64::INFINITY,
            None | Some(0) => 0.0,
            Some(limit) => is as f64 / limit as f64,
        };
        let times = budget.map_or(0.0, |b| {
            usage_ratio(triangles, b.triangles)
                .max(usage_ratio(objects, b.objects))
                .max(usage_ratio(bytes, b.bytes))
        });
        if budget.is_some() && times <= 1.0 || drawn.is_empty() {
            continue;
        }
        let mut costliest = drawn.clone();
        costliest.sort_by_key(|(group, count)| (std::cmp::Reverse(*count), *group));
        let name =
            |(group, count): &(u32, u32)| (costs.groups[*group as usize].name.clone(), *count);
        let costliest = costliest.iter().take(NAMED).map(name).collect();
        let bounds = pvs.cell_bounds(cell.0).unwrap_or_default();
        all.push(OverBudget {
            cell,
            bounds,
            triangles,
            objects,
            bytes,
            times,
            costliest,
        });
    }
    all.sort_by(|a, b| {
        b.times
            .total_cmp(&a.times)
            .then(b.triangles.cmp(&a.triangles))
            .then(a.cell.cmp(&b.cell))
    });
    if budget.is_none() {
        all.truncate(most);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn budget_rejects_unknown_limits() {
        let read = |text: &str| serde_json::from_str::<Budget>(text);
        assert_eq!(read(r#"{"triangles": 9}"#).unwrap().triangles, Some(9));
        assert!(
            read(r#"{"triangle": 9}"#)
                .unwrap_err()
                .to_string()
                .contains("triangle")
        );
    }
}
