//! The check that the statements of a result about itself, which no certificate covers, match its contents.

use super::{BakedResult, NOT_REACHED, SET_ASIDE};

/// The methods whose results have certificates.
const METHODS: [&str; 2] = ["exact", "verified"];

/// Returns the method that the parameters of a result state. A result of another program need not state one.
fn stated_method(task: &serde_json::Value) -> Option<&str> {
    let task = task.as_object()?;
    let exact = task
        .get("exact")
        .map(|exact| match exact["effort"].as_str() {
            Some("bounded") => "verified",
            _ => "exact",
        });
    let other = || {
        ["aggressive", "portals"]
            .into_iter()
            .find(|method| task.contains_key(*method))
    };
    exact.or_else(other)
}

/// Returns the grid that the parameters of an exact result state.
fn stated_grid(task: &serde_json::Value) -> Option<&serde_json::Value> {
    let sampling = task["exact"]["sampling"].as_object()?;
    sampling
        .values()
        .map(|sampler| &sampler["grid"])
        .find(|grid| grid.is_object())
}

/// Checks the method, the number of cells, and the flags of a result. Returns a message about the first
/// contradiction.
pub(super) fn check(result: &dyn BakedResult) -> Result<(), String> {
    let parameters: serde_json::Value = serde_json::from_str(result.parameters())
        .map_err(|e| format!("the result's parameters are not valid JSON: {e}"))?;
    let method = result.method();
    if !METHODS.contains(&method) {
        return Err(format!(
            "the method {method:?} has no certificates; only exact and verified have them"
        ));
    }
    let task = &parameters["spec"]["visibility"];
    if let Some(stated) = stated_method(task).filter(|stated| *stated != method) {
        return Err(format!(
            "the result states the method {method}, but its parameters state {stated}"
        ));
    }
    if let Some(grid) = stated_grid(task) {
        let sides = ["x", "y", "z"].map(|side| grid[side].as_u64());
        let cells = sides
            .iter()
            .try_fold(1u64, |n, side| n.checked_mul((*side)?));
        if cells != Some(u64::from(result.cell_count())) {
            let [x, y, z] = ["x", "y", "z"].map(|side| grid[side].to_string());
            return Err(format!(
                "the result's parameters state {x}x{y}x{z} cells, but the result has {}",
                result.cell_count()
            ));
        }
    }
    let mut reached = 0;
    for cell in 0..result.cell_count() {
        let flags = result.flags(cell)?;
        reached += u64::from(flags & NOT_REACHED == 0);
        if flags & !(SET_ASIDE | NOT_REACHED) != 0 {
            return Err(format!(
                "cell {cell} has flags {flags:#x}, but only the bits 0x1 and 0x2 are defined"
            ));
        }
    }
    // A cell without viewpoints makes no claims about triangles, so the parameters must state the number of
    // cells with viewpoints.
    let expected = match &parameters["viewpoints"] {
        serde_json::Value::Null => Some(u64::from(result.cell_count())),
        given => given["cells_reached"].as_u64(),
    };
    if expected != Some(reached) {
        return Err(format!(
            "the flags mark {reached} cells with viewpoints, but the result's parameters state {}",
            expected.map_or("no valid number".to_owned(), |n| n.to_string())
        ));
    }
    Ok(())
}
