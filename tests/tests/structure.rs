//! Tests of the structure in ARCHITECTURE.md: the permitted dependencies between crates, and no cycles
//! between modules.
//!
//! A cycle is a set of source files of one crate that import each other. Re-exports (`pub use`) of a `mod.rs`
//! or `lib.rs` do not count, since they only shorten a path. Test modules do not count, either.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .to_owned()
}

/// Returns the names of all crates that `package` depends on, directly or not, without the dependencies of
/// its tests.
fn dependencies(package: &str) -> BTreeSet<String> {
    let out = Command::new(env!("CARGO"))
        .args([
            "tree",
            "--offline",
            "--locked",
            "--package",
            package,
            "--edges",
            "normal",
            "--prefix",
            "none",
        ])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    let text = String::from_utf8(out.stdout).unwrap();
    text.lines()
        .skip(1)
        .filter_map(|l| l.split(' ').next())
        .map(str::to_owned)
        .collect()
}

/// Returns the crates of this workspace among the [`dependencies`].
fn ours(package: &str) -> Vec<String> {
    dependencies(package)
        .into_iter()
        .filter(|d| d.starts_with("sightline"))
        .collect()
}

#[test]
fn coordinator_depends_on_no_tracer_or_search() {
    let all = dependencies("sightline-coordinator");
    for foreign in [
        "wgpu",
        "libloading",
        "sightline-trace",
        "sightline-sample",
        "sightline-exact",
        "sightline-bake",
    ] {
        assert!(
            !all.contains(foreign),
            "sightline-coordinator depends on {foreign}"
        );
    }
}

#[test]
fn assembly_depends_on_no_tracer_or_network() {
    let all = dependencies("sightline-assemble");
    for foreign in [
        "wgpu",
        "libloading",
        "tokio",
        "tonic",
        "sled",
        "sightline-trace",
        "sightline-sample",
        "sightline-exact",
        "sightline-bake",
        "sightline-coordinator",
    ] {
        assert!(
            !all.contains(foreign),
            "sightline-assemble depends on {foreign}"
        );
    }
}

#[test]
fn scheduler_depends_on_no_store_or_network() {
    let all = dependencies("sightline-scheduler");
    for foreign in [
        "tokio",
        "tonic",
        "sled",
        "sightline-store",
        "sightline-coordinator",
    ] {
        assert!(
            !all.contains(foreign),
            "sightline-scheduler depends on {foreign}"
        );
    }
    assert_eq!(ours("sightline-records"), ["sightline-numbers"]);
}

#[test]
fn tracers_depend_on_no_samplers() {
    let all = ours("sightline-trace");
    assert!(!all.contains(&"sightline-sample".to_owned()), "{all:?}");
}

#[test]
fn checker_depends_only_on_number_types() {
    assert_eq!(ours("sightline-certificate"), ["sightline-numbers"]);
    assert!(ours("sightline-numbers").is_empty());
}

#[test]
fn geometry_and_formats_depend_on_no_scenes() {
    assert_eq!(ours("sightline-geometry"), ["sightline-numbers"]);
    assert!(ours("sightline-formats").is_empty());
}

#[test]
fn result_reader_depends_on_no_other_crate() {
    assert!(ours("sightline-pvs").is_empty());
}

#[test]
fn point_queries_depend_on_no_tracer() {
    assert_eq!(
        ours("sightline-tetra"),
        [
            "sightline-formats",
            "sightline-geometry",
            "sightline-numbers",
            "sightline-scene"
        ]
    );
    let all = dependencies("sightline-tetra");
    for foreign in ["wgpu", "libloading"] {
        assert!(
            !all.contains(foreign),
            "sightline-tetra depends on {foreign}"
        );
    }
}

#[test]
fn traces_do_not_depend_on_traced_crates() {
    assert_eq!(ours("sightline-traces"), ["sightline-proto"]);
}

