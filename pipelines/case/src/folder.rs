//! The folder of a case: which files belong to which stage, how they are removed or kept after a
//! failure, and the lock that admits one run at a time.

use crate::status::{Identity, Stage, State, Status, Verdict};
use isoparticles_stage::error::{Error, Result};
use std::fs::File;
use std::path::{Path, PathBuf};

/// A folder that holds the results of one case.
#[derive(Debug)]
pub struct CaseFolder {
    /// OUT/NAME.
    pub path: PathBuf,
    /// NAME.
    pub name: String,
}

/// The files of a stage in the folder of a case, and which of them are kept when it fails.
#[derive(Clone, Copy, Debug)]
pub struct Belongings {
    /// Name of the stage.
    pub stage: &'static str,
    /// The output is the file NAME with this ending.
    pub output: &'static str,
    /// Files named NAME.STEM and NAME.STEM.* belong to it.
    pub stems: &'static [&'static str],
    /// Subfolders of the case's folder that belong to it.
    pub folders: &'static [&'static str],
    /// Endings of results that are renamed with `.failed` when a check fails.
    pub set_aside: &'static [&'static str],
    /// Endings of files that explain a failure and keep their names.
    pub explains: &'static [&'static str],
}

/// All stages in order. The page belongs to none of them.
pub const STAGES: [Belongings; 7] = [
    Belongings {
        stage: "phantom",
        output: "nrrd",
        stems: &["nrrd", "truth"],
        folders: &[],
        set_aside: &[],
        explains: &[],
    },
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
        folders: &[],
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

/// Ending of the checkpoint from which a stopped run of `particles` resumes.
pub const CHECKPOINT: &str = "checkpoint.bin";
/// Ending of the report of `tetmesh-check`, which is also a result.
pub const REPORT: &str = "report.json";
/// Ending of the page about the case.
pub const PAGE: &str = "report.html";
/// Folder of the stages' reports.
pub const REPORTS: &str = "reports";
/// Folder of the pictures, within the folder of the case.
pub const PICTURES: &str = "pictures";
const LOCK: &str = ".lock";
/// Names of unfinished files start with the first text and contain the second
/// (`common/file/src/output.rs`, `files.py` of tetmesh-check).
const PARTIAL: (&str, &str) = (".isoparticles-", ".partial");

/// The files of a stage.
///
/// # Panics
/// When there is no such stage.
#[must_use]
pub fn belongings(stage: &str) -> &'static Belongings {
    STAGES.iter().find(|known| known.stage == stage).expect("a stage of the table")
}

/// Held while a run works in a folder. The system releases it when the process ends, in any way.
#[derive(Debug)]
pub struct Lock {
    _file: File,
    /// Whether the file system supports locks, so that no other run can hold this one.
    certain: bool,
}

impl CaseFolder {
    /// The folder of a case; creates nothing.
    #[must_use]
    pub fn new(out: &Path, name: &str) -> Self {
        Self { path: out.join(name), name: name.to_owned() }
    }

    /// Name of a file of the case, by its ending.
    #[must_use]
    pub fn file_name(&self, ending: &str) -> String {
        format!("{}.{ending}", self.name)
    }

    /// Path of a file of the case, by its ending.
    #[must_use]
    pub fn file(&self, ending: &str) -> PathBuf {
        self.path.join(self.file_name(ending))
    }

    /// Path of the status file.
    #[must_use]
    pub fn status_path(&self) -> PathBuf {
        self.file("status.json")
    }

    /// Creates the folder and takes the lock. The holder is the only writer, so unfinished files of
    /// killed programs are then removed.
    ///
    /// # Errors
    /// When the folder cannot be created, or another run works in it.
    pub fn lock(&self) -> Result<Lock> {
        std::fs::create_dir_all(self.path.join(REPORTS)).map_err(|error| {
            Error::file(&self.path, "create the folder", &error, "check OUT, its permissions and the free disk space")
        })?;
        let lock = self.try_lock()?.ok_or_else(|| {
            Error::input(
                format!("{}: another run works on this case", self.path.display()),
                "two runs would overwrite each other's files",
                "wait until it ends, stop it, or set another NAME",
            )
        })?;
        if lock.certain {
            self.remove_partial();
        }
        Ok(lock)
    }

