//! Output files: a new file appears complete and synced, or the previous file stays.
//!
//! [`NewFile`] writes under a temporary name in the folder of the target. [`NewFile::commit`] syncs the file,
//! renames it, and syncs the folder.
//!
//! # Invariants
//!
//! - After a power cut the target is the previous file or the whole new file, and a committed file stays. The
//!   order of sync, rename and sync ensures this; `tests/tests/output_files.rs` records the system calls with
//!   `strace`.
//! - Every command and every library function that writes a file for users uses this crate.

use std::fs::{File, Metadata};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

/// The access of users to a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// The owner, group and mode of the replaced file, or the mode that the umask permits for a new file. The
    /// user of this process becomes the owner if the system does not allow it to set another owner.
    Shared,
    /// Access for the owner only (mode 0600). The owner of a replaced file stays the owner, or
    /// [`NewFile::commit`] fails.
    Private,
}

/// An output file under a temporary name. If this value is dropped before [`NewFile::commit`], the temporary
/// file is removed.
#[derive(Debug)]
pub struct NewFile {
    part: BufWriter<NamedTempFile>,
    target: PathBuf,
    access: Access,
    /// The open folder of the target, which [`NewFile::commit`] syncs after the rename.
    #[cfg(unix)]
    folder: File,
}

impl NewFile {
    /// Creates the temporary file that [`NewFile::commit`] renames to `path`.
    ///
    /// If `path` is a symbolic link, `commit` replaces the file to which the link points; the link stays.
    ///
    /// # Errors
    /// `path` is a folder, a device, a pipe, the file of standard output or a link to a missing file, or its
    /// folder is absent, not writable or, on Unix, not readable.
    pub fn begin(path: &Path, access: Access) -> io::Result<Self> {
        let (target, replaces) = resolve(path)?;
        let parent = folder_of(&target);
        let mut builder = tempfile::Builder::new();
        // The length of the temporary name does not depend on the target's name, which may be as long as the
        // file system permits.
        builder.prefix(".sightline-part-").rand_bytes(12);
        #[cfg(unix)]
        if access == Access::Shared && !replaces {
            // The umask of the process applies; without this line the mode is 0600.
            builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
        }
        #[cfg(not(unix))]
        let _ = replaces;
        let part = builder.tempfile_in(parent)?;
        Ok(Self {
            part: BufWriter::new(part),
            #[cfg(unix)]
            folder: File::open(parent)?,
            target,
            access,
        })
    }

    /// Syncs the file, renames it to its target, and syncs the folder.
    ///
    /// # Errors
    /// If the file cannot be written, synced or renamed, the target is unchanged. If the folder cannot be
    /// synced, the target is the new file, as the message states.
    pub fn commit(self) -> io::Result<()> {
        let part = self
            .part
            .into_inner()
            .map_err(io::IntoInnerError::into_error)?;
        match std::fs::metadata(&self.target) {
            Ok(before) => pass_on(&before, part.as_file(), self.access)?,
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            Err(e) => return Err(e),
        }
        part.as_file().sync_all()?;
        part.persist(&self.target).map_err(|e| e.error)?;
        #[cfg(unix)]
        match self.folder.sync_all() {
            // Some network file systems cannot sync a folder; their servers sync a rename.
            Err(e)
                if matches!(
                    e.kind(),
                    io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported
                ) => {}
            Err(e) => {
                let text = format!("the file is complete, but its folder cannot be synced: {e}");
                return Err(io::Error::new(e.kind(), text));
            }
            Ok(()) => {}
        }
        Ok(())
    }
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.part.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.part.flush()
    }
}

/// Writes `bytes` as the whole content of the file `path`, with [`Access::Shared`].
///
/// # Errors
/// See [`NewFile::begin`] and [`NewFile::commit`].
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> io::Result<()> {
    let mut file = NewFile::begin(path, Access::Shared)?;
    file.write_all(bytes.as_ref())?;
    file.commit()
}

/// Checks that the file `path` can be written, before a command computes the content. The check leaves no
/// file.
///
/// # Errors
/// See [`NewFile::begin`].
pub fn check(path: &Path) -> io::Result<()> {
    NewFile::begin(path, Access::Shared).map(drop)
}

/// Returns the path with symbolic links resolved, and true if a file exists at this path.
fn resolve(path: &Path) -> io::Result<(PathBuf, bool)> {
    let refuse = |reason: &str| Err(io::Error::new(io::ErrorKind::InvalidInput, reason));
    match std::fs::metadata(path) {
        // Check the type of the file first: the link /dev/stdout can point to a pipe, which has no path.
        Ok(before) if before.is_dir() => refuse("the path is a folder; name a file"),
        Ok(before) if !before.is_file() => {
            refuse("the path is not an ordinary file but a device or a pipe; name a file")
        }
        Ok(before) if is_stdout(&before)? => {
            refuse("standard output is redirected to this file; name another file")
        }
        Ok(_) => Ok((std::fs::canonicalize(path)?, true)),
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(e),
        Err(_) if path.is_symlink() => {
            refuse("the path is a link to a missing file; remove the link, or name another file")
        }
        Err(_) => Ok((path.to_owned(), false)),
    }
}

