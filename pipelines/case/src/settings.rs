//! Collects the settings of a case from the user and the case file, and decides which settings take
//! precedence.

use crate::keys::{self, KEYS};
use isoparticles_stage::error::{Error, Result};
use std::collections::BTreeMap;

/// Source of a setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The user, on the command line.
    User,
    /// The case file, or a default of the Makefile.
    Case,
}

/// The keys that are set, with their values.
#[derive(Clone, Debug, Default)]
pub struct Settings {
    values: BTreeMap<&'static str, (String, Source)>,
    case_file: Option<String>,
    /// Where the user's settings come from, as messages describe it.
    by_user: String,
}

/// Pairs of mutually exclusive keys, with the reason.
const EXCLUSIVE: [(&str, &str, &str); 10] = [
    ("INPUT", "PHANTOM", "a case has one volume: a file or a phantom"),
    ("ISO", "LABELS", "a volume is meshed either as a scan or as a label map"),
    ("ISO", "MATERIALS", "a volume is meshed either as a scan or as a label map"),
    ("LABELS", "MATERIALS", "LABELS joins labels to one object, MATERIALS keeps them apart"),
    ("SIZE", "EPSILON", SIZE_IS_UNIFORM),
    ("SIZE", "DELTA", SIZE_IS_UNIFORM),
    ("SIZE", "MIN_SIZE", SIZE_IS_UNIFORM),
    ("SIZE", "MAX_SIZE", SIZE_IS_UNIFORM),
    ("SIZE", "QUALITY", SIZE_IS_UNIFORM),
    ("SIZE", "VERTICES", "each of them sets the edge length"),
];
/// Reason why SIZE excludes the keys that grade or bound the edge length.
const SIZE_IS_UNIFORM: &str = "SIZE sets one edge length everywhere, without grading or bounds";

/// Pairs of keys. If the user sets the first key, a value of the second key from the case file is
/// ignored.
const DROPPED_WITH: [(&str, &str); 6] = [
    ("LABELS", "INSIDE"),
    ("MATERIALS", "INSIDE"),
    ("SIZE", "SCALE"),
    ("VERTICES", "SCALE"),
    ("VERTICES", "MIN_SIZE"),
    ("VERTICES", "MAX_SIZE"),
];

impl Settings {
    /// Reads the `KEY=VALUE` assignments of the user and of the case file. The user's settings take
    /// precedence; settings of the case file that contradict them are dropped. An empty value
    /// unsets a key.
    ///
    /// # Errors
    /// If a key is unknown (the message suggests the most similar key or name in `known`), a value
    /// has the wrong form, or two keys from one source exclude each other.
    pub fn read(user: &[String], case: &[String], case_file: Option<&str>, known: &[String]) -> Result<Self> {
        let by_user = "on the command line".to_owned();
        Self { case_file: case_file.map(str::to_owned), by_user, ..Self::default() }.filled(user, case, known)
    }

    /// Reads settings like [`Settings::read`], but takes the user's assignments from a row of a
    /// list. These assignments take precedence over `common`, which applies to all rows.
    ///
    /// # Errors
    /// If [`Settings::read`] would return an error for these settings.
    pub fn read_row(row: &[String], line: u64, common: &[String], known: &[String]) -> Result<Self> {
        Self { by_user: format!("line {line} of the list"), ..Self::default() }.filled(row, common, known)
    }

    fn filled(mut self, user: &[String], case: &[String], known: &[String]) -> Result<Self> {
        let settings = &mut self;
        for (assignments, by) in [(case, Source::Case), (user, Source::User)] {
            for assignment in assignments {
                let set_by = settings.hand(by);
                let (name, value) = assignment.split_once('=').ok_or_else(|| {
                    Error::input(
                        format!("{assignment}: not a variable with a value ({set_by})"),
                        "variables describe a case",
                        "write KEY=VALUE, such as SIZE=2.5",
                    )
                })?;
                let (key, value) = (keys::find(name, known, &set_by)?, value.trim());
                settings.values.remove(key.name);
                if !value.is_empty() {
                    keys::check(key, value, &set_by)?;
                    settings.values.insert(key.name, (value.to_owned(), by));
                }
            }
        }
        settings.give_way()?;
        Ok(self)
    }

    /// Returns the value of a key, or `None` if the key is unset or was dropped.
    pub fn get(&self, key: &str) -> Option<&str> {
        self.values.get(key).map(|(value, _)| value.as_str())
    }

    /// Returns the settings without one of the keys.
    #[must_use]
    pub fn without(&self, key: &str) -> Self {
        let mut settings = self.clone();
        settings.values.remove(key);
        settings
    }

    /// Splits a value that is a list of options into words, as a shell does.
    pub fn words(&self, key: &str) -> Vec<String> {
        // `keys::check` has verified the quotes.
        self.get(key).and_then(shlex::split).unwrap_or_default()
    }