#[test]
fn libraries_depend_on_no_network_or_store() {
    let libraries = std::fs::read_dir(root().join("crates")).unwrap();
    for name in libraries.map(|e| e.unwrap().file_name().into_string().unwrap()) {
        let all = dependencies(&format!("sightline-{name}"));
        for foreign in ["tokio", "tonic", "sled"] {
            assert!(
                !all.contains(foreign),
                "sightline-{name} depends on {foreign}"
            );
        }
    }
}

/// Collects the source files below `dir` by module path. `lib.rs` and `main.rs` have the empty path.
fn modules(dir: &Path, path: &[String], out: &mut BTreeMap<Vec<String>, PathBuf>) {
    for entry in std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().path()) {
        let stem = entry.file_stem().unwrap().to_str().unwrap().to_owned();
        let child = || {
            path.iter()
                .cloned()
                .chain([stem.clone()])
                .collect::<Vec<_>>()
        };
        if entry.is_dir() {
            modules(&entry, &child(), out);
        } else if entry.extension().is_some_and(|e| e == "rs") {
            let own = matches!(stem.as_str(), "lib" | "main" | "mod");
            out.insert(if own { path.to_vec() } else { child() }, entry);
        }
    }
}

/// Returns the code of a file without comments and without its test module.
fn code(file: &Path) -> String {
    let text = std::fs::read_to_string(file).unwrap();
    // A test module inside the file is its last part. A test module in another file is only declared here.
    let cuts = ["#[cfg(test)]\nmod ", "#[cfg(test)]\npub mod "]
        .into_iter()
        .flat_map(|m| text.match_indices(m));
    let inline = |at: &usize| {
        text[*at..]
            .find(['{', ';'])
            .is_some_and(|end| text[*at + end..].starts_with('{'))
    };
    let text = &text[..cuts
        .map(|(at, _)| at)
        .filter(inline)
        .min()
        .unwrap_or(text.len())];
    let lines = text.lines().map(|l| l.split("//").next().unwrap());
    lines.collect::<Vec<_>>().join("\n")
}

/// Returns the paths in the code that start with `crate::`, `super::` or a child module, with groups in
/// braces expanded.
fn named(text: &str, own: &[String], children: &[&String]) -> Vec<Vec<String>> {
    let mut out = Vec::new();
    let words: Vec<String> = ["crate", "super"]
        .into_iter()
        .chain(children.iter().map(|c| c.as_str()))
        .map(|w| format!("{w}::"))
        .collect();
    for (start, word) in words.iter().flat_map(|w| text.match_indices(w.as_str())) {
        let before = text[..start].chars().next_back();
        if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':' || c == '$') {
            continue;
        }
        let mut rest = &text[start..];
        let mut base: Vec<String> = if word == "crate::" {
            Vec::new()
        } else {
            own.to_vec()
        };
        while let Some(more) = rest.strip_prefix("super::") {
            base.pop();
            rest = more;
        }
        rest = rest.strip_prefix("crate::").unwrap_or(rest);
        let mut tree = String::new();
        let mut depth = 0;
        for c in rest.chars() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ';' | '(' | ')' | '<' | '>' | '[' | ']' | '=' | '!' | '?' | '&' | '|' => break,
                ',' | ' ' | '\n' if depth == 0 => break,
                _ => {}
            }
            if depth < 0 {
                break;
            }
            tree.push(c);
        }
        expand(&tree, &base, &mut out);
    }
    out
}

/// Expands `a::{b, c::d}` below `base`.
fn expand(tree: &str, base: &[String], out: &mut Vec<Vec<String>>) {
    let tree = tree.trim();
    let (head, group) = tree
        .split_once('{')
        .map_or((tree, None), |(h, g)| (h, Some(g)));
    let head = head.split_whitespace().next().unwrap_or("");
    let path: Vec<String> = base
        .iter()
        .cloned()
        .chain(
            head.split("::")
                .filter(|s| !s.is_empty() && *s != "self")
                .map(str::to_owned),
        )
        .collect();
    let Some(group) = group else {
        out.push(path);
        return;
    };
    let inner = group.trim_end().strip_suffix('}').unwrap_or(group);
    let (mut depth, mut from) = (0, 0);
    for (at, c) in inner.char_indices().chain([(inner.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !inner[from..at].trim().is_empty() {
                    expand(&inner[from..at], &path, out);
                }
                from = (at + 1).min(inner.len());
            }
            _ => {}
        }
    }
}

