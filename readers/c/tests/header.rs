//! Comparison of the C header with the functions of the library.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

/// Writes `include/sightline_pvs.h` when `SIGHTLINE_WRITE_HEADER` is set, and compares it otherwise.
#[test]
fn header_matches_library() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(root.join("cbindgen.toml")).unwrap();
    let made = cbindgen::Builder::new()
        .with_src(root.join("src/lib.rs"))
        .with_config(config)
        .generate();
    let mut bytes = Vec::new();
    made.unwrap().write(&mut bytes);
    let path = root.join("include/sightline_pvs.h");
    if std::env::var_os("SIGHTLINE_WRITE_HEADER").is_some() {
        std::fs::write(&path, &bytes).unwrap();
    }
    let is = std::fs::read(&path).unwrap();
    assert!(
        is == bytes,
        "set SIGHTLINE_WRITE_HEADER=1 and run this test again to write {}",
        path.display()
    );
}