    /// Returns the file name of the case file without its extension, if there is a case file.
    pub fn case_file(&self) -> Option<&str> {
        self.case_file.as_deref()
    }

    /// Returns the settings that may change a result. The status stores them.
    pub fn parameters(&self) -> BTreeMap<String, String> {
        let told = KEYS.iter().filter(|key| !keys::WITHOUT_EFFECT.contains(&key.name));
        told.filter_map(|key| Some((key.name.to_owned(), self.get(key.name)?.to_owned()))).collect()
    }

    fn by(&self, key: &str) -> Option<Source> {
        self.values.get(key).map(|(_, by)| *by)
    }

    /// Describes, for messages, where a setting comes from.
    fn hand(&self, by: Source) -> String {
        match (by, &self.case_file) {
            (Source::User, _) => self.by_user.clone(),
            (Source::Case, Some(file)) => format!("in pipelines/{file}.mk"),
            (Source::Case, None) => "by default".to_owned(),
        }
    }

    fn give_way(&mut self) -> Result<()> {
        for (mine, other) in DROPPED_WITH {
            if self.by(mine) == Some(Source::User) && self.by(other) == Some(Source::Case) {
                self.values.remove(other);
            }
        }
        for (one, two, why) in EXCLUSIVE {
            match (self.by(one), self.by(two)) {
                (Some(Source::User), Some(Source::Case)) => drop(self.values.remove(two)),
                (Some(Source::Case), Some(Source::User)) => drop(self.values.remove(one)),
                (Some(by), Some(_)) => {
                    let value = |key| self.get(key).unwrap_or_default().to_owned();
                    return Err(Error::input(
                        format!("{one}={} and {two}={} are both set ({})", value(one), value(two), self.hand(by)),
                        why,
                        format!("keep {one} or {two}"),
                    ));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(user: &[&str], case: &[&str]) -> Result<Settings> {
        let strings = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
        Settings::read(&strings(user), &strings(case), Some("demo"), &[])
    }

    #[test]
    fn a_case_file_gives_way_to_the_user() {
        let case = ["ISO=170", "INSIDE=above", "MIN_SIZE=2", "SCALE=3", "SEED=4"];
        let settings = read(&["SIZE=3"], &case).expect("SIZE against the case's MIN_SIZE");
        assert_eq!((settings.get("SIZE"), settings.get("MIN_SIZE"), settings.get("SCALE")), (Some("3"), None, None));
        assert_eq!((settings.get("ISO"), settings.get("SEED")), (Some("170"), Some("4")));
        let settings = read(&["LABELS=left lung,2..5"], &case).expect("LABELS against the case's ISO");
        assert_eq!((settings.get("ISO"), settings.get("INSIDE")), (None, None));
        assert_eq!(settings.get("LABELS"), Some("left lung,2..5"));
        let settings = read(&["MATERIALS=all"], &case).expect("MATERIALS against the case's ISO");
        assert_eq!((settings.get("ISO"), settings.get("INSIDE"), settings.get("MATERIALS")), (None, None, Some("all")));
        let settings = read(&["MATERIALS=all", "VERTICES=9000"], &["LABELS=1", "SIZE=2"])
            .expect("a number of vertices of many materials");
        assert_eq!((settings.get("MATERIALS"), settings.get("VERTICES")), (Some("all"), Some("9000")));
        let settings = read(&["MAX_SIZE=9"], &["SIZE=2"]).expect("MAX_SIZE against the case's SIZE");
        assert_eq!(settings.get("SIZE"), None);
        let settings = read(&["ISO="], &case).expect("an empty value unsets the case's");
        assert_eq!(settings.get("ISO"), None);
        assert_eq!(read(&["SEED=5"], &case).expect("the same key").get("SEED"), Some("5"));
    }

    #[test]
    fn two_values_of_one_hand_that_exclude_each_other_are_refused() {
        let error = read(&["SIZE=3", "MIN_SIZE=1"], &[]).expect_err("both by the user");
        assert!(error.what.contains("SIZE=3 and MIN_SIZE=1") && error.what.contains("command line"), "{error}");
        let error = read(&["LABELS=1", "MATERIALS=all"], &[]).expect_err("one object or many");
        assert!(error.what.contains("LABELS=1 and MATERIALS=all"), "{error}");
        let error = read(&[], &["ISO=3", "LABELS=1"]).expect_err("both by the case");
        assert!(error.what.contains("pipelines/demo.mk"), "{error}");
        let error = read(&[], &["MIN_SZIE=3"]).expect_err("a slip in the case file");
        assert!(error.what.contains("pipelines/demo.mk") && error.next.contains("MIN_SIZE"), "{error}");
    }
}
