//! The extensions that glTF files declare: the table of the documentation, warnings and errors.

#![allow(clippy::unwrap_used, reason = "tests")]

mod support;

use std::collections::BTreeSet;
use std::fmt::Write as _;

use serde_json::{Value, json};
use sightline_scene::SceneError;
use sightline_scene::load::{EXTENSIONS, LoadOptions, LoadedScene, Support, load_bytes_with};
use support::{compress, packed_square, soup, square};

fn load(change: impl FnOnce(&mut Value)) -> Result<LoadedScene, SceneError> {
    let mut g = square();
    change(&mut g.json);
    load_bytes_with("test.glb", &g.glb(), None, &LoadOptions::default())
}

#[test]
fn page_shows_table_of_loader() {
    let mut table =
        String::from("| extension | treatment | part that is read, or reason |\n|---|---|---|\n");
    for row in EXTENSIONS {
        writeln!(
            table,
            "| `{}` | {} | {} |",
            row.name,
            row.support.name(),
            row.note
        )
        .unwrap();
    }
    let page = include_str!("../../../docs/extensions.md");
    assert!(
        page.contains(&table),
        "docs/extensions.md must have this table:\n{table}"
    );
    assert_eq!(
        page.matches("| `").count(),
        EXTENSIONS.len(),
        "docs/extensions.md has other rows"
    );
    let names: BTreeSet<&str> = EXTENSIONS.iter().map(|e| e.name).collect();
    assert_eq!(names.len(), EXTENSIONS.len(), "an extension has two rows");
}

#[test]
fn extensions_load_warn_or_refuse_as_in_table() {
    for row in EXTENSIONS {
        let name = row.name.replace('*', "x");
        let used = load(|j| j["extensionsUsed"] = json!([name])).unwrap();
        let required = load(|j| j["extensionsRequired"] = json!([name]));
        match row.support {
            Support::Read | Support::Irrelevant => {
                assert_eq!(used.warnings, [""; 0], "{name}");
                assert_eq!(required.unwrap().warnings, [""; 0], "{name}");
            }
            Support::Refused => {
                assert!(
                    used.warnings[0].contains(&format!("{name}, which is not read")),
                    "{name}"
                );
                let error = required.unwrap_err().to_string();
                assert!(
                    error.contains("extensionsRequired") && error.contains(&name),
                    "{error}"
                );
            }
        }
    }
}

#[test]
fn unknown_extension_warns_once_with_its_name() {
    let loaded = load(|j| {
        j["extensionsUsed"] = json!(["ACME_a", "KHR_materials_unlit", "ACME_b", "ACME_a"])
    });
    let warnings = loaded.unwrap().warnings;
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    for (warning, name) in warnings.iter().zip(["ACME_a", "ACME_b"]) {
        assert!(warning.starts_with(&format!(
            "the file uses the extension {name}, which is unknown"
        )));
    }
    let many: Vec<String> = (0..1000).map(|n| format!("ACME_{n}")).collect();
    let warnings = load(|j| j["extensionsUsed"] = json!(many))
        .unwrap()
        .warnings;
    assert!(
        warnings.len() < 20 && warnings.last().unwrap().contains("984 more"),
        "{warnings:?}"
    );
}

#[test]
fn khr_meshopt_compression_is_read_as_ext() {
    let ext = packed_square();
    let mut khr = packed_square();
    for view in khr.json["bufferViews"].as_array_mut().unwrap() {
        if let Some(extensions) = view.get_mut("extensions") {
            let compressed = extensions["EXT_meshopt_compression"].take();
            *extensions = json!({"KHR_meshopt_compression": compressed});
        }
    }
    khr.json["extensionsRequired"] = json!(["KHR_meshopt_compression"]);
    assert_eq!(soup(&khr.load().unwrap()), soup(&ext.load().unwrap()));
    // Errors name the extension of the file.
    khr.json["bufferViews"][2]["extensions"]["KHR_meshopt_compression"]["mode"] = json!("ODD");
    let error = khr.load().unwrap_err().to_string();
    assert!(
        error.contains("buffer view 2, KHR_meshopt_compression: the mode ODD is unknown"),
        "{error}"
    );
}

#[test]
fn khr_meshopt_compression_of_version_1_is_read() {
    // The positions of the square in version 1: literal deltas of one block, with channels of byte deltas.
    let mut g = square();
    let mut packed = vec![0xa1, 0xff, 0xff, 0xff];
    let bytes: Vec<[u8; 12]> = support::SQUARE.iter().map(|p| bytemuck::cast(*p)).collect();
    for byte in 0..12 {
        let mut last = 0u8;
        for element in &bytes {
            let difference = element[byte].wrapping_sub(last);
            packed.push((difference << 1) ^ 0u8.wrapping_sub(difference >> 7));
            last = element[byte];
        }
    }
    packed.resize(packed.len() + 24, 0);
    compress(&mut g, 0, &packed, "ATTRIBUTES", "NONE", 12);
    let view = g.json["bufferViews"]
        .as_array_mut()
        .unwrap()
        .last_mut()
        .unwrap();
    let compressed = view["extensions"]["EXT_meshopt_compression"].take();
    view["extensions"] = json!({"KHR_meshopt_compression": compressed});
    g.json["extensionsRequired"] = json!(["KHR_meshopt_compression"]);
    assert_eq!(soup(&g.load().unwrap()), soup(&square().load().unwrap()));
}
