//! The folder of a case: the files of each stage, their removal or renaming after a failure, and
//! the lock that allows only one run at a time.

use crate::status::{Identity, Stage, State, Status, Verdict};
use isoparticles_stage::error::{Error, Result};
use std::fs::File;
use std::path::{Path, PathBuf};

/// A folder that contains the results of one case.
#[derive(Debug)]
pub struct CaseFolder {
    /// Path of the folder, OUT/NAME.
    pub path: PathBuf,
    /// Name of the case.
    pub name: String,
}

/// The files of a stage in the folder of a case, and the suffixes of the files that are kept if the
/// stage fails.
#[derive(Clone, Copy, Debug)]
pub struct Belongings {
    /// Name of the stage.
    pub stage: &'static str,
    /// Suffix of the output file, NAME.SUFFIX.
    pub output: &'static str,
    /// The files named NAME.STEM or NAME.STEM.* belong to the stage.
    pub stems: &'static [&'static str],
    /// Subfolders of the case's folder that belong to the stage.
    pub folders: &'static [&'static str],
    /// Suffixes of the results that are kept, with `.failed` in their names, if a check fails.
    pub set_aside: &'static [&'static str],
    /// Suffixes of the files that explain a failure. These files keep their names.
    pub explains: &'static [&'static str],
}

/// All stages in the order in which they run. The page of the case does not belong to any stage.
pub const STAGES: [Belongings; 8] = [
    Belongings {
        stage: "phantom",
        output: "nrrd",
        stems: &["nrrd", "truth"],
        folders: &[],
        set_aside: &[],
        explains: &[],
    },
    Belongings { stage: "read", output: "input.vti", stems: &["input"], folders: &[], set_aside: &[], explains: &[] },
    Belongings {
        stage: "distfield",
        output: "distfield.vti",
        stems: &["distfield"],
        folders: &[],
        set_aside: &["distfield.vti"],
        explains: &[],
    },
    Belongings {
        stage: "sizefield",
        output: "sizefield.vti",
        stems: &["sizefield"],
        folders: &[],
        set_aside: &["sizefield.vti"],
        explains: &[],
    },
    Belongings {
        stage: "seed",
        output: "seeds.bin",
        stems: &["seeds"],
        folders: &[],
        set_aside: &["seeds.bin"],
        explains: &[],
    },
    Belongings {
        stage: "particles",
        output: "particles.bin",
        stems: &["particles", "passes", "checkpoint"],
        folders: &[],
        set_aside: &["particles.bin"],
        explains: &["passes.csv", CHECKPOINT],
    },
    Belongings {
        stage: "reconstruct",
        output: "surface.vtp",
        stems: &["surface"],
        folders: &["updates"],
        set_aside: &["surface.vtp"],
        explains: &["surface.offending.vtp"],
    },
    Belongings {
        stage: "tetmesh-check",
        output: "volume.vtu",
        stems: &["volume", "boundary", "tetrahedra", "report"],
        folders: &[PICTURES],
        set_aside: &["volume.vtu", REPORT],
        explains: &["tetrahedra.log"],
    },
];

/// Suffix of the checkpoint file, from which a stopped run of `particles` resumes.
pub const CHECKPOINT: &str = "checkpoint.bin";
/// Suffix of the report of `tetmesh-check`, which is also a result of the case.
pub const REPORT: &str = "report.json";
/// Suffix of the page of the case.
pub const PAGE: &str = "report.html";
/// Folder of the stages' reports.
pub const REPORTS: &str = "reports";
/// Folder of the pictures, within the folder of the case.
pub const PICTURES: &str = "pictures";
/// Name of the lock file in the folder of a case.
const LOCK: &str = ".lock";
/// Names of unfinished files start with the first string and contain the second
/// (`common/file/src/output.rs`, `files.py` of tetmesh-check).
const PARTIAL_NAME: (&str, &str) = (".isoparticles-", ".partial");

/// Returns the files of the stage called `stage`.
///
/// # Panics
/// If there is no such stage.
#[must_use]
pub fn belongings(stage: &str) -> &'static Belongings {
    STAGES.iter().find(|known| known.stage == stage).expect("a stage of the table")
}

