//! Selects the advice for failed checks and warnings from the table
//! `stages/tetmesh-check/src/tetmesh_check/report/page/advice.json`. The page of a case uses the
//! same table; `advice.py` beside it describes its format.

use serde::Deserialize;
use std::collections::BTreeMap;

const TABLE: &str = include_str!("../../../stages/tetmesh-check/src/tetmesh_check/report/page/advice.json");

#[derive(Deserialize)]
struct Table {
    advice: Vec<Entry>,
    terms: Vec<Entry>,
}

/// An entry of the table. `text` is the advice for messages that contain `words`, or, for a term,
/// the text that replaces the placeholder `words` in the advice.
#[derive(Deserialize)]
struct Entry {
    words: String,
    /// Variable that must be set for the entry to apply, or `VARIABLE=VALUE`; `None` if the entry
    /// always applies.
    set: Option<String>,
    #[serde(rename = "do")]
    text: String,
}

impl Entry {
    fn applies(&self, parameters: &BTreeMap<String, String>) -> bool {
        let Some(set) = &self.set else { return true };
        match set.split_once('=') {
            Some((name, value)) => parameters.get(name).is_some_and(|known| known == value),
            None => parameters.contains_key(set),
        }
    }
}

/// Returns the advice for a failed check of a case with these parameters, or `None` if the message
/// of the check already contains advice. For an unknown message, the advice refers to the
/// troubleshooting page.
pub(crate) fn advice_for(check: &str, parameters: &BTreeMap<String, String>) -> Option<String> {
    find(check, parameters, |_| true)
}

/// Returns the advice for a warning, or `None` if the table has no entry for it.
pub(crate) fn known_advice(warning: &str, parameters: &BTreeMap<String, String>) -> Option<String> {
    find(warning, parameters, |entry| !entry.words.is_empty())
}

fn find(message: &str, parameters: &BTreeMap<String, String>, usable: fn(&Entry) -> bool) -> Option<String> {
    let table: Table = serde_json::from_str(TABLE).ok()?;
    let lowered = message.to_lowercase();
    let fits = |entry: &&Entry| usable(entry) && lowered.contains(&entry.words) && entry.applies(parameters);
    let advice = table.advice.iter().find(fits)?.text.clone();
    let terms = table.terms.iter().filter(|term| term.applies(parameters));
    let text = terms.fold(advice, |text, term| text.replace(&term.words, &term.text));
    (!text.is_empty()).then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn advice(check: &str, set: &[(&str, &str)]) -> String {
        let parameters = set.iter().map(|&(name, value)| (name.to_owned(), value.to_owned())).collect();
        advice_for(check, &parameters).unwrap_or_default()
    }

    #[test]
    fn advice_names_the_variable_that_is_set() {
        let check = "3 pairs of intersecting triangles";
        assert!(advice(check, &[]).contains("a smaller MIN_SIZE, or RECONSTRUCT_OPTIONS"));
        let of_materials = advice(check, &[("SIZE", "2"), ("MATERIALS", "all")]);
        assert!(of_materials.contains("use a smaller SIZE") && of_materials.contains("--size NAME=MM"));
        assert!(advice(check, &[("VERTICES", "900")]).contains("more VERTICES"));
    }

    #[test]
    fn advice_depends_on_the_value_of_a_variable() {
        let check = "4 open edges (edges of only one triangle)";
        assert!(advice(check, &[("BORDER", "open")]).contains("BORDER=cap"));
        assert!(!advice(check, &[("BORDER", "cap")]).contains("BORDER"));
    }

    #[test]
    fn a_message_with_advice_gets_no_other() {
        assert_eq!(advice("2 poor triangles forced by the junction curves: --accept-forced accepts them", &[]), "");
        assert!(advice("an unknown message", &[]).contains("troubleshooting.md"));
        assert_eq!(known_advice("an unknown message", &BTreeMap::new()), None);
    }
}
