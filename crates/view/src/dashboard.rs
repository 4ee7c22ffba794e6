//! The page with a coordinator's jobs and workers. The page contains no data: its program requests the data
//! from the coordinator that serves it.

use crate::html::{fill, program};

const DOCUMENT: &str = include_str!("../dashboard/dashboard.html");
const STYLE: &str = include_str!("../dashboard/dashboard.css");
/// The modules of the program. Each module comes after the modules that it imports.
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

/// The HTML form with the button that ends a session.
const LOGOUT: &str = "<form method=\"post\" action=\"/logout\"><button>Log out</button></form>";

/// Returns the page of a coordinator's jobs and workers as HTML.
///
/// `nonce` is the text of an attribute of the page's style and program. The text begins with a space or is
/// empty. If `has_sessions` is true, the page has a button that ends the session.
pub fn dashboard(nonce: &str, has_sessions: bool) -> String {
    let logout = if has_sessions { LOGOUT } else { "" };
    let parts = [
        ("nonce", nonce.to_owned()),
        ("logout", logout.to_owned()),
        ("style", STYLE.trim_end().to_owned()),
        ("program", program(&MODULES)),
    ];
    fill(DOCUMENT, &parts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::html::tests::names_are_used_once;

    #[test]
    fn modules_form_one_program() {
        names_are_used_once(&program(&MODULES));
        assert!(!dashboard("", false).contains("{{"));
    }

    #[test]
    fn page_has_no_style_and_no_program_without_nonce() {
        let page = dashboard(" nonce=\"x\"", true);
        for element in ["<style", "<script"] {
            let count = page.matches(element).count();
            assert!(count > 0, "{element}");
            assert_eq!(
                page.split(element)
                    .skip(1)
                    .filter(|rest| !with_nonce(rest))
                    .count(),
                0,
                "{element}"
            );
        }
        assert!(page.contains("action=\"/logout\"") && !dashboard("", false).contains("/logout"));
        // A policy with nonces forbids style attributes and event handlers in markup, and attributes that the
        // program sets by name.
        for attribute in [" style=", " style:", "{style:", " onclick="] {
            assert!(!page.contains(attribute), "{attribute}");
        }
    }

    fn with_nonce(rest: &str) -> bool {
        rest.split('>')
            .next()
            .is_some_and(|attributes| attributes.ends_with(" nonce=\"x\""))
    }
}
