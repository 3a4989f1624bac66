//! Writes output files. [`check_output`] checks a path before the computation starts.
//! [`write_atomically`] writes under a temporary name in the same folder, and renames the file when
//! it is complete.

use crate::error::{Error, Result};
use crate::interrupt;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Paths of the temporary files that currently exist. A second interrupt deletes the files.
static TEMPORARIES: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Checks that an output file can be written.
///
/// # Errors
/// If the file exists and `force` is false, if the path is a folder, or if the containing folder is
/// not writable.
pub fn check_output(path: &Path, force: bool) -> Result<()> {
    if path.is_dir() {
        return Err(Error::Folder { path: path.to_path_buf() });
    }
    if path.exists() && !is_special(path) && !force {
        return Err(Error::Exists { path: path.to_path_buf() });
    }
    if is_special(path) {
        return Ok(());
    }
    temporary_beside(path).map(drop).map_err(|source| Error::Write { path: path.to_path_buf(), source })
}

/// Writes a file atomically: the file appears under its name only when it is complete. After an
/// error (such as a full disk) or an interrupt, the old file is unchanged and no temporary file
/// remains. Devices and pipes are written directly.
pub fn write_atomically(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    let attempt = if is_special(path) { write_through(path, write) } else { write_and_rename(path, write) };
    attempt.map_err(|error| {
        if error.get_ref().is_some_and(|source| source.is::<Stopped>()) {
            Error::Interrupted { path: path.to_path_buf() }
        } else {
            Error::Write { path: path.to_path_buf(), source: error }
        }
    })
}

/// Deletes the temporary files of this process. Called before the process exits after a second
/// interrupt.
pub fn remove_temporaries() {
    for path in temporaries().drain(..) {
        // ignore the error if the file no longer exists
        let _ = std::fs::remove_file(path);
    }
}

fn write_and_rename(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    // Keep a symbolic link and replace its target.
    let target = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let path = target.as_path();
    let temporary = temporary_beside(path)?;
    let name = temporary.path().to_path_buf();
    temporaries().push(name.clone());
    let result = fill(temporary.as_file(), write).and_then(|()| {
        temporary.as_file().sync_all()?;
        temporary.persist(path).map_err(|error| error.error).map(drop)
    });
    temporaries().retain(|other| *other != name);
    result
}

/// Writes directly to a device or pipe, which cannot be replaced by renaming.
fn write_through(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    fill(&File::options().write(true).open(path)?, write)
}

fn fill(file: &File, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let mut writer = BufWriter::with_capacity(1 << 18, Stoppable { file, stopped_before: interrupt::requested() });
    write(&mut writer)?;
    writer.flush()
}

fn temporary_beside(path: &Path) -> io::Result<tempfile::NamedTempFile> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".isoparticles-").suffix(".partial");
    #[cfg(unix)]
    {
        // Let the user's umask determine the permissions, as for any new file. By default, tempfile
        // gives access only to the owner.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

fn is_special(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file() && !metadata.is_dir())
}

fn temporaries() -> std::sync::MutexGuard<'static, Vec<PathBuf>> {
    TEMPORARIES.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A file that rejects writes after an interrupt. Files that are opened after the interrupt, such
/// as reports and final checkpoints, still accept writes.
struct Stoppable<'a> {
    file: &'a File,
    stopped_before: bool,
}

#[derive(Debug, thiserror::Error)]
#[error("interrupted")]
struct Stopped;

impl Write for Stoppable<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if !self.stopped_before && interrupt::requested() {
            return Err(io::Error::other(Stopped));
        }
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(folder)
            .expect("folder")
            .map(|entry| entry.expect("entry").file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn an_error_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("out.bin");
        write_atomically(&path, |file| file.write_all(b"first")).expect("written");
        let error = write_atomically(&path, |file| {
            file.write_all(&[0; 1 << 20])?;
            Err(io::Error::from(io::ErrorKind::StorageFull))
        })
        .expect_err("full");
        assert!(error.remedy().contains("free some disk space"), "{error}");
        assert_eq!(std::fs::read(&path).expect("kept"), b"first");
        assert_eq!(names(folder.path()), ["out.bin"]);
    }

    #[test]
    fn outputs_are_checked_before_the_work() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("out.bin");
        check_output(&path, false).expect("free");
        assert!(names(folder.path()).is_empty());
        std::fs::write(&path, b"x").expect("written");
        assert!(check_output(&path, false).expect_err("exists").to_string().contains("already exists"));
        check_output(&path, true).expect("forced");
        assert!(check_output(folder.path(), true).is_err());
        let absent = folder.path().join("absent/out.bin");
        assert!(check_output(&absent, false).expect_err("no folder").remedy().contains("create the folder"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_device_is_an_error() {
        let path = Path::new("/dev/full");
        check_output(path, false).expect("a device is never replaced");
        let error = write_atomically(path, |file| file.write_all(&[1; 4096])).expect_err("full");
        assert!(error.to_string().contains("/dev/full") && error.remedy().contains("free some disk space"), "{error}");
    }
}
