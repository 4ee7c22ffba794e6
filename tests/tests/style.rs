//! Tests that count names which readers cannot understand. Each count may only fall: lower its limit here
//! when it does.
//!
//! A constructor is `new`, `from_x` or `parse`, not `of`. A variable is a noun, not `of`. A parameter is not
//! a tuple pattern: it is a struct, or its parts are separate parameters. A type has a name that no other
//! type of its crate has.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Maximum number of functions named `of`.
const FUNCTIONS: usize = 0;
/// Maximum number of variables of `let` named `of`.
const VARIABLES: usize = 0;
/// Maximum number of variables of loops and closures named `of`.
const INNER_VARIABLES: usize = 0;
/// Maximum number of parameters that are tuple patterns.
const TUPLES: usize = 0;
/// Maximum number of type names that more than one file of a crate declares.
const TYPES: usize = 0;

/// Returns the text of each source file of the workspace without comments, with its path.
fn sources() -> Vec<(PathBuf, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let listed = Command::new("git")
        .args([
            "ls-files",
            "--cached",
            "--others",
            "--exclude-standard",
            "*.rs",
        ])
        .current_dir(root)
        .output()
        .unwrap();
    let listed = String::from_utf8(listed.stdout).unwrap();
    let read = |name: &str| {
        let text = std::fs::read_to_string(root.join(name)).ok()?;
        let lines = text.lines().map(|line| match line.find("//") {
            Some(at) => &line[..at],
            None => line,
        });
        Some((PathBuf::from(name), lines.collect::<Vec<_>>().join("\n")))
    };
    // This file contains such names in its texts.
    let others = listed
        .lines()
        .filter(|name| !name.ends_with("tests/style.rs"));
    others.filter_map(read).collect()
}

/// Returns the number of occurrences of words in this order, with any white space between them.
fn count_words(text: &str, words: [&str; 2]) -> usize {
    let all: Vec<&str> = text
        .split(|c: char| c.is_whitespace() || "(<:=;{},".contains(c))
        .filter(|word| !word.is_empty() && *word != "mut")
        .collect();
    all.windows(2).filter(|pair| **pair == words).count()
}

/// Returns the number of function parameters that are tuple patterns.
fn count_tuples(text: &str) -> usize {
    let mut count = 0;
    for (at, _) in text.match_indices("fn ") {
        let Some(open) = text[at..].find(['(', '{', ';']).map(|open| at + open) else {
            continue;
        };
        if !text[open..].starts_with('(') {
            continue;
        }
        let (mut depth, mut begins) = (0, true);
        for c in text[open..].chars() {
            match c {
                '(' => {
                    count += usize::from(depth == 1 && begins);
                    depth += 1;
                    begins = depth == 1;
                }
                ')' => {
                    depth -= 1;
                    begins = false;
                }
                ',' if depth == 1 => begins = true,
                c if c.is_whitespace() => {}
                _ => begins = false,
            }
            if depth == 0 {
                break;
            }
        }
    }
    count
}

/// Checks that the sum of `count` over all source files does not exceed its limit.
#[track_caller]
fn check(what: &str, limit: usize, count: impl Fn(&str) -> usize) {
    let counts: Vec<(PathBuf, usize)> = sources()
        .into_iter()
        .map(|(path, text)| (path, count(&text)))
        .filter(|(_, count)| *count > 0)
        .collect();
    let total: usize = counts.iter().map(|(_, count)| count).sum();
    assert!(
        total <= limit,
        "{total} {what}, and the limit is {limit}: {counts:#?}"
    );
    assert!(
        total == limit,
        "{total} {what}: lower the limit in this file from {limit} to {total}"
    );
}

/// Returns the names of the types that the text of one file declares outside its tests. Types of functions
/// and associated types are indented, and do not count.
fn type_names(text: &str) -> BTreeSet<&str> {
    let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
    let declared = text.lines().filter_map(|line| {
        let line = match line.strip_prefix("pub") {
            Some(rest) => rest.split_once(' ')?.1,
            None => line,
        };
        let (kind, rest) = line.split_once(' ')?;
        let is_type = ["struct", "enum", "trait", "union", "type"].contains(&kind);
        is_type.then(|| {
            rest.split(|c: char| !c.is_alphanumeric() && c != '_')
                .next()
        })?
    });
    declared.collect()
}

#[test]
fn type_names_occur_once_in_a_crate() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let mut files: BTreeMap<(PathBuf, String), Vec<PathBuf>> = BTreeMap::new();
    for (path, text) in sources() {
        let home = path
            .ancestors()
            .skip(1)
            .find(|folder| root.join(folder).join("Cargo.toml").is_file())
            .unwrap();
        // Each program and each test program is a separate crate.
        let inner = path.strip_prefix(home).unwrap();
        let is_test = inner.iter().any(|part| {
            let part = part.to_str().unwrap();
            part == "tests" || part.ends_with("tests.rs")
        });
        if !inner.starts_with("src") || inner.starts_with("src/bin") || is_test {
            continue;
        }
        for name in type_names(&text) {
            let key = (home.to_owned(), name.to_owned());
            files.entry(key).or_default().push(path.clone());
        }
    }
    files.retain(|_, files| files.len() > 1);
    let count = files.len();
    assert_eq!(
        count, TYPES,
        "type names that occur in several files of a crate: {files:#?}"
    );
}

#[test]
fn functions_have_names() {
    check("functions are named `of`", FUNCTIONS, |text| {
        count_words(text, ["fn", "of"])
    });
}

#[test]
fn variables_are_nouns() {
    check("variables are named `of`", VARIABLES, |text| {
        count_words(text, ["let", "of"])
    });
}

#[test]
fn variables_of_loops_and_closures_are_nouns() {
    check("variables are named `of`", INNER_VARIABLES, |text| {
        let closures = ["|of|", "|of:", "|of,", ", of|"];
        let parameters: usize = closures.iter().map(|c| text.matches(c).count()).sum();
        count_words(text, ["for", "of"]) + parameters
    });
}

#[test]
fn parameters_are_no_tuples() {
    check("parameters are tuple patterns", TUPLES, count_tuples);
}

#[test]
fn counters_count() {
    let text =
        "fn of(x: u8) {}\nfn of<T>((a, b): (u8, u8), c: u8, (d, e): (T, T)) { let mut of = 1; }\n";
    assert_eq!(count_words(text, ["fn", "of"]), 2);
    assert_eq!(count_words(text, ["let", "of"]), 1);
    assert_eq!(count_tuples(text), 2);
    assert_eq!(
        count_tuples("fn f(x: impl Fn(u8) -> (u8, u8)) -> (u8, u8) {}"),
        0
    );
}
