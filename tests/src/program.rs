//! The path of the program under test.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Returns the path of the program under test. The path is the value of `SIGHTLINE_BIN`, or otherwise the
/// program that `cargo build` creates from this checkout, in the profile and target folder of the running
/// test. An up-to-date program is not built again.
pub fn program() -> &'static Path {
    static PROGRAM: OnceLock<PathBuf> = OnceLock::new();
    PROGRAM.get_or_init(|| match std::env::var_os("SIGHTLINE_BIN") {
        Some(named) => {
            let named = PathBuf::from(named);
            assert!(
                named.is_file(),
                "SIGHTLINE_BIN names no file: {}",
                named.display()
            );
            // Tests run the program from other folders.
            std::path::absolute(named).unwrap()
        }
        None => build(),
    })
}

/// Returns the path of an example of this checkout, built like the program.
pub fn example(name: &str) -> PathBuf {
    built(&["--example", name], name)
}

fn build() -> PathBuf {
    built(&["--bins"], "sightline")
}

/// Builds targets. Returns the path of the executable with this name.
fn built(targets: &[&str], name: &str) -> PathBuf {
    // The path of the test has the form TARGET/PROFILE/deps/TEST-HASH.
    let test = std::env::current_exe().unwrap();
    let folder = test.ancestors().nth(2).unwrap();
    let profile = match folder.file_name().unwrap().to_str().unwrap() {
        "debug" => "dev",
        other => other,
    };
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo
        // Build the whole workspace: for one package, cargo would select other features and build the
        // dependencies again.
        .args([
            "build",
            "--workspace",
            "--profile",
            profile,
            "--message-format",
            "json-render-diagnostics",
        ])
        .args(targets)
        .arg("--target-dir")
        .arg(folder.parent().unwrap())
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .stdin(Stdio::null())
        .stderr(Stdio::inherit());
    let built = cargo
        .output()
        .unwrap_or_else(|e| panic!("{cargo:?} does not start: {e}"));
    assert!(built.status.success(), "{cargo:?} failed");
    let messages = String::from_utf8(built.stdout).unwrap();
    messages
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .filter(|message| message["target"]["name"] == name)
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .unwrap_or_else(|| panic!("{cargo:?} named no executable"))
}

/// Returns true on CI, where a missing requirement of a test is a failure instead of a reason to skip the
/// test.
pub fn in_ci() -> bool {
    std::env::var_os("CI").is_some_and(|value| !value.is_empty() && value != "false")
}
