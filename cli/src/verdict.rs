//! What came of checking a result: accepted, or refused with the claim that does not hold.

use std::path::Path;

use serde_json::{Value, json};

/// What came of a check, as JSON and in words.
pub enum Verdict {
    /// Every claim holds.
    Accepted(Value, String),
    /// A claim does not.
    Refused(Value, String),
}

/// What a check tells while it runs, and how it is told to stop.
pub struct Hooks<'a> {
    /// Takes the numbers of cells that are done and of all.
    pub progress: &'a (dyn Fn(u32, u32) + Sync),
    /// Whether to stop.
    pub cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl Verdict {
    /// A claim about a cell, or about the whole result, does not hold.
    pub fn refused(cell: Option<u32>, reason: &str, result: &Path) -> Self {
        let value = match cell {
            Some(cell) => json!({"accepted": false, "cell": cell, "reason": reason}),
            None => json!({"accepted": false, "reason": reason}),
        };
        let cell = cell.map_or(String::new(), |cell| format!(", cell {cell}"));
        let text = format!(
            "REFUSED: {}{cell}: {reason}; the result is damaged or was altered, bake it again",
            result.display()
        );
        Self::Refused(value, text)
    }
}
