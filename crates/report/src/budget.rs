//! Budgets: what a cell may draw, the cells that draw more, and which objects cost most there.

use serde::{Deserialize, Serialize};
use sightline_pvs::Pvs;

use crate::costs::Costs;

/// Bytes of a triangle unless a budget says otherwise: three corners of three floats.
const BYTES_A_TRIANGLE: u64 = 36;
/// Objects that are named of a cell.
const NAMED: usize = 8;

/// What a cell may draw. What is absent has no limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Budget {
    /// Triangles in the set.
    pub triangles: Option<u64>,
    /// Objects of which something is in the set.
    pub objects: Option<u64>,
    /// Bytes of these objects, all of their triangles.
    pub bytes: Option<u64>,
    /// Bytes of a triangle; 36 if absent.
    pub bytes_per_triangle: Option<u64>,
}

/// A cell that draws more than it may, or, without a budget, one of those that draw most.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OverBudget {
    /// Its number.
    pub cell: u32,
    /// Its box, world space.
    pub bounds: [[f32; 3]; 2],
    /// What it draws.
    pub triangles: u64,
    /// Objects of which it draws something.
    pub objects: u64,
    /// Bytes of these objects.
    pub bytes: u64,
    /// How many times the budget that is exceeded most; 0 without a budget.
    pub times: f64,
    /// The objects that cost most: names, and how many of their triangles the cell draws.
    pub costliest: Vec<(String, u32)>,
}

/// The cells that draw more than they may, the worst first; without a budget the `most` that draw most.
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
    for (cell, drawn) in (0u32..).zip(&costs.cells) {
        let triangles: u64 = drawn.iter().map(|(_, count)| u64::from(*count)).sum();
        let objects = drawn.len() as u64;
        let bytes = drawn
            .iter()
            .map(|(group, _)| size(*group))
            .sum::<u64>()
            .saturating_mul(each);
        let usage_ratio = |is: u64, limit: Option<u64>| match limit {
            // Anything is infinitely many times nothing.
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
        let bounds = pvs.cell_bounds(cell).unwrap_or_default();
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
    fn a_budget_names_only_what_there_is() {
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