/// Lock that a run holds while it works in a folder. The operating system releases the lock when
/// the process ends, even after a crash.
#[derive(Debug)]
pub struct Lock {
    _file: File,
    /// Whether the file system supports locks, so that no other run can hold the same lock.
    certain: bool,
}

impl CaseFolder {
    /// Returns the folder of a case. Creates nothing on disk.
    #[must_use]
    pub fn new(out: &Path, name: &str) -> Self {
        Self { path: out.join(name), name: name.to_owned() }
    }

    /// Returns the name of the file of the case that has the suffix `ending`.
    #[must_use]
    pub fn file_name(&self, ending: &str) -> String {
        format!("{}.{ending}", self.name)
    }

    /// Returns the path of the file of the case that has the suffix `ending`.
    #[must_use]
    pub fn file(&self, ending: &str) -> PathBuf {
        self.path.join(self.file_name(ending))
    }

    /// Returns the path of the status file.
    #[must_use]
    pub fn status_path(&self) -> PathBuf {
        self.file("status.json")
    }

    /// Creates the folder, acquires the lock and removes unfinished files of killed programs. This
    /// is safe because only the run with the lock writes to the folder.
    ///
    /// # Errors
    /// If the folder cannot be created, or another run is using it.
    pub fn lock(&self) -> Result<Lock> {
        std::fs::create_dir_all(self.path.join(REPORTS)).map_err(|error| {
            Error::file(&self.path, "create the folder", &error, "check OUT, its permissions and the free disk space")
        })?;
        let lock = self.try_lock()?.ok_or_else(|| {
            Error::input(
                format!("{}: another run is working on this case", self.path.display()),
                "two runs would overwrite each other's files",
                "wait until it ends, stop it, or set another NAME",
            )
        })?;
        if lock.certain {
            self.remove_partial();
        }
        Ok(lock)
    }

