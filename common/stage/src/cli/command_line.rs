//! The canonical command line in the history of an output.

use isoparticles_file::history::file_name;
use std::path::{Path, PathBuf};

/// Shared options with a value that do not affect the result.
const SILENT: [&str; 4] = ["--threads", "--max-memory", "--report", "--progress"];

/// Returns the command line for the history. Paths in `outputs` are replaced with `OUTPUT`, and
/// other paths with their file names. Shared options that do not affect the result are omitted, and
/// so are the options in `silent`, all of which have a value.
pub(super) fn canonical_command_line(
    tool: &str,
    arguments: impl Iterator<Item = String>,
    outputs: &[PathBuf],
    silent: &[&str],
) -> String {
    let mut words = vec![tool.to_owned()];
    let mut arguments = arguments;
    while let Some(argument) = arguments.next() {
        let (name, value) = match argument.split_once('=') {
            Some((name, value)) if name.starts_with("--") => (name, Some(value)),
            _ => (argument.as_str(), None),
        };
        let short_flags = name.len() > 1 && name.starts_with('-') && name[1..].chars().all(|c| c == 'v' || c == 'q');
        match name {
            "--verbose" | "--quiet" | "--force" => {}
            _ if short_flags => {}
            // -oPATH and -o=PATH are the same as -o PATH
            _ if name.len() > 2 && name.starts_with("-o") => {
                words.extend(["-o".to_owned(), shorten(name[2..].trim_start_matches('='), outputs)]);
            }
            _ if SILENT.contains(&name) || silent.contains(&name) => {
                if value.is_none() {
                    arguments.next();
                }
            }
            _ => words.push(match value {
                Some(value) => format!("{name}={}", shorten(value, outputs)),
                None => shorten(&argument, outputs),
            }),
        }
    }
    words.join(" ")
}

fn shorten(word: &str, outputs: &[PathBuf]) -> String {
    let path = Path::new(word);
    if outputs.iter().any(|output| output == path) {
        "OUTPUT".to_owned()
    } else if word.contains([std::path::MAIN_SEPARATOR, '/']) && !is_pair(word) {
        file_name(path)
    } else {
        word.to_owned()
    }
}

/// Returns whether a word gives a length of a pair of materials, such as `left/right=1.5`.
fn is_pair(word: &str) -> bool {
    !word.starts_with("mask:") && word.rsplit_once('=').is_some_and(|(_, value)| value.parse::<f64>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn canonical_command_line_omits_folders_outputs_and_threads() {
        let line = |words: &[&str], output: &str| {
            canonical_command_line(
                "seed",
                words.iter().map(|word| (*word).to_owned()),
                &[PathBuf::from(output)],
                &["--export"],
            )
        };
        let first = line(
            &["/a/in.vti", "-o", "/a/out.bin", "--seed", "3", "-vv", "--threads=4", "--max-memory", "8G", "--force"],
            "/a/out.bin",
        );
        let second =
            line(&["b/in.vti", "-o", "other.bin", "--export=inp", "--seed", "3", "--report", "r.json"], "other.bin");
        assert_eq!(first, "seed in.vti -o OUTPUT --seed 3");
        assert_eq!(first, second);
        for attached in ["-oout.bin", "-o=out.bin"] {
            assert_eq!(line(&["in.vti", attached], "out.bin"), "seed in.vti -o OUTPUT");
        }
        assert_eq!(line(&["--iso=-500", "-5"], "x"), "seed --iso=-500 -5");
        assert_eq!(line(&["--refine", "mask:/home/me/valve.nrrd=0.4"], "x"), "seed --refine valve.nrrd=0.4");
        for size in ["--size left/right=1.5", "--size=left/right=1.5"] {
            let words: Vec<&str> = size.split(' ').collect();
            assert_eq!(line(&words, "x"), format!("seed {size}"));
        }
    }
}
