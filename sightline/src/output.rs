//! Output files of commands: the rules for existing files, on top of the synced replacement of
//! `sightline_files`.
//!
//! Only a file of the same format is replaced, because a user may give `-o` the name of the model by mistake.

use std::fs::File;
use std::io::{Read as _, Write};
use std::path::{Path, PathBuf};

use sightline_files::{Access, NewFile, folder_of as folder};

use crate::error::Error;

/// The format of an output file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A result.
    Pvs,
    /// A scene as binary PLY.
    Ply,
    /// A scene as binary glTF.
    Glb,
    /// A scene as glTF in JSON.
    Gltf,
    /// A page.
    Html,
    /// A document of `export`.
    Json,
    /// A table of `export`.
    Csv,
    /// A picture.
    Png,
    /// Cells between surfaces.
    Tets,
    /// Tetrahedra for VTK.
    Vtu,
}

impl Format {
    /// Returns the first bytes of a file of this format.
    pub fn magic(self) -> &'static [u8] {
        match self {
            Self::Pvs => b"\x89PVS",
            Self::Ply => b"ply\n",
            Self::Glb => b"glTF",
            Self::Gltf => b"{",
            Self::Html => b"<!doctype html><!-- sightline ",
            Self::Json => b"{\"format\"",
            Self::Csv => b"cell,object",
            Self::Png => b"\x89PNG",
            Self::Tets => b"\x89TET",
            Self::Vtu => b"<VTKFile type=\"UnstructuredGrid\"",
        }
    }

    /// Returns the flag that names a file of this format.
    fn flag(self) -> &'static str {
        match self {
            Self::Vtu => "--export",
            Self::Png => "--picture",
            _ => "-o",
        }
    }

    /// Returns the extension of a file of this format, without a dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Pvs => "pvs",
            Self::Ply => "ply",
            Self::Glb => "glb",
            Self::Gltf => "gltf",
            Self::Html => "html",
            Self::Json => "json",
            Self::Csv => "csv",
            Self::Png => "png",
            Self::Tets => "tets",
            Self::Vtu => "vtu",
        }
    }
}

/// Extensions of well-known formats. An output file with one of these extensions must have the format of the
/// extension.
const KNOWN: [&str; 15] = [
    "obj", "ply", "gltf", "glb", "stl", "off", "fbx", "dae", "3mf", "usd", "usdz", "pvs", "html",
    "tets", "vtu",
];

/// A path to which a file may be written.
#[derive(Debug)]
pub struct Output {
    /// The path as the user gave it.
    named: PathBuf,
    /// The path with links resolved.
    target: PathBuf,
}

impl Output {
    /// Checks, before any work, that `path` can be written. Permits replacing only an existing file of the
    /// same format, and never the file `input`.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] with the reason, if the path cannot be written.
    pub fn check(path: &Path, format: Format, input: Option<&Path>) -> Result<Self, Error> {
        let flag = format.flag();
        let refusal =
            |why: String| Error::usage(format!("{} cannot be written: {why}", path.display()));
        let refuse = |why: String| Err(refusal(why));
        if path.as_os_str() == "-" {
            return refuse(format!(
                "results go to files, not to stdout; give {flag} a name"
            ));
        }
        if path
            .as_os_str()
            .to_string_lossy()
            .ends_with(std::path::is_separator)
        {
            return refuse(format!(
                "the path names a folder; give {flag} the name of a file"
            ));
        }
        let extension = path
            .extension()
            .and_then(|e| e.to_str())
            .unwrap_or_default()
            .to_ascii_lowercase();
        if extension != format.extension() && KNOWN.contains(&extension.as_str()) {
            let ours = format.extension();
            return refuse(format!(
                "the name ends in .{extension}, but the command writes a .{ours} file; give {flag} a \
                 name that ends in .{ours}"
            ));
        }
        // Check the path before resolving it: a pipe has no resolved path, although the link /dev/stdout
        // points to it.
        if let Ok(there) = std::fs::metadata(path) {
            if there.is_dir() {
                return refuse(format!(
                    "the path is a folder; give {flag} the name of a file"
                ));
            }
            if !there.is_file() {
                return refuse(format!(
                    "the path is a device or a pipe, not an ordinary file; give {flag} another name"
                ));
            }
        }
        let target = match std::fs::canonicalize(path) {
            Ok(target) => target,
            Err(_) if path.is_symlink() => {
                return refuse(format!(
                    "the path is a link to a missing file; remove the link, or give {flag} another name"
                ));
            }
            Err(_) => path.to_owned(),
        };
        let folder = folder(&target);
        if !folder.is_dir() {
            return refuse(format!(
                "the folder {} does not exist; create it, or give {flag} a file in another folder",
                folder.display()
            ));
        }
        if input.is_some_and(|i| std::fs::canonicalize(i).is_ok_and(|i| i == target)) {
            return refuse(format!(
                "the path is the input itself; give {flag} another name"
            ));
        }
        if target.exists() {
            let mut begins = Vec::new();
            File::open(&target)
                .and_then(|f| f.take(format.magic().len() as u64).read_to_end(&mut begins))
                .map_err(|e| {
                    refusal(format!(
                        "the existing file cannot be read ({e}); give {flag} another name"
                    ))
                })?;
            if !begins.is_empty() && begins != format.magic() {
                return refuse(format!(
                    "the existing file is not a .{} file; remove it, or give {flag} another name",
                    format.extension()
                ));
            }
        }
        // Only a test file shows reliably if the folder is writable.
        sightline_files::check(&target).map_err(|e| {
            refusal(format!(
                "{e}; give {flag} a file in a folder where you may write"
            ))
        })?;
        Ok(Self {
            named: path.to_owned(),
            target,
        })
    }

