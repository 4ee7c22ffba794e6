//! A Python environment with the package, from the library that is built with the program and the files of
//! this checkout.
//!
//! `scripts/python.sh` checks the build with `pip`, which compiles all code once more.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use crate::{in_ci, program};

/// Returns the interpreter of the environment, or `None` without Python, which is a failure on CI. The
/// environment is created once per target folder, with the packages that the tests need.
pub fn python() -> Option<&'static Path> {
    static PYTHON: OnceLock<Option<PathBuf>> = OnceLock::new();
    PYTHON.get_or_init(make).as_deref()
}

/// Returns the folder of the libraries that are built with the program.
pub fn libraries() -> PathBuf {
    program().parent().unwrap().to_owned()
}

/// Returns the folder of the Python package.
pub fn python_folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .unwrap()
        .join("python")
}

fn make() -> Option<PathBuf> {
    if let Err(e) = Command::new("python3").arg("--version").output() {
        assert!(!in_ci(), "python3: {e}");
        eprintln!("not run: python3 ({e}); scripts/setup.sh --for test");
        return None;
    }
    let (source, environment) = (python_folder(), libraries().join("python"));
    // Several test programs may run at the same time. The lock file is outside the folder, because the folder
    // is emptied.
    let lock = File::create(libraries().join("python.lock")).unwrap();
    lock.lock().unwrap();
    let python = environment.join("bin/python");
    let wanted = fs::read(source.join("pyproject.toml")).unwrap();
    let stamp = environment.join(".made-of");
    if fs::read(&stamp).is_ok_and(|made_of| made_of == wanted) {
        install(&python, &source);
        return Some(python);
    }
    run(Command::new("python3")
        .args(["-m", "venv", "--clear"])
        .arg(&environment));
    let names = "import sys, re; text = open(sys.argv[1]).read(); \
                 print(*re.findall(r'\"([^\"]+)\"', re.search(r'^test = \\[(.*)\\]', text, re.M).group(1)))";
    let names = run(Command::new(&python)
        .args(["-c", names])
        .arg(source.join("pyproject.toml")));
    let mut pip = Command::new(&python);
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "numpy",
    ]);
    run(pip.args(names.split_whitespace()));
    install(&python, &source);
    fs::write(stamp, wanted).unwrap();
    Some(python)
}

/// Copies the package into the environment.
fn install(python: &Path, source: &Path) {
    let place = run(Command::new(python).args([
        "-c",
        "import sysconfig; print(sysconfig.get_path('purelib'))",
    ]));
    let package = Path::new(place.trim()).join("sightline");
    fs::create_dir_all(&package).unwrap();
    for entry in fs::read_dir(source.join("python/sightline"))
        .unwrap()
        .map(Result::unwrap)
    {
        if entry.path().is_file() {
            put(&entry.path(), &package.join(entry.file_name()));
        }
    }
    let name = libraries().join("lib_sightline.so");
    let native = [name.clone(), name.with_extension("dylib")]
        .into_iter()
        .find(|native| native.is_file());
    let native = native
        .unwrap_or_else(|| panic!("{} is not there: cargo build --workspace", name.display()));
    put(&native, &package.join("_sightline.abi3.so"));
}

/// Copies a file unless an equal file exists. The replacement is atomic for readers of the older file.
fn put(from: &Path, to: &Path) {
    let bytes = fs::read(from).unwrap();
    if !fs::read(to).is_ok_and(|there| there == bytes) {
        let new = to.with_extension("new");
        fs::write(&new, bytes).unwrap();
        fs::rename(new, to).unwrap();
    }
}

fn run(command: &mut Command) -> String {
    let out = command
        .output()
        .unwrap_or_else(|e| panic!("{command:?}: {e}"));
    assert!(
        out.status.success(),
        "{command:?}: {}{}",
        String::from_utf8_lossy(&out.stderr),
        String::from_utf8_lossy(&out.stdout)
    );
    String::from_utf8(out.stdout).unwrap()
}
