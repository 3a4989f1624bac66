//! Changes the edge length in regions of a finished surface (RESIZE). After `reconstruct`,
//! `sizefield --update` and `reconstruct --update` run for each region in turn.

use crate::command::{Command, Programs, options, resized, shared};
use crate::folder::{CaseFolder, report_name};
use crate::program::{self, Ended};
use crate::settings::Settings;
use isoparticles_stage::error::{Error, Result};
use std::ffi::OsString;
use std::path::PathBuf;

/// Returns `first`, the command that makes the surface, and the commands that change it in each
/// region in turn. Intermediate files have the names of the results of the case, in folders of
/// their own. Histories contain names without folders, so the history of a step does not depend on
/// the number of steps that follow.
pub(crate) fn commands(
    first: Command,
    folder: &CaseFolder,
    regions: &[String],
    settings: &Settings,
    programs: &Programs,
) -> Vec<Command> {
    let word = OsString::from;
    let file = |ending: &str| folder.file(ending).into_os_string();
    let step =
        |at: usize, ending: &str| folder.path.join(UPDATES[at % 2]).join(folder.file_name(ending)).into_os_string();
    let (size, surface) = ("sizefield.vti", "surface.vtp");
    let mut commands = vec![first];
    replace(&mut commands[0].arguments, &file(surface), &step(0, surface));
    for (before, region) in regions.iter().enumerate() {
        let is_last = before + 1 == regions.len();
        let previous = if before == 0 { file(size) } else { step(before, size) };
        let sized = if is_last { resized(folder) } else { step(before + 1, size) };
        let made = if is_last { file(surface) } else { step(before + 1, surface) };
        let program = programs.bin.join("sizefield");
        let files = [
            file("distfield.vti"),
            word("--update"),
            previous,
            word("-o"),
            sized.clone(),
            word("--resize"),
            word(region),
        ];
        // all commands write the report of the stage; that of the last one remains
        let report = folder.path.join(report_name("reconstruct")).into_os_string();
        let arguments =
            files.into_iter().chain(shared(settings, "sizefield")).chain([word("--report"), report.clone()]);
        commands.push(Command { program, arguments: arguments.collect() });
        let files = [
            word("--update"),
            step(before, surface),
            word("--distfield"),
            file("distfield.vti"),
            word("--sizefield"),
            sized,
            word("-o"),
            made,
        ];
        let options = options("reconstruct", settings).into_iter().map(OsString::from);
        let arguments =
            files.into_iter().chain(options).chain(shared(settings, "reconstruct")).chain([word("--report"), report]);
        commands.push(Command { program: programs.bin.join("reconstruct"), arguments: arguments.collect() });
    }
    commands
}

/// Folders of the intermediate files, within the folder of the case. The steps use them
/// alternately, and [`run`] removes them at its end.
const UPDATES: [&str; 2] = ["updates/0", "updates/1"];

/// Replaces the words that are equal to `from`.
fn replace(words: &mut [OsString], from: &OsString, to: &OsString) {
    words.iter_mut().filter(|word| *word == from).for_each(|word| word.clone_from(to));
}

/// Runs the commands of a stage in order, and stops after the first that does not exit with code 0.
/// The intermediate files are removed in any case.
///
/// # Errors
/// If a program cannot be started, or if a folder cannot be made.
pub(crate) fn run(folder: &CaseFolder, commands: &[Command]) -> Result<Ended> {
    let between = UPDATES.map(|name| folder.path.join(name));
    let has_updates = commands.len() > 1;
    for path in between.iter().filter(|_| has_updates) {
        std::fs::create_dir_all(path)
            .map_err(|error| Error::file(path, "create", &error, "check the folder's permissions"))?;
    }
    let mut ended = Ok(Ended::Code(0));
    for command in commands {
        ended = program::run(&command.program, &command.arguments);
        if !matches!(ended, Ok(Ended::Code(0))) {
            keep_surface(folder, command);
            break;
        }
    }
    between.iter().filter(|_| has_updates).for_each(|path| drop(std::fs::remove_dir_all(path)));
    ended
}

/// Moves the surface that a command has written, and its offending simplices, to the places of the
/// result. The case then keeps them like any surface that fails a check.
fn keep_surface(folder: &CaseFolder, command: &Command) {
    let result = folder.file("surface.vtp");
    let output = command.arguments.iter().skip_while(|word| *word != "-o").nth(1).map(PathBuf::from);
    let Some(surface) = output.filter(|path| path.file_name() == result.file_name()) else { return };
    for ending in ["vtp", "offending.vtp"] {
        // a file that the command has not written cannot be moved
        let _ = std::fs::rename(surface.with_extension(ending), result.with_extension(ending));
    }
}