    /// Removes unfinished files. One that cannot be removed does no harm.
    fn remove_partial(&self) {
        let folders = [self.path.clone(), self.path.join(REPORTS), self.path.join(PICTURES)];
        for entry in folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.starts_with(PARTIAL.0) && name.contains(PARTIAL.1) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Takes the lock of an existing folder; `None` when another run holds it.
    fn try_lock(&self) -> Result<Option<Lock>> {
        let path = self.path.join(LOCK);
        let file = File::options().create(true).truncate(false).write(true).open(&path);
        let file = file.map_err(|error| Error::file(&path, "write", &error, "check the folder's permissions"))?;
        match file.try_lock() {
            Ok(()) => Ok(Some(Lock { _file: file, certain: true })),
            Err(std::fs::TryLockError::WouldBlock) => Ok(None),
            // Without file locks a second run cannot be detected; most runs are alone.
            Err(std::fs::TryLockError::Error(_)) => Ok(Some(Lock { _file: file, certain: false })),
        }
    }

    /// Reads the status, and marks it interrupted if its run was killed. `None` if there is no
    /// readable status. The status of a run in progress stays unchanged.
    ///
    /// # Errors
    /// When the corrected status cannot be written.
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

    /// Sorted names of the files that belong to a stage, including those in its subfolders.
    #[must_use]
    pub fn files_of(&self, stage: &Belongings) -> Vec<String> {
        let mut files: Vec<String> = self.listing("").into_iter().filter(|name| self.owns(stage, name)).collect();
        for folder in stage.folders {
            files.extend(self.listing(folder));
        }
        files.sort();
        files
    }

    /// Whether a file with this name belongs to a stage.
    fn owns(&self, stage: &Belongings, name: &str) -> bool {
        let Some(rest) = name.strip_prefix(&self.name).and_then(|rest| rest.strip_prefix('.')) else { return false };
        let starts = |stem: &str| rest.strip_prefix(stem).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
        rest != PAGE && stage.stems.iter().any(|stem| starts(stem))
    }

    /// Names of the files in a subfolder, relative to the folder of the case.
    fn listing(&self, folder: &str) -> Vec<String> {
        let Ok(entries) = std::fs::read_dir(self.path.join(folder)) else { return Vec::new() };
        let prefix = if folder.is_empty() { String::new() } else { format!("{folder}/") };
        let files = entries.flatten().filter(|entry| !entry.path().is_dir());
        files.map(|entry| format!("{prefix}{}", entry.file_name().to_string_lossy())).collect()
    }

    /// Whether a name is one of a stage's fixed file names, with or without `.failed`.
    #[must_use]
    pub fn is_usual(&self, stage: &Belongings, name: &str) -> bool {
        let usual = std::iter::once(&stage.output).chain(stage.set_aside).chain(stage.explains);
        usual.into_iter().any(|ending| name == self.file_name(ending) || name == self.file_name(&failed(ending)))
    }

    /// Removes what a stage made, except files with the endings in `keep`. Removed are files with
    /// fixed names, files in the status, and all files of its stems if it was killed. Other files
    /// belong to the user and stay.
    ///
    /// # Errors
    /// When a file cannot be removed.
    pub fn remove_files_of(&self, stage: &Belongings, earlier: Option<&Stage>, keep: &[&str]) -> Result<()> {
        for name in self.made_before(stage, earlier) {
            if !keep.iter().any(|ending| name == self.file_name(ending)) {
                self.remove(&name)?;
            }
        }
        for folder in stage.folders {
            // Fails if the folder holds other files; these stay.
            let _ = std::fs::remove_dir(self.path.join(folder));
        }
        self.remove(&report_name(stage.stage))
    }

    /// Names of the files that a stage made in an earlier run.
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
    /// When it exists and cannot be removed.
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

    /// Renames the results of a failed stage with `.failed`, keeps pictures and explaining files,
    /// and removes the rest. Files in `others` existed before the run and stay. Returns the names
    /// of the kept files.
    ///
    /// # Errors
    /// When a file cannot be renamed or removed.
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

    /// Sizes and modification times of files, by name, to detect later changes.
    #[must_use]
    pub fn identities(&self, names: &[String]) -> std::collections::BTreeMap<String, Identity> {
        names.iter().filter_map(|name| Some((name.clone(), Identity::of(&self.path.join(name))?))).collect()
    }

    /// Whether every output of a stage is unchanged since the stage wrote it.
    #[must_use]
    pub fn is_intact(&self, stage: &Stage) -> bool {
        let same = |(name, identity): (&String, &Identity)| Identity::of(&self.path.join(name)) == Some(*identity);
        stage.identities.len() == stage.outputs.len() && stage.identities.iter().all(same)
    }

    /// Removes the whole folder; `false` if it does not exist.
    ///
    /// # Errors
    /// When it is not the folder of a case, another run works in it, or it cannot be removed.
    pub fn clean(&self) -> Result<bool> {
        if !self.path.exists() {
            return Ok(false);
        }
        let known = STAGES.iter().any(|stage| !self.files_of(stage).is_empty());
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

/// Ending of a result that is kept after a failed check: `volume.vtu` becomes `volume.failed.vtu`.
fn failed(ending: &str) -> String {
    ending.rsplit_once('.').map_or_else(|| format!("{ending}.failed"), |(stem, kind)| format!("{stem}.failed.{kind}"))
}

/// Path of a stage's report relative to the folder of the case.
#[must_use]
pub fn report_name(stage: &str) -> String {
    format!("{REPORTS}/{stage}.json")
}

/// Corrects the status of a killed run: running stages become interrupted.
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

    /// `tests/kills.py` found that SIGKILL during a write leaves the unfinished file behind.
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
}