    /// Removes unfinished files. Ignores errors, because later runs do not read these files.
    fn remove_partial(&self) {
        let folders = [self.path.clone(), self.path.join(REPORTS), self.path.join(PICTURES)];
        for entry in folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with(PARTIAL_NAME.0) && name.contains(PARTIAL_NAME.1) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Acquires the lock of an existing folder. Returns `None` if another run holds it.
    fn try_lock(&self) -> Result<Option<Lock>> {
        let path = self.path.join(LOCK);
        let file = File::options().create(true).truncate(false).write(true).open(&path);
        let file = file.map_err(|error| Error::file(&path, "write", &error, "check the folder's permissions"))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Lock { _file: file, certain: true })),
            Err(std::fs::TryLockError::WouldBlock) => Ok(None),
            // On a file system without locks, a second run cannot be detected.
            Err(std::fs::TryLockError::Error(_)) => Ok(Some(Lock { _file: file, certain: false })),
        }
    }

    /// Reads the status and marks it as interrupted if its run was killed. Returns `None` if there
    /// is no readable status. The status of a run in progress is left unchanged.
    ///
    /// # Errors
    /// If the corrected status cannot be written.
    pub fn settle(&self) -> Result<Option<Status>> {
        let path = self.status_path();
        let Some(status) = Status::read(&path) else { return Ok(None) };
        if status.verdict != Verdict::Running {
            return Ok(Some(status));
        }
        let Some(_lock) = self.try_lock()? else { return Ok(Some(status)) };
        let status = interrupted(status);
        status.write(&path)?;
        Ok(Some(status))
    }

    /// Returns the names of the files that belong to a stage, including files in its subfolders, in
    /// sorted order.
    #[must_use]
    pub fn files_of(&self, stage: &Belongings) -> Vec<String> {
        let mut files: Vec<String> = self.listing("").into_iter().filter(|name| self.owns(stage, name)).collect();
        for folder in stage.folders {
            files.extend(self.listing(folder));
        }
        files.sort();
        files
    }

    /// Returns whether a file with this name belongs to a stage.
    fn owns(&self, stage: &Belongings, name: &str) -> bool {
        let Some(rest) = name.strip_prefix(&self.name).and_then(|rest| rest.strip_prefix('.')) else { return false };
        let starts = |stem: &str| rest.strip_prefix(stem).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
        rest != PAGE && stage.stems.iter().any(|stem| starts(stem))
    }

    /// Returns the names of the files in a subfolder, relative to the folder of the case.
    fn listing(&self, folder: &str) -> Vec<String> {
        let Ok(entries) = std::fs::read_dir(self.path.join(folder)) else { return Vec::new() };
        let prefix = if folder.is_empty() { String::new() } else { format!("{folder}/") };
        let files = entries.flatten().filter(|entry| !entry.path().is_dir());
        files.map(|entry| format!("{prefix}{}", entry.file_name().to_string_lossy())).collect()
    }

    /// Returns whether a name is one of a stage's fixed file names, with or without `.failed`.
    #[must_use]
    pub fn is_usual(&self, stage: &Belongings, name: &str) -> bool {
        let usual = std::iter::once(&stage.output).chain(stage.set_aside).chain(stage.explains);
        usual.into_iter().any(|ending| name == self.file_name(ending) || name == self.file_name(&failed(ending)))
    }

    /// Removes the report of a stage and the files that the stage made, except files with the
    /// suffixes in `keep`. A file counts as made by the stage if it has one of the stage's fixed
    /// names or is listed in the status. If the stage was interrupted or killed, every file with
    /// one of the stage's stems counts. Other files belong to the user and are left in place.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn remove_files_of(&self, stage: &Belongings, earlier: Option<&Stage>, keep: &[&str]) -> Result<()> {
        for name in self.made_before(stage, earlier) {
            if !keep.iter().any(|ending| name == self.file_name(ending)) {
                self.remove(&name)?;
            }
        }
        for folder in stage.folders {
            // This fails if the folder contains other files, which are left in place.
            let _ = std::fs::remove_dir(self.path.join(folder));
        }
        self.remove(&report_name(stage.stage))
    }

    /// Returns the names of the files that a stage made in an earlier run.
    #[must_use]
    pub fn made_before(&self, stage: &Belongings, earlier: Option<&Stage>) -> Vec<String> {
        let killed = earlier.is_some_and(|stage| matches!(stage.state, State::Running | State::Interrupted));
        let listed = |name: &String| earlier.is_some_and(|it| it.outputs.contains(name) || it.kept.contains(name));
        let mut files = self.files_of(stage);
        files.retain(|name| killed || listed(name) || self.is_usual(stage, name));
        files
    }

    /// Removes a file if it exists.
    ///
    /// # Errors
    /// If the file exists and cannot be removed.
    pub fn remove(&self, name: &str) -> Result<()> {
        let path = self.path.join(name);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(Error::file(
                &path,
                "remove",
                &error,
                "delete it yourself, because it is out of date, or correct the folder's permissions",
            )),
            _ => Ok(()),
        }
    }

    /// Inserts `.failed` into the names of a failed stage's results, keeps its pictures and the
    /// files that explain the failure, and removes its other files. Files in `others` existed
    /// before the run and are left in place. Returns the names of the kept files.
    ///
    /// # Errors
    /// If a file cannot be renamed or removed.
    pub fn set_aside(&self, stage: &Belongings, others: &[String]) -> Result<Vec<String>> {
        let mut kept = Vec::new();
        for name in self.files_of(stage).into_iter().filter(|name| !others.contains(name)) {
            let is = |ending: &&&str| name == self.file_name(ending);
            if let Some(ending) = stage.set_aside.iter().find(is) {
                let aside = self.file_name(&failed(ending));
                let (from, to) = (self.path.join(&name), self.path.join(&aside));
                std::fs::rename(&from, &to)
                    .map_err(|error| Error::file(&from, "rename", &error, "check the folder's permissions"))?;
                kept.push(aside);
            } else if name.contains('/') || stage.explains.iter().any(|ending| is(&ending)) {
                kept.push(name);
            } else {
                self.remove(&name)?;
            }
        }
        kept.sort();
        Ok(kept)
    }

    /// Returns the size and modification time of each file, by name, so that later changes can be
    /// detected.
    #[must_use]
    pub fn identities(&self, names: &[String]) -> std::collections::BTreeMap<String, Identity> {
        names.iter().filter_map(|name| Some((name.clone(), Identity::of(&self.path.join(name))?))).collect()
    }

    /// Returns whether every output of a stage is unchanged since the stage wrote it.
    #[must_use]
    pub fn is_intact(&self, stage: &Stage) -> bool {
        let same = |(name, identity): (&String, &Identity)| Identity::of(&self.path.join(name)) == Some(*identity);
        stage.identities.len() == stage.outputs.len() && stage.identities.iter().all(same)
    }

    /// Removes the whole folder. Returns `false` if it does not exist.
    ///
    /// # Errors
    /// If the folder does not belong to a case, another run is working in it, or it cannot be
    /// removed.
    pub fn clean(&self) -> Result<bool> {
        if !self.path.exists() {
            return Ok(false);
        }
        // a volume alone, NAME.nrrd, may be the user's
        let made = STAGES.iter().filter(|stage| stage.stage != "phantom");
        let known = made.into_iter().any(|stage| !self.files_of(stage).is_empty());
        if !known && !self.status_path().exists() && !self.path.join(LOCK).exists() {
            return Err(Error::input(
                format!("{}: contains no results of a case", self.path.display()),
                "clean removes only folders of cases",
                "check NAME and OUT, or delete the folder yourself",
            ));
        }
        let _lock = self.lock()?;
        std::fs::remove_dir_all(&self.path)
            .map_err(|error| Error::file(&self.path, "remove", &error, "check the folder's permissions"))?;
        Ok(true)
    }
}