/// Returns the file that defines an item of a module: the module's own file, or the file that the item is
/// re-exported from.
fn home<'a>(
    module: &'a Vec<String>,
    item: Option<&String>,
    files: &'a BTreeMap<Vec<String>, PathBuf>,
) -> &'a Vec<String> {
    let Some(item) = item else { return module };
    let text = code(&files[module]);
    if defines(&text, item) {
        return module;
    }
    for statement in text
        .split_inclusive(';')
        .filter(|s| s.trim_start().starts_with("pub use"))
    {
        let tree = statement
            .trim()
            .trim_start_matches("pub use")
            .trim_end_matches(';')
            .trim();
        let (base, tree) = match tree.strip_prefix("crate::") {
            Some(rest) => (&[][..], rest),
            None => (&module[..], tree.strip_prefix("self::").unwrap_or(tree)),
        };
        let mut paths = Vec::new();
        expand(tree, base, &mut paths);
        for path in paths.iter().filter(|p| p.last() == Some(item)) {
            let target = (0..path.len())
                .rev()
                .find_map(|n| files.get_key_value(&path[..n]));
            if let Some((target, _)) = target.filter(|(t, _)| *t != module) {
                return home(target, Some(item), files);
            }
        }
    }
    module
}

/// Returns the sets of files that import each other, directly or through others.
fn circles(source: &Path) -> Vec<Vec<String>> {
    let mut files = BTreeMap::new();
    modules(source, &[], &mut files);
    let mut arrows: BTreeMap<&Vec<String>, BTreeSet<&Vec<String>>> = BTreeMap::new();
    for (module, file) in &files {
        let text = code(file);
        // Re-exports only shorten paths.
        let statements = text
            .split_inclusive(';')
            .filter(|s| !s.trim_start().starts_with("pub use"));
        let text: String = statements.collect();
        let children = files
            .keys()
            .filter(|f| f.len() == module.len() + 1 && f.starts_with(module));
        let children: Vec<&String> = children.filter_map(|f| f.last()).collect();
        for path in named(&text, module, &children) {
            // Use the longest prefix of the path that is a file. The rest of the path is an item of that
            // file.
            let target = (0..=path.len())
                .rev()
                .find_map(|n| files.get_key_value(&path[..n]));
            if let Some((target, _)) = target.filter(|(t, _)| *t != module) {
                let end = home(target, path.get(target.len()), &files);
                if end != module {
                    arrows.entry(module).or_default().insert(end);
                }
            }
        }
    }
    let mut reach: BTreeMap<&Vec<String>, BTreeSet<&Vec<String>>> = BTreeMap::new();
    for module in files.keys() {
        let mut seen = BTreeSet::new();
        let mut open: Vec<_> = arrows.get(module).into_iter().flatten().copied().collect();
        while let Some(next) = open.pop() {
            if seen.insert(next) {
                open.extend(arrows.get(next).into_iter().flatten());
            }
        }
        reach.insert(module, seen);
    }
    let mut found = BTreeSet::new();
    for (module, seen) in &reach {
        let circle: Vec<String> = seen
            .iter()
            .filter(|o| reach[*o].contains(module))
            .map(|o| o.join("::"))
            .collect();
        if !circle.is_empty() {
            found.insert(circle);
        }
    }
    found.into_iter().collect()
}

/// Returns true if a file itself defines an item with this name.
fn defines(text: &str, item: &str) -> bool {
    let words: Vec<&str> = text
        .split(|c: char| !(c.is_alphanumeric() || c == '_'))
        .collect();
    words.windows(2).any(|w| {
        matches!(
            w[0],
            "fn" | "struct" | "enum" | "trait" | "type" | "const" | "static" | "union"
        ) && w[1] == item
    })
}

