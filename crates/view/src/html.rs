//! The page of a result as one HTML document that contains its style, program and data.

use serde_json::json;
use sightline_formats::html::escaped;
use sightline_pvs::layout::Section;

use crate::pack::{block, triangles, values};
use crate::{View, ViewError};

const DOCUMENT: &str = include_str!("../page/page.html");
const STYLE: &str = include_str!("../page/style.css");
/// The modules of the program. Each module comes after the modules that it imports.
const MODULES: [&str; 7] = [
    include_str!("../../../readers/js/pvs.mjs"),
    include_str!("../page/math.mjs"),
    include_str!("../page/trace.mjs"),
    include_str!("../page/why.mjs"),
    include_str!("../page/draw.mjs"),
    include_str!("../page/camera.mjs"),
    include_str!("../page/main.mjs"),
];

/// The sections of a result that the page's program reads.
const READ: [Section; 8] = [
    Section::Info,
    Section::Method,
    Section::Tree,
    Section::Objects,
    Section::Flags,
    Section::Visible,
    Section::Undecided,
    Section::Items,
];

/// Returns the page of a result as one HTML document.
///
/// # Errors
/// [`ViewError`] if the result cannot be read or the data cannot be compressed.
pub fn page(view: &View<'_>) -> Result<String, ViewError> {
    let worst = view.worst.iter().map(
        |w| json!({"viewpoint": w.viewpoint.map(f64::from), "cell": w.cell, "error": w.error}),
    );
    let meta = json!({
        "up": view.up,
        "start": view.start,
        "far": view.far,
        "caveat": view.caveat,
        "ask": view.ask.as_ref().map(|ask| json!({"url": ask.url, "job": ask.job})),
        "about": view.about,
        "maps": view.maps.iter().map(|map| &map.name).collect::<Vec<_>>(),
        "places": !view.places.is_empty(),
        "worst": worst.collect::<Vec<_>>(),
    });
    let parts = [
        ("title", escaped(&view.title)),
        ("nonce", view.nonce.clone()),
        ("style", STYLE.trim_end().to_owned()),
        // A text in the description must not end the script element.
        ("meta", meta.to_string().replace('<', "\\u003c")),
        ("result", block(&view.pvs.with_sections(&READ))?),
        (
            "scene",
            view.scene
                .map(|scene| block(&triangles(scene)))
                .transpose()?
                .unwrap_or_default(),
        ),
        ("values", block(&values(view))?),
        ("program", program(&MODULES)),
    ];
    Ok(fill(DOCUMENT, &parts))
}

/// Replaces each `{{name}}` in a document by the text of the part with this name, or by nothing if there is
/// no such part.
pub fn fill(document: &str, parts: &[(&str, String)]) -> String {
    let length = parts.iter().map(|(_, text)| text.len()).sum::<usize>() + document.len();
    let (mut out, mut rest) = (String::with_capacity(length), document);
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        out.push_str(before);
        out.extend(
            parts
                .iter()
                .filter(|(part, _)| *part == name)
                .map(|(_, text)| text.as_str()),
        );
        rest = after;
    }
    out.push_str(rest);
    out
}

/// Joins JavaScript modules into one program, without `import` lines and without the word `export`.
pub fn program(modules: &[&str]) -> String {
    let mut out = String::new();
    for line in modules.iter().flat_map(|module| module.lines()) {
        if !line.starts_with("import ") {
            out.push_str(line.strip_prefix("export ").unwrap_or(line));
            out.push('\n');
        }
    }
    out
}

#[cfg(test)]
pub mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Checks that no top-level name occurs twice, because the names of all modules share one scope.
    pub fn names_are_used_once(all: &str) {
        let is_word = |line: &str| line.starts_with("import ") || line.starts_with("export ");
        assert!(!all.lines().any(is_word) && !all.contains("</script"));
        let name = |line: &str| {
            let mut words = line.split([' ', '(', '=']);
            let is_name = matches!(
                words.next(),
                Some("const" | "function" | "class" | "async" | "let")
            );
            words
                .find(|word| !word.is_empty() && *word != "function")
                .filter(|_| is_name)
                .map(str::to_owned)
        };
        let names: Vec<String> = all.lines().filter_map(name).collect();
        let once: BTreeSet<&String> = names.iter().collect();
        assert_eq!(once.len(), names.len(), "{names:?}");
    }

    #[test]
    fn modules_form_one_program() {
        names_are_used_once(&program(&MODULES));
    }
}