/// Returns the suffix under which a result is kept after a failed check: `volume.vtu` becomes
/// `volume.failed.vtu`.
fn failed(ending: &str) -> String {
    ending.rsplit_once('.').map_or_else(|| format!("{ending}.failed"), |(stem, kind)| format!("{stem}.failed.{kind}"))
}

/// Returns the path of a stage's report, relative to the folder of the case.
#[must_use]
pub fn report_name(stage: &str) -> String {
    format!("{REPORTS}/{stage}.json")
}

/// Corrects the status of a killed run by marking its running stages as interrupted.
fn interrupted(mut status: Status) -> Status {
    let mut at = String::from("before its first stage");
    for stage in status.stages.iter_mut().filter(|stage| stage.state == State::Running) {
        stage.state = State::Interrupted;
        at = format!("in {}", stage.stage);
    }
    status.verdict = Verdict::Interrupted;
    status.headline = format!("The run was killed {at}; run it again.");
    status.page = None;
    status
}

#[cfg(test)]
mod tests {
    use super::CaseFolder;

    /// A SIGKILL during a write leaves an unfinished file behind (found by `tests/kills.py`). The
    /// next run must remove this file.
    #[test]
    fn what_a_killed_program_had_begun_to_write_is_taken_away() {
        let out = tempfile::tempdir().expect("folder");
        let folder = CaseFolder::new(out.path(), "case");
        drop(folder.lock().expect("free"));
        let begun = [".isoparticles-a1b2c3.partial", "reports/.isoparticles-x.partial"];
        let begun = begun.iter().chain(&[".isoparticles-case.volume.17.partial.vtu"]);
        for name in begun.clone().chain(&["case.volume.vtu", ".isoparticles-mine"]) {
            std::fs::write(folder.path.join(name), b"half").expect("written");
        }
        let lock = folder.lock().expect("free");
        assert!(begun.clone().all(|name| !folder.path.join(name).exists()));
        assert!(folder.path.join("case.volume.vtu").exists() && folder.path.join(".isoparticles-mine").exists());
        // A run without the lock removes nothing.
        std::fs::write(folder.path.join(".isoparticles-a1b2c3.partial"), b"half").expect("written");
        folder.lock().expect_err("held");
        assert!(folder.path.join(".isoparticles-a1b2c3.partial").exists());
        drop(lock);
    }

    #[test]
    fn a_folder_with_only_a_volume_is_not_removed() {
        let out = tempfile::tempdir().expect("folder");
        let folder = CaseFolder::new(out.path(), "case");
        std::fs::create_dir(&folder.path).expect("made");
        std::fs::write(folder.path.join("case.nrrd"), b"the user's").expect("written");
        folder.clean().expect_err("no case");
        std::fs::write(folder.path.join("case.surface.vtp"), b"a result").expect("written");
        assert!(folder.clean().expect("a case") && !folder.path.exists());
    }
}
