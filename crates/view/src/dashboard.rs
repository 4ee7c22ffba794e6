//! The page that shows a coordinator's jobs and workers. It holds no data: its program asks the coordinator
//! that serves it.

use crate::html::{fill, program};

const DOCUMENT: &str = include_str!("../dashboard/dashboard.html");
const STYLE: &str = include_str!("../dashboard/dashboard.css");
/// The modules of the program, each after those that it imports.
const MODULES: [&str; 8] = [
    include_str!("../dashboard/words.mjs"),
    include_str!("../dashboard/calls.mjs"),
    include_str!("../dashboard/jobs.mjs"),
    include_str!("../dashboard/workers.mjs"),
    include_str!("../dashboard/map.mjs"),
    include_str!("../dashboard/timeline.mjs"),
    include_str!("../dashboard/job.mjs"),
    include_str!("../dashboard/dashboard.mjs"),
];

/// The page.
pub fn dashboard() -> String {
    fill(DOCUMENT, &[("style", STYLE.trim_end().to_owned()), ("program", program(&MODULES))])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::html::tests::names_are_used_once;

    #[test]
    fn the_modules_are_one_program() {
        names_are_used_once(&program(&MODULES));
        assert!(!dashboard().contains("{{"));
    }
}
