//! Defines the keys that a user or a case file may set: their meaning, and how their values are
//! checked before any work starts.

use isoparticles_stage::error::{Error, Result};

/// Form of a value, which is checked before any work starts.
#[derive(Clone, Copy, Debug)]
pub enum Form {
    /// Any string. The stage that uses it checks it.
    Text,
    /// Options of a program, split into words as in a shell.
    Words,
    /// A finite number.
    Number,
    /// A finite number above 0.
    Positive,
    /// A finite number that is 0 or more.
    NotNegative,
    /// A whole number of at least this value.
    Whole(u64),
    /// One of these words.
    OneOf(&'static [&'static str]),
}

/// One key.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Name on the command line and in a case file.
    pub name: &'static str,
    /// Form of the value.
    pub form: Form,
    /// Short description with the unit.
    pub what: &'static str,
}

const fn key(name: &'static str, form: Form, what: &'static str) -> Key {
    Key { name, form, what }
}

/// All keys, in the order of the help text.
pub const KEYS: [Key; 41] = [
    key("CASE", Form::Text, "the case file in pipelines/"),
    key("NAME", Form::Text, "the name of the results"),
    key("INPUT", Form::Text, "the volume to mesh"),
    key("PHANTOM", Form::Words, "the shape and options of the phantom program"),
    key("SERIES", Form::Text, "the series of a folder of DICOM files, by description, number or UID"),
    key("DATASET", Form::Text, "the array of an HDF5, MATLAB or Zarr file: a path, a variable or a level"),
    key(
        "SPACING",
        Form::Text,
        "the distance between voxel centres of a file that does not contain it, mm: 0.01 or 1,1,2",
    ),
    key(
        "CROP",
        Form::Text,
        "the region to keep: a box such as mm:0..50,..,10.. or voxels:0..99,..,5.., or a mask file",
    ),
    key("DOWNSAMPLE", Form::Text, "the number of voxels to join along each axis: 2 or 2,2,1"),
    key("ISO", Form::Number, "the iso value"),
    key("LABELS", Form::Text, "the labels to mesh"),
    key("MATERIALS", Form::Text, "the materials to mesh together: all, or lungs:2,heart:1,rest:3+4..6"),
    key("INSIDE", Form::OneOf(&["above", "below"]), "the side of ISO on which the object lies"),
    key("BORDER", Form::OneOf(&["cap", "flat", "open"]), "the treatment of the object at the border of the volume"),
    key(
        "SPACE",
        Form::OneOf(&["lps", "ras", "scanner"]),
        "the world frame of the results: lps, ras, or scanner, that of INPUT",
    ),
    key("SCALE", Form::NotNegative, "the size of the features to smooth away, mm"),
    key("EPSILON", Form::Positive, "the ratio of edge length to local feature size"),
    key("DELTA", Form::Positive, "the maximum gradient of the edge length"),
    key("SIZE", Form::Positive, "a constant edge length, mm"),
    key("MIN_SIZE", Form::Positive, "the minimum edge length, mm"),
    key("MAX_SIZE", Form::Positive, "the maximum edge length, mm"),
    key("VERTICES", Form::Whole(4), "the number of vertices of the surface"),
    key("QUALITY", Form::OneOf(&["coarse", "medium", "fine"]), "how fine the mesh is"),
    key(
        "RESIZE",
        Form::Words,
        "changes of the edge length in regions of the finished surface: ball:X,Y,Z,RADIUS=H or mask:FILE=H, in this order",
    ),
    key("COUNT", Form::Whole(4), "the number of particles to seed"),
    key("SEED", Form::Whole(0), "the seed for random numbers"),
    key("BACKEND", Form::OneOf(&["auto", "gpu", "cpu"]), "the device that moves the particles"),
    key(
        "TET_ORDER",
        Form::OneOf(&["1", "2"]),
        "the order of the tetrahedra; 2 adds mid-edge nodes, on F = 0 or on interfaces for surface edges",
    ),
    key(
        "FOR",
        Form::OneOf(&["simnibs", "brainstorm", "opencarp", "febio", "calculix", "fenicsx", "simvascular"]),
        "the program for which the tetrahedra are exported",
    ),
    key(
        "ACCEPT_LOSSES",
        Form::OneOf(&["yes", "no"]),
        "whether to accept objects and materials whose volume a scale changes by more than 10 %; the verdict lists them",
    ),
    key(
        "ACCEPT_FORCED",
        Form::OneOf(&["yes", "no"]),
        "whether to accept elements below a limit where the surface allows no better ones; the verdict counts them",
    ),
    key("MAX_MEMORY", Form::Text, "the maximum memory of a stage, such as 8G"),
    key("DISTFIELD_OPTIONS", Form::Words, "further options of distfield"),
    key("SIZEFIELD_OPTIONS", Form::Words, "further options of sizefield"),
    key("PARTICLES_OPTIONS", Form::Words, "further options of particles"),
    key("RECONSTRUCT_OPTIONS", Form::Words, "further options of reconstruct"),
    key("TETMESH_OPTIONS", Form::Words, "further options of tetmesh-check"),
    key("OUT", Form::Text, "the folder of the results"),
    key("THREADS", Form::Whole(0), "the number of CPU threads, 0 for all cores"),
    key("VERBOSITY", Form::Words, "-q, -v or -vv"),
    key("HXT", Form::OneOf(&["yes", "no"]), "whether Gmsh may fill large surfaces with tetrahedra"),
];