/// Returns true if standard output is redirected to this file. A replacement would lose later lines of
/// output.
fn is_stdout(file: &Metadata) -> io::Result<bool> {
    #[cfg(unix)]
    {
        use std::os::fd::AsFd as _;
        use std::os::unix::fs::MetadataExt as _;
        let stdout = File::from(io::stdout().as_fd().try_clone_to_owned()?).metadata()?;
        Ok((stdout.dev(), stdout.ino()) == (file.dev(), file.ino()))
    }
    #[cfg(not(unix))]
    {
        let _ = file;
        Ok(false)
    }
}

/// Returns the folder that contains the file `path`; `.` for a file name without a folder.
pub fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Copies the owner and group of the replaced file (`before`) to the new file (`file`), and sets the mode:
/// the mode of the replaced file for [`Access::Shared`], 0600 for [`Access::Private`].
#[cfg(unix)]
fn pass_on(before: &Metadata, file: &File, access: Access) -> io::Result<()> {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, fchown};
    let now = file.metadata()?;
    if (now.uid(), now.gid()) != (before.uid(), before.gid()) {
        match fchown(file, Some(before.uid()), Some(before.gid())) {
            // Only root can give a file to another owner, and only to an owner in its user namespace. Without
            // this right, the user who writes the file remains the owner.
            Err(e)
                if access == Access::Shared
                    && matches!(
                        e.kind(),
                        io::ErrorKind::PermissionDenied | io::ErrorKind::InvalidInput
                    ) => {}
            done => done?,
        }
    }
    let mode = if access == Access::Shared {
        before.mode() & 0o777
    } else {
        0o600
    };
    file.set_permissions(std::fs::Permissions::from_mode(mode))
}

/// Does nothing: on systems other than Unix, a new file inherits its access rights from the folder.
#[cfg(not(unix))]
fn pass_on(_: &Metadata, _: &File, _: Access) -> io::Result<()> {
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let name = |e: io::Result<std::fs::DirEntry>| e.unwrap().file_name().into_string().unwrap();
        let mut names: Vec<_> = std::fs::read_dir(folder).unwrap().map(name).collect();
        names.sort();
        names
    }

    #[test]
    fn target_changes_at_commit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out");
        write(&path, "old").unwrap();
        let mut file = NewFile::begin(&path, Access::Shared).unwrap();
        file.write_all(b"new").unwrap();
        file.flush().unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        drop(file);
        assert_eq!(names(folder.path()), ["out"]);
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        write(&path, "new").unwrap();
        assert_eq!(names(folder.path()), ["out"]);
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }

    #[test]
    fn longest_name_is_writable() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("n".repeat(255));
        write(&path, "bytes").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"bytes");
    }

    #[test]
    fn folder_and_absent_folder_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        assert!(
            check(folder.path())
                .unwrap_err()
                .to_string()
                .contains("is a folder")
        );
        let absent = check(&folder.path().join("none/out")).unwrap_err();
        assert_eq!(absent.kind(), io::ErrorKind::NotFound);
        check(&folder.path().join("out")).unwrap();
        assert!(names(folder.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn devices_pipes_and_dangling_links_are_rejected() {
        let folder = tempfile::tempdir().unwrap();
        let device = check(Path::new("/dev/null")).unwrap_err().to_string();
        assert!(device.contains("not an ordinary file"), "{device}");
        let link = folder.path().join("link");
        std::os::unix::fs::symlink("nothing", &link).unwrap();
        let dangling = check(&link).unwrap_err().to_string();
        assert!(dangling.contains("link to a missing file"), "{dangling}");
        // A pipe has no path, although a link under /proc leads to it.
        let (reader, _writer) = std::io::pipe().unwrap();
        let pipe = format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&reader));
        if Path::new("/proc/self/fd").is_dir() {
            let pipe = check(Path::new(&pipe)).unwrap_err().to_string();
            assert!(pipe.contains("a device or a pipe"), "{pipe}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn link_stays_and_its_target_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        std::fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink("real", &link).unwrap();
        write(&link, "new").unwrap();
        assert!(link.is_symlink());
        assert_eq!(std::fs::read(&real).unwrap(), b"new");
    }

    #[cfg(unix)]
    #[test]
    fn mode_of_replaced_file_stays() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o7777;
        let path = folder.path().join("out");
        for before in [0o600, 0o644, 0o664, 0o666, 0o440] {
            std::fs::write(&path, "old").unwrap();
            std::fs::set_permissions(&path, PermissionsExt::from_mode(before)).unwrap();
            write(&path, "new").unwrap();
            assert_eq!(mode(&path), before);
            std::fs::remove_file(&path).unwrap();
        }
        // A new file has the mode that the umask permits, which any other file shows.
        std::fs::write(folder.path().join("other"), "").unwrap();
        write(&path, "new").unwrap();
        assert_eq!(mode(&path), mode(&folder.path().join("other")));
        let private = folder.path().join("private");
        for _ in 0..2 {
            NewFile::begin(&private, Access::Private)
                .unwrap()
                .commit()
                .unwrap();
            assert_eq!(mode(&private), 0o600);
            std::fs::set_permissions(&private, PermissionsExt::from_mode(0o644)).unwrap();
        }
    }
}
