//! Whether the statements of a result about itself, which no certificate covers, agree with its contents.

use super::{BakedResult, NOT_REACHED, SET_ASIDE};

/// The methods whose results have certificates.
const METHODS: [&str; 2] = ["exact", "verified"];

/// Checks method, number of cells, and flags; a message about the first contradiction.
pub(super) fn check(result: &dyn BakedResult) -> Result<(), String> {
    let parameters: serde_json::Value = serde_json::from_str(result.parameters())
        .map_err(|e| format!("its parameters are not valid JSON: {e}"))?;
    let method = result.method();
    if !METHODS.contains(&method) {
        return Err(format!("{method:?} is no method that has certificates"));
    }
    // A result of another program need not name its method.
    if parameters["method"].as_str().is_some_and(|m| m != method) {
        return Err(format!(
            "its method is {method}, and {} in its parameters",
            parameters["method"]
        ));
    }
    if let Some(grid) = parameters["division"]["grid"].as_array() {
        let cells = grid
            .iter()
            .try_fold(1u64, |n, side| n.checked_mul(side.as_u64()?));
        if cells != Some(u64::from(result.cell_count())) {
            return Err(format!(
                "its parameters say {} cells, and it has {}",
                parameters["division"]["grid"],
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
                "cell {cell} has flags {flags:#x} with an unknown bit"
            ));
        }
    }
    // Nothing is claimed about a cell that no viewpoint reaches, so the parameters have to say how many
    // these are.
    let expected = match &parameters["viewpoints"] {
        serde_json::Value::Null => Some(u64::from(result.cell_count())),
        given => given["cells_reached"].as_u64(),
    };
    if expected != Some(reached) {
        return Err(format!(
            "viewpoints are in {reached} of its cells by their flags, and in {} by its parameters",
            expected.map_or("an unknown number".to_owned(), |n| n.to_string())
        ));
    }
    Ok(())
}