    /// Returns true if both outputs are the same file.
    pub fn is(&self, other: &Self) -> bool {
        let place = |output: &Self| {
            let folder = std::fs::canonicalize(folder(&output.target)).unwrap_or_default();
            (
                folder,
                output.target.file_name().map(std::ffi::OsStr::to_owned),
            )
        };
        place(self) == place(other)
    }

    /// Returns the path as the user gave it.
    pub fn path(&self) -> &Path {
        &self.named
    }

    /// Writes the file with `fill`, and moves it to its path if `fill` succeeds.
    ///
    /// # Errors
    /// The error of `fill`, or [`crate::ErrorKind::Internal`] if the file cannot be written.
    pub fn write(
        &self,
        fill: impl FnOnce(&mut dyn Write) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let mut part = self.begin()?;
        fill(&mut part)?;
        part.place()
    }

    /// Creates the file under a temporary name.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Internal`] if the file cannot be created.
    pub fn begin(&self) -> Result<PartialFile<'_>, Error> {
        let file = NewFile::begin(&self.target, Access::Shared);
        Ok(PartialFile {
            output: self,
            file: file.map_err(|e| Error::writing(&self.named, &e))?,
        })
    }
}

/// A file under a temporary name. If it is dropped before [`PartialFile::place`], the file is removed.
#[derive(Debug)]
pub struct PartialFile<'a> {
    output: &'a Output,
    file: NewFile,
}

impl PartialFile<'_> {
    /// Syncs the complete file and moves it to its path.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Internal`] if the file cannot be written, synced or moved.
    pub fn place(self) -> Result<(), Error> {
        self.file
            .commit()
            .map_err(|e| Error::writing(&self.output.named, &e))
    }
}

impl Write for PartialFile<'_> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(path: &Path) -> Result<Output, String> {
        Output::check(path, Format::Pvs, None).map_err(|e| e.to_string())
    }

    #[test]
    fn only_older_result_is_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("model"), "v 0 0 0\n").unwrap();
        std::fs::write(at("old.pvs"), b"\x89PVS\r\n\x1a\nrest").unwrap();
        std::fs::write(at("empty.pvs"), b"").unwrap();
        std::fs::create_dir(at("folder")).unwrap();
        assert!(check(&at("model")).unwrap_err().contains("not a .pvs"));
        assert!(check(&at("folder")).unwrap_err().contains("folder"));
        assert!(
            check(&at("none/a.pvs"))
                .unwrap_err()
                .contains("does not exist")
        );
        assert!(check(&at("a.glb")).unwrap_err().contains(".glb"));
        assert!(
            check(&dir.path().join("new/"))
                .unwrap_err()
                .contains("names a folder")
        );
        assert!(check(Path::new("-")).unwrap_err().contains("stdout"));
        for name in ["old.pvs", "empty.pvs", "new.pvs", "name"] {
            check(&at(name)).unwrap();
            assert_eq!(at(name).exists(), name == "old.pvs" || name == "empty.pvs");
        }
        assert_eq!(std::fs::read_to_string(at("model")).unwrap(), "v 0 0 0\n");
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_rejected_and_links_followed() {
        assert!(
            check(Path::new("/dev/null"))
                .unwrap_err()
                .contains("not an ordinary file")
        );
        let dir = tempfile::tempdir().unwrap();
        let (real, link) = (dir.path().join("real.pvs"), dir.path().join("link.pvs"));
        std::os::unix::fs::symlink(&real, &link).unwrap();
        assert!(check(&link).unwrap_err().contains("link to a missing file"));
        std::fs::write(&real, b"").unwrap();
        let write = |out: &mut dyn Write| out.write_all(b"new").map_err(Error::internal);
        check(&link).unwrap().write(write).unwrap();
        assert_eq!(std::fs::read(&real).unwrap(), b"new");
        assert!(link.is_symlink());
    }

    #[test]
    fn scene_is_never_output_and_failed_write_leaves_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let scene = dir.path().join("scene");
        std::fs::write(&scene, b"\x89PVS").unwrap();
        let spelled = dir.path().join(".").join("scene");
        let refused = Output::check(&spelled, Format::Pvs, Some(&scene)).unwrap_err();
        assert!(
            refused.to_string().contains("the input itself"),
            "{refused}"
        );
        let output = check(&dir.path().join("out.pvs")).unwrap();
        let fail = |_: &mut dyn Write| -> Result<(), Error> { Err(Error::job("no")) };
        assert_eq!(
            output.write(fail).unwrap_err().kind(),
            crate::ErrorKind::Job
        );
        output.begin().unwrap().write_all(b"half").unwrap();
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    }
}