/// Keys that do not change results. They do not cause a stage to run again and are not among the
/// parameters in the status.
pub const WITHOUT_EFFECT: [&str; 5] = ["CASE", "OUT", "THREADS", "VERBOSITY", "MAX_MEMORY"];

/// Returns the key called `name`. For an unknown name, the error suggests the most similar name
/// among the keys and the caller's names in `other`.
///
/// # Errors
/// If there is no such key.
pub fn find(name: &str, other: &[String], set_by: &str) -> Result<&'static Key> {
    if let Some(key) = KEYS.iter().find(|key| key.name == name) {
        return Ok(key);
    }
    let known = KEYS.iter().map(|key| key.name).chain(other.iter().map(String::as_str));
    let nearest = nearest(name, known).map_or(String::new(), |near| format!("did you mean {near}? "));
    Err(Error::input(
        format!("{name}: no such variable ({set_by})"),
        "it would be ignored",
        format!("{nearest}`{} help` lists them", crate::program::front()),
    ))
}

/// Returns the candidate with the smallest edit distance from `name`, if `name` may be a
/// misspelling of it.
pub fn nearest<'a>(name: &str, candidates: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let name = name.to_uppercase();
    let distance = |candidate: &str| strsim::damerau_levenshtein(&name, candidate);
    // As in rustc, a third of the letters may be wrong, or one letter in a short name.
    let most = (name.chars().count() / 3).max(1);
    candidates.map(|candidate| (distance(candidate), candidate)).min().filter(|(d, _)| *d <= most).map(|(_, c)| c)
}

/// Checks the value of a key.
///
/// # Errors
/// If the value does not have the form of the key.
pub fn check(key: &Key, value: &str, set_by: &str) -> Result<()> {
    let must = match key.form {
        Form::Text => None,
        Form::Words => shlex::split(value).is_none().then(|| "options with balanced quotes".to_owned()),
        Form::Number => wrong_number(value, |_| true).then(|| "a number, such as 300 or -500.5".to_owned()),
        Form::Positive => wrong_number(value, |x| x > 0.0).then(|| "a number above 0, such as 2.5".to_owned()),
        Form::NotNegative => {
            wrong_number(value, |x| x >= 0.0).then(|| "a number of at least 0, such as 2.5".to_owned())
        }
        Form::Whole(least) => {
            value.parse::<u64>().map_or(true, |n| n < least).then(|| format!("a whole number of at least {least}"))
        }
        Form::OneOf(words) => (!words.contains(&value)).then(|| {
            let near = nearest_word(value, words).map_or(String::new(), |near| format!(" (did you mean {near}?)"));
            format!("one of {}{near}", words.join(", "))
        }),
    };
    match must {
        None => Ok(()),
        Some(must) => Err(Error::input(
            format!("{}={value} ({set_by}): not {}", key.name, form_in_words(key.form)),
            format!("{} sets {}", key.name, key.what),
            format!("give {must}"),
        )),
    }
}

/// Returns the first word whose edit distance from a value is at most two.
fn nearest_word<'a>(value: &str, words: &[&'a str]) -> Option<&'a str> {
    let value = value.to_lowercase();
    words.iter().copied().find(|word| strsim::damerau_levenshtein(&value, word) <= 2)
}

fn form_in_words(form: Form) -> &'static str {
    match form {
        Form::Text => "a text",
        Form::Words => "a list of options",
        Form::Number => "a number",
        Form::Positive => "a number above 0",
        Form::NotNegative => "a number of at least 0",
        Form::Whole(_) => "a whole number in range",
        Form::OneOf(_) => "an allowed word",
    }
}

fn wrong_number(value: &str, fits: impl Fn(f64) -> bool) -> bool {
    !value.parse::<f64>().is_ok_and(|x| x.is_finite() && fits(x))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_is_met_with_the_nearest_name() {
        let other = ["BENCH_OPTIONS".to_owned()];
        for (slip, meant) in [
            ("SZIE", "SIZE"),
            ("size", "SIZE"),
            ("MINSIZE", "MIN_SIZE"),
            ("LABEL", "LABELS"),
            ("BENCH_OPTION", "BENCH_OPTIONS"),
        ] {
            let error = find(slip, &other, "on the command line").expect_err(slip);
            assert!(error.next.contains(&format!("did you mean {meant}?")), "{slip}: {error}");
        }
        let error = find("ELEPHANTS", &other, "on the command line").expect_err("far from all");
        assert!(!error.next.contains("did you mean"), "{error}");
    }

    #[test]
    fn values_are_checked_by_their_form() {
        let attempts = [
            ("SIZE", "2.5", "-1"),
            ("SIZE", "1e1", "abc"),
            ("ISO", "-500", "abc"),
            ("ISO", "0", "inf"),
            ("SCALE", "0", "-0.1"),
            ("THREADS", "0", "two"),
            ("VERTICES", "20000", "3"),
            ("BORDER", "open", "opened"),
            ("TETMESH_OPTIONS", "--export 'inp,msh'", "--export 'inp"),
        ];
        for (name, good, bad) in attempts {
            let key = find(name, &[], "here").expect(name);
            check(key, good, "on the command line").expect(good);
            let error = check(key, bad, "on the command line").expect_err(bad);
            assert!(error.what.contains(&format!("{name}={bad}")) && error.next.starts_with("give "), "{error}");
        }
    }
}
