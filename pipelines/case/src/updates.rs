//! Changes of the edge length in regions of a finished surface (RESIZE): after `reconstruct`,
//! `sizefield --update` and `reconstruct --update` run for each region in turn.

use crate::command::{Command, Programs, options, resized, shared};
use crate::folder::{CaseFolder, report_name};
use crate::program::{self, Ended};
use crate::settings::Settings;
use isoparticles_stage::error::{Error, Result};
use std::ffi::OsString;

/// Returns the commands that change the surface of `first` in several regions, one after the other.
/// The files of each step have the names that the results of the case would have, so their
/// histories do not depend on the number of regions.
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
        let own = [
            file("distfield.vti"),
            word("--update"),
            previous,
            word("--resize"),
            word(region),
            word("-o"),
            sized.clone(),
        ];
        let report = folder.path.join(report_name("reconstruct")).into_os_string();
        let arguments = own.into_iter().chain(shared(settings, "sizefield")).chain([word("--report"), report.clone()]);
        commands.push(Command { program, arguments: arguments.collect() });
        let own = [
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
            own.into_iter().chain(options).chain(shared(settings, "reconstruct")).chain([word("--report"), report]);
        commands.push(Command { program: programs.bin.join("reconstruct"), arguments: arguments.collect() });
    }
    commands
}

/// Folders of the files of every other update, within the folder of the case. A run removes them
/// when all updates are done.
const UPDATES: [&str; 2] = ["updates/0", "updates/1"];

fn replace(words: &mut [OsString], from: &OsString, to: &OsString) {
    words.iter_mut().filter(|word| *word == from).for_each(|word| word.clone_from(to));
}

/// Runs the commands of a stage until one does not succeed. The files of intermediate updates are
/// removed in any case.
///
/// # Errors
/// If a program cannot be started, or a folder cannot be made or removed.
pub(crate) fn run(folder: &CaseFolder, commands: &[Command]) -> Result<Ended> {
    let between = UPDATES.map(|name| folder.path.join(name));
    let has_updates = commands.len() > 1;
    for path in between.iter().filter(|_| has_updates) {
        std::fs::create_dir_all(path)
            .map_err(|error| Error::file(path, "create", &error, "check the folder's permissions"))?;
    }
    let mut ended = Ok(Ended::Code(0));
    for command in commands {
        if matches!(ended, Ok(Ended::Code(0))) {
            ended = program::run(&command.program, &command.arguments);
        }
    }
    between.iter().filter(|_| has_updates).for_each(|path| drop(std::fs::remove_dir_all(path)));
    ended
}
