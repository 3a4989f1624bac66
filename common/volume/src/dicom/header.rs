//! Reads elements of DICOM headers, and creates the errors for missing and invalid ones.

use crate::error::bad;
use crate::error::{Error, Result};
use dicom_dictionary_std::tags;
use dicom_object::{InMemDicomObject, Tag};
use std::path::Path;

/// The elements of a DICOM file, or of an item in one of its sequences.
#[derive(Clone, Copy)]
pub(super) struct Header<'a> {
    pub(super) path: &'a Path,
    pub(super) object: &'a InMemDicomObject,
}

impl<'a> Header<'a> {
    /// Returns an element as a string, or an empty string if the element is missing.
    pub(super) fn text(&self, tag: Tag) -> String {
        let text = self.object.get(tag).and_then(|element| element.to_str().ok());
        text.map_or_else(String::new, |text| text.trim_matches([' ', '\0']).to_owned())
    }

    /// Returns an element as an integer from 0 to 65,535, or `None` if the element is missing.
    pub(super) fn whole(&self, tag: Tag) -> Result<Option<usize>> {
        let Some(element) = self.object.get(tag) else { return Ok(None) };
        match element.to_int::<u16>() {
            Ok(number) => Ok(Some(number.into())),
            Err(error) => Err(self.meaningless(&tag.to_string(), &error.to_string())),
        }
    }

    /// Returns the `COUNT` finite numbers of an element. Fails if the element is missing or
    /// invalid.
    pub(super) fn numbers<const COUNT: usize>(&self, tag: Tag, name: &str) -> Result<[f64; COUNT]> {
        let Some(element) = self.object.get(tag) else {
            return Err(bad(
                self.path,
                format!("has no {name}"),
                "without it, the position of the slice is unknown",
                "export the series again from a program that keeps it, or move files that are not slices to another \
                 folder",
            ));
        };
        let numbers = element.to_multi_float64().ok().and_then(|numbers| <[f64; COUNT]>::try_from(numbers).ok());
        numbers
            .filter(|numbers| numbers.iter().all(|number| number.is_finite()))
            .ok_or_else(|| self.meaningless(name, &self.text(tag)))
    }

    /// Returns an element as a number, or `default` if the element is missing.
    pub(super) fn number_or(&self, tag: Tag, name: &str, default: f64) -> Result<f64> {
        match self.object.get(tag) {
            None => Ok(default),
            Some(_) => self.numbers::<1>(tag, name).map(|[number]| number),
        }
    }

    /// Returns an element as a positive number, or `None` if it is missing or not one.
    pub(super) fn positive(&self, tag: Tag) -> Option<f64> {
        let number = self.object.get(tag)?.to_float64().ok()?;
        (number.is_finite() && number > 0.0).then_some(number)
    }

    /// Returns the items of a sequence. A missing sequence has no items.
    pub(super) fn items(&self, tag: Tag) -> impl ExactSizeIterator<Item = Self> + Clone + use<'a> {
        let items = self.object.get(tag).and_then(|element| element.items()).unwrap_or_default();
        let path = self.path;
        items.iter().map(move |object| Header { path, object })
    }

    /// Returns an item of a sequence.
    pub(super) fn item(&self, tag: Tag, index: usize) -> Option<Self> {
        let object = self.object.get(tag)?.items()?.get(index)?;
        Some(Header { path: self.path, object })
    }

    /// Returns the elements of a functional group of a frame (PS3.3, section C.7.6.16): the item of
    /// the sequence `tag` for this frame, otherwise the item for all frames. Returns `self` if
    /// neither exists, because files with one frame have the same elements outside of sequences.
    pub(super) fn of_frame(&self, frame: usize, tag: Tag) -> Self {
        let own = self.item(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, frame);
        let shared = || self.item(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, 0);
        let group = |groups: Header<'a>| groups.item(tag, 0);
        own.and_then(group).or_else(|| shared().and_then(group)).unwrap_or(*self)
    }

    pub(super) fn meaningless(&self, name: &str, value: &str) -> Error {
        let shown: String = value.chars().take(80).collect();
        bad(
            self.path,
            format!("has {name} '{shown}' in its header"),
            "this value is invalid",
            "copy or export the file again",
        )
    }
}

/// Creates the error for a file that the operating system cannot read.
pub(super) fn unreadable(path: &Path, error: std::io::Error) -> Error {
    Error::file(path, "read", error, "copy or export the file again")
}

/// Creates the error for a file whose elements cannot be read, for the given reason.
pub(super) fn damaged(path: &Path, damage: &str) -> Error {
    bad(
        path,
        format!("cannot be read as DICOM: {damage}"),
        "it is truncated or damaged, or uses a compression that cannot be read",
        "copy the file again, write it uncompressed (gdcmconv --raw), or move it to another folder if it is not a slice",
    )
}