#[test]
fn modules_have_no_import_cycles() {
    let root = root();
    let mut crates: Vec<PathBuf> = [
        "sightline",
        "cli",
        "coordinator",
        "coordinator/records",
        "coordinator/scheduler",
        "coordinator/store",
        "http",
        "worker",
        "traces",
        "proto",
        "python",
    ]
    .iter()
    .map(|c| root.join(c))
    .collect();
    crates.extend(
        std::fs::read_dir(root.join("crates"))
            .unwrap()
            .map(|e| e.unwrap().path()),
    );
    crates.sort();
    let mut found = Vec::new();
    for one in crates {
        for circle in circles(&one.join("src")) {
            found.push(format!(
                "{}: {}",
                one.strip_prefix(&root).unwrap().display(),
                circle.join(", ")
            ));
        }
    }
    assert!(
        found.is_empty(),
        "modules that import each other:\n{}",
        found.join("\n")
    );
}

#[test]
fn cycle_is_detected_and_re_export_is_ignored() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(dir.path().join(name), text).unwrap();
    write("lib.rs", "mod a;\nmod b;\nmod c;\npub use a::{A, C};\n");
    write("a.rs", "use crate::b::{self, B};\npub struct A(B);\n");
    write("b.rs", "pub struct B;\n// use crate::a::A;\n");
    write("c.rs", "use crate::A;\npub struct C(A);\n");
    assert!(circles(dir.path()).is_empty());
    write("b.rs", "pub struct B;\nfn f(a: &super::a::A) {}\n");
    assert_eq!(circles(dir.path()), [["a", "b"]]);
    write("b.rs", "pub struct B;\nfn f(c: crate::C) {}\n");
    write(
        "lib.rs",
        "mod a;\nmod b;\nmod c;\npub use a::A;\npub use c::C;\n",
    );
    assert_eq!(circles(dir.path()), [["a", "b", "c"]]);
    write(
        "b.rs",
        "pub struct B;\n#[cfg(test)]\nmod tests { use crate::a::A; }\n",
    );
    assert!(circles(dir.path()).is_empty());
}

/// Tests that a check which cannot run is a failure if `CI` is set. Machines of continuous integration need
/// not set it themselves.
#[test]
fn ci_program_sets_ci() {
    use std::os::unix::fs::PermissionsExt as _;
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &[u8]| {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path
    };
    let program = write(".ci/run", &std::fs::read(root().join(".ci/run")).unwrap());
    write("scripts/test.sh", b"#!/bin/sh\nprintf %s \"$CI\"\n");
    for before in [None, Some(""), Some("false")] {
        let mut command = Command::new(&program);
        match before {
            Some(value) => command.env("CI", value),
            None => command.env_remove("CI"),
        };
        let out = command.output().unwrap();
        assert_eq!(
            String::from_utf8_lossy(&out.stdout),
            "true",
            "with CI={before:?} before"
        );
    }
}

#[test]
fn paths_in_the_documents_exist() {
    let root = root();
    let mut found = 0;
    let mut absent = Vec::new();
    for document in ["ARCHITECTURE.md", "CONTRIBUTING.md", "README.md"] {
        let text = std::fs::read_to_string(root.join(document)).unwrap();
        for path in text.split('`').skip(1).step_by(2) {
            let plain = |c: char| c.is_ascii_alphanumeric() || "_-./".contains(c);
            let folder = path.split_once('/').map_or("", |(folder, _)| folder);
            // Results and build folders are not in the repository.
            let is_ours = root.join(folder).join("Cargo.toml").is_file()
                || ["crates", "deploy", "docs", "scripts"].contains(&folder);
            if folder.is_empty() || !is_ours || !path.chars().all(plain) {
                continue;
            }
            found += 1;
            if !root.join(path).exists() {
                absent.push(format!("{document}: {path}"));
            }
        }
    }
    assert!(found > 100, "{found} paths");
    assert!(absent.is_empty(), "{absent:#?}");
}
